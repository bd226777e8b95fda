"""Grasps at the table's edge: one pin above, one below the overhanging part of the object.

`grasp_lines` finds all grasps of an object: `GraspLines`, straight lines along which the pins can approach.
It reads the object's height from a `HeightMap`. At a pose, a line ends where hand or pin would meet the
table.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from slipmap.models.geometry import compose, rotated, seen_from
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.balance import corners_of
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.robots import (
    FINGER_LENGTH,
    FINGER_RADIUS,
    GRIP_FORCE,
    GRIPPER_OPENING,
    HAND_DISTANCE,
    HAND_RADIUS,
)
from slipmap.planners.settings import GoalSettings

GRAVITY = 9.81  # m/s²
PITCH = 2e-3  # m, side of a pixel in a height map

_DIRECTIONS = 48
_APART = 5e-3  # m between neighbouring lines
_STEP = 2.5e-3  # m between positions of the pins' ends along a line
_BESIDE = 5e-3  # m from the pins' axes to the outline beside them: a pin slips off a rounded edge
_ENOUGH = 0.02  # m, of room; more is not better
_AT_ONCE = 32  # poses

Raster = NDArray[np.float32]


@dataclass(frozen=True)
class Gripper:
    """A parallel gripper of two round pins; by default the robot's own."""

    opening: float = GRIPPER_OPENING  # largest distance between the axes of the pins, m
    finger_radius: float = FINGER_RADIUS  # of a pin, m
    finger_length: float = FINGER_LENGTH  # of a pin in front of the hand, m
    hand_radius: float = HAND_RADIUS  # half the hand's width across the closing direction, m
    hand_distance: float = HAND_DISTANCE  # from the pins' ends back to the middle of the hand, m
    force: float = GRIP_FORCE  # largest force of a pin, N


@dataclass(frozen=True, eq=False)
class Grasp:
    """A horizontal grasp from outside the table; the pins close vertically and are fully open until then.

    The hand approaches in a straight line along `approach`, at half the height of the object's top, and stops
    with the pins' ends at `tip`. `GraspLines` lists the checks.
    """

    # (2,) middle of the line along which the lower pin supports the object, object frame, m
    patch: FloatArray
    approach: float  # direction of the hand's motion, from x of the object frame, rad
    opening: float  # distance between the axes of the pins until they close, m
    tip: FloatArray  # (2,) ends of the pins, object frame, m
    height: float  # of the object's top between the pins, m
    # from the inner end of the lower contact to the outer end of the upper one, m: the lever arm of the two
    # opposed forces that carry the weight
    length: float
    force: float  # of the lower pin that keeps the object level with probability 1 - epsilon, N

    def at(self, pose: FloatArray) -> FloatArray:
        """(4,) x, y, z (m) of the midpoint between the pins' ends and yaw (rad) of the approach, world.

        Args:
            pose: (3,) of the object in the world, m and rad; the table's top is at z = 0.
        """
        x, y, yaw = compose(pose, np.append(self.tip, self.approach))
        return np.array([x, y, self.height / 2, yaw])


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Smallest and largest possible height at points of the object frame; 0 outside the outline.

    A height is known where neighbouring cells are equally high; elsewhere it may be any between theirs.
    """

    corner: FloatArray  # (2,) the raster's first point, m; its rows go along y, its columns along x
    lowest: Raster  # smallest height, m
    highest: Raster  # largest height, m

    @staticmethod
    def of(grid: CellGrid, heights: FloatArray) -> HeightMap:
        """Heights between the cells of a grid.

        Args:
            grid: n cells and the outline.
            heights: (n,) m, positive.

        Raises:
            ValueError: the number of heights differs from that of the cells, or a height is not positive.
        """
        heights = np.asarray(heights, dtype=float)
        if heights.shape != (len(grid),):
            raise ValueError(f"heights: {len(grid)} cells need as many heights, got shape {heights.shape}")
        if not (np.isfinite(heights) & (heights > 0)).all():
            cell = int(np.flatnonzero(~(np.isfinite(heights) & (heights > 0)))[0])
            raise ValueError(f"heights: cell {cell} must have a positive height, has {heights[cell]} m")
        x0, y0, x1, y1 = grid.polygon.bounds
        x, y = np.arange(x0, x1 + PITCH, PITCH), np.arange(y0, y1 + PITCH, PITCH)
        points = np.stack(np.meshgrid(x, y), axis=-1)
        inside = shapely.contains_xy(grid.polygon, points[..., 0], points[..., 1])
        low, high = _between_cells(grid, heights, points[inside])
        lowest, highest = (np.zeros(inside.shape, dtype=np.float32) for _ in range(2))
        lowest[inside], highest[inside] = low, high
        return HeightMap(np.array([x0, y0]), lowest, highest)

    def highest_within(self, distance: float) -> Raster:
        """Largest height within a distance (m) of each point, as a larger raster for `sampled`."""
        reach = int(np.ceil(distance / PITCH))
        offset = np.arange(-reach, reach + 1) * PITCH
        disc = (np.hypot(*np.meshgrid(offset, offset)) <= distance + PITCH / 2).astype(np.uint8)
        padded = np.pad(self.highest, reach)
        return np.asarray(cv2.dilate(padded, disc), dtype=np.float32)

    def sampled(self, raster: Raster, points: FloatArray) -> Raster:
        """Values (...) of one of this map's rasters at points (..., 2); 0 outside it.

        Args:
            raster: `lowest`, `highest` or one of `highest_within`, centred on the same points.
            points: object frame, m.
        """
        more = (np.array(raster.shape) - self.lowest.shape) // 2
        column = np.rint((points[..., 0] - self.corner[0]) / PITCH).astype(np.intp) + more[1]
        row = np.rint((points[..., 1] - self.corner[1]) / PITCH).astype(np.intp) + more[0]
        within = (row >= 0) & (row < raster.shape[0]) & (column >= 0) & (column < raster.shape[1])
        values = raster[np.where(within, row, 0), np.where(within, column, 0)]
        return np.asarray(np.where(within, values, 0), dtype=np.float32)


def _between_cells(grid: CellGrid, heights: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest height of the cells around each point: usually four, fewer at the rim."""
    tree = cKDTree(grid.centers)
    _, around = tree.query(points, k=9, p=np.inf, distance_upper_bound=0.999 * grid.width)
    nearest = heights[tree.query(points)[1]]
    low = np.append(heights, np.inf)[around].min(axis=1)
    high = np.append(heights, -np.inf)[around].max(axis=1)
    return np.where(np.isfinite(low), low, nearest), np.where(np.isfinite(high), high, nearest)


@dataclass(frozen=True, eq=False)
class GraspLines:
    """L lines over the object frame, each with S places for the pins' ends, `_STEP` apart.

    Checks of a grasp in the object frame:

    - The open pins keep `clearance` above and below everything that they pass on their way in.
    - The hand, swept along the line, keeps `clearance` from the outline, whatever the height there.
    - The axis of the lower pin lies under the outline over at least `least_contact`. There, and where the
      upper pin holds, the outline extends 5 mm farther to either side.
    - The upper pin comes down on known heights: between cells of different height the object may have any
      height between theirs. At least `least_contact` lies between the outermost place that is certainly as
      high as everything that the pin passes (less `tolerance`) and the inner end of the lower contact.
    - The object stays level in hypotheses of total probability 1 - epsilon or more: a force at either end
      carries the moment of the weight about the cross axis of the pins, friction the moment about their own
      axis, and the lower pin also the weight, all together within the gripper's force. Both moments are added
      as if they needed the same force.

    At a pose (`reach`), the lower pin and the hand, swept along the line, keep `clearance` from the table.
    """

    direction: FloatArray  # (L, 2) in which the hand moves
    offset: FloatArray  # (L,) of the line to the left of the origin, m
    start: FloatArray  # (L,) coordinate along the line of the first place, where the outline begins, m
    force: FloatArray  # (L, S) that the grasp needs, N; inf where the grasp fails a check
    height: FloatArray  # (L, S) largest that the pins pass, m
    lower: FloatArray  # (L, S) inner end of the lower contact, coordinate along the line, m
    upper: FloatArray  # (L, S) outer end of the upper contact, likewise
    gripper: Gripper  # whose grasps they are
    clearance: float  # m

    def reach(self, poses: FloatArray, table: Table) -> FloatArray:
        """(P, L) farthest coordinate of the pins' ends at which pins and hand clear the table, m.

        Args:
            poses: (P, 3) of the object in the world.
            table: top at the height of the object's underside.
        """
        hand = self.gripper.hand_radius + self.clearance
        pin = self.gripper.finger_radius + self.clearance
        behind = self.gripper.hand_distance - self.gripper.hand_radius
        pins_free = first_on_table(self.direction, self.offset, poses, table, pin)
        hand_free = first_on_table(self.direction, self.offset, poses, table, hand)
        return np.minimum(pins_free, hand_free + behind) - self.clearance

    def ranked(self, poses: FloatArray, table: Table) -> tuple[FloatArray, FloatArray, NDArray[np.intp]]:
        """The best grasp on each line at each pose.

        The best place needs the least force. Lines are compared by their value: room, up to 20 mm, less 20 mm
        times the share of the gripper's force that is needed. Room is approximately how much farther over the
        table the object could lie and still leave a grasp on the line.

        Args:
            poses: (P, 3) of the object in the world.

        Returns:
            value: (P, L) m, -inf where the line has no grasp.
            room: (P, L) m.
            place: (P, L) index of the best place.
        """
        best = _running_argmin(self.force)
        least = np.minimum.accumulate(self.force, axis=1)
        first = self.start + _STEP * np.argmax(np.isfinite(self.force), axis=1)
        reach = self.reach(poses, table)
        last = np.floor((reach - self.start) / _STEP)
        index = np.clip(last, 0, self.force.shape[1] - 1).astype(np.intp)
        line = np.arange(len(self.start))
        force = np.where(last >= 0, least[line, index], np.inf)
        spare = np.minimum(reach - first, self.gripper.finger_length)
        facing = towards_table(self.direction, self.offset, first, poses, table)
        room = spare * np.maximum(facing, 0.0)
        value = np.minimum(room, _ENOUGH) - _ENOUGH * force / self.gripper.force
        return value, room, best[line, index]

    def best(
        self, poses: FloatArray, table: Table
    ) -> tuple[FloatArray, FloatArray, NDArray[np.intp], NDArray[np.intp]]:
        """The line with the largest value at each pose: value (P,), room (P,), line (P,) and place (P,).

        It calls `ranked` for a few poses at a time, so that they fit into the processor's cache.
        """
        parts = []
        for begin in range(0, len(poses), _AT_ONCE):
            value, room, place = self.ranked(poses[begin : begin + _AT_ONCE], table)
            line = np.argmax(value, axis=1)
            row = np.arange(len(line))
            parts.append((value[row, line], room[row, line], line, place[row, line]))
        value, room, line, place = (np.concatenate(part) for part in zip(*parts, strict=True))
        return value, room, line, place

    def grasp(self, line: int, place: int) -> Grasp:
        """The grasp at one place of a line."""
        along, offset = self.direction[line], self.offset[line]
        base = offset * _left_of(along)
        lower, upper = self.lower[line, place], self.upper[line, place]
        return Grasp(
            patch=base + (self.start[line] + lower) / 2 * along,
            approach=float(np.arctan2(along[1], along[0])),
            opening=self.gripper.opening,
            tip=base + (self.start[line] + place * _STEP) * along,
            height=float(self.height[line, place]),
            length=float(lower - upper),
            force=float(self.force[line, place]),
        )


def grasp_lines(
    grid: CellGrid,
    heights: FloatArray,
    centers_of_mass: FloatArray,
    masses: FloatArray,
    probability: FloatArray,
    settings: GoalSettings,
    gripper: Gripper,
) -> GraspLines:
    """Grasps from 48 directions on lines 5 mm apart; `GraspLines` lists the checks.

    Args:
        heights: (n,) of the object's top over each cell, m.
        centers_of_mass: (K, 2) of the hypotheses, object frame, m.
        masses: (K,) of the whole object, kg.
        probability: (K,) of the hypotheses.

    Returns:
        Lines on which some grasp passes the checks; perhaps none.
    """
    field = HeightMap.of(grid, heights)
    hand = field.highest_within(gripper.hand_radius + settings.clearance)
    passed = field.highest_within(gripper.finger_radius + settings.clearance)
    direction, offset, first = _all_lines(grid, hand_margin=gripper.hand_radius + settings.clearance)
    extent = float(np.ptp(grid.exterior, axis=0).sum()) + gripper.hand_radius + settings.clearance
    along = first[:, None] + _STEP * np.arange(int((extent + gripper.finger_length) / _STEP) + 2)
    normal = _left_of(direction)
    points = direction[:, None] * along[..., None] + (normal * offset[:, None])[:, None]

    lowest = field.sampled(field.lowest, points)
    inside = lowest > 0
    firm = inside.copy()
    for side in (-_BESIDE, _BESIDE):
        firm &= field.sampled(field.lowest, points + side * normal[:, None]) > 0
    entered = np.argmax(inside, axis=1)
    met = inside[np.arange(len(inside)), entered]
    window = entered[:, None] + np.arange(int(gripper.finger_length / _STEP) + 1)

    def at_tip(values: NDArray) -> NDArray:
        return np.take_along_axis(values, window, axis=1)

    height = at_tip(np.maximum.accumulate(field.sampled(passed, points), axis=1))
    lower = at_tip(np.maximum.accumulate(np.where(firm, along, -np.inf), axis=1))
    upper = _outer_contact(at_tip(np.where(firm, lowest, 0.0)), at_tip(along), height - settings.tolerance)
    behind = window - int(gripper.hand_distance / _STEP)
    touched = np.maximum.accumulate(field.sampled(hand, points) > 0, axis=1)
    hand_free = (behind < 0) | ~np.take_along_axis(touched, np.maximum(behind, 0), axis=1)

    start = along[np.arange(len(along)), entered]
    arm = lower - upper
    good = met[:, None] & hand_free & (arm >= settings.least_contact)
    good &= lower - start[:, None] >= settings.least_contact
    good &= gripper.opening - 2 * gripper.finger_radius - height >= 2 * settings.clearance
    kept = good.any(axis=1)
    needed = _needed_force(
        arm[kept], lower[kept], start[kept], height[kept], direction[kept], offset[kept],
        centers_of_mass, masses, probability, settings,
    )  # fmt: skip
    force = np.where(good[kept] & (needed <= gripper.force), needed, np.inf)
    holds = np.isfinite(force).any(axis=1)
    kept[kept] = holds
    return GraspLines(
        direction[kept], offset[kept], start[kept], force[holds], height[kept], lower[kept], upper[kept],
        gripper, settings.clearance,
    )  # fmt: skip


def _all_lines(grid: CellGrid, hand_margin: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Direction (L, 2), offset (L,) and a coordinate (L,) before object and hand meet."""
    parts = []
    for angle in 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS:
        along = np.array([np.cos(angle), np.sin(angle)])
        across = grid.exterior @ np.array([-along[1], along[0]])
        count = max(1, int(np.ptp(across) / _APART))
        offset = across.min() + np.ptp(across) * (np.arange(count) + 0.5) / count
        first = (grid.exterior @ along).min() - hand_margin
        parts.append((np.tile(along, (count, 1)), offset, np.full(count, first)))
    direction, offset, first = (np.concatenate(part) for part in zip(*parts, strict=True))
    return direction, offset, first


def _outer_contact(heights: FloatArray, along: FloatArray, wanted: FloatArray) -> FloatArray:
    """(L, S) coordinate of the first place as high as `wanted` (L, S), up to each tip; inf if none is."""
    rising = np.maximum.accumulate(heights, axis=1)
    first = np.zeros(wanted.shape, dtype=np.intp)
    for column in rising.T:
        first += column[:, None] < wanted
    reached = first <= np.arange(wanted.shape[1])
    index = np.minimum(first, wanted.shape[1] - 1)
    return np.where(reached, np.take_along_axis(along, index, axis=1), np.inf)


def _needed_force(
    arm: FloatArray,
    lower: FloatArray,
    start: FloatArray,
    height: FloatArray,
    direction: FloatArray,
    offset: FloatArray,
    centers_of_mass: FloatArray,
    masses: FloatArray,
    probability: FloatArray,
    settings: GoalSettings,
) -> FloatArray:
    """(L, S) force of the lower pin, N, that suffices in hypotheses of total probability 1 - epsilon or more.

    A weight W at a lever l beyond the contact's inner end is held by a force W l / arm from above at the
    outer end; a weight at a distance d beside the line by friction at both pins, W d = friction · force ·
    height.
    """
    normal = _left_of(direction)
    needed = np.empty((len(masses), *arm.shape))
    with np.errstate(divide="ignore", invalid="ignore"):
        for k, (center, mass) in enumerate(zip(centers_of_mass, masses, strict=True)):
            at = (direction @ center)[:, None]
            beside = np.abs(normal @ center - offset)[:, None]
            lever = np.maximum(np.maximum(at - lower, start[:, None] - at), 0.0)
            force = GRAVITY * mass * (1.0 + lever / arm + beside / (settings.friction * height))
            needed[k] = np.where(arm > 0, force, np.inf)
    order = np.argsort(-needed, axis=0)
    weaker = np.cumsum(probability[order], axis=0) > settings.epsilon
    enough = np.take_along_axis(order, np.argmax(weaker, axis=0)[None], axis=0)
    return np.take_along_axis(needed, enough, axis=0)[0]


def _running_argmin(values: FloatArray) -> NDArray[np.intp]:
    """(L, S) index of the least value up to each column, the first of equal ones."""
    least = np.minimum.accumulate(values, axis=1)
    new = np.hstack([np.ones((len(values), 1), dtype=bool), least[:, 1:] < least[:, :-1]])
    return np.maximum.accumulate(np.where(new, np.arange(values.shape[1]), 0), axis=1)


def _left_of(direction: FloatArray) -> FloatArray:
    """(..., 2) unit vectors turned by 90 degrees to the left."""
    return np.stack([-direction[..., 1], direction[..., 0]], axis=-1)


def first_on_table(
    direction: FloatArray, offset: FloatArray, poses: FloatArray, table: Table, half_width: float
) -> FloatArray:
    """Where strips that extend in from far away first meet the table top.

    Args:
        direction: (L, 2) unit vectors of their direction, object frame.
        offset: (L,) of the strips' middle lines to the left of the object's origin, m.
        poses: (P, 3) of the object in the world, m and rad.
        half_width: of the strips, m.

    Returns:
        (P, L) coordinate along each line, from the point nearest to the object's origin, m; inf where the
        strip misses the table.
    """
    corners = corners_of(table)
    if len(corners) > 0:
        return _first_in_strip(*_on_lines(direction, offset, poses, corners), half_width)
    assert table.radius is not None  # see corners_of
    along, left = _on_lines(direction, offset, poses, np.array([table.center]))
    beside = np.maximum(np.abs(left[..., 0]) - half_width, 0.0)
    square = table.radius**2 - beside**2
    return np.asarray(np.where(square > 0, along[..., 0] - np.sqrt(np.maximum(square, 0.0)), np.inf))


def towards_table(
    direction: FloatArray, offset: FloatArray, at: FloatArray, poses: FloatArray, table: Table
) -> FloatArray:
    """Cosine between each line and the shortest path to the table from a point on it, outside the table.

    Args:
        direction: (L, 2) unit vectors along the lines, object frame.
        offset: (L,) of the lines to the left of the object's origin, m.
        at: (L,) coordinate of the point along its line, m.
        poses: (P, 3) of the object in the world, m and rad.

    Returns:
        (P, L).
    """
    if table.shape == "round":
        along, left = _on_lines(direction, offset, poses, np.array([table.center]))
        ahead = along[..., 0] - at
        return np.asarray(ahead / np.maximum(np.hypot(ahead, left[..., 0]), 1e-9))
    angle = poses[:, 2:]
    points = at[:, None] * direction + offset[:, None] * _left_of(direction)
    away = rotated(points, angle) + poses[:, None, :2] - np.asarray(table.center)
    half = np.asarray(table.size) / 2
    to_table = np.clip(away, -half, half) - away
    ahead = (to_table * rotated(direction, angle)).sum(axis=-1)
    return np.asarray(ahead / np.maximum(np.hypot(to_table[..., 0], to_table[..., 1]), 1e-9))


def _on_lines(
    direction: FloatArray, offset: FloatArray, poses: FloatArray, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """World points (c, 2) along (P, L, c) and to the left of (P, L, c) each line."""
    x, y = np.moveaxis(seen_from(points, poses[:, None])[:, None], -1, 0)
    ux, uy = direction[:, :1], direction[:, 1:]
    return x * ux + y * uy, y * ux - x * uy - offset[:, None]


def _first_in_strip(along: FloatArray, left: FloatArray, half_width: float) -> FloatArray:
    """Smallest coordinate of a polygon (..., c) within |left| <= half_width; inf if it lies outside."""
    next_along, next_left = np.roll(along, -1, axis=-1), np.roll(left, -1, axis=-1)
    found = np.where(np.abs(left) <= half_width, along, np.inf).min(axis=-1)
    for side in (-half_width, half_width):
        crosses = (left > side) != (next_left > side)
        share = np.where(crosses, (side - left) / np.where(crosses, next_left - left, 1.0), 0.0)
        there = np.where(crosses, along + share * (next_along - along), np.inf)
        found = np.minimum(found, there.min(axis=-1))
    return np.asarray(found)
