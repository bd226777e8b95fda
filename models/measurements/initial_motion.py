"""The twist with which an object enters a trial, and the test that tells it from rest."""

from __future__ import annotations

import numpy as np
from models.physics.cell_grid import FloatArray

FEWEST_ROWS = 6
WINDOW_ROWS = (6, 8, 11, 16, 23, 32, 45, 64)
LONGEST_WINDOW = 0.25  # s
SLOWEST_SPEED = 0.01  # m/s; friction of 0.1 stops it within 0.05 mm
SLOWEST_TURN = 0.1  # rad/s; the same speed at the rim of an object of 0.1 m
RESOLUTION = 1e-6  # m and rad; files round to about this
EVIDENCE_AGAINST_REST = 100.0  # least gain in twice the log-likelihood
EVIDENCE_AGAINST_ONSET = 10.0
BRIEF_REST = 0.015  # s; an onset this early is as good as motion from the start
TOLERATED_LOSS = 12.0  # against such an onset, which has one parameter a channel more
SIGNIFICANCE = 5.0  # least speed in standard errors
COARSE_FIT = 0.02  # misfit over travel that still counts as one smooth motion
FINE_FIT = 0.001  # the same for the window the estimate comes from: bounds the bias by about 1 %
HUBER = 1.345  # residual in standard deviations above which a row counts less (Huber 1964)


def initial_twist(time: FloatArray, pose: FloatArray) -> FloatArray:
    """Velocity (v_x, v_y, omega) at the first pose; exactly zero unless the rows say otherwise.

    The first 6, 8, 11 … rows (at most 0.25 s) are fitted with a quadratic in time by Huber's robust
    regression. The object counts as moving when, for one of these windows,
    (1) the quadratic fits within twice the noise or within 2 % of the travel,
    (2) its initial speed exceeds 0.01 m/s or 0.1 rad/s and five standard errors, and
    (3) it explains the rows better than every history that begins at rest: a constant pose, and, where
    a finger can push, a constant pose over the first k >= 2 rows followed by any quadratic. "Better" is
    a gain of 30 in twice the log-likelihood, so an onset between the first rows is not taken for motion.
    The estimate is then taken from the longest window that a quadratic fits within the noise.

    Noise is the robust spread of each row about the line through its neighbours, so slow wander of a
    tracker goes unnoticed by (3); the least speeds in (2) are there for it. Friction stops anything
    slower within less than a tenth of a millimetre, so rounding it to rest costs nothing.

    Args:
        time: (T,) s, increasing.
        pose: (T, 3) x, y in m and unwrapped angle in rad.
        can_be_pushed: whether a finger is near; without one an object at rest stays there.

    Returns:
        (3,) world velocity in m/s, m/s, rad/s. Zeros for fewer than six rows: too few to tell.
    """
    noise = _row_noise(time, pose)
    within = int(np.searchsorted(time, time[0] + LONGEST_WINDOW, side="right"))
    sizes = [size for size in WINDOW_ROWS if size <= within]
    for position, size in enumerate(sizes):
        if _moves(time[:size] - time[0], pose[:size], noise):
            return _longest_fit(time - time[0], pose, noise, sizes[position:])
    return np.zeros(3)


def _moves(time: FloatArray, pose: FloatArray, noise: FloatArray) -> bool:
    basis = _quadratic(time)
    coefficients, residual = _huber_fit(basis, pose, noise)
    travel = np.ptp(basis @ coefficients, axis=0)
    misfit = _robust_spread(residual)
    if np.any(misfit > np.maximum(2.0 * noise, COARSE_FIT * travel)):
        return False
    scale = np.maximum(np.maximum(noise, misfit), 0.5 * COARSE_FIT * travel)
    velocity = np.abs(coefficients[1])
    standard_error = np.maximum(noise, misfit) * np.sqrt(np.linalg.inv(basis.T @ basis)[1, 1])
    fast = velocity > np.array([SLOWEST_SPEED, SLOWEST_SPEED, SLOWEST_TURN])
    if not np.any(fast & (velocity > SIGNIFICANCE * standard_error)):
        return False
    cost = _huber_cost(residual, scale)
    return all(
        _cost_from_rest(time, pose, noise, scale, rows) > cost + _needed_gain(time, rows)
        for rows in range(len(time), 1, -1)
    )


def _needed_gain(time: FloatArray, rows: int) -> float:
    if rows == len(time):
        return EVIDENCE_AGAINST_REST
    return EVIDENCE_AGAINST_ONSET if time[rows - 1] > BRIEF_REST else -TOLERATED_LOSS


def _cost_from_rest(time: FloatArray, pose: FloatArray, noise: FloatArray, scale: FloatArray, rows: int) -> float:
    """Cost of the best history that rests over the first `rows` rows and is quadratic after them."""
    _, residual = _huber_fit(np.ones((rows, 1)), pose[:rows], noise)
    cost = _huber_cost(residual, scale)
    if len(time) - rows > 3:  # three rows or fewer are met exactly
        _, residual = _huber_fit(_quadratic(time[rows:]), pose[rows:], noise)
        cost += _huber_cost(residual, scale)
    return cost


def _longest_fit(time: FloatArray, pose: FloatArray, noise: FloatArray, sizes: list[int]) -> FloatArray:
    velocity = np.zeros(3)
    for size in sizes:
        basis = _quadratic(time[:size])
        coefficients, residual = _huber_fit(basis, pose[:size], noise)
        travel = np.ptp(basis @ coefficients, axis=0)
        fits = np.all(_robust_spread(residual) <= np.maximum(1.25 * noise, FINE_FIT * travel))
        if size > sizes[0] and not fits:
            break
        velocity = coefficients[1]
    return velocity


def _quadratic(time: FloatArray) -> FloatArray:
    return np.stack([np.ones_like(time), time, time**2], axis=1)


def _row_noise(time: FloatArray, pose: FloatArray) -> FloatArray:
    """(3,) robust standard deviation of a row, from its distance to the line through its neighbours."""
    if len(time) < 3:
        return np.full(3, RESOLUTION)
    late = ((time[1:-1] - time[:-2]) / (time[2:] - time[:-2]))[:, None]
    distance = pose[1:-1] - (1.0 - late) * pose[:-2] - late * pose[2:]
    return np.maximum(_robust_spread(distance / np.sqrt(1.0 + late**2 + (1.0 - late) ** 2)), RESOLUTION)


def _robust_spread(residual: FloatArray) -> FloatArray:
    """Standard deviation from the median distance to zero (1.4826 makes it exact for Gaussian rows)."""
    return 1.4826 * np.median(np.abs(residual), axis=0)


def _huber_cost(residual: FloatArray, scale: FloatArray) -> float:
    size = np.abs(residual) / scale
    return float(np.sum(np.where(size <= HUBER, size**2, 2.0 * HUBER * size - HUBER**2)))


def _huber_fit(basis: FloatArray, values: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients (p, 3) and residuals (m, 3) by iteratively reweighted least squares."""
    widths = np.maximum(np.max(np.abs(basis), axis=0), np.finfo(float).tiny)
    design = basis / widths
    weights = np.ones_like(values)
    coefficients = np.empty((basis.shape[1], values.shape[1]))
    residual = values
    for _ in range(8):
        root = np.sqrt(weights)
        for column in range(values.shape[1]):
            weight = root[:, column]
            solution, *_ = np.linalg.lstsq(design * weight[:, None], values[:, column] * weight)
            coefficients[:, column] = solution
        residual = values - design @ coefficients
        size = np.abs(residual) / np.maximum(_robust_spread(residual), noise)
        weights = HUBER / np.maximum(size, HUBER)
    return coefficients / widths[:, None], residual
