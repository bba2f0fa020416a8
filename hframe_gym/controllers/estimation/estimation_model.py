"""Models for estimators: parameters as ratios to their declared values, and the measurement equation."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
from typing_extensions import override

from ...arrays import Array, Mask, ParameterRows, TravelStates
from ...dynamics import Equations
from ...errors import InputError
from ...machine import Machine, Sensor
from ..models.motion_model import MotionModel

# Prior standard deviations of the logarithms of parameter ratios: friction is hardly known before it is
# measured, masses are weighed, motors have data sheets. A resistance has the effect of a Kt and is not
# estimated beside it.
PARAMETER_STD = {"mass": 0.1, "coulomb": 0.4, "viscous": 0.2, "EA": 0.1, "Kt": 0.05, "Ke": 0.05}
COMMON_BELT_STD = 0.17  # of the error that all belts have in common because they are cut from one piece
# Of these deviations, what remains possible after an identification: heat, wear, friction that depends on the
# place.
REMAINING = 0.25
LARGEST_RATIO = 4.0  # largest ratio of a parameter to its declared value, or the inverse
# m, floor of the measurement noise in travel, also for sensors declared without noise.
SMALLEST_NOISE_M = 1e-7


def prior_deviation(machine: Machine, name: str, declared: float) -> float:
    """Return the prior standard deviation of ln(true value / declared value) of a parameter, dimensionless.

    For an identified parameter with the standard deviation s and the value v, it is sqrt((s / v)^2 +
    (`REMAINING` * declared)^2), but at most `declared`.

    Args:
        machine: Machine with the value, and with its covariance if it was identified.
        name: Full name of the parameter, for example "x.mass".
        declared: Result for a parameter that was not identified or is 0, dimensionless.
    """
    std = machine.uncertainty.std(name) if machine.uncertainty else None
    value = machine.parameters[name]
    if std is None or value == 0.0:
        return declared
    return min(declared, float(np.hypot(std / value, REMAINING * declared)))


class ParameterRatios:
    """Parameters of a machine, estimated as natural logarithms of their ratios to the declared values.

    A logarithm of 0.1 means about 10 % above the declared value. A parameter cannot change its sign.

    Args:
        names: Full names of the k estimated parameters, for example "x.mass".
    """

    def __init__(self, machine: Machine, names: Iterable[str]) -> None:
        self.names = tuple(names)
        all_names = list(machine.parameters)
        self._columns = np.array([all_names.index(name) for name in self.names], np.intp)
        self._declared = np.array(list(machine.parameters.values()))

    def parameters(self, logarithms: Array) -> ParameterRows:
        """Compute the values of all parameters.

        An estimated one is its declared value times exp(logarithm).

        Args:
            logarithms: Natural logarithms of the ratios of the k estimated parameters, shape (B, k).
        """
        values = np.tile(self._declared, (len(logarithms), 1))
        values[:, self._columns] *= np.exp(logarithms)
        return values


class AugmentedParameters(ParameterRatios):
    """Parameters that are estimated together with the state: nonzero masses, friction, EA, motor constants.

    EA is the tensile stiffness of a belt (modulus times cross section), N; its estimate also absorbs the
    error of the belt's length.

    Attributes:
        names: Full names of the k parameters.
        covariance: Prior covariance of the logarithms, shape (k, k).
    """

    def __init__(self, machine: Machine) -> None:
        values = machine.parameters
        components = [
            *machine.coordinate_names,
            *(b.name for b in machine.belts),
            *(d.name for d in machine.drives),
        ]
        candidates = [f"{component}.{key}" for component in components for key in PARAMETER_STD]
        super().__init__(machine, (name for name in candidates if values.get(name, 0.0) != 0.0))
        keys = [name.rpartition(".")[2] for name in self.names]
        belts = np.array([key == "EA" for key in keys], np.float64)
        std = np.array([PARAMETER_STD[key] for key in keys], np.float64)
        self.covariance: Array = np.diag(std**2) + COMMON_BELT_STD**2 * np.outer(belts, belts)

    def ratios(self, logarithms: Array) -> Array:
        """Compute the ratios of estimated to declared values, [1/4, 4], from `logarithms`, shape (B, k)."""
        return np.exp(self.clip(logarithms))

    def clip(self, logarithms: Array) -> Array:
        """Limit `logarithms` of parameter ratios, shape (B, k), to [-ln 4, ln 4] (`LARGEST_RATIO`)."""
        return np.clip(logarithms, -np.log(LARGEST_RATIO), np.log(LARGEST_RATIO))

    @override
    def parameters(self, logarithms: Array) -> ParameterRows:
        """Compute parameter values; ratios to the declared ones are limited to [1/4, 4] (`LARGEST_RATIO`)."""
        return super().parameters(self.clip(logarithms))


def _is_linear(sensor: Sensor) -> bool:
    """Return whether a sensor measures a linear function of the positions and speeds."""
    return sensor.of_velocity or (sensor.of_position and sensor.turn is None)


class MeasurementModel:
    """Measurement equation z = H s + d(s) of a machine's declared sensors, scaled to meters of belt travel.

    The state s holds the belt travel of the n coordinates, m, and its velocity, m/s; d(s) is what effects of
    the sensors, such as an interpolation error, add to a linear measurement. Only sensors of positions and
    speeds are used. Others count as outside their range: accelerations, currents and unsigned speeds are not
    linear in the state, and an angle that wraps around does not determine the position.

    Args:
        model: Model of the machine whose `sensors`, with their ranges and delays, supply the measurements.

    Attributes:
        channels: Number of sensors.
        is_linear: Whether no effect changes the sensors, so that d is 0.
        matrix: H, shape (channels, 2 n); m per m in the first n columns, m per m/s (s) in the others,
            which a sensor's delay makes nonzero.
        variance: Variances of the measurement noise including quantization, m^2, shape (channels,).

    Raises:
        InputError: If the sensors do not determine the tool's position.
    """

    def __init__(self, model: MotionModel) -> None:
        machine = model.machine
        names = machine.coordinate_names
        self.channels = len(machine.sensors)
        ranges = machine.measuring_ranges
        unlimited = dataclasses.replace(
            machine, effects=tuple(e for e in machine.effects if not e.measuring_range)
        )
        self._equations = equations = Equations(unlimited)
        self._used = np.array([_is_linear(sensor) for sensor in machine.sensors], np.bool_)
        count = len(names)
        self._scale = np.tile(machine.travel_per_unit, 2)
        readings = self._readings(np.vstack([np.zeros(2 * count), np.diag(self._scale)]))
        # Sensitivity of each channel to travel and speed of each coordinate, in the channel's unit per m and
        # per m/s.
        sensitivity = (readings[1:] - readings[0]).T / self._scale
        sensitivity[~self._used] = 0.0
        norm = np.linalg.norm(sensitivity, axis=1)
        self._unit = 1.0 / np.where(norm > 0.0, norm, 1.0)  # m or m/s per channel's unit
        self._undelayed = sensitivity * self._unit[:, None]
        positions, speeds = np.split(self._undelayed, 2, axis=1)
        self.is_linear = all(effect.definition.measurement is None for effect in unlimited.effects)
        # To first order in a sensor's delay d, it measures travel - d * velocity.
        delays = np.array(equations.measurement_delays(), np.float64)
        self.matrix: Array = np.hstack([positions, speeds - delays[:, None] * positions])
        limits = [ranges.get(s.channel, (-np.inf, np.inf)) for s in machine.sensors]
        self._low, self._high = np.array(limits, np.float64).reshape(-1, 2).T
        noise = np.array([np.hypot(s.noise, s.resolution / np.sqrt(12.0)) for s in machine.sensors])
        self.variance: Array = (noise * self._unit) ** 2 + SMALLEST_NOISE_M**2
        if np.linalg.matrix_rank(positions @ model.rigid) < model.rigid.shape[1]:
            raise InputError(
                f"machine {machine.name!r}: its sensors ({', '.join(machine.output_channels) or 'none'}) "
                "do not determine the position of the tool"
            )

    def _readings(self, states: TravelStates) -> Array:
        """Return the measurements without delay, in the units of the channels, shape (B, channels)."""
        count = states.shape[1] // 2
        columns = list((states / self._scale).T)
        at_rest = [np.zeros(len(states))] * max(count, len(self._equations.machine.drives))
        readings = self._equations.sensor_readings(columns[:count], columns[count:], at_rest, at_rest)
        return np.stack(np.broadcast_arrays(*readings, at_rest[0])[:-1], axis=1)

    def deviation(self, states: TravelStates) -> Array:
        """Compute d(s), what effects add to the linear measurement, m or m/s, shape (B, channels), or 0."""
        if self.is_linear:
            return np.zeros((len(states), self.channels))
        deviation = self._readings(states) * self._unit - states @ self._undelayed.T
        return np.where(self._used, deviation, 0.0)

    def to_travel(self, measurements: Array) -> Array:
        """Scale measurements to belt travel, m, or its rate, m/s, for the measurement equation.

        Args:
            measurements: Measurements in the units of the channels, shape (B, channels).

        Returns:
            Measurements, shape (B, channels): m of positions, m/s of speeds; unchanged if the sensor is not
            used.
        """
        return measurements * self._unit

    def in_range(self, measurements: Array) -> Mask:
        """Test which measurements lie strictly inside the ranges of their sensors, shape (B, channels).

        At an end of its range, a sensor does not follow the position. Such a measurement must not correct an
        estimate. False for sensors that the estimate does not use, and for missing measurements (NaN).

        Args:
            measurements: Measurements, m or rad, shape (B, channels).
        """
        return self._used & (measurements > self._low) & (measurements < self._high)
