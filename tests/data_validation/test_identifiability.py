from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.data_validation.identifiability import told
from hframe_gym.identification import prepare
from hframe_gym.machine import BUILTIN_MACHINES, Coordinate, Machine
from hframe_gym.recordings import Recording


@pytest.fixture
def cart() -> Machine:
    """Viscous friction alone, no back-EMF: everything has a closed form."""
    axis = BUILTIN_MACHINES["axis"]()
    drive = axis.drives[0]
    return axis.replace(coordinates=(Coordinate("x", mass=2.0, viscous=5.0),)).replace({f"{drive.name}.Ke": 0.0})


def test_the_bound_is_that_of_the_closed_form(cart: Machine) -> None:
    """x = (F/b) (t - tau (1 - exp(-t/tau))), tau = m/b, after a step of force F."""
    m, b, force = 2.0, 5.0, cart.drives[0].gain * 3.0
    noise = cart.sensors[0].noise
    time = np.arange(1500) * 1e-3
    inputs = np.full((1500, 1), 3.0)

    def x(m: float, b: float) -> np.ndarray:
        tau = m / b
        return force / b * (time - tau * (1 - np.exp(-time / tau)))

    h = 1e-5
    slopes = np.stack([(x(m * (1 + h), b) - x(m * (1 - h), b)), (x(m, b * (1 + h)) - x(m, b * (1 - h)))]) / (
        2 * h * noise
    )
    expected = np.sqrt(np.diag(np.linalg.inv(slopes @ slopes.T)))
    data = prepare([Recording("r", time, inputs, x(m, b)[:, None])], cart)
    np.testing.assert_allclose(data.noise, noise)
    found = told(data, cart, ["x.mass", "x.viscous"])
    np.testing.assert_allclose([t.relative_std for t in found], expected, rtol=0.02)
    assert found[0].partner == "x.viscous"


def test_two_that_only_show_as_a_product_are_not_told_apart(cart: Machine) -> None:
    time = np.arange(1500) * 1e-3
    inputs = 3.0 * np.sin(6 * time)[:, None]
    data = prepare([Recording("r", time, inputs, cart.simulate(time, inputs).outputs)], cart)
    kt, ratio = told(data, cart, ["motor.Kt", "motor.gear_ratio"])
    assert (kt.partner, ratio.partner) == ("motor.gear_ratio", "motor.Kt")
    assert abs(kt.correlation) > 0.999


def test_a_coordinate_that_never_breaks_away_tells_only_that(hframe: Machine) -> None:
    time = np.arange(800) * 1e-3
    inputs = np.zeros((800, 2))
    data = prepare([Recording("r", time, inputs, np.zeros((800, 4)))], hframe)
    assert all(np.isinf(t.relative_std) for t in told(data, hframe, ["x.mass", "x.coulomb", "left.EA"]))
