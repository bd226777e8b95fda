"""The finger's contact: the gap against Shapely, the force in Coulomb's cone, corners, depth and release."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from sliding_objects import (
    FINGER_RADIUS,
    GRAVITY,
    finger_push,
    gaps_along,
    l_shape,
    line,
    random_maps,
    rectangle,
    rotation,
    signed_distances,
    star,
    to_object,
    touched_point,
    twists_between,
    with_start,
)

from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.compiled import compiled
from slipmap.models.physics.contact import CONTACT_COLUMNS, MAX_CONTACTS, find_contacts
from slipmap.models.physics.rollout import Maps, Push, Slider, Smoothing

ONE_CELL = np.zeros((1, 2))


@compiled()
def gap(points, radius, edges):
    """(k,) gaps between discs at points (k, 2) and the outline, m, negative where they overlap."""
    result, contacts = np.empty(len(points)), np.empty((MAX_CONTACTS, CONTACT_COLUMNS))
    for k in range(len(points)):
        find_contacts(points[k, 0], points[k, 1], radius, np.inf, edges, contacts)
        result[k] = contacts[0, 4]
    return result


@st.composite
def outlines(draw: st.DrawFn) -> CellGrid:
    """Star-shaped outlines of 3 to 12 corners, mostly with concave ones, every other with a concave hole."""
    middle, exterior = star(draw, 12, 0.03)
    # All of a star is visible from its centre, so a smaller copy lies inside.
    holes = (middle + 0.3 * (exterior - middle),) if draw(st.booleans()) else ()
    return CellGrid(ONE_CELL, 0.01, exterior, holes)


@st.composite
def places(draw: st.DrawFn) -> tuple[CellGrid, np.ndarray]:
    """An outline and points all around it, half of them close to an edge or next to a corner."""
    grid = draw(outlines())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    corners = grid.edges[:, :2]
    along = rng.uniform(0, 1, (len(corners), 1))
    on_edges = corners + along * (grid.edges[:, 2:] - corners)
    near = np.concatenate([corners, on_edges])
    near = near + rng.normal(0, 0.004, near.shape)
    return grid, np.concatenate([near, rng.uniform(-0.15, 0.15, (20, 2))])


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(places())
def test_gap_outside_is_the_distance_less_the_radius(place: tuple[CellGrid, np.ndarray]) -> None:
    grid, points = place
    expected = signed_distances(grid, points)
    outside = expected > 1e-6
    assert gap(points[outside], FINGER_RADIUS, grid.edges) == pytest.approx(
        expected[outside] - FINGER_RADIUS, abs=1e-12
    )


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(places())
def test_gap_inside_is_the_negative_distance_less_the_radius(place: tuple[CellGrid, np.ndarray]) -> None:
    grid, points = place
    expected = signed_distances(grid, points)
    inside = expected < -1e-6
    assert gap(points[inside], FINGER_RADIUS, grid.edges) == pytest.approx(
        expected[inside] - FINGER_RADIUS, abs=1e-12
    )


def test_gap_at_a_corner_that_is_listed_twice() -> None:
    exterior = np.array([[-0.05, -0.03], [0.05, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.05, 0.03]])
    grid = CellGrid(ONE_CELL, 0.01, exterior)
    point = np.array([[0.053, -0.034]])
    assert gap(point, FINGER_RADIUS, grid.edges) == pytest.approx([0.0], abs=1e-12)


def test_gap_level_with_a_corner_that_rounding_has_shifted() -> None:
    # A regular polygon computed with sine and cosine: its leftmost corner is at y = 6e-18 m, not at 0.
    angles = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    grid = CellGrid(ONE_CELL, 0.01, 0.05 * np.column_stack([np.cos(angles), np.sin(angles)]))
    levels = grid.exterior[60, 1] * np.linspace(-0.1, 1.1, 121)
    points = np.column_stack([np.full_like(levels, -0.08), levels])
    assert gap(points, FINGER_RADIUS, grid.edges) == pytest.approx(0.03 - FINGER_RADIUS, abs=1e-12)


def test_a_push_on_a_corner_that_rounding_has_shifted_goes_straight() -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    disc = cells_from_polygon(0.05 * np.column_stack([np.cos(angles), np.sin(angles)]), count=60)
    maps = Maps(np.full(len(disc), 0.01), np.full(len(disc), 0.4), np.array([0.5]))
    end = 0.02 + FINGER_RADIUS + 0.05  # where the finger leaves the centre
    for h in (0.002, 0.005, 0.01):
        tip = line((-0.08, 0.0), (0.02, 0.0), 5.0, h)
        (pose,) = Slider(disc, FINGER_RADIUS).rollout(maps, [finger_push(tip, h)]).end[:, 0, :3]
        assert pose == pytest.approx([end, 0.0, 0.0], abs=1e-4)


def test_gap_before_a_corner_in_a_straight_side() -> None:
    side = np.array([[-0.05, -0.03], [0, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.05, 0.03]])
    for angle in np.linspace(0.01, 6.0, 100):
        grid = CellGrid(ONE_CELL, 0.01, side @ rotation(angle).T)
        outwards = rotation(angle) @ (0, -1)
        points = grid.exterior[1] + np.linspace(0.004, 0.006, 20)[:, None] * outwards
        # One at a time, so that no earlier answer can stand in for a missing one.
        for point, distance in zip(points, np.linspace(0.004, 0.006, 20), strict=True):
            far_then_here = gap(np.array([[1.0, 1.0], point]), FINGER_RADIUS, grid.edges)
            assert far_then_here[1] == pytest.approx(distance - FINGER_RADIUS, abs=1e-9)


def test_a_push_on_a_corner_in_a_straight_side_holds_contact() -> None:
    h = 0.01
    block = rectangle(10, 6)
    side = np.vstack([block.exterior, [-0.05, 0.0]])
    maps = Maps(np.full(60, 0.01), np.full(60, 0.4), np.array([0.5]))
    for angle in np.linspace(0.05, 5.95, 60):
        turned = rotation(angle).T
        grid = CellGrid(block.centers @ turned, block.width, side @ turned)
        heading = rotation(angle)[:, 0]
        tip = line((-0.05 - FINGER_RADIUS) * heading, 0.05 * heading, 0.5, h)
        forces = Slider(grid, FINGER_RADIUS).rollout(maps, [finger_push(tip, h)]).forces[0]
        # Steady translation: the push balances the friction of the whole object.
        expected = np.tile(0.6 * 0.4 * GRAVITY * heading, (40, 1))
        assert forces[10:] == pytest.approx(expected, rel=0.02, abs=0.02)


def test_a_force_does_not_drive_the_object_into_the_finger() -> None:
    h = 0.02
    grid = rectangle(10, 6)
    maps = Maps(np.full(60, 0.01), np.full(60, 0.4), np.array([0.3]))
    tip = np.tile([0.05 + FINGER_RADIUS + 0.0015, 0.0], (11, 1))
    push = finger_push(tip, h, wrench=np.tile([6.0, 0, 0, 0, 0], (10, 1)))
    out = Slider(grid, FINGER_RADIUS).rollout(maps, [push])
    assert gaps_along(grid, out.poses[0], tip[1:], FINGER_RADIUS).min() > -1e-4


def contact_forces(slider: Slider, maps: Maps, push: Push) -> tuple[np.ndarray, np.ndarray]:
    """Force along the inward normal and across it at the middle of each step (k, 2), the finger's slip (k,).

    The slip is that of the finger's surface against the touched point, along the second force.
    """
    out = slider.rollout(maps, [push])
    poses = with_start(out.poses[0], push)
    twists = twists_between(poses, push.h)
    forces, slips = np.empty((len(twists), 2)), np.empty(len(twists))
    for k, (twist, force) in enumerate(zip(twists, out.forces[0], strict=True)):
        pose = 0.5 * (poses[k] + poses[k + 1])
        tip = 0.5 * (push.tip[k] + push.tip[k + 1])
        contact, normal = touched_point(slider.grid, to_object(tip, pose))
        tangent = np.array([-normal[1], normal[0]])
        local = rotation(pose[2]).T @ force
        finger = rotation(pose[2]).T @ (push.tip[k + 1] - push.tip[k]) / push.h
        if push.tip_angle is not None:
            spin = (push.tip_angle[k + 1] - push.tip_angle[k]) / push.h
            finger = finger + spin * FINGER_RADIUS * np.array([normal[1], -normal[0]])
        surface = twist[:2] + twist[2] * np.array([-contact[1], contact[0]])
        forces[k] = -local @ normal, local @ tangent
        slips[k] = (finger - surface) @ tangent
    return forces, slips


# Pushes of a 10 cm x 6 cm rectangle from its left side: height of the finger, angle of its path, friction,
# and spin of the finger, rad/s.
SCENES = [
    pytest.param(0.0, 0.0, 0.3, 0.0, id="centre"),
    pytest.param(0.015, 0.6, 0.1, 0.0, id="slides"),
    pytest.param(0.015, 0.6, 1.0, 0.0, id="sticks"),
    pytest.param(0.02, 0.8, 0.2, 0.0, id="slides off the corner"),
    pytest.param(0.033, -0.2, 0.3, 0.0, id="on the corner"),
    pytest.param(-0.02, 0.6, 0.0, 0.0, id="without friction"),
    pytest.param(0.0, 0.0, 0.2, -5.0, id="turns and slides"),
    pytest.param(0.0, 0.0, 1.0, 3.0, id="turns and rolls"),
]


@pytest.mark.parametrize(("height", "angle", "mu", "spin"), SCENES)
def test_contact_force_stays_in_the_cone_and_opposes_slip(
    height: float, angle: float, mu: float, spin: float
) -> None:
    h = 2e-3
    grid = rectangle(10, 6)
    maps = random_maps(np.random.default_rng(5), 60, mu_finger=mu)
    start = (-0.05 - FINGER_RADIUS - 1e-4, height)
    tip = line(start, 0.05 * np.array([np.cos(angle), np.sin(angle)]), 1.5, h)
    turned = spin * h * np.arange(len(tip)) if spin else None
    push = finger_push(tip, h, tip_angle=turned)
    forces, slips = contact_forces(Slider(grid, FINGER_RADIUS), maps, push)
    normal, tangential = forces.T
    touching = normal > 0
    assert touching.sum() > 100
    assert np.all(normal >= 0)
    # The normal at mid-step differs from the one that the step used by its prediction error.
    assert np.all(np.abs(tangential) <= (mu + 1e-3) * normal + 1e-9)
    assert np.all(forces[~touching] == 0)
    # Friction on the object points along the finger's slip, up to creep and the same error.
    assert np.all(tangential * slips >= -1e-4 * np.abs(tangential) - 1e-3 * normal * np.abs(slips))
    slipping = touching & (np.abs(slips) > 1e-3)
    assert np.all(np.abs(np.abs(tangential) - mu * normal)[slipping] <= 2e-3 * normal[slipping])


def test_scenes_of_the_cone_hold_sticking_and_slipping() -> None:
    h = 2e-3
    grid = rectangle(10, 6)
    for mu, sticks in ((0.1, False), (1.0, True)):
        maps = random_maps(np.random.default_rng(5), 60, mu_finger=mu)
        tip = line((-0.05 - FINGER_RADIUS, 0.015), 0.05 * rotation(0.6)[:, 0], 0.5, h)
        _, slips = contact_forces(Slider(grid, FINGER_RADIUS), maps, finger_push(tip, h))
        assert (np.abs(slips[50:]).max() < 2e-5) == sticks
        assert (np.abs(slips[-20:]).min() > 5e-3) != sticks


def test_a_finger_that_turns_rolls_along_the_side() -> None:
    """Where it sticks, it pushes the touched point sideways at the speed of its own surface."""
    h, spin = 2e-3, 3.0
    grid = rectangle(10, 6)
    maps = Maps(np.full(60, 0.01), np.full(60, 0.4), np.array([1.0]))
    tip = line((-0.05 - FINGER_RADIUS, 0.0), (0.05, 0.0), 0.1, h)
    push = finger_push(tip, h, tip_angle=spin * h * np.arange(len(tip)))
    poses = with_start(Slider(grid, FINGER_RADIUS).rollout(maps, [push]).poses[0], push)
    twist = twists_between(poses, h)[5]
    x, y = to_object(0.5 * (tip[5] + tip[6]), 0.5 * (poses[5] + poses[6]))
    surface = twist[:2] + twist[2] * np.array([-y, x + FINGER_RADIUS])
    # The finger turns counterclockwise: its right side, which touches the object, moves up.
    assert surface[1] == pytest.approx(spin * FINGER_RADIUS, abs=2e-4)
    frictionless = Maps(maps.mass, maps.mu, np.zeros(1))
    slider = Slider(grid, FINGER_RADIUS)
    still = replace(push, tip_angle=None)
    ends = [slider.rollout(frictionless, [one]).end for one in (push, still)]
    np.testing.assert_allclose(*ends, atol=1e-12)


def test_a_concave_corner_holds_the_finger_from_two_sides() -> None:
    h, radius = 5e-3, 0.008
    grid = l_shape()
    n = len(grid)
    maps = Maps(np.full(n, 0.02), np.full(n, 0.4), np.array([0.0]))
    slider = Slider(grid, radius)
    # Into the corner at (0, 0), towards -x and -y.
    heading = np.array([-0.8, -0.6])
    start = np.array([radius, radius]) - 0.002 * heading
    push = finger_push(line(start, 0.03 * heading, 1.0, h), h)
    out = slider.rollout(maps, [push])
    local_tip = np.array([to_object(t, q) for t, q in zip(push.tip[1:], out.poses[0], strict=True)])
    local_force = np.array([rotation(q[2]).T @ f for q, f in zip(out.poses[0], out.forces[0], strict=True)])
    held = slice(60, None)
    # Without friction each side pushes only along its normal: a force between the two needs both.
    assert np.all(local_force[held] < -0.1)
    assert local_tip[held] == pytest.approx(np.full((140, 2), radius), abs=2e-5)


def test_only_one_side_of_a_concave_corner_is_felt_away_from_it() -> None:
    h, radius = 5e-3, 0.008
    grid = l_shape()
    maps = Maps(np.full(len(grid), 0.02), np.full(len(grid), 0.4), np.array([0.0]))
    # Against the inner side of the arm that runs along y, 4 mm above the corner.
    push = finger_push(line((radius + 1e-4, radius + 0.004), (-0.03, 0), 0.2, h), h)
    out = Slider(grid, radius).rollout(maps, [push])
    local_force = np.array([rotation(q[2]).T @ f for q, f in zip(out.poses[0], out.forces[0], strict=True)])
    assert local_force[5:, 0].max() < -0.1
    assert np.abs(local_force[:, 1]).max() < 1e-2


@pytest.mark.parametrize("speed", [0.05, 0.0, -0.05])
def test_a_finger_without_friction_never_pulls(speed: float) -> None:
    """A finger that comes straight at a symmetric object, stops before it or backs away, without slip."""
    h = 0.01
    grid = rectangle(2, 2, 2.0**-5)
    maps = Maps(np.full(4, 0.0625), np.full(4, 0.4), np.array([0.0]))
    tip = line((-(2.0**-5) - FINGER_RADIUS - 1e-3, 0.0), (speed, 0), 0.2, h)
    out = Slider(grid, FINGER_RADIUS).rollout(maps, [finger_push(tip, h)])
    assert np.all(out.forces[0, :, 0] >= 0)
    assert out.end[0, 0, :3] == pytest.approx([max(0.2 * speed - 1e-3, 0), 0, 0], abs=2e-5)


def test_a_finger_that_leaves_lets_go() -> None:
    h = 5e-3
    grid = rectangle(10, 6)
    maps = random_maps(np.random.default_rng(6), 60)
    there = line((-0.05 - FINGER_RADIUS, 0.01), (0.05, 0), 0.5, h)
    back = line(there[-1], (-0.05, 0), 0.5, h)[1:]
    push = finger_push(np.vstack([there, back]), h)
    out = Slider(grid, FINGER_RADIUS).rollout(maps, [push])
    gone = slice(len(there) + 2, None)
    assert np.linalg.norm(out.forces[0, 20:90], axis=1).min() > 0.5
    assert np.all(out.forces[0, gone] == 0)
    assert np.ptp(out.poses[0, gone], axis=0) == pytest.approx(np.zeros(3), abs=1e-5)
    assert out.end[0, 0, 3:] == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.parametrize("weight", [1.0, 1e4])
@pytest.mark.parametrize("penetration", [1e-4, 1e-5, 1e-6])
def test_a_slow_finger_sinks_in_less_than_twice_the_stated_depth(penetration: float, weight: float) -> None:
    h = 5e-3
    grid = rectangle(10, 6)
    maps = random_maps(np.random.default_rng(7), 60)
    maps = Maps(maps.mass * weight, maps.mu, maps.mu_finger)
    tip = line((-0.05 - FINGER_RADIUS, 0.01), (0.01, 0.003), 2.0, h)
    push = finger_push(tip, h)
    out = Slider(grid, FINGER_RADIUS, smoothing=Smoothing(penetration=penetration)).rollout(maps, [push])
    gaps = gaps_along(grid, out.poses[0], tip[1:], FINGER_RADIUS)
    force = np.linalg.norm(out.forces[0, -1])
    load = (maps.mass * maps.mu).sum() * GRAVITY
    assert gaps.min() > -2 * penetration
    # At the end of a steady push the depth is that of the spring: force over load.
    assert 0.2 < force / load < 1.2
    assert gaps[-1] == pytest.approx(-penetration * force / load, rel=0.2)


@pytest.mark.parametrize("h", [0.01, 0.005, 0.001])
def test_a_finger_that_passes_by_is_felt_no_farther_than_its_slip_in_a_step(h: float) -> None:
    # The convex contact lifts a slipping finger off by mu times its way in one step; beyond there is nothing.
    speed, mu = 0.1, 0.5
    grid = rectangle(10, 6)
    maps = Maps(np.full(60, 0.01), np.full(60, 0.5), np.array([mu]))

    def moved(clearance: float) -> float:
        tip = line((-0.04, -0.03 - FINGER_RADIUS - clearance), (speed, 0), 0.8, h)
        return float(np.abs(Slider(grid, FINGER_RADIUS).rollout(maps, [finger_push(tip, h)]).end).max())

    assert moved(1.02 * mu * speed * h) == 0
    assert moved(0.5 * mu * speed * h) > 0
