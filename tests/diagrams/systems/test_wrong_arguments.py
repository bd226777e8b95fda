"""Blocks and options refuse arguments that cannot work when they are made, before anything is simulated."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from driven_block import DrivenBlock
from moving_blocks import block, block_belief

from slipmap.diagrams.application.demonstration import tilted_block
from slipmap.diagrams.loops.exploration_loop import LoopOptions
from slipmap.diagrams.loops.pregrasp_loop import PregraspOptions
from slipmap.diagrams.perception.cell_perception import CellPerception
from slipmap.diagrams.systems.belief_visualizer import BeliefVisualizer
from slipmap.diagrams.systems.cell_grid_slider import CellGridSlider
from slipmap.diagrams.systems.diagnosis import Diagnosis
from slipmap.diagrams.systems.exploration import Exploration
from slipmap.diagrams.systems.finger import FingerMotion, FingerPath
from slipmap.diagrams.systems.goal_and_push_planner import GoalAndPushPlanner
from slipmap.diagrams.systems.identification import Identification
from slipmap.diagrams.systems.measurement_logger import MeasurementLogger, TrialLogger
from slipmap.diagrams.systems.model_monitor import ModelMonitor
from slipmap.diagrams.systems.multiverse_slider import MultiverseSlider
from slipmap.models.measurements.push_dataset import Noise, Table
from slipmap.planners.settings import PokeSettings, PregraspSettings, RepairSettings
from slipmap.planners.table_push import TablePush

NOISE = Noise(position=1e-3, angle=1e-2)
PUSH = TablePush(np.array([-0.1, 0.0]), np.array([-0.05, 0.0]), 0.05)
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
        (lambda: TrialLogger(fit=-1), ["TrialLogger: fit", "at least 0, got -1"]),
        (lambda: MeasurementLogger(fit=1.5), ["MeasurementLogger: fit", "got 1.5"]),  # type: ignore[arg-type]
        (lambda: ModelMonitor(NOISE, model_error=-1), ["ModelMonitor: model_error", "got -1"]),
        (lambda: ModelMonitor(NOISE, model_error=np.nan), ["ModelMonitor: model_error", "got nan"]),
        (lambda: MultiverseSlider(-1), ["MultiverseSlider: h", "got -1 s"]),
        (lambda: MultiverseSlider(np.nan), ["MultiverseSlider: h", "got nan s"]),
        (lambda: FingerMotion(-1), ["FingerMotion: period", "got -1 s"]),
        (lambda: FingerPath([PUSH], 0.01, rest=-1), ["push: rest", "got -1 s"]),
        (lambda: FingerPath([PUSH], 0.01, rest=np.nan), ["push: rest", "got nan s"]),
        (lambda: BeliefVisualizer(None, period=-1), ["BeliefVisualizer: period", "got -1 s"]),  # type: ignore
        (lambda: BeliefVisualizer(None, which=3), ["BeliefVisualizer: which", "0, 1, 2, got 3"]),  # type: ignore
        (lambda: CellPerception(cells=np.nan), ["CellPerception: cells", "got nan"]),  # type: ignore[arg-type]
        (lambda: diagnosis(effects="tether"), ["write ['tether']"]),
        (lambda: diagnosis(effects=["foo"]), ["unknown effect 'foo'"]),
        (lambda: diagnosis(pushes=-1), ["Diagnosis: pushes", "got -1"]),
        (lambda: diagnosis(seed=None), ["Diagnosis: seed", "got None"]),
        (lambda: Identification(finger_radius=-1), ["Identification: finger_radius", "got -1 m"]),
        (lambda: Identification(gravity=np.nan), ["Identification: gravity", "got nan"]),
        (lambda: Identification(hypotheses=2.5), ["hypotheses", "got 2.5"]),  # type: ignore[arg-type]
        (lambda: Identification(seed=-1), ["seed", "got -1"]),
        (lambda: slider(["tether", "tether"]), ["effect tether is given twice"]),
        (lambda: slider("tether"), ["write ['tether']"]),
        (lambda: Noise(position=-1.0), ["Noise: position", "got -1.0 m"]),
        (lambda: Noise(angle=np.nan), ["Noise: angle", "got nan rad"]),
        (lambda: Table("round", (0.0, 0.0)), ["radius of a round table", "got None m"]),
        (lambda: Table("round", (np.nan, 0.0), radius=0.5), ["Table: center", "nan"]),
        (lambda: Table("rectangle", (0.0, 0.0), size=(1.0,)), ["size of a rectangular"]),  # type: ignore
        (lambda: Table("rectangle", (0.0, 0.0), size=(1.0, -1.0)), ["size of a rectangular", "-1.0"]),
    ],
)
def test_a_wrong_argument_is_refused_by_its_name(make: Callable[[], Any], named: list[str]) -> None:
    with pytest.raises(ValueError) as refused:
        make()
    for name in named:
        assert name in str(refused.value)


def diagnosis(**given: Any) -> Diagnosis:
    return Diagnosis(lambda trials, grid: None, RepairSettings(), **{"pushes": 5} | given)  # type: ignore


def slider(effects: Any) -> Any:
    belief = block_belief(1)
    return CellGridSlider(belief.grid, belief.maps, 0.008, 0.005, effects)


def test_a_grid_is_not_a_text() -> None:
    with pytest.raises(TypeError, match=r"Identification: grid must be a CellGrid, such as .*; got a str"):
        Identification(grid="a")  # type: ignore[arg-type]


@pytest.mark.parametrize("finger", [[-0.1, 0.0, np.nan, np.nan], [np.inf, 0.0, 0.0, 0.0]])
def test_a_finger_of_which_only_a_part_is_known_is_refused(finger: list[float]) -> None:
    driven = DrivenBlock(slider([]), finger=finger)
    with pytest.raises(ValueError, match=r"finger: .* four finite numbers, or four NaN"):
        driven.advance(0.01)


def test_a_finger_that_appears_inside_the_object_is_refused() -> None:
    """It would shoot the object away. One that keeps in contact, or overlaps by an error, is not."""
    driven = DrivenBlock(slider([]), finger=[0.0, 0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match=r"begins with the finger 28 mm inside the object"):
        driven.advance(0.01)
    driven = DrivenBlock(slider([]), finger=[-0.035, 0.0, 0.1, 0.0])
    driven.advance(0.05)
    assert driven.read("object_pose")[0] > 1e-3


def test_numbers_of_numpy_are_numbers() -> None:
    assert LoopOptions(pushes=np.int64(3)).pushes == 3  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: Identification(3), r"make_dataset must be a function .* got a int"),  # type: ignore[arg-type]
        (lambda: Identification(tilted_block()), r"got a PushDataset; slipmap\.identify"),  # type: ignore
        (lambda: FingerPath([1], 0.01), r"FingerPath: a push must be a TablePush, such as .*; got a int"),  # type: ignore
        (lambda: BeliefVisualizer(None), "meshcat must be a .*Meshcat, got None"),  # type: ignore
    ],
)
def test_a_thing_of_another_kind_is_refused_with_what_is_wanted(make: Callable[[], Any], told: str) -> None:
    with pytest.raises(TypeError, match=told):
        make()


@pytest.mark.parametrize("block", [slider([]), MultiverseSlider(0.005)], ids=["one", "all"])
def test_a_wrench_that_is_not_finite_is_refused(block: Any) -> None:
    driven = DrivenBlock(block, wrench=[np.nan, 0.0, 0.0, 0.0, 0.0])
    if isinstance(block, MultiverseSlider):
        block.set_belief(driven.context, block_belief(2), np.zeros(3))
    with pytest.raises(
        ValueError, match=r"wrench: .* five finite numbers, .* got \[nan, 0.0, 0.0, 0.0, 0.0\]"
    ):
        driven.advance(0.01)


@pytest.mark.parametrize("pose", [[np.nan, 0.0, 0.0], [0.0, 0.0]])
def test_hypotheses_are_placed_at_a_pose_only(pose: list[float]) -> None:
    universes = MultiverseSlider(0.005)
    with pytest.raises(ValueError, match=r"set_belief: pose must be (finite|of shape \(3,\)), got"):
        universes.set_belief(universes.CreateDefaultContext(), block_belief(2), pose)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("block", "port", "value", "told"),
    [
        (
            Identification(grid=block()),
            "trials",
            tilted_block(),
            r"Identification: the port trials takes a Seq",
        ),
        (
            MultiverseSlider(0.005),
            "belief",
            tilted_block(),
            "MultiverseSlider: the port belief takes a Belief",
        ),
    ],
)
def test_a_value_of_another_kind_at_a_port_is_refused_by_its_name(
    block: Any, port: str, value: Any, told: str
) -> None:
    rest = {"push": SimpleNamespace(push_id=1), "belief": block_belief(2), "trials": ()}
    inputs = {port: value} if port == "trials" else {**rest, port: value}
    with pytest.raises(TypeError, match=told):
        DrivenBlock(block, **inputs).advance(0.1)
