"""`slipmap example`: sample pushes to try the commands on."""

from __future__ import annotations

from pathlib import Path

import click

from slipmap.diagrams.application.commands import options
from slipmap.diagrams.application.outputs import check_folder
from slipmap.diagrams.application.terminal import note
from slipmap.models.files import BadInput, writing


@click.command()
@options.path_option(
    "-o", "--output", "folder", default="tilted", metavar="DIR", about="New folder for the pushes.",
)  # fmt: skip
def example(folder: Path) -> None:
    """Write sample pushes of a block with a hidden effect.

    The pushes are simulated on a table that is not level, which the model does not know. Learn from them, see
    the model fail, find out why, and repair it.
    """
    from slipmap.diagrams.application.demonstration import tilted_block
    from slipmap.models.measurements import write_dataset
    from slipmap.models.measurements.reading import DESCRIPTION_FILE

    following = f"`slipmap identify {options.typed([folder])} -o belief.npz`"
    if (folder / DESCRIPTION_FILE).exists():
        raise BadInput(f"{folder}: holds pushes already; continue with {following}, or name another folder")
    check_folder(folder.absolute().parent, folder)
    with writing(folder):
        write_dataset(tilted_block(), folder)
    note(f"pushes: {folder}")
    note(f"Next: {following}.")
