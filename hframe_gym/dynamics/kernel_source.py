"""Generates the source of a machine's simulation kernel by evaluating the equations of motion on traced expressions.

What is the same for all machines of one shape (coordinates, rows of the belts, places of drives and effects) becomes
source text: zeros vanish, ones become additions. What differs between them (every value of `Machine.parameters`) is
data: one SIMD lane per machine.

One step of length h, from travel q and speed v (`reference_step` is the same algorithm in plain Python):

    1. Forces at the half-way point q + h/2 v, and from them the acceleration a (zero where static friction holds).
    2. Forces again at the corrected point q + h/2 v + h^2/12 a; speed-dependent friction is evaluated at v + h/2 a.
    3. Exact flow of m dv/dt = f - b v - F sign v with these forces (`friction`), and its exact travel.
    4. Machines with a coordinate that stops within the step: exact time of the stop, then rest or reversal.
    5. States of the effects.

The scheme is of second order and needs two force evaluations and one division per three belts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..machine import HOOKS, Machine, argument_names
from .belts import combination
from .elementwise import exp, fma, named, where
from .equations import Equations, ForceBalance
from .expressions import Expression, function_source
from .parameterized_machine import MotionPoint
from .tracing import Trace

# Constants of a step that `prepare` derives from the parameters, for each coordinate; those of PER_DIRECTION for both
# directions of motion where viscous friction depends on the direction.
PER_COORDINATE = ("mass", "per_mass", "coulomb", "correction_gain")
PER_DIRECTION = ("viscous", "correction_damping", "decay", "speed_gain", "first_weight", "last_weight")


@dataclass(frozen=True)
class Layout:
    """Row of each quantity in the arrays `parameters` and `derived` of a compiled simulation kernel.

    Both arrays have one column per machine.

    Attributes:
        parameters: Row of each machine parameter by full name, for example "x.mass".
        derived: Row of each constant that the generated function `prepare` derives from parameters and step length h,
            for example "coordinate_0.decay", the factor exp(-b h / m) of the first coordinate.
    """

    parameters: Mapping[str, int]
    derived: Mapping[str, int]


class KernelSource:
    """Source text of the simulation kernel (generated code) for all machines of one shape (`Machine.shape`).

    Args:
        machine: Any machine of the shape; its parameter values do not matter.
        forced: Whether an external force acts on every coordinate.

    Attributes:
        layout: Row of each quantity in the arrays `parameters` and `derived` of the generated functions.
        states: Number of rows of a state: travel and speed of each coordinate, time, effect states.
        delayed: Whether a drive has a delay.
        lagged: Whether a sensor has a delay.
        text: Source of the functions prepare (constants of a step), voltage_delays, advance (the integrator),
            read_sensors and measurement_delays.
    """

    def __init__(self, machine: Machine, *, forced: bool = False) -> None:
        self.machine = machine
        self.forced = forced
        self._plain = Equations(machine)
        self._coordinates = range(len(machine.coordinates))
        parameters = {name: row for row, name in enumerate(machine.parameters)}
        derived: list[str] = []
        for i in self._coordinates:
            derived += [_row_name("coordinate", i, key) for key in PER_COORDINATE]
            derived += [_row_name("coordinate", i, key + s) for s in self._directions(i) for key in PER_DIRECTION]
        derived += [_row_name("drive", j, "force_per_volt") for j in range(len(machine.drives))]
        derived += [_row_name("belt", b, "stiffness") for b, belt in enumerate(machine.belts) if not belt.length]
        self.layout = Layout(parameters, {name: row for row, name in enumerate(derived)})
        self.states = 2 * len(self._coordinates) + 1 + len(self._plain.states)
        definitions = [e.definition for e in machine.effects]
        self.delayed = any(d.delay for d in definitions)
        self.lagged = any(d.measurement_delay for d in definitions)
        # The forces of these belts are not linear around the half-way point: a step evaluates them twice.
        self._nonlinear_belts = any(d.tension or d.belt_travel for d in definitions)
        hooks = [getattr(d, hook) for d in definitions for hook in HOOKS if getattr(d, hook)]
        self._uses_time = any("t" in argument_names(f) for f in hooks) or any(d.against == "time" for d in definitions)
        traces = (
            self._prepare(),
            self._delays("voltage_delays"),
            _StepTrace(self).trace,
            self._read_sensors(),
            self._delays("measurement_delays"),
        )
        self.text = "\n\n".join(f"@inlined\n{function_source(trace)}" for trace in traces)

    def _directions(self, i: int) -> tuple[str, ...]:
        """Return suffixes of the derived constants that depend on the direction of motion of coordinate i."""
        return ("_forward", "_backward") if any(self._plain.effects_on("viscous", i)) else ("",)

    def _equations(self, trace: Trace) -> Equations:
        """Return the equations with the parameters loaded from the array `parameters`."""
        rows = self.layout.parameters.items()
        return Equations(self.machine, {name: trace.load("parameters", row, f"p{row}") for name, row in rows})

    # -- constants of a step ---------------------------------------------------------------------------------------

    def _prepare(self) -> Trace:
        """Trace the constants that depend on parameters and the step length only."""
        trace = Trace("prepare(parameters, derived, h)")
        equations, h, rows = self._equations(trace), trace.argument("h"), self.layout.derived
        for i in self._coordinates:
            mass = trace.let("mass", i, equations.mass(i))
            constants = (mass, 1.0 / mass, equations.coulomb(i), h * h / 12.0 / mass)
            for key, value in zip(PER_COORDINATE, constants, strict=True):
                trace.store("derived", rows[_row_name("coordinate", i, key)], value)
            for suffix in self._directions(i):
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
                    trace.store("derived", rows[_row_name("coordinate", i, key + suffix)], value)
        for j in range(len(self.machine.drives)):
            trace.store("derived", rows[_row_name("drive", j, "force_per_volt")], equations.force_per_volt(j))
        for b, belt in enumerate(self.machine.belts):
            if not belt.length:
                trace.store("derived", rows[_row_name("belt", b, "stiffness")], equations.constant_stiffness(b))
        return trace

    # -- sensors and delays ----------------------------------------------------------------------------------------

    def _delays(self, function: str) -> Trace:
        """Trace voltage_delays (delay of each drive, s) or measurement_delays (delay of each sensor, s)."""
        trace = Trace(f"{function}(parameters, delays)")
        for row, delay in enumerate(getattr(self._equations(trace), function)()):
            trace.store("delays", row, delay)
        return trace

    def _read_sensors(self) -> Trace:
        """Trace the reading of each sensor in its unit."""
        trace = Trace("read_sensors(state, parameters, readings)")
        equations = self._equations(trace)
        travel = [trace.load("state", i, f"travel_{i}") for i in self._coordinates]
        positions = [p / equations.radius(i) for i, p in enumerate(travel)]
        for j, reading in enumerate(equations.sensor_readings(positions)):
            trace.store("readings", j, reading)
        return trace


class _PreparedEquations(Equations):
    """Equations that take from `derived` what `prepare` has computed.

    Args:
        source: The kernel.
        trace: Trace of the function `advance`.
    """

    def __init__(self, source: KernelSource, trace: Trace) -> None:
        rows = source.layout.parameters.items()
        super().__init__(source.machine, {name: trace.load("parameters", row, f"p{row}") for name, row in rows})
        self._trace = trace
        self._rows = source.layout.derived

    def derived(self, component: str, index: int, key: str) -> Expression:
        """Return the expression of the step constant `key` of a "coordinate", "drive" or "belt" with this index."""
        row = self._rows[_row_name(component, index, key)]
        return self._trace.load("derived", row, f"{key}_{index}")

    def coulomb(self, i: int) -> Expression:
        """Return the expression of the Coulomb friction force of coordinate i along its belt travel, N."""
        return self.derived("coordinate", i, "coulomb")

    def force_per_volt(self, j: int) -> Expression:
        """Return the expression of the force of drive j per volt at standstill along the belt travel, N/V."""
        return self.derived("drive", j, "force_per_volt")

    def constant_stiffness(self, b: int) -> Expression:
        """Return the expression of the stiffness EA / rest length of belt b, N/m."""
        return self.derived("belt", b, "stiffness")


class _StepTrace:
    """Traces the function `advance`, in the order of the algorithm at the top of this module.

    Args:
        source: The kernel.
    """

    def __init__(self, source: KernelSource) -> None:
        self.source = source
        self.coordinates = range(len(source.machine.coordinates))
        self.trace = trace = Trace("advance(state, parameters, derived, inputs, external_forces, h, steps)")
        self.equations = _PreparedEquations(source, trace)
        count = len(self.coordinates)
        trace.line("align_stack()")
        self.travel = [trace.variable("travel", i, trace.load("state", i, "")) for i in self.coordinates]
        self.speed = [trace.variable("speed", i, trace.load("state", count + i, "")) for i in self.coordinates]
        self.time = trace.variable("time", None, trace.load("state", 2 * count, ""))
        first = 2 * count + 1
        self.effect_states = {
            k: trace.variable("effect_state", k, trace.load("state", first + row, ""))
            for row, k in enumerate(self.equations.states)
        }
        self.h = trace.argument("h")
        with trace.block("for step in range(steps):", loop=True):
            self._step()
        for i in self.coordinates:
            trace.store("state", i, self.travel[i])
            trace.store("state", count + i, self.speed[i])
        elapsed = 0.0 if source._uses_time else self.h * trace.argument("steps")
        trace.store("state", 2 * count, self.time + elapsed)
        for row, k in enumerate(self.equations.states):
            trace.store("state", first + row, self.effect_states[k])

    def _step(self) -> None:
        """Trace one step."""
        trace, equations, h = self.trace, self.equations, self.h
        half = trace.let("half_step", None, 0.5 * h)
        with trace.section("1. forces at the half-way point, and the acceleration", "half_"):
            half_way = [named("travel", i, fma(half, self.speed[i], self.travel[i])) for i in self.coordinates]
            point = MotionPoint(half_way, self.speed, self.time + half, self.effect_states, half)
            motor_voltages = equations.motor_voltages(self._voltages())
            belts = equations.belt_states(point)
            drive_and_belts = self._drive_and_belt_forces(equations.belt_forces(point, belts), motor_voltages)
            balance = self._balance(point, motor_voltages, drive_and_belts)
            correction = [named("correction", i, self._correction(i, balance)) for i in self.coordinates]
        with trace.section("2. forces at the corrected point", "corrected_"):
            corrected = [q + dq for q, dq in zip(half_way, correction, strict=True)]
            mean_speed = [fma(6.0 / h, dq, v) for v, dq in zip(self.speed, correction, strict=True)]
            point = MotionPoint(corrected, mean_speed, self.time + half, self.effect_states, half)
            if self.source._nonlinear_belts:
                belt_forces = equations.belt_forces(point, equations.belt_states(point))
                drive_and_belts = self._drive_and_belt_forces(belt_forces, motor_voltages)
            else:  # the stiffness at the half-way point serves again
                stiffness = [belt.stiffness for belt in belts]
                drive_and_belts = self._shifted_forces(drive_and_belts, stiffness, correction)
            balance = self._balance(point, motor_voltages, drive_and_belts)
        with trace.section("3. exact flow with friction"):
            flows = [self._flow(i, balance) for i in self.coordinates]
        with trace.section("4. coordinates that stop within the step"):
            ends = [self._stop(i, balance, *flow) for i, flow in enumerate(flows)]
        with trace.section("5. the new state"):
            traveled = [travel - q for (_, travel), q in zip(ends, self.travel, strict=True)]
            states = {}
            for k, state in self.effect_states.items():
                value = equations.next_state(k, state, balance.arguments.get(k, {}), traveled, mean_speed, h)
                states[k] = trace.let("next_effect_state", k, value)
            self.effect_states = {k: trace.assign(self.effect_states[k], state) for k, state in states.items()}
            self.speed = [trace.assign(v, speed) for v, (speed, _) in zip(self.speed, ends, strict=True)]
            self.travel = [trace.assign(q, travel) for q, (_, travel) in zip(self.travel, ends, strict=True)]
            if self.source._uses_time:
                self.time = trace.assign(self.time, self.time + h)

    def _voltages(self) -> list[Expression]:
        """Return the commanded voltage of each drive; with a delay it changes from step to step."""
        count = len(self.source.machine.drives)
        if self.source.delayed:
            return [self.trace.load("inputs", f"step * {count} + {j}", f"u{j}", invariant=False) for j in range(count)]
        return [self.trace.load("inputs", j, f"u{j}") for j in range(count)]

    def _drive_and_belt_forces(
        self, belt_forces: Sequence[Expression], motor_voltages: Sequence[Expression]
    ) -> list[Expression]:
        """Return the forces of belts and drives, and the external ones."""
        forces = self.equations.add_drive_forces(belt_forces, motor_voltages)
        if self.source.forced:
            forces = [f + self.trace.load("external_forces", i, f"w{i}") for i, f in enumerate(forces)]
        return [named("drive_and_belts", i, self.trace.expression(f)) for i, f in enumerate(forces)]

    def _balance(
        self, point: MotionPoint, motor_voltages: Sequence[Expression], forces: Sequence[Expression]
    ) -> ForceBalance:
        """Return the force balance with named results."""
        balance = self.equations.force_balance(point, motor_voltages, forces)
        total = [named("force", i, f) for i, f in enumerate(balance.forces)]
        coulomb = [named("coulomb", i, level) for i, level in enumerate(balance.coulomb)]
        return ForceBalance(total, coulomb, balance.arguments)

    def _shifted_forces(
        self, forces: Sequence[Expression], stiffness: Sequence[Expression], shift: Sequence[Expression]
    ) -> list[Expression]:
        """Return the forces after a small displacement of the travel, to first order: f - G' k G shift."""
        rows = self.equations.extension_rows
        changes = [named("tension_change", b, k * combination(rows[b], shift)) for b, k in enumerate(stiffness)]
        result = []
        for i, force in enumerate(forces):
            row = {b: -rows[b].get(i, 0.0) for b in range(len(rows))}
            result.append(named("drive_and_belts", i, force + combination(row, changes)))
        return result

    def _by_direction(self, i: int, key: str, balance: ForceBalance, *, reversed_motion: bool = False) -> Expression:
        """Return a constant of coordinate i for its direction of motion, or for the opposite one."""
        suffixes = self.source._directions(i)
        if len(suffixes) == 1:
            return self.equations.derived("coordinate", i, key)
        direction = self.trace.node("direction", self.speed[i], balance.forces[i])
        ahead, behind = (self.equations.derived("coordinate", i, key + suffix) for suffix in suffixes)
        choice: Expression = where(direction >= 0.0, *((behind, ahead) if reversed_motion else (ahead, behind)))
        return choice

    def _correction(self, i: int, balance: ForceBalance) -> Expression:
        """Return h^2/12 times the acceleration of coordinate i, m."""
        speed, force = self.speed[i], balance.forces[i]
        gain = self.equations.derived("coordinate", i, "correction_gain")
        net = force - self.trace.node("friction_force", speed, force, balance.coulomb[i])
        value: Expression = fma(gain, net, self._by_direction(i, "correction_damping", balance) * speed)
        return value

    def _flow(self, i: int, balance: ForceBalance) -> tuple[Expression, Expression, Expression]:
        """Trace the step of coordinate i without a stop; return speed, whether it stops, and travel."""
        decay, gain, first, last = (
            self._by_direction(i, key, balance) for key in ("decay", "speed_gain", "first_weight", "last_weight")
        )
        results = (("next_speed", i), ("stopped", i))
        arguments = (self.speed[i], balance.forces[i], balance.coulomb[i], decay, gain)
        next_speed, stopped = self.trace.call("update_speed", *arguments, results=results)
        travel = fma(last, next_speed, fma(first, self.speed[i], self.travel[i]))
        return next_speed, stopped, self.trace.variable("next_travel", i, travel)

    def _stop(
        self, i: int, balance: ForceBalance, next_speed: Expression, stopped: Expression, next_travel: Expression
    ) -> tuple[Expression, Expression]:
        """Trace the step of coordinate i in the lanes where it stops; return speed and travel after the step."""
        mass, per_mass = (self.equations.derived("coordinate", i, key) for key in ("mass", "per_mass"))
        viscous = self._by_direction(i, "viscous", balance)
        viscous_after = self._by_direction(i, "viscous", balance, reversed_motion=True)
        before_stop = (self.speed[i], balance.forces[i], balance.coulomb[i], viscous)
        arguments = (*before_stop, viscous_after, mass, per_mass, self.h)
        results = (("speed_after_stop", i), ("traveled", i))
        with self.trace.block("if any_of({}):", stopped):
            speed, traveled = self.trace.call("stop_or_reverse", *arguments, results=results)
            return (
                self.trace.assign(next_speed, where(stopped, speed, next_speed)),
                self.trace.assign(next_travel, where(stopped, self.travel[i] + traveled, next_travel)),
            )


def _row_name(component: str, index: int, key: str) -> str:
    """Return the name of a derived constant."""
    return f"{component}_{index}.{key}"
