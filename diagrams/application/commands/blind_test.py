"""`slipmap blind-test`: hide effects in simulated datasets, diagnose them all, and count what was found."""

from __future__ import annotations

import importlib
import json
import multiprocessing
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.outputs import make_folder
from slipmap.diagrams.application.terminal import note, prepare_kernels
from slipmap.models.files import BadInput, write_json, write_text

TESTS = Path(__file__).resolve().parents[2] / "tests"
RESULT, FAILURE = ".result.json", ".failure.json"


@click.command("blind-test")
@options.seed_option
@click.option(
    "--count", type=click.IntRange(1, 10_000), default=20, show_default=True, metavar="M",
    help="Datasets, one for each seed from SEED on.",
)  # fmt: skip
@click.option(
    "-o", "--output", type=click.Path(file_okay=False, path_type=Path), default=Path("blind-test"),
    show_default=True, metavar="DIR", help="Folder of datasets, diagnoses and score.",
)  # fmt: skip
@click.option(
    "--jobs", type=click.IntRange(1, 64), default=1, show_default=True, metavar="J",
    help="Datasets at the same time, each in a process of its own.",
)  # fmt: skip
def blind_test(seed: int, count: int, output: Path, jobs: int) -> None:
    """Hide effects in simulated pushes, and see what is found.

    An independent simulator, part of slipmap's tests, draws an object, 24 pushes and a hidden effect, or
    none, from each seed. Every dataset is diagnosed and compared with its truth. What is in DIR already is
    not done again, so a run that was stopped goes on; only failures are tried anew. Writes score.md and
    score.json. A dataset takes about half a minute to simulate.
    """
    _blind("generator")
    make_folder(output)
    prepare_kernels()
    seeds = range(seed, seed + count)
    waiting = [number for number in seeds if not _file(output, number, RESULT).exists()]
    if len(waiting) < count:
        note(f"{count - len(waiting)} of {count} datasets have their diagnosis in {output} already")
    if waiting:
        note(_announcement(len(waiting), jobs))
    started = time.monotonic()
    for done, (number, outcome) in enumerate(_run_all(output, waiting, jobs), start=1):
        left = (time.monotonic() - started) / done * (len(waiting) - done)
        note(f"{done} of {len(waiting)}, {_duration(left)} left: {_name(number)}, {outcome}")
    score = _score(output, seeds)
    write_json(output / "score.json", score.to_json())
    write_text(output / "score.md", score.markdown())
    click.echo(score.text(), nl=False)
    note(f"score: {output / 'score.md'}")


def _announcement(count: int, jobs: int) -> str:
    """What the first lines of outcomes are waited for."""
    at_once = f", {jobs} at a time" if jobs > 1 and count > 1 else ""
    return f"{count} dataset{'s' * (count > 1)} to simulate and diagnose{at_once}; about a minute each …"


def _blind(module: str) -> Any:
    """A module of the blind tests, which lie beside the packages in a checkout and in no wheel.

    Raises:
        BadInput: they are not there.
    """
    if not (TESTS / "blind" / "generator.py").is_file():
        raise BadInput(
            "the blind tests' simulator is part of slipmap's tests, which an installed package does not"
            " hold; in a checkout of the sources, call python -m slipmap blind-test"
        )
    # Folders in tests/ bear the packages' names; what is imported already cannot be taken for them.
    for package in ("models", "planners"):
        importlib.import_module(package)
    if str(TESTS) not in sys.path:
        sys.path.append(str(TESTS))
    return importlib.import_module(f"blind.{module}")


def _name(number: int) -> str:
    return f"blind-{number:05d}"


def _file(folder: Path, number: int, ending: str) -> Path:
    return folder / f"{_name(number)}{ending}"


def _run_all(folder: Path, numbers: list[int], jobs: int) -> Iterator[tuple[int, str]]:
    """Number and outcome of each dataset as it is done."""
    if jobs == 1:
        for number in numbers:
            yield number, _run(folder, number)
        return
    # Forked processes would share the threads of numba and BLAS with this one; Ctrl-C is for this one alone.
    pool = ProcessPoolExecutor(
        min(jobs, len(numbers) or 1),
        multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),
    )
    futures = {pool.submit(_run, folder, number): number for number in numbers}
    try:
        for future in as_completed(futures):
            number, error = futures[future], future.exception()
            if error is not None:
                _record_failure(folder, number, error)
            yield number, f"failed: {error}" if error is not None else future.result()
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        _stop_workers(folder)
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


def _run(folder: Path, number: int) -> str:
    """Generate a dataset unless it is there, diagnose it, write the result, and tell it in a few words."""
    generator = _blind("generator")
    dataset = folder / _name(number)
    try:
        # The truth is written last: where it is, the dataset is whole.
        if generator.truth_file(dataset).exists():
            truth = generator.Truth.read(generator.truth_file(dataset))
        else:
            truth = generator.generate(number, dataset)
        result = _diagnose(dataset, number)
        # A result that cannot be scored is a failure of its dataset, not of all at the end.
        _blind("scoring").score([(truth, result)])
        write_json(_file(folder, number, RESULT), result)
    except Exception as error:
        _record_failure(folder, number, error)
        return f"failed: {type(error).__name__}: {' '.join(str(error).split())}"
    _file(folder, number, FAILURE).unlink(missing_ok=True)
    hidden = f"{truth.effect} ({truth.strength})" if truth.effect else "nothing hidden"
    names = result.get("effects") if result["verdict"] == "ambiguous" else [result.get("effect")]
    return f"{hidden} → {' '.join([result['verdict'], ', '.join(filter(None, names or []))]).strip()}"


def _diagnose(folder: Path, seed: int) -> dict[str, Any]:
    from slipmap.models.measurements import read_dataset

    dataset = read_dataset(folder)
    began = time.perf_counter()
    document = (
        importlib.import_module("slipmap.models.inference.diagnosis").diagnose(dataset, seed=seed).to_json()
    )
    result = dict(json.loads(document) if isinstance(document, str) else document)
    result.setdefault("seconds", time.perf_counter() - began)
    return result


def _record_failure(folder: Path, number: int, error: BaseException) -> None:
    write_json(
        _file(folder, number, FAILURE),
        {
            "error": f"{type(error).__name__}: {' '.join(str(error).split())}",
            "traceback": "".join(traceback.format_exception(error)),
        },
    )


def _score(folder: Path, numbers: range) -> Any:
    generator = _blind("generator")
    pairs, failed = [], {}
    for number in numbers:
        result = _file(folder, number, RESULT)
        if result.exists():
            truth = generator.Truth.read(generator.truth_file(folder / _name(number)))
            pairs.append((truth, json.loads(result.read_text(encoding="utf-8"))))
        else:
            failure = json.loads(_file(folder, number, FAILURE).read_text(encoding="utf-8"))
            failed[_name(number)] = failure["error"]
    return _blind("scoring").score(pairs, failed)


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
