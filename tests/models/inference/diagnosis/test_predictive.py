"""The score of pushes left out agrees with leaving them out."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from slipmap.models.inference.diagnosis.correlated import PushEquations


@pytest.fixture
def problem() -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    rng = np.random.default_rng(3)
    jacobians = [rng.normal(size=(rows, 4)) for rows in (7, 5, 9)]
    truth = rng.normal(size=4)
    residuals = [J @ truth + rng.normal(size=len(J)) for J in jacobians]
    return jacobians, residuals, np.array([1.0, 4.0, 0.3, 2.0])


def density_of_left_out(jacobians, residuals, precision, b: int) -> float:
    """log p(r_b | others) by conditioning, with nothing of the implementation's algebra."""
    others = [k for k in range(len(jacobians)) if k != b]
    hessian = np.diag(precision) + sum(jacobians[k].T @ jacobians[k] for k in others)
    z = -np.linalg.solve(hessian, sum(jacobians[k].T @ residuals[k] for k in others))
    J = jacobians[b]
    covariance = np.eye(len(J)) + J @ np.linalg.inv(hessian) @ J.T
    found = multivariate_normal(np.zeros(len(J)), covariance).logpdf(residuals[b] + J @ z)
    return float(found + 0.5 * len(J) * np.log(2 * np.pi))


class TestScores:
    def test_equal_refits_without_the_push(self, problem) -> None:
        jacobians, residuals, precision = problem
        equations = PushEquations.of(jacobians, [r[:, None] for r in residuals])
        scores, _ = equations.scores(np.arange(4), precision)
        for b in range(3):
            assert scores[b, 0] == pytest.approx(density_of_left_out(*problem, b), abs=1e-10)

    def test_columns_left_out_are_not_used(self, problem) -> None:
        jacobians, residuals, precision = problem
        columns = np.array([2, 0])
        all_of_it = PushEquations.of(jacobians, [r[:, None] for r in residuals])
        part = PushEquations.of([J[:, columns] for J in jacobians], [r[:, None] for r in residuals])
        scores, best = all_of_it.scores(columns, precision[columns])
        expected, best_expected = part.scores(np.arange(2), precision[columns])
        np.testing.assert_allclose(scores, expected, atol=1e-12)
        np.testing.assert_allclose(best, best_expected, atol=1e-12)

    def test_many_residuals_at_once(self, problem) -> None:
        jacobians, residuals, precision = problem
        rng = np.random.default_rng(1)
        many = [np.column_stack([r, rng.normal(size=(len(r), 3))]) for r in residuals]
        together, _ = PushEquations.of(jacobians, many).scores(np.arange(4), precision)
        for column in range(4):
            alone = PushEquations.of(jacobians, [r[:, column : column + 1] for r in many])
            np.testing.assert_allclose(together[:, column], alone.scores(np.arange(4), precision)[0][:, 0])

    def test_pull_holds_the_optimum(self, problem) -> None:
        # At an optimum of data and prior together the best change is none, if the prior's gradient is told.
        jacobians, residuals, precision = problem
        hessian = np.diag(precision) + sum(J.T @ J for J in jacobians)
        z = -np.linalg.solve(hessian, sum(J.T @ r for J, r in zip(jacobians, residuals, strict=True)))
        there = [(r + J @ z)[:, None] for J, r in zip(jacobians, residuals, strict=True)]
        equations = PushEquations.of(jacobians, there)
        _, best = equations.scores(np.arange(4), precision, precision * z)
        np.testing.assert_allclose(best, 0.0, atol=1e-12)
