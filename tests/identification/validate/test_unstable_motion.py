"""Where a motion is unstable, a simulation enlarges an error as small as the noise, at any moment of a run."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.identification import prepare
from hframe_gym.identification.validate.unstable_motion import enlargement
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import Recording
from tests.identification.single_axis import AXIS, limited_runs


@pytest.mark.parametrize(("angle", "low", "high"), [(1.0, 0.0, 1.1), (2.9, 20.0, np.inf)])
def test_a_pendulum_near_its_top_enlarges_an_error(angle: float, low: float, high: float) -> None:
    """A controller swings it to an angle, where it keeps it; the error of the start shrinks before."""
    pendulum = BUILTIN_MACHINES["pendulum"]()
    time_s, state, voltages, measured = np.arange(700) * 5e-3, np.zeros(2), [], []
    for time in time_s:
        target = angle * float(np.clip(time - 0.3, 0.0, 1.0))
        voltages.append(np.clip(20.0 * (target - state[0]) - 1.5 * state[1], -12.0, 12.0))
        measured.append(state[0])
        step = simulate(pendulum, [0.0, 5e-3], [[voltages[-1]], [0.0]], state)
        state = np.array([step.positions[1, 0], step.velocities[1, 0]])
    run = Recording("run", time_s, np.array(voltages)[:, None], np.array(measured)[:, None])
    assert low <= enlargement(pendulum, prepare([run], pendulum), 15.0) <= high


def test_an_axis_enlarges_no_error() -> None:
    assert enlargement(AXIS, prepare(limited_runs([4.0]), AXIS), 15.0) == pytest.approx(1.0, abs=0.2)
