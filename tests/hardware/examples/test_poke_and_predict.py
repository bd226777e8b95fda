"""A robot pokes a wrench three times and knows then how it slides."""

import pytest

from diagrams.hardware.testing import (
    assert_better_than_uniform,
    assert_limits_kept,
    assert_predicts,
)

pytestmark = pytest.mark.twin


@pytest.fixture
def scenario(scenario):
    scenario.object.name = "wrench"
    return scenario


def test_three_pokes_tell_how_a_fourth_ends(cell):
    run = cell.explore(pushes=3, checks=1)

    assert_predicts(run, within=0.010)
    assert_better_than_uniform(run)
    assert_limits_kept(cell.commands, cell.scenario.guard)
