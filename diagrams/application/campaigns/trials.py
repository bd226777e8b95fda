"""Trials of a campaign: specifications, outcomes, and estimates from many of them.

Specs and outcomes are plain data. Trials share nothing, each has its own seed, and outcomes are returned in
the order of the trials, so the result is the same whether `run_trials` uses local processes (joblib) or a
cluster (Dask). Only the main process writes files, so a cluster needs no shared disk.
"""

from __future__ import annotations

import importlib
import json
import os
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from slipmap.diagrams.systems.workers import deaf_workers, prepare_worker
from slipmap.models.files import BadInput, replaced_file
from slipmap.models.progress import StageProgress


@dataclass(frozen=True)
class TrialSpec:
    """A trial to run, on any machine.

    Raises:
        BadInput: the name is not a file name, or JSON cannot hold the parameters.
    """

    name: str  # of the trial and its file; letters, digits, '-', '_' and '.'
    # `module:function`, called as function(seed=seed, **parameters); returns JSON-serialisable data
    function: str
    parameters: Mapping[str, Any]  # JSON-serialisable
    seed: int  # of all its random draws

    def __post_init__(self) -> None:
        if not self.name.strip("._-") or not all(c.isalnum() or c in "-_." for c in self.name):
            raise BadInput(f"trial {self.name!r}: use only letters, digits, '-', '_' and '.'")
        try:
            self.to_json()
        except (TypeError, ValueError) as error:
            raise BadInput(f"trial {self.name}: parameters must be plain data ({error})") from error

    def to_json(self) -> dict[str, Any]:
        """The spec as JSON."""
        document = vars(self) | {"parameters": dict(self.parameters)}
        return dict(json.loads(json.dumps(document, allow_nan=False)))

    def run(self) -> TrialOutcome:
        """Run the trial. Exceptions are recorded, not raised."""
        began = time.perf_counter()
        try:
            module, _, name = self.function.partition(":")
            result = getattr(importlib.import_module(module), name)(seed=self.seed, **self.parameters)
            plain = json.loads(json.dumps(result, allow_nan=False))
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            text = " ".join(str(error).split())
            failure = f"{type(error).__name__} in {Path(place.filename).name}, line {place.lineno}: {text}"
            return TrialOutcome(self, None, failure, time.perf_counter() - began)
        return TrialOutcome(self, plain, None, time.perf_counter() - began)


@dataclass(frozen=True)
class TrialOutcome:
    """Outcome of a trial."""

    spec: TrialSpec  # the trial
    result: Any  # returned by its function; None where it failed
    failure: str | None  # why it failed, or None
    # duration, s; the only part that depends on the machine
    seconds: float = field(compare=False, default=0.0)


def write_outcome(outcome: TrialOutcome, folder: Path) -> None:
    """Write `<name>.json` to a folder atomically.

    Raises:
        BadInput: the folder cannot be written to.
    """
    document = outcome.spec.to_json() | {
        "result": outcome.result,
        "failure": outcome.failure,
        "seconds": outcome.seconds,
    }
    path = _file(outcome.spec, folder)
    try:
        with replaced_file(path) as part:
            part.write_text(json.dumps(document, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    except OSError as error:
        raise BadInput(f"cannot write {path}: {error.strerror or error}; choose another folder") from error


def read_outcome(spec: TrialSpec, folder: Path) -> TrialOutcome | None:
    """The stored outcome of a trial, or None.

    Raises:
        BadInput: the file is damaged, or is of a trial with other parameters.
    """
    path = _file(spec, folder)
    if not path.exists():
        return None
    advice = "remove it or choose another folder"
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        stored = {key: document[key] for key in ("name", "function", "parameters", "seed")}
        outcome = TrialOutcome(spec, document["result"], document["failure"], float(document["seconds"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(f"{path} is not a readable trial ({error}); {advice}") from error
    if stored != spec.to_json():
        different = [key for key, value in spec.to_json().items() if stored[key] != value]
        raise BadInput(f"{path} is of another campaign, its {' and '.join(different)} differ; {advice}")
    return outcome


def _file(spec: TrialSpec, folder: Path) -> Path:
    return folder / f"{spec.name}.json"


Backend = Literal["processes", "dask"]
CRASHED = "the process that ran the trial died"


def run_trials(
    specs: Sequence[TrialSpec],
    folder: Path,
    *,
    backend: Backend = "processes",
    workers: int = 1,
    scheduler: str | None = None,
    progress: StageProgress | None = None,
) -> list[TrialOutcome]:
    """Run all trials without a stored outcome, and return all outcomes in order.

    A trial that raises, or whose process dies, is recorded as failed; the others continue. It is tried again
    when the campaign is run again.

    Args:
        specs: trials with different names.
        folder: exists; `<name>.json` of each trial is written there as soon as it is done.
        backend: `processes` on this machine, or `dask`.
        workers: number of processes; ignored with Dask, which has its own workers.
        scheduler: address of Dask's scheduler, such as tcp://10.0.0.1:8786.
        progress: called with the number of trials done and their total.

    Raises:
        BadInput: names are not unique, the folder holds other trials, the scheduler is missing or does
            not answer, or the `cluster` extra is not installed.
    """
    if len({spec.name for spec in specs}) < len(specs):
        raise BadInput("two trials of the campaign have the same name")
    done: dict[str, TrialOutcome] = {}
    for spec in specs:
        outcome = read_outcome(spec, folder)
        if outcome is not None and outcome.failure is None:
            done[spec.name] = outcome
    report = progress or (lambda done, total: None)
    report(len(done), len(specs))
    remaining = [spec for spec in specs if spec.name not in done]
    if remaining:
        made = _on_processes(remaining, workers) if backend == "processes" else _on_dask(remaining, scheduler)
        for outcome in made:
            write_outcome(outcome, folder)
            done[outcome.spec.name] = outcome
            report(len(done), len(specs))
    return [done[spec.name] for spec in specs]


def _on_processes(specs: Sequence[TrialSpec], workers: int) -> Iterator[TrialOutcome]:
    """Outcomes as they arrive. When a process dies, the trials in progress are run again one by one."""
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    remaining = list(specs)
    while remaining:
        sent: list[TrialSpec] = []
        received: set[str] = set()
        try:
            for outcome in _in_parallel(remaining, workers, sent):
                received.add(outcome.spec.name)
                yield outcome
        except TerminatedWorkerError:
            suspects = [spec for spec in sent if spec.name not in received]
            for spec in suspects:
                try:
                    yield from _in_parallel([spec], 1, [])
                except TerminatedWorkerError:
                    yield TrialOutcome(spec, None, CRASHED)
            received |= {spec.name for spec in suspects}
        remaining = [spec for spec in remaining if spec.name not in received]


def _in_parallel(specs: Sequence[TrialSpec], workers: int, sent: list[TrialSpec]) -> Iterator[TrialOutcome]:
    """Outcomes as they arrive; appends the trials handed to processes to `sent`."""
    from joblib import Parallel, delayed, parallel_config

    def jobs() -> Iterator[object]:
        for spec in specs:
            sent.append(spec)
            yield delayed(TrialSpec.run)(spec)

    # With one job, joblib would run in this process, and a crashing trial would kill it.
    jobs_at_once = max(2, workers)
    watch = {"initializer": prepare_worker, "initargs": (os.getpid(),)}
    with parallel_config("loky", inner_max_num_threads=1, **watch):
        parallel = Parallel(
            n_jobs=jobs_at_once, batch_size=1, pre_dispatch=workers, return_as="generator_unordered"
        )
        with deaf_workers():
            outcomes = parallel(jobs())
        yield from outcomes


def _on_dask(specs: Sequence[TrialSpec], scheduler: str | None) -> Iterator[TrialOutcome]:
    try:
        from distributed import Client, KilledWorker, as_completed
    except ModuleNotFoundError as error:
        raise BadInput(
            "Dask is not installed; install it here and on the workers with `pip install 'slipmap[cluster]'`"
        ) from error
    if scheduler is None:
        raise BadInput("with Dask, give the address of its scheduler, such as tcp://10.0.0.1:8786")
    try:
        client = Client(scheduler, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise BadInput(f"no Dask scheduler answers at {scheduler} ({error})") from error
    with client:
        killed: list[TrialSpec] = []
        futures = {
            # Not pure, so that two campaigns on one cluster stay separate.
            client.submit(TrialSpec.run, spec, pure=False): spec
            for spec in specs
        }
        for future in as_completed(futures):
            try:
                yield future.result()
            except KilledWorker:
                killed.append(futures[future])
        # Dask blames every trial on a worker that died; run alone, only the crashing trial fails.
        for spec in killed:
            try:
                yield client.submit(TrialSpec.run, spec, pure=False).result()
            except KilledWorker:
                yield TrialOutcome(spec, None, CRASHED)


def by_object(outcomes: Sequence[TrialOutcome]) -> dict[str, list[TrialOutcome]]:
    """Outcomes of the trials that did not fail, by the name of the object."""
    found: dict[str, list[TrialOutcome]] = {}
    for outcome in outcomes:
        if outcome.result is not None:
            found.setdefault(outcome.spec.parameters["object_name"], []).append(outcome)
    return found


_LEVEL = 0.95  # of all intervals


@dataclass(frozen=True)
class Estimate:
    """A number and its 95 % interval."""

    value: float  # NaN without data
    # low, high: ends of the interval
    low: float
    high: float
    count: int  # trials behind it

    def percent(self) -> str:
        """Per cent with interval, as in a table: `97 (91 to 99)`."""
        return self.text(100.0, 0)

    def text(self, factor: float = 1.0, digits: int = 1) -> str:
        """Multiplied by a factor and rounded, such as `5.2 (4.9 to 5.5)`; a dash without data."""
        if not np.isfinite(self.value):
            return "–"
        value, low, high = (f"{factor * number:.{digits}f}" for number in (self.value, self.low, self.high))
        return f"{value} ({low} to {high})" if np.isfinite(self.low + self.high) else value

    def short(self, factor: float = 1.0, digits: int = 1) -> str:
        """Like `text`, with half the interval's width, such as `5.2 ± 0.3`."""
        if not np.isfinite(self.high - self.low):
            return self.text(factor, digits)
        return f"{factor * self.value:.{digits}f} ± {factor * (self.high - self.low) / 2:.{digits}f}"


def share(successes: int, count: int) -> Estimate:
    """Share of successes among `count` independent trials, with Wilson's interval.

    Raises:
        ValueError: the numbers do not form a share.
    """
    from scipy.stats import binomtest

    if count == 0 and successes == 0:
        return Estimate(float("nan"), 0.0, 1.0, 0)
    interval = binomtest(successes, count).proportion_ci(_LEVEL, method="wilson")
    return Estimate(successes / count, float(interval.low), float(interval.high), count)


def exact_range(hits: float, of: int) -> tuple[float, float]:
    """95 % range of the true share given `hits` out of `of` (Clopper and Pearson)."""
    from scipy.stats import beta

    low = float(beta.ppf(0.025, hits, of - hits + 1)) if hits else 0.0
    return low, float(beta.ppf(0.975, hits + 1, of - hits)) if hits < of else 1.0


def mean(values: Sequence[float]) -> Estimate:
    """Mean of independent values, with Student's interval; no interval for fewer than two."""
    from scipy.stats import t

    data = np.asarray(values, dtype=float)
    count = len(data)
    if count == 0:
        return Estimate(float("nan"), float("nan"), float("nan"), 0)
    middle = float(data.mean())
    if count == 1:
        return Estimate(middle, float("nan"), float("nan"), 1)
    half = float(t.ppf(0.5 + _LEVEL / 2, count - 1) * data.std(ddof=1) / np.sqrt(count))
    return Estimate(middle, middle - half, middle + half, count)
