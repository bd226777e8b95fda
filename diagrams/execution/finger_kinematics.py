"""Where the finger is, what it feels, and how the arm must stand for it to be somewhere, down or level."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable
from pydrake.solvers import Solve

from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.robots import ARM_JOINTS, FINGER_LENGTH, POSITION_LIMITS

WORKING_POSTURE = np.array([1.4, -0.8, -1.07, -1.38, 0.0, 1.41, -0.93])
"""(7,) rad; the finger points about down in the middle of what the arm reaches from `default_arm_base`. The
elbow is to one side, at a height of 0.3 m at least; above the hand, joint 6 would often be at its limit."""

LIMIT_MARGIN = np.deg2rad(3.0)
"""The joints keep this far from their limits, rad."""

_TOLERANCE = 1e-6  # m, of the finger's position; over the finger's length also of its direction
_SWIVELS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.6, 0.0, -0.6, 0.0, 0.0, 0.0, 0.0],
        [-0.6, 0.0, 0.6, 0.0, 0.0, 0.0, 0.0],
        [0.3, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        [-0.3, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
    ]
)
"""Turns of the elbow about the line from shoulder to wrist, added to the working posture as starts of the
search. At 60 random points 16 random starts found no posture nearer than these."""
_WEIGHTS = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.1])
_PULL = 0.1  # towards the working posture, per step along a line


class MotionRefused(ValueError):
    """The arm cannot make this motion. The text says why."""


class OutOfReach(MotionRefused):
    """The finger cannot be held there, pointing as it should."""


class FingerKinematics:
    """Forward and inverse kinematics of the finger's end T.

    Args:
        model: the arm as `arm_model` makes it: finalized, 7 positions, a frame `tip`.
    """

    def __init__(self, model: MultibodyPlant) -> None:
        self.model = model
        self.tip = model.GetFrameByName("tip")
        self._context = model.CreateDefaultContext()  # scratch: every method sets the positions it needs
        shoulder, elbow, wrist = (model.GetFrameByName(f"iiwa_link_{k}") for k in (2, 4, 6))
        origin = np.zeros(3)

        def place(frame: Frame, seen_from: Frame) -> FloatArray:
            return np.asarray(model.CalcPointsPositions(self._context, frame, origin, seen_from).ravel())

        # The axes of the last three joints meet in the wrist, those of the first three in the shoulder.
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
            p_WT: (3,) where the end of the finger shall be, world, m.
            near: (7,) angles of a neighbouring point to go on from, rad: the solution lies close to them. If
                None, of all ways to reach the point the one nearest to `WORKING_POSTURE` is taken.
            yaw: direction from the wrist to the finger, rad, kept within 8 degrees; any if None.

        Raises:
            OutOfReach: there are no such angles within the joints' limits and their margin.
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
        """Joint angles (7,) with the finger held level, the pins one above the other, and the flange on top.

        Args:
            p_WT: (3,) where the end of the finger shall be, world, m.
            yaw: direction in which the finger shall point, rad.
            near: (7,) angles from which to search, rad: the solution lies close to them.

        Raises:
            OutOfReach: the search finds none within the joints' limits and their margin.
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
        """Whether the wrist can be there with some bend of the elbow; a search takes long to say no."""
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
            f"{place}: {ARM_JOINTS[k]} would have to turn to {np.rad2deg(q[k]):.0f} degrees, "
            f"of which {np.rad2deg(largest[k]):.0f} are allowed"
        )

    def _search(
        self, points: list[_Held], start: FloatArray, goal: FloatArray, largest: FloatArray
    ) -> FloatArray | None:
        """Of the angles within ±`largest` those nearest to the goal; None if the search finds none."""
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


_Held = tuple[FloatArray, FloatArray, FloatArray]  # a point (3,) in T, where in the world, and slack there, m
_EXACT = np.full(3, _TOLERANCE)


def _pointing_down(p_WT: FloatArray) -> list[_Held]:
    """The finger is vertical when a second point of its axis is above its end."""
    up = np.array([0.0, 0.0, FINGER_LENGTH])
    return [(np.zeros(3), p_WT, _EXACT), (-up, p_WT + up, np.array([_TOLERANCE, _TOLERANCE, FINGER_LENGTH]))]


def _turned(p_WT: FloatArray, yaw: float) -> _Held:
    """The wrist's side of the finger."""
    behind = FINGER_LENGTH * _ahead(yaw)
    return np.array([0.0, -FINGER_LENGTH, 0.0]), p_WT - behind, np.full(3, 0.1 * FINGER_LENGTH)


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


def tip_force(jacobian: FloatArray, torque_external: FloatArray) -> FloatArray:
    """Force (3,) of the finger on the object, world, N.

    The torques are Jᵀ times the wrench on the finger. How high the object touches the finger is not known, so
    a moment about its end is estimated along with the force, under a Gaussian prior of mean zero.

    In simulated pushes of a 1 kg box (5 N) at 0.1 m/s the estimate is the plant's contact force within 0.1 N
    on average and 0.3 to 0.6 N (rms) in each sample, at steps of 1 to 5 ms: the driver smooths the torques
    over 10 ms. The blow of first touch, up to 80 N for a step or two, comes out smoothed likewise.

    Args:
        jacobian: (6, 7) angular, then linear velocity of the finger's end per joint speed, world.
        torque_external: (7,) joint torques caused by contact, N m.
    """
    rows = np.vstack([jacobian.T / _TORQUE_NOISE, np.eye(3, 6) / _MOMENT_SPREAD])
    sides = np.concatenate([torque_external / _TORQUE_NOISE, np.zeros(3)])
    wrench = np.linalg.lstsq(rows, sides, rcond=None)[0]
    return -wrench[3:]
