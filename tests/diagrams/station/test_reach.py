"""An object that the arm cannot push is refused before anything moves."""

import pytest

from slipmap.diagrams.loops.exploration_loop import check_reach
from slipmap.diagrams.station.scenario import Scenario, ScenarioError


def test_what_is_out_of_reach_is_refused():
    scenario = Scenario()
    check_reach(scenario, scenario.object.make())
    scenario.table.radius, scenario.object.pose = 1.5, [0.9, 0.2, 0.0]
    with pytest.raises(ScenarioError, match=r"cannot push hammer at x = 0\.9 m, y = 0\.2 m"):
        check_reach(scenario, scenario.object.make())
