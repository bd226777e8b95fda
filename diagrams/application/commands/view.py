"""`slipmap view`: a belief in a browser, to be turned and looked at from all sides."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.terminal import Progress, note, prepare_kernels, wait_for_enter
from slipmap.models.files import BadInput, write_text

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat


PORT = 7000
"""Of the page, if it is free."""


@click.command()
@click.argument("belief_file", metavar="BELIEF", type=click.Path(path_type=Path))
@click.option(
    "--html", "page_file", type=options.OutputFile("html", "htm"), metavar="FILE",
    help="Write the view as one page for any browser, which needs no network, and end.",
)  # fmt: skip
@options.effect_file_option
def view(belief_file: Path, page_file: Path | None, effect_files: tuple[Path, ...]) -> None:
    """Look at a belief in 3D in a browser.

    BELIEF is a file that `slipmap identify`, `slipmap fit` or `slipmap explore` wrote. On each cell of the
    object stands a prism: the higher and brighter, the more is believed to be there of mass, of friction, or
    of their product, which is the force that it takes to slide the cell. Side by side stand the mean of all
    hypotheses and the most probable ones. Where these look alike, the pushes have decided; where they
    differ, the pushes have left it open. A red pin shows the centre of mass.

    Without --html the page is served to browsers on this computer until you press Enter or Ctrl-C.
    """
    from slipmap.models.inference.belief import Belief

    belief = Belief.load(belief_file, options.find_effects(effect_files))
    from slipmap.diagrams.application.figures.belief_scene import belief_scene

    page = belief_scene(belief).static_html()
    if page_file is not None:
        write_text(page_file, page)
        note(f"view: {page_file}")
        return
    with _served(page) as address:
        note(f"the view is at {address}; press Enter to end")
        wait_for_enter()


@contextmanager
def _served(page: str) -> Iterator[str]:
    """Serve one page on this computer while the block runs; yields its address."""
    # A third of the time in which `slipmap --help` answers, and only this needs it.
    from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

    content = page.encode("utf-8")

    class Answer(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path != "/":
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing."""

    try:
        server = ThreadingHTTPServer(("127.0.0.1", PORT), Answer)
    except OSError:
        server = ThreadingHTTPServer(("127.0.0.1", 0), Answer)
    with server:
        Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://localhost:{server.server_port}/"
        finally:
            server.shutdown()


# A run of the robot's cell while it is watched in Meshcat, recorded, or neither.


@contextmanager
def in_view(show: bool, recording: Path | None) -> Iterator[tuple[Meshcat | None, Progress]]:
    """Meshcat, if it is asked for, and progress, for a run; the recording is written where the run ends well.

    Args:
        show: serve the view, and wait for Enter at the end.
        recording: page that plays the run back, if wanted.

    Raises:
        BadInput: this machine cannot render pictures, or the scenario or the real cell cannot be had.
    """
    from slipmap.diagrams.hardware.network import HardwareError
    from slipmap.diagrams.perception.renderer import RendererUnavailable
    from slipmap.diagrams.station.scenario import ScenarioError

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

    from slipmap.diagrams.systems.belief_visualizer import VIEW

    logging.getLogger("drake").setLevel(logging.WARNING)  # the address is told below, where it is of use
    meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    meshcat.SetCameraPose(*VIEW)
    for helper in ("/Grid", "/Axes"):
        meshcat.SetProperty(helper, "visible", False)
    if show:
        note(f"watch it at {meshcat.web_url()}")
    return meshcat
