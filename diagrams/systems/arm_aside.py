"""Whether the arm is out of the camera's way to the object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from diagrams.collectable import PythonSystem
from diagrams.perception.sight import Sight
from models.perception.arm_mask import Hull
from models.perception.camera import PinholeCamera, View
from models.physics.cell_grid import FloatArray


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
