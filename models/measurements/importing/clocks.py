"""Align the clocks of several files by contact, and find stamps that cannot be right.

The object moves only while the finger touches it: on the right clock the finger's rim lies on the outline
while the object moves, and never inside it. A force rises when the finger reaches the outline.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slipmap.models.measurements.motion import row_noise, spread_rows
from slipmap.models.measurements.push_dataset import Setup, gaps
from slipmap.models.measurements.trial import Channel
from slipmap.models.physics.cell_grid import FloatArray

_SURE = 2.0  # standard errors
_STEP = 0.05  # s, step of the coarse search
_MOST_LAGS = 3000  # most lags tried by geometry, the likeliest by motion
_ROWS = 150  # object rows that decide among them
_COARSE, _FINE = 5e-3, 2e-3  # m of depth or air that count half, in the coarse and fine search
_AIR, _DEPTH = 0.02, 0.03  # m; larger values are clipped in the fit
_TOUCHES = 5e-3  # m, including errors of frames and outline
_LEAST_TOUCHED = 0.15  # share of the rows of motion; in the others the object may be carried
_FEWEST_ROWS = 10
_FIT_ROWS = 1500
_CALIBRATION = 2e-4  # m by which outline and finger may be thicker than stated
_RECTIFIED = 0.2  # share of the noise that the outline's corners may turn into a constant gap
_JITTER = 1e-4  # m, at least
_SLOWEST = 3e-3  # m/s of a moving object
_SPANS = (0.1, 0.3, 0.8)  # s over which speeds are taken
_EDGE = 0.15  # s at both ends of a motion in which the object may still rest
_NEAR_EPOCH = 2.0  # s by which two clocks that both count from 1970 may differ

_STARTED = 5e-4  # m from where the finger waited at first
_RISE = 0.2  # s around the touch in which the force must rise
_SHIFTS = (0.0, -0.1, 0.1, -0.2, 0.2, -0.3, 0.3)  # s from the coarse lag at which rises are sought
_FORCE_STEP = 0.02  # s, step of the coarse search for the force
_USUAL_ROWS = 1200  # force rows among which frequent values are sought
_LEAST_CORRELATION = 0.3
_FEWEST_AGREEING = 2  # recordings of a session
_APPROACH = 5e-3  # m/s, lowest speed of a finger that touches
_WAITS = 0.4  # s before the touch in which the object rests
_PASSES = 0.04  # s around it in which the finger's path is straight
_SOON = 1.0  # s after it in which the object moves

_AROUND = 5  # rows on either side among which a stamp is judged, and longest run of wrong ones
_FAR, _PERIODS = 0.1, 20.0  # s, and usual steps, that a wrong stamp is from those around it
_ELSEWHERE = 1e6  # s from the next stamps, at an end: a clock that was not set yet
_MOST_SHARE = 0.1  # of the rows; if more are odd, the clock is of another kind
_ROWS_A_STAMP = 3.0  # rows with one stamp, on average, that still differ


class Lag(NamedTuple):
    """Correction to be added to a channel's stamps."""

    value: float  # s
    error: float  # s, standard deviation
    text: str  # how it was found
    by_touch: bool = True  # whether contact shows it; otherwise only correlation with motion does

    @property
    def sure(self) -> bool:
        """Whether it is significant."""
        return abs(self.value) > _SURE * self.error

    def contradicts(self, other: Lag) -> bool:
        """Whether the two lags are inconsistent."""
        return abs(self.value - other.value) > 3.0 * float(np.hypot(self.error, other.error))


class Touch(NamedTuple):
    """The finger reaches a resting outline and pushes it."""

    time: float  # s, by geometry
    approach: float  # speed at which the gap closes, m/s
    gap: float  # usual gap while it then pushes, m, negative inside


class Rise(NamedTuple):
    """A force's rise at a touch."""

    delay: float  # s after the touch; negative if it is early
    explained: float  # of it by the gap left while pushing, if outline or finger are thicker or thinner, s
    gap: float  # that gap, m, negative inside


def finger_lag(setup: Setup, pose: Channel, tip: Channel, near: bool) -> Lag | None:
    """The lag that brings the finger's clock to the object's; None if contact does not show it.

    Args:
        near: whether both clocks count from 1970, so that they differ little.
    """
    moving = _moving(setup, pose)
    if not moving.any():
        return None
    rows = _telling(moving)
    lags = _candidates(pose, tip, moving, near)
    if not len(lags):
        return None
    cost = [_misfit(setup, pose, tip, rows, moving, lag, _COARSE) for lag in lags]
    best = float(lags[np.argmin(cost)])
    for step in (0.01, 0.002):
        tried = best + step * np.arange(-8, 9)
        best = float(min(tried, key=lambda lag: _misfit(setup, pose, tip, rows, moving, lag, _FINE)))
    touched = _touched(setup, pose, tip, moving, best)
    # An object that moves far from the finger is being carried, and shows nothing.
    return None if touched is None else _refined(setup, pose, tip, touched, best)


def _touched(
    setup: Setup, pose: Channel, tip: Channel, moving: NDArray[np.bool_], lag: float
) -> NDArray[np.bool_] | None:
    """(T,) rows of motion at which the finger touches on the clock of a lag; None if they are too few."""
    time = pose.time - lag
    touched = moving & (time >= tip.time[0]) & (time <= tip.time[-1])
    touched[touched] = np.abs(gaps(setup, tip.at(time[touched]), pose.values[touched])) < _TOUCHES
    return touched if touched.sum() >= max(_FEWEST_ROWS, _LEAST_TOUCHED * moving.sum()) else None


def _moving(setup: Setup, pose: Channel) -> NDArray[np.bool_]:
    """(T,) rows well inside motions of the object.

    Speeds are taken over the shortest span in which the motion exceeds the noise of the rows.
    """
    reach = 0.5 * setup.reach
    noise = _row_noise(pose, reach)
    for span in _SPANS:
        step = pose.at(pose.time + 0.5 * span) - pose.at(pose.time - 0.5 * span)
        speed = (np.hypot(step[:, 0], step[:, 1]) + reach * np.abs(step[:, 2])) / span
        fastest = float(np.percentile(speed, 95))
        if 5.0 * noise / span < 0.5 * fastest:
            break
    fast = speed > max(_SLOWEST, 5.0 * noise / span, 0.2 * fastest)
    edge = max(_EDGE, 0.75 * span)
    # A row counts if all rows within the edge also move.
    still = np.flatnonzero(~fast)
    after = np.searchsorted(still, np.arange(len(fast)))
    # Over a wide span, rest before the first row or after the last may also seem to move.
    times = np.concatenate([[pose.time[0]], pose.time[still], [pose.time[-1]]])
    return fast & (pose.time - times[after] > edge) & (times[after + 1] - pose.time > edge)


def _row_noise(pose: Channel, reach: float) -> float:
    """Standard deviation of the distance between two rows at the same pose, m, from third differences, which
    are small in smooth motion."""
    if len(pose.time) < 8:
        return 0.0
    third = np.median(np.abs(np.diff(pose.values, 3, axis=0)), axis=0) / 0.6745 / np.sqrt(20.0)
    return float(np.sqrt(2.0) * np.linalg.norm(third * [1.0, 1.0, reach]))


def _telling(moving: NDArray[np.bool_], count: int = _ROWS) -> NDArray[np.int_]:
    """A selection of rows of motion, and a third as many of rest."""
    chosen = []
    for rows, most in ((np.flatnonzero(moving), count), (np.flatnonzero(~moving), count // 3)):
        if len(rows):
            rows = rows[spread_rows(len(rows), most)]
        chosen.append(rows)
    return np.sort(np.concatenate(chosen))


def _candidates(pose: Channel, tip: Channel, moving: NDArray[np.bool_], near: bool) -> FloatArray:
    """Lags to try: all in steps or, if there are too many, those at which finger and object move together."""
    least = pose.time[moving][0] - tip.time[-1]
    most = pose.time[moving][-1] - tip.time[0]
    if near:
        least, most = max(least, -_NEAR_EPOCH), min(most, _NEAR_EPOCH)
    lags = np.arange(least, most + _STEP, _STEP)
    if len(lags) <= _MOST_LAGS:
        return lags
    grid = np.arange(pose.time[0], pose.time[-1], _STEP)
    object_moves = np.interp(grid, pose.time, moving.astype(float))
    times = np.arange(tip.time[0], tip.time[-1], _STEP)
    speed = np.hypot(*np.gradient(tip.at(times), axis=0).T)
    finger_moves = (speed > 0.2 * np.percentile(speed, 95)).astype(float)
    together = _correlated(object_moves, finger_moves)
    shift = pose.time[0] - tip.time[0] + _STEP * (np.arange(len(together)) - (len(times) - 1))
    return np.sort(shift[np.argsort(-together, kind="stable")[:_MOST_LAGS]])


def _correlated(one: FloatArray, other: FloatArray) -> FloatArray:
    """(len(one) + len(other) - 1,) cross-correlation at each shift of the other relative to the one."""
    from scipy.fft import irfft, next_fast_len, rfft

    size = len(one) + len(other) - 1
    fast = next_fast_len(size)
    return np.asarray(irfft(rfft(one, fast) * rfft(other[::-1], fast), fast)[:size])


def _misfit(
    setup: Setup,
    pose: Channel,
    tip: Channel,
    rows: NDArray[np.int_],
    moving: NDArray[np.bool_],
    lag: float,
    scale: float,
) -> float:
    """Mean over rows of depth, and of air while the object moves, relative to a length `scale`, from 0 to 1
    per row, so that an occasionally carried object does not decide. An unrecorded finger counts as far."""
    time = pose.time[rows] - lag
    known = (time >= tip.time[0]) & (time <= tip.time[-1])
    gap = np.full(len(rows), np.inf)
    gap[known] = gaps(setup, tip.at(time[known]), pose.values[rows[known]])
    square = np.where(moving[rows], gap, np.minimum(gap, 0.0)) ** 2
    return float(np.mean(1.0 - scale**2 / (scale**2 + square)))


def _refined(
    setup: Setup, pose: Channel, tip: Channel, moving: NDArray[np.bool_], lag: float, count: int = _FIT_ROWS
) -> Lag:
    """The least-squares lag, fitted together with a constant thickness that outline and finger may lack.

    While the object rests, only depth beyond the noise counts: a finger that waits at the outline would lie
    inside it by chance in every second row.
    """
    from scipy.optimize import least_squares

    rows = _telling(moving, count)
    # Stamps since 1970 lack the precision for the small steps below.
    near = Channel(tip.time + lag, tip.values)
    reach = 0.5 * setup.reach
    sigmas = (setup.noise.position or 0.0, setup.noise.tip or 0.0, reach * (setup.noise.angle or 0.0))
    time, poses = pose.time[moving], pose.values[moving]
    scatter = float(row_noise(time, gaps(setup, near.at(time), poses)[:, None])[0])
    noise = max(_JITTER, scatter, float(np.linalg.norm(sigmas)))
    most = np.where(moving[rows], _AIR, 0.0)
    allowed = np.where(moving[rows], 0.0, 3.0 * noise)

    def residuals(unknown: FloatArray) -> FloatArray:
        more, thicker = 1e-2 * unknown[0], 1e-3 * unknown[1]
        gap = gaps(setup, near.at(pose.time[rows] - more), pose.values[rows]) - thicker
        each = np.clip(gap + allowed, -_DEPTH, most) / noise
        return np.append(each, np.sqrt(len(rows)) * thicker / _CALIBRATION)

    found = least_squares(
        residuals, np.full(2, 0.05), loss="soft_l1", x_scale=0.1, diff_step=1e-2, xtol=1e-5, ftol=1e-6
    )
    value = lag + 1e-2 * float(found.x[0])
    # A thickness of the size of the calibration error would look like this much time, as would the noise.
    speed = float(np.median(np.hypot(*_velocity(pose, moving).T)))
    error = float(np.hypot(_CALIBRATION, _RECTIFIED * noise)) / max(speed, 1e-3)
    return Lag(value, error, f"by contact over {int(moving.sum())} rows of motion")


def _velocity(pose: Channel, rows: NDArray[np.bool_]) -> FloatArray:
    time = pose.time[rows]
    return np.asarray((pose.at(time + 0.02) - pose.at(time - 0.02))[:, :2] / 0.04)


def force_lag(setup: Setup, pose: Channel, tip: Channel, force: Channel, near: bool) -> Lag | None:
    """The lag that brings the force's clock to that of object and finger; None if it cannot be found."""
    moving = _moving(setup, pose)
    moving &= gaps(setup, tip.at(pose.time), pose.values) < _AIR
    grid = np.arange(pose.time[0], pose.time[-1], _FORCE_STEP)
    times = np.arange(force.time[0], force.time[-1], _FORCE_STEP)
    if not moving.any() or min(len(times), len(grid)) < 10:
        return None
    pressed = np.interp(grid, pose.time, moving.astype(float))
    cells = np.clip(((force.time - force.time[0]) / _FORCE_STEP).astype(int), 0, len(times) - 1)
    rows = np.maximum(np.bincount(cells, minlength=len(times)), 1)
    shifts = np.arange(len(grid) + len(times) - 1) - len(times) + 1
    lags = pose.time[0] - force.time[0] + _FORCE_STEP * shifts
    inside = np.abs(lags) <= _NEAR_EPOCH if near else np.ones(len(lags), dtype=bool)
    best, coarse = _LEAST_CORRELATION, None
    for rest in _usual_forces(force.values[:, :2]):
        mean = np.bincount(cells, np.hypot(*(force.values[:, :2] - rest).T), len(times)) / rows
        together = np.where(inside, _correlated(pressed - pressed.mean(), mean - mean.mean()), -np.inf)
        scale = float(np.std(pressed) * np.std(mean)) * min(len(grid), len(times))
        place = int(np.argmax(together))
        if scale > 0.0 and together[place] > best * scale:
            best, coarse = float(together[place]) / scale, float(lags[place])
    if coarse is None:
        return None
    touches = _touches(setup, pose, tip)
    rises: list[float] = []
    for shift in _SHIFTS:  # forces that fall off late in a push mislead the correlation
        moved = Channel(force.time + coarse + shift, force.values)
        there = [rise - touch.time for touch in touches if (rise := _rise(moved, touch.time)) is not None]
        if len(there) > len(rises) and (shift == 0.0 or len(there) > 0.5 * len(touches)):
            rises = [rise - shift for rise in there]
    if not rises:
        return Lag(coarse, max(_FORCE_STEP, _row_period(force)), "from when it is large", by_touch=False)
    lag = lag_by_rises(rises, force)
    return lag._replace(value=coarse + lag.value)


def lag_by_rises(rises: Sequence[float], force: Channel) -> Lag:
    """The correction of a force's stamps from its delays of rise at touches.

    A row may hold the force before or after its stamp, so the error includes one row period.
    """
    middle, error = middle_of(rises)
    count = f"{len(rises)} touch{'es' if len(rises) > 1 else ''}"
    return Lag(-middle, float(np.hypot(error, _row_period(force))), f"by its rise at {count}")


def usual_lag(lags: Sequence[Lag | None]) -> Lag | None:
    """The lag that recordings of a session agree on; None if their clocks differ, or they are too few."""
    known = [lag for lag in lags if lag is not None]
    if len(known) < _FEWEST_AGREEING:
        return None
    middle = float(np.median([lag.value for lag in known]))
    centre = Lag(middle, 0.0, "")
    agreeing = [lag for lag in known if lag.by_touch and not lag.contradicts(centre)]
    if len(agreeing) < max(_FEWEST_AGREEING, 0.5 * len(lags)):
        return None
    middle = float(np.median([lag.value for lag in agreeing]))
    return Lag(middle, float(np.median([lag.error for lag in agreeing])), "as in the other recordings")


def _row_period(channel: Channel) -> float:
    """Median time from row to row, s."""
    return float(np.median(np.diff(channel.time))) if len(channel.time) > 1 else 0.0


def _usual_forces(values: FloatArray) -> list[FloatArray]:
    """Up to three frequent forces (2,); one of them is what the sensor reads without contact."""
    chosen = values[spread_rows(len(values), _USUAL_ROWS)]
    noise = float(np.median(np.abs(np.diff(values, axis=0)))) + 1e-9
    near = max(4.0 * noise, 0.02 * float(np.ptp(chosen, axis=0).max()))
    close = np.hypot(*np.moveaxis(chosen[:, None] - chosen[None], -1, 0)) < near
    left = np.ones(len(chosen), dtype=bool)
    found: list[FloatArray] = []
    while len(found) < 3 and left.any():
        members = close[np.argmax((close & left).sum(axis=1) * left)] & left
        found.append(np.asarray(np.median(chosen[members], axis=0)))
        left &= np.hypot(*(chosen - found[-1]).T) > 2.0 * near
    return found


def rises_after_touch(setup: Setup, pose: Channel, tip: Channel, force: Channel) -> list[Rise]:
    """The force's rise at each usable touch."""
    return [
        Rise(rise - touch.time, -touch.gap / touch.approach, touch.gap)
        for touch in _touches(setup, pose, tip)
        if (rise := _rise(force, touch.time)) is not None
    ]


def middle_of(values: Sequence[float]) -> tuple[float, float]:
    """The median, and its standard error from the spread of the values."""
    middle = float(np.median(values))
    spread = 1.4826 * float(np.median(np.abs(np.array(values) - middle)))
    return middle, spread / float(np.sqrt(len(values)))


def lag_left(setup: Setup, pose: Channel, tip: Channel) -> Lag | None:
    """The remaining lag between two nearly aligned clocks; None if the object does not move enough."""
    moving = _moving(setup, pose)
    moving &= (pose.time > tip.time[0] + _EDGE) & (pose.time < tip.time[-1] - _EDGE)
    if int(moving.sum()) < _FEWEST_ROWS:
        return None
    moving[moving] &= gaps(setup, tip.at(pose.time[moving]), pose.values[moving]) < _AIR
    if int(moving.sum()) < _FEWEST_ROWS:
        return None
    lag = _refined(setup, pose, tip, moving, 0.0, _ROWS)
    return None if _touched(setup, pose, tip, moving, lag.value) is None else lag


def _touches(setup: Setup, pose: Channel, tip: Channel) -> list[Touch]:
    """The touches at which the object begins to move."""
    gap = gaps(setup, tip.values, pose.at(tip.time))
    moving = np.interp(tip.time, pose.time, _moving(setup, pose).astype(float)) > 0.5
    found: list[Touch] = []
    for row in np.flatnonzero((gap[1:] <= 0.0) & (gap[:-1] > 0.0)):
        touch = tip.time[row]
        pushed = moving & (tip.time > touch) & (tip.time < touch + _SOON)
        waits = (pose.time > touch - _WAITS) & (pose.time < touch - 0.25 * _WAITS)
        way = np.flatnonzero((tip.time > touch - _PASSES) & (tip.time < touch + _PASSES))
        if not pushed.any() or waits.sum() < 3 or len(way) < 4:
            continue
        # Use the object's resting pose: its rows after the touch would hide the time of the touch.
        early, late = np.array_split(pose.values[waits], 2)
        if np.hypot(*(np.median(late, axis=0) - np.median(early, axis=0))[:2]) > _STARTED:
            continue  # it was already moving; noise of the gap only looks like a touch
        resting = np.median(pose.values[waits], axis=0)
        slope, level = np.polyfit(tip.time[way] - touch, gaps(setup, tip.values[way], resting), 1)
        if slope < -_APPROACH:
            found.append(Touch(float(touch - level / slope), -float(slope), float(np.median(gap[pushed]))))
    kept: list[Touch] = []
    for one in found:
        if not kept or one.time > kept[-1].time + 0.5:
            kept.append(one)
    return kept


def _rise(force: Channel, touch: float) -> float | None:
    """Time at which the force is halfway between its values before and after a touch, s."""
    time = force.time
    near = np.flatnonzero((time > touch - _RISE) & (time < touch + _RISE))
    early, late = near[time[near] < touch - 0.5 * _RISE], near[time[near] > touch + 0.5 * _RISE]
    if len(early) < 3 or len(late) < 3:
        return None
    size = np.hypot(*(force.values[:, :2] - np.median(force.values[early, :2], axis=0)).T)
    before, after = float(np.median(size[early])), float(np.median(size[late]))
    inside = size[near]
    noise = 1.4826 * float(np.median(np.abs(np.diff(inside)))) + 1e-9
    if after - before < 4.0 * noise:
        return None
    level = 0.5 * (before + after)
    above = inside > level
    if level - before > 8.0 * noise:
        step = int(np.argmax(above))  # after the impact, contact may be lost for a moment
    else:
        # The step that separates the rows best: fewest above before it, fewest below after it.
        wrong = np.append(0, np.cumsum(above)) + np.append(np.cumsum(~above[::-1])[::-1], 0)
        step = int(np.argmin(wrong))
    if not 0 < step < len(near):
        return None
    one, two = near[step - 1], near[step]
    share = (level - size[one]) / (size[two] - size[one]) if size[two] > size[one] else 0.5
    return float(time[one] + np.clip(share, 0.0, 1.0) * (time[two] - time[one]))


def wild_rows(time: FloatArray) -> NDArray[np.int_]:
    """Rows whose stamps lie far outside those before and after them, such as 0 where none was taken.

    Stamps that start anew, and pauses, are not among them: a stamp is compared with the median of the rows
    around it, which in order is the stamp itself. At the ends only a stamp out of order counts, or one that
    is over a million seconds away.

    Args:
        time: (T,) s, NaN where unknown.
    """
    known = np.flatnonzero(np.isfinite(time))
    count = 2 * _AROUND + 1
    if len(known) <= count:
        return np.zeros(0, dtype=int)
    stamps = time[known]
    windows = np.lib.stride_tricks.sliding_window_view(stamps, count)
    middle = np.median(windows, axis=1)
    usual = np.concatenate([np.full(_AROUND, middle[0]), middle, np.full(_AROUND, middle[-1])])
    off = stamps - usual
    period = float(np.median(np.abs(np.diff(stamps))))
    wild = np.abs(off) > max(_FAR, _PERIODS * period)
    wild[:_AROUND] &= (off[:_AROUND] > 0.0) | (off[:_AROUND] < -_ELSEWHERE)
    wild[-_AROUND:] &= (off[-_AROUND:] < 0.0) | (off[-_AROUND:] > _ELSEWHERE)
    return known[wild] if wild.sum() <= _MOST_SHARE * len(stamps) else np.zeros(0, dtype=int)


def coarse_text(time: FloatArray, values: FloatArray) -> str:
    """What is odd about stamps that many rows share although their values differ; "" if nothing.

    Args:
        time: (T,) s, in order.
        values: (T, n) of the rows.
    """
    new = np.append(True, np.diff(time) > 0.0)
    moved = np.append(True, (np.diff(values, axis=0) != 0.0).any(axis=1))
    moments = int(new.sum())
    if moments < 2 or int((new | moved).sum()) < _ROWS_A_STAMP * moments:
        return ""
    step = float(np.median(np.diff(time[new])))
    return (
        f"its clock counts in steps of {step:.3g} s only, while the rows change in between; if the rows are"
        " evenly spaced, give their `rate` in Hz"
    )
