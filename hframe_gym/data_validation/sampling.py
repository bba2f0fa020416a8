"""Checks of the timing: clock, lost samples, sensors slower than the log, and voltages that are logged late.

A recording holds in each row the voltage that acts from its time to the time of the next row. Many loggers
write the voltage that has acted until then, so that every voltage is one row late. A delay of the response
has physical causes, which identification can find; a response before its cause has none, unless too long a
delay is declared.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import special

from ..arrays import Array
from ..identification import (
    MIN_ROWS,
    Dataset,
    PreparedRecording,
    SelectionCriteria,
    default_free_parameters,
    fit,
)
from ..identification.fit.voltage_updates import describe_interpolation, voltage_updates
from ..identification.predict.prediction import SEARCH_BANDWIDTH
from ..identification.predict.voltage_errors import with_voltage_errors
from ..machine import Machine, rigid_basis
from ..recordings import GAP_PERIODS, Recording, missing_rows, repetitions, usual_step
from .findings import Finding, Severity

_LONG_PERIOD = 0.2  # s; slower samples cannot record the motion of a machine
_LONG_RUN = 120.0  # s
_SHORT_RUN = 0.05  # s; as long as the rest before a motion should be, so that no motion fits in
_NEIGHBORS = 10  # rows on each side of a gap whose lateness is compared
_JITTER = 0.02  # standard deviation of the time steps / period above which it is noted
_IRREGULAR = 0.1  # standard deviation of the time steps / period above which identification may suffer
_SAME_RATE = 1.02  # ratio of sampling periods up to which runs have one rate
# Fits that compare the voltages as logged with those of the next row.
_RUNS = 3  # those with the largest changes of the voltages suffice
_MAX_ROWS = 20_000  # of a run; fits of longer ones take too long for a check
_ITERATIONS = 10  # of a fit that need not converge fully
_CERTAIN = 0.7  # fraction of chi-squared below which the earlier voltages certainly explain the motion better
_PAST_ROWS = 4  # from which a measurement is predicted; two suffice for a mass without noise
_CHANCE = 1e-6  # probability below which measurements certainly depend on the voltages of their own rows
# Response of a measurement to the voltage of its own row / to a voltage that acts for a whole row. On 39 sets
# whose voltages are in time, it is at most 0.33 where it is significant (a controller that is faster than the
# log changes the voltage between the rows); with voltages that are late by a row, 1.1 and more.
_WHOLE_ROW = 0.5
_EXPLAINED = 10.0  # chi-squared per sample of an explained motion: an error of three times the noise
_OWN_ROW = 0.1  # fraction of what previous rows do not predict that the own row must explain instead


def times_in_milliseconds(recordings: Sequence[Recording]) -> list[Finding]:
    """Report runs whose times are probably in milliseconds instead of seconds: one fault for each.

    A median time step of at least 0.2 s would be too long to record the motion of a machine.
    """
    periods = {r.name: float(np.median(np.diff(r.time_s))) for r in recordings if len(r.time_s) > 1}
    advice = "is it in milliseconds? Convert it: hframe import FILE --unit time_s=ms --out RUNS"
    return [
        Finding("fault", name, "time_s", f"samples are {period:.4g} s apart, {advice}")
        for name, period in periods.items()
        if period >= _LONG_PERIOD
    ]


def check_sampling(recording: Recording, stamp_jitter: float = 0.0) -> list[Finding]:
    """Check number of rows, gaps, duration and jitter of the sample times of one run.

    Args:
        recording: Run with the times that identification uses.
        stamp_jitter: Standard deviation of the logged stamps around these times, s, where equal steps replace
            them.

    Returns:
        Findings (severity, run, channel, message). Fewer rows than identification needs (20) are a fault.
        Lost samples, times that are late although no row is missing, a duration below 0.05 s or above 120 s
        and a jitter above 10 % of the period are advice; a jitter of 2 % to 10 % is a note. Empty if nothing
        is wrong.
    """
    steps = np.diff(recording.time_s)
    if len(steps) + 1 < MIN_ROWS:
        message = (
            f"number of rows is {len(steps) + 1}, identification needs at least {MIN_ROWS}: delete the file"
        )
        return [Finding("fault", recording.name, "time_s", message)]
    period = float(np.median(steps))
    findings = _lost_samples(recording) + _duration(recording) + _uneven_steps(recording)
    if stamp_jitter:
        message = (
            f"the stamps jitter by {1e3 * stamp_jitter:.2g} ms, but the motion was sampled in equal steps of "
            f"{1e3 * period:.4g} ms; these replace the stamps"
        )
        findings.append(Finding("note", recording.name, "time_s", message))
    return findings


def _lost_samples(recording: Recording) -> list[Finding]:
    """Report, as advice, rows that are missing, or times that are late although no row is missing."""
    steps, gaps = np.diff(recording.time_s), missing_rows(recording.time_s) > 0
    if _has_late_stamps(recording):
        rate = len(steps) / float(np.sum(steps))
        message = (
            "sampling is irregular: times are late by half a period or more, but no row is missing. "
            "If the samples were taken at a fixed rate, "
            f"state it: hframe import FILE --map time_s={rate:.4g}Hz --out RUNS"
        )
    elif gaps.any():
        lost = float(np.sum(steps[gaps]) - np.sum(gaps) * usual_step(recording.time_s))  # s
        duration = f"{lost:.3g} s" if lost >= 1.0 else f"{1e3 * lost:.3g} ms"
        count = int(gaps.sum())
        number = f"{count} gaps" if count > 1 else "1 gap"
        message = (
            f"{number} ({duration} in total, {100 * lost / np.sum(steps):.2g} %): samples were dropped or "
            "taken late; identification estimates the inputs in gaps of up to 20 rows from the motion"
        )
    else:
        return []
    return [Finding("advice", recording.name, "time_s", message)]


def _duration(recording: Recording) -> list[Finding]:
    """Report, as advice, a run that is too short for a motion, or so long that a fit is slow."""
    seconds = float(recording.time_s[-1] - recording.time_s[0])
    if seconds < _SHORT_RUN:
        message = f"is only {1e3 * seconds:.3g} ms long: are its times in another unit?"
        return [Finding("advice", recording.name, "time_s", message)]
    if seconds > _LONG_RUN:
        message = f"is {seconds:.4g} s long, which makes a fit slow: cut it by hframe import --split-at-rests"
        return [Finding("advice", recording.name, "", message)]
    return []


def _uneven_steps(recording: Recording) -> list[Finding]:
    """Report rows that are written as values arrive (advice), and steps that differ (advice or a note)."""
    steps, gaps = np.diff(recording.time_s), missing_rows(recording.time_s) > 0
    period, usual = float(np.median(steps)), usual_step(recording.time_s)
    if usual > period:
        message = (
            f"rows are written as values arrive, at irregular times up to {1e3 * usual:.3g} ms apart: "
            "inputs hold until the next row. If they change in between, log at a fixed rate"
        )
        return [Finding("advice", recording.name, "time_s", message)]
    if gaps.all() or _has_late_stamps(recording):  # these are reported, and nothing more is said of the steps
        return []
    jitter = float(np.std(steps[~gaps]))
    if jitter <= _JITTER * period:
        return []
    severity: Severity = "advice" if jitter > _IRREGULAR * period else "note"
    message = f"sampling is irregular, {1e3 * period:.4g} ms with a jitter of {1e3 * jitter:.2g} ms"
    return [Finding(severity, recording.name, "time_s", message)]


def _has_late_stamps(recording: Recording) -> bool:
    """Return whether times are late by half a period or more, although no row is missing."""
    steps = np.diff(recording.time_s)
    late = steps > GAP_PERIODS * float(np.median(steps))
    return bool(late.any()) and _late_stamps(recording.time_s, late)


def _late_stamps(time_s: Array, gaps: NDArray[np.bool_]) -> bool:
    """Return whether long steps, `gaps` (n - 1,), are late stamps: short ones follow, no row is missing."""
    steps = np.diff(time_s)
    short = steps < (2.0 - GAP_PERIODS) * np.median(steps)
    if np.count_nonzero(short) < 0.5 * np.count_nonzero(gaps):
        return False
    period = float(time_s[-1] - time_s[0]) / len(steps)
    # Lateness plus a constant; a missing row makes all later times late
    lateness = time_s - period * np.arange(len(time_s))
    return not any(
        np.median(lateness[k + 1 : k + 1 + _NEIGHBORS])
        - np.median(lateness[max(k + 1 - _NEIGHBORS, 0) : k + 1])
        > 0.5 * period
        for k in np.flatnonzero(gaps[:-1])
    )


def sampling_rate(recordings: Sequence[Recording]) -> Finding:
    """Report number, total duration and sampling rate of the runs, in one note."""
    periods = [float(np.median(np.diff(r.time_s))) for r in recordings if len(r.time_s) > 1]
    seconds = sum(float(r.time_s[-1] - r.time_s[0]) for r in recordings)
    low, high = min(periods, default=np.nan), max(periods, default=np.nan)
    rate = f"{1 / low:.4g} Hz" if high <= _SAME_RATE * low else f"{1 / high:.4g} to {1 / low:.4g} Hz"
    return Finding(
        "note", "", "time_s", f"{len(recordings)} runs, {seconds:.4g} s in total, sampled at {rate}"
    )


def overlapping_clocks(recordings: Sequence[Recording]) -> list[Finding]:
    """Report, in one note, that the times of the runs overlap because the clock restarted with each run.

    Identification can find a drift (a slow change from run to run) only if all runs have a common clock.
    """
    ordered = sorted(recordings, key=lambda recording: recording.time_s[0])
    overlapping = [b.name for a, b in pairwise(ordered) if b.time_s[0] < a.time_s[-1]]
    if not overlapping:
        return []
    message = (
        f"{len(overlapping)} runs overlap in time: the clock restarts, so a drift over the session cannot be "
        "identified"
    )
    return [Finding("note", "", "time_s", message)]


def slow_sensors(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report, as advice, sensors that measure less often than rows are logged (`repetitions`).

    Rows then repeat their values.
    """
    findings = []
    for j, channel in enumerate(machine.output_channels):
        counts = {r.name: count for r in recordings if (count := repetitions(r.outputs[:, j])) > 1.0}
        if counts:
            message = (
                f"is measured every {float(np.median(list(counts.values()))):.3g} rows and repeated between "
                f"them ({len(counts)} runs): the repeated values are not used, as if these cells were empty"
            )
            findings.append(Finding("advice", "", channel, message))
    return findings


def check_input_timing(data: Dataset, machine: Machine) -> list[Finding]:
    """Report voltages that seem to be logged one row late: earlier ones explain the motion clearly better.

    The machine's parameters are fitted twice, with the voltages as logged and with the voltages of the next
    row. Of the runs with at most 20,000 rows, the three with the largest changes of the voltages are used.
    The finding is a fault only if three conditions hold: measurements depend on the voltage of their row,
    which is impossible if this voltage acts from the time of the row on; they do so as strongly as on a
    voltage that acts over an entire row; and the shifted voltages explain the motion, or the row's voltages
    explain at least a tenth of what previous rows do not predict. Otherwise it is advice, because a force or
    a mass that the machine lacks can also make the shifted voltages fit better.

    Returns:
        One finding (fault or advice) about all runs together if the second fit has less than 70 % of the
        chi-squared (sum of squared errors divided by the noise variances) of the first, otherwise an empty
        list. Also empty if all runs have more than 20,000 rows, or if the declared machine has a delay or an
        effect with a state (lag, hysteresis, loop of a drive), because too large a declared delay would make
        the response seem early as well.
    """
    runs = _with_largest_changes(data)
    acting = (*machine.drive_laws, *machine.effects)
    if not runs.runs or any(e.definition.delay or e.definition.next_state for e in acting):
        return []
    earlier = dataclasses.replace(runs, runs=tuple(map(_with_earlier_inputs, runs.runs)))
    free = default_free_parameters(machine)
    logged = fit(machine, free, runs, SEARCH_BANDWIDTH, iterations=_ITERATIONS)
    shifted = fit(machine, free, earlier, SEARCH_BANDWIDTH, theta=logged.theta, iterations=_ITERATIONS)
    if not shifted.cost < _CERTAIN * logged.cost < np.inf:
        return []
    channels = " and ".join(machine.input_channels)
    verb = "are" if len(machine.drives) > 1 else "is"
    evidence = (
        "the motion follows the voltage of the next row (chi-squared per "
        f"sample {shifted.chi2:.3g} instead of {logged.chi2:.3g})"
    )
    remedy = "shift the voltages up by one row and delete the last row"
    feedthrough = _feedthrough(runs.runs, machine)
    explained = shifted.chi2 < _EXPLAINED or feedthrough.explained > _OWN_ROW
    if feedthrough.probability < _CHANCE and feedthrough.response > _WHOLE_ROW and explained:
        return [
            Finding(
                "fault", "", "", f"{channels} {verb} logged one row late: {evidence}. {remedy.capitalize()}"
            )
        ]
    message = (
        f"{channels} may be logged one row late, or the machine lacks a force or a mass: {evidence}. "
        f"If the logger writes the voltage that has acted until the time of its row, {remedy}"
    )
    return [Finding("advice", "", "", message)]


def check_voltages_between_rows(data: Dataset, machine: Machine) -> list[Finding]:
    """Report voltages that change between the rows, because the controller is faster than the log.

    Returns:
        One finding of severity "advice" about all runs together, or none; see `voltage_updates`. There is
        also none if all runs have more than 20,000 rows.
    """
    runs = _with_largest_changes(data)
    if not runs.runs:
        return []
    held = fit(machine, default_free_parameters(machine), runs, SEARCH_BANDWIDTH, iterations=_ITERATIONS)
    updates = voltage_updates(held, runs, SelectionCriteria())
    if updates.per_row == 1:
        return []
    interpolated = with_voltage_errors(held.machine, runs.with_updates(updates.per_row))
    # Much is left: what the machine lacks may act as voltages do that come earlier.
    explained = updates.fitted < SelectionCriteria().explained_chi2
    beside = (
        ""
        if explained
        else ", and asks again beside each effect that it finds, whose lack may look like this"
    )
    message = (
        f"{updates.describe(machine.commands_in_words, data.period)}: "
        f"identification interpolates them{beside}; "
        f"{describe_interpolation(held.machine, interpolated)}"
    )
    return [Finding("advice", "", "", message)]


def _with_largest_changes(data: Dataset) -> Dataset:
    """Return the three runs of up to 20,000 rows whose voltages change most from row to row."""
    short = (run for run in data.runs if len(run.time_s) <= _MAX_ROWS)
    return data.with_runs([run.name for run in sorted(short, key=_input_changes)[-_RUNS:]])


class _Feedthrough(NamedTuple):
    """How measurements depend on the voltages of their own rows.

    Attributes:
        probability: Probability of the measurements if they do not, times the number of sensors.
        response: Response to these voltages / the response to voltages that act for a whole row.
        explained: Fraction of what previous rows do not predict that these voltages explain.
    """

    probability: float
    response: float
    explained: float


def _feedthrough(runs: Sequence[PreparedRecording], machine: Machine) -> _Feedthrough:
    """Test whether measurements depend on the voltages of their own rows, which act only afterwards.

    An F-test compares two linear regressions: from voltages and measurements of the previous four rows, and
    from the voltages of the own row as well. In open loop, it holds for any missing effect, because the part
    of a voltage that previous rows do not predict is independent of the motion. A controller makes voltages
    depend on the measurements of their own row, but with the opposite sign, for which `machine` is needed;
    such a dependence does not count. Sensors that measured in less than half of the rows are ignored. Without
    complete rows or motion, the probability is 1.
    """
    period = float(np.median(np.concatenate([np.diff(r.time_s) for r in runs])))
    drives = runs[0].inputs.shape[1]
    measured = np.isfinite(np.concatenate([r.outputs for r in runs])).mean(axis=0) > 0.5
    directions = _directions(machine)[measured]
    channels = [np.hstack([r.inputs, r.outputs[:, measured]]) for r in runs]
    rows = np.concatenate([sliding_window_view(values, _PAST_ROWS + 1, axis=0) for values in channels])
    # (rows, channels, previous rows and the row itself)
    rows = rows[np.isfinite(rows[..., :-1]).all(axis=(1, 2))]
    found = _Feedthrough(1.0, 0.0, 0.0)
    for j, direction in enumerate(directions, start=drives):
        used = rows[np.isfinite(rows[:, j, -1])]
        freedom = len(used) - rows[0, :, :-1].size - 1 - drives if len(rows) else 0
        if freedom < MIN_ROWS or np.ptp(used[:, j, -1]) == 0.0:
            continue
        past = np.column_stack([used[..., :-1].reshape(len(used), -1), np.ones(len(used))])
        present = np.column_stack([used[:, :drives, -1], used[:, j, -1]])
        present -= past @ np.linalg.lstsq(past, present)[0]
        voltages, response = present[:, :drives], present[:, drives]
        explained = voltages @ np.linalg.lstsq(voltages, response)[0]
        left = response - explained
        ratio = (response @ response / (left @ left) - 1.0) * freedom / drives
        expected = voltages @ direction * period**2 / 2  # of a force that acts for one row
        if explained @ expected > 0.0:
            probability = len(directions) * float(special.fdtrc(drives, freedom, ratio))
            if probability < found.probability:
                share = float(explained @ explained / (response @ response))
                found = _Feedthrough(probability, float(explained @ expected / (expected @ expected)), share)
    return found


def _directions(machine: Machine) -> Array:
    """Return the sensors' accelerations per volt of each drive, with stiff belts, SI, (sensors, drives)."""
    rigid = rigid_basis(machine)
    mass = np.array([c.mass for c in machine.coordinates])
    force = np.column_stack([machine.coefficients({d.coordinate: d.gain}) for d in machine.drives])
    return np.asarray(
        machine.sensor_matrix @ rigid @ np.linalg.solve(rigid.T @ (mass[:, None] * rigid), rigid.T @ force)
    )


def _input_changes(run: PreparedRecording) -> float:
    """Return the sum of squared changes of the voltages from row to row, V^2."""
    return float(np.sum(np.diff(run.inputs, axis=0) ** 2))


def _with_earlier_inputs(run: PreparedRecording) -> PreparedRecording:
    """Return a run in which each voltage acts one row earlier."""
    return dataclasses.replace(run, inputs=np.vstack([run.inputs[1:], run.inputs[-1:]]))
