"""Signals of a machine: voltages at the motors, sensor readings, and delays, with the effects on them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..symbolic.elementwise import named
from .belts import combination
from .parameterized_machine import ParameterizedMachine, Value


class SignalEquations(ParameterizedMachine):
    """Equations of the amplifiers and sensors of one machine.

    Args:
        values: Parameter values (floats, arrays or symbolic expressions) by full name, for example
            "sensor_scale@x_m.g"; other parameters keep the machine's values.
    """

    def motor_voltages(self, voltages: Sequence[Value]) -> list[Value]:
        """Apply the effects of the amplifiers (offset, gain error, dead band, ...) to the commanded voltages, V.

        The voltages are those after the drives' delays.
        """
        result = []
        for j, (drive, voltage) in enumerate(zip(self.machine.drives, voltages, strict=True)):
            for _, e in self.effects_at("voltage", drive.name):
                voltage = self.evaluate(e, "voltage", {"V": voltage})
            result.append(named("voltage", j, voltage))
        return result

    def sensor_readings(self, positions: Sequence[Value]) -> list[Value]:
        """Compute the reading of every sensor, m or rad, with effects (scale, skew, ...), without delay and noise.

        A reading is a sum of coordinates (or products of two), m or rad, times the coefficients in the sensor's `row`.
        """
        names = self.machine.coordinate_names
        readings = []
        for j, sensor in enumerate(self.machine.sensors):
            rows = []
            for key, coefficient in sensor.row.items():  # a key is a coordinate, or a product of two such as "y*yaw"
                factors = [key] if key in names else key.split("*")
                rows.append((sorted(names.index(factor) for factor in factors), coefficient))
            terms, coefficients = [], {}
            for k, (indices, coefficient) in enumerate(sorted(rows)):  # in an order that is independent of the file's
                terms.append(math.prod((positions[i] for i in indices[1:]), start=positions[indices[0]]))
                coefficients[k] = coefficient
            reading = combination(coefficients, terms)
            across = self.machine.other_axis(sensor.coordinate)  # skew depends on the other carriage's position
            quantities = {"across": positions[names.index(across)] if across else 0.0}
            for _, e in self.effects_at("measurement", sensor.channel):
                reading = self.evaluate(e, "measurement", {"r": reading, **quantities})
            readings.append(named("reading", j, reading))
        return readings

    def voltage_delays(self) -> list[Value]:
        """Return the delay of each drive, s: the sum of the delays that effects declare."""
        return [self._delay("delay", d.name) for d in self.machine.drives]

    def measurement_delays(self) -> list[Value]:
        """Return the delay of each sensor's measurement, s: the sum of the delays that effects declare."""
        return [self._delay("measurement_delay", s.channel) for s in self.machine.sensors]

    def _delay(self, hook: str, component: str) -> Value:
        delay: Value = 0.0
        for _, e in self.effects_at(hook, component):
            delay = delay + self.evaluate(e, hook, {})
        return delay
