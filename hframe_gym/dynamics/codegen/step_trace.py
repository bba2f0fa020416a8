"""Generate by tracing the function `advance`, the integrator's steps, in which simulations spend their time.

One step of length h, from travel q and speed v (`reference_step` is the same algorithm in plain Python):

    1. Forces at the half-way point q + h/2 v, and from them the acceleration a (zero where static friction
      holds).
    2. Forces again at the corrected point q + h/2 v + h^2/12 a; speed-dependent friction is evaluated at v +
      h/2 a.
    3. Exact flow of m dv/dt = f - b v - F sign v with these forces (`friction`), and its exact travel.
    4. Machines with a coordinate that stops within the step: exact time of the stop, then rest or reversal.
    5. States of the effects.

The scheme is of second order and needs two force evaluations and one division per three belts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any

from typing_extensions import override

from ..physics.belts import combination
from ..physics.equations import Equations, ForceBalance
from ..physics.parameterized_machine import MotionPoint
from ..symbolic.elementwise import fma, minimum, named, where
from ..symbolic.tracing import Expression, Trace
from .kernel_source import KernelSource, row_name


class _PreparedEquations(Equations):
    """Equations that take from `derived` what `prepare` has computed."""

    def __init__(self, source: KernelSource, trace: Trace) -> None:
        super().__init__(source.machine, source.parameters(trace))
        self._trace = trace
        self._rows = source.layout.derived
        self.constants: Mapping[str, Expression] = {}  # instead of those that `prepare` has computed

    def derived(self, component: str, index: int, key: str) -> Expression:
        """Return the step constant `key` of a "coordinate", "drive" or "belt" with this index."""
        name = row_name(component, index, key)
        if name in self.constants:
            return self.constants[name]
        row = self._rows[name]
        return self._trace.load("derived", row, f"{key}_{index}")

    @override
    def coulomb(self, i: int) -> Expression:
        return self.derived("coordinate", i, "coulomb")

    @override
    def force_per_volt(self, j: int) -> Expression:
        return self.derived("drive", j, "force_per_volt")

    @override
    def constant_stiffness(self, b: int) -> Expression:
        return self.derived("belt", b, "stiffness")


class StepTrace:
    """Trace of the generated function `advance`, in the order of the algorithm at the top of this module."""

    def __init__(self, source: KernelSource) -> None:
        self.trace = trace = Trace(
            "advance(state, parameters, derived, inputs, external_forces, h: float, steps: int)"
        )
        self._begin(source)
        count, first = len(self.coordinates), 2 * len(self.coordinates) + 1
        with trace.block("for step in range(steps):", loop=True):
            self._step()
        self.h, self.equations.constants = trace.argument("h"), {}
        for i in self.coordinates:
            trace.store("state", i, self.travel[i])
            trace.store("state", count + i, self.speed[i])
        elapsed = 0.0 if source.uses_time else self.h * trace.argument("steps")
        trace.store("state", 2 * count, self.time + elapsed)
        for row, k in enumerate(self.equations.states):
            trace.store("state", first + row, self.effect_states[k])
        if source.felt:
            self._store_felt(source.states - source.felt)

    def _begin(self, source: KernelSource) -> None:
        """Trace what comes before the first step: the state is loaded."""
        self.source, trace = source, self.trace
        self.coordinates = range(len(source.machine.coordinates))
        self.equations = _PreparedEquations(source, trace)
        count = len(self.coordinates)
        trace.line("align_stack()")
        self.travel = [trace.variable("travel", i, trace.load("state", i, "")) for i in self.coordinates]
        self.speed = [
            trace.variable("speed", i, trace.load("state", count + i, "")) for i in self.coordinates
        ]
        self.time = trace.variable("time", None, trace.load("state", 2 * count, ""))
        first = 2 * count + 1
        self.effect_states = {
            k: trace.variable("effect_state", k, trace.load("state", first + row, ""))
            for row, k in enumerate(self.equations.states)
        }
        self.h = trace.argument("h")

    def _store_felt(self, row: int) -> None:
        """Trace each coordinate's acceleration, m/s^2, and each drive's current, A, after the last step."""
        trace, equations = self.trace, self.equations
        with trace.section("6. accelerations and currents", "felt_"):
            point = MotionPoint(self.travel, self.speed, self.time, self.effect_states)
            motor_voltages = equations.motor_voltages(self._last_voltages())
            belt_forces = equations.belt_forces(point, equations.belt_states(point))
            balance = self._balance(
                point, motor_voltages, self._drive_and_belt_forces(belt_forces, motor_voltages)
            )
            for i in self.coordinates:
                speed, force = self.speed[i], balance.forces[i]
                net = force - trace.node("friction_force", speed, force, balance.coulomb[i])
                net = net - self._by_direction(i, "viscous", balance) * speed
                trace.store("state", row + i, net * equations.derived("coordinate", i, "per_mass"))
            for j in range(len(motor_voltages)):
                current = equations.current(j, point, motor_voltages)
                trace.store("state", row + len(self.coordinates) + j, current)

    def _last_voltages(self) -> list[Expression]:
        """Return the commanded voltage of each drive in the last step."""
        count = len(self.source.machine.drives)
        if not self.source.drives_delayed:
            return self._voltages()
        rows = [f"(steps - 1) * {count} + {j}" for j in range(count)]
        return [self.trace.load("inputs", row, f"last_u{j}", invariant=False) for j, row in enumerate(rows)]

    def _step(self) -> None:
        """Trace one step."""
        trace, equations = self.trace, self.equations
        if self.source.clocked:
            self._set_clock()
        h = self.h
        half = trace.let("half_step", None, 0.5 * h)
        with trace.section("1. forces at the half-way point, and the acceleration", "half_"):
            half_way = [
                named("travel", i, fma(half, self.speed[i], self.travel[i])) for i in self.coordinates
            ]
            point = MotionPoint(half_way, self.speed, self.time + half, self.effect_states, half)
            motor_voltages = equations.motor_voltages(self._voltages())
            belts = equations.belt_states(point)
            drive_and_belts = self._drive_and_belt_forces(equations.belt_forces(point, belts), motor_voltages)
            balance = self._balance(point, motor_voltages, drive_and_belts)
            correction = [named("correction", i, self._correction(i, balance)) for i in self.coordinates]
        with trace.section("2. forces at the corrected point", "corrected_"):
            corrected = [q + dq for q, dq in zip(half_way, correction, strict=True)]
            mean_speed = [fma(6.0 / h, dq, v) for v, dq in zip(self.speed, correction, strict=True)]
            gained = [12.0 / h * dq for dq in correction]
            point = MotionPoint(corrected, mean_speed, self.time + half, self.effect_states, half, gained)
            if equations.nonlinear_belts:
                belt_forces = equations.belt_forces(point, equations.belt_states(point))
                drive_and_belts = self._drive_and_belt_forces(belt_forces, motor_voltages)
            else:  # the stiffness at the half-way point serves again
                stiffness = [belt.stiffness for belt in belts]
                drive_and_belts = self._shifted_forces(drive_and_belts, stiffness, correction)
            balance = self._balance(point, motor_voltages, drive_and_belts)
        with trace.section("3. exact flow with friction"):
            flows = [self._flow(i, balance) for i in self.coordinates]
        with trace.section("4. coordinates that stop within the step"):
            ends = self._stops(balance, flows)
        with trace.section("5. the new state"):
            traveled = [travel - q for (_, travel), q in zip(ends, self.travel, strict=True)]
            gained = [speed - v for (speed, _), v in zip(ends, self.speed, strict=True)]
            states = {}
            for k, state in self.effect_states.items():
                given = balance.arguments.get(k, {})
                value = equations.next_state(k, state, given, traveled, mean_speed, h, gained)
                states[k] = trace.let("next_effect_state", k, value)
            self.effect_states = {
                k: trace.assign(self.effect_states[k], state) for k, state in states.items()
            }
            self.speed = [trace.assign(v, speed) for v, (speed, _) in zip(self.speed, ends, strict=True)]
            self.travel = [trace.assign(q, travel) for q, (_, travel) in zip(self.travel, ends, strict=True)]
            if self.source.uses_time:
                self.time = trace.assign(self.time, self.time + h)

    def _set_clock(self) -> None:
        """Trace the actual length of the present step and the constants that depend on it."""
        trace, source = self.trace, self.source
        factor = self.equations.step_factor(self.effect_states)
        self.h = trace.let("actual_step", None, self.h * factor)
        self.equations.constants = dict(source.step_constants(trace, source.equations(trace), self.h))

    def _voltages(self) -> list[Expression]:
        """Return the commanded voltage of each drive; with a delay it changes from step to step."""
        count = len(self.source.machine.drives)
        if self.source.drives_delayed:
            return [
                self.trace.load("inputs", f"step * {count} + {j}", f"u{j}", invariant=False)
                for j in range(count)
            ]
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
        changes = [
            named("tension_change", b, k * combination(rows[b], shift)) for b, k in enumerate(stiffness)
        ]
        result = []
        for i, force in enumerate(forces):
            row = {b: -rows[b].get(i, 0.0) for b in range(len(rows))}
            result.append(named("drive_and_belts", i, force + combination(row, changes)))
        return result

    def _by_direction(
        self, i: int, key: str, balance: ForceBalance, *, reversed_motion: bool = False
    ) -> Expression:
        """Return a constant of coordinate i for its direction of motion, or for the opposite one."""
        suffixes = self.source.directions(i)
        if len(suffixes) == 1:
            return self.equations.derived("coordinate", i, key)
        direction = self.trace.node("direction", self.speed[i], balance.forces[i])
        ahead, behind = (self.equations.derived("coordinate", i, key + suffix) for suffix in suffixes)
        choice: Expression = where(
            direction >= 0.0, *((behind, ahead) if reversed_motion else (ahead, behind))
        )
        return choice

    def _correction(self, i: int, balance: ForceBalance) -> Expression:
        """Return h^2/12 times the acceleration of coordinate i, m."""
        speed, force = self.speed[i], balance.forces[i]
        gain = self.equations.derived("coordinate", i, "correction_gain")
        net = force - self.trace.node("friction_force", speed, force, balance.coulomb[i])
        value: Expression = fma(gain, net, self._by_direction(i, "correction_damping", balance) * speed)
        return value

    def _flow(self, i: int, balance: ForceBalance) -> tuple[Expression, Expression, Expression]:
        """Trace the step of coordinate i without a stop; return speed, speed * former speed, and travel."""
        decay, gain, first, last = (
            self._by_direction(i, key, balance)
            for key in ("decay", "speed_gain", "first_weight", "last_weight")
        )
        speed = self._initial_speed(i, balance)
        arguments = (speed, balance.forces[i], balance.coulomb[i], decay, gain)
        next_speed = self.trace.variable("next_speed", i, self.trace.node("update_speed", *arguments))
        crossing = self.trace.variable("crossing", i, next_speed * speed)
        travel = fma(last, next_speed, fma(first, speed, self.travel[i]))
        return next_speed, crossing, self.trace.variable("next_travel", i, travel)

    def _initial_speed(self, i: int, balance: ForceBalance) -> Expression:
        """Return the speed of coordinate i from which the flow begins; derivatives replace it."""
        return self.speed[i]

    def _stops(
        self, balance: ForceBalance, flows: Sequence[tuple[Expression, Expression, Expression]]
    ) -> list[tuple[Expression, Expression]]:
        """Trace a loop in which every machine takes its next stopping coordinate; return speeds and travels.

        In a register of machines some coordinate stops in most steps, but seldom two of one machine. So there
        is one branch per step, and its body seldom runs twice.
        """
        trace, h, ends = self.trace, self.h, []
        crossings = [crossing for _, crossing, _ in flows]
        # Not an expression of the body, which would be computed once, before the loop.
        with trace.block("while any_of({}):", trace.node(">", 0.0, reduce(minimum, crossings))):
            stops = [named("stops", i, crossing < 0.0) for i, crossing in enumerate(crossings)]
            coordinate = _first_of(stops, list(map(float, self.coordinates)), -1.0)
            coordinate = trace.let("stopping_coordinate", None, coordinate)
            operands: dict[str, Sequence[Expression]] = {
                "speed": self.speed,
                "force": balance.forces,
                "coulomb": balance.coulomb,
                "viscous": [self._by_direction(i, "viscous", balance) for i in self.coordinates],
                "viscous_after": [
                    self._by_direction(i, "viscous", balance, reversed_motion=True) for i in self.coordinates
                ],
                "mass": [self.equations.derived("coordinate", i, "mass") for i in self.coordinates],
                "per_mass": [self.equations.derived("coordinate", i, "per_mass") for i in self.coordinates],
            }
            arguments = [
                trace.let(
                    f"stopping_{key}", None, trace.expression(_first_of(stops[:-1], values[:-1], values[-1]))
                )
                for key, values in operands.items()
            ]
            results = (("speed_after_stop", None), ("traveled", None))
            speed, traveled = trace.call("stop_or_reverse", *arguments, h, results=results)
            for i, (next_speed, crossing, next_travel) in enumerate(flows):
                turn = named("turn", i, coordinate == float(i))
                trace.assign(crossing, where(turn, 0.0, crossing))
                next_speed = trace.assign(next_speed, where(turn, speed, next_speed))
                next_travel = trace.assign(next_travel, where(turn, self.travel[i] + traveled, next_travel))
                ends.append((next_speed, next_travel))
        return ends


def _first_of(conditions: Sequence[Any], values: Sequence[Any], otherwise: Any) -> Any:
    """Return the expression of the value of the first condition that is true, or `otherwise`."""
    selected = otherwise
    for condition, value in reversed(list(zip(conditions, values, strict=True))):
        selected = where(condition, value, selected)
    return selected
