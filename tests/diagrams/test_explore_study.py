"""`slipmap explore-study` counts what its runs left, and does not run again what is there."""

import json

import numpy as np
import pytest
from schemas import assert_as_described

from diagrams.commands.explore_study import _judged


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
    assert said.code == 2 and "is no run of a study" in " ".join(said.err.split())


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


@pytest.mark.parametrize("away, inside", [(2.0, True), (2.3, False)])
def test_the_region_holds_90_percent_of_a_normal_distribution(away, inside):
    """In a plane, 90 % of a normal distribution lie within 2.146 standard deviations."""
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    centers = 0.01 * np.sqrt(2) * np.column_stack([np.cos(angle), np.sin(angle)])  # deviation 0.01 each way
    judged = _judged(_Run(centers, [0.01 * away, 0.0]))
    assert_as_described("explore-study", {"box": [judged | {"pushes": 5, "checks": 10}]})
    assert judged["center_of_mass_inside"] is inside
    assert judged["center_of_mass_off"] == pytest.approx(0.01 * away)
    assert judged["error"] == pytest.approx(2e-3)
