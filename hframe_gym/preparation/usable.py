"""Remove unusable measurements from a recording, in the same way for `check`, `identify` and `simulate`.

A recording is unwrapped first, and stamps that jitter around equal steps are replaced by these. Not usable
are repetitions of the last measurement by a sensor that is slower than the log or silent, outliers, and the
measurements before the machine comes to rest. Inputs that were measured with much noise are averaged. Only
all runs together show the ends of the sensors' ranges (`sensors/saturation.py`).
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from ..line_log import LineLog
from ..machine import Machine
from ..recordings import (
    Recording,
    repetitions,
    without_outliers,
    without_repetitions,
    without_silences,
    without_wraps,
    wraps_of,
)
from .clock.regular_clock import with_regular_clock
from .dataset import MIN_ROWS
from .inputs.measured_noise import without_input_noise
from .start.rest import InitialRest, count_resting_rows, initial_rest, without_moving_start


class UsableRun(NamedTuple):
    """A run whose unusable measurements have been replaced by NaN.

    Attributes:
        measured: The run, unwrapped, without repetitions, outliers and silences.
        rest: Rest at its beginning.
        usable: The same run, also without the measurements before the machine comes to rest.
    """

    measured: Recording
    rest: InitialRest
    usable: Recording


def usable_run(recording: Recording, machine: Machine, log: LineLog | None = None) -> UsableRun:
    """Unwrap a run, repair its clock, and replace measurements that are not usable by NaN.

    These are values that the log repeats, outliers, values while a sensor was silent, and those before a run
    that begins in motion comes to rest. Jittering stamps become equal steps, and noisy inputs are averaged.
    Measurements at the end of a sensor's range stay.

    Args:
        recording: Run as logged.
        log: Called with a line of text for each channel that wraps and each kind of measurements that is
            removed.

    Returns:
        The repaired run twice, `measured` with and `usable` without the measurements before it comes to rest,
        and the `rest` at its beginning.
    """
    regular, jitter_s = with_regular_clock(without_wraps(recording, machine), machine)
    unwrapped = without_input_noise(regular, machine, log)
    distinct = without_repetitions(unwrapped)
    plausible = without_outliers(distinct, machine)
    measured = without_silences(plausible, machine)
    rest = initial_rest(measured, machine)
    usable = without_moving_start(measured, machine, rest)
    if log is not None:
        _log_wraps(recording, machine, log)
        if jitter_s:
            log(
                f"{recording.name}: the stamps jitter by {1e3 * jitter_s:.2g} ms, "
                "but the motion was sampled in equal steps; these replace the stamps"
            )
        _log_repetitions(unwrapped, distinct, machine, log)
        removals = (
            (distinct, plausible, "outliers"),
            (plausible, measured, "values that were repeated while the sensor was silent"),
            (measured, usable, "moving start"),
        )
        for before, after, what in removals:
            if after is not before:
                count = np.isfinite(before.outputs).sum(axis=0) - np.isfinite(after.outputs).sum(axis=0)
                found = ", ".join(
                    f"{n} of {c}" for n, c in zip(count, machine.output_channels, strict=True) if n
                )
                log(f"{recording.name}: {what} not used: {found}")
    return UsableRun(measured, rest, usable)


def from_first_measurement(recording: Recording, machine: Machine) -> Recording:
    """Copy a run without the rows before its first measurement, if the machine may move in them.

    If a run begins at rest, it does not matter when the sensors begin to measure. Otherwise no measurement
    gives the position of the first row, but the run can be simulated from the first row with a measurement
    on.

    Returns:
        Copy; the same object if something is measured at rest, if nothing is measured at all, or if fewer
        than 20 rows would remain.
    """
    measured = np.flatnonzero(np.isfinite(recording.outputs).any(axis=1))
    first = int(measured[0]) if len(measured) else 0
    if not 0 < first <= len(recording.time_s) - MIN_ROWS:
        return recording
    if first < count_resting_rows(recording, machine):
        return recording
    series = {name: getattr(recording, name)[first:] for name in ("time_s", "inputs", "outputs")}
    return dataclasses.replace(recording, **series)


def without_unknown_voltage(recording: Recording, machine: Machine) -> Recording:
    """Copy a recording without accelerations and currents in the first row.

    These jump with the voltage, and the voltage before the first row is unknown; the cells become NaN. If no
    sensor measures such a quantity, the result is the recording itself.
    """
    felt = np.array([s.sensed.jumps for s in machine.sensors], np.bool_)
    if not felt.any():
        return recording
    outputs = recording.outputs.copy()
    outputs[0, felt] = np.nan
    return dataclasses.replace(recording, outputs=outputs)


def _log_wraps(recording: Recording, machine: Machine, log: LineLog) -> None:
    """Log the angles and counters that wrap."""
    for channel, wrap in wraps_of(recording, machine).items():
        unit = machine.sensor_unit(machine.sensor(channel))
        log(f"{recording.name}: {channel} {wrap.describe(unit)}")


def _log_repetitions(before: Recording, after: Recording, machine: Machine, log: LineLog) -> None:
    """Log the sensors that are slower than the log."""
    for channel, values, kept in zip(machine.output_channels, before.outputs.T, after.outputs.T, strict=True):
        if repeated := int(np.isfinite(values).sum() - np.isfinite(kept).sum()):
            rows = f"{channel} is measured every {repetitions(values):.3g} rows"
            log(f"{before.name}: {rows}; the {repeated} repeated values are not used")
