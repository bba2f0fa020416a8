"""Random numbers: distribution, independence, dependence on key, step and channel; joint samples."""

import numpy as np
import pytest
from scipy.stats import kstest, norm

from hframe_gym.envs.randomization.random_numbers import (
    RESET_STEP,
    CorrelatedSampler,
    _log,
    cos_sin_of_turns,
    normal_pair,
    pivoted_cholesky,
    reset_uniforms,
    uniform,
)

KEY = np.uint64(0xDEADBEEF12345678)


def test_uniform_numbers_along_key_step_and_channel():
    for numbers in (
        [uniform(np.uint64(k), 3, 1) for k in range(5000)],
        [uniform(KEY, step, 1) for step in range(5000)],
        [uniform(KEY, 3, channel) for channel in range(5000)],
    ):
        assert 0.0 < min(numbers) < max(numbers) < 1.0
        assert kstest(numbers, "uniform").pvalue > 1e-3
        assert abs(np.corrcoef(numbers[1:], numbers[:-1])[0, 1]) < 0.05


def unmix(z):
    """Return the number whose `_mix` is z: the inverse of the finalizer of SplitMix64."""
    for shift, factor in ((31, 0x94D049BB133111EB), (27, 0xBF58476D1CE4E5B9), (30, None)):
        # The upper bits of an xorshift are unchanged; each pass restores `shift` more of the lower ones.
        restored = z
        for _ in range(64 // shift + 1):
            restored = z ^ (restored >> shift)
        z = restored if factor is None else restored * pow(factor, -1, 2**64) % 2**64
    return z


def test_the_numbers_of_a_reset_are_below_one():
    golden, key = 0x9E3779B97F4A7C15, 2**64 - 1  # the hash whose number rounds to 1, then its inputs
    for factor in (1, RESET_STEP + 1, 1):  # of channel 0, of the step, of the key
        key = (unmix(key) - golden * factor) % 2**64
    assert uniform(np.uint64(key), RESET_STEP, 0) == 1.0
    assert reset_uniforms(np.array([key], np.uint64), 1)[0, 0] == 1.0 - 2.0**-53


def test_normal_pairs_are_normal_and_independent():
    pairs = np.array([normal_pair(KEY, step, 0) for step in range(20000)])
    for column in pairs.T:
        assert kstest(column, norm.cdf).pvalue > 1e-3
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 0.03
    assert abs(np.corrcoef(pairs[1:, 0], pairs[:-1, 1])[0, 1]) < 0.03


def test_the_numbers_of_a_reset_do_not_depend_on_other_resets():
    keys = np.arange(7, dtype=np.uint64)
    together = reset_uniforms(keys, 5)
    np.testing.assert_array_equal(reset_uniforms(keys[3:4], 5)[0], together[3])
    np.testing.assert_array_equal(reset_uniforms(keys, 2), together[:, :2])


@pytest.mark.parametrize("x", [1e-17, 0.3, 0.70710678, 0.7072, 1.0, 1.5, 7e5])
def test_logarithm(x):
    assert _log(x) == pytest.approx(np.log(x), rel=1e-12, abs=1e-13)


def test_cosine_and_sine():
    u = np.linspace(0.0, 1.0, 1001)
    both = np.array([cos_sin_of_turns(v) for v in u])
    np.testing.assert_allclose(
        both, np.stack([np.cos(2 * np.pi * u), np.sin(2 * np.pi * u)], axis=1), atol=1e-14
    )


def test_factor_of_a_singular_covariance_with_very_different_units():
    change, std = np.array([1e3, 2e-7, 0.0]), np.array([1e-2, 1e-12, 0.0])
    covariance = np.outer(change, change) + np.diag(std**2)
    factor = pivoted_cholesky(covariance, np.array([1e4, 1e-6, 1.0]))
    np.testing.assert_allclose(factor @ factor.T, covariance, rtol=1e-9)
    # beside the common change
    assert factor[1] @ factor[1] - factor[1, 0] ** 2 == pytest.approx(2e-24, rel=1e-3)


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
