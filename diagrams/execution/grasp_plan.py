"""The arm's motion for a grasp at the table's edge, planned as a whole before anything moves."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from pydrake.trajectories import PiecewisePolynomial, Trajectory

from diagrams.execution.clearance import ArmClearance, Obstacle
from diagrams.execution.config import ExecutionConfig
from diagrams.execution.finger_kinematics import FingerKinematics, OutOfReach
from diagrams.execution.messages import ActiveGrasp
from diagrams.execution.motion import MotionRefused, Phase, Plan, follow
from diagrams.execution.trajectories import joint_path, smooth
from diagrams.execution.ways import find_way
from models.physics.cell_grid import FloatArray
from models.robots import FINGER_RADIUS, GRIP_FORCE, POSITION_LIMITS

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
