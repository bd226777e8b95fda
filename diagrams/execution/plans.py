"""The arm's motion for a push, planned as a whole before anything moves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import pairwise

import numpy as np
from pydrake.math import RigidTransform
from pydrake.trajectories import PiecewisePolynomial, Trajectory

from slipmap.diagrams.execution.clearance import ArmClearance, Obstacle, Surroundings
from slipmap.diagrams.execution.finger_kinematics import FingerKinematics, OutOfReach
from slipmap.diagrams.execution.motion import (
    MotionRefused,
    Phase,
    Plan,
    braking,
    check_joints,
    find_way,
    follow,
    joint_path,
    paced,
    smooth,
)
from slipmap.diagrams.execution.requests import ActiveGrasp
from slipmap.diagrams.execution.settings import ExecutionConfig
from slipmap.diagrams.station.arm import HOME, arm_model
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import FINGER_RADIUS, GRIP_FORCE, POSITION_LIMITS
from slipmap.planners.table_push import TablePush

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


# The arm's motion for a grasp at the table's edge, planned as a whole before anything moves.


CLEAR = 0.01
"""Distance that the arm keeps on its way to the object, m."""
CLOSE = 0.003
"""Distance that the open gripper keeps from the table, and the arm from the object, while it grasps, m."""
LIFT = 0.10
"""Height to which the object is lifted, m."""

_REST = 0.5  # s, after which the arm stays where it is
_BACK = (0.06, 0.09, 0.12, 0.16, 0.2)  # m, by which the gripper may stand back before it comes in
_STARTS = 24
_SEARCHES = np.random.default_rng(11).uniform(-0.8, 0.8, (_STARTS, 7)) * POSITION_LIMITS


def plan_grasp(
    kinematics: FingerKinematics,
    clearance: ArmClearance,
    grasp: ActiveGrasp,
    q: FloatArray,
    config: ExecutionConfig,
) -> Plan:
    """Reach around to a place outside the table, come in level with the pins open, close, lift, and hold.

    Args:
        kinematics: of the arm.
        clearance: of the arm at its table.
        grasp: what to do.
        q: (7,) where the arm rests now, rad.
        config: how it moves.

    Raises:
        MotionRefused: the hand cannot be held there, or there is no way to it. The text says why.
    """
    obstacle = Obstacle(grasp.grid, grasp.heights, grasp.pose)
    x, y, z, yaw = grasp.grasp.at(grasp.pose)
    tip, opening = np.array([x, y, z]), grasp.grasp.opening
    refusals = []
    for posture in _postures(kinematics, tip, yaw, q):
        try:
            comes, lifts = _lines(kinematics, clearance, tip, yaw, posture, obstacle, grasp)
            way = find_way(
                q, comes[0], lambda at: clearance.of(at, opening, obstacle) > CLEAR, "to the object"
            )
        except MotionRefused as refusal:
            refusals.append(refusal)
            continue
        ways = [smooth(joint_path(np.array(leg)), kinematics, config.transit_speed) for leg in pairwise(way)]
        coming, lifting = (
            smooth(joint_path(line), kinematics, config.grasping_speed) for line in (comes, lifts)
        )
        return Plan(
            (
                Phase("reaching", ways[0], opening),
                *(Phase("reaching", leg, opening, opening) for leg in (*ways[1:], coming)),
                Phase("closing", _still(posture, config.closing), 0.0, opening, GRIP_FORCE),
                Phase("lifting", lifting, force=GRIP_FORCE),
                Phase("holding", _still(lifts[-1], _REST), force=GRIP_FORCE),
            )
        )
    if refusals:
        raise refusals[0]
    raise MotionRefused(
        f"the gripper cannot be held level at ({x:.3f}, {y:.3f}) m, {z:.3f} m high, pointing to "
        f"{np.rad2deg(yaw):.0f} degrees: this is out of the arm's reach"
    )


def can_grasp(
    kinematics: FingerKinematics, clearance: ArmClearance, grasp: ActiveGrasp, q: FloatArray
) -> bool:
    """Whether the arm can come in straight and lift there; a way from q (7,), rad, is not looked for."""
    obstacle = Obstacle(grasp.grid, grasp.heights, grasp.pose)
    x, y, z, yaw = grasp.grasp.at(grasp.pose)
    tip = np.array([x, y, z])
    for posture in _each_posture(kinematics, tip, yaw, q):
        try:
            _lines(kinematics, clearance, tip, yaw, posture, obstacle, grasp)
        except MotionRefused:
            continue
        return True
    return False


def _postures(kinematics: FingerKinematics, tip: FloatArray, yaw: float, q: FloatArray) -> list[FloatArray]:
    """All ways (7,) found to hold the gripper at the object, the nearest to q first."""
    found = _each_posture(kinematics, tip, yaw, q)
    return sorted(found, key=lambda posture: float(np.abs(posture - q).max()))


def _each_posture(
    kinematics: FingerKinematics, tip: FloatArray, yaw: float, q: FloatArray
) -> Iterator[FloatArray]:
    """The same as they are found."""
    found: list[FloatArray] = []
    for start in (q, *_SEARCHES):
        try:
            posture = kinematics.level(tip, yaw, start)
        except OutOfReach:
            continue
        if all(np.abs(posture - other).max() > 0.1 for other in found):
            found.append(posture)
            yield posture


def _lines(
    kinematics: FingerKinematics,
    clearance: ArmClearance,
    tip: FloatArray,
    yaw: float,
    posture: FloatArray,
    obstacle: Obstacle,
    grasp: ActiveGrasp,
) -> tuple[FloatArray, FloatArray]:
    """Joint angles (m, 7) of the straight ways in, from where the open gripper is clear, and up.

    Raises:
        MotionRefused: out of reach, or too close to something.
    """

    def level(point: FloatArray, near: FloatArray) -> FloatArray:
        return kinematics.level(point, yaw, near)

    def check(line: FloatArray, opening: float, what: str) -> None:
        least = min(clearance.of(q, opening, obstacle, holding=True) for q in line)
        if least < CLOSE:
            raise MotionRefused(f"while {what} the arm would be {1e3 * least:.0f} mm from something")

    outward = -np.array([np.cos(yaw), np.sin(yaw), 0.0])
    for back in _BACK:
        comes = follow(level, tip, tip + back * outward, posture)[::-1]
        if clearance.of(comes[0], grasp.grasp.opening, obstacle) > CLEAR:
            break
    else:
        raise MotionRefused(f"{1e3 * _BACK[-1]:.0f} mm back from the object the open gripper is still at it")
    check(comes, grasp.grasp.opening, "coming in")
    lifts = follow(level, tip, tip + np.array([0.0, 0.0, LIFT]), posture)
    check(lifts, grasp.grasp.height + 2 * FINGER_RADIUS, "lifting")
    return comes, lifts


def _still(q: FloatArray, duration: float) -> Trajectory:
    return PiecewisePolynomial.ZeroOrderHold([0.0, duration], np.column_stack([q, q]))


# What the arm can do from its home posture, for those who plan.


@dataclass(frozen=True)
class ArmChecks:
    """Whether the arm can make a push, or a grasp.

    It can be sent to another process: models of the arm are built where they are first needed, and kept.

    Attributes:
        models: a key of `ARM_MODELS`.
        table: where the object lies.
        config: how the arm moves.
    """

    models: str
    table: Table
    config: ExecutionConfig

    def can_push(self, obstacle: Obstacle, push: TablePush) -> bool:
        """Whether the arm can make a push of an object, and come home."""
        around = Surroundings(_clearance(self.table), obstacle)
        try:
            plan_push(_kinematics(self.models), push, HOME, HOME, self.config, around)
        except MotionRefused:
            return False
        return True

    def can_grasp(self, grasp: ActiveGrasp) -> bool:
        """Whether the gripper can come in, close and lift."""
        return can_grasp(_kinematics(self.models), _clearance(self.table), grasp, HOME)


@lru_cache(maxsize=2)
def _kinematics(models: str) -> FingerKinematics:
    return FingerKinematics(arm_model(models=models))


@lru_cache(maxsize=2)
def _clearance(table: Table) -> ArmClearance:
    return ArmClearance(table)
