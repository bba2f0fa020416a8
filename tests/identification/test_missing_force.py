"""Tests of the missing force: on carriages that no sensor measures, and the variables on which it depends."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.dynamics.simulation import simulate_batch
from hframe_gym.effects import EFFECTS
from hframe_gym.identification.dataset import prepare
from hframe_gym.identification.periodogram import periodogram_peaks
from hframe_gym.identification.residual import _correlation_ratio, missing_force
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("axis", ["x", "y"])
def test_encoders_alone_show_the_period_of_the_friction_of_a_carriage(hframe: Machine, axis: str) -> None:
    machine = dataclasses.replace(hframe, sensors=hframe.sensors[:2])
    rough = machine.with_effects(EFFECTS["position_friction"].at(axis, A=0.3, L=0.02, p=1.0))
    time_s = np.arange(4000) * 1e-3
    inputs = 8.0 * np.sin(2 * np.pi * np.outer(time_s, [0.7, 0.45]))
    inputs[:200] = 0.0
    readings = simulate_batch(rough, time_s, inputs).readings[0]
    data = prepare([Recording("run_01", time_s, inputs, readings)], machine)
    motion = missing_force(machine, data)[axis]
    strongest = periodogram_peaks(motion, data.period, friction=True)[0]
    assert 2 * np.pi / strongest == pytest.approx(0.02, rel=0.03)


def test_an_input_at_rest_does_not_stand_for_time() -> None:
    """Equal values of a variable belong to one bin; in the order of the samples they would be bins of time."""
    drift = np.linspace(-1.0, 1.0, 1600)
    assert _correlation_ratio(drift, np.where(drift < 0.9, 0.0, drift)) < 0.2
    assert _correlation_ratio(drift, drift) > 0.95
