"""Divide the runs of a session into those that are fitted and those that are held out, which no fit uses."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...errors import InputError, name_runs, suggestion
from ...machine import Machine
from ...recordings import Recording, peak_to_peak
from ..dataset import MIN_ROWS
from ..sensors.noise import difference_noise
from .accelerations import acceleration_fractions

_GROUP_SIZE = 4  # One of four runs is held out.
# Relative difference of spectra below which runs count as alike. Repetitions with other random numbers differ
# by 0.05 to 0.2; steps, slow sines, multisines and chirps of the same amplitude differ from each other by 0.2
# to 0.6.
_ALIKE = 0.2
_NORMAL_SPAN = 4.65  # standard deviations of noise between its 1st and 99th percentile
_MOVES = 0.01  # fraction of a sensor's largest span in all runs; with less, the error of a run says nothing
_COVERED = 0.5  # fraction of a run's rows in its parts; with more, the parts are used and not the run
_NO_NOISE = 0.5  # fraction of a span that noise does not explain
_MOST = 0.5  # fraction of all squared acceleration; with more, a run tells more of inertia than all others


def divide_runs(
    recordings: Sequence[Recording], chosen: Sequence[str] = (), machine: Machine | None = None
) -> tuple[str, ...]:
    """Check that the runs of a session can be fitted, and choose those that are held out.

    Args:
        machine: Machine that was recorded, whose sensors show accelerations. Default: these are not compared.
        chosen: Names of the runs to hold out. Default: one of each group of four similar runs, see
            `hold_out`.

    Returns:
        Names of the held-out runs.

    Raises:
        InputError: If a run has fewer than 20 rows, the runs cannot be divided, or no sensor moves in the
            fitted ones.
    """
    _require_rows(recordings)
    held_out = hold_out(recordings, chosen, machine)
    _require_motion([recording for recording in recordings if recording.name not in held_out])
    return held_out


def short_runs(recordings: Sequence[Recording]) -> dict[str, str]:
    """Find runs that are too short for the filters, such as pieces of a log with gaps.

    If all runs are too short, the result is empty, because none can be left out.

    Returns:
        Reason, as the predicate of a sentence, by name of the run.
    """
    short = {
        recording.name: f"has {len(recording.time_s)} rows, identification needs at least {MIN_ROWS}"
        for recording in recordings
        if len(recording.time_s) < MIN_ROWS
    }
    return short if len(short) < len(recordings) else {}


def copied_runs(recordings: Sequence[Recording], kept: Sequence[str] = ()) -> dict[str, str]:
    """Find runs whose times, commands and measurements are a copy of another run or of a part of it.

    A copy of a held-out run among the fitted ones makes the held-out error meaningless. The usual cause is a
    log that was imported as one run and again in parts; the parts are used then. No machine repeats a motion
    to the last digit, unless nothing moves.

    Args:
        recordings: All runs, in the order in which the first one of equal runs is kept.
        kept: Names of runs to keep in preference to their copies, for example the held-out ones.

    Returns:
        Reason, as the predicate of a sentence, by name of the copy.
    """
    first_of: dict[bytes, str] = {}
    reasons: dict[str, str] = {}
    moving = [recording for recording in recordings if peak_to_peak(recording.outputs).any()]
    for recording in sorted(moving, key=lambda recording: recording.name not in kept):
        content = recording.inputs.tobytes() + recording.outputs.tobytes()
        original = first_of.setdefault(content, recording.name)
        if original != recording.name:
            reasons[recording.name] = f"is a copy of {original}, the same in every row"
    different = [recording for recording in moving if recording.name not in reasons]
    for whole in different:
        parts = [run for run in different if run.name not in reasons and _is_part(run, whole)]
        if not parts:
            continue
        names = [run.name for run in parts]
        covered = sum(len(run.time_s) for run in parts) / len(whole.time_s)
        if whole.name not in kept and (covered >= _COVERED or not set(kept).isdisjoint(names)):
            reasons[whole.name] = f"contains {name_runs(names)}, used in its place"
        else:
            reasons |= dict.fromkeys(names, f"is a part of {whole.name}, the same in every row")
    return reasons


def _is_part(run: Recording, whole: Recording) -> bool:
    """Return whether another, longer run has all rows of a run, one after the other."""
    first = int(np.searchsorted(whole.time_s, run.time_s[0]))
    rows = slice(first, first + len(run.time_s))
    return len(run.time_s) < len(whole.time_s) and all(
        np.array_equal(getattr(run, name), getattr(whole, name)[rows], equal_nan=True)
        for name in ("time_s", "inputs", "outputs")
    )


def _require_rows(recordings: Sequence[Recording]) -> None:
    """Check that runs are long enough for the filters."""
    for recording in recordings:
        if len(recording.time_s) < MIN_ROWS:
            raise InputError(
                f"run {recording.name}: number of rows is {len(recording.time_s)}, "
                f"at least {MIN_ROWS} are needed"
            )


def _require_motion(fitted: Sequence[Recording]) -> None:
    """Check that at least one sensor measures motion in at least one of the fitted runs."""
    if not moving_runs(fitted):
        raise InputError(
            f"runs {', '.join(run.name for run in fitted)}: no sensor moves, so nothing can be identified"
        )


def hold_out(
    recordings: Sequence[Recording], chosen: Sequence[str] = (), machine: Machine | None = None
) -> tuple[str, ...]:
    """Choose the runs that are held out: excluded from the fit and used to evaluate it.

    By default, the runs are divided into groups of four with similar voltages (see `spectral_differences`),
    and one run of each group is held out. A group consists of the first run that belongs to no group yet and
    the three remaining runs that are most similar to it; the last group has up to seven runs. The run to hold
    out is chosen by three criteria, each of which decides between the runs that are equally good by those
    before it:

    1. The held-out runs are as similar as possible to runs that are fitted. A kind of motion that occurs only
       once is therefore fitted if possible.
    2. The run is no repetition of another held-out run.
    3. The run is close to the fourth, eighth, ... of all runs. If all runs are alike, every fourth one is
      held out.

    Runs in which nothing moves (`moving_runs`) are fitted, for the noise of the sensors, and never chosen: an
    error on them says nothing about the machine.

    Args:
        chosen: Names of the runs to hold out. Default: one of each group of four; one if there are fewer than
            four.
        machine: Machine that was recorded, whose sensors show accelerations. Default: these are not compared.

    Returns:
        Names of the held-out runs.

    Raises:
        InputError: If a run is unknown, no run is left to fit, or nothing moves in any of the held-out runs
            although the machine moves in others.
    """
    names = [r.name for r in recordings]
    unknown = [c for c in chosen if c not in names]
    if unknown:
        raise InputError(
            f"--hold-out {unknown[0]}: no such run; "
            f"the runs are {', '.join(names)}{suggestion(unknown[0], names)}"
        )
    moving = moving_runs(recordings)
    eligible = [r for r in recordings if r.name in moving] or recordings
    if len(eligible) == 1 < len(names):
        raise InputError(
            f"nothing moves except in run {eligible[0].name}; a run that moves must be fitted and another "
            "one held out, so record more runs or split this one: hframe import FILE --split-every SECONDS"
        )
    needed = np.zeros(len(eligible), np.bool_)
    if machine is not None and len(eligible) > 2:  # of two runs, one always has half
        needed = acceleration_fractions(eligible, machine) > _MOST
    held_out = tuple(chosen) or tuple(
        eligible[i].name for i in _representative_runs(spectral_differences(eligible), needed)
    )
    if not set(held_out) & {run.name for run in eligible}:
        raise InputError(
            f"--hold-out {', '.join(held_out)}: nothing moves in it, so its "
            f"error says nothing about the machine; hold out a run that moves, such as {eligible[-1].name}"
        )
    if len(set(held_out)) >= len(names):
        raise InputError(
            f"runs: {len(names)}, held out: {len(set(held_out))}; "
            "at least one must be left to fit, so split the recording into several runs or hold out fewer"
        )
    return held_out


def _representative_runs(differences: Array, needed: NDArray[np.bool_]) -> list[int]:
    """Return the indices of runs to hold out, sorted.

    Args:
        differences: How much the runs differ, dimensionless, shape (runs, runs).
        needed: Whether each run is needed for the fit, shape (runs,).
    """
    remaining = list(range(len(differences)))
    held_out: list[int] = []

    def unsuitability(run: int) -> tuple[bool, float, bool, int]:
        """Return four properties of a candidate, the most important one first; small values are better."""
        candidates = [*held_out, run]
        to_fitted = np.delete(differences[candidates], candidates, axis=1).min(axis=1, initial=np.inf).sum()
        repeated = bool((differences[run, held_out] == 0.0).any())
        fourth = _GROUP_SIZE * len(candidates) - 1  # index of the fourth, eighth, ... of all runs
        return bool(needed[run]), float(to_fitted), repeated, abs(run - fourth)

    while remaining:
        # stable: equals in order of names
        group = sorted(remaining, key=lambda run: differences[remaining[0], run])
        if len(group) >= 2 * _GROUP_SIZE:
            group = group[:_GROUP_SIZE]
        held_out.append(min(group, key=unsuitability))
        remaining = [run for run in remaining if run not in group]
    return sorted(held_out)


def spectral_differences(recordings: Sequence[Recording]) -> Array:
    """Compare the kinds of motion of runs by the spectra of their voltages.

    The spectrum s of a run consists of the root mean square voltages in each octave of frequency: of each
    drive, and of the sum and the difference of each pair of drives, divided by sqrt(2). On a machine with
    belts, sum and difference move different axes. Adjacent octaves overlap, so that a small change of a
    frequency changes the spectrum little.

    Args:
        recordings: Runs with their voltages, V, of any durations and sampling rates.

    Returns:
        |s_i - s_j| / (|s_i| + |s_j|) for each pair of runs i and j, dimensionless, shape (runs, runs). It is
        1 if the runs have no octave in common, and 1/3 if one run has twice the voltages of the other. Values
        below 0.2, such as those of repetitions of a run, are set to 0.
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


def moving_runs(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Find the runs in which at least one sensor moves beyond its noise and 1 % of its largest span.

    A span is the difference between the 99th and the 1st percentile of the measurements, so that single wrong
    samples and the first steps of a motor that hardly turns do not count.

    Returns:
        Names of these runs.
    """
    spans, moves = np.zeros((2, len(recordings), recordings[0].outputs.shape[1]))
    for i, recording in enumerate(recordings):
        for j, values in enumerate(recording.outputs.T):
            measured = values[np.isfinite(values)]
            if len(measured):
                spans[i, j] = np.ptp(np.percentile(measured, [1, 99]))
                moves[i, j] = (
                    max(spans[i, j] ** 2 - (_NORMAL_SPAN * difference_noise([measured])) ** 2, 0.0) ** 0.5
                )
    moving = (moves > _MOVES * spans.max(axis=0)) & (moves > _NO_NOISE * spans)
    return tuple(r.name for r, moves in zip(recordings, moving.any(axis=1), strict=True) if moves)
