import json
import math
import shutil

import numpy as np
import pytest

from models.measurements import DatasetError, Noise, Table, read_dataset


def refused(example, *words):
    with pytest.raises(DatasetError) as caught:
        read_dataset(example.write())
    for word in words:
        assert word in str(caught.value), f"{word!r} is not in: {caught.value}"


def warned(example, *words):
    warnings = read_dataset(example.write()).warnings
    assert len(warnings) == 1, warnings
    for word in words:
        assert word in warnings[0], f"{word!r} is not in: {warnings[0]}"


def record(example, index=1):
    return example.records[f"trials/{index:03d}.json"]


def test_everything_arrives(example):
    dataset = read_dataset(example.write())
    assert (dataset.name, dataset.description) == ("example", "a square pushed along +x")
    assert (dataset.height, dataset.mass, dataset.finger_radius, dataset.gravity) == (0.03, 1.2, 0.005, 9.8)
    assert dataset.noise == Noise(0.0002, 0.002, 0.0001, 0.05)
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
    assert [len(c.time) for c in (trial.object_pose, trial.tip_pose, trial.ft_wrench)] == [98, 99, 49]
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


def test_no_finger_no_questions_about_it(example):
    rows = record(example)
    rows["tip_pose"] = [[0.0, 10.0, 10.0, 0.0]]  # nor need its clock agree
    for row in rows["object_pose"]:
        row[1] = 0.5 * (row[0] - 1000.0) - 0.25 * (row[0] - 1000.0) ** 2
    dataset = read_dataset(example.write())
    assert [trial.has_finger for trial in dataset.trials] == [True, False, True]
    assert dataset.warnings == ()


# faults in a trial ---------------------------------------------------------------------------------


def spoil(key, row, column, value):
    def change(example):
        record(example)[key][row][column] = value

    return change


def replaced(key, value):
    def change(example):
        record(example)[key] = value

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (spoil("object_pose", 7, 0, 1000.01), ["object_pose, row 7", "1000.01 s goes back", "of row 6"]),
        (spoil("tip_pose", 1, 0, 1000.003), ["tip_pose, row 1", "repeats that of row 0"]),
        (spoil("ft_wrench", 4, 1, math.inf), ["ft_wrench, row 4", "infinite"]),
        (spoil("object_pose", 4, 2, -math.inf), ["object_pose, row 4", "infinite"]),
        (spoil("object_pose", 4, 1, 1e9), ["object_pose, row 4", "too large"]),
        (spoil("tip_pose", 0, 0, 1.46e18), ["tip_pose, row 0", "too large"]),
        (spoil("object_pose", 2, 1, "0.1"), ["object_pose, row 2", "must hold numbers", "'0.1'"]),
        (spoil("object_pose", 2, 1, True), ["object_pose, row 2", "must hold numbers", "True"]),
        (spoil("object_pose", 2, 1, [0.1]), ["object_pose, row 2", "must hold numbers"]),
        (spoil("object_pose", 2, 1, 10**400), ["object_pose, row 2", "beyond what a measured number can be"]),
        (replaced("object_pose", [[0.0, 0.0, 0.0]] * 3), ["object_pose, row 0", "needs 4 columns, has 3"]),
        (replaced("tip_pose", [[0.0] * 4, [0.0] * 5]), ["tip_pose, row 1", "needs 4 columns, has 5"]),
        (replaced("tip_pose", [[0.0] * 4, 3.0]), ["tip_pose, row 1", "must be a list of 4 numbers, got 3.0"]),
        (replaced("object_pose", []), ["object_pose", "the trial is empty"]),
        (replaced("object_pose", {}), ["object_pose", "must be a list of rows"]),
        (replaced("object_pose", None), ["`object_pose` is missing"]),
        (replaced("object_pose", [[0.0] * 4]), ["object_pose: one usable row"]),
        (replaced("tip_pose", [[0.0, math.nan, 0.0, 0.0]] * 4), ["tip_pose", "every row holds NaN"]),
        (replaced("ft_wrench", [[math.nan] * 4] * 4), ["ft_wrench", "every row holds NaN"]),
    ],
)  # fmt: skip
def test_faults_in_a_trial_are_named_with_file_and_row(example, change, words):
    change(example)
    refused(example, "trials/001.json", *words)


def test_row_numbers_count_the_dropped_rows(example):
    rows = record(example)["object_pose"]
    rows[2][1] = math.nan
    rows[7][0] = rows[6][0]
    refused(example, "object_pose, row 7", "row 6")


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "not valid JSON"),
        (b'{"object_pose": [[0.0, 0.1', "cut short"),
        (b"[1, 2]", "must be a mapping"),
        (b"\xff\xfe\x00", "not valid JSON"),
        (b"[" * 100_000, "nested too deeply"),
        (b'{"tip_pose": [], "tip_pose": []}', "'tip_pose' stands there twice"),
        (b'{"object_pose": ' + b"9" * 10_000 + b"}", "not valid JSON"),
    ],
)
def test_a_record_that_is_no_json(example, content, word):
    folder = example.write()
    (folder / "trials/001.json").write_bytes(content)
    with pytest.raises(DatasetError, match=word) as caught:
        read_dataset(folder)
    assert "trials/001.json" in str(caught.value) and len(str(caught.value)) < 600


def test_a_missing_record_or_a_folder_in_its_place(example):
    folder = example.write()
    (folder / "trials/001.json").unlink()
    with pytest.raises(DatasetError, match=r"001\.json: there is no such file"):
        read_dataset(folder)
    (folder / "trials/001.json").mkdir()
    with pytest.raises(DatasetError, match=r"001\.json: is a folder"):
        read_dataset(folder)


def test_clocks_that_do_not_meet(example):
    for row in record(example)["ft_wrench"]:
        row[0] -= 1000.0
    refused(example, "trials/001.json, ft_wrench", "one clock")
    for row in record(example, 0)["tip_pose"]:
        row[0] += 5.0
    refused(example, "trials/000.json, tip_pose", "1005.003", "one clock")


def test_the_same_push_twice(example):
    example.records["trials/002.json"] = json.loads(json.dumps(record(example, 0)))
    refused(example, "trials/002.json holds the same measurement as trials/000.json")


@pytest.mark.parametrize(("inside", "fault"), [(0.0025, False), (0.0045, True), (0.02, True), (0.08, True)])
def test_a_finger_that_starts_inside_the_object(example, inside, fault):
    for row in record(example)["tip_pose"]:
        row[1] += 0.004 + inside  # the first row is 4 mm before contact
    if fault:
        refused(example, "trials/001.json, row 0", f"{1e3 * inside:.0f}"[0], "mm inside the object")
    else:
        assert read_dataset(example.write()).warnings == ()


# suspicions about a trial --------------------------------------------------------------------------


def test_degrees_are_noticed(example):
    for row in record(example)["object_pose"]:
        row[3] = 0.2 * row[0] - 200.0 + 10.0 * row[1] / 0.04
    warned(example, "trials/001.json, object_pose", "degrees?")


@pytest.mark.parametrize(("path", "noticed"), [(0.04, True), (2.0, False)])
def test_a_whole_turn_on_a_short_path_is_noticed(example, path, noticed):
    """Seven degrees look like more than a turn; a spinning object that goes far may turn that much."""
    for step, row in enumerate(record(example)["object_pose"]):
        row[1:] = [path * step / 99, 0.0, 7.0 * step / 99]
    record(example)["tip_pose"] = [[0.0, 10.0, 10.0, 0.0]]
    assert any("degrees?" in warning for warning in read_dataset(example.write()).warnings) == noticed


def test_a_constant_angle_in_degrees_is_noticed_too(example):
    for row in record(example)["object_pose"]:
        row[3] += 90.0
    example.document["finger"]["radius"] = 0.001
    for row in record(example)["tip_pose"]:
        row[1] -= 0.02
    assert any("degrees?" in warning for warning in read_dataset(example.write()).warnings)


def test_a_tip_in_another_frame_is_noticed(example):
    for row in record(example)["tip_pose"]:
        row[2] += 0.3
    warned(example, "trials/001.json", "never touches", "wrong frame?")


def test_a_tip_in_another_frame_is_noticed_where_only_the_ends_are_known(example):
    rows = record(example)
    rows["object_pose"] = rows["object_pose"][::99]
    rows["tip_pose"] = [[row[0], row[1], row[2] + 0.3, 0.0] for row in rows["tip_pose"][::99]]
    warned(example, "trials/001.json", "wrong frame?")


def ends_of(tips, poses):
    return {
        "object_pose": [[float(t), *pose] for t, pose in enumerate(poses)],
        "tip_pose": [[float(t), *tip, 0.0] for t, tip in enumerate(tips)],
    }


def test_where_only_the_ends_are_known_the_finger_went_straight(example):
    """It ends beyond the object, far from both of its known poses."""
    passing = ends_of([(-0.2, 0.0), (0.2, 0.0)], [(0.0, 0.0, 0.0), (0.0, 0.06, 0.4)])
    example.records["trials/001.json"] = passing
    assert read_dataset(example.write()).warnings == ()


@pytest.mark.parametrize(("turned", "noticed"), [(0.6, False), (-0.6, True)])
def test_where_only_the_ends_are_known_the_outline_is_turned(example, turned, noticed):
    example.document["object"]["outline"] = [[-0.1, -0.01], [0.1, -0.01], [0.1, 0.01], [-0.1, 0.01]]
    example.document["object"]["cells"] = {
        "width": 0.02,
        "centers": [[0.02 * i - 0.09, 0] for i in range(10)],
    }
    example.document["trials"] = [{"file": "trials/001.json"}]
    x, y = 0.1 * math.cos(0.6) + 0.008, 0.1 * math.sin(0.6)  # at the end of the bar
    poses = [(0.0, 0.0, turned), (-0.01, 0.0, turned)]
    example.records["trials/001.json"] = ends_of([(x + 0.2, y), (x, y)], poses)
    warnings = read_dataset(example.write()).warnings
    assert any("wrong frame?" in warning for warning in warnings) == noticed, warnings


def test_one_kind_of_suspicion_lists_its_trials(example):
    for index in (0, 2):
        for row in record(example, index)["tip_pose"]:
            row[2] -= 0.4
    warned(example, "trials/000.json, trials/002.json:", "never touches")


def test_lengths_in_millimetres_are_noticed(example):
    for key in ("object_pose", "tip_pose"):
        for row in record(example)[key]:
            row[1] *= 1000.0
            row[2] *= 1000.0
    warnings = read_dataset(example.write()).warnings
    assert any("object moves faster than 10 m/s" in warning for warning in warnings)
    for row in record(example)["tip_pose"]:
        row[1] /= 1000.0
        row[2] = 0.3 + 100.0 * (row[0] - 1000.003)
    warnings = read_dataset(example.write()).warnings
    assert any("tip moves faster than 10 m/s" in warning for warning in warnings)


def test_a_tip_in_millimetres_is_not_taken_for_no_finger(example):
    for row in record(example)["tip_pose"]:
        row[1] = 1000.0 * row[1] + 2000.0
    warned(example, "trials/001.json", "begins to move, but no finger is within 1 m")


def test_jitter_of_the_stamps_is_not_speed(example):
    for row in record(example)["tip_pose"][10::10]:
        row[0] -= 0.00999  # 0.6 mm within 10 µs
    assert read_dataset(example.write()).warnings == ()


def test_times_in_milliseconds_are_noticed(example):
    for key in ("object_pose", "tip_pose", "ft_wrench"):
        for row in record(example)[key]:
            row[0] *= 1000.0
    warned(example, "trials/001.json", "are times in s?")


def test_a_tip_track_that_ends_while_the_finger_moves(example):
    record(example)["tip_pose"] = record(example)["tip_pose"][:60]
    warned(example, "trials/001.json", "held at its last position")
    for row in record(example)["tip_pose"]:
        row[1] = min(row[1], record(example)["tip_pose"][40][1])
    assert read_dataset(example.write()).warnings == ()


def test_a_key_with_a_slip_of_the_pen(example):
    record(example)["ft_wrenches"] = record(example).pop("ft_wrench")
    warned(example, "trials/001.json", "'ft_wrenches' is unknown")


def test_nothing_to_learn_from(example):
    for entry in example.document["trials"]:
        entry["role"] = "heldout"
    warned(example, "every trial is heldout")
