"""Check recordings before identification: clock, sensors, wiring, excitation and parameters."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..dynamics import stiffness_matrix
from ..identification import Dataset, estimate_initial_state, prepare
from ..machine import Machine
from ..recordings import GAP_PERIODS, Recording
from .excitation import check_excitation, check_parameters, constant_inputs
from .findings import Finding, Severity
from .wiring import check_wiring, rigid_prediction

Array = NDArray[np.float64]

_JITTER = 0.02  # of the period; standard deviation above which sampling is irregular
_SAME_RATE = 1.02  # ratio of sampling periods up to which runs have one rate
_MIN_REST = 0.05  # s at rest that determine the initial state and the sensors' zeros
_STUCK_AFTER = 0.1  # s; a channel that is constant for a shorter time is not stuck
_MOVES = 0.1  # of its span in the run; a channel that should have moved by less may have been at rest
_STRETCH_MARGIN = 2.0  # friction and stiffness are as declared, which may be wrong by this factor
_NOISE_SPAN = 8.0  # peak-to-peak noise in standard deviations
_MORE_NOISE = 3.0  # times the declared noise


def check_recordings(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Check recordings of a machine before identification.

    The checks cover the clock, the rest before the motion, sensors (noise, empty, stuck or clipped channels), wiring
    (signs, swapped channels, units, ratios), excitation, and the precision with which parameters can be estimated.

    Args:
        recordings: Runs of the machine, at least one.
        machine: Declared machine.

    Returns:
        Findings sorted by severity: faults first, then advice, then notes.
    """
    data = prepare(recordings, machine)
    findings = [_sampling_rate(recordings), *_overlapping_clocks(recordings), *_sensor_noise(data, machine)]
    moving = []
    for recording in recordings:
        findings += _check_sampling(recording) + _check_initial_rest(recording, machine)
        findings += _unmeasured_outputs(recording, machine)
        if not _moves(recording, data):
            message = "nothing moves in this run: it only determines the noise of the sensors"
            findings.append(Finding("advice", recording.name, "", message))
            continue
        findings += _stuck_outputs(recording, machine)
        if len(recording.time_s) > 2:
            moving.append(recording.name)
    findings += check_excitation(recordings, data, machine)
    if moving:
        findings += check_wiring(data.with_runs(moving), machine) + check_parameters(data.with_runs(moving), machine)
    order = ("fault", "advice", "note")
    return sorted(findings, key=lambda finding: order.index(finding.severity))


def recording_warnings(recording: Recording, machine: Machine) -> list[Finding]:
    """Check a single recording: irregular sampling, inputs that never change, outputs that are stuck or clipped.

    Args:
        recording: Run of the machine.
        machine: Declared machine.

    Returns:
        Findings of severity "fault" or "advice"; notes are left out.
    """
    findings = [
        *_check_sampling(recording),
        *constant_inputs([recording], machine),
        *_stuck_outputs(recording, machine),
    ]
    return [finding for finding in findings if finding.severity != "note"]


def _check_sampling(recording: Recording) -> list[Finding]:
    """Report lost samples and irregular sampling of one run."""
    steps = np.diff(recording.time_s)
    if len(steps) == 0:
        return [Finding("fault", recording.name, "time_s", "has a single row, which contains no motion")]
    findings = []
    period = float(np.median(steps))
    gaps = steps > GAP_PERIODS * period
    if gaps.any():
        lost = float(np.sum(steps[gaps]) - np.sum(gaps) * period)  # s
        message = (
            f"{int(gaps.sum())} gaps ({1e3 * lost:.3g} ms in total, {100 * lost / np.sum(steps):.2g} %): samples were "
            "dropped, and the inputs in the gaps are unknown"
        )
        findings.append(Finding("advice", recording.name, "time_s", message))
    jitter = float(np.std(steps[~gaps]))
    if jitter > _JITTER * period:
        message = f"sampling is irregular, {1e3 * period:.4g} ms with a jitter of {1e3 * jitter:.2g} ms"
        findings.append(Finding("advice", recording.name, "time_s", message))
    return findings


def _sampling_rate(recordings: Sequence[Recording]) -> Finding:
    """Report number, duration and sampling rate of the runs."""
    periods = [float(np.median(np.diff(r.time_s))) for r in recordings if len(r.time_s) > 1]
    seconds = sum(float(r.time_s[-1] - r.time_s[0]) for r in recordings)
    low, high = min(periods, default=np.nan), max(periods, default=np.nan)
    rate = f"{1 / low:.4g} Hz" if high <= _SAME_RATE * low else f"{1 / high:.4g} to {1 / low:.4g} Hz"
    return Finding("note", "", "time_s", f"{len(recordings)} runs, {seconds:.4g} s in total, sampled at {rate}")


def _overlapping_clocks(recordings: Sequence[Recording]) -> list[Finding]:
    """Report runs that overlap in time: their clocks were restarted."""
    ordered = sorted(recordings, key=lambda recording: recording.time_s[0])
    overlapping = [b.name for a, b in pairwise(ordered) if b.time_s[0] < a.time_s[-1]]
    if not overlapping:
        return []
    message = (
        f"{len(overlapping)} runs overlap in time: the clock restarts, so a drift over the session cannot be identified"
    )
    return [Finding("note", "", "time_s", message)]


def _check_initial_rest(recording: Recording, machine: Machine) -> list[Finding]:
    """Report a run that does not begin at rest long enough to determine the initial state and the sensors' zeros."""
    rows = estimate_initial_state(recording, machine).resting_rows
    seconds = float(recording.time_s[min(rows, len(recording.time_s)) - 1] - recording.time_s[0])
    if seconds >= _MIN_REST:
        return []
    message = (
        f"{rows} rows ({1e3 * seconds:.3g} ms) at rest before the first input: the initial state and the zeros of the "
        "encoders are uncertain"
    )
    return [Finding("advice", recording.name, "", message)]


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


def _stuck_outputs(recording: Recording, machine: Machine) -> list[Finding]:
    """Report outputs that keep one value while they should move; at an end of their span they are clipped."""
    findings = []
    for j, channel in enumerate(machine.output_channels):
        values = recording.outputs[:, j]
        if not np.isfinite(values).any():
            continue
        seconds, value = _longest_stuck_interval(recording, j, machine)
        if seconds:
            at_end = value in (np.nanmax(values), np.nanmin(values)) and np.nanmax(values) > np.nanmin(values)
            state = "stays at the end of its span: clipped?" if at_end else "does not move: stuck?"
            message = f"for {seconds:.3g} s, while other channels move, it {state} (at {value:.4g})"
            findings.append(Finding("fault", recording.name, channel, message))
    return findings


def _longest_stuck_interval(recording: Recording, channel: int, machine: Machine) -> tuple[float, float]:
    """Return duration, s, and value of the longest interval in which a channel is stuck; 0 s if there is none."""
    values, time_s = recording.outputs[:, channel], recording.time_s
    prediction = rigid_prediction(recording.outputs, channel, machine)
    ends = (np.nanmax(values), np.nanmin(values))
    constant = np.concatenate([np.diff(values) == 0.0, [False]])
    intervals = np.flatnonzero(np.diff(np.concatenate([[False], constant, [False]]).astype(int))).reshape(-1, 2)
    longest, longest_value = 0.0, 0.0
    for first, last in intervals:
        seconds = float(time_s[last] - time_s[first])
        if seconds <= max(longest, _STUCK_AFTER):
            continue
        rows = slice(first, last + 1)
        if prediction is not None:
            predicted, weights = prediction
            allowed = max(
                _MOVES * float(np.nanmax(predicted) - np.nanmin(predicted)),
                _span_at_rest(recording.inputs[rows], channel, weights, machine),
            )
            stuck = _span(predicted[rows]) > allowed
        else:
            # An encoder has no end of its range, and nothing else shows whether it should have moved.
            at_end = values[first] in ends and ends[0] > ends[1] and not machine.sensors[channel].incremental
            stuck = bool(at_end) and _others_move(recording, channel, rows)
        if stuck:
            longest, longest_value = seconds, float(values[first])
    return longest, longest_value


def _span(values: Array) -> float:
    """Return the peak-to-peak value of the measured rows, 0 if there are none."""
    return float(np.nanmax(values) - np.nanmin(values)) if np.isfinite(values).any() else 0.0


def _span_at_rest(inputs: Array, channel: int, weights: Array, machine: Machine) -> float:
    """Return how much the prediction of a channel may move while its coordinate is held by friction.

    Friction holds the coordinate while belts and drive pull on it, so the belts can stretch by up to the friction force
    in either direction, plus the change of the drive's force. Noise of the other channels adds to it.
    """
    sensor = machine.sensors[channel]
    index = machine.coordinate_names.index(sensor.coordinate)
    force_span = 2 * machine.coordinates[index].coulomb
    for drive, voltages in zip(machine.drives, inputs.T, strict=True):
        if drive.coordinate == sensor.coordinate:
            force_span += drive.gain * float(np.ptp(voltages))
    stiffness = stiffness_matrix(machine)[index, index]
    stretch_span = abs(sensor.row[sensor.coordinate]) * force_span / stiffness if stiffness else 0.0
    noise = np.array([max(s.noise, s.resolution) for s in machine.sensors])
    return _STRETCH_MARGIN * stretch_span + _NOISE_SPAN * float(np.linalg.norm(weights * noise))


def _others_move(recording: Recording, channel: int, rows: slice) -> bool:
    """Return whether any other output moves in an interval by a fraction of its span in the run."""
    others = [k for k in range(recording.outputs.shape[1]) if k != channel]
    spans = [(_span(recording.outputs[rows, k]), _span(recording.outputs[:, k])) for k in others]
    return any(in_interval > _MOVES * in_run > 0 for in_interval, in_run in spans)
