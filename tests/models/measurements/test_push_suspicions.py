"""What looks wrong in a trial is read, with a warning."""

import math

import pytest
from spoilt_datasets import record, warned

from slipmap.models.measurements import read_dataset


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
    warned(example, "trials/001.json", "begins to move, but no finger comes within 1 m of its outline")


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


def test_a_force_given_the_other_way_round_is_noticed(example):
    for row in record(example)["ft_wrench"]:
        row[1:] = [-value for value in row[1:]]
    warned(example, "trials/001.json", "against the finger's motion", "is its sign reversed?")


def test_a_frozen_tracker_is_noticed(example):
    for row in record(example)["object_pose"]:
        row[1:] = [0.0, 0.0, 0.0]
    warned(example, "trials/001.json", "never changes", "frozen?")


def test_a_finger_of_one_row_is_noticed(example):
    record(example)["tip_pose"] = record(example)["tip_pose"][:1]
    assert any("tip_pose has only one row" in warning for warning in read_dataset(example.write()).warnings)


def test_two_rows_of_force_do_not_tell_its_sign(example):
    """Such as of a push of which only the ends were kept: one before the touch, one after it."""
    for index in range(3):
        for name, rows in record(example, index).items():
            record(example, index)[name] = [rows[0], rows[-1]]
        for row in record(example, index)["ft_wrench"]:
            row[1:] = [-0.3, 0.0, 0.0]
    assert not any("pulled" in text for text in read_dataset(example.write()).warnings)
