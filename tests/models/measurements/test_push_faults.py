"""Faults in a trial are refused, with file and row."""

import json
import math

import pytest
from spoilt_datasets import record, refused

from slipmap.models.measurements import DatasetError, parsing, read_dataset


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
        (spoil("object_pose", 7, 0, 1000.01), ["object_pose, row 7", "1000.01 s is earlier", "of row 6"]),
        (spoil("tip_pose", 1, 0, 1000.003), ["tip_pose, row 1", "repeats that of row 0"]),
        (spoil("ft_wrench", 4, 1, math.inf), ["ft_wrench, row 4", "infinite"]),
        (spoil("object_pose", 4, 2, -math.inf), ["object_pose, row 4", "infinite"]),
        (spoil("object_pose", 4, 1, 1e9), ["object_pose, row 4", "too large"]),
        (spoil("tip_pose", 0, 0, 1.46e18), ["tip_pose, row 0", "too large"]),
        (spoil("object_pose", -1, 0, 2100.0), ["object_pose", "may last at most 1000 s", "milliseconds"]),
        (spoil("object_pose", 2, 1, "0.1"), ["object_pose, row 2", "must hold numbers", "text; write 0.1"]),
        (spoil("object_pose", 2, 1, True), ["object_pose, row 2", "must hold numbers", "True"]),
        (spoil("object_pose", 2, 1, [0.1]), ["object_pose, row 2", "must hold numbers"]),
        (spoil("object_pose", 2, 1, 10**400), ["object_pose, row 2", "too large for a measured number"]),
        (replaced("object_pose", [[0.0, 0.0, 0.0]] * 3), ["object_pose, row 0", "needs 4 columns, has 3"]),
        (replaced("tip_pose", [[0.0] * 4, [0.0] * 5]), ["tip_pose, row 1", "needs 4 columns, has 5"]),
        (replaced("tip_pose", [[0.0] * 4, 3.0]), ["tip_pose, row 1", "must be a list of 4 numbers, got 3.0"]),
        (replaced("object_pose", []), ["object_pose", "remove this empty trial"]),
        (replaced("object_pose", {}), ["object_pose", "must be a list of rows"]),
        (replaced("object_pose", None), ["`object_pose` is missing"]),
        (replaced("object_pose", [[0.0] * 4]), ["object_pose: one usable row"]),
        (replaced("tip_pose", [[0.0, math.nan, 0.0, 0.0]] * 4), ["tip_pose", "every row contains NaN"]),
        (replaced("ft_wrench", [[math.nan] * 4] * 4), ["ft_wrench", "every row contains NaN"]),
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
        (b'{"tip_pose": [], "tip_pose": []}', "'tip_pose' appears twice"),
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


def test_the_same_push_at_another_time(example):
    example.records["trials/002.json"] = json.loads(json.dumps(record(example, 0)))
    for rows in record(example, 2).values():
        for row in rows:
            row[0] += 100.0
    refused(example, "trials/002.json holds the same measurement as trials/000.json")


def test_a_fault_that_several_files_share_is_told_once(example):
    for name in ("trials/000.json", "trials/001.json"):
        for row in example.records[name]["object_pose"]:
            row[0] *= 1e4 if name.endswith("0.json") else 2e4
    with pytest.raises(DatasetError) as caught:
        read_dataset(example.write())
    text = str(caught.value)
    assert text.count("were these milliseconds?") == 1 and "in the first, lasts" in text
    assert text.index("000.json") < text.index("001.json") < text.index("lasts")


def test_texts_that_differ_in_their_own_file_become_one():
    texts = ["a/1.csv, row 3: 1.csv is empty", "a/2.csv: 2.csv is empty", "a/3.csv: lasts 4 s", "no place"]
    said = ["a/1.csv, row 3, a/2.csv: the file is empty", "a/3.csv: lasts 4 s", "no place"]
    assert parsing.grouped(texts) == said
