"""Shared by commands that run, record or replay a robot's cell: options, scenario, view and results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from slipmap.diagrams.application.commands.options import (
    Option,
    bundled,
    complete_objects,
    path_option,
    typed,
)
from slipmap.diagrams.application.outputs import check_output
from slipmap.diagrams.application.terminal import (
    Progress,
    counted,
    note,
    prepare_kernels,
    wait_for_enter,
    warnings_noted,
)
from slipmap.diagrams.hardware.network import LCM_URL
from slipmap.models.files import BadInput, write_text

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from slipmap.diagrams.loops.run_folder import RunFolder
    from slipmap.diagrams.station.scenario import ObjectSettings, Scenario
    from slipmap.models.inference.results import Identification
    from slipmap.models.measurements import PushDataset
    from slipmap.models.objects.true_object import TrueObject


class Stopped(click.ClickException):
    """Ctrl-C, after something was saved."""

    exit_code = 130


station_object_option = click.option(
    "--object", "object_name", metavar="NAME", shell_complete=complete_objects,
    help="One of the six objects: book, box, hammer, wrench, snack, spray_gun. [default: hammer]",
)  # fmt: skip
scenario_option = path_option(
    "--scenario", "scenario_file",
    about="YAML file that describes the cell: table, camera, noise, your own object, hidden effects.",
)  # fmt: skip
lcm_option = click.option(
    "--lcm", "url", default=LCM_URL, show_default=True, metavar="URL",
    help="Address of the cell's messages; with ttl=0 they stay on this computer.",
)  # fmt: skip


def folder_option(default: str, more: str = "") -> Option:
    """The option `--output DIR`, which was `--out`, for the results of a run; `more` is added to its help."""
    about = f"Folder for pushes, belief, pictures and report.{more}"
    return path_option("-o", "--out", "--output", "folder", default=default, metavar="DIR", about=about)


class CellRun(NamedTuple):
    """Where a run takes place, how it is watched, and where its results go."""

    hardware: bool
    url: str
    open_meshcat: bool
    recording: Path | None
    folder: Path

    @property
    def address(self) -> str | None:
        """Address of a real cell; None for a simulated one."""
        return self.url if self.hardware else None

    def check_outputs(self, record: RunFolder, json_file: Path | None) -> None:
        """Refuse files that could not be written, and say which earlier run in the folder gives way.

        The folder must exist, as the files may lie in it.

        Raises:
            BadInput: see `check_output`.
        """
        if self.recording is not None:
            check_output(self.recording, ("html", "htm"))
        if json_file is not None:
            check_output(json_file)
        if record.replaces:
            note(
                f"this run replaces the earlier one in {self.folder} ({counted(record.replaces)}); --output"
                " chooses another folder"
            )

    @contextmanager
    def in_view(self) -> Iterator[tuple[Meshcat | None, Progress]]:
        """Meshcat, if requested, and progress."""
        recorded = self.recording is not None
        meshcat = _meshcat(self.open_meshcat) if self.open_meshcat or recorded else None
        with Progress() as progress:
            prepare_kernels()
            if meshcat is not None and recorded:
                from slipmap.diagrams.systems.python_system import DRAWN_EVERY

                meshcat.StartRecording(frames_per_second=1.0 / DRAWN_EVERY)
            yield meshcat, progress
        if meshcat is not None and recorded:
            meshcat.StopRecording()
        if self.open_meshcat and meshcat is not None:
            note(f"the view is at {meshcat.web_url()}; press Enter to quit")
            wait_for_enter()

    def keep_recording(self, meshcat: Meshcat | None) -> None:
        """Write the recording, if requested: last of all, so that a full disk loses nothing else.

        Raises:
            BadInput: it cannot be written.
        """
        if meshcat is None or self.recording is None:
            return
        try:
            with Progress() as progress, progress.step("writing the recording"):
                meshcat.PublishRecording()
                write_text(self.recording, str(meshcat.StaticHtml()))
        except BadInput as error:
            raise BadInput(
                f"{error}; only the recording is lost, {self.folder} holds everything else (continue a run"
                f" that was cut off with `slipmap explore --resume {self.folder}`)"
            ) from error
        show_files({"recording": self.recording})


def _meshcat(show: bool) -> Meshcat:
    import logging

    from pydrake.geometry import Meshcat, MeshcatParams

    from slipmap.diagrams.systems.belief_visualizer import VIEW

    logging.getLogger("drake").setLevel(logging.WARNING)  # the address is printed below, where it is needed
    meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    meshcat.SetCameraPose(*VIEW)
    for helper in ("/Grid", "/Axes"):
        meshcat.SetProperty(helper, "visible", False)
    if show:
        note(f"watch it at {meshcat.web_url()}")
    return meshcat


def cell_options(folder: str) -> Option:
    """The options of a `CellRun`, passed to the command as `cell`; `folder` is the default of --output."""
    options: list[Option] = [
        click.option(
            "--hardware", is_flag=True,
            help="Drive a real cell, or its simulated twin (`slipmap station`), at the address of --lcm.",
        ),
        lcm_option,
        click.option(
            "--meshcat", "open_meshcat", is_flag=True,
            help="Show the run in a browser: print the address, and wait for Enter or Ctrl-C at the end.",
        ),
        path_option(
            "--record", "recording",
            about="Write the whole run as an HTML page that plays it back without a network.",
        ),
        folder_option(folder, " An earlier simulated run there is replaced, one with --hardware never."),
    ]  # fmt: skip

    def decorate(command: Any) -> Any:
        decorated = bundled("cell", CellRun)(command)
        for option in reversed(options):
            decorated = option(decorated)
        return decorated

    return decorate


adapt_option = click.option(
    "--adapt", is_flag=True,
    help="Repair the model during the run: when pushes surprise it, and every few pushes, diagnose them,"
    " push again while the answer is open, and add the effect that is named. The model learns from every"
    " push.",
)  # fmt: skip


def effects_of_library(names: Sequence[str]) -> tuple[str, ...]:
    """Names of the library's effects, in the order given.

    Raises:
        EffectError: there is no such effect, or one is named twice.
    """
    from slipmap.models.effects.registry import effects_named

    return tuple(effect.name for effect in effects_named(names)) if names else ()


def scenario_of(path: Path | None, object_name: str | None, *, simulated: bool = False) -> Scenario:
    """The scenario of a file or the default one, with another object if given.

    Args:
        simulated: whether a simulated arm will push that object.

    Raises:
        BadInput: the file or the object's name is wrong, or the object cannot be pushed and seen where it
            lies.
    """
    from slipmap.diagrams.station.hidden_effects import check_strength
    from slipmap.diagrams.station.placement import check_feasible, check_placement, check_rest
    from slipmap.diagrams.station.scenario import Scenario, read_scenario

    try:
        scenario = Scenario() if path is None else read_scenario(path, object_name)
        scenario.object.name = object_name or scenario.object.name
        with warnings_noted():
            thing = scenario.object.make()
    except BadInput:
        raise
    except ValueError as error:
        where = "" if path is None or object_name is not None else f"{path}: "
        raise BadInput(f"{where}object: {error}") from error
    if scenario.object.mesh is not None:
        _show_mesh(scenario.object, thing)
    try:
        check_placement(scenario, thing)
        check_rest(scenario, thing)
        if simulated:
            from slipmap.diagrams.loops.exploration_loop import check_reach

            check_feasible(scenario, thing)
            check_strength(scenario.hidden, thing, scenario.simulation.time_step, scenario.gravity)
            check_reach(scenario, thing)
    except ValueError as error:
        raise BadInput(str(error) if path is None else f"{path}: {error}") from error
    return scenario


def _show_mesh(settings: ObjectSettings, thing: TrueObject) -> None:
    from slipmap.diagrams.application.commands.describe_object import size_in_words
    from slipmap.models.objects.meshes import up_axis

    assert settings.mesh is not None
    axis, height = settings.up or up_axis(settings.mesh), 1e3 * thing.height.max()
    note(f"object {thing.name}: {size_in_words(thing.grid)}, {height:.3g} mm high with {axis} up")


def leave(
    identification: Identification,
    dataset: PushDataset,
    folder: Path,
    progress: Progress,
    *,
    seed: int,
    told: tuple[str, Sequence[str]] = ("", ()),
) -> dict[str, Path]:
    """Write belief, pictures and report beside the pushes; returns their paths by name.

    Args:
        seed: of the run.
        told: what it says of itself in the report: a headline, or nothing, and sentences.
    """
    from slipmap.diagrams.application.commands.identify import keep
    from slipmap.diagrams.application.reports.comparison_report import comparison_report
    from slipmap.models.inference.comparison import compare

    belief = folder / "belief.npz"
    pictures = keep(identification, dataset, belief, None, progress)
    comparison = compare(dataset, identification.belief, seed=seed, label="model", progress=progress)
    text = comparison_report([comparison], dataset, str(folder / "pushes"), run=told)
    write_text(folder / "report.html", text)
    written = {"pushes": folder / "pushes", "belief": belief, "report": folder / "report.html"}
    return written | {f"picture of {path.stem.removeprefix('belief.')}": path for path in pictures}


def go_on_exploring(cell: CellRun) -> str:
    """The command that makes more pushes after those in a folder."""
    again = " --hardware" if cell.hardware else ""
    return f"`slipmap explore --after {typed(cell.folder)} --output FOLDER{again}`"


def show_files(written: Mapping[str, Path]) -> None:
    """Print which file is where."""
    for what, path in written.items():
        note(f"{what + ':':<19}{path}")
