"""Tests of standard deviations that outliers hardly change."""

import numpy as np
import pytest

from hframe_gym.robust_statistics import std_by_median, white_noise


def test_one_wild_value_in_ten_changes_the_standard_deviation_little() -> None:
    rng = np.random.default_rng(1)
    samples = rng.normal(0.0, 2.0, (4000, 2))
    wild = np.where(rng.random(samples.shape) < 0.1, 1e6, samples)
    np.testing.assert_allclose(std_by_median(samples, axis=0), 2.0, rtol=0.05)
    np.testing.assert_allclose(std_by_median(wild, axis=0), 2.0, rtol=0.2)


@pytest.mark.parametrize("order", [2, 3])
def test_noise_is_found_below_motion_that_is_a_hundred_times_as_large(order: int) -> None:
    rng = np.random.default_rng(2)
    pieces = [np.sin(np.linspace(0.0, 6.0, n)) + rng.normal(0.0, 0.01, n) for n in (1500, 2500)]
    assert white_noise(pieces, order) == pytest.approx(0.01, rel=0.06)


def test_pieces_that_are_too_short_have_no_noise() -> None:
    assert white_noise([np.arange(3.0), np.zeros(0)], 3) == 0.0
