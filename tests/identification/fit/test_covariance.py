"""Tests of parameter uncertainty."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.identification import FreeParameter, fit, prepare
from hframe_gym.identification.fit.covariance import with_uncertainty
from hframe_gym.identification.predict.prediction import SIMULATION
from hframe_gym.machine import BUILTIN_MACHINES, Coordinate
from hframe_gym.recordings import Recording


def test_covariance_matches_the_closed_form_for_white_noise() -> None:
    """For x = F t^2 / (2 m) and white noise sigma, the standard deviation of m is sigma / |dx/dm|."""
    machine = BUILTIN_MACHINES["axis"]()
    drive = machine.drives[0]
    machine = machine.replace(coordinates=(Coordinate("x", mass=2.0),)).replace({f"{drive.name}.Ke": 0.0})
    time_s = np.arange(1500) * 1e-3
    inputs = np.full((1500, 1), 0.5)
    position = 0.5 * drive.gain * 0.5 * time_s**2 / 2.0
    sigma, rng = 1e-3, np.random.default_rng(0)
    recordings = []
    for k in range(8):
        outputs = (position + rng.normal(0.0, sigma, 1500))[:, None]
        outputs[0] = 0.0  # the zero of the run is that of its only row at rest
        recordings.append(Recording(f"run_{k}", time_s, inputs, outputs))
    machine = machine.replace(sensors=(type(machine.sensors[0])("x_m", {"x": 1.0}, noise=sigma),))
    data = prepare(recordings, machine)
    fitted = fit(machine, [FreeParameter("x.mass", 2.0, prior=1.0)], data, SIMULATION)
    uncertainty = with_uncertainty(fitted, data).uncertainty
    assert uncertainty is not None
    std_of_mass = data.noise[0] / np.linalg.norm(position / 2.0) / np.sqrt(8)
    assert uncertainty.std("x.mass") == pytest.approx(std_of_mass, rel=0.5)
    assert fitted.values["x.mass"] == pytest.approx(2.0, abs=4 * std_of_mass)
