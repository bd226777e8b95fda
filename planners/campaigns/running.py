"""Runs trials on local processes (joblib) or on a cluster (Dask). The result is the same whatever runs them.

Trials share nothing, each has its own seed, and outcomes are put into the order of the trials. Only the
process that was started writes files, so a cluster needs no common disk.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Literal

from planners.campaigns.trial import CampaignError, TrialOutcome, TrialSpec, read_outcome, write_outcome

Backend = Literal["processes", "dask"]
CRASHED = "the process that made the trial died"

Progress = Callable[[int, int], None]


def run_trials(
    specs: Sequence[TrialSpec],
    folder: Path,
    *,
    backend: Backend = "processes",
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> list[TrialOutcome]:
    """Make all trials that are not on file, and return the outcomes of all, in their order.

    A trial that raises, or whose process dies, is recorded as failed; the others go on. It is tried again
    when the campaign is run again.

    Args:
        specs: trials with different names.
        folder: exists; `<name>.json` of each trial is written there as soon as it is done.
        backend: `processes` on this machine, or `dask`.
        workers: processes; of no meaning with Dask, whose workers are there already.
        scheduler: address of Dask's scheduler, such as tcp://10.0.0.1:8786.
        progress: called with the number of trials done and that of all.

    Raises:
        CampaignError: names that are not different, a folder with other trials, a scheduler that is not
            given or not reached, or the `cluster` extra is missing.
    """
    if len({spec.name for spec in specs}) < len(specs):
        raise CampaignError("two trials of the campaign have the same name")
    if workers < 1:
        raise CampaignError(f"a campaign needs at least one worker, got {workers}")
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
    """Outcomes as they come. When a process dies, the trials under way are made again one by one."""
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
    """Outcomes as they come; `sent` is filled with the trials that processes were given."""
    from joblib import Parallel, delayed, parallel_config

    def jobs() -> Iterator[object]:
        for spec in specs:
            sent.append(spec)
            yield delayed(TrialSpec.run)(spec)

    # With one job joblib would stay in this process, which a trial must not be able to kill.
    jobs_at_once = max(2, workers)
    with parallel_config("loky", inner_max_num_threads=1):
        yield from Parallel(
            n_jobs=jobs_at_once, batch_size=1, pre_dispatch=workers, return_as="generator_unordered"
        )(jobs())


def _on_dask(specs: Sequence[TrialSpec], scheduler: str | None) -> Iterator[TrialOutcome]:
    try:
        from distributed import Client, KilledWorker, as_completed
    except ModuleNotFoundError as error:
        raise CampaignError(
            "Dask is not installed; `pip install 'slipmap[cluster]'` brings it, here and on the workers"
        ) from error
    if scheduler is None:
        raise CampaignError("with Dask, give the address of its scheduler, such as tcp://10.0.0.1:8786")
    try:
        client = Client(scheduler, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise CampaignError(f"no Dask scheduler answers at {scheduler} ({error})") from error
    with client:
        killed: list[TrialSpec] = []
        futures = {
            # Not pure, so that two campaigns that run on one cluster keep apart.
            client.submit(TrialSpec.run, spec, pure=False): spec
            for spec in specs
        }
        for future in as_completed(futures):
            try:
                yield future.result()
            except KilledWorker:
                killed.append(futures[future])
        # Dask suspects all that waited on a worker that died; alone, a trial answers for itself.
        for spec in killed:
            try:
                yield client.submit(TrialSpec.run, spec, pure=False).result()
            except KilledWorker:
                yield TrialOutcome(spec, None, CRASHED)
