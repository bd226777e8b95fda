"""A recording of a whole session is cut where the object is carried, or refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from straight_pushes import reread, straight_pushes

from slipmap.models.measurements import Channel, DatasetError, read_dataset
from slipmap.models.measurements.sessions import CARRIED, SILENT, cut_at_carries, cut_at_rests
from slipmap.models.measurements.setup_description import setup_document

CARRY = 1.5  # s


def session(trials, seen=True):
    """Trials one after the other, between which the object is carried and the finger goes by a way around."""
    times, poses, tips = [], [], []
    now = 0.0
    for number, trial in enumerate(trials):
        if number:
            steps = np.arange(0.0, CARRY, 0.01)[:, None] / CARRY
            ramp = np.clip((steps - 0.3) / 0.5, 0.0, 1.0)
            pose, tip = poses[-1][-1], tips[-1][-1]
            starts = trial.tip_pose.values[0] - trial.object_pose.values[0, :2]
            outward = (1.0 - steps) * (tip - pose[:2]) + steps * starts
            away = 5.0 * outward * np.sin(np.pi * np.clip(steps, 0.0, 1.0)) ** 0.5
            if seen:
                times.append(now + CARRY * steps[:, 0])
                poses.append(pose + (trial.object_pose.values[0] - pose) * ramp)
                tips.append(tip + (trial.tip_pose.values[0] - tip) * steps + away)
            now += CARRY
        times.append(now + trial.object_pose.time)
        poses.append(trial.object_pose.values)
        tips.append(trial.tip_pose.values)
        now = times[-1][-1] + 0.01
    return np.concatenate(times), np.concatenate(poses), np.concatenate(tips)


def far(trial):
    """The finger goes back 60 mm instead of 30."""
    tip = trial.tip_pose.values.copy()
    gone = np.linspace(0.0, 1.0, 40)[:, None]
    tip[-40:] += 0.03 * gone * (tip[0] - tip[60]) / np.hypot(*(tip[0] - tip[60]))
    return replace(trial, tip_pose=Channel(trial.tip_pose.time, tip))


@pytest.fixture(params=[True, False], ids=["carried in sight", "carried out of sight"])
def recorded(request):
    trials = [far(trial) for trial in straight_pushes(4).trials]
    return trials, *session(trials, request.param)


def test_a_csv_of_a_session_is_cut_into_its_pushes(tmp_path, recorded):
    trials, time, pose, tip = recorded
    rows = np.column_stack([time, pose, tip])
    text = "t,object_x,object_y,object_theta,tip_x,tip_y\n" + "\n".join(
        ",".join(f"{cell:.6f}" for cell in row) for row in rows
    )
    (tmp_path / "all.csv").write_text(text)
    (tmp_path / "bar.yaml").write_text(json.dumps(setup_document(straight_pushes(1))))
    dataset = read_dataset(tmp_path / "all.csv", object_name=str(tmp_path / "bar.yaml"))
    assert [(trial.name, trial.role) for trial in dataset.trials] == [
        ("all.csv#1", "fit"), ("all.csv#2", "fit"), ("all.csv#3", "fit"), ("all.csv#4", "heldout"),
    ]  # fmt: skip
    (warning,) = dataset.warnings
    assert "while the finger is away at t = " in warning and "cut there into 4 pushes" in warning
    for piece, whole in zip(dataset.trials, trials, strict=True):
        for end in (0, -1):
            expected = whole.object_pose.values[end]
            assert np.abs(piece.object_pose.values[end, :2] - expected[:2]).max() < 2e-3
    many = read_dataset(tmp_path / "all.csv", object_name=str(tmp_path / "bar.yaml"), keep_all=True)
    assert len(many.trials) == 4


def test_a_session_as_one_trial_is_refused(tmp_path, recorded):
    trials, time, pose, tip = recorded
    whole = replace(trials[0], object_pose=Channel(time, pose), tip_pose=Channel(time, tip), ft_wrench=None)
    with pytest.raises(
        DatasetError, match=r"moves 0\.\d m while the finger is away at t = .* s; cut the rec"
    ):
        reread(tmp_path, replace(straight_pushes(1), trials=(whole,)), lambda trial: trial)


def test_one_push_in_which_the_object_is_carried_is_left_out(tmp_path, recorded):
    _, time, pose, tip = recorded
    dataset = straight_pushes()
    bad = replace(
        dataset.trials[2], object_pose=Channel(time, pose), tip_pose=Channel(time, tip), ft_wrench=None
    )
    read = reread(tmp_path, dataset, lambda trial: bad, only=2)
    (warning,) = read.warnings
    assert (
        warning.startswith("trials/002.json: the object moves 0.")
        and "left out; to keep it, set `keep: true`" in warning
    )
    assert len(read.trials) == 11


def pressed(pause):
    """Four pushes on one clock, each recorded until the finger still presses, and paused in between."""
    times, poses, tips = [], [], []
    for number, trial in enumerate(straight_pushes(4).trials):
        times.append(trial.object_pose.time[:72] + number * (0.72 + pause))
        poses.append(trial.object_pose.values[:72])
        tips.append(trial.tip_pose.values[:72])
    channels = (
        Channel(np.concatenate(times), np.concatenate(poses)),
        Channel(*map(np.concatenate, (times, tips))),
    )
    return replace(trial, name="all.csv", object_pose=channels[0], tip_pose=channels[1], ft_wrench=None)


def test_a_recording_is_cut_where_it_pauses():
    """Though the finger touches the object before each pause, nothing tells what it did in it."""
    setup = straight_pushes(4)
    whole = pressed(3.0)
    end = setup.trials[0].tip_pose.time[71] + 1e-9
    turned = np.minimum(whole.tip_pose.time, end)  # in the first push alone
    angle = Channel(whole.tip_pose.time, turned[:, None])
    pushes, told = cut_at_carries(setup, [replace(whole, tip_angle=angle)], "all.csv")
    assert [push.name for push in pushes] == [f"all.csv#{number}" for number in (1, 2, 3, 4)]
    for push, original in zip(pushes, setup.trials, strict=True):
        assert np.array_equal(push.object_pose.values, original.object_pose.values[:72])
    assert [push.tip_angle is not None for push in pushes] == [True, False, False, False]
    assert np.array_equal(pushes[0].tip_angle.values[:, 0], pushes[0].tip_pose.time)
    (cut,) = told
    assert "no rows of object and finger for 3.01 s from t = 0.7 s on and 2 more times" in cut.text
    assert cut.reasons == (SILENT,)
    (cut,) = cut_at_carries(setup, [pressed(1500.0)], "all.csv")[1]
    assert "no rows of object and finger for 1500 s" in cut.text


def test_carrying_and_pauses_are_counted_apart(recorded):
    """A session, and after a pause four pushes that end with the finger at the object."""
    (trial, *_), time, pose, tip = recorded
    carried = replace(trial, object_pose=Channel(time, pose), tip_pose=Channel(time, tip), ft_wrench=None)
    paused = pressed(3.0)
    both = {
        name: Channel(
            np.concatenate([carried.channels[name].time, paused.channels[name].time + time[-1] + 5.0]),
            np.concatenate([carried.channels[name].values, paused.channels[name].values]),
        )
        for name in ("object_pose", "tip_pose")
    }
    setup = straight_pushes(4)
    _, (cut,) = cut_at_carries(setup, [replace(carried, **both)], "all.csv")
    told = cut.text
    assert cut.reasons == (CARRIED, SILENT)
    # The finger is away in the pause after the session: someone carried the object.
    assert (
        "while the finger is away at t = 1." in told and " s and 3 more times, and there are no rows" in told
    )
    assert "on and 2 more times; the recording was cut there into 8 pushes" in told


def test_a_pause_in_which_nothing_moves_is_no_cut():
    """Nor is one of the tracker alone, whose finger tells what happened."""
    setup = straight_pushes(1)
    push = setup.trials[0]
    late = Channel(push.object_pose.time + np.where(np.arange(120) < 3, 0.0, 5.0), push.object_pose.values)
    tips = push.tip_pose.values.copy()
    tips[:3] = tips[3]
    waits = replace(push, object_pose=late, tip_pose=Channel(late.time, tips), ft_wrench=None)
    time = 10.0 * push.object_pose.time  # a slow push of 12 s
    blind = Channel(np.delete(time, np.s_[30:50]), np.delete(push.object_pose.values, np.s_[30:50], axis=0))
    slow = replace(push, object_pose=blind, tip_pose=Channel(time, push.tip_pose.values), ft_wrench=None)
    for trial in (waits, slow):
        assert cut_at_carries(setup, [trial], "push.csv") == ([trial], [])


def test_a_long_rest_before_a_push_is_cut_off():
    push = straight_pushes(1).trials[0]
    waits = np.arange(-1200.0, 0.0)
    channels = [
        Channel(
            np.concatenate([waits, channel.time]),
            np.concatenate([np.tile(channel.values[0], (1200, 1)), channel.values]),
        )
        for channel in (push.object_pose, push.tip_pose)
    ]
    long = replace(push, object_pose=channels[0], tip_pose=channels[1], ft_wrench=None)
    (kept,) = cut_at_rests(straight_pushes(1), long, longest=1000.0)
    assert kept.name == push.name
    assert -2.0 < kept.object_pose.time[0] < 0.05 and kept.object_pose.time[-1] > 1.0
    assert cut_at_rests(straight_pushes(1), long) == [long]


def test_an_object_that_slides_on_is_not_carried(tmp_path):
    """Struck, it leaves the finger behind and comes to rest 0.2 m away."""
    time = np.arange(0.0, 2.0, 0.01)
    slid = 0.2 * (1.0 - (1.0 - np.clip(time - 0.3, 0.0, 1.0)) ** 2)
    push = straight_pushes(1).trials[0]
    heading = np.append((push.tip_pose.values[60] - push.tip_pose.values[0]), 0.0)
    heading /= np.linalg.norm(heading)
    pose = push.object_pose.values[0] + heading * slid[:, None]
    tip = push.tip_pose.values[0] + heading[:2] * np.clip(0.4 * (time - 0.29), 0.0, 0.01)[:, None]
    slide = replace(push, object_pose=Channel(time, pose), tip_pose=Channel(time, tip), ft_wrench=None)
    dataset = reread(tmp_path, replace(straight_pushes(1), trials=(slide,)), lambda trial: trial)
    assert not any("away" in warning for warning in dataset.warnings)


@pytest.mark.parametrize("name", ["session2.csv", "session_push_id.csv"])
def test_shared_sessions_are_three_pushes(shared_data, name):
    folder = shared_data / "cases" / "session_in_one_file"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    dataset = read_dataset(folder / name, object_name=str(folder / "sq.yaml"))
    assert len(dataset.trials) == 3
    for trial in dataset.trials:
        assert trial.object_pose.time[-1] - trial.object_pose.time[0] < 3.5
    if name == "session2.csv":
        assert "moves 0.2 m while the finger is away at t = 3.4 s" in dataset.warnings[0]
