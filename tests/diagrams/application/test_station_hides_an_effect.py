"""The whole path on the robot: a tilted table nobody told of; explore, diagnose, fit, and the error falls.

`slipmap explore --after` goes on from there: another run begins with those pushes, and with the effect.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from slipmap.diagrams.application.command_line import run
from slipmap.diagrams.loops.exploration_loop import LoopOptions
from slipmap.diagrams.loops.exploration_run import explore
from slipmap.diagrams.loops.run_folder import ExplorationFolder
from slipmap.diagrams.station.scenario import read_scenario
from slipmap.models.inference.belief import Belief
from slipmap.models.measurements import read_dataset

# Small pictures and few cells, for speed: this tilt shows in any of them.
SCENARIO = """
object: {name: box}
camera: {rate: 4.0, width: 480, height_pixels: 360}
simulation: {time_step: 0.005}
pokes: {taps: 0.0}
hidden:
  table_tilt: {down_x: 0.12, down_y: -0.08}
"""


@pytest.fixture(scope="module")
def explored(renderer, tmp_path_factory):
    """Pushes that the robot recorded on a table that is not level."""
    folder = tmp_path_factory.mktemp("tilted")
    (folder / "cell.yaml").write_text(SCENARIO)
    cell = read_scenario(folder / "cell.yaml")
    options = LoopOptions(pushes=4, checks=1, strategy="random", cells=24, hypotheses=6, seed=3)
    explore(cell, options, record=ExplorationFolder(folder, cell, options))
    return folder


def test_the_hidden_tilt_is_found_and_the_error_falls(explored):
    said = explored / "diagnosis.json"
    arguments = ["diagnose", str(explored / "pushes"), "--quick"]
    assert run([*arguments, "--json", str(said)]) == 0
    diagnosis = json.loads(said.read_text())
    assert diagnosis["verdict"] in ("effect", "ambiguous")
    assert "table_tilt" in diagnosis["effects"]
    assert diagnosis["heldout_final_error_after"] < 0.5 * diagnosis["heldout_final_error_before"]


def test_adding_the_tilt_makes_predictions_better(explored):
    compared = explored / "comparison.json"
    arguments = ["compare", str(explored / "pushes"), "--effect", "table_tilt"]
    html = str(explored / "comparison.html")
    assert run([*arguments, "-o", html, "--json", str(compared)]) == 0
    both = json.loads(compared.read_text())
    errors = {
        label: [push["model"]["final_add"] for push in both[label]["pushes"] if push["role"] == "heldout"]
        for label in ("before", "after")
    }
    assert len(errors["after"]) == 1
    assert sum(errors["after"]) < 0.5 * sum(errors["before"])


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_its_pushes_are_all_learned_from_with_the_effect_and_the_object_lies_where_they_left_it(
    explored, slipmap, tmp_path
):
    kept, out = contents(explored), tmp_path / "further"
    words = ["--after", explored, "--effect", "table_tilt", "--pushes", 0, "--checks", 1, "--seed", 5]
    said = slipmap("explore", *words, "--output", out)
    assert said.code == 0, said.err
    old, new = read_dataset(explored / "pushes").trials, read_dataset(out / "pushes").trials
    assert [trial.role for trial in old] == ["fit"] * 4 + ["heldout"]
    assert [trial.role for trial in new] == ["fit"] * 5 + ["heldout"]
    for trial, same in zip(new, old, strict=False):
        assert np.array_equal(trial.object_pose.values, same.object_pose.values)
    assert new[-1].object_pose.values[0] == pytest.approx(old[-1].object_pose.values[-1], abs=2e-3)
    belief = Belief.load(out / "belief.npz")
    assert belief.settings["fit_trials"] == [trial.name for trial in old]
    assert [effect.name for effect in belief.effects] == ["table_tilt", "load_transfer"]
    assert contents(explored) == kept


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--object", "book"], "leave out --object"),
        (["--pushes", 0, "--checks", 0], "slipmap fit"),
        (["--hardware"], "in simulation; leave out --hardware"),
        (["--resume", "BEFORE"], "leave out --after"),
        (["--output", "BEFORE"], "name another folder with --output"),
    ],
)
def test_what_makes_no_sense_beside_it_is_refused(explored, slipmap, tmp_path, words, named):
    kept = contents(explored)
    out = [] if {"--resume", "--output"} & {*map(str, words)} else ["--output", tmp_path / "out"]
    words = [explored if word == "BEFORE" else word for word in words]
    said = slipmap("explore", *out, "--after", explored, *words)
    assert said.code == 2 and named in said.err
    assert contents(explored) == kept and not list(tmp_path.iterdir())


def test_there_must_be_pushes_to_begin_with(slipmap, tmp_path):
    for words, named in ((["--after", tmp_path], "holds no run"), (["--pushes", 0], "nothing to learn from")):
        said = slipmap("explore", "--output", tmp_path / "out", *words)
        assert said.code == 2 and named in said.err
    assert not list(tmp_path.iterdir())
