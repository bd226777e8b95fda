"""Goals at the table's edge: poses where the object stays and overhangs far enough to be grasped.

`Graspable.sample_goals` implements lines 11 to 13 of Algorithm 4 of Song and Boularias (2020).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from slipmap.models.geometry import rotated
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.balance import balance_margins, corners_of, fall_probability
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.planners.grasps import Grasp, GraspLines, Gripper, grasp_lines
from slipmap.planners.settings import GoalSettings

_ENOUGH_MARGIN = 0.02  # m; more is not better


@dataclass(frozen=True, eq=False)
class Goal:
    """A pose at the edge with a grasp."""

    pose: FloatArray  # (3,) of the object, world, m and rad
    grasp: Grasp  # the best one there
    fall_probability: float  # of hypotheses whose balance margin there is below the settings' margin
    margin: float  # balance margin that the object has with probability 1 - epsilon, m
    room: float  # approximate distance that the object could lie farther in and still be grasped this way, m
    # ranks goals, larger is better: the grasp's value (`GraspLines.ranked`) plus the margin, up to 20 mm
    value: float


@dataclass(frozen=True, eq=False)
class Graspable:
    """An object with its grasps, for planning; made by `of`, once per belief."""

    grid: CellGrid  # cells and outline
    centers_of_mass: FloatArray  # (K, 2) of the hypotheses, object frame, m
    probability: FloatArray  # (K,) of the hypotheses
    lines: GraspLines  # all its grasps
    settings: GoalSettings  # requirements on goals

    @staticmethod
    def of(
        grid: CellGrid,
        heights: ArrayLike,
        centers_of_mass: ArrayLike,
        probability: ArrayLike,
        settings: GoalSettings,
        masses: ArrayLike | None = None,
        gripper: Gripper | None = None,
    ) -> Graspable:
        """Find the grasps of an object.

        Args:
            heights: (n,) of the object's top over each cell, m.
            centers_of_mass: (K, 2) of the hypotheses, object frame, m.
            probability: (K,) of the hypotheses; those of probability 0 do not count.
            masses: (K,) of the whole object in each hypothesis, kg; `settings.mass` if None.
            gripper: the robot's own if None.

        Raises:
            ValueError: shapes that do not match, or invalid settings.
        """
        settings.check()
        centers = np.asarray(centers_of_mass, dtype=float)
        p = np.asarray(probability, dtype=float)
        weights = np.full(len(p), settings.mass) if masses is None else np.asarray(masses, dtype=float)
        if centers.shape != (*p.shape, 2) or weights.shape != p.shape:
            raise ValueError(
                f"goals: {p.shape} probabilities need as many centres of mass and masses, got"
                f" {centers.shape} and {weights.shape}"
            )
        counts = p > 0
        lines = grasp_lines(
            grid,
            np.asarray(heights, dtype=float),
            centers[counts],
            weights[counts],
            p[counts],
            settings,
            gripper or Gripper(),
        )
        return Graspable(grid, centers, p, lines, settings)

    @staticmethod
    def of_belief(belief: Belief, heights: ArrayLike, settings: GoalSettings) -> Graspable:
        """As `of`, with grid, centres of mass, masses and probabilities of a belief."""
        masses = belief.maps.mass.sum(axis=1)
        return Graspable.of(
            belief.grid, heights, belief.centers_of_mass, belief.probability, settings, masses
        )

    def goals_at(self, poses: ArrayLike, table: Table) -> list[Goal | None]:
        """Find which of the given poses are goals, as a method would choose them in the paper's Figure 5.

        A pose is a goal if the object falls there with a probability of at most epsilon and a grasp passes
        the checks listed in `GraspLines`.

        Args:
            poses: (P, 3) of the object in the world, m and rad.

        Returns:
            A goal or None for each pose.
        """
        poses = np.asarray(poses, dtype=float)
        margins = balance_margins(self.grid, self.centers_of_mass, poses, table)
        falls = fall_probability(margins, self.probability, self.settings.margin)
        found: list[Goal | None] = [None] * len(poses)
        stays = np.flatnonzero(falls <= self.settings.epsilon)
        if len(stays) == 0 or len(self.lines.start) == 0:
            return found
        sure = self._sure_margins(margins[stays])
        best = self.lines.best(poses[stays], table)
        for index, margin, value, room, line, place in zip(stays, sure, *best, strict=True):
            if np.isfinite(value):
                found[index] = Goal(
                    pose=poses[index],
                    grasp=self.lines.grasp(int(line), int(place)),
                    fall_probability=float(falls[index]),
                    margin=float(margin),
                    room=float(room),
                    value=float(value + min(margin, _ENOUGH_MARGIN)),
                )
        return found

    def grasps_at(self, pose: ArrayLike, table: Table) -> list[Grasp]:
        """All grasps at a pose, one on each line, best first; balance is not checked."""
        if len(self.lines.start) == 0:
            return []
        value, _, place = (rows[0] for rows in self.lines.ranked(np.asarray(pose, dtype=float)[None], table))
        order = np.argsort(-value, kind="stable")
        return [self.lines.grasp(int(k), int(place[k])) for k in order if np.isfinite(value[k])]

    def sample_goals(
        self, table: Table, rng: np.random.Generator, allowed: Callable[[Goal], bool] = lambda goal: True
    ) -> list[Goal]:
        """Goals along the whole edge, best first, at most `settings.count`.

        `settings.samples` poses are drawn uniformly along the edge, in orientation and in overhang;
        `goals_at` decides which of them are goals.

        Args:
            allowed: whether the robot can serve a goal; called best first, until there are enough.

        Returns:
            Goals; none if the object cannot be left at the edge and grasped.
        """
        poses = self._poses_at_edge(table, rng)
        goals = [goal for goal in self.goals_at(poses, table) if goal is not None]
        goals.sort(key=lambda goal: -goal.value)
        kept: list[Goal] = []
        for goal in goals:
            if len(kept) == self.settings.count:
                break
            if allowed(goal):
                kept.append(goal)
        return kept

    def _sure_margins(self, margins: FloatArray) -> FloatArray:
        """(P,) margin that hypotheses of probability 1 - epsilon or more have."""
        order = np.argsort(margins, axis=1)
        below = np.cumsum(self.probability[order], axis=1)
        first = np.argmax(below > self.settings.epsilon, axis=1)
        return np.take_along_axis(np.take_along_axis(margins, order, axis=1), first[:, None], axis=1)[:, 0]

    def _poses_at_edge(self, table: Table, rng: np.random.Generator) -> FloatArray:
        """(P, 3) poses at which part of the object overhangs, but not its expected centre of mass."""
        count = self.settings.samples
        rim, outward = _points_of_edge(table, rng.uniform(size=count))
        turn = rng.uniform(-np.pi, np.pi, count)
        in_object = rotated(outward, -turn)
        farthest = (in_object @ self.grid.exterior.T).max(axis=1) - self.settings.least_contact
        middle = in_object @ (self.probability @ self.centers_of_mass) + self.settings.margin
        in_by = middle + rng.uniform(size=count) * np.maximum(farthest - middle, 0.0)
        return np.column_stack([rim - in_by[:, None] * outward, turn])


def _points_of_edge(table: Table, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (P, 2) of the edge at shares (P,) of its length and the outward normals (P, 2) there."""
    corners = corners_of(table)
    if len(corners) == 0:
        assert table.radius is not None  # see corners_of
        outward = np.column_stack([np.cos(2 * np.pi * share), np.sin(2 * np.pi * share)])
        return np.asarray(table.center) + table.radius * outward, outward
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    way = share * lengths.sum()
    side = np.minimum(np.searchsorted(np.cumsum(lengths), way, side="right"), len(sides) - 1)
    along = sides[side] / lengths[side, None]
    points = corners[side] + (way - (np.cumsum(lengths) - lengths)[side])[:, None] * along
    return points, np.column_stack([along[:, 1], -along[:, 0]])
