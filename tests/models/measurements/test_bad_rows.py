"""Rows that cannot be true are left out, before angles are unwrapped, and named."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from example_dataset import push_record
from spoilt_datasets import record

from slipmap.diagrams.application.demonstration import tilted_block
from slipmap.models.measurements import read_dataset, write_dataset
from slipmap.models.measurements.bad_rows import sound_rows, without_force_spikes


def flip(rows, row, angle=math.pi):
    rows[row][3] += angle


@pytest.mark.parametrize("row", [0, 1, 40, 98, 99])
@pytest.mark.parametrize("angle", [math.pi, -math.pi, math.pi / 2])
def test_a_flipped_row_is_left_out_and_later_rows_turn_no_further(example, row, angle):
    flip(record(example)["object_pose"], row, angle)
    dataset = read_dataset(example.write())
    (warning,) = dataset.warnings
    shown = f"{abs(round(math.degrees(angle)))}°"
    assert f"trials/001.json, object_pose, row {row}: theta turns by about {shown}" in warning
    pose = dataset.trials[1].object_pose
    assert len(pose.time) == 99
    np.testing.assert_allclose(pose.values[:, 2], 0.2 * pose.values[:, 0], atol=1e-12)


def test_flips_in_several_pushes_are_one_warning(example):
    for index in range(3):
        flip(record(example, index)["object_pose"], 30 + index)
    (warning,) = read_dataset(example.write()).warnings
    assert warning.startswith("trials/000.json, object_pose, row 30; trials/001.json, object_pose, row 31; ")


@pytest.mark.parametrize("at", [[0, 1, 2], [50], [20, 21, 22, 23, 24, 25, 26, 27, 60], [97, 98, 99]])
def test_zeros_of_an_occluded_object_are_left_out(example, at):
    for rows in record(example).values():
        for row in rows:
            row[0] += 5.0
    for key in ("object_pose", "tip_pose"):
        for row in record(example)[key]:
            row[1], row[2] = row[1] + 0.3, row[2] - 0.2
    for row in at:
        record(example)["object_pose"][row][1:] = [0.0, 0.0, 0.0]
    dataset = read_dataset(example.write())
    (warning,) = dataset.warnings
    assert f"row{'s' if len(at) > 1 else ''} {at[0]}" in warning and "is exactly zero" in warning
    assert len(dataset.trials[1].object_pose.time) == 100 - len(at)
    assert dataset.trials[1].object_pose.values[:, 0].min() > 0.29


def test_an_object_that_rests_at_zero_is_no_fault(example):
    """As simulated pushes begin: here 8 rows are exactly zero before the finger arrives."""
    assert sum(row[1:] == [0.0, 0.0, 0.0] for row in record(example)["object_pose"]) > 5
    assert read_dataset(example.write()).warnings == ()


@pytest.mark.parametrize("key", ["object_pose", "tip_pose"])
@pytest.mark.parametrize("rows", [[50], [50, 51, 52]])
def test_a_jump_and_back_is_left_out(example, key, rows):
    for row in rows:
        record(example)[key][row][2] += 0.04
    dataset = read_dataset(example.write())
    (warning,) = dataset.warnings
    assert f"{key}, row" in warning and "jumps and comes back; left out" in warning
    assert len(getattr(dataset.trials[1], key).time) == 100 - len(rows)


def test_a_frame_that_turns_and_stays_is_named_and_kept(example):
    for row in record(example)["object_pose"][60:]:
        row[3] += math.pi / 2
    dataset = read_dataset(example.write())
    assert any("theta turns by about 90° after row 59" in warning for warning in dataset.warnings)
    assert len(dataset.trials[1].object_pose.time) == 100


@pytest.mark.parametrize("way", [0.14, 0.05])
def test_a_hit_is_no_jump(example, way):
    """At 50 Hz an object that is struck at 0.7 m/s moves 14 mm a row, and stops as fast."""
    rows = push_record()
    time = np.arange(60) * 0.02
    moved = np.clip(0.7 * (time - 0.4), 0.0, way)
    rows["object_pose"] = np.column_stack([time, moved, 0.0 * time, 4.0 * moved]).tolist()
    rows["tip_pose"] = np.column_stack([time, 0.7 * (time - 0.4) - 0.055, 0 * time, 0 * time])[:31].tolist()
    del rows["ft_wrench"]
    example.records["trials/001.json"] = rows
    dataset = read_dataset(example.write())
    assert len(dataset.trials[1].object_pose.time) == 60
    assert not any("left out" in warning or "stays" in warning for warning in dataset.warnings)


@pytest.mark.parametrize("case", ["occluded_rows_are_zero", "theta_one_row_flipped"])
def test_shared_cases_are_as_smooth_as_without_the_fault(shared_data, case):
    folder = shared_data / "cases" / case
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    dataset = read_dataset(folder)
    assert len(dataset.warnings) == 1 and "left out" in dataset.warnings[0]
    for trial in dataset.trials:
        step = np.abs(np.diff(trial.object_pose.values, axis=0))
        assert step[:, :2].max() < 0.02 and step[:, 2].max() < 0.3, trial.name


@pytest.mark.parametrize("code", [-1.0, -9999.0, 999.0])
@pytest.mark.parametrize("at", [range(3), range(40, 55), range(95, 100)])
def test_codes_of_an_unseen_object_are_left_out(example, code, at):
    """However many rows, and although -9999 rad looks like an angle in degrees."""
    for row in at:
        record(example)["object_pose"][row][1:] = 3 * [code]
    dataset = read_dataset(example.write())
    (warning,) = dataset.warnings
    assert f"is exactly {code:g} while the rows around it are not" in warning
    assert len(dataset.trials[1].object_pose.time) == 100 - len(at)


def test_a_long_stay_at_another_place_is_left_out(example):
    """As of a receiver that clears only the position, for longer than an object can be elsewhere and back."""
    for row in range(40, 60):
        record(example)["object_pose"][row][1:3] = [0.2, -0.3]
    dataset = read_dataset(example.write())
    (warning,) = dataset.warnings
    assert "stands at one place, away from the rows around" in warning
    assert len(dataset.trials[1].object_pose.time) == 80


@pytest.mark.parametrize("fall", [1.0, -1.0, 0.0])
def test_a_finger_at_which_x_equals_y_is_sound(fall):
    """In every row of a way along the diagonal, or in one where the way crosses it, in steps of 20 mm."""
    way = np.round(0.03 + 0.02 * np.arange(30), 3)
    across = way if fall > 0.0 else np.round(0.27 + fall * (way - 0.27), 3)
    tips = np.column_stack([way, np.where(np.arange(30) < 20, across, across[20])])
    kept, found, complaint = sound_rows(0.1 * np.arange(30), tips)
    assert kept.all() and (found, complaint) == ({}, "")


def test_a_finger_known_to_10_mm_that_rests_where_x_equals_y_is_sound():
    tips = np.where(np.arange(200)[:, None] < 85, [0.39, 0.38], [0.39, 0.39])
    assert sound_rows(0.01 * np.arange(200), tips)[0].all()
    there_and_back = np.where(np.abs(np.arange(200) - 100)[:, None] < 15, [0.401, 0.101], [0.39, 0.09])
    assert sound_rows(0.01 * np.arange(200), there_and_back)[0].all()


def test_an_object_that_is_struck_to_and_fro_and_rests_in_between_is_sound():
    """At 10 Hz, as a simulator records it: each blow lasts less than a row, and resting poses are equal."""
    time = 0.1 * np.arange(200)
    poses = np.tile([0.2, 0.1, 0.0], (200, 1))
    poses[60:140] += [0.03, 0.0, 0.1]
    assert sound_rows(time, poses)[0].all()


def test_an_angle_that_changes_for_long_is_told_and_left():
    """A body at rest, in one place throughout: no stay at another one."""
    time = 0.1 * np.arange(200)
    poses = np.tile([0.2, 0.1, 0.0], (200, 1))
    poses[60:140, 2] += math.pi
    kept, _, complaint = sound_rows(time, poses)
    assert kept.all() and complaint.startswith("theta turns by about 180°")


def moving(time, still=(), wait=0.0):
    """(T, 3) poses of an object that moves at 0.1 m/s from `wait` s on, while a tracker that does not see it
    repeats its last pose."""
    values = np.column_stack([0.1 * np.maximum(time - wait, 0.0), 0.0 * time, 0.02 * time])
    for row in still:
        values[row] = values[row - 1]
    return values


def test_repeats_of_the_last_pose_are_left_out():
    time = 0.01 * np.arange(200)
    kept, found, complaint = sound_rows(time, moving(time, range(80, 110)))
    assert np.flatnonzero(~kept).tolist() == list(range(80, 110))
    assert list(found) == ["repeats the pose before, while the object moves on as the next pose shows"]
    assert complaint == ""


@pytest.mark.parametrize("rows", [4, 5, 8])
def test_poses_that_come_less_often_than_rows_are_no_repeats(rows):
    """Of a tracker at 60 Hz, say, in a log at 240 Hz, of an object that moves by over 10 mm per pose."""
    time = np.arange(240) / 240.0
    poses = moving(8.0 * time)[np.arange(240) // rows * rows]
    assert sound_rows(time, poses + np.array([0.3, -0.2, 0.1]))[0].all()


def test_rest_is_no_repeat():
    """Before a push that starts between two rows, and of an object that is put elsewhere."""
    time = 0.2 * np.arange(60)
    resting = moving(time, wait=4.1)
    resting[time < 4.1] = resting[0]
    put = np.where(time[:, None] < 6.0, [0.0, 0.0, 0.0], [0.05, 0.0, 0.0])
    for values in (resting, put):
        assert sound_rows(time, values + np.array([0.3, -0.2, 0.1]))[0].all()


def test_a_spike_of_force_is_left_out_and_named(tmp_path):
    dataset = tilted_block()
    trials = list(dataset.trials)
    wrench = trials[4].ft_wrench
    spoilt = wrench.values.copy()
    spoilt[7, :2] = [3000.0, -4000.0]
    trials[4] = replace(trials[4], ft_wrench=replace(wrench, values=spoilt))
    write_dataset(replace(dataset, trials=tuple(trials)), tmp_path / "spoilt")
    found = read_dataset(tmp_path / "spoilt")
    (warning,) = found.warnings
    assert re.search(
        rf"004\.json: ft_wrench is up to 5000 N at t = {wrench.time[7]:.3f} s, over 10 times", warning
    )
    kept = found.trials[4].ft_wrench
    assert np.allclose(kept.time, np.delete(wrench.time, 7))
    assert np.allclose(kept.values, np.delete(wrench.values, 7, axis=0), atol=1e-6)
    # Strong is not odd where all pushes are, nor where rows beside it are.
    for strong in ([4], range(12)):
        stronger = [
            replace(one, ft_wrench=replace(one.ft_wrench, values=100.0 * one.ft_wrench.values))
            if number in strong
            else one
            for number, one in enumerate(dataset.trials)
        ]
        assert without_force_spikes(stronger) == (stronger, [])
    # Of two pushes none is usual.
    assert without_force_spikes(trials[3:5]) == (trials[3:5], [])


def test_a_blow_and_a_single_row_of_force_are_no_spikes():
    """A blow may last less than a row; of a force in one row, none shows that it is wrong."""
    trials = list(tilted_block().trials)
    pose, wrench = trials[3].object_pose, trials[3].ft_wrench
    struck = float(wrench.time[7])
    moves = np.where(pose.time[:, None] < struck, 0.0, (pose.time[:, None] - struck) * [0.3, 0.1, 0.0])
    strong = wrench.values.copy()
    strong[7, :2] = [3000.0, -4000.0]
    trials[3] = replace(
        trials[3],
        object_pose=replace(pose, values=pose.values[0] + moves),
        ft_wrench=replace(wrench, values=strong),
    )
    single = replace(wrench, time=wrench.time[:1], values=np.array([[500.0, 0.0, 0.0]]))
    trials[5] = replace(trials[5], ft_wrench=single)
    assert without_force_spikes(trials) == (trials, [])
