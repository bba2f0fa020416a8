"""Tests of recursive least squares."""

from __future__ import annotations

import numpy as np

from hframe_gym.controllers.estimation.recursive_least_squares import RecursiveLeastSquares


def test_the_estimates_are_those_of_all_measurements_together() -> None:
    """Corrections one after the other end at the solution of the normal equations with the prior."""
    rng = np.random.default_rng(0)
    std, truth = np.array([0.5, 2.0, 1.0]), np.array([0.3, -1.0, 0.8])
    recursive = RecursiveLeastSquares(std)
    recursive.resize(1)
    recursive.restart(np.array([True]))
    information, vector = np.diag(std**-2.0), np.zeros(3)
    for _ in range(20):
        matrix, variance = rng.normal(size=(2, 3)), rng.uniform(0.1, 1.0, size=2)
        measured = matrix @ truth + rng.normal(size=2) * np.sqrt(variance)
        recursive.correct(measured[None] - recursive.estimates @ matrix.T, matrix[None], variance[None])
        information += matrix.T @ (matrix / variance[:, None])
        vector += matrix.T @ (measured / variance)
    np.testing.assert_allclose(recursive.estimates[0], np.linalg.solve(information, vector), rtol=1e-9)


def test_an_episode_starts_from_the_prior() -> None:
    """A machine whose episode starts forgets its measurements; the others go on."""
    recursive = RecursiveLeastSquares(np.array([1.0]))
    recursive.resize(2)
    recursive.restart(np.ones(2, np.bool_))
    for starts in ([True, False], [False, False]):
        recursive.correct(np.ones((2, 1)), np.ones((2, 1, 1)), np.ones(1))
        recursive.restart(np.array(starts))
    # 1 / 2 after the first measurement; the second one counts a third.
    np.testing.assert_allclose(recursive.estimates, [[0.5], [0.5 + 1.0 / 3.0]])
