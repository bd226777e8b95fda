"""The simulated world against formulas, and against Newton's equations integrated by another method."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from scipy.integrate import solve_ivp

from slipmap.diagrams.application.studies.blind.objects import (
    GRAVITY,
    KINDS,
    FingerPath,
    PushPlan,
    SlidingObject,
    random_object,
    random_plan,
)
from slipmap.diagrams.application.studies.blind.secret_effects import (
    Effect,
    anisotropic_table,
    finger_compliance,
    friction_drift,
    gusts,
    linear_friction_field,
    loose_mass,
    moving_table,
    patch_friction_field,
    sensor_latency,
    shifted_loads,
    skate,
    stribeck_friction,
    table_tilt,
    tether,
    tracker_offset,
    tracker_scale,
    viscous_friction,
)
from slipmap.diagrams.application.studies.blind.world import World

MU, MASS, WIDTH = 0.3, 0.8, 0.02


def block(columns=5, rows=5, mu_finger=0.3):
    """A uniform rectangle, its middle at the origin."""
    cells = np.array([(i, j) for i in range(columns) for j in range(rows)])
    n = len(cells)
    origin = -0.5 * WIDTH * np.array([columns, rows])
    return SlidingObject(
        "block", cells, WIDTH, origin, np.full(n, MASS / n), np.full(n, MU), mu_finger, 0.006, 0.05
    )


def disc(across=31, radius=0.06):
    """A disc of many small cells; width and radius are such that their area is the disc's."""
    width = 2 * radius / across
    index = np.arange(across) - (across - 1) / 2
    cells = np.array(
        [(i, j) for i in range(across) for j in range(across) if np.hypot(index[i], index[j]) < across / 2]
    )
    n = len(cells)
    width *= np.sqrt(np.pi * radius**2 / (n * width**2))
    origin = -0.5 * width * np.array([across, across])
    return SlidingObject("disc", cells, width, origin, np.full(n, MASS / n), np.full(n, MU), 0.3, 0.006, 0.05)


def straight(speed, duration, start=(-0.058, 0.0)):
    path = FingerPath(np.array(start), 0.0, 0.0, np.array([0.0, duration + 1]), np.array([speed, speed]))
    return PushPlan("medium", "moving", duration, np.zeros(3), path)


def coasted(effect, velocity, duration=0.4, thing=None, step=5e-4):
    """The object slides freely, with the finger far away."""
    far = np.full((int(np.ceil(duration / step)) + 2, 2), 50.0)
    world = World(thing or block(), effect, step=step)
    return world._run(np.zeros(3), np.asarray(velocity, dtype=float), far, 0, 1)


def test_a_sliding_block_stops_after_v2_over_2_mu_g():
    motion = coasted(Effect(), [0.8, 0.0, 0.0])
    assert motion.poses[-1, 0] == pytest.approx(0.8**2 / (2 * MU * GRAVITY), abs=3e-4)
    np.testing.assert_allclose(motion.poses[-1, 1:], 0.0, atol=1e-9)
    assert np.ptp(motion.poses[-50:], axis=0).max() < 1e-7  # it rests, and does not creep


def test_a_spinning_disc_is_braked_by_two_thirds_mu_m_g_r():
    thing = disc()
    omega = 8.0
    brake = 2 / 3 * MU * MASS * GRAVITY * 0.06 / thing.inertia
    assert thing.inertia == pytest.approx(0.5 * MASS * 0.06**2, rel=0.01)
    motion = coasted(Effect(), [0.0, 0.0, omega], thing=thing)
    assert motion.poses[-1, 2] == pytest.approx(omega**2 / (2 * brake), rel=0.01)
    np.testing.assert_allclose(motion.poses[-1, :2], 0.0, atol=2e-5)


def test_sliding_and_turning_agree_with_an_adaptive_integration_of_exact_coulomb_friction():
    thing = random_object(np.random.default_rng(5))
    points, cell, share = thing.quadrature(0.0015)
    load = thing.mass[cell] * GRAVITY * thing.mu[cell] / share
    middle = thing.center_of_mass
    arms = points - middle
    inertia = thing.inertia - thing.total_mass * middle @ middle
    start = np.array([0.4, -0.2, 7.0])

    def rate(_, state):
        c, s = np.cos(state[2]), np.sin(state[2])
        arm = arms @ np.array([[c, s], [-s, c]])
        velocity = state[3:5] + state[5] * np.column_stack([-arm[:, 1], arm[:, 0]])
        force = -load[:, None] * velocity / np.linalg.norm(velocity, axis=1)[:, None]
        moment = np.sum(arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0])
        return [*state[3:], *(force.sum(axis=0) / thing.total_mass), moment / inertia]

    v = start[:2] + start[2] * np.array([-middle[1], middle[0]])
    moving = 0.06  # s
    motion = coasted(Effect(), start, moving, thing, step=1e-4)
    span = (0, motion.clock[-1])
    end = solve_ivp(rate, span, [*middle, 0.0, *v, start[2]], rtol=1e-8, atol=1e-10).y[:3, -1]
    x, y, angle = motion.poses[-1]
    c, s = np.cos(angle), np.sin(angle)
    assert angle == pytest.approx(end[2], abs=2e-3)
    np.testing.assert_allclose([x, y] + np.array([[c, -s], [s, c]]) @ middle, end[:2], atol=6e-5)


def test_a_push_through_the_middle_goes_straight_at_the_force_of_friction():
    motion = World(block(), Effect()).push(straight(0.05, 1.0))
    pushed = 0.05 * motion.clock[-1] - 0.002
    np.testing.assert_allclose(motion.poses[-1], [pushed, 0.0, 0.0], atol=2e-4)
    last = np.diff(motion.impulse[-400:], axis=0) / (motion.clock[1] - motion.clock[0])
    np.testing.assert_allclose(last.mean(axis=0), [MU * MASS * GRAVITY, 0.0, 0.0], atol=5e-3)


def test_the_finger_goes_where_it_is_told_and_slides_along_a_side_with_its_own_friction():
    plan = straight(0.05, 1.0)
    turned = replace(plan, path=replace(plan.path, heading=0.6))
    motion = World(block(mu_finger=0.2), Effect()).push(turned)
    np.testing.assert_allclose(motion.hand, turned.path.positions(motion.clock), atol=1e-6)
    force = np.diff(motion.impulse, axis=0) / 5e-4
    touching = (force[:, 0] > 0.1) & (motion.clock[1:] > 0.07)  # after the first touch
    c, s = np.cos(motion.poses[:-1, 2]), np.sin(motion.poses[:-1, 2])
    normal, along = c * force[:, 0] + s * force[:, 1], c * force[:, 1] - s * force[:, 0]
    assert np.abs(along[touching] / normal[touching]).max() == pytest.approx(0.2, abs=1e-3)
    # The torque about the finger's axis is that of a force along its skin.
    np.testing.assert_allclose(force[touching, 2], along[touching] * 0.006, atol=2e-4)


def test_halving_the_step_moves_no_push_by_more_than_a_twentieth_of_a_millimetre():
    rng = np.random.default_rng(11)
    thing = random_object(rng)
    for kind in ("fast", "medium"):
        plan = random_plan(rng, thing, kind)
        ends = [World(thing, Effect(), step=h).push(plan).poses[-1] for h in (5e-4, 2.5e-4)]
        np.testing.assert_allclose(ends[0][:2], ends[1][:2], atol=5e-5)
        assert ends[0][2] == pytest.approx(ends[1][2], abs=1e-3)


def test_tilt_changes_the_way_to_rest_by_its_part_of_gravity_and_holds_at_rest():
    tilt = 0.1
    down = coasted(table_tilt(tilt, 0.0), [0.5, 0.0, 0.0])
    braking = GRAVITY * (MU * np.cos(tilt) - np.sin(tilt))
    assert down.poses[-1, 0] == pytest.approx(0.5**2 / (2 * braking), abs=3e-4)
    across = coasted(table_tilt(0.4, np.pi / 2), [0.0, 0.0, 0.0], 0.2)  # steeper than friction holds
    falling = GRAVITY * (np.sin(0.4) - MU * np.cos(0.4))
    acceleration = 2 * np.polyfit(across.clock[20:], across.poses[20:, 1], 2)[0]
    assert acceleration == pytest.approx(falling, rel=1e-3)
    assert np.abs(coasted(table_tilt(0.2, 1.0), [0, 0, 0]).poses[-1]).max() < 2e-5


def test_drag_brakes_exponentially_beside_friction():
    thing = block()
    effect = viscous_friction(400.0)
    rate = 400.0 * thing.area / MASS
    # v' = -μ g - rate v from v0
    v0, level = 0.6, MU * GRAVITY / rate
    rest = np.log(1 + v0 / level) / rate
    way = (v0 + level) * (1 - np.exp(-rate * rest)) / rate - level * rest
    assert coasted(effect, [v0, 0, 0]).poses[-1, 0] == pytest.approx(way, abs=3e-4)


def test_an_anisotropic_table_brakes_each_way_by_its_own_friction():
    effect = anisotropic_table(along=0.8, across=1.3, angle=np.pi / 2)
    for direction, factor in (((0.6, 0.0), 1.3), ((0.0, 0.6), 0.8)):
        motion = coasted(effect, [*direction, 0.0])
        assert np.hypot(*motion.poses[-1, :2]) == pytest.approx(
            0.6**2 / (2 * factor * MU * GRAVITY), abs=3e-4
        )


def test_a_blade_resists_sideways_motion_and_turns_the_object_about_itself():
    along = coasted(skate((0.0, 0.0), 0.0, 1.0), [0.6, 0, 0])
    assert along.poses[-1, 0] == pytest.approx(0.6**2 / (2 * MU * GRAVITY), abs=3e-4)
    across = coasted(skate((0.0, 0.0), np.pi / 2, 1.0), [0.6, 0, 0])
    assert across.poses[-1, 0] == pytest.approx(0.6**2 / (2 * (MU * GRAVITY + 1.0 / MASS)), abs=3e-4)
    ahead = coasted(skate((0.04, 0.0), 0.0, 1.0), [0.0, 0.6, 0])  # the front is held back
    assert ahead.poses[-1, 2] < -0.02


def test_friction_that_depends_on_place_and_on_the_push():
    linear = linear_friction_field(gradient=(4.0, 0.0), center=(0.0, 0.0))
    # Energy: μ g (x + 2 x²) = v² / 2 with the middle of a block that does not turn.
    way = (-1 + np.sqrt(1 + 4 * 2 * 0.6**2 / (2 * MU * GRAVITY))) / 4
    assert coasted(linear, [0.6, 0, 0]).poses[-1, 0] == pytest.approx(way, abs=3e-4)
    inside = patch_friction_field(center=(0.05, 0.0), radius=0.3, edge=0.006, factor=2.0)
    assert coasted(inside, [0.6, 0, 0]).poses[-1, 0] == pytest.approx(0.6**2 / (4 * MU * GRAVITY), abs=3e-4)
    world = World(block(), friction_drift(change=0.5))
    ends = []
    for index in (0, 2):
        motion = world.push(straight(0.05, 0.6), index=index, count=3)
        ends.append(np.diff(motion.impulse[-300:, 0]).mean() / 5e-4)
    np.testing.assert_allclose(ends, MU * MASS * GRAVITY * np.array([0.75, 1.25]), rtol=5e-3)


def test_stribeck_friction_takes_the_force_that_its_law_says():
    motion = World(block(), stribeck_friction(static=1.6, speed=0.05)).push(straight(0.04, 0.8))
    force = np.diff(motion.impulse[-300:, 0]).mean() / 5e-4
    assert force == pytest.approx(MU * MASS * GRAVITY * (1 + 0.6 * np.exp(-0.04 / 0.05)), rel=5e-3)


@pytest.mark.parametrize("lever", [0.01, 0.03])
def test_a_moment_shifts_load_as_on_an_elastic_table(lever):
    """A uniform bar of half length L under a moment of its weight times `lever`: at L/3 one end lifts off."""
    half, weight = 0.05, 4.0
    x = np.linspace(-half, half, 2001)
    points = np.array([(a, b) for a in x for b in (-0.01, 0.01)])
    loads = np.full(len(points), weight / len(points))
    pressed = shifted_loads(loads, points, np.array([weight * lever, 0.0]), np.zeros(3))
    across = 1.0 + 3.0 * lever * points[:, 0] / half**2
    contact = 3.0 * (half - lever)
    lifted = np.maximum(2.0 * (points[:, 0] - half + contact) / contact, 0.0) * 2.0 * half / contact
    expected = across if lever < half / 3 else lifted
    assert pressed / loads == pytest.approx(expected, abs=5e-3)
    assert pressed @ points[:, 0] == pytest.approx(weight * lever, rel=1e-6)


def test_a_tether_a_belt_and_gusts_move_what_friction_does_not_hold():
    held = coasted(tether(anchor=(0.3, 0.0), stiffness=5.0, slack=0.1), [0, 0, 0])
    assert np.abs(held.poses[-1]).max() < 2e-5
    caught = tether(anchor=(-0.3, 0.0), stiffness=5.0, slack=0.3)
    # Energy: μ m g x + k x² / 2 = m v² / 2
    a, b = 2.5, MU * MASS * GRAVITY
    way = (-b + np.sqrt(b**2 + 4 * a * 0.5 * MASS * 0.6**2)) / (2 * a)
    assert coasted(caught, [0.6, 0, 0]).poses[:, 0].max() == pytest.approx(way, abs=3e-4)
    belt = coasted(moving_table((0.0, 0.05)), [0, 0, 0])
    drawn_in = 0.05**2 / (2 * MU * GRAVITY)
    assert belt.poses[-1, 1] == pytest.approx(0.05 * belt.clock[-1] - drawn_in, abs=1e-4)
    strong, mild = (gusts(size, 0.0, period=0.8, phases=(0.0,)) for size in (2 * MU * MASS * GRAVITY, 1.0))
    assert coasted(strong, [0, 0, 0]).poses[-1, 0] > 0.01
    assert np.abs(coasted(mild, [0, 0, 0]).poses[-1]).max() < 2e-5


def test_a_compliant_finger_lags_by_force_times_compliance():
    stiff, soft = (
        World(block(), effect).push(straight(0.05, 1.0)) for effect in (Effect(), finger_compliance(2e-3))
    )
    lag = stiff.poses[-1, 0] - soft.poses[-1, 0]
    assert lag == pytest.approx(2e-3 * MU * MASS * GRAVITY, rel=0.02)
    np.testing.assert_allclose(soft.hand, stiff.hand, atol=1e-6)


def test_a_loose_mass_swings_at_its_frequency_while_the_object_rests():
    effect = loose_mass(share=0.5, frequency=3.0, damping_ratio=0.0, place=(0.0, 0.0), mass=0.5 * MASS)
    stopped = straight(0.05, 1.6)
    stopped = replace(
        stopped,
        path=replace(
            stopped.path, times=np.array([0, 0.01, 0.5, 0.51, 3]), speeds=np.array([0, 0.2, 0.2, 0, 0])
        ),
    )
    plain, loose = (World(block(), e).push(stopped) for e in (Effect(), effect))
    assert np.abs(plain.poses[-1, 0] - loose.poses[-1, 0]) > 2e-4
    force = np.diff(loose.impulse[:, 0]) / 5e-4
    first = np.flatnonzero(loose.clock[:-1] > 0.05)[0]
    swing = force[first : first + 667].mean()  # over one period the springs' mean is the weight's friction
    assert swing == pytest.approx(MU * MASS * GRAVITY, rel=0.1)


def test_sensors_change_the_record_alone():
    clock = np.linspace(0, 1, 101)
    poses = np.column_stack([clock, 2 * clock, np.full(101, np.pi / 2)])
    t = np.array([0.005, 0.5, 1.0])
    np.testing.assert_allclose(
        sensor_latency(0.1).reported(t, clock, poses)[:, 0], [0.0, 0.4, 0.9], atol=1e-12
    )
    np.testing.assert_allclose(tracker_scale(1.1).reported(t, clock, poses)[1], [0.55, 1.1, np.pi / 2])
    np.testing.assert_allclose(tracker_offset(0.01, 0.0).reported(t, clock, poses)[1], [0.5, 1.01, np.pi / 2])


def test_random_objects_are_whole_and_every_side_lies_on_a_rectangle():
    shapes = set()
    for seed in range(40):
        thing = random_object(np.random.default_rng(seed))
        shapes.add(thing.shape)
        assert 20 <= len(thing.cells) <= 60
        assert thing.footprint.geom_type == "Polygon" and not thing.footprint.interiors
        assert thing.footprint.area == pytest.approx(thing.area, rel=1e-6)
        assert 0.3 - 1e-9 <= thing.total_mass <= 2.0 + 1e-9
        boxes = [
            shapely.box(*(center - size / 2), *(center + size / 2)) for center, size in thing.rectangles()
        ]
        cover = shapely.union_all(boxes)
        assert cover.symmetric_difference(thing.footprint).area < 1e-8
        for start, end in zip(thing.outline, np.roll(thing.outline, -1, axis=0), strict=True):
            side = shapely.LineString([start, end])
            assert any(box.exterior.buffer(1e-7).contains(side) for box in boxes), (thing.shape, seed)
    assert len(shapes) >= 7


def test_random_pushes_begin_free_of_the_object_and_stay_on_the_table():
    rng = np.random.default_rng(3)
    thing = random_object(rng)
    for kind in KINDS:
        plan = random_plan(rng, thing, kind)
        assert 1.2 < plan.duration < 4.2
        c, s = np.cos(plan.pose[2]), np.sin(plan.pose[2])
        local = (plan.path.start - plan.pose[:2]) @ np.array([[c, -s], [s, c]])
        assert 0 < shapely.Point(local).distance(thing.footprint) - thing.finger_radius < 0.02
        fine = plan.path.positions(np.linspace(0, plan.duration, 2000))
        assert np.abs(fine).max() < 0.5
        speed = np.linalg.norm(np.diff(fine, axis=0), axis=1) / (plan.duration / 1999)
        assert speed.max() == pytest.approx(plan.path.speeds.max(), rel=0.02)
