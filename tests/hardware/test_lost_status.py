"""A cell whose arm falls silent: the arm stops, the reason is told, and what was measured is kept."""

import pytest

from diagrams.exploration_run import ExplorationFailed
from diagrams.hardware.testing import Fault, assert_limits_kept
from models.measurements import read_dataset


@pytest.fixture
def scenario(scenario):
    scenario.object.name = "book"
    return scenario


def test_an_arm_that_falls_silent_in_the_second_push_is_stopped(cell, faults):
    faults.when("pushing", Fault("status", "stop", after=1.0), push=2)

    with pytest.raises(ExplorationFailed, match=r"at push 2 of 3: the arm's last status is .* ms old"):
        cell.explore(pushes=3, checks=0, cells=30, hypotheses=8)

    (folder,) = cell.folder.glob("*-exploration")
    assert len(read_dataset(folder / "pushes").trials) == 1
    assert_limits_kept(cell.commands, cell.scenario.guard)
