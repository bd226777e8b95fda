"""`slipmap explore-study` counts what its runs left, and does not run again what is there."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest
from schemas import assert_as_described
from test_command_line import ENVIRONMENT, hear_ctrl_c

from slipmap.diagrams.application.commands.studies import _judged
from slipmap.diagrams.loops import exploration_run
from slipmap.diagrams.loops.exploration_run import ExplorationStopped


def a_row(**changes):
    row = {"error": 2e-3, "uniform": 8e-3, "center_of_mass_off": 0.01, "center_of_mass_inside": True,
           "simulated": 80.0, "seconds": 60.0, "pushes": 5, "checks": 10}  # fmt: skip
    return {**row, **changes}


def test_runs_that_are_there_are_counted(slipmap, tmp_path):
    rows = [
        a_row(),
        a_row(error=4e-3, center_of_mass_inside=False),
        {"failed": "the object was lost", "pushes": 5, "checks": 10},
    ]
    for number, row in enumerate(rows):
        (tmp_path / f"box-{number}.json").write_text(json.dumps(row))
    words = ["explore-study", "--object", "box", "--runs", 3, "-o", tmp_path]
    said = slipmap(*words, "--json", tmp_path / "study.json")
    assert said.code == 0
    line = next(line for line in said.out.splitlines() if line.startswith("box"))
    assert line.split() == ["box", "2", "1", "3.0", "8.0", "10", "1"]
    assert "in 1 of 2 runs" in said.out
    assert json.loads((tmp_path / "study.json").read_text()) == {"box": rows}


def test_runs_of_another_study_are_refused(slipmap, tmp_path):
    file = tmp_path / "box-0.json"
    file.write_text(json.dumps(a_row(checks=3)))
    said = slipmap("explore-study", "--object", "box", "--runs", 1, "-o", tmp_path)
    assert said.code == 2 and "5 pushes and 3 checks" in said.err and "5 and 10" in " ".join(said.err.split())
    file.write_text("{}")
    said = slipmap("explore-study", "--object", "box", "--runs", 1, "-o", tmp_path)
    assert said.code == 2 and "is not a run of a study" in " ".join(said.err.split())


def test_without_a_good_run_there_are_no_means(slipmap, tmp_path):
    for name, row in (("box", {"failed": "lost", "pushes": 5, "checks": 10}), ("book", a_row())):
        (tmp_path / f"{name}-0.json").write_text(json.dumps(row))
    said = slipmap("explore-study", "--object", "box", "--object", "book", "--runs", 1, "-o", tmp_path)
    line = next(line for line in said.out.splitlines() if line.startswith("box"))
    assert line.split() == ["box", "0", "1", "–", "–", "–", "0"]
    assert "nan" not in said.out


@pytest.mark.parametrize("error", [ExplorationStopped("stopped at push 2 of 15"), KeyboardInterrupt()])
def test_ctrl_c_ends_the_study_and_is_no_result(slipmap, tmp_path, monkeypatch, error):
    def stopped(*arguments, learn_when_stopped, **options):
        assert not learn_when_stopped
        raise error

    (tmp_path / "box-0.json").write_text(json.dumps(a_row()))
    monkeypatch.setattr(exploration_run, "explore", stopped)
    words = ["explore-study", "--object", "box", "--runs", 3, "-o", tmp_path]
    said = slipmap(*words, "--json", tmp_path / "study.json")
    assert (said.code, said.out) == (130, "")
    told = " ".join(said.err.split())
    assert "box, seed 1" in told and "run the same command again to continue the study" in told
    assert [path.name for path in tmp_path.iterdir()] == ["box-0.json"]


@pytest.mark.usefixtures("renderer")
def test_a_real_ctrl_c_leaves_nothing_of_the_run(tmp_path):
    command = [sys.executable, "-m", "slipmap", "explore-study", "--object", "book"]
    command += ["--runs", "2", "-o", str(tmp_path / "study")]
    with subprocess.Popen(
        command, env=ENVIRONMENT, text=True, stderr=subprocess.PIPE, preexec_fn=hear_ctrl_c
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("exploring"):
                process.send_signal(signal.SIGINT)
                break
        else:
            pytest.fail("it ended without a word of exploring")
        said = process.stderr.read()
        assert process.wait(timeout=60) == 130, said
    assert "Traceback" not in said and "to continue the study" in said
    assert not (tmp_path / "study").exists()


class _Run:
    """An exploration whose belief is known."""

    def __init__(self, centers, true):
        belief = type(
            "B", (), {"centers_of_mass": centers, "probability": np.full(len(centers), 1 / len(centers))}
        )
        self.identification = type(
            "I", (), {"belief": belief, "errors": lambda self, role, of="final_add": np.array([1e-3, 3e-3])}
        )()
        self.true_center_of_mass = np.asarray(true)
        self.simulated = self.seconds = 1.0


@pytest.mark.parametrize("away, inside", [(2.0, True), (2.5, False)])
def test_a_run_is_judged_by_where_the_centre_of_mass_is(away, inside):
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    centers = 0.01 * np.sqrt(2) * np.column_stack([np.cos(angle), np.sin(angle)])  # deviation 0.01 each way
    judged = _judged(_Run(centers, [0.01 * away, 0.0]))
    assert_as_described("explore-study", {"box": [judged | {"pushes": 5, "checks": 10}]})
    assert judged["center_of_mass_inside"] is inside
    assert judged["center_of_mass_off"] == pytest.approx(0.01 * away)
    assert judged["error"] == pytest.approx(2e-3)
