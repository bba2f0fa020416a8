"""Trace the functions of a machine's simulation kernel by evaluating the equations on expressions.

A traced expression records the operations on it (module `tracing`). What is the same for all machines of one
shape (coordinates, factors of the belts, sites of drives and effects) becomes source text, where terms with
the factor 0 and multiplications by 1 are omitted. What differs between them (every value of
`Machine.parameters`) is data, with one machine in each SIMD lane.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from ...machine import HOOKS, Machine, argument_names
from ..physics.equations import Equations
from ..symbolic.elementwise import exp
from ..symbolic.tracing import Expression, Trace

# Functions of the generated text.
FUNCTIONS = ("prepare", "voltage_delays", "advance", "read_sensors", "measurement_delays")

# Constants of a step that `prepare` derives from the parameters, for each coordinate; those of PER_DIRECTION
# for both directions of motion where viscous friction depends on the direction.
PER_COORDINATE = ("mass", "per_mass", "coulomb", "correction_gain")
PER_DIRECTION = ("viscous", "correction_damping", "decay", "speed_gain", "first_weight", "last_weight")


def feels_forces(machine: Machine) -> bool:
    """Return whether a sensor measures an acceleration or a current, which depend on the voltages."""
    return any(sensor.sensed.jumps for sensor in machine.sensors)


@dataclass(frozen=True)
class Layout:
    """Row of each quantity in the arrays `parameters` and `derived` of a compiled simulation kernel.

    Both arrays have one column per machine.

    Attributes:
        parameters: Row of each machine parameter by full name, for example "x.mass".
        derived: Row of each constant that the generated function `prepare` derives from parameters and step
            length h, for example "coordinate_0.decay", the factor exp(-b h / m) of the first coordinate.
    """

    parameters: Mapping[str, int]
    derived: Mapping[str, int]


def row_name(component: str, index: int, key: str) -> str:
    """Return the name of a step constant, such as "coordinate_0.decay" for the factor exp(-b h / m)."""
    return f"{component}_{index}.{key}"


class KernelSource:
    """Functions of the simulation kernel (generated code) for all machines of one shape (`Machine.shape`).

    Args:
        machine: Any machine of the shape; its parameter values do not matter.
        forced: Whether an external force acts on every coordinate.

    Attributes:
        layout: Row of each quantity in the arrays `parameters` and `derived` of the generated functions.
        felt: Number of rows of a state that hold accelerations and currents: none unless a sensor measures
            them.
        states: Number of rows of a state: travel and speed of each coordinate, time, effect states, and then
            (`felt`) the acceleration along the belt travel of each coordinate and the current of each drive
            just before the present sample, under the voltages that have acted until then. They are 0 at the
            start.
        drives_delayed: Whether a drive has a delay.
        sensors_delayed: Whether a sensor has a delay.
        uses_time: Whether time is counted step by step: an effect depends on it, or on the clock.
        clocked: Whether an effect changes the clock: steps then last differently long for each machine.
    """

    def __init__(self, machine: Machine, *, forced: bool = False) -> None:
        self.machine = machine
        self.forced = forced
        self._plain = Equations(machine)
        self._coordinates = range(len(machine.coordinates))
        parameters = {name: row for row, name in enumerate(machine.parameters)}
        derived: list[str] = []
        for i in self._coordinates:
            derived += [row_name("coordinate", i, key) for key in PER_COORDINATE]
            derived += [
                row_name("coordinate", i, key + s) for s in self.directions(i) for key in PER_DIRECTION
            ]
        derived += [row_name("drive", j, "force_per_volt") for j in range(len(machine.drives))]
        derived += [
            row_name("belt", b, "stiffness") for b, belt in enumerate(machine.belts) if not belt.length
        ]
        self.layout = Layout(parameters, {name: row for row, name in enumerate(derived)})
        self.felt = len(machine.coordinates) + len(machine.drives) if feels_forces(machine) else 0
        self.states = 2 * len(self._coordinates) + 1 + len(self._plain.states) + self.felt
        definitions = [e.definition for e in (*machine.drive_laws, *machine.effects)]
        self.drives_delayed = any(d.delay for d in definitions)
        self.sensors_delayed = any(d.measurement_delay for d in definitions)
        hooks = [getattr(d, hook) for d in definitions for hook in HOOKS if getattr(d, hook)]
        self.clocked = any(d.clock for d in definitions)
        self.uses_time = (
            self.clocked
            or any("t" in argument_names(f) for f in hooks)
            or any(d.against == "time" for d in definitions)
        )

    def directions(self, i: int) -> tuple[str, ...]:
        """Return the suffixes of coordinate i's step constants that distinguish directions of motion.

        They are ("_forward", "_backward") if an effect changes the viscous friction of the coordinate, else
        ("",).
        """
        return ("_forward", "_backward") if any(self._plain.effects_on("viscous", i)) else ("",)

    def parameters(self, trace: Trace) -> dict[str, Expression]:
        """Load all parameters, by full name, from the array `parameters` of the traced function."""
        rows = self.layout.parameters.items()
        return {name: trace.load("parameters", row, f"p{row}") for name, row in rows}

    def equations(self, trace: Trace) -> Equations:
        """Return the equations of motion as expressions of a trace.

        Their parameters are loaded from the array `parameters` of the traced function.
        """
        return Equations(self.machine, self.parameters(trace))

    # -- constants of a step ---------------------------------------------------------------------------------

    def trace_constants(self, trace: Trace) -> Trace:
        """Trace the generated function `prepare`: constants that depend on parameters and step length only.

        The statements are appended to `trace`, which is returned.
        """
        for name, value in self.step_constants(trace, self.equations(trace), trace.argument("h")):
            trace.store("derived", self.layout.derived[name], value)
        return trace

    def step_constants(
        self, trace: Trace, equations: Equations, h: Expression
    ) -> Iterator[tuple[str, Expression]]:
        """Trace the constants of an integration step, which depend on parameters and step length only.

        Args:
            trace: Trace to which their computation is added.
            equations: Equations whose parameters are expressions of this trace.
            h: Length of the step, s.

        Yields:
            Name of the constant, a key of `layout.derived` such as "coordinate_0.decay", and its value, SI.
        """
        for i in self._coordinates:
            mass = trace.let("mass", i, equations.mass(i))
            of_coordinate = (mass, 1.0 / mass, equations.coulomb(i), h * h / 12.0 / mass)
            for key, value in zip(PER_COORDINATE, of_coordinate, strict=True):
                yield row_name("coordinate", i, key), value
            for suffix in self.directions(i):
                viscous = equations.viscous(i, -1.0 if suffix == "_backward" else 1.0)
                decay_rate = trace.let(f"damping{suffix}", i, viscous * h / mass)
                last_weight = trace.let(f"weight{suffix}", i, trace.node("end_weight", decay_rate))
                values = (
                    viscous,
                    -h * h / 12.0 / mass * viscous,
                    exp(-decay_rate),
                    h / mass * trace.node("decay_integral", decay_rate),
                    h * (1.0 - last_weight),
                    h * last_weight,
                )
                for key, value in zip(PER_DIRECTION, values, strict=True):
                    yield row_name("coordinate", i, key + suffix), value
        for j in range(len(self.machine.drives)):
            yield row_name("drive", j, "force_per_volt"), equations.force_per_volt(j)
        for b, belt in enumerate(self.machine.belts):
            if not belt.length:
                yield row_name("belt", b, "stiffness"), equations.constant_stiffness(b)

    # -- sensors and delays ----------------------------------------------------------------------------------

    def trace_delays(self, trace: Trace, function: str) -> Trace:
        """Trace a generated function that computes each drive's or each sensor's delay, s.

        Args:
            trace: Trace to which the statements are appended; it is returned.
            function: "voltage_delays" (drives) or "measurement_delays" (sensors).
        """
        for row, delay in enumerate(getattr(self.equations(trace), function)()):
            trace.store("delays", row, delay)
        return trace

    def trace_sensors(self, trace: Trace) -> Trace:
        """Trace the generated function `read_sensors`: the reading of each sensor in its unit.

        The statements are appended to `trace`, which is returned.
        """
        equations = self.equations(trace)
        travel = [trace.load("state", i, f"travel_{i}") for i in self._coordinates]
        positions = [p / equations.radius(i) for i, p in enumerate(travel)]
        velocities, accelerations, currents = None, None, None
        if any(not sensor.of_position for sensor in self.machine.sensors):
            count = len(self._coordinates)
            speed = [trace.load("state", count + i, f"speed_{i}") for i in self._coordinates]
            velocities = [v / equations.radius(i) for i, v in enumerate(speed)]
        if self.felt:
            rows = [
                trace.load("state", row, f"felt_{row}") for row in range(self.states - self.felt, self.states)
            ]
            accelerations = [a / equations.radius(i) for i, a in enumerate(rows[: len(self._coordinates)])]
            currents = rows[len(self._coordinates) :]
        states: dict[int, Expression] = {}
        if any(sensor.quantity == "tension" for sensor in self.machine.sensors):
            first = 2 * len(self._coordinates) + 1
            states = {
                k: trace.load("state", first + row, f"effect_state_{k}")
                for row, k in enumerate(equations.states)
            }
        readings = equations.sensor_readings(
            positions, velocities, accelerations, currents, effect_states=states
        )
        for j, reading in enumerate(readings):
            trace.store("readings", j, reading)
        return trace
