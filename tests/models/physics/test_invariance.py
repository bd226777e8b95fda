"""Invariance to the world frame, the object frame, handedness, and the unit of mass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sliding_objects import (
    FINGER_RADIUS,
    coast,
    drive,
    finger_push,
    l_shape,
    line,
    random_maps,
    rotation,
    to_object,
    to_world,
)

from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps, Push, Slider

H = 5e-3
GRID = l_shape()
MAPS = random_maps(np.random.default_rng(8), len(GRID), mu_finger=0.35)
START = (0.4, -0.3, 0.7)


def finger_round_a_corner() -> Push:
    """Starts off the object, slides along the L's lower side, then rounds its corner."""
    start = to_world((0.02, -0.02 - FINGER_RADIUS - 0.0004), START)
    heading = rotation(START[2]) @ rotation(1.2)[:, 0]
    return finger_push(line(start, 0.08 * heading, 1.2, H), H, start_pose=START)


def by_a_turning_finger() -> Push:
    push = finger_round_a_corner()
    return replace(push, tip_angle=3.0 * H * np.arange(len(push.tip)))


def moving_object_meets_finger() -> Push:
    tip = line(to_world((0.03, 0.006), START), (0.02, 0.01), 0.5, H)
    return finger_push(tip, H, start_pose=START, start_twist=np.array([-0.2, 0.3, 3.0]))


def by_wrench() -> Push:
    wrench = np.tile([4.0, 1.0, 0.03, -0.01, 0.05], (100, 1))
    wrench[60:] = 0
    return drive(wrench, H, start_pose=START, start_twist=(0.1, 0.0, -1.0))


PUSHES = pytest.mark.parametrize(
    "push",
    [
        pytest.param(finger_round_a_corner(), id="finger"),
        pytest.param(by_a_turning_finger(), id="turning finger"),
        pytest.param(moving_object_meets_finger(), id="moving object"),
        pytest.param(by_wrench(), id="wrench"),
        pytest.param(coast((0.4, -0.2, 6.0), 0.5, H, start_pose=START), id="coasting"),
    ],
)


def simulate(grid: CellGrid, maps: Maps, push: Push) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """World poses (S, 3), forces (T, 2) and the last twist (3,)."""
    out = Slider(grid, FINGER_RADIUS).rollout(maps, [push])
    return out.poses[0], out.forces[0], out.end[0, 0, 3:]


def test_the_pushes_do_what_they_are_for() -> None:
    still, turning = (
        simulate(GRID, MAPS, push)[0] for push in (finger_round_a_corner(), by_a_turning_finger())
    )
    assert np.abs(still - turning).max() > 1e-3
    for push in (finger_round_a_corner(), moving_object_meets_finger(), by_wrench()):
        poses, forces, _ = simulate(GRID, MAPS, push)
        assert np.ptp(poses[:, 2]) > 0.02
        assert push.wrench is not None or np.linalg.norm(forces, axis=1).max() > 0.5


@PUSHES
def test_the_world_frame_does_not_matter(push: Push) -> None:
    shift, angle = np.array([2.0, -1.0]), 2.2

    def moved(points: np.ndarray) -> np.ndarray:
        return points @ rotation(angle).T + shift

    wrench = push.wrench
    if wrench is not None:
        wrench = np.hstack([wrench[:, :2] @ rotation(angle).T, wrench[:, 2:]])
    start = np.array([*moved(push.start_pose[:2]), push.start_pose[2] + angle])
    poses, forces, twist = simulate(GRID, MAPS, push)
    elsewhere = simulate(GRID, MAPS, replace(push, tip=moved(push.tip), start_pose=start, wrench=wrench))
    assert elsewhere[0] == pytest.approx(
        np.column_stack([moved(poses[:, :2]), poses[:, 2] + angle]), abs=1e-9
    )
    assert elsewhere[1] == pytest.approx(forces @ rotation(angle).T, abs=1e-7)
    assert elsewhere[2] == pytest.approx(twist, abs=1e-9)


def in_another_frame(push: Push, origin: np.ndarray, angle: float) -> tuple[CellGrid, Push]:
    """The same object and push, described in an object frame at `origin`, turned by `angle`."""
    frame = (*origin, angle)
    grid = CellGrid(to_object(GRID.centers, frame), GRID.width, to_object(GRID.exterior, frame))
    start = np.array([*to_world(origin, push.start_pose), push.start_pose[2] + angle])
    vx, vy, omega = push.start_twist
    twist = np.array([*(rotation(angle).T @ (vx - omega * origin[1], vy + omega * origin[0])), omega])
    wrench = push.wrench
    if wrench is not None:
        wrench = np.hstack([wrench[:, :2], to_object(wrench[:, 2:4], frame), wrench[:, 4:]])
    return grid, replace(push, start_pose=start, start_twist=twist, wrench=wrench)


@PUSHES
@pytest.mark.parametrize("origin", [(0.03, -0.02), (-0.4, 0.3)])
def test_the_object_frame_does_not_matter(push: Push, origin: tuple[float, float]) -> None:
    origin_, angle = np.array(origin), 1.1
    poses, forces, _ = simulate(GRID, MAPS, push)
    other_poses, other_forces, _ = simulate(*_with_maps(in_another_frame(push, origin_, angle)))
    expected = np.array([[*to_world(origin_, q), q[2] + angle] for q in poses])
    assert other_poses == pytest.approx(expected, abs=1e-9)
    assert other_forces == pytest.approx(forces, abs=1e-7)


def test_the_object_frame_hardly_matters_within_a_step() -> None:
    """Between the ends of a step the origin goes straight where it should go along an arc: by its sagitta."""
    push = coast((0.0, 0.0, 6.0), 0.2, H)
    push = replace(push, pose_times=H * (np.arange(40) + 0.5))
    origin, angle = np.array([0.1, 0.0]), 1.1
    poses, _, _ = simulate(GRID, MAPS, push)
    other_poses, _, _ = simulate(*_with_maps(in_another_frame(push, origin, angle)))
    expected = np.array([[*to_world(origin, q), q[2] + angle] for q in poses])
    sagitta = np.linalg.norm(origin) * (6.0 * H) ** 2 / 8.0
    assert np.abs(other_poses - expected).max() < 1.01 * sagitta


def _with_maps(described: tuple[CellGrid, Push]) -> tuple[CellGrid, Maps, Push]:
    grid, push = described
    return grid, MAPS, push


@PUSHES
def test_a_mirror_image_moves_as_the_mirror_image(push: Push) -> None:
    flip = np.array([1.0, -1.0])
    grid = CellGrid(GRID.centers * flip, GRID.width, GRID.exterior * flip)
    mirrored = replace(
        push,
        tip=push.tip * flip,
        tip_angle=None if push.tip_angle is None else -push.tip_angle,
        start_pose=push.start_pose * [1, -1, -1],
        start_twist=push.start_twist * [1, -1, -1],
        wrench=None if push.wrench is None else push.wrench * [1, -1, 1, -1, -1],
    )
    poses, forces, twist = simulate(GRID, MAPS, push)
    mirror_poses, mirror_forces, mirror_twist = simulate(grid, MAPS, mirrored)
    assert mirror_poses == pytest.approx(poses * [1, -1, -1], abs=1e-9)
    assert mirror_forces == pytest.approx(forces * flip, abs=1e-7)
    assert mirror_twist == pytest.approx(twist * [1, -1, -1], abs=1e-9)


@pytest.mark.parametrize("scale", [1e-4, 30.0, 1e5])
@pytest.mark.parametrize("push", [finger_round_a_corner(), moving_object_meets_finger()])
def test_heavier_objects_move_alike_under_a_finger(push: Push, scale: float) -> None:
    heavy = Maps(MAPS.mass * scale, MAPS.mu, MAPS.mu_finger)
    poses, forces, twist = simulate(GRID, MAPS, push)
    heavy_poses, heavy_forces, heavy_twist = simulate(GRID, heavy, push)
    assert heavy_poses == pytest.approx(poses, abs=1e-9)
    assert heavy_forces == pytest.approx(forces * scale, abs=1e-7 * scale)
    assert heavy_twist == pytest.approx(twist, abs=1e-9)


@PUSHES
def test_the_order_of_the_cells_does_not_matter(push: Push) -> None:
    order = np.random.default_rng(9).permutation(len(GRID))
    grid = CellGrid(GRID.centers[order], GRID.width, np.roll(GRID.exterior, 2, axis=0))
    maps = Maps(MAPS.mass[:, order], MAPS.mu[:, order], MAPS.mu_finger)
    for value, expected in zip(simulate(grid, maps, push), simulate(GRID, MAPS, push), strict=True):
        assert value == pytest.approx(expected, abs=1e-7)


def test_many_models_and_pushes_at_once_are_those_one_by_one() -> None:
    rng = np.random.default_rng(10)
    n = len(GRID)
    maps = Maps(rng.uniform(0.005, 0.03, (3, n)), rng.uniform(0.2, 0.6, (3, n)), rng.uniform(0, 1, 3))
    pushes = [finger_round_a_corner(), by_wrench(), moving_object_meets_finger()]
    slider = Slider(GRID, FINGER_RADIUS)
    together = slider.rollout(maps, pushes, sensitivities=True)
    for k in range(3):
        for b, push in enumerate(pushes):
            alone = slider.rollout(maps[[k]], [push], sensitivities=True)
            at = slice(together.pose_at[b], together.pose_at[b + 1])
            # The two are compiled separately, so sums may round differently.
            assert together.poses_of(b)[k] == pytest.approx(alone.poses[0], abs=1e-12)
            assert together.forces_of(b)[k] == pytest.approx(alone.forces[0], abs=1e-8)
            assert together.end[k, b] == pytest.approx(alone.end[0, 0], abs=1e-10)
            scale = np.abs(alone.d_poses).max()
            assert together.d_poses[k, at] == pytest.approx(alone.d_poses[0], abs=1e-8 * scale)
