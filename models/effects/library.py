"""The library of effects, one small class each; their formulas use the symbols of `symbols.py`."""

from typing import Any

import numpy as np

from slipmap.models.effects.effect import Effect, Parameter, Scene
from slipmap.models.effects.symbols import REST_SPEED, force_at_mass_center, positive_part, smooth_step, sp
from slipmap.models.physics.cell_grid import FloatArray


class SensorLatency(Effect):
    name = "sensor_latency"
    belongs_to = "tracker"
    sentence = (
        "The tracker's clock is off relative to the finger's: poses are reported late, or early if the"
        " latency is negative."
    )
    parameters = (
        Parameter("latency", "s", "delay of the tracker; negative if it is early", -0.3, 0.5, 0.03, 0.0),
    )

    def delay(self, p: Any) -> Any:
        return p.latency


class TrackerOffset(Effect):
    name = "tracker_offset"
    sentence = "The tracked frame is not the object frame."
    parameters = (
        Parameter("x", "m", "x of the tracked frame in the object frame", -0.1, 0.1, 3e-3, 0.0),
        Parameter("y", "m", "y of the tracked frame in the object frame", -0.1, 0.1, 3e-3, 0.0),
        Parameter("angle", "rad", "rotation of the tracked frame", -0.6, 0.6, 0.02, 0.0),
    )

    def measured(self, pose: Any, p: Any) -> Any:
        c, s = sp.cos(pose.theta), sp.sin(pose.theta)
        return pose.x + c * p.x - s * p.y, pose.y + s * p.x + c * p.y, pose.theta + p.angle


class TrackerScale(Effect):
    name = "tracker_scale"
    belongs_to = "tracker"
    sentence = "The tracker's lengths are off by a few percent."
    parameters = (
        Parameter("excess", "1", "relative excess of reported over true lengths", -0.3, 0.3, 0.01, 0.0),
    )

    def measured(self, pose: Any, p: Any) -> Any:
        return (1 + p.excess) * pose.x, (1 + p.excess) * pose.y, pose.theta


class TrackerShift(Effect):
    name = "tracker_shift"
    belongs_to = "tracker"
    sentence = (
        "Tracker and finger do not share a frame: the tracker is shifted or rotated in the world, or the"
        " finger's recorded point is off its centre."
    )
    parameters = (
        Parameter("x", "m", "reported minus true x, relative to the finger", -0.1, 0.1, 3e-3, 0.0),
        Parameter("y", "m", "reported minus true y, relative to the finger", -0.1, 0.1, 3e-3, 0.0),
        Parameter("angle", "rad", "rotation of the tracker about the world's origin", -0.6, 0.6, 0.01, 0.0),
    )

    def measured(self, pose: Any, p: Any) -> Any:
        c, s = sp.cos(p.angle), sp.sin(p.angle)
        return c * pose.x - s * pose.y + p.x, s * pose.x + c * pose.y + p.y, pose.theta + p.angle


class ForceFrame(Effect):
    name = "force_frame"
    belongs_to = "force sensor"
    sentence = "The force sensor's axes are not aligned with the world's: its force is rotated or mirrored."
    parameters = (
        Parameter("angle", "rad", "rotation of the reported force", -3.5, 3.5, 0.3, 0.0),
        Parameter(
            "mirror", "1", "1: y is negated before the rotation; below 1, weakened", 0.0, 1.0, 0.3, 0.0
        ),
    )

    def felt(self, force: Any, p: Any) -> Any:
        c, s, y = sp.cos(p.angle), sp.sin(p.angle), (1 - 2 * p.mirror) * force.y
        return c * force.x - s * y, s * force.x + c * y

    def far_starts(self) -> list[dict[str, float]]:
        return [
            {"angle": angle, "mirror": mirror}
            for angle in (-np.pi / 2, 0.0, np.pi / 2, np.pi)
            for mirror in (0.0, 1.0)
            if angle or mirror
        ]


class ForceBias(Effect):
    name = "force_bias"
    belongs_to = "force sensor"
    sentence = "The force sensor was not zeroed: it adds a constant force."
    parameters = (
        Parameter("x", "N", "added force along x", -100.0, 100.0, 0.03, 0.0, weight_power=1.0),
        Parameter("y", "N", "added force along y", -100.0, 100.0, 0.03, 0.0, weight_power=1.0),
    )

    def felt(self, force: Any, p: Any) -> Any:
        return force.x + p.x, force.y + p.y


class ForceGains(Effect):
    name = "force_gains"
    belongs_to = "force sensor"
    sentence = "The force sensor's axes have different gains."
    parameters = (
        Parameter(
            "excess",
            "1",
            "relative excess of x's gain over the mean; y's is as much below",
            -0.9,
            0.9,
            0.3,
            0.0,
        ),
    )

    def felt(self, force: Any, p: Any) -> Any:
        # A gain common to both axes would be the same as different friction.
        return (1 + p.excess) * force.x, (1 - p.excess) * force.y


class ForceLatency(Effect):
    name = "force_latency"
    belongs_to = "force sensor"
    sentence = (
        "The force sensor's clock is off: forces are reported late, or early if the latency is negative."
    )
    parameters = (
        Parameter("latency", "s", "delay of the force sensor; negative if it is early", -0.3, 0.5, 0.03, 0.0),
    )

    def force_delay(self, p: Any) -> Any:
        return p.latency


class ViscousFriction(Effect):
    name = "viscous_friction"
    belongs_to = "table"
    sentence = "Drag proportional to speed and area, as from an oil film, adds to dry friction."
    parameters = (
        Parameter(
            "drag_per_area", "N s/m^3", "drag per unit speed and area", 0.0, 1e6, 100.0, 0.0, weight_power=1.0
        ),
    )

    def drag(self, cell: Any, p: Any) -> Any:
        return p.drag_per_area * cell.area


class StribeckFriction(Effect):
    name = "stribeck_friction"
    belongs_to = "table"
    sentence = "Friction falls with speed from a static to a kinetic level."
    parameters = (
        Parameter("excess", "1", "relative excess of static over kinetic friction", 0.0, 3.0, 0.3, 0.0),
        Parameter("speed", "m/s", "speed by which most of the excess is lost", 0.002, 0.5, 0.03, start=0.04),
        Parameter("shape", "1", "1: falls at once; 2: holds at first, then falls", 1.0, 2.0, 0.5, start=1.5),
    )

    def friction(self, cell: Any, p: Any) -> Any:
        return 1 + p.excess * sp.exp(-((cell.speed / p.speed) ** p.shape))

    def starts(self, scene: Scene) -> list[dict[str, float]]:
        return [{"speed": share * scene.speed} for share in (0.2, 0.5, 1.2)]


def _ellipse(a: Any, b: Any) -> tuple[Any, Any, Any]:
    """Q with eigenvalues (1 + ρ)/(1 - ρ) and its inverse, where ρ = hypot(a, b).

    The first eigenvector is at the angle atan2(b, a)/2. Friction along each eigenvector is Coulomb's times
    the square root of its eigenvalue.
    """
    square = a**2 + b**2
    return (1 + square + 2 * a) / (1 - square), 2 * b / (1 - square), (1 + square - 2 * a) / (1 - square)


def _grain(along_x: str, along_xy: str) -> tuple[Parameter, Parameter]:
    """Parameters a and b of `_ellipse`; the arguments say along which direction each raises friction."""
    return (
        Parameter(
            "along_x", "1", f"grain a: positive if friction is higher along {along_x}", -0.6, 0.6, 0.1, 0.0
        ),
        Parameter("along_xy", "1", f"grain b: the same along {along_xy}", -0.6, 0.6, 0.1, 0.0),
    )


class AnisotropicTable(Effect):
    name = "anisotropic_table"
    belongs_to = "table"
    sentence = "Friction differs along and across the table's grain."
    parameters = _grain("x than along y", "the diagonals")

    def stretch(self, cell: Any, p: Any) -> Any:
        c, s = cell.cos**2 - cell.sin**2, 2 * cell.cos * cell.sin
        return _ellipse(c * p.along_x + s * p.along_xy, c * p.along_xy - s * p.along_x)


class AnisotropicObject(Effect):
    name = "anisotropic_object"
    sentence = "Friction differs along and across a grain of the object's underside."
    parameters = _grain("the object's x", "its diagonals")

    def stretch(self, cell: Any, p: Any) -> Any:
        return _ellipse(p.along_x, p.along_xy)


class TableTilt(Effect):
    name = "table_tilt"
    belongs_to = "table"
    sentence = "The table is not level: gravity has a component along it."
    parameters = (
        Parameter("down_x", "rad", "slope along x, positive downhill", -0.4, 0.4, 0.03, 0.0),
        Parameter("down_y", "rad", "slope along y, positive downhill", -0.4, 0.4, 0.03, 0.0),
    )

    def downhill(self, body: Any, p: Any) -> Any:
        return body.gravity * p.down_x, body.gravity * p.down_y


class TableFrictionField(Effect):
    name = "table_friction_field"
    belongs_to = "table"
    sentence = "Friction varies with the position on the table: a gradient, a patch, or both."
    parameters = (
        Parameter(
            "gradient_x",
            "1/m",
            "rise of friction along x over that at the patch's centre",
            -8.0,
            8.0,
            1.0,
            0.0,
        ),
        Parameter("gradient_y", "1/m", "the same along y", -8.0, 8.0, 1.0, 0.0),
        Parameter("patch", "1", "logarithm of the friction factor on a round patch", -2.5, 2.5, 0.5, 0.0),
        Parameter("patch_x", "m", "centre of the patch, x", -10.0, 10.0, 0.1),
        Parameter("patch_y", "m", "centre of the patch, y", -10.0, 10.0, 0.1),
        Parameter("patch_radius", "m", "radius of the patch", 0.01, 2.0, 0.05, start=0.12),
    )

    def friction(self, cell: Any, p: Any) -> Any:
        distance = sp.sqrt((cell.x - p.patch_x) ** 2 + (cell.y - p.patch_y) ** 2 + 1e-12)
        # Share of the cell inside the patch: the patch's edge is sharper than a cell is wide.
        inside = smooth_step(p.patch_radius - distance, cell.width)
        # The patch's centre, where searches start among the pushes, anchors the gradient as well: the world's
        # origin may be anywhere.
        rise = 1 + p.gradient_x * (cell.x - p.patch_x) + p.gradient_y * (cell.y - p.patch_y)
        return positive_part(rise, 0.02) / positive_part(1, 0.02) * sp.exp(p.patch * inside)

    def level(self, place: FloatArray, values: FloatArray) -> FloatArray:
        gradient, center = values[:, :2], values[:, 3:5]
        rise = 1.0 + (gradient * (place - center)).sum(axis=1)
        return np.asarray((rise + np.hypot(rise, 0.02)) / (1.0 + np.hypot(1.0, 0.02)))

    def starts(self, scene: Scene) -> list[dict[str, float]]:
        # Half the width of the region in which the object's cells were.
        width = scene.reach + 0.5 * scene.radius
        places = np.array([-0.5, 0.0, 0.5]) * width
        x0, y0 = scene.center
        return [
            {"patch_x": x0 + x, "patch_y": y0 + y, "patch_radius": share * width}
            for share in (0.45, 1.0)
            for x in places
            for y in places
        ]

    def far_starts(self) -> list[dict[str, float]]:
        # Without a patch, nothing says where it is: from the null, the gradient takes its place.
        return [{"patch": -0.7}, {"patch": 0.7}]


class Tether(Effect):
    name = "tether"
    sentence = "A cable, when taut, pulls the object towards a fixed point."
    parameters = (
        Parameter("stiffness", "N/m", "stiffness of the cable", 0.0, 1e4, 1.0, 0.0, weight_power=1.0),
        Parameter("anchor_x", "m", "fixed end of the cable, x", -2.0, 2.0, 0.3),
        Parameter("anchor_y", "m", "fixed end of the cable, y", -2.0, 2.0, 0.3),
        Parameter("slack", "m", "length at which the cable becomes taut", 0.0, 10.0, 0.1),
        Parameter("point_x", "m", "attachment to the object, x in the object frame", -1.0, 1.0, 0.03),
        Parameter("point_y", "m", "attachment to the object, y in the object frame", -1.0, 1.0, 0.03),
    )

    def force(self, body: Any, p: Any) -> Any:
        arm_x = body.cos * p.point_x - body.sin * p.point_y
        arm_y = body.sin * p.point_x + body.cos * p.point_y
        dx, dy = p.anchor_x - body.x - arm_x, p.anchor_y - body.y - arm_y
        distance = sp.sqrt(dx**2 + dy**2 + 1e-6)
        pull = p.stiffness * positive_part(distance - p.slack, 2e-3) / distance
        return pull * dx, pull * dy, pull * (arm_x * dy - arm_y * dx)

    def starts(self, scene: Scene) -> list[dict[str, float]]:
        (x, y), reach = scene.center, scene.reach
        return [
            {
                "anchor_x": x + far * reach * np.cos(angle),
                "anchor_y": y + far * reach * np.sin(angle),
                "slack": slack * reach,
            }
            for angle in np.arange(0.0, 2 * np.pi, np.pi / 3)
            for far, slack in ((0.6, 0.0), (1.5, 1.2))
        ]


class FrictionDrift(Effect):
    name = "friction_drift"
    sentence = "Friction changes from push to push, by wear or polishing."
    parameters = (Parameter("rate", "1/push", "relative change of friction per push", -0.3, 0.3, 0.01, 0.0),)

    def friction(self, cell: Any, p: Any) -> Any:
        return sp.exp(p.rate * cell.order)


class FingerCompliance(Effect):
    name = "finger_compliance"
    belongs_to = "finger"
    sentence = "The finger bends: its true tip yields to the contact force."
    parameters = (
        Parameter(
            "compliance", "m/N", "deflection of the tip per force", 0.0, 0.1, 4e-3, 0.0, weight_power=-1.0
        ),
    )

    def compliance(self, body: Any, p: Any) -> Any:
        return p.compliance


class LooseMass(Effect):
    name = "loose_mass"
    sentence = "Part of the mass moves inside the object, on a spring and damper."
    parameters = (
        Parameter("share", "1", "loose share of the mass", 0.0, 0.9, 0.2, 0.0),
        Parameter("rate", "rad/s", "natural frequency of the loose part", 1.0, 120.0, 10.0, start=15.0),
        Parameter("damping", "1", "damping ratio of the loose part", 0.0, 2.0, 0.2, start=0.2),
    )
    memory = ("lag_x", "lag_y", "rush_x", "rush_y")

    def _pull(self, body: Any, p: Any) -> tuple[Any, Any]:
        """World acceleration that spring and damper give the loose part, which lags by lag_x, lag_y.

        It is that in the middle of the step if nothing else holds the rest of the object (trapezoidal rule),
        which is stable for every rate: at its old value, a stiff spring would create energy.
        """
        stiffness, damper = p.rate**2, 2 * p.damping * p.rate + body.step * p.rate**2 / 2
        slower = 1 + body.step * damper / (2 * (1 - p.share))
        return tuple(
            -(stiffness * lag + damper * rush) / slower
            for lag, rush in ((body.lag_x, body.rush_x), (body.lag_y, body.rush_y))
        )

    def inertia(self, body: Any, p: Any) -> Any:
        return 1 - p.share

    def force(self, body: Any, p: Any) -> Any:
        ax, ay = self._pull(body, p)
        return force_at_mass_center(body, -p.share * body.mass * ax, -p.share * body.mass * ay)

    def remember(self, before: Any, after: Any, p: Any) -> Any:
        ax, ay = self._pull(before, p)
        rush_x = before.rush_x + before.step * ax - (after.com_vx - before.com_vx)
        rush_y = before.rush_y + before.step * ay - (after.com_vy - before.com_vy)
        lag_x = before.lag_x + before.step * (before.rush_x + rush_x) / 2
        return lag_x, before.lag_y + before.step * (before.rush_y + rush_y) / 2, rush_x, rush_y

    def starts(self, scene: Scene) -> list[dict[str, float]]:
        return [{"rate": rate, "damping": damping} for rate in (6.0, 15.0, 35.0) for damping in (0.1, 0.5)]


class LoadTransfer(Effect):
    name = "load_transfer"
    sentence = "Pushing above the table's surface and braking shift load between cells."
    parameters = (
        Parameter("push_height", "m", "height of the finger above the table", 0.0, 0.5, 0.03, 0.0),
        Parameter("mass_height", "m", "height of the centre of mass", 0.0, 0.5, 0.03, 0.0),
    )
    memory = ("gain_x", "gain_y")

    def friction(self, cell: Any, p: Any) -> Any:
        # Moment per unit weight, which the table balances by loading the cells in front: of the finger, of
        # inertia, and of gravity on a slope.
        inertia_x = cell.mass * (cell.gain_x - cell.downhill_x)
        inertia_y = cell.mass * (cell.gain_y - cell.downhill_y)
        mx = (p.push_height * cell.force_x - p.mass_height * inertia_x) / cell.weight
        my = (p.push_height * cell.force_y - p.mass_height * inertia_y) / cell.weight
        bx, by = cell.cos * mx + cell.sin * my, cell.cos * my - cell.sin * mx
        kx = cell.spread_xx * bx + cell.spread_xy * by
        ky = cell.spread_xy * bx + cell.spread_yy * by
        # No shift at the centre of mass, so that the sum stays the weight while no cell lifts off.
        com_x = cell.cos * cell.com_x + cell.sin * cell.com_y
        com_y = cell.cos * cell.com_y - cell.sin * cell.com_x
        shift = kx * (cell.rx - com_x) + ky * (cell.ry - com_y)
        # Cells that lift off carry nothing, and those in front carry that much more. The eighth root is three
        # square roots, which vectorise over cells.
        return 1 + shift / (1 + shift**8) ** sp.Rational(1, 8)

    def remember(self, before: Any, after: Any, p: Any) -> Any:
        return (
            (after.com_vx - before.com_vx) / before.step,
            (after.com_vy - before.com_vy) / before.step,
        )


class Skate(Effect):
    name = "skate"
    sentence = "A blade or wheel under the object runs freely along one line and resists sideways motion."
    parameters = (
        Parameter("resistance", "1", "sideways resistance divided by the weight", 0.0, 3.0, 0.05, 0.0),
        Parameter("angle", "rad", "free direction, object frame", -7.0, 7.0, 0.4),
        Parameter("point_x", "m", "contact with the table, x in the object frame", -1.0, 1.0, 0.03),
        Parameter("point_y", "m", "contact with the table, y in the object frame", -1.0, 1.0, 0.03),
    )

    def blade(self, body: Any, p: Any) -> Any:
        return p.resistance * body.weight, -sp.sin(p.angle), sp.cos(p.angle), p.point_x, p.point_y

    def starts(self, scene: Scene) -> list[dict[str, float]]:
        return [{"angle": angle} for angle in np.arange(0.0, np.pi, np.pi / 6)]


class ImpulseFriction(Effect):
    name = "impulse_friction"
    belongs_to = "table"
    sentence = (
        "Friction is solved as impulses along the world's x and y, as in simulators, and leans towards the "
        "axis that meets more mass."
    )
    parameters = (
        Parameter(
            "share", "1", "how far friction leans; 1 as in Bullet's multibody solver", 0.0, 1.0, 0.3, 0.0
        ),
    )

    def _lean(self, cell: Any, p: Any) -> Any:
        """d of an impulse that meets masses in the ratio (1 + d) / (1 - d) along the world's x and y.

        The impulse acts at the arm (a_x, a_y) from the centre of mass of an object with radius of gyration ρ:
        d = (a_x² - a_y²) / (2 ρ² + a_x² + a_y²), times the share.
        """
        arm_x = cell.cos * cell.rx - cell.sin * cell.ry - cell.com_x
        arm_y = cell.sin * cell.rx + cell.cos * cell.ry - cell.com_y
        radius2 = cell.moment / cell.mass - cell.com_x**2 - cell.com_y**2
        return p.share * (arm_x**2 - arm_y**2) / (2 * radius2 + arm_x**2 + arm_y**2)

    def stretch(self, cell: Any, p: Any) -> Any:
        d = self._lean(cell, p)
        along = d * sp.cos(2 * cell.theta)
        return 1 + along, -d * sp.sin(2 * cell.theta), 1 - along

    def friction(self, cell: Any, p: Any) -> Any:
        # The force leans without growing: μN Q u / |Q u|, with u's direction from before the step. In a step
        # from rest or with a turning cell it lies between μN sqrt(1 - |d|) and μN sqrt(1 + |d|).
        d = self._lean(cell, p)
        norm2 = (1 + d) * cell.ux**2 + (1 - d) * cell.uy**2
        force2 = (1 + d) ** 2 * cell.ux**2 + (1 - d) ** 2 * cell.uy**2
        return sp.sqrt((norm2 + REST_SPEED**2) / (force2 + REST_SPEED**2))


class FrictionDiamond(Effect):
    name = "friction_diamond"
    belongs_to = "table"
    sentence = (
        "Friction follows a pyramid instead of a cone, as in MuJoCo by default, and is smaller along the"
        " diagonals of the world's axes."
    )
    parameters = (
        Parameter("share", "1", "1: a pyramid; below 1, a blend of cone and pyramid", 0.0, 1.0, 0.3, 0.0),
    )

    def pyramid(self, body: Any, p: Any) -> Any:
        return 1 - p.share, p.share / sp.sqrt(2), sp.pi / 4


class FrictionSquare(Effect):
    name = "friction_square"
    belongs_to = "table"
    sentence = "Friction is solved separately along the world's x and y, and is larger along the diagonals."
    parameters = (
        Parameter(
            "share", "1", "1: two separate frictions; below 1, a blend with the cone", 0.0, 1.0, 0.3, 0.0
        ),
    )

    def pyramid(self, body: Any, p: Any) -> Any:
        return 1 - p.share, p.share, sp.Integer(0)


class SlipLoad(Effect):
    name = "slip_load"
    sentence = "Cells that slip faster carry more load: a simulator's contacts lift what slides over them."
    parameters = (
        Parameter(
            "share", "1", "0: even load; 1: load as slip squared, in a spin on the spot", -1.0, 3.0, 0.5, 0.0
        ),
    )

    def friction(self, cell: Any, p: Any) -> Any:
        # Squared slip is quadratic in position. Its linear part would tip the object and is left out, which
        # leaves ω² (|r - r_com|² - ρ²) over the mean square; weighted by mass, it sums to 0.
        x, y = cell.cos * cell.rx - cell.sin * cell.ry, cell.sin * cell.rx + cell.cos * cell.ry
        apart2 = (x - cell.com_x) ** 2 + (y - cell.com_y) ** 2
        radius2 = cell.moment / cell.mass - cell.com_x**2 - cell.com_y**2 - cell.width**2 / 6
        spin2 = cell.omega**2
        mean2 = cell.com_vx**2 + cell.com_vy**2 + spin2 * radius2 + REST_SPEED**2
        shift = p.share * spin2 * (apart2 - radius2) / mean2
        # As in `LoadTransfer`: no cell pulls at the table.
        return 1 + shift / (1 + shift**8) ** sp.Rational(1, 8)


class TorsionalFriction(Effect):
    name = "torsional_friction"
    sentence = "A torque resists rotation in addition to the cells' friction, however the object slides."
    parameters = (Parameter("radius", "m", "torque divided by the object's weight", 0.0, 0.05, 2e-3, 0.0),)

    def blade(self, body: Any, p: Any) -> Any:
        # A blade so far away that it resists only spin: n is 1e-3 of a unit vector, at an arm of 1 km.
        return p.radius * body.weight, 1e-3, 0, 0, -1e3


class _Library(tuple[Effect, ...]):
    """The effects that slipmap knows, shown by name in signatures."""

    def __repr__(self) -> str:
        return "slipmap.LIBRARY"


_EFFECTS = (
    ViscousFriction(),
    StribeckFriction(),
    AnisotropicTable(),
    AnisotropicObject(),
    TableTilt(),
    TableFrictionField(),
    Tether(),
    SensorLatency(),
    FrictionDrift(),
    FingerCompliance(),
    LooseMass(),
    LoadTransfer(),
    Skate(),
    ImpulseFriction(),
    FrictionDiamond(),
    FrictionSquare(),
    SlipLoad(),
    TorsionalFriction(),
    TrackerOffset(),
    TrackerScale(),
    TrackerShift(),
    ForceFrame(),
    ForceBias(),
    ForceGains(),
    ForceLatency(),
)

LIBRARY: tuple[Effect, ...] = _Library(_EFFECTS)
