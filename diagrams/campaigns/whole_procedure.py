"""Figure 7 of the paper: how often an unknown object ends in the gripper, with arm and camera in the loop."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from diagrams.campaigns.experiment import Experiment, Summary, TableText, names_and_seeds
from diagrams.campaigns.paper_numbers import WHOLE_PROCEDURE
from planners.campaigns.tables import Estimate, mean, share
from planners.campaigns.trial import CampaignError, TrialOutcome, TrialSpec
from planners.methods import METHODS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HERE = "diagrams.campaigns.whole_procedure"
_FATES = ("held", "fell", "dropped", "gave up")


def trial(*, seed: int, object_name: str, method: str) -> dict[str, Any]:
    """Put the object down at the table's middle, turned at random, and let the robot take it.

    All of Algorithm 4 is done anew in each trial, exploring too.

    Returns:
        What `PregraspRun.to_json` tells, and `yaw`. A run in which nothing could be learned gave up.
    """
    from diagrams.exploration_loop import LoopOptions
    from diagrams.exploration_run import ExplorationFailed
    from diagrams.pregrasp_loop import PregraspOptions
    from diagrams.pregrasp_run import run_pregrasp
    from diagrams.station.scenario import Scenario

    scenario = Scenario()
    scenario.object.name = object_name
    yaw = float(np.random.default_rng([seed, 3]).uniform(-180.0, 180.0))
    scenario.object.pose = [0.0, 0.0, yaw]
    options = PregraspOptions(LoopOptions(seed=seed), method=method)
    try:
        told = run_pregrasp(scenario, options).to_json()
    except ExplorationFailed as error:
        told = {"fate": "gave up", "reason": str(error), "pushes": []}
    # What the clock says depends on the machine, and the same seeds shall give the same result.
    return {key: value for key, value in told.items() if key != "seconds"} | {"yaw": yaw}


def _specs(objects: Sequence[str], trials: int, seed: int, truth: str) -> list[TrialSpec]:
    if truth != "plant":
        raise CampaignError("fig7: the robot's cell is simulated by plant alone; leave out --truth")
    return [
        TrialSpec(
            f"{name}-{method}-{number}", f"{_HERE}:trial", {"object_name": name, "method": method}, number
        )
        for name, number in names_and_seeds(objects, trials, seed)
        for method in METHODS
    ]


def _summary(outcomes: Sequence[TrialOutcome]) -> Summary:
    results: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for outcome in outcomes:
        if outcome.result is not None:
            told = outcome.spec.parameters
            of_object = results.setdefault(told["object_name"], {method: [] for method in METHODS})
            of_object[told["method"]].append(outcome.result)
    held = {
        name: {
            method: share(sum(one["fate"] == "held" for one in of[method]), len(of[method]))
            for method in METHODS
        }
        for name, of in results.items()
    }
    every = {method: [one for of in results.values() for one in of[method]] for method in METHODS}
    pushes = {method: mean([len(one["pushes"]) for one in every[method]]) for method in METHODS}
    fates = {method: Counter(one["fate"] for one in every[method]) for method in METHODS}
    rows = []
    for name, of_methods in held.items():
        rows.append([name, *(one.percent() for one in of_methods.values())])
        if name in WHOLE_PROCEDURE:
            paper = WHOLE_PROCEDURE[name]
            rows.append(["  paper", *(f"{paper[m]:.0f}" if m in paper else "–" for m in METHODS)])
    ways = [
        ["pushes to the edge, mean", *(pushes[method].short(digits=2) for method in METHODS)],
        *([fate, *(str(fates[method][fate]) for method in METHODS)] for fate in _FATES),
    ]
    return Summary(
        [
            TableText("Explored, brought to the edge, grasped and lifted, %", ("object", *METHODS), rows),
            TableText("Pushes to the edge, and how trials ended", ("", *METHODS), ways),
        ],
        "Pushes count in all trials, failed ones too; those that explore are not among them.",
        {
            "held": {
                name: {method: one.to_json() for method, one in of.items()} for name, of in held.items()
            },
            "pushes": {method: one.to_json() for method, one in pushes.items()},
            "fates": {method: dict(of) for method, of in fates.items()},
            "paper": WHOLE_PROCEDURE,
        },
        lambda: _figure(held),
    )


def _figure(held: dict[str, dict[str, Estimate]]) -> list[Figure]:
    from diagrams.figures.campaigns import shares_figure

    marks = {
        name: {method: (value, value) for method, value in of.items()} for name, of in WHOLE_PROCEDURE.items()
    }
    return [shares_figure("Explored, brought to the edge, grasped and lifted", held, marks)]


FIGURE_7 = Experiment("fig7", 10, _specs, _summary, ("hammer",))
