"""Tests of joint samples of parameters."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.envs.correlated_samples import CorrelatedSampler, pivoted_cholesky

pytestmark = pytest.mark.unit


def test_factor_of_a_singular_covariance_with_very_different_units():
    change, std = np.array([1e3, 2e-7, 0.0]), np.array([1e-2, 1e-12, 0.0])
    covariance = np.outer(change, change) + np.diag(std**2)
    factor = pivoted_cholesky(covariance, np.array([1e4, 1e-6, 1.0]))
    np.testing.assert_allclose(factor @ factor.T, covariance, rtol=1e-9)
    assert factor[1] @ factor[1] - factor[1, 0] ** 2 == pytest.approx(2e-24, rel=1e-3)  # beside the common change


def test_sums_that_are_known_better_than_their_terms_are_kept_at_the_limits():
    """a + 2 b is known to 1 %, a alone to 100 %."""
    change, known = np.array([1.0, -0.5]), np.array([0.01, 0.0])
    covariance = np.outer(change, change) + np.outer(known, known)
    nominal, lower, upper = np.array([1.0, 2.0]), np.zeros(2), np.array([np.inf, 2.2])
    sampler = CorrelatedSampler(covariance, nominal, lower, upper)
    values = nominal + sampler.deviations(np.random.default_rng(0).random((20000, 2)))
    assert (values @ [1.0, 2.0]).std() == pytest.approx(0.01, rel=0.05)
    assert values[:, 1].max() < 2.25
    assert values[:, 0].min() > 0.5
    assert (np.abs(values - nominal) <= sampler.reach).all()


def test_a_parameter_without_spread_is_constant():
    sampler = CorrelatedSampler(np.zeros((1, 1)), np.zeros(1), np.zeros(1), np.ones(1))
    assert (sampler.deviations(np.array([[0.1], [0.9]])) == 0.0).all()
