"""Sensors that saturate: recognized by the motion that they do not follow, and blanked."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.machine import Machine
from hframe_gym.preparation.sensors.saturation import blank_saturated, range_effects, saturation_ranges
from hframe_gym.recordings import Recording

QUANTUM = 5.2e-4
RADIUS = 0.0194
NOISE = np.array([1.5e-4, 1.5e-4, 2e-5, 2e-5])


def moving_runs(limit: float = 0.1) -> list[Recording]:
    """Return runs along x in which the laser saturates at a limit, m."""
    rng = np.random.default_rng(4)
    time_s = np.arange(2000) * 1e-3
    recordings = []
    for k in range(2):
        x = 0.16 * np.sin(2 * np.pi * time_s * (1 + k))
        turned = np.round(np.column_stack([-x, x]) / RADIUS / QUANTUM) * QUANTUM
        lasers = np.column_stack([np.minimum(x, limit), np.zeros_like(x)]) + rng.normal(0, 2e-5, (2000, 2))
        recordings.append(Recording(f"run_{k}", time_s, np.zeros((2000, 2)), np.hstack([turned, lasers])))
    return recordings


def test_a_saturated_laser_is_recognized_and_blanked(hframe: Machine) -> None:
    recordings = moving_runs()
    ranges = saturation_ranges(recordings, hframe, NOISE)
    assert list(ranges) == ["x_m"]
    low, high = ranges["x_m"]
    assert high == pytest.approx(0.1, abs=2e-5)
    assert low < -1.0
    blanked = blank_saturated(recordings[0], ranges, hframe, NOISE)
    saturated = recordings[0].outputs[:, 2] > 0.1 - 80e-6
    assert np.isnan(blanked.outputs[saturated, 2]).all()
    assert np.isfinite(blanked.outputs[~saturated, 2]).mean() > 0.99
    [effect] = range_effects(ranges)
    assert effect.label == "sensor_range@x_m"
    assert effect.parameters["high"] == high


def test_a_saturated_measurement_with_unusual_noise_is_blanked_as_well(hframe: Machine) -> None:
    """Of 20,000 saturated measurements, one is expected beyond 4 standard deviations of the noise."""
    outputs = np.zeros((6, 4))
    outputs[:, 2] = [0.0999, 0.1, 0.1 - 5 * 2e-5, 0.1, 0.1 - 9 * 2e-5, 0.1 - 5 * 2e-5]
    run = Recording("run", np.arange(6) * 1e-3, np.zeros((6, 2)), outputs)
    blanked = blank_saturated(run, {"x_m": (-1.0, 0.1)}, hframe, NOISE)
    np.testing.assert_array_equal(np.isnan(blanked.outputs[:, 2]), [True, True, True, True, False, False])


def test_a_coordinate_that_rests_is_not_saturated(hframe: Machine) -> None:
    """One motor that rests while the other drives the stage is normal."""
    assert saturation_ranges(moving_runs(limit=1.0), hframe, NOISE) == {}
