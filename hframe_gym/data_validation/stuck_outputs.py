"""Find outputs that are stuck at one value or clipped at the end of a sensor's range."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..dynamics import stiffness_matrix
from ..machine import Machine
from ..preparation.sensors.drive_off import drives_off
from ..preparation.start.rest import count_resting_rows
from ..recordings import Recording, bridge_blanks, peak_to_peak
from .findings import Finding, Severity, channel_unit
from .wiring import rigid_misfit, rigid_prediction

_STUCK_AFTER = 0.1  # s; a channel that is constant for a shorter time is not stuck
_LONGEST_BLANK = 0.02  # s; longer times between two measurements are not bridged
# Fraction of a channel's span in the run; a channel that should have moved by less may have been at rest.
_MOVES = 0.1
_STRETCH_MARGIN = 2.0  # factor by which the declared friction, drives and stiffness may be wrong
# Peak-to-peak noise in standard deviations; about that of 20 000 normally distributed samples.
NOISE_SPAN = 8.0
# Pairs of successive measurements at rest, at least, and fraction of equal ones, at most, of a noisy sensor.
_MIN_PAIRS, _MAX_EQUAL = 30, 0.01
# Multiple of the declared friction and fraction of the rated force that certainly move a coordinate, and the
# fraction of an interval in which they act in each direction.
_PUSH, _RATED_PUSH, _MIN_PUSHED = 5.0, 0.2, 0.1
_DRIVEN = "while its drive pushes in both directions"
_CONSISTENT = 0.3  # fraction of the motion; other channels that contradict each other by more prove nothing


def stuck_outputs(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report sensor channels that keep one value for more than 0.1 s although they should have changed.

    A channel should have changed in an interval for one of three reasons:

    - The other channels show that its coordinate moves.
    - The sensor has noise at rest, so that its measurements are never constant.
    - Its drive pushes the coordinate in both directions, each in at least a tenth of the interval, with more
      than five times the Coulomb friction and a fifth of the rated force. This reason counts only for
      machines without belts, springs and drives that follow a set point, and only if no other channels
      determine the motion of the coordinate.

    The finding is a fault, but advice in two cases: for the third reason, because the drive may have been
    off; and if a sensor with a fixed zero (no incremental encoder) stays at the smallest or largest value of
    all runs, which may be the end of its range. Identification leaves out measurements at such an end.

    Returns:
        At most one finding for each run and channel, about the longest interval in which it is stuck.
    """
    findings = []
    # Ends of the channels' spans over all runs, (2, sensors).
    spans = [_ends(recording.outputs) for recording in recordings]
    ends = np.array([np.fmin.reduce([low for low, _ in spans]), np.fmax.reduce([high for _, high in spans])])
    noisy = _noisy_at_rest(recordings, machine)
    for recording in recordings:
        inside = bridge_blanks(
            _without_ends(recording.outputs, ends, machine), recording.time_s, _LONGEST_BLANK
        )
        for j, sensor in enumerate(machine.sensors):
            seconds, value, reason = _longest_stuck_interval(
                recording, inside, j, ends[:, j], bool(noisy[j]), machine
            )
            if not seconds:
                continue
            stays = f"for {seconds:.3g} s, {reason}, it stays at {value:.4g}"
            severity: Severity = "advice"
            if not sensor.incremental and value in ends[:, j]:
                message = f"{stays}, the end of its span: clipped? A fit leaves these rows out"
            elif reason == _DRIVEN:
                message = (
                    f"{stays}: is the sensor stuck, or was the drive off? Leave these rows out of the run"
                )
            else:
                severity = "fault"
                message = f"{stays}: stuck. Leave these cells empty, or delete the run"
            findings.append(Finding(severity, recording.name, sensor.channel, message))
    return findings


def check_drives_off(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report, as advice, rests in which a position does not follow its set point."""
    findings = []
    for rest in drives_off(recordings, machine):
        apart = f"{rest.apart:+.4g} {channel_unit(rest.sensor, machine)}"
        message = (
            f"rests in rows {rest.first + 1} to {rest.last + 1}, {apart} from where it rests at this "
            f"{rest.command} otherwise: was the drive off? Identification does not use these rows; "
            "begin the log when the drive is on"
        )
        findings.append(Finding("advice", rest.run, rest.sensor, message))
    return findings


def _ends(outputs: Array) -> tuple[Array, Array]:
    """Return the smallest and the largest measurement of each channel, NaN where it has none."""
    return np.fmin.reduce(outputs, axis=0), np.fmax.reduce(outputs, axis=0)


def _without_ends(outputs: Array, ends: Array, machine: Machine) -> Array:
    """Return outputs (n, sensors) with NaN where one with a fixed zero may be at the end of its range."""
    margin = np.array([max(3 * sensor.noise, sensor.resolution) for sensor in machine.sensors])
    fixed = np.array([not sensor.incremental for sensor in machine.sensors])
    at_end = (outputs <= ends[0] + margin) | (outputs >= ends[1] - margin)
    return np.where(at_end & fixed, np.nan, outputs)


def _longest_stuck_interval(
    recording: Recording, inside: Array, channel: int, ends: Array, noisy: bool, machine: Machine
) -> tuple[float, float, str]:
    """Return duration, s, value and reason of the longest interval with a stuck channel; 0 s if none."""
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
            at_rest = _span_at_rest(recording.inputs[rows], channel, weights, machine)
            allowed = max(_MOVES * float(peak_to_peak(predicted)), at_rest)
            stuck = float(peak_to_peak(predicted[rows])) > allowed and _consistent(
                inside[rows], channel, machine
            )
        else:
            # An encoder has no end of its range, and nothing else shows whether it should have moved.
            at_end = value in ends and ends[0] < ends[1] and not machine.sensors[channel].incremental
            stuck = bool(at_end) and _others_move(recording, channel, rows)
        if stuck:
            return float(seconds[k]), value, "while other channels move"
        if noisy and value not in ends:
            return float(seconds[k]), value, "without the noise that it has at rest"
        if prediction is None and value not in ends and _is_driven(recording.inputs[rows], channel, machine):
            return float(seconds[k]), value, _DRIVEN
    return 0.0, 0.0, ""


def _noisy_at_rest(recordings: Sequence[Recording], machine: Machine) -> NDArray[np.bool_]:
    """Return for each sensor whether hardly any two successive measurements at rest are equal."""
    equal, pairs = np.zeros(len(machine.sensors)), np.zeros(len(machine.sensors))
    for recording in recordings:
        steps = np.diff(recording.outputs[: count_resting_rows(recording, machine)], axis=0)
        equal += np.count_nonzero(steps == 0.0, axis=0)
        pairs += np.count_nonzero(np.isfinite(steps), axis=0)
    return (pairs >= _MIN_PAIRS) & (equal <= _MAX_EQUAL * pairs)


def _is_driven(inputs: Array, channel: int, machine: Machine) -> bool:
    """Return whether a drive pushes the sensor's coordinate both ways, far beyond the declared friction.

    An end stop holds a machine in one direction only. Machines with belts are left out: a carriage at rest
    may stretch them; and so are drives that follow a set point, whose command is no force.
    """
    sensor = machine.sensors[channel]
    if machine.belts or machine.drive_laws or machine.spring_loaded or len(sensor.row) > 1:
        return False
    columns = [j for j, drive in enumerate(machine.drives) if drive.coordinate == sensor.coordinate]
    friction = machine.coordinate(sensor.coordinate).coulomb
    force = sum((machine.drives[j].gain * inputs[:, j] for j in columns), np.zeros(len(inputs)))
    rated = sum(machine.drives[j].gain * machine.drives[j].rated_voltage for j in columns)
    moves = max(_PUSH * friction, _RATED_PUSH * rated)  # force that certainly moves the coordinate
    return bool(columns) and bool(min(np.mean(force > moves), np.mean(force < -moves)) > _MIN_PUSHED)


def _consistent(outputs: Array, channel: int, machine: Machine) -> bool:
    """Return whether the other channels do not contradict each other; True if they are not redundant."""
    others = outputs.copy()
    others[:, channel] = np.nan
    complete = np.isfinite(others) | ~np.isfinite(others).any(axis=0)
    first = int(np.argmax(complete.all(axis=1)))
    return rigid_misfit(others - others[first], machine) < _CONSISTENT


def _span_at_rest(inputs: Array, channel: int, weights: Array, machine: Machine) -> float:
    """Return how much the prediction of a channel may move while its coordinate is held by friction.

    Friction holds the coordinate while belts and drives pull on it, so the belts can stretch by up to the
    friction force in either direction, plus the change of the drives' forces. Noise of the other channels
    adds to it.
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
    return _STRETCH_MARGIN * stretch_span + NOISE_SPAN * float(np.linalg.norm(weights * noise))


def _others_move(recording: Recording, channel: int, rows: slice) -> bool:
    """Return whether any other output moves in an interval by a fraction of its span in the run."""
    others = np.delete(recording.outputs, channel, axis=1)
    in_interval, in_run = peak_to_peak(others[rows]), peak_to_peak(others)
    return bool(np.any((in_interval > _MOVES * in_run) & (in_run > 0.0)))
