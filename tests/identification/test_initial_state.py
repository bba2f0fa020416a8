from __future__ import annotations

import numpy as np

from hframe_gym.identification import estimate_initial_state
from hframe_gym.identification.initial_state import resting_rows
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording


def recording(outputs: np.ndarray, change: int) -> Recording:
    inputs = np.zeros((len(outputs), 2))
    inputs[change:] = 3.0
    return Recording("r", np.arange(len(outputs)) * 1e-3, inputs, outputs)


def test_lasers_place_the_machine_and_encoders_get_an_offset(hframe: Machine) -> None:
    rng = np.random.default_rng(3)
    x, y = 0.11, -0.07
    outputs = np.tile([0.0, 0.0, x, y], (200, 1))
    outputs[:, 2:] += rng.normal(0, 20e-6, (200, 2))
    start = estimate_initial_state(recording(outputs, 100), hframe)
    assert start.rows == 101
    phi = np.array([-(x + y), x - y]) / 0.0194
    np.testing.assert_allclose(start.state[:2], [x, y], atol=1e-5)
    np.testing.assert_allclose(start.state[2:4], phi, atol=1e-3)
    np.testing.assert_allclose(start.offset[:2], -phi, atol=1e-3)
    np.testing.assert_allclose(start.offset[2:], 0.0, atol=1e-9)


def test_encoders_alone_place_the_machine(hframe: Machine) -> None:
    x, y = 0.05, 0.02
    outputs = np.tile([-(x + y) / 0.0194, (x - y) / 0.0194, np.nan, np.nan], (20, 1))
    start = estimate_initial_state(recording(outputs, 10), hframe)
    np.testing.assert_allclose(start.state[:2], [x, y], atol=1e-9)
    np.testing.assert_allclose(start.offset, 0.0, atol=1e-9)


def test_a_run_that_is_driven_from_its_first_row_rests_one_row() -> None:
    outputs = np.zeros((30, 4))
    assert resting_rows(recording(outputs, 0)) == 1
    assert resting_rows(recording(outputs, 30)) == 30
