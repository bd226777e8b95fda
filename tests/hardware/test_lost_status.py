"""A cell whose arm falls silent: the arm stops, and the reason is told."""

import pytest

from diagrams.exploration_run import ExplorationFailed
from diagrams.hardware.testing import Fault, assert_limits_kept


@pytest.fixture
def scenario(scenario):
    scenario.object.name = "book"
    return scenario


def test_an_arm_that_falls_silent_on_its_way_is_stopped(cell, faults):
    faults.when("pushing", Fault("status", "stop", after=1.0))

    with pytest.raises(ExplorationFailed, match=r"at push 1 of 3: the arm's last status is .* ms old"):
        cell.explore(pushes=3, checks=0)

    assert_limits_kept(cell.commands, cell.scenario.guard)
