"""Tests of parameter uncertainty and of the reasons to doubt a parameter."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import FreeParameter, fit, prepare
from hframe_gym.identification.parameter_diagnostics import parameter_doubts
from hframe_gym.identification.prediction import SIMULATION
from hframe_gym.identification.uncertainty import with_uncertainty
from hframe_gym.machine import BUILTIN_MACHINES, Coordinate, Machine, Uncertainty
from hframe_gym.recordings import Recording

pytestmark = pytest.mark.unit


@pytest.fixture
def axis() -> Machine:
    return BUILTIN_MACHINES["axis"]()


def with_standard_deviations(machine: Machine, relative_std: dict[str, float], correlation: float = 0.0) -> Machine:
    """Attach relative standard deviations by parameter name; the first two parameters are correlated."""
    std = np.array([relative * machine.parameters[name] for name, relative in relative_std.items()])
    correlations = np.eye(len(std))
    correlations[0, 1] = correlations[1, 0] = correlation
    return machine.replace(uncertainty=Uncertainty(tuple(relative_std), np.outer(std, std) * correlations))


def test_covariance_matches_the_closed_form_for_white_noise() -> None:
    """For x = F t^2 / (2 m) and white noise sigma, the standard deviation of m is sigma / |dx/dm|."""
    machine = BUILTIN_MACHINES["axis"]()
    drive = machine.drives[0]
    machine = machine.replace(coordinates=(Coordinate("x", mass=2.0),)).replace({f"{drive.name}.Ke": 0.0})
    time_s = np.arange(1500) * 1e-3
    inputs = np.full((1500, 1), 0.5)
    position = 0.5 * drive.gain * 0.5 * time_s**2 / 2.0
    sigma = 1e-3
    outputs = (position + np.random.default_rng(0).normal(0.0, sigma, 1500))[:, None]
    outputs[0] = 0.0  # the offset of the run is that of its only row at rest
    machine = machine.replace(sensors=(type(machine.sensors[0])("x_m", {"x": 1.0}, noise=sigma),))
    data = prepare([Recording("run", time_s, inputs, outputs)], machine)
    fitted = fit(machine, [FreeParameter("x.mass", 2.0, prior=1.0)], data, SIMULATION)
    uncertainty = with_uncertainty(fitted, data).uncertainty
    assert uncertainty is not None
    std_of_mass = data.noise[0] / np.linalg.norm(position / 2.0)
    assert uncertainty.std("x.mass") == pytest.approx(std_of_mass, rel=0.6)
    assert fitted.values["x.mass"] == pytest.approx(2.0, abs=4 * std_of_mass)


def test_no_doubt_about_well_determined_parameters(axis: Machine) -> None:
    machine = with_standard_deviations(axis, {"x.mass": 0.01, "x.viscous": 0.02}, correlation=0.9)
    assert parameter_doubts(machine, axis) == {"x.mass": [], "x.viscous": []}


def test_high_correlation_names_the_partner(axis: Machine) -> None:
    machine = with_standard_deviations(axis, {"x.mass": 0.01, "x.viscous": 0.01}, correlation=-0.98)
    assert parameter_doubts(machine, axis) == {
        "x.mass": ["correlation -0.980 with x.viscous"],
        "x.viscous": ["correlation -0.980 with x.mass"],
    }


def test_large_deviation_is_attributed_to_the_prior_or_to_the_data(axis: Machine) -> None:
    """The prior of a mass is 30 % wide, that of viscous friction 70 %."""
    machine = with_standard_deviations(axis, {"x.mass": 0.25, "x.viscous": 0.25})
    assert parameter_doubts(machine, axis) == {
        "x.mass": ["determined by the declared value more than by the data"],
        "x.viscous": ["poorly determined"],
    }


def test_parameter_at_a_bound_is_reported(axis: Machine) -> None:
    machine = axis.with_effects(EFFECTS["dead_band"].at("motor", Vd=0.4, drop=1.0))
    machine = with_standard_deviations(machine, {"dead_band@motor.Vd": 0.01, "dead_band@motor.drop": 0.01})
    assert parameter_doubts(machine, axis) == {"dead_band@motor.Vd": [], "dead_band@motor.drop": ["at a bound"]}


def test_machine_without_uncertainty_has_no_doubts(axis: Machine) -> None:
    assert parameter_doubts(axis, axis) == {}
