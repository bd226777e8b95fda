"""Figure 6 of the paper: how often each method brings an object to the edge, and with how many pushes."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from slipmap.diagrams.application.campaigns.experiments import (
    PREGRASP_ACTIONS,
    PREGRASP_SUCCESS,
    Experiment,
    Summary,
)
from slipmap.diagrams.application.campaigns.methods_compared import compare_methods
from slipmap.diagrams.application.campaigns.trials import TrialOutcome
from slipmap.diagrams.application.campaigns.worlds import DirectWorld, identified, world_of
from slipmap.models.geometry import angle_between
from slipmap.models.inference.belief import Belief
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.planners.pregrasp import Pregrasp, bring_to_edge
from slipmap.planners.push_decisions import ObjectFell
from slipmap.planners.settings import METHODS, PregraspSettings

NEAR = 0.02  # largest distance from the goal, m; with `NEAR_ANGLE` the paper's criterion of success
NEAR_ANGLE = 15.0  # largest angle from the goal, deg
YAWS_A_BELIEF = 100  # trials that share one belief: the paper identifies each object once
FATES = ("success", "fell", "missed", "gave up")


def trial(*, seed: int, truth: str, object_name: str, method: str, belief_seed: int) -> dict[str, Any]:
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


def _summary(outcomes: Sequence[TrialOutcome]) -> Summary:
    compared = compare_methods(
        outcomes, good="success", pushes=lambda result: result["pushes"], together=True
    )
    return Summary(
        [
            compared.success_table("Brought to the edge, %", PREGRASP_SUCCESS),
            compared.ways_table("Pushes, and how trials ended", "pushes, mean", FATES, PREGRASP_ACTIONS),
        ],
        "Numbers of pushes include unsuccessful trials.",
        compared.to_json("success") | {"paper": {"success": PREGRASP_SUCCESS, "pushes": PREGRASP_ACTIONS}},
        lambda: compared.figures("Brought to the edge, within 20 mm and 15° of the goal", PREGRASP_SUCCESS),
    )


FIGURE_6 = Experiment("fig6", 100, trial, _summary, {"method": METHODS}, YAWS_A_BELIEF)
