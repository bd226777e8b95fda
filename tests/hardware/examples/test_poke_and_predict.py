"""A robot pokes a snack bag five times and knows then how it slides."""

import pytest

from slipmap.diagrams.loops.exploration_loop import LoopOptions
from slipmap.diagrams.testing import (
    assert_better_than_uniform,
    assert_limits_kept,
    assert_predicts,
)
from slipmap.models.inference.identification import identify

pytestmark = pytest.mark.twin


@pytest.fixture
def scenario(scenario):
    scenario.object.name = "snack"
    return scenario


@pytest.fixture
def exploration():
    return LoopOptions(pushes=5, checks=2)


def test_five_pokes_tell_how_others_end(explored, pushes, cell):
    assert_predicts(explored, within=0.010)
    assert_better_than_uniform(explored)
    assert_limits_kept(cell.commands, cell.scenario.guard)

    assert_predicts(identify(pushes, seed=1, friction_laws=False), within=0.010)
