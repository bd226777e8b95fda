"""`slipmap explore` and `slipmap pregrasp`: a robot learns an object's maps by pushing it, and grasps it.

`pregrasp` explores the object, then pushes it to the table's edge and grasps it there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slipmap.diagrams.application.commands import cell_run, options
from slipmap.diagrams.application.outputs import take_folder
from slipmap.diagrams.application.terminal import counted, note, paragraph, table
from slipmap.models.files import BadInput, all_or_nothing, write_json
from slipmap.planners.settings import METHODS, STRATEGIES

if TYPE_CHECKING:
    from slipmap.diagrams.loops.exploration_loop import LoopOptions, RecordedRun
    from slipmap.diagrams.loops.exploration_run import ExplorationRun
    from slipmap.diagrams.loops.pregrasp_loop import PregraspRun
    from slipmap.diagrams.loops.run_folder import RunFolder
    from slipmap.diagrams.station.scenario import Scenario
    from slipmap.diagrams.systems.model_monitor import Watch


@click.command()
@cell_run.station_object_option
@cell_run.scenario_option
@options.count_option(
    "--pushes", least=0, most=100, default=5,
    about="Pushes to learn from; with --after, in addition to the earlier ones.",
)  # fmt: skip
@options.count_option(
    "--checks", least=0, most=100, default=3,
    about="Random pushes afterwards, which only test what was learned.",
)  # fmt: skip
@click.option(
    "--strategy", type=click.Choice(STRATEGIES), default="most-distinctive", show_default=True,
    help="How to choose the next push (Algorithm 2).",
)  # fmt: skip
@options.effect_option(required=False, purpose="Effect of the library to add to the model")
@cell_run.adapt_option
@cell_run.cell_options("exploration")
@options.path_option(
    "--resume", metavar="DIR",
    about="Continue the run in this folder that was cut off or gave up, with its original options.",
)  # fmt: skip
@options.path_option(
    "--after", metavar="DIR",
    about="Start from what the run in this folder recorded: learn from all its pushes and --pushes further"
    " ones, with the effects given now. The object lies where that run left it.",
)  # fmt: skip
@options.seed_option
@options.json_in_folder_option
def explore(
    object_name: str | None,
    scenario_file: Path | None,
    pushes: int,
    checks: int,
    strategy: str,
    effect_names: tuple[str, ...],
    adapt: bool,
    cell: cell_run.CellRun,
    resume: Path | None,
    after: Path | None,
    seed: int,
    json_file: Path | None,
) -> None:
    """Let a robot explore an object: look, push, learn, repeat.

    A Kuka iiwa with a finger pushes the object on a table, a depth camera watches, and the belief about mass
    and friction is updated after each push. The robot uses only the camera's images and the arm's own
    sensors. The pushes form a dataset that every other command can use. Each is written as soon as it is
    recorded, so --resume can continue a run that was killed. If pushes surprise the model and `slipmap
    diagnose` names an effect, --after starts from the recorded pushes and --effect adds the effect. With
    --adapt, the robot does this by itself.

    The robot is simulated unless --hardware is given.
    """
    from slipmap.diagrams.loops.exploration_loop import LoopOptions
    from slipmap.diagrams.loops.run_folder import PUSHES, is_complete, resumed

    before = None
    if resume is not None:
        options.refuse(
            "--object", "--scenario", "--pushes", "--checks", "--strategy", "--effect", "--adapt", "--output",
            "--after", "--seed", because="--resume keeps the options of the run",
        )  # fmt: skip
        cell = cell._replace(folder=resume)
        scenario, wanted, before = resumed(resume)
    else:
        if adapt:
            options.refuse("--checks", because="--adapt learns from every push")
            checks = 0
        if after is None:
            scenario = cell_run.scenario_of(scenario_file, object_name, simulated=not cell.hardware)
        else:
            options.refuse("--object", "--scenario", because="--after uses the cell of the earlier run")
            if after.resolve() == cell.folder.resolve():
                raise BadInput(
                    f"--after {after}: this run would write there too; name another folder with --output"
                )
            scenario, _, recorded = resumed(after)
            if not pushes + checks:
                raise BadInput(
                    f"--pushes 0 and --checks 0 make no push; `slipmap fit {options.typed(after / PUSHES)}`"
                    " learns from the recorded ones"
                )
            before = recorded.all_to_learn_from()
            pushes += len(before.trials)
        if not pushes:
            raise BadInput("--pushes 0 leaves nothing to learn from; give 1 or more")
        effects = cell_run.effects_of_library(effect_names)
        wanted = LoopOptions(
            pushes=pushes, checks=checks, strategy=strategy, seed=seed, effects=effects, adapt=adapt
        )
    if before is not None and cell.hardware is not before.of_a_real_cell:
        was = "in simulation; leave out" if cell.hardware else "in a real cell; add"
        raise BadInput(f"{resume or after}: that run was made {was} --hardware to continue it")
    made = all((cell.folder / name).is_file() for name in ("belief.npz", "report.html"))
    asks_nothing = json_file is None and cell.recording is None
    if resume is not None and asks_nothing and made and is_complete(resume):
        note(
            f"{resume}: this run is complete, nothing is left to do;"
            f" {cell_run.go_on_exploring(cell)} makes more pushes"
        )
        return
    _explore(cell, scenario, wanted, before, json_file, resumes=resume is not None)


def _explore(
    cell: cell_run.CellRun,
    scenario: Scenario,
    wanted: LoopOptions,
    before: RecordedRun | None,
    json_file: Path | None,
    *,
    resumes: bool,
) -> None:
    """Run an exploration, and write and print what it learned.

    Args:
        before: what an earlier run recorded: this one, if it `resumes`, or that named with --after.
    """
    from slipmap.diagrams.loops import exploration_run
    from slipmap.diagrams.loops.run_folder import ExplorationFolder

    take_folder(cell.folder)
    record = ExplorationFolder(cell.folder, scenario, wanted, before if resumes else None)
    cell.check_outputs(record, json_file)
    if before is not None and not resumes:
        record.keep(before)
    failure, stopped = "", False
    with cell.in_view() as (meshcat, progress):
        try:
            run = exploration_run.explore(
                scenario, wanted,
                hardware=cell.address, meshcat=meshcat, progress=progress, record=record, before=before,
            )  # fmt: skip
        except exploration_run.ExplorationFailed as error:
            stopped = isinstance(error, exploration_run.ExplorationStopped)
            if error.run is None:
                raise _ended(error, record) from error
            run, failure = error.run, f"{error}."
        with record.going_on(len(run.dataset.trials)), all_or_nothing():
            written = cell_run.leave(
                run.identification, run.dataset, cell.folder, progress, seed=wanted.seed, told=_told(run)
            )
            if not stopped:  # else only what continues the run may write there
                record.end(complete=not failure)
            write_json(json_file, {**_learned_json(run), "monitor": run.watch, "failure": failure})
    _show_exploration(run)
    surprised = _show_surprises(run, cell.folder)
    cell_run.show_files(written)
    cell.keep_recording(meshcat)
    if failure:
        kept = (
            f"{failure} What was recorded until then is kept; continue with `slipmap explore --resume"
            f" {cell.folder}`."
        )
        raise cell_run.Stopped(kept) if stopped else click.ClickException(kept)
    note(f"Next: {_next_step(cell, wrong=surprised or run.watch.alarm)}.")


def _ended(error: Exception, record: RunFolder) -> click.Abort | click.ClickException:
    """The exception that ends a command whose run recorded nothing; after Ctrl-C, no file is left."""
    from slipmap.diagrams.loops.exploration_run import ExplorationStopped

    if not isinstance(error, ExplorationStopped):
        return click.ClickException(str(error))
    record.leave_none()
    return click.Abort()


def _next_step(cell: cell_run.CellRun, *, wrong: bool) -> str:
    """What to do after an exploration; `wrong` is whether pushes surprised the model beyond chance."""
    go_on = cell_run.go_on_exploring(cell)
    if wrong:
        pushes = options.typed(cell.folder / "pushes")
        return f"`slipmap diagnose {pushes}`; {go_on} with `--effect` continues with the effect that it names"
    belief = options.typed(cell.folder / "belief.npz")
    return (
        f"open {cell.folder / 'report.html'}; predict other pushes of the object with `slipmap predict"
        f" DATASET --belief {belief}`; {go_on} makes more pushes"
    )


@click.command()
@cell_run.station_object_option
@cell_run.scenario_option
@options.explorations_option
@click.option(
    "--method", type=click.Choice(METHODS), default="probabilistic", show_default=True,
    help="Model to plan with: all hypotheses, one drawn from them, a uniform object, or the truth.",
)  # fmt: skip
@options.effect_option(
    required=False, purpose="Effect of the library to add to the model for learning and planning"
)
@cell_run.adapt_option
@cell_run.cell_options("pregrasp")
@options.seed_option
@options.json_in_folder_option
def pregrasp(
    object_name: str | None,
    scenario_file: Path | None,
    pushes: int,
    method: str,
    effect_names: tuple[str, ...],
    adapt: bool,
    cell: cell_run.CellRun,
    seed: int,
    json_file: Path | None,
) -> None:
    """Push an object to the table's edge and grasp it there.

    For objects that cannot be grasped where they lie. The robot explores the object as `slipmap explore`
    does, pushes it until it sticks out over the table's edge without risk of falling, grasps it there and
    lifts it. The pushes are saved as a dataset; those towards the edge test what was learned. The command
    succeeds only if the gripper holds the object at the end.

    The robot is simulated unless --hardware is given.
    """
    from slipmap.diagrams.loops import pregrasp_loop
    from slipmap.diagrams.loops.exploration_loop import LoopOptions
    from slipmap.diagrams.loops.exploration_run import ExplorationFailed
    from slipmap.diagrams.loops.run_folder import PregraspFolder

    scenario = cell_run.scenario_of(scenario_file, object_name, simulated=not cell.hardware)
    effects = cell_run.effects_of_library(effect_names)
    exploration = LoopOptions(pushes=pushes, seed=seed, effects=effects, adapt=adapt)
    wanted = pregrasp_loop.PregraspOptions(exploration, method=method)
    if cell.hardware and method == "true":
        raise BadInput("--method true: the truth is known for simulated objects only; choose another method")
    take_folder(cell.folder)
    record = PregraspFolder(cell.folder, scenario, repeatable=not cell.hardware)
    cell.check_outputs(record, json_file)
    try:
        with cell.in_view() as (meshcat, progress):
            run = pregrasp_loop.pregrasp(
                scenario, wanted, hardware=cell.address, meshcat=meshcat, progress=progress, record=record
            )
            with all_or_nothing():
                explored = run.exploration
                written = cell_run.leave(
                    explored.identification, explored.dataset, cell.folder, progress,
                    seed=seed, told=_told(explored, run.explorations),
                )  # fmt: skip
                record.end()
                write_json(json_file, {**_learned_json(explored), "pregrasp": run})
    except ExplorationFailed as error:
        raise _ended(error, record) from error
    _show_exploration(run.exploration, goes_on=False)
    _show_pregrasp(run)
    _show_surprises(run.exploration, cell.folder, run.explorations)
    cell_run.show_files(written)
    cell.keep_recording(meshcat)
    if not run.held:
        kept = f"the object is not held: {run.reason}. What was recorded is kept in {cell.folder}."
        raise cell_run.Stopped(kept) if run.interrupted else click.ClickException(kept)


def _learned_json(run: ExplorationRun) -> dict[str, Any]:
    learned = run.identification
    own = {"effects": learned.effect_estimates, "truth": run.truth(), "repair": run.repair}
    return {**learned.to_json(), **own}


def _show_exploration(run: ExplorationRun, *, goes_on: bool = True) -> None:
    """Print what was learned; `goes_on` is whether `slipmap explore --after` accepts the run's folder."""
    from slipmap.diagrams.application.commands.identify import show, show_effects

    show(run.identification, run.dataset, None)
    show_effects(run.identification)
    if not run.angle_seen:
        paragraph(
            "The object looks round to the camera. Its angle cannot be seen, so it was held fixed, with an"
            " uncertainty of one radian. Errors of predicted pushes include rotation that nobody saw, and the"
            " location of the mass is given in the frame of an object that does not turn."
        )
    truth = run.truth()
    if truth is None:
        paragraph(f"It took {run.seconds:.0f} s.")
    else:
        _show_truth(truth)
        paragraph(
            f"{run.simulated:.0f} s of simulated time took {run.seconds - run.thinking:.0f} s; learning and"
            f" choosing pushes took {run.thinking:.0f} s."
        )
    paragraph(_monitor_words(run.watch, goes_on=goes_on))


def _told(run: ExplorationRun, explored: int | None = None) -> tuple[str, list[str]]:
    """Headline and sentences for the report on how the model was repaired, if it was to adapt; `explored` as
    for `repair_story`."""
    from slipmap.diagrams.application.reports.diagnosis_words import repair_headline, repair_story
    from slipmap.models.inference.diagnosis.results import estimates_by_effect
    from slipmap.models.inference.effect_words import effect_in_words

    if run.repair is None:
        return "", []
    grid = run.identification.belief.grid
    sizes = {
        name: effect_in_words(name, estimates, grid)
        for name, estimates in estimates_by_effect(run.identification).items()
    }
    headline = repair_headline(run.repair, run.watch, sizes)
    return headline, repair_story(run.repair, run.watch, explored)


def _show_surprises(run: ExplorationRun, folder: Path, explored: int | None = None) -> bool:
    """Print which pushes ended outside their intervals, and how the model was repaired if it was to adapt.

    Args:
        explored: as for `repair_story`.

    Returns:
        Whether these pushes are more, or farther out, than chance explains.
    """
    from slipmap.diagrams.application.reports.diagnosis_words import repair_story
    from slipmap.diagrams.application.reports.tables import show_surprises

    where = options.typed(folder / "pushes")
    beyond_chance = show_surprises(run.identification.pushes, where, "the final belief's")
    for sentence in [] if run.repair is None else repair_story(run.repair, run.watch, explored):
        paragraph(sentence)
    return beyond_chance


def _show_truth(truth: Mapping[str, Any]) -> None:
    places = {"believed": truth["center_of_mass_believed"], "true": truth["center_of_mass"]}
    table(
        "Centre of mass, and the truth that only the simulator knows",
        ["", "x, mm", "y, mm"],
        [[name, *(f"{1e3 * value:z.1f}" for value in place)] for name, place in places.items()],
        numbers=(1, 2),
    )
    paragraph(f"The belief's centre of mass is {1e3 * truth['center_of_mass_error']:.1f} mm off.")


def _monitor_words(watch: Watch, *, goes_on: bool = True) -> str:
    """The monitor's summary, in a sentence or two; `goes_on` as for `_show_exploration`."""
    from slipmap.diagrams.systems.model_monitor import LEVEL
    from slipmap.models.inference.end_region import beyond_in_millimetres

    if not watch.judged:
        return "Monitor: no push was made after the first belief, so there was nothing to check it against."
    largest = max(push.misfit for push in watch.judged)
    count = counted(len(watch.judged))
    numbers = f"{count} compared with the belief before each; largest misfit {largest:.1f} (typically 1)"
    outside = [push for push in watch.judged if push.surprising]
    if outside:
        worst = max(outside, key=lambda push: push.error / push.allowed)
        error, allowed = beyond_in_millimetres(worst.error, worst.allowed)
        numbers += (
            f"; {len(outside)} outside the 95 % region, the worst being push {worst.trial:03d}, which ended"
            f" {error} mm from the prediction of the belief at that time ({allowed} mm at most were expected)"
        )
    if first := next((push for push in watch.judged if push.alarm), None):
        return (
            f"Monitor: ALARM from push {first.trial:03d} on{'' if watch.alarm else ', since withdrawn'}"
            f" ({first.cause}): {numbers}."
            " The object does not move as the model predicts. `slipmap diagnose` may say why"
            f"{', and `slipmap explore --after` continues with the effect that it names' * goes_on}."
        )
    peak = max(push.evidence for push in watch.judged)
    return f"Monitor: no alarm; {numbers}, largest evidence {peak:.1f} (alarm at {1 / LEVEL:.0f})."


def _show_pregrasp(run: PregraspRun) -> None:
    rows = []
    for number, push in enumerate(run.to_json()["pushes"], 1):
        rows.append(
            [
                str(number),
                f"{1e3 * math.dist(push['after'][:2], push['goal'][:2]):.0f}",
                f"{100 * push['success_probability']:.0f}",
                f"{100 * push['fall_probability']:.0f}",
                f"{1e3 * push['margin']:.0f}",
            ]
        )
    if rows:
        table(
            "Pushes towards the edge: distance from the goal afterwards; as planned, probabilities of"
            " reaching it and of falling, and the margin",
            ["push", "distance, mm", "reaches it, %", "falls, %", "margin, mm"],
            rows,
            numbers=(0, 1, 2, 3, 4),
        )
    if run.held:
        paragraph(
            f"After {counted(len(run.pushes))}, the gripper grasped the object at the edge and holds it."
        )
    else:
        paragraph(f"The object is not held: {run.reason}.")
    if run.true_height is not None and run.fate != ("held" if run.held else "gave up"):
        paragraph(f"In truth, which only the simulator knows, it {run.fate}.")
