"""Figures 6 and 7 of the paper: how often each method brings an object to the edge, and into the gripper.

In figure 6 the finger moves without an arm; in figure 7 the robot explores, pushes and grasps the object.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slipmap.diagrams.application import figures
from slipmap.diagrams.application.campaigns.experiments import (
    PREGRASP_ACTIONS,
    PREGRASP_SUCCESS,
    WHOLE_PROCEDURE,
    Experiment,
    Summary,
    TableText,
)
from slipmap.diagrams.application.campaigns.trials import Estimate, TrialOutcome, by_object, mean, share
from slipmap.diagrams.application.campaigns.worlds import DirectWorld, identified, world_of
from slipmap.models.geometry import angle_between
from slipmap.models.inference.belief import Belief
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.planners.pregrasp import Pregrasp, bring_to_edge
from slipmap.planners.push_decisions import ObjectFell
from slipmap.planners.settings import METHODS, PregraspSettings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from slipmap.diagrams.loops.exploration_run import ExplorationRun
    from slipmap.diagrams.station.scenario import Scenario

ALL = "all"  # row of all objects together
Paper = Mapping[str, Mapping[str, float]]  # success in % by object and method; not all need be present


@dataclass(frozen=True, eq=False)
class MethodsCompared:
    """Results of trials with several methods or models; each result has a `fate` and `pushes`."""

    # results of trials by object and method, with the row `ALL` if requested
    results: dict[str, dict[str, list[dict[str, Any]]]]
    success: dict[str, dict[str, Estimate]]  # share of trials by object and method
    pushes: dict[str, Estimate]  # mean number by method
    fates: dict[str, Counter[str]]  # numbers of trials by method and fate

    @property
    def methods(self) -> tuple[str, ...]:
        """Methods, in the order of the columns."""
        return tuple(self.pushes)

    def success_table(self, title: str, paper: Paper) -> TableText:
        """Table of success in %, with the paper's below."""
        rows = []
        for name, of_methods in self.success.items():
            rows.append([name, *(one.percent() for one in of_methods.values())])
            if name in paper:
                theirs = paper[name]
                rows.append(["  paper", *(f"{theirs[m]:.0f}" if m in theirs else "–" for m in self.methods)])
        return TableText(title, ("object", *self.methods), rows)

    def ways_table(
        self, title: str, label: str, fates: Sequence[str], paper: Mapping[str, float] | None = None
    ) -> TableText:
        """Table of the numbers of pushes, with the paper's below, and of trials with each fate."""
        rows = [[label, *(one.short(digits=2) for one in self.pushes.values())]]
        if paper is not None:
            rows.append(["  paper", *(f"{paper[method]:.2f}" for method in self.methods)])
        rows += [
            [fate, *(str(counts[fate]) if counts else "–" for counts in self.fates.values())]
            for fate in fates
        ]
        return TableText(title, ("", *self.methods), rows)

    def to_json(self, success: str) -> dict[str, Any]:
        """For JSON, with the shares of success under the key `success`."""
        return {success: self.success, "pushes": self.pushes, "fates": self.fates}

    def figures(self, title: str, paper: Paper) -> list[Figure]:
        """Bars of success, with marks for the paper's."""
        marks = {name: {method: (value, value) for method, value in of.items()} for name, of in paper.items()}
        return [figures.shares_figure(title, self.success, marks)]


def compare_methods(
    outcomes: Sequence[TrialOutcome],
    *,
    good: str,
    pushes: Callable[[Any], int],
    together: bool = False,
    parameter: str = "method",
    methods: Sequence[str] = METHODS,
) -> MethodsCompared:
    """Summarise trials; failed ones have no result and do not count.

    Args:
        good: the fate that counts as success.
        pushes: number of pushes of a result.
        together: whether to add a row `ALL`.
        parameter: of a trial, which holds its method.
        methods: in the order of the columns.
    """
    results = {
        name: {
            method: [one.result for one in of if one.spec.parameters[parameter] == method]
            for method in methods
        }
        for name, of in by_object(outcomes).items()
    }
    every = {method: [one for of in results.values() for one in of[method]] for method in methods}
    if together:
        results[ALL] = every
    return MethodsCompared(
        results,
        {
            name: {
                method: share(sum(one["fate"] == good for one in of[method]), len(of[method]))
                for method in methods
            }
            for name, of in results.items()
        },
        {method: mean([pushes(one) for one in every[method]]) for method in methods},
        {method: Counter(one["fate"] for one in every[method]) for method in methods},
    )


NEAR = 0.02  # largest distance from the goal, m; with `NEAR_ANGLE` the paper's criterion of success
NEAR_ANGLE = 15.0  # largest angle from the goal, deg
YAWS_A_BELIEF = 100  # trials that share one belief: the paper identifies each object once
EDGE_FATES = ("success", "fell", "missed", "gave up")


def edge_trial(*, seed: int, truth: str, object_name: str, method: str, belief_seed: int) -> dict[str, Any]:
    """Place the object at the middle of the table, turned at random, and let a method bring it to the edge.

    Returns:
        See `result_of`.
    """
    belief = identified(truth, object_name, belief_seed)
    world = world_of(truth, object_name)
    ended, yaw = brought_to_edge(world, belief, seed, method)
    return result_of(world, ended, yaw)


def brought_to_edge(
    world: DirectWorld, belief: Belief, seed: int, method: str = "probabilistic"
) -> tuple[Pregrasp, float]:
    """How the procedure ended from the middle of the table, and the initial yaw (rad)."""
    thing = world.true_object
    rng = np.random.default_rng([seed, 3])
    yaw = float(rng.uniform(-np.pi, np.pi))
    world.reset(np.array([0.0, 0.0, yaw]), rng)
    ended = bring_to_edge(
        world, belief, thing.height, PregraspSettings(), np.random.default_rng([seed, 4]),
        method=method, truth=thing.maps,
    )  # fmt: skip
    return ended, yaw


def result_of(world: DirectWorld, ended: Pregrasp, yaw: float) -> dict[str, Any]:
    """A trial's result.

    Returns:
        `success`: whether the object truly lies within 20 mm and 15° of the goal, flat on the table, and the
        method knows it; `fate`: `success`, `fell`, `missed` (wrongly counted as a success by the method) or
        `gave up`; `reason`: the procedure's message; `pushes`: their number; `yaw`, rad.
    """
    try:
        pose = world.true_pose
    except ObjectFell:
        fate = "fell"
    else:
        if not ended.success or ended.goal is None:
            fate = "gave up"
        else:
            fate = "success" if near(pose, ended.goal.pose) else "missed"
    return {"success": fate == "success", "fate": fate, "reason": ended.reason, "pushes": len(ended.pushes),
            "yaw": yaw}  # fmt: skip


def near(pose: FloatArray, goal: FloatArray) -> bool:
    """Whether a pose (3,) is within 20 mm and 15° of the goal (3,)."""
    angle = float(angle_between(pose[2], goal[2]))
    return bool(np.hypot(*(pose[:2] - goal[:2])) <= NEAR and abs(angle) <= np.radians(NEAR_ANGLE))


def _edge_summary(outcomes: Sequence[TrialOutcome]) -> Summary:
    compared = compare_methods(
        outcomes, good="success", pushes=lambda result: result["pushes"], together=True
    )
    return Summary(
        [
            compared.success_table("Brought to the edge, %", PREGRASP_SUCCESS),
            compared.ways_table("Pushes, and how trials ended", "pushes, mean", EDGE_FATES, PREGRASP_ACTIONS),
        ],
        "Numbers of pushes include unsuccessful trials.",
        compared.to_json("success") | {"paper": {"success": PREGRASP_SUCCESS, "pushes": PREGRASP_ACTIONS}},
        lambda: compared.figures("Brought to the edge, within 20 mm and 15° of the goal", PREGRASP_SUCCESS),
    )


FIGURE_6 = Experiment("fig6", 100, edge_trial, _edge_summary, {"method": METHODS}, YAWS_A_BELIEF)


FETCH_FATES = ("held", "fell", "dropped", "gave up")


def fetch_trial(*, seed: int, object_name: str, method: str) -> dict[str, Any]:
    """Run all of Algorithm 4, including the exploration, in each trial; see `taken`."""
    from slipmap.diagrams.station.scenario import Scenario

    return taken(Scenario(), seed, object_name, method)[0]


def taken(
    scenario: Scenario, seed: int, object_name: str, method: str, *, adapt: bool = False
) -> tuple[dict[str, Any], ExplorationRun | None]:
    """Place the object at the middle of the table, turned at random, and let the robot fetch it.

    Args:
        scenario: the cell; its object is replaced by `object_name`.
        adapt: whether the model is repaired during the run.

    Returns:
        The content of `PregraspRun.to_json` with `yaw` (deg), and the exploration, None where nothing could
        be learned; such a run counts as `gave up`.

    Raises:
        KeyboardInterrupt: Ctrl-C, which is no result.
    """
    from slipmap.diagrams.loops.exploration_loop import LoopOptions
    from slipmap.diagrams.loops.exploration_run import ExplorationFailed, ExplorationStopped
    from slipmap.diagrams.loops.pregrasp_loop import PregraspOptions, pregrasp

    scenario.object.name = object_name
    yaw = float(np.random.default_rng([seed, 3]).uniform(-180.0, 180.0))
    scenario.object.pose = [0.0, 0.0, yaw]
    options = PregraspOptions(LoopOptions(seed=seed, adapt=adapt), method=method)
    learned = None
    try:
        run = pregrasp(scenario, options)
        if run.interrupted:
            raise KeyboardInterrupt
        told, learned = run.to_json(), run.exploration
    except ExplorationStopped as error:
        raise KeyboardInterrupt from error
    except ExplorationFailed as error:
        told = {"fate": "gave up", "reason": str(error), "pushes": []}
    # Durations depend on the machine, but the same seeds must give the same result.
    return {key: value for key, value in told.items() if key != "seconds"} | {"yaw": yaw}, learned


def _fetch_summary(outcomes: Sequence[TrialOutcome]) -> Summary:
    compared = compare_methods(outcomes, good="held", pushes=lambda result: len(result["pushes"]))
    title = "Explored, brought to the edge, grasped and lifted"
    return Summary(
        [
            compared.success_table(f"{title}, %", WHOLE_PROCEDURE),
            compared.ways_table(
                "Pushes to the edge, and how trials ended", "pushes to the edge, mean", FETCH_FATES
            ),
        ],
        "Numbers of pushes include unsuccessful trials, but not the pushes for exploration.",
        compared.to_json("held") | {"paper": WHOLE_PROCEDURE},
        lambda: compared.figures(title, WHOLE_PROCEDURE),
    )


FIGURE_7 = Experiment(
    "fig7",
    10,
    fetch_trial,
    _fetch_summary,
    {"method": METHODS},
    plant_alone="the robot's cell",
    objects=("hammer",),
)
