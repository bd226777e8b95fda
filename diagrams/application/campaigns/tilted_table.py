"""What a missing effect costs: a table that is not level, planned for as if it were, and with its tilt.

Beyond the paper. Both models learn from the same five pushes on the tilted table. One has no tilt among what
it can learn, the other has; then each brings the object from the middle to the edge.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from slipmap.diagrams.application.campaigns import experiments
from slipmap.diagrams.application.campaigns.methods_compared import ALL, results_of
from slipmap.diagrams.application.campaigns.pregrasp_success import FATES, brought_to_edge, result_of
from slipmap.planners.trials import CampaignError, Estimate, TrialOutcome, TrialSpec, mean, share

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from slipmap.diagrams.application.campaigns.plant_world import PlantWorld
    from slipmap.models.inference.belief import Belief
    from slipmap.planners.pregrasp import Pregrasp

TILT = 2.0
"""Slope of the table, deg."""
MODELS = ("without the tilt", "with the tilt")
"""What the models can learn."""
YAWS_A_BELIEF = 5
"""Trials with one and the same belief; learning takes longer than pushing."""


def trial(*, seed: int, object_name: str, model: str, belief_seed: int) -> dict[str, Any]:
    """Bring the object over the tilted table with what one of `MODELS` learned.

    Returns:
        That of figure 6, and `errors`: of each push, mean distance of the cells from where the mean of the
        hypotheses had them, m; a push after which the object was not seen is left out.
    """
    belief = _learned(object_name, belief_seed)[MODELS.index(model)]
    world = _world(object_name)
    ended, yaw = brought_to_edge(world, belief, seed)
    return result_of(world, ended, yaw) | {"errors": _errors(belief, ended)}


@lru_cache(maxsize=8)
def _world(object_name: str) -> PlantWorld:
    from slipmap.diagrams.application.campaigns.plant_world import PlantWorld
    from slipmap.diagrams.station.hidden_effects import HiddenEffectsConfig, TableTilt
    from slipmap.models.objects.benchmark_objects import benchmark_object

    hidden = HiddenEffectsConfig(table_tilt=TableTilt(down_x=float(np.radians(TILT))))
    return PlantWorld(benchmark_object(object_name), hidden=hidden)


@lru_cache(maxsize=8)
def _learned(object_name: str, seed: int) -> tuple[Belief, Belief]:
    """Beliefs of `MODELS`, from the same pushes."""
    from slipmap.diagrams.application.campaigns.worlds import as_dataset, explored
    from slipmap.models.inference.identification import identify

    world = _world(object_name)
    plain, trials = explored(world, seed)
    tilted = identify(as_dataset(world, trials), ["table_tilt"], seed=seed)
    return plain, tilted.belief


def _errors(belief: Belief, ended: Pregrasp) -> list[float]:
    from slipmap.models.geometry import turned_to
    from slipmap.models.physics.paper_notation import add
    from slipmap.planners.robust_push import NEGLIGIBLE

    errors = []
    for made in ended.pushes:
        if made.trial.object_pose.time[-1] < made.trial.tip_pose.time[-1]:
            continue
        # One hypothesis may count the angle a turn further than another.
        predicted = turned_to(made.planned.predicted, made.before[2])
        weights = belief.probability[belief.probability > NEGLIGIBLE]
        weights = weights / weights.sum()
        errors.append(float(add(weights @ predicted, made.trial.object_pose.values[-1], belief.grid.centers)))
    return errors


def _specs(objects: Sequence[str], trials: int, seed: int, truth: str) -> list[TrialSpec]:
    if truth != "plant":
        raise CampaignError("tilt: the tilted table is simulated by plant alone; leave out --truth")
    return experiments.specs_of(
        f"{__name__}:trial", objects, trials, seed, {"model": MODELS},
        lambda number: {"belief_seed": number // YAWS_A_BELIEF},
    )  # fmt: skip


def _summary(outcomes: Sequence[TrialOutcome]) -> experiments.Summary:
    results, every = results_of(outcomes, "model", MODELS)
    rows_of = [*results.items(), (ALL, every)]
    success = {
        name: {model: share(sum(one["success"] for one in of[model]), len(of[model])) for model in MODELS}
        for name, of in rows_of
    }
    errors = {name: {model: _mean_error(of[model]) for model in MODELS} for name, of in rows_of}
    pushes = {model: mean([one["pushes"] for one in every[model]]) for model in MODELS}
    fates = {model: Counter(one["fate"] for one in every[model]) for model in MODELS}
    title = f"Brought to the edge of a table tilted by {TILT:g}°"
    rows = [["pushes, mean", *(pushes[model].short(digits=2) for model in MODELS)]]
    rows += [[fate, *(str(fates[model][fate]) for model in MODELS)] for fate in FATES]
    return experiments.Summary(
        [
            experiments.TableText(f"{title}, %", ("object", *MODELS), _rows(success, Estimate.percent)),
            experiments.TableText(
                "Where pushes end off their prediction, mean, mm",
                ("object", *MODELS),
                _rows(errors, lambda one: one.short(1e3)),
            ),
            experiments.TableText("Pushes, and how trials ended", ("", *MODELS), rows),
        ],
        "Both models learn from the same five pushes. A trial's error is the mean over its pushes.",
        {
            "tilt": TILT,
            "success": experiments.as_json(success),
            "errors": experiments.as_json(errors),
            "pushes": experiments.as_json(pushes),
            "fates": {model: dict(of) for model, of in fates.items()},
        },
        lambda: _figures(title, success, errors),
    )


def _mean_error(results: Sequence[dict[str, Any]]) -> Estimate:
    return mean([float(np.mean(one["errors"])) for one in results if one["errors"]])


def _rows(estimates: dict[str, dict[str, Estimate]], told: Any) -> list[list[str]]:
    return [[name, *(told(one) for one in of.values())] for name, of in estimates.items()]


def _figures(
    title: str, success: dict[str, dict[str, Estimate]], errors: dict[str, dict[str, Estimate]]
) -> list[Figure]:
    from slipmap.diagrams.application.figures.campaign_figures import means_figure, shares_figure

    off = means_figure("Where pushes end off their prediction", errors, 1e3, "mm")
    return [off, shares_figure(title, success, {})]


TILTED_TABLE = experiments.Experiment("tilt", 20, _specs, _summary)
