"""Arguments and options that several commands share, and checks of them before any work is done."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from functools import wraps
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from slipmap.diagrams.application.outputs import check_output
from slipmap.diagrams.application.terminal import Progress, note
from slipmap.models.files import BadInput

if TYPE_CHECKING:
    from slipmap.models.effects.effect import Effect
    from slipmap.models.measurements import PushDataset

Option = Callable[[Any], Any]
"""Adds an option to a command."""


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


def bundled(name: str, kind: Any) -> Option:
    """Pass the options that are fields of the NamedTuple `kind` to a command as one argument `name`."""

    def decorate(command: Any) -> Any:
        @wraps(command)
        def decorated(**arguments: Any) -> Any:
            values = kind(**{field: arguments.pop(field) for field in kind._fields})
            return command(**{name: values}, **arguments)

        return decorated

    return decorate


def count_option(
    name: str, *parameter: str, least: int = 1, most: int | None = None, default: int | None = None,
    metavar: str | None = "N", about: str,
) -> Option:  # fmt: skip
    """An option that takes a whole number."""
    kind = click.IntRange(least, most)
    return click.option(name, *parameter, type=kind, metavar=metavar, help=about, **_shown(default))


def path_option(
    *names: str, default: str | None = None, required: bool = False, multiple: bool = False,
    metavar: str = "FILE", about: str,
) -> Option:  # fmt: skip
    """An option that names a file or a folder, which is not checked yet."""
    return click.option(
        *names, type=click.Path(path_type=Path), required=required, multiple=multiple, metavar=metavar,
        help=about, **_shown(default),
    )  # fmt: skip


def output_option(
    *names: str, endings: Sequence[str] = (), default: str | None = None, required: bool = False, about: str
) -> Option:
    """An option that names a file to be written."""
    return click.option(
        *names, type=OutputFile(*endings), required=required, metavar="FILE", help=about, **_shown(default)
    )


def _shown(default: object) -> dict[str, Any]:
    """Settings of an option whose help shows its default; empty where there is none."""
    return {} if default is None else {"default": default, "show_default": True}


def picture_option(*names: str, default: str | None = None, about: str) -> Option:
    """An option that names a picture to be drawn."""
    return output_option(*names, endings=("png", "pdf", "svg"), default=default, about=about)


def results_option(*parameter: str, default: str, about: str = "Folder for the results.") -> Option:
    """The option `--output DIR` of a study that continues where it was stopped."""
    return click.option(
        "-o", "--output", *parameter, type=click.Path(file_okay=False, path_type=Path), metavar="DIR",
        help=about, **_shown(Path(default)),
    )  # fmt: skip


def belief_option(*, required: bool, more: str = "") -> Option:
    """The option `--belief FILE`."""
    about = f"Belief that `slipmap identify` or `slipmap fit` wrote{more}."
    return path_option("--belief", "belief_file", required=required, about=about)


def report_option(default: str) -> Option:
    """The option `--output FILE` of a report for a browser."""
    about = "The report, one file that any browser opens without a network."
    return output_option("-o", "--output", endings=("html", "htm"), default=default, about=about)


def effect_option(*, required: bool, purpose: str) -> Option:
    """The option `--effect NAME`, which may be given several times."""
    return click.option(
        "--effect", "effect_names", multiple=True, required=required, metavar="NAME",
        shell_complete=_completed(lambda: [effect.name for effect in find_effects(())]),
        help=f"{purpose}, such as table_tilt; may be repeated.",
    )  # fmt: skip


def objects_option(name: str, *, about: str, default: str = "all six") -> Option:
    """An option that names some of the six objects."""
    return click.option(
        name, "object_names", multiple=True, metavar="NAME", shell_complete=complete_objects,
        help=f"{about}; may be repeated. [default: {default}]",
    )  # fmt: skip


def _completed(names: Callable[[], Sequence[str]]) -> Callable[..., list[str]]:
    """Completes an option whose values are names; the names are looked up only then."""
    return lambda context, parameter, begun: [name for name in names() if name.startswith(begun)]


def _object_names() -> Sequence[str]:
    from slipmap.models.objects.benchmark_objects import BENCHMARK_OBJECTS

    return BENCHMARK_OBJECTS


complete_objects = _completed(_object_names)
"""The six objects, for `shell_complete`."""

dataset_argument = click.argument("dataset", type=click.Path(path_type=Path))
datasets_argument = click.argument(
    "datasets", metavar="DATASET...", type=click.Path(path_type=Path), nargs=-1, required=True
)
json_option = output_option("--json", "json_file", about="Write the result as JSON.")
json_in_folder_option = path_option(
    "--json", "json_file", about="Write the result as JSON; the file may lie in the folder of --output."
)
"""For commands that make a folder first and check the file afterwards."""
seed_option = count_option(
    "--seed", least=0, most=2**32 - 1, default=0, metavar=None, about="Seed of all random draws."
)
object_option = click.option(
    "--object",
    "object_name",
    metavar="NAME|YAML",
    help="What was pushed, for MIT and CSV files, which do not say: a shape of the MIT push dataset, such as"
    " rect1, or a YAML file with the keys object and finger of a dataset.yaml, and csv where columns have"
    " other names or units.",
)
maps_option = path_option(
    "--maps",
    about="YAML file with what is known of the object's maps: the keys under `known` in a dataset.yaml.",
)
effect_file_option = path_option(
    "--effect-file", "effect_files", multiple=True,
    about="Python file with your own effects, in addition to the library's; may be repeated.",
)  # fmt: skip
belief_output_option = output_option(
    "-o", "--output", endings=["npz"], required=True, about="File for the belief, such as belief.npz."
)
hypotheses_option = count_option(
    "--hypotheses", least=2, most=1000, default=20, metavar="K", about="Hypotheses to find."
)
pictures_option = path_option(
    "--pictures", metavar="DIR", about="Folder for the pictures. [default: that of the belief]"
)
apart_option = click.option(
    "--apart",
    multiple=True,
    type=click.Choice(["table", "tracker", "finger", "force sensor"]),
    help="What several datasets do not share; may be repeated.",
)
explorations_option = count_option("--pushes", most=100, default=5, about="Pushes to learn from.")


def asked_for(option: str) -> bool:
    """Whether an option of the running command, such as `--seed`, was given, not left at its default."""
    context = click.get_current_context()
    (name,) = [param.name for param in context.command.params if param.opts[-1] == option]
    return context.get_parameter_source(name or "") is not ParameterSource.DEFAULT


def refuse(*settled: str, because: str) -> None:
    """Refuse options that another option already determines.

    Raises:
        BadInput: one of them was given.
    """
    for option in settled:
        if asked_for(option):
            raise BadInput(f"{because}; leave out {option}")


def find_effects(files: Sequence[Path]) -> tuple[Effect, ...]:
    """The library's effects and those of some files.

    Raises:
        EffectError: a file is faulty, or names an effect like another one.
    """
    from slipmap.models.effects.registry import known_effects

    return known_effects(files)


def load_dataset(
    path: Path, object_name: str | None, progress: Progress, maps: Path | None = None, *, named: bool = False
) -> PushDataset:
    """Read a dataset with progress, and print warnings about it.

    Args:
        path: of the dataset.
        object_name: what was pushed, where the dataset does not say.
        progress: called after each trial.
        maps: file with what is known of the object's maps.
        named: whether warnings name the dataset, as where several are read.

    Raises:
        DatasetError: it cannot be used.
    """
    from slipmap.models.measurements import read_dataset

    def tell(warning: str) -> None:
        # Some begin with the path of a file in the dataset, others with the name of a push.
        where = f"{path}: " if named and not warning.startswith(str(path)) else ""
        note(f"warning: {where}{warning}")

    return read_dataset(
        path,
        object_name=object_name,
        maps=maps,
        progress=lambda done, total: progress("reading pushes", done, total),
        tell=tell,
    )


def load_together(
    paths: Sequence[Path], object_name: str | None, progress: Progress, one_only: Sequence[str] = ()
) -> list[PushDataset]:
    """Read several datasets, each of one object, for one model.

    Args:
        paths: of the datasets.
        object_name, progress: as in `load_dataset`.
        one_only: options, besides --maps, that are for one dataset.

    Raises:
        BadInput: such an option was given.
        DatasetError: a dataset cannot be used.
    """
    for option in (*one_only, "--maps"):
        if asked_for(option):
            raise BadInput(
                f"{option} is for one dataset; leave it out for several (known maps belong under `known` in"
                " each dataset.yaml)"
            )
    return [load_dataset(path, object_name, progress, named=True) for path in paths]


def refuse_apart(apart: Sequence[str]) -> None:
    """Refuse --apart for a single dataset.

    Raises:
        BadInput: it was given.
    """
    if apart:
        raise BadInput("--apart says what several datasets do not share; give two or more")


def typed(*paths: Path) -> str:
    """Paths as a command takes them."""
    return shlex.join(map(str, paths))


def datasets_typed() -> str:
    """The datasets of the running command, with the options that say how to read and explain them, as other
    commands take them."""
    given = click.get_current_context().params
    words = [str(path) for name in ("dataset", "datasets") for path in _listed(given.get(name))]
    for option, name in _OF_DATASETS.items():
        words += [word for value in _listed(given.get(name)) for word in (option, str(value))]
    return shlex.join(words)


_OF_DATASETS = {
    "--object": "object_name", "--maps": "maps", "--apart": "apart", "--effect-file": "effect_files",
}  # fmt: skip


def _listed(value: Any) -> tuple[Any, ...]:
    """The values of a parameter that may be given once, several times or not at all."""
    return value if isinstance(value, tuple) else () if value is None else (value,)


# Parameters that name outputs although their type does not say so.
_FILES_IN_FOLDERS = ("json_file", "recording")
_FOLDERS = ("folder", "output", "pictures")
_MEASURED = (".yaml", ".yml", ".json", ".csv", ".h5", ".hdf5")  # files that may be part of a dataset


def keep_files_apart(command: click.Command) -> None:
    """Make a command refuse, before any work, to overwrite its inputs or to write two results to one file.

    Raises:
        UsageError: raised when the command is called like that.
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
        for path in _listed(arguments.get(param.name or "")):
            if not isinstance(path, Path):
                continue
            if isinstance(param.type, OutputFile) or param.name in _FILES_IN_FOLDERS:
                written.append((param.opts[-1], path))
                if path.suffix.lower() == ".npz":  # a belief, beside which pictures are drawn
                    folder = arguments.get("pictures") or path.parent
                    written += [
                        (f"a picture of {param.opts[-1]}", folder / f"{path.stem}.{what}.png")
                        for what in ("maps", "pushes")
                    ]
            elif param.name not in _FOLDERS:
                read.append(path)
    for (one, path), (other, same) in combinations(written, 2):
        if path.resolve() == same.resolve():
            raise click.UsageError(f"{one} and {other} both name {path}; give each its own file.")
    for option, path in written:
        for source in read:
            if path.resolve() == source.resolve() or _is_part(path, source):
                raise click.UsageError(
                    f"{option} {path} would overwrite what the command reads; name another file."
                )


def _is_part(path: Path, source: Path) -> bool:
    """Whether an existing file may belong to a dataset."""
    if not (source.is_dir() and path.is_file() and path.suffix.lower() in _MEASURED):
        return False
    return path.resolve().is_relative_to(source.resolve())
