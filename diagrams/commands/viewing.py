"""A run of the robot's cell while it is watched in Meshcat, recorded, or neither."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from diagrams.console import BadInput, Progress, note, prepare_kernels, wait_for_enter
from diagrams.outputs import write_text

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat


@contextmanager
def in_view(show: bool, recording: Path | None) -> Iterator[tuple[Meshcat | None, Progress]]:
    """Meshcat, if it is asked for, and progress, for a run; the recording is written where the run ends well.

    Args:
        show: serve the view, and wait for Enter at the end.
        recording: page that plays the run back, if wanted.

    Raises:
        BadInput: this machine cannot render pictures, or the scenario or the real cell cannot be had.
    """
    from diagrams.hardware.channels import HardwareError
    from diagrams.perception.renderer import RendererUnavailable
    from diagrams.station.scenario_file import ScenarioError

    meshcat = _meshcat(show) if show or recording is not None else None
    with Progress() as progress:
        prepare_kernels()
        if meshcat is not None and recording is not None:
            meshcat.StartRecording(frames_per_second=15.0)
        try:
            yield meshcat, progress
        except (HardwareError, RendererUnavailable, ScenarioError) as error:
            raise BadInput(str(error)) from error
        if meshcat is not None and recording is not None:
            progress("writing the recording", 0, 1)
            meshcat.StopRecording()
            meshcat.PublishRecording()
            write_text(recording, str(meshcat.StaticHtml()))
            progress("writing the recording", 1, 1)
    if show and meshcat is not None:
        click.echo(f"the view is at {meshcat.web_url()}; press Enter to end", err=True)
        wait_for_enter()


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
