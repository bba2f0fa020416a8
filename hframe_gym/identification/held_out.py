"""Held-out runs, which no fit uses: choose them, and evaluate by how much effects reduce their error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import InputError
from ..machine import Machine
from ..recordings import Recording
from .dataset import Dataset, PreparedRecording
from .estimation import Fit, prediction_cost
from .force_sizes import force_error
from .forward_selection import SelectedEffect
from .model_error import CONTRADICTION
from .prediction import POLISH_STEP, SEARCH_BANDWIDTH, SIMULATION, map_runs
from .start_uncertainty import prediction_residuals

_HOLD_OUT_EVERY = 4  # Every fourth run is held out.
_MIN_EXCITATION = 0.05  # change of the predictions relative to their errors, root mean square


def hold_out(recordings: Sequence[Recording], chosen: Sequence[str] = ()) -> tuple[str, ...]:
    """Choose the runs that are held out: excluded from the fit and used to evaluate it.

    Args:
        recordings: All runs (times, s; voltages, V; measurements, m or rad).
        chosen: Names of the runs to hold out. Default: every fourth, the last one if there are fewer than four.

    Returns:
        Names of the held-out runs.

    Raises:
        InputError: If a run is unknown or no run is left to fit.
    """
    names = [r.name for r in recordings]
    unknown = [c for c in chosen if c not in names]
    if unknown:
        raise InputError(f"--hold-out {unknown[0]}: no such run; the runs are {', '.join(names)}")
    held_out = tuple(chosen) or tuple(names[_HOLD_OUT_EVERY - 1 :: _HOLD_OUT_EVERY]) or tuple(names[-1:])
    if len(set(held_out)) >= len(names):
        raise InputError(
            f"runs: {len(names)}, held out: {len(set(held_out))}; at least one must be left to fit, so split the "
            "recording into several runs or hold out fewer"
        )
    return held_out


def held_out_gain(selected: SelectedEffect, machine: Machine, validation: Dataset, bandwidth: float) -> float:
    """Return the fraction of the squared error of the held-out runs that one of several effects removes.

    The machine with all effects is compared with a copy without this effect, whose other parameters are equal. If the
    effect added coordinates, it is compared with the machine that was fitted before the effect was added.

    Args:
        selected: Effect (deviation from the nominal model) that the search selected.
        machine: Machine with all effects.
        validation: Held-out runs (times, voltages, measurements), which were not fitted.
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a simulation.

    Returns:
        Fraction, dimensionless, at most 1; negative if the effect increases the error, as `error_reduction` defines it.
    """
    return error_reduction(_machine_without(selected, machine), machine, validation, bandwidth)


def _machine_without(selected: SelectedEffect, machine: Machine) -> Machine:
    """Return a machine without one of its effects; for an effect that added coordinates, the machine before it."""
    if selected.effect.definition.structure:  # the effect added coordinates
        return selected.machine_without
    return machine.replace(effects=tuple(e for e in machine.effects if e.label != selected.effect.label))


def error_reduction(without: Machine, machine: Machine, validation: Dataset, bandwidth: float) -> float:
    """Return by which fraction the squared error of a machine is smaller than another machine's.

    The error is the prediction error in units of the sensors' noise. With the widest observer (60 rad/s), for machines
    without belts and with a drive and a sensor for each coordinate, it is the error of the drives' force instead:
    force by the voltages minus force that the measured motion requires (`force_sizes.force_error`).

    Args:
        without: Machine to compare with, for example without an effect (deviation from the nominal model).
        machine: Machine to evaluate.
        validation: Runs to predict (times, voltages, measurements, SI).
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a simulation.

    Returns:
        Fraction, dimensionless, at most 1; negative if the error is larger, not finite if a machine diverges.
    """
    forces = [force_error(m, validation) if bandwidth == SEARCH_BANDWIDTH else None for m in (without, machine)]
    if forces[0] is not None and forces[1] is not None:
        return 1.0 - (forces[1] / forces[0]) ** 2
    costs = [prediction_cost(m, validation, bandwidth, longest_step=POLISH_STEP) for m in (without, machine)]
    return 1.0 - costs[1] / costs[0]


def worsens_simulation(without: Machine, machine: Machine, validation: Dataset) -> bool:
    """Check whether a machine with effects simulates the held-out runs worse than the refitted machine without them.

    An observer hides slow errors, so that wrong effects may reduce the error of predictions and add up in a simulation.

    Args:
        without: Refitted machine without the effects (deviations from the nominal model).
        machine: Machine with all effects.
        validation: Held-out runs (times, voltages, measurements, SI).

    Returns:
        True if the squared errors of the simulations are larger with the effects in the geometric mean over the runs,
        in which one run with a large error of another cause does not decide. False if both diverge.
    """
    changes = []
    for run in validation.single_runs():
        costs = [prediction_cost(m, run, SIMULATION, longest_step=POLISH_STEP) for m in (without, machine)]
        changes.append(np.log(costs[1]) - np.log(costs[0]) if np.isfinite(costs).any() else 0.0)
    return bool(np.sum(changes) > 0.0)


def is_excited(selected: SelectedEffect, machine: Machine, validation: Dataset, bandwidth: float) -> bool:
    """Check whether an effect (deviation from the nominal model) changes the predictions of the held-out runs at all.

    Examples of effects that do not: a current limit that the held-out voltages never reach, or a constant force on a
    carriage that friction holds.

    Args:
        selected: Effect that the search selected.
        machine: Machine with all effects.
        validation: Held-out runs (times, voltages, measurements, SI).
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a simulation.

    Returns:
        True if the root mean square change of the predictions is at least 1/20 of the root mean square error, or if a
        prediction diverges.
    """
    without = _machine_without(selected, machine)

    def of_run(run: PreparedRecording) -> tuple[float, float]:
        errors = [
            prediction_residuals(m, run, validation, bandwidth, longest_step=POLISH_STEP) for m in (machine, without)
        ]
        return float(np.sum((errors[1] - errors[0]) ** 2)), float(np.sum(errors[0] ** 2))

    change, error = np.sum(list(map_runs(of_run, validation)), axis=0)
    return not change < _MIN_EXCITATION**2 * error  # not finite if the machine diverges without the effect


def contradicting_held_out_runs(fitted: Fit, validation: Dataset) -> tuple[str, ...]:
    """Find the held-out runs that a fitted machine explains far worse than the runs that it was fitted to.

    Either something was wrong with such a run (a loose connector, a slipped belt, another amplifier setting), or it
    excites an effect that the fitted runs do not excite.

    Args:
        fitted: Fit of the machine.
        validation: Held-out runs.

    Returns:
        Names of the runs whose chi-squared per sample (mean squared residual in units of the noise), at the observer
        bandwidth of the fit, exceeds ten times the larger of 1 and that of the fitted runs.
    """
    limit = CONTRADICTION * max(1.0, fitted.chi2)
    return tuple(
        run.runs[0].name
        for run in validation.single_runs()
        if prediction_cost(fitted.machine, run, fitted.bandwidth, longest_step=POLISH_STEP) > limit * run.count
    )
