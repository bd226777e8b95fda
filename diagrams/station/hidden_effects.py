"""Effects in the true world that the object's model lacks and that pushes should reveal.

Parameters have the same meaning as those of the same name in `models/effects/library.py`; the defaults mean
no effect.
"""

# Annotations stay objects, because Drake's YAML reader inspects them.
from dataclasses import dataclass, field, fields

import numpy as np
from pydrake.common.cpp_param import List
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder, State
from pydrake.systems.sensors import ImageDepth32F

from slipmap.diagrams.station.sliding_object import BODY, GRAVITY, connect_motion, spatial_inertia
from slipmap.diagrams.systems.python_system import PythonSystem, held, read, replace_held
from slipmap.models.objects.true_object import TrueObject
from slipmap.models.physics.cell_grid import FloatArray

_TOUCH = 2e-3  # m; cells farther from the table's height do not slide on it
_LATEST = 0.3  # s
_SLOWEST = 1e-3  # m/s; the extra friction fades out below about this slip
_SLOW_PUSH = 0.04  # m/s; an object moved as slowly must not be stopped within a time step
_FAR = 0.5  # m, distance from the table's centre up to which a gradient's rise is examined
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]  # the two axes after each


class _Numbers:
    _not_negative: tuple[str, ...] = ()

    def check(self) -> None:
        """Raise ValueError for an invalid field."""
        for item in fields(self):  # type: ignore[arg-type]
            value = getattr(self, item.name)
            if not np.isfinite(value) or (item.name in self._not_negative and value < 0):
                sign = " and not negative" if item.name in self._not_negative else ""
                raise ValueError(f"{type(self).__name__}.{item.name} must be finite{sign}, got {value}")


@dataclass
class TableTilt(_Numbers):
    """The table is not level; only the object feels it."""

    # down_x, down_y: slopes along x and y, downhill where positive, rad
    down_x: float = 0.0
    down_y: float = 0.0

    def check(self) -> None:
        """Raise ValueError for an invalid field."""
        super().check()
        if max(abs(self.down_x), abs(self.down_y)) > 0.5:
            raise ValueError(f"TableTilt: slopes are in rad, at most 0.5, got {self.down_x}, {self.down_y}")


@dataclass
class Tether(_Numbers):
    """A cable pulls the object towards a fixed point beyond its slack length."""

    _not_negative = ("stiffness", "slack")

    stiffness: float = 0.0  # of the cable, N/m
    # anchor_x, anchor_y: where it is fixed on the table, world, m
    anchor_x: float = 0.3
    anchor_y: float = 0.0
    slack: float = 0.0  # length at which it starts to pull, m
    # point_x, point_y: where it is tied to the object's base, object frame, m
    point_x: float = 0.0
    point_y: float = 0.0


@dataclass
class ViscousFriction(_Numbers):
    """A film of oil under the object."""

    _not_negative = ("drag_per_area",)

    drag_per_area: float = 0.0  # force per speed and area, N s/m³


@dataclass
class TableFrictionField(_Numbers):
    """Friction varies with the place on the table."""

    _not_negative = ("patch_radius",)

    # gradient_x, gradient_y: rise along x and y relative to friction at the patch's centre, 1/m
    gradient_x: float = 0.0
    gradient_y: float = 0.0
    patch: float = 0.0  # logarithm of the factor on a round patch
    # patch_x, patch_y: its centre, world, m
    patch_x: float = 0.0
    patch_y: float = 0.0
    patch_radius: float = 0.12  # m

    def factor(self, points: FloatArray) -> FloatArray:
        """(k,) factor on friction at points (k, 2), world, m."""
        away = points - [self.patch_x, self.patch_y]
        inside = np.hypot(*away.T) < self.patch_radius
        slope = 1 + away @ np.array([self.gradient_x, self.gradient_y])
        return np.maximum(slope, 0.0) * np.exp(self.patch * inside)


@dataclass
class SensorLatency(_Numbers):
    """Pictures are late, but claim to be current."""

    _not_negative = ("latency",)

    latency: float = 0.0  # s

    def check(self) -> None:
        """Raise ValueError for an invalid field."""
        super().check()
        if self.latency > _LATEST:
            raise ValueError(
                f"SensorLatency.latency must be at most {_LATEST:g} s, got {self.latency}: otherwise the arm"
                " counts as aside while it is still in the picture"
            )


@dataclass
class HiddenEffectsConfig:
    """All effects that can be hidden in the station; none by default."""

    table_tilt: TableTilt = field(default_factory=TableTilt)
    tether: Tether = field(default_factory=Tether)
    viscous_friction: ViscousFriction = field(default_factory=ViscousFriction)
    table_friction_field: TableFrictionField = field(default_factory=TableFrictionField)
    sensor_latency: SensorLatency = field(default_factory=SensorLatency)

    def check(self) -> None:
        """Raise ValueError for an invalid field."""
        for effect in fields(self):
            getattr(self, effect.name).check()

    @property
    def is_null(self) -> bool:
        """Whether there is no effect at all."""
        return not self.is_forceful and not self.sensor_latency.latency

    @property
    def is_forceful(self) -> bool:
        """Whether there is an effect on the object itself."""
        tilt, spots = self.table_tilt, self.table_friction_field
        sizes = [tilt.down_x, tilt.down_y, self.tether.stiffness, self.viscous_friction.drag_per_area]
        return any([*sizes, spots.gradient_x, spots.gradient_y, spots.patch])


def tilted_gravity(tilt: TableTilt, gravity: float = GRAVITY) -> FloatArray:
    """(3,) gravity in the frame of a table that slopes down by `tilt` along x and y, m/s²."""
    down = np.array([np.tan(tilt.down_x), np.tan(tilt.down_y), -1.0])
    return gravity * down / np.linalg.norm(down)


def check_strength(config: HiddenEffectsConfig, thing: TrueObject, step: float, gravity: float) -> None:
    """Refuse effects that are too stiff or too strong to be simulated.

    Args:
        config: whose parameters are valid.
        thing: the object that they act on.
        step: of the plant, s.
        gravity: m/s².

    Raises:
        ValueError: names the setting of the scenario, and what the step allows.
    """
    mass, area = thing.total_mass, len(thing.grid) * thing.grid.width**2
    # Explicit Euler needs less than 2 and 4; a quarter of that keeps it accurate.
    if config.viscous_friction.drag_per_area * area * step / mass > 0.5:
        raise ValueError(
            "hidden.viscous_friction: ViscousFriction.drag_per_area: too large for an object of"
            f" {mass:.3g} kg and a time step of {step:g} s; at most {0.5 * mass / step / area:.3g} N s/m³,"
            " or a smaller simulation.time_step"
        )
    if config.tether.stiffness * step**2 / mass > 1.0:
        raise ValueError(
            f"hidden.tether: Tether.stiffness: too stiff for an object of {mass:.3g} kg and a time step of"
            f" {step:g} s; at most {mass / step**2:.3g} N/m, or a smaller simulation.time_step"
        )
    field = config.table_friction_field
    if any((field.gradient_x, field.gradient_y, field.patch)):
        _refuse_sticky(field, thing, step, gravity)


def _refuse_sticky(field: TableFrictionField, thing: TrueObject, step: float, gravity: float) -> None:
    # A force that is constant over a step can at most stop the object within it.
    uphill = np.array([field.gradient_x, field.gradient_y])
    far = _FAR / max(float(np.hypot(*uphill)), 1e-9) * uphill
    places = np.array([far, [field.patch_x, field.patch_y] if field.patch > 0 else far])
    cells = thing.grid.centers - thing.center_of_mass[:2] + places[:, None]
    with np.errstate(over="ignore"):
        factors = np.minimum(field.factor(cells.reshape(-1, 2)), 1e9).reshape(len(places), -1)
    braked = (np.maximum(factors - 1, 0) @ (thing.mass * thing.mu)) * gravity * step / thing.total_mass
    if (worst := float(braked.max())) > _SLOW_PUSH:
        highest = float(factors[braked.argmax()].max())
        raise ValueError(
            f"hidden.table_friction_field: friction of up to {highest:.3g} times the object's own is too"
            f" strong for a time step of {step:g} s: in one step it would take {worst:.3g} m/s from the"
            f" object, but slow pushes have {_SLOW_PUSH:g} m/s; at most"
            f" {1 + (highest - 1) * _SLOW_PUSH / worst:.3g} times, or a smaller simulation.time_step"
        )


class HiddenEffects(PythonSystem):
    """Forces of the hidden effects on the object, for the plant's `applied_spatial_force`.

    Inputs are the plant's `body_poses` and `body_spatial_velocities`.

    Tilt acts as the difference between tilted and level gravity at the centre of mass. The plant's own
    gravity stays level, because an arm whose controller knows its mounting is not affected. The tether pulls
    at the base, so that it does not tip the object. Drag is integrated over the cells' squares.

    In Drake, a cell has the same coefficient everywhere. The friction field therefore acts as the difference,
    (factor - 1) μ m g for each cell on the table, against (or along) the cell's slip. A force that is
    constant over a time step cannot stick, so it fades out below a slip of 1 mm/s, and where friction is
    reduced, below the speed that one step of the difference gives to a free cell. Additional friction takes
    at most as much energy from the object as its impulse over a step can. During a push only cells next to
    the centre of rotation are that slow; but an object at rest is held by its friction without the field.

    Raises:
        ValueError: an invalid parameter, or an effect too stiff or too strong to be simulated with the
            plant's time step.
    """

    def __init__(self, plant: MultibodyPlant, true_object: TrueObject, config: HiddenEffectsConfig) -> None:
        super().__init__()
        config.check()
        grid = true_object.grid
        gravity = -float(plant.gravity_field().gravity_vector()[2])
        check_strength(config, true_object, plant.time_step(), gravity)
        self._config = config
        self._index = plant.GetBodyByName(BODY).index()
        self._base = np.column_stack([grid.centers, np.zeros(len(grid))])
        self._width = grid.width
        self._load = true_object.mass * true_object.mu * gravity
        self._step = plant.time_step()
        self._step_of_speed = true_object.mu * gravity * self._step
        self._mass = true_object.total_mass
        inertia = spatial_inertia(true_object)
        self._spin_inertia = inertia.Shift(inertia.get_com()).CalcRotationalInertia().get_moments()[2]
        self._p_OC = true_object.center_of_mass
        tilted, level = (tilted_gravity(tilt, gravity) for tilt in (config.table_tilt, TableTilt()))
        self._downhill = self._mass * (tilted - level)
        field = config.table_friction_field
        self._slows = any(
            (config.viscous_friction.drag_per_area, field.gradient_x, field.gradient_y, field.patch)
        )
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[List[RigidTransform]]())
        self._velocities = self.DeclareAbstractInputPort(
            "body_spatial_velocities", Value[List[SpatialVelocity]]()
        )
        self.DeclareAbstractOutputPort(
            "spatial_forces",
            lambda: AbstractValue.Make([ExternallyAppliedSpatialForce()]),
            self._calc_forces,
            {self._poses.ticket(), self._velocities.ticket()},
        )

    def _calc_forces(self, context: Context, output: AbstractValue) -> None:
        X_WO: RigidTransform = self._poses.Eval(context)[self._index]
        V_WO: SpatialVelocity = self._velocities.Eval(context)[self._index]
        force, torque = self.wrench(X_WO, V_WO)
        applied = ExternallyAppliedSpatialForce()
        applied.body_index = self._index
        applied.p_BoBq_B = np.zeros(3)
        applied.F_Bq_W = SpatialForce(torque, force)
        output.set_value([applied])

    def wrench(self, X_WO: RigidTransform, V_WO: SpatialVelocity) -> tuple[FloatArray, FloatArray]:
        """Force (3,) and torque (3,) about the object frame's origin, world, N and N m."""
        R, p_WO, tether = X_WO.rotation().matrix(), X_WO.translation(), self._config.tether
        tied = R @ [tether.point_x, tether.point_y, 0.0]
        forces = np.array([self._downhill, tether_pull(tether, p_WO + tied)])
        force = forces.sum(axis=0)
        torque = _cross(np.array([R @ self._p_OC, tied]), forces).sum(axis=0)
        if self._slows:
            omega, arms = V_WO.rotational(), self._base @ R.T
            velocities = V_WO.translational() + _cross(omega, arms)
            velocities[:, 2] = 0.0
            touching = np.abs(p_WO[2] + arms[:, 2]) < _TOUCH
            drag = self._config.viscous_friction.drag_per_area * self._width**2 * touching
            friction = self._extra_friction(p_WO + arms, velocities, touching)
            brakes = (friction * velocities).sum(axis=1) < 0.0
            friction[brakes] *= self._share(
                friction[brakes], (arms - R @ self._p_OC)[brakes], velocities[brakes]
            )
            slowing = friction - drag[:, None] * velocities
            force = force + slowing.sum(axis=0)
            torque = torque + _cross(arms, slowing).sum(axis=0)
            # A square's own second moment, w²/6 of its area.
            torque[2] -= drag.sum() * self._width**2 / 6 * omega[2]
        return force, torque

    def _extra_friction(self, p_WC: FloatArray, v_WC: FloatArray, touching: FloatArray) -> FloatArray:
        """(n, 3) force that the friction field adds to the friction of each cell, world, N."""
        excess = (self._config.table_friction_field.factor(p_WC[:, :2]) - 1) * touching
        slowest = np.maximum(_SLOWEST, -excess * self._step_of_speed)
        speed = np.sqrt((v_WC**2).sum(axis=1) + slowest**2)
        return -(excess * self._load / speed)[:, None] * v_WC

    def _share(self, forces: FloatArray, arms: FloatArray, velocities: FloatArray) -> float:
        """Largest share, up to 1, of planar forces (n, 3) that brake the object throughout a time step.

        At this share their impulse leaves the object with the least energy; more of it would drive it back.

        Args:
            forces: on the cells, world, N.
            arms: (n, 3) the cells from the centre of mass, world, m.
            velocities: (n, 3) of the cells, world, m/s.
        """
        power = float((forces * velocities).sum())
        if power >= 0:
            return 1.0
        total = forces.sum(axis=0)
        spin = float(arms[:, 0] @ forces[:, 1] - arms[:, 1] @ forces[:, 0])
        taken = float(total @ total) / self._mass + spin**2 / self._spin_inertia
        return min(1.0, -power / max(self._step * taken, 1e-300))


def _cross(one: FloatArray, other: FloatArray) -> FloatArray:
    """(…, 3) cross products; `np.cross` takes several times as long for so few vectors."""
    return one.take(_NEXT, -1) * other.take(_LAST, -1) - one.take(_LAST, -1) * other.take(_NEXT, -1)


def tether_pull(tether: Tether, p_WP: FloatArray) -> FloatArray:
    """(3,) force on the object's end of the cable, world, N."""
    way = np.array([tether.anchor_x, tether.anchor_y, p_WP[2]]) - p_WP
    length = float(np.linalg.norm(way))
    if length <= max(tether.slack, 1e-9):
        return np.zeros(3)
    return tether.stiffness * (length - tether.slack) / length * way


class LatePictures(PythonSystem):
    """Delays depth pictures; its output is right at multiples of the camera's period.

    Args:
        latency: s.
        period: of the camera, s.
    """

    def __init__(self, latency: float, period: float) -> None:
        super().__init__()
        self._picture = self.DeclareAbstractInputPort("depth_image", AbstractValue.Make(ImageDepth32F()))
        self._count = max(int(np.ceil(latency / period - 1e-9)), 1)
        offset = self._count * period - latency
        self._taken = self.DeclareAbstractState(held(()))
        # A latency of whole periods is off from them by rounding, which must not move the event before them.
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset if offset > 1e-9 else 0.0, self._take)
        self.DeclareAbstractOutputPort(
            "depth_image",
            lambda: AbstractValue.Make(ImageDepth32F()),
            self._late,
            {self.abstract_state_ticket(self._taken)},
        )

    def _take(self, context: Context, state: State) -> None:
        picture = self.EvalAbstractInput(context, self._picture.get_index())
        replace_held(state, self._taken, (*read(context, self._taken), picture.Clone())[-self._count :])

    def _late(self, context: Context, output: AbstractValue) -> None:
        taken = read(context, self._taken)
        output.SetFrom(taken[0] if len(taken) == self._count else AbstractValue.Make(ImageDepth32F()))


def add_hidden_effects(
    builder: DiagramBuilder, plant: MultibodyPlant, true_object: TrueObject, config: HiddenEffectsConfig
) -> HiddenEffects | None:
    """Connect the effects to a finalized plant; None, and no change, if none acts on the object."""
    if not config.is_forceful:
        return None
    system = builder.AddNamedSystem("hidden_effects", HiddenEffects(plant, true_object, config))
    connect_motion(builder, plant, system)
    builder.Connect(system.get_output_port(), plant.get_applied_spatial_force_input_port())
    return system
