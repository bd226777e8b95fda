"""Object and finger that were recorded in different frames: the change that brings them together is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from slipmap.models.effects.registry import effects_named
from slipmap.models.geometry import rotated
from slipmap.models.measurements import PushDataset, trial_checks
from slipmap.models.measurements.contact import contact_rows
from slipmap.models.measurements.foreign_frames import (
    EFFECT_SHIFT,
    EFFECT_TURN,
    FrameChange,
    exchanged,
    frame_change,
)
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.measurements.trial import Channel, Trial
from slipmap.models.measurements.trial_checks import check_trials, fault_of_frame
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners.exploration import candidate_pushes

Change = Callable[[FloatArray], FloatArray]


@lru_cache
def recorded(spread: float = 0.3) -> PushDataset:
    """Ten pushes of a wedge, anywhere on a table."""
    rng = np.random.default_rng(4)
    grid = cells_from_polygon(np.array([[-5, -3], [6, -3], [1, 4]]) * 0.01, count=30)
    slider = Slider(grid, 0.006)
    maps = Maps(np.full((1, len(grid)), 0.02), np.full((1, len(grid)), 0.3), np.array([0.3]))
    pushes = [
        one.push([*rng.uniform(-spread, spread, 2), rng.uniform(-np.pi, np.pi)])
        for one in candidate_pushes(grid, 0.006, rng, 10, length=(0.05, 0.1))
    ]
    return record_pushes(slider, maps, pushes, rng)


def with_poses(change: Change, dataset: PushDataset) -> PushDataset:
    trials = [
        replace(trial, object_pose=replace(trial.object_pose, values=change(trial.object_pose.values)))
        for trial in dataset.trials
    ]
    return replace(dataset, trials=tuple(trials))


def found(dataset: PushDataset) -> FrameChange | None:
    return frame_change(dataset, contact_rows(dataset, dataset.trials))


def turned(angle: float) -> Change:
    return lambda poses: np.column_stack([rotated(poses[:, :2], angle), poses[:, 2] + angle])


def of_columns(x: Change, y: Change, theta: Change) -> Change:
    return lambda poses: np.column_stack([x(poses), y(poses), theta(poses)])


SWAPPED = of_columns(lambda p: p[:, 1], lambda p: p[:, 0], lambda p: p[:, 2])
CASES: list[tuple[Change, str]] = [
    (SWAPPED, "x and y of the object's poses swapped and theta kept"),
    (
        of_columns(lambda p: p[:, 1], lambda p: p[:, 0], lambda p: np.pi / 2 - p[:, 2]),
        "x and y of the object's poses swapped and theta mirrored too",
    ),
    (lambda poses: poses * [1.0, -1.0, -1.0], "y of the object's poses negated and theta mirrored too"),
    (
        of_columns(lambda p: -p[:, 0], lambda p: p[:, 1], lambda p: p[:, 2] + np.pi / 2),
        "x of the object's poses negated and theta replaced by theta -90°",
    ),
    (turned(np.pi), "the object's poses rotated by 180°"),
    (
        lambda poses: turned(2.0)(poses) + np.array([0.4, -0.1, 0.0]),
        "the object's poses rotated by -115°, then shifted by (257, 322) mm",
    ),
]


@pytest.mark.parametrize(("change", "words"), CASES, ids=[words for _, words in CASES])
def test_the_change_that_brings_finger_and_object_together_is_named(change: Change, words: str) -> None:
    dataset = with_poses(change, recorded())
    best = found(dataset)
    assert best is not None and best.touching == best.pushes == 10
    assert f"10 of 10 pushes with {words}: do object and finger share a frame?" in best.words


def test_it_is_told_on_reading_and_no_effect_is_sought(monkeypatch) -> None:
    dataset = with_poses(SWAPPED, recorded())
    change = found(dataset)
    assert change is not None
    monkeypatch.setattr(trial_checks, "frame_change", lambda setup, pushes: change)
    _, warnings = check_trials(dataset, dataset.trials, "here", lambda trial: True)
    assert f"here: {change.words}" in warnings
    assert fault_of_frame(dataset, dataset.trials) == change.words


def test_what_tracker_shift_describes_is_left_to_it() -> None:
    dataset = with_poses(turned(0.4), recorded())
    best = found(dataset)
    assert best is not None and np.degrees(best.angle) == pytest.approx(np.degrees(-0.4), abs=1.0)
    assert best.words.endswith("share a frame? If not, the effect tracker_shift may describe it")
    assert fault_of_frame(dataset, dataset.trials) is None
    reach = {one.name: one.high for one in effects_named(["tracker_shift"])[0].parameters}
    assert reach == {"x": EFFECT_SHIFT, "y": EFFECT_SHIFT, "angle": EFFECT_TURN}
    assert not best._replace(shift=np.array([0.0, 0.3])).explained


@pytest.mark.parametrize(
    "change",
    [
        lambda poses: poses,
        lambda poses: (
            poses + np.array([0.008, -0.005, 0.05])
        ),  # as calibration may leave, which effects describe
        lambda poses: poses * [1.0, 1.0, 0.0] + np.array([0.0, 0.0, 1.0]),  # not a frame's fault
    ],
)
def test_nothing_is_named_where_frames_agree(change: Change) -> None:
    assert found(with_poses(change, recorded())) is None


def test_pushes_at_one_place_show_no_rotation() -> None:
    assert found(with_poses(SWAPPED, recorded(spread=0.01))) is None


@pytest.mark.parametrize("theta", ["the object's", "none"])
def test_columns_of_object_and_finger_that_are_exchanged_are_told(theta: str) -> None:
    dataset = recorded()
    trials = []
    for trial in dataset.trials:
        pose, tip = trial.object_pose, trial.tip_pose
        turn = pose.at(tip.time)[:, 2] if theta == "the object's" else np.zeros(len(tip.time))
        taken = replace(pose, time=tip.time, values=np.column_stack([tip.values, turn]))
        left = replace(tip, time=pose.time, values=pose.values[:, :2])
        trials.append(replace(trial, object_pose=taken, tip_pose=left))
    wrong = replace(dataset, trials=tuple(trials))
    told = exchanged(wrong, contact_rows(wrong, wrong.trials))
    assert told is not None and told.startswith("the object moves before the finger does in ")
    assert "are the columns of object and finger exchanged" in told
    assert fault_of_frame(wrong, wrong.trials) == told
    _, warnings = check_trials(wrong, wrong.trials, "here", lambda trial: True)
    assert f"here: {told}" in warnings


def with_finger_later(seconds: float, trial: Trial) -> Trial:
    return replace(trial, tip_pose=replace(trial.tip_pose, time=trial.tip_pose.time + seconds))


def test_a_late_clock_of_the_finger_alone_is_not_called_exchanged() -> None:
    dataset = recorded()

    def told(seconds: list[float]) -> str | None:
        trials = [with_finger_later(*pair) for pair in zip(seconds, dataset.trials, strict=True)]
        return exchanged(dataset, contact_rows(dataset, trials))

    leads = [sets_out(trial.tip_pose) - sets_out(trial.object_pose) for trial in dataset.trials]
    assert told([0.0] * 10) is None
    assert told([0.27] * 10) is None
    assert told([0.1 - lead for lead in leads]) is None
    assert "10 of 10 pushes, by up to 0.2 s" in (told([0.2 - lead for lead in leads]) or "")


def sets_out(track: Channel) -> float:
    away = np.hypot(*(track.values[:, :2] - track.values[0, :2]).T) > 5e-3
    return float(track.time[np.argmax(away)])


def test_objects_that_a_table_carries_while_the_finger_waits_are_not_exchanged() -> None:
    def carried(trial: Trial) -> Trial:
        """On a table that moves by 5 mm/s, from 2 s before the finger moves, in its frame."""
        before = np.linspace(0.0, 1.99, 100)
        pose, tip = trial.object_pose, trial.tip_pose
        drift = np.array([5e-3, 0.0, 0.0])
        poses = np.vstack([np.tile(pose.values[0], (100, 1)), pose.values])
        poses += np.concatenate([before, 2.0 + pose.time - pose.time[0]])[:, None] * drift
        tips = np.vstack([np.tile(tip.values[0], (100, 1)), tip.values])
        tips[100:] += (2.0 + tip.time - tip.time[0])[:, None] * drift[:2]
        return replace(
            trial,
            object_pose=replace(
                pose, time=np.concatenate([before, 2.0 + pose.time - pose.time[0]]), values=poses
            ),
            tip_pose=replace(tip, time=np.concatenate([before, 2.0 + tip.time - tip.time[0]]), values=tips),
        )

    dataset = recorded()
    assert exchanged(dataset, contact_rows(dataset, [carried(trial) for trial in dataset.trials])) is None
