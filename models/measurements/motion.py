"""Motion from recorded rows: the smooth track of a finger, and the initial twist of an object in a trial.

A finger moves smoothly, but its record jitters. Fed into the model unsmoothed, jitter rattles the contact
between no force and twice the force, and rectifies into a drift: with jitter of 0.1 mm, ten pushes,
most of them taps, ended 2.4 mm off (docs/lab/estimator.md).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.ndimage import uniform_filter1d

from slipmap.models.physics.cell_grid import FloatArray

_GENTLE_JERK = 10.0  # m/s³; changes of acceleration at this rate are no corners
_FIRST_CHANGE, _ITERATIONS = 3.5, 15  # the first ε in multiples of the noise
_OFF_TRACK = 2.5  # times the noise; rows farther off the track count linearly (Huber)
_SMALLEST_NOISE = 2e-6  # m; rounding of the record is not noise

_WINDOW_ROWS = (6, 8, 11, 16, 23, 32, 45, 64)
_LONGEST_WINDOW = 0.25  # s
_SLOWEST = np.array(
    [0.01, 0.01, 0.1]
)  # m/s, which friction of 0.1 stops within 0.05 mm; rad/s, the same speed at a radius of 0.1 m
_SIGNIFICANCE = 10.0  # least speed in standard errors
_GAIN_OVER_REST = 10.0  # least gain in twice the log-likelihood
_BRIEF_REST = 0.015  # s; an onset this early is equivalent to motion from the start
_TOLERATED_LOSS = 12.0  # against such an onset, which has more parameters
_COARSE_FIT = 0.02  # misfit over travel that still counts as one smooth motion
_FINE_FIT = 0.001  # the same for the window the estimate comes from: bounds its bias by about 1 %
_RESOLUTION = 1e-6  # m and rad; files are rounded to about this
_LEAST_STEPS = np.array([5e-5, 5e-5, np.radians(0.05)])  # m and rad; finer rounding is not told
_FEWEST_SPACINGS = 8  # between distinct values,
_ON_GRID = 0.9  # share of them that are multiples of a step,
_OFF_GRID = 0.05  # to this share of it
_UNEVEN = 0.3  # changes of speed per spacing; even motion without noise has equal spacings too
_FEWEST_EVEN, _LEAST_WAY = 8, 2e-4  # rows that move, by so many m over two spacings, to judge stamps by
_UNEVEN_STAMPS = 0.7  # interquartile range of the spacings over their median
_SMOOTHER = 2.0  # times; over the rows of 45 recorded and simulated datasets, no other finger reaches both
_HUBER = 1.345  # residual in standard deviations above which a row counts less (Huber 1964)
_HUBER_ITERATIONS = 8


def spread_rows(count: int, most: int) -> NDArray[np.int_]:
    """At most `most` of so many rows, by index: spread evenly, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, most).astype(int))


def interpolated(
    wanted: float | Sequence[float] | np.ndarray, times: np.ndarray, values: FloatArray
) -> FloatArray:
    """(…, c) values at wanted times (…), linear between ascending times (M,) with values (M, c), constant
    beyond."""
    return np.stack([np.interp(wanted, times, column) for column in values.T], axis=-1)


def smooth_track(
    time: FloatArray, track: FloatArray, pairs: int = 8
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The track of a finger whose acceleration changes rarely, but then by any amount.

    A robot speeds up, moves, slows down and stops, each at its own acceleration. Windows of any width either
    blunt these corners or let jitter pass; both change how far a struck object slides. So the likeliest track
    x minimises, with the noise σ of the rows y,

        Σ huber(|y - x| / σ) + 3/2 Σ log(1 + |Δ³x|² / ε²),

    where third differences Δ³x of consecutive rows, the changes of acceleration, are distributed as Cauchy's,
    and single rows off the track, such as those with a late time stamp, count linearly. Each iteration solves
    a least-squares problem with the weights of the last one. ε falls from 3.5 σ, which keeps the search from
    poor minima, to what a jerk of 10 m/s³ makes of rows so far apart. σ is estimated from third differences,
    which are small in smooth motion.

    Where jitter hides a corner, the likeliest track puts it at one place or another, a little too fast or too
    slow, and a struck object slides as far as the fastest moment lets it: too far, however the jitter falls.
    So the result is the mean of the likeliest tracks of records with as much noise again (bagging). These
    scatter about it as it does about the true track.

    Args:
        time: (T,) increasing, s; rows may jitter in time.
        track: (T, 2) positions, m.
        pairs: of opposite draws of noise; fewer are the first of more.

    Returns:
        Times (M,) at the median rate over the same span, the track there, (M, 2), and the likeliest tracks
        (N, M, 2), the second half with the opposite noise of the first. Tracks of fewer than twelve rows come
        back as they are, and alone.
    """
    if len(time) < 12:
        return time, track, track[None]
    step = float(np.median(np.diff(time)))
    grid = np.linspace(time[0], time[-1], round((time[-1] - time[0]) / step) + 1)
    raw = interpolated(grid, time, track)
    third = np.abs(np.diff(raw, 3, axis=0))
    noise = max(float((np.median(third, axis=0) / 0.6745 / np.sqrt(20.0)).max()), _SMALLEST_NOISE)
    more = np.random.default_rng(0).standard_normal((pairs, *raw.shape))
    noisier = (raw - raw[0]) + noise * np.concatenate([more, -more])
    noise *= np.sqrt(2.0)
    least = min(_FIRST_CHANGE, _GENTLE_JERK * step**3 / noise)
    likeliest = raw[0] + noise * _likeliest(noisier / noise, least)
    return grid, likeliest.mean(axis=0), likeliest


def _likeliest(rows: FloatArray, least: float) -> FloatArray:
    """Likeliest tracks (N, T, 2) for records (N, T, 2), in multiples of their noise; `least` is ε."""
    smooth = rows
    weight, counts = np.zeros(rows.shape[:2]), np.ones(rows.shape[:2])
    changes = np.zeros_like(weight[:, 3:])
    for epsilon in np.geomspace(_FIRST_CHANGE, least, _ITERATIONS):
        weight[:, :-3] = 3.0 / (changes + epsilon**2)
        smooth = _least_squares(rows, counts, weight)
        changes = (np.diff(smooth, 3, axis=1) ** 2).sum(axis=-1)
        counts = _OFF_TRACK / np.maximum(np.linalg.norm(smooth - rows, axis=-1), _OFF_TRACK)
    return smooth


def _least_squares(rows: FloatArray, counts: FloatArray, weight: FloatArray) -> FloatArray:
    """x (N, T, c) that minimises Σ counts |x - rows|² + Σ weight |Δ³x|², for weights (N, T).

    All tracks are one system, in which the last three weights of each, zero, part it from the next.
    """
    upper = np.zeros((4, counts.size))  # of the symmetric matrix with three diagonals beside the main one
    upper[3] = counts.ravel()
    parts = weight.ravel()[:-3]
    third = (-1.0, 3.0, -3.0, 1.0)
    for i, left in enumerate(third):
        for j, right in enumerate(third[i:], i):
            upper[3 - (j - i), j : j + len(parts)] += left * right * parts
    solution = solveh_banded(upper, (counts[..., None] * rows).reshape(counts.size, -1))
    return solution.reshape(rows.shape)


def initial_twist(time: FloatArray, pose: FloatArray) -> FloatArray:
    """Velocity (v_x, v_y, omega) at the first pose; exactly zero unless the rows say otherwise.

    The first 6, 8, 11 … rows (at most 0.25 s) are fitted with a quadratic in time by Huber's robust
    regression. The object counts as moving when, for one of these windows,

    1. the quadratic fits within twice the noise or within 2 % of the travel,
    2. its initial speed exceeds 0.01 m/s or 0.1 rad/s and ten standard errors, and
    3. it explains the rows better, by 10 in twice the log-likelihood, than every history that begins at rest:
       a constant pose over the first k >= 2 rows, followed by any quadratic or by nothing. If that rest ends
       within 0.015 s, the two are nearly indistinguishable and equivalent for a simulation, so the quadratic
       only has to be not clearly worse.

    The estimate is then taken from the longest window that a quadratic fits within the noise.

    Noise is the robust spread of each row about the line through its neighbours. This misses slow wander of a
    tracker, so the thresholds are far above those for independent rows; wander over three standard deviations
    of a row within the window can still pass for a slow start, in under 1 % of trials. Rounding slow motion
    to rest costs little: friction stops anything slower than the least speeds within a tenth of a millimetre.

    Args:
        time: (T,) s, increasing.
        pose: (T, 3) x, y in m and unwrapped angle in rad.

    Returns:
        (3,) world velocity in m/s, m/s, rad/s. Zeros for fewer than six rows, which are too few.
    """
    noise = pose_scatter(time, pose)
    within = int(np.searchsorted(time, time[0] + _LONGEST_WINDOW, side="right"))
    sizes = [size for size in _WINDOW_ROWS if size <= within]
    for position, size in enumerate(sizes):
        if _moves(time[:size] - time[0], pose[:size], noise):
            return _longest_fit(time - time[0], pose, noise, sizes[position:])
    return np.zeros(3)


def _moves(time: FloatArray, pose: FloatArray, noise: FloatArray) -> bool:
    basis = _quadratic(time)
    coefficients, residual = _huber_fit(basis, pose, noise)
    travel = np.ptp(basis @ coefficients, axis=0)
    misfit = _robust_spread(residual)
    if np.any(misfit > np.maximum(2.0 * noise, _COARSE_FIT * travel)):
        return False
    velocity = np.abs(coefficients[1])
    slope_weights = np.linalg.pinv(basis)[1]
    standard_error = np.maximum(noise, misfit) * np.linalg.norm(slope_weights)
    fast = velocity > _SLOWEST
    if not np.any(fast & (velocity > _SIGNIFICANCE * standard_error)):
        return False
    scale = np.maximum(np.maximum(noise, misfit), 0.5 * _COARSE_FIT * travel)
    cost = _huber_cost(residual, scale)
    return all(
        _cost_from_rest(time, pose, noise, scale, rows)
        > cost + (_GAIN_OVER_REST if time[rows - 1] > _BRIEF_REST else -_TOLERATED_LOSS)
        for rows in range(len(time), 1, -1)
    )


def _cost_from_rest(
    time: FloatArray, pose: FloatArray, noise: FloatArray, scale: FloatArray, resting_rows: int
) -> float:
    """Cost of the best history that rests over its first rows and is quadratic after them."""
    _, residual = _huber_fit(np.ones((resting_rows, 1)), pose[:resting_rows], noise)
    cost = _huber_cost(residual, scale)
    if len(time) - resting_rows > 3:  # three rows or fewer are met exactly
        _, residual = _huber_fit(_quadratic(time[resting_rows:]), pose[resting_rows:], noise)
        cost += _huber_cost(residual, scale)
    return cost


def _longest_fit(time: FloatArray, pose: FloatArray, noise: FloatArray, sizes: list[int]) -> FloatArray:
    """Velocity from the longest window that fits: a short one may exceed the noise by chance."""
    velocity = np.zeros(3)
    for size in sizes:
        basis = _quadratic(time[:size])
        coefficients, residual = _huber_fit(basis, pose[:size], noise)
        travel = np.ptp(basis @ coefficients, axis=0)
        fits = np.all(_robust_spread(residual) <= np.maximum(1.25 * noise, _FINE_FIT * travel))
        if size == sizes[0] or fits:
            velocity = coefficients[1]
    return velocity


def _quadratic(time: FloatArray) -> FloatArray:
    return np.stack([np.ones_like(time), time, time**2], axis=1)


def pose_scatter(time: FloatArray, pose: FloatArray) -> FloatArray:
    """(3,) standard deviation of a pose's x, y and angle, at least what rounding alone makes."""
    return np.maximum(row_noise(time, pose), rounding_noise([pose]))


def row_noise(time: FloatArray, values: FloatArray) -> FloatArray:
    """(c,) robust standard deviation of a row (c,) from the line through its neighbours."""
    if len(time) < 3:
        return np.full(values.shape[1], _RESOLUTION)
    share = ((time[1:-1] - time[:-2]) / (time[2:] - time[:-2]))[:, None]
    distance = values[1:-1] - (1.0 - share) * values[:-2] - share * values[2:]
    spread = _robust_spread(distance / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2))
    return np.maximum(spread, _RESOLUTION)


def white_noise(values: FloatArray) -> FloatArray:
    """Standard deviation of white noise in each column, from the median of second differences: these have six
    times the variance of white noise, and the median rejects real acceleration."""
    second = values[2:] - 2.0 * values[1:-1] + values[:-2]
    smooth = uniform_filter1d(second, 5, axis=0)
    return np.median(np.abs(second - smooth), axis=0) / 0.6745 / np.sqrt(6.0 * 0.8)


def rounding_noise(tracks: Sequence[FloatArray]) -> FloatArray:
    """(3,) standard deviation that the rounding of x, y and angle alone makes; 0 where none shows."""
    return rounding_steps(tracks) / np.sqrt(12.0)


def rounding_steps(tracks: Sequence[FloatArray]) -> FloatArray:
    """(3,) steps in which x, y and angle of poses (T, 3) come, m and rad; 0 where they come in none.

    Steps below 0.05 mm or 0.05° are not told.
    """
    steps = np.array([_step([track[:, column] for track in tracks]) for column in range(3)])
    return np.where(steps > _LEAST_STEPS, steps, 0.0)


def _step(tracks: Sequence[FloatArray]) -> float:
    """Step by which the values of all tracks differ, a whole number of times; 0 if there is none."""
    spacings = np.concatenate([np.diff(np.unique(track)) for track in tracks] or [np.zeros(0)])
    spacings = spacings[spacings > _RESOLUTION]
    if len(spacings) < _FEWEST_SPACINGS:
        return 0.0
    for parts in range(1, 6):  # a fast object skips values
        rough = float(np.median(spacings)) / parts
        times = np.maximum(np.round(spacings / rough), 1.0)
        step = float(np.median(spacings / times))
        if np.mean(np.abs(spacings / step - times) < _OFF_GRID) < _ON_GRID:
            continue
        changes = sum(int((np.abs(np.diff(track, 2)) > 0.5 * step).sum()) for track in tracks)
        return step if changes > _UNEVEN * len(spacings) else 0.0
    return 0.0


def stamp_jitter(time: FloatArray, place: FloatArray) -> float | None:
    """Standard deviation by which the stamps of evenly spaced rows jitter, s; 0 where nothing says so.

    Rows are taken for even if their stamps vary widely, but a row lies nearer the middle between its
    neighbours than where their stamps would have it. Where rows are missing it is the other way round.

    Args:
        time: (T,) s.
        place: (T, 2) of what moves smoothly, such as a finger, m.

    Returns:
        None if too few rows move.
    """
    if len(time) < _FEWEST_EVEN:
        return None
    before, after = np.diff(time)[:-1], np.diff(time)[1:]
    ahead = place[2:] - place[:-2]
    way = np.hypot(*ahead.T)
    moves = way > max(0.3 * float(np.percentile(way, 90)), _LEAST_WAY)
    if moves.sum() < _FEWEST_EVEN:
        return None
    low, middle, high = np.percentile(before, [25, 50, 75])
    if high - low < _UNEVEN_STAMPS * middle:
        return 0.0
    share = (before / (before + after))[:, None]
    off = [np.hypot(*(place[1:-1] - place[:-2] - part * ahead).T)[moves] for part in (0.5, share)]
    if _SMOOTHER * np.median(off[0]) > np.median(off[1]):
        return 0.0
    row = np.arange(len(time))
    left = time - np.polyval(np.polyfit(row, time, 1), row)
    return float(_robust_spread(left[:, None])[0])


def _robust_spread(residual: FloatArray) -> FloatArray:
    """Standard deviation from the median distance to zero (the factor 1.4826 is for Gaussian rows)."""
    # The same as np.median, which takes ten times as long for so few rows.
    ordered = np.sort(np.abs(residual), axis=0)
    return 1.4826 * 0.5 * (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])


def _huber_cost(residual: FloatArray, scale: FloatArray) -> float:
    size = np.abs(residual) / scale
    return float(np.sum(np.where(size <= _HUBER, size**2, 2.0 * _HUBER * size - _HUBER**2)))


def _huber_fit(basis: FloatArray, values: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients (p, 3) and residuals (m, 3) by iteratively reweighted least squares."""
    widths = np.max(np.abs(basis), axis=0)
    orthonormal, triangle = np.linalg.qr(basis / widths)
    weights = np.ones_like(values)
    for _ in range(_HUBER_ITERATIONS):
        normal = np.einsum("mp,mc,mq->cpq", orthonormal, weights, orthonormal)
        right = np.einsum("mp,mc,mc->cp", orthonormal, weights, values)
        solution = np.linalg.solve(normal, right[..., None])[..., 0].T
        residual = values - orthonormal @ solution
        size = np.abs(residual) / np.maximum(_robust_spread(residual), noise)
        weights = _HUBER / np.maximum(size, _HUBER)
    return np.linalg.solve(triangle, solution) / widths[:, None], residual
