"""Tests of the estimated parameters and of the measurement equation."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers import MotionModel, StateEstimator
from hframe_gym.controllers.estimation.estimation_model import AugmentedParameters, MeasurementModel
from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Sensor


def test_nonzero_parameters_of_the_motion_are_estimated(hframe: Machine) -> None:
    names = AugmentedParameters(hframe).names
    assert {"x.mass", "y.coulomb", "phi1.viscous", "bottom.EA", "motor2.Ke"} <= set(names)
    assert not {"x.radius", "left.rest_length", "motor1.resistance"} & set(names)
    linear = AugmentedParameters(BUILTIN_MACHINES["hframe-linear"]()).names
    assert not [name for name in linear if name.endswith("coulomb")]


def test_parameters_of_effects_are_not_estimated(hframe: Machine) -> None:
    machine = hframe.with_effects(EFFECTS["stribeck_friction"].at("x", dF=1.0, vs=0.02))
    assert AugmentedParameters(machine).names == AugmentedParameters(hframe).names


def test_parameters_are_declared_values_times_limited_ratios(hframe: Machine) -> None:
    augmented = AugmentedParameters(hframe)
    logarithms = np.zeros((2, len(augmented.names)))
    logarithms[:, augmented.names.index("y.mass")] = np.log(1.2), 50.0
    rows = augmented.parameters(logarithms)
    declared = np.array(list(hframe.parameters.values()))
    column = list(hframe.parameters).index("y.mass")
    np.testing.assert_allclose(rows[:, column] / declared[column], [1.2, 4.0])
    np.testing.assert_array_equal(
        np.delete(rows, column, axis=1), np.tile(np.delete(declared, column), (2, 1))
    )


def test_errors_of_the_belts_are_correlated(hframe: Machine) -> None:
    augmented = AugmentedParameters(hframe)
    belts = [i for i, name in enumerate(augmented.names) if name.endswith(".EA")]
    covariance = augmented.covariance[np.ix_(belts, belts)]
    correlation = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert 0.5 < correlation[0, 1] < 1.0
    assert np.linalg.eigvalsh(augmented.covariance).min() > 0.0


def test_measurement_equation_follows_the_declared_sensors(hframe: Machine) -> None:
    """An encoder in front of a gear of 5, and a laser with range, skew and delay."""
    sensors = (
        Sensor("phi1_rad", {"phi1": 5.0}, 0.0, 0.12, "encoder"),
        Sensor("x_m", {"x": 1.0}, 2e-5, 0.0, "laser"),
    )
    effects = (
        EFFECTS["sensor_range"].at("x_m", low=-0.05, high=0.06),
        EFFECTS["sensor_skew"].at("x_m", a=0.02),
        EFFECTS["sensor_delay"].at("x_m", d=0.003),
    )
    machine = hframe.replace(sensors=sensors).with_effects(*effects)
    measurements = MeasurementModel(MotionModel(machine))
    radius = hframe.coordinate("phi1").radius
    length = np.hypot(1.0, 0.02)
    expected = np.zeros((2, 8))
    expected[0, 2] = 1.0
    expected[1, [0, 1]] = 1.0 / length, 0.02 / length
    expected[1, 4:] = -0.003 * expected[1, :4]
    np.testing.assert_allclose(measurements.matrix, expected, atol=1e-12)
    np.testing.assert_allclose(
        measurements.to_travel(np.array([[2.0, 0.1]])), [[2.0 * radius / 5.0, 0.1 / length]]
    )
    std = np.array([0.12 / np.sqrt(12.0) * radius / 5.0, 2e-5 / length])
    np.testing.assert_allclose(np.sqrt(measurements.variance), std, rtol=1e-3)
    in_range = measurements.in_range(np.array([[100.0, 0.06], [0.0, 0.059]]))
    np.testing.assert_array_equal(in_range, [[True, False], [True, True]])


def test_a_periodic_error_is_taken_from_the_measurement(hframe: Machine) -> None:
    sensors = (Sensor("x_m", {"x": 1.0}, 2e-5), Sensor("y_m", {"y": 1.0}, 2e-5))
    amplitude, rate, phase = 2e-4, 1290.0, -2.0
    error = EFFECTS["interpolation_error"].at("x_m", A=amplitude, n=rate, p=phase)
    machine = hframe.replace(sensors=sensors).with_effects(error)
    position = np.column_stack([np.linspace(-0.1, 0.1, 23), np.full(23, 0.03)])
    measured = position.copy()
    measured[:, 0] += amplitude * np.sin(rate * position[:, 0] + phase)
    state = StateEstimator(machine, 0.01).update(measured)
    np.testing.assert_allclose(state[:, :2], position, atol=0.01 * amplitude)


def test_sensors_that_do_not_determine_the_tool_are_rejected(hframe: Machine) -> None:
    machine = hframe.replace(sensors=(Sensor("x_m", {"x": 1.0}, 1e-5),))
    with pytest.raises(InputError, match=r"its sensors \(x_m\) do not determine the position of the tool"):
        MeasurementModel(MotionModel(machine))
