"""`slipmap campaign` makes trials, keeps them, and tells what came of them beside the paper's numbers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from schemas import assert_as_described, assert_json_as_described, validator

from slipmap.diagrams.application.campaigns import adaptation, methods_compared
from slipmap.diagrams.application.campaigns.experiments import ABOUT, experiment_of
from slipmap.diagrams.application.campaigns.methods_compared import near
from slipmap.diagrams.application.campaigns.trials import TrialOutcome, write_outcome
from slipmap.diagrams.application.command_line import run
from slipmap.models.files import plain
from slipmap.planners.pregrasp import METHODS
from slipmap.planners.settings import STRATEGIES

POSES = 4


def _pretend(figure: str, seed: int, parameters: dict[str, Any]) -> dict[str, Any]:
    """What a trial of a figure might return."""
    if figure == "fig3":
        rank = STRATEGIES.index(parameters["strategy"])
        return {"errors": [1e-3 * (rank + 1) / n for n in range(1, 6)]}
    if figure == "fig4":
        return {"errors": {name: [2e-3] * 5 for name in ("identified", "uniform", "Algorithm 1")}}
    if figure == "fig5":
        fell = [False, False, True, False]
        chosen = {
            "probabilistic": [[True, True, False, False]],
            "deterministic": [[True, False, True, False], [True, True, False, True]],
            "uniform": [[False, False, True, False]],
            "true": [[not one for one in fell]],
        }
        return {"poses": [[0, 0, 0]] * POSES, "fell": fell, "chosen": chosen,
                "stay_probability": [1.0, 0.96, 0.02, 0.6]}  # fmt: skip
    if figure == "coverage":
        places = ["table", "table", "rim_at_end", "over_rim"]
        rarities = [0.8, 0.3, 0.07, 0.01 + seed]
        pushes = [
            {"place": place, "rarity": rarity, "error": 1e-3 * (k + 1), "spread": 2e-3}
            for k, (place, rarity) in enumerate(zip(places, rarities, strict=True))
        ]
        return {"pushes": pushes, "lost": 1}
    if figure == "tilt":
        good = parameters["model"] == "with the tilt" or seed == 1
        fate, errors = ("success", [2e-3, 4e-3]) if good else ("missed", [])
        return {"success": good, "fate": fate, "pushes": 2, "reason": "", "yaw": 0.0, "errors": errors}
    if figure == "adapt":
        return _adapted(seed, **parameters)
    good = parameters["method"] == "true" or seed % 2 == 0
    if figure == "fig7":
        return {"fate": "held" if good else "dropped", "pushes": [{}] * (3 + seed), "reason": "", "yaw": 0.0}
    return {
        "success": good,
        "fate": "success" if good else "fell",
        "pushes": 3 + seed,
        "reason": "",
        "yaw": 0,
    }


def _adapted(seed: int, object_name: str, hidden: str, robot: str) -> dict[str, Any]:
    """Of the tilt, seed 0 is named, but late, 1 is equivalent and 2 is not; else nothing is adopted. The tilt
    and the tether move pushes by more than 5 mm, the tether throws the object down."""
    adapting = robot == "adapting"
    effects = ["table_tilt" if seed == 0 else "tether"] if adapting and hidden == "tilt" else []
    errors = [(0.020, []), (0.030, []), (0.002 if seed < 2 else 0.015, effects)]
    judged = [
        {"trial": k, "error": e, "moved": 0.1, "effects": given} for k, (e, given) in enumerate(errors, 1)
    ]
    fate = "held" if adapting or hidden != "tilt" else "fell"
    findings = [{"action": "adopts", "pushes": 5}, {"action": "keeps", "pushes": 12}]
    findings[0]["pushes"] = 11 if seed == 0 else 10
    repair = {"effects": effects, "findings": findings if effects else []} if adapting else None
    shifts = {"tilt": [4e-3, 6e-3, 7e-3], "tether": [1e-3, None, None]}.get(hidden, [4.9e-3] * 3)
    return {"fate": fate, "pushes": [{}] * (2 if adapting else 3), "reason": "", "yaw": 0.0,
            "judged": judged, "repair": repair, "shifts": shifts if adapting else []}  # fmt: skip


def _campaign(figure: str, folder: Path, objects: Sequence[str], trials: int) -> tuple[int, dict[str, Any]]:
    """Run a campaign all of whose trials are on file."""
    files = folder / f"{figure}-plant"
    files.mkdir()
    for spec in experiment_of(figure).specs(objects or experiment_of(figure).objects, trials, 0, "plant"):
        result = _pretend(figure, spec.seed, dict(spec.parameters))
        write_outcome(TrialOutcome(spec, result, None, 1.0), files)
    names = [word for name in objects for word in ("--objects", name)]
    report = folder / "report.json"
    words = ["campaign", figure, *names, "--trials", str(trials), "-o", str(folder), "--json", str(report)]
    code = run(words)
    assert_json_as_described(words)
    return code, json.loads(report.read_text())


def _lines(text: str, name: str) -> list[str]:
    return [line for line in text.splitlines() if line.strip().startswith(name)]


def test_strategies_are_compared_push_by_push(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, document = _campaign("fig3", tmp_path, ["book", "hammer"], 2)
    assert code == 0
    assert document["curves"]["book"]["most-different"][1]["value"] == pytest.approx(1e-3)
    assert _lines(capsys.readouterr().out, "most-different")[0].split()[1] == "2.0"
    assert (tmp_path / "fig3-plant.png").stat().st_size > 10_000
    assert document["failed"] == {}


def test_models_are_compared_push_by_push(tmp_path: Path) -> None:
    code, document = _campaign("fig4", tmp_path, ["book"], 1)
    assert code == 0
    assert set(document["curves"]["book"]) == {"identified", "uniform", "Algorithm 1"}


def test_goals_are_counted_both_ways(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, document = _campaign("fig5", tmp_path, ["book"], 2)
    assert code == 0
    # Two trials, each: probabilistic 2 of 2 chosen stay, of 3 that stay 2 are chosen; and so on by hand.
    precision, recall = document["precision"]["book"], document["recall"]["book"]
    assert [precision[m]["value"] for m in METHODS] == pytest.approx([1.0, 4 / 5, 0.0, 1.0])
    assert [recall[m]["value"] for m in METHODS] == pytest.approx([2 / 3, 4 / 6, 0.0, 1.0])
    assert [precision[m]["count"] for m in METHODS] == [4, 10, 2, 6]
    bins = document["reliability"]
    assert [(b["stated"], b["value"], b["count"]) for b in bins] == [
        (pytest.approx(0.02), 0.0, 2), (pytest.approx(0.6), 1.0, 2), (pytest.approx(0.98), 1.0, 4)
    ]  # fmt: skip
    assert _lines(capsys.readouterr().out, "paper")[0].split()[1] == "100"
    assert (tmp_path / "fig5-plant.2.png").exists()


def test_success_stands_beside_the_papers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, document = _campaign("fig6", tmp_path, ["snack"], 4)
    assert code == 0
    success = document["success"]["snack"]
    assert [success[m]["value"] for m in METHODS] == [0.5, 0.5, 0.5, 1.0]
    assert document["pushes"]["true"]["value"] == pytest.approx(4.5)
    assert document["fates"]["uniform"] == {"success": 2, "fell": 2}
    paper = _lines(capsys.readouterr().out, "paper")
    assert paper[0].split()[1:] == ["81", "61", "42", "76"]
    assert paper[1].split()[1:] == ["6.27", "5.69", "6.05", "5.46"]


def test_the_whole_procedure_stands_beside_the_papers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, document = _campaign("fig7", tmp_path, [], 2)
    assert code == 0
    assert document["objects"] == ["hammer"]
    assert [document["held"]["hammer"][m]["value"] for m in METHODS] == [0.5, 0.5, 0.5, 1.0]
    assert document["pushes"]["uniform"]["value"] == pytest.approx(3.5)
    assert document["fates"]["uniform"] == {"held": 1, "dropped": 1}
    assert _lines(capsys.readouterr().out, "paper")[0].split()[1:] == ["100", "80", "30", "–"]
    assert run(["campaign", "fig7", "--truth", "bullet", "-o", str(tmp_path)]) == 2
    assert "only plant simulates" in capsys.readouterr().err


def test_every_experiment_is_found_by_its_name() -> None:
    assert [experiment_of(name).name for name in ABOUT] == list(ABOUT)
    with pytest.raises(ValueError, match="there are fig3, fig4"):
        experiment_of("fig1")


def test_every_fate_is_described() -> None:
    described = {
        branch["if"]["properties"]["experiment"]["const"]: branch["then"]["properties"].get("fates")
        for branch in validator("campaign").schema["allOf"]
    }
    for figure, fates in (
        ("fig6", methods_compared.EDGE_FATES),
        ("fig7", methods_compared.FETCH_FATES),
        ("tilt", methods_compared.EDGE_FATES),
    ):
        assert described[figure]["additionalProperties"]["propertyNames"]["enum"] == list(fates)


@pytest.mark.parametrize("figure", ABOUT)
def test_without_any_result_numbers_are_null(figure: str) -> None:
    specs = experiment_of(figure).specs(["book"], 1, 0, "plant")
    summary = experiment_of(figure).summary([TrialOutcome(spec, None, "lost") for spec in specs])
    told = {"experiment": figure, "truth": "plant", "seed": 0, "objects": ["book"], "trials": len(specs)}
    document = plain(summary.document)
    assert_as_described("campaign", document | told | {"failed": {specs[0].name: "lost"}})
    pushes = document.get("pushes", {})
    assert all(one["value"] is None for one in pushes.values())


def test_near_is_twenty_millimetres_and_fifteen_degrees() -> None:
    goal = np.array([0.3, 0.1, 3.1])
    assert near(np.add(goal, [0.019, 0.0, 2 * np.pi + 0.26]), goal)
    assert not near(np.add(goal, [0.015, 0.015, 0.0]), goal)
    assert not near(np.add(goal, [0.0, 0.0, 0.27]), goal)


def test_wrong_use_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["-o", str(tmp_path)]
    assert run(["campaign", "fig3", "--objects", "hamer", *out]) == 2
    assert "did you mean hammer?" in capsys.readouterr().err
    assert run(["campaign", "fig4", "--objects", "book", "--trials", "1", "--backend", "dask", *out]) == 2
    assert "scheduler" in capsys.readouterr().err or "cluster" in capsys.readouterr().err
    here = ["campaign", "fig4", "--objects", "book", "--trials", "1", *out]
    assert run([*here, "--scheduler", "tcp://nowhere:1"]) == 2
    assert "--scheduler is for --backend dask alone" in capsys.readouterr().err
    assert run([*here, "--backend", "dask", "--scheduler", "tcp://nowhere:1", "--workers", "2"]) == 2
    assert "--workers is for processes on this machine" in capsys.readouterr().err


def test_failed_trials_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = tmp_path / "fig4-plant"
    files.mkdir()
    specs = experiment_of("fig4").specs(["book"], 1, 0, "plant")
    outcomes = [TrialOutcome(spec, None, "RuntimeError in x.py, line 3: lost") for spec in specs]
    summary = experiment_of("fig4").summary(outcomes)
    assert summary.tables == []
    assert len(summary.figures()) == 1
    from slipmap.diagrams.application.commands.studies import _show_summary

    _show_summary(summary, outcomes)
    told = capsys.readouterr()
    assert "1 of 1 trials failed" in told.err and "line 3: lost" in told.err


def test_some_methods_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = tmp_path / "fig7-plant"
    files.mkdir()
    for spec in experiment_of("fig7").specs(["hammer"], 2, 0, "plant"):
        if spec.parameters["method"] == "true":
            result = _pretend("fig7", spec.seed, dict(spec.parameters))
            write_outcome(TrialOutcome(spec, result, None, 1.0), files)
    words = ["campaign", "fig7", "--methods", "true", "--trials", "2", "-o", str(tmp_path)]
    assert run(words) == 0
    assert sorted(path.stem for path in files.glob("*.json")) == ["hammer-true-0", "hammer-true-1"]
    shown = capsys.readouterr().out
    told = _lines(shown, "hammer")[0].split()
    assert told[1:4] == ["–", "–", "–"] and told[4].startswith("100")
    assert _lines(shown, "held")[0].split() == ["held", "–", "–", "–", "2"]


@pytest.mark.parametrize(
    ("figure", "told"), [("fig7", "choose one of probabilistic"), ("fig5", "this experiment has neither")]
)
def test_a_method_that_is_not_there_is_told(
    figure: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["campaign", figure, "--methods", "clairvoyant", "-o", str(tmp_path)]) == 2
    assert told in capsys.readouterr().err


def test_what_the_missing_tilt_costs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, document = _campaign("tilt", tmp_path, ["book"], 2)
    assert code == 0
    success = document["success"]["book"]
    assert [success[model]["value"] for model in ("without the tilt", "with the tilt")] == [0.5, 1.0]
    assert document["errors"]["all"]["without the tilt"] == pytest.approx(
        {"value": 3e-3, "low": None, "high": None, "count": 1}
    )
    assert document["fates"] == {
        "without the tilt": {"success": 1, "missed": 1},
        "with the tilt": {"success": 2},
    }
    assert _lines(capsys.readouterr().out, "missed")[0].split() == ["missed", "1", "0"]


def test_what_a_robot_that_adapts_adopts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, document = _campaign("adapt", tmp_path, ["book"], 3)
    assert code == 0
    told = document["hidden"]
    assert set(told) == {*adaptation.HIDDEN, "all effects"}
    assert told["tilt"]["answers"] == {"named": 1, "equivalent": 1, "other": 1, "none": 0}
    assert [told[name]["right"]["value"] for name in ("tilt", "nothing", "film")] == [2 / 3, 1.0, 0.0]
    errors = told["tilt"]["errors"]
    assert (errors["before"]["value"], errors["before"]["count"]) == (pytest.approx(0.25), 3)
    assert errors["ratio"] == pytest.approx(0.08)
    assert told["film"]["errors"]["ratio"] is None
    assert [told[name]["needed"] for name in ("tilt", "tether", "film", "all effects")] == [3, 3, 0, 6]
    assert told["tilt"]["right_where_needed"]["value"] == 1 / 3  # the one named came late
    assert told["all effects"]["right_where_needed"]["value"] == 1 / 6
    assert told["all effects"]["right"]["value"] == 2 / 15 and told["film"]["right_where_needed"] is None
    held = told["tilt"]["held"]
    assert (held["adapting"]["value"], held["plain"]["value"]) == (1.0, 0.0)
    assert told["tilt"]["pushes"]["plain"]["value"] == 3.0
    assert "3 fell" in _lines(capsys.readouterr().out, "tilt")[-1]


def test_an_effect_or_its_rival_counts_as_both() -> None:
    """Hypotheses had one or the other, then the rival alone, once pushes ruled out the first."""
    pushes = [
        {"trial": trial, "error": error, "moved": 0.1, "effects": effects}
        for trial, (error, effects) in enumerate(
            [(0.02, []), (0.03, []), (0.004, ["table_tilt", "tether"]), (0.002, ["tether"])]
        )
    ]
    repair = {"effects": ["table_tilt"], "rival": "tether"}
    assert adaptation.adopted({"repair": repair}) == ["table_tilt", "tether"]
    told = {"repair": repair, "judged": pushes}
    assert adaptation.answer("tether", told) == adaptation.answer("tilt", told) == "named"
    assert adaptation.errors_by_adoption(told) == (pytest.approx(0.25), pytest.approx(0.03))
    assert adaptation.errors_by_adoption(told | {"repair": {"effects": [], "rival": ""}}) is None


def test_what_is_hidden_alone(tmp_path: Path) -> None:
    specs = experiment_of("adapt").specs(["book"], 1, 0, "plant")
    assert len(specs) == 2 * len(adaptation.HIDDEN)
    files = tmp_path / "adapt-plant"
    files.mkdir()
    for spec in specs:
        if spec.parameters["hidden"] == "film":
            write_outcome(TrialOutcome(spec, _pretend("adapt", 0, dict(spec.parameters)), None, 1.0), files)
    assert run(["campaign", "adapt", "--objects", "book", "--methods", "film", "--trials", "1",
                "-o", str(tmp_path)]) == 0  # fmt: skip
    assert sorted(path.stem for path in files.glob("*.json")) == [
        "book-film-adapting-0", "book-film-plain-0"
    ]  # fmt: skip


def test_the_tilted_table_is_the_plants_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["campaign", "tilt", "--truth", "bullet", "-o", str(tmp_path)]) == 2
    assert "leave out --truth" in capsys.readouterr().err


def test_ends_inside_the_regions_are_counted_by_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, document = _campaign("coverage", tmp_path, ["book", "wrench"], 2)
    assert code == 0
    assert set(document["coverage"]) == {"book", "wrench", "all"}
    of_book = document["coverage"]["book"]
    assert of_book["table"] == {
        "pushes": 4, "inside_50": 0.5, "inside_90": 1.0, "inside_95": 1.0,
        "error_median": pytest.approx(1.5e-3), "spread_median": pytest.approx(2e-3),
    }  # fmt: skip
    rim = of_book["rim_at_end"]
    assert [rim[key] for key in ("pushes", "inside_50", "inside_90", "inside_95")] == [2, 0.0, 0.0, 1.0]
    over = document["coverage"]["all"]["over_rim"]
    assert [over[key] for key in ("pushes", "inside_50", "inside_90", "inside_95")] == [4, 0.5, 0.5, 0.5]
    assert document["lost"] == 4
    assert _lines(capsys.readouterr().out, "all")[1].split()[:6] == ["all", "rim", "at", "4", "0", "0"]
