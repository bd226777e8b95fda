"""Whether a robot that repairs its model during a run names what was hidden from it, and what that gains.

Beyond the paper. Each cell of the station runs twice, with and without `--adapt`: the object is explored,
brought to the edge, grasped and lifted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from slipmap.diagrams.application import figures
from slipmap.diagrams.application.campaigns import experiments
from slipmap.diagrams.application.campaigns.methods_compared import FETCH_FATES, taken
from slipmap.diagrams.application.campaigns.trials import TrialOutcome, mean, share
from slipmap.diagrams.station.hidden_effects import (
    HiddenEffectsConfig,
    SensorLatency,
    TableFrictionField,
    TableTilt,
    Tether,
    ViscousFriction,
)
from slipmap.diagrams.station.scenario import Scenario
from slipmap.models.geometry import compose
from slipmap.models.physics.paper_notation import add

if TYPE_CHECKING:
    from slipmap.diagrams.loops.exploration_run import ExplorationRun

ROBOTS = ("adapting", "plain")  # how the robot runs: with or without `--adapt`
NOTHING = "nothing"

HIDDEN: dict[str, HiddenEffectsConfig] = {
    NOTHING: HiddenEffectsConfig(),
    "tilt": HiddenEffectsConfig(table_tilt=TableTilt(down_x=float(np.radians(2.0)))),
    "latency": HiddenEffectsConfig(sensor_latency=SensorLatency(0.08)),
    # Friction is halved on a patch beside the middle.
    "patch": HiddenEffectsConfig(
        table_friction_field=TableFrictionField(patch=-0.7, patch_x=0.08, patch_y=0.05, patch_radius=0.12)
    ),
    "film": HiddenEffectsConfig(viscous_friction=ViscousFriction(400.0)),
    "tether": HiddenEffectsConfig(tether=Tether(stiffness=5.0, anchor_x=0.35, anchor_y=0.2, slack=0.2)),
}
"""What is hidden, by its name in the tables."""

NAMES = {
    "tilt": "table_tilt",
    "latency": "sensor_latency",
    "patch": "table_friction_field",
    "film": "viscous_friction",
    "tether": "tether",
}
"""The correct effect of the library for each hidden effect."""

MOVES = 5e-3
"""m by which an effect must change where the first pushes end, in the median, to be worth a name."""

SOON = 10  # pushes within which the effect must be adopted for that
FIRST = 5  # number of exploring pushes that count for this: those made whatever is adopted later

FELL = 0.4  # ratio of the error after to before at or below which another effect counts as equivalent
NEXT = 5  # number of pushes after the adoption that count


def trial(*, seed: int, object_name: str, hidden: str, robot: str) -> dict[str, Any]:
    """Let the robot fetch an object; see `taken`.

    Args:
        hidden: one of `HIDDEN`.
        robot: one of `ROBOTS`.

    Returns:
        The content of `PregraspRun.to_json`, `yaw`, `judged` (for each predicted push its error and how far
        it moved the object, m, its p, whether there was an alarm, and the effects of the model), `repair`,
        and for the adapting robot `shifts`, see `shifts_of_ends`.

    Raises:
        KeyboardInterrupt: Ctrl-C, which is no result.
    """
    scenario = Scenario(hidden=HIDDEN[hidden])
    told, run = taken(scenario, seed, object_name, "probabilistic", adapt=robot == "adapting")
    if run is None:
        return told | {"judged": [], "repair": None, "shifts": []}
    names = ("trial", "error", "moved", "p", "alarm")
    judged = [
        {name: getattr(one, name) for name in names} | {"effects": list(one.effects)}
        for one in run.watch.judged
    ]
    repair = None if run.repair is None else run.repair.to_json()
    shifts = shifts_of_ends(run, HIDDEN[hidden]) if robot == "adapting" else []
    return told | {"judged": judged, "repair": repair, "shifts": shifts}


def shifts_of_ends(run: ExplorationRun, hidden: HiddenEffectsConfig) -> list[float | None]:
    """Distances (ADD), m, between the true ends of the first pushes with and without the hidden effects.

    Both ends come from the plant without an arm, from the recorded pose and track of the finger. A distance
    is None where the object falls with the effects or without.
    """
    from slipmap.diagrams.application.campaigns.plant_world import PlantWorld

    thing, X_SO = run.true_object, run.X_SO
    assert thing is not None and X_SO is not None
    pushes = run.dataset.trials[:FIRST]
    if not hidden.is_forceful:
        return [0.0] * len(pushes)
    worlds = [PlantWorld(thing, hidden=effects) for effects in (hidden, None)]
    shifts: list[float | None] = []
    for push in pushes:
        X_WO = compose(push.object_pose.values[0], X_SO)
        ends = np.array([world.replayed(push, X_WO) for world in worlds])
        shifts.append(None if np.isnan(ends).any() else float(add(ends[0], ends[1], thing.grid.centers)))
    return shifts


def adopted(result: dict[str, Any]) -> list[str]:
    """Effects of the model at the end, with the one that may be there instead of the last."""
    if result["repair"] is None:
        return []
    rival = result["repair"].get("rival", "")
    return [*result["repair"]["effects"], *([rival] if rival else [])]


def errors_by_adoption(result: dict[str, Any]) -> tuple[float, float] | None:
    """Median error of pushes as a share of their way: before the final effects were adopted, and for the next
    `NEXT` pushes with them; None where either is missing."""
    from slipmap.diagrams.systems.diagnosis import has_model

    if not adopted(result):
        return None
    model = result["repair"]["effects"], result["repair"].get("rival", "")
    with_them = [push for push in result["judged"] if has_model(push["effects"], *model)]
    if not with_them:
        return None
    before = [push for push in result["judged"] if push["trial"] < with_them[0]["trial"]]
    if not before:
        return None

    def median(pushes: Sequence[dict[str, Any]]) -> float:
        return float(np.median([push["error"] / max(push["moved"], 1e-3) for push in pushes]))

    return median(before), median(with_them[:NEXT])


def answer(hidden: str, result: dict[str, Any]) -> str:
    """How the robot dealt with the hidden effect: `none` adopted, `named`, also where the model has it or a
    rival, `equivalent`, or `other`."""
    effects = adopted(result)
    if not effects:
        return "none"
    if NAMES.get(hidden) in effects:
        return "named"
    errors = errors_by_adoption(result)
    lowered = errors is not None and errors[1] <= FELL * errors[0]
    return "equivalent" if lowered and hidden != NOTHING else "other"


def is_needed(result: dict[str, Any]) -> bool:
    """Whether the hidden effects change where the first pushes end by at least `MOVES` in the median."""
    shifts = [np.inf if shift is None else shift for shift in result["shifts"]]
    return bool(shifts) and bool(np.median(shifts) >= MOVES)


def adopted_after(result: dict[str, Any]) -> int | None:
    """Number of pushes after which the effects of the model at the end were adopted; None without any."""
    if not adopted(result):
        return None
    return int([one["pushes"] for one in result["repair"]["findings"] if one["action"] == "adopts"][-1])


_ANSWERS = ("named", "equivalent", "other", "none")
_EVERY = "all effects"


def _summary(outcomes: Sequence[TrialOutcome]) -> experiments.Summary:
    every: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for outcome in outcomes:
        told = outcome.spec.parameters
        of = every.setdefault(told["hidden"], {robot: [] for robot in ROBOTS})
        if outcome.result is not None:
            of[told["robot"]].append(outcome.result | {"hidden": told["hidden"]})
    hiding = [of for hidden, of in every.items() if hidden != NOTHING]
    if len(hiding) > 1:
        every[_EVERY] = {robot: [one for of in hiding for one in of[robot]] for robot in ROBOTS}
    found = {hidden: _found(of) for hidden, of in every.items()}
    answers, matter, off, delivered, fates = [], [], [], [], []
    for hidden, row in found.items():
        right, needed, errors = row["right"], row["right_where_needed"], row["errors"]
        answers.append([hidden, str(right.count), *map(str, row["answers"].values()), right.percent()])
        matter.append([hidden, str(row["needed"]), "–" if needed is None else needed.percent()])
        ratio = "–" if errors["ratio"] is None else f"{errors['ratio']:.2f}"
        numbers = [errors[when].short(1e2) for when in ("before", "after")]
        off.append([hidden, str(errors["before"].count), *numbers, ratio])
        numbers = [row["held"][robot].percent() for robot in ROBOTS]
        numbers += [row["pushes"][robot].short(digits=2) for robot in ROBOTS]
        delivered.append([hidden, *numbers])
        fates.append([hidden, *(_fates(every[hidden][robot]) for robot in ROBOTS)])
    held = {hidden: row["held"] for hidden, row in found.items()}
    title = "Explored, brought to the edge, grasped and lifted"
    columns = ("hidden", *(f"held {robot}, %" for robot in ROBOTS), *(f"pushes {robot}" for robot in ROBOTS))
    return experiments.Summary(
        [
            experiments.TableText("Effects adopted", ("hidden", "trials", *_ANSWERS, "right, %"), answers),
            experiments.TableText("Where they are needed", ("hidden", "trials", "right in time, %"), matter),
            experiments.TableText(
                "Error of predicted ends, median of a trial, % of the push's way; median of the ratios",
                ("hidden", "trials", "before", "with the effect", "ratio"),
                off,
            ),
            experiments.TableText(title, columns, delivered),
            experiments.TableText("How trials ended", ("hidden", *ROBOTS), fates),
        ],
        "An effect counts as named also where the model has it or a rival."
        f" Another effect counts as equivalent if it lowers the error of the next {NEXT} pushes to {FELL:.0%}"
        f" or less; where nothing is hidden, `none` is right. An effect is needed if the first {FIRST} pushes"
        f" end {1e3 * MOVES:.0f} mm or more elsewhere with it (median, in the plant), and in time within"
        f" {SOON} pushes. Only pushes towards the edge are counted.",
        {"hidden": found},
        lambda: [figures.shares_figure(title, held, {})],
    )


def _found(of: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    """What the trials of each robot showed: counts, estimates and, where there is nothing to count, None."""
    adapting = of["adapting"]
    said = [answer(one["hidden"], one) for one in adapting]
    right = [_is_right(one) for one in adapting]
    needed = [_is_right(one) and (adopted_after(one) or 0) <= SOON for one in adapting if is_needed(one)]
    fell = [pair for one in adapting if (pair := errors_by_adoption(one)) is not None]
    before, after = (mean([pair[k] for pair in fell]) for k in (0, 1))
    return {
        "answers": {name: said.count(name) for name in _ANSWERS},
        "right": share(sum(right), len(right)),
        "needed": len(needed),
        "right_where_needed": share(sum(needed), len(needed)) if needed else None,
        "errors": {
            "before": before,
            "after": after,
            "ratio": float(np.median([pair[1] / pair[0] for pair in fell])) if fell else None,
        },
        "held": {robot: share(_count(of[robot], "held"), len(of[robot])) for robot in ROBOTS},
        "pushes": {robot: mean([len(one["pushes"]) for one in of[robot]]) for robot in ROBOTS},
    }


def _is_right(result: dict[str, Any]) -> bool:
    said = answer(result["hidden"], result)
    return said == "none" if result["hidden"] == NOTHING else said in ("named", "equivalent")


def _count(results: Sequence[dict[str, Any]], fate: str) -> int:
    return sum(one["fate"] == fate for one in results)


def _fates(results: Sequence[dict[str, Any]]) -> str:
    return (
        ", ".join(f"{_count(results, fate)} {fate}" for fate in FETCH_FATES if _count(results, fate)) or "–"
    )


ADAPTATION = experiments.Experiment(
    "adapt", 3, trial, _summary, {"hidden": tuple(HIDDEN), "robot": ROBOTS}, plant_alone="the robot's cell"
)
