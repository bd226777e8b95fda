"""Commands that test slipmap and physics engines many times against known truths.

`slipmap explore-study` explores objects; `slipmap calibrate` counts how often intervals contain the truth;
`slipmap blind-test` hides effects in simulated datasets, diagnoses them and counts what was found; `slipmap
campaign` repeats the paper's experiments and compares with its numbers; `slipmap audit` measures how far
physics engines depart from Coulomb's law of friction, in millimetres.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import time
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from slipmap.diagrams.application.campaigns.experiments import ABOUT, experiment_of
from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.commands.cell_run import Stopped, scenario_of
from slipmap.diagrams.application.outputs import take_folder, write_figures
from slipmap.diagrams.application.terminal import Progress, counted, note, paragraph, prepare_kernels, table
from slipmap.diagrams.systems.workers import deaf_workers, prepare_worker
from slipmap.models.files import PART, BadInput, all_or_nothing, remove_part, write_json, write_text

if TYPE_CHECKING:
    from slipmap.diagrams.application.campaigns.experiments import Summary
    from slipmap.diagrams.application.campaigns.trials import Backend, TrialOutcome, TrialSpec
    from slipmap.diagrams.application.studies.blind.scoring import Score
    from slipmap.diagrams.application.studies.calibration import CalibrationResult
    from slipmap.diagrams.loops.exploration_run import ExplorationRun


@click.command("explore-study")
@options.objects_option("--object", about="Object to explore")
@options.count_option("--runs", most=1000, default=10, about="Runs of each object, with seeds from SEED up.")
@options.explorations_option
@options.count_option("--checks", most=100, default=10, about="Random pushes afterwards, to test with.")
@options.results_option("folder", default="explore-study")
@options.seed_option
@options.json_option
def explore_study(
    object_names: tuple[str, ...],
    runs: int,
    pushes: int,
    checks: int,
    folder: Path,
    seed: int,
    json_file: Path | None,
) -> None:
    """Explore objects several times and judge the predictions.

    Reports how well further pushes of each object were predicted. Each run writes a JSON file and its pushes
    as a dataset to DIR. Runs already there are not repeated, so a stopped study continues. A run of 15 pushes
    takes two to three minutes.
    """
    from slipmap.diagrams.loops.exploration_run import ExplorationStopped
    from slipmap.models.objects.benchmark_objects import BENCHMARK_OBJECTS

    names = tuple(dict.fromkeys(object_names)) or tuple(BENCHMARK_OBJECTS)
    take_folder(folder)
    prepare_kernels()
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    for name in names:
        for number in range(seed, seed + runs):
            try:
                rows[name].append(_row(folder, name, number, pushes, checks))
            except (ExplorationStopped, KeyboardInterrupt) as error:
                raise Stopped(
                    f"stopped at {name}, seed {number}; nothing of this run is kept. The earlier runs are in"
                    f" {folder}; run the same command again to continue the study."
                ) from error
    _show_errors(rows)
    write_json(json_file, rows)


def _row(folder: Path, name: str, seed: int, pushes: int, checks: int) -> dict[str, Any]:
    """Result of one run, from its file or made now.

    Raises:
        ExplorationStopped: Ctrl-C; nothing of this run is kept.
    """
    path = folder / f"{name}-{seed}.json"
    if path.exists():
        return _row_of(path, pushes, checks)
    from slipmap.diagrams.loops.exploration_loop import LoopOptions
    from slipmap.diagrams.loops.exploration_run import ExplorationFailed, ExplorationStopped, explore
    from slipmap.models.measurements import write_dataset

    options_of_run = LoopOptions(pushes=pushes, checks=checks, seed=seed)
    try:
        with Progress() as progress:
            scenario = scenario_of(None, name)
            run = explore(scenario, options_of_run, progress=progress, learn_when_stopped=False)
    except ExplorationStopped:
        raise
    except ExplorationFailed as error:
        row: dict[str, Any] = {"failed": str(error)}
    else:
        write_dataset(run.dataset, folder / f"{name}-{seed}", overwrite=True)
        row = _judged(run)
    row |= {"pushes": pushes, "checks": checks}
    write_json(path, row)
    note(f"{name}, seed {seed}: {row.get('failed') or 'error {:.1f} mm'.format(1e3 * row['error'])}")
    return row


def _row_of(path: Path, pushes: int, checks: int) -> dict[str, Any]:
    """A run of an earlier study, if that had the same options."""
    try:
        row = dict(json.loads(path.read_text(encoding="utf-8")))
        asked = row["pushes"], row["checks"]
    except (ValueError, KeyError, TypeError) as error:
        raise BadInput(f"{path}: is not a run of a study; move it away") from error
    if asked != (pushes, checks):
        raise BadInput(
            f"{path}: is a run of {asked[0]} pushes and {asked[1]} checks, but this study has {pushes} and"
            f" {checks}; name another folder with -o"
        )
    return row


def _judged(run: ExplorationRun) -> dict[str, Any]:
    import numpy as np

    from slipmap.models.inference.end_region import EndRegion

    found = run.identification
    centers, p = found.belief.centers_of_mass, found.belief.probability
    mean = p @ centers
    off = run.true_center_of_mass - mean
    return {
        "error": float(found.errors("heldout").mean()),
        "uniform": float(found.errors("heldout", "uniform_add").mean()),
        "center_of_mass_off": float(np.hypot(*off)),
        "center_of_mass_inside": EndRegion.of(centers, p, np.zeros(2)).holds(run.true_center_of_mass, 0.9),
        "simulated": run.simulated,
        "seconds": run.seconds,
    }


def _show_errors(rows: dict[str, list[dict[str, Any]]]) -> None:
    cells, inside, done = [], 0, 0
    for name, results in rows.items():
        good = [row for row in results if "failed" not in row]
        done += len(good)
        count = sum(row["center_of_mass_inside"] for row in good)
        failed = len(results) - len(good)
        means = [
            f"{1e3 * sum(row[key] for row in good) / len(good):.{digits}f}" if good else "–"
            for key, digits in (("error", 1), ("uniform", 1), ("center_of_mass_off", 0))
        ]
        cells.append([name, str(len(good)), str(failed), *means, str(count)])
        inside += count
    table(
        "Error at the end of further pushes (ADD: mean distance between predicted and measured cells) and of"
        " the centre of mass, mm; runs with the centre of mass inside its 90 % region",
        ["object", "runs", "failed", "belief", "uniform", "centre of mass", "inside 90 %"],
        cells,
        numbers=(1, 2, 3, 4, 5, 6),
    )
    paragraph(f"The centre of mass lies in the belief's 90 % region in {inside} of {done} runs.")


_TELLS_NOTHING = 0.3
"""Width of a share's 95 % range that is too wide to distinguish right intervals from wrong ones."""


@click.command()
@options.count_option(
    "--objects", most=10_000, default=40, about="Objects to simulate; more objects give a sharper answer."
)
@options.seed_option
@options.picture_option("-o", "--output", about="Picture of the reliability curves (.png, .pdf or .svg).")
@options.json_option
def calibrate(objects: int, seed: int, output: Path | None, json_file: Path | None) -> None:
    """Check that 90 % intervals hold the truth 90 % of the time.

    Draws random objects of five kinds, pushes them in simulation, identifies each, and counts how often the
    truth lies inside the belief's 90 % interval. The range beside each share (95 %, Clopper and Pearson)
    shows how well so many objects determine it. Takes several seconds per object.
    """
    with Progress() as progress:
        prepare_kernels()
        from slipmap.diagrams.application.studies.calibration import LEVEL, calibrate as calibrated

        result = calibrated(objects=objects, seed=seed, progress=progress)
    rows = coverage_rows(result)
    numbers = {name: getattr(result, name) for name in ("objects", "seed", "seconds", "ranks", "by_kind")}
    with all_or_nothing():
        if output is not None:
            from slipmap.diagrams.application.figures import calibration_figure

            write_figures(output, [calibration_figure(result)])
        write_json(json_file, {**numbers, "level": LEVEL, "coverage": rows})
    table(
        f"True values inside the {LEVEL:.0%} interval; objects: {result.objects}, in"
        f" {result.seconds:.0f} s",
        ["quantity", "inside", "of", "share", "95 % range", "verdict"],
        [
            [row["name"], str(row["inside"]), str(row["of"]), f"{row['share']:.0%}",
             f"{row['low']:.0%} to {row['high']:.0%}", row["verdict"]]
            for row in rows
        ],
        numbers=(1, 2, 3, 4),
    )  # fmt: skip
    names = list(result.coverage)
    table(
        "Share inside, by kind of object",
        ["kind", *names],
        [[kind, *(f"{held[name]:.0%}" for name in names)] for kind, held in result.by_kind.items()],
        numbers=tuple(range(1, len(names) + 1)),
    )
    if output is not None:
        note(f"picture: {output}")


def coverage_rows(result: CalibrationResult) -> list[dict[str, Any]]:
    """Counts of true values inside, with the 95 % range of their share and a verdict on the intervals."""
    from slipmap.diagrams.application.campaigns.trials import exact_range
    from slipmap.diagrams.application.studies.calibration import LEVEL

    rows = []
    for name, share in result.coverage.items():
        count = len(result.ranks[name])
        inside = round(share * count)
        # Pushes of one object are not independent: count no more draws than objects.
        draws = min(count, result.objects)
        low, high = exact_range(share * draws, draws)
        verdict = "too narrow" if high < LEVEL else "too wide" if low > LEVEL else "as it should be"
        if verdict == "as it should be" and high - low > _TELLS_NOTHING:
            verdict = "too few objects to tell"
        rows.append(
            {"name": name, "inside": inside, "of": count, "share": share, "low": low, "high": high,
             "verdict": verdict}
        )  # fmt: skip
    return rows


@click.command("blind-test")
@options.seed_option
@options.count_option(
    "--count", most=10_000, default=20, metavar="M", about="Datasets, one for each seed from SEED up."
)
@options.results_option(default="blind-test", about="Folder for datasets, diagnoses and score.")
@options.count_option(
    "--jobs", most=64, default=1, metavar="J",
    about="Datasets to process in parallel, each in its own process.",
)  # fmt: skip
def blind_test(seed: int, count: int, output: Path, jobs: int) -> None:
    """Hide effects in simulated pushes, and see what is found.

    An independent simulator, which shares no physics with the model, draws an object, 24 pushes and a hidden
    effect, or none, from each seed. Every dataset is diagnosed and compared with its truth. Results already
    in DIR are kept, so a stopped run continues; only failures are tried again. Writes score.md and
    score.json. A dataset takes about half a minute to simulate.
    """
    take_folder(output)
    prepare_kernels()
    cases = [_Case(output, number) for number in range(seed, seed + count)]
    waiting = [case for case in cases if not case.result.exists()]
    if len(waiting) < count:
        note(f"{count - len(waiting)} of {count} datasets are already diagnosed in {output}")
    if waiting:
        at_once = f", {jobs} at a time" if jobs > 1 and len(waiting) > 1 else ""
        note(f"{counted(len(waiting), 'dataset')} to simulate and diagnose{at_once}; about a minute each …")
    started = time.monotonic()
    for done, (case, outcome) in enumerate(_run_all(waiting, jobs), start=1):
        left = (time.monotonic() - started) / done * (len(waiting) - done)
        duration = f"{left:.0f} s" if left < 90 else f"{left / 60:.0f} min"
        note(f"{done} of {len(waiting)}, {duration} left: {case.name}, {outcome}")
    score = _score(cases)
    with all_or_nothing():
        write_json(output / "score.json", score.to_json())
        write_text(output / "score.md", score.markdown())
    click.echo(score.text(), nl=False)
    note(f"score: {output / 'score.md'}")


class _Case(NamedTuple):
    """A dataset, by its seed, and the paths of its files."""

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
    """Each dataset and its outcome, as it is done."""
    if jobs == 1 or not cases:
        yield from ((case, _run(case)) for case in cases)
        return
    # Forked processes would share the threads of numba and BLAS; only this process handles Ctrl-C.
    pool = ProcessPoolExecutor(
        min(jobs, len(cases)),
        multiprocessing.get_context("spawn"),
        initializer=prepare_worker,
        initargs=(os.getpid(),),
    )
    try:
        with deaf_workers():
            futures = {pool.submit(_run, case): case for case in cases}
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
    """End the working processes, and remove what they were writing."""
    workers = multiprocessing.active_children()
    for worker in workers:
        worker.terminate()
    for worker in workers:
        worker.join()
        for part in folder.glob(f"{PART}{worker.pid}.*"):
            remove_part(part)


def _run(case: _Case) -> str:
    """Generate a dataset unless it exists, diagnose it, write the result, and return it in a few words."""
    from slipmap.diagrams.application.studies.blind import generator, scoring
    from slipmap.models.inference.diagnosis.procedure import diagnose
    from slipmap.models.measurements import read_dataset

    dataset = case.folder / case.name
    try:
        # The truth is written last: where it exists, the dataset is complete.
        file = generator.truth_file(dataset)
        truth = generator.Truth.read(file) if file.exists() else generator.generate(case.seed, dataset)
        pushes = read_dataset(dataset, tell=lambda warning: None)  # what is hidden may look wrong
        result: dict[str, Any] = diagnose(pushes, seed=case.seed).to_json()
        # A result that cannot be scored is a failure of this dataset, not of the whole run at the end.
        scoring.score([(truth, result)])
        write_json(case.result, result)
    except Exception as error:
        return f"failed: {_record_failure(case, error)}"
    case.failure.unlink(missing_ok=True)
    hidden = f"{truth.effect} ({truth.strength})" if truth.effect else "nothing hidden"
    names = result["effects"] if result["verdict"] == "ambiguous" else [result["effect"]]
    return f"{hidden} → {' '.join([result['verdict'], ', '.join(filter(None, names))]).strip()}"


def _record_failure(case: _Case, error: BaseException) -> str:
    """Write an error to its file; returns it in one line."""
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


_SHOWN_FAILURES = 5


@click.command(epilog="Experiments: " + "; ".join(f"{name}, {about}" for name, about in ABOUT.items()) + ".")
@click.argument("experiment", type=click.Choice(list(ABOUT)), metavar="EXPERIMENT")
@options.objects_option("--objects", about="Object", default="all six; fig7: hammer")
@click.option(
    "--methods", "methods", multiple=True, metavar="NAME",
    help="Method of fig6 and fig7, or what is hidden in adapt; may be repeated. [default: all]",
)  # fmt: skip
@options.count_option(
    "--trials", most=100_000,
    about="Trials of each object, with seeds from SEED up. [default: as the experiment needs]",
)  # fmt: skip
@click.option(
    "--truth", type=click.Choice(["plant", "bullet"]), default="plant", show_default=True,
    help="Simulator that plays the real world: Drake's MultibodyPlant, or Bullet (extra `bench`).",
)  # fmt: skip
@click.option(
    "--backend", type=click.Choice(["processes", "dask"]), default="processes", show_default=True,
    help="Where trials run: on this machine, or on a Dask cluster (extra `cluster`).",
)  # fmt: skip
@click.option("--scheduler", metavar="ADDRESS", help="Dask's scheduler, such as tcp://10.0.0.1:8786.")
@options.count_option("--workers", most=1024, about="Processes on this machine. [default: one per core]")
@options.results_option("folder", default="campaign")
@options.seed_option
@options.json_option
def campaign(
    experiment: str,
    object_names: tuple[str, ...],
    methods: tuple[str, ...],
    trials: int | None,
    truth: str,
    backend: Backend,
    scheduler: str | None,
    workers: int | None,
    folder: Path,
    seed: int,
    json_file: Path | None,
) -> None:
    """Repeat an experiment of the paper, or one beyond it.

    Shows the results beside the paper's numbers. Each trial writes a file to DIR/EXPERIMENT-TRUTH. Trials
    already there are not repeated, so a stopped campaign continues; failed trials are tried again. The same
    seeds give the same table on any backend.
    """
    from joblib import cpu_count

    from slipmap.diagrams.application.campaigns.trials import run_trials

    if scheduler is not None and backend != "dask":
        raise BadInput("--scheduler is for --backend dask alone; add that, or leave --scheduler out")
    if workers is not None and backend == "dask":
        raise BadInput("--workers is for processes on this machine; with --backend dask, the cluster decides")
    chosen = experiment_of(experiment)
    names = _checked(object_names or chosen.objects)
    files = folder / f"{experiment}-{truth}"
    take_folder(files)
    prepare_kernels()
    specs = _by_methods(chosen.specs(names, trials or chosen.trials, seed, truth), methods)
    if truth == "bullet" and find_spec("pybullet") is None:
        raise BadInput("Bullet is not installed; install it with `pip install 'slipmap[bench]'`")
    with Progress() as progress:
        outcomes = run_trials(
            specs,
            files,
            backend=backend,
            workers=workers or cpu_count(),
            scheduler=scheduler,
            progress=lambda done, total: progress(f"{experiment}, trials", done, total),
        )
    summary = chosen.summary(outcomes)
    picture = folder / f"{experiment}-{truth}.png"
    document = summary.document | {
        "experiment": experiment,
        "truth": truth,
        "seed": seed,
        "objects": list(names),
        "trials": len(outcomes),
        "failed": {o.spec.name: o.failure for o in outcomes if o.failure is not None},
    }
    with all_or_nothing():
        write_figures(picture, summary.figures())
        write_json(folder / f"{experiment}-{truth}.json", document)
        write_json(json_file, document)
    _show_summary(summary, outcomes)
    note(f"trials: {files}\npicture: {picture}")


def _checked(object_names: Sequence[str]) -> tuple[str, ...]:
    from slipmap.models.objects.benchmark_objects import BENCHMARK_OBJECTS, benchmark_object

    for name in object_names:
        try:
            benchmark_object(name)
        except ValueError as error:
            raise BadInput(str(error)) from error
    return tuple(dict.fromkeys(object_names)) or tuple(BENCHMARK_OBJECTS)


def _by_methods(specs: list[TrialSpec], methods: Sequence[str]) -> list[TrialSpec]:
    """The trials of some methods; all where none is named."""
    if not methods:
        return specs
    key = "hidden" if "hidden" in specs[0].parameters else "method"
    known = list(dict.fromkeys(spec.parameters[key] for spec in specs if key in spec.parameters))
    if not known:
        raise BadInput(
            "--methods selects methods of fig6 and fig7, or what is hidden in adapt; this experiment has"
            " neither"
        )
    for method in methods:
        if method not in known:
            raise BadInput(f"method {method!r} is unknown; choose one of {', '.join(known)}")
    return [spec for spec in specs if spec.parameters[key] in methods]


def _show_summary(summary: Summary, outcomes: Sequence[TrialOutcome]) -> None:
    for shown in summary.tables:
        words = shown.columns.index("") if "" in shown.columns[1:] else 0
        table(shown.title, shown.columns, shown.rows, numbers=range(words + 1, len(shown.columns)))
    paragraph("Intervals are 95 % intervals. " + summary.remark)
    failed = [outcome for outcome in outcomes if outcome.failure is not None]
    if failed:
        note(f"{len(failed)} of {len(outcomes)} trials failed and are left out of the tables:")
        for outcome in failed[:_SHOWN_FAILURES]:
            note(f"  {outcome.spec.name}: {outcome.failure}")
        if len(failed) > _SHOWN_FAILURES:
            note("  …")


@click.command()
@click.argument("engines", metavar="ENGINE...", nargs=-1, required=True)
@options.report_option("audit.html")
@options.json_option
def audit(engines: tuple[str, ...], output: Path, json_file: Path | None) -> None:
    """Measure how far a physics engine is from Coulomb's law.

    ENGINE is mujoco, bullet or drake, with settings after a colon, such as mujoco:elliptic,impratio=100,
    bullet:pyramid, drake:sap or drake:hydroelastic; or a class in a file of your own, such as
    my_engine.py:Engine (docs/audit.md says what it needs). Probes name the defects, each with a size and an
    uncertainty; 24 pushes of an object with known maps measure their cost in millimetres.
    """
    from slipmap.diagrams.application.audit.engines import find_engine

    subjects = [find_engine(spec) for spec in engines]
    with Progress() as progress:
        prepare_kernels()
        from slipmap.diagrams.application.audit.procedure import (
            audit as audited,
            prices_beside,
            standard_pushes,
        )

        standard = standard_pushes()
        audits = [audited(subject, standard, progress) for subject in subjects]
        beside = prices_beside(engines, standard, progress) if len(audits) == 1 else {}
        from slipmap.diagrams.application.reports.audit_words import audit_report, show_audits

        document = {"engines": audits, "beside_mm": {k: 1e3 * v for k, v in beside.items()}}
        with progress.step("drawing"), all_or_nothing():
            write_text(output, audit_report(audits, beside))
            write_json(json_file, document)
    show_audits(audits, beside)
    note(f"report: {output}")
