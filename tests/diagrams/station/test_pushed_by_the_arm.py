"""The arm pushes light and low objects fast, and they slide as the cell-grid model says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus

import slipmap
from slipmap.diagrams.execution.push_executor import PushExecutor
from slipmap.diagrams.execution.requests import ActivePush
from slipmap.diagrams.station.arm import HOME, arm_model
from slipmap.diagrams.station.station import Station, take_fixed_steps
from slipmap.models.geometry import placed
from slipmap.models.inference.observations import observe
from slipmap.models.measurements.push_dataset import Channel, Trial
from slipmap.planners.table_push import TablePush

_SPEED = 0.077  # m/s, as in an exploration
_SAMPLE = 0.01  # s


class _Cell:
    """A station and an executor; the object lies at the world's origin, turned by an angle."""

    def __init__(self, name: str, angle: float) -> None:
        scenario = slipmap.Scenario()
        thing = replace(scenario.object, name=name, pose=[0.0, 0.0, float(np.degrees(angle))])
        builder = DiagramBuilder()
        self.station = builder.AddSystem(Station(replace(scenario, object=thing)))
        executor = builder.AddSystem(PushExecutor(arm_model(), HOME, scenario.execution))
        for port in ("iiwa.position", "gripper.position", "gripper.force_limit"):
            builder.Connect(executor.GetOutputPort(port), self.station.GetInputPort(port))
        for port in ("iiwa.position_measured", "iiwa.torque_external"):
            builder.Connect(self.station.GetOutputPort(port), executor.GetInputPort(port))
        builder.ExportInput(executor.GetInputPort("push"), "push")
        self.executor = executor
        self.simulator = Simulator(builder.Build())
        take_fixed_steps(self.simulator)

    def push(self, push: TablePush) -> tuple[Trial, np.ndarray]:
        """The push as recorded without noise, and the object's tilt in each step while it moved, rad."""
        root = self.simulator.get_mutable_context()
        self.simulator.get_system().GetInputPort("push").FixValue(root, Value[object](ActivePush(1, push)))
        port = self.executor.GetOutputPort("status")
        context = self.executor.GetMyContextFromRoot(root)
        tilts, rows = [], []

        def watch(now: Context) -> EventStatus:
            status = port.Eval(context)
            if status.push_id == 1 and status.mode in ("home", "refused"):
                assert status.mode == "home", status
                return EventStatus.ReachedTermination(self.executor, status.mode)
            X_WO = self.station.GetOutputPort("truth.object_pose").Eval(self._of_station(now))
            R = X_WO.rotation().matrix()
            pose = [*X_WO.translation()[:2], np.arctan2(R[1, 0], R[0, 0])]
            tilts.append((*pose, np.hypot(R[2, 0], R[2, 1])))
            if not rows or now.get_time() > rows[-1][0] + _SAMPLE - 1e-6:
                X_WT = self.executor.GetOutputPort("tip_pose").Eval(context)
                rows.append([now.get_time(), *X_WT.translation(), *pose])
            self.station.after_step(now)
            return EventStatus.DidNothing()

        self.simulator.set_monitor(watch)
        self.simulator.AdvanceTo(15.0)
        steps, recording = np.array(tilts), np.array(rows)
        low = recording[recording[:, 3] < 0.006]  # the finger is down
        time = low[:, 0] - low[0, 0]
        ends = low[[0, -1], 4:]
        moving = np.abs(np.diff(steps[:, :3], axis=0)).max(axis=1) > 1e-7
        trial = Trial("push", "fit", Channel(time[[0, -1]], ends), Channel(time, low[:, 1:3]), None)
        return trial, steps[1:][moving, 3]

    def _of_station(self, root: Context) -> Context:
        return self.station.GetMyContextFromRoot(root)


@pytest.mark.parametrize(
    ("name", "angle", "begin", "end"),
    [
        ("wrench", 2.690, [0.1536, -0.0379], [0.1236, 0.0183]),
        ("spray_gun", -0.294, [-0.1826, 0.0492], [-0.1226, 0.0094]),
    ],
)
def test_it_neither_rocks_nor_ends_elsewhere_than_the_model(name, angle, begin, end):
    """On walls as hard as blocks both rocked for a quarter of these pushes and ended 20 and 37 mm off."""
    cell = _Cell(name, angle)
    pose = np.array([0.0, 0.0, angle])
    trial, tilts = cell.push(TablePush(placed(np.array(begin), pose), placed(np.array(end), pose), _SPEED))
    thing = cell.station.true_object
    push = observe(trial).push
    rollout = slipmap.Slider(thing.grid, finger_radius=0.008).rollout(thing.maps, [push])
    predicted, measured = rollout.end[0, 0, :3], trial.object_pose.values[-1]
    assert np.linalg.norm(measured[:2] - push.start_pose[:2]) > 0.01
    assert np.mean(tilts > 1e-4) < 0.02, f"tilted by more than 0.1 mrad in {np.mean(tilts > 1e-4):.0%}"
    assert 1e3 * np.linalg.norm(predicted[:2] - measured[:2]) < 2.0
    assert np.degrees(abs(predicted[2] - measured[2])) < 0.5
