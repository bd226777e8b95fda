"""Where the finger is and what force it exerts, from what the arm says, whoever drives it."""

from __future__ import annotations

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context

from diagrams.collectable import PythonSystem
from diagrams.execution.finger_kinematics import FingerKinematics
from diagrams.execution.tip_force import tip_force


class FingerSense(PythonSystem):
    """The finger's pose and force from joint angles and torques.

    .. pydrake_system::

        name: FingerSense
        input_ports:
        - iiwa.position_measured
        - iiwa.torque_external
        output_ports:
        - tip_pose
        - tip_force

    - `iiwa.position_measured` (7,) rad; `iiwa.torque_external` (7,) N m, of contact on the arm.
    - `tip_pose`: X_WT; `tip_force` (3,) N, of the finger on the object, in the world.

    Args:
        model: the arm as `diagrams.station.arm.arm_model` makes it.
    """

    def __init__(self, model: MultibodyPlant) -> None:
        super().__init__()
        self._kinematics = FingerKinematics(model)
        self._position = self.DeclareVectorInputPort("iiwa.position_measured", 7)
        self._torque = self.DeclareVectorInputPort("iiwa.torque_external", 7)
        position, torque = self._position.ticket(), self._torque.ticket()
        self.DeclareAbstractOutputPort(
            "tip_pose", lambda: Value(RigidTransform()), self._calc_pose, {position}
        )
        self.DeclareVectorOutputPort("tip_force", 3, self._calc_force, {position, torque})

    def _calc_pose(self, context: Context, output: Value) -> None:
        output.set_value(self._kinematics.pose(self._position.Eval(context)))

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        jacobian = self._kinematics.jacobian(self._position.Eval(context))
        output.SetFromVector(tip_force(jacobian, self._torque.Eval(context)))
