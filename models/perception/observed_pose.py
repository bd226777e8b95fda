"""What one picture says about where the object is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from models.perception.picture_check import Fault
from models.physics.cell_grid import FloatArray

Reason = Literal["", "no object", "occluded", "left the table"] | Fault


@dataclass(frozen=True, eq=False)
class ObservedPose:
    """Pose of the object frame O in W as seen in one picture, or why it could not be seen.

    Attributes:
        pose: (3,) x, y (m) and theta (rad) of O in W; NaN if not valid. Theta is continuous: it goes on from
            the last pose beyond ±pi.
        covariance: (3, 3) of the pose, m², m rad, rad²; NaN if not valid.
        valid: whether the object was seen.
        reason: empty, or why not: "no object" (none was seen yet, or what is seen is not it), "occluded" (the
            arm hides too much of it), "left the table", or what is wrong with the picture.
        time: at which the picture was taken, s.
    """

    pose: FloatArray
    covariance: FloatArray
    valid: bool
    reason: Reason = ""
    time: float = 0.0

    @staticmethod
    def unseen(reason: Reason, time: float = 0.0) -> ObservedPose:
        """No pose, for a reason."""
        return ObservedPose(np.full(3, np.nan), np.full((3, 3), np.nan), False, reason, time)
