"""Files that a command cannot read, or may not write, are named before any work."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace

import numpy as np
import pytest
from refusals import assert_refused, files_in

from slipmap.models.physics.cell_grid import CellGrid


def test_a_missing_dataset_is_named(slipmap, tmp_path):
    said = slipmap("identify", tmp_path / "nowhere", "-o", tmp_path / "belief.npz")
    assert_refused(said, "nowhere", "there is no such file or folder")
    assert files_in(tmp_path) == []


def test_a_link_that_leads_to_itself_is_no_internal_failure(slipmap, tmp_path):
    (tmp_path / "loop.csv").symlink_to("loop.csv")
    said = slipmap("identify", tmp_path / "loop.csv", "--object", "rect1", "-o", tmp_path / "belief.npz")
    assert_refused(said, "loop.csv", "name the file")


def test_a_broken_trial_is_named_and_nothing_is_written(slipmap, tilted_folder, tmp_path):
    dataset = tmp_path / "block"
    shutil.copytree(tilted_folder, dataset)
    broken = dataset / "trials" / "001.json"
    broken.write_text(broken.read_text()[:-40])
    before = files_in(tmp_path)
    said = slipmap("identify", dataset, "-o", tmp_path / "belief.npz", "--json", tmp_path / "result.json")
    assert_refused(said, broken, "not valid JSON")
    assert files_in(tmp_path) == before


def test_more_fit_pushes_than_there_are_are_refused(slipmap, tilted_folder, tmp_path):
    said = slipmap("identify", tilted_folder, "-o", tmp_path / "b.npz", "--fit-pushes", 9)
    assert_refused(said, "--fit-pushes 9", "8 pushes")


def test_outputs_are_checked_before_any_work(slipmap, tilted_folder, tmp_path):
    """Most of these datasets do not exist; it is the output that is complained of."""
    missing = tmp_path / "missing"
    for arguments in (
        ["-o", missing / "belief.npz"],
        ["-o", tmp_path / "belief.npz", "--json", missing / "result.json"],
    ):
        assert_refused(slipmap("identify", tmp_path / "data", *arguments), f"{missing}", "does not exist")
    assert_refused(slipmap("identify", tmp_path / "data", "-o", tmp_path), tmp_path, "is a folder")
    said = slipmap("predict", "data", "--belief", "b.npz", "-o", tmp_path / "picture.txt")
    assert_refused(said, "picture.txt", ".png")
    (tmp_path / "file").write_text("in the way")
    said = slipmap(
        "identify",
        tilted_folder,
        "-o",
        tmp_path / "b.npz",
        "--pictures",
        tmp_path / "file" / "sub",
    )
    assert_refused(said, tmp_path / "file")
    assert_refused(slipmap("demo", "-o", tmp_path / "file"), tmp_path / "file")
    assert files_in(tmp_path) == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere; run as another user")
def test_a_folder_without_write_permission_is_refused(slipmap, tmp_path):
    tmp_path.chmod(0o500)
    assert_refused(slipmap("identify", tmp_path / "data", "-o", tmp_path / "belief.npz"), tmp_path)


def test_beliefs_that_are_none_are_refused(slipmap, tilted_folder, belief, tmp_path):
    bad, picture = tmp_path / "bad.npz", tmp_path / "p.png"
    arguments = ("predict", tilted_folder, "--belief", bad, "-o", picture)
    assert_refused(slipmap(*arguments), "bad.npz")
    belief.save(tmp_path / "whole.npz")
    for content in (b"", b"not a belief", (tmp_path / "whole.npz").read_bytes()[:-500]):
        bad.write_bytes(content)
        assert_refused(slipmap(*arguments), "bad.npz")
    np.savez(bad, a=np.zeros(3))
    assert_refused(slipmap(*arguments), "bad.npz")
    assert not picture.exists()


def test_a_belief_about_another_object_is_refused(slipmap, tilted_folder, belief, tmp_path):
    larger = CellGrid(2.0 * belief.grid.centers, 2.0 * belief.grid.width, 2.0 * belief.grid.exterior)
    replace(belief, grid=larger).save(tmp_path / "larger.npz")
    said = slipmap("predict", tilted_folder, "--belief", tmp_path / "larger.npz", "-o", tmp_path / "p.png")
    assert_refused(said, "belief", "tilted")


def test_demo_does_not_overwrite_what_it_did_not_make(slipmap, tmp_path):
    (tmp_path / "pushes").mkdir()
    (tmp_path / "pushes" / "thesis.txt").write_text("years of work")
    assert_refused(slipmap("demo", "-o", tmp_path), tmp_path / "pushes", "not a push dataset")
    assert files_in(tmp_path) == ["pushes/thesis.txt"]


@pytest.mark.parametrize("content", [None, b"", b"not a log"])
def test_a_log_that_is_none_leaves_no_folder(slipmap, tmp_path, content):
    log = tmp_path / "pushes.lcmlog"
    if content is not None:
        log.write_bytes(content)
    said = slipmap("replay", log, "-o", tmp_path / "results" / "replay")
    assert said.code == 2 and str(log) in said.err
    assert not (tmp_path / "results").exists()


def test_a_folder_that_was_there_stays_though_it_is_empty(slipmap, tmp_path):
    (tmp_path / "replay").mkdir()
    assert slipmap("replay", tmp_path / "no.lcmlog", "-o", tmp_path / "replay" / "new").code == 2
    assert (tmp_path / "replay").is_dir() and not (tmp_path / "replay" / "new").exists()


def test_measurements_without_an_object_are_told_of_the_option(slipmap, tmp_path):
    (tmp_path / "push.csv").write_text("t,object_x\n")
    said = slipmap("identify", tmp_path / "push.csv", "-o", tmp_path / "belief.npz")
    assert_refused(said, "push.csv", "--object", "rect1")


def test_a_place_in_yaml_is_told_without_the_parsers_own_names(slipmap, tilted_folder, tmp_path):
    dataset = tmp_path / "block"
    shutil.copytree(tilted_folder, dataset)
    for file, arguments in (
        (dataset / "dataset.yaml", ("identify", dataset, "-o", tmp_path / "belief.npz")),
        (tmp_path / "cell.yaml", ("explore", "--scenario", tmp_path / "cell.yaml", "-o", tmp_path / "o")),
    ):
        file.write_text("object: [1\nb: }")
        said = slipmap(*arguments)
        assert_refused(said, file.name, "line 2, column 2")
        assert "string>" not in said.err
