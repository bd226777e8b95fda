import math
import os
import shutil

import pytest
from shapely.geometry import LinearRing

from slipmap.models.measurements import DatasetError, read_dataset


def set_at(path, value):
    def change(document):
        for key in path[:-1]:
            document = document[key]
        document[path[-1]] = value

    return change


def without(*path):
    def change(document):
        for key in path[:-1]:
            document = document[key]
        del document[path[-1]]

    return change


CROSSED = [[-0.05, -0.05], [0.05, 0.05], [0.05, -0.05], [-0.05, 0.05]]
CLOSED = [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05], [-0.05, -0.05]]
MILLIMETRES = [[-50, -50], [50, -50], [50, 50], [-50, 50]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (without("format"), ["`format` is missing", "push-dataset/1"]),
        (set_at(["format"], "push-dataset/2"), ["format is 'push-dataset/2'", "only push-dataset/1"]),
        (without("object"), ["`object` is missing"]),
        (set_at(["object"], 3), ["object: must be a mapping", "got 3"]),
        (without("object", "outline"), ["`outline` is missing"]),
        (set_at(["object", "outline"], CROSSED), ["not a simple polygon"]),
        (set_at(["object", "outline"], MILLIMETRES), ["outline: reaches 50 m", "divide by 1000?"]),
        (set_at(["object", "outline"], [[0, 0], [1e-5, 0], [0, 1e-5]]), ["outline: is only 1e-05 m across"]),
        (set_at(["object", "cells", "centers", 3, 1], 1e200), ["object.cells: reaches 1e+200 m"]),
        (set_at(["object", "cells", "width"], 20.0), ["object.cells: reaches 20 m"]),
        (set_at(["noise", "position"], 1e300), ["noise.position: a standard deviation must lie"]),
        (set_at(["object", "outline"], [[0, 0], [1, 0]]), ["at least three corners"]),
        (set_at(["object", "outline", 2], [0.05, math.nan]), ["outline, row 2", "two finite numbers"]),
        (set_at(["object", "holes"], 3), ["object.holes: must be a list of rings", "got 3"]),
        (
            set_at(["object", "holes"], [[[0.0, 0.0], [0.2, 0.0], [0.0, 0.01]]]),
            ["holes[0] does not lie inside the outline; correct the outline or the hole"],
        ),
        (without("table", "center"), ["table.center is missing; it must be two numbers"]),
        (without("object", "cells", "centers"), ["cells.centers is missing; it must be a list of rows"]),
        (without("finger", "radius"), ["finger.radius is missing; it must be a number"]),
        (set_at(["object", "outline", 2], [0.05]), ["outline, row 2", "needs 2 columns, has 1"]),
        (set_at(["object", "cells", "width"], 0), ["cells.width: must be positive"]),
        (set_at(["object", "cells", "width"], "5e-3"), ["must be a number, got '5e-3'", "text; write 0.005"]),
        (set_at(["object", "cells", "width"], "-.64"), ["must be a number, got '-.64'", "text; write -0.64"]),
        (set_at(["object", "outline"], [["-.5", 0]]), ["row 0: must hold numbers, got '-.5'", "write -0.5"]),
        (set_at(["object", "cells", "centers"], []), ["there are no cells"]),
        (set_at(["object", "cells", "centers", 4, 0], math.nan), ["cell centres: point 4 is not finite"]),
        (set_at(["object", "cells", "centers"], [[1.0, 1.0]]), ["no centre lies inside the outline"]),
        (set_at(["object", "mass"], 1e30), ["object.mass: must lie between 1e-06 and 1e+06 kg, got 1e+30"]),
        (set_at(["gravity"], 1e300), ["gravity: must lie between 0.001 and 1000 m/s²"]),
        (set_at(["object", "mass"], -1.0), ["object.mass: must be positive (kg), got -1.0"]),
        (set_at(["object", "height"], 0), ["object.height: must be positive"]),
        (without("finger"), ["`finger` is missing"]),
        (set_at(["finger", "radius"], 0.0), ["finger.radius: must be positive (m), got 0.0"]),
        (set_at(["finger", "radius"], math.inf), ["finger.radius: must be a finite number"]),
        (set_at(["finger", "radius"], True), ["finger.radius: must be a number, got True"]),
        (set_at(["finger", "radius"], 4.75), ["finger.radius is 4.75 m", "divide by 1000?"]),
        (set_at(["gravity"], -9.81), ["gravity: must be positive"]),
        (set_at(["gravity"], None), ["gravity is missing; it must be a number"]),
        (set_at(["noise", "tip"], -1e-3), ["deviation must lie between 0 and 0.1, got -0.001"]),
        (set_at(["table", "shape"], "oval"), ["table.shape: must be round or rectangle, got 'oval'"]),
        (set_at(["table", "radius"], 0), ["table.radius: must be positive"]),
        (set_at(["table", "center"], [1.0]), ["table.center: must be two numbers"]),
        (set_at(["name"], 7), ["name: must be text, got 7"]),
        (set_at(["trials"], []), ["trials must be a list of one or more"]),
        (set_at(["trials"], "all"), ["trials must be a list of one or more"]),
        (set_at(["trials", 1], "trials/001.json"), ["trials, row 1: must be a mapping"]),
        (set_at(["trials", 1, "role"], "test"), ["trials, row 1: role must be fit or heldout, got 'test'"]),
        (set_at(["trials", 1, "file"], "trials/000.json"), ["row 1", "listed twice (first in row 0)"]),
        (set_at(["trials", 1, "file"], "trials/../trials/000.json"), ["row 1", "listed twice"]),
        (set_at(["trials", 1, "file"], "../other.json"), ["trials, row 1", "outside the dataset's folder"]),
        (set_at(["trials", 1, "file"], "/etc/hostname"), ["trials, row 1", "outside the dataset's folder"]),
        (set_at(["trials", 1, "file"], "no\0name"), ["trials, row 1", "not a usable file name"]),
        (set_at(["trials", 1, "file"], "x" * 5000), ["cannot be read"]),
        (set_at(["trials", 1, "file"], "trials"), ["trials: is a folder"]),
        (without("trials", 1, "file"), ["trials, row 1: `file` is missing"]),
    ],
)  # fmt: skip
def test_faults_in_the_description(example, change, words):
    change(example.document)
    with pytest.raises(DatasetError) as caught:
        read_dataset(example.write())
    for word in words:
        assert word in str(caught.value), caught.value
    named = "trials" if words[0] in ("cannot be read", "trials: is a folder") else "dataset.yaml"
    assert str(caught.value).startswith((str(example.folder / named), f"'{example.folder}"[:20]))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (set_at(["object", "cells", "centers", 3], [0.07, 0.0]), "1 of 25 centres lie outside the outline"),
        (set_at(["object", "cells", "centers", 3], [0.053, 0.0]), "1 of 25 centres lie outside the outline"),
        (set_at(["object", "cells", "centers", 3], [0.04, 0.04]), "some cells overlap"),
        (set_at(["object", "cells", "centers", 3], [0.041, 0.04]), "some cells overlap"),
        (set_at(["object", "cells", "width"], 0.002), "area is 0.01 times that of the outline"),
        (set_at(["object", "outline"], CLOSED), "last corner repeats the first"),
        (set_at(["object", "outline"], [*CLOSED[:2], *CLOSED[1:4]]), "row 2: repeats the corner before"),
        (set_at(["object", "weight"], 1.2), "object: the key 'weight' is unknown and ignored (known: cells,"),
        (set_at(["object", "hight"], 0.1), "'hight' is unknown and ignored; did you mean height? (known:"),
        (set_at(["gravitation"], 9.81), "the key 'gravitation' is unknown"),
        (set_at(["finger", "diameter"], 0.01), "finger: the key 'diameter' is unknown"),
        (set_at(["table", "size"], [1, 1]), "table: the key 'size' is unknown"),
        (set_at(["object", "height"], 50.0), "object.height is 50 m over a footprint of 0.1 m; are both"),
        (set_at(["object", "height"], 5e-5), "are both in m"),
        (set_at(["object", "mass"], 815.0), "object.mass is 815 kg on 100 cm², 8.15e+04 kg/m²; is it in kg"),
        (set_at(["object", "mass"], 0.000815), "is it in kg"),
        (set_at(["noise", "torque"], 0.1), "noise: the key 'torque' is unknown"),
        (set_at(["trials", 0, "weight"], 2), "trials, row 0: the key 'weight' is unknown"),
        (set_at(["gravity"], 981.0), "expected about 9.81"),
    ],
)  # fmt: skip
def test_suspicions_about_the_description(example, change, word):
    change(example.document)
    warnings = read_dataset(example.write()).warnings
    assert len(warnings) == 1 and word in warnings[0], warnings


def test_an_outline_seen_again_may_pass_a_little_inside_a_centre(example):
    corners = [[-0.05, -0.05], [0.0395, -0.05], [0.0395, 0.05], [-0.05, 0.05]]
    example.document["object"]["outline"] = corners
    assert read_dataset(example.write()).warnings == ()


def test_a_clockwise_outline_is_turned(example):
    example.document["object"]["outline"].reverse()
    dataset = read_dataset(example.write())
    assert dataset.warnings == () and LinearRing(dataset.grid.exterior).is_ccw


BILLION = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [*{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}]\n"
    for a, b in zip("abcdefghij", "bcdefghijk", strict=True)
)
MERGED = "a: &a {x: 1, y: 2}\n" + "".join(
    f"{b}: &{b}\n  <<: [*{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}]\n"
    for a, b in zip("abcdefghij", "bcdefghijk", strict=True)
)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("", "must be a mapping"),
        ("- 1\n- 2\n", "must be a mapping"),
        ("{a: [1, 2", "not valid YAML"),
        ("a:\n\tb: 1\n", "indent with spaces, not with a tab"),
        ("a: 1\na: 2\n", "'a' appears twice, again in line 2"),
        ("? [1, 2]\n: 3\n", "not valid YAML"),
        ("1: 2\n", "keys must be text"),
        ("a: !!python/object/apply:os.system [echo hacked]\n", "not valid YAML"),
        ("a: !!timestamp 2001-99-99\n", "not valid YAML"),
        ("a: &a [*a]\nformat: push-dataset/1\nobject: *a\n", "object: must be a mapping"),
        (
            BILLION + "format: push-dataset/1\nobject: {outline: *k}\nfinger: *k\n",
            "finger: must be a mapping",
        ),
        (BILLION + "format: push-dataset/1\nobject: {outline: *k}\nfinger: {radius: 0.1}\n", "9"),
        (MERGED, "merge keys"),
        ("[" * 5_000, "YAML"),
        ("a: " + "9" * 10_000, "not valid YAML"),
        ("\x00", "not valid YAML"),
        (b"\xff\xfe\xff", "not valid YAML"),
    ],
)
def test_a_description_that_is_no_plain_yaml(tmp_path, content, word):
    (tmp_path / "dataset.yaml").write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(DatasetError, match=word) as caught:
        read_dataset(tmp_path)
    assert "dataset.yaml" in str(caught.value) and len(str(caught.value)) < 600


def test_a_link_out_of_the_folder_is_not_followed(example, tmp_path):
    folder = example.write()
    (tmp_path / "secret.json").write_text((folder / "trials/000.json").read_text())
    (folder / "trials/001.json").unlink()
    os.symlink(tmp_path / "secret.json", folder / "trials/001.json")
    with pytest.raises(DatasetError, match="outside the dataset's folder"):
        read_dataset(folder)


def test_a_file_too_large_to_be_a_description(tmp_path):
    with open(tmp_path / "dataset.yaml", "wb") as file:
        file.truncate(2**33)  # a hole on disk
    with pytest.raises(DatasetError, match="8192 MiB, more than the 4 MiB"):
        read_dataset(tmp_path)


@pytest.mark.parametrize("path", ["missing", "missing/dataset.yaml", "x" * 5000])
def test_nothing_there(tmp_path, path):
    with pytest.raises(DatasetError, match=r"no such file|cannot be read"):
        read_dataset(tmp_path / path)


def test_an_empty_folder_or_a_file_of_another_kind(tmp_path):
    with pytest.raises(DatasetError, match="contains no measurements; expected a push dataset"):
        read_dataset(tmp_path)
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(DatasetError, match="this kind of file cannot be read; expected a push dataset"):
        read_dataset(tmp_path / "notes.txt")


def test_the_folder_of_a_run_names_the_dataset_in_it(example, tmp_path):
    """Beside the pushes lie files such as run.json, which could be a recording of the MIT dataset."""
    run = tmp_path / "run"
    shutil.copytree(example.write(), run / "pushes")
    (run / "run.json").write_text("{}")
    with pytest.raises(DatasetError, match=f"holds some; give one: {run / 'pushes'}$"):
        read_dataset(run)


def test_a_push_dataset_needs_no_object_name(example):
    with pytest.raises(DatasetError, match="describes its own object"):
        read_dataset(example.write(), object_name="hex")


def test_no_noise_counts_as_the_least_that_can_be_computed_with(example):
    example.document["noise"] = {"position": 0, "angle": 0.0, "tip": 0, "force": 1e-300, "outline": 0}
    noise = read_dataset(example.write()).noise
    assert (noise.position, noise.angle, noise.tip, noise.force, noise.outline) == (
        1e-6,
        1e-5,
        1e-6,
        1e-4,
        1e-6,
    )


@pytest.mark.parametrize("brackets", ["[" * 100_000, "- " * 50_000])
def test_a_deeply_nested_description_is_refused(tmp_path, brackets):
    (tmp_path / "dataset.yaml").write_text(brackets)
    with pytest.raises(DatasetError, match="nested too deeply"):
        read_dataset(tmp_path)
