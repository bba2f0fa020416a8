"""Check recordings before identification: clock, sensors, wiring, excitation and parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..dynamics import stiffness_matrix
from ..identification import Dataset, estimate_initial_state, prepare
from ..machine import Machine
from ..recordings import Recording, bridge_blanks, only_measurements, without_repetitions
from .excitation import check_excitation, check_parameters, constant_inputs
from .findings import Finding, Severity
from .sampling import check_sampling, overlapping_clocks, sampling_rate, slow_sensors, times_in_milliseconds
from .wiring import check_wiring, rigid_misfit, rigid_prediction

Array = NDArray[np.float64]

_MIN_REST = 0.05  # s; a shorter rest hardly determines the initial state and the sensors' zeros
_REST_TOLERANCE = 1e-6  # s; times in a file are rounded
_STUCK_AFTER = 0.1  # s; a channel that is constant for a shorter time is not stuck
_LONGEST_BLANK = 0.02  # s; longer times between two measurements are not bridged
_MOVES = 0.1  # fraction of a channel's span in the run; a channel that should have moved by less may have been at rest
_STRETCH_MARGIN = 2.0  # factor by which the declared friction, drives and stiffness may be wrong
_NOISE_SPAN = 8.0  # peak-to-peak noise in standard deviations
_MORE_NOISE = 3.0  # ratio of measured to declared noise above which the noise is reported as advice
_CONSISTENT = 0.3  # fraction of the motion; other channels that contradict each other by more prove nothing


def check_recordings(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Check recordings of a machine before identification.

    The checks cover the clock, the rest before the motion, the sensors (noise, outliers, empty, stuck or clipped
    channels), the wiring (signs, swapped channels, units, gear ratios), the excitation, and the precision with which
    parameters can be estimated. If the times of a run appear to be in milliseconds, only this is reported.

    Args:
        recordings: Runs of the machine (times, voltages, measurements), at least one.
        machine: Machine as declared, before identification.

    Returns:
        Findings (severity, run, channel, message) sorted by severity: faults first, then advice, then notes.
    """
    if wrong_times := times_in_milliseconds(recordings):
        return wrong_times
    cleaned = [only_measurements(recording, machine) for recording in recordings]
    data = prepare(cleaned, machine)
    moving = [recording.name for recording in cleaned if _moves(recording, data) and len(recording.time_s) > 2]
    findings = [sampling_rate(recordings), *overlapping_clocks(recordings), *_sensor_noise(data, machine)]
    findings += _faults_and_advice(recordings, cleaned, data, moving, machine)
    for recording in cleaned:
        findings += _check_initial_rest(recording, machine) + _unmeasured_outputs(recording, machine)
        if not _moves(recording, data):
            message = "nothing moves in this run: it only determines the noise of the sensors"
            findings.append(Finding("advice", recording.name, "", message))
    findings += check_excitation(cleaned, data, machine)
    if moving:
        findings += check_parameters(data.with_runs(moving), machine)
    return _by_severity(findings)


def check_before_fit(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Find faults in recordings that make a fit meaningless, and defects that impair it.

    `hframe identify` calls this function first. It makes those checks of `check_recordings` that concern the quality of
    the data: clock, inputs that never change, outliers, stuck or clipped outputs, and wiring (signs, swapped channels,
    units, gear ratios). It does not check whether the excitation suffices.

    Args:
        recordings: Runs of the machine (times, voltages, measurements), at least one.
        machine: Machine as declared, before identification.

    Returns:
        Findings (severity, run, channel, message): first those of severity "fault", which make a fit meaningless, then
        those of severity "advice".
    """
    if wrong_times := times_in_milliseconds(recordings):
        return wrong_times
    cleaned = [only_measurements(recording, machine) for recording in recordings]
    data = prepare(cleaned, machine)
    moving = [recording.name for recording in cleaned if _moves(recording, data) and len(recording.time_s) > 2]
    findings = _faults_and_advice(recordings, cleaned, data, moving, machine) + constant_inputs(recordings, machine)
    return _by_severity([finding for finding in findings if finding.severity != "note"])


def _faults_and_advice(
    recordings: Sequence[Recording],
    cleaned: Sequence[Recording],
    data: Dataset,
    moving: Sequence[str],
    machine: Machine,
) -> list[Finding]:
    """Check slow sensors, sampling, outliers, stuck outputs and wiring.

    The runs are given as recorded, without outliers (`cleaned`), and prepared for a fit (`data`).
    """
    findings = slow_sensors(recordings, machine)
    for recording, without in zip(recordings, cleaned, strict=True):
        findings += check_sampling(recording) + _outliers(without_repetitions(recording), without, machine)
    if not moving:
        message = "nothing moves in any run: are the drives powered and the sensors connected?"
        return [*findings, Finding("fault", "", "", message)]
    findings += _stuck_outputs([recording for recording in cleaned if recording.name in moving], machine)
    return findings + check_wiring(data.with_runs(moving), machine)


def _by_severity(findings: Sequence[Finding]) -> list[Finding]:
    """Return findings sorted by severity."""
    order = ("fault", "advice", "note")
    return sorted(findings, key=lambda finding: order.index(finding.severity))


def _check_initial_rest(recording: Recording, machine: Machine) -> list[Finding]:
    """Report a run that does not begin at rest long enough to determine the initial state and the sensors' zeros."""
    rows = estimate_initial_state(recording, machine).resting_rows
    seconds = float(recording.time_s[min(rows, len(recording.time_s)) - 1] - recording.time_s[0])
    if seconds >= _MIN_REST - _REST_TOLERANCE:
        return []
    rest = f"{rows} rows ({1e3 * seconds:.3g} ms) at rest before the first input"
    if rows == 1:
        rest = "begins with an input, so only its first row counts as at rest"
    return [Finding("advice", recording.name, "", f"{rest}: initial state and zeros of the encoders are uncertain")]


def _sensor_noise(data: Dataset, machine: Machine) -> list[Finding]:
    """Report noise and quantum of each channel beside the declared values."""
    findings = []
    for j, sensor in enumerate(machine.sensors):
        if not any(np.isfinite(run.outputs[:, j]).any() for run in data.runs):
            continue
        noise, quantum = float(data.noise[j]), float(data.quantum[j])
        unit = machine.coordinate(sensor.coordinate).unit("position")
        steps = f", steps of {quantum:.3g} {unit}" if quantum else ""
        declared = max(sensor.noise, sensor.resolution / np.sqrt(12))
        message = f"noise {noise:.3g} {unit}{steps} (declared: noise {sensor.noise:.3g}, steps {sensor.resolution:.3g})"
        severity: Severity = "advice" if 0 < _MORE_NOISE * declared < noise else "note"
        findings.append(Finding(severity, "", sensor.channel, message))
    return findings


def _unmeasured_outputs(recording: Recording, machine: Machine) -> list[Finding]:
    """Report outputs with empty cells."""
    findings = []
    for channel, values in zip(machine.output_channels, recording.outputs.T, strict=True):
        fraction = float(np.mean(np.isnan(values)))
        if fraction == 1.0:
            findings.append(Finding("advice", recording.name, channel, "was not measured in this run"))
        elif fraction:
            findings.append(Finding("note", recording.name, channel, f"{100 * fraction:.3g} % of its rows are empty"))
    return findings


def _moves(recording: Recording, data: Dataset) -> bool:
    """Return whether any channel moves by more than its noise and quantum."""
    for values, noise, quantum in zip(recording.outputs.T, data.noise, data.quantum, strict=True):
        if np.isfinite(values).any() and np.nanmax(values) - np.nanmin(values) > max(_NOISE_SPAN * noise, 2 * quantum):
            return True
    return False


def _outliers(recording: Recording, cleaned: Recording, machine: Machine) -> list[Finding]:
    """Report the number of outliers of each channel of one run, which are NaN in the cleaned run."""
    findings = []
    mask = np.isfinite(recording.outputs) & np.isnan(cleaned.outputs)  # (n, sensors)
    for channel, values, outliers in zip(machine.output_channels, recording.outputs.T, mask.T, strict=True):
        if outliers.any():
            row = int(np.argmax(outliers))
            number = f"{outliers.sum()} outliers, the first" if outliers.sum() > 1 else "an outlier"
            message = f"{number} in row {row + 1} ({values[row]:.4g}): excluded, as if these cells were empty"
            findings.append(Finding("advice", recording.name, channel, message))
    return findings


def _stuck_outputs(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report outputs that keep one value while they should move.

    If this value is the smallest or the largest over all runs, a sensor with a fixed zero may have reached the end of
    its range (advice), which identification handles. Otherwise the channel is stuck (fault).
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
