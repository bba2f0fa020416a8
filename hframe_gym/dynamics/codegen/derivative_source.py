"""Generate the source of the derivatives of a machine's simulation kernel, from the kernel's traces.

The functions multiply by the transposed derivative (reverse mode): from the derivatives of a number, such as
a cost, with respect to the results of a function, they compute its derivatives with respect to the function's
arguments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from typing_extensions import override

from ..physics.equations import ForceBalance
from ..symbolic.elementwise import absolute, where
from ..symbolic.source_text import function_source
from ..symbolic.tracing import Expression
from .kernel_source import KernelSource
from .reverse_trace import ReverseTrace
from .step_trace import StepTrace

DERIVATIVE_FUNCTIONS = (
    "step_back",
    "step_back_without_parameters",
    "prepare_back",
    "read_sensors_back",
    "voltage_delays_back",
)


class _StepBack(StepTrace):
    """Trace of one step of the integrator and of its derivatives.

    Args:
        friction: Derivative of static friction, see `derivatives.Friction`.
        by_parameters: Whether to compute derivatives with respect to the parameters.
    """

    def __init__(self, source: KernelSource, *, friction: str, by_parameters: bool) -> None:
        name = "step_back" if by_parameters else "step_back_without_parameters"
        results = "adjoint_state, adjoint_parameters, adjoint_derived, adjoint_inputs"
        trace = ReverseTrace(
            f"{name}(state, parameters, derived, inputs, {results}, h: float)", friction=friction
        )
        self.trace = self.reverse = trace
        self._begin(source)
        argument_travel, argument_speed = list(self.travel), list(self.speed)
        argument_states = dict(self.effect_states)
        self._step()
        count = len(self.coordinates)
        rows = [
            *zip(argument_travel, self.travel, strict=True),
            *zip(argument_speed, self.speed, strict=True),
        ]
        by_row = dict(enumerate(rows))
        for row, k in enumerate(self.equations.states):
            by_row[2 * count + 1 + row] = (argument_states[k], self.effect_states[k])
        seeds = _seeds(trace, "adjoint_state", {row: result for row, (_, result) in by_row.items()})
        arrays = ("inputs", "parameters", "derived") if by_parameters else ("inputs",)
        loaded = {key: value for key, value in trace.loaded.items() if key[0] in arrays}
        with trace.section("derivatives"):
            found = trace.adjoints(seeds, [*(argument for argument, _ in by_row.values()), *loaded.values()])
            for row, (argument, _) in by_row.items():
                trace.write("adjoint_state", row, found.get(argument, trace.expression(0.0)))
            _add_to_rows(trace, loaded, found)
        trace.drop_unused_branches()

    @override
    def _voltages(self) -> list[Expression]:
        return [self.trace.load("inputs", j, f"u{j}") for j in range(len(self.source.machine.drives))]

    @override
    def _initial_speed(self, i: int, balance: ForceBalance) -> Expression:
        """Return the speed of coordinate i; a held one counts as zero: a small speed would stop at once."""
        speed = self.speed[i]
        if self.reverse.friction == "sliding":
            return speed
        held = (speed == 0.0) & (absolute(balance.forces[i]) < balance.coulomb[i])
        return where(held, 0.0, speed)  # type: ignore[no-any-return]

    @override
    def _stops(
        self, balance: ForceBalance, flows: Sequence[tuple[Expression, Expression, Expression]]
    ) -> list[tuple[Expression, Expression]]:
        """Trace a branch for each coordinate that stops; return speeds and travels."""
        if self.reverse.friction == "sliding":
            return [(next_speed, next_travel) for next_speed, _, next_travel in flows]
        ends = []
        for i, (next_speed, crossing, next_travel) in enumerate(flows):
            stops = crossing < 0.0

            def update(
                values: Sequence[Expression], i: int = i, stops: Expression = stops
            ) -> tuple[Expression, Expression]:
                # Machines that do not stop take values for which everything is finite.
                speed, traveled = self.reverse.operations(
                    "stop_or_reverse",
                    where(stops, self.speed[i], 1.0),
                    where(stops, balance.forces[i], 0.0),
                    where(stops, balance.coulomb[i], 1.0),
                    self._by_direction(i, "viscous", balance),
                    self._by_direction(i, "viscous", balance, reversed_motion=True),
                    self.equations.derived("coordinate", i, "mass"),
                    self.equations.derived("coordinate", i, "per_mass"),
                    self.h,
                )
                return where(stops, speed, values[0]), where(stops, self.travel[i] + traveled, values[1])

            speed, travel = self.trace.update_if_any(stops, [next_speed, next_travel], update)
            ends.append((speed, travel))
        return ends


def derivative_source(source: KernelSource, *, friction: str) -> str:
    """Write the source text of the derivatives of a kernel, which `compile_lanes` compiles.

    Args:
        friction: Derivative where static friction holds a coordinate: "exact", "smoothed" or "sliding", see
            `derivatives.Friction`.

    Returns:
        Text of the functions `DERIVATIVE_FUNCTIONS`. Each function adds its part to the arrays of derivatives
        with respect to parameters, step constants and voltages. The function of a step gets, in
        `adjoint_state`, the derivatives with respect to the state after the step, and overwrites them by
        those with respect to the state before it.
    """
    traces = [_StepBack(source, friction=friction, by_parameters=flag).reverse for flag in (True, False)]
    constants = ReverseTrace("prepare_back(parameters, adjoint_derived, adjoint_parameters, h: float)")
    source.trace_constants(constants)
    _add_derivatives(constants, "derived", ("parameters",))
    sensors = ReverseTrace(
        "read_sensors_back(state, parameters, adjoint_readings, adjoint_state, adjoint_parameters)"
    )
    source.trace_sensors(sensors)
    _add_derivatives(sensors, "readings", ("state", "parameters"))
    delays = ReverseTrace("voltage_delays_back(parameters, adjoint_delays, adjoint_parameters)")
    source.trace_delays(delays, "voltage_delays")
    _add_derivatives(delays, "delays", ("parameters",))
    return "\n\n".join(map(function_source, [*traces, constants, sensors, delays]))


def _add_derivatives(trace: ReverseTrace, results: str, arguments: Sequence[str]) -> None:
    """Append statements that add the derivatives of a weighted sum of the results to rows of arguments."""
    trace.line(f'"""Derivatives of {results}."""')
    loaded = {key: value for key, value in trace.loaded.items() if key[0] in arguments}
    stored = {row: value for (array, row), value in trace.stored.items() if array == results}
    seeds = _seeds(trace, f"adjoint_{results}", stored)
    _add_to_rows(trace, loaded, trace.adjoints(seeds, loaded.values()))


def _seeds(
    trace: ReverseTrace, array: str, results: Mapping[int, Expression]
) -> dict[Expression, Expression]:
    """Load the derivatives by the results of a function from their rows of an array, by result."""
    seeds: dict[Expression, Expression] = {}
    for row, result in results.items():
        seed = trace.let("seed", row, trace.read(array, row))
        seeds[result] = seeds[result] + seed if result in seeds else seed  # two rows may hold the same result
    return seeds


def _add_to_rows(
    trace: ReverseTrace,
    loaded: Mapping[tuple[str, int], Expression],
    derivatives: Mapping[Expression, Expression],
) -> None:
    """Append statements that add the derivatives by loaded rows to the rows of the arrays `adjoint_...`."""
    for (array, row), value in loaded.items():
        if value in derivatives:
            trace.add_to(f"adjoint_{array}", row, derivatives[value])
