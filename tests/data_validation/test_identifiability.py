"""Cramer-Rao bounds against a closed form, and parameters that recordings do not determine."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.data_validation import cramer_rao_bounds
from hframe_gym.data_validation.identifiability import CramerRaoBound, check_parameters, findings_of_bounds
from hframe_gym.identification import prepare
from hframe_gym.machine import BUILTIN_MACHINES, Coordinate, Machine
from hframe_gym.recordings import Recording
from tests.data_validation.planted_mistakes import measure


@pytest.fixture
def cart() -> Machine:
    """Return an axis with viscous friction only and no back-EMF, whose motion has a closed form."""
    axis = BUILTIN_MACHINES["axis"]()
    drive = axis.drives[0]
    return axis.replace(coordinates=(Coordinate("x", mass=2.0, viscous=5.0),)).replace(
        {f"{drive.name}.Ke": 0.0}
    )


@pytest.mark.oracle
def test_bounds_of_mass_and_friction_equal_the_closed_form(cart: Machine) -> None:
    """The response to a step of force F is x = (F/b) (t - tau (1 - exp(-t/tau))) with tau = m/b."""
    m, b, force = 2.0, 5.0, cart.drives[0].gain * 3.0
    noise = cart.sensors[0].noise
    time = np.arange(1500) * 1e-3
    inputs = np.full((1500, 1), 3.0)

    def x(m: float, b: float) -> np.ndarray:
        tau = m / b
        return force / b * (time - tau * (1 - np.exp(-time / tau)))

    h = 1e-5
    slopes = np.stack([x(m * (1 + h), b) - x(m * (1 - h), b), x(m, b * (1 + h)) - x(m, b * (1 - h))]) / (
        2 * h * noise
    )
    # The sensor is not quantized, so the zero of the run is fitted.
    slopes -= slopes.mean(axis=1, keepdims=True)
    expected = np.sqrt(np.diag(np.linalg.inv(slopes @ slopes.T)))
    data = prepare([Recording("r", time, inputs, x(m, b)[:, None])], cart)
    np.testing.assert_allclose(data.noise, noise)
    bounds = cramer_rao_bounds(data, cart, ["x.mass", "x.viscous"])
    np.testing.assert_allclose([bound.relative_std for bound in bounds], expected, rtol=0.02)
    assert bounds[0].partner == "x.viscous"


def test_parameters_that_act_only_as_a_product_are_inseparable(cart: Machine) -> None:
    time = np.arange(1500) * 1e-3
    inputs = 3.0 * np.sin(6 * time)[:, None]
    data = prepare([Recording("r", time, inputs, cart.simulate(time, inputs).outputs)], cart)
    torque_constant, ratio = cramer_rao_bounds(data, cart, ["motor.Kt", "motor.gear_ratio"])
    assert (torque_constant.partner, ratio.partner) == ("motor.gear_ratio", "motor.Kt")
    assert abs(torque_constant.correlation) > 0.999


def test_parameters_of_a_machine_that_never_moves_have_infinite_bounds(hframe: Machine) -> None:
    time = np.arange(800) * 1e-3
    data = prepare([Recording("r", time, np.zeros((800, 2)), np.zeros((800, 4)))], hframe)
    bounds = cramer_rao_bounds(data, hframe, ["x.mass", "x.coulomb", "left.EA"])
    assert [bound.relative_std for bound in bounds] == [np.inf] * 3


def test_friction_of_a_motor_is_inseparable_from_its_back_emf(hframe: Machine) -> None:
    """Both are viscous friction of the motor's coordinate, so no recording separates them."""
    time = np.arange(1000) * 1e-3
    inputs = np.column_stack([6 * np.sin(9 * time), 5 * np.sin(7 * time)])
    outputs = measure(hframe, hframe.simulate(time, inputs).outputs)
    data = prepare([Recording("r", time, inputs, outputs)], hframe)
    friction, back_emf = cramer_rao_bounds(data, hframe, ["phi1.viscous", "motor1.Ke"])
    assert friction.partner == "motor1.Ke"
    assert friction.correlation < -0.999
    assert friction.relative_std > 0.1
    assert friction.relative_std > back_emf.relative_std


def test_the_sum_of_viscous_friction_and_back_emf_is_reported_and_not_each_alone() -> None:
    """An axis whose friction alone is as large as this sum is equivalent, so the bounds are equal."""
    axis = BUILTIN_MACHINES["axis"]()
    drive = axis.drives[0]
    total = axis.parameters["x.viscous"] + drive.gain * drive.gear_ratio * drive.Ke
    equivalent = axis.replace({"x.viscous": total, f"{drive.name}.Ke": 0.0})
    time = np.arange(1500) * 1e-3
    inputs = 4.0 * np.sign(np.sin(6.0 * time))[:, None]
    data = prepare([Recording("r", time, inputs, axis.simulate(time, inputs).outputs)], axis)
    [damping] = [f for f in check_parameters(data, axis) if "viscous" in f.channel or "Ke" in f.channel]
    assert (damping.severity, damping.channel) == ("note", f"x.viscous and {drive.name}.Ke")
    [expected] = [b for b in cramer_rao_bounds(data, equivalent) if b.name == "x.viscous"]
    assert "only their sum can be determined" in damping.message
    stated = float(damping.message.partition("at least ")[2].partition(" %")[0])
    assert stated == pytest.approx(100 * expected.relative_std, rel=0.05)


@pytest.mark.parametrize(
    ("relative_std", "severity", "message"),
    [
        (0.001, "note", "standard error at least 0.1 %"),
        (
            0.3,
            "advice",
            "standard error at least 30 %; cannot be separated from x.viscous (correlation +0.990)",
        ),
    ],
)
def test_correlated_parameters_are_inseparable_only_if_they_are_inaccurate(
    relative_std: float, severity: str, message: str
) -> None:
    (finding,) = findings_of_bounds([CramerRaoBound("x.mass", relative_std, "x.viscous", 0.99)])
    assert (finding.severity, finding.message) == (severity, message)


def test_parameters_without_influence_share_one_finding() -> None:
    (finding,) = findings_of_bounds(
        [CramerRaoBound(name, np.inf, "", 0.0) for name in ("x.mass", "x.viscous")]
    )
    assert str(finding) == "advice: x.mass, x.viscous: have no influence on these runs"


def test_parameters_that_are_not_determined_share_one_finding() -> None:
    """Set points that a stiff drive follows leave standard errors of 1e5 % and more."""
    stds = {"x.mass": 1e3, "x.viscous": 20.0, "motor.Kt": 0.5}
    bounds = [CramerRaoBound(name, std, "", 0.0) for name, std in stds.items()]
    undetermined, poor = findings_of_bounds(bounds)
    assert str(undetermined).startswith("advice: x.mass, x.viscous: not determined by these runs")
    assert (poor.channel, poor.message) == ("motor.Kt", "standard error at least 50 %")
