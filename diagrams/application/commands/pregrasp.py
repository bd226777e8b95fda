"""`slipmap pregrasp`: the robot explores an object, pushes it to the table's edge, and takes it there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.commands.cell_run import (
    CellRun,
    Stopped,
    cell_options,
    effects_of_library,
    leave,
    scenario_of,
    scenario_option,
    show_files,
    station_object_option,
)
from slipmap.diagrams.application.commands.explore import learned_json, show
from slipmap.diagrams.application.outputs import make_folder
from slipmap.diagrams.application.terminal import paragraph, table
from slipmap.models.files import BadInput, write_json
from slipmap.planners.settings import METHODS

if TYPE_CHECKING:
    from slipmap.diagrams.loops.pregrasp_loop import PregraspOptions, PregraspRun
    from slipmap.diagrams.loops.run_folder import PushRecord
    from slipmap.diagrams.station.scenario import Scenario


@click.command()
@station_object_option
@scenario_option
@options.explorations_option
@click.option(
    "--method", type=click.Choice(METHODS), default="probabilistic", show_default=True,
    help="What is planned with: all hypotheses, one drawn from them, a uniform object, or the truth.",
)  # fmt: skip
@options.effect_option(
    required=False, purpose="Effect of the library to add to the model that learns and plans"
)
@cell_options("pregrasp")
@options.seed_option
@options.json_in_folder_option
def pregrasp(
    object_name: str | None,
    scenario_file: Path | None,
    pushes: int,
    method: str,
    effect_names: tuple[str, ...],
    cell: CellRun,
    seed: int,
    json_file: Path | None,
) -> None:
    """Let a robot take what it cannot grasp where it lies.

    It explores the object as `slipmap explore` does, pushes it to where it sticks out over the table's edge
    and certainly stays, grasps it there and lifts it. The pushes are left as a dataset; those towards the
    edge judge what was learned. The command succeeds only where the object is held in the end.

    The robot is simulated, unless --hardware is given.
    """
    from slipmap.diagrams.loops.exploration_loop import LoopOptions
    from slipmap.diagrams.loops.pregrasp_loop import PregraspOptions
    from slipmap.diagrams.loops.run_folder import PregraspRecord

    scenario = scenario_of(scenario_file, object_name)
    exploration = LoopOptions(pushes=pushes, seed=seed, effects=effects_of_library(effect_names))
    wanted = PregraspOptions(exploration, method=method)
    if cell.hardware and method == "true":
        raise BadInput("--method true: the truth is known of a simulated object alone; choose another method")
    make_folder(cell.folder)
    record = PregraspRecord(cell.folder, scenario)
    cell.check_outputs(json_file)
    try:
        run = _run(scenario, wanted, cell, record)
    except BaseException:
        if not cell.hardware:
            record.end()  # a simulation can be made again: the same command may replace what it left
        raise
    written = leave(run.exploration.identification, run.exploration.dataset, cell.folder, cell.recording)
    record.end()
    if json_file is not None:
        write_json(json_file, {**learned_json(run.exploration), "pregrasp": run.to_json()})
    show(run.exploration)
    _show(run)
    show_files(written)
    if not run.held:
        kept = f"the object is not held: {run.reason}. What was recorded is kept in {cell.folder}."
        raise Stopped(kept) if run.interrupted else click.ClickException(kept)


def _run(scenario: Scenario, wanted: PregraspOptions, cell: CellRun, record: PushRecord) -> PregraspRun:
    """Run the loop to its end.

    Raises:
        BadInput: this machine cannot render pictures, or the real cell cannot be reached.
        click.ClickException: the loop stopped before anything could be learned.
    """
    from slipmap.diagrams.loops.exploration_run import ExplorationFailed, ExplorationStopped
    from slipmap.diagrams.loops.pregrasp_loop import run_pregrasp

    with cell.in_view() as (meshcat, progress):
        try:
            return run_pregrasp(
                scenario, wanted, hardware=cell.address, meshcat=meshcat, progress=progress, record=record
            )
        except ExplorationStopped as error:
            raise click.Abort() from error
        except ExplorationFailed as error:
            raise click.ClickException(str(error)) from error


def _show(run: PregraspRun) -> None:
    """Print the way to the edge, and how it ended."""
    rows = []
    for number, push in enumerate(run.to_json()["pushes"], 1):
        off = [1e3 * (push["after"][k] - push["goal"][k]) for k in range(2)]
        rows.append(
            [
                str(number),
                f"{(off[0] ** 2 + off[1] ** 2) ** 0.5:.0f}",
                f"{100 * push['success_probability']:.0f}",
                f"{100 * push['fall_probability']:.0f}",
                f"{1e3 * push['margin']:.0f}",
            ]
        )
    if rows:
        table(
            "Pushes towards the edge, as planned and as they went",
            ["push", "then off the goal, mm", "at the goal, %", "falls, %", "margin, mm"],
            rows,
            numbers=(0, 1, 2, 3, 4),
        )
    if run.held:
        paragraph(f"After {len(run.pushes)} pushes the gripper took the object at the edge, and holds it.")
    else:
        paragraph(f"The object is not held: {run.reason}.")
    if run.true_height is not None and run.fate != ("held" if run.held else "gave up"):
        paragraph(f"In truth, which only the simulator knows, it {run.fate}.")
