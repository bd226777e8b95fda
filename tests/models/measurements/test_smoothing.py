"""Smoothing of a finger's track."""

from __future__ import annotations

import numpy as np

from slipmap.models.measurements.motion import _least_squares


def test_the_banded_solution_is_that_of_the_full_equations_of_each_track() -> None:
    rng = np.random.default_rng(0)
    rows, counts = rng.normal(size=(3, 30, 2)), rng.uniform(0.1, 1.0, (3, 30))
    weight = np.pad(rng.uniform(0.0, 50.0, (3, 27)), ((0, 0), (0, 3)))
    third = np.diff(np.eye(30), 3, axis=0)
    found = _least_squares(rows, counts, weight)
    for x, own, count, parts in zip(found, rows, counts, weight[:, :-3], strict=True):
        equations = np.diag(count) + third.T @ np.diag(parts) @ third
        np.testing.assert_allclose(x, np.linalg.solve(equations, count[:, None] * own), atol=1e-12)
