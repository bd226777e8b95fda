"""A table that is not level, of which nobody told: the robot names the tilt, adds it, and its error falls."""

import numpy as np
import pytest

from slipmap.diagrams.testing import assert_adopts, assert_limits_kept

pytestmark = pytest.mark.twin


@pytest.fixture
def scenario(scenario):
    scenario.object.name = "box"
    scenario.hidden.table_tilt.down_x, scenario.hidden.table_tilt.down_y = 0.18, -0.12
    return scenario


def test_a_robot_adds_the_tilt_to_its_model(cell):
    run = cell.explore(pushes=7, checks=0, adapt=True, seed=3)
    assert_adopts(run, "table_tilt")
    assert_limits_kept(cell.commands, cell.scenario.guard)
    before = [push.error for push in run.watch.judged if "table_tilt" not in push.effects]
    after = [push.error for push in run.watch.judged if "table_tilt" in push.effects]
    assert after[-1] < 0.5 * np.median(before), (before, after)
