"""Divide the runs of a session into those that are fitted and those that are held out, which no fit uses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...errors import InputError, suggestion
from ...machine import Machine
from ...recordings import Recording
from ..dataset import MIN_ROWS
from .accelerations import acceleration_fractions
from .moving import moving_runs
from .spectra import spectral_differences

_GROUP_SIZE = 4  # One of four runs is held out.
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
