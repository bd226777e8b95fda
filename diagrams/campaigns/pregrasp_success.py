"""Figure 6 of the paper: how often each method brings an object to the edge, and by how many pushes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from diagrams.campaigns.experiment import Experiment, Summary, TableText, names_and_seeds
from diagrams.campaigns.paper_numbers import PREGRASP_ACTIONS, PREGRASP_SUCCESS
from planners.campaigns.tables import Estimate, mean, share
from planners.campaigns.trial import TrialOutcome, TrialSpec
from planners.methods import METHODS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from models.physics.cell_grid import FloatArray

NEAR = 0.02
"""From the goal, m; with `NEAR_ANGLE` the paper's success."""
NEAR_ANGLE = 15.0
"""From the goal, deg."""
YAWS_A_BELIEF = 100
"""Trials with one and the same belief: the paper identifies each object once."""

_HERE = "diagrams.campaigns.pregrasp_success"
_FATES = ("success", "fell", "missed", "gave up")


def trial(*, seed: int, truth: str, object_name: str, method: str, belief_seed: int) -> dict[str, Any]:
    """Put the object down at the table's middle, turned at random, and let a method bring it to the edge.

    Returns:
        `success`: whether it truly lies within 20 mm and 15° of the goal, flat on the table, and the method
        knows it; `fate`: that, or `fell`, `missed` (taken for a success, but it is not) or `gave up`;
        `reason` in the procedure's words; `pushes`; `yaw`.
    """
    from diagrams.campaigns.learning import identified
    from diagrams.campaigns.worlds import world_of
    from planners.pregrasp import bring_to_edge
    from planners.pregrasp_settings import PregraspSettings
    from planners.world import ObjectFell

    belief = identified(truth, object_name, belief_seed)
    world = world_of(truth, object_name)
    thing = world.true_object
    rng = np.random.default_rng([seed, 3])
    yaw = float(rng.uniform(-np.pi, np.pi))
    world.reset(np.array([0.0, 0.0, yaw]), rng)
    ended = bring_to_edge(
        world, belief, thing.height, PregraspSettings(), np.random.default_rng([seed, 4]),
        method=method, truth=thing.maps,
    )  # fmt: skip
    try:
        pose = world.true_pose
    except ObjectFell:
        fate = "fell"
    else:
        if not ended.success or ended.goal is None:
            fate = "gave up"
        else:
            fate = "success" if near(pose, ended.goal.pose) else "missed"
    return {
        "success": fate == "success",
        "fate": fate,
        "reason": ended.reason,
        "pushes": len(ended.pushes),
        "yaw": yaw,
    }


def near(pose: FloatArray, goal: FloatArray) -> bool:
    """Whether a pose (3,) is the goal (3,) but for 20 mm and 15°."""
    angle = (pose[2] - goal[2] + np.pi) % (2 * np.pi) - np.pi
    return bool(np.hypot(*(pose[:2] - goal[:2])) <= NEAR and abs(angle) <= np.radians(NEAR_ANGLE))


def _specs(objects: Sequence[str], trials: int, seed: int, truth: str) -> list[TrialSpec]:
    return [
        TrialSpec(
            f"{name}-{method}-{number}",
            f"{_HERE}:trial",
            {
                "truth": truth,
                "object_name": name,
                "method": method,
                "belief_seed": number // YAWS_A_BELIEF,
            },
            number,
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
    every = {method: [one for of in results.values() for one in of[method]] for method in METHODS}
    success = {
        name: {
            method: share(sum(one["success"] for one in of[method]), len(of[method])) for method in METHODS
        }
        for name, of in [*results.items(), ("all", every)]
    }
    pushes = {method: mean([one["pushes"] for one in every[method]]) for method in METHODS}
    fates = {method: Counter(one["fate"] for one in every[method]) for method in METHODS}
    rows = []
    for name, of_methods in success.items():
        rows.append([name, *(one.percent() for one in of_methods.values())])
        if name in PREGRASP_SUCCESS:
            rows.append(["  paper", *(f"{PREGRASP_SUCCESS[name][method]:.0f}" for method in METHODS)])
    actions = [
        ["pushes, mean", *(pushes[method].short(digits=2) for method in METHODS)],
        ["  paper", *(f"{PREGRASP_ACTIONS[method]:.2f}" for method in METHODS)],
        *([fate, *(str(fates[method][fate]) for method in METHODS)] for fate in _FATES),
    ]
    return Summary(
        [
            TableText("Brought to the edge, %", ("object", *METHODS), rows),
            TableText("Pushes, and how trials ended", ("", *METHODS), actions),
        ],
        "Pushes count in all trials, failed ones too.",
        {
            "success": {
                name: {method: one.to_json() for method, one in of.items()} for name, of in success.items()
            },
            "pushes": {method: one.to_json() for method, one in pushes.items()},
            "fates": {method: dict(of) for method, of in fates.items()},
            "paper": {"success": PREGRASP_SUCCESS, "pushes": PREGRASP_ACTIONS},
        },
        lambda: _figure(success),
    )


def _figure(success: dict[str, dict[str, Estimate]]) -> list[Figure]:
    from diagrams.figures.campaigns import shares_figure

    marks = {
        name: {method: (value, value) for method, value in of.items()}
        for name, of in PREGRASP_SUCCESS.items()
    }
    return [shares_figure("Brought to the edge, within 20 mm and 15° of the goal", success, marks)]


FIGURE_6 = Experiment("fig6", 100, _specs, _summary)
