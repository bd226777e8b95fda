"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from diagrams.console import Progress, note
from diagrams.outputs import check_file

if TYPE_CHECKING:
    from models.measurements import PushDataset

PICTURES = ("png", "pdf", "svg")


class OutputFile(click.ParamType):
    """A file to be written: checked before any work is done."""

    name = "file"

    def __init__(self, *endings: str) -> None:
        self.endings = endings

    def convert(self, value: str | Path, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path, if it can be written."""
        path = Path(value)
        check_file(path, self.endings)
        return path


dataset_argument = click.argument("dataset", type=click.Path(path_type=Path))
json_option = click.option(
    "--json", "json_file", type=OutputFile(), metavar="FILE", help="Write the result as JSON."
)
seed_option = click.option(
    "--seed",
    type=click.IntRange(0, 2**32 - 1),
    default=0,
    show_default=True,
    help="Seed of every random draw.",
)
object_option = click.option(
    "--object",
    "object_name",
    metavar="NAME|YAML",
    help="What was pushed, for MIT and CSV files, which do not say it: a shape of the MIT push dataset such"
    " as rect1, or a YAML file with the keys object and finger of a dataset.yaml.",
)


def load_dataset(path: Path, object_name: str | None, progress: Progress) -> PushDataset:
    """Read a dataset, with progress, and tell what looks wrong about it.

    Raises:
        DatasetError: it cannot be used.
    """
    from models.measurements import read_dataset

    dataset = read_dataset(
        path, object_name=object_name, progress=lambda done, total: progress("reading pushes", done, total)
    )
    for warning in dataset.warnings:
        note(f"warning: {warning}")
    return dataset
