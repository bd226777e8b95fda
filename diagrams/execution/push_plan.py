"""The arm's motion for a push, planned as a whole before anything moves."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from pydrake.math import RigidTransform
from pydrake.trajectories import PiecewisePolynomial, Trajectory

from diagrams.execution.config import ExecutionConfig
from diagrams.execution.finger_kinematics import FingerKinematics, OutOfReach
from diagrams.execution.motion import MotionRefused, Phase, Plan, check_joints, follow
from diagrams.execution.surroundings import Surroundings
from diagrams.execution.trajectories import braking, joint_path, paced, smooth
from models.physics.cell_grid import FloatArray
from models.robots import POSITION_LIMITS
from planners.table_push import TablePush

ARCH = np.array([0.0, 0.0, 0.8, 0.0, 0.0, 0.0, 0.0])
"""(7,) rad; times one of `ARCHES` and added to the middle of the way to or from a push, lifts the finger."""
ARCHES = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25)

SAG = 0.02
"""By which the gripper may be lower than the safe height between home and push, m."""

_LOW_BALLS = np.array([[0.0, 0.0, 0.0], [0.0, 0.06, -0.16], [0.0, -0.06, -0.16], [0.0, -0.226, -0.158]]).T
_LOW_RADII = np.array([0.0, 0.04, 0.04, 0.076])
# (3, 4) in T and (4,), m: the finger's end, both ends of the hand, the wrist

TURNS = np.deg2rad([-30.0, -60.0, -90.0, 30.0, 120.0, -120.0, 60.0, 90.0])
"""Of the hand about the finger, which are tried where the arm would come too near to something, rad."""

_Inverse = Callable[[FloatArray, FloatArray | None], FloatArray]
# joint angles (7,) for the finger's end at a point (3,), near given ones if any, or OutOfReach

RELEASE, RELEASE_SPEED = 0.005, 0.05
"""m and m/s by which the finger goes back before it is lifted. One that still presses on the object can drag
it up and away: with fingers that gave way, a box by 3 to 23 mm."""


def plan_push(
    kinematics: FingerKinematics,
    push: TablePush,
    q: FloatArray,
    home: FloatArray,
    config: ExecutionConfig,
    surroundings: Surroundings | None = None,
) -> Plan:
    """Approach, lower, push, rest, go back a little, lift and return home.

    From `default_arm_base` every push between points within 0.36 m of W's origin can be made at 0.1 m/s, as
    60 random ones showed, and 57 of 60 within 0.45 m; the others are close under the shoulder. Planning
    takes 50 ms, with surroundings 70, and up to 0.6 s where the hand must be turned. It is turned about the
    finger where the arm would come too near to what is around it: the forearm, whose lower side is 6 to 9 cm
    above the table, then leans to another side.

    Args:
        kinematics: of the arm.
        push: what to do.
        q: (7,) where the arm rests now, rad, with the finger higher than what stands on the table.
        home: (7,) where it shall rest afterwards, rad.
        config: how it moves.
        surroundings: what the arm keeps away from; nothing if None.

    Raises:
        MotionRefused: a point out of reach, a joint limit in the way, too fast for a joint or the finger, or
            too near to the object, the table or the arm itself.
    """
    if push.speed > config.push_speed_limit:
        raise MotionRefused(
            f"{push.speed:g} m/s is faster than the finger may push, at most {config.push_speed_limit:g} m/s"
        )
    straight = _push_held(kinematics.inverse, kinematics, push, q, home, config)
    if surroundings is None:
        return straight
    try:
        surroundings.check(straight, push)
        return straight
    except MotionRefused as refusal:
        too_near = refusal
    yaw = kinematics.yaw(straight.phases[1].trajectory.value(0.0)[:, 0])
    for turn in TURNS:
        turned = partial(kinematics.inverse, yaw=yaw + turn)
        try:
            plan = _push_held(turned, kinematics, push, q, home, config)
            surroundings.check(plan, push)
            return plan
        except MotionRefused:
            continue
    raise too_near


def _push_held(
    posture: _Inverse,
    kinematics: FingerKinematics,
    push: TablePush,
    q: FloatArray,
    home: FloatArray,
    config: ExecutionConfig,
) -> Plan:
    """The motion with the finger held in one way."""
    lift = np.array([0.0, 0.0, config.safe_height - config.tip_height])
    begin, end = (np.array([*point, config.tip_height]) for point in (push.begin, push.end))
    line, pushing = _pushing(posture, push, begin, end, config)
    down = follow(posture, begin, begin + lift, line[0])[::-1]
    off = end - np.array([*(RELEASE * push.direction), 0.0])
    back = follow(posture, end, off, line[-1])
    up = follow(posture, off, off + lift, back[-1])
    return Plan(
        (
            Phase("approaching", _way(kinematics, q, down[0], config)),
            Phase("lowering", smooth(joint_path(down), kinematics, config.lowering_speed)),
            Phase("pushing", pushing),
            Phase("retreating", smooth(joint_path(back), kinematics, RELEASE_SPEED)),
            Phase("retreating", smooth(joint_path(up), kinematics, config.lowering_speed)),
            Phase("retreating", _way(kinematics, up[-1], home, config)),
        )
    )


def plan_retreat(
    kinematics: FingerKinematics, q: FloatArray, speed: FloatArray, home: FloatArray, config: ExecutionConfig
) -> Plan:
    """Stop, lift the finger if it is low, and go home.

    Args:
        kinematics: of the arm.
        q: (7,) joint angles now, rad.
        speed: (7,) joint speeds now, rad/s.
        home: (7,) where to go, rad.
        config: how the arm moves.
    """
    phases = [braking(q, speed)]
    q = phases[0].value(phases[0].end_time())[:, 0]
    tip = kinematics.pose(q).translation()
    if tip[2] < config.safe_height:
        try:
            up = follow(kinematics.inverse, tip, np.array([tip[0], tip[1], config.safe_height]), q)
        except MotionRefused:
            pass  # not pointing down, or at the edge of the reach: the way home lifts it as well
        else:
            up[0] = q
            phases.append(smooth(joint_path(up), kinematics, config.lowering_speed))
            q = up[-1]
    if np.abs(home - q).max() > 1e-6:
        phases.append(smooth(_arch(kinematics, q, home, config)[0], kinematics, config.transit_speed))
    return Plan(tuple(Phase("retreating", phase) for phase in phases))


def _way(
    kinematics: FingerKinematics, q: FloatArray, goal: FloatArray, config: ExecutionConfig
) -> Trajectory:
    """From rest at q to rest at the goal, both (7,), rad.

    Raises:
        MotionRefused: the gripper would come lower than its safe height by more than `SAG`.
    """
    path, lowest = _arch(kinematics, q, goal, config)
    if lowest < config.safe_height - SAG:
        raise MotionRefused(
            f"between the push and the home posture the gripper would come down to {lowest:.3f} m, "
            f"at least {config.safe_height - SAG:.3f} m are safe"
        )
    return smooth(path, kinematics, config.transit_speed)


def _arch(
    kinematics: FingerKinematics, q: FloatArray, goal: FloatArray, config: ExecutionConfig
) -> tuple[Trajectory, float]:
    """The flattest arch between two postures that is high enough, else the highest; its lowest point, m."""
    highest: tuple[Trajectory, float] | None = None
    for share in ARCHES:
        knots = np.column_stack([q, (q + goal) / 2.0 + share * ARCH, goal])
        path = PiecewisePolynomial.LagrangeInterpolatingPolynomial([0.0, 0.5, 1.0], knots)
        postures = path.vector_values(np.linspace(0.0, 1.0, 21)).T
        lowest = min(_lowest(kinematics.pose(posture)) for posture in postures)
        inside = (np.abs(postures) <= POSITION_LIMITS).all()
        if highest is None or (inside and lowest > highest[1]):
            highest = path, lowest
        if highest[1] > config.safe_height - SAG:
            break
    assert highest is not None
    return highest


def _lowest(X_WT: RigidTransform) -> float:
    """Height of the lowest point of finger, hand and wrist, m."""
    return float(((X_WT @ _LOW_BALLS)[2] - _LOW_RADII).min())


def _pushing(
    posture: _Inverse, push: TablePush, begin: FloatArray, end: FloatArray, config: ExecutionConfig
) -> tuple[FloatArray, Trajectory]:
    """Joint angles (m, 7) along the line, and the motion along it.

    The posture that suits one end best need not last to the other, so both are tried.
    """
    refusals = []
    for first, last, order in ((begin, end, 1), (end, begin, -1)):
        try:
            try:
                start = posture(first, None)
            except OutOfReach as error:
                raise MotionRefused(str(error)) from error
            line = follow(posture, first, last, start)[::order]
            pace = push.pace(config.speeding_up, config.slowing_down)
            motion = paced(joint_path(line), pace, config.settle)
            check_joints(motion)
            return line, motion
        except MotionRefused as refusal:
            refusals.append(refusal)
    raise max(refusals, key=lambda refusal: isinstance(refusal.__cause__, OutOfReach))
