"""The arm at its table, seen from the side, for notebooks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform, RotationMatrix

from slipmap import Scenario, Station
from slipmap.diagrams.execution.arm_motion import FingerKinematics
from slipmap.diagrams.perception.camera import CameraConfig
from slipmap.diagrams.station.arm import arm_model
from slipmap.models.physics.cell_grid import FloatArray

_EYE, _TARGET = np.array([1.05, 0.65, 1.1]), np.array([-0.1, 0.0, 0.27])  # world, m


class Beside(CameraConfig):
    """A camera that looks at the arm and the table from the side."""

    @property
    def X_WC(self) -> RigidTransform:
        """Pose of the camera."""
        ahead = (_TARGET - _EYE) / np.linalg.norm(_TARGET - _EYE)
        right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
        return RigidTransform(RotationMatrix(np.column_stack([right, np.cross(ahead, right), ahead])), _EYE)


def picture_beside(scenario: Scenario, tip: ArrayLike) -> FloatArray:
    """Picture of the cell with the finger at a point, and the object where the scenario puts it.

    Args:
        scenario: the cell; its own camera is not used.
        tip: (2,) x and y of the finger's end, world, m.

    Returns:
        (height, width, 3) red, green and blue.

    Raises:
        MotionRefused: the arm does not reach this point.
    """
    camera = Beside(width=960, height_pixels=600, fov_y=0.84)
    station = Station(replace(scenario, camera=camera))
    point = np.array([*np.asarray(tip), scenario.execution.tip_height])
    posture = FingerKinematics(arm_model()).inverse(point)
    context = station.CreateDefaultContext()
    plant = station.plant
    plant.SetPositions(plant.GetMyMutableContextFromRoot(context), station.arm.iiwa, posture)
    return station.GetOutputPort("camera.rgb_image").Eval(context).data[..., :3]
