"""Arguments and options that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from diagrams.console import Progress, note
from diagrams.outputs import check_file

if TYPE_CHECKING:
    from models.effects.effect import Effect
    from models.measurements import PushDataset

PICTURES = ("png", "pdf", "svg")
Command = TypeVar("Command", bound=Callable[..., Any])


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
effect_file_option = click.option(
    "--effect-file", "effect_files", type=click.Path(path_type=Path), multiple=True, metavar="FILE",
    help="Python file with effects of your own, beside those of the library; may be given several times.",
)  # fmt: skip


def effect_option(*, required: bool, purpose: str) -> Callable[[Command], Command]:
    """The option `--effect NAME`, which may be given several times."""
    return click.option(
        "--effect", "effect_names", multiple=True, required=required, metavar="NAME",
        help=f"{purpose}, such as table_tilt; may be given several times.",
    )  # fmt: skip


def find_effects(files: Sequence[Path]) -> tuple[Effect, ...]:
    """The library's effects, and those of some files.

    Raises:
        EffectError: a file is faulty, or has an effect of a name that is taken.
    """
    from models.effects.registry import known_effects

    return known_effects(files)


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
