"""What a diagnosis of several datasets says, to people and to programs."""

import dataclasses
import json

import numpy as np
import pytest
from schemas import assert_as_described

import slipmap as slipmap_package
from slipmap.diagrams.application.reports.diagnosis_words import show_together, where_it_falls
from slipmap.models.inference.diagnosis.locked import LockedErrors
from slipmap.models.inference.diagnosis.results import ParameterEstimate
from slipmap.models.inference.diagnosis.several import DatasetResult, JointCandidate, JointDiagnosis
from slipmap.models.measurements import write_dataset
from slipmap.models.objects import cells_from_polygon

SQUARE = cells_from_polygon([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]], count=9)


def made(*falls, verdict="effect"):
    """A diagnosis that names a lag, with the falls of the datasets' costs; None where nothing is named."""
    named = verdict == "effect"
    lag = (ParameterEstimate("sensor_latency", "latency", "s", 0.025, 0.02, 0.03),) if named else ()
    errors = LockedErrors(np.array([1e-3, 2e-3]), np.array([4e-3, 6e-3]), np.array([3.0, 5.0]))
    datasets = tuple(
        DatasetResult(
            f"set {k}", ("a", "b"), ("c", "d"), k == 0, errors, errors if named else None, fall, lag
        )
        for k, fall in enumerate(falls)
    )
    candidates = (
        JointCandidate("sensor_latency", 20.0, 25.0, 22.0, named, None),
        JointCandidate("skate", 1.0, None, None, False, None),
    )
    return JointDiagnosis(
        verdict, "A sentence.", ("sensor_latency",) if named else (), named, lag, candidates, datasets,
        sum(falls) if named else None, 1.0, 0,
    )  # fmt: skip


def test_where_locked_pushes_are_not_better_predicted_is_said():
    assert "of every dataset are predicted better" in where_it_falls(made(4.0, 5.0))
    said = where_it_falls(made(4.0, -1.0, 5.0))
    assert "of 2 of 3 datasets are predicted better, not those of set 1" in said and "8.0 nats" in said
    assert where_it_falls(made(None, None, verdict="adequate")) == ""


def test_what_is_printed_names_sizes_and_the_next_command(capsys):
    show_together(made(4.0, 5.0), SQUARE)
    printed = " ".join(capsys.readouterr().out.split())
    for words in (
        "25 ms late (20 to 30)",
        "slipmap fit DATASET --effect sensor_latency",
        "set 0 (whole)",
        "5.0",
    ):
        assert words in printed


@pytest.mark.parametrize("diagnosis", [made(4.0, -1.0), made(None, None, verdict="undecided")])
def test_json_is_as_described(diagnosis):
    document = json.loads(json.dumps(diagnosis.to_json()))
    assert_as_described("diagnose", document)
    assert_as_described("diagnose-together", document)


def test_options_of_one_dataset_are_refused_for_several_and_the_other_way_round(slipmap, tmp_path):
    said = slipmap("diagnose", tmp_path / "a", tmp_path / "b", "--quick")
    assert said.code == 2 and "--quick is for one dataset" in said.err
    said = slipmap("diagnose", tmp_path / "a", "--apart", "table")
    assert said.code == 2 and "give two or more" in said.err


def test_a_copy_of_a_dataset_under_another_name_is_refused(slipmap, tmp_path):
    dataset, _ = slipmap_package.simulated_hammer(seed=1, fit=2, heldout=1)
    for name in ("first", "second"):
        write_dataset(dataclasses.replace(dataset, name=name), tmp_path / name)
    said = slipmap("diagnose", tmp_path / "first", tmp_path / "second")
    assert said.code == 2 and "first and second contain the same push" in " ".join(said.err.split())
