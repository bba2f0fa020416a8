"""The jitter of the clock, from measurements in fast motion."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.preparation.clock.jitter import clock_jitter


@pytest.mark.parametrize("jitter", [0.0, 20e-6])
def test_clock_jitter_is_estimated_from_fast_motion(jitter: float) -> None:
    rng = np.random.default_rng(0)
    time_s = np.arange(2000) * 1e-3
    late = time_s + rng.normal(0.0, jitter, 2000) if jitter else time_s
    channel = 8.0 * np.sin(9.0 * late) + rng.normal(0.0, 0.15e-3, 2000)
    assert clock_jitter([time_s], [channel], 0.15e-3) == pytest.approx(jitter, rel=0.15)


def test_the_steps_of_a_coarse_encoder_are_no_clock_jitter() -> None:
    time_s = np.arange(3000) * 1e-3
    channel = np.rint(450.0 * time_s + 10 * np.sin(time_s)) * 0.2  # about 0.45 steps per row
    assert clock_jitter([time_s], [channel], 0.2 / np.sqrt(12)) == 0.0


def test_a_vibration_is_no_clock_jitter() -> None:
    time_s = np.arange(2000) * 1e-3
    channel = 8.0 * np.sin(9.0 * time_s) + 1e-3 * np.sin(2 * np.pi * 60.0 * time_s)
    channel += np.random.default_rng(0).normal(0.0, 0.15e-3, 2000)
    assert clock_jitter([time_s], [channel], 0.15e-3) == 0.0


def test_a_jitter_of_more_than_half_a_period_is_none() -> None:
    """A sensor that keeps values for four rows deviates from smooth motion by several periods' travel."""
    time_s = np.arange(2000) * 1e-3
    held = np.sin(8.0 * time_s)[np.arange(2000) // 4 * 4]
    assert clock_jitter([time_s], [held], 1e-5) == 0.0
    late = time_s + np.random.default_rng(0).uniform(-0.5e-3, 0.5e-3, 2000)
    assert clock_jitter([time_s], [np.sin(8.0 * late)], 1e-5) == pytest.approx(
        1e-3 / np.sqrt(12),
        rel=0.2,  # the median of squares is that of a normal distribution
    )
