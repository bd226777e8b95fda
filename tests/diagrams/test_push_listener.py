"""Messages of a made-up cell: the push in them is found, on the senders' stamps, whatever else comes."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from slipmap.diagrams.application.terminal import status
from slipmap.diagrams.hardware import network
from slipmap.diagrams.hardware.message_stream import TICK, Event, LcmLog, LogReader
from slipmap.diagrams.loops.push_listener import HEARD, PushListener, hearing, record_pushes, why_none
from slipmap.models.files import BadInput
from slipmap.models.measurements import PushDataset, read_dataset
from slipmap.models.measurements.writing import PushRecorder
from tests.hardware.made_up_cell import AHEAD, FORCE, MadeUpCell, gripper, scenario

CELL = "camera: {width: 320, height_pixels: 240, fov_y: 0.5, rate: 10.0}\n"
CELLS = 20
LATE = 0.06
FIRST = 1
"""Of the arm's messages: the clock begins half a look (5 ms) before the first, and a trial a look after its
descent."""


@pytest.fixture(scope="module")
def cell() -> MadeUpCell:
    return MadeUpCell()


@dataclass
class Recorded:
    """What `record_pushes` made of the cell's messages."""

    events: list[Event]
    listener: PushListener
    dataset: PushDataset
    folder: Path
    log: Path
    told: list[str]


@pytest.fixture(scope="module")
def recorded(cell, tmp_path_factory) -> Recorded:
    """Pictures were under way for 70 ms, there was junk on every channel, and some messages were left out."""
    slow = [
        replace(event, utime=event.utime + 70_000 * (event.channel == network.CAMERA_DEPTH))
        for event in cell.events()
    ]
    events = []
    for number, event in enumerate(sorted(slow, key=lambda event: event.utime)):
        events.append(event)
        if number % 300 == 7:
            events += [replace(event, channel=channel, data=b"junk") for channel in (*HEARD, "ELSE")]
    events = [replace(event, number=number + 3 * (number > 20)) for number, event in enumerate(events)]
    ticks = [Event(event.number, event.utime, TICK, b"") for event in events[::100]]
    mixed = sorted([*events, *ticks], key=lambda event: event.utime)
    place = tmp_path_factory.mktemp("recorded")
    listener, told = PushListener(scenario(), "box", CELLS), []
    with open(place / "log", "wb") as log:
        record_pushes(mixed, listener, PushRecorder(place / "box"), told.append, log=LcmLog(log))
    return Recorded(events, listener, listener.dataset(), place / "box", place / "log", told)


@pytest.fixture(scope="module")
def listener(recorded) -> PushListener:
    return recorded.listener


@pytest.fixture(scope="module")
def dataset(recorded) -> PushDataset:
    return recorded.dataset


def test_a_push_is_on_the_disk_and_all_messages_in_the_log(recorded):
    (trial,) = read_dataset(recorded.folder).trials
    assert np.array_equal(trial.tip_pose.values, recorded.dataset.trials[0].tip_pose.values)
    with open(recorded.log, "rb") as file:
        logged = list(LogReader(file, "log"))
    assert [(e.utime, e.channel, e.data) for e in logged] == [
        (e.utime, e.channel, e.data) for e in recorded.events
    ]
    assert [event.number for event in logged] == list(range(len(logged)))


def test_lines_tell_what_is_heard_and_which_push_is_kept(recorded):
    text = "\n".join(recorded.told)
    assert "3 messages were dropped" in text
    assert "the object is seen" in text
    assert "push 1 is kept" in text
    assert "IIWA_STATUS 201 Hz" in hearing(recorded.listener)  # junk was heard, too
    assert "dropped 7 of CAMERA_DEPTH" in hearing(recorded.listener)


def test_the_push_is_found_with_where_the_box_was(cell, dataset):
    (trial,) = dataset.trials
    way = np.linalg.norm(trial.object_pose.values[-1, :2] - trial.object_pose.values[0, :2])
    assert way == pytest.approx(cell.way[-1], abs=3e-4)
    assert trial.object_pose.values[[0, -1], 2] == pytest.approx([0.0, 0.0], abs=5e-3)
    assert dataset.name == "box" and trial.role == "fit"


def test_rows_of_the_finger_are_what_the_arm_said_at_their_stamps(cell, listener, dataset):
    """To the last digit: nothing is moved in time by when a message came or was looked at."""
    (trial,) = dataset.trials
    said = cell.tips[messages(listener, trial.tip_pose.time), :2]
    assert np.abs(said - trial.tip_pose.values).max() < 1e-9
    assert np.diff(trial.tip_pose.time) == pytest.approx(0.01, abs=1e-6)
    pressing = trial.ft_wrench.values[:, :2] @ AHEAD
    assert np.median(pressing[pressing > 0.1]) == pytest.approx(FORCE, rel=0.05)


def test_a_picture_counts_at_its_stamp_however_late_it_comes(cell, listener, dataset):
    """70 ms of the way would be 5.6 mm."""
    poses = dataset.trials[0].object_pose
    along = poses.values[:, :2] @ AHEAD
    true = cell.way[messages(listener, poses.time)]
    assert ((true > 0.01) & (true < 0.06)).sum() >= 5
    assert along == pytest.approx(true, abs=7e-4)


def messages(listener: PushListener, times: np.ndarray) -> np.ndarray:
    """(n,) numbers of the arm's messages at times of the trial; it begins with the descent."""
    return np.round((listener.descents[0].begin + times) / network.ARM_PERIOD).astype(int) + FIRST


def test_junk_is_counted(listener):
    came = listener.heard()
    count = came["ELSE"].count
    assert count > 5
    assert all(came[channel].dropped == {"cannot be decoded": count} for channel in HEARD)
    assert came[network.IIWA_STATUS].rate == pytest.approx(200.0, rel=0.01)


def test_without_messages_it_is_told_what_is_missing():
    listener = PushListener(scenario(), "box", CELLS)
    assert "IIWA_STATUS, SCHUNK_WSG_STATUS, CAMERA_DEPTH, CAMERA_POSE" in why_none(listener)
    listener.hear(Event(0, 1, "IIWA_COMMAND", b""))
    assert "messages came on IIWA_COMMAND" in why_none(listener)


def test_replay_tells_of_the_lag_and_leaves_what_exploring_leaves(slipmap, tmp_path):
    """The camera stamps its pictures 60 ms late; the log is cut off in the middle of its last message."""
    log = tmp_path / "late.lcmlog"
    whole = b"".join(event.encode() for event in MadeUpCell(LATE).events())
    log.write_bytes(whole[:-3])
    cell = tmp_path / "cell.yaml"
    cell.write_text(CELL)
    out = tmp_path / "out"
    said = slipmap(
        "replay", log, "--scenario", cell, "-o", out, "--hypotheses", 2, "--json", tmp_path / "said.json"
    )
    assert said.code == 0
    assert "ends in the middle of a message" in said.err
    assert "push 1 is kept" in said.err
    lag = json.loads((tmp_path / "said.json").read_text())["heard"]["camera_lag"]
    assert lag["value"] == pytest.approx(LATE, abs=0.01)
    assert lag["low"] < LATE < lag["high"] and lag["shown"]
    assert f"{1e3 * lag['value']:.0f} ms late" in said.out
    assert len(read_dataset(out / "pushes").trials) == 1
    assert (out / "belief.npz").is_file() and (out / "report.html").is_file()


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"no log at all, but long enough for a header", "is not an LCM log"),
        (b"", "holds no push: no valid message came on IIWA_STATUS"),
        (
            Event(0, 1, "CAMERA_DEPTH", b"x" * 50).encode() + b"x" * 60,
            "is damaged after 1 messages, at byte 90",
        ),
        (Event(0, 1_000, network.GRIPPER_STATUS, gripper(0.0)).encode(), "on IIWA_STATUS, CAMERA_DEPTH"),
    ],
)
def test_logs_without_pushes_are_bad_input_told_in_a_paragraph(slipmap, tmp_path, content, why):
    log = tmp_path / "bad.lcmlog"
    log.write_bytes(content)
    said = slipmap("replay", log, "-o", tmp_path / "out")
    assert said.code == 2
    last = said.err.strip().splitlines()[-1]
    assert last.startswith("slipmap: ") and why in last and str(log) in last


def test_a_log_that_is_not_there(slipmap, tmp_path):
    said = slipmap("replay", tmp_path / "none", "-o", tmp_path / "out")
    assert said.code == 2 and "cannot be read (No such file" in said.err


def heard_on_the_network(monkeypatch, events: list[Event]) -> None:
    class Stream(list[Event]):
        def __init__(self, url: str, heard: list[str]) -> None:
            super().__init__(events)

        def close(self) -> None:
            pass

    monkeypatch.setattr("slipmap.diagrams.hardware.message_stream.MessageStream", Stream)


def test_what_is_recorded_as_mcap_can_be_replayed(slipmap, tmp_path, monkeypatch, recorded):
    """The log holds all that came, junk included; from it the same push is found again."""
    heard_on_the_network(monkeypatch, recorded.events)
    monkeypatch.setattr("slipmap.models.inference.camera_lag.camera_lag", lambda dataset, progress: None)
    cell, log = tmp_path / "cell.yaml", tmp_path / "box.mcap"
    cell.write_text(CELL)
    said = slipmap("record", "--scenario", cell, "-o", tmp_path / "box", "--log", log, "--pushes", 1)
    assert said.code == 0 and f"messages: {log}" in said.err
    out = tmp_path / "out"
    said = slipmap("replay", log, "--scenario", cell, "-o", out, "--hypotheses", 2)
    assert said.code == 0
    (first,), (again,) = read_dataset(tmp_path / "box").trials, read_dataset(out / "pushes").trials
    for channel in ("object_pose", "tip_pose", "ft_wrench"):
        assert np.array_equal(getattr(first, channel).values, getattr(again, channel).values)
        np.testing.assert_allclose(getattr(first, channel).time, getattr(again, channel).time, atol=1e-9)
    assert (out / "belief.npz").is_file() and (out / "report.html").is_file()


def test_record_writes_what_it_heard(slipmap, tmp_path, monkeypatch, recorded):
    """All of the command but the network, and what the pushes say of the camera."""

    heard_on_the_network(monkeypatch, recorded.events)
    monkeypatch.setattr("slipmap.models.inference.camera_lag.camera_lag", lambda dataset, progress: None)
    cell = tmp_path / "cell.yaml"
    cell.write_text(CELL)
    words = ["record", "--scenario", cell, "-o", tmp_path / "box", "--pushes", 1]
    said = slipmap(*words, "--json", tmp_path / "said.json")
    assert said.code == 0
    assert "latency cannot be estimated" in said.out
    assert "ELSE" not in said.err and "IIWA_STATUS" in said.err
    assert max(len(line) for line in said.err.splitlines() if str(tmp_path) not in line) <= 80
    heard = json.loads((tmp_path / "said.json").read_text())
    assert heard["pushes"] == 1 and heard["camera_lag"] is None
    (descent,) = heard["descents"]
    assert descent["kept"] and 0.0 < descent["begin"] < descent["end"] < heard["seconds"]
    assert heard["channels"]["ELSE"]["messages"] > 5
    assert len(read_dataset(tmp_path / "box").trials) == 1


def test_recording_never_overwrites_what_was_measured(slipmap, tmp_path, dataset):
    from slipmap.models.measurements import write_dataset

    folder = write_dataset(dataset, tmp_path / "box")
    said = slipmap("record", "-o", folder)
    assert said.code == 2 and str(folder) in said.err
    log = tmp_path / "log"
    log.write_text("")
    said = slipmap("record", "-o", tmp_path / "other", "--log", log)
    assert said.code == 2 and "exists already" in said.err


def test_an_address_that_is_none_is_told_at_once(slipmap, tmp_path):
    said = slipmap("record", "-o", tmp_path / "box", "--lcm", "udpm://10.0.0.1:7667")
    assert said.code == 2 and "multicast" in said.err and not (tmp_path / "box").exists()


@pytest.mark.parametrize("name", ["box.log", "box.mcap"])
def test_a_start_that_fails_leaves_no_log_that_blocks_the_next(slipmap, tmp_path, monkeypatch, name):
    log = tmp_path / name
    said = slipmap("record", "-o", tmp_path / "box", "--log", log, "--lcm", "nonsense")
    assert said.code == 2 and not log.exists()
    monkeypatch.setitem(sys.modules, "mcap.writer", None)  # not installed
    said = slipmap("record", "-o", tmp_path / "box", "--log", tmp_path / "box.mcap")
    assert said.code == 2 and "slipmap[import]" in said.err and not list(tmp_path.iterdir())


def test_a_log_of_what_was_heard_before_a_failure_stays(slipmap, tmp_path, monkeypatch, recorded):
    def cut_off(stream, listener, recorder, tell, log, **how):
        log.write(recorded.events[0])
        raise BadInput("the network is gone")

    heard_on_the_network(monkeypatch, recorded.events)
    monkeypatch.setattr("slipmap.diagrams.loops.push_listener.record_pushes", cut_off)
    log = tmp_path / "box.log"
    assert slipmap("record", "-o", tmp_path / "box", "--log", log).code == 2
    assert log.stat().st_size > 0


def test_lines_about_what_is_heard_fit_80_columns(capsys, recorded):
    for line in (*recorded.told, hearing(recorded.listener)):
        status(line)
        said = capsys.readouterr().err.splitlines()
        assert all(len(part) <= 80 for part in said)
        assert " ".join(part.strip() for part in said) == line
        assert all(part.startswith("    ") for part in said[1:])
    assert len(hearing(recorded.listener)) > 80
