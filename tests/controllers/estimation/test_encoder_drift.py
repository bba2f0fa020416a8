"""Tests of the decision whether encoders drift, on simulated recordings of the estimator's machine."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers import encoders_drift
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.machine import Machine, rest_state
from hframe_gym.recordings import Recording
from tests.controllers.closed_loop import PERIOD
from tests.controllers.estimation.test_state_estimator import RigMeasurements, with_rig

ROWS = 601  # at 1 kHz


def recording(machine: Machine, crept_m: float, seed: int) -> Recording:
    """Return a run of 0.6 s, at rest at first, then with new voltages every 4 ms, while a belt creeps."""
    time_s = 1e-3 * np.arange(ROWS)
    volts = np.repeat(np.random.default_rng(seed).uniform(-9.0, 9.0, (ROWS // 4 + 1, 2)), 4, axis=0)[:ROWS]
    volts[:20] = 0.0
    positions = simulate(machine, time_s, volts, rest_state(machine, np.array([0.05, -0.05]))).positions[
        :, :4
    ]
    positions[:, 2] += np.linspace(0.0, crept_m, ROWS) / machine.travel_per_unit[2]
    return Recording(f"run_{seed}", time_s, volts, RigMeasurements(np.inf, seed)(positions))


@pytest.mark.parametrize("delay_s", [0.0, 0.013])
@pytest.mark.parametrize(("crept_m", "drift"), [(0.0, False), (2e-4, True)])
def test_encoders_drift_where_a_belt_creeps(
    hframe: Machine, crept_m: float, drift: bool, delay_s: float
) -> None:
    if delay_s:
        hframe = hframe.with_effects(EFFECTS["input_delay"].at("drives", d=delay_s))
    runs = [recording(hframe, crept_m, seed) for seed in (5, 6)]
    assert encoders_drift(with_rig(hframe, np.inf), runs, PERIOD) == drift


def test_what_cannot_be_compared_is_refused(hframe: Machine) -> None:
    machine, run = with_rig(hframe, np.inf), recording(hframe, 0.0, 5)
    with pytest.raises(InputError, match="at least one recording"):
        encoders_drift(machine, [], PERIOD)
    with pytest.raises(InputError, match=r"run_5 takes less than a control period, 1 s"):
        encoders_drift(machine, [run], 1.0)
    run.outputs[20, 1] = np.nan
    with pytest.raises(InputError, match="channel 1"):
        encoders_drift(machine, [run], PERIOD)
