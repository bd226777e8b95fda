"""A robot pokes a snack bag five times and knows then how it slides."""

import pytest

from diagrams.hardware.testing import (
    assert_better_than_uniform,
    assert_limits_kept,
    assert_predicts,
)

pytestmark = pytest.mark.twin


@pytest.fixture
def scenario(scenario):
    scenario.object.name = "snack"
    return scenario


def test_five_pokes_tell_how_others_end(cell):
    run = cell.explore(pushes=5, checks=2)

    assert_predicts(run, within=0.010)
    assert_better_than_uniform(run)
    assert_limits_kept(cell.commands, cell.scenario.guard)
