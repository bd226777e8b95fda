"""Read push measurements: a folder of the format push-dataset/1, with a dataset.yaml and one JSON file per
push, or files of pushes without a description."""

import logging
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from slipmap.models.measurements import csv_files, mit_files, parsing
from slipmap.models.measurements.known_maps import with_known_maps
from slipmap.models.measurements.parsing import Fingerprint
from slipmap.models.measurements.push_dataset import Noise, PushDataset, Setup, Table, dataset_of
from slipmap.models.measurements.sessions import cut_at_carries
from slipmap.models.measurements.setup_description import SETUP_KEYS, parse_setup, setup_document
from slipmap.models.measurements.trial import CHANNELS, LAST_PLACE, DatasetError, Role, Trial, in_order
from slipmap.models.measurements.trial_checks import check_trials
from slipmap.models.measurements.trial_tables import IN_DEGREES, json_tables, trial_from_tables
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.progress import StageProgress
from slipmap.models.settings import check_kind, check_whole

FORMAT = "push-dataset/1"
IMPORTED = "imported from "
"""Start of the sentence of provenance with which every imported dataset begins."""
DESCRIPTION_FILE = "dataset.yaml"
Entry = tuple[str, Role]
Reader = Callable[[str, Role, bytes, str], tuple[list[Trial], list[str]]]

_LOG = logging.getLogger("slipmap.measurements")
_YAML_ENDINGS = (".yaml", ".yml")
_MIT_ENDINGS = mit_files.JSON_ENDINGS + mit_files.HDF5_ENDINGS
_HELDOUT_SHARE = 4
_MOST_NAMED = 5  # most files named in one warning
_KINDS = (
    "a push dataset (a folder with a dataset.yaml), MIT push files (.json, .h5, .hdf5) or CSV files (.csv)"
)


def read_dataset(
    path: str | os.PathLike[str],
    *,
    object_name: str | None = None,
    progress: StageProgress | None = None,
    keep_all: bool = False,
    maps: str | os.PathLike[str] | None = None,
    tell: Callable[[str], object] = _LOG.warning,
) -> PushDataset:
    """Read push measurements.

    There are three kinds, recognised by what `path` is:

    - a folder with a `dataset.yaml`, or that file: format push-dataset/1;
    - JSON or HDF5 files of the MIT push dataset, one or a folder of them. They store the force of the object
      on the finger, so all three columns are negated. The object is taken from `shape=...` in the file names;
    - CSV files, one or a folder of them; see `csv_files` for the columns. Their force is already that of the
      finger on the object.

    MIT and CSV files do not state roles: the last quarter (rounded down) is heldout, in the order of their
    names, in which numbers count by value (push_2 before push_10). A file in which the object is carried
    while the finger is away is cut into its pushes there.

    Inconsistencies are reported and kept in the dataset's `warnings`. Single pushes whose geometry is wrong
    while that of the others is right are left out; errors common to all pushes stay, for `diagnose`.

    Args:
        object_name: what was pushed, for MIT and CSV files: a shape of the MIT dataset (rect1, hex, ...; with
            its mass and the 4.75 mm finger) or a YAML file with the keys object, finger and, if wanted, name,
            description, table, gravity, noise of a dataset.yaml, and csv, see `parse_columns`.
        progress: called after each trial with the number read and the total.
        keep_all: leave no push out; in a push dataset, `keep: true` or `keep: false` beside a file in
            `trials` forces either for that push.
        maps: YAML file of what is known about the object's maps, instead of `known` in a dataset.yaml.
        tell: called with each warning; by default Python's logging, which shows it.

    Raises:
        DatasetError: any fault in the files; the message names file, trial and row.

    Example:
        >>> import tempfile
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(fit=2, heldout=0)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = slipmap.write_dataset(dataset, folder + "/pushes")
        ...     [trial.name for trial in slipmap.read_dataset(path).trials]
        ['trials/000.json', 'trials/001.json']
    """
    dataset = _read(path, object_name, progress, keep_all)
    if maps is not None:
        dataset = with_known_maps(dataset, maps)
    for warning in dataset.warnings:
        tell(warning)
    return dataset


def dataset_from_arrays(
    pushes: Sequence[Mapping[str, ArrayLike]],
    grid: CellGrid,
    *,
    finger_radius: float,
    heldout: int | None = None,
    name: str = "pushes",
    description: str = "",
    mass: float | None = None,
    height: float | None = None,
    finger_height: float | None = None,
    table: Table | None = None,
    gravity: float = 9.81,
    noise: Noise | None = None,
    keep_all: bool = False,
    tell: Callable[[str], object] = _LOG.warning,
) -> PushDataset:
    """A dataset of arrays, which are checked as files are by `read_dataset`.

    Each push is a mapping of its sensors to rows, each sensor with its own times:

    - `object_pose`: (T, 4) time (s), x, y (m) and theta (rad) of the object frame in the world frame;
    - `tip_pose`: (T, 3) time (s), x, y (m) of the finger's centre in the world frame, or (T, 4) with the
      finger's angle about its axis (rad), which counts if it turns;
    - `ft_wrench`, if force was measured: (T, 3) time (s) and force of the finger on the object in the world
      frame (N), or (T, 4) with the torque about the finger's axis (N·m).

    Rows with NaN are left out. Pushes that cannot be pushes, as in millimetres, are told or left out.

    Args:
        pushes: in the order of the experiment.
        grid: the object's cells.
        finger_radius: m.
        heldout: number of last pushes to hold out; if None, a quarter, rounded down.
        name, description: of the dataset.
        mass, height: of the object, kg and m, where known.
        finger_height: of the finger's lower end above the table, m, where known.
        table: the table top, where known.
        gravity: m/s².
        noise: standard deviations of the sensors, where known.
        keep_all, tell: as in `read_dataset`.

    Raises:
        DatasetError: an array of another shape, times that do not increase, numbers too large for their unit,
            or a description that a file must not contain, such as a radius that is not positive; names push
            and array.
        ValueError: a number of held-out pushes that is no whole number from 0.
        TypeError: something else than mappings of arrays and a grid.

    Example:
        >>> import numpy as np
        >>> import slipmap
        >>> grid = slipmap.cells_from_polygon([[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]])
        >>> time = np.linspace(0.0, 1.0, 101)
        >>> way = 0.05 * np.maximum(time - 0.1, 0.0)  # pushed at the middle of a side, along +y
        >>> poses = np.column_stack([time, 0.0 * time, way, 0.0 * time])
        >>> tips = np.column_stack([time, 0.0 * time, 0.05 * (time - 0.1) - 0.038])
        >>> pushes = [{"object_pose": poses, "tip_pose": tips}]
        >>> slipmap.dataset_from_arrays(pushes, grid, finger_radius=0.008)
        PushDataset('pushes': 72 cells; 1 push to fit, 0 held out)
    """
    check_kind("grid", grid, CellGrid, "such as slipmap.cells_from_polygon returns")
    trials: list[Trial] = []
    doubts: list[tuple[str, str, str]] = []
    for number, arrays in enumerate(pushes):
        where = f"push {number}"
        check_kind(where, arrays, Mapping, f"with the arrays {', '.join(CHANNELS)}")
        tables = {channel: _rows(arrays[channel], channel, where) for channel in _known(arrays, where)}
        trial, told = trial_from_tables(f"trials/{number:03d}.json", "fit", tables, where)
        trials.append(trial)
        doubts += [(where, where, doubt) for doubt in told]
    if heldout is not None:
        check_whole("heldout", heldout, 0)
        if heldout > len(trials):
            raise DatasetError(f"heldout: there are {len(trials)} pushes, so {heldout} cannot be held out")
    check_kind("name", name, str, "for messages and reports")
    if noise is not None:
        check_kind("noise", noise, Noise, "such as slipmap.models.measurements.Noise(position=2e-4)")
    if table is not None:
        check_kind("table", table, Table, "such as slipmap.models.measurements.Table('round', (0, 0), 0.5)")
    dataset = dataset_of(
        last_held_out(trials, heldout), grid, name=name, description=description,
        finger_radius=finger_radius, mass=mass, height=height, finger_height=finger_height, table=table,
        gravity=gravity, noise=noise or Noise(),
    )  # fmt: skip
    stays = True if keep_all else None
    kept, told = check_trials(dataset, dataset.trials, name, lambda trial: stays)
    _, of_setup = parse_setup(setup_document(dataset), name, name)
    warnings = (*of_setup, *_gathered(doubts), *told)
    for warning in warnings:
        tell(warning)
    if keep_all:
        kept = [replace(trial, kept=True) for trial in kept]
    return replace(dataset, trials=tuple(kept), warnings=warnings)


_COLUMNS = {
    "object_pose": ((4,), "time s, x m, y m, theta rad"),
    "tip_pose": ((3, 4), "time s, x m, y m, perhaps theta rad"),
    "ft_wrench": ((3, 4), "time s, force_x N, force_y N"),
}
"""Numbers of columns that an array may have, and their meaning."""


def _known(arrays: Mapping[str, ArrayLike], where: str) -> list[str]:
    """Names of the arrays of a push; refuses others."""
    for key in arrays:
        if key not in CHANNELS:
            raise DatasetError(f"{where}: unknown array {key!r}; a push has {', '.join(CHANNELS)}")
    return [key for key in arrays if arrays[key] is not None]


def _rows(array: ArrayLike, channel: str, where: str) -> FloatArray:
    """Rows (T, 3 or 4) of a channel; a torque that is missing is NaN."""
    columns, meaning = _COLUMNS[channel]
    where = f"{where}, {channel}"
    try:
        rows: FloatArray = np.ma.filled(np.ma.asarray(array, dtype=float), np.nan)
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{where}: needs an array of numbers ({error})") from None
    if rows.ndim != 2 or rows.shape[1] not in columns:
        turned = "; give its transpose" if rows.ndim == 2 and rows.shape[0] in columns else ""
        raise DatasetError(f"{where}: needs rows ({meaning}), but has the shape {rows.shape}{turned}")
    if channel == "ft_wrench" and rows.shape[1] == 3:
        return np.column_stack([rows, np.full(len(rows), np.nan)])
    return rows


def _read(
    path: str | os.PathLike[str], object_name: str | None, progress: StageProgress | None, keep_all: bool
) -> PushDataset:
    source = Path(path)
    try:
        if not source.exists():
            raise DatasetError(f"{str(source)!r}: there is no such file or folder; expected {_KINDS}")
        is_folder = source.is_dir()
        description = source / DESCRIPTION_FILE if is_folder else source
        if is_folder and object_name is None and not description.exists():
            _refuse_parent_of_datasets(source)
        if not (description.exists() if is_folder else _is(source, _YAML_ENDINGS)):
            return _read_files(source, object_name, progress, keep_all)
        if object_name is not None:
            raise DatasetError(
                f"{description}: a push dataset describes its own object; leave out the object's name"
            )
        return _read_push_format(description, progress, keep_all)
    except OSError as error:
        raise DatasetError(f"{str(path)!r} cannot be read ({error})") from None


def was_imported(provenance: Iterable[str]) -> bool:
    """Whether a dataset with this provenance was imported from a laboratory's own files."""
    return any(text.startswith(IMPORTED) for text in provenance)


def check_format(document: dict[str, Any], where: str) -> None:
    """Refuse a description whose `format` is missing or different.

    Raises:
        DatasetError: the message names the format that can be read.
    """
    found = parsing.required(document, "format", where, f"a push dataset needs `format: {FORMAT}`")
    if found != FORMAT:
        raise DatasetError(f"{where}: format is {parsing.shown(found)}, but only {FORMAT} can be read")


def _assembled(
    setup: Setup,
    fingerprint: Fingerprint,
    warnings: list[str],
    source: Path,
    folder: Path,
    entries: Sequence[Entry],
    read: Reader,
    progress: StageProgress | None,
    keep: Callable[[Trial], bool | None],
    assign: Callable[[list[Trial]], list[Trial]] | None = None,
    imported: bool = False,
) -> PushDataset:
    """Assemble a dataset from files in a folder, each read from its name, role, content and path.

    `keep` tells whether a trial stays whatever the checks find, goes, or is judged (None). `assign` gives all
    trials their roles if files may contain several pushes.
    """
    trials: list[Trial] = []
    found: list[tuple[str, str, str]] = []
    faults: list[str] = []
    for index, (name, role) in enumerate(entries):
        try:
            content = parsing.read_bytes(folder / name)
            fingerprint.add(name, content)
            pushes, doubts = read(name, role, content, str(folder / name))
            if assign is not None:
                pushes, cuts = cut_at_carries(setup, pushes, str(folder / name))
                doubts = [*doubts, *(cut.text for cut in cuts)]
        except DatasetError as error:
            faults.append(str(error))
            continue
        trials += pushes
        found += [(f"{folder / name}", name, doubt) for doubt in doubts]
        if progress is not None:
            progress(index + 1, len(entries))
    if faults:
        raise parsing.all_faults(faults, len(entries), "files")
    if assign is not None:
        trials = assign(trials)
    trials = list(in_order(trials))  # before the checks leave some out
    trials, doubts = check_trials(setup, trials, str(source), keep, imported)
    trials = [replace(trial, kept=True) if keep(trial) else trial for trial in trials]
    warnings += _gathered(found) + doubts
    return PushDataset(
        **vars(setup), trials=tuple(trials), fingerprint=fingerprint.hexdigest(), warnings=tuple(warnings)
    )


def _gathered(found: Sequence[tuple[str, str, str]]) -> list[str]:
    """Warnings about files with these paths and names, one per kind, which names all files that share it."""
    kinds: dict[str, list[tuple[str, str, str]]] = {}
    for path, name, doubt in found:
        place, _, fault = doubt.removeprefix(path).partition(": ")
        # Every angle in degrees has numbers of its own; those of the first are enough.
        kind = IN_DEGREES if IN_DEGREES in fault else fault
        kinds.setdefault(kind, []).append((name + place, fault, doubt))
    texts = []
    for alike in kinds.values():
        if len(alike) == 1:
            texts.append(alike[0][2])
        else:
            more = f" and {len(alike) - _MOST_NAMED} more" if len(alike) > _MOST_NAMED else ""
            fault = alike[0][1].replace(f". {IN_DEGREES}", f", in the first. {IN_DEGREES}")
            texts.append(f"{'; '.join(place for place, _, _ in alike[:_MOST_NAMED])}{more}: {fault}")
    return texts


# A folder of the format push-dataset/1.


def _read_push_format(description: Path, progress: StageProgress | None, keep_all: bool) -> PushDataset:
    where = str(description)
    content, document = parsing.read_yaml(description, where)
    check_format(document, where)
    setup, warnings = parse_setup(document, where, default_name=description.resolve().parent.name)
    warnings += parsing.unknown_keys(document, ("format", "trials", "provenance", *SETUP_KEYS), where)
    fingerprint = Fingerprint()
    fingerprint.add(DESCRIPTION_FILE, content)
    entries, forced, orders = _entries(document, description.parent, where, warnings)
    folder = description.parent
    told = document.get("provenance") or []
    if not isinstance(told, list):
        raise DatasetError(f"{where}: provenance must be a list of sentences, got {parsing.shown(told)}")
    provenance = tuple(parsing.text(one, f"{where}: provenance") for one in told)
    dataset = _assembled(
        setup, fingerprint, warnings, description, folder, entries,
        _one(partial(_read_record, orders)), progress,
        keep=lambda trial: forced.get(trial.name, True if keep_all else None),
        imported=was_imported(provenance),
    )  # fmt: skip
    return replace(dataset, provenance=provenance)


def _entries(
    document: dict[str, Any], folder: Path, where: str, warnings: list[str]
) -> tuple[list[Entry], dict[str, bool], dict[str, int]]:
    """The trials listed in a description, which of them it says to keep or drop, and the order of each."""
    listed = parsing.required(
        document, "trials", where, "list the trials, [{file: trials/000.json, role: fit}]"
    )
    if not isinstance(listed, list) or not listed:
        raise DatasetError(
            f"{where}: trials must be a list of one or more entries, got {parsing.shown(listed)}"
        )
    entries: list[Entry] = []
    forced: dict[str, bool] = {}
    orders: dict[str, int] = {}
    taken: set[int] = set()
    files: dict[Path, int] = {}
    for row, value in enumerate(listed):
        place = f"{where}: trials, row {row}"
        entry = parsing.section(value, ("file", "role", "keep", "order"), place, warnings)
        name = parsing.text(parsing.required(entry, "file", place, "name the trial's file"), f"{place}: file")
        role = entry.get("role", "fit")
        if role not in get_args(Role):
            raise DatasetError(f"{place}: role must be fit or heldout, got {parsing.shown(role)}")
        file = _inside(folder, name, place)
        if file in files:
            raise DatasetError(f"{place}: {name} is listed twice (first in row {files[file]}); list it once")
        files[file] = row
        if "keep" in entry:
            if not isinstance(entry["keep"], bool):
                raise DatasetError(
                    f"{place}: keep must be true or false, got {parsing.shown(entry['keep'])}; leave it out"
                    " to have the push judged"
                )
            forced[name] = entry["keep"]
        order = entry.get("order", row)
        if isinstance(order, bool) or not (isinstance(order, int) and 0 <= order <= LAST_PLACE):
            raise DatasetError(
                f"{place}: order must be a whole number from 0 to {LAST_PLACE}, got {parsing.shown(order)}"
            )
        if order in taken:
            raise DatasetError(
                f"{place}: order {order} is also that of another trial; a trial without `order` has its row's"
            )
        taken.add(order)
        orders[name] = order
        entries.append((name, role))
    return entries, forced, orders


def _inside(folder: Path, name: str, where: str) -> Path:
    """The resolved path of a file named relative to a folder; it must not lie outside, not even by a link."""
    try:
        path = (folder / name).resolve()
        root = folder.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise DatasetError(f"{where}: {parsing.shown(name)} is not a usable file name ({error})") from None
    if Path(name).is_absolute() or not path.is_relative_to(root):
        raise DatasetError(
            f"{where}: {parsing.shown(name)} lies outside the dataset's folder; trial files belong inside it"
        )
    return path


def _read_record(
    orders: dict[str, int], name: str, role: Role, content: bytes, where: str
) -> tuple[Trial, list[str]]:
    arrays = parsing.mapping(parsing.parse_json(content, where), where)
    trial, doubts = trial_from_tables(name, role, json_tables(arrays, where), where)
    return replace(trial, order=orders[name]), parsing.unknown_keys(arrays, CHANNELS, where) + doubts


# Files of pushes whose object is named or described elsewhere.


def _refuse_parent_of_datasets(source: Path) -> None:
    """Raise DatasetError if folders in this one are datasets, as in a run's folder."""
    inside = sorted(found.parent for found in source.glob(f"*/{DESCRIPTION_FILE}"))
    if inside:
        names = ", ".join(map(str, inside[:3])) + (" …" if len(inside) > 3 else "")
        raise DatasetError(f"{source}: this folder is not a dataset but holds some; give one: {names}")


def _read_files(
    source: Path, object_name: str | None, progress: StageProgress | None, keep_all: bool
) -> PushDataset:
    files = _record_files(source) if source.is_dir() else [source]
    fingerprint = Fingerprint()
    read: Reader
    if _is(files[0], csv_files.CSV_ENDINGS):
        setup, warnings, columns = _setup(object_name, None, source, fingerprint)
        read = partial(csv_files.read_csv_trials, columns=columns)
    elif _is(files[0], _MIT_ENDINGS):
        _refuse_part_of_a_dataset(files[0])
        setup, warnings, _ = _setup(object_name, mit_files.named_shape(files), source, fingerprint)
        warnings += mit_files.surface_warnings(files)
        read = _one(mit_files.read_mit_trial)
    else:
        raise DatasetError(f"{source}: this kind of file cannot be read; expected {_KINDS}")
    entries: list[Entry] = [(file.name, "fit") for file in files]
    return _assembled(
        setup, fingerprint, warnings, source, files[0].parent, entries, read, progress,
        keep=lambda trial: True if keep_all else None, assign=last_held_out,
    )  # fmt: skip


def _one(read: Callable[[str, Role, bytes, str], tuple[Trial, list[str]]]) -> Reader:
    """A reader of files that contain one push each."""

    def read_all(name: str, role: Role, content: bytes, where: str) -> tuple[list[Trial], list[str]]:
        trial, doubts = read(name, role, content, where)
        return [trial], doubts

    return read_all


def last_held_out(trials: list[Trial], count: int | None = None) -> list[Trial]:
    """Trials with so many of the last held out; if None, a quarter, rounded down."""
    learned = len(trials) - (len(trials) // _HELDOUT_SHARE if count is None else count)
    return trials[:learned] + [replace(trial, role="heldout") for trial in trials[learned:]]


def _is(file: Path, endings: tuple[str, ...]) -> bool:
    return file.suffix.lower() in endings


def _record_files(folder: Path) -> list[Path]:
    files = sorted(
        (
            file
            for file in folder.iterdir()
            if _is(file, _MIT_ENDINGS + csv_files.CSV_ENDINGS) and not file.name.startswith(".")
        ),
        key=parsing.by_numbers,
    )
    if not files:
        raise DatasetError(f"{folder}: contains no measurements; expected {_KINDS}")
    if len({_is(file, csv_files.CSV_ENDINGS) for file in files}) > 1:
        raise DatasetError(
            f"{folder}: contains both CSV and MIT push files; put each kind into a separate folder"
        )
    return files


def _refuse_part_of_a_dataset(file: Path) -> None:
    for folder in file.resolve().parents[:2]:
        if (folder / DESCRIPTION_FILE).exists():
            raise DatasetError(
                f"{file}: belongs to the push dataset {folder}, whose forces have the opposite sign to"
                " those of MIT files; read that folder instead"
            )


def _setup(
    object_name: str | None, named: str | None, source: Path, fingerprint: Fingerprint
) -> tuple[Setup, list[str], csv_files.CsvColumns]:
    """Setup from a named shape or a YAML file, warnings, and columns of CSV files.

    `named` is the shape in the measurements' own file names.
    """
    chosen = object_name or named
    if chosen is None:
        raise DatasetError(
            f"{source}: does not say which object was pushed; give --object (in Python object_name) with a"
            f" shape of the MIT dataset ({', '.join(sorted(mit_files.MIT_SHAPES))}) or a YAML file with the"
            f" keys object and finger of a {DESCRIPTION_FILE}"
        )
    if not _is_description(chosen) and named is not None and named != chosen:
        mit_files.mit_shape(chosen, str(source))
        raise DatasetError(
            f"{source}: the file names say shape={named}, not {chosen}; leave out the object's name"
        )
    document = object_document(chosen, fingerprint, str(source))
    where = chosen if _is_description(chosen) else str(source)
    setup, warnings = parse_setup(document, where, default_name=source.stem)
    warnings += parsing.unknown_keys(document, ("format", "trials", "csv", *SETUP_KEYS), where)
    return setup, warnings, csv_files.parse_columns(document.get("csv"), f"{where}: csv")


def _is_description(chosen: str) -> bool:
    return chosen not in mit_files.MIT_SHAPES and _is(Path(chosen), _YAML_ENDINGS)


def object_document(chosen: str, fingerprint: Fingerprint, where: str = "--object") -> dict[str, Any]:
    """The keys of a dataset.yaml that describe an object, from a YAML file or for a shape of the MIT dataset.

    Raises:
        DatasetError: the file cannot be read, or there is no such shape.
    """
    if _is_description(chosen):
        content, document = parsing.read_yaml(Path(chosen), chosen)
        fingerprint.add("object", content)
        return document
    shape = mit_files.mit_shape(chosen, where)
    fingerprint.add("object", chosen.encode())
    return {
        "description": f"Pushes of {chosen} of the MIT push dataset (Yu et al. 2016)",
        "object": {"outline": shape.outline.tolist(), "height": mit_files.THICKNESS, "mass": shape.mass},
        "finger": {"radius": mit_files.FINGER_RADIUS},
    }
