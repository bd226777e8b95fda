"""A recording that grows in its folder: whenever it ends, what was kept opens."""

from __future__ import annotations

import errno
import os
import signal
import tempfile
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from example_dataset import example_in

from slipmap.models.files import write_json
from slipmap.models.measurements import DatasetError, read_dataset, write_dataset, writing as recording
from slipmap.models.measurements.writing import PushRecorder


@lru_cache(maxsize=1)
def example():
    with tempfile.TemporaryDirectory() as folder:
        return read_dataset(example_in(Path(folder) / "example").write())


@lru_cache(maxsize=100)
def growing(count, offset=0.0):
    """A dataset of that many trials; all different."""
    whole = example()
    trial = whole.trials[0]
    trials = []
    for number in range(count):
        pose = replace(trial.object_pose, values=trial.object_pose.values + 1e-3 * number + offset)
        trials.append(replace(trial, name=f"trials/{number:03d}.json", object_pose=pose))
    return replace(whole, trials=tuple(trials))


def same(one, other):
    assert len(one.trials) == len(other.trials)
    for a, b in zip(one.trials, other.trials, strict=True):
        assert (a.name, a.role) == (b.name, b.role)
        for channel in ("object_pose", "tip_pose", "ft_wrench"):
            assert np.array_equal(getattr(a, channel).values, getattr(b, channel).values)


def record(folder, count, *, offset=0.0, kept=0):
    recorder = PushRecorder(folder, kept)
    for number in range(kept + 1, count + 1):
        recorder.keep(growing(number, offset))
    return recorder


def test_what_is_recorded_is_what_would_be_written_at_once(tmp_path):
    record(tmp_path / "pushes", 3)
    write_dataset(growing(3), tmp_path / "at once")
    ours, theirs = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*")}
        for folder in (tmp_path / "pushes", tmp_path / "at once")
    )
    assert ours == theirs
    assert {path.name for path in tmp_path.iterdir()} == {"pushes", "at once"}


def test_after_each_push_the_folder_opens(tmp_path):
    recorder = PushRecorder(tmp_path / "pushes")
    assert not (tmp_path / "pushes").exists()
    for count in (1, 2, 4):
        recorder.keep(growing(count))
        same(read_dataset(tmp_path / "pushes"), growing(count))
    recorder.keep(growing(4))
    same(read_dataset(tmp_path / "pushes"), growing(4))


def test_an_outline_that_becomes_more_exact_is_described_anew(tmp_path):
    recorder = record(tmp_path / "pushes", 2)
    finer = replace(growing(2).grid, exterior=1.01 * growing(2).grid.exterior)
    recorder.keep(replace(growing(2), grid=finer))
    found = read_dataset(tmp_path / "pushes")
    same(found, growing(2))
    assert np.array_equal(found.grid.exterior, finer.exterior)


def test_a_recording_that_was_interrupted_is_gone_on_with(tmp_path):
    record(tmp_path / "pushes", 2)
    record(tmp_path / "pushes", 4, kept=2)
    same(read_dataset(tmp_path / "pushes"), growing(4))


def test_an_earlier_recording_stays_until_the_first_push_and_is_gone_then(tmp_path):
    record(tmp_path / "pushes", 3)
    recorder = PushRecorder(tmp_path / "pushes")
    same(read_dataset(tmp_path / "pushes"), growing(3))
    recorder.keep(growing(1, offset=1.0))
    same(read_dataset(tmp_path / "pushes"), growing(1, offset=1.0))
    assert {path.name for path in tmp_path.iterdir()} == {"pushes"}


def test_other_files_in_the_folder_are_told_before_anything_is_recorded(tmp_path):
    record(tmp_path / "pushes", 1)
    (tmp_path / "pushes" / "notes.txt").write_text("mine")
    with pytest.raises(DatasetError, match=r"notes.txt is not part"):
        PushRecorder(tmp_path / "pushes")


class Killed(BaseException):
    pass


def test_wherever_it_is_cut_off_the_folder_opens_with_what_was_kept(tmp_path, monkeypatch):
    """Every system call that changes a file, from the second push on, is once the last."""
    point = 0
    while True:
        folder = tmp_path / str(point) / "pushes"
        folder.parent.mkdir()
        recorder = record(folder, 1)
        left = [point]

        def cut(call, left=left):
            def instead(*arguments, **options):
                if left[0] == 0:
                    raise Killed
                left[0] -= 1
                return call(*arguments, **options)

            return instead

        kept = 1
        with monkeypatch.context() as patch:
            for name in ("replace", "fsync"):
                patch.setattr(recording.os, name, cut(getattr(os, name)))
            patch.setattr(recording, "open", cut(open), raising=False)
            try:
                for kept in (1, 2, 3):
                    recorder.keep(growing(kept + 1))
            except Killed:
                pass
            else:
                break
        found = read_dataset(folder)
        assert len(found.trials) >= kept
        same(found, growing(len(found.trials)))
        record(folder, 4, kept=len(found.trials))
        same(read_dataset(folder), growing(4))
        point += 1
    assert point == 3 * 6  # of each push two files, each opened, synced and renamed


def test_a_killed_process_loses_nothing_that_was_kept(tmp_path):
    """SIGKILL after random times, a process each."""
    rng = np.random.default_rng(0)
    datasets = [growing(count) for count in range(1, 40)]
    for attempt in range(8):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        told, tell = os.pipe()
        child = os.fork()
        if child == 0:
            recorder = PushRecorder(folder / "pushes")
            for dataset in datasets:
                recorder.keep(dataset)
                os.write(tell, b".")
            os._exit(0)
        os.close(tell)
        said = len(os.read(told, 1))  # it has begun
        time.sleep(rng.uniform(0.0, 0.1))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        said += len(os.read(told, 1000))
        os.close(told)
        found = read_dataset(folder / "pushes")
        assert said <= len(found.trials) <= said + 1
        same(found, growing(len(found.trials)))
        write_json(folder / "next.json", {})  # whatever the next command writes
        assert {path.name for path in folder.iterdir()} == {"pushes", "next.json"}


@pytest.mark.parametrize(("call", "named"), [(0, "trials/002.json"), (1, "dataset.yaml")])
def test_a_full_disk_names_the_file_and_what_was_kept_opens(tmp_path, monkeypatch, call, named):
    recorder = record(tmp_path / "pushes", 2)
    calls = iter([call == 1, False])

    def full(descriptor):
        if not next(calls):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(recording.os, "fsync", full)
        with pytest.raises(OSError, match="No space left") as told:
            recorder.keep(growing(3))
    assert told.value.filename == str(tmp_path / "pushes" / named)
    assert told.value.errno == errno.ENOSPC
    same(read_dataset(tmp_path / "pushes"), growing(2))
    assert {path.name for path in tmp_path.iterdir()} == {"pushes"}
    recorder.keep(growing(3))  # there is room again
    same(read_dataset(tmp_path / "pushes"), growing(3))


def test_a_full_disk_at_the_first_push_leaves_the_earlier_recording(tmp_path, monkeypatch):
    record(tmp_path / "pushes", 3)

    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(recording, "_write_files", full)
    with pytest.raises(OSError, match="No space left"):
        PushRecorder(tmp_path / "pushes").keep(growing(1, offset=1.0))
    same(read_dataset(tmp_path / "pushes"), growing(3))
