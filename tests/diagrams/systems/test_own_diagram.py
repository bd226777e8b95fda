"""A user's own diagram: the example on the blocks works, is short, and learns what it pushes."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driven_block import DrivenBlock
from moving_blocks import block_belief
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from slipmap.diagrams.systems.belief_visualizer import BeliefVisualizer
from slipmap.diagrams.systems.cell_grid_slider import slider_of_hypothesis
from slipmap.diagrams.systems.finger import FingerPath
from slipmap.diagrams.systems.identification import PERIOD, Identification
from slipmap.diagrams.systems.measurement_logger import TrialLogger
from slipmap.diagrams.systems.model_monitor import ModelMonitor
from slipmap.diagrams.systems.multiverse_slider import MultiverseSlider
from slipmap.models.measurements import Trial
from slipmap.models.measurements.push_dataset import Noise, Table
from slipmap.models.perception.seen_object import ObservedPose
from slipmap.planners.table_push import TablePush

EXAMPLE = Path(__file__).parents[3] / "docs" / "examples" / "own_diagram.py"
PUSH = TablePush(np.array([-0.1, 0.0]), np.array([-0.05, 0.0]), 0.05)
H = 0.01


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    """What the example's names stand for after it has run."""
    return runpy.run_path(str(EXAMPLE))


def read(made: dict[str, Any], block: str, port: str) -> Any:
    system = made[block]
    return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(made["simulator"].get_context()))


def test_it_has_at_most_thirty_lines_beside_its_imports() -> None:
    text = EXAMPLE.read_text()
    imports = [node for node in ast.parse(text).body if isinstance(node, ast.Import | ast.ImportFrom)]
    imported = {line for node in imports for line in range(node.lineno, (node.end_lineno or 0) + 1)}
    lines = [number for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    assert len(set(lines) - imported) <= 30


def test_every_push_is_recorded_from_rest_to_rest_and_learned_from(made: dict[str, Any]) -> None:
    trials = read(made, "logger", "trials")
    assert [trial.role for trial in trials] == ["fit", "fit"]
    for trial, push in zip(trials, made["pushes"], strict=True):
        tip, poses, forces = trial.tip_pose.values, trial.object_pose.values, trial.ft_wrench.values
        assert tip[[0, -1]] == pytest.approx(np.array([push.begin, push.end]), abs=1e-9)
        assert not np.ptp(poses[:20], axis=0).any() and np.ptp(poses[-5:], axis=0).max() < 1e-5
        assert np.hypot(*(poses[-1] - poses[0])[:2]) > 0.01
        assert np.abs(forces).max() > 0.1 and not forces[:20].any()
    assert read(made, "learner", "learned") == 2


def test_the_belief_knows_the_load_and_which_half_is_heavier(made: dict[str, Any]) -> None:
    belief, truth = made["belief"], made["truth"]
    assert len(belief) == 6 and belief.finger_radius == 0.008
    load = float((truth.mass * truth.mu).sum() * 9.81)
    assert belief.probability @ belief.friction_forces == pytest.approx(load, rel=0.1)
    assert (belief.probability @ belief.centers_of_mass)[0] > 0.004


def test_the_finger_is_nowhere_between_pushes_and_moves_as_it_says() -> None:
    finger = DrivenBlock(FingerPath([PUSH, PUSH], H, pause=0.5))
    places, pushing = [], []
    while finger.time < 5.0:
        places.append(finger.read("finger"))
        pushing.append(finger.read("push"))
        finger.advance(H)
    down = np.isfinite(places).all(axis=1)
    assert [push is not None and push.push is PUSH for push in pushing] == down.tolist()
    assert {push.push_id for push in pushing if push is not None} == {1, 2}
    assert np.flatnonzero(np.diff(down.astype(int)) == 1).shape == (2,)
    assert not down[:49].any()
    first = np.array(places)[down][: len(PUSH.path(H)) - 1]
    np.testing.assert_allclose(first[1:, :2], first[:-1, :2] + H * first[:-1, 2:], atol=1e-12)
    assert np.linalg.norm(first[:, 2:], axis=1).max() == pytest.approx(PUSH.speed)


@pytest.mark.parametrize("share", [0.3, 0.5, 1.5])
def test_a_model_with_steps_of_its_own_meets_a_finger_without_jumps(share: float) -> None:
    """Or the finger would press into the object and out again at each of the model's steps."""
    finger = DrivenBlock(FingerPath([PUSH], H, pause=0.1))
    rows = []
    while finger.time < 1.5:
        rows.append(finger.read("finger"))
        finger.advance(share * H)
    rows = [row for row in rows if np.isfinite(row).all()]
    assert len(rows) > 50
    before, after = np.array(rows[:-1]), np.array(rows[1:])
    assert np.abs(before[:, :2] + share * H * before[:, 2:] - after[:, :2]).max() < 1.5 * 0.5 * H**2


@pytest.mark.parametrize(
    ("pause", "h", "words"),
    [
        (-1.0, 0.005, "pause must be finite and not negative, got -1.0 s"),
        (np.nan, 0.005, "pause must be finite and not negative"),
        (0.0, 0.005, "pause must be at least 0.01 s.*two pushes as one; got 0 s"),
    ],
)
def test_a_pause_that_no_logger_would_notice_is_refused(pause: float, h: float, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        FingerPath([PUSH, PUSH], h, pause=pause)


@pytest.mark.parametrize(("pause", "h"), [(0.01, 0.005), (0.005, 0.005), (0.0, 0.01), (0.008, 0.004)])
def test_a_pause_as_short_as_may_be_separates_two_trials(pause: float, h: float) -> None:
    trials = recorded(FingerPath([PUSH, PUSH], h, pause=pause), TrialLogger())
    assert len(trials) == 2
    for trial in trials:
        ends = trial.tip_pose.values[[0, -1]]
        assert ends == pytest.approx(np.array([PUSH.begin, PUSH.end]), abs=1e-9)


def test_a_finger_that_jumps_is_told() -> None:
    """As it does for a logger with few rows, if the finger is up only between two of them."""
    finger = FingerPath([PUSH, TablePush([0.1, 0.0], [0.06, 0.0], 0.05)], 0.005, pause=0.01)
    with pytest.raises(ValueError, match=r"finger jumped by 150 mm .* lift it \(NaN\) for at least 0.1 s"):
        recorded(finger, TrialLogger(period=0.1))
    fast = TablePush(PUSH.begin, [0.3, 0.0], 0.8)
    for period in (0.01, 0.05, 0.2):
        assert len(recorded(FingerPath([fast], 0.005), TrialLogger(period=period))) == 1


def recorded(finger: FingerPath, logger: TrialLogger) -> tuple[Trial, ...]:
    """The trials of an object that stays in place."""
    builder = DiagramBuilder()
    builder.AddSystem(finger), builder.AddSystem(logger)
    pose = builder.AddSystem(ConstantVectorSource(np.zeros(3)))
    builder.Connect(finger.GetOutputPort("finger"), logger.GetInputPort("finger"))
    builder.Connect(pose.get_output_port(), logger.GetInputPort("object_pose"))
    force = builder.AddSystem(ConstantVectorSource(np.ones(2)))
    builder.Connect(force.get_output_port(), logger.GetInputPort("finger_force"))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(finger.end + 0.3)
    trials: tuple[Trial, ...] = logger.GetOutputPort("trials").Eval(
        logger.GetMyContextFromRoot(simulator.get_context())
    )
    return trials


def test_pushes_after_those_to_learn_from_judge_and_force_is_optional() -> None:
    logger = DrivenBlock(TrialLogger(fit=1, period=H), object_pose=np.zeros(3), finger=np.full(4, np.nan))
    for x in (0.1, 0.2):
        logger.set(finger=[x, 0.0, 0.0, 0.0])
        logger.advance(4 * H)
        logger.set(object_pose=[x, 0.0, 0.0])
        logger.advance(H)
        logger.set(finger=np.full(4, np.nan))
        logger.advance(5 * H)
    trials = logger.read("trials")
    assert [(trial.name, trial.role) for trial in trials] == [
        ("trials/000.json", "fit"), ("trials/001.json", "heldout"),
    ]  # fmt: skip
    assert trials[0].ft_wrench is None and trials[0].tip_pose.time[0] == 0.0
    seen = logger.read("observed_pose")
    assert seen.valid and seen.time == pytest.approx(20 * H) and seen.pose.tolist() == [0.2, 0.0, 0.0]


@pytest.mark.parametrize("force", [None, [0.02, 0.0], [np.nan, np.nan], [0.2, 0.0]])
def test_a_push_that_touches_nothing_is_no_trial(force: list[float] | None) -> None:
    """It would calm a monitor, whose hypotheses do not move either."""
    inputs = {} if force is None else {"finger_force": force}
    logger = DrivenBlock(TrialLogger(period=H), object_pose=np.zeros(3), finger=np.zeros(4), **inputs)
    logger.advance(5 * H)
    logger.set(finger=np.full(4, np.nan))
    logger.advance(5 * H)
    assert len(logger.read("trials")) == (force == [0.2, 0.0])


def test_rows_of_a_tracker_that_lost_the_object_are_left_out() -> None:
    lost, logger = np.full(3, np.nan), DrivenBlock(TrialLogger(period=H), object_pose=np.zeros(3))
    for poses in ([[0.0] * 3, lost, [0.02, 0.0, 0.1]], [lost, lost, [0.03, 0.0, 0.1]]):
        for pose in poses:
            logger.set(finger=np.zeros(4), object_pose=pose)
            logger.advance(2 * H)
        logger.set(finger=np.full(4, np.nan), object_pose=lost)
        logger.advance(2 * H)
        assert not logger.read("observed_pose").valid
    (first,) = logger.read("trials")  # in the second push, it was not seen to move
    assert first.object_pose.time == pytest.approx([0.0, H, 4 * H, 5 * H])
    assert len(first.tip_pose.time) == 6


def test_a_pose_from_elsewhere_is_a_valid_one() -> None:
    seen = ObservedPose.of([0.1, 0.2, 4.0], time=2.0)
    assert seen.valid and seen.reason == "" and seen.time == 2.0
    assert seen.pose.tolist() == [0.1, 0.2, 4.0] and not seen.covariance.any()


def test_a_pose_that_is_not_finite_is_missing_and_one_of_another_shape_refused() -> None:
    lost = ObservedPose.of([0.0, np.nan, 0.0], time=2.0)
    assert not lost.valid and lost.time == 2.0 and lost.why == "the tracker reports no finite pose"
    with pytest.raises(ValueError, match=r"pose must be x, y and theta \(3,\).* got the shapes \(2,\)"):
        ObservedPose.of([0.1, 0.2])


def test_without_cells_it_says_what_to_connect(made: dict[str, Any]) -> None:
    block = DrivenBlock(Identification(), trials=read(made, "logger", "trials"))
    with pytest.raises(ValueError, match="connect the port cell_grid, or give the argument grid"):
        block.advance(PERIOD)


def test_it_learns_from_what_its_arguments_say(made: dict[str, Any]) -> None:
    grid, table = made["grid"], Table("round", (0.0, 0.0), radius=0.5)
    block = Identification(grid=grid, finger_radius=0.007, table=table, gravity=1.62, hypotheses=2)
    learner = DrivenBlock(block, trials=read(made, "logger", "trials")[:1])
    learner.advance(PERIOD)
    belief = learner.read("belief")
    assert (belief.finger_radius, belief.gravity, len(belief)) == (0.007, 1.62, 2)
    assert belief.grid is grid


def test_a_diagram_may_have_two_of_each_block() -> None:
    """Drake exits where two systems have one name; without a name of their own it makes names up."""
    builder = DiagramBuilder()
    meshcat = Meshcat()
    for path in ("/one", "/other"):
        builder.AddSystem(slider_of_hypothesis(block_belief(1), 0, H))
        builder.AddSystem(MultiverseSlider(H))
        builder.AddSystem(ModelMonitor(Noise(position=1e-3, angle=1e-2)))
        builder.AddSystem(BeliefVisualizer(meshcat, path=path))
    assert len(builder.Build().GetSystems()) == 8
