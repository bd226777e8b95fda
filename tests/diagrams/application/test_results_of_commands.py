"""What commands print and leave behind when all goes well."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from refusals import files_in

from slipmap.models.inference.belief import Belief
from slipmap.models.inference.summaries import middle_poses
from slipmap.models.measurements import read_dataset, write_dataset
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners.exploration import candidate_pushes


def test_demo_leaves_a_dataset_a_belief_pictures_and_json(demo_folder):
    assert files_in(demo_folder) == [
        "demo.json",
        "demo/belief.maps.png",
        "demo/belief.npz",
        "demo/belief.pushes.png",
        "demo/pushes/dataset.yaml",
        *[f"demo/pushes/trials/{k:03d}.json" for k in range(4)],
    ]
    dataset = read_dataset(demo_folder / "demo" / "pushes")
    assert (len(dataset.fit_trials), len(dataset.heldout_trials)) == (3, 1)
    learned = Belief.load(demo_folder / "demo" / "belief.npz")
    assert (learned.fingerprint, len(learned)) == (dataset.fingerprint, 20)


def test_demo_pictures_show_something(demo_folder):
    for name in ("maps", "pushes"):
        picture = cv2.imread(str(demo_folder / "demo" / f"belief.{name}.png"))
        assert min(picture.shape[:2]) > 500
        ink = (picture.min(axis=2) < 200).mean()
        assert 0.01 < ink < 0.6
        colours = np.ptp(picture.astype(int), axis=2)
        assert (colours > 60).mean() > 0.001


def test_json_of_the_demo(demo_folder):
    text = (demo_folder / "demo.json").read_text()
    result = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert text == json.dumps(result, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
    assert {
        "fit_error_mean",
        "heldout_error_mean",
        "trials",
        "hypotheses",
        "identifiable",
        "seed",
        "truth",
    } <= set(result)
    assert [trial["role"] for trial in result["trials"]] == ["fit"] * 3 + ["heldout"]
    assert sum(hypothesis["probability"] for hypothesis in result["hypotheses"]) == pytest.approx(1)
    assert result["fit_error_mean"] < 0.1 * np.mean([trial["no_motion_add"] for trial in result["trials"]])


def test_demo_compares_with_the_truth_of_the_hammer(demo_folder):
    truth = {entry["name"]: entry for entry in json.loads((demo_folder / "demo.json").read_text())["truth"]}
    steel, wood = 7850 * 0.1 * 0.0375 * 0.025, 700 * 0.025 * 0.225 * 0.02
    assert truth["total mass"]["truth"] == pytest.approx(steel + wood)
    assert truth["total friction"]["truth"] == pytest.approx((0.2 * steel + 0.4 * wood) * 9.81)
    # The head's middle lies at 131.25 - 18.75 mm, the handle's at -131.25 + 112.5 mm.
    middle = (steel * 0.1125 + wood * -0.01875) / (steel + wood)
    assert truth["centre of mass, y"]["truth"] == pytest.approx(middle)
    middle = (0.2 * steel * 0.1125 + 0.4 * wood * -0.01875) / (0.2 * steel + 0.4 * wood)
    assert truth["centre of friction, y"]["truth"] == pytest.approx(middle)
    assert truth["centre of friction, x"]["truth"] == pytest.approx(0, abs=1e-9)
    assert set(truth) >= {"centre of mass, x", "finger friction"}
    for entry in truth.values():
        assert entry["inside"] is (entry["low"] <= entry["truth"] <= entry["high"])


def test_identify_then_predict(slipmap, demo_folder, tmp_path):
    hammer, pictures = demo_folder / "demo" / "pushes", tmp_path / "pictures"
    said = slipmap(
        "identify", hammer, "-o", tmp_path / "one.npz", "--fit-pushes", 1, "--hypotheses", 3,
        "--pictures", pictures, "--json", tmp_path / "one.json",
    )  # fmt: skip
    assert said.code == 0
    assert files_in(tmp_path) == ["one.json", "one.npz", "pictures/one.maps.png", "pictures/one.pushes.png"]
    assert max(map(len, said.out.splitlines())) <= 80
    assert "object does not move" in said.out and "90 % interval" in said.out
    assert str(tmp_path / "one.npz") in said.err
    result = json.loads((tmp_path / "one.json").read_text())
    assert len(result["trials"]) == 2 and len(result["hypotheses"]) == 3

    said = slipmap(
        "predict",
        hammer,
        "--belief",
        tmp_path / "one.npz",
        "-o",
        tmp_path / "p.svg",
        "--json",
        tmp_path / "p.json",
    )
    assert said.code == 0
    assert "<svg" in (tmp_path / "p.svg").read_text()[:1000]
    prediction = json.loads((tmp_path / "p.json").read_text())
    assert [trial["trial"] for trial in prediction["trials"]] == [f"trials/{k:03d}.json" for k in range(4)]
    by_name = {trial["trial"]: trial for trial in result["trials"]}
    belief = Belief.load(tmp_path / "one.npz")
    for trial in prediction["trials"]:
        assert np.shape(trial["predicted_end_hypotheses"]) == (3, 3)
        ends = np.array(trial["predicted_end_hypotheses"])
        middle = middle_poses(ends, np.array(prediction["probability"]), belief.grid)
        np.testing.assert_allclose(middle, trial["predicted_end"], atol=1e-5)
        if trial["trial"] in by_name:
            assert trial["final_add"] == pytest.approx(by_name[trial["trial"]]["final_add"])


def test_identify_with_the_plain_law_alone(slipmap, demo_folder, tmp_path):
    hammer, laws = demo_folder / "demo" / "pushes", []
    for more in ([], ["--plain"]):
        said = slipmap(
            "identify", hammer, "-o", tmp_path / "b.npz", "--fit-pushes", 1, "--hypotheses", 4,
            "--json", tmp_path / "b.json", *more,
        )  # fmt: skip
        assert said.code == 0
        laws.append(json.loads((tmp_path / "b.json").read_text())["friction_laws"])
    assert len(laws[0]) > 1 and laws[1] == {"plain": 1.0}


def test_calibrate_prints_draws_and_writes_coverage(slipmap, tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    ranks = {"centre of mass, x": rng.uniform(size=25), "total friction": np.full(25, 0.99)}

    def calibrate(*, objects, seed, progress):
        progress("objects", objects, objects)
        coverage = {"centre of mass, x": 0.88, "total friction": 0.0}
        by_kind = {"even": coverage}
        return SimpleNamespace(
            objects=objects, seed=seed, seconds=1.0, coverage=coverage, ranks=ranks, by_kind=by_kind
        )

    monkeypatch.setattr("slipmap.diagrams.application.studies.calibration.calibrate", calibrate)
    picture, result = tmp_path / "curves.png", tmp_path / "c.json"
    said = slipmap("calibrate", "--objects", 25, "--seed", 3, "-o", picture, "--json", result)
    assert said.code == 0
    rows = [line.split() for line in said.out.splitlines()]
    assert ["total", "friction", "0", "25", "0%", "0%", "to", "14%", "too", "narrow"] in rows
    document = json.loads(result.read_text())
    assert (document["objects"], document["seed"], document["coverage"][0]["inside"]) == (25, 3, 22)
    assert document["by_kind"] == {"even": {"centre of mass, x": 0.88, "total friction": 0.0}}
    assert ["even", "88%", "0%"] in rows
    np.testing.assert_allclose(document["ranks"]["centre of mass, x"], ranks["centre of mass, x"])
    assert cv2.imread(str(picture)).std() > 5


def test_identify_says_where_cells_are_wider_than_the_base(slipmap, tmp_path):
    """Pushes of a block that rests on a disc of 10 mm radius, learned with cells of 10 mm and of 5 mm."""
    outline = [[-0.05, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.05, 0.03]]
    fine, coarse = (cells_from_polygon(outline, width=width) for width in (0.005, 0.01))
    rests = np.hypot(*(fine.centers - [0.012, -0.005]).T) < 0.01
    maps = Maps(np.full((1, len(fine)), 1.0 / len(fine)), np.where(rests, 3.0, 1e-3)[None], np.array([0.3]))
    rng = np.random.default_rng(0)
    pushes = [candidate.push([0.0, 0.0, 0.0]) for candidate in candidate_pushes(fine, 0.006, rng, 6)]
    dataset = record_pushes(Slider(fine, 0.006), maps, pushes, rng)
    for grid, said in ((coarse, True), (fine, False)):
        folder = write_dataset(replace(dataset, grid=grid), tmp_path / str(len(grid)))
        found = slipmap("identify", folder, "-o", tmp_path / "b.npz", "--plain", "--hypotheses", 2)
        assert found.code == 0, found.err
        assert ("THE CELLS ARE TOO COARSE FOR THIS OBJECT" in found.out) is said
