"""The coefficients and effects of a machine whose parameters are floats, arrays or symbolic expressions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from ...machine import AppliedEffect, Component, Machine, argument_names
from ..symbolic.elementwise import named
from ..symbolic.tracing import evaluate_formula
from .effect_instances import effect_instances

# A float, an array or a symbolic expression (of the kernel's source text, or of CasADi). The arrays of a call
# have one common shape: that of samples, or of variants of the machine.
Value = Any
IndexRow = Mapping[int, float]


@dataclass(frozen=True)
class MotionPoint:
    """A point of a motion at which forces are evaluated.

    Attributes:
        travel: Belt travel of each coordinate, m (radius * angle of a rotary one).
        speed: Rate of the belt travel, m/s.
        time: Time since the machine was switched on, s.
        effect_states: State of each effect that has one (bristle deflection, motor current, ...), in its
            unit, by its index in `ParameterizedMachine.instances`.
        elapsed: Time since the instant of `effect_states`, s: half a step at the middle of a step of the
            integrator. None if they belong to this point.
        gained: Change of `speed` in this step, m/s; None: not known, and taken as zero.
    """

    travel: Sequence[Value]
    speed: Sequence[Value]
    time: Value = 0.0
    effect_states: Mapping[int, Value] = field(default_factory=dict)
    elapsed: Value | None = None
    gained: Sequence[Value] | None = None


class ParameterizedMachine:
    """A machine whose parameters are floats, arrays or symbolic expressions (all typed `Value`).

    Args:
        values: Parameter values by full name, SI; other parameters keep the machine's values.

    Attributes:
        extension_rows: For each belt, extension per belt travel, m/m, by index of the coordinate.
        length_rows: For each belt, change of length per belt travel, m/m, by index of the coordinate.
        drive_coordinates: For each drive, index of the coordinate that it moves.
        instances: Effects, once for each component on which they act.
        states: Indices of the instances that have a state.
    """

    def __init__(self, machine: Machine, values: Mapping[str, Value] | None = None) -> None:
        self.machine = machine
        self._values: dict[str, Value] = {**machine.parameters, **(values or {})}
        names = machine.coordinate_names
        index = {name: i for i, name in enumerate(names)}
        # In the order of the coordinates: the order in which a file lists the factors must not change a
        # rounding error.
        self.extension_rows = [_ordered(b.extension, index) for b in machine.belts]
        self.length_rows = [_ordered(b.length, index) for b in machine.belts]
        self.drive_coordinates = [index[d.coordinate] for d in machine.drives]
        self.instances = effect_instances(machine)
        self.states = [
            k for k, instance in enumerate(self.instances) if instance.effect.definition.next_state
        ]

    # -- parameters ------------------------------------------------------------------------------------------

    def parameter(self, name: str) -> Value:
        """Return the value of a parameter, SI, given its full name, such as "x.mass".

        A tied parameter (`Machine.ties`) is a factor times the value of another one.

        Raises:
            KeyError: If the machine has no such parameter.
        """
        if name in self.machine.ties:
            other, factor = self.machine.ties[name]
            return factor * self.parameter(other)
        return self._values[name]

    @cached_property
    def _coordinates(self) -> list[Any]:
        """Coordinates of the machine with the parameter values of this object."""
        return [self._with_values(c) for c in self.machine.coordinates]

    @cached_property
    def drives(self) -> list[Any]:
        """Drives of the machine, in its order, as `machine.Drive` objects with this object's values."""
        return [self._with_values(d) for d in self.machine.drives]

    def _with_values(self, component: Component) -> Any:
        """Return a component whose parameters may be arrays or expressions; its formulas take them."""
        values = {key: self.parameter(f"{component.label}.{key}") for key in component.parameter_names}
        return component.with_values(values)

    def radius(self, i: int) -> Value:
        """Return the belt travel per unit of coordinate i: a pulley's radius, m, or 1 for a linear one."""
        return self._coordinates[i].travel_per_unit

    def per_radius(self, i: int) -> Value:
        """Return the position of coordinate i per belt travel, the reciprocal of `radius`, 1/m."""
        return 1.0 / self.radius(i)

    def mass(self, i: int) -> Value:
        """Return the mass of coordinate i referred to its belt travel, kg: inertia / radius^2 of a pulley."""
        return self._coordinates[i].mass / (self.radius(i) * self.radius(i))

    def coulomb(self, i: int) -> Value:
        """Return the Coulomb friction force of coordinate i along its belt travel, N, without effects."""
        return self._coordinates[i].coulomb / self.radius(i)

    def viscous(self, i: int, direction: Value) -> Value:
        """Return the viscous friction coefficient of coordinate i along its belt travel, Ns/m.

        The back-EMF of the drives (the damping by their laws) and the effects on friction are included.

        Args:
            direction: 1 for motion in positive direction, -1 in negative direction; 0 or a number in between
                blends the coefficients of both directions, which differ only by effects.
        """
        coefficient = self._coordinates[i].viscous
        for _, e in self.effects_on("viscous", i):
            coefficient = self.evaluate(e, "viscous", {"b": coefficient, "direction": direction})
        for j, of_drive in enumerate(self.drive_coordinates):
            if of_drive == i:
                coefficient = coefficient + self.drives[j].damping
        return coefficient / (self.radius(i) * self.radius(i))

    def force_per_volt(self, j: int) -> Value:
        """Return the force of drive j per volt at standstill, N/V, along the belt travel of its coordinate.

        It is N Kt / (R r), with gear ratio N, torque constant Kt, resistance R and pulley radius r (1 for a
        linear coordinate).
        """
        return self.drives[j].gain / self.radius(self.drive_coordinates[j])

    # -- effects ---------------------------------------------------------------------------------------------

    def effects_at(self, hook: str, component: str) -> Iterator[tuple[int, AppliedEffect]]:
        """Yield the effects on a component that change a certain quantity, in the order in which they act.

        Args:
            hook: Quantity, for example "voltage". An effect changes it if it defines the formula of this
                name; `hframe_gym.machine.Effect` lists the formulas ("hooks").
            component: Name of a drive, belt, coordinate or sensor channel, for example "motor1".

        Yields:
            Index in the attribute `instances`, and the effect with its parameter values.
        """
        instances = enumerate(self.instances)
        here = [
            (k, i.effect)
            for k, i in instances
            if i.component == component and getattr(i.effect.definition, hook)
        ]
        yield from sorted(here, key=lambda entry: entry[1].definition.signal_order)

    def effects_on(self, hook: str, i: int) -> Iterator[tuple[int, AppliedEffect]]:
        """Yield the results of `effects_at` for coordinate i and for the drives that move it."""
        for k, instance in enumerate(self.instances):
            if getattr(instance.effect.definition, hook) and instance.coordinate == i:
                yield k, instance.effect

    def evaluate(self, effect: AppliedEffect, hook: str, quantities: Mapping[str, Value]) -> Value:
        """Evaluate a formula of an effect with the parameter values of this object.

        Args:
            hook: Name of the formula, for example "force"; `hframe_gym.machine.Effect` lists them with their
                units.
            quantities: Arguments of the formula other than the effect's parameters, by symbol, for example
                position q (m or rad) and speed v (m/s or rad/s).

        Raises:
            TypeError: If the formula cannot be evaluated (`evaluate_formula`).
        """
        function = getattr(effect.definition, hook)
        names = argument_names(function)
        values = [
            self.parameter(f"{effect.label}.{n}") if n in effect.parameters else quantities[n] for n in names
        ]
        return evaluate_formula(f"{effect.label}, {hook}", function, *values)

    def position(self, point: MotionPoint, i: int) -> Value:
        """Return the position of coordinate i in its unit, m or rad: belt travel divided by radius."""
        return point.travel[i] * self.per_radius(i)

    def speed(self, point: MotionPoint, i: int) -> Value:
        """Return coordinate i's speed in its unit, m/s or rad/s: belt speed divided by radius."""
        return point.speed[i] * self.per_radius(i)

    def effect_state(self, k: int, point: MotionPoint, **arguments: Value) -> Value:
        """Return the state of effect k, such as a bristle deflection, SI; 0 for an effect without state.

        If `point.elapsed` (s) is set, the states in `point` are from this much earlier, and the effect's
        formula `next_state` advances the state to the time of the point.

        Args:
            k: Index of the effect in `instances`.
            **arguments: Arguments of the formula `next_state`: for an effect that replaces dry friction
                `level`, the Coulomb friction force, N or Nm; for an effect on a drive's current or law, as
                far as the formula takes them, the current `i` without the effect, A, the motor voltage `V`,
                the position `q` and the gear ratio `N`. None for other effects.
        """
        if k not in self.states:
            return 0.0
        state = point.effect_states.get(k, 0.0)
        if point.elapsed is None:
            return state
        speed = self.speed(point, self.instances[k].state_coordinate)
        step = {"dq": point.elapsed * speed, "dt": point.elapsed, "v": speed, "dv": 0.0}
        quantities = {"z": state, **step, **arguments}
        return named("effect_state", k, self.evaluate(self.instances[k].effect, "next_state", quantities))

    def _quantities(self, k: int, i: int, point: MotionPoint) -> dict[str, Value]:
        """Return the arguments of the hooks that act on coordinate i, except for the effect's state."""
        effect = self.instances[k].effect
        quantities = {"q": self.position(point, i), "v": self.speed(point, i), "t": point.time}
        variable, _, name = effect.definition.against.partition(" of ")
        if variable == "time":
            quantities["u"] = point.time
        elif variable in ("position", "velocity"):
            read = self.position if variable == "position" else self.speed
            quantities["u"] = read(point, self.machine.coordinate_names.index(name))
        return quantities

    def _with_state(self, k: int, i: int, point: MotionPoint) -> dict[str, Value]:
        """Return the arguments of the hooks that act on coordinate i, with the effect's state."""
        quantities = self._quantities(k, i, point)
        quantities["z"] = self.effect_state(k, point)
        if self.instances[k].effect.definition.against.startswith("path"):
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
        gained: Sequence[Value] | None = None,
    ) -> Value:
        """Return the state of effect k after a step of the integrator, SI.

        Args:
            k: Index of the effect in `instances`; it must have a state.
            state: Its state before the step, SI.
            arguments: Arguments of its formula `next_state` that the motion does not give, by name, such as
                "level" (`ForceBalance.arguments`).
            traveled: Change of the belt travel of each coordinate over the step, m.
            speed: Mean rate of the belt travel of each coordinate in the step, m/s.
            dt: Length of the step, s.
            gained: Change of that rate in the step, m/s; None: not known, and taken as zero.
        """
        quantities = {"z": state, "dt": dt, **arguments}
        if (i := self.instances[k].state_coordinate) >= 0:
            quantities |= {"dq": traveled[i] * self.per_radius(i), "v": speed[i] * self.per_radius(i)}
            quantities["dv"] = gained[i] * self.per_radius(i) if gained else 0.0
        return self.evaluate(self.instances[k].effect, "next_state", quantities)


def _ordered(row: Mapping[str, float], index: Mapping[str, int]) -> IndexRow:
    """Return the factors of a row that are not zero by index of the coordinate, ascending."""
    return dict(sorted((index[name], factor) for name, factor in row.items() if factor))
