"""Held-out runs, which no fit uses: choose them, and evaluate by how much effects reduce their error."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...machine import Machine
from ...preparation.dataset import Dataset, PreparedRecording, moving_runs
from ...recordings import Recording
from ..evidence.tried_effects import SelectedEffect
from ..fit.estimation import Fit, prediction_cost
from ..fit.force_sizes import force_error
from ..judge import held_out as judge
from ..judge.error import FitError
from ..judge.run import HeldOutRun, contradicts
from ..predict.prediction import POLISH_STEP, SEARCH_BANDWIDTH, SIMULATION, map_runs
from ..predict.start_uncertainty import prediction_residuals

Array = NDArray[np.float64]

_GROUP_SIZE = 4  # One of four runs is held out.
# Relative difference of spectra below which runs count as alike. Repetitions with other random numbers differ by 0.05
# to 0.2; steps, slow sines, multisines and chirps of the same amplitude differ from each other by 0.2 to 0.6.
_ALIKE = 0.2


def hold_out(recordings: Sequence[Recording], chosen: Sequence[str] = ()) -> tuple[str, ...]:
    """Choose the runs that are held out: excluded from the fit and used to evaluate it.

    By default, the runs are divided into groups of four with similar voltages (see `spectral_differences`), and one run
    of each group is held out. A group consists of the first run that belongs to no group yet and the three remaining
    runs that are most similar to it; the last group has up to seven runs. The run to hold out is chosen by three
    criteria, each of which decides between the runs that are equally good by those before it:

    1. The held-out runs are as similar as possible to runs that are fitted. A kind of motion that occurs only once is
       therefore fitted if possible.
    2. The run is no repetition of another held-out run.
    3. The run is close to the fourth, eighth, ... of all runs. If all runs are alike, every fourth one is held out.

    Runs in which nothing moves (`moving_runs`) are fitted, for the noise of the sensors, and never chosen: an error on
    them says nothing about the machine.

    Args:
        recordings: All runs (times, s; voltages, V; measurements, m or rad).
        chosen: Names of the runs to hold out. Default: one of each group of four; one if there are fewer than four.

    Returns:
        Names of the held-out runs.

    Raises:
        InputError: If a run is unknown, no run is left to fit, or nothing moves in any of the held-out runs although
            the machine moves in others.
    """
    names = [r.name for r in recordings]
    unknown = [c for c in chosen if c not in names]
    if unknown:
        raise InputError(f"--hold-out {unknown[0]}: no such run; the runs are {', '.join(names)}")
    moving = moving_runs(recordings)
    eligible = [r for r in recordings if r.name in moving] or recordings
    if len(eligible) == 1 < len(names):
        raise InputError(
            f"nothing moves except in run {eligible[0].name}; a run that moves must be fitted and another one held "
            "out, so record more runs or split this one: hframe import FILE --split-every SECONDS"
        )
    held_out = tuple(chosen) or tuple(
        eligible[i].name for i in _representative_runs(spectral_differences(eligible))
    )
    if not set(held_out) & {run.name for run in eligible}:
        raise InputError(
            f"--hold-out {', '.join(held_out)}: nothing moves in it, so its error says nothing about the machine; hold "
            f"out a run that moves, such as {eligible[-1].name}"
        )
    if len(set(held_out)) >= len(names):
        raise InputError(
            f"runs: {len(names)}, held out: {len(set(held_out))}; at least one must be left to fit, so split the "
            "recording into several runs or hold out fewer"
        )
    return held_out


def _representative_runs(differences: Array) -> list[int]:
    """Return the indices of the runs to hold out, sorted, given how much the runs differ, shape (runs, runs)."""
    remaining = list(range(len(differences)))
    held_out: list[int] = []

    def unsuitability(run: int) -> tuple[float, bool, int]:
        """Return three properties of a candidate, the most important one first; small values are better."""
        candidates = [*held_out, run]
        to_fitted = np.delete(differences[candidates], candidates, axis=1).min(axis=1, initial=np.inf).sum()
        repeated = bool((differences[run, held_out] == 0.0).any())
        fourth = _GROUP_SIZE * len(candidates) - 1  # index of the fourth, eighth, ... of all runs
        return float(to_fitted), repeated, abs(run - fourth)

    while remaining:
        group = sorted(
            remaining, key=lambda run: differences[remaining[0], run]
        )  # stable: equals in order of names
        if len(group) >= 2 * _GROUP_SIZE:
            group = group[:_GROUP_SIZE]
        held_out.append(min(group, key=unsuitability))
        remaining = [run for run in remaining if run not in group]
    return sorted(held_out)


def spectral_differences(recordings: Sequence[Recording]) -> Array:
    """Compare the kinds of motion of runs by the spectra of their voltages.

    The spectrum s of a run consists of the root mean square voltages in each octave of frequency: of each drive, and of
    the sum and the difference of each pair of drives, divided by sqrt(2). On a machine with belts, sum and difference
    move different axes. Adjacent octaves overlap, so that a small change of a frequency changes the spectrum little.

    Args:
        recordings: Runs with their voltages, V, of any durations and sampling rates.

    Returns:
        |s_i - s_j| / (|s_i| + |s_j|) for each pair of runs i and j, dimensionless, shape (runs, runs). It is 1 if the
        runs have no octave in common, and 1/3 if one run has twice the voltages of the other. Values below 0.2, such as
        those of repetitions of a run, are set to 0.
    """
    duration = max(float(r.time_s[-1] - r.time_s[0]) for r in recordings)
    spectra = [_octave_spectrum(r, duration) for r in recordings]
    octaves = max(len(s) for s in spectra)
    padded = np.array([np.pad(s, ((0, octaves - len(s)), (0, 0))).ravel() for s in spectra])
    size = np.linalg.norm(padded, axis=1)
    difference = np.array([np.linalg.norm(padded - other, axis=1) for other in padded])
    difference /= np.maximum(size[:, None] + size, np.finfo(float).tiny)  # both are 0 without any voltage
    return np.where(difference < _ALIKE, 0.0, difference)


def _octave_spectrum(recording: Recording, duration: float) -> Array:
    """Return rms voltages by octave of frequency, from 1 / duration (s) on, V, shape (octaves, signals)."""
    rows = len(recording.time_s)
    amplitudes = np.fft.rfft(recording.inputs, axis=0) / rows
    pairs = itertools.combinations(amplitudes.T, 2)
    signals = [*amplitudes.T, *(c / np.sqrt(2.0) for a, b in pairs for c in (a + b, a - b))]
    period = float(np.median(np.diff(recording.time_s)))
    octave = np.log2(np.maximum(np.fft.rfftfreq(rows, period) * duration, 1.0))
    lower = octave.astype(int)
    fraction = octave - lower  # of the power that belongs to the next octave
    powers = [
        np.bincount(lower, power * (1.0 - fraction), lower[-1] + 2)
        + np.bincount(lower + 1, power * fraction, lower[-1] + 2)
        for power in (np.abs(signal) ** 2 for signal in signals)
    ]
    return np.sqrt(np.column_stack(powers))


def held_out_gain(selected: SelectedEffect, machine: Machine, validation: Dataset, bandwidth: float) -> float:
    """Return the fraction of the squared error of the held-out runs that one of several effects removes.

    The machine with all effects is compared with a copy without this effect, whose other parameters are equal. If the
    effect added coordinates, it is compared with the machine that was fitted before the effect was added.

    An observer hides slow errors, and with them what a small constant force explains. If it shows no gain, the error of
    a simulation decides, provided that the effect removes more than half of that.

    Args:
        selected: Effect (deviation from the nominal model) that the search selected.
        machine: Machine with all effects.
        validation: Held-out runs (times, voltages, measurements), which were not fitted.
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a simulation.

    Returns:
        Fraction, dimensionless, at most 1; negative if the effect increases the error, as `error_reduction` defines it.
    """
    without = _machine_without(selected, machine)
    gain = error_reduction(without, machine, validation, bandwidth)
    simulated = None
    if bandwidth != SIMULATION:
        simulated = partial(error_reduction, without, machine, validation, SIMULATION)
    return judge.gain_of_effect(gain, simulated)


def _machine_without(selected: SelectedEffect, machine: Machine) -> Machine:
    """Return a machine without one of its effects; for an effect that added coordinates, the machine before it."""
    if selected.effect.definition.structure:  # the effect added coordinates
        return selected.machine_without
    return machine.replace(effects=tuple(e for e in machine.effects if e.label != selected.effect.label))


def error_reduction(without: Machine, machine: Machine, validation: Dataset, bandwidth: float) -> float:
    """Return by which fraction a machine reduces the squared error of another: 1 - error^2 / error_without^2.

    The error is the root mean square prediction error in units of the sensors' noise. With the widest observer
    (60 rad/s), for machines without belts and with a drive and a sensor for each coordinate, it is the error of the
    drives' force instead: force by the voltages minus force that the measured motion requires
    (`force_sizes.force_error`). Effects on sensors do not change this force. If the machines differ in such effects,
    the prediction errors are therefore compared.

    Args:
        without: Machine to compare with, for example without an effect (deviation from the nominal model).
        machine: Machine to evaluate.
        validation: Runs to predict (times, voltages, measurements, SI).
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a simulation.

    Returns:
        Fraction, dimensionless, at most 1; negative if the error is larger, not finite if a machine diverges.
    """
    on_sensors = [
        {e.label for e in m.effects if e.definition.measurement or e.definition.measurement_delay}
        for m in (without, machine)
    ]
    comparable = bandwidth == SEARCH_BANDWIDTH and on_sensors[0] == on_sensors[1]
    forces = [force_error(m, validation) if comparable else None for m in (without, machine)]
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
        True if the ratio of the squared simulation errors, with effects / without effects, has a geometric mean over
        the runs above 1. In this mean, a single run with a large error of another cause counts little. A run on which
        both simulations diverge does not count.
    """
    changes = []
    for run in validation.single_runs():
        costs = [prediction_cost(m, run, SIMULATION, longest_step=POLISH_STEP) for m in (without, machine)]
        changes.append(np.log(costs[1]) - np.log(costs[0]) if np.isfinite(costs).any() else 0.0)
    return judge.worsens_simulation(changes)


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
            prediction_residuals(m, run, validation, bandwidth, longest_step=POLISH_STEP)
            for m in (machine, without)
        ]
        return float(np.sum((errors[1] - errors[0]) ** 2)), float(np.sum(errors[0] ** 2))

    change, error = np.sum(list(map_runs(of_run, validation)), axis=0)
    return judge.is_excited(float(change), float(error))


def contradicting_held_out_runs(
    after: Fit, before: Machine, selected: Sequence[SelectedEffect], validation: Dataset
) -> tuple[str, ...]:
    """Find the held-out runs that a fitted machine explains far worse than the runs that it was fitted to.

    Either something was wrong with such a run (a loose connector, a slipped belt, another amplifier setting), or it
    excites an effect that the fitted runs do not excite. A run whose error the effects cause refutes these instead.

    Args:
        after: Fit of the machine with the selected effects.
        before: Refitted machine without effects.
        selected: The selected effects.
        validation: Held-out runs.

    Returns:
        Names of the runs that contradict (`judge.run.contradicts`), at the observer bandwidth of the fit.
    """

    def shown_by(run: Dataset) -> HeldOutRun:
        cost = prediction_cost(after.machine, run, after.bandwidth, longest_step=POLISH_STEP)

        def gains() -> tuple[float, ...]:
            together = error_reduction(before, after.machine, run, after.bandwidth)
            return (together, *(held_out_gain(s, after.machine, run, after.bandwidth) for s in selected))

        return HeldOutRun(FitError(cost, run.count), after.chi2, gains if selected else None)

    return tuple(run.runs[0].name for run in validation.single_runs() if contradicts(shown_by(run)))
