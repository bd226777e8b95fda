"""The arm's motions for a push, a grasp at the table's edge and the way home, planned before they start."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import pairwise

import numpy as np
from pydrake.trajectories import PiecewisePolynomial, Trajectory

from slipmap.diagrams.execution.arm_motion import (
    FingerKinematics,
    MotionRefused,
    OutOfReach,
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
from slipmap.diagrams.execution.clearance import ArmClearance, Obstacle, Surroundings
from slipmap.diagrams.execution.requests import ActiveGrasp, ExecutionConfig
from slipmap.diagrams.station.arm import HOME, arm_model
from slipmap.models.geometry import angle_between
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import ACCELERATION_LIMITS, FINGER_RADIUS, GRIP_FORCE, POSITION_LIMITS
from slipmap.planners.table_push import TablePush

CLEAR = 0.01  # distance that the arm keeps from everything on its way to the object, m
CLOSE = 0.003
"""Distance that the open gripper keeps from the table, and the arm from the object, during a grasp, m."""
LIFT = 0.10  # height to which the object is lifted, m

ARCH = np.array([0.0, 0.0, 0.8, 0.0, 0.0, 0.0, 0.0])
"""(7,) rad; scaled by one of `_ARCHES` and added half-way to or from a push, it raises the finger."""
TURNS = np.deg2rad([-30.0, 0.0, -60.0, 30.0, -90.0, 120.0, -120.0, 60.0, 90.0])
"""Rotations of the hand about the finger, rad, that are tried until the hand can keep its direction along a
push and nothing is too close to the arm. Of the first `_COMPARED`, the one that is easiest on the
joints is taken."""
_COMPARED = 4
_EASY = 0.2
"""s that a joint may need for braking within the limit of its acceleration, for each m/s of the finger: at
0.1 m/s it then brakes gently after a fault."""

_ARCHES = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25)
_SAG = 0.02  # m by which the gripper may drop below the safe height between home and push

# The finger's end, both ends of the hand, and the wrist: (3, 4) in T and (4,) radii, m.
_LOW_BALLS = np.array([[0.0, 0.0, 0.0], [0.0, 0.06, -0.16], [0.0, -0.06, -0.16], [0.0, -0.226, -0.158]]).T
_LOW_RADII = np.array([0.0, 0.04, 0.04, 0.076])

# Distance (m) and speed (m/s) of the finger's retreat before it is lifted. A finger that still presses on the
# object can drag it up and away: with compliant fingers, a box by 3 to 23 mm.
_RELEASE, _RELEASE_SPEED = 0.005, 0.05

_REST = 0.5  # s; duration of the final phase, after which the arm stays in place
_BACK = (0.06, 0.09, 0.12, 0.16, 0.2)  # m; distances from the object from which the gripper may come in
_SEARCHES = np.random.default_rng(11).uniform(-0.8, 0.8, (24, 7)) * POSITION_LIMITS

_Inverse = Callable[[FloatArray, FloatArray | None], FloatArray]
# joint angles (7,) for the finger's end at a point (3,), near given ones if any, or OutOfReach


@dataclass(frozen=True, eq=False)
class ArmPlanner:
    """Plans the arm's motions."""

    kinematics: FingerKinematics
    config: ExecutionConfig
    home: FloatArray  # (7,) joint angles at which it rests between pushes, rad

    def push(
        self,
        push: TablePush,
        q: FloatArray,
        surroundings: Surroundings | None = None,
        *,
        any_will_do: bool = False,
    ) -> Plan:
        """Plan a push: approach, lower, push, rest, retreat slightly, lift and return home.

        The hand keeps its direction while it pushes: a round finger that turns with the hand rolls along the
        object, and pushes are chosen for one that does not. The hand turns on the way only where the arm
        cannot do otherwise, as on some long lines across the table.

        From `default_arm_base`, 60 of 60 random pushes between points within 0.36 m of W's origin can be made
        at 0.1 m/s, and 57 of 60 within 0.45 m; the others are close under the shoulder. Planning takes 0.1 to
        0.3 s, and up to 0.6 s if the arm would come too close to its surroundings: the forearm, whose lower
        side is 6 to 9 cm above the table, then leans to another side.

        Args:
            q: (7,) joint angles at which the arm rests now, rad, with the finger above everything on the
                table.
            surroundings: what the arm keeps away from; nothing if None.
            any_will_do: take the first plan that is found, instead of one that is easy on the joints.

        Raises:
            MotionRefused: a point out of reach, a joint limit in the way, too fast for a joint or the finger,
                or too close to the object, the table or the arm itself.
        """
        limit = self.config.push_speed_limit
        if push.speed > limit:
            raise MotionRefused(
                f"{push.speed:g} m/s is faster than the finger may push, at most {limit:g} m/s"
            )

        def tried(posture: _Inverse) -> Plan:
            plan = self._push_held(posture, push, q)
            if surroundings is not None:
                surroundings.check(plan, push)
            return plan

        easiest: tuple[float, Plan] | None = None
        for count, posture in enumerate(self._steady(push)):
            if easiest is not None and count >= _COMPARED:
                break
            with suppress(MotionRefused):
                plan = tried(posture)
                haste = _haste(plan, push)
                if haste <= 1.0 or any_will_do:
                    return plan
                if easiest is None or haste < easiest[0]:
                    easiest = haste, plan
        return tried(self.kinematics.inverse) if easiest is None else easiest[1]

    def _steady(self, push: TablePush) -> Iterator[_Inverse]:
        """Postures between which the hand does not turn: by each of `TURNS` from halfway between the
        directions that are best at both ends.

        Raises:
            OutOfReach: an end of the push is.
        """
        begin, end = (
            self.kinematics.yaw(self.kinematics.inverse(np.array([*point, self.config.tip_height])))
            for point in (push.begin, push.end)
        )
        middle = begin + angle_between(end, begin) / 2.0
        for turn in TURNS:
            yield partial(self.kinematics.inverse, yaw=middle + turn)

    def retreat(self, q: FloatArray, speed: FloatArray) -> Plan:
        """Plan to stop, lift the finger if it is low, and go home.

        Args:
            q: (7,) joint angles now, rad.
            speed: (7,) joint speeds now, rad/s.
        """
        phases = [braking(q, speed)]
        q = phases[0].value(phases[0].end_time())[:, 0]
        tip = self.kinematics.pose(q).translation()
        if tip[2] < self.config.safe_height:
            try:
                up = follow(
                    self.kinematics.inverse, tip, np.array([tip[0], tip[1], self.config.safe_height]), q
                )
            except MotionRefused:
                pass  # not pointing down, or at the edge of the reach: the way home raises it anyway
            else:
                up[0] = q
                phases.append(self._along(up, self.config.lowering_speed))
                q = up[-1]
        if np.abs(self.home - q).max() > 1e-6:
            phases.append(smooth(self._arch(q, self.home)[0], self.kinematics, self.config.transit_speed))
        return Plan(tuple(Phase("retreating", phase) for phase in phases))

    def grasp(self, clearance: ArmClearance, grasp: ActiveGrasp, q: FloatArray) -> Plan:
        """Plan a grasp: reach around the table, come in level with open pins, close, lift, and hold.

        Args:
            q: (7,) joint angles at which the arm rests now, rad.

        Raises:
            MotionRefused: the hand cannot be held there, or no path to it is found. The text says why.
        """
        place = _GraspPlace(self.kinematics, clearance, grasp)
        opening = grasp.grasp.opening
        refusals = []
        for posture in sorted(place.postures(q), key=lambda posture: float(np.abs(posture - q).max())):
            try:
                comes, lifts = place.lines(posture)
                way = find_way(q, comes[0], lambda at: clearance.of(at, opening, place.obstacle) > CLEAR)
            except MotionRefused as refusal:
                refusals.append(refusal)
                continue
            ways = [self._along(np.array(leg), self.config.transit_speed) for leg in pairwise(way)]
            coming, lifting = (self._along(line, self.config.grasping_speed) for line in (comes, lifts))
            return Plan(
                (
                    Phase("reaching", ways[0], opening),
                    *(Phase("reaching", leg, opening, opening) for leg in (*ways[1:], coming)),
                    Phase("closing", _still(posture, self.config.closing), 0.0, opening, GRIP_FORCE),
                    Phase("lifting", lifting, force=GRIP_FORCE),
                    Phase("holding", _still(lifts[-1], _REST), force=GRIP_FORCE),
                )
            )
        if refusals:
            raise refusals[0]
        x, y, z = place.tip
        raise MotionRefused(
            f"the gripper cannot be held level at ({x:.3f}, {y:.3f}) m, {z:.3f} m high, pointing to "
            f"{np.rad2deg(place.yaw):.0f} degrees: this is out of the arm's reach"
        )

    def _push_held(self, posture: _Inverse, push: TablePush, q: FloatArray) -> Plan:
        config = self.config
        lift = np.array([0.0, 0.0, config.safe_height - config.tip_height])
        begin, end = (np.array([*point, config.tip_height]) for point in (push.begin, push.end))
        line, pushing = self._pushing(posture, push, begin, end)
        down = follow(posture, begin, begin + lift, line[0])[::-1]
        off = end - np.array([*(_RELEASE * push.direction), 0.0])
        back = follow(posture, end, off, line[-1])
        up = follow(posture, off, off + lift, back[-1])
        return Plan(
            (
                Phase("approaching", self._way(q, down[0])),
                Phase("lowering", self._along(down, config.lowering_speed)),
                Phase("pushing", pushing),
                Phase("retreating", self._along(back, _RELEASE_SPEED)),
                Phase("retreating", self._along(up, config.lowering_speed)),
                Phase("retreating", self._way(up[-1], self.home)),
            )
        )

    def _pushing(
        self, posture: _Inverse, push: TablePush, begin: FloatArray, end: FloatArray
    ) -> tuple[FloatArray, Trajectory]:
        """Joint angles (m, 7) along the line, and the motion along it.

        The best posture at one end may not be possible up to the other, so both ends are tried as the start.
        """
        refusals = []
        for first, last, order in ((begin, end, 1), (end, begin, -1)):
            try:
                line = follow(posture, first, last, posture(first, None))[::order]
                pace = push.pace(self.config.speeding_up, self.config.slowing_down)
                motion = paced(joint_path(line), pace, self.config.settle)
                check_joints(motion)
                return line, motion
            except MotionRefused as refusal:
                refusals.append(refusal)
        raise max(refusals, key=lambda refusal: isinstance(refusal, OutOfReach))

    def _way(self, q: FloatArray, goal: FloatArray) -> Trajectory:
        config = self.config
        path, lowest = self._arch(q, goal)
        if lowest < config.safe_height - _SAG:
            raise MotionRefused(
                f"between the push and the home posture the gripper would come down to {lowest:.3f} m, "
                f"at least {config.safe_height - _SAG:.3f} m are safe"
            )
        return smooth(path, self.kinematics, config.transit_speed)

    def _along(self, knots: FloatArray, tip_speed: float) -> Trajectory:
        return smooth(joint_path(knots), self.kinematics, tip_speed)

    def _arch(self, q: FloatArray, goal: FloatArray) -> tuple[Trajectory, float]:
        """The flattest arch between two postures that is high enough, else the highest one, and its lowest
        point."""
        highest: tuple[Trajectory, float] | None = None
        for share in _ARCHES:
            knots = np.column_stack([q, (q + goal) / 2.0 + share * ARCH, goal])
            path = PiecewisePolynomial.LagrangeInterpolatingPolynomial([0.0, 0.5, 1.0], knots)
            postures = path.vector_values(np.linspace(0.0, 1.0, 21)).T
            balls = [(self.kinematics.pose(posture) @ _LOW_BALLS)[2] for posture in postures]
            lowest = float((balls - _LOW_RADII).min())
            inside = (np.abs(postures) <= POSITION_LIMITS).all()
            if highest is None or (inside and lowest > highest[1]):
                highest = path, lowest
            if highest[1] > self.config.safe_height - _SAG:
                break
        assert highest is not None
        return highest


class _GraspPlace:
    """The gripper's place at a grasp, and the paths to it."""

    def __init__(self, kinematics: FingerKinematics, clearance: ArmClearance, grasp: ActiveGrasp) -> None:
        self._kinematics, self._clearance, self._grasp = kinematics, clearance, grasp.grasp
        self.obstacle = Obstacle(grasp.grid, grasp.heights, grasp.pose)
        *tip, self.yaw = grasp.grasp.at(grasp.pose)
        self.tip = np.array(tip)

    def postures(self, q: FloatArray) -> Iterator[FloatArray]:
        """Joint angles (7,) for the gripper at the object, as found; the first search starts at q."""
        found: list[FloatArray] = []
        for start in (q, *_SEARCHES):
            try:
                posture = self._level(self.tip, start)
            except OutOfReach:
                continue
            if all(np.abs(posture - other).max() > 0.1 for other in found):
                found.append(posture)
                yield posture

    def lines(self, posture: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Joint angles (m, 7) of the straight paths in, from where the open gripper is clear, and up.

        Raises:
            MotionRefused: out of reach, or too close to something.
        """
        outward = -np.array([np.cos(self.yaw), np.sin(self.yaw), 0.0])
        for back in _BACK:
            comes = follow(self._level, self.tip, self.tip + back * outward, posture)[::-1]
            if self._clearance.of(comes[0], self._grasp.opening, self.obstacle) > CLEAR:
                break
        else:
            raise MotionRefused(
                f"the open gripper still touches the object {1e3 * _BACK[-1]:.0f} mm back from it"
            )
        self._check(comes, self._grasp.opening, "coming in")
        lifts = follow(self._level, self.tip, self.tip + np.array([0.0, 0.0, LIFT]), posture)
        self._check(lifts, self._grasp.height + 2 * FINGER_RADIUS, "lifting")
        return comes, lifts

    def _level(self, point: FloatArray, near: FloatArray) -> FloatArray:
        return self._kinematics.level(point, self.yaw, near)

    def _check(self, line: FloatArray, opening: float, what: str) -> None:
        least = min(self._clearance.of(q, opening, self.obstacle, holding=True) for q in line)
        if least < CLOSE:
            raise MotionRefused(f"while {what} the arm would be {1e3 * least:.0f} mm from something")


def _haste(plan: Plan, push: TablePush) -> float:
    """How fast joints turn during a push, for the finger's speed; above 1 they brake hard after a fault."""
    (motion,) = (phase.trajectory for phase in plan.phases if phase.mode == "pushing")
    speeds = motion.MakeDerivative().vector_values(np.linspace(0.0, motion.end_time(), 50))
    braking_times = np.abs(speeds).max(axis=1) / ACCELERATION_LIMITS
    return float(braking_times.max()) / (_EASY * push.speed)


def _still(q: FloatArray, duration: float) -> Trajectory:
    return PiecewisePolynomial.ZeroOrderHold([0.0, duration], np.column_stack([q, q]))


@dataclass(frozen=True)
class ArmChecks:
    """Checks whether the arm can make a push or a grasp.

    It can be sent to another process: models of the arm are built on first use and cached.
    """

    models: str  # a key of `ARM_MODELS`
    table: Table
    config: ExecutionConfig

    def can_push(self, obstacle: Obstacle, push: TablePush) -> bool:
        """Whether the arm can push an object and return home."""
        planner = ArmPlanner(_kinematics(self.models), self.config, HOME)
        try:
            planner.push(push, HOME, Surroundings(_clearance(self.table), obstacle), any_will_do=True)
        except MotionRefused:
            return False
        return True

    def can_grasp(self, grasp: ActiveGrasp) -> bool:
        """Whether the gripper can come in straight and lift there; the path from home is not checked."""
        place = _GraspPlace(_kinematics(self.models), _clearance(self.table), grasp)
        for posture in place.postures(HOME):
            try:
                place.lines(posture)
            except MotionRefused:
                continue
            return True
        return False


@lru_cache(maxsize=2)
def _kinematics(models: str) -> FingerKinematics:
    return FingerKinematics(arm_model(models=models))


@lru_cache(maxsize=2)
def _clearance(table: Table) -> ArmClearance:
    return ArmClearance(table)
