"""`slipmap explore`: the robot pokes an object that it has never seen and learns its maps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from diagrams.commands.options import json_option, seed_option
from diagrams.console import BadInput, Progress, note, paragraph, prepare_kernels, table, wait_for_enter
from diagrams.outputs import check_file, make_folder, write_json, write_text, writing
from planners.strategies import STRATEGIES

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from diagrams.exploration_loop import LoopOptions
    from diagrams.exploration_run import ExplorationRun
    from diagrams.station.scenario import Scenario


class _Stopped(click.ClickException):
    """Ctrl-C, after something was kept."""

    exit_code = 130


@click.command()
@click.option(
    "--object", "object_name", metavar="NAME",
    help="One of the six objects: book, box, hammer, wrench, snack, spray_gun. [default: hammer]",
)  # fmt: skip
@click.option(
    "--scenario", "scenario_file", type=click.Path(path_type=Path), metavar="FILE",
    help="YAML file that describes the cell: table, camera, noise, your own object, hidden effects.",
)  # fmt: skip
@click.option(
    "--pushes", type=click.IntRange(1, 100), default=5, show_default=True, metavar="N",
    help="Pushes to learn from.",
)  # fmt: skip
@click.option(
    "--checks", type=click.IntRange(0, 100), default=3, show_default=True, metavar="N",
    help="Random pushes after these, which only judge what was learned.",
)  # fmt: skip
@click.option(
    "--strategy", type=click.Choice(STRATEGIES), default="most-distinctive", show_default=True,
    help="How the next push is chosen (Algorithm 2).",
)  # fmt: skip
@click.option(
    "--meshcat", "open_meshcat", is_flag=True,
    help="Serve the view and print its address; wait for Enter or Ctrl-C at the end.",
)  # fmt: skip
@click.option(
    "--record", "recording", type=click.Path(path_type=Path), metavar="FILE",
    help="Write the whole run as a page that plays it back without a network.",
)  # fmt: skip
@click.option(
    "--out", "folder", type=click.Path(path_type=Path), default="exploration", show_default=True,
    metavar="DIR", help="Folder for pushes, belief, pictures and report.",
)  # fmt: skip
@seed_option
@json_option
def explore(
    object_name: str | None,
    scenario_file: Path | None,
    pushes: int,
    checks: int,
    strategy: str,
    open_meshcat: bool,
    recording: Path | None,
    folder: Path,
    seed: int,
    json_file: Path | None,
) -> None:
    """Let a simulated robot explore an object: look, poke, learn, and poke again.

    A Kuka iiwa with a finger pushes the object on its table, a depth camera watches, and after each push the
    belief about mass and friction forms anew. Nothing but the camera's pictures and the arm's own sensors is
    used. The pushes are left as a dataset, on which every other command works.
    """
    from diagrams.exploration_loop import LoopOptions

    scenario = scenario_of(scenario_file, object_name)
    options = LoopOptions(pushes=pushes, checks=checks, strategy=strategy, seed=seed)
    make_folder(folder)
    if recording is not None:
        check_file(recording, ("html", "htm"))
    run, failure, stopped = run_loop(scenario, options, open_meshcat, recording)
    written = leave(run, folder, recording)
    if json_file is not None:
        write_json(json_file, {**run.identification.to_json(), "truth": run.truth(), "failure": failure})
    show(run)
    for what, path in written.items():
        note(f"{what + ':':<19}{path}")
    if failure:
        kept = f"{failure} What was recorded until then is kept in {folder}."
        raise _Stopped(kept) if stopped else click.ClickException(kept)


def scenario_of(path: Path | None, object_name: str | None) -> Scenario:
    """The scenario of a file, if any, with another object, if any.

    Raises:
        BadInput: the file, or the object's name.
    """
    from diagrams.station.scenario import Scenario
    from diagrams.station.scenario_file import ScenarioError, read_settings

    try:
        scenario = Scenario() if path is None else read_settings(path, Scenario)
        if object_name is not None:
            scenario.object.name = object_name
            scenario.object.mesh = scenario.object.labels = None
        scenario.object.make()
    except ScenarioError as error:
        raise BadInput(str(error)) from error
    except ValueError as error:
        raise BadInput(f"object: {error}") from error
    return scenario


def run_loop(
    scenario: Scenario, options: LoopOptions, open_meshcat: bool, recording: Path | None
) -> tuple[ExplorationRun, str, bool]:
    """Run the loop; returns what it brought, why it ended early, if it did, and whether Ctrl-C ended it.

    Raises:
        BadInput: this machine cannot render pictures.
        click.ClickException: the loop stopped before anything could be learned.
    """
    from diagrams import exploration_run
    from diagrams.perception.renderer import RendererUnavailable
    from diagrams.station.scenario_file import ScenarioError

    meshcat = _meshcat(open_meshcat) if open_meshcat or recording is not None else None
    failure, stopped = "", False
    with Progress() as progress:
        prepare_kernels()
        if meshcat is not None and recording is not None:
            meshcat.StartRecording(frames_per_second=15.0)
        try:
            run = exploration_run.explore(scenario, options, meshcat=meshcat, progress=progress)
        except (RendererUnavailable, ScenarioError) as error:
            raise BadInput(str(error)) from error
        except exploration_run.ExplorationFailed as error:
            stopped = isinstance(error, exploration_run.ExplorationStopped)
            if error.run is None:
                raise (click.Abort() if stopped else click.ClickException(str(error))) from error
            run, failure = error.run, f"{error}."
        if meshcat is not None and recording is not None:
            progress("writing the recording", 0, 1)
            meshcat.StopRecording()
            meshcat.PublishRecording()
            write_text(recording, str(meshcat.StaticHtml()))
            progress("writing the recording", 1, 1)
    if open_meshcat and meshcat is not None:
        click.echo(f"the view is at {meshcat.web_url()}; press Enter to end", err=True)
        wait_for_enter()
    return run, failure, stopped


def _meshcat(show: bool) -> Meshcat:
    import logging

    from pydrake.geometry import Meshcat, MeshcatParams

    from diagrams.systems.belief_visualizer import VIEW

    logging.getLogger("drake").setLevel(logging.WARNING)  # the address is told below, where it is of use
    meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    meshcat.SetCameraPose(*VIEW)
    for helper in ("/Grid", "/Axes"):
        meshcat.SetProperty(helper, "visible", False)
    if show:
        note(f"watch it at {meshcat.web_url()}")
    return meshcat


def leave(run: ExplorationRun, folder: Path, recording: Path | None) -> dict[str, Path]:
    """Write dataset, belief, pictures and report; returns what lies where."""
    from diagrams.commands.compare import report
    from diagrams.commands.identify import keep
    from models.inference.comparison import compare
    from models.measurements import write_dataset

    place = folder / "pushes"
    with writing(place):
        write_dataset(run.dataset, place, overwrite=True)
    belief = folder / "belief.npz"
    with Progress() as progress:
        pictures = keep(run.identification, run.dataset, belief, None, progress)
        comparison = compare(run.dataset, run.identification.belief, seed=0, label="model", progress=progress)
        text = report([comparison], run.dataset)
    write_text(folder / "report.html", text)
    written = {"pushes": place, "belief": belief, "report": folder / "report.html"}
    written |= {f"picture of {path.stem.removeprefix('belief.')}": path for path in pictures}
    return written if recording is None else {**written, "recording": recording}


def show(run: ExplorationRun) -> None:
    """Print what was learned, beside the truth that only the simulator knows."""
    from diagrams.commands.identify import show as show_identification

    show_identification(run.identification, run.dataset)
    truth = run.truth()
    believed, true = truth["center_of_mass_believed"], truth["center_of_mass"]
    table(
        "Centre of mass, against the truth that only the simulator knows",
        ["", "x, mm", "y, mm"],
        [
            ["believed", *(f"{1e3 * value:.1f}" for value in believed)],
            ["true", *(f"{1e3 * value:.1f}" for value in true)],
        ],
        numbers=(1, 2),
    )
    paragraph(
        f"The belief's centre of mass is {1e3 * truth['center_of_mass_error']:.1f} mm off."
        f" {run.simulated:.0f} s of simulated time took {run.seconds:.0f} s."
    )
