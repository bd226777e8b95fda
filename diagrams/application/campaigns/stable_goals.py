"""Figure 5 of the paper: which poses at the table's edge a method considers stable, and which are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slipmap.diagrams.application import figures
from slipmap.diagrams.application.campaigns import experiments
from slipmap.diagrams.application.campaigns.trials import Estimate, TrialOutcome, by_object, share
from slipmap.diagrams.application.campaigns.worlds import DirectWorld, identified, world_of
from slipmap.models.geometry import rotated
from slipmap.models.physics.balance import balance_margins, fall_probability
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.planners.goals import Graspable
from slipmap.planners.pregrasp import planning_belief
from slipmap.planners.push_decisions import ObjectFell
from slipmap.planners.settings import METHODS, GoalSettings

_POSES = 10  # poses of an object in a trial
_DRAWS = 10  # draws of the deterministic method from one belief
_TRIES = 20_000  # most poses drawn to find those at which the gripper could grasp
_BINS = np.array([0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0])
"""Bins of the reliability diagram; most poses are nearly certain."""


def trial(*, seed: int, truth: str, object_name: str) -> dict[str, Any]:
    """Identify the object, draw graspable poses at the edge, let the methods choose, and try each pose.

    Returns:
        `poses`; `fell` for each; `stay_probability` of the whole belief, without safety margin; and `chosen`:
        for each method a list of its draws, each with a flag for every pose that is a goal.
    """
    belief = identified(truth, object_name, seed)
    world = world_of(truth, object_name)
    thing = world.true_object
    rng = np.random.default_rng([seed, 2])

    def graspable(method: str) -> Graspable:
        planning = planning_belief(method, belief, rng, thing.maps)
        return Graspable.of_belief(planning, thing.height, GoalSettings())

    poses = _poses(graspable("true"), world, rng)
    chosen = {
        method: [
            [goal is not None for goal in graspable(method).goals_at(poses, world.table)]
            for _ in range(_DRAWS if method == "deterministic" else 1)
        ]
        for method in METHODS
    }
    margins = balance_margins(belief.grid, belief.centers_of_mass, poses, world.table)
    return {
        "poses": poses.tolist(),
        "fell": [_falls(world, pose) for pose in poses],
        "stay_probability": (1.0 - fall_probability(margins, belief.probability)).tolist(),
        "chosen": chosen,
    }


def _poses(thing: Graspable, world: DirectWorld, rng: np.random.Generator) -> FloatArray:
    """(_POSES, 3) poses at the edge of a round table, uniform in place, angle and overhang, where the gripper
    could grasp the true object, stable or not."""
    radius = world.table.radius
    assert radius is not None
    found: list[FloatArray] = []
    for _ in range(_TRIES):
        place, angle, out = rng.uniform(0, 2 * np.pi), rng.uniform(-np.pi, np.pi), rng.uniform()
        outward = np.array([np.cos(place), np.sin(place)])
        extent = thing.grid.exterior @ rotated(outward, -angle)
        rim = extent.min() + out * (extent.max() - extent.min())
        pose = np.array([*(np.asarray(world.table.center) + (radius - rim) * outward), angle])
        if thing.grasps_at(pose, world.table):
            found.append(pose)
            if len(found) == _POSES:
                return np.array(found)
    raise RuntimeError(f"the gripper can grasp at only {len(found)} of {_TRIES} poses at the edge")


def _falls(world: DirectWorld, pose: FloatArray) -> bool:
    world.reset(pose, np.random.default_rng(0))
    try:
        _ = world.true_pose
    except ObjectFell:
        return True
    return False


def _summary(outcomes: Sequence[TrialOutcome]) -> experiments.Summary:
    results = {name: [one.result for one in of] for name, of in by_object(outcomes).items()}
    everything = [result for of_object in results.values() for result in of_object]
    precision, recall, rows, found = {}, {}, [], []
    for name, of_object in [*results.items(), ("all", everything)]:
        precision[name] = {method: _share(of_object, method, of_chosen=True) for method in METHODS}
        recall[name] = {method: _share(of_object, method, of_chosen=False) for method in METHODS}
        rows.append([name, *(one.percent() for one in precision[name].values())])
        found.append([name, *(one.percent() for one in recall[name].values())])
    paper = [
        f"{low:.0f}" if low == high else f"{low:.0f} to {high:.0f}"
        for low, high in experiments.STABLE_GOALS.values()
    ]
    rows.append(["paper", *paper, "–"])
    bins, marks = _reliability(everything), {name: experiments.STABLE_GOALS for name in precision}
    return experiments.Summary(
        [
            experiments.TableText("Stable among the goals chosen, %", ("object", *METHODS), rows),
            experiments.TableText("Chosen among stable, graspable poses, %", ("object", *METHODS), found),
        ],
        "Poses of a trial and draws from a belief are treated as independent. The paper used real objects.",
        {
            "precision": precision,
            "recall": recall,
            "reliability": [{"stated": stated, **vars(estimate)} for stated, estimate in bins],
            "paper": {method: list(ends) for method, ends in experiments.STABLE_GOALS.items()},
        },
        lambda: [
            figures.shares_figure("Stable among the goals chosen", precision, marks),
            figures.reliability_figure("Probability of staying on the table", {"all objects": bins}),
        ],
    )  # fmt: skip


def _share(results: Sequence[dict[str, Any]], method: str, *, of_chosen: bool) -> Estimate:
    """Share of stable among chosen poses, or of chosen among stable poses."""
    both = total = 0
    for result in results:
        stays = ~np.array(result["fell"])
        for draw in np.array(result["chosen"][method]):
            both += int((draw & stays).sum())
            total += int((draw if of_chosen else stays).sum())
    return share(both, total)


def _reliability(results: Sequence[dict[str, Any]]) -> list[tuple[float, Estimate]]:
    """For each nonempty bin, the mean probability of staying and the share that stayed."""
    stated = np.array([p for result in results for p in result["stay_probability"]])
    stayed = ~np.array([fell for result in results for fell in result["fell"]], dtype=bool)
    places = np.clip(np.searchsorted(_BINS, stated, side="right") - 1, 0, len(_BINS) - 2)
    return [
        (float(stated[places == k].mean()), share(int(stayed[places == k].sum()), int((places == k).sum())))
        for k in np.unique(places)
    ]


FIGURE_5 = experiments.Experiment("fig5", 20, trial, _summary)
