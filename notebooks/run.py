"""Run notebooks from top to bottom and keep what they show: `python notebooks/run.py NOTEBOOK …`.

Jupyter does the same, but writes more into the file. Here counters, times and versions are left out and
pictures are compressed, so that a diff shows only what changed.
"""

from __future__ import annotations

import argparse
import base64
import io
import json
import os
import sys
from pathlib import Path
from typing import Any

COLOURS = 128
"""Colours of a kept picture."""

METADATA = {
    "kernelspec": {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}

SHOWN = ("image/png", "image/svg+xml", "text/html", "text/markdown", "text/plain")
"""Kinds of output that are kept, best first; of each output, only the first kind it has."""


class CellFailed(RuntimeError):
    """A cell of a notebook raised an exception. The message names the cell and shows its source."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Run notebooks from top to bottom and keep what they show.")
    parser.add_argument("notebooks", type=Path, nargs="+", metavar="NOTEBOOK")
    parser.add_argument(
        "--check", action="store_true", help="only run them, in the current folder; do not write the files"
    )
    arguments = parser.parse_args()
    shell = _shell()
    for path in [path.resolve() for path in arguments.notebooks]:
        notebook = json.loads(path.read_text())
        if not arguments.check:
            os.chdir(path.parent)  # where Jupyter would run it
        shell.reset()
        try:
            execute(notebook, shell)
        except CellFailed as error:
            sys.exit(f"{path.name}, {error}")
        if not arguments.check:
            path.write_text(as_text(notebook))


def execute(notebook: dict[str, Any], shell: Any) -> None:
    """Run all code cells and replace their outputs.

    Args:
        notebook: changed in place.
        shell: a shell in which nothing is defined yet.

    Raises:
        CellFailed: a cell raised an exception; the cells after it were not run.
    """
    from IPython.utils.capture import capture_output

    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for number, cell in enumerate(cells, start=1):
        source = "".join(cell["source"])
        with capture_output() as shown:
            result = shell.run_cell(source, store_history=True)
        sys.stderr.write(shown.stderr)
        if not result.success:
            raise CellFailed(f"code cell {number} failed:\n{source}\n\n{shown.stdout}")
        cell["outputs"] = _kept(shown)


def _shell() -> Any:
    """A shell that runs cells as Jupyter does, without a server: magics, last expressions, inline figures."""
    os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"
    from IPython.core.displayhook import DisplayHook
    from IPython.core.interactiveshell import InteractiveShell

    class Published(DisplayHook):
        def __call__(self, result: object = None) -> None:
            """Publish the value of a cell's last expression, unless the cell ends in a semicolon."""
            if result is not None and not self.quiet():
                self.shell.display_pub.publish(*self.compute_format_data(result))

    class Shell(InteractiveShell):
        displayhook_class = Published

        def enable_gui(self, gui: str | None = None) -> None:
            """Do nothing: there is no GUI."""

    shell = Shell.instance(colors="nocolor")
    shell.history_manager.enabled = False  # keep out of the user's own history
    return shell


def as_text(notebook: dict[str, Any]) -> str:
    """Text of the notebook's file; the same cells and outputs always give the same text."""
    cells = []
    for cell in notebook["cells"]:
        kept = {"cell_type": cell["cell_type"], "metadata": {}, "source": _lines("".join(cell["source"]))}
        if cell["cell_type"] == "code":
            kept |= {"execution_count": None, "outputs": cell["outputs"]}
        cells.append(kept)
    document = {"cells": cells, "metadata": METADATA, "nbformat": 4, "nbformat_minor": 4}
    return json.dumps(document, indent=1, ensure_ascii=False, sort_keys=True) + "\n"


def _kept(shown: Any) -> list[dict[str, Any]]:
    outputs: list[dict[str, Any]] = []
    if shown.stdout:
        outputs.append({"name": "stdout", "output_type": "stream", "text": _lines(shown.stdout)})
    for output in shown.outputs:
        kind = next(kind for kind in SHOWN if kind in output.data)
        if "<iframe" in str(output.data[kind]):
            continue  # it shows a file that exists only where the notebook has run
        data = {kind: _packed(output.data[kind]) if kind == "image/png" else _lines(output.data[kind])}
        outputs.append({"data": data, "metadata": {}, "output_type": "display_data"})
    return outputs


def _packed(picture: bytes | str) -> str:
    """A PNG with few colours, in base64 as Jupyter writes it."""
    from PIL import Image

    content = base64.b64decode(picture) if isinstance(picture, str) else picture
    file = io.BytesIO()
    few = Image.open(io.BytesIO(content)).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    few.save(file, format="PNG", optimize=True)
    return base64.b64encode(file.getvalue()).decode()


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


if __name__ == "__main__":
    main()
