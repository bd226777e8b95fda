"""Whether a robot that repairs its model during a run names what was hidden from it, and what that gains.

Beyond the paper. Each cell of the station runs twice, with and without `--adapt`: the object is explored,
brought to the edge, grasped and lifted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

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

FELL = 0.4  # ratio of the error after to before at or below which another effect counts as equivalent
NEXT = 5  # number of pushes after the adoption that count


def trial(*, seed: int, object_name: str, hidden: str, robot: str) -> dict[str, Any]:
    """Let the robot fetch an object; see `taken`.

    Args:
        hidden: one of `HIDDEN`.
        robot: one of `ROBOTS`.

    Returns:
        The content of `PregraspRun.to_json`, `yaw`, `judged` (for each predicted push its error and how far
        it moved the object, m, its p, whether there was an alarm, and the effects of the model) and `repair`.

    Raises:
        KeyboardInterrupt: Ctrl-C, which is no result.
    """
    scenario = Scenario(hidden=HIDDEN[hidden])
    told, run = taken(scenario, seed, object_name, "probabilistic", adapt=robot == "adapting")
    if run is None:
        return told | {"judged": [], "repair": None}
    names = ("trial", "error", "moved", "p", "alarm")
    judged = [
        {name: getattr(one, name) for name in names} | {"effects": list(one.effects)}
        for one in run.watch.judged
    ]
    return told | {"judged": judged, "repair": None if run.repair is None else run.repair.to_json()}


def adopted(result: dict[str, Any]) -> list[str]:
    """Effects of the model at the end."""
    return [] if result["repair"] is None else list(result["repair"]["effects"])


def errors_by_adoption(result: dict[str, Any]) -> tuple[float, float] | None:
    """Median error of pushes as a share of their way: before the final effects were adopted, and for the next
    `NEXT` pushes with them; None where either is missing."""
    effects = set(adopted(result))
    with_them = [push for push in result["judged"] if effects and effects <= set(push["effects"])]
    if not with_them:
        return None
    before = [push for push in result["judged"] if push["trial"] < with_them[0]["trial"]]
    if not before:
        return None

    def median(pushes: Sequence[dict[str, Any]]) -> float:
        return float(np.median([push["error"] / max(push["moved"], 1e-3) for push in pushes]))

    return median(before), median(with_them[:NEXT])


def answer(hidden: str, result: dict[str, Any]) -> str:
    """How the robot dealt with the hidden effect: `none` adopted, `named`, `equivalent`, or `other`."""
    effects = adopted(result)
    if not effects:
        return "none"
    if NAMES.get(hidden) in effects:
        return "named"
    errors = errors_by_adoption(result)
    lowered = errors is not None and errors[1] <= FELL * errors[0]
    return "equivalent" if lowered and hidden != NOTHING else "other"


_ANSWERS = ("named", "equivalent", "other", "none")


def _summary(outcomes: Sequence[TrialOutcome]) -> experiments.Summary:
    every: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for outcome in outcomes:
        told = outcome.spec.parameters
        of = every.setdefault(told["hidden"], {robot: [] for robot in ROBOTS})
        if outcome.result is not None:
            of[told["robot"]].append(outcome.result)
    answers, off, delivered, fates, held, document = [], [], [], [], {}, {}
    for hidden, of in every.items():
        said = [answer(hidden, one) for one in of["adapting"]]
        counts = {name: said.count(name) for name in _ANSWERS}
        right = counts["none"] if hidden == NOTHING else counts["named"] + counts["equivalent"]
        found = share(right, len(said))
        fell = [pair for one in of["adapting"] if (pair := errors_by_adoption(one)) is not None]
        errors = {
            "before": mean([pair[0] for pair in fell]),
            "after": mean([pair[1] for pair in fell]),
            "ratio": mean([pair[1] / pair[0] for pair in fell]),
        }
        held[hidden] = {robot: share(_count(of[robot], "held"), len(of[robot])) for robot in ROBOTS}
        pushes = {robot: mean([len(one["pushes"]) for one in of[robot]]) for robot in ROBOTS}
        answers.append([hidden, str(len(said)), *(str(counts[name]) for name in _ANSWERS), found.percent()])
        two = (errors[name].short(1e2) for name in ("before", "after"))
        off.append([hidden, str(len(fell)), *two, errors["ratio"].short(digits=2)])
        numbers = (pushes[robot].short(digits=2) for robot in ROBOTS)
        delivered.append([hidden, *(held[hidden][robot].percent() for robot in ROBOTS), *numbers])
        fates.append([hidden, *(_fates(of[robot]) for robot in ROBOTS)])
        document[hidden] = {
            "answers": counts,
            "right": found,
            "errors": errors,
            "held": held[hidden],
            "pushes": pushes,
        }
    title = "Explored, brought to the edge, grasped and lifted"
    columns = ("hidden", *(f"held {robot}, %" for robot in ROBOTS), *(f"pushes {robot}" for robot in ROBOTS))
    return experiments.Summary(
        [
            experiments.TableText("Effects adopted", ("hidden", "trials", *_ANSWERS, "right, %"), answers),
            experiments.TableText(
                "Error of predicted ends, median of a trial, % of the push's way",
                ("hidden", "trials", "before", "with the effect", "ratio"),
                off,
            ),
            experiments.TableText(title, columns, delivered),
            experiments.TableText("How trials ended", ("hidden", *ROBOTS), fates),
        ],
        f"Another effect counts as equivalent if it lowers the error of the next {NEXT} pushes to {FELL:.0%}"
        " or less; where nothing is hidden, `none` is right. Only pushes towards the edge are counted.",
        {"hidden": document},
        lambda: [figures.shares_figure(title, held, {})],
    )


def _count(results: Sequence[dict[str, Any]], fate: str) -> int:
    return sum(one["fate"] == fate for one in results)


def _fates(results: Sequence[dict[str, Any]]) -> str:
    return (
        ", ".join(f"{_count(results, fate)} {fate}" for fate in FETCH_FATES if _count(results, fate)) or "–"
    )


ADAPTATION = experiments.Experiment(
    "adapt", 3, trial, _summary, {"hidden": tuple(HIDDEN), "robot": ROBOTS}, plant_alone="the robot's cell"
)
