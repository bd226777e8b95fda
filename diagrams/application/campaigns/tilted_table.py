"""What a missing effect costs: planning on a tilted table with and without the tilt in the model.

Beyond the paper. Both models learn from the same five pushes on the tilted table, only one of them with a
tilt as an effect; then each brings the object from the middle to the edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from slipmap.diagrams.application import figures
from slipmap.diagrams.application.campaigns import experiments
from slipmap.diagrams.application.campaigns.methods_compared import (
    EDGE_FATES,
    brought_to_edge,
    compare_methods,
    result_of,
)
from slipmap.diagrams.application.campaigns.plant_world import PlantWorld
from slipmap.diagrams.application.campaigns.trials import TrialOutcome, mean
from slipmap.diagrams.application.campaigns.worlds import as_dataset, explored
from slipmap.diagrams.station.hidden_effects import HiddenEffectsConfig, TableTilt
from slipmap.models.geometry import turned_to
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.identification import identify
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.physics.paper_notation import add
from slipmap.planners.pregrasp import Pregrasp
from slipmap.planners.settings import NEGLIGIBLE

TILT = 2.0  # slope of the table, deg
MODELS = ("without the tilt", "with the tilt")  # the models compared
YAWS_A_BELIEF = 5  # trials that share one belief; learning takes longer than pushing


def trial(*, seed: int, object_name: str, model: str, belief_seed: int) -> dict[str, Any]:
    """Bring the object to the edge of the tilted table with the belief of one of `MODELS`.

    Returns:
        The result as in figure 6, and `errors`: for each push, mean distance of the cells from the mean
        prediction of the hypotheses, m, without pushes after which the object was not seen.
    """
    belief = _learned(object_name, belief_seed)[MODELS.index(model)]
    world = _world(object_name)
    ended, yaw = brought_to_edge(world, belief, seed)
    return result_of(world, ended, yaw) | {"errors": _errors(belief, ended)}


@lru_cache(maxsize=8)
def _world(object_name: str) -> PlantWorld:
    hidden = HiddenEffectsConfig(table_tilt=TableTilt(down_x=float(np.radians(TILT))))
    return PlantWorld(benchmark_object(object_name), hidden=hidden)


@lru_cache(maxsize=8)
def _learned(object_name: str, seed: int) -> tuple[Belief, Belief]:
    """The beliefs of `MODELS`, learned from the same pushes."""
    world = _world(object_name)
    plain, trials = explored(world, seed)
    tilted = identify(as_dataset(world, trials), ["table_tilt"], seed=seed)
    return plain, tilted.belief


def _errors(belief: Belief, ended: Pregrasp) -> list[float]:
    errors = []
    for made in ended.pushes:
        if made.trial.object_pose.time[-1] < made.trial.tip_pose.time[-1]:
            continue
        # Hypotheses may differ by whole turns.
        predicted = turned_to(made.planned.predicted, made.before[2])
        weights = belief.probability[belief.probability > NEGLIGIBLE]
        weights = weights / weights.sum()
        errors.append(float(add(weights @ predicted, made.trial.object_pose.values[-1], belief.grid.centers)))
    return errors


def _summary(outcomes: Sequence[TrialOutcome]) -> experiments.Summary:
    compared = compare_methods(
        outcomes, good="success", pushes=lambda result: result["pushes"], together=True,
        parameter="model", methods=MODELS,
    )  # fmt: skip
    errors = {
        name: {
            model: mean([float(np.mean(one["errors"])) for one in results if one["errors"]])
            for model, results in of.items()
        }
        for name, of in compared.results.items()
    }
    title = f"Brought to the edge of a table tilted by {TILT:g}°"
    off = [[name, *(one.short(1e3) for one in of.values())] for name, of in errors.items()]
    told = compared.to_json("success")
    return experiments.Summary(
        [
            compared.success_table(f"{title}, %", {}),
            experiments.TableText("Mean error of predicted ends, mm", ("object", *MODELS), off),
            compared.ways_table("Pushes, and how trials ended", "pushes, mean", EDGE_FATES),
        ],
        "Both models learn from the same five pushes. The error of a trial is the mean over its pushes.",
        {"tilt": TILT, "success": told.pop("success"), "errors": errors, **told},
        lambda: [
            figures.means_figure("Error of predicted ends", errors, 1e3, "mean error, mm"),
            *compared.figures(title, {}),
        ],
    )


TILTED_TABLE = experiments.Experiment(
    "tilt", 20, trial, _summary, {"model": MODELS}, YAWS_A_BELIEF, plant_alone="the tilted table"
)
