"""The guard in the plant: the finger is to push what cannot be pushed."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.systems.primitives import ConstantVectorSource

from slipmap.diagrams.hardware.guard import CommandGuard
from slipmap.diagrams.station.arm import arm_model
from slipmap.planners.table_push import TablePush
from tests.diagrams.execution import arm_rig


class GuardedRig(arm_rig.Rig):
    """The arm in its plant with a guard before it."""

    def _connect_command(self, builder) -> None:
        guard = builder.AddSystem(CommandGuard(arm_model()))
        now = builder.AddSystem(ConstantVectorSource([0.0]))

        def connect(source, output, target, name=None) -> None:
            builder.Connect(source.GetOutputPort(output), target.GetInputPort(name or output))

        connect(self.executor, "iiwa.position", guard)
        connect(guard, "iiwa.position", self.station)
        connect(guard, "health", self.executor)
        connect(now, "y0", guard, "status_age")
        for name in ("iiwa.position_measured", "iiwa.torque_external"):
            connect(self.station, name, guard)


@pytest.fixture(scope="module")
def met():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(arm_rig, "BOX_MASS", 300.0)
        rig = GuardedRig()
    simulator = rig.start(TablePush([-0.06, 0.02], [0.06, 0.02], 0.05))
    log = rig.run(simulator, lambda sample: sample.status.mode == "stopped")
    end = log[-1].time + 0.3
    return log + rig.run(simulator, lambda sample: sample.time >= end)


def force(sample) -> float:
    return float(np.linalg.norm(sample.contact_force))


def test_the_arm_stops_soon_after_the_touch_and_says_why(met):
    touch = next(sample.time for sample in met if force(sample) > 1.0)
    stopped = next(sample for sample in met if sample.status.mode == "stopped")
    assert stopped.time - touch < 0.1
    assert "something pushes against the arm" in stopped.status.reason


def test_the_arm_does_not_go_on_pressing(met):
    """Held where it was told to be, it would press with all that its control gives for the way inside."""
    assert max(map(force, met)) > 100.0
    assert force(met[-1]) < 20.0
    assert np.abs(met[-1].box - met[0].box).max() < 3e-3
    last = np.array([sample.measured for sample in met[-10:]])
    assert np.abs(last - last[0]).max() < 1e-4
