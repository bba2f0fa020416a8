"""Choose a representative part of a long session for the search for effects.

A search fits hundreds of candidates, and each takes as long as the runs are. Beyond a normal session, more
rows make parameters more accurate, but hardly show another effect. The search therefore uses a part of the
runs that represents all of them; what it finds is fitted to all rows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from ...machine import Machine
from ...recordings import Recording
from ..dataset import MIN_ROWS, Dataset, PreparedRecording
from ..start.encoder_zeros import EncoderZeros
from ..start.measured_state import estimate_initial_state
from ..usable import without_unknown_voltage
from .moving import moving_runs
from .spectra import spectral_differences

# Rows times coordinates of a normal session: eight runs of 5 s at 1 kHz of a machine with four coordinates.
# Its complete search takes a quarter of a minute as a median, and one to three minutes if nothing explains
# the error.
NORMAL_SESSION = 160_000
# The same of the rows to which the machines are fitted in the end. More would need gigabytes of memory and
# minutes, and make parameters hardly more accurate.
LARGEST_FIT = 10 * NORMAL_SESSION
# Time of a fit for a row and for the motion until the next one, in normal sampling periods of 1 ms: measured
# on logs of 1 kHz and 500 Hz.
NORMAL_PERIOD, _OF_ROW, _OF_MOTION = 1e-3, 0.75, 0.25
# Runs among which a normal session is divided. An effect must be confirmed by runs to which it was not
# fitted, so few long ones would say less than this many shorter ones.
_RUNS = 8
_REST_S = 0.1  # s without motion, after which a part of a run may begin as a run does: at rest
# How far sensors vary at rest, in standard deviations of their noise and in quantization steps.
_NOISE_AT_REST, _STEPS_AT_REST = 8.0, 1.5


def representative_part(
    data: Dataset, machine: Machine, *, size: float = NORMAL_SESSION, every_run: bool = False
) -> Dataset:
    """Return a representative part of the runs, for the search for effects.

    Runs that move are added, each time the one that differs most from the runs before by the spectra of its
    voltages, until they fill a session of normal size. The chosen runs are cut to one length
    (`largest_share`), with which their sum has the permitted size; shorter runs remain complete. Of each cut
    run, one contiguous part is kept, whose voltages resemble those of the complete run most. It may begin
    with the run or every half part later; there it is put off to the next rest, if one follows within half a
    part. Without a sensor of positions it begins with the run.

    Args:
        machine: Machine as declared.
        size: Largest number of rows times coordinates, dimensionless, for rows that are 1 ms apart; fewer if
            they are further apart.
        every_run: Whether a part of each run is kept, however short.

    Returns:
        The runs, or parts of them with the same names and a measured start; `data` itself if it is small
        enough, or if the errors of its voltages are known by row.
    """
    per_row = _OF_ROW + _OF_MOTION * data.period / NORMAL_PERIOD
    rows = round(size / (len(machine.coordinates) * per_row))
    if sum(len(run.time_s) for run in data.runs) <= rows or data.has_voltage_errors:
        return data
    chosen = data.runs if every_run else _different_runs(data, rows)
    longest = int(largest_share([len(run.time_s) for run in chosen], rows))
    parts = (_representative_rows(run, max(longest, MIN_ROWS), data, machine) for run in chosen)
    return dataclasses.replace(data, runs=tuple(parts))


def is_long(recording: Recording, machine: Machine) -> bool:
    """Return whether a run has more than an eighth of the rows of a normal session (`NORMAL_SESSION`).

    Args:
        machine: Machine that was recorded; rows count once per coordinate.
    """
    return len(recording.time_s) * len(machine.coordinates) > NORMAL_SESSION / _RUNS


def describe_part(part: Dataset, data: Dataset) -> str:
    """Describe the part of the runs that is used, for the log: "40000 of 300000 rows, of 5 of 5 runs".

    Args:
        data: All runs.
    """
    used, rows = (sum(len(run.time_s) for run in each.runs) for each in (part, data))
    return f"{used} of {rows} rows, of {len(part.runs)} of {len(data.runs)} runs"


def largest_share(lengths: Sequence[float], total: float) -> float:
    """Return the length to which longer ones must be cut so that all lengths sum to at most `total`.

    Args:
        lengths: Lengths, such as durations, s, or numbers of rows, dimensionless.
        total: Largest sum of the lengths, in their unit, s or dimensionless.

    Returns:
        Largest permitted length, in the same unit, s or dimensionless.
    """
    left = float(total)
    for i, length in enumerate(sorted(lengths)):
        share = left / (len(lengths) - i)
        if length > share:
            return share
        left -= length
    return max(lengths)


def _different_runs(data: Dataset, rows: int) -> list[PreparedRecording]:
    """Return runs that move and differ, as many as fill the given rows, in the order of the data."""
    moving = moving_runs([_recorded(run) for run in data.runs])
    runs = [run for run in data.runs if run.name in moving] or list(data.runs)
    differences = spectral_differences([_recorded(run) for run in runs])
    order, filled = [0], min(len(runs[0].time_s), rows / _RUNS)
    while filled < rows and len(order) < len(runs):
        others = [k for k in range(len(runs)) if k not in order]
        # Of runs that are alike, those far from each other in the session: machines change with time.
        following = max(
            others, key=lambda k: (differences[k, order].min(), min(abs(k - taken) for taken in order))
        )
        order.append(following)
        filled += min(len(runs[following].time_s), rows / _RUNS)
    return [runs[k] for k in sorted(order)]


def _representative_rows(
    run: PreparedRecording, rows: int, data: Dataset, machine: Machine
) -> PreparedRecording:
    """Return the part of a run, so many rows long, whose voltages resemble those of the whole run most."""
    if len(run.time_s) <= rows:
        return run
    if not machine.position_sensors.any():  # forces may depend on positions, known from the beginning on only
        return run.first_rows(rows)
    starts = _starts(run, rows, data)
    whole = _recorded(run)
    parts = (whole.rows(slice(start, start + rows)) for start in starts)
    difference = spectral_differences([whole, *parts])[0, 1:]
    return _part(run, starts[int(np.argmin(difference))], rows, machine)


def _starts(run: PreparedRecording, rows: int, data: Dataset) -> list[int]:
    """Return rows at which a part may begin, half a part apart, later by up to that much for a rest."""
    resting, last = np.flatnonzero(_at_rest(run, data)), len(run.time_s) - rows
    starts = [0]
    for row in range(rows // 2, last + 1, max(rows // 2, 1)):
        following = resting[np.searchsorted(resting, row) :]
        at_rest = len(following) and following[0] <= min(row + rows // 2, last)
        starts.append(int(following[0]) if at_rest else row)
    return starts


def _at_rest(run: PreparedRecording, data: Dataset) -> NDArray[np.bool_]:
    """Return for each row whether no voltage is applied and no sensor moves from there on for some time.

    Sensors without any measurement in the run say nothing; one that only pauses may hide a motion.
    """
    count = max(2, round(_REST_S / data.period))
    present = np.isfinite(run.outputs).any(axis=0)
    outputs, driven = run.outputs[:, present], np.abs(run.inputs)
    tolerance = (_NOISE_AT_REST * data.noise + _STEPS_AT_REST * data.quantum)[present]
    low = np.hstack([np.where(np.isfinite(outputs), outputs, np.inf), -driven])
    high = np.hstack([np.where(np.isfinite(outputs), outputs, -np.inf), driven])
    ahead = -(count // 2)  # the window of a row consists of the rows that follow
    highest = maximum_filter1d(high, count, axis=0, origin=ahead)
    lowest = minimum_filter1d(low, count, axis=0, origin=ahead)
    span = highest - lowest
    return np.all((span <= np.concatenate([tolerance, np.zeros(driven.shape[1])])) & (span >= 0.0), axis=1)


def _part(run: PreparedRecording, start: int, rows: int, machine: Machine) -> PreparedRecording:
    """Return rows of a run as a run of its own, with the state that its first measurements show."""
    if start == 0:
        return run.first_rows(rows)
    whole = _recorded(run)
    whole = dataclasses.replace(whole, outputs=whole.outputs + run.initial.zeros)
    chosen = slice(start, start + rows)
    part = without_unknown_voltage(whole.rows(chosen), machine)
    encoders = [sensor.incremental for sensor in machine.sensors]  # they count from the zero of the whole run
    zeros = EncoderZeros(np.where(encoders, run.initial.zeros, np.nan), run.initial.zero_spread)
    initial = estimate_initial_state(part, machine, zeros)
    return dataclasses.replace(
        run.rows(chosen),
        inputs=part.inputs,
        outputs=part.outputs - initial.zeros,
        initial=initial,
        weights=np.where(np.isfinite(part.outputs), run.weights[chosen], 0.0),
    )


def _recorded(run: PreparedRecording) -> Recording:
    """Return a run as a recording, with measurements minus the sensors' zeros."""
    return Recording(run.name, run.time_s, run.inputs, run.outputs)
