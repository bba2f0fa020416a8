"""Signals of a machine: voltages at the motors, sensor readings, and delays, with the effects on them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ...machine import SENSOR_KINDS
from ..symbolic.elementwise import named
from ..symbolic.tracing import evaluate_formula
from .belts import BeltEquations, combination
from .parameterized_machine import MotionPoint, Value


class SignalEquations(BeltEquations):
    """Equations of the amplifiers and sensors of one machine.

    Args:
        values: Parameter values (floats, arrays or symbolic expressions) by full name, for example
            "sensor_scale@x_m.g"; other parameters keep the machine's values.
    """

    def motor_voltages(self, voltages: Sequence[Value]) -> list[Value]:
        """Compute the motor voltages, V, by applying the amplifiers' effects (offset, gain, dead band, ...).

        The arguments are the commanded voltages after the drives' delays.
        """
        result = []
        for j, (drive, voltage) in enumerate(zip(self.machine.drives, voltages, strict=True)):
            for _, e in self.effects_at("voltage", drive.name):
                voltage = self.evaluate(e, "voltage", {"V": voltage})
            result.append(named("voltage", j, voltage))
        return result

    def sensor_readings(
        self,
        positions: Sequence[Value],
        velocities: Sequence[Value] | None = None,
        accelerations: Sequence[Value] | None = None,
        currents: Sequence[Value] | None = None,
        *,
        effect_states: Mapping[int, Value] | None = None,
    ) -> list[Value]:
        """Compute the reading of every sensor, with its effects (scale, skew, ...), without delay and noise.

        A sensor's quantity is a weighted sum, with the coefficients in its `row`: of positions (or products
        of two), speeds or accelerations of coordinates, of currents of drives, or of tensions of belts. The
        formula of the sensor's kind converts the sum to the reading. Values are floats, arrays of one common
        shape (...) or symbolic expressions.

        Args:
            positions: Position of each coordinate, m or rad, in the machine's order, shape (...) each.
            velocities: Velocity of each coordinate, m/s or rad/s, shape (...) each; needed for sensors of
                speeds, accelerations and tensions.
            accelerations: Acceleration of each coordinate, m/s^2 or rad/s^2, shape (...) each; needed for
                sensors of accelerations.
            currents: Current of each drive, A, shape (...) each; needed for sensors of currents.
            effect_states: State of each effect that has one, SI, shape (...) each, by index in `instances`;
                tensions depend on the states of pulleys. Default: 0.

        Returns:
            Reading of every sensor in its unit, in the machine's order, shape (...) each.

        Raises:
            ValueError: If the quantity of a sensor is not given.
        """
        names = self.machine.coordinate_names
        motion: dict[str, Any] = {
            "position": positions,
            "speed": velocities,
            "acceleration": accelerations if velocities is not None else None,
            "current": currents,
        }
        if velocities is not None and any(s.quantity == "tension" for s in self.machine.sensors):
            travel, speed = (
                [value * self.radius(i) for i, value in enumerate(values)]
                for values in (positions, velocities)
            )
            belts = self.belt_states(MotionPoint(travel, speed, effect_states=effect_states or {}))
            motion["tension"] = [belt.tension for belt in belts]
        components = {
            "drive": [drive.name for drive in self.machine.drives],
            "belt": [belt.name for belt in self.machine.belts],
        }
        readings = []
        for j, sensor in enumerate(self.machine.sensors):
            quantity = sensor.quantity
            if motion.get(quantity) is None:
                raise ValueError(
                    f"sensor {sensor.channel}: the reading needs the {quantity} of every component"
                )
            if sensor.sensed.component == "coordinate":
                reading = self._combined(sensor.row, quantity, motion)
            else:
                of_kind = components[sensor.sensed.component]
                row = {of_kind.index(key): coefficient for key, coefficient in sensor.row.items()}
                reading = combination(row, motion[quantity])
            signal = SENSOR_KINDS.get(sensor.kind).signal
            reading = evaluate_formula(f"sensor kind {sensor.kind}, signal", signal, reading)
            # Ripple depends on the position of what is measured, skew on that of the other carriage.
            measured = self.machine.coordinate_of_sensor(sensor)
            across = self.machine.other_axis(sensor.coordinate)
            quantities = {
                "q": positions[names.index(measured)],
                "across": positions[names.index(across)] if across else 0.0,
            }
            for _, e in self.effects_at("measurement", sensor.channel):
                reading = self.evaluate(e, "measurement", {"r": reading, **quantities})
            readings.append(named("reading", j, reading))
        return readings

    def _combined(self, row: Mapping[str, float], quantity: str, motion: Mapping[str, Any]) -> Value:
        """Return the sum of coefficients times positions, or its first or second derivative in time."""
        names = self.machine.coordinate_names
        rows = []
        for key, coefficient in row.items():  # a key is a coordinate, or a product of two such as "y*yaw"
            factors = [key] if key in names else key.split("*")
            rows.append((sorted(names.index(factor) for factor in factors), coefficient))
        terms, coefficients = [], {}
        for k, (indices, coefficient) in enumerate(sorted(rows)):  # in an order independent of the file's
            terms.append(_term(indices, quantity, motion))
            coefficients[k] = coefficient
        return combination(coefficients, terms)

    def voltage_delays(self) -> list[Value]:
        """Return the delay of each drive, s: the sum of the delays that effects declare."""
        return [self._delay("delay", d.name) for d in self.machine.drives]

    def measurement_delays(self) -> list[Value]:
        """Return the delay of each sensor's measurement, s: the sum of the delays that effects declare."""
        return [self._delay("measurement_delay", s.channel) for s in self.machine.sensors]

    def step_factor(self, effect_states: Mapping[int, Value]) -> Value:
        """Return the true duration of a step of the integrator divided by that by the log's clock.

        The ratio is dimensionless, and 1 without an effect on the clock.

        Args:
            effect_states: State of each effect that has one, SI, by index in `instances`.
        """
        factor: Value = 1.0
        for k, e in self.effects_at("clock", "machine"):
            factor = factor + self.evaluate(e, "clock", {"z": effect_states[k]})
        return factor

    def _delay(self, hook: str, component: str) -> Value:
        delay: Value = 0.0
        for _, e in self.effects_at(hook, component):
            delay = delay + self.evaluate(e, hook, {})
        return delay


def _term(indices: Sequence[int], quantity: str, motion: Mapping[str, Any]) -> Value:
    """Return the product of one or two positions, or its first or second derivative in time."""
    q, v, a = motion["position"], motion["speed"], motion["acceleration"]
    first, *others = indices
    if quantity == "position":
        return math.prod((q[i] for i in others), start=q[first])
    if not others:
        return motion[quantity][first]
    (second,) = others
    if quantity == "speed":
        return v[first] * q[second] + q[first] * v[second]
    return a[first] * q[second] + 2.0 * v[first] * v[second] + q[first] * a[second]
