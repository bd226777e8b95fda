"""The arm takes the hammer at the table's edge and lifts it."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from slipmap.diagrams.execution.push_executor import PushExecutor
from slipmap.diagrams.execution.requests import ActiveGrasp, ActivePush
from slipmap.diagrams.station.arm import HOME, add_arm, add_arm_drivers, arm_model
from slipmap.diagrams.station.sliding_object import BODY, add_sliding_object, plant_config, resting_pose
from slipmap.diagrams.station.table import ROUND_TABLE, TABLE_FRICTION, add_table
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.robots import FINGER_RADIUS, GRIPPER_OPENING
from slipmap.planners.goals import Graspable
from slipmap.planners.settings import GoalSettings
from slipmap.planners.table_push import TablePush


class Cell:
    """Table, hammer, arm and executor."""

    def __init__(self):
        self.hammer = benchmark_object("hammer")
        builder = DiagramBuilder()
        self.plant, _ = AddMultibodyPlant(plant_config(4e-3), builder)
        add_table(self.plant)
        add_sliding_object(self.plant, self.hammer, TABLE_FRICTION)
        arm = add_arm(self.plant)
        self.plant.Finalize()
        add_arm_drivers(builder, self.plant, arm)
        self.station = builder.Build()
        builder = DiagramBuilder()
        builder.AddNamedSystem("station", self.station)
        self.executor = builder.AddSystem(PushExecutor(arm_model(), HOME, table=ROUND_TABLE))
        for name in ("iiwa.position", "gripper.position", "gripper.force_limit"):
            builder.Connect(self.executor.GetOutputPort(name), self.station.GetInputPort(name))
        for name in ("iiwa.position_measured", "iiwa.torque_external"):
            builder.Connect(self.station.GetOutputPort(name), self.executor.GetInputPort(name))
        for name in ("push", "grasp"):
            builder.ExportInput(self.executor.GetInputPort(name), name)
        self.diagram = builder.Build()

    def start(self, pose, grasp):
        simulator = Simulator(self.diagram)
        context = simulator.get_mutable_context()
        plant = self.plant.GetMyMutableContextFromRoot(context)
        self.plant.SetFreeBodyPose(plant, self.plant.GetBodyByName(BODY), resting_pose(*pose))
        request = ActiveGrasp(4, grasp, pose, self.hammer.grid, self.hammer.height)
        self.tell(simulator, "grasp", request)
        self.tell(simulator, "push", None)
        return simulator

    def tell(self, simulator, port, value):
        self.diagram.GetInputPort(port).FixValue(simulator.get_mutable_context(), Value[object](value))

    def status(self, simulator):
        context = self.executor.GetMyContextFromRoot(simulator.get_context())
        return self.executor.GetOutputPort("status").Eval(context)

    def opening(self, simulator):
        context = self.station.GetMyContextFromRoot(simulator.get_context())
        return self.station.GetOutputPort("gripper.state_measured").Eval(context)[0]

    def pose(self, simulator):
        context = self.plant.GetMyContextFromRoot(simulator.get_context())
        return self.plant.EvalBodyPoseInWorld(context, self.plant.GetBodyByName(BODY))


@pytest.fixture(scope="module")
def cell():
    return Cell()


@pytest.fixture(scope="module")
def goals(cell):
    """Where the arm can grasp, and where it cannot."""
    hammer = cell.hammer
    found = Graspable.of(
        hammer.grid, hammer.height, hammer.center_of_mass[None, :2], [1.0],
        GoalSettings(samples=300), [hammer.total_mass],
    ).sample_goals(ROUND_TABLE, np.random.default_rng(0))  # fmt: skip
    side = [np.degrees(np.arctan2(*goal.grasp.at(goal.pose)[[1, 0]])) for goal in found]
    near = next(goal for goal, angle in zip(found, side, strict=True) if 110 < abs(angle) < 160)
    far = next(goal for goal, angle in zip(found, side, strict=True) if abs(angle) < 60)
    return near, far


def test_hammer_is_lifted_level_and_stays_in_the_grip(cell, goals):
    near, _ = goals
    simulator = cell.start(near.pose, near.grasp)
    before, modes, held = cell.pose(simulator).translation(), [], None
    while held is None or simulator.get_context().get_time() < held + 1.5:
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.1)
        assert simulator.get_context().get_time() < 20.0
        mode = cell.status(simulator).mode
        if mode not in modes:
            modes.append(mode)
        if mode == "closing" and held is None:
            np.testing.assert_allclose(cell.pose(simulator).translation(), before, atol=2e-3)
        if mode == "holding":
            held = held or simulator.get_context().get_time()
    assert modes[-4:] == ["reaching", "closing", "lifting", "holding"]
    assert cell.status(simulator).push_id == 4
    X_WO = cell.pose(simulator)
    np.testing.assert_allclose(X_WO.translation() - before, [0.0, 0.0, 0.1], atol=5e-3)
    assert np.degrees(np.abs(RollPitchYaw(X_WO.rotation()).vector()[:2])).max() < 2.0
    assert cell.opening(simulator) == pytest.approx(near.grasp.height + 2 * FINGER_RADIUS, abs=1.5e-3)
    # Nothing makes it let go.
    cell.tell(simulator, "grasp", None)
    cell.tell(simulator, "push", ActivePush(5, TablePush([0.0, 0.0], [0.1, 0.0], 0.1)))
    simulator.AdvanceTo(simulator.get_context().get_time() + 0.3)
    assert cell.status(simulator).mode == "holding"
    assert cell.pose(simulator).translation()[2] > 0.09


def test_grasp_out_of_reach_is_refused_and_the_arm_stays(cell, goals):
    _, far = goals
    simulator = cell.start(far.pose, far.grasp)
    simulator.AdvanceTo(0.3)
    status = cell.status(simulator)
    assert status.mode == "refused" and status.push_id == 4
    assert "out of the arm's reach" in status.reason
    assert cell.opening(simulator) < 0.01 < GRIPPER_OPENING


def test_a_request_to_grasp_without_a_table_is_refused(cell, goals):
    executor = PushExecutor(arm_model(), HOME)
    near, _ = goals
    request = ActiveGrasp(1, near.grasp, near.pose, cell.hammer.grid, cell.hammer.height)
    simulator = Simulator(executor)
    context = simulator.get_mutable_context()
    executor.GetInputPort("iiwa.position_measured").FixValue(context, HOME)
    executor.GetInputPort("iiwa.torque_external").FixValue(context, np.zeros(7))
    executor.GetInputPort("push").FixValue(context, Value[object](None))
    executor.GetInputPort("grasp").FixValue(context, Value[object](request))
    simulator.AdvanceTo(0.5)
    assert "without a table" in executor.GetOutputPort("status").Eval(context).reason
