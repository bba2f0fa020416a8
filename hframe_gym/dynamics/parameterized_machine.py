"""A machine whose parameters are values of any algebra: its coefficients, effects, sensor readings and delays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..machine import AppliedEffect, Machine, argument_names
from .elementwise import named

Value = Any
IndexRow = Mapping[int, float]


@dataclass(frozen=True)
class MotionPoint:
    """A point of a motion at which forces are evaluated.

    Attributes:
        travel: Belt travel of each coordinate, m (radius * angle of a rotary one).
        speed: Rate of the travel, m/s.
        time: Time since the machine was switched on, s.
        effect_states: State of each effect that has one, by the effect's index in the machine.
        elapsed: Time that has passed since `effect_states`, s; None if they are those of this point.
    """

    travel: Sequence[Value]
    speed: Sequence[Value]
    time: Value = 0.0
    effect_states: Mapping[int, Value] = field(default_factory=dict)
    elapsed: Value | None = None


class ParameterizedMachine:
    """A machine with parameters of any algebra.

    Args:
        machine: Machine with its effects.
        values: Parameter values by full name; parameters that are missing keep the machine's values.
    """

    def __init__(self, machine: Machine, values: Mapping[str, Value] | None = None) -> None:
        self.machine = machine
        self._values: dict[str, Value] = {**machine.parameters, **(values or {})}
        names = machine.coordinate_names
        index = {name: i for i, name in enumerate(names)}
        self.extension_rows = [{index[c]: g for c, g in b.extension.items() if g} for b in machine.belts]
        self.length_rows = [{index[c]: g for c, g in b.length.items() if g} for b in machine.belts]
        self.drive_coordinates = [index[d.coordinate] for d in machine.drives]
        self._effect_coordinates = [index.get(self._acts_on(e), -1) for e in machine.effects]
        # A tabulated effect over the path of a coordinate integrates that coordinate's path.
        self.state_coordinates = [
            index.get(e.definition.against.partition(" of ")[2], i)
            for e, i in zip(machine.effects, self._effect_coordinates, strict=True)
        ]
        self.states = [k for k, e in enumerate(machine.effects) if e.definition.next_state]

    def _acts_on(self, effect: AppliedEffect) -> str:
        """Name of the coordinate on which an effect acts, empty for none."""
        definition, machine = effect.definition, self.machine
        if definition.coordinate:
            return definition.coordinate
        if definition.site in ("motor", "drive"):
            return next((d.coordinate for d in machine.drives if d.name == effect.site), "")
        if definition.site == "sensor":
            return ""
        return machine.coordinate_of_site(effect.site) or ""

    # -- parameters ------------------------------------------------------------------------------------------------

    def parameter(self, name: str) -> Value:
        """Return the value of a parameter by its full name; a tied one is a factor times another."""
        if name in self.machine.ties:
            other, factor = self.machine.ties[name]
            return factor * self.parameter(other)
        return self._values[name]

    def is_rotary(self, i: int) -> bool:
        """Return whether coordinate i is rotary."""
        return self.machine.coordinates[i].kind == "rotary"

    def _of_coordinate(self, i: int, key: str) -> Value:
        return self.parameter(f"{self.machine.coordinates[i].name}.{key}")

    def radius(self, i: int) -> Value:
        """Return the travel per unit of coordinate i: the pulley's radius, m, or 1."""
        return self._of_coordinate(i, "radius") if self.is_rotary(i) else 1.0

    def per_radius(self, i: int) -> Value:
        """Return 1/radius of coordinate i, 1/m, or 1 for a linear coordinate."""
        return 1.0 / self.radius(i) if self.is_rotary(i) else 1.0

    def mass(self, i: int) -> Value:
        """Return the mass of coordinate i seen by its travel, kg."""
        return self._of_coordinate(i, "mass") / (self.radius(i) * self.radius(i))

    def coulomb(self, i: int) -> Value:
        """Return the Coulomb level of coordinate i seen by its travel, N, without effects."""
        return self._of_coordinate(i, "coulomb") / self.radius(i)

    def viscous(self, i: int, direction: Value) -> Value:
        """Return the viscous coefficient of coordinate i seen by its travel, Ns/m, with back-EMF and effects.

        Args:
            i: Index of the coordinate.
            direction: Sign of the motion, +1 or -1.
        """
        coefficient = self._of_coordinate(i, "viscous")
        for _, e in self.effects_on("viscous", i):
            coefficient = self.evaluate(e, "viscous", {"b": coefficient, "direction": direction})
        for j, of_drive in enumerate(self.drive_coordinates):
            if of_drive == i:
                coefficient = coefficient + self._torque_per_volt(j) * self._emf_constant(j)
        return coefficient / (self.radius(i) * self.radius(i))

    def _of_drive(self, j: int, key: str) -> Value:
        return self.parameter(f"{self.machine.drives[j].name}.{key}")

    def _torque_per_volt(self, j: int) -> Value:
        """Return N Kt / R of drive j, N/V or Nm/V."""
        return self._of_drive(j, "gear_ratio") * self._of_drive(j, "Kt") / self._of_drive(j, "resistance")

    def _emf_constant(self, j: int) -> Value:
        """Return N Ke of drive j, V per unit of speed."""
        return self._of_drive(j, "gear_ratio") * self._of_drive(j, "Ke")

    def force_per_volt(self, j: int) -> Value:
        """Return the force of drive j at standstill on the travel of its coordinate, N/V."""
        return self._torque_per_volt(j) / self.radius(self.drive_coordinates[j])

    def constant_stiffness(self, b: int) -> Value:
        """Return EA / rest length of belt b, N/m: its stiffness where its length does not follow the carriage."""
        name = self.machine.belts[b].name
        return self.parameter(f"{name}.EA") / self.parameter(f"{name}.rest_length")

    # -- effects ---------------------------------------------------------------------------------------------------

    def effects_at(self, hook: str, *sites: str) -> Iterator[tuple[int, AppliedEffect]]:
        """Iterate over the effects with a hook at one of the sites, with their indices."""
        for k, e in enumerate(self.machine.effects):
            if getattr(e.definition, hook) and e.site in sites:
                yield k, e

    def effects_on(self, hook: str, i: int) -> Iterator[tuple[int, AppliedEffect]]:
        """Iterate over the effects with a hook that act on coordinate i, with their indices."""
        for k, e in enumerate(self.machine.effects):
            if getattr(e.definition, hook) and self._effect_coordinates[k] == i:
                yield k, e

    def evaluate(self, effect: AppliedEffect, hook: str, quantities: Mapping[str, Value]) -> Value:
        """Return a hook's value for the given quantities and the parameter values of these equations."""
        function = getattr(effect.definition, hook)
        return function(
            *(
                self.parameter(f"{effect.label}.{name}") if name in effect.parameters else quantities[name]
                for name in argument_names(function)
            )
        )

    def position(self, point: MotionPoint, i: int) -> Value:
        """Return the position of coordinate i in the coordinate's unit, m or rad."""
        return point.travel[i] * self.per_radius(i)

    def speed(self, point: MotionPoint, i: int) -> Value:
        """Return the speed of coordinate i in the coordinate's unit, m/s or rad/s."""
        return point.speed[i] * self.per_radius(i)

    def effect_state(self, k: int, point: MotionPoint, **arguments: Value) -> Value:
        """Return the state of effect k at a point; arguments: level and current, where its `next_state` needs them."""
        if k not in self.states:
            return 0.0
        state = point.effect_states.get(k, 0.0)
        if point.elapsed is None:
            return state
        speed = self.speed(point, self.state_coordinates[k])
        quantities = {"z": state, "dq": point.elapsed * speed, "dt": point.elapsed, "v": speed, **arguments}
        return named("effect_state", k, self.evaluate(self.machine.effects[k], "next_state", quantities))

    def _quantities(self, k: int, i: int, point: MotionPoint) -> dict[str, Value]:
        """Arguments of the hooks that act on coordinate i, except for the effect's state."""
        effect = self.machine.effects[k]
        quantities = {"q": self.position(point, i), "v": self.speed(point, i), "t": point.time}
        variable, _, name = effect.definition.against.partition(" of ")
        if variable == "time":
            quantities["u"] = point.time
        elif variable in ("position", "velocity"):
            read = self.position if variable == "position" else self.speed
            quantities["u"] = read(point, self.machine.coordinate_names.index(name))
        return quantities

    def _with_state(self, k: int, i: int, point: MotionPoint) -> dict[str, Value]:
        """Arguments of the hooks that act on coordinate i, with the effect's state."""
        quantities = self._quantities(k, i, point)
        quantities["z"] = self.effect_state(k, point)
        if self.machine.effects[k].definition.against.startswith("path"):
            quantities["u"] = quantities["z"]
        return quantities

    def next_state(
        self,
        k: int,
        state: Value,
        arguments: Mapping[str, Value],
        traveled: Sequence[Value],
        speed: Sequence[Value],
        dt: Value,
    ) -> Value:
        """Return the state of effect k after a step.

        Args:
            k: Index of the effect.
            state: State before the step.
            arguments: `ForceBalance.arguments[k]` of the step.
            traveled: Travel of each coordinate over the step, m.
            speed: Speed of each coordinate within the step, m/s.
            dt: Length of the step, s.
        """
        i = self.state_coordinates[k]
        quantities = {"z": state, "dt": dt, **arguments}
        if i >= 0:
            quantities |= {"dq": traveled[i] * self.per_radius(i), "v": speed[i] * self.per_radius(i)}
        return self.evaluate(self.machine.effects[k], "next_state", quantities)

    # -- sensors and delays ----------------------------------------------------------------------------------------

    def sensor_readings(self, positions: Sequence[Value]) -> list[Value]:
        """Return the reading of every sensor, in its unit, without delay, noise and resolution.

        Args:
            positions: Position of each coordinate in the coordinate's unit.
        """
        names = self.machine.coordinate_names
        readings = []
        for j, sensor in enumerate(self.machine.sensors):
            terms = []
            for key in sensor.row:  # a key is a coordinate, or a product of two
                factors = [key] if key in names else key.split("*")
                value = positions[names.index(factors[0])]
                for factor in factors[1:]:
                    value = value * positions[names.index(factor)]
                terms.append(value)
            reading = combination(dict(enumerate(sensor.row.values())), terms)
            across = self.machine.other_axis(sensor.coordinate)
            quantities = {"across": positions[names.index(across)] if across else 0.0}
            for _, e in self.effects_at("measurement", sensor.channel):
                reading = self.evaluate(e, "measurement", {"r": reading, **quantities})
            readings.append(named("reading", j, reading))
        return readings

    def voltage_delays(self) -> list[Value]:
        """Return the delay of each drive's voltage, s."""
        return [self._delay("delay", d.name, "drives") for d in self.machine.drives]

    def measurement_delays(self) -> list[Value]:
        """Return the delay of each sensor, s."""
        return [self._delay("measurement_delay", s.channel) for s in self.machine.sensors]

    def _delay(self, hook: str, *sites: str) -> Value:
        delay: Value = 0.0
        for _, e in self.effects_at(hook, *sites):
            delay = delay + self.evaluate(e, hook, {})
        return delay


def combination(row: IndexRow, values: Sequence[Value]) -> Value:
    """Return the sum of row[i] * values[i]; positive terms come first, because a leading minus costs an instruction."""
    terms = sorted(((i, factor) for i, factor in row.items() if factor), key=lambda term: term[1] < 0)
    if not terms:
        return 0.0
    i, factor = terms[0]
    first = values[i] if factor == 1.0 else -values[i] if factor == -1.0 else factor * values[i]
    return add_combination(first, dict(terms[1:]), values)


def add_combination(total: Value, row: IndexRow, values: Sequence[Value]) -> Value:
    """Return total + the sum of row[i] * values[i]."""
    for i, factor in sorted(row.items(), key=lambda term: term[1] < 0):
        size = values[i] if abs(factor) == 1.0 else abs(factor) * values[i]
        total = total - size if factor < 0 else total + size
    return total
