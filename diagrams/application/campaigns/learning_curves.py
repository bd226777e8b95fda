"""Figures 3 and 4 of the paper: how well further pushes are predicted after one to five pushes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slipmap.diagrams.application import figures
from slipmap.diagrams.application.campaigns import experiments
from slipmap.diagrams.application.campaigns.trials import TrialOutcome, by_object, mean
from slipmap.diagrams.application.campaigns.worlds import DirectWorld, as_dataset, world_of
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.identification import identify
from slipmap.models.measurements import Trial
from slipmap.planners.pregrasp import explore
from slipmap.planners.settings import STRATEGIES, PregraspSettings

PUSHES = 5  # most pushes to learn from, as many as in the paper
CHECKS = 10  # random pushes of other placements that test a belief
MODELS = ("identified", "uniform", "Algorithm 1")
"""Models compared in figure 4: the default method, its uniform object, and Algorithm 1 as printed."""

Curves = dict[str, dict[str, list[list[float]]]]
"""Per object and per compared variant, for each trial, the errors (m) after 1 to `PUSHES` pushes."""


def strategies_trial(*, seed: int, truth: str, object_name: str, strategy: str) -> dict[str, Any]:
    """Trial of figure 3: errors (m) on the same test pushes after 1 to `PUSHES` pushes of a strategy."""
    world = world_of(truth, object_name)
    checks = _pushes(world, CHECKS, "random", seed, 0)
    trials = _pushes(world, PUSHES, strategy, seed, 1)
    found = [
        identify(as_dataset(world, trials[:count], checks), seed=seed, friction_laws=False)
        for count in range(1, PUSHES + 1)
    ]
    return {"errors": [float(one.errors("heldout").mean()) for one in found]}


def models_trial(*, seed: int, truth: str, object_name: str) -> dict[str, Any]:
    """Trial of figure 4: errors (m) of every model on test pushes after 1 to `PUSHES` random pushes."""
    world = world_of(truth, object_name)
    checks = _pushes(world, CHECKS, "random", seed, 0)
    trials = _pushes(world, PUSHES, "random", seed, 1)
    errors: dict[str, list[float]] = {name: [] for name in MODELS}
    for count in range(1, PUSHES + 1):
        dataset = as_dataset(world, trials[:count], checks)
        ours = identify(dataset, seed=seed, friction_laws=False)
        paper = identify(dataset, method="paper", seed=seed)
        for name, values in (
            ("identified", ours.errors("heldout")),
            ("uniform", ours.errors("heldout", "uniform_add")),
            ("Algorithm 1", paper.errors("heldout")),
        ):
            errors[name].append(float(values.mean()))
    return {"errors": errors}


def _pushes(world: DirectWorld, count: int, strategy: str, seed: int, series: int) -> Sequence[Trial]:
    """Pushes of an object placed at the middle of the table with a random orientation."""

    def learn(trials: Sequence[Trial]) -> Belief:
        return identify(as_dataset(world, trials), seed=seed, friction_laws=False).belief

    rng = np.random.default_rng([seed, series, 0])
    world.reset(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]), rng)
    settings = PregraspSettings(explorations=count, strategy=strategy)
    grid, choices = world.true_object.grid, np.random.default_rng([seed, series, 1])
    return explore(world, grid, settings, choices, learn=learn)


def _strategy_summary(outcomes: Sequence[TrialOutcome]) -> experiments.Summary:
    curves = {
        name: {
            strategy: [one.result["errors"] for one in of if one.spec.parameters["strategy"] == strategy]
            for strategy in STRATEGIES
        }
        for name, of in by_object(outcomes).items()
    }
    remark = (
        "The paper gives no numbers for its figure 3; it finds no clear advantage of chosen over random"
        " pushes."
    )
    title = "Error after N pushes chosen by a strategy (ADD: mean distance of cells, mm)"
    return _summary(title, "strategy", curves, remark)


def _model_summary(outcomes: Sequence[TrialOutcome]) -> experiments.Summary:
    curves = {
        name: {model: [one.result["errors"][model] for one in of] for model in MODELS}
        for name, of in by_object(outcomes).items()
    }
    remark = (
        "The paper gives no numbers for its figure 4; there, identified models predict better with more"
        " pushes."
    )
    return _summary("Error after N random pushes (ADD: mean distance of cells, mm)", "model", curves, remark)


def _summary(title: str, what: str, curves: Curves, remark: str) -> experiments.Summary:
    means = {
        name: {label: [mean(column) for column in zip(*trials, strict=True)] for label, trials in of.items()}
        for name, of in curves.items()
    }
    columns = (what, *map(str, range(1, PUSHES + 1)))
    tables = []
    for name, estimates in means.items():
        rows = [[label, *(one.short(1e3) for one in row)] for label, row in estimates.items()]
        count = max(map(len, curves[name].values()))
        tables.append(experiments.TableText(f"{title}: {name}, {count} trials", columns, rows))
    return experiments.Summary(
        tables, remark, {"curves": means, "unit": "m"}, lambda: [figures.curves_figure(title, means)]
    )


FIGURE_3 = experiments.Experiment("fig3", 10, strategies_trial, _strategy_summary, {"strategy": STRATEGIES})
FIGURE_4 = experiments.Experiment("fig4", 10, models_trial, _model_summary)
