"""Tests of inverse dynamics: the relative force error."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, prepare
from hframe_gym.identification.forces.inverse_dynamics import force_error
from hframe_gym.machine import AppliedEffect, Coordinate, Drive, Machine, Sensor
from hframe_gym.recordings import Recording


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


def test_rows_at_irregular_times_do_not_make_a_right_machine_wrong() -> None:
    """Rows that are written as values arrive: filtered as regular, they missed 3.5 times the force."""
    steps = np.random.default_rng(0).uniform(2e-3, 12e-3, 2000)
    time, mass, viscous, rate = np.cumsum(steps), 3.0, 5.0, 2.0
    middle = time + 0.5 * np.append(steps[1:], 0.0)
    force = -mass * rate**2 * np.sin(rate * middle) + viscous * rate * np.cos(rate * middle)
    run = Recording("r", time, force[:, None] / 2.0, np.sin(rate * time)[:, None])
    error = force_error(axis(mass, viscous), prepare([run], axis(mass, viscous)))
    assert error is not None
    assert error < 0.01


@pytest.mark.parametrize(("step", "largest"), [(1e-6, 0.01), (2e-3, 0.5), (2e-2, 0.5)])
def test_a_coarse_sensor_does_not_make_a_right_machine_wrong(step: float, largest: float) -> None:
    """Differentiated twice up to 100 Hz, the rounding of an encoder was many times the drives' force."""
    time = np.arange(8000) * 1e-3
    mass, viscous, rate = 3.0, 5.0, 2.0
    middle = time + 0.5e-3
    force = -mass * rate**2 * np.sin(rate * middle) + viscous * rate * np.cos(rate * middle)
    position = np.round(np.sin(rate * time) / step) * step
    machine = axis(mass, viscous)
    error = force_error(
        machine, prepare([Recording("r", time, force[:, None] / 2.0, position[:, None])], machine)
    )
    assert error is not None
    assert error < largest


def test_machine_with_belts_has_no_force_error(hframe: Machine) -> None:
    time = np.arange(50) * 1e-3
    data = prepare([Recording("r", time, np.zeros((50, 2)), np.zeros((50, 4)))], hframe)
    assert force_error(hframe, data) is None


@pytest.mark.parametrize(("coulomb", "expected"), [(3.0, 0.0), (1.0, 0.5)])
def test_dry_friction_holds_a_force_up_to_its_limit_at_rest(coulomb: float, expected: float) -> None:
    """A force of 2 N does not move the axis: friction of 3 N explains that, 1 N explains half of it."""
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


def force_error_without(missing: slice | list[int]) -> float | None:
    """Return the force error of a known motion of which measurements are missing.

    The mass is wrong by 10 % of the force's amplitude; voltages in the rows 1900 to 2099 are wrong.
    """
    time = np.arange(4000) * 1e-3
    middle = time + 0.5e-3
    force = -12.0 * np.sin(2.0 * middle) + 10.0 * np.cos(2.0 * middle)
    force[1900:2100] += 50.0
    position = np.sin(2.0 * time)[:, None]
    position[missing] = np.nan
    machine = axis(3.3, 5.0)
    return force_error(machine, prepare([Recording("r", time, force[:, None] / 2.0, position)], machine))


def test_single_missing_measurements_are_interpolated() -> None:
    complete = force_error_without([])
    assert complete is not None
    assert complete > 0.5
    assert force_error_without([500, 700, 1950, 1951, 1952, 3500]) == pytest.approx(complete, rel=1e-3)


@pytest.mark.parametrize("first", [1950, 1951])
def test_measurements_5_ms_apart_are_interpolated_however_times_are_rounded(first: int) -> None:
    complete = force_error_without([])
    assert force_error_without(slice(first, first + 4)) == pytest.approx(complete, rel=1e-3)
    assert force_error_without(slice(first, first + 5)) != pytest.approx(complete, rel=0.1)


def test_rows_near_a_long_gap_have_no_force_error() -> None:
    """The wrong voltages in the gap do not count; what remains is the error of the mass."""
    assert force_error_without(slice(1880, 2120)) == pytest.approx(0.077, rel=0.05)


def test_a_sensor_that_is_missing_most_of_the_time_has_no_force_error() -> None:
    assert force_error_without([k for k in range(1, 3999) if k % 50]) is None


def test_a_run_with_too_few_measured_rows_for_the_filter_has_no_force_error() -> None:
    time = np.arange(2000) * 1e-3
    position = 0.1 * np.sin(2.0 * time)[:, None]
    position[:1990] = np.nan
    machine = axis(3.0, 5.0)
    assert (
        force_error(machine, prepare([Recording("r", time, np.ones((2000, 1)), position)], machine)) is None
    )


def test_force_error_of_a_slow_log() -> None:
    """With a period of more than 50 ms, no sample lies in the transient of the filter."""
    time = np.arange(400) * 0.1
    mass, viscous, rate = 3.0, 5.0, 0.2
    middle = time + 0.05
    force = -mass * rate**2 * np.sin(rate * middle) + viscous * rate * np.cos(rate * middle)
    run = Recording("r", time, force[:, None] / 2.0, np.sin(rate * time)[:, None])
    error = force_error(axis(mass, viscous), prepare([run], axis(mass, viscous)))
    assert error == pytest.approx(0.0, abs=0.02)


def two_sensors(*effects: AppliedEffect, swapped: bool = False, missing: int = 1) -> tuple[Machine, Dataset]:
    """Return an axis with a precise encoder (20 rad/m) and a noisier laser that is late by 20 ms, and a run.

    The sensors are swapped if asked; of the encoder, one row of `missing` is measured.
    """
    time, rng = np.arange(4000) * 1e-3, np.random.default_rng(1)
    middle = time + 0.5e-3
    force = -12.0 * np.sin(2.0 * middle) + 10.0 * np.cos(2.0 * middle)
    encoder = 20.0 * np.sin(2.0 * time)
    encoder[np.arange(4000) % missing > 0] = np.nan
    laser = np.sin(2.0 * (time - 0.02)) + rng.normal(0.0, 1e-6, 4000)
    order = [1, 0] if swapped else [0, 1]
    sensors = Sensor("x_rad", {"x": 20.0}, noise=2e-9), Sensor("x_m", {"x": 1.0}, noise=1e-6)
    machine = axis(3.0, 5.0)
    machine = Machine("axis", machine.coordinates, (), machine.drives, tuple(sensors[i] for i in order))
    outputs = np.column_stack([encoder, laser])[:, order]
    return machine.with_effects(*effects), prepare(
        [Recording("r", time, force[:, None] / 2.0, outputs)], machine
    )


@pytest.mark.parametrize("swapped", [False, True])
def test_of_two_sensors_the_one_with_the_least_noise_gives_the_motion(swapped: bool) -> None:
    """It measures in rad, and the delay of the other sensor changes nothing."""
    without = force_error(*two_sensors(swapped=swapped))
    delay = EFFECTS["sensor_delay"].at("x_m", d=0.02)
    assert without == pytest.approx(0.0, abs=2e-3)
    assert force_error(*two_sensors(delay, swapped=swapped)) == without


def test_the_delay_of_the_sensor_that_gives_the_motion_is_undone() -> None:
    """The laser gives it, because the encoder measures seldom; a delay of 20 ms alone is an error of 4 %."""
    late = force_error(*two_sensors(missing=3))
    assert late is not None
    assert late > 0.03
    delay = EFFECTS["sensor_delay"].at("x_m", d=0.02)
    assert force_error(*two_sensors(delay, missing=3)) == pytest.approx(0.0, abs=0.012)


def test_no_force_error_if_an_effect_changes_the_measured_motion() -> None:
    scale = EFFECTS["sensor_scale"]
    assert force_error(*two_sensors(scale.at("x_rad", g=0.1))) is None
    assert force_error(*two_sensors(scale.at("x_m", g=0.1))) == force_error(*two_sensors())
