"""Tests of the balance of forces over windows of measured motion."""

from __future__ import annotations

import numpy as np

from hframe_gym.identification import prepare
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.preparation.forces.force_balance import force_balance
from hframe_gym.preparation.forces.motion_windows import motion_windows
from hframe_gym.recordings import Recording


def test_the_balance_returns_inertia_and_friction() -> None:
    """The simulator is the oracle: any windows give the declared inertia and friction with back-EMF."""
    axis = BUILTIN_MACHINES["axis"]()
    time = np.arange(4000) * 1e-3
    volts = np.repeat(np.random.default_rng(0).uniform(-6, 6, 80), 50)[:, None]
    run = Recording("run", time, volts, axis.simulate(time, volts).outputs)
    data = prepare([run], axis)
    one = np.eye(1)
    for span in (0.005, 0.02):
        balance = force_balance([motion_windows(data.runs[0], span)], axis, one, one)
        assert balance is not None
        assert balance.unexplained < 1e-3
        np.testing.assert_allclose(balance.inertia, 1.0, atol=0.02)
        np.testing.assert_allclose(balance.viscous, 1.0, atol=0.1)  # windows smooth reversals
    swapped = force_balance([motion_windows(data.runs[0], 0.02)], axis, -one, one)
    assert swapped is not None
    assert swapped.unexplained > 0.5


def test_windows_agree_with_the_accelerations_of_a_known_motion() -> None:
    """Input and position of a mass m under a force F that changes within a window: m z'' = F for means."""
    time = np.arange(0.0, 1.0, 1e-3)
    force = np.repeat(np.random.default_rng(2).uniform(-1.0, 1.0, 1000 // 8), 8)
    speed = np.concatenate([[0.0], np.cumsum(force * 1e-3)])[:1000]
    position = np.concatenate([[0.0], np.cumsum(speed[:-1] * 1e-3 + force[: len(speed) - 1] * 5e-7)])
    axis = BUILTIN_MACHINES["axis"]()
    [run] = prepare([Recording("run", time, force[:, None], position[:, None])], axis).runs
    windows = motion_windows(run, 0.02)
    np.testing.assert_allclose(windows.acceleration, windows.inputs, atol=2e-4)


def test_a_run_that_is_shorter_than_the_windows_gives_no_rows() -> None:
    axis = BUILTIN_MACHINES["axis"]()
    time = np.arange(30) * 1e-3
    [run] = prepare([Recording("run", time, np.ones((30, 1)), time[:, None] ** 2)], axis).runs
    windows = motion_windows(run, 0.05)
    assert windows.position.shape == (0, 1)
    assert force_balance([windows], axis, np.eye(1), np.eye(1)) is None
    assert force_balance([], axis, np.eye(1), np.eye(1)) is None


def test_blank_measurements_are_left_out() -> None:
    axis = BUILTIN_MACHINES["axis"]()
    time = np.arange(3000) * 1e-3
    volts = 5.0 * np.sign(np.sin(7 * time))[:, None]
    outputs = axis.simulate(time, volts).outputs.copy()
    outputs[1000:1500] = np.nan
    [run] = prepare([Recording("run", time, volts, outputs)], axis).runs
    windows = motion_windows(run, 0.02)
    assert np.isnan(windows.acceleration).any()
    balance = force_balance([windows], axis, np.eye(1), np.eye(1))
    assert balance is not None
    assert balance.unexplained < 0.01
