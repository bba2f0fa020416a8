"""Check whether the voltages act before they are logged.

A recording holds in each row the voltage that acts from its time to the time of the next row. Many loggers write the
voltage that has acted until then, so that every voltage is one row late. A delay of the response has physical causes,
which identification can find; a response before its cause has none, unless too long a delay is declared.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ..identification import Dataset, PreparedRecording, default_free_parameters, fit
from ..identification.prediction import SEARCH_BANDWIDTH
from ..machine import Machine
from .findings import Finding

_RUNS = 3  # those with the largest changes of the voltages suffice
_MAX_ROWS = 20_000  # of a run; fits of longer ones take too long for a check
_ITERATIONS = 10  # of a fit that need not converge fully
_CERTAIN = 0.7  # fraction of chi-squared below which the earlier voltages certainly explain the motion better


def check_input_timing(data: Dataset, machine: Machine) -> list[Finding]:
    """Check whether voltages that act one row earlier explain the motion clearly better.

    The machine's parameters are fitted twice, with the voltages as logged and with those of the next row.

    Args:
        data: Runs in which the machine moves (times, s; voltages, V; measurements, m or rad), without other faults.
        machine: Declared machine.

    Returns:
        A fault about all runs together if the second fit has less than 70 % of the chi-squared (mean squared error over
        noise variance) of the first, else nothing. Nothing also if all runs have more than 20,000 rows, or if the
        machine is declared with a delay or lag, which may be too long.
    """
    largest = sorted((run for run in data.runs if len(run.time_s) <= _MAX_ROWS), key=_input_changes)[-_RUNS:]
    if not largest or any(e.definition.delay or e.definition.next_state for e in machine.effects):
        return []
    runs = data.with_runs([run.name for run in largest])
    earlier = dataclasses.replace(runs, runs=tuple(map(_with_earlier_inputs, runs.runs)))
    free = default_free_parameters(machine)
    logged = fit(machine, free, runs, SEARCH_BANDWIDTH, iterations=_ITERATIONS)
    shifted = fit(machine, free, earlier, SEARCH_BANDWIDTH, theta=logged.theta, iterations=_ITERATIONS)
    if not shifted.cost < _CERTAIN * logged.cost < np.inf:
        return []
    channels = " and ".join(machine.input_channels)
    verb = "are" if len(machine.drives) > 1 else "is"
    message = (
        f"{channels} {verb} logged one row late: the motion follows the voltage of the next row (chi-squared per "
        f"sample {shifted.chi2:.3g} instead of {logged.chi2:.3g}). Move the voltages up by one row"
    )
    return [Finding("fault", "", "", message)]


def _input_changes(run: PreparedRecording) -> float:
    """Return the sum of squared changes of the voltages from row to row, V^2."""
    return float(np.sum(np.diff(run.inputs, axis=0) ** 2))


def _with_earlier_inputs(run: PreparedRecording) -> PreparedRecording:
    """Return a run in which each voltage acts one row earlier."""
    return dataclasses.replace(run, inputs=np.vstack([run.inputs[1:], run.inputs[-1:]]))
