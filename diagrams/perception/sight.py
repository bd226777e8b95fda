"""What the camera will see of an object that lies somewhere, past the resting arm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from slipmap.diagrams.systems.python_system import PythonSystem
from slipmap.models.perception.object_mask import Hull, draw_hulls
from slipmap.models.perception.pinhole_camera import PinholeCamera, View
from slipmap.models.perception.seen_object import SeenObject
from slipmap.models.physics.cell_grid import FloatArray


class Sight:
    """The camera's view of the table while the arm rests.

    Args:
        view: the camera at its place.
        hulls: around the arm where it rests, see `ArmHulls`.
    """

    def __init__(self, view: View, hulls: Sequence[Hull]) -> None:
        self._view = view
        self._hidden = draw_hulls(hulls, view)

    def share(self, seen: SeenObject, pose: FloatArray) -> float:
        """Share of an object's cells that are in the picture and not hidden, at a pose (3,), m and rad."""
        c, s = np.cos(pose[2]), np.sin(pose[2])
        places = pose[:2] + seen.grid.centers @ np.array([[c, s], [-s, c]])
        pixels, _ = self._view.project(np.column_stack([places, seen.cell_heights]))
        column, row = np.round(pixels).astype(int).T
        height, width = self._hidden.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        clear = ~self._hidden[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        return float((inside & clear).mean())


# Whether the arm is out of the camera's way to the object.


class ArmAside(PythonSystem):
    """Tells whether the whole object can be seen past the arm.

    .. pydrake_system::

        name: ArmAside
        input_ports:
        - arm_position
        - X_WC
        - object_pose
        - seen_object
        output_ports:
        - aside

    - `arm_position` (7,) rad; `X_WC`: of the camera; `object_pose`: `ObservedPose`; `seen_object`:
      `SeenObject | None`.
    - `aside`: bool, whether the arm hides no cell of the object where it was just seen; False while it is
      not seen.

    Args:
        camera: of the pictures.
        arm_hulls: hulls around the arm for joint angles (7,), rad, such as `ArmHulls`.
    """

    def __init__(self, camera: PinholeCamera, arm_hulls: Callable[[FloatArray], Sequence[Hull]]) -> None:
        super().__init__()
        self._camera, self._arm_hulls = camera, arm_hulls
        self._arm = self.DeclareVectorInputPort("arm_position", 7)
        self._X_WC = self.DeclareAbstractInputPort("X_WC", Value(RigidTransform()))
        self._pose = self.DeclareAbstractInputPort("object_pose", Value[object](None))
        self._seen = self.DeclareAbstractInputPort("seen_object", Value[object](None))
        self.DeclareAbstractOutputPort(
            "aside",
            lambda: Value[object](False),
            lambda context, output: output.set_value(self._aside(context)),
            {port.ticket() for port in (self._arm, self._X_WC, self._pose, self._seen)},
        )

    def _aside(self, context: Context) -> bool:
        pose, seen = self._pose.Eval(context), self._seen.Eval(context)
        if seen is None or not pose.valid:
            return False
        view = _view(self._camera, self._X_WC.Eval(context).GetAsMatrix4().tobytes())
        sight = Sight(view, self._arm_hulls(np.asarray(self._arm.Eval(context))))
        return sight.share(seen, pose.pose) == 1.0


@lru_cache(maxsize=4)
def _view(camera: PinholeCamera, X_WC: bytes) -> View:
    return View(camera, np.frombuffer(X_WC).reshape(4, 4))
