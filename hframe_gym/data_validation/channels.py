"""Each output channel by itself: blank, stuck, clipped, quantised, noisy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..identification import Dataset
from ..machine import Machine
from ..recordings import Recording
from .findings import Finding
from .rigid_kinematics import from_others

_LONG = 0.1  # s, a channel that stands still for less is not stuck
_MOVES = 0.1  # of its whole span: a channel that should have moved by less may have stood still
_NOISIER = 3.0  # times its declared noise

Array = NDArray[np.float64]


def blank(recording: Recording, machine: Machine) -> list[Finding]:
    """Outputs that were not measured, wholly or in part."""
    found = []
    for channel, values in zip(machine.output_channels, recording.outputs.T, strict=True):
        share = float(np.mean(np.isnan(values)))
        if share == 1.0:
            found.append(Finding("advice", recording.name, channel, "was not measured in this run"))
        elif share:
            message = f"{100 * share:.3g} % of its rows are blank"
            found.append(Finding("note", recording.name, channel, message))
    return found


def stuck(recording: Recording, machine: Machine) -> list[Finding]:
    """Outputs that keep one value while, by the other outputs, they move; at an end of their range: clipped."""
    found = []
    for j, channel in enumerate(machine.output_channels):
        values = recording.outputs[:, j]
        if not np.isfinite(values).any():
            continue
        seconds, value = _longest_still(recording, j, machine)
        if seconds:
            clipped = value in (np.nanmax(values), np.nanmin(values)) and np.nanmax(values) > np.nanmin(values)
            kind = "stays at the end of its range: clipped?" if clipped else "does not move: stuck?"
            message = f"for {seconds:.3g} s, while others move, it {kind} (at {value:.4g})"
            found.append(Finding("fault", recording.name, channel, message))
    return found


def _longest_still(recording: Recording, j: int, machine: Machine) -> tuple[float, float]:
    """Longest time, s, that output j keeps one value while it should move, and that value; 0 s where it never does."""
    values, time_s = recording.outputs[:, j], recording.time_s
    expected = from_others(recording.outputs, j, machine)
    longest, at = 0.0, 0.0
    still = np.concatenate([np.diff(values) == 0.0, [False]])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int))).reshape(-1, 2)
    edges = edges[time_s[edges[:, 1]] - time_s[edges[:, 0]] > _LONG]
    ends = (np.nanmax(values), np.nanmin(values))
    for first, last in edges:
        seconds = float(time_s[last] - time_s[first])
        if seconds <= longest:
            continue
        if expected is not None:
            size = np.nanmax(expected) - np.nanmin(expected)
            part = expected[first : last + 1]
            moved = bool(np.isfinite(part).any() and np.nanmax(part) - np.nanmin(part) > _MOVES * size > 0)
        else:
            moved = bool(values[first] in ends and ends[0] > ends[1]) and _others_move(recording, j, first, last)
        if moved:
            longest, at = seconds, float(values[first])
    return longest, at


def _others_move(recording: Recording, j: int, first: int, last: int) -> bool:
    """Whether any other output moves by a share of its span between two rows."""
    for k in range(recording.outputs.shape[1]):
        whole, part = recording.outputs[:, k], recording.outputs[first : last + 1, k]
        if k != j and np.isfinite(part).any():
            size = np.nanmax(whole) - np.nanmin(whole)
            if size > 0 and np.nanmax(part) - np.nanmin(part) > _MOVES * size:
                return True
    return False


def resolution(data: Dataset, machine: Machine) -> list[Finding]:
    """Noise and quantum of each channel beside what the machine declares."""
    found = []
    for j, sensor in enumerate(machine.sensors):
        if not any(np.isfinite(run.outputs[:, j]).any() for run in data.runs):
            continue
        noise, quantum = float(data.noise[j]), float(data.quantum[j])
        unit = machine.coordinate(next(iter(sensor.row))).unit("position")
        steps = f", steps of {quantum:.3g} {unit}" if quantum else ""
        declared = max(sensor.noise, sensor.resolution / np.sqrt(12))
        message = f"noise {noise:.3g} {unit}{steps} (declared: noise {sensor.noise:.3g}, steps {sensor.resolution:.3g})"
        louder = declared > 0 and noise > _NOISIER * declared
        found.append(Finding("advice" if louder else "note", "", sensor.channel, message))
    return found


def motionless(recording: Recording, data: Dataset, machine: Machine) -> list[Finding]:
    """A run in which nothing moves by more than its sensors' noise and steps."""
    spans = []
    for j in range(len(machine.sensors)):
        values = recording.outputs[:, j]
        if np.isfinite(values).any():
            spans.append((np.nanmax(values) - np.nanmin(values)) / max(data.noise[j] * 8, data.quantum[j] * 2, 1e-15))
    if spans and max(spans) > 1.0:
        return []
    return [Finding("advice", recording.name, "", "nothing moves in this run: it tells the sensors' noise and no more")]


def all_of(recordings: Sequence[Recording], data: Dataset, machine: Machine) -> list[Finding]:
    """Everything there is to say of the channels, run by run."""
    found = resolution(data, machine)
    for recording in recordings:
        still = motionless(recording, data, machine)
        found += blank(recording, machine) + (still or stuck(recording, machine))
    return found
