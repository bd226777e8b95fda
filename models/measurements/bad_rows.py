"""Rows that cannot be true: a tracker's exact zeros or another code while the object is elsewhere, as
receivers publish for what they do not see, its jumps or flips that the next rows undo, and spikes of a force.

Otherwise a single pose flipped by half a turn would shift every later row by a whole turn when angles are
unwrapped.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slipmap.models.geometry import angle_between
from slipmap.models.measurements import parsing
from slipmap.models.measurements.trial import Channel, Trial
from slipmap.models.physics.cell_grid import FloatArray

_JUMP = 0.01  # m
_TURN = 0.5  # rad
_FASTER = 3.0  # times nearly all other steps of the record
_MOST_ROWS = 5  # longest jump, in rows, or
_MOST_SHARE = 0.1  # as a share of the rows
_END_ROWS = 2  # longest jump at an end of the record, where nothing comes back
_END_FACTOR = 3.0  # such a jump, and one to where the object stands for long, must be larger by this factor
_BLIND = 0.2  # s without a row, after which the object may be anywhere
_FEWEST_REPEATS = 3  # of a pose
_FAR = 0.1  # m from the other rows, of a code
_BRAKES = 10.0  # m/s², by which friction slows an object down at most
_SPIKE, _FEWEST_FORCES = 10.0, 3  # times the forces beside it, and rows of force among which it is one
_BLOW, _STRUCK = 0.1, 2e-3  # s before and after a blow, and m that the object moves by it
_FEWEST_ROWS = 6  # fewer rows cannot be judged


def sound_rows(time: FloatArray, values: FloatArray) -> tuple[NDArray[np.bool_], dict[str, list[int]], str]:
    """Find the rows that can be true.

    Args:
        time: (T,) increasing, s.
        values: (T, 2) positions, m, or (T, 3) with an angle as recorded, rad.

    Returns:
        (T,) whether a row is kept; the faults of the other rows, with their row numbers; and a complaint
        about jumps that stay, empty if there are none.
    """
    kept = np.ones(len(time), dtype=bool)
    found: dict[str, list[int]] = {}
    if len(time) < _FEWEST_ROWS:
        return kept, found, ""
    for run in _code_runs(values):
        kept[run] = False
        code = float(values[run[0], 0])
        words = f"is exactly {'zero' if code == 0.0 else f'{code:g}'} while the rows around it are not"
        found.setdefault(words, []).extend(run.tolist())
    rows = np.flatnonzero(kept)
    for run in _repeats(time[rows], values[rows]):
        kept[rows[run]] = False
        words = "repeats the pose before, while the object moves on as the next pose shows"
        found.setdefault(words, []).extend(rows[run].tolist())
    rows = np.flatnonzero(kept)
    jumps, stays = _jumps(time[rows], values[rows])
    for run, words in jumps:
        kept[rows[run]] = False
        found.setdefault(words, []).extend(rows[run].tolist())
    complaint = ""
    if stays:
        step, words = stays[0]
        complaint = f"{words} after row {rows[step]}, t = {time[rows[step]]:.3f} s, and stays there"
    return kept, found, complaint


def without_force_spikes(trials: Sequence[Trial]) -> tuple[list[Trial], list[str]]:
    """The trials without rows of force that stand out from all others, as when a bit is lost on the way,
    and a warning for each that had some.

    Such a row is over ten times as large as the largest force of a usual push and as the rows before and
    after it, and strikes no object. Of fewer than three pushes none is usual.
    """
    sizes = [np.hypot(*trial.ft_wrench.values[:, :2].T) for trial in trials if trial.ft_wrench is not None]
    usual = float(np.median([size.max(initial=0.0) for size in sizes])) if len(sizes) >= 3 else 0.0
    if not usual > 0.0:  # also where forces are missing
        return list(trials), []
    sound, warnings = [], []
    for trial in trials:
        if trial.ft_wrench is not None and len(trial.ft_wrench.time) >= _FEWEST_FORCES:
            time, values = trial.ft_wrench.time, trial.ft_wrench.values
            size = np.hypot(*values[:, :2].T)
            before, after = np.pad(size, 1)[:-2], np.pad(size, 1)[2:]
            spikes = size > _SPIKE * np.maximum(np.maximum(before, after), usual)
            spikes[spikes] = [not _strikes(trial.object_pose, t) for t in time[spikes]]
            if spikes.any():
                trial = replace(trial, ft_wrench=trial.ft_wrench.chosen(~spikes))
                largest = parsing.rounded(float(size[spikes].max()), 3)
                at = ", ".join(f"{t:.3f}" for t in time[spikes])
                warnings.append(
                    f"{trial.name}: ft_wrench is up to {largest} N at t = {at} s, over"
                    f" {_SPIKE:.0f} times the forces beside it and in most pushes; left out"
                )
        sound.append(trial)
    return sound, warnings


def _strikes(pose: Channel, t: float) -> bool:
    """Whether the object rests before and moves after a moment, s, as if struck then."""
    place = pose.at([t - _BLOW, t, t + _BLOW])[:, :2]
    before, after = np.hypot(*np.diff(place, axis=0).T)
    return bool(after > _STRUCK and after > _FASTER * before)


def _code_runs(values: FloatArray) -> Iterator[NDArray[np.int_]]:
    """Runs of rows with one number in all columns, such as 0, if the rows on both sides lie elsewhere.

    A number other than 0 must lie far from all other rows: a finger on a diagonal also has x = y.
    """
    alike = np.flatnonzero((values == values[:, :1]).all(axis=1))
    alike = alike[[code == 0.0 or _far_from_others(values, code) for code in values[alike, 0]]]
    if not 0 < len(alike) < len(values) - 1:
        return
    codes = values[alike, 0]
    for run in np.split(alike, np.flatnonzero((np.diff(alike) > 1) | (np.diff(codes) != 0.0)) + 1):
        beside = [(row, row + side) for row, side in ((run[0] - 1, -1), (run[-1] + 1, 1))]
        inside = [(row, next_) for row, next_ in beside if 0 <= row < len(values)]
        away = [_apart(values[row], values[run[0]]) for row, _ in inside]
        if all(step.max() > 1.0 for step in away) and (
            len(inside) > 1 or _sudden(away[0], _step(values, *inside[0]))
        ):
            yield run


def _far_from_others(values: FloatArray, code: float) -> bool:
    """Whether x = y = code lies farther from where the other rows are than these lie apart, and 0.1 m."""
    others = values[(values != code).any(axis=1), :2]
    low, high = others.min(axis=0, initial=np.inf), others.max(axis=0, initial=-np.inf)
    return bool(np.maximum(low - code, code - high).max() > max(_FAR, (high - low).max()))


def _repeats(time: FloatArray, values: FloatArray) -> Iterator[NDArray[np.int_]]:
    """Runs of rows equal to the one before, after which the record jumps to where the motion led meanwhile.

    Some trackers publish the last pose as long as they do not see the object.
    """
    same = (values[1:] == values[:-1]).all(axis=1)
    step = np.hypot(*(values[1:, :2] - values[:-1, :2]).T)
    for last in np.flatnonzero((step > _JUMP) & np.append(False, same[:-1])).tolist():
        moving = np.flatnonzero(~same[:last])
        first = int(moving[-1]) + 1 if len(moving) else 0  # the row that is repeated
        ends = (first - _MOST_ROWS, first), (last + 1, last + 1 + _MOST_ROWS)
        if last - first < _FEWEST_REPEATS or ends[0][0] < 0 or ends[1][1] >= len(time):
            continue
        beside = max(step[begin:end].max() for begin, end in ends)
        if step[last] < _FASTER * beside:  # as where poses are coarse, or come less often than rows
            continue
        speeds = [float(np.hypot(*(values[b] - values[a])[:2]) / (time[b] - time[a])) for a, b in ends]
        jumped = step[last] / (time[last + 1] - time[first])
        if max(jumped, *speeds) < _FASTER * min(jumped, *speeds):
            yield np.arange(first + 1, last + 1)


def _sudden(step: FloatArray, next_: FloatArray) -> bool:
    """Whether a step is large compared with the next one, unlike that of an object that was struck."""
    return bool(((step > 1.0) & (step > _FASTER * next_)).any())


def _step(values: FloatArray, one: int, other: int) -> FloatArray:
    """(2,) distance between two rows; 0 beyond the ends."""
    if min(one, other) < 0 or max(one, other) >= len(values):
        return np.zeros(2)
    return _apart(values[one], values[other])


def _apart(one: FloatArray, other: FloatArray) -> FloatArray:
    """(…, 2) distance between two rows: of their positions in units of 10 mm, of their angles in 0.5 rad."""
    place = np.hypot(*np.moveaxis(one[..., :2] - other[..., :2], -1, 0)) / _JUMP
    turn = np.abs(angle_between(one[..., 2], other[..., 2])) / _TURN if one.shape[-1] > 2 else 0.0 * place
    return np.stack([place, turn], axis=-1)


def _jumps(
    time: FloatArray, values: FloatArray
) -> tuple[list[tuple[NDArray[np.int_], str]], list[tuple[int, str]]]:
    """Runs of rows that jump and come back, and steps after which the record stays elsewhere."""
    step = _apart(values[1:], values[:-1])
    speed = step / np.diff(time)[:, None]
    usual = np.percentile(speed, 90, axis=0)
    blind = np.diff(time) > max(_BLIND, 5.0 * float(np.median(np.diff(time))))
    large = (step > 1.0) & (speed > _FASTER * usual) & ~blind[:, None]
    steps = np.flatnonzero(large.any(axis=1))
    longest = max(_MOST_ROWS, int(_MOST_SHARE * len(time)))
    held = (values[1:, :2] == values[:-1, :2]).all(axis=1)  # as a tracker that lost the object may do
    # A struck object may rest at its new place and be struck back, but slides for a while each time.
    leaps = step[:, 0] * _JUMP > np.maximum(_END_FACTOR * _JUMP, 0.5 * _BRAKES * np.diff(time) ** 2)
    jumps: list[tuple[NDArray[np.int_], str]] = []
    stays: list[tuple[int, str]] = []
    done = -1
    for place, first in enumerate(steps.tolist()):
        if first <= done:
            continue
        for last in steps[place + 1 :].tolist():
            stands = bool(leaps[first] and leaps[last] and held[first + 1 : last].all())
            if last - first > longest and not stands:
                break
            # Meanwhile the object may have moved on at its usual speed.
            allowed = np.maximum(1.0, _FASTER * usual * (time[last + 1] - time[first])) / 2.0
            if (_apart(values[last + 1], values[first]) < allowed).all():
                words = _words(step[first], "and comes back")
                if stands and last > first + 1:
                    words = "stands at one place, away from the rows around"
                jumps.append((np.arange(first + 1, last + 1), words))
                done = last
                break
        else:
            last = first
        if done >= first:
            continue
        # Where nothing comes back, one or two rows at an end are considered the wrong ones.
        beside = np.maximum(_step(values, first - 1, first), _step(values, first + 1, first + 2))
        if not _sudden(step[first], beside):
            continue
        huge = bool((step[first] > _END_FACTOR).any())
        if first < _END_ROWS and huge:
            jumps.append((np.arange(first + 1), _words(step[first], "relative to the next row")))
        elif first >= len(time) - 1 - _END_ROWS and huge:
            jumps.append((np.arange(first + 1, len(time)), _words(step[first], "relative to the row before")))
            break
        else:
            stays.append((first, _words(step[first], "").strip()))
    return jumps, stays


def _words(step: FloatArray, end: str) -> str:
    place, turn = float(step[0] * _JUMP), float(np.degrees(step[1] * _TURN))
    if step[1] > 1.0 and step[1] * _TURN > place:
        near = min((90.0, 180.0), key=lambda angle: abs(angle - turn))
        size = f"about {near:.0f}°" if abs(near - turn) < 15.0 else "far"
        return f"theta turns by {size} {end}"
    return f"jumps {end}" if end else f"jumps by {1e3 * place:.0f} mm"
