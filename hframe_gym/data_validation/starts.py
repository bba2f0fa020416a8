"""Find starts from rest that contradict the commands: against the drive, or none although it pushes.

A start against the drive shows a command without a sign or with the wrong one.

Where a machine rests without a command, friction holds all other forces, so that no command can start it in
the other direction. Springs and weights, which the machine file may lack, do not matter then. In a steady
motion they do: a hoist lowers its load against its motor.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Times
from ..identification import Dataset
from ..machine import Machine
from ..preparation.runs.without_power import without_power
from ..recordings import Recording, peak_to_peak
from .findings import Finding
from .stuck_outputs import NOISE_SPAN

_MIN_REST = 0.05  # s, without a command; a shorter one may be the reversal of a motion
# Fraction of the channel's span in all runs, or of its largest speed, that is a motion: not the recoil of a
# gear or the reaction of a swinging payload.
_STARTED = 0.1
# Of a run's starts. A log without signs of a machine that moves to and fro has half of them against the
# command; fewer may be pushes by hand.
_AGAINST = 0.5


def check_power(recordings: Sequence[Recording], data: Dataset, machine: Machine) -> list[Finding]:
    """Report, as advice, beginnings and ends of runs in which commands have no effect.

    Args:
        recordings: Runs without outliers in which something moves, at least one.
        data: All runs prepared for a fit, for the noise of the sensors.
        machine: Machine as declared.
    """
    findings, by_name = [], {recording.name: recording for recording in recordings}
    for part in without_power(recordings, data.noise, data.quantum, machine):
        time_s = by_name[part.run].time_s
        end_s = time_s[part.last + 1] if part.first == 0 else time_s[part.first]
        message = (
            f"does not move {part.coordinate} in rows {part.first + 1} to {part.last + 1} ({part.pushes} "
            "starts), although commands that are not larger start it elsewhere: was the amplifier off? "
            f"Identification does not use these rows; cut the log at {end_s:.6g} s of this run "
            "(hframe import FILE --cut FROM:TO)"
        )
        findings.append(Finding("advice", part.run, " and ".join(part.commands), message))
    return findings


class Start(NamedTuple):
    """A start from rest.

    Attributes:
        time_s: Time of the last row at rest, s.
        along: Whether the motion has the direction of the drives' force.
    """

    time_s: float
    along: bool


def check_starts(recordings: Sequence[Recording], data: Dataset, machine: Machine) -> list[Finding]:
    """Report runs in which at least half of a coordinate's starts from rest are against its drives.

    It is a fault for voltages and duty cycles. For currents and torques it is advice, because a brake that
    opens lets a weight sink against the torque. Two cases are not checked: machines with belts, where other
    motors move a coordinate as well, and drives whose force is not in proportion to their command.

    Args:
        recordings: Runs without outliers in which something moves, at least one.
        data: All runs prepared for a fit, for the noise of the sensors.
        machine: Machine as declared.
    """
    if machine.belts or machine.drive_laws:
        return []
    outputs = np.concatenate([recording.outputs for recording in recordings])
    of_speed = np.array([sensor.of_velocity for sensor in machine.sensors], np.bool_)
    largest = np.where(of_speed, np.abs(np.nan_to_num(outputs)).max(axis=0), peak_to_peak(outputs))
    findings = []
    for recording in recordings:
        for j, sensor in enumerate(machine.sensors):
            drives = [drive for drive in machine.drives if drive.coordinate == sensor.coordinate]
            if len(sensor.row) > 1 or not sensor.has_direction or not drives:
                continue
            force = recording.inputs @ [drive.gain if drive in drives else 0.0 for drive in machine.drives]
            values = np.sign(sensor.row[sensor.coordinate]) * recording.outputs[:, j]
            resting = max(NOISE_SPAN * float(data.noise[j]), 2.0 * float(data.quantum[j]))
            moving = max(_STARTED * float(largest[j]), 2.0 * resting)
            starts = list(starts_from_rest(recording.time_s, force, values, resting, moving))
            against = [start.time_s for start in starts if not start.along]
            if not against or len(against) < _AGAINST * len(starts):
                continue
            inputs = " and ".join(drive.channel for drive in drives)
            message = (
                f"starts from rest against {inputs}, the first time at {against[0]:.4g} s ({len(against)} of "
                f"{len(starts)} starts): was the magnitude of {inputs} logged without its sign, "
                "or is the sign of one column wrong? Correct the columns of the file, or leave out the run"
            )
            of_voltage = all(drive.command == "voltage" for drive in drives)
            if not of_voltage:
                message += ". Where a brake opens, a weight may sink so"
            findings.append(
                Finding("fault" if of_voltage else "advice", recording.name, sensor.channel, message)
            )
            break
    return findings


def starts_from_rest(
    time_s: Times, force: Array, values: Array, resting: float, moving: float
) -> Iterator[Start]:
    """Yield the starts of motion in a run, each from a rest without drive force.

    A start counts if three conditions hold: the force does not change its sign until the motion has reached
    the size `moving`; the rest before it has lasted at least as long as this, so that no slow motion from
    before passes for a start; and nothing moved the other way since the force began, because a wheel that is
    stopped may spring back.

    Args:
        force: Force of the drives, N or Nm, shape (n,).
        values: Positions or speeds in the direction of the force, m, rad, m/s or rad/s, NaN where not
            measured, shape (n,).
        resting: Largest change of the values at rest, in their unit.
        moving: Smallest change of the values that counts as a motion, in their unit, more than `resting`.

    Yields:
        Time of the last row at rest, s, and whether the motion has the direction of the force.
    """
    idle = np.concatenate([[False], force == 0.0, [False]]).astype(int)
    last = -1  # row in which the previous start reached its size
    for first, end in zip(np.flatnonzero(np.diff(idle) > 0), np.flatnonzero(np.diff(idle) < 0), strict=True):
        measured = first + np.flatnonzero(np.isfinite(values[first:end]))
        if end == len(force) or not len(measured):
            continue
        direction = np.sign(force[end])
        opposite = np.flatnonzero(np.sign(force[end:]) == -direction)
        until = end + opposite[0] if len(opposite) else len(force)
        change = values[:until] - values[measured[-1]]
        reached = end + np.flatnonzero(np.abs(change[end:]) >= moving)
        if not len(reached) or reached[0] == last:
            continue
        last = int(reached[0])
        left = int(np.flatnonzero(np.abs(change[:last]) <= resting)[-1])  # the last row at rest
        disturbed = first + np.flatnonzero(np.abs(change[first:end]) > resting)
        begin = disturbed[-1] + 1 if len(disturbed) else first
        if np.any(-np.sign(change[last]) * change[end:left] > resting):
            continue
        long_enough = time_s[measured[-1]] - time_s[begin] >= _MIN_REST
        if long_enough and time_s[left] - time_s[begin] >= time_s[last] - time_s[left]:
            yield Start(float(time_s[left]), bool(np.sign(change[last]) == direction))
