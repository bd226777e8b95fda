"""Cut recordings of a whole session: an object that moves while the finger is away was carried by someone,
and where nothing was recorded for a while, anything may have happened."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from slipmap.models.geometry import angle_between
from slipmap.models.measurements import parsing
from slipmap.models.measurements.push_dataset import Setup, gaps
from slipmap.models.measurements.trial import Channel, DatasetError, Trial
from slipmap.models.measurements.trial_tables import if_turning
from slipmap.models.physics.cell_grid import FloatArray

_AWAY = 0.02  # m between the finger's rim and the object
_CARRIED = 0.01  # m that a carried object moves
_SPEED = 0.015  # m/s above which the object does not rest
_WINDOW = 0.1  # s
_PAUSE = 0.1  # s of rest between two motions
_BLIND = 0.2  # s without a pose; a motion in such a gap counts separately
_SILENT, _SILENT_ROWS = 1.0, 20.0  # s, and usual steps, without a row of finger or object
_FEWEST_ROWS = 6  # in a push
_PUSHED = 2e-3  # m that the object moves in a push
_SLOW = (3e-3, 0.3)  # speed, m/s, and window, s, that distinguish a slow push from rest
_LEAVES = 5e-3  # m of air between two pushes
_MARGIN = 0.5  # s kept before and after the object moves


class Carry(NamedTuple):
    """A motion of the object while the finger is away."""

    first: int  # last row at rest before it
    last: int  # first row after it
    distance: float  # of the object frame, or if larger, of the outline's farthest point by rotation, m
    time: float  # s


CARRIED = "the object is carried while the finger is away"
SILENT = "nothing was recorded for a while"


class Cut(NamedTuple):
    """A recording that was cut."""

    text: str  # where and why, for the user
    reasons: tuple[str, ...]  # `CARRIED`, `SILENT` or both


def carries(setup: Setup, trial: Trial) -> list[Carry]:
    """Motions that begin at rest with the finger over 20 mm away, if others begin at the finger."""
    if not trial.finger_near(setup.reach):
        return []
    runs = _motions(setup, trial)
    if not runs:
        return []
    found = []
    pose, reach = trial.object_pose, setup.reach
    gap = gaps(setup, trial.tip_pose.at(pose.time), pose.values)
    if all(gap[first] > _AWAY for first, _ in runs):
        return []  # nothing was pushed: the finger is in another frame
    for first, last in runs:
        moved = float(_displacement(pose.values[last], pose.values[first], reach))
        if first > 0 and gap[first] > _AWAY and moved > _CARRIED:
            shift = float(np.hypot(*(pose.values[last] - pose.values[first])[:2]))
            found.append(Carry(first, last, max(shift, moved - shift), float(pose.time[first])))
    return found


def silences(setup: Setup, trial: Trial) -> list[Carry]:
    """Pauses of over a second without a row of object or finger, after which one of them is elsewhere."""
    if trial.ends_only or not trial.finger_near(setup.reach):
        return []
    pose, tip = trial.object_pose.time, trial.tip_pose.time
    stamps = np.sort(np.concatenate([pose, tip]))
    least = max(_SILENT, _SILENT_ROWS * float(np.median(np.diff(pose))))
    found = []
    for place in np.flatnonzero(np.diff(stamps) > least):
        last = int(np.searchsorted(pose, stamps[place + 1]))
        if not 0 < last < len(pose):
            continue
        before, after = trial.object_pose.values[last - 1], trial.object_pose.values[last]
        moved = float(_displacement(before, after, setup.reach))
        finger = float(np.hypot(*np.diff(trial.tip_pose.at(stamps[[place, place + 1]]), axis=0)[0, :2]))
        if moved > _PUSHED + 4.0 * setup.noise_of_motion or finger > _LEAVES:
            found.append(Carry(last - 1, last, moved, float(stamps[place])))
    return found


def _motions(
    setup: Setup, trial: Trial, speed: float = _SPEED, window: float = _WINDOW
) -> list[tuple[int, int]]:
    """The last row at rest before each motion of the object, and the first row after it.

    Args:
        speed: above which the object does not rest, m/s.
        window: over which the speed is taken, s.
    """
    pose = trial.object_pose
    if trial.ends_only or len(pose.time) < _FEWEST_ROWS:
        return []
    reach = setup.reach
    middle = 0.5 * (pose.time[1:] + pose.time[:-1])
    step = _displacement(pose.values[1:], pose.values[:-1], reach)
    around = _displacement(pose.at(middle + 0.5 * window), pose.at(middle - 0.5 * window), reach)
    steps = np.flatnonzero((step > _CARRIED) | (around > speed * window + 4.0 * setup.noise_of_motion))
    if len(steps) == 0:
        return []
    pauses = pose.time[steps[1:]] - pose.time[steps[:-1] + 1]
    blind = np.diff(pose.time)[steps] > max(_BLIND, 5.0 * float(np.median(np.diff(pose.time))))
    runs = np.split(steps, np.flatnonzero((pauses > _PAUSE) | blind[1:] | blind[:-1]) + 1)
    return [(int(run[0]), int(run[-1]) + 1) for run in runs]


def carried_text(carry: Carry) -> str:
    """Description of a carry for errors and warnings."""
    return f"the object moves {carry.distance:.1g} m while the finger is away at t = {carry.time:.1f} s"


def _overlap(one: Carry, other: Carry) -> bool:
    return one.first < other.last and other.first < one.last


def _silence_text(time: FloatArray, silence: Carry) -> str:
    """Description of a pause of the recording, given the stamps of the poses."""
    lasts = float(time[silence.last]) - silence.time
    return (
        f"there are no rows of object and finger for {parsing.rounded(lasts, 3)} s from t ="
        f" {silence.time:.1f} s on"
    )


def _more_times(found: Sequence[Carry]) -> str:
    more = len(found) - 1
    return f" and {more} more time{'s' if more > 1 else ''}" if more else ""


def cut_at_carries(setup: Setup, trials: Sequence[Trial], where: str) -> tuple[list[Trial], list[Cut]]:
    """Cut each trial where the object is carried or nothing was recorded, into pushes named file#1 and so on.

    Raises:
        DatasetError: nothing is left of a trial.
    """
    reach = setup.reach
    result: list[Trial] = []
    cuts: list[Cut] = []
    for trial in trials:
        carried, silent = carries(setup, trial), silences(setup, trial)
        silent = [one for one in silent if not any(_overlap(one, other) for other in carried)]
        found = sorted((*carried, *silent))
        if not found:
            result.append(trial)
            continue
        time = trial.object_pose.time
        begins = [time[0], *(time[carry.last] for carry in found)]
        ends = [*(time[carry.first] for carry in found), time[-1]]
        pieces = [_between(trial, begin, end, reach) for begin, end in zip(begins, ends, strict=True)]
        pushes = [piece for piece in pieces if piece is not None]
        texts = [carried_text(carried[0]) + _more_times(carried)] if carried else []
        texts += [_silence_text(time, silent[0]) + _more_times(silent)] if silent else []
        text = ", and ".join(texts)
        if not pushes:
            raise DatasetError(f"{where}: {text}; cut the recording into its pushes")
        text = f"{text}; the recording was cut there into {len(pushes)} push{'es' * (len(pushes) > 1)}"
        reasons = ((CARRIED, carried), (SILENT, silent))
        cuts.append(Cut(f"{where}: {text}", tuple(reason for reason, found in reasons if found)))
        result += _numbered(trial, pushes)
    return result, cuts


def cut_at_rests(setup: Setup, trial: Trial, longest: float = np.inf) -> list[Trial]:
    """Cut a recording of several pushes where the object rests and the finger leaves it between two motions.

    Each push begins half a second before the object moves, ends half a second after, and is named name#1 and
    so on. A recording of one push is returned unchanged, if it does not last longer than `longest` s.
    """
    runs = _motions(setup, trial, *_SLOW) if trial.finger_near(setup.reach) else []
    pose, reach = trial.object_pose, setup.reach
    gap = gaps(setup, trial.tip_pose.at(pose.time), pose.values) if len(runs) > 1 else np.zeros(0)
    pushes: list[tuple[int, int]] = []
    for first, last in runs:
        if pushes and np.max(gap[pushes[-1][1] : first + 1], initial=0.0) < _LEAVES:
            pushes[-1] = (pushes[-1][0], last)
        else:
            pushes.append((first, last))
    pushes = [
        (first, last)
        for first, last in pushes
        if float(np.max(_displacement(pose.values[first : last + 1], pose.values[first], reach))) > _PUSHED
    ]
    if not pushes or (len(pushes) < 2 and pose.time[-1] - pose.time[0] <= longest):
        return [trial]
    between = [0.5 * (pose.time[one[1]] + pose.time[two[0]]) for one, two in pairwise(pushes)]
    found = []
    for (first, last), begin, end in zip(
        pushes, [pose.time[0], *between], [*between, pose.time[-1]], strict=True
    ):
        piece = _between(
            trial, max(begin, pose.time[first] - _MARGIN), min(end, pose.time[last] + _MARGIN), reach
        )
        if piece is not None:
            found.append(piece)
    return _numbered(trial, found) if len(found) > 1 else found or [trial]


def _numbered(trial: Trial, pushes: Sequence[Trial]) -> list[Trial]:
    """The pushes of a recording, named name#1 and so on."""
    return [replace(push, name=f"{trial.name}#{number}") for number, push in enumerate(pushes, 1)]


def _between(trial: Trial, begin: float, end: float, reach: float) -> Trial | None:
    """The part of a trial from `begin` to `end`; None if that is not a push."""
    channels = {name: _part(channel, begin, end) for name, channel in trial.channels.items()}
    pose, tip = channels["object_pose"], channels["tip_pose"]
    if pose is None or tip is None or len(pose.time) < _FEWEST_ROWS:
        return None
    if float(np.max(_displacement(pose.values, pose.values[0], reach))) < _PUSHED:
        return None
    angle = None if trial.tip_angle is None else _part(trial.tip_angle, begin, end)
    turns = None if angle is None else if_turning(angle)
    return Trial(trial.name, trial.role, pose, tip, channels.get("ft_wrench"), tip_angle=turns)


def _part(channel: Channel, begin: float, end: float) -> Channel | None:
    inside = (channel.time >= begin) & (channel.time <= end)
    return channel.chosen(inside) if inside.any() else None


def _displacement(one: FloatArray, other: FloatArray, reach: float) -> FloatArray:
    """(…) distance that a point at the outline moves from one pose (…, 3) to another, m."""
    shift = np.hypot(one[..., 0] - other[..., 0], one[..., 1] - other[..., 1])
    return np.asarray(shift + reach * np.abs(angle_between(one[..., 2], other[..., 2])))
