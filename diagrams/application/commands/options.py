"""Arguments and options that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import wraps
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

from slipmap.diagrams.application.outputs import check_output
from slipmap.diagrams.application.terminal import Progress, note
from slipmap.diagrams.hardware.network import LCM_URL

if TYPE_CHECKING:
    from slipmap.models.effects.effect import Effect
    from slipmap.models.measurements import PushDataset


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
        check_output(path, self.endings)
        return path


dataset_argument = click.argument("dataset", type=click.Path(path_type=Path))
json_option = click.option(
    "--json", "json_file", type=OutputFile(), metavar="FILE", help="Write the result as JSON."
)
json_in_folder_option = click.option(
    "--json", "json_file", type=click.Path(path_type=Path), metavar="FILE",
    help="Write the result as JSON; it may go into the folder of --out.",
)  # fmt: skip
"""For commands that make a folder first, and check the file then."""
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
    " as rect1, or a YAML file with the keys object and finger of a dataset.yaml and, where columns have"
    " other names or units, csv.",
)
effect_file_option = click.option(
    "--effect-file", "effect_files", type=click.Path(path_type=Path), multiple=True, metavar="FILE",
    help="Python file with effects of your own, beside those of the library; may be given several times.",
)  # fmt: skip


belief_output_option = click.option(
    "-o", "--output", type=OutputFile("npz"), required=True, metavar="FILE",
    help="Where the belief goes, such as belief.npz.",
)  # fmt: skip
hypotheses_option = click.option(
    "--hypotheses", type=click.IntRange(2, 1000), default=20, show_default=True, metavar="K",
    help="Hypotheses to find.",
)  # fmt: skip
pictures_option = click.option(
    "--pictures", type=click.Path(path_type=Path), metavar="DIR",
    help="Folder for the pictures; beside the belief if not given.",
)  # fmt: skip


def belief_option(*, required: bool, more: str = "") -> Callable[[Command], Command]:
    """The option `--belief FILE`."""
    return click.option(
        "--belief", "belief_file", type=click.Path(path_type=Path), required=required, metavar="FILE",
        help=f"Belief that `slipmap identify` or `slipmap fit` wrote{more}.",
    )  # fmt: skip


def report_option(default: str) -> Callable[[Command], Command]:
    """The option `--output FILE` of a report for a browser."""
    return click.option(
        "-o", "--output", type=OutputFile("html", "htm"), default=default, show_default=True, metavar="FILE",
        help="The report, one file for any browser; it needs no network.",
    )  # fmt: skip


def asked_for(option: str) -> bool:
    """Whether an option of the command that runs was given, rather than left at its default."""
    return click.get_current_context().get_parameter_source(option) is not ParameterSource.DEFAULT


def _completed(names: Callable[[], Sequence[str]]) -> Callable[..., list[str]]:
    """What a shell offers for an option whose values are names; they are asked for when it does."""
    return lambda context, parameter, begun: [name for name in names() if name.startswith(begun)]


def _effect_names() -> list[str]:
    return [effect.name for effect in find_effects(())]


def _object_names() -> Sequence[str]:
    from slipmap.models.objects.benchmark_objects import BENCHMARK_OBJECTS

    return BENCHMARK_OBJECTS


complete_objects = _completed(_object_names)
"""The six objects, for `shell_complete`."""


def effect_option(*, required: bool, purpose: str) -> Callable[[Command], Command]:
    """The option `--effect NAME`, which may be given several times."""
    return click.option(
        "--effect", "effect_names", multiple=True, required=required, metavar="NAME",
        shell_complete=_completed(_effect_names),
        help=f"{purpose}, such as table_tilt; may be given several times.",
    )  # fmt: skip


def find_effects(files: Sequence[Path]) -> tuple[Effect, ...]:
    """The library's effects, and those of some files.

    Raises:
        EffectError: a file is faulty, or has an effect of a name that is taken.
    """
    from slipmap.models.effects.registry import known_effects

    return known_effects(files)


def effects_of_library(names: Sequence[str]) -> tuple[str, ...]:
    """Names of effects of the library, as they were given.

    Raises:
        EffectError: there is no such effect, or one is named twice.
    """
    from slipmap.models.effects.registry import effects_named

    return tuple(effect.name for effect in effects_named(names)) if names else ()


def load_dataset(path: Path, object_name: str | None, progress: Progress) -> PushDataset:
    """Read a dataset, with progress, and tell what looks wrong about it.

    Raises:
        DatasetError: it cannot be used.
    """
    from slipmap.models.measurements import read_dataset

    dataset = read_dataset(
        path, object_name=object_name, progress=lambda done, total: progress("reading pushes", done, total)
    )
    for warning in dataset.warnings:
        note(f"warning: {warning}")
    return dataset


station_object_option = click.option(
    "--object", "object_name", metavar="NAME", shell_complete=complete_objects,
    help="One of the six objects: book, box, hammer, wrench, snack, spray_gun. [default: hammer]",
)  # fmt: skip
scenario_option = click.option(
    "--scenario", "scenario_file", type=click.Path(path_type=Path), metavar="FILE",
    help="YAML file that describes the cell: table, camera, noise, your own object, hidden effects.",
)  # fmt: skip
lcm_option = click.option(
    "--lcm", "url", default=LCM_URL, show_default=True, metavar="URL",
    help="Address of the cell's messages; with ttl=0 they stay on this computer.",
)  # fmt: skip
hardware_option = click.option(
    "--hardware", is_flag=True,
    help="Drive a real cell, or its twin of `slipmap station`, that listens at the address of --lcm.",
)  # fmt: skip
explorations_option = click.option(
    "--pushes", type=click.IntRange(1, 100), default=5, show_default=True, metavar="N",
    help="Pushes to learn from.",
)  # fmt: skip
meshcat_option = click.option(
    "--meshcat", "open_meshcat", is_flag=True,
    help="Serve the view and print its address; wait for Enter or Ctrl-C at the end.",
)  # fmt: skip
record_option = click.option(
    "--record", "recording", type=click.Path(path_type=Path), metavar="FILE",
    help="Write the whole run as a page that plays it back without a network.",
)  # fmt: skip


def folder_option(default: str) -> Callable[[Command], Command]:
    """The option `--out DIR` of what a run in the robot's cell leaves."""
    return click.option(
        "-o", "--out", "folder", type=click.Path(path_type=Path), default=default, show_default=True,
        metavar="DIR", help="Folder for pushes, belief, pictures and report.",
    )  # fmt: skip


# What a command reads is not what it writes.


FILES_IN_FOLDERS = ("json_file", "recording")
FOLDERS = ("folder", "output", "pictures")
"""Parameters that are written though their type does not say so."""

MEASURED = (".yaml", ".yml", ".json", ".csv", ".h5", ".hdf5")
"""Endings of files that may be part of a dataset."""


def keep_files_apart(command: click.Command) -> None:
    """Have a command refuse, before any work, to write over what it reads or two results over each other.

    Raises:
        UsageError: when the command is called so.
    """
    work = command.callback
    assert work is not None

    @wraps(work)
    def checked(**arguments: Any) -> Any:
        _check(command, arguments)
        return work(**arguments)

    command.callback = checked


def _check(command: click.Command, arguments: dict[str, Any]) -> None:
    written: list[tuple[str, Path]] = []
    read: list[Path] = []
    for param in command.params:
        for path in _paths(arguments.get(param.name or "")):
            if isinstance(param.type, OutputFile) or param.name in FILES_IN_FOLDERS:
                written.append((param.opts[-1], path))
            elif param.name not in FOLDERS:
                read.append(path)
    for (one, path), (other, same) in combinations(written, 2):
        if path.resolve() == same.resolve():
            raise click.UsageError(f"{one} and {other} both name {path}; give each a file of its own.")
    for option, path in written:
        for source in read:
            if path.resolve() == source.resolve() or _is_part(path, source):
                raise click.UsageError(
                    f"{option} {path} would write over what the command reads; name another file."
                )


def _is_part(path: Path, source: Path) -> bool:
    """Whether an existing file may be one of a dataset's."""
    if not (source.is_dir() and path.is_file() and path.suffix.lower() in MEASURED):
        return False
    return path.resolve().is_relative_to(source.resolve())


def _paths(value: Any) -> Iterator[Path]:
    values = value if isinstance(value, tuple) else (value,)
    return (entry for entry in values if isinstance(entry, Path))
