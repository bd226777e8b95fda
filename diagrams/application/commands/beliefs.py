"""`slipmap view` and `slipmap export`: a belief in a browser, and as a model for simulators."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import cast

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.outputs import check_folder
from slipmap.diagrams.application.terminal import counted, note, status, wait_for_enter
from slipmap.models.files import write_text, writing

_PORT = 7000
"""Port of the page, if it is free."""


@click.command()
@click.argument("belief_file", metavar="BELIEF", type=click.Path(path_type=Path))
@options.output_option(
    "--html", "page_file", endings=("html", "htm"),
    about="Write the view as one page that any browser opens without a network, and quit.",
)  # fmt: skip
@options.effect_file_option
def view(belief_file: Path, page_file: Path | None, effect_files: tuple[Path, ...]) -> None:
    """Look at a belief in 3D in a browser.

    BELIEF is a file that `slipmap identify`, `slipmap fit` or `slipmap explore` wrote. A prism on each cell
    of the object shows its mass, its friction, or their product, which gives the force needed to slide the
    cell: the higher and brighter, the larger. The mean of all hypotheses and the most probable ones are side
    by side. Where they agree, the pushes have determined the value; where they differ, it is left open. A red
    pin marks the centre of mass.

    Without --html, the page is served to browsers on this computer until you press Enter or Ctrl-C.
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
        note(f"the view is at {address}; press Enter to quit")
        wait_for_enter()


@contextmanager
def _served(page: str) -> Iterator[str]:
    """Serve one page on this computer while the block runs; yields its address."""
    # Would be a third of the time of `slipmap --help`, and only this needs it.
    from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

    content = page.encode("utf-8")

    class Answer(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            # Against DNS rebinding: a foreign page could otherwise read the belief.
            if self.headers.get("Host", "") not in names:
                self.send_error(421)
                return
            if self.path != "/":
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: object) -> None:
            """Log nothing."""

    try:
        server = ThreadingHTTPServer(("127.0.0.1", _PORT), Answer)
    except OSError:
        server = ThreadingHTTPServer(("127.0.0.1", 0), Answer)
    names = {f"{host}:{server.server_port}" for host in ("localhost", "127.0.0.1")}
    with server:
        Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://localhost:{server.server_port}/"
        finally:
            server.shutdown()


@click.command()
@click.argument("belief", type=click.Path(path_type=Path))
@click.option("--to", "kind", type=click.Choice(["sdf", "urdf", "mjcf"]), required=True, help="Format.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), required=True, metavar="DIR",
    help="New folder for the models.",
)  # fmt: skip
@click.option(
    "--height", type=click.FloatRange(2e-3, 10.0), metavar="M",
    help="Height of the object, m, which a belief does not contain. [default: 0.02]",
)  # fmt: skip
@click.option(
    "--hypotheses",
    is_flag=True,
    help="Write one model for each hypothesis instead of their mean, for domain randomisation.",
)
@options.effect_file_option
def export(
    belief: Path,
    kind: str,
    output: Path,
    height: float | None,
    hypotheses: bool,
    effect_files: tuple[Path, ...],
) -> None:
    """Write a belief as an SDF, URDF or MJCF model.

    The object of BELIEF becomes a rigid body with its mass, centre of mass and inertia, on 32 small feet
    with the friction of the parts above them. Prints what the format cannot represent.
    """
    from slipmap.diagrams.application.simulator_models import (
        DEFAULT_HEIGHT,
        LOST,
        TO_MIND,
        Format,
        export_belief,
    )
    from slipmap.models.inference.belief import Belief

    check_folder(output.absolute().parent, output)
    learned = Belief.load(belief, options.find_effects(effect_files))
    to = cast(Format, kind)
    with writing(output):
        paths = export_belief(learned, to, output, height=height or DEFAULT_HEIGHT, hypotheses=hypotheses)
    for loss in LOST:
        status(f"not in the models: {loss}")
    for remark in TO_MIND[to]:
        status(f"caution: {remark}")
    if height is None:
        status(f"caution: the height is assumed to be {DEFAULT_HEIGHT:g} m; give --height if it matters")
    click.echo(f"{counted(len(paths), 'model')}: {paths[0]}{' and so on' if paths[1:] else ''}")
    note(f"folder: {output}")
