"""Tests of what the recordings alone show of the sensors: quantum and noise."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.preparation.sensors.noise import (
    difference_noise,
    independent_values,
    sensor_noise,
    sensor_quantum,
)
from hframe_gym.recordings import quantum_of

QUANTUM = 5.2e-4


def moving_encoder(seed: int, rows: int = 3000) -> np.ndarray:
    """Return the measurements of an encoder that moves at random, rad."""
    path = np.cumsum(np.random.default_rng(seed).normal(0, 2e-3, rows))
    return np.asarray(np.round(path / QUANTUM) * QUANTUM)


def test_a_quantized_channel_shows_its_quantum_and_a_noisy_one_none() -> None:
    smooth = np.cumsum(np.random.default_rng(0).normal(0, 2e-3, 3000))
    assert quantum_of(moving_encoder(0)) == pytest.approx(QUANTUM)
    assert quantum_of(smooth) == 0.0
    assert quantum_of(np.full(100, np.nan)) == 0.0


def test_steady_speed_is_no_quantum() -> None:
    """A tachometer-like run: nearly all changes are equal to within 2 %, but add up to no multiples."""
    speed = np.random.default_rng(0).uniform(0.98, 1.02, 300)
    speed[:5] = np.linspace(0.3, 0.9, 5)
    assert quantum_of(7.0 * np.cumsum(speed)) == 0.0


@pytest.mark.parametrize("resting", [1, 2, 3, 5])
def test_resting_runs_do_not_count_for_the_quantum(resting: int) -> None:
    """The median over all runs is half the quantum where half of the runs rest, and zero where most do."""
    channel = [moving_encoder(1), moving_encoder(2), *[np.full(3000, 0.7)] * resting]
    assert sensor_quantum(channel, 0.0) == pytest.approx(QUANTUM)


def test_a_sensor_that_never_moves_has_its_declared_resolution() -> None:
    assert sensor_quantum([np.full(3000, 0.7)] * 4, 1e-3) == 1e-3


def fast_encoder(seed: int) -> np.ndarray:
    """A run of 400 rows in which an encoder counts tens of steps from row to row."""
    counts = np.cumsum(np.rint(40.0 * np.sin(np.arange(400) / 37.0) + 25.0 + seed))
    return QUANTUM * counts


@pytest.mark.parametrize("finer", [1.0, 12.5, 45.45])
def test_an_encoder_in_fast_motion_has_the_step_of_its_values(finer: float) -> None:
    """No two rows that follow each other differ by one step, but values of other rows do."""
    channel = [fast_encoder(seed) for seed in range(4)]
    assert all(quantum_of(values) == 0.0 for values in channel)
    assert sensor_quantum(channel, QUANTUM / finer) == pytest.approx(QUANTUM, rel=1e-6)


def test_values_of_other_steps_than_declared_have_the_declared_resolution() -> None:
    """Interpolated counts have no step, and a file's last digit is none of the encoder."""
    channel = [np.round(np.convolve(fast_encoder(s), [0.3, 0.45, 0.25], "valid"), 9) for s in range(4)]
    assert sensor_quantum(channel, QUANTUM) == QUANTUM


def test_repeated_measurements_of_a_resting_encoder_count_as_one() -> None:
    """At rest an encoder repeats one rounding error; in slow motion, and with noise, measurements differ."""
    time_s = np.arange(300) * 1e-3
    moving = QUANTUM * np.concatenate([np.zeros(100), 0.1 * np.arange(100), np.full(100, 9.0)])
    outputs = np.column_stack([np.floor(moving / QUANTUM) * QUANTUM, moving, np.full(300, np.nan)])
    counts = independent_values(time_s, outputs, np.array([QUANTUM, 0.0, QUANTUM]))
    # at rest, and the first ten milliseconds of motion
    np.testing.assert_allclose(counts[:110, 0], 1.0 / 110)
    np.testing.assert_allclose(counts[110:190, 0], 1.0)
    np.testing.assert_allclose(counts[190:, 0], 1.0 / 110)
    np.testing.assert_allclose(counts[:, 1], 1.0)
    np.testing.assert_allclose(counts[:, 2], 0.0)


def test_missing_measurements_do_not_end_a_rest() -> None:
    values = np.full((100, 1), 0.7)
    values[::2] = np.nan
    counts = independent_values(np.arange(100) * 1e-3, values, np.array([QUANTUM]))
    np.testing.assert_allclose(counts[1::2], 1.0 / 50)
    np.testing.assert_allclose(counts[::2], 0.0)


@pytest.mark.parametrize("every", [2, 5])
def test_blank_cells_of_a_slow_encoder_do_not_change_the_quantum(every: int) -> None:
    channel = []
    for seed in range(4):
        values = moving_encoder(seed)
        values[np.arange(len(values)) % every != 0] = np.nan
        channel.append(values if seed % 2 else np.where(np.isfinite(values), 0.7, np.nan))
    assert sensor_quantum(channel, 0.0) == pytest.approx(QUANTUM)


def test_noise_is_that_of_the_resting_rows_and_not_of_a_slow_creep() -> None:
    rng = np.random.default_rng(1)
    creep = 1e-3 * np.linspace(0.0, 1.0, 400) ** 2
    channel = [creep + rng.normal(0, 35e-6, 400) for _ in range(3)]
    assert sensor_noise(channel, [400] * 3, 0.0, 1.0) == pytest.approx(35e-6, rel=0.1)


def test_noise_without_resting_rows_is_the_declared_one_or_that_of_third_differences() -> None:
    rng = np.random.default_rng(2)
    channel = [np.sin(np.arange(3000) * 1e-3) + rng.normal(0, 35e-6, 3000)]
    assert sensor_noise(channel, [1], 0.0, 2e-5) == 2e-5
    assert sensor_noise(channel, [1], 0.0, 0.0) == pytest.approx(35e-6, rel=0.1)
    assert sensor_noise(channel, [1], 1.0, 2e-5) == pytest.approx(1 / np.sqrt(12))
    assert sensor_noise([np.full(50, np.nan)], [1], 0.0, 0.0) == 1.0


@pytest.mark.parametrize("speed", [0.2, 0.45, 0.7, 3.3])
def test_the_steps_of_a_coarse_encoder_in_motion_are_no_noise(speed: float) -> None:
    # speed: steps per row
    channel = [np.rint(speed * np.arange(3000) + 10 * np.sin(np.arange(3000) * 1e-3)) * 0.2]
    assert sensor_noise(channel, [1], 0.2, 0.0) == pytest.approx(0.2 / np.sqrt(12))
    noisy = [channel[0] + np.random.default_rng(3).normal(0.0, 0.5, 3000)]
    assert sensor_noise(noisy, [1], 0.2, 0.0) == pytest.approx(0.5, rel=0.1)
    # Noise of half a step is larger than rounding, although third differences of the steps alone may be as
    # large.
    motion = speed * np.arange(3000) + 10 * np.sin(np.arange(3000) * 1e-3)
    small = [np.rint(motion + np.random.default_rng(3).normal(0.0, 0.5, 3000)) * 0.2]
    assert sensor_noise(small, [1], 0.2, 0.0) == pytest.approx(0.2 * np.hypot(0.5, 1 / np.sqrt(12)), rel=0.1)


def test_noise_of_a_slow_sensor_comes_from_its_measurements() -> None:
    """A sensor that measures in every fifth row has no third differences between neighboring rows."""
    rng = np.random.default_rng(0)
    values = np.full(5000, np.nan)
    values[::5] = rng.normal(0.0, 20e-6, 1000)
    assert sensor_noise([values], [1], 0.0, 0.0) == pytest.approx(20e-6, rel=0.2)


def test_noise_of_straight_lines_is_that_of_their_kinks() -> None:
    """A logger that averages over pulses writes lines of 10 rows: most third differences vanish."""
    rng = np.random.default_rng(4)
    ends = 80.0 + rng.normal(0.0, 0.3, 301)
    lines = np.interp(np.arange(3000), np.arange(301) * 10, ends)
    noise = sensor_noise([lines], [1], 0.0, 0.0)
    assert 0.003 < noise < 0.3
    assert sensor_noise([10.0 * lines, 10.0 * lines], [1, 1], 0.0, 0.0) == pytest.approx(10.0 * noise)
    assert sensor_noise([lines], [1], 0.0, 2e-5) == 2e-5
    # Without kinks and with a kink in every row, third differences decide as before.
    smooth = np.sin(np.arange(3000) * 1e-3)
    assert sensor_noise([smooth], [1], 0.0, 0.0) == pytest.approx(difference_noise([smooth]))
