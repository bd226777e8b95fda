"""Bullet's world: weights, friction and falls are those of the object, without a line of the plant's."""

from __future__ import annotations

import numpy as np
import pytest

from slipmap.diagrams.application.campaigns.worlds import WorldNoise
from slipmap.models.geometry import turn
from slipmap.models.measurements.push_dataset import Noise
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.physics.rollout import Push, Slider
from slipmap.planners.push_decisions import ObjectFell
from slipmap.planners.table_push import TablePush

pytest.importorskip("pybullet", reason="Bullet comes with the extra `bench`")

from slipmap.diagrams.application.campaigns.bullet_world import BulletWorld

EXACT = WorldNoise(control=0.0, sensors=Noise(), camera=100.0)


@pytest.fixture(scope="module")
def world() -> BulletWorld:
    return BulletWorld(benchmark_object("book"), noise=EXACT)


def test_each_foot_carries_the_weight_of_its_cell(world: BulletWorld) -> None:
    thing = world.true_object
    world.reset(np.zeros(3), np.random.default_rng(0))
    world._settle()
    carried = np.zeros(len(thing.grid))
    for contact in world._p.getContactPoints(world._body):
        if contact[9] > 0.0:
            off = np.linalg.norm(thing.grid.centers - contact[5][:2], axis=1)
            assert off.min() < 1e-3  # prisms hang above the table
            carried[np.argmin(off)] += contact[9]
    np.testing.assert_allclose(carried, 9.81 * thing.mass, rtol=0.02)


def test_slides_like_the_model_and_pushes_back_with_its_friction() -> None:
    world = BulletWorld(benchmark_object("book"), noise=EXACT)
    thing = world.true_object
    rng = np.random.default_rng(0)
    world.reset(np.zeros(3), rng)
    left = thing.grid.exterior[:, 0].min()
    side = thing.center_of_mass[1] + 0.05
    push = TablePush(np.array([left - 0.011, side]), np.array([left + 0.09, side]), 0.1)
    trials = [world.push(push)]
    world.reset(np.zeros(3), rng)
    trials.append(world.push(push))
    np.testing.assert_array_equal(trials[0].object_pose.values, trials[1].object_pose.values)
    tip = trials[0].tip_pose
    motion = Push(
        0.01, tip.values, np.zeros(3),
        pose_times=trials[0].object_pose.time[1:], force_times=tip.time[1:] - 0.005,
    )  # fmt: skip
    rollouts = Slider(thing.grid, world.finger_radius).rollout(thing.maps, [motion])
    expected = rollouts.poses_of(0)[0]
    off = trials[0].object_pose.values[1:] - expected
    assert abs(expected[-1, 2]) > np.radians(4.0)
    assert np.linalg.norm(off[:, :2], axis=1).max() < 4e-3
    assert np.abs(off[:, 2]).max() < np.radians(2.0)
    assert trials[0].ft_wrench is not None
    steady = slice(60, 100)
    measured = trials[0].ft_wrench.values[steady, :2].mean(axis=0)
    predicted = rollouts.forces_of(0)[0][steady].mean(axis=0)
    np.testing.assert_allclose(measured, predicted, atol=0.05 * np.hypot(*predicted))


def test_falls_where_its_weight_is_beyond_the_edge(world: BulletWorld) -> None:
    assert world.table.radius is not None
    for angle in (0.3, 2.5):
        middle = turn(angle) @ world.true_object.center_of_mass[:2]
        outward = middle / np.hypot(*middle)
        for beyond, falls in ((-0.02, False), (5e-3, True)):
            place = (world.table.radius + beyond) * outward - middle
            world.reset(np.array([*place, angle]), np.random.default_rng(0))
            if falls:
                with pytest.raises(ObjectFell):
                    world.look()
            else:
                np.testing.assert_allclose(world.look(), [*place, angle], atol=2e-3)


def test_thin_prisms_rest_on_the_table() -> None:
    world = BulletWorld(benchmark_object("wrench"), EXACT)
    world.reset(np.array([0.0, 0.0, 1.0]), np.random.default_rng(0))
    world.push(TablePush(np.array([0.5, 0.3]), np.array([0.51, 0.3]), 0.2))
    np.testing.assert_allclose(world.look(), [0.0, 0.0, 1.0], atol=1e-4)
