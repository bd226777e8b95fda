"""`slipmap blind-test`: hide effects in simulated datasets, diagnose them all, and count what was found."""

from __future__ import annotations

import json
import multiprocessing
import shutil
import signal
import time
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.outputs import make_folder
from slipmap.diagrams.application.terminal import note, prepare_kernels
from slipmap.models.files import write_json, write_text

if TYPE_CHECKING:
    from slipmap.diagrams.application.studies.blind.scoring import Score


@click.command("blind-test")
@options.seed_option
@options.count_option(
    "--count", most=10_000, default=20, metavar="M", about="Datasets, one for each seed from SEED on."
)
@options.results_option(default="blind-test", about="Folder of datasets, diagnoses and score.")
@options.count_option(
    "--jobs", most=64, default=1, metavar="J",
    about="Datasets at the same time, each in a process of its own.",
)  # fmt: skip
def blind_test(seed: int, count: int, output: Path, jobs: int) -> None:
    """Hide effects in simulated pushes, and see what is found.

    An independent simulator, which shares no physics with the model, draws an object, 24 pushes and a hidden
    effect, or none, from each seed. Every dataset is diagnosed and compared with its truth. What is in DIR
    already is not done again, so a run that was stopped goes on; only failures are tried anew. Writes
    score.md and score.json. A dataset takes about half a minute to simulate.
    """
    make_folder(output)
    prepare_kernels()
    cases = [_Case(output, number) for number in range(seed, seed + count)]
    waiting = [case for case in cases if not case.result.exists()]
    if len(waiting) < count:
        note(f"{count - len(waiting)} of {count} datasets have their diagnosis in {output} already")
    if waiting:
        at_once = f", {jobs} at a time" if jobs > 1 and len(waiting) > 1 else ""
        what = f"{len(waiting)} dataset{'s' * (len(waiting) > 1)}"
        note(f"{what} to simulate and diagnose{at_once}; about a minute each …")
    started = time.monotonic()
    for done, (case, outcome) in enumerate(_run_all(waiting, jobs), start=1):
        left = (time.monotonic() - started) / done * (len(waiting) - done)
        duration = f"{left:.0f} s" if left < 90 else f"{left / 60:.0f} min"
        note(f"{done} of {len(waiting)}, {duration} left: {case.name}, {outcome}")
    score = _score(cases)
    write_json(output / "score.json", score.to_json())
    write_text(output / "score.md", score.markdown())
    click.echo(score.text(), nl=False)
    note(f"score: {output / 'score.md'}")


class _Case(NamedTuple):
    """A dataset, by its seed, and where it and its diagnosis lie."""

    folder: Path
    seed: int

    @property
    def name(self) -> str:
        return f"blind-{self.seed:05d}"

    @property
    def result(self) -> Path:
        return self.folder / f"{self.name}.result.json"

    @property
    def failure(self) -> Path:
        return self.folder / f"{self.name}.failure.json"


def _run_all(cases: Sequence[_Case], jobs: int) -> Iterator[tuple[_Case, str]]:
    """Each dataset as it is done, and its outcome."""
    if jobs == 1 or not cases:
        yield from ((case, _run(case)) for case in cases)
        return
    # Forked processes would share the threads of numba and BLAS with this one; Ctrl-C is for this one alone.
    pool = ProcessPoolExecutor(
        min(jobs, len(cases)),
        multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),
    )
    futures = {pool.submit(_run, case): case for case in cases}
    try:
        for future in as_completed(futures):
            case, error = futures[future], future.exception()
            if error is not None:
                _record_failure(case, error)
            yield case, f"failed: {error}" if error is not None else future.result()
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        _stop_workers(cases[0].folder)
        raise
    pool.shutdown()


def _stop_workers(folder: Path) -> None:
    """End the processes at work, and remove what they were writing."""
    workers = multiprocessing.active_children()
    for worker in workers:
        worker.terminate()
    for worker in workers:
        worker.join()
        for part in folder.glob(f".{worker.pid}.*"):
            shutil.rmtree(part) if part.is_dir() else part.unlink()


def _run(case: _Case) -> str:
    """Generate a dataset unless it is there, diagnose it, write the result, and tell it in a few words."""
    from slipmap.diagrams.application.studies.blind import generator, scoring
    from slipmap.models.inference.diagnosis.procedure import diagnose
    from slipmap.models.measurements import read_dataset

    dataset = case.folder / case.name
    try:
        # The truth is written last: where it is, the dataset is whole.
        file = generator.truth_file(dataset)
        truth = generator.Truth.read(file) if file.exists() else generator.generate(case.seed, dataset)
        result: dict[str, Any] = diagnose(read_dataset(dataset), seed=case.seed).to_json()
        # A result that cannot be scored is a failure of its dataset, not of all at the end.
        scoring.score([(truth, result)])
        write_json(case.result, result)
    except Exception as error:
        return f"failed: {_record_failure(case, error)}"
    case.failure.unlink(missing_ok=True)
    hidden = f"{truth.effect} ({truth.strength})" if truth.effect else "nothing hidden"
    names = result["effects"] if result["verdict"] == "ambiguous" else [result["effect"]]
    return f"{hidden} → {' '.join([result['verdict'], ', '.join(filter(None, names))]).strip()}"


def _record_failure(case: _Case, error: BaseException) -> str:
    """Write an error down; returns it in a line."""
    said = f"{type(error).__name__}: {' '.join(str(error).split())}"
    write_json(case.failure, {"error": said, "traceback": "".join(traceback.format_exception(error))})
    return said


def _score(cases: Sequence[_Case]) -> Score:
    from slipmap.diagrams.application.studies.blind.generator import Truth, truth_file
    from slipmap.diagrams.application.studies.blind.scoring import score

    pairs, failed = [], {}
    for case in cases:
        if case.result.exists():
            truth = Truth.read(truth_file(case.folder / case.name))
            pairs.append((truth, json.loads(case.result.read_text(encoding="utf-8"))))
        else:
            failed[case.name] = json.loads(case.failure.read_text(encoding="utf-8"))["error"]
    return score(pairs, failed)
