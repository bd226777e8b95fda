"""Smoothing of a finger's track."""

from __future__ import annotations

import numpy as np

from slipmap.models.measurements.motion import _least_squares


def test_the_banded_solution_is_that_of_the_full_equations() -> None:
    rng = np.random.default_rng(0)
    rows, counts, weight = rng.normal(size=(30, 2)), rng.uniform(0.1, 1.0, 30), rng.uniform(0.0, 50.0, 27)
    third = np.diff(np.eye(30), 3, axis=0)
    expected = np.linalg.solve(np.diag(counts) + third.T @ np.diag(weight) @ third, counts[:, None] * rows)
    np.testing.assert_allclose(_least_squares(rows, counts, weight), expected, atol=1e-12)
