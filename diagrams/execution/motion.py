"""Motions of arm and gripper, phase by phase, and joint angles along straight lines of the finger."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydrake.trajectories import Trajectory

from diagrams.execution.finger_kinematics import OutOfReach
from diagrams.execution.trajectories import SPEED_SHARE
from models.physics.cell_grid import FloatArray
from models.robots import ACCELERATION_LIMITS, ARM_JOINTS, GRIP_FORCE, POSITION_LIMITS, SPEED_LIMITS

KNOT_DISTANCES = (0.01, 0.0025)
"""Of the points of a line at which the joint angles are computed, m; a spline joins them. The finer is tried
where the joints have to turn fast, as they do beside their limits."""

LARGEST_STEP = 0.2
"""Of a joint between two such points, rad; more would be another way of reaching the point."""

Posture = Callable[[FloatArray, FloatArray], FloatArray]
"""Joint angles (7,) for the finger's end at a point (3,) that lie close to given ones (7,), or OutOfReach."""


class MotionRefused(ValueError):
    """The arm cannot make this motion. The text says why."""


@dataclass(frozen=True, eq=False)
class Phase:
    """A part of the motion.

    Attributes:
        mode: see `ExecutionStatus`.
        trajectory: joint angles (7,), rad, over time from 0, s.
        opening: what the gripper is told at the end, m.
        opening_before: what it is told at the begin, from where it moves evenly, m.
        force: largest force of a pin, N.
    """

    mode: str
    trajectory: Trajectory
    opening: float = 0.0
    opening_before: float = 0.0
    force: float = GRIP_FORCE / 2

    @cached_property
    def duration(self) -> float:
        """In s."""
        return float(self.trajectory.end_time())

    def opening_at(self, time: float) -> float:
        """What the gripper is told at a time since the phase's begin, s."""
        share = min(time / self.duration, 1.0)
        return (1.0 - share) * self.opening_before + share * self.opening


@dataclass(frozen=True, eq=False)
class Plan:
    """Phases one after the other, from rest to rest."""

    phases: tuple[Phase, ...]

    @cached_property
    def duration(self) -> float:
        """In s."""
        return sum(phase.duration for phase in self.phases)

    def phase(self, time: float) -> tuple[Phase, float]:
        """The phase at a time since the plan's begin, s, and the time since its own; the last one lasts."""
        for phase in self.phases:
            if time < phase.duration:
                break
            time -= phase.duration
        else:
            time = phase.duration
        return phase, max(time, 0.0)

    def at(self, time: float) -> tuple[str, FloatArray]:
        """Mode and joint angles (7,) at a time since the plan's begin, s; rests at both ends."""
        phase, since = self.phase(time)
        return phase.mode, phase.trajectory.value(since)[:, 0]

    def motion(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Joint angles (7,) rad and speeds (7,) rad/s at a time since the plan's begin, s."""
        step = 1e-4
        q = self.at(time)[1]
        return q, (self.at(time + step)[1] - q) / step


def follow(posture: Posture, first: FloatArray, last: FloatArray, start: FloatArray) -> FloatArray:
    """Joint angles (m, 7) of the finger's end at points (3,) of a line, evenly spaced.

    Args:
        posture: how the finger is held at a point.
        first, last: (3,) ends of the line, m.
        start: (7,) joint angles at its first end, rad.

    Raises:
        MotionRefused: a point is out of reach, or only with a leap of the joints.
    """
    for distance in KNOT_DISTANCES:
        try:
            return _knots(posture, first, last, start, distance)
        except MotionRefused as refusal:
            refused = refusal
    raise refused


def _knots(
    posture: Posture, first: FloatArray, last: FloatArray, start: FloatArray, distance: float
) -> FloatArray:
    """See `follow`; the points are at most `distance` (m) apart."""
    pieces = max(int(np.ceil(np.linalg.norm(last - first) / distance)), 3)
    knots = [start]
    for share in np.linspace(0.0, 1.0, pieces + 1)[1:]:
        point = (1.0 - share) * first + share * last
        try:
            q = posture(point, knots[-1])
        except OutOfReach as error:
            raise MotionRefused(str(error)) from error
        leap = np.abs(q - knots[-1])
        if leap.max() > LARGEST_STEP:
            k = int(np.argmax(leap))
            raise MotionRefused(
                f"at ({point[0]:.3f}, {point[1]:.3f}) m {ARM_JOINTS[k]} would have to leap by "
                f"{np.rad2deg(leap[k]):.0f} degrees"
            )
        knots.append(q)
    return np.array(knots)


def check_joints(motion: Trajectory) -> None:
    """Refuse a motion that is too fast for a joint or passes a limit between its knots.

    Raises:
        MotionRefused: names the joint and the limit.
    """
    times = np.linspace(motion.start_time(), motion.end_time(), 200)
    derivative, second = motion.MakeDerivative(), motion.MakeDerivative(2)
    for what, values, limits, unit in (
        ("turn to", motion.vector_values(times), POSITION_LIMITS, "degrees"),
        ("turn at", derivative.vector_values(times), SPEED_SHARE * SPEED_LIMITS, "degrees a second"),
        ("speed up by", second.vector_values(times), ACCELERATION_LIMITS, "degrees a second squared"),
    ):
        largest = np.abs(values).max(axis=1)
        k = int(np.argmax(largest / limits))
        if largest[k] > limits[k]:
            raise MotionRefused(
                f"{ARM_JOINTS[k]} would have to {what} {np.rad2deg(largest[k]):.0f} {unit}, "
                f"of which {np.rad2deg(limits[k]):.0f} are allowed"
            )
