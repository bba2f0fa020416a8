from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers.dd2_filter import moments, points


def test_a_linear_map_is_exact() -> None:
    """Mean A m and covariance A P A', also of a covariance that is singular."""
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(5, 4, 3))
    mean, covariance = rng.normal(size=(5, 4)), roots @ roots.transpose(0, 2, 1)
    A = rng.normal(size=(6, 4))
    found, spread = moments(points(mean, covariance, np.zeros(4)) @ A.T)
    np.testing.assert_allclose(found, mean @ A.T, atol=1e-12)
    np.testing.assert_allclose(spread, A @ covariance @ A.T, atol=1e-6)


@pytest.mark.parametrize("mean", [0.0, 1.5])
def test_the_square_of_a_normal_variable(mean: float) -> None:
    """E x^2 = m^2 + s^2 and var x^2 = 4 m^2 s^2 + 2 s^4."""
    s = 0.7
    found, spread = moments(points(np.array([[mean]]), np.array([[[s**2]]]), np.zeros(1)) ** 2)
    assert found[0, 0] == pytest.approx(mean**2 + s**2, rel=1e-6)
    assert spread[0, 0, 0] == pytest.approx(4.0 * mean**2 * s**2 + 2.0 * s**4, rel=1e-6)


def test_what_is_known_is_asked_at_the_least_distance() -> None:
    asked = points(np.zeros((1, 2)), np.zeros((1, 2, 2)), np.array([1e-8, 1e-6]))
    np.testing.assert_allclose(asked[0, 1:3], np.sqrt(3.0) * np.diag([1e-8, 1e-6]))
