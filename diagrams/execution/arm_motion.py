"""Motions of arm and gripper: joint angles along lines of the finger, and how fast to go along them.

`Plan` is a motion as a whole, phase by phase; `find_way` looks for a way around what stands in it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ompl import base, geometric, util
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PathParameterizedTrajectory, PiecewisePolynomial, Trajectory

from slipmap.diagrams.execution.finger_kinematics import FingerKinematics, MotionRefused
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import ACCELERATION_LIMITS, ARM_JOINTS, GRIP_FORCE, POSITION_LIMITS, SPEED_LIMITS
from slipmap.planners.table_push import Pace

Posture = Callable[[FloatArray, FloatArray], FloatArray]
"""Joint angles (7,) for the finger's end at a point (3,) that lie close to given ones (7,), or OutOfReach."""

_SPEED_SHARE, _ACCELERATION_SHARE = 0.9, 0.6  # of the joints' limits, that motions use
_MINIMUM_JERK = Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])  # Flash and Hogan 1985

# m between the points of a line at which the joint angles are computed; a spline joins them. The finer is
# tried where the joints have to turn fast, as they do beside their limits.
_KNOT_DISTANCES = (0.01, 0.0025)
_LARGEST_STEP = 0.2  # rad, of a joint between two of them; more would be another way of reaching the point


def joint_path(knots: FloatArray) -> PiecewisePolynomial:
    """Smooth path over [0, 1] through joint angles.

    Args:
        knots: (m, 7) angles, evenly spaced along the path, rad; m >= 2. Two are joined by a straight line.
    """
    breaks = np.linspace(0.0, 1.0, len(knots))
    if len(knots) < 4:
        return PiecewisePolynomial.FirstOrderHold(breaks, knots.T)
    return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
        breaks, knots.T, periodic_end_condition=False
    )


def smooth(path: Trajectory, kinematics: FingerKinematics, tip_speed: float) -> Trajectory:
    """Along a path from rest to rest with the minimum-jerk profile, as fast as joints and finger may.

    With s(t) = σ(t/T), speeds are q'σ'/T and accelerations (q''σ'² + q'σ'')/T²: this gives the shortest T.

    Args:
        path: of 7 joint angles over [0, 1], rad.
        tip_speed: largest speed of the finger's end, m/s.
    """
    shares = np.linspace(0.0, 1.0, 101)
    unit = PiecewisePolynomial([_MINIMUM_JERK], [0.0, 1.0])
    sigma, d_sigma, dd_sigma = (unit.MakeDerivative(order).vector_values(shares)[0] for order in range(3))
    q, dq, ddq = (path.MakeDerivative(order).vector_values(sigma) for order in range(3))
    speeds, accelerations = dq * d_sigma, ddq * d_sigma**2 + dq * dd_sigma
    tip_speeds = [np.linalg.norm(kinematics.jacobian(q[:, k])[3:] @ speeds[:, k]) for k in range(len(shares))]
    duration = max(
        (np.abs(speeds).max(axis=1) / (_SPEED_SHARE * SPEED_LIMITS)).max(),
        np.sqrt((np.abs(accelerations).max(axis=1) / (_ACCELERATION_SHARE * ACCELERATION_LIMITS)).max()),
        max(tip_speeds) / tip_speed,
    )
    unit.ScaleTime(duration)
    return PathParameterizedTrajectory(path, unit)


def paced(path: Trajectory, pace: Pace, rest: float) -> Trajectory:
    """Along a path over [0, 1] at a given pace, then a rest.

    Args:
        path: of 7 joint angles, rad; equal steps of its parameter are equal ways of the finger.
        pace: of the finger.
        rest: time at the end, s.
    """
    times, ways, speeds = (list(values) for values in (pace.times, pace.ways, pace.speeds))
    if rest > 1e-9:
        times, ways, speeds = [*times, times[-1] + rest], [*ways, ways[-1]], [*speeds, 0.0]
    share = PiecewisePolynomial.CubicHermite(
        times, np.array([ways]) / ways[-1], np.array([speeds]) / ways[-1]
    )
    return PathParameterizedTrajectory(path, share)


def braking(q: FloatArray, speed: FloatArray) -> Trajectory:
    """From motion to rest with constant accelerations of the joints, within their limits.

    Args:
        q: (7,) joint angles at the begin, rad.
        speed: (7,) joint speeds at the begin, rad/s.
    """
    duration = max(float((np.abs(speed) / (_ACCELERATION_SHARE * ACCELERATION_LIMITS)).max()), 0.01)
    return PiecewisePolynomial.CubicHermite(
        [0.0, duration],
        np.column_stack([q, q + speed * duration / 2.0]),
        np.column_stack([speed, np.zeros(7)]),
    )


@dataclass(frozen=True, eq=False)
class Phase:
    """A part of the motion."""

    mode: str  # see `ExecutionStatus`
    trajectory: Trajectory  # joint angles (7,), rad, over time from 0, s
    opening: float = 0.0  # of the gripper that is asked for at the end, m
    opening_before: float = 0.0  # the same at the begin, from where it moves evenly, m
    force: float = GRIP_FORCE / 2  # largest force of a pin, N

    @cached_property
    def duration(self) -> float:
        """In s."""
        return float(self.trajectory.end_time())

    def opening_at(self, time: float) -> float:
        """Opening that is asked for at a time since the phase's begin (s), m."""
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
    for distance in _KNOT_DISTANCES:
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
        q = posture(point, knots[-1])
        leap = np.abs(q - knots[-1])
        if leap.max() > _LARGEST_STEP:
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
        ("turn at", derivative.vector_values(times), _SPEED_SHARE * SPEED_LIMITS, "degrees a second"),
        ("speed up by", second.vector_values(times), ACCELERATION_LIMITS, "degrees a second squared"),
    ):
        largest = np.abs(values).max(axis=1)
        k = int(np.argmax(largest / limits))
        if largest[k] > limits[k]:
            raise MotionRefused(
                f"{ARM_JOINTS[k]} would have to {what} {np.rad2deg(largest[k]):.0f} {unit}, "
                f"of which {np.rad2deg(limits[k]):.0f} are allowed"
            )


def find_way(
    start: FloatArray, goal: FloatArray, is_clear: Callable[[FloatArray], bool], what: str
) -> FloatArray:
    """Corners (m, 7) of a polygon of joint angles from start to goal, both included, by RRT-Connect.

    Args:
        start, goal: (7,) rad.
        is_clear: whether the arm may be at a posture (7,), rad.
        what: the way, for the message.

    Raises:
        MotionRefused: none is found, or an end is not clear.
    """
    for q in (start, goal):
        if not is_clear(q):
            raise MotionRefused(f"no way {what}: the arm would be too close to something at its end")
    space = base.RealVectorStateSpace(7)
    bounds = base.RealVectorBounds(7)
    for k, limit in enumerate(POSITION_LIMITS):
        bounds.setLow(k, -float(limit))
        bounds.setHigh(k, float(limit))
    space.setBounds(bounds)
    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(7)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(lambda state: is_clear(_posture(state)))
    # Between the postures that are looked at: 0.06 rad, norm over all joints.
    information.setStateValidityCheckingResolution(0.06 / space.getMaximumExtent())
    information.setup()
    ends = [space.allocState() for _ in range(2)]
    for state, q in zip(ends, (start, goal), strict=True):
        for k in range(7):
            state[k] = float(q[k])
    if information.checkMotion(*ends):
        return np.array([start, goal])
    setup = geometric.SimpleSetup(information)
    setup.setStartAndGoalStates(*ends)
    planner = geometric.RRTConnect(information)
    planner.setRange(0.6)
    setup.setPlanner(planner)
    left = iter(range(500))
    setup.solve(base.PlannerTerminationCondition(lambda: next(left, None) is None))
    if not setup.haveExactSolutionPath():
        raise MotionRefused(f"no way {what} was found around table, stand and object")
    path = setup.getSolutionPath()
    simplifier = geometric.PathSimplifier(information)
    simplifier.reduceVertices(path)
    simplifier.partialShortcutPath(path, 60)
    simplifier.reduceVertices(path)
    return np.array([_posture(state) for state in path.getStates()])


def _posture(state: base.State) -> FloatArray:
    return np.array([state[k] for k in range(7)])
