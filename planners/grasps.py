"""The grasp at the table's edge: one pin above, one below the part of the object that sticks out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.physics.cell_grid import FloatArray
from models.robots import (
    FINGER_LENGTH,
    FINGER_RADIUS,
    GRIP_FORCE,
    GRIPPER_OPENING,
    HAND_DISTANCE,
    HAND_RADIUS,
)


@dataclass(frozen=True)
class Gripper:
    """A parallel gripper of two round pins; by default the robot's own.

    Attributes:
        opening: largest distance between the axes of the pins, m.
        finger_radius: of a pin, m.
        finger_length: of a pin in front of the hand, m.
        hand_radius: half the hand's width across the closing direction, m.
        hand_distance: from the pins' ends back to the middle of the hand, m.
        force: largest force of a pin, N.
    """

    opening: float = GRIPPER_OPENING
    finger_radius: float = FINGER_RADIUS
    finger_length: float = FINGER_LENGTH
    hand_radius: float = HAND_RADIUS
    hand_distance: float = HAND_DISTANCE
    force: float = GRIP_FORCE


@dataclass(frozen=True, eq=False)
class Grasp:
    """A horizontal grasp from outside the table, the pins closing vertically, fully open until then.

    The hand comes on a straight line along `approach`, at half the height of the object's top, and stops with
    the pins' ends at `tip`. `GraspLines` states what is checked.

    Attributes:
        patch: (2,) middle of the line along which the lower pin supports the object, object frame, m.
        approach: direction in which the hand comes, from x of the object frame, rad.
        opening: distance between the axes of the pins until they close, m.
        tip: (2,) where the pins end, object frame, m.
        height: of the object's top between the pins, m.
        length: between the inner end of the lower contact and the outer end of the upper one, m: the arm at
            which two opposed forces carry the weight.
        force: of the lower pin, by which the object stays level with probability 1 - epsilon, N.
    """

    patch: FloatArray
    approach: float
    opening: float
    tip: FloatArray
    height: float
    length: float
    force: float

    def at(self, pose: FloatArray) -> FloatArray:
        """(4,) x, y, z (m) of the point half-way between the pins' ends and the approach's yaw (rad), world.

        Args:
            pose: (3,) of the object in the world, m and rad; the table's top is at z = 0.
        """
        c, s = np.cos(pose[2]), np.sin(pose[2])
        x, y = self.tip
        return np.array(
            [pose[0] + c * x - s * y, pose[1] + s * x + c * y, self.height / 2, pose[2] + self.approach]
        )
