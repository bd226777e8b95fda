"""A cell whose arm falls silent: the arm stops, and the reason is told."""

import pytest

from slipmap.diagrams.hardware.guard import GuardSettings
from slipmap.diagrams.loops.exploration_run import ExplorationFailed
from slipmap.diagrams.testing import Fault, assert_limits_kept


@pytest.fixture
def scenario(scenario):
    scenario.object.name = "book"
    scenario.guard.transit_speed = GuardSettings().transit_speed
    return scenario


def test_an_arm_that_falls_silent_on_its_way_is_stopped(cell, faults):
    faults.when("pushing", Fault("status", "stop", after=1.7))

    with pytest.raises(ExplorationFailed, match=r"at push 1 of 3: the arm's last status is .* ms old"):
        cell.explore(pushes=3, checks=0)

    assert_limits_kept(cell.commands, cell.scenario.guard)
    fastest = max(log.tip_speeds.max() for log in cell.commands)
    assert 0.3 < fastest <= GuardSettings().transit_speed + 1e-3
