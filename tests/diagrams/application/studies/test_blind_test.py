"""`slipmap blind-test` with a small generator and a diagnosis that is told what to say."""

import json
from types import SimpleNamespace

import pytest

from slipmap.diagrams.application.studies.blind import generator
from slipmap.diagrams.application.studies.blind.secret_effects import LIBRARY, PLAIN
from slipmap.models.measurements import PushDataset


@pytest.fixture
def diagnosed(monkeypatch):
    """A diagnosis in place of the real one; the seeds it was asked for, and what it answers."""
    generate = generator.generate

    def small(seed, folder):
        return generate(seed, folder, effect=LIBRARY[0] if seed == 7 else PLAIN, strength="clear", pushes=1)

    monkeypatch.setattr(generator, "generate", small)
    asked = []

    def diagnose(dataset, *, seed):
        assert isinstance(dataset, PushDataset) and len(dataset.trials) == 1
        asked.append(seed)
        return SimpleNamespace(to_json=lambda: answer(seed))

    def answer(seed):
        if seed in broken:
            raise RuntimeError("the fit ran away")
        return {"verdict": "ambiguous", "effect": None, "effects": ["tether", "table_tilt"], "seconds": 2.0}

    broken: set[int] = set()
    monkeypatch.setattr("slipmap.models.inference.diagnosis.procedure.diagnose", diagnose)
    return SimpleNamespace(asked=asked, broken=broken)


def test_it_writes_datasets_truths_diagnoses_and_the_score(slipmap, tmp_path, diagnosed):
    said = slipmap("blind-test", "--seed", "7", "--count", "2", "-o", tmp_path / "out")
    assert said.code == 0, said.err
    assert diagnosed.asked == [7, 8]
    assert "false alarms where nothing is hidden  1 of 1" in said.out
    assert "ambiguous sets that hold the truth    1 of 1" in said.out
    assert said.err.startswith("2 datasets to simulate and diagnose; about a minute each …\n")
    assert "1 of 2, " in said.err
    assert "left: blind-00007, table_tilt (clear) → ambiguous tether, table_tilt" in said.err
    for name in ("blind-00007", "blind-00008"):
        assert (tmp_path / "out" / name / "dataset.yaml").is_file()
        assert (tmp_path / "out" / f"{name}.truth.yaml").is_file()
        assert json.loads((tmp_path / "out" / f"{name}.result.json").read_text())["verdict"] == "ambiguous"
    score = json.loads((tmp_path / "out" / "score.json").read_text())
    assert len(score["cases"]) == 2 and score["failed"] == {}
    assert (tmp_path / "out" / "score.md").read_text().startswith("| hidden |")


def test_a_stopped_run_goes_on_and_a_failure_loses_nothing_else(slipmap, tmp_path, diagnosed):
    diagnosed.broken.add(8)
    said = slipmap("blind-test", "--seed", "7", "--count", "3", "-o", tmp_path)
    assert said.code == 0
    assert "blind-00008, failed: RuntimeError: the fit ran away" in said.err
    assert "no diagnosis of blind-00008: RuntimeError: the fit ran away" in said.out.replace("\n", " ")
    assert "answer" in json.loads((tmp_path / "blind-00008.failure.json").read_text())["traceback"]
    kept = (tmp_path / "blind-00007.result.json").stat().st_mtime_ns
    dataset = (tmp_path / "blind-00008" / "dataset.yaml").stat().st_mtime_ns
    diagnosed.broken.clear()
    diagnosed.asked.clear()
    said = slipmap("blind-test", "--seed", "7", "--count", "4", "-o", tmp_path)
    assert said.code == 0
    assert diagnosed.asked == [8, 10]
    assert "2 of 4 datasets are already diagnosed" in said.err and "\n2 datasets to simulate" in said.err
    assert (tmp_path / "blind-00007.result.json").stat().st_mtime_ns == kept
    assert (tmp_path / "blind-00008" / "dataset.yaml").stat().st_mtime_ns == dataset
    assert not (tmp_path / "blind-00008.failure.json").exists()
    assert len(json.loads((tmp_path / "score.json").read_text())["cases"]) == 4


def test_a_diagnosis_with_an_unheard_of_verdict_is_a_failure_and_not_the_end(
    slipmap, tmp_path, diagnosed, monkeypatch
):
    monkeypatch.setattr(
        "slipmap.models.inference.diagnosis.procedure.diagnose",
        lambda dataset, seed: SimpleNamespace(to_json=lambda: {"verdict": "maybe"}),
    )
    said = slipmap("blind-test", "--count", "1", "-o", tmp_path)
    assert said.code == 0
    assert "failed: ValueError: blind-00000: verdict 'maybe'" in said.err
    assert not (tmp_path / "blind-00000.result.json").exists()
