"""Tests of the sizes of effects and of their standard deviations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification.evidence.effect_parameters import parameter_values, sizes
from hframe_gym.machine import Uncertainty
from tests.identification.scripted_fits import HFRAME, fit_with


def test_the_size_of_an_effect_is_as_certain_as_its_form_permits() -> None:
    """Runs that are slower than the speed scale tell the product only, which may be certain."""
    friction = EFFECTS["stribeck_friction"].at("x", dF=2.0, vs=0.03)
    names = ("x.mass", "stribeck_friction@x.vs", "stribeck_friction@x.dF")
    correlation = np.array([[1.0, 0.0, 0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 1.0]])
    correlation[1, 2] = correlation[2, 1] = 0.79
    stds = np.array([0.1, 0.05, 5.0])
    machine = HFRAME.with_effects(friction).replace(
        uncertainty=Uncertainty(names, correlation * np.outer(stds, stds))
    )
    (size,) = sizes(friction, machine)
    assert (size.name, size.unit, size.value) == ("dF", "N", 2.0)
    assert size.std == pytest.approx(5.0 * np.sqrt(1.0 - 0.79**2))
    assert sizes(friction, machine.replace(uncertainty=None)) == ()
    assert sizes(EFFECTS["current_limit"].at("motor1", I=1.0), machine) == ()


@pytest.mark.parametrize(("std_of_speed", "std_of_size", "expected"), [(0.0, 5.0, 5.0), (0.05, 0.0, 0.0)])
def test_parameters_without_a_variance_were_held(
    std_of_speed: float, std_of_size: float, expected: float
) -> None:
    friction = EFFECTS["stribeck_friction"].at("x", dF=2.0, vs=0.03)
    names = ("stribeck_friction@x.vs", "stribeck_friction@x.dF")
    uncertainty = Uncertainty(names, np.diag([std_of_speed**2, std_of_size**2]))
    (size,) = sizes(friction, HFRAME.with_effects(friction).replace(uncertainty=uncertainty))
    assert size.std == expected


def test_an_effect_in_proportion_to_an_uncertain_coefficient_may_be_certain() -> None:
    """Viscous friction and back-EMF act alike; the difference between directions is known anyway."""
    drag = EFFECTS["asymmetric_viscous"].at("phi1", a=0.3)
    names = ("phi1.viscous", "asymmetric_viscous@phi1.a")
    covariance = np.array([[1.0, -0.99], [-0.99, 1.0]]) * np.outer([1e-5, 0.4], [1e-5, 0.4])
    (size,) = sizes(drag, HFRAME.with_effects(drag).replace(uncertainty=Uncertainty(names, covariance)))
    assert size.std == pytest.approx(0.4 * np.sqrt(1.0 - 0.99**2))


@pytest.mark.parametrize(
    ("name", "site", "simpler"),
    [
        ("interpolation_error", "phi1_rad", {1.0: "eccentric_encoder"}),
        ("interpolation_error", "x_m", {}),  # an encoder of a turn only
        ("cogging", "motor1", {1.0: "unbalance"}),  # which acts on the coordinate of the motor
    ],
)
def test_a_simpler_effect_acts_at_the_same_place(name: str, site: str, simpler: dict[float, str]) -> None:
    effect = EFFECTS[name].at(site, A=0.01, n=1.0, p=0.7)
    fitted = dataclasses.replace(fit_with(chi2=1.0), machine=HFRAME.with_effects(effect))
    assert {p.name: p.simpler for p in parameter_values(effect.label, fitted)} == {
        "A": {},
        "n": simpler,
        "p": {},
    }
