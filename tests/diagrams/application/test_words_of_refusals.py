"""What is said of a path that is none, a file that is a folder or a device, and an address that cannot be."""

from __future__ import annotations

import pytest
from refusals import assert_refused, files_in


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["identify", "", "-o", "b.npz"], "DATASET has an empty name"),
        (["identify", "data", "-o", ""], "-o/--output has an empty name"),
        (["identify", "data", "-o", "b.npz", "--pictures="], "--pictures has an empty name"),
        (["view", ""], "BELIEF has an empty name"),
        (["explore", "--scenario", ""], "--scenario has an empty name"),
        (["explore", "--output", ""], "--output has an empty name"),
        (["effects", "--effect-file", "a.py", "--effect-file", ""], "--effect-file has an empty name"),
        (["effects", "--json", ""], "--json has an empty name"),
        (["object", "", "-o", "a.yaml", "--finger", "0.01"], "FILE has an empty name"),
        (["replay", ""], "LOG has an empty name"),
    ],
)
def test_an_empty_path_is_not_the_working_folder(slipmap, tmp_path, monkeypatch, arguments, named):
    monkeypatch.chdir(tmp_path)
    assert_refused(slipmap(*arguments), named, f"See `slipmap {arguments[0]} --help`.")
    assert files_in(tmp_path) == []


@pytest.mark.parametrize(
    "arguments",
    [["effects"], ["check", "x"], ["identify", "x", "-o", "b.npz"], ["explore", "-o", "out"], ["doctor"]],
)
def test_results_are_not_written_to_standard_output(slipmap, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    assert_refused(slipmap(*arguments, "--json", "-"), "cannot write to standard output", "name a file for -")
    assert files_in(tmp_path) == []


@pytest.mark.parametrize("name", ["thing", "thing.stl", "thing.png"])
def test_a_folder_is_no_object(slipmap, tmp_path, name):
    (tmp_path / name).mkdir()
    more = ["--metres-per-pixel", 0.001] if name.endswith("png") else []
    said = slipmap("object", tmp_path / name, "-o", tmp_path / "a.yaml", "--finger", 0.01, *more)
    assert_refused(said, f"{tmp_path / name}: is a folder")


@pytest.mark.parametrize(
    "arguments",
    [
        ["effects", "--effect-file", "/dev/zero"],
        ["explore", "--scenario", "/dev/zero"],
        ["object", "/dev/zero", "-o", "a.yaml", "--finger", "0.01"],
        ["identify", "x.csv", "--object", "dev.yaml", "-o", "a.npz"],
        ["explore", "--scenario", "endless.yaml"],
    ],
)
def test_a_device_is_told_as_such(slipmap, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.csv").write_text("t,object_x\n")
    for name in ("dev.yaml", "endless.yaml"):
        (tmp_path / name).symlink_to("/dev/zero")
    assert_refused(slipmap(*arguments), "is a device or a pipe; give a file")


def test_a_scenario_file_has_a_bound(slipmap, tmp_path):
    (tmp_path / "cell.yaml").write_text("# " + 2**21 * "x")
    said = slipmap("explore", "--scenario", tmp_path / "cell.yaml", "--output", tmp_path / "out")
    assert_refused(said, "cell.yaml: 2048 KiB, more than the 64 KiB it may have")


def test_an_effect_file_is_named_once(slipmap, tmp_path):
    for text, line in (("import nothing_of_the_kind", 1), ("a = 1\nraise ValueError('oh')", 2)):
        (tmp_path / "bad.py").write_text(text)
        said = slipmap("effects", "--effect-file", tmp_path / "bad.py")
        assert_refused(said, f"effect file {tmp_path / 'bad.py'}, line {line}: ")
        assert said.err.count("bad.py") == 1


def test_a_twin_comes_up_at_no_address_that_cannot_be(slipmap):
    said = slipmap("station", "--lcm", "nonsense")
    assert_refused(said, "the address must look like", "nonsense")
    assert "starting the cell" not in said.err
