"""The whole path on the robot: a tilted table nobody told of; explore, diagnose, fit, and the error falls."""

import json

import pytest

from slipmap.diagrams.application.command_line import run

SCENARIO = """
object: {name: box}
camera: {rate: 5.0}
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
    code = run(
        ["explore", "--scenario", str(folder / "cell.yaml"), "--pushes", "5", "--checks", "1", "--seed", "3",
         "--strategy", "random", "--out", str(folder)]
    )  # fmt: skip
    assert code == 0
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
