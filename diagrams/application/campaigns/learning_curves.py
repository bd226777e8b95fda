"""Figures 3 and 4 of the paper: how well further pushes are predicted after one push, two pushes, and on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from slipmap.diagrams.application.campaigns.direct_world import DirectWorld
from slipmap.diagrams.application.campaigns.experiments import (
    Experiment,
    Summary,
    TableText,
    names_and_seeds,
)
from slipmap.diagrams.application.campaigns.worlds import world_of
from slipmap.diagrams.systems.measurement_logger import dataset_of
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements import PushDataset, Trial
from slipmap.planners.pregrasp import learn_by_pushing
from slipmap.planners.settings import STRATEGIES, PregraspSettings
from slipmap.planners.trials import Estimate, TrialOutcome, TrialSpec, mean

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from slipmap.models.measurements import Trial


PUSHES = 5
"""To learn from, at most; as many as the paper's identification has."""
CHECKS = 10
"""Random pushes of other placements, by which a belief is judged."""
MODELS = ("identified", "uniform", "Algorithm 1")
"""Compared in figure 4: the default method, its uniform object, and Algorithm 1 as printed."""

_HERE = "slipmap.diagrams.application.campaigns.learning_curves"


def strategies_trial(*, seed: int, truth: str, object_name: str, strategy: str) -> dict[str, Any]:
    """Trial of figure 3: errors (m) on the same further pushes, after 1 to `PUSHES` pushes of a strategy."""
    from slipmap.diagrams.application.campaigns.worlds import world_of
    from slipmap.models.inference.identification import identify

    world = world_of(truth, object_name)
    checks = _pushes(world, CHECKS, "random", seed, 0)
    trials = _pushes(world, PUSHES, strategy, seed, 1)
    found = [identify(as_dataset(world, trials[:count], checks), seed=seed) for count in range(1, PUSHES + 1)]
    return {"errors": [float(one.errors("heldout").mean()) for one in found]}


def models_trial(*, seed: int, truth: str, object_name: str) -> dict[str, Any]:
    """Trial of figure 4: errors (m) of every model on further pushes, after 1 to `PUSHES` random pushes."""
    from slipmap.diagrams.application.campaigns.worlds import world_of
    from slipmap.models.inference.identification import identify

    world = world_of(truth, object_name)
    checks = _pushes(world, CHECKS, "random", seed, 0)
    trials = _pushes(world, PUSHES, "random", seed, 1)
    errors: dict[str, list[float]] = {name: [] for name in MODELS}
    for count in range(1, PUSHES + 1):
        dataset = as_dataset(world, trials[:count], checks)
        ours = identify(dataset, seed=seed)
        paper = identify(dataset, method="paper", seed=seed)
        for name, values in (
            ("identified", ours.errors("heldout")),
            ("uniform", ours.errors("heldout", "uniform_add")),
            ("Algorithm 1", paper.errors("heldout")),
        ):
            errors[name].append(float(values.mean()))
    return {"errors": errors}


def _pushes(world: DirectWorld, count: int, strategy: str, seed: int, series: int) -> Sequence[Trial]:
    """Pushes of an object that is put down at the table's middle, turned at random."""
    from slipmap.models.inference.identification import identify
    from slipmap.planners.pregrasp import explore
    from slipmap.planners.settings import PregraspSettings

    def learn(trials: Sequence[Trial]) -> Belief:
        return identify(as_dataset(world, trials), seed=seed).belief

    rng = np.random.default_rng([seed, series, 0])
    world.reset(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]), rng)
    settings = PregraspSettings(explorations=count, strategy=strategy)
    grid, choices = world.true_object.grid, np.random.default_rng([seed, series, 1])
    return explore(world, grid, settings, choices, learn=learn)


def _strategy_specs(objects: Sequence[str], trials: int, seed: int, truth: str) -> list[TrialSpec]:
    return [
        TrialSpec(
            f"{name}-{strategy}-{number}",
            f"{_HERE}:strategies_trial",
            {"truth": truth, "object_name": name, "strategy": strategy},
            number,
        )
        for name, number in names_and_seeds(objects, trials, seed)
        for strategy in STRATEGIES
    ]


def _model_specs(objects: Sequence[str], trials: int, seed: int, truth: str) -> list[TrialSpec]:
    return [
        TrialSpec(f"{name}-{number}", f"{_HERE}:models_trial", {"truth": truth, "object_name": name}, number)
        for name, number in names_and_seeds(objects, trials, seed)
    ]


def _strategy_summary(outcomes: Sequence[TrialOutcome]) -> Summary:
    curves: dict[str, dict[str, list[list[float]]]] = {}
    for outcome in outcomes:
        if outcome.result is not None:
            parameters = outcome.spec.parameters
            of_object = curves.setdefault(parameters["object_name"], {name: [] for name in STRATEGIES})
            of_object[parameters["strategy"]].append(outcome.result["errors"])
    remark = (
        "The paper's figure 3 has no numbers in its text; it finds no clear advantage of choosing pushes over"
        " random ones."
    )
    return _summary("Error after N pushes chosen by a strategy (mean ADD, mm)", "strategy", curves, remark)


def _model_summary(outcomes: Sequence[TrialOutcome]) -> Summary:
    curves: dict[str, dict[str, list[list[float]]]] = {}
    for outcome in outcomes:
        if outcome.result is not None:
            of_object = curves.setdefault(
                outcome.spec.parameters["object_name"], {name: [] for name in MODELS}
            )
            for name in MODELS:
                of_object[name].append(outcome.result["errors"][name])
    remark = (
        "The paper's figure 4 has no numbers in its text; there, identified models predict better the more"
        " pushes they have seen."
    )
    return _summary("Error after N random pushes (mean ADD, mm)", "model", curves, remark)


def _summary(title: str, what: str, curves: dict[str, dict[str, list[list[float]]]], remark: str) -> Summary:
    tables, document = [], {}
    columns = (what, *map(str, range(1, PUSHES + 1)))
    for name, of_object in curves.items():
        estimates = _curves_of(of_object)
        document[name] = {label: [one.to_json() for one in row] for label, row in estimates.items()}
        rows = [[label, *(one.short(1e3) for one in row)] for label, row in estimates.items()]
        count = max(map(len, of_object.values()))
        tables.append(TableText(f"{title}: {name}, {count} trials", columns, rows))
    return Summary(tables, remark, {"curves": document, "unit": "m"}, lambda: _figure(title, curves))


def _curves_of(values: Mapping[str, Sequence[Sequence[float]]]) -> dict[str, list[Estimate]]:
    """For each label the means over trials, one for each place along the curve."""
    return {label: [mean(column) for column in zip(*trials, strict=True)] for label, trials in values.items()}


def _figure(title: str, curves: dict[str, dict[str, list[list[float]]]]) -> list[Figure]:
    from slipmap.diagrams.application.figures.campaign_figures import curves_figure

    return [curves_figure(title, {name: _curves_of(labels) for name, labels in curves.items()})]


FIGURE_3 = Experiment("fig3", 10, _strategy_specs, _strategy_summary)
FIGURE_4 = Experiment("fig4", 10, _model_specs, _model_summary)


# Pushes recorded in a campaign's world, and what is learned from them.


MOST_PUSHES = 5
"""From which an object is identified, as in the paper."""


def as_dataset(world: DirectWorld, fit: Sequence[Trial], heldout: Sequence[Trial] = ()) -> PushDataset:
    """Recorded trials as a dataset: those to learn from, then those to judge with.

    Raises:
        DatasetError: there is no trial.
    """
    trials = [
        replace(trial, name=f"trials/{number:03d}.json", role="fit" if number < len(fit) else "heldout")
        for number, trial in enumerate([*fit, *heldout])
    ]
    return dataset_of(
        trials,
        world.true_object.grid,
        name=world.true_object.name,
        finger_radius=world.finger_radius,
        noise=world.noise.sensors,
        table=world.table,
        description=f"Recorded in the world of {type(world).__name__}.",
    )


@lru_cache(maxsize=32)
def identified(truth: str, object_name: str, seed: int) -> Belief:
    """What five pushes of an object in its world teach; made once in a process for each seed.

    Raises:
        ObjectFell, PushNotMade: the object could not be explored.
    """
    return explored(world_of(truth, object_name), seed)[0]


def explored(world: DirectWorld, seed: int) -> tuple[Belief, tuple[Trial, ...]]:
    """What `MOST_PUSHES` pushes teach of the object at the table's middle, and the pushes.

    Raises:
        ObjectFell, PushNotMade: the object could not be explored.
    """
    rng = np.random.default_rng([seed, 0])
    world.reset(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]), rng)
    return learn_by_pushing(
        world,
        world.true_object.grid,
        lambda trials, grid: as_dataset(world, trials),
        PregraspSettings(explorations=MOST_PUSHES),
        np.random.default_rng([seed, 1]),
    )
