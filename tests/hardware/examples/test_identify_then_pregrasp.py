"""A hammer cannot be grasped where it lies: the robot learns how it slides, and takes it at the edge."""

import pytest

from slipmap.diagrams.testing import assert_held, assert_limits_kept

pytestmark = pytest.mark.twin


@pytest.fixture
def scenario(scenario):
    """The hammer lies near the edge already, so that few pushes are needed."""
    scenario.object.name = "hammer"
    scenario.object.pose = [-0.27, 0.13, 20.0]
    scenario.pokes.center, scenario.pokes.longest = [-0.27, 0.13], 0.05
    scenario.pushes.candidates = 24
    return scenario


def test_a_hammer_is_explored_brought_to_the_edge_and_lifted(cell):
    run = cell.pregrasp(pushes=1, most=6, cells=40, hypotheses=8)

    assert_held(run)
    assert 1 <= len(run.pushes) <= 6
    assert_limits_kept(cell.commands, cell.scenario.guard)
