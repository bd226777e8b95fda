"""Executor, guard and an arm that follows, with faults between them; no plant, so that it runs fast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, EventStatus
from pydrake.systems.primitives import ConstantValueSource

from slipmap.diagrams.execution.arm_motion import FingerKinematics
from slipmap.diagrams.execution.plans import ArmPlanner
from slipmap.diagrams.execution.push_executor import PushExecutor
from slipmap.diagrams.execution.requests import ActivePush, ExecutionConfig
from slipmap.diagrams.hardware.guard import PERIOD, CommandGuard, GuardSettings
from slipmap.diagrams.station.arm import HOME, arm_model
from slipmap.planners.table_push import TablePush
from tests.hardware.faults import FollowingArm, StatusLink

PUSH = TablePush(np.array([-0.12, 0.02]), np.array([0.06, 0.02]), 0.1)
MODEL = arm_model()
KINEMATICS = FingerKinematics(MODEL)
_PUSHING = (
    ArmPlanner(KINEMATICS, ExecutionConfig(), HOME).push(PUSH, HOME).phases[2].trajectory.value(0.0)[:, 0]
)
NEAR = KINEMATICS.inverse(np.array([-0.14, 0.02, 0.101]), _PUSHING, KINEMATICS.yaw(_PUSHING))
"""(7,) joint angles over the begin of the push, from where it does not take long: at a safe height, and with
the hand in the direction that it has then."""


@dataclass(frozen=True)
class Log:
    """What was said and told, every `PERIOD`, once the arm had said something."""

    times: np.ndarray
    commands: np.ndarray
    measured: np.ndarray
    modes: list[str]
    health: list[object]
    status: object

    @property
    def speeds(self) -> np.ndarray:
        """(n, 7) of the joints, as commanded, rad/s."""
        return np.diff(self.commands, axis=0) / PERIOD

    @property
    def tip_speeds(self) -> np.ndarray:
        """(n,) of the finger's end, as commanded, m/s."""
        tip = np.array([KINEMATICS.pose(q).translation() for q in self.commands])
        return np.linalg.norm(np.diff(tip, axis=0), axis=1) / PERIOD

    @property
    def moving(self) -> np.ndarray:
        """Times at which the command was not that before, s."""
        return self.times[1:][np.abs(self.speeds).max(axis=1) > 1e-9]


def run(
    duration,
    *,
    link=None,
    arm=None,
    settings=None,
    push=PUSH,
    home=NEAR,
    before_guard=None,
    gripper=None,
    execution=None,
    **inputs,
):
    """Let the arm make a push for a while.

    Args:
        duration: s.
        link: `StatusLink`.
        arm: `FollowingArm`.
        settings: `GuardSettings`.
        push: what to do; None for nothing.
        home: joint angles at the begin, and between pushes.
        before_guard: system between executor and guard, ports 0.
        gripper: source of the gripper's state for the executor.
        execution: `ExecutionConfig`.
        inputs: sources for `image_age` or `abort` of the guard, systems with one output.
    """
    builder = DiagramBuilder()
    settings = settings or GuardSettings()
    held = settings.held_to(execution or ExecutionConfig())
    executor = builder.AddSystem(PushExecutor(MODEL, home, held))
    guard = builder.AddSystem(CommandGuard(MODEL, settings))
    link = builder.AddSystem(link or StatusLink())
    arm = builder.AddSystem(arm or FollowingArm(home))
    request = builder.AddSystem(ConstantValueSource(Value[object](push and ActivePush(1, push))))
    builder.Connect(request.get_output_port(), executor.GetInputPort("push"))
    wanted = executor.GetOutputPort("iiwa.position")
    if before_guard is not None:
        builder.AddSystem(before_guard)
        builder.Connect(wanted, before_guard.get_input_port())
        wanted = before_guard.get_output_port()
    builder.Connect(wanted, guard.GetInputPort("iiwa.position"))
    builder.Connect(guard.GetOutputPort("iiwa.position"), arm.GetInputPort("command"))
    builder.Connect(guard.GetOutputPort("health"), executor.GetInputPort("health"))
    for name in ("position", "torque"):
        builder.Connect(arm.GetOutputPort(name), link.GetInputPort(name))
    for block in (executor, guard):
        builder.Connect(link.GetOutputPort("position"), block.GetInputPort("iiwa.position_measured"))
        builder.Connect(link.GetOutputPort("torque"), block.GetInputPort("iiwa.torque_external"))
    builder.Connect(link.GetOutputPort("age"), guard.GetInputPort("status_age"))
    if gripper is not None:
        source = builder.AddSystem(gripper).get_output_port()
        builder.Connect(source, executor.GetInputPort("gripper.state_measured"))
    for name, source in inputs.items():
        builder.Connect(builder.AddSystem(source).get_output_port(), guard.GetInputPort(name))
    diagram = builder.Build()

    simulator = Simulator(diagram)
    rows = []

    def watch(root):
        def read(block, port):
            return block.GetOutputPort(port).Eval(block.GetMyContextFromRoot(root))

        time = root.get_time()
        if read(guard, "health").mode == "waiting":
            return EventStatus.DidNothing()
        if not rows or time - rows[-1][0] > 0.5 * PERIOD:
            rows.append(
                (
                    time,
                    read(guard, "iiwa.position").copy(),
                    read(arm, "position").copy(),
                    read(executor, "status").mode,
                    read(guard, "health"),
                    read(executor, "status"),
                )
            )
        return EventStatus.DidNothing()

    simulator.set_monitor(watch)
    simulator.AdvanceTo(duration)
    times, commands, measured, modes, health, status = zip(*rows, strict=True)
    return Log(np.array(times), np.array(commands), np.array(measured), list(modes), list(health), status[-1])
