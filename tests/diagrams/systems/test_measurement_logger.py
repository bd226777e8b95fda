"""Recording a push: what makes up a trial, and what is left out of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from driven_block import DrivenBlock, seen_at
from pydrake.math import RigidTransform, RollPitchYaw

from slipmap.diagrams.execution.arm_motion import TORQUE_LAG
from slipmap.diagrams.execution.requests import ExecutionStatus
from slipmap.diagrams.systems.loop_messages import LoopStatus
from slipmap.diagrams.systems.measurement_logger import LOOKS, PERIOD, MeasurementLogger
from slipmap.models.measurements import PushDataset, Trial, read_dataset, write_dataset
from slipmap.models.measurements.push_dataset import Noise, dataset_of
from slipmap.models.measurements.trial import Channel, DatasetError
from slipmap.models.objects import cells_from_polygon
from slipmap.models.perception.seen_object import ObservedPose

PICTURE = 0.1  # s between pictures, ten times that between rows
SPEED, FORCE = 0.05, (3.0, -1.0, 0.5)


class Cell(DrivenBlock):
    """A logger whose camera, arm and supervisor do what the test says."""

    def __init__(self, fit: int = 1) -> None:
        super().__init__(
            MeasurementLogger(fit),
            object_pose=ObservedPose.unseen("no object"), tip_pose=RigidTransform(), tip_force=np.zeros(3),
            execution=ExecutionStatus("home"), status=LoopStatus("looking", 0),
        )  # fmt: skip
        self.tip = np.array([-0.1, 0.02, 0.004])
        self.angle, self.turn = 2.7, 0.0  # of the hand, and its change from row to row, rad
        self.advance(0.5 * PERIOD)

    def picture(self, pose: tuple[float, float, float] | None) -> None:
        """A picture now, and the time until the next."""
        unseen = ObservedPose.unseen("occluded", self.time)
        self.set(object_pose=unseen if pose is None else seen_at(*pose, time=self.time))
        self.advance(PICTURE)

    def look(self, poses) -> None:
        for pose in poses:
            self.picture(pose)

    def move(self, mode: str, rows: int, force=FORCE) -> None:
        """The finger goes along x for so many rows, and the arm feels a force all the while."""
        self.set(execution=ExecutionStatus(mode, 0), tip_force=force)
        for _ in range(rows):
            self.tip[0] += SPEED * PERIOD
            self.angle += self.turn
            self.set(tip_pose=RigidTransform(RollPitchYaw(np.pi, 0.0, self.angle), self.tip))
            self.advance(PERIOD)

    def push(self, number: int, rows: int = 100) -> None:
        self.set(status=LoopStatus("pushing", number))
        for mode, count in (("approaching", 20), ("lowering", 20), ("pushing", rows), ("retreating", 20)):
            self.move(mode, count)
        self.set(execution=ExecutionStatus("home", 0), status=LoopStatus("recording", number))

    @property
    def trials(self) -> tuple[Trial, ...]:
        return self.read("trials")


def scattered(center, seed: int, count: int = LOOKS) -> list[tuple[float, float, float]]:
    """Looks at an object at rest."""
    return [tuple(row) for row in np.random.default_rng(seed).normal(center, 1e-3, (count, 3))]


BEFORE, AFTER = scattered([0.1, 0.2, 0.3], 1), scattered([0.15, 0.2, 0.4], 2)


@pytest.fixture(scope="module")
def trial() -> Trial:
    """Looks, a push of 1 s in which the finger is down, and looks."""
    cell = Cell()
    cell.look([(9.0, 9.0, 9.0), (8.0, 8.0, 8.0), *BEFORE])
    cell.push(0)
    cell.look(AFTER)
    (recorded,) = cell.trials
    return recorded


def test_a_trial_begins_with_the_mean_of_the_last_looks(trial):
    first, second = trial.object_pose.values[:2]
    assert first == pytest.approx(np.mean(BEFORE, axis=0), abs=1e-12)
    assert np.array_equal(first, second)
    assert trial.object_pose.time[:2] == pytest.approx([0.0, PERIOD])


def test_a_trial_ends_with_the_mean_of_the_first_looks_after_it(trial):
    assert trial.object_pose.values[-1] == pytest.approx(np.mean(AFTER, axis=0), abs=1e-12)
    assert trial.object_pose.time[-1] == trial.tip_pose.time[-1]


def test_tip_and_force_are_recorded_only_while_the_finger_pushes(trial):
    assert trial.tip_pose.time == pytest.approx(PERIOD * np.arange(100), abs=1e-9)
    x = trial.tip_pose.values[:, 0]
    assert np.diff(x) == pytest.approx(np.full(99, SPEED * PERIOD))
    assert x[0] == pytest.approx(-0.1 + SPEED * PERIOD * 41)  # after approaching and lowering
    assert trial.tip_pose.values[:, 1] == pytest.approx(np.full(100, 0.02))
    assert trial.ft_wrench.time == pytest.approx(trial.tip_pose.time - TORQUE_LAG, abs=1e-12)
    assert trial.ft_wrench.values == pytest.approx(np.tile([FORCE[0], FORCE[1], 0.0], (100, 1)))


def test_the_angle_of_a_hand_that_turns_is_recorded(trial):
    assert trial.tip_angle is None
    cell = Cell()
    cell.turn = 0.005
    cell.look(BEFORE)
    cell.push(0)
    cell.look(AFTER)
    angle = cell.trials[0].tip_angle
    assert angle is not None
    np.testing.assert_array_equal(angle.time, cell.trials[0].tip_pose.time)
    np.testing.assert_allclose(np.diff(angle.values[:, 0]), 0.005, atol=1e-9)  # through half a turn


@pytest.mark.parametrize(
    ("moved", "force", "kept"),
    [((0, 0, 0), 0.0, False), ((4e-3, 0, 0), 0.0, True), ((0, 0, 0.03), 0.0, True), ((0, 0, 0), 2.0, True)],
)
def test_a_push_that_touched_nothing_is_no_trial(moved, force, kept):
    """Neither did the object move nor was a force felt."""
    cell = Cell()
    cell.look(LOOKS * [(0.1, 0.2, 0.3)])
    cell.set(status=LoopStatus("pushing", 0))
    for doing in ("approaching", "pushing", "retreating"):
        cell.move(doing, 20, np.array([force, 0.0, 0.0]))
    cell.set(execution=ExecutionStatus("home", 0), status=LoopStatus("recording", 0))
    cell.look(LOOKS * [tuple(np.array([0.1, 0.2, 0.3]) + moved)])
    assert len(cell.trials) == kept
    assert cell.read("missed") == (() if kept else (0,))


def test_poses_seen_in_spite_of_the_arm_are_kept_and_others_left_out():
    cell = Cell()
    cell.look(BEFORE)
    cell.set(status=LoopStatus("pushing", 0))
    cell.move("approaching", 10)
    cell.picture((7.0, 7.0, 7.0))  # on the way, the finger is not down
    began = cell.time
    cell.move("pushing", 30)
    seen = cell.time
    cell.set(object_pose=seen_at(0.12, 0.2, 0.35, time=seen))
    cell.move("pushing", 20)
    cell.set(object_pose=ObservedPose.unseen("occluded", cell.time))
    cell.move("pushing", 20)
    cell.set(object_pose=replace(ObservedPose.unseen("no object", cell.time), pose=np.ones(3)))
    cell.move("pushing", 20)
    cell.move("retreating", 10)
    cell.set(execution=ExecutionStatus("home", 0), status=LoopStatus("recording", 0))
    cell.look([AFTER[0], None, *AFTER[1:]])
    (trial,) = cell.trials
    assert len(trial.object_pose.time) == 4
    assert trial.object_pose.values[2] == pytest.approx([0.12, 0.2, 0.35])
    assert trial.object_pose.time[2] == pytest.approx(seen - began, abs=PERIOD)
    assert trial.object_pose.values[-1] == pytest.approx(np.mean(AFTER, axis=0))


@pytest.mark.parametrize(("last_seen", "kept"), [((0.15, 0.2, 0.4), 5), ((0.12, 0.2, 0.4), 3)])
def test_a_track_that_does_not_end_where_the_object_lies_is_left_out(last_seen, kept):
    cell = Cell()
    cell.look(BEFORE)
    cell.set(status=LoopStatus("pushing", 0))
    cell.move("pushing", 30)
    cell.set(object_pose=seen_at(0.12, 0.2, 0.35, time=cell.time))
    cell.move("pushing", 60)
    cell.set(object_pose=seen_at(*last_seen, time=cell.time))
    cell.move("pushing", 10)
    cell.move("retreating", 10)
    cell.set(execution=ExecutionStatus("home", 0), status=LoopStatus("recording", 0))
    cell.look(AFTER)
    (trial,) = cell.trials
    assert len(trial.object_pose.time) == kept


def test_a_trial_waits_for_enough_looks_with_the_arm_at_home():
    cell = Cell()
    cell.look(BEFORE)
    cell.push(0)
    cell.look(AFTER[:-1])
    assert cell.trials == ()
    cell.look([None, None])
    assert cell.trials == ()
    cell.look(AFTER[-1:])
    assert len(cell.trials) == 1
    cell.look(AFTER)
    assert len(cell.trials) == 1


def test_a_picture_counts_once_however_often_it_is_read():
    """The logger looks ten times at each picture."""
    cell = Cell()
    cell.look(BEFORE)
    cell.push(0)
    cell.set(object_pose=seen_at(*AFTER[0], time=cell.time))
    cell.advance(10 * LOOKS * PERIOD)
    assert cell.trials == ()


def test_looks_before_something_else_moved_the_object_do_not_count():
    """A mean of two places would be a third."""
    cell = Cell()
    moved = [(x + 0.02, y, theta) for x, y, theta in BEFORE[:4]]
    cell.look([*BEFORE, *moved])
    cell.push(0)
    cell.look([*AFTER[:3], *[(x, y + 0.03, theta) for x, y, theta in AFTER]])
    (trial,) = cell.trials
    assert trial.object_pose.values[0] == pytest.approx(np.mean(moved, axis=0), abs=1e-12)
    after = np.add(np.mean(AFTER, axis=0), [0, 0.03, 0])
    assert trial.object_pose.values[-1] == pytest.approx(after, abs=1e-12)


def test_a_picture_from_before_the_push_is_no_look_after_it():
    cell = Cell()
    cell.look(BEFORE)
    cell.push(0)
    cell.advance(PICTURE)  # the picture is still the last one before the push
    cell.look(AFTER[:-1])
    assert cell.trials == ()
    cell.look(AFTER[-1:])
    (trial,) = cell.trials
    assert trial.object_pose.values[-1] == pytest.approx(np.mean(AFTER, axis=0), abs=1e-12)


def test_the_push_under_way_is_told_row_by_row():
    cell = Cell()
    cell.look(BEFORE)
    assert cell.read("under_way") == {"object_pose": (), "tip_pose": (), "ft_wrench": ()}
    cell.set(status=LoopStatus("pushing", 0))
    cell.move("pushing", 30)
    rows = cell.read("under_way")
    assert [len(rows[name]) for name in ("object_pose", "tip_pose", "ft_wrench")] == [2, 30, 30]
    cell.move("retreating", 5)
    cell.set(execution=ExecutionStatus("home", 0), status=LoopStatus("recording", 0))
    cell.look(AFTER)
    (trial,) = cell.trials
    tips = np.array(rows["tip_pose"])
    assert tips[:, 0] - tips[0, 0] == pytest.approx(trial.tip_pose.time)
    assert tips[:, 1:3] == pytest.approx(trial.tip_pose.values)
    assert cell.read("under_way")["tip_pose"] == ()


def test_a_push_that_is_given_up_leaves_nothing():
    cell = Cell()
    cell.look(BEFORE)
    cell.set(status=LoopStatus("pushing", 0))
    cell.move("pushing", 30)
    cell.set(status=LoopStatus("looking", 0))
    cell.move("retreating", 5)
    assert cell.read("under_way")["tip_pose"] == ()
    cell.set(execution=ExecutionStatus("home", 0))
    cell.look(BEFORE)
    cell.push(0, rows=50)
    cell.look(AFTER)
    (trial,) = cell.trials
    assert len(trial.tip_pose.time) == 50


def test_rows_of_the_finger_bear_the_time_at_which_it_was_measured():
    """And one that was measured once is written down once, however often it is read."""
    cell = Cell()
    cell.look(BEFORE)
    cell.set(status=LoopStatus("pushing", 0))
    cell.advance(PERIOD)
    began = cell.time
    for row in range(10):
        cell.set(tip_age=[cell.time + 0.5 * PERIOD - began - 0.02 * (row // 2)])
        cell.move("pushing", 1)
    times = [row[0] - began for row in cell.read("under_way")["tip_pose"]]
    assert times == pytest.approx(0.02 * np.arange(5), abs=1e-9)


def test_roles_follow_the_number_of_pushes_to_learn_from():
    cell = Cell(fit=2)
    cell.look(BEFORE)
    for number in range(4):
        cell.push(number, rows=5)
        cell.look(scattered([0.1 * number, 0, 0], number))
        cell.set(status=LoopStatus("looking", number + 1))
    assert [trial.role for trial in cell.trials] == ["fit", "fit", "heldout", "heldout"]
    assert [trial.name for trial in cell.trials] == [f"trials/00{k}.json" for k in range(4)]
    for before, after in zip(
        cell.trials, cell.trials[1:], strict=False
    ):  # looks after one are before the next
        assert np.array_equal(before.object_pose.values[-1], after.object_pose.values[0])


def dataset(trials) -> PushDataset:
    grid = cells_from_polygon(np.array([[-2, -1], [2, -1], [2, 1], [-2, 1]]) * 0.01, width=0.01)
    noise = Noise(position=4e-4, angle=3e-3, tip=1e-4, force=0.3)
    return dataset_of(trials, grid, name="block", finger_radius=0.01, noise=noise)


def test_recorded_trials_are_a_dataset_that_can_be_written(trial, tmp_path):
    recorded = dataset([trial])
    again = read_dataset(write_dataset(recorded, tmp_path / "block"))
    assert again.name == "block" and again.finger_radius == 0.01 and again.noise == recorded.noise
    for channel in ("object_pose", "tip_pose", "ft_wrench"):
        kept = getattr(again.trials[0], channel)
        assert kept.time == pytest.approx(getattr(trial, channel).time, abs=1e-9)
        assert kept.values == pytest.approx(getattr(trial, channel).values, abs=1e-9)


def test_the_fingerprint_tells_recordings_apart(trial):
    other = replace(trial, tip_pose=Channel(trial.tip_pose.time, trial.tip_pose.values + 1e-9))
    assert dataset([trial]).fingerprint == dataset([trial]).fingerprint
    assert dataset([trial]).fingerprint != dataset([other]).fingerprint
    with pytest.raises(DatasetError):
        dataset([])
