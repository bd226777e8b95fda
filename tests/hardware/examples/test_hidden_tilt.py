"""A table that is not level, of which nobody told: it is noticed, named, and then no surprise any more."""

import pytest

from slipmap.diagrams.testing import assert_alarm, assert_names, assert_quiet
from slipmap.models.inference.diagnosis.procedure import diagnose

pytestmark = pytest.mark.twin


@pytest.fixture
def scenario(scenario):
    scenario.object.name = "box"
    scenario.pokes.taps = 0.0
    scenario.hidden.table_tilt.down_x, scenario.hidden.table_tilt.down_y = 0.18, -0.12
    return scenario


def test_a_tilted_table_is_noticed_named_and_learned(cell):
    surprised = cell.explore(pushes=9, checks=2, strategy="random", seed=3)
    assert_alarm(surprised.watch)

    diagnosis = diagnose(surprised.dataset, quick=True, seed=0)
    assert_names(diagnosis, "table_tilt")

    knowing = cell.explore(pushes=0, checks=3, seed=4, go_on=True, effects=["table_tilt"])
    assert_quiet(knowing.watch)
