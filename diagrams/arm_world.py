"""The station as a world to plan in: the arm pushes, the camera looks, the gripper takes the object."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from diagrams.execution import ActivePush, ExecutionStatus
from diagrams.execution.clearance import ArmClearance
from diagrams.execution.finger_kinematics import FingerKinematics
from diagrams.execution.grasp_plan import can_grasp
from diagrams.execution.messages import ActiveGrasp
from diagrams.execution.motion import MotionRefused
from diagrams.execution.push_executor import PushExecutor
from diagrams.execution.push_plan import plan_push
from diagrams.perception.cell_perception import CellPerception
from diagrams.station.arm import HOME, arm_model
from diagrams.station.scenario import Scenario
from diagrams.station.station import Station
from diagrams.systems.measurement_logger import LOOKS, MeasurementLogger
from diagrams.systems.messages import MOST_ATTEMPTS, LoopStatus
from models.measurements import Trial
from models.perception.observed_pose import ObservedPose
from models.perception.seen_object import SeenObject
from models.physics.cell_grid import FloatArray
from models.robots import FINGER_RADIUS
from planners.grasps import Grasp
from planners.table_push import TablePush
from planners.world import ObjectFell, PushNotMade

TICK = 0.05
"""s of simulated time between two looks at what the blocks say."""
PATIENCE = 10.0
"""s of simulated time that the object may stay out of sight with the arm at home."""
LONGEST = 60.0
"""s of simulated time for a push or a grasp."""
HELD_LESS = 0.5
"""Share of the height between the pins by which they may come closer than that while they hold."""

_ALWAYS = 10_000  # trials that the logger may record


class ArmWorld:
    """A `planners.world.World` whose pushes are made by the arm and whose poses come from the camera.

    Simulated time goes on while something is asked for, and stands still while the caller thinks.

    Args:
        scenario: what the cell is like.
        cells: wanted number of cells of the object as seen.
        meshcat: where to show it, if anywhere.

    Raises:
        ValueError: an object, a surface or a hidden effect that cannot be had.
        RendererUnavailable: this machine cannot render pictures.
    """

    def __init__(self, scenario: Scenario, cells: int = 60, meshcat: Meshcat | None = None) -> None:
        self.table = scenario.table.make()
        self.finger_radius = FINGER_RADIUS
        self._config = scenario.execution
        self._looks = (LOOKS + 1) / scenario.camera.rate  # s, until a trial can begin
        builder = DiagramBuilder()
        self.station = builder.AddSystem(Station(scenario, meshcat))
        model = arm_model(models=scenario.arm.models)
        self._perception = builder.AddNamedSystem(
            "perception", CellPerception(scenario.camera, cells, self.station.arm_hulls)
        )
        self._executor = builder.AddNamedSystem(
            "executor", PushExecutor(model, HOME, scenario.execution, self.table)
        )
        self._logger = builder.AddNamedSystem("logger", MeasurementLogger(_ALWAYS))
        for source, output, target, target_input in (
            (self.station, "camera.depth_image", self._perception, "depth_image"),
            (self.station, "camera.X_WC", self._perception, "X_WC"),
            (self.station, "iiwa.position_measured", self._perception, "arm_position"),
            (self.station, "iiwa.position_measured", self._executor, "iiwa.position_measured"),
            (self.station, "iiwa.torque_external", self._executor, "iiwa.torque_external"),
            (self._executor, "iiwa.position", self.station, "iiwa.position"),
            (self._executor, "gripper.position", self.station, "gripper.position"),
            (self._executor, "gripper.force_limit", self.station, "gripper.force_limit"),
            (self._perception, "object_pose", self._logger, "object_pose"),
            (self._executor, "tip_pose", self._logger, "tip_pose"),
            (self._executor, "tip_force", self._logger, "tip_force"),
            (self._executor, "status", self._logger, "execution"),
        ):
            builder.Connect(source.GetOutputPort(output), target.GetInputPort(target_input))
        builder.ExportInput(self._executor.GetInputPort("push"), "push")
        builder.ExportInput(self._executor.GetInputPort("grasp"), "grasp")
        builder.ExportInput(self._logger.GetInputPort("status"), "status")
        self._diagram = builder.Build()
        self._simulator = Simulator(self._diagram)
        self._context = self._simulator.get_mutable_context()
        self._kinematics, self._clearance = FingerKinematics(model), ArmClearance(self.table)
        self._number = 0
        self._tell("push", None)
        self._tell("grasp", None)
        self._tell("status", LoopStatus("looking", 0))

    @property
    def time(self) -> float:
        """Simulated, s."""
        return float(self._context.get_time())

    def first_look(self) -> SeenObject:
        """The object as the camera makes it out.

        Raises:
            ObjectFell: it does not.
        """
        self._patiently(lambda: self._says(self._perception, "seen_object") is not None)
        seen: SeenObject = self._says(self._perception, "seen_object")
        return seen

    def look(self) -> FloatArray:
        """(3,) pose of the object in a picture taken from now on. Raises ObjectFell."""
        asked = self.time

        def seen() -> bool:
            observed: ObservedPose = self._says(self._perception, "object_pose")
            return observed.valid and observed.time >= asked

        self._patiently(seen)
        return np.array(self._says(self._perception, "object_pose").pose)

    def can_push(self, push: TablePush) -> bool:
        """Whether the arm can make a push from home."""
        try:
            plan_push(self._kinematics, push, HOME, HOME, self._config)
        except MotionRefused:
            return False
        return True

    def can_grasp(self, grasp: Grasp, pose: FloatArray) -> bool:
        """Whether the gripper can come in and lift where the object would lie at a pose (3,), m and rad."""
        return can_grasp(self._kinematics, self._clearance, self._active(grasp, pose), HOME)

    def push(self, push: TablePush) -> Trial:
        """Make a push. Raises PushNotMade; ObjectFell where it is not seen any more afterwards."""
        try:
            plan_push(self._kinematics, push, HOME, HOME, self._config)
        except MotionRefused as refusal:
            raise PushNotMade(str(refusal)) from refusal
        self._simulator.AdvanceTo(self.time + self._looks)
        self._number += 1
        made = len(self._says(self._logger, "records"))
        self._tell("status", LoopStatus("pushing", self._number))
        self._tell("push", ActivePush(MOST_ATTEMPTS * self._number, push))
        status = self._until("home", MOST_ATTEMPTS * self._number)
        if status.mode == "refused":
            raise PushNotMade(status.reason)
        self._tell("status", LoopStatus("recording", self._number))
        self._patiently(lambda: len(self._says(self._logger, "records")) > made)
        trial: Trial = self._says(self._logger, "records")[-1]
        self._tell("status", LoopStatus("looking", self._number))
        return trial

    def grasp(self, grasp: Grasp, pose: FloatArray) -> bool:
        """Take the object at a pose (3,), m and rad, and lift it; whether the pins hold something.

        Raises:
            PushNotMade: the arm refuses.
        """
        self._number += 1
        self._tell("grasp", self._active(grasp, pose))
        status = self._until("holding", MOST_ATTEMPTS * self._number)
        if status.mode == "refused":
            raise PushNotMade(status.reason)
        self._simulator.AdvanceTo(self.time + 1.0)
        between = self._says(self.station, "gripper.state_measured")[0] - 2 * FINGER_RADIUS
        return bool(between > (1.0 - HELD_LESS) * grasp.height)

    def _active(self, grasp: Grasp, pose: FloatArray) -> ActiveGrasp:
        seen = self.first_look()
        return ActiveGrasp(MOST_ATTEMPTS * self._number, grasp, pose, seen.grid, seen.cell_heights)

    def _until(self, mode: str, number: int) -> ExecutionStatus:
        """Let time go on until the executor is done with a request."""
        last = self.time + LONGEST
        while self.time < last:
            self._simulator.AdvanceTo(self.time + TICK)
            status: ExecutionStatus = self._says(self._executor, "status")
            if status.push_id == number and status.mode in (mode, "refused"):
                return status
        raise PushNotMade(f"the arm is not done after {LONGEST:g} s, it is still {status.mode}")

    def _patiently(self, done: Callable[[], bool]) -> None:
        """Let time go on until something is so. Raises ObjectFell with what the camera says."""
        last = self.time + PATIENCE
        while not done():
            if self.time > last:
                observed: ObservedPose = self._says(self._perception, "object_pose")
                raise ObjectFell(f"the camera does not see the object on the table: {observed.reason}")
            self._simulator.AdvanceTo(self.time + TICK)

    def _tell(self, port: str, value: object) -> None:
        self._diagram.GetInputPort(port).FixValue(self._context, Value[object](value))

    def _says(self, system: Any, port: str) -> Any:
        return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(self._context))
