"""What the reader takes from a push dataset, and what it may leave out."""

import math
import shutil

import numpy as np
import pytest
from spoilt_datasets import record

from slipmap.models.measurements import DatasetError, Noise, Table, read_dataset, write_dataset


def test_everything_arrives(example):
    dataset = read_dataset(example.write())
    assert (dataset.name, dataset.description) == ("example", "a square pushed along +x")
    assert (dataset.height, dataset.mass, dataset.finger_radius, dataset.gravity) == (0.03, 1.2, 0.005, 9.8)
    assert dataset.noise == Noise(0.0002, 0.002, 0.0001, 0.05, 0.0003)
    assert dataset.table == Table("round", (0.0, 0.1), radius=0.5)
    assert len(dataset.grid) == 25 and dataset.grid.width == 0.02
    assert [trial.name for trial in dataset.trials] == list(example.records)
    assert dataset.warnings == ()
    first, rows = dataset.trials[0], example.records["trials/000.json"]
    np.testing.assert_array_equal(first.object_pose.time, np.array(rows["object_pose"])[:, 0])
    np.testing.assert_array_equal(first.object_pose.values, np.array(rows["object_pose"])[:, 1:])
    np.testing.assert_array_equal(first.tip_pose.values, np.array(rows["tip_pose"])[:, 1:3])
    assert first.ft_wrench is not None
    np.testing.assert_array_equal(first.ft_wrench.values, np.array(rows["ft_wrench"])[:, 1:])
    assert len(first.ft_wrench.time) == 50  # its own rate


def test_the_description_file_names_the_same_dataset_and_progress_is_told(example):
    folder = example.write()
    steps = []
    dataset = read_dataset(folder / "dataset.yaml", progress=lambda done, total: steps.append((done, total)))
    assert dataset.fingerprint == read_dataset(folder).fingerprint
    assert steps == [(1, 3), (2, 3), (3, 3)]


def test_defaults(example):
    for key in ("gravity", "noise", "table", "name", "description"):
        del example.document[key]
    for key in ("height", "mass"):
        del example.document["object"][key]
    del example.document["trials"][0]["role"]
    dataset = read_dataset(example.write())
    assert (dataset.gravity, dataset.noise, dataset.table) == (9.81, Noise(), None)
    assert (dataset.height, dataset.mass, dataset.description) == (None, None, "")
    assert (dataset.name, dataset.trials[0].role) == ("example", "fit")


def test_places_in_the_experiment_are_those_of_the_rows_or_as_said(example, tmp_path):
    rows = example.document["trials"]
    rows[0]["keep"] = False
    dataset = read_dataset(example.write())
    assert [trial.order for trial in dataset.trials] == [1, 2]
    written = write_dataset(dataset, tmp_path / "again")
    assert [trial.order for trial in read_dataset(written).trials] == [1, 2]
    for row, order, said in (
        (1, 2, "trials, row 2: order 2 is also that of another trial"),
        (1, -1, "row 1: order must be a whole number from 0 to 1000000, got -1"),
        (1, True, "row 1: order must be a whole number from 0 to 1000000, got True"),
        (1, 10**7, "row 1: order must be a whole number from 0 to 1000000, got 10000000"),
    ):
        rows[row]["order"] = order
        with pytest.raises(DatasetError, match=said):
            read_dataset(example.write())
    rows[1]["order"], rows[2]["order"] = 7, 5
    assert [trial.order for trial in read_dataset(example.write()).trials] == [7, 5]


def test_cells_are_cut_from_the_outline_where_none_are_given(example):
    del example.document["object"]["cells"]
    grid = read_dataset(example.write()).grid
    assert 50 <= len(grid) <= 70
    assert len(grid) * grid.width**2 == pytest.approx(0.01, rel=0.1)


def test_the_fingerprint_follows_the_content_not_the_place(example, tmp_path):
    folder = example.write()
    before = read_dataset(folder).fingerprint
    shutil.copytree(folder, tmp_path / "elsewhere")
    assert read_dataset(tmp_path / "elsewhere").fingerprint == before
    record(example)["object_pose"][5][1] += 1e-9
    assert read_dataset(example.write()).fingerprint != before


# what a trial may hold -----------------------------------------------------------------------------


def test_rows_with_nan_are_dropped_channel_by_channel(example):
    rows = record(example)
    rows["object_pose"][3][2] = math.nan
    rows["object_pose"][4][0] = None
    rows["tip_pose"][0][1] = math.nan
    rows["tip_pose"][7][3] = math.nan  # theta of the tip is not used
    rows["ft_wrench"][9][3] = math.nan
    trial = read_dataset(example.write()).trials[1]
    assert [len(c.time) for c in (trial.object_pose, trial.tip_pose, trial.ft_wrench)] == [98, 99, 50]
    assert rows["object_pose"][2][0] in trial.object_pose.time
    assert rows["object_pose"][3][0] not in trial.object_pose.time


def test_theta_is_unwrapped_across_dropped_rows(example):
    rows = record(example)["object_pose"]
    true = 3.0 + 0.01 * np.arange(100)
    for row, angle in zip(rows, true, strict=True):
        row[3] = math.remainder(angle, 2.0 * math.pi)
    for lost in range(12, 16):  # the wrap itself is not seen
        rows[lost][3] = math.nan
    example.document["finger"]["radius"] = 0.001  # the square is turned
    theta = read_dataset(example.write()).trials[1].object_pose.values[:, 2]
    np.testing.assert_allclose(theta, np.delete(true, range(12, 16)), atol=1e-12)


def test_a_finger_has_an_angle_if_it_turns(example, tmp_path):
    turned = 3.0 + 0.005 * np.arange(100)
    for row, angle in zip(record(example)["tip_pose"], turned, strict=True):
        row[3] = math.remainder(angle, math.tau)
    for step, row in enumerate(record(example, 2)["tip_pose"]):
        row[3] = 0.3 + 0.01 * (-1.0) ** step  # jitters
    rows = record(example)["tip_pose"]
    rows[20][3], rows[30][3] = math.nan, -9999.0  # not known
    rows[60][3] -= math.pi  # a flip
    read = read_dataset(example.write())
    assert read.trials[0].tip_angle is None and read.trials[2].tip_angle is None and read.warnings == ()
    angle = read.trials[1].tip_angle
    assert angle is not None and len(read.trials[1].tip_pose.time) == 100
    np.testing.assert_allclose(angle.values[:, 0], np.delete(turned, [20, 30]), atol=6e-3)
    again = read_dataset(write_dataset(read, tmp_path / "again")).trials[1].tip_angle
    assert again is not None
    np.testing.assert_allclose(again.at(angle.time), angle.values, atol=1e-12)


@pytest.mark.parametrize("noise", [0.01, 0.03, 0.1])
def test_noise_of_an_angle_is_no_turn(example, noise):
    rng = np.random.default_rng(0)
    for name in example.records:
        for row in example.records[name]["tip_pose"]:
            row[3] = 1.0 + noise * rng.standard_normal()
    assert [trial.tip_angle for trial in read_dataset(example.write()).trials] == [None, None, None]


def test_an_angle_of_the_finger_in_degrees_is_told_and_not_used(example):
    for step, row in enumerate(record(example)["tip_pose"]):
        row[3] = 0.3 * step
    read = read_dataset(example.write())
    assert read.trials[1].tip_angle is None
    assert any("trials/001.json, tip_pose: theta turns by 29.7" in text for text in read.warnings)


def test_force_can_be_missing(example):
    del record(example, 0)["ft_wrench"]
    record(example, 1)["ft_wrench"] = None
    record(example, 2)["ft_wrench"] = []
    assert [trial.ft_wrench for trial in read_dataset(example.write()).trials] == [None, None, None]


def test_two_rows_are_first_and_last_pose(example):
    rows = record(example)
    for key in ("object_pose", "tip_pose"):
        rows[key] = [rows[key][0], rows[key][-1]]
    dataset = read_dataset(example.write())
    assert [trial.ends_only for trial in dataset.trials] == [False, True, False]
    assert dataset.warnings == ()


def test_an_object_that_never_moves_is_no_fault(example):
    for row in record(example)["object_pose"]:
        row[1:] = [0.0, 0.0, 0.0]
    for row in record(example)["tip_pose"]:
        row[1] = min(row[1], -0.057)
    assert read_dataset(example.write()).warnings == ()


def test_a_finger_too_high_for_its_unit_or_for_the_object_is_told(example):
    example.document["finger"]["height"] = 4.0
    with pytest.raises(DatasetError, match=r"finger.height is 4 m above the table; divide by 1000"):
        read_dataset(example.write())
    example.document["finger"]["height"] = example.document["object"]["height"] = 0.03
    dataset = read_dataset(example.write())
    assert dataset.finger_height == 0.03 and any("passes over" in text for text in dataset.warnings)


def test_no_finger_no_questions_about_it(example):
    rows = record(example)
    rows["tip_pose"] = [[0.0, 10.0, 10.0, 0.0]]  # nor need its clock agree
    for row in rows["object_pose"]:
        row[1] = 0.5 * (row[0] - 1000.0) - 0.25 * (row[0] - 1000.0) ** 2
    dataset = read_dataset(example.write())
    assert [trial.finger_near() for trial in dataset.trials] == [True, False, True]
    assert dataset.warnings == ()
