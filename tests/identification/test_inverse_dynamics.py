"""Tests of inverse dynamics: the relative force error."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.identification import prepare
from hframe_gym.identification.force_sizes import force_error
from hframe_gym.machine import Coordinate, Drive, Machine, Sensor
from hframe_gym.recordings import Recording

pytestmark = pytest.mark.unit


def axis(mass: float, viscous: float) -> Machine:
    """Return an axis with 2 N/V and no back-EMF."""
    return Machine(
        "axis",
        (Coordinate("x", mass, viscous),),
        (),
        (Drive("motor", "v_V", "x", Kt=2.0, Ke=0.0, resistance=1.0, gear_ratio=1.0, rated_voltage=10.0),),
        (Sensor("x_m", {"x": 1.0}),),
    )


def test_force_error_of_a_known_motion() -> None:
    """x = sin 2 t needs F = m a + b v exactly; a wrong mass gives a known relative error."""
    time = np.arange(4000) * 1e-3
    mass, viscous, rate = 3.0, 5.0, 2.0
    # The held input means the force at a row is half that of the row before.
    middle = time + 0.5e-3
    force = -mass * rate**2 * np.sin(rate * middle) + viscous * rate * np.cos(rate * middle)
    run = Recording("r", time, force[:, None] / 2.0, np.sin(rate * time)[:, None])
    data = prepare([run], axis(mass, viscous))
    exact = force_error(axis(mass, viscous), data)
    assert exact is not None
    assert exact < 2e-3
    wrong = force_error(axis(1.1 * mass, viscous), data)
    missing_force = 0.1 * mass * rate**2 * np.sin(rate * middle)
    assert wrong == pytest.approx(np.linalg.norm(missing_force) / np.linalg.norm(force), rel=0.02)


def test_machine_with_belts_has_no_force_error(hframe: Machine) -> None:
    time = np.arange(50) * 1e-3
    data = prepare([Recording("r", time, np.zeros((50, 2)), np.zeros((50, 4)))], hframe)
    assert force_error(hframe, data) is None


@pytest.mark.parametrize(("coulomb", "expected"), [(3.0, 0.0), (1.0, 0.5)])
def test_dry_friction_holds_a_force_up_to_its_limit_at_rest(coulomb: float, expected: float) -> None:
    """A force of 2 N does not move the axis: friction of 3 N explains that, friction of 1 N explains half of it."""
    time = np.arange(1000) * 1e-3
    position = 1e-8 * np.random.default_rng(0).normal(size=(1000, 1))
    machine = axis(3.0, 5.0).replace({"x.coulomb": coulomb})
    data = prepare([Recording("r", time, np.ones((1000, 1)), position)], machine)
    assert force_error(machine, data) == pytest.approx(expected, abs=0.02)


def test_a_run_that_lacks_the_measurements_before_its_rest_has_a_force_error() -> None:
    time = np.arange(2000) * 1e-3
    position = 0.1 * np.sin(2.0 * time)[:, None]
    position[:200] = np.nan
    machine = axis(3.0, 5.0)
    error = force_error(machine, prepare([Recording("r", time, np.ones((2000, 1)), position)], machine))
    assert error is not None
    position[1000] = np.nan
    assert force_error(machine, prepare([Recording("r", time, np.ones((2000, 1)), position)], machine)) is None


def test_a_run_with_too_few_measured_rows_for_the_filter_has_no_force_error() -> None:
    time = np.arange(2000) * 1e-3
    position = 0.1 * np.sin(2.0 * time)[:, None]
    position[:1990] = np.nan
    machine = axis(3.0, 5.0)
    assert force_error(machine, prepare([Recording("r", time, np.ones((2000, 1)), position)], machine)) is None


def test_force_error_of_a_slow_log() -> None:
    """With a period of more than 50 ms, no sample lies in the transient of the filter."""
    time = np.arange(400) * 0.1
    mass, viscous, rate = 3.0, 5.0, 0.2
    middle = time + 0.05
    force = -mass * rate**2 * np.sin(rate * middle) + viscous * rate * np.cos(rate * middle)
    run = Recording("r", time, force[:, None] / 2.0, np.sin(rate * time)[:, None])
    error = force_error(axis(mass, viscous), prepare([run], axis(mass, viscous)))
    assert error == pytest.approx(0.0, abs=0.02)
