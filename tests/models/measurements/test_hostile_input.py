"""Whatever happens to the files of a dataset, reading gives a valid dataset or a DatasetError."""

import copy
import json
import math
import tempfile
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml
from example_dataset import example_in
from hypothesis import HealthCheck, given, settings, strategies as st

from slipmap.models.measurements import DatasetError, read_dataset
from slipmap.models.measurements.trial_tables import unwrapped

SETTINGS = settings(
    max_examples=100, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck)
)

STRANGE = st.one_of(
    st.none(),
    st.booleans(),
    st.sampled_from([0, -1, 10**400, -(10**30), 2**63, 1e308, -1e308, 5e-324, math.nan, math.inf, -math.inf]),
    st.floats(),
    st.text(max_size=5),
    st.sampled_from(["1e-3", "nan", "../x", "trials/000.json", "fit", "push-dataset/1", "\x00", "/dev/zero"]),
    st.lists(st.one_of(st.floats(), st.none(), st.text(max_size=2)), max_size=4),
    st.recursive(st.integers(), lambda inner: st.lists(inner, max_size=3), max_leaves=20),
    st.dictionaries(st.text(max_size=4), st.floats(), max_size=3),
)


def places(value, path=()):
    """Every path into a nested structure of mappings and lists."""
    yield path
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in inner:
        yield from places(child, (*path, key))


@st.composite
def mutated(draw, original):
    """The structure with one to three values dropped, repeated or swapped for strange ones."""
    result = {"root": copy.deepcopy(original)}
    for _ in range(draw(st.integers(1, 3))):
        spots = [path for path in places(result) if path]
        depth = draw(st.integers(1, max(len(path) for path in spots)))  # else rows of numbers win
        path = draw(st.sampled_from([path for path in spots if len(path) == depth]))
        holder = result
        for key in path[:-1]:
            holder = holder[key]
        change = draw(st.sampled_from(["drop", "swap", "repeat"]))
        if change == "drop" and len(path) > 1:
            del holder[path[-1]]
        elif change == "repeat" and isinstance(holder, list):
            holder.insert(path[-1], copy.deepcopy(holder[path[-1]]))
        else:
            holder[path[-1]] = draw(STRANGE)
        if "root" not in result:
            break
    return result.get("root")


def small_example(folder):
    """Few cells and rows, so that each mutation has a chance to matter."""
    example = example_in(Path(folder) / "example")
    example.document["object"]["cells"]["centers"] = [[0.01, 0.01], [0.01, -0.01], [-0.01, 0.0]]
    example.document["object"]["cells"]["width"] = 0.05
    for record in example.records.values():
        for key in record:
            record[key] = record[key][::20]
    return example


CELLS = st.sampled_from(["", "0", "1", "1.5", "-3", "nan", "inf", "x", '"', ","])
SMALL = small_example("unwritten")


def object_file(folder):
    """The object alone; with cells given, none need be cut from the outline."""
    path = Path(folder) / "object.yaml"
    path.write_text(yaml.safe_dump({key: SMALL.document[key] for key in ("object", "finger")}))
    return str(path)


def read_or_refuse(path, **more):
    """A dataset whose numbers can be used, or None where it was refused."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            dataset = read_dataset(path, **more)
        except DatasetError as error:
            assert 10 < len(str(error)) < 1500 and "\n" not in str(error)
            return None
        for trial in dataset.trials:
            for channel in (trial.object_pose, trial.tip_pose, trial.ft_wrench):
                if channel is not None:
                    assert np.isfinite(channel.values).all() and (np.diff(channel.time) > 0.0).all()
            assert np.isfinite(trial.initial_velocity()).all()
        assert dataset.finger_radius > 0.0 and np.isfinite(dataset.grid.centers).all()
        return dataset


@SETTINGS
@given(mutated(SMALL.document))
def test_spoilt_descriptions(document):
    with tempfile.TemporaryDirectory() as folder:
        example = small_example(folder)
        example.write()
        path = example.folder / "dataset.yaml"
        path.write_text(yaml.safe_dump(document), encoding="utf-8")
        read_or_refuse(example.folder)


@SETTINGS
@given(mutated(SMALL.records["trials/001.json"]))
def test_spoilt_records(record):
    with tempfile.TemporaryDirectory() as folder:
        example = small_example(folder)
        example.records["trials/001.json"] = record
        read_or_refuse(example.write())


@SETTINGS
@given(st.sampled_from(["dataset.yaml", "trials/000.json"]), st.floats(0.0, 1.0), st.binary(max_size=4))
def test_cut_and_broken_bytes(name, share, junk):
    with tempfile.TemporaryDirectory() as folder:
        example = small_example(folder)
        path = example.write() / name
        content = path.read_bytes()
        cut = int(share * len(content))
        path.write_bytes(content[:cut] + junk)
        read_or_refuse(example.folder)
        path.write_bytes(content[:cut] + junk + content[cut + len(junk) :])
        read_or_refuse(example.folder)


@SETTINGS
@given(st.binary(max_size=300) | st.text(max_size=300).map(str.encode))
def test_arbitrary_bytes(content):
    with tempfile.TemporaryDirectory() as folder:
        described = object_file(folder)
        for name in ("dataset.yaml", "a.json", "b.csv", "c.h5"):
            path = Path(folder) / name.replace(".", "_") / name
            path.parent.mkdir()
            path.write_bytes(content)
            assert read_or_refuse(path, object_name=None if name == "dataset.yaml" else described) is None


@SETTINGS
@given(st.floats(0.0, 1.0), st.binary(min_size=1, max_size=8))
def test_broken_hdf5(share, junk):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "push.h5"
        with h5py.File(path, "w") as file:
            for key, rows in SMALL.records["trials/001.json"].items():
                file.create_dataset(key, data=np.array(rows))
        content = path.read_bytes()
        place = int(share * len(content))
        path.write_bytes(content[:place] + junk + content[place + len(junk) :])
        read_or_refuse(path, object_name=object_file(folder))
        path.write_bytes(content[:place])
        read_or_refuse(path, object_name=object_file(folder))


@SETTINGS
@given(st.lists(st.lists(CELLS, max_size=8), max_size=6))
def test_arbitrary_csv(rows):
    header = "t,object_x,object_y,object_theta,tip_x,tip_y"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "push.csv"
        path.write_text("\n".join([header, *(",".join(row) for row in rows)]))
        read_or_refuse(path, object_name=object_file(folder))


def test_the_unspoilt_example_is_read():
    with tempfile.TemporaryDirectory() as folder:
        dataset = read_or_refuse(small_example(folder).write())
        assert dataset is not None and len(dataset.trials) == 3


@given(st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=20))
def test_unwrapping_leaves_no_jump_and_is_done_once(angles):
    once = unwrapped(np.array(angles))
    assert np.all(np.abs(np.diff(once)) <= np.pi + 2e-9)
    turns = (once - angles) / (2.0 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    np.testing.assert_array_equal(unwrapped(once), once)


@pytest.mark.parametrize("number", ["1e999", "-1e999", "NaN", "1" + "0" * 4000])
def test_numbers_that_json_allows_and_nobody_measures(tmp_path, number):
    example = small_example(tmp_path)
    folder = example.write()
    text = json.dumps(example.records["trials/000.json"]).replace("0.01]", f"{number}]", 1)
    (folder / "trials/000.json").write_text(text)
    dataset = read_or_refuse(folder)
    assert (dataset is not None) == (number == "NaN")
