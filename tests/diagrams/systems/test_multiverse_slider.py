"""All hypotheses of a belief stepped together: each as if it were alone."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from driven_block import DrivenBlock
from moving_blocks import H, Player, block_belief, seen, table_pushes
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder

from slipmap.diagrams.systems.multiverse_slider import MultiverseSlider
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.belief import Belief
from slipmap.models.physics.paper_notation import add
from slipmap.models.physics.rollout import Maps, Push

FIRST, SECOND = table_pushes(2, 3)
PAUSE = 5 * H


def finger(time: float) -> np.ndarray:
    """Of the first push, then, after a pause without a finger, of the second."""
    push, since = (FIRST, time) if time < lasts(FIRST) + 0.5 * H else (SECOND, time - lasts(FIRST) - PAUSE)
    k = round(since / H)
    if not 0 <= k < len(push.tip) - 1:
        return np.full(4, np.nan)
    return np.concatenate([push.tip[k], (push.tip[k + 1] - push.tip[k]) / H])


def lasts(push: Push) -> float:
    return H * (len(push.tip) - 1)


def push_at(time: float) -> Any:
    if time < lasts(FIRST) - 0.5 * H:
        return SimpleNamespace(push_id=7)
    return SimpleNamespace(push_id=8) if time > lasts(FIRST) + PAUSE - 0.5 * H else None


def learned(effects: list[str], values: list[float]) -> Belief:
    belief = block_belief(5)
    maps = belief.maps
    rows = np.array(values) * np.linspace(0.5, 1.5, 5)[:, None]
    return replace(
        belief, maps=Maps(maps.mass, maps.mu, maps.mu_finger, rows), effects=tuple(effects_named(effects))
    )


BELIEFS = {
    "plain": block_belief(5),
    "loose_mass": learned(["loose_mass"], [0.3, 15.0, 0.2]),
    "late": learned(["sensor_latency", "tracker_offset"], [0.05, 0.002, -0.001, 0.02]),
}


@pytest.fixture(scope="module")
def diagram() -> Diagram:
    """Two pushes; what is believed is set by `belief_of`."""
    builder = DiagramBuilder()
    starts = {7: FIRST.start_pose, 8: SECOND.start_pose}
    player = builder.AddSystem(
        Player(
            {"finger": (4, finger)},
            {
                "belief": lambda time: BELIEFS[CHOSEN[0]],
                "object_pose": lambda time: seen(starts[7 if time < lasts(FIRST) else 8]),
                "push": push_at,
                "trials": lambda time: RECORDED[: 2 if time < lasts(FIRST) else 3],
            },
        )
    )
    multiverse = builder.AddNamedSystem("multiverse_slider", MultiverseSlider(H))
    for port in ("finger", "belief", "object_pose", "push", "trials"):
        builder.Connect(player.GetOutputPort(port), multiverse.GetInputPort(port))
    return builder.Build()


CHOSEN = ["plain"]
RECORDED = (None,) * 3  # the first push is the third of the experiment


def run(diagram: Diagram, until: float) -> tuple[Any, Any]:
    """The multiverse and its Context, in which the time is `until`."""
    simulator = Simulator(diagram)
    # The last step is the one that ends at `until`.
    simulator.AdvanceTo(until - 0.5 * H)
    system = diagram.GetSubsystemByName("multiverse_slider")
    return system, system.GetMyContextFromRoot(simulator.get_context().Clone())


@pytest.mark.parametrize("name", BELIEFS)
def test_hypotheses_move_as_each_alone(diagram: Diagram, name: str) -> None:
    CHOSEN[0] = name
    belief = BELIEFS[name]
    # Halfway, where a late report differs from the truth.
    half = len(FIRST.tip) // 2
    system, context = run(diagram, half * H)
    poses = system.GetOutputPort("poses").Eval(context)
    rollouts = belief.slider.rollout(belief.maps, [replace(FIRST, pose_times=None)])
    alone = rollouts.poses[:, half - 1]
    assert np.abs(poses - alone).max() < 1e-10
    assert np.ptp(poses[:, 2]) > 1e-3
    mean = belief.probability @ alone
    assert np.allclose(system.GetOutputPort("mean_pose").Eval(context), mean, atol=1e-10)
    spread = sum(
        p * add(pose, mean, belief.grid.centers) for p, pose in zip(belief.probability, alone, strict=True)
    )
    assert system.GetOutputPort("spread").Eval(context)[0] == pytest.approx(spread, abs=1e-9)


def test_a_new_push_starts_where_the_object_is_seen(diagram: Diagram) -> None:
    CHOSEN[0] = "plain"
    belief = BELIEFS["plain"]
    system, context = run(diagram, lasts(FIRST) + PAUSE)
    after_first = system.GetOutputPort("mean_pose").Eval(context)
    assert np.hypot(*(after_first - FIRST.start_pose)[:2]) > 0.02
    system, context = run(diagram, lasts(FIRST) + PAUSE + lasts(SECOND))
    alone = belief.slider.rollout(belief.maps, [replace(SECOND, pose_times=None)]).poses[:, -1]
    assert np.abs(system.GetOutputPort("poses").Eval(context) - alone).max() < 1e-10


def test_a_push_counts_among_the_recorded_ones_and_the_one_before_is_kept(diagram: Diagram) -> None:
    CHOSEN[0] = "plain"
    system, context = run(diagram, lasts(FIRST) + PAUSE)
    first = system.universes(context)
    assert (first.order, first.before) == (2, None)
    system, context = run(diagram, lasts(FIRST) + PAUSE + lasts(SECOND))
    second = system.universes(context)
    assert second.order == 3 and second.of_trial(3) is second and second.of_trial(1) is None
    np.testing.assert_array_equal(second.of_trial(2).poses, first.poses)


@pytest.mark.parametrize(
    ("pushes", "orders"),
    [
        # the recorded pushes so far and the number of the present candidate, in turn
        ([(0, 0), (1, 20), (2, 40)], [None, 1, 2]),  # no belief at first
        ([(1, 20), (1, 21), (1, 22), (2, 40)], [1, 1, 1, 2]),  # refused, or touched nothing
        ([(4, 80), (5, 100)], [4, 5]),  # continues an earlier run
    ],
)
def test_the_order_is_that_of_identify(pushes: list[tuple[int, int]], orders: list[int | None]) -> None:
    block = DrivenBlock(MultiverseSlider(H), object_pose=seen(np.zeros(3)))
    got = []
    for count, number in pushes:
        belief = block_belief() if count else None
        block.set(push=SimpleNamespace(push_id=number), trials=(None,) * count, belief=belief)
        block.advance(2 * H)
        universes = block.read("universes")
        got.append(None if universes is None else universes.order)
    assert got == orders


def test_pushes_need_the_trials_to_count_among() -> None:
    push = SimpleNamespace(push_id=0)
    block = DrivenBlock(MultiverseSlider(H), object_pose=seen(np.zeros(3)), push=push, belief=block_belief())
    with pytest.raises(RuntimeError, match=r"trials.* is not connected"):
        block.advance(2 * H)


def test_without_a_belief_there_is_no_prediction() -> None:
    system = MultiverseSlider(H)
    context = system.CreateDefaultContext()
    assert system.GetOutputPort("poses").Eval(context).shape == (0, 3)
    assert np.isnan(system.GetOutputPort("mean_pose").Eval(context)).all()
    assert np.isnan(system.GetOutputPort("spread").Eval(context)).all()
    system.set_belief(context, block_belief(), np.array([0.1, 0.2, 0.3]))
    assert np.allclose(system.GetOutputPort("poses").Eval(context), [0.1, 0.2, 0.3])
    assert system.GetOutputPort("spread").Eval(context) == [0.0]
