"""Campaigns give the same whatever runs them, lose nothing to a bad trial, and go on where they were."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import trial_functions

from slipmap.diagrams.application.campaigns.trials import (
    CRASHED,
    TrialSpec,
    read_outcome,
    run_trials,
)
from slipmap.models.files import BadInput

HERE = str(Path(__file__).parent)


@pytest.fixture(autouse=True)
def _findable(monkeypatch: pytest.MonkeyPatch) -> None:
    path = os.pathsep.join([HERE, str(Path.cwd()), os.environ.get("PYTHONPATH", "")])
    monkeypatch.setenv("PYTHONPATH", path)


def _specs(function: str, count: int = 5, scale: float = 2.0) -> list[TrialSpec]:
    return [
        TrialSpec(f"trial-{seed}", f"trial_functions:{function}", {"scale": scale}, seed)
        for seed in range(count)
    ]


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


def test_the_number_of_workers_does_not_matter(tmp_path: Path) -> None:
    results = []
    for workers in (1, 2):
        folder = _made(tmp_path / str(workers))
        results.append(run_trials(_specs("slow_draw"), folder, workers=workers))
        assert sorted(path.name for path in folder.iterdir()) == [f"trial-{k}.json" for k in range(5)]
    assert results[0] == results[1]
    assert [o.result["value"] for o in results[0]] == [
        trial_functions.draw(seed=k, scale=2.0)["value"] for k in range(5)
    ]


def test_a_trial_that_raises_is_recorded(tmp_path: Path) -> None:
    outcomes = run_trials(_specs("fail"), tmp_path, workers=2)
    assert [outcome.failure is None for outcome in outcomes] == [True, True, False, True, True]
    assert outcomes[2].failure is not None
    assert outcomes[2].failure.startswith("RuntimeError in trial_functions.py, line ")
    assert outcomes[2].failure.endswith(": seed 2 is bad")
    on_file = json.loads((tmp_path / "trial-2.json").read_text())
    assert on_file["result"] is None and "seed 2 is bad" in on_file["failure"]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_process_that_dies_takes_no_other_trial_with_it(tmp_path: Path, workers: int) -> None:
    outcomes = run_trials(_specs("die"), tmp_path, workers=workers)
    assert [outcome.failure for outcome in outcomes] == [None, None, CRASHED, None, None]
    assert read_outcome(_specs("die")[2], tmp_path) == outcomes[2]


def test_what_is_on_file_is_not_made_again_but_failures_are(tmp_path: Path) -> None:
    first = run_trials(_specs("draw", 2), tmp_path)
    stamps = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    failed = tmp_path / "trial-1.json"
    failed.write_text(json.dumps(json.loads(failed.read_text()) | {"result": None, "failure": "power cut"}))
    seen: list[tuple[int, int]] = []
    again = run_trials(_specs("draw", 3), tmp_path, progress=lambda *args: seen.append(args))
    assert again[:2] == first
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert (tmp_path / "trial-0.json").stat().st_mtime_ns == stamps["trial-0.json"]


def test_trials_of_another_campaign_are_not_taken_for_its_own(tmp_path: Path) -> None:
    run_trials(_specs("draw", 1), tmp_path)
    with pytest.raises(BadInput, match="its parameters differ"):
        run_trials(_specs("draw", 1, scale=3.0), tmp_path)
    (tmp_path / "trial-0.json").write_text("{")
    with pytest.raises(BadInput, match="not a readable trial"):
        run_trials(_specs("draw", 1), tmp_path)


def test_a_result_that_json_cannot_hold_is_a_failure(tmp_path: Path) -> None:
    outcome = run_trials(_specs("not_plain", 1), tmp_path)[0]
    assert outcome.failure is not None and "ValueError" in outcome.failure


def test_bad_requests_are_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="same name"):
        run_trials([*_specs("draw", 1), *_specs("draw", 1)], tmp_path)
    with pytest.raises(BadInput, match="use only letters"):
        TrialSpec("a/b", "trial_functions:draw", {}, 0)
    with pytest.raises(BadInput, match="plain data"):
        TrialSpec("a", "trial_functions:draw", {"scale": float("inf")}, 0)
    pytest.importorskip("distributed", reason="Dask comes with the extra `cluster`")
    with pytest.raises(BadInput, match="address of its scheduler"):
        run_trials(_specs("draw", 1), tmp_path, backend="dask")


@contextmanager
def _cluster(workers: int, threads: int) -> Iterator[str]:
    """Address of a scheduler with workers that are each a process of its own."""
    distributed = pytest.importorskip("distributed", reason="Dask comes with the extra `cluster`")
    dask = pytest.importorskip("dask")
    # Each death costs the time of a new worker's start; Dask's four would show no more than two.
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=threads,
            processes=True,
            host="127.0.0.1",
            dashboard_address=None,
        ) as running,
    ):
        yield running.scheduler_address
        # A cluster that is closed while a dead worker's place is filled again fails in doing so.
        with distributed.Client(running.scheduler_address) as client:
            client.wait_for_workers(workers)


def test_a_cluster_gives_the_same(tmp_path: Path) -> None:
    here, there = _made(tmp_path / "here"), _made(tmp_path / "there")
    local = run_trials(_specs("fail"), here, workers=2)
    with _cluster(workers=2, threads=1) as scheduler:
        remote = run_trials(_specs("fail"), there, backend="dask", scheduler=scheduler)
    assert local == remote
    texts = [
        [{**json.loads(path.read_text()), "seconds": 0} for path in sorted(folder.iterdir())]
        for folder in (here, there)
    ]
    assert texts[0] == texts[1]


def test_a_worker_that_dies_takes_no_other_trial_with_it(tmp_path: Path) -> None:
    with _cluster(workers=1, threads=2) as scheduler:
        outcomes = run_trials(_specs("die_beside_another", 4), tmp_path, backend="dask", scheduler=scheduler)
    assert [outcome.failure for outcome in outcomes] == [None, None, CRASHED, None]
