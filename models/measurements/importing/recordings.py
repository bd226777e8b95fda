"""From a laboratory's files to a push dataset: group the files that belong together into recordings, and find
the pushes in them."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slipmap.models.geometry import angle_between, rotated
from slipmap.models.measurements import parsing
from slipmap.models.measurements.contact import contact_rows, middle_angle, normals_and_forces
from slipmap.models.measurements.importing.clocks import Lag, finger_lag, force_lag, usual_lag
from slipmap.models.measurements.importing.files import find_files, read_sources
from slipmap.models.measurements.importing.force_bias import Bias, force_at_rest, unknown_biases, usual_bias
from slipmap.models.measurements.importing.import_setup import (
    CONTACT,
    ChannelSetup,
    ImportSetup,
    parse_import_setup,
)
from slipmap.models.measurements.importing.mapping import is_there, mapped, times
from slipmap.models.measurements.importing.source import Source, names_in, rows_named
from slipmap.models.measurements.parsing import Fingerprint, all_faults
from slipmap.models.measurements.push_dataset import PushDataset, Setup
from slipmap.models.measurements.reading import IMPORTED, last_held_out, object_document
from slipmap.models.measurements.sessions import cut_at_carries, cut_at_rests
from slipmap.models.measurements.trial import CHANNELS, Channel, DatasetError, Trial, in_order
from slipmap.models.measurements.trial_checks import check_trials
from slipmap.models.measurements.trial_tables import LONGEST_PUSH, refuse_long, trial_from_tables
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.progress import StageProgress

_LOG = logging.getLogger("slipmap.measurements")
_EPOCH = 1e6  # s above which a clock counts from 1970 or another distant day
_NOWHERE = 100.0  # m from the object, where an absent finger is placed
_LONGEST = 1e5  # s of a recording
_FEWEST_ROWS = 10  # rows of a push after which stamps may start again,
_NEAR_START = 0.1  # within this share of its duration from where they began


def import_dataset(
    sources: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    setup: str | os.PathLike[str],
    *,
    object_name: str | None = None,
    progress: StageProgress | None = None,
    tell: Callable[[str], object] = _LOG.warning,
) -> PushDataset:
    """Import a push dataset from a laboratory's own files: motion-capture exports, robot logs, bags, tables.

    Files that belong together form one recording: those whose patterns match the same text at the `*`. A
    recording is brought to one clock, cut into pushes where the object rests and the finger leaves it, where
    the object is carried, or where nothing was recorded for a while, and checked as in `read_dataset`. The
    processing steps are listed in the dataset's `provenance`. The last quarter of the pushes is held out,
    unless the setup names others.

    Args:
        sources: files and folders.
        setup: a setup.yaml: object and finger as in a dataset.yaml, and where pose, finger and force are; see
            docs/import.md.
        object_name: what was pushed, if the setup does not state it, as in `read_dataset`.
        progress: called after each recording with the number done and the total.
        tell: called with each warning.

    Raises:
        DatasetError: the setup is wrong, or files cannot be used; one message names all of them.

    Example:
        >>> import pathlib, tempfile
        >>> import slipmap
        >>> folder = pathlib.Path(tempfile.mkdtemp())
        >>> rows = [f"{t} {min(t, 50)} 0 0 {min(t, 50) - 26} 0" for t in range(80)]
        >>> _ = (folder / "push.txt").write_text("k x y theta a b" + chr(10) + chr(10).join(rows))
        >>> _ = (folder / "setup.yaml").write_text('''
        ... object: {outline: [[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]]}
        ... finger: {radius: 0.006}
        ... unit: mm
        ... time: k
        ... rate: 100
        ... object_pose: {position: [x, y], angle: theta}
        ... tip_pose: {position: [a, b]}
        ... ''')
        >>> dataset = slipmap.import_dataset(folder / "push.txt", folder / "setup.yaml")
        >>> [trial.name for trial in dataset.trials], dataset.trials[0].tip_pose.values[0].round(3).tolist()
        (['push.txt'], [-0.026, 0.0])
    """
    where = str(setup)
    content, document = parsing.read_yaml(Path(setup), where)
    fingerprint = Fingerprint()
    fingerprint.add("setup.yaml", content)
    described = object_document(object_name, fingerprint) if object_name else None
    said = parse_import_setup(document, where, Path(setup).stem, described)
    files = find_files(sources)
    groups = _recordings(files, said, where)
    reader = _Files(files, said, fingerprint)
    found: dict[str, _Recording | DatasetError] = {}
    for number, name in enumerate(groups, 1):
        found[name] = _attempt(name, groups[name], said, reader)
        if progress is not None:
            progress(number, len(groups))
    usual = usual_lag([lag for one in _good(found).values() for lag in one.force_lags])
    if usual is not None:
        for name, one in found.items():
            if isinstance(one, DatasetError) or any(_stands_alone(lag, usual) for lag in one.force_lags):
                found[name] = _attempt(name, groups[name], said, reader, usual)
    if faults := [str(one) for one in found.values() if isinstance(one, DatasetError)]:
        raise all_faults(faults, len(groups), "recordings")
    read = _good(found)
    bias = usual_bias([bias for one in read.values() for bias in one.biases.values()])
    if bias is not None:
        for name, one in read.items():
            if None in one.biases.values():
                read[name] = _recording(name, groups[name], said, reader, usual, bias)
    done: dict[str, list[str]] = {}
    warnings = list(said.warnings)
    warnings += unknown_biases({label: bias for one in read.values() for label, bias in one.biases.items()})
    for one in read.values():
        warnings += one.doubts
        for label, step in dict.fromkeys(one.steps):
            done.setdefault(step, []).append(label)
    parts = len({label for one in read.values() for label in one.labels})
    warnings = parsing.grouped(warnings, parsing.NUMBER)
    trials = _with_roles([trial for one in read.values() for trial in one.trials], said.heldout, where)
    kept, doubts = check_trials(said.setup, in_order(trials), where)
    provenance = (
        f"{IMPORTED}{parsing.listed(list(files))}",
        *(
            step if len(labels) == parts else f"{parsing.listed(labels)}: {step}"
            for step, labels in done.items()
        ),
        *warnings,
    )
    for warning in (*warnings, *doubts):
        tell(warning)
    return PushDataset(
        **vars(said.setup), trials=tuple(kept), fingerprint=fingerprint.hexdigest(),
        warnings=(*warnings, *doubts), provenance=tuple(" ".join(text.split()) for text in provenance),
    )  # fmt: skip


def _with_roles(trials: list[Trial], heldout: Sequence[str] | None, where: str) -> list[Trial]:
    """The pushes with those held out that a setup names, or the last quarter."""
    if heldout is None:
        return last_held_out(trials)
    names = [trial.name for trial in trials]
    strangers = [name for name in heldout if name not in names]
    if strangers:
        raise DatasetError(
            f"{where}: heldout: no push is named {parsing.listed(strangers)}; there are"
            f" {parsing.listed(names)}"
        )
    return [replace(trial, role="heldout") if trial.name in heldout else trial for trial in trials]


# Which files belong together.


def _recordings(files: Mapping[str, Path], said: ImportSetup, where: str) -> dict[str, dict[str, str]]:
    """The file of each channel, for each recording; recordings are named after the file of the poses."""
    keyed = {
        name: {key: file for file in files if (key := _key(channel.source, file)) is not None}
        for name, channel in said.channels.items()
    }
    for name, found in keyed.items():
        if not found and said.channels[name].named:
            raise DatasetError(
                f"{where}: {name}.source: no file matches {parsing.shown(said.channels[name].source)};"
                f" there are {parsing.listed(list(files))}"
            )
    groups: dict[str, dict[str, str]] = {}
    for key, file in keyed["object_pose"].items():
        group = {}
        for name, found in keyed.items():
            if key in found:
                group[name] = found[key]
            elif len(found) == 1:  # one file for all recordings, such as a robot's daily log
                group[name] = next(iter(found.values()))
            elif said.channels[name].named:
                raise DatasetError(
                    f"{where}: {name}.source: no file goes with {file}; the * of both patterns must match the"
                    " same text"
                )
        groups[file] = group
    return groups


def _key(pattern: str, name: str) -> str | None:
    """The text matched by the `*` of a pattern in a file's name; None if it does not match."""
    expression = ".*".join(re.escape(part) for part in pattern.split("*"))
    match = re.fullmatch(expression.replace(".*", "(.*)"), name)
    if match is None and "/" not in pattern:
        match = re.fullmatch(expression.replace(".*", "(.*)"), name.rpartition("/")[2])
        if match is not None and match.groups():
            return "/".join((name.rpartition("/")[0], *match.groups()))
    return None if match is None else "/".join(match.groups())


class _Files:
    """Tables of files, each read once; only the last few are kept."""

    def __init__(self, files: Mapping[str, Path], said: ImportSetup, fingerprint: Fingerprint) -> None:
        self._files, self._said, self._fingerprint = files, said, fingerprint
        self._read: dict[str, list[Source]] = {}
        self._added: set[str] = set()

    def tables(self, name: str) -> list[Source]:
        """The tables of a file. Raises DatasetError."""
        if name not in self._read:
            path = self._files[name]
            while len(self._read) > len(CHANNELS):
                self._read.pop(next(iter(self._read)))
            self._read[name] = read_sources(path, name, self._said.parts)
            if name not in self._added:
                self._added.add(name)
                for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
                    if file.is_file():
                        self._fingerprint.add(name, file.read_bytes())
        return self._read[name]

    def table(self, file: str, channel: ChannelSetup) -> Source:
        """The table of a channel. Raises DatasetError if the choice is ambiguous."""
        tables = self.tables(file)
        if channel.part:
            wanted = channel.part.strip("/").lower()
            found = [table for table in tables if table.part.strip("/").lower() == wanted]
            if not found:
                found = [t for t in tables if t.part.strip("/").lower().split(":")[-1] == wanted]
            if not found and len(tables) == 1:
                found = rows_named(tables[0], channel.part)
        else:
            found = tables
        if len(found) == 1 or (found and not channel.part and len(tables) == 1):
            return found[0]
        parts = parsing.listed([table.part for table in tables if table.part] or names_in(tables[0]))
        if channel.part:
            raise DatasetError(
                f"{tables[0].file}: has no part {parsing.shown(channel.part)}; there are {parts or 'none'}"
            )
        raise DatasetError(f"{tables[0].file}: has several parts; name one with `part`: {parts}")


# One recording.


@dataclass(frozen=True)
class _Recording:
    trials: list[Trial] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)  # what looks wrong
    labels: list[str] = field(default_factory=list)  # of the parts separated by push numbers or stamps
    steps: list[tuple[str, str]] = field(default_factory=list)  # label, and what was done
    force_lags: list[Lag | None] = field(default_factory=list)  # of each part with a force to be aligned
    biases: dict[str, Bias | None] = field(default_factory=dict)  # of each part's force, None if unknown


def _good(found: Mapping[str, _Recording | DatasetError]) -> dict[str, _Recording]:
    return {name: one for name, one in found.items() if not isinstance(one, DatasetError)}


def _attempt(
    name: str, group: Mapping[str, str], said: ImportSetup, reader: _Files, usual: Lag | None = None
) -> _Recording | DatasetError:
    """The pushes of a recording, or why it cannot be used."""
    try:
        return _recording(name, group, said, reader, usual)
    except DatasetError as error:
        return error


def _recording(
    name: str,
    group: Mapping[str, str],
    said: ImportSetup,
    reader: _Files,
    usual: Lag | None = None,
    bias: FloatArray | None = None,
) -> _Recording:
    """The pushes of a recording.

    Args:
        usual: lag of the force's stamps on which the session's recordings agree, if known.
        bias: (2,) of the force, N, on which they agree, if known.
    """
    sources: dict[str, Source] = {}
    for channel, file in group.items():
        how = said.channels[channel]
        if not how.named and file != group["object_pose"]:
            continue
        if not how.named and channel != "object_pose" and len(reader.tables(file)) > 1:
            continue
        source = reader.table(file, how)
        if how.named or channel == "object_pose" or is_there(source, channel, how):
            sources[channel] = source
    whole = _Recording()
    pushes = dict(_pushes_told_apart(name, sources, said))
    if len(pushes) > 1:
        told_apart = "cut into pushes by their numbers, or where the stamps start again"
        whole.steps.extend((label, told_apart) for label in pushes)
    for label, parts in pushes.items():
        one = _one_clock(label, parts, said, usual, bias)
        whole.biases.update(one.biases)
        for key in ("trials", "doubts", "labels", "steps", "force_lags"):
            getattr(whole, key).extend(getattr(one, key))
    return whole


def _pushes_told_apart(
    name: str, sources: Mapping[str, Source], said: ImportSetup
) -> Iterator[tuple[str, dict[str, Source]]]:
    """The rows of each push by the column that numbers them, in order of appearance."""
    columns = {}
    for channel, source in sources.items():
        column = said.channels[channel].push or source.push or "push_id"
        if column in source.columns:
            columns[channel] = column
        elif said.channels[channel].push:
            source.name_of(column)
    if "object_pose" not in columns:
        yield from _cut_where_stamps_start_anew(name, sources, said)
        return
    numbers = {
        channel: np.array([parsing.push_label(text) for text in sources[channel].texts(column)])
        for channel, column in columns.items()
    }
    pushes = list(dict.fromkeys(numbers["object_pose"].tolist()))
    if "" in pushes:
        raise DatasetError(
            f"{sources['object_pose'].where}: cells of {columns['object_pose']} are empty; say which push"
            " each row belongs to"
        )
    parts = {
        channel: [source.chosen(np.flatnonzero(numbers[channel] == push)) for push in pushes]
        if channel in numbers
        else _parts_without_numbers(channel, sources, said, columns["object_pose"], len(pushes))
        for channel, source in sources.items()
    }
    for number, push in enumerate(pushes):
        yield f"{name}#{push}", {channel: part[number] for channel, part in parts.items()}


def _parts_without_numbers(
    channel: str, sources: Mapping[str, Source], said: ImportSetup, column: str, count: int
) -> list[Source]:
    """The table of a channel for each of `count` pushes that only the object's table numbers.

    It is cut where its stamps start anew. If they never do, the whole serves every push: the object's stamps
    do not either, or contact aligns the two.

    Raises:
        DatasetError: the stamps start anew more or less often than the pushes are numbered.
    """
    source, tracked = sources[channel], sources["object_pose"]
    pieces = _cut_at_new_starts(source, said.channels[channel])
    if len(pieces) == 1 and (
        _is_aligned(channel, sources, said)
        or len(_cut_at_new_starts(tracked, said.channels["object_pose"])) == 1
    ):
        return [source] * count
    if len(pieces) != count:
        raise DatasetError(
            f"{tracked.where}: {column} numbers {count} pushes, but the stamps of {channel} in"
            f" {source.where} start anew {len(pieces) - 1} times; number the pushes there, too, and"
            f" name the column with {channel}.push, or give each push its own files"
        )
    return [source.chosen(rows) for rows in pieces]


def _cut_at_new_starts(source: Source, channel: ChannelSetup) -> list[NDArray[np.int_]]:
    """The rows of a table, cut where stamps go back to the start."""
    return np.split(np.arange(len(source)), _new_starts(times(source, channel)))


def _cut_where_stamps_start_anew(
    name: str, sources: Mapping[str, Source], said: ImportSetup
) -> Iterator[tuple[str, dict[str, Source]]]:
    """The recording cut where stamps go back to the start; unchanged if they never do."""
    pieces = {
        channel: _cut_at_new_starts(source, said.channels[channel]) for channel, source in sources.items()
    }
    count = len(pieces["object_pose"])
    for channel, rows in pieces.items():
        if len(rows) != count:
            raise DatasetError(
                f"{sources['object_pose'].where}: stamps of object_pose go back to the start {count - 1}"
                f" times, those of {channel} in {sources[channel].where} {len(rows) - 1} times; name the"
                " column that numbers the pushes with `push`, or give each push its own files"
            )
    if count == 1:
        yield name, dict(sources)
        return
    for number in range(count):
        yield (
            f"{name}#{number + 1}",
            {channel: source.chosen(pieces[channel][number]) for channel, source in sources.items()},
        )


def _new_starts(time: FloatArray) -> NDArray[np.int_]:
    """Rows at which stamps go back to, or close to, their start."""
    known = np.flatnonzero(np.isfinite(time))
    if len(known) < _FEWEST_ROWS:
        return np.zeros(0, dtype=int)
    row_period = float(np.median(np.abs(np.diff(time[known]))))
    found: list[int] = []
    first = last = latest = float(time[known[0]])
    for row in known[1:].tolist():
        now = float(time[row])
        lasts = latest - first
        if lasts > _FEWEST_ROWS * row_period and now < last and now < first + _NEAR_START * lasts:
            found.append(row)
            first = latest = now
        last, latest = now, max(latest, now)
    return np.array(found, dtype=int)


def _one_clock(
    name: str, sources: Mapping[str, Source], said: ImportSetup, usual: Lag | None, bias: FloatArray | None
) -> _Recording:
    """Pushes of a recording, with all channels on the clock of the object's poses."""
    setup = said.setup
    found = {
        channel: mapped(source, channel, said.channels[channel], own=_is_own(source, channel, sources))
        for channel, source in sources.items()
    }
    steps = [f"{channel}: {text}" for channel, one in found.items() for text in one.done]
    doubts = [text for one in found.values() for text in one.doubts]
    tables = {channel: one.table for channel, one in found.items()}
    epochs = {channel: bool(len(rows) and rows[0, 0] > _EPOCH) for channel, rows in tables.items()}
    zero = float(np.floor(tables["object_pose"][0, 0])) if epochs["object_pose"] else 0.0
    for channel, rows in tables.items():
        clock = said.channels[channel].clock
        for stamps in (rows[:, 0], found[channel].lifted):  # rounded alike, so that they stay equal
            stamps += clock if isinstance(clock, float) else 0.0
            stamps -= zero
        if isinstance(clock, float):
            steps.append(f"{channel}: {clock:g} s added to the stamps")
    if zero:
        steps.append(f"times count from {zero:.0f} s since 1970")
    if "tip_pose" not in tables:
        pose = tables["object_pose"]
        tables["tip_pose"] = np.array([[pose[0, 0], pose[0, 1] + _NOWHERE, pose[0, 2], 0.0]])
        steps.append("there is no finger")
    trial, more = trial_from_tables(name, "fit", tables, name, longest=_LONGEST)
    doubts += more
    if "tip_pose" in found and len(found["tip_pose"].lifted):
        trial = _far_where_lifted(trial, found["tip_pose"].lifted)
    trial, force_lags = _by_contact(trial, sources, said, usual, epochs, steps, doubts)
    biases: dict[str, Bias | None] = {}
    if trial.ft_wrench is not None and trial.finger_near(said.setup.reach):
        if said.channels["ft_wrench"].offset is None:
            trial, text, biases[name] = force_at_rest(setup, trial, bias)
            steps.append(text)
        if said.channels["ft_wrench"].turned_by_contact:
            trial, text = _turned(trial, said)
            steps.append(text)
    parted, more = _parted(setup, trial, name)
    steps += more
    return _Recording(parted, doubts, [name], [(name, step) for step in steps], force_lags, biases)


def _by_contact(
    trial: Trial,
    sources: Mapping[str, Source],
    said: ImportSetup,
    usual: Lag | None,
    epochs: Mapping[str, bool],
    steps: list[str],
    doubts: list[str],
) -> tuple[Trial, list[Lag | None]]:
    """The trial with finger and force on the object's clock, by contact where they need it, and the lag that
    was found for the force, if one was looked for.

    Args:
        usual: lag of the force in the session as a whole.
        epochs: whether the stamps of a channel count from 1970.
        steps, doubts: to which remarks are added.
    """
    setup = said.setup
    force_lags: list[Lag | None] = []
    fingers: Lag | None = None
    for channel in ("tip_pose", "ft_wrench"):
        if channel not in sources or not _is_aligned(channel, sources, said):
            continue
        near = epochs["object_pose"] and epochs[channel] and said.channels[channel].clock is None
        if channel == "tip_pose":
            lag = fingers = finger_lag(setup, trial.object_pose, trial.tip_pose, near)
        else:
            force = trial.channels["ft_wrench"]
            lag = force_lag(setup, trial.object_pose, trial.tip_pose, force, near)
            beside = "tip_pose" in sources and sources[channel].file == sources["tip_pose"].file
            if fingers is not None and beside and (lag is None or not lag.by_touch):
                lag = fingers._replace(text="as for the finger in the same file")
            force_lags.append(lag)
            if usual is not None and _stands_alone(lag, usual):
                doubts.append(_outvoted(trial.name, lag, usual))
                lag = usual
        trial, text = _aligned(trial, channel, lag)
        (steps if text.startswith(channel) else doubts).append(text)
        if lag is not None and not lag.by_touch:
            doubts.append(
                f"{trial.name}: no touch confirms the clock of {channel}; compare contact and force in the"
                f" picture, or give {channel}.clock, the seconds to add to its stamps"
            )
    return trial, force_lags


def _parted(setup: Setup, trial: Trial, name: str) -> tuple[list[Trial], list[str]]:
    """The pushes of a recording, and remarks on where it was cut."""
    pushes, cuts = cut_at_carries(setup, [trial], name)
    steps = [f"cut where {reason}" for cut in cuts for reason in cut.reasons]
    parted = [piece for push in pushes for piece in cut_at_rests(setup, push, LONGEST_PUSH)]
    if len(parted) > len(pushes):
        steps.append(f"cut into {len(parted)} pushes where the object rests and the finger leaves it")
    parted = [_lowered(piece) for piece in parted]
    for piece in parted:
        refuse_long(piece.object_pose, piece.name)
    if len(parted) > 1 and parted[0].name != name:
        parted = [replace(push, name=f"{name}#{number}") for number, push in enumerate(parted, 1)]
    return parted, steps


def _is_aligned(channel: str, sources: Mapping[str, Source], said: ImportSetup) -> bool:
    """Whether contact brings a channel to the object's clock: another file does not share it by itself."""
    clock = said.channels[channel].clock
    return clock == CONTACT or (clock is None and sources[channel].file != sources["object_pose"].file)


def _is_own(source: Source, channel: str, sources: Mapping[str, Source]) -> bool:
    """Whether a rotation in a channel's table is its own: not a finger's beside the object's poses."""
    tracked = sources["object_pose"]
    return channel == "object_pose" or (source.file, source.part) != (tracked.file, tracked.part)


def _far_where_lifted(trial: Trial, lifted: FloatArray) -> Trial:
    """The trial with the finger far away at the stamps where it is lifted, and may pass over the object."""
    tip = trial.tip_pose
    far = np.isin(tip.time, lifted)
    return replace(trial, tip_pose=Channel(tip.time, tip.values + np.where(far, _NOWHERE, 0.0)[:, None]))


def _lowered(trial: Trial) -> Trial:
    """The trial without the rows of a lifted finger, unless there are no others."""
    tip = trial.tip_pose
    away = tip.values - trial.object_pose.at(tip.time)[:, :2]
    down = np.hypot(*away.T) < 0.5 * _NOWHERE
    return replace(trial, tip_pose=tip.chosen(down)) if down.any() else trial


def _stands_alone(lag: Lag | None, usual: Lag) -> bool:
    """Whether contact does not show a recording's lag, while that of the session differs."""
    return lag is None or (not lag.by_touch and lag.contradicts(usual))


def _outvoted(name: str, lag: Lag | None, usual: Lag) -> str:
    alone = "does not show its clock" if lag is None else f"would move it by {lag.value:.4f} s ({lag.text})"
    return f"{name}: ft_wrench alone {alone}; the {usual.value:.4f} s of the session as a whole was used"


def _aligned(trial: Trial, channel: str, lag: Lag | None) -> tuple[Trial, str]:
    """The trial with a channel's stamps on the clock of the object's poses, and a remark on how."""
    moved = trial.channels[channel]
    if lag is None:
        text = (
            f"{trial.name}: contact does not show how the clock of {channel} differs from that of"
            f" object_pose; check frames, outline and finger.radius, or give {channel}.clock, the seconds to"
            " add to its stamps"
        )
        begin, end = trial.object_pose.time[[0, -1]]
        if moved.time[-1] <= begin or moved.time[0] >= end:
            raise DatasetError(text)
        return trial, f"{text}. The stamps were left as they are"
    if channel == "ft_wrench" and not lag.sure:
        return trial, f"{channel}: stamps left as they are, since they agree with the poses within the error"
    channels = {channel: Channel(moved.time + lag.value, moved.values)}
    if channel == "tip_pose" and (angle := trial.tip_angle) is not None:
        channels["tip_angle"] = Channel(angle.time + lag.value, angle.values)
    text = f"{channel}: {lag.value:.4f} s added to the stamps, {lag.text} (± {1e3 * lag.error:.1f} ms)"
    return replace(trial, **channels), text  # type: ignore[arg-type]


def _turned(trial: Trial, said: ImportSetup) -> tuple[Trial, str]:
    """The trial with its force rotated so that on the whole it points along the contact normal."""
    normal, force, _ = normals_and_forces(said.setup, contact_rows(said.setup, [trial]))
    if len(force) < 10:
        raise DatasetError(f"{trial.name}: too few rows with force in contact to rotate ft_wrench by")
    angle = -middle_angle(angle_between(force, normal))
    assert trial.ft_wrench is not None
    values = trial.ft_wrench.values.copy()
    values[:, :2] = rotated(values[:, :2], angle)
    text = f"ft_wrench: rotated by {np.degrees(angle_between(angle, 0.0)):.1f}° to fit the contact"
    return replace(trial, ft_wrench=Channel(trial.ft_wrench.time, values)), text
