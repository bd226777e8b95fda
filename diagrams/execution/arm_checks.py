"""What the arm can do from its home posture, for those who plan."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from diagrams.execution.clearance import ArmClearance, Obstacle
from diagrams.execution.config import ExecutionConfig
from diagrams.execution.finger_kinematics import FingerKinematics
from diagrams.execution.grasp_plan import can_grasp
from diagrams.execution.messages import ActiveGrasp
from diagrams.execution.motion import MotionRefused
from diagrams.execution.push_plan import plan_push
from diagrams.execution.surroundings import Surroundings
from diagrams.station.arm import HOME, arm_model
from models.measurements.push_dataset import Table
from planners.table_push import TablePush


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
