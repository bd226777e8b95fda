"""A hammer cannot be grasped where it lies: the robot learns how it slides, and takes it at the edge."""

import pytest

from diagrams.hardware.testing import assert_held, assert_limits_kept

pytestmark = pytest.mark.twin


def test_a_hammer_is_explored_brought_to_the_edge_and_lifted(cell):
    run = cell.pregrasp(pushes=3)

    assert_held(run)
    assert 1 <= len(run.pushes) <= 8
    assert_limits_kept(cell.commands, cell.scenario.guard)
