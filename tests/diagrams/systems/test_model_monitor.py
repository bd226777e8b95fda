"""The monitor is quiet while the model holds, and loud on a table that is not level."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from moving_blocks import Player, block, block_belief, moved, seen, table_pushes
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from diagrams.systems.model_monitor import LEVEL, ModelMonitor
from models.effects.registry import effects_named
from models.inference.diagnosis.error_model import ErrorModel
from models.inference.push_misfit import observed_push, pose_noise, push_misfit, simulated_misfits
from models.physics.cell_grid import FloatArray
from models.physics.rollout import Push

NOISE = np.array([5e-4, 5e-4, 4e-3])
ERROR = ErrorModel(pose_noise(NOISE[0], NOISE[2]), 0.03, 0.0)
PERIOD = 0.1
LOOKS = 30
GAP = 3
"""Looks between two pushes."""


@dataclass(frozen=True)
class Told:
    """One push: poses predicted and observed at `LOOKS` + 1 times."""

    predicted: FloatArray
    observed: FloatArray


@lru_cache
def pushes_seen(effect: str, values: tuple[float, ...], count: int, seed: int) -> tuple[Told, ...]:
    rng = np.random.default_rng(seed)
    told = []
    belief = block_belief()
    for push in table_pushes(count, seed):
        true = moved(push, effects_named([effect]) if effect else (), values)
        start = push.start_pose + NOISE * rng.normal(size=3)
        observed = np.vstack([start, true + NOISE * rng.normal(size=true.shape)])
        rollouts = belief.slider.rollout(belief.maps, [replace(push, start_pose=start)])
        predicted = np.einsum("k,ksc->sc", belief.probability, rollouts.poses)
        told.append(Told(np.vstack([start, predicted]), observed))
    return tuple(told)


PLAYED: list[Told] = []


def look(time: float) -> tuple[int, int]:
    """Number of the push and of the look at it; the push is over where that is beyond `LOOKS`."""
    return divmod(round(time / PERIOD), LOOKS + 1 + GAP)


def push_at(time: float) -> Any:
    push, row = look(time)
    return SimpleNamespace(push_id=push) if push < len(PLAYED) and row <= LOOKS else None


def pose_at(time: float, which: str) -> FloatArray:
    push, row = look(time)
    if push >= len(PLAYED):
        return np.zeros(3)
    return getattr(PLAYED[push], which)[min(row, LOOKS)]


@pytest.fixture(scope="module")
def diagram() -> Diagram:
    calibration = simulated_misfits(block_belief(), table_pushes(20, 1), ERROR, 300, np.random.default_rng(0))
    builder = DiagramBuilder()
    player = builder.AddSystem(
        Player(
            {"predicted_pose": (3, lambda time: pose_at(time, "predicted"))},
            {
                "object_pose": lambda time: seen(pose_at(time, "observed"), NOISE[0], NOISE[2]),
                "push": push_at,
            },
        )
    )
    monitor = builder.AddSystem(ModelMonitor(block(), calibration, PERIOD))
    for port in ("predicted_pose", "object_pose", "push"):
        builder.Connect(player.GetOutputPort(port), monitor.GetInputPort(port))
    return builder.Build()


@dataclass(frozen=True)
class After:
    """What the monitor says after a push."""

    evidence: float
    alarm: bool
    misfit: float
    residual: FloatArray


def watched(diagram: Diagram, told: tuple[Told, ...]) -> list[After]:
    PLAYED[:] = told
    simulator = Simulator(diagram)
    monitor = diagram.GetSubsystemByName("model_monitor")
    rows = []
    for b in range(len(told)):
        simulator.AdvanceTo(PERIOD * ((b + 1) * (LOOKS + 1 + GAP) - 0.5))
        context: Context = monitor.GetMyContextFromRoot(simulator.get_context())
        evidence, misfit, residual, alarm = (
            monitor.GetOutputPort(name).Eval(context) for name in ("evidence", "misfit", "residual", "alarm")
        )
        rows.append(After(float(evidence[0]), alarm, float(misfit[0]), residual.copy()))
    return rows


def test_quiet_on_pushes_as_believed(diagram: Diagram) -> None:
    rows = watched(diagram, pushes_seen("", (), 20, 7))
    assert not any(row.alarm for row in rows)
    assert max(row.evidence for row in rows) < 0.2 / LEVEL


def test_loud_on_a_tilted_table_and_calm_again(diagram: Diagram) -> None:
    """The alarm comes within a few pushes, stays for one push as usual, and goes in the end."""
    tilted = pushes_seen("table_tilt", (0.05, -0.06), 8, 7)
    rows = watched(diagram, tilted)
    first = next(b for b, row in enumerate(rows) if row.alarm)
    assert first <= 4
    rows = watched(diagram, tilted[: first + 1] + pushes_seen("", (), 20, 7))
    alarms = [row.alarm for row in rows]
    assert alarms[first : first + 2] == [True, True]
    assert not alarms[-1]
    released = alarms.index(False, first)
    assert all(row.evidence > 1.0 for row in rows[first:released])
    assert rows[released].evidence <= 1.0


def test_outputs_are_those_of_the_last_push(diagram: Diagram) -> None:
    (told,) = pushes_seen("table_tilt", (0.05, -0.06), 1, 9)
    (row,) = watched(diagram, (told,))
    assert np.allclose(row.residual, told.observed[-1] - told.predicted[-1])
    times = PERIOD * np.arange(1, LOOKS + 1)
    push = Push(times[-1], np.full((2, 2), np.nan), told.observed[0], pose_times=times)
    expected = push_misfit(observed_push(push, told.observed[1:]), told.predicted[1:], ERROR, block())
    assert row.misfit == pytest.approx(expected, rel=1e-9)


def test_nothing_seen_is_no_evidence(diagram: Diagram) -> None:
    (row,) = watched(diagram, (Told(np.full((31, 3), np.nan), np.zeros((31, 3))),))
    assert row.evidence == 1.0
    assert np.isnan(row.misfit)
    assert np.isnan(row.residual).all()


def test_calibration_is_checked() -> None:
    with pytest.raises(ValueError, match="at least 20 finite misfits"):
        ModelMonitor(block(), np.ones(5))
