"""Rank the variables on which the force that a machine lacks depends, as a hint to its cause for the report."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from ..machine.motion import rigid_motions
from .dataset import Dataset
from .free_parameters import typical_force
from .residual import Dependence, comparable_forces, dependence_variables, white_sensors

Array = NDArray[np.float64]
_DEPENDENCE_BINS = 16  # Bins of a variable on which the missing force may depend.
_MINIMUM_DEPENDENCE = 0.05  # Fraction of the variance.
_SIGNIFICANT = 1.5  # Variance of a force that is larger than noise, in units of the variance that noise causes.
_ROUNDING_FORCE = 1e-9  # Of the typical force; a smaller missing force is a rounding error, as on an axis at rest.


def rank_dependences(machine: Machine, data: Dataset) -> list[Dependence]:
    """Rank the variables on which the force that the model lacks depends, as a hint to its cause.

    For each coordinate and each variable (position, velocity, voltage, time), the mean of the force
    (`comparable_forces`) over bins of the variable is computed. What the noise of the sensors causes is subtracted from
    the variance of the force and from that of the bin means.

    Args:
        machine: Machine that predicts.
        data: Measured runs (times, voltages, measurements, SI).

    Returns:
        Pairs of coordinate and variable whose bin means explain more than 5 % of the variance beyond noise, with this
        fraction, sorted by the explained variance, largest first. A coordinate has none if the force on it is not
        significantly larger than what noise causes, if its sensors show only white noise in a simulation, or if it
        never moves.
    """
    force, noise = comparable_forces(machine, data)
    by_run = [dependence_variables(machine, run, data) for run in data.runs]
    variables = {name: np.concatenate([variables[name] for variables in by_run]) for name in by_run[0]}
    total, by_noise = np.var(force, axis=0), np.var(noise, axis=0)
    least = np.maximum(_SIGNIFICANT * by_noise, (_ROUNDING_FORCE * typical_force(machine)) ** 2)
    ranked: list[tuple[float, Dependence]] = []
    for i in np.flatnonzero((total > least) & _deviating(machine, data)):
        for name, values in variables.items():
            explained = total[i] * _correlation_ratio(force[:, i], values)
            explained -= by_noise[i] * _correlation_ratio(noise[:, i], values)
            fraction = min(float(explained / (total[i] - by_noise[i])), 1.0)
            if fraction > _MINIMUM_DEPENDENCE:
                ranked.append((explained, Dependence(name, machine.coordinate_names[i], fraction)))
    return [dependence for _, dependence in sorted(ranked, key=lambda entry: -entry[0])]


def _deviating(machine: Machine, data: Dataset) -> NDArray[np.bool_]:
    """Mark the coordinates whose sensors show more than white noise in a simulation, shape (coordinates,).

    For a coordinate without a sensor, the sensors of the coordinates that move with it count.
    """
    names = machine.coordinate_names
    measured = np.array([[sensor.coordinate == name for sensor in machine.sensors] for name in names])
    related = measured.copy()
    for motion in rigid_motions(machine).values():
        related |= np.outer(motion != 0.0, measured[motion != 0.0].any(axis=0))
    related[measured.any(axis=1)] = measured[measured.any(axis=1)]
    return np.asarray((related & ~white_sensors(machine, data)).any(axis=1))


def _correlation_ratio(values: Array, variable: Array) -> float:
    """Return the fraction of the variance of values (n,) that bins of a variable explain (Fisher 1925).

    The bins have about the same number of samples; equal values of the variable are in one bin.
    """
    total = float(np.var(values))
    if total == 0.0 or np.ptp(variable) == 0.0:
        return 0.0
    ranks = np.searchsorted(np.sort(variable), variable)
    bins = ranks * _DEPENDENCE_BINS // len(variable)
    counts = np.maximum(np.bincount(bins, minlength=_DEPENDENCE_BINS), 1)
    means = np.bincount(bins, values, _DEPENDENCE_BINS) / counts
    return float(np.var(means[bins]) / total)
