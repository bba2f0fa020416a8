"""Find outputs that are stuck at one value or clipped at the end of a sensor's range."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..dynamics import stiffness_matrix
from ..machine import Machine
from ..recordings import Recording, bridge_blanks
from .findings import Finding, Severity
from .wiring import rigid_misfit, rigid_prediction

Array = NDArray[np.float64]

_STUCK_AFTER = 0.1  # s; a channel that is constant for a shorter time is not stuck
_LONGEST_BLANK = 0.02  # s; longer times between two measurements are not bridged
_MOVES = 0.1  # fraction of a channel's span in the run; a channel that should have moved by less may have been at rest
_STRETCH_MARGIN = 2.0  # factor by which the declared friction, drives and stiffness may be wrong
_NOISE_SPAN = 8.0  # peak-to-peak noise in standard deviations
_CONSISTENT = 0.3  # fraction of the motion; other channels that contradict each other by more prove nothing


def stuck_outputs(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report outputs that keep one value while they should move.

    If this value is the smallest or the largest over all runs, a sensor with a fixed zero may have reached the end of
    its range (advice), which identification handles. Otherwise the channel is stuck (fault).

    Args:
        recordings: Runs in which the machine moves (times, s; voltages, V; measurements, m or rad).
        machine: Declared machine.

    Returns:
        At most one finding for each run and channel.
    """
    findings = []
    # Ends of the channels' spans over all runs, (2, sensors).
    spans = [_ends(recording.outputs) for recording in recordings]
    ends = np.array([np.fmin.reduce([low for low, _ in spans]), np.fmax.reduce([high for _, high in spans])])
    for recording in recordings:
        inside = bridge_blanks(_without_ends(recording.outputs, ends, machine), recording.time_s, _LONGEST_BLANK)
        for j, sensor in enumerate(machine.sensors):
            seconds, value = _longest_stuck_interval(recording, inside, j, ends[:, j], machine)
            if not seconds:
                continue
            stays = f"for {seconds:.3g} s, while other channels move, it stays at {value:.4g}"
            if not sensor.incremental and value in ends[:, j]:
                severity: Severity = "advice"
                message = f"{stays}, the end of its span: clipped? A fit leaves these rows out"
            else:
                severity = "fault"
                message = f"{stays}: stuck. Leave these cells empty, or delete the run"
            findings.append(Finding(severity, recording.name, sensor.channel, message))
    return findings


def _ends(outputs: Array) -> tuple[Array, Array]:
    """Return the smallest and the largest measurement of each channel, NaN where it has none."""
    return np.fmin.reduce(outputs, axis=0), np.fmax.reduce(outputs, axis=0)


def _without_ends(outputs: Array, ends: Array, machine: Machine) -> Array:
    """Return outputs (n, sensors) with NaN where a sensor with a fixed zero may be at the end of its range."""
    margin = np.array([max(3 * sensor.noise, sensor.resolution) for sensor in machine.sensors])
    fixed = np.array([not sensor.incremental for sensor in machine.sensors])
    at_end = (outputs <= ends[0] + margin) | (outputs >= ends[1] - margin)
    return np.where(at_end & fixed, np.nan, outputs)


def _longest_stuck_interval(
    recording: Recording, inside: Array, channel: int, ends: Array, machine: Machine
) -> tuple[float, float]:
    """Return duration, s, and value of the longest interval in which a channel is stuck; 0 s if there is none.

    Args:
        recording: Run with n rows.
        inside: Its outputs without those that may be clipped, shape (n, sensors).
        channel: Index of the sensor.
        ends: Smallest and largest measurement of the sensor over all runs, shape (2,).
        machine: Declared machine.
    """
    measured = np.flatnonzero(np.isfinite(recording.outputs[:, channel]))
    values, time_s = recording.outputs[measured, channel], recording.time_s[measured]
    prediction = rigid_prediction(inside, channel, machine)
    constant = np.concatenate([[False], np.diff(values) == 0.0, [False]])
    intervals = np.flatnonzero(np.diff(constant.astype(int))).reshape(-1, 2)  # first and last sample of each
    seconds = time_s[intervals[:, 1]] - time_s[intervals[:, 0]]
    for k in np.argsort(-seconds):
        if seconds[k] <= _STUCK_AFTER:
            break
        rows = slice(measured[intervals[k, 0]], measured[intervals[k, 1]] + 1)
        value = float(values[intervals[k, 0]])
        if prediction is not None:
            predicted, weights = prediction
            allowed = max(_MOVES * _span(predicted), _span_at_rest(recording.inputs[rows], channel, weights, machine))
            stuck = _span(predicted[rows]) > allowed and _consistent(inside[rows], channel, machine)
        else:
            # An encoder has no end of its range, and nothing else shows whether it should have moved.
            at_end = value in ends and ends[0] < ends[1] and not machine.sensors[channel].incremental
            stuck = bool(at_end) and _others_move(recording, channel, rows)
        if stuck:
            return float(seconds[k]), value
    return 0.0, 0.0


def _consistent(outputs: Array, channel: int, machine: Machine) -> bool:
    """Return whether the other channels do not contradict each other; True if they are not redundant."""
    others = outputs.copy()
    others[:, channel] = np.nan
    complete = np.isfinite(others) | ~np.isfinite(others).any(axis=0)
    first = int(np.argmax(complete.all(axis=1)))
    return rigid_misfit(others - others[first], machine) < _CONSISTENT


def _span(values: Array) -> float:
    """Return the peak-to-peak value of the measured rows, 0 if there are none."""
    return float(np.nanmax(values) - np.nanmin(values)) if np.isfinite(values).any() else 0.0


def _span_at_rest(inputs: Array, channel: int, weights: Array, machine: Machine) -> float:
    """Return how much the prediction of a channel may move while its coordinate is held by friction.

    Friction holds the coordinate while belts and drives pull on it, so the belts can stretch by up to the friction
    force in either direction, plus the change of the drives' forces. Noise of the other channels adds to it.
    """
    sensor = machine.sensors[channel]
    index = machine.coordinate_names.index(sensor.coordinate)
    coordinate = machine.coordinates[index]
    belt_force = sum(
        drive.gain * float(np.ptp(voltages)) / machine.coordinate(drive.coordinate).travel_per_unit
        for drive, voltages in zip(machine.drives, inputs.T, strict=True)
    )
    force_span = 2 * coordinate.coulomb + belt_force * coordinate.travel_per_unit
    stiffness = stiffness_matrix(machine)[index, index]
    stretch_span = abs(sensor.row[sensor.coordinate]) * force_span / stiffness if stiffness else 0.0
    noise = np.array([max(s.noise, s.resolution) for s in machine.sensors])
    return _STRETCH_MARGIN * stretch_span + _NOISE_SPAN * float(np.linalg.norm(weights * noise))


def _others_move(recording: Recording, channel: int, rows: slice) -> bool:
    """Return whether any other output moves in an interval by a fraction of its span in the run."""
    others = [k for k in range(recording.outputs.shape[1]) if k != channel]
    spans = [(_span(recording.outputs[rows, k]), _span(recording.outputs[:, k])) for k in others]
    return any(in_interval > _MOVES * in_run > 0 for in_interval, in_run in spans)
