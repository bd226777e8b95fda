"""Blocks and options refuse arguments that cannot work when they are made, before anything is simulated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from moving_blocks import block

from slipmap.diagrams.loops.exploration_loop import LoopOptions
from slipmap.diagrams.loops.pregrasp_loop import PregraspOptions
from slipmap.diagrams.systems.exploration import Exploration
from slipmap.diagrams.systems.goal_and_push_planner import GoalAndPushPlanner
from slipmap.diagrams.systems.identification import Identification
from slipmap.diagrams.systems.measurement_logger import TrialLogger
from slipmap.diagrams.systems.model_monitor import ModelMonitor
from slipmap.models.measurements.push_dataset import Noise, Table
from slipmap.planners.settings import PokeSettings, PregraspSettings

NOISE = Noise(position=1e-3, angle=1e-2)
ROUND = Table("round", (0.0, 0.0), radius=0.5)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: LoopOptions(pushes=0), ["LoopOptions: pushes", "at least 1, got 0"]),
        (lambda: LoopOptions(pushes=-1, checks=3), ["pushes", "got -1"]),
        (lambda: LoopOptions(pushes=2.5), ["pushes", "whole number", "got 2.5"]),  # type: ignore[arg-type]
        (lambda: LoopOptions(pushes=True), ["pushes", "got True"]),
        (lambda: LoopOptions(checks=-1), ["checks", "at least 0, got -1"]),
        (lambda: LoopOptions(cells=0), ["cells", "got 0"]),
        (lambda: LoopOptions(hypotheses=1), ["hypotheses", "at least 2, got 1"]),
        (lambda: LoopOptions(seed=-1), ["seed", "got -1"]),
        (
            lambda: LoopOptions(strategy="foo"),
            ["LoopOptions: strategy", "'foo'", "random", "most-distinctive"],
        ),
        (lambda: LoopOptions(effects=["foo"]), ["unknown effect 'foo'"]),
        (lambda: LoopOptions(effects="table_tilt"), ["list of names", "write ['table_tilt']"]),
        (
            lambda: PregraspOptions(method="foo"),
            ["PregraspOptions: method", "'foo'", "probabilistic", "true"],
        ),
        (lambda: PregraspOptions(pushes=0), ["PregraspOptions: pushes", "got 0"]),
        (lambda: Identification(grid=block(), method="foo"), ["method 'foo'", "gauss-newton, paper"]),
        (lambda: Identification(method="paper", effects=["tether"]), ["paper does not support effects"]),
        (lambda: Identification(effects="tether"), ["write ['tether']"]),
        (lambda: Identification(hypotheses=1), ["hypotheses must be a whole number of at least 2, got 1"]),
        (
            lambda: Exploration("foo", 3, 0.008, PokeSettings(), lambda thing, push: True, seed=0),
            ["Exploration: strategy", "'foo'", "random, most-different, most-distinctive"],
        ),
        (
            lambda: GoalAndPushPlanner(PregraspSettings(), ROUND, method="foo"),
            ["GoalAndPushPlanner: method", "'foo'", "probabilistic, deterministic, uniform, true"],
        ),
        (lambda: Table("oval", (0.0, 0.0)), ["Table: shape", "round, rectangle", "'oval'"]),  # type: ignore
        (lambda: ModelMonitor(NOISE, period=0.0), ["ModelMonitor: period", "got 0.0 s"]),
        (lambda: ModelMonitor(NOISE, period=np.nan), ["ModelMonitor: period", "nan"]),
        (lambda: TrialLogger(period=0.0), ["TrialLogger: period", "got 0.0 s"]),
        (lambda: TrialLogger(period=-0.01), ["TrialLogger: period", "got -0.01 s"]),
    ],
)
def test_a_wrong_argument_is_refused_by_its_name(make: Callable[[], Any], named: list[str]) -> None:
    with pytest.raises(ValueError) as refused:
        make()
    for name in named:
        assert name in str(refused.value)


def test_numbers_of_numpy_are_numbers() -> None:
    assert LoopOptions(pushes=np.int64(3)).pushes == 3  # type: ignore[arg-type]
