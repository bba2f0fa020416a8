"""Formulas traced from the equations of motion, and their signals' and parameters' names in source text.

The equations are evaluated once with traced expressions (`dynamics.symbolic.tracing`), as for the simulation
kernel. So there is one source of the equations. Names are made of fixed words, sanitized names of parameters,
and numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from typing_extensions import override

from ...dynamics.symbolic.tracing import Expression, Trace
from ...machine import Machine
from ..base import plain


class FormulaTrace(Trace):
    """Trace of a formula without branches; what a kernel would skip is always evaluated."""

    @override
    def update_if_any(
        self, condition: Any, values: Sequence[Any], update: Callable[[Sequence[Any]], Sequence[Any]]
    ) -> list[Any]:
        """Return the updated values; the update changes nothing where the condition is false."""
        return list(update(values))


@dataclass(frozen=True)
class Parameter:
    """A parameter of the machine in exported source text.

    Attributes:
        identifier: Its name in the source text.
        value: Its value, SI.
        comment: Full name and unit.
    """

    identifier: str
    value: float
    comment: str


@dataclass(frozen=True)
class Signal:
    """An input or output of a formula.

    Attributes:
        name: Name in the source text.
        size: Number of its entries; 0 for a number instead of an array.
        comment: Meaning and unit.
    """

    name: str
    size: int
    comment: str

    def elements(self) -> list[str]:
        """Return each entry as source text, "velocity[0]" of an array, which counts from 0 in C and in ST."""
        return [f"{self.name}[{i}]" for i in range(self.size)] if self.size else [self.name]


@dataclass(frozen=True)
class Formula:
    """A function from signals to signals, traced.

    Attributes:
        name: Name, after the prefix of the export.
        comment: What it computes.
        inputs: Arguments, in the order of the function.
        outputs: Results; a state is an input and an output of the same name.
        function: Function (values, *arguments) of the parameter values by full name, None for those of the
            machine, and of one value (or list of values) per input, which returns all entries of the outputs.
        results: One expression for each entry of the outputs, in order.
    """

    name: str
    comment: str
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    function: Callable[..., Sequence[Any]]
    results: list[Expression]

    @property
    def states(self) -> tuple[Signal, ...]:
        """Signals that are both input and output, such as an integral."""
        return tuple(signal for signal in self.outputs if signal in self.inputs)


def trace_formula(
    name: str,
    comment: str,
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    function: Callable[..., Sequence[Any]],
    parameters: Mapping[str, Parameter],
) -> Formula:
    """Trace a function of the equations of motion as a formula, from which source text can be written.

    Args:
        name: Name, after the prefix of the export.
        comment: What it computes.
        inputs: Arguments of the written function, in order.
        outputs: Its results; one that is also an input, such as an integral, is a state.
        function: Function (values, *arguments) of the parameter values by full name, and of one value or list
            of values per input, which returns all entries of the outputs.
        parameters: Parameters of the machine by full name, see `parameters_of`.
    """
    trace = FormulaTrace(name)
    values = {full: trace.argument(p.identifier) for full, p in parameters.items()}
    arguments: list[Any] = []
    for signal in inputs:
        elements = [trace.argument(text) for text in signal.elements()]
        arguments.append(elements if signal.size else elements[0])
    results = [trace.expression(value) for value in function(values, *arguments)]
    return Formula(name, comment, tuple(inputs), tuple(outputs), function, results)


def parameters_of(machine: Machine) -> dict[str, Parameter]:
    """Return identifier in source text, value (SI) and comment of the parameters of a machine.

    Returns:
        By full name, such as "x.mass"; all identifiers are different.
    """
    found: dict[str, Parameter] = {}
    taken: set[str] = set()
    for full, value in machine.parameters.items():
        stem = identifier = "p_" + re.sub(r"\W+", "_", full, flags=re.ASCII).strip("_").lower()
        number = 1
        while identifier in taken:  # Structured Text does not distinguish upper from lower case
            number += 1
            identifier = f"{stem}_{number}"
        taken.add(identifier)
        found[full] = Parameter(identifier, float(value), plain(f"{full}, {machine.unit(full)}"))
    return found
