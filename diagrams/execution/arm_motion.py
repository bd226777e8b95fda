"""Motions of the arm: kinematics and force of the finger, joint angles along lines, and timing.

`Plan` is a complete motion in phases; `find_way` searches for a path around obstacles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ompl import base, geometric, util
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable
from pydrake.polynomial import Polynomial
from pydrake.solvers import Solve
from pydrake.trajectories import PathParameterizedTrajectory, PiecewisePolynomial, Trajectory

from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import (
    ACCELERATION_LIMITS,
    ARM_JOINTS,
    FINGER_LENGTH,
    GRIP_FORCE,
    POSITION_LIMITS,
    SPEED_LIMITS,
)
from slipmap.planners.table_push import Pace

WORKING_POSTURE = np.array([1.4, -0.8, -1.07, -1.38, 0.0, 1.41, -0.93])
"""(7,) rad; the finger points roughly down at the centre of the arm's reach from `default_arm_base`. The
elbow is to one side, at a height of at least 0.3 m; with the elbow above the hand, joint 6 would often be at
its limit."""

LIMIT_MARGIN = np.deg2rad(3.0)  # distance that the joints keep from their limits, rad
_TOLERANCE = 1e-6  # m, of the finger's position, and over the finger's length also of its direction
_SWIVELS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.6, 0.0, -0.6, 0.0, 0.0, 0.0, 0.0],
        [-0.6, 0.0, 0.6, 0.0, 0.0, 0.0, 0.0],
        [0.3, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        [-0.3, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
    ]
)
"""Rotations of the elbow about the line from shoulder to wrist, added to the working posture as starting
points of the search. At 60 random points, 16 random starting points found no posture nearer than these."""
_WEIGHTS = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.1])
_PULL = 0.1  # towards the working posture, per step along a line


class MotionRefused(ValueError):
    """The arm cannot make this motion. The text says why."""


class OutOfReach(MotionRefused):
    """The finger cannot be held at this point in the required direction."""


class FingerKinematics:
    """Forward and inverse kinematics of the finger's end T.

    Args:
        model: the arm, as built by `arm_model`: finalized, 7 positions, a frame `tip`.
    """

    def __init__(self, model: MultibodyPlant) -> None:
        self.model = model
        self.tip = model.GetFrameByName("tip")
        self._context = model.CreateDefaultContext()  # scratch: every method sets the positions it needs
        shoulder, elbow, wrist = (model.GetFrameByName(f"iiwa_link_{k}") for k in (2, 4, 6))
        origin = np.zeros(3)

        def place(frame: Frame, seen_from: Frame) -> FloatArray:
            return np.asarray(model.CalcPointsPositions(self._context, frame, origin, seen_from).ravel())

        # The axes of the last three joints meet at the wrist, those of the first three at the shoulder.
        self._p_WShoulder = place(shoulder, model.world_frame())
        self._p_TWrist = place(wrist, self.tip)
        self._upper_arm, self._forearm = (
            float(np.linalg.norm(place(*ends))) for ends in ((elbow, shoulder), (wrist, elbow))
        )

    def pose(self, q: FloatArray) -> RigidTransform:
        """X_WT at joint angles q (7,), rad."""
        self.model.SetPositions(self._context, q)
        return self.tip.CalcPoseInWorld(self._context)

    def jacobian(self, q: FloatArray) -> FloatArray:
        """(6, 7) angular, then linear velocity of T in the world per joint speed, rad/s and m/s."""
        self.model.SetPositions(self._context, q)
        world = self.model.world_frame()
        return np.asarray(
            self.model.CalcJacobianSpatialVelocity(
                self._context, JacobianWrtVariable.kQDot, self.tip, np.zeros(3), world, world
            )
        )

    def yaw(self, q: FloatArray) -> float:
        """Direction from the wrist to a finger that points down, at joint angles q (7,), rad."""
        y_WT = self.pose(q).rotation().matrix()[:, 1]
        return float(np.arctan2(y_WT[1], y_WT[0]))

    def inverse(
        self, p_WT: FloatArray, near: FloatArray | None = None, yaw: float | None = None
    ) -> FloatArray:
        """Joint angles (7,) with the finger's end at a point and the finger pointing down.

        Args:
            p_WT: (3,) required position of the finger's end, world, m.
            near: (7,) angles for a neighbouring point, rad: the solution is close to them. If None, it is the
                one nearest to `WORKING_POSTURE`.
            yaw: direction from the wrist to the finger, rad, kept within 0.5 degrees; any if None.

        Raises:
            OutOfReach: no such angles are found within the joints' limits and their margin.
        """
        largest = POSITION_LIMITS - LIMIT_MARGIN
        if near is None:
            goal, starts = WORKING_POSTURE, WORKING_POSTURE + _SWIVELS
        else:
            goal, starts = near + _PULL * (WORKING_POSTURE - near), np.atleast_2d(near)
        points = _pointing_down(p_WT)
        if yaw is not None:
            points.append(_turned(p_WT, yaw))
        found = [q for q in (self._search(points, start, goal, largest) for start in starts) if q is not None]
        if not found:
            raise OutOfReach(self._why_not(p_WT, starts[0]))
        return min(found, key=lambda q: float((q - goal) @ _WEIGHTS @ (q - goal)))

    def level(self, p_WT: FloatArray, yaw: float, near: FloatArray) -> FloatArray:
        """Joint angles (7,) with the finger level, the pins one above the other, and the flange on top.

        Args:
            p_WT: (3,) required position of the finger's end, world, m.
            yaw: required direction of the finger, rad.
            near: (7,) angles from which to search, rad: the solution is close to them.

        Raises:
            OutOfReach: no such angles are found within the joints' limits and their margin.
        """
        ahead, down = _ahead(yaw), np.array([0.0, 0.0, -1.0])
        q = None
        if self._arm_spans(p_WT + np.column_stack([np.cross(down, ahead), down, ahead]) @ self._p_TWrist):
            q = self._search(_held_level(p_WT, yaw), near, near, POSITION_LIMITS - LIMIT_MARGIN)
        if q is None:
            raise OutOfReach(
                f"the finger cannot be held level at ({p_WT[0]:.3f}, {p_WT[1]:.3f}) m, {p_WT[2]:.3f} m high, "
                f"pointing to {np.rad2deg(yaw):.0f} degrees"
            )
        return q

    def _arm_spans(self, p_WWrist: FloatArray) -> bool:
        """Whether the wrist can be there with some bend of the elbow; a failing search would take long."""
        distance = np.linalg.norm(p_WWrist - self._p_WShoulder)
        return bool(distance <= self._upper_arm + self._forearm)

    def _why_not(self, p_WT: FloatArray, start: FloatArray) -> str:
        place = f"the finger cannot point down at ({p_WT[0]:.3f}, {p_WT[1]:.3f}) m, {p_WT[2]:.3f} m high"
        q = self._search(_pointing_down(p_WT), start, WORKING_POSTURE, np.full(7, np.pi))
        largest = POSITION_LIMITS - LIMIT_MARGIN
        if q is None:
            return f"{place}: this is out of the arm's reach"
        k = int(np.argmax(np.abs(q) - largest))
        if abs(q[k]) <= largest[k]:
            return f"{place} from the posture before it"
        return (
            f"{place}: {ARM_JOINTS[k]} would have to turn to {np.rad2deg(q[k]):.0f} degrees; "
            f"{np.rad2deg(largest[k]):.0f} are allowed"
        )

    def _search(
        self, points: list[_Held], start: FloatArray, goal: FloatArray, largest: FloatArray
    ) -> FloatArray | None:
        """The angles within ±`largest` that are nearest to the goal; None if none are found."""
        problem = InverseKinematics(self.model, self._context, with_joint_limits=False)
        world, q = self.model.world_frame(), problem.q()
        for p_T, p_W, slack in points:
            problem.AddPositionConstraint(self.tip, p_T, world, p_W - slack, p_W + slack)
        program = problem.get_mutable_prog()
        program.AddBoundingBoxConstraint(-largest, largest, q)
        program.AddQuadraticErrorCost(_WEIGHTS, goal, q)
        program.SetInitialGuess(q, np.clip(start, -largest, largest))
        result = Solve(program)
        return np.asarray(result.GetSolution(q)) if result.is_success() else None


_Held = tuple[FloatArray, FloatArray, FloatArray]  # a point (3,) in T, its place in the world, and slack, m
_EXACT = np.full(3, _TOLERANCE)


def _pointing_down(p_WT: FloatArray) -> list[_Held]:
    """Constraints for a vertical finger: its end, and a second point of its axis above it."""
    up = np.array([0.0, 0.0, FINGER_LENGTH])
    return [(np.zeros(3), p_WT, _EXACT), (-up, p_WT + up, np.array([_TOLERANCE, _TOLERANCE, FINGER_LENGTH]))]


def _turned(p_WT: FloatArray, yaw: float) -> _Held:
    """A constraint on the side of the finger where the wrist is."""
    behind = FINGER_LENGTH * _ahead(yaw)
    return np.array([0.0, -FINGER_LENGTH, 0.0]), p_WT - behind, np.full(3, 0.005 * FINGER_LENGTH)


def _ahead(yaw: float) -> FloatArray:
    return np.array([np.cos(yaw), np.sin(yaw), 0.0])


def _held_level(p_WT: FloatArray, yaw: float) -> list[_Held]:
    down = np.array([0.0, 0.0, -1.0])
    return [
        (np.zeros(3), p_WT, _EXACT),
        (np.array([0.0, 0.0, -FINGER_LENGTH]), p_WT - FINGER_LENGTH * _ahead(yaw), _EXACT),
        (np.array([0.0, FINGER_LENGTH, 0.0]), p_WT + FINGER_LENGTH * down, _EXACT),
    ]


# Standard deviations of a joint's external torque, and of the contact force's moment about the finger's end,
# N m: 15 N act some cm above it.
_TORQUE_NOISE, _MOMENT_SPREAD = 0.1, 0.5

TORQUE_LAG = 0.009
"""s by which external torques lag behind the contact: 10 ms, the time constant of the driver's low-pass
filter, less half a step."""


def tip_force(jacobian: FloatArray, torque_external: FloatArray) -> FloatArray:
    """Force (3,) of the finger on the object, world, N.

    The torques are Jᵀ times the wrench on the finger. The height at which the object touches the finger is
    unknown, so a moment about its end is estimated along with the force, with a zero-mean Gaussian prior.

    In simulated pushes of a 1 kg box (5 N) at 0.1 m/s, the estimate agrees with the plant's contact force
    within 0.1 N on average and 0.3 to 0.6 N (rms) per sample, at steps of 1 to 5 ms, because the driver
    smooths the torques over 10 ms. The impact of first touch, up to 80 N for one or two steps, is smoothed
    likewise.

    Args:
        jacobian: (6, 7) angular, then linear velocity of the finger's end per joint speed, world.
        torque_external: (7,) joint torques caused by contact, N m.
    """
    rows = np.vstack([jacobian.T / _TORQUE_NOISE, np.eye(3, 6) / _MOMENT_SPREAD])
    sides = np.concatenate([torque_external / _TORQUE_NOISE, np.zeros(3)])
    wrench = np.linalg.lstsq(rows, sides, rcond=None)[0]
    return -wrench[3:]


Posture = Callable[[FloatArray, FloatArray], FloatArray]
"""Joint angles (7,) for the finger's end at a point (3,) that are close to given ones (7,), or OutOfReach."""

_SPEED_SHARE, _ACCELERATION_SHARE = 0.9, 0.6  # of the joints' limits, used by motions
_MINIMUM_JERK = Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])  # Flash and Hogan 1985

# m between the points of a line at which the joint angles are computed; a spline joins them. The finer
# spacing is tried if the joints must turn fast, as near their limits.
_KNOT_DISTANCES = (0.01, 0.0025)
_LARGEST_STEP = 0.2  # rad, of a joint between two of them; more means another branch of solutions


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
    """Time a path from rest to rest with a minimum-jerk profile, as fast as joints and finger are allowed.

    With s(t) = σ(t/T), speeds are q'σ'/T and accelerations (q''σ'² + q'σ'')/T², which gives the shortest T.

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
    """Time a path over [0, 1] at a given pace, followed by a rest.

    Args:
        path: of 7 joint angles, rad; equal steps of its parameter are equal distances of the finger.
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
    """Motion to rest with constant accelerations of the joints, within their limits.

    Args:
        q: (7,) joint angles at the start, rad.
        speed: (7,) joint speeds at the start, rad/s.
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
    opening: float = 0.0  # commanded opening of the gripper at the end, m
    opening_before: float = 0.0  # the same at the start; it changes linearly in between, m
    force: float = GRIP_FORCE / 2  # largest force of a pin, N

    @cached_property
    def duration(self) -> float:
        """Duration, s."""
        return float(self.trajectory.end_time())

    def opening_at(self, time: float) -> float:
        """Commanded opening at a time since the start of the phase (s), m."""
        share = min(time / self.duration, 1.0)
        return (1.0 - share) * self.opening_before + share * self.opening


@dataclass(frozen=True, eq=False)
class Plan:
    """Phases one after another, from rest to rest."""

    phases: tuple[Phase, ...]

    @cached_property
    def duration(self) -> float:
        """Duration, s."""
        return sum(phase.duration for phase in self.phases)

    def phase(self, time: float) -> tuple[Phase, float]:
        """The phase at a time since the start of the plan, s, and the time since its own start; at the end,
        the last one."""
        for phase in self.phases:
            if time < phase.duration:
                break
            time -= phase.duration
        else:
            time = phase.duration
        return phase, max(time, 0.0)

    def at(self, time: float) -> tuple[str, FloatArray]:
        """Mode and joint angles (7,) at a time since the start of the plan, s; at rest outside it."""
        phase, since = self.phase(time)
        return phase.mode, phase.trajectory.value(since)[:, 0]

    def motion(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Joint angles (7,) rad and speeds (7,) rad/s at a time since the start of the plan, s."""
        step = 1e-4
        q = self.at(time)[1]
        return q, (self.at(time + step)[1] - q) / step


def follow(posture: Posture, first: FloatArray, last: FloatArray, start: FloatArray) -> FloatArray:
    """Joint angles (m, 7) for the finger's end at evenly spaced points (3,) of a line.

    Args:
        posture: joint angles for the finger at a point.
        first, last: (3,) ends of the line, m.
        start: (7,) joint angles at its first end, rad.

    Raises:
        MotionRefused: a point is out of reach, or reached only with a jump of the joints.
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
                f"at ({point[0]:.3f}, {point[1]:.3f}) m {ARM_JOINTS[k]} would have to jump by "
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
        ("turn at", derivative.vector_values(times), _SPEED_SHARE * SPEED_LIMITS, "degrees per second"),
        ("speed up by", second.vector_values(times), ACCELERATION_LIMITS, "degrees per second squared"),
    ):
        largest = np.abs(values).max(axis=1)
        k = int(np.argmax(largest / limits))
        if largest[k] > limits[k]:
            raise MotionRefused(
                f"{ARM_JOINTS[k]} would have to {what} {np.rad2deg(largest[k]):.0f} {unit}; "
                f"{np.rad2deg(limits[k]):.0f} are allowed"
            )


def find_way(start: FloatArray, goal: FloatArray, is_clear: Callable[[FloatArray], bool]) -> FloatArray:
    """Vertices (m, 7) of a polyline of joint angles from start to goal, both included, by RRT-Connect.

    Args:
        start, goal: (7,) rad.
        is_clear: whether the arm may be at a posture (7,), rad.

    Raises:
        MotionRefused: none is found, or an end is not clear.
    """
    for q in (start, goal):
        if not is_clear(q):
            raise MotionRefused("no path to the object: the arm would be too close to something at one end")
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
    # Postures are checked every 0.06 rad, norm over all joints.
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
        raise MotionRefused("no path to the object was found around table, stand and object")
    path = setup.getSolutionPath()
    simplifier = geometric.PathSimplifier(information)
    simplifier.reduceVertices(path)
    simplifier.partialShortcutPath(path, 60)
    simplifier.reduceVertices(path)
    return np.array([_posture(state) for state in path.getStates()])


def _posture(state: base.State) -> FloatArray:
    return np.array([state[k] for k in range(7)])
