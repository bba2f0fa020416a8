from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording, fill_gaps


def test_lost_rows_come_back_blank_with_inputs_between_their_neighbours() -> None:
    time = 3.0 + np.arange(10) * 1e-3
    run = Recording("r", time, np.arange(20.0).reshape(10, 2), np.ones((10, 4)))
    keep = np.ones(10, bool)
    keep[[4, 5, 8]] = False
    filled = fill_gaps(Recording("r", time[keep], run.inputs[keep], run.outputs[keep]))
    np.testing.assert_allclose(filled.time_s, time, atol=1e-12)
    np.testing.assert_allclose(filled.inputs, run.inputs, atol=1e-9)
    np.testing.assert_array_equal(np.isnan(filled.outputs).all(axis=1), ~keep)


def test_a_whole_or_a_jittered_run_stays_as_it_is() -> None:
    time = np.arange(50) * 1e-3 + np.random.default_rng(0).uniform(-2e-4, 2e-4, 50)
    run = Recording("r", time, np.zeros((50, 2)), np.zeros((50, 4)))
    assert fill_gaps(run) is run
    single = Recording("r", time[:1], np.zeros((1, 2)), np.zeros((1, 4)))
    assert fill_gaps(single) is single


def test_the_motion_after_a_gap_is_nearer_than_with_the_input_held_on(hframe: Machine) -> None:
    """The stage driven by a sine of 20 Hz, three rows in a hundred lost: simulated ends under both readings."""
    time = np.arange(2000) * 1e-3
    inputs = 6 * np.sin(2 * np.pi * 20 * time)[:, None] * [1.0, 0.5] + [2.0, -1.0]
    whole = hframe.simulate(time, inputs).outputs
    keep = np.random.default_rng(1).random(2000) > 0.03
    keep[0] = True
    lost = Recording("r", time[keep], inputs[keep], whole[keep])
    held = hframe.simulate(lost.time_s, lost.inputs).outputs - lost.outputs
    filled = fill_gaps(lost)
    error = hframe.simulate(filled.time_s, filled.inputs).outputs - filled.outputs
    assert np.nanstd(error[:, 2]) < 0.3 * np.std(held[:, 2])
    assert np.nanstd(error[:, 2]) == pytest.approx(0.0, abs=2e-4)
