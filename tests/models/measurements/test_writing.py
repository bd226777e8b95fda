import os
import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from slipmap.models.measurements import (
    Channel,
    DatasetError,
    Noise,
    PushDataset,
    Table,
    Trial,
    read_dataset,
    write_dataset,
)
from slipmap.models.physics.cell_grid import CellGrid


def assert_equal(one: PushDataset, other: PushDataset) -> None:
    """Every number to the last bit."""
    numbers = ("height", "mass", "finger_radius", "finger_height", "table", "gravity", "noise")
    for key in ("name", "description", *numbers):
        assert getattr(one, key) == getattr(other, key), key
    assert one.grid.width == other.grid.width
    np.testing.assert_array_equal(one.grid.centers, other.grid.centers)
    np.testing.assert_array_equal(one.grid.exterior, other.grid.exterior)
    assert [(t.name, t.role) for t in one.trials] == [(t.name, t.role) for t in other.trials]
    for mine, its in zip(one.trials, other.trials, strict=True):
        for key in ("object_pose", "tip_pose", "ft_wrench"):
            a, b = getattr(mine, key), getattr(its, key)
            assert (a is None) == (b is None), key
            if a is not None:
                np.testing.assert_array_equal(a.time, b.time)
                np.testing.assert_array_equal(a.values, b.values)


positive = st.floats(1e-3, 1e3)
coordinate = st.floats(-0.2, 0.2)


@st.composite
def channels(draw, values, columns, at_least):
    rows = draw(st.integers(at_least, 6))
    steps = draw(st.lists(st.floats(1e-4, 0.3), min_size=rows, max_size=rows))
    table = [[draw(value) for value in values] for _ in range(rows)]
    return Channel(np.cumsum(steps), np.array(table).reshape(rows, columns))


@st.composite
def trials(draw, index):
    """Each with a place of the finger of its own, for two trials must not be equal."""
    pose = draw(channels([coordinate, coordinate, st.floats(-3.0, 3.0)], 3, 2))
    tip = draw(channels([st.floats(0.4, 0.6), coordinate], 2, 1))
    force = st.floats(-50.0, 50.0)
    wrench = draw(st.none() | channels([force, force, force], 3, 1))
    start = draw(st.floats(0.0, 0.9)) + index
    pose, tip = (Channel(start + c.time - c.time[0], c.values) for c in (pose, tip))
    tip.values[:, 0] += 1e-3 * index
    if wrench is not None:
        wrench = Channel(start + wrench.time - wrench.time[0], wrench.values)
    pose.values[:, 2] = np.cumsum(pose.values[:, 2])  # steps below half a turn: unwrapped
    name = draw(st.sampled_from(["trials/{}.json", "{}.json", "deep/er/push {}.json", "Stoß {}.json"]))
    role = draw(st.sampled_from(["fit", "heldout"]))
    return Trial(name.format(index), role, pose, tip, wrench)


@st.composite
def datasets(draw):
    level = st.none() | st.floats(0.0, 0.1)
    side = st.floats(0.1, 3.0)
    place = st.tuples(coordinate, coordinate)
    table = st.one_of(
        st.none(),
        st.builds(Table, st.just("round"), place, radius=side),
        st.builds(Table, st.just("rectangle"), place, size=st.tuples(side, side)),
    )
    jolt = np.array([[draw(coordinate), draw(coordinate)] for _ in range(4)]) * 1e-2
    corners = np.array([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]) + jolt
    return PushDataset(
        name=draw(st.text(st.characters(codec="utf-8"))),
        description=draw(st.text(st.characters(codec="utf-8"))),
        grid=CellGrid(corners * draw(st.floats(0.1, 0.7)), draw(st.floats(1e-3, 0.1)), corners),
        height=draw(st.none() | positive),
        mass=draw(st.none() | positive),
        finger_radius=draw(st.floats(1e-4, 0.05)),
        finger_height=draw(st.none() | st.floats(1e-4, 0.5)),
        table=draw(table),
        gravity=draw(positive),
        noise=draw(st.builds(Noise, level, level, level, level)),
        trials=tuple(draw(trials(index)) for index in range(draw(st.integers(1, 3)))),
        fingerprint="",
    )


@settings(max_examples=40, derandomize=True, deadline=None)
@given(datasets())
def test_what_is_written_is_read_to_the_last_bit(tmp_path_factory, dataset):
    folder = write_dataset(dataset, tmp_path_factory.mktemp("round") / "trip")
    assert_equal(read_dataset(folder), dataset)


@pytest.mark.parametrize("sign", ["\x85", "\u2028", "\u2029", "\ufeff", "\x0b", "\xa0", "\r\n"])
def test_unusual_breaks_and_blanks_in_a_description_stay(example, tmp_path, sign):
    dataset = replace(read_dataset(example.write()), description=f"before{sign}after{sign}")
    written = write_dataset(dataset, tmp_path / "strange")
    assert read_dataset(written).description == dataset.description


@pytest.mark.parametrize("name", ["bullet/book_p9", "effects/public-none", "real/mit_abs_rect1"])
def test_shipped_datasets_make_the_round_trip(shared_data, tmp_path, name):
    dataset = read_dataset(shared_data / name)
    assert_equal(read_dataset(write_dataset(dataset, tmp_path / "copy")), dataset)


def test_a_selection_can_be_written(example, tmp_path):
    dataset = read_dataset(example.write()).with_fit_pushes(1)
    assert_equal(read_dataset(write_dataset(dataset, tmp_path / "a" / "b" / "few")), dataset)


@pytest.mark.parametrize(
    "name", ["push.csv", "../push.json", "/push.json", "a//push.json", "a\\b.json", "é" * 200]
)
def test_names_that_do_not_fit_are_numbered(example, tmp_path, name):
    dataset = read_dataset(example.write())
    strange = replace(dataset, trials=(replace(dataset.trials[0], name=name), dataset.trials[1]))
    copy = read_dataset(write_dataset(strange, tmp_path / "copy"))
    assert [trial.name for trial in copy.trials] == ["trials/000.json", "trials/001.json"]


def test_files_are_readable_to_others_and_nothing_else_is_left(example, tmp_path):
    dataset = read_dataset(example.write())
    target = write_dataset(dataset, tmp_path / "out" / "copy")
    assert os.listdir(target.parent) == ["copy"]
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(target.stat().st_mode) == 0o777 & ~mask


def test_a_dataset_is_replaced_only_on_demand(example, tmp_path):
    dataset = read_dataset(example.write())
    target = write_dataset(dataset, tmp_path / "out")
    with pytest.raises(DatasetError, match="there is already a push dataset"):
        write_dataset(dataset.with_fit_pushes(1), target)
    assert len(read_dataset(target).trials) == 3
    write_dataset(dataset.with_fit_pushes(1), target, overwrite=True)
    assert len(read_dataset(target).trials) == 2
    assert not (target / "trials/001.json").exists()
    assert sorted(os.listdir(tmp_path)) == ["example", "out"]


def test_nothing_foreign_is_overwritten(example, tmp_path):
    dataset = read_dataset(example.write())
    (tmp_path / "file").write_text("mine")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    (tmp_path / "named").mkdir()
    (tmp_path / "named" / "dataset.yaml").write_text("format: photographs/3")
    mixed = write_dataset(dataset, tmp_path / "mixed")
    (mixed / "README.md").write_text("mine")
    for name, word in [
        ("file", "this is a file, not a folder"),
        ("other", "not a push dataset"),
        ("named", "format is 'photographs/3'"),
        ("mixed", "README.md is not part of the dataset there and would be lost"),
    ]:
        with pytest.raises(DatasetError, match=word):
            write_dataset(dataset, tmp_path / name, overwrite=True)
    assert (tmp_path / "file").read_text() == (tmp_path / "other" / "notes.txt").read_text() == "mine"
    assert (mixed / "README.md").read_text() == "mine"


@pytest.mark.parametrize("inner", [(), ("trials",)])
def test_an_empty_folder_is_taken(example, tmp_path, inner):
    target = tmp_path.joinpath("empty", *inner)
    target.mkdir(parents=True)
    dataset = read_dataset(example.write())
    assert_equal(read_dataset(write_dataset(dataset, tmp_path / "empty")), dataset)


@pytest.mark.parametrize("fault", ["write_text", "replace"])
def test_a_failure_half_way_leaves_the_old_dataset(example, tmp_path, monkeypatch, fault):
    dataset = read_dataset(example.write())
    target = write_dataset(dataset, tmp_path / "out")
    owner = Path if fault == "write_text" else os
    real, calls = getattr(owner, fault), []

    def full_disk(*args, **more):
        calls.append(args)
        if len(calls) == 2:  # the second trial, or the new folder after the old one was set aside
            raise OSError("no space left on device")
        return real(*args, **more)

    with monkeypatch.context() as patch:
        patch.setattr(owner, fault, full_disk)
        with pytest.raises(OSError, match="no space left"):
            write_dataset(dataset.with_fit_pushes(1), target, overwrite=True)
    assert_equal(read_dataset(target), dataset)
    assert sorted(os.listdir(tmp_path)) == ["example", "out"]
