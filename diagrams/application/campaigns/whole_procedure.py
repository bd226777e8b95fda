"""Figure 7 of the paper: how often an unknown object ends up in the gripper, with arm and camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from slipmap.diagrams.application.campaigns.experiments import (
    WHOLE_PROCEDURE,
    Experiment,
    Summary,
)
from slipmap.diagrams.application.campaigns.methods_compared import compare_methods
from slipmap.diagrams.application.campaigns.trials import TrialOutcome
from slipmap.planners.settings import METHODS

if TYPE_CHECKING:
    from slipmap.diagrams.loops.exploration_run import ExplorationRun
    from slipmap.diagrams.station.scenario import Scenario

FATES = ("held", "fell", "dropped", "gave up")


def trial(*, seed: int, object_name: str, method: str) -> dict[str, Any]:
    """Run all of Algorithm 4, including the exploration, in each trial; see `taken`."""
    from slipmap.diagrams.station.scenario import Scenario

    return taken(Scenario(), seed, object_name, method)[0]


def taken(
    scenario: Scenario, seed: int, object_name: str, method: str, *, adapt: bool = False
) -> tuple[dict[str, Any], ExplorationRun | None]:
    """Place the object at the middle of the table, turned at random, and let the robot fetch it.

    Args:
        scenario: the cell; its object is replaced by `object_name`.
        adapt: whether the model is repaired during the run.

    Returns:
        The content of `PregraspRun.to_json` with `yaw` (deg), and the exploration, None where nothing could
        be learned; such a run counts as `gave up`.

    Raises:
        KeyboardInterrupt: Ctrl-C, which is no result.
    """
    from slipmap.diagrams.loops.exploration_loop import LoopOptions
    from slipmap.diagrams.loops.exploration_run import ExplorationFailed, ExplorationStopped
    from slipmap.diagrams.loops.pregrasp_loop import PregraspOptions, pregrasp

    scenario.object.name = object_name
    yaw = float(np.random.default_rng([seed, 3]).uniform(-180.0, 180.0))
    scenario.object.pose = [0.0, 0.0, yaw]
    options = PregraspOptions(LoopOptions(seed=seed, adapt=adapt), method=method)
    learned = None
    try:
        run = pregrasp(scenario, options)
        if run.interrupted:
            raise KeyboardInterrupt
        told, learned = run.to_json(), run.exploration
    except ExplorationStopped as error:
        raise KeyboardInterrupt from error
    except ExplorationFailed as error:
        told = {"fate": "gave up", "reason": str(error), "pushes": []}
    # Durations depend on the machine, but the same seeds must give the same result.
    return {key: value for key, value in told.items() if key != "seconds"} | {"yaw": yaw}, learned


def _summary(outcomes: Sequence[TrialOutcome]) -> Summary:
    compared = compare_methods(outcomes, good="held", pushes=lambda result: len(result["pushes"]))
    title = "Explored, brought to the edge, grasped and lifted"
    return Summary(
        [
            compared.success_table(f"{title}, %", WHOLE_PROCEDURE),
            compared.ways_table(
                "Pushes to the edge, and how trials ended", "pushes to the edge, mean", FATES
            ),
        ],
        "Numbers of pushes include unsuccessful trials, but not the pushes for exploration.",
        compared.to_json("held") | {"paper": WHOLE_PROCEDURE},
        lambda: compared.figures(title, WHOLE_PROCEDURE),
    )


FIGURE_7 = Experiment(
    "fig7", 10, trial, _summary, {"method": METHODS}, plant_alone="the robot's cell", objects=("hammer",)
)
