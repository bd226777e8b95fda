"""Each effect in a case that can be solved by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pushed_with_effects import EFFECTS, block, coast_of, slide, steady_push
from scipy.integrate import quad

from slipmap.models.physics.rollout import Push

G = 9.81
MU, MASS = 0.3, 0.5
SQUARE = block(6, 6, 0.01)
AREA = 0.06**2
DOT = block(1, 1, 1e-3)


def test_viscous_coasting_decays_exponentially_beside_dry_friction() -> None:
    c, speed, mu = 1500.0, 0.8, 0.05
    times = np.array([0.05, 0.1, 0.2])
    out = slide(
        [EFFECTS["viscous_friction"]], [c],
        coast_of((speed, 0, 0), 0.2, 1e-4, times=times), grid=SQUARE, mass=MASS, mu=mu,
    )  # fmt: skip
    k = c * AREA / MASS
    fall = 1 - np.exp(-k * times)
    expected = (speed + mu * G / k) * fall / k - mu * G / k * times
    assert out.poses[0, :, 0] == pytest.approx(expected, rel=1e-3)
    assert out.end[0, 0, 3] == pytest.approx((speed + mu * G / k) * np.exp(-k * 0.2) - mu * G / k, rel=3e-3)


def test_viscous_drag_brakes_a_spin_by_the_second_moment_of_area() -> None:
    c, spin, mu = 1000.0, 30.0, 1e-6
    out = slide(
        [EFFECTS["viscous_friction"]], [c], coast_of((0, 0, spin), 0.3, 2e-4), grid=SQUARE, mass=MASS, mu=mu
    )
    # Drag and inertia have the same second moment if both are uniform.
    assert out.end[0, 0, 5] == pytest.approx(spin * np.exp(-c * AREA / MASS * 0.3), rel=3e-3)


@pytest.mark.parametrize("shape", [1.0, 2.0])
def test_stopping_distance_under_stribeck_friction(shape: float) -> None:
    excess, slow, speed = 0.8, 0.1, 0.4
    values = [excess, slow, shape]
    push = coast_of((speed, 0, 0), 0.4, 2e-4)
    out = slide([EFFECTS["stribeck_friction"]], values, push, grid=SQUARE, mu=MU)
    expected, _ = quad(lambda v: v / (MU * G * (1 + excess * np.exp(-((v / slow) ** shape)))), 0, speed)
    assert out.poses[0, -1, 0] == pytest.approx(expected, rel=2e-3)
    assert abs(out.end[0, 0, 3]) < 1e-4
    plain = speed**2 / (2 * MU * G)
    assert abs(expected / plain - 1) > 0.03


def steady_force(name: str, values: list[float], angle: float, **more: float) -> float:
    """Mean size of the finger's force in the second half of a steady push, N."""
    effects = [EFFECTS[name]] if name else []
    out = slide(effects, values, steady_push(angle, **more), grid=SQUARE, mass=MASS, mu=MU)
    return float(np.hypot(*out.forces[0, 250:].T).mean())


@pytest.mark.parametrize("name", ["anisotropic_table", "anisotropic_object"])
def test_forces_along_the_axes_of_a_grain(name: str) -> None:
    a = 0.2
    along, across = (steady_force(name, [a, 0.0], angle) for angle in (0.0, np.pi / 2))
    assert along / across == pytest.approx((1 + a) / (1 - a), rel=1e-4)
    assert along * across == pytest.approx((MU * MASS * G) ** 2, rel=1e-4)
    # With the object turned by a right angle, the table's grain stays and the object's turns.
    turned = steady_force(name, [a, 0.0], 0.0, yaw=np.pi / 2)
    assert turned == pytest.approx(along if name == "anisotropic_table" else across, rel=1e-6)


@pytest.mark.parametrize("name", ["anisotropic_table", "anisotropic_object"])
def test_diagonal_grain_drives_an_object_off_its_line(name: str) -> None:
    b = 0.1
    out = slide([EFFECTS[name]], [0.0, b], coast_of((1.0, 0, 0), 5e-4, 5e-5), grid=SQUARE, mu=MU)
    # Friction is -Q u / sqrt(u Q u): (q_xx, q_xy) for u along x.
    q_xx, q_xy = (1 + b**2) / (1 - b**2), 2 * b / (1 - b**2)
    change = out.end[0, 0, 3:5] - [1.0, 0.0]
    assert change == pytest.approx(-MU * G * 5e-4 / np.sqrt(q_xx) * np.array([q_xx, q_xy]), rel=2e-3)


def test_a_sliding_block_on_a_tilted_table() -> None:
    down, mu, start = 0.2, 0.05, 0.1
    out = slide([EFFECTS["table_tilt"]], [down, 0.0], coast_of((start, 0, 0), 0.3, 1e-3), grid=SQUARE, mu=mu)
    assert out.end[0, 0, 3] == pytest.approx(start + G * (down - mu) * 0.3, rel=1e-6)
    uphill = slide(
        [EFFECTS["table_tilt"]], [-down, 0.0], coast_of((1.0, 0, 0), 0.3, 1e-3), grid=SQUARE, mu=mu
    )
    assert uphill.end[0, 0, 3] == pytest.approx(1.0 - G * (down + mu) * 0.3, rel=1e-6)
    resting = slide([EFFECTS["table_tilt"]], [0.2, 0.1], coast_of((0, 0, 0), 0.3, 1e-3), grid=SQUARE, mu=MU)
    assert np.abs(resting.poses).max() < 1e-5


def braking(name: str, values: list[float], place: tuple[float, float]) -> float:
    """Friction coefficient on a dot that slides less than a millimetre at one place."""
    push = coast_of((0.3, 0, 0), 1e-3, 1e-4, start=(*place, 0.0))
    out = slide([EFFECTS[name]], values, push, grid=DOT, mu=MU)
    return float((0.3 - out.end[0, 0, 3]) / (1e-3 * G))


def test_patch_and_gradient_of_the_tables_friction() -> None:
    patch = [0.0, 0.0, 0.7, 0.1, 0.05, 0.08]
    name = "table_friction_field"
    assert braking(name, patch, (0.1, 0.05)) == pytest.approx(MU * np.exp(0.7), rel=1e-4)
    assert braking(name, patch, (0.3, 0.05)) == pytest.approx(MU, rel=1e-4)
    on_the_border = braking(name, patch, (0.1 - 0.00015, 0.05 + 0.08))
    assert on_the_border == pytest.approx(MU * np.exp(0.35), rel=0.01)
    gradient = [2.0, -1.0, 0.0, 0.0, 0.0, 0.1]
    assert braking(name, gradient, (0.1, 0.05)) == pytest.approx(MU * 1.15, rel=1e-3)
    assert braking(name, gradient, (-0.2, 0.1)) == pytest.approx(MU * 0.5, rel=1e-3)
    elsewhere = [2.0, -1.0, 0.0, 0.8, -0.3, 0.1]
    assert braking(name, elsewhere, (0.9, -0.25)) == pytest.approx(MU * 1.15, rel=1e-3)
    assert EFFECTS[name].level(np.array([0.9, -0.25]), np.array([elsewhere])) == pytest.approx(1.15, rel=1e-3)
    assert 0 < braking(name, gradient, (-0.9, 0.1)) < 0.02 * MU


def test_energy_of_a_tether() -> None:
    stiffness, slack, speed = 40.0, 0.1, 0.9
    push = coast_of((speed, 0, 0), 0.15, 1e-4, start=(0.05, 0.0, 0.0))
    values = [stiffness, 0.0, 0.0, slack, 0.0, 0.0]
    out = slide([EFFECTS["tether"]], values, push, grid=SQUARE, mass=MASS, mu=0.05)
    far, v = out.end[0, 0, 0], out.end[0, 0, 3]
    assert far > slack + 0.04
    spring = 0.5 * stiffness * (far - slack) ** 2
    lost = MASS * 0.05 * G * (far - 0.05)
    assert spring > 0.3 * MASS * speed**2 / 2
    assert 0.5 * MASS * v**2 + spring + lost == pytest.approx(0.5 * MASS * speed**2, rel=4e-3)
    slow = slide([], [], push, grid=SQUARE, mass=MASS, mu=0.05)
    assert slow.end[0, 0, 0] - far > 0.005


def test_a_slack_tether_pulls_little_and_one_beyond_pulls_towards_its_anchor() -> None:
    name, values = "tether", [100.0, 0.3, 0.4, 0.2, 0.0, 0.0]
    body = SimpleNamespace(x=0.0, y=0.0, cos=0.8, sin=0.6)
    p = SimpleNamespace(**dict(zip([q.name for q in EFFECTS[name].parameters], values, strict=True)))
    fx, fy, torque = (float(value) for value in EFFECTS[name].force(body, p))
    assert (fx, fy, torque) == pytest.approx((100 * 0.3 * 0.6, 100 * 0.3 * 0.8, 0), rel=1e-3)
    near = SimpleNamespace(x=0.3, y=0.3, cos=0.8, sin=0.6)
    assert np.hypot(*(float(f) for f in EFFECTS[name].force(near, p)[:2])) < 0.01 * np.hypot(fx, fy)
    # Tied at a point that the turned object carries to (0.08, 0.06), it pulls there, and turns the object.
    p.point_x, p.point_y = 0.1, 0.0
    gx, gy, turn = (float(value) for value in EFFECTS[name].force(body, p))
    away = np.array([0.3 - 0.08, 0.4 - 0.06])
    pull = 100 * (np.hypot(*away) - 0.2) / np.hypot(*away) * away
    assert (gx, gy) == pytest.approx(tuple(pull), rel=1e-3)
    assert turn == pytest.approx(0.08 * pull[1] - 0.06 * pull[0], rel=1e-3)


def test_latency_shifts_poses_in_time() -> None:
    times = np.linspace(0.013, 0.293, 15)
    late = 0.0707
    early = slide([], [], coast_of((1.2, 0.3, 6.0), 0.3, 1e-3, times=times), grid=SQUARE)
    shifted = coast_of((1.2, 0.3, 6.0), 0.5, 1e-3, times=times + late)
    out = slide([EFFECTS["sensor_latency"]], [late], shifted, grid=SQUARE)
    assert out.poses == pytest.approx(early.poses, abs=1e-12)
    before = slide(
        [EFFECTS["sensor_latency"]], [0.2], coast_of((1, 0, 0), 0.3, 1e-3, times=times), grid=SQUARE
    )
    assert np.all(before.poses[0, times < 0.2] == 0)


def test_geometry_of_a_tracked_frame_that_is_off() -> None:
    x, y, angle = 0.01, -0.02, 0.3
    true = np.array([0.1, 0.2, 0.5])
    c, s = np.cos(0.5), np.sin(0.5)
    reported = true + np.array([c * x - s * y, s * x + c * y, angle])
    push = coast_of((1.0, 0.2, 8.0), 0.2, 1e-3, start=true)
    there = slide([], [], push, grid=SQUARE).poses[0]
    seen = slide([EFFECTS["tracker_offset"]], [x, y, angle],
                 coast_of((1.0, 0.2, 8.0), 0.2, 1e-3, start=reported), grid=SQUARE).poses[0]  # fmt: skip
    # The frames are rigidly joined: the transform is the same at every instant.
    cos, sin = np.cos(there[:, 2]), np.sin(there[:, 2])
    assert seen[:, 0] == pytest.approx(there[:, 0] + cos * x - sin * y, abs=1e-12)
    assert seen[:, 1] == pytest.approx(there[:, 1] + sin * x + cos * y, abs=1e-12)
    assert seen[:, 2] == pytest.approx(there[:, 2] + angle, abs=1e-12)
    longer = slide([EFFECTS["tracker_scale"]], [0.05],
                   coast_of((1.0, 0.2, 8.0), 0.2, 1e-3, start=true * [1.05, 1.05, 1]),
                   grid=SQUARE).poses[0]  # fmt: skip
    assert longer == pytest.approx(there * [1.05, 1.05, 1], abs=1e-12)


def test_a_finger_that_turns_turns_also_where_it_bends() -> None:
    still = steady_push(0.0)
    push = replace(still, tip_angle=4.0 * still.h * np.arange(len(still.tip)))
    stiff = slide([], [], push, grid=SQUARE)
    bent = slide([EFFECTS["finger_compliance"]], [1e-5], push, grid=SQUARE)
    assert bent.poses == pytest.approx(stiff.poses, abs=2e-4)
    assert np.abs(stiff.poses - slide([], [], still, grid=SQUARE).poses).max() > 3e-3


def test_a_tracker_shifted_and_turned_is_a_finger_in_another_frame() -> None:
    """Reported and true frames are rigidly joined at every instant."""
    x, y, angle = 0.01, -0.02, 0.3
    c, s = np.cos(angle), np.sin(angle)

    def seen(poses: np.ndarray) -> np.ndarray:
        return np.column_stack(
            [
                x + c * poses[:, 0] - s * poses[:, 1],
                y + s * poses[:, 0] + c * poses[:, 1],
                poses[:, 2] + angle,
            ]
        )

    push = steady_push(0.4, yaw=0.2)
    true = slide([], [], push, grid=SQUARE)
    elsewhere = Push(push.h, push.tip, seen(push.start_pose[None])[0], force_times=push.force_times)
    out = slide([EFFECTS["tracker_shift"]], [x, y, angle], elsewhere, grid=SQUARE)
    assert out.poses[0] == pytest.approx(seen(true.poses[0]), abs=1e-12)
    assert out.forces == pytest.approx(true.forces, abs=1e-9)


def test_a_tracker_shifted_in_the_world_is_a_finger_recorded_off_its_centre() -> None:
    push, off = steady_push(0.0), np.array([4e-3, -2e-3])
    true = slide([], [], push, grid=SQUARE)
    recorded = Push(push.h, push.tip + off, push.start_pose, force_times=push.force_times)
    out = slide([EFFECTS["tracker_shift"]], [*-off, 0.0], recorded, grid=SQUARE)
    # The finger's world is shifted by as much, and the tracker's report is shifted back.
    assert out.poses == pytest.approx(true.poses, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "values", "reported"),
    [
        ("force_frame", [np.pi / 2, 0.0], lambda fx, fy: (-fy, fx)),
        ("force_frame", [0.0, 1.0], lambda fx, fy: (fx, -fy)),
        ("force_frame", [np.pi, 1.0], lambda fx, fy: (-fx, fy)),
        ("force_frame", [np.pi / 2, 1.0], lambda fx, fy: (fy, fx)),
        ("force_bias", [0.3, -0.2], lambda fx, fy: (fx + 0.3, fy - 0.2)),
        ("force_gains", [0.1], lambda fx, fy: (1.1 * fx, 0.9 * fy)),
    ],
)
def test_a_force_sensor_reports_another_force_of_the_same_motion(name, values, reported) -> None:  # type: ignore[no-untyped-def]
    push = steady_push(0.7, yaw=0.1)
    true, out = slide([], [], push, grid=SQUARE), slide([EFFECTS[name]], values, push, grid=SQUARE)
    # Each is compiled by itself, so that on some processors they round differently.
    assert out.poses == pytest.approx(true.poses, rel=0.0, abs=1e-12)
    assert pytest.approx(np.array(reported(*true.forces[0].T)), abs=1e-12) == out.forces[0].T


def test_a_late_force_is_that_of_before() -> None:
    """A delay of whole steps shifts the forces, half a step more averages two; at first, the first holds."""
    push, steps = steady_push(0.7, yaw=0.1), 12
    true = slide([], [], push, grid=SQUARE).forces[0]
    late = slide([EFFECTS["force_latency"]], [steps * push.h], push, grid=SQUARE).forces[0]
    assert late[steps:] == pytest.approx(true[:-steps], abs=1e-9)
    assert late[:steps] == pytest.approx(np.tile(true[0], (steps, 1)), abs=1e-9)
    between = slide([EFFECTS["force_latency"]], [(steps + 0.5) * push.h], push, grid=SQUARE).forces[0]
    middle = 0.5 * (true[:-1] + true[1:])
    assert between[steps + 1 :] == pytest.approx(middle[:-steps], abs=1e-9)
    early = slide([EFFECTS["force_latency"]], [-steps * push.h], push, grid=SQUARE).forces[0]
    assert early[:-steps] == pytest.approx(true[steps:], abs=1e-9)


def test_drift_scales_the_force_by_the_order_of_the_push() -> None:
    plain = steady_force("", [], 0.0)
    assert plain == pytest.approx(MU * MASS * G, rel=1e-4)
    for order in (0, 5, 20):
        force = steady_force("friction_drift", [0.03], 0.0, order=order)
        assert force / plain == pytest.approx(np.exp(0.03 * order), rel=1e-5)


@pytest.mark.parametrize("h", [1e-3, 2e-3, 5e-3, 0.01])
def test_a_bending_finger_is_a_damped_spring_at_any_step(h: float) -> None:
    """After contact the object swings on the finger: m b'' + (τ b' + b)/C = friction, for the bend b."""
    compliance, speed = 2e-3, 0.05
    ends = h * np.arange(round(1.0 / h) + 1)
    tip = np.column_stack([speed * ends - 0.03 - 0.005, 0 * ends])
    push = Push(h, tip, np.zeros(3), force_times=ends[1:] - h / 2)
    out = slide([EFFECTS["finger_compliance"]], [compliance], push, grid=SQUARE, mass=MASS, mu=MU)
    behind, force = tip[1:, 0] + 0.005 + 0.03 - out.poses[0, :, 0], out.forces[0, :, 0]
    friction, settling = MU * MASS * G, 0.01
    # It starts to slide when spring and damper hold the friction, with b' = speed.
    rest, late = compliance * friction, settling * speed
    rate = 1 / np.sqrt(MASS * compliance)
    damping = 0.5 * settling * rate**2
    swing = np.sqrt(rate**2 - damping**2)
    shape = np.array([-late, (speed - damping * late) / swing])

    def bend_at(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bend and its rate."""
        turned = np.stack([np.cos(swing * time), np.sin(swing * time)])
        turning = swing * np.stack([-turned[1], turned[0]])
        fade = np.exp(-damping * time)
        return rest + fade * (shape @ turned), fade * (shape @ (turning - damping * turned))

    time = ends[1:] - (rest - late) / speed
    slides = time > 0.03
    bend, _ = bend_at(time[slides])
    assert np.ptp(bend) > 1e-3
    assert behind[slides] == pytest.approx(bend, abs=1e-4)
    # A step's force is that at its start: it changes the mean speed of the step before into that of the step.
    bend, turn = bend_at(time[slides] - h)
    assert force[slides] == pytest.approx((bend + settling * turn) / compliance, rel=0.05)
    assert force[-1] == pytest.approx(friction, rel=0.01)


def test_natural_frequency_of_a_loose_mass() -> None:
    share, rate, kick = 0.4, 20.0, 2.0
    h, steps = 2e-4, 10_000
    wrench = np.zeros((steps, 5))
    wrench[:50, 0] = kick
    push = Push(h, np.full((steps + 1, 2), np.nan), np.zeros(3), wrench=wrench)
    out = slide([EFFECTS["loose_mass"]], [share, rate, 0.0], push, grid=SQUARE, mass=MASS, mu=1e-7)
    speed = np.diff(out.poses[0, :, 0]) / h
    # Whatever swings inside, the total keeps the momentum of the kick.
    mean = kick * 50 * h / MASS
    swing = speed[60:] - mean
    rising = np.flatnonzero((swing[:-1] < 0) & (swing[1:] >= 0))
    period = h * np.diff(rising).mean()
    # Two bodies, (1 - s) m and s m, on a spring s m ω².
    assert len(rising) >= 5
    assert 2 * np.pi / period == pytest.approx(rate / np.sqrt(1 - share), rel=2e-3)
    assert speed[60 : 60 + round(3 * period / h)].mean() == pytest.approx(mean, rel=0.02)


@pytest.mark.parametrize(("direction", "sign"), [((1.0, 0.0), 1.0), ((0.0, 1.0), -1.0)])
def test_two_grains_along_one_axis_add_up_and_two_across_each_other_cancel(direction, sign) -> None:
    """Q has the determinant 1 and the sum of both deviations from a multiple of 1."""
    rho, mu, speed = 0.6, 0.3, 0.4
    names = ("anisotropic_table", "anisotropic_object")
    push = Push(
        2e-4, np.full((2501, 2), np.nan), np.zeros(3), start_twist=speed * np.array([*direction, 0.0])
    )
    out = slide([EFFECTS[name] for name in names], [rho, 0.0, rho, 0.0], push, grid=SQUARE, mass=MASS, mu=mu)
    deviation = 2 * 2 * rho / (1 - rho**2)
    friction = mu * np.sqrt(np.sqrt(1 + deviation**2) + sign * deviation)
    assert out.poses[0, -1, :2] @ direction == pytest.approx(speed**2 / (2 * friction * G), rel=5e-3)
    opposed = slide(
        [EFFECTS[name] for name in names], [rho, 0.0, -rho, 0.0], push, grid=SQUARE, mass=MASS, mu=mu
    )
    assert opposed.poses[0, -1, :2] @ direction == pytest.approx(speed**2 / (2 * mu * G), rel=5e-3)


@pytest.mark.parametrize("values", [(0.8, 60.0, 0.5), (0.9, 35.0, 0.5), (0.9, 120.0, 0.2), (0.3, 120.0, 2.0)])
def test_a_stiff_loose_mass_slides_alike_at_every_time_step(values) -> None:
    """Its spring swings faster than a step of a slow push can follow, and must create no energy."""
    ends = []
    for h in (0.001, 0.005, 0.01):
        steps = round(0.6 / h)
        push = Push(h, np.full((steps + 1, 2), np.nan), np.zeros(3), start_twist=np.array([0.3, 0.0, 1.0]))
        out = slide([EFFECTS["loose_mass"]], list(values), push, grid=SQUARE, mass=MASS, mu=0.03)
        ends.append(out.poses[0, -1, :2])
    assert 0.05 < ends[0][0] < 0.3**2 / (2 * 0.03 * G)
    np.testing.assert_allclose(ends[1:], [ends[0]] * 2, atol=2e-3)


@pytest.mark.parametrize("uneven", [0.0, 2.5])
@pytest.mark.parametrize("theta", [0.0, 0.7])
def test_moment_balance_of_load_transfer(theta: float, uneven: float) -> None:
    """The cells' loads carry the weight, and those of an even object balance the moment of a high force."""
    high, width = 0.02, 0.01
    force = np.array([0.4, -0.3])
    centers = SQUARE.centers
    mass = np.where(centers[:, 0] + centers[:, 1] > 0, 1.0 + uneven, 1.0)
    mass *= MASS / mass.sum()
    com = mass @ centers / MASS
    turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    spread = np.linalg.inv(np.cov(centers.T, bias=True) + np.eye(2) * width**2 / 12)
    body = {
        "force_x": (turn @ force)[0], "force_y": (turn @ force)[1], "mass": MASS, "weight": MASS * G,
        "com_x": (turn @ com)[0], "com_y": (turn @ com)[1], "gain_x": 0.0, "gain_y": 0.0,
        "downhill_x": 0.0, "downhill_y": 0.0, "cos": turn[0, 0], "sin": turn[1, 0],
        "spread_xx": spread[0, 0], "spread_xy": spread[0, 1], "spread_yy": spread[1, 1],
    }  # fmt: skip
    p = SimpleNamespace(push_height=high, mass_height=0.0)
    law = EFFECTS["load_transfer"].friction
    factors = np.array([float(law(SimpleNamespace(**body, rx=x, ry=y), p)) for x, y in centers])
    loads = mass * G * factors
    assert loads.sum() == pytest.approx(MASS * G, rel=1e-3)
    if not uneven:
        slope = np.linalg.lstsq(np.c_[centers, np.ones(len(centers))], factors)[0][:2]
        within_cells = MASS * G * width**2 / 12 * slope
        assert loads @ centers + within_cells == pytest.approx(high * force, rel=2e-3)


@pytest.mark.parametrize("high", [0.02, 0.06, 0.1, 0.15])
def test_the_weight_is_carried_even_where_cells_lift_off(high: float) -> None:
    """Pushing high above the table shifts the load; it does not make a uniform object heavier."""
    assert steady_force("load_transfer", [high, 0.0], 0.0) == pytest.approx(MU * MASS * G, rel=0.01)


@pytest.mark.parametrize("slope", [0.0, 0.1, -0.1])
def test_braking_presses_the_front_of_an_object_with_a_high_centre_of_mass(slope: float) -> None:
    """On a slope too: gravity pulls at the same height, so the moment is that of friction alone."""
    grid = SQUARE
    x = grid.centers[:, 0]
    rough = 0.3 + 5.0 * x
    high = 0.015
    push = coast_of((1.0, 0, 0), 0.1, 1e-4)
    effects = [EFFECTS["load_transfer"], EFFECTS["table_tilt"]]
    out = slide(effects, [0.0, high, slope, 0.0], push, grid=grid, mass=MASS, mu=rough)
    # a/g = Σ mu_i s_i / n with s = 1 + x (z a/g) / S_xx.
    second = (x**2).mean() + 0.01**2 / 12
    expected = 0.3 / (1 - high * (rough * x).mean() / second)
    assert (1.0 - out.end[0, 0, 3]) / (0.1 * G) + slope == pytest.approx(expected, rel=3e-3)
    assert expected > 0.32


def test_a_skate_resists_sideways_motion_alone() -> None:
    angle, resistance = 0.5, 0.4
    values = [resistance, angle, 0.0, 0.0]
    along = np.array([np.cos(angle), np.sin(angle)])
    for way, friction in ((along, MU), (np.array([-along[1], along[0]]), MU + resistance)):
        push = coast_of((*(1.0 * way), 0.0), 0.1, 1e-3)
        out = slide([EFFECTS["skate"]], values, push, grid=SQUARE, mu=MU)
        assert out.end[0, 0, 3:5] @ way == pytest.approx(1.0 - friction * G * 0.1, rel=1e-4)


def test_a_skate_off_the_centre_turns_the_object() -> None:
    values = [0.4, 0.0, 0.02, 0.0]
    out = slide(
        [EFFECTS["skate"]], values, coast_of((0.0, 1.0, 0.0), 5e-3, 1e-4), grid=SQUARE, mass=MASS, mu=1e-6
    )
    moment = MASS * (0.06**2 + 0.06**2) / 12
    torque = 0.02 * -0.4 * MASS * G
    # At first the point moves sideways like the object.
    inertia_of_cells = MASS * ((SQUARE.centers**2).sum(axis=1).mean() + 0.01**2 / 6)
    assert inertia_of_cells == pytest.approx(moment, rel=1e-9)
    assert out.end[0, 0, 5] == pytest.approx(torque / moment * 5e-3, rel=0.01)
