"""Beyond the paper: how many pushes end within the belief's regions, on the table and at its rim.

An object is explored as for Figure 6, brought from the table's middle to the edge, pushed away from it, and
brought back. Every push is then predicted from its start with the recorded finger path, and its end is
compared with the belief's regions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slipmap.diagrams.application import figures
from slipmap.diagrams.application.campaigns import experiments
from slipmap.diagrams.application.campaigns.methods_compared import ALL
from slipmap.diagrams.application.campaigns.trials import Estimate, TrialOutcome, by_object, share
from slipmap.diagrams.application.campaigns.worlds import DirectWorld, as_dataset, identified, world_of
from slipmap.models.geometry import placed
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.prediction import Prediction, predict
from slipmap.models.measurements import Trial
from slipmap.models.measurements.push_dataset import Table
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.planners.exploration import NoReachablePush
from slipmap.planners.pregrasp import bring_to_edge
from slipmap.planners.push_decisions import ObjectFell, PushNotMade
from slipmap.planners.robust_push import plan_push
from slipmap.planners.settings import PregraspSettings

PLACES = ("table", "rim_at_end", "over_rim")
"""Kinds of pushes: the table carries all cells before and after; not all after; not all before."""

LEVELS = (0.5, 0.9, 0.95)
TRIALS_A_BELIEF = 2  # trials that share one belief, which decides how they go
_VISITS = 2  # to the edge in a trial
_BACK = (0.05, 0.12)  # m, how far a push is to move the object away from the edge
_TURN = np.radians(40.0)  # rad, how far it is to turn the object at most


def trial(*, seed: int, truth: str, object_name: str, belief_seed: int) -> dict[str, Any]:
    """Bring the object to the edge, away from it and back, and compare the ends with the belief's regions.

    Returns:
        `pushes`, each with its `place` (one of `PLACES`), `rarity` (probability under a correct model of an
        end at least as far out), `error` (ADD, m) and `spread` (of the hypotheses, m); `lost`: number of
        pushes left out because the object no longer lay on the table.
    """
    belief = identified(truth, object_name, belief_seed)
    world = world_of(truth, object_name)
    rng = np.random.default_rng([seed, 5])
    world.reset(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]), rng)
    made = pushes_at_the_edge(world, belief, np.random.default_rng([seed, 6]))
    seen = [one for one in made if one.object_pose.time[-1] >= one.tip_pose.time[-1]]
    pushes = predict(belief, as_dataset(world, [], seen)) if seen else ()
    told = [_told(push, belief.grid, world.table) for push in pushes]
    return {"pushes": told, "lost": len(made) - len(seen)}


def pushes_at_the_edge(world: DirectWorld, belief: Belief, rng: np.random.Generator) -> list[Trial]:
    """Pushes to the edge, away from it and back, until the object falls or no push is left."""
    settings = PregraspSettings()
    made: list[Trial] = []
    for visit in range(_VISITS):
        ended = bring_to_edge(world, belief, world.true_object.height, settings, rng)
        made += [push.trial for push in ended.pushes]
        if not ended.success or visit == _VISITS - 1:
            break
        try:
            pose = world.look()
            away = _off_the_edge(pose, world.table, rng)
            planned = plan_push(belief, pose, away, world.table, settings.push, rng)
            made.append(world.push(planned.push))
            world.look()
        except (ObjectFell, PushNotMade, NoReachablePush):
            break
    return made


def _off_the_edge(pose: FloatArray, table: Table, rng: np.random.Generator) -> FloatArray:
    """(3,) a pose nearer to the middle of the table."""
    inward = np.asarray(table.center) - pose[:2]
    inward = inward / max(float(np.hypot(*inward)), 1e-9)
    return np.array([*(pose[:2] + rng.uniform(*_BACK) * inward), pose[2] + rng.uniform(-_TURN, _TURN)])


def place_of(start: FloatArray, end: FloatArray, grid: CellGrid, table: Table) -> str:
    """The kind, one of `PLACES`, of a push from one pose (3,) to another."""
    if _sticks_out(start, grid, table):
        return "over_rim"
    return "rim_at_end" if _sticks_out(end, grid, table) else "table"


def _sticks_out(pose: FloatArray, grid: CellGrid, table: Table) -> bool:
    """Whether the centre of any cell is beyond the rim."""
    return bool((table.margin(placed(grid.centers, pose)) < 0.0).any())


def _told(push: Prediction, grid: CellGrid, table: Table) -> dict[str, Any]:
    return {
        "place": place_of(push.observation.push.start_pose, push.measured[-1], grid, table),
        "rarity": push.rarity,
        "error": push.final_add,
        "spread": push.spread,
    }


def coverage(pushes: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """By place: number of pushes, share inside each region, and medians; None without pushes."""
    found = {}
    for place in PLACES:
        here = [push for push in pushes if push["place"] == place]
        row: dict[str, Any] = {"pushes": len(here)}
        for level in LEVELS:
            inside = sum(push["rarity"] >= 1.0 - level for push in here)
            row[f"inside_{100 * level:.0f}"] = inside / len(here) if here else None
        for name in ("error", "spread"):
            row[f"{name}_median"] = float(np.median([push[name] for push in here])) if here else None
        found[place] = row
    return found


def _summary(outcomes: Sequence[TrialOutcome]) -> experiments.Summary:
    results = {name: [one.result for one in of] for name, of in by_object(outcomes).items()}
    pushes = {name: [push for one in of for push in one["pushes"]] for name, of in results.items()}
    pushes[ALL] = [push for of_object in pushes.values() for push in of_object]
    found = {name: coverage(of_object) for name, of_object in pushes.items()}
    rows = [
        [name, place.replace("_", " "), *_cells(row)]
        for name, places in found.items()
        for place, row in places.items()
        if row["pushes"]
    ]
    lost = sum(one["lost"] for of in results.values() for one in of)
    return experiments.Summary(
        [
            experiments.TableText(
                "Pushes that end inside the belief's regions, %",
                ("object", "", "pushes", *(f"{x:.0%}" for x in LEVELS), "error, mm", "spread, mm"),
                rows,
            )
        ],
        "Errors (ADD: mean distance between predicted and measured cells) and spreads are medians. Pushes"
        " with the same belief share its errors, so the intervals, which treat them as independent, are too"
        f" narrow. {lost} pushes after which the object did not lie on the table are left out.",
        {"coverage": found, "lost": lost},
        lambda: [
            figures.shares_figure("Pushes that end inside the belief's 95 % region", _inside(pushes), {})
        ],
    )


def _cells(row: dict[str, Any]) -> list[str]:
    count = row["pushes"]
    shares = [row[f"inside_{100 * level:.0f}"] for level in LEVELS]
    inside = [f"{100 * value:.0f}" for value in shares[:-1]]
    surest = share(round(shares[-1] * count), count).percent()
    medians = [f"{1e3 * row[name]:.1f}" for name in ("error_median", "spread_median")]
    return [str(count), *inside, surest, *medians]


def _inside(pushes: dict[str, list[dict[str, Any]]]) -> dict[str, dict[str, Estimate]]:
    """Share of pushes that end inside the 95 % region, by object and place."""
    return {
        name: {
            place.replace("_", " "): share(sum(p["rarity"] >= 0.05 for p in here), len(here))
            for place in PLACES
            if (here := [push for push in of_object if push["place"] == place])
        }
        for name, of_object in pushes.items()
    }


COVERAGE = experiments.Experiment("coverage", 20, trial, _summary, {}, TRIALS_A_BELIEF)
