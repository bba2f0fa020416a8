"""Kinds of sensors: what a sensor measures, as a formula of the motion."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from functools import cache
from typing import Any, ClassVar, cast, get_args

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import override

from ..arrays import Array
from ..registry import Registry
from .sensed_quantities import SensorQuantity


class SensorKind:
    """Base class of sensor kinds, such as encoders: what a sensor measures, as a formula of the motion.

    A kind is a subclass that registers itself with `@SENSOR_KINDS.register("name")`. Kinds are never
    instantiated. Simulation, linearization, state estimation, environments, identification and checks all
    read the formula `signal`.

    Attributes:
        incremental: Whether the sensor counts increments from its position at power-on. Its zero is then
            unknown, and elastic belts may lie between it and the tool.
        has_offset: Whether the measurements have an unknown constant offset, as those of an accelerometer do,
            which also feels gravity. Comparisons with a simulation then ignore the mean of the difference.
        turn: Range of an angle that wraps around, such as 2 pi, in the channel's unit; None if it does not
            wrap.
        unit: Unit of the measurement, if it is not that of the quantity: V for the generator of a tachometer,
            whose coefficients in `Sensor.row` are in V per rad/s.
    """

    incremental: ClassVar[bool] = False
    has_offset: ClassVar[bool] = False
    turn: ClassVar[float | None] = None
    unit: ClassVar[str] = ""

    @staticmethod
    def signal(position: Any) -> Any:
        """Compute the ideal measurement (without noise and rounding) from the sensor's quantity.

        The name of the argument, which subclasses may change, selects the quantity. "position", "speed" or
        "acceleration" is the sum of the sensor's coefficients (`Sensor.row`) times those of the coordinates
        (m, rad; per second; per second squared); "current" is the sum of coefficients times the currents of
        the drives, A; "tension" that of coefficients times the tensions of the belts beyond their pretension,
        N.

        A formula uses the operators + - * / and abs, and has slope 1, as initial states and observers assume:
        a constant factor belongs in the coefficients, a nonlinearity in an effect of the sensor.

        Args:
            position: The quantity: float, array of any shape or symbolic expression.

        Returns:
            Ideal measurement in the unit of the quantity, or in `unit`, of the same shape.
        """
        return position

    @classmethod
    def quantity(cls) -> SensorQuantity:
        """Return the name of the measured quantity, the argument of `signal`; ValueError if there is none."""
        return _quantity_of(cls.signal)

    @classmethod
    def has_direction(cls) -> bool:
        """Return whether the measurement changes its sign with the direction, unlike an absolute value."""
        return bool(cls.signal(-1.0) != cls.signal(1.0))

    @staticmethod
    def measure(reading: Array, noise: ArrayLike, resolution: ArrayLike, normal: ArrayLike) -> Array:
        """Convert ideal readings to measurements: add noise, then round; the shapes broadcast.

        Args:
            reading: Ideal (noise-free, continuous) readings, in the sensor's unit, any shape.
            noise: Standard deviation of the noise, same unit, any shape.
            resolution: Quantization step of the sensor, same unit, any shape; 0 for a continuous sensor.
            normal: Samples of the standard normal distribution, dimensionless, any shape; they are multiplied
                by `noise`.
        """
        value = np.asarray(reading + np.asarray(noise) * normal)
        quantum = np.broadcast_to(np.asarray(resolution, float), value.shape)
        return np.where(
            quantum > 0.0, np.rint(value / np.where(quantum > 0.0, quantum, 1.0)) * quantum, value
        )


@cache
def _quantity_of(signal: Callable[[Any], Any]) -> SensorQuantity:
    """Return the quantity that a formula of a sensor kind takes."""
    names = list(inspect.signature(signal).parameters)
    quantities = get_args(SensorQuantity)
    if len(names) != 1 or names[0] not in quantities:
        raise ValueError(
            f"{signal.__qualname__}: has the arguments {', '.join(names) or 'none'}; it must have exactly "
            f"one of {', '.join(quantities)}. What else changes the measurement is an effect of the sensor"
        )
    return cast(SensorQuantity, names[0])


SENSOR_KINDS: Registry[type[SensorKind]] = Registry("sensor kind", base=SensorKind)


@SENSOR_KINDS.register("encoder")
class Encoder(SensorKind):
    """An incremental encoder: it counts increments from its position at power-on, so its zero is unknown."""

    incremental = True


@SENSOR_KINDS.register("laser")
class Laser(SensorKind):
    """A laser distance sensor; it measures the absolute position, so its zero is known."""


@SENSOR_KINDS.register("speed")
class SpeedSensor(SensorKind):
    """A tachometer, or a drive or counter that reports a speed, in m/s or rad/s."""

    @staticmethod
    @override
    def signal(speed: Any) -> Any:
        """Return the `speed`, m/s or rad/s, any shape."""
        return speed


@SENSOR_KINDS.register("unsigned-speed")
class UnsignedSpeedSensor(SensorKind):
    """A pulse counter without direction: it reports the absolute value of the speed, in m/s or rad/s."""

    @staticmethod
    @override
    def signal(speed: Any) -> Any:
        """Return the absolute value of the `speed`, m/s or rad/s, any shape."""
        return abs(speed)


@SENSOR_KINDS.register("acceleration")
class AccelerationSensor(SensorKind):
    """An accelerometer on a carriage, such as an ADXL345, m/s^2 or rad/s^2; offset and gravity are unknown.

    It measures the acceleration just before the sample, under the voltages that have acted until then.
    """

    has_offset = True

    @staticmethod
    @override
    def signal(acceleration: Any) -> Any:
        """Return the `acceleration`, m/s^2 or rad/s^2, any shape."""
        return acceleration


@SENSOR_KINDS.register("current")
class CurrentSensor(SensorKind):
    """The measured current of a drive, A, just before the sample, under the voltages until then."""

    @staticmethod
    @override
    def signal(current: Any) -> Any:
        """Return the `current`, A, any shape."""
        return current


@SENSOR_KINDS.register("belt-force")
class BeltForceSensor(SensorKind):
    """A load cell at a pulley or strain gauge on a clamp: a belt's tension, N; the pretension is unknown."""

    has_offset = True

    @staticmethod
    @override
    def signal(tension: Any) -> Any:
        """Return the `tension` beyond the pretension, N, any shape."""
        return tension


@SENSOR_KINDS.register("absolute-angle")
class AbsoluteAngle(SensorKind):
    """An absolute encoder of one turn: its zero is known, and the angle wraps around from 2 pi to 0 rad."""

    turn: ClassVar[float] = 2.0 * math.pi

    @staticmethod
    @override
    def measure(reading: Array, noise: ArrayLike, resolution: ArrayLike, normal: ArrayLike) -> Array:
        """Add noise and round as `SensorKind.measure`, then wrap the angle to [0, 2 pi) rad."""
        return np.mod(SensorKind.measure(reading, noise, resolution, normal), AbsoluteAngle.turn)
