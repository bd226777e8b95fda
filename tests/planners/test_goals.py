"""Goals of the six objects against brute force: polygons for clearance, a linear programme for holding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import shapely
from scipy.optimize import linprog
from shapely import affinity

from slipmap.models.measurements.push_dataset import Table
from slipmap.models.objects.benchmark_objects import BENCHMARK_OBJECTS, benchmark_object
from slipmap.models.objects.footprints import cells_from_polygon
from slipmap.models.objects.true_object import TrueObject
from slipmap.planners.goals import Goal, Graspable
from slipmap.planners.grasps import Gripper
from slipmap.planners.settings import GoalSettings

GRAVITY = 9.81
ROUND = Table("round", (0.0, 0.0), radius=0.5)
RECTANGLE = Table("rectangle", (0.1, 0.0), size=(1.0, 0.7))
ROUNDING = 2e-3
"""m, half of what a raster of 2 mm and places 2.5 mm apart can be off."""


@dataclass(frozen=True)
class Case:
    """An object, hypotheses around its true centre of mass, and its goals on a table."""

    thing: TrueObject
    centers: np.ndarray
    probability: np.ndarray
    table: Table
    goals: list[Goal]


@pytest.fixture(
    scope="module",
    params=[(name, ROUND) for name in BENCHMARK_OBJECTS] + [("hammer", RECTANGLE), ("box", RECTANGLE)],
    ids=lambda param: f"{param[0]}-{param[1].shape}",
)
def case(request: pytest.FixtureRequest) -> Case:
    name, table = request.param
    thing = benchmark_object(name)
    rng = np.random.default_rng(0)
    centers = thing.center_of_mass[:2] + rng.normal(0.0, 6e-3, (20, 2))
    probability = rng.dirichlet(np.ones(20))
    settings, masses = GoalSettings(samples=1000, count=1000), np.full(20, thing.total_mass)
    goals = Graspable.of(
        thing.grid, thing.height, centers, probability, settings, masses
    ).sample_goals(table, rng)  # fmt: skip
    return Case(thing, centers, probability, table, goals)


def test_every_object_has_goals_ranked_best_first(case: Case) -> None:
    assert len(case.goals) > 100
    values = [goal.value for goal in case.goals]
    assert values == sorted(values, reverse=True)


def test_goals_stay_with_the_stated_probability(case: Case) -> None:
    for goal in _some(case):
        placed = affinity.translate(
            affinity.rotate(case.thing.grid.polygon, goal.pose[2], origin=(0, 0), use_radians=True),
            *goal.pose[:2],
        )
        support = (placed & _top(case.table)).convex_hull
        points = shapely.points(_in_world(case.centers, goal.pose))
        distance = shapely.distance(support.exterior, points)
        margins = np.where(shapely.contains(support, points), distance, -distance)
        assert goal.fall_probability == pytest.approx(case.probability[margins < 5e-3].sum(), abs=1e-9)
        assert goal.fall_probability <= 0.1
        assert case.probability[margins < goal.margin - 1e-4].sum() <= 0.1
        assert case.probability[margins < goal.margin + 1e-4].sum() > 0.1


def test_gripper_comes_without_touching_table_or_object(case: Case) -> None:
    """The real prisms and the whole way of approach, 0.4 m long."""
    gripper, top = Gripper(), _top(case.table)
    for goal in _some(case):
        x, y, z, yaw = goal.grasp.at(goal.pose)
        along, tip = np.array([np.cos(yaw), np.sin(yaw)]), np.array([x, y])
        pin = shapely.LineString([tip, tip - 0.4 * along]).buffer(gripper.finger_radius, cap_style="flat")
        hand = shapely.LineString(
            [tip - gripper.hand_distance * along, tip - (gripper.hand_distance + 0.4) * along]
        ).buffer(gripper.hand_radius)
        assert shapely.distance(pin, top) >= 4.9e-3
        assert shapely.distance(hand, top) >= 4.9e-3
        assert z + goal.grasp.opening / 2 <= 0.2  # nothing absurd
        for block in case.thing.blocks:
            placed = _placed(block.outline, goal.pose)
            assert shapely.distance(hand, placed) >= 5e-3 - ROUNDING
            if shapely.distance(pin, placed) < 1e-3:
                assert z + goal.grasp.opening / 2 - gripper.finger_radius >= block.height + 4e-3
        # The lower pin passes below the object.
        assert z - goal.grasp.opening / 2 + gripper.finger_radius <= -4.9e-3


def test_grasp_carries_the_weight_in_hypotheses_that_are_likely_enough(case: Case) -> None:
    """Least force of the lower pin by a linear programme over points at both lines of contact."""
    thing = case.thing
    weight = GRAVITY * thing.total_mass
    for goal in _some(case)[::3]:
        grasp = goal.grasp
        along = np.array([np.cos(grasp.approach), np.sin(grasp.approach)])
        line = grasp.tip - along * np.arange(0.0, 0.1, 1e-3)[:, None]
        line = line[shapely.contains_xy(thing.grid.polygon, line)]
        assert np.ptp(line @ along) >= 0.015 - ROUNDING
        nearest = np.linalg.norm(line[:, None] - thing.grid.centers, axis=2).argmin(axis=1)
        high = line[thing.height[nearest] >= grasp.height - 3e-3 - 1e-6]
        below, above = line @ along, high @ along
        too_heavy = 0.0
        for center, p in zip(case.centers, case.probability, strict=True):
            at = float(center @ along)
            result = linprog(
                np.r_[np.ones(len(below)), np.zeros(len(above))],
                A_eq=np.vstack(
                    [
                        np.r_[np.ones(len(below)), -np.ones(len(above))],
                        np.r_[below - at, -(above - at)],
                    ]
                ),
                b_eq=[weight, 0.0],
            )
            across = abs(float(center @ [-along[1], along[0]] - grasp.tip @ [-along[1], along[0]]))
            beside = weight * across / (0.2 * grasp.height)
            assert result.status == 0
            # Places are 2.5 mm apart: of a short contact that is much.
            if result.fun + beside > grasp.force * (1 + 2.5e-3 / grasp.length) + 1e-6:
                too_heavy += p
        assert too_heavy <= GoalSettings().epsilon
        assert grasp.force <= 80.0


def test_patch_and_tip_lie_on_one_line(case: Case) -> None:
    for goal in _some(case):
        along = np.array([np.cos(goal.grasp.approach), np.sin(goal.grasp.approach)])
        way = goal.grasp.tip - goal.grasp.patch
        assert abs(way @ [-along[1], along[0]]) < 1e-9
        assert -1e-9 <= way @ along <= 0.1


def test_room_is_left(case: Case) -> None:
    """Moved straight in by most of its room, the object still has a grasp near the one before."""
    thing = case.thing
    planned = Graspable.of(
        thing.grid, thing.height, case.centers, case.probability, GoalSettings(),
        masses=np.full(20, thing.total_mass),
    )  # fmt: skip
    tried = 0
    for goal in case.goals[:200:20]:
        tip = shapely.Point(goal.grasp.at(goal.pose)[:2])
        nearest = np.array(shapely.shortest_line(tip, _top(case.table)).coords)
        inward = (nearest[1] - nearest[0]) / np.linalg.norm(nearest[1] - nearest[0])
        moved = goal.pose + np.array([*(0.8 * min(goal.room, 0.02) * inward), 0.0])
        again = planned.grasps_at(moved, case.table)
        near = [
            g for g in again
            if abs(np.angle(np.exp(1j * (g.approach - goal.grasp.approach)))) < 0.1
            and np.linalg.norm(g.patch - goal.grasp.patch) < 0.05
        ]  # fmt: skip
        assert near
        tried += 1
    assert tried == 10


@pytest.fixture(scope="module")
def slab() -> dict:
    """0.3 m by 0.1 m by 30 mm, of 0.5 kg, known well."""
    grid = cells_from_polygon(
        np.array([[-0.15, -0.05], [0.15, -0.05], [0.15, 0.05], [-0.15, 0.05]]), width=0.025
    )
    return {
        "grid": grid,
        "heights": np.full(len(grid), 0.03),
        "centers_of_mass": np.zeros((2, 2)),
        "probability": np.array([0.5, 0.5]),
        "settings": GoalSettings(samples=300, count=40),
        "masses": np.full(2, 0.5),
    }


def test_poses_that_a_method_would_choose(slab: dict) -> None:
    thing = Graspable.of(**slab)
    poses = np.array(
        [
            [0.0, 0.0, 0.0],  # in the middle: nothing sticks out
            [0.45, 0.0, 0.0],  # out by 0.1 m
            [0.497, 0.0, 0.0],  # stays, but by less than the margin
            [0.53, 0.0, 0.0],  # falls
            [0.45, 0.0, np.pi / 2],  # along the rim, not out
            [0.485, 0.0, np.pi / 2],  # along the rim, out by 35 mm
        ]
    )
    chosen = [goal is not None for goal in thing.goals_at(poses, ROUND)]
    assert chosen == [False, True, False, False, False, True]
    (goal,) = [g for g in thing.goals_at(poses[1:2], ROUND) if g]
    assert goal.margin == pytest.approx(0.05, abs=2e-3)
    # Towards the table, and as far in as the rim lets it.
    assert abs(goal.grasp.approach) > np.pi - 0.3
    assert goal.grasp.tip[0] == pytest.approx(0.05 + 0.005, abs=4e-3)


def test_one_hypothesis_that_falls_is_enough_when_it_is_likely(slab: dict) -> None:
    pose = np.array([[0.45, 0.0, 0.0]])
    for share, chosen in ((0.05, True), (0.2, False)):
        changed = slab | {
            "centers_of_mass": np.array([[0.0, 0.0], [0.06, 0.0]]),
            "probability": np.array([1 - share, share]),
        }
        assert (Graspable.of(**changed).goals_at(pose, ROUND)[0] is not None) == chosen


def test_no_goals_where_the_gripper_cannot(slab: dict) -> None:
    rng = np.random.default_rng(0)

    def number(changed: dict) -> int:
        gripper = changed.pop("gripper", None)
        return len(Graspable.of(**slab | changed, gripper=gripper).sample_goals(ROUND, rng))

    assert number({}) > 0
    assert number({"masses": np.full(2, 20.0)}) == 0
    assert number({"heights": np.full(len(slab["grid"]), 0.2)}) == 0
    assert number({"gripper": Gripper(opening=0.03 + 0.016 + 0.009)}) == 0
    assert number({"gripper": Gripper(opening=0.03 + 0.016 + 0.011)}) > 0
    # One hypothesis that is too heavy is enough, unless it is impossible.
    heavy = {"masses": np.array([0.5, 20.0])}
    assert number(heavy) == 0
    assert number(heavy | {"probability": np.array([1.0, 0.0])}) > 0


def test_upper_pin_stays_off_a_tower(slab: dict) -> None:
    """A tower at one end: no grasp reaches it, the other end is free."""
    tower = np.where(slab["grid"].centers[:, 0] > 0.1, 0.2, 0.03)
    goals = Graspable.of(**slab | {"heights": tower}).sample_goals(ROUND, np.random.default_rng(0))
    assert goals
    for goal in goals:
        x, _ = goal.grasp.tip
        assert x < 0.1
        assert goal.grasp.height == pytest.approx(0.03)


def test_upper_pin_passes_beside_a_wall_with_clearance(slab: dict) -> None:
    """Along one side a wall; it may begin anywhere between the cells that are low and those that are high."""
    walled = np.where(slab["grid"].centers[:, 1] > 0.025, 0.2, 0.03)
    grasps = Graspable.of(**slab | {"heights": walled}).grasps_at([0.45, 0.0, 0.0], ROUND)
    wall = shapely.box(-0.15, 0.0125, 0.15, 0.05)
    nearest = np.inf
    for grasp in grasps:
        along = np.array([np.cos(grasp.approach), np.sin(grasp.approach)])
        pin = shapely.LineString([grasp.tip, grasp.tip - 0.3 * along])
        pin = pin.buffer(Gripper().finger_radius, cap_style="flat")
        nearest = min(nearest, shapely.distance(pin, wall))
    assert 5e-3 - ROUNDING <= nearest < 12e-3


def test_pins_do_not_lie_along_an_edge(slab: dict) -> None:
    """They would slip off where it is rounded."""
    graspable = Graspable.of(
        slab["grid"], slab["heights"], slab["centers_of_mass"], slab["probability"], slab["settings"],
        slab["masses"],
    )  # fmt: skip
    grasps = graspable.grasps_at(np.array([0.5, 0.0, 0.0]), ROUND)
    along = [grasp.tip[1] for grasp in grasps if abs(abs(grasp.approach) - np.pi) < 1e-9]
    assert len(along) > 10
    assert np.abs(along).max() < 0.05 - 5e-3 + ROUNDING


def test_same_seed_same_goals_and_only_allowed_ones(slab: dict) -> None:
    thing = Graspable.of(**slab)
    first, second = (thing.sample_goals(ROUND, np.random.default_rng(3)) for _ in range(2))
    assert [g.value for g in first] == [g.value for g in second]
    assert len(first) == 40
    right = thing.sample_goals(ROUND, np.random.default_rng(3), lambda goal: bool(goal.pose[0] > 0.2))
    assert right
    assert all(goal.pose[0] > 0.2 for goal in right)


def test_settings_and_shapes_are_checked(slab: dict) -> None:
    with pytest.raises(ValueError, match="goals: epsilon"):
        Graspable.of(**slab | {"settings": GoalSettings(epsilon=0.7)})
    with pytest.raises(ValueError, match="as many centres of mass"):
        Graspable.of(**slab | {"centers_of_mass": np.zeros((3, 2))})


def _some(case: Case) -> list[Goal]:
    """Best, worst and those between."""
    picked = np.unique(np.linspace(0, len(case.goals) - 1, 40).astype(int))
    return [case.goals[k] for k in picked]


def _top(table: Table) -> shapely.Polygon:
    if table.shape == "round":
        return shapely.Point(*table.center).buffer(table.radius, quad_segs=2000)
    x, y = np.asarray(table.size) / 2
    return affinity.translate(shapely.box(-x, -y, x, y), *table.center)


def _placed(shape: shapely.Polygon, pose: np.ndarray) -> shapely.Polygon:
    return affinity.translate(affinity.rotate(shape, pose[2], origin=(0, 0), use_radians=True), *pose[:2])


def _in_world(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]
