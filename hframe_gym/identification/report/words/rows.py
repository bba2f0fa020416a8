"""Effects and parameters of a result as the page lists them, with digits, units and remarks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....effects.smooth_table import TABLE_FAMILY
from ....machine import Machine, written_unit
from ....web_page import number
from ..content.document import Report
from ..diagnostics.inseparable_parameters import sum_text
from ..diagnostics.parameter_diagnostics import parameter_doubts, with_structure_of
from ..units import percent


@dataclass(frozen=True)
class ParameterRow:
    """A fitted parameter: value, standard deviation and unit as text, "" if there is none.

    Attributes:
        declared: Declared value.
        doubt: Reasons to doubt the value.
    """

    name: str
    value: str
    std: str
    unit: str
    declared: str = ""
    doubt: str = ""


@dataclass(frozen=True)
class EffectRow:
    """An effect that was found.

    Attributes:
        name: Name in words.
        table: Whether it is a table, which is drawn.
        parameters: Parameters; empty for a table.
        size: Sentence about the effect's force; "" if unknown.
        gain: Sentence about the change of the held-out runs' error by the effect.
        rivals: Effects that these runs do not distinguish from it.
        equivalent: Effects that no recording can distinguish from it.
    """

    name: str
    site: str
    formula: str
    table: bool
    parameters: Sequence[ParameterRow]
    size: str
    gain: str
    rivals: Sequence[str]
    equivalent: Sequence[str]


@dataclass(frozen=True)
class CorrelationRow:
    """A fitted parameter with its correlations with those before it, dimensionless."""

    name: str
    values: Sequence[float]


@dataclass(frozen=True)
class InseparableRow:
    """Parameters that the data do not separate, with what the data determine of them."""

    names: str
    sums: str


def effect_rows(report: Report, machine: Machine) -> list[EffectRow]:
    """Return the selected effects as the page lists them, the one with the largest held-out gain first.

    Each has its formula, its parameters with digits and units (none for a table), sentences on its force and
    its gain, and its rivals.

    Args:
        report: Content of report.json.
        machine: Identified machine with these effects.
    """
    definitions = {e.label: e.definition for e in machine.effects}
    rows = []
    for e in sorted(report.effects, key=lambda e: -e.held_out_gain):
        definition = definitions[f"{e.name}@{e.site}"]
        table = definition.family == TABLE_FAMILY
        equivalent = [r for r in e.rivals if definition.is_equivalent(machine, e.site, r)]
        parameters = [
            ParameterRow(
                name=key,
                value=f"{p.value:.5g}"
                if p.at_least is None
                else f"{p.value:.2g} (at least {p.at_least:.2g})",
                std="" if p.std is None or p.at_least is not None else f"± {p.std:.2g}",
                unit=written_unit(p.unit),
            )
            for key, p in e.parameters.items()
        ]
        rows.append(
            EffectRow(
                name=e.name.replace("_", " "),
                site=e.site,
                formula=definition.formula,
                table=table,
                parameters=[] if table else parameters,
                size=""
                if e.size is None
                else f"Its force is {number(100 * e.size)} % of the drives' force (rms).",
                gain=_gain_sentence(e.held_out_gain),
                rivals=[r for r in e.rivals if r not in equivalent],
                equivalent=equivalent,
            )
        )
    return rows


def _gain_sentence(gain: float) -> str:
    """Say how an effect changes the squared error of the held-out runs; a negative gain increases it."""
    if gain < 0.0:
        return f"It increases the squared error of the held-out runs by {-100 * gain:.3g} %."
    return f"It removes {percent(gain)} % of the squared error of the held-out runs."


def parameter_rows(machine: Machine, declared: Machine) -> list[ParameterRow]:
    """Return every identified parameter except a table's as the page lists it.

    Each has its value, standard deviation, unit, declared value ("" if its effect is not declared) and the
    reasons to doubt it ("" without any, `parameter_doubts`).

    Args:
        machine: Identified machine. Without an uncertainty, there are no rows.
        declared: Machine as declared.
    """
    if machine.uncertainty is None:
        return []
    doubts = parameter_doubts(machine, declared)
    added = {effect.label for effect in machine.effects} - {effect.label for effect in declared.effects}
    before = {
        name: value
        for name, value in with_structure_of(machine, declared).parameters.items()
        if name.rpartition(".")[0] not in added
    }
    return [
        ParameterRow(
            name=name,
            value=f"{machine.parameters[name]:.5g}",
            std=f"{machine.uncertainty.std(name):.2g}",
            unit=written_unit(machine.unit(name)),
            declared=f"{before[name]:.5g}" if name in before else "",
            doubt="; ".join(doubts[name]),
        )
        for name in machine.uncertainty.names
        if not name.startswith(_tables(machine))
    ]


def correlation_rows(machine: Machine) -> list[CorrelationRow]:
    """Return the correlation coefficients of each identified parameter with the parameters before it.

    Parameters of tables are left out. There are no rows if the machine has no uncertainty.
    """
    if machine.uncertainty is None:
        return []
    names = machine.uncertainty.names
    kept = [k for k, name in enumerate(names) if not name.startswith(_tables(machine))]
    matrix = machine.uncertainty.correlation[np.ix_(kept, kept)]
    return [
        CorrelationRow(names[k], [float(r) for r in row[:i]])
        for i, (k, row) in enumerate(zip(kept, matrix, strict=True))
    ]


def _tables(machine: Machine) -> tuple[str, ...]:
    """Return how the names of the parameters of a machine's tables begin."""
    return tuple(f"{e.label}." for e in machine.effects if e.definition.family == TABLE_FAMILY)


def inseparable_rows(report: Report, machine: Machine) -> list[InseparableRow]:
    """Return the sets of parameters that the data do not separate, with the sums that they determine.

    A set without such a sum has the text "no combination".

    Args:
        report: Content of report.json.
        machine: Identified machine, for the units.
    """
    rows = []
    for group in report.not_separable:
        sums = [
            f"{sum_text(entry.weights)} = {entry.value:.5g} ± {entry.std:.2g} "
            f"{written_unit(machine.unit(next(iter(entry.weights))))}".rstrip()
            for entry in group.determined
        ]
        rows.append(InseparableRow(", ".join(group.parameters), "; ".join(sums) or "no combination"))
    return rows
