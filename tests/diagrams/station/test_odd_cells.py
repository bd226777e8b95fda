"""Cells in which nothing can be explored are refused at once, with cause and number."""

import pytest

from slipmap.diagrams.application.commands.cell_run import scenario_of
from slipmap.models.files import BadInput
from tests.diagrams.odd_scenarios import REFUSED, TRIED, written


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_work_is_refused_at_once(tmp_path, name):
    with pytest.raises((BadInput, ValueError)) as refused:
        scenario_of(written(tmp_path, name), None, simulated=True)
    assert REFUSED[name][1] in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "name", ["heavy", "far", "0.5 Hz", "camera aside", "long rod", "rough scan", "thin", "small"]
)
def test_what_may_work_is_let_in(tmp_path, name):
    assert scenario_of(written(tmp_path, name), None, simulated=True).object.called in str(TRIED[name])
