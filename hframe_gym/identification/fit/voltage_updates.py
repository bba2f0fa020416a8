"""Find out whether the voltages change between the rows of a log, from the motion.

A controller that is faster than the log changes the voltages several times from one row to the next. The log does not
say so, but the motion does: voltages that are held from row to row act late, by up to half a sampling period. A machine
is therefore fitted with held voltages, then with voltages that are interpolated and change twice a row, three times and
so on, while the error falls. If that reduces the error clearly, instruments count the changes (`slow_logs`).
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from ...machine import Machine
from ...preparation.dataset import Dataset
from ..judge.criteria import SelectionCriteria
from ..judge.run import UpdatesEvidence, voltages_change_between_rows
from ..predict.prediction import SEARCH_BANDWIDTH
from ..predict.voltage_errors import expected_excess
from .estimation import Fit, prediction_costs
from .model_error import continue_fit
from .slow_logs import count_updates

_MOST_UPDATES = 20  # a row; with more, voltages act earlier by less than a fortieth of a sampling period


class VoltageUpdates(NamedTuple):
    """How often the voltages change from one row to the next.

    Attributes:
        per_row: Number of changes; 1 if the voltages are held.
        held: Chi-squared per sample of the machine that is fitted with held voltages, dimensionless.
        fitted: Chi-squared per sample of the machine that is fitted with that many changes, dimensionless.
    """

    per_row: int
    held: float
    fitted: float

    def describe(self, period: float) -> str:
        """Describe voltages that change between rows, for the user: a sentence without a point.

        Args:
            period: Sampling period of the log, s.
        """
        return (
            f"the voltages change between the rows, about {self.per_row} times from one row to the next (every "
            f"{1e3 * period / self.per_row:.2g} ms; chi-squared per sample {self.fitted:.3g} instead of "
            f"{self.held:.3g} with held voltages)"
        )


class VoltagesChangeError(Exception):
    """A search found that the voltages change between the rows; its runs held them.

    Attributes:
        machine: Machine with the effects that were found before.
        updates: How often the voltages change.
    """

    def __init__(self, machine: Machine, updates: VoltageUpdates) -> None:
        super().__init__("the voltages change between the rows")
        self.machine, self.updates = machine, updates


def require_held_voltages(fitted: Fit, data: Dataset, criteria: SelectionCriteria) -> None:
    """Check that the voltages are held, if the runs are predicted so; an effect that was missing had a larger error.

    Args:
        fitted: Fit of a machine with effects to the runs.
        data: Runs (times, voltages, measurements, SI).
        criteria: Decision thresholds.

    Raises:
        VoltagesChangeError: If the voltages change between the rows.
    """
    if data.updates > 1:
        return
    updates = voltage_updates(fitted, data, criteria)
    if updates.per_row > 1:
        raise VoltagesChangeError(fitted.machine, updates)


def voltage_updates(fitted: Fit, data: Dataset, criteria: SelectionCriteria) -> VoltageUpdates:
    """Find how often the voltages change from one row to the next.

    Args:
        fitted: Fit of a machine to the runs as they are.
        data: Runs (times, voltages, measurements, SI).
        criteria: Decision thresholds.

    Returns:
        The number of changes, and what it leaves of the error beside what held voltages leave.
    """
    data = data.with_updates(1)
    held = continue_fit(fitted, data, SEARCH_BANDWIDTH)
    per_row, best = _least_error(held, data)
    if per_row > 1:
        before, after = (
            prediction_costs(f.machine, d, SEARCH_BANDWIDTH)
            for f, d in ((held, data), (best, data.with_updates(per_row)))
        )
        excess = expected_excess(best.machine, data.with_updates(per_row), SEARCH_BANDWIDTH)
        error = dataclasses.replace(best.error, floor=best.floor + excess)
        evidence = UpdatesEvidence(held.error, error, float(np.mean(after < before)))
        if voltages_change_between_rows(evidence, criteria):
            per_row = count_updates(best, data, _MOST_UPDATES) or per_row
            fitted = continue_fit(best, data.with_updates(per_row), SEARCH_BANDWIDTH)
            return VoltageUpdates(per_row, held.chi2, fitted.chi2)
    return VoltageUpdates(1, held.chi2, held.chi2)


def _least_error(held: Fit, data: Dataset) -> tuple[int, Fit]:
    """Return the number of changes with the least error, and its fit; a fit with held voltages is given."""
    best, per_row = held, 1
    for trial in range(2, _MOST_UPDATES + 1):
        refitted = continue_fit(best, data.with_updates(trial), held.bandwidth)
        if not refitted.cost < best.cost:
            break
        best, per_row = refitted, trial
    return per_row, best
