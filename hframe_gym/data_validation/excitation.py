"""Check excitation: motion, speeds and spectra of the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..dynamics import belt_modes
from ..identification import Dataset
from ..machine import DRIVE_KINDS, Machine, rigid_motions
from ..recordings import Recording, bridge_blanks, comparison_window, peak_to_peak
from .findings import Finding, channel_unit, command_in_words
from .stuck_outputs import NOISE_SPAN
from .wiring import sensor_motions

_OVERVOLTAGE = 1.2  # times the rated voltage, above which the column's unit is doubted
# Fraction of a coordinate's range; less does not determine effects that depend on position.
_NARROW_TRAVEL = 0.3
_WIDE_TRAVEL = 1.05  # fraction of a coordinate's range; more contradicts the declared range
# Fraction of the moving time in the rarer direction that direction-dependent friction requires.
_ONE_SIDED = 0.15
_SLOW = 0.1  # fraction of the top speed; motion below is slow
_SLOW_TIME = 0.05  # fraction of the moving time that should be slow, to determine friction at low speed
_MOVING = 0.01  # fraction of the top speed; motion below is rest
_WINDOW = 0.02  # s, time over which speed is measured at least
_TOP_PERCENTILE = 99  # percentile of the speeds that counts as top speed; the maximum would be noise
_MIN_SPECTRUM_ROWS = 9  # rows of a run; the spectrum of a shorter one has hardly any frequencies
_MODE_MARGIN = 0.7  # fraction of the lowest belt frequency; power above it excites the belts
_MODE_POWER = 1e-3  # fraction of the total power that should be near or above the lowest belt frequency


@dataclass(frozen=True)
class _MeasuredMotion:
    """Motion of the leading coordinate of a rigid motion, of all runs one after the other.

    Attributes:
        travel: Positions, m or rad, NaN where a sensor did not measure, shape (rows,).
        speed: Speeds, m/s or rad/s, shape (differences,).
        noise: Noise or quantization step of the travel, whichever is larger, m or rad.
    """

    travel: Array
    speed: Array
    noise: float

    @property
    def span(self) -> float:
        """Difference between the largest and the smallest position, m or rad."""
        return float(peak_to_peak(self.travel))

    @property
    def moves(self) -> bool:
        """Whether the travel is more than the noise of the sensors."""
        return self.span > NOISE_SPAN * self.noise


def check_excitation(recordings: Sequence[Recording], data: Dataset, machine: Machine) -> list[Finding]:
    """Check whether inputs and motion are rich enough for identification.

    Advice is given where

    - an input is constant in a run, or exceeds 1.2 times the rated value;
    - the drive force along a rigid motion does not exceed the Coulomb friction in both directions;
    - a coordinate travels through less than 30 % or more than 105 % of its declared range;
    - less than 15 % of its motion is in one of the directions, or less than 5 % is slower than a tenth of its
      top speed;
    - less than 0.1 % of the power of an input is above 0.7 times the lowest natural frequency of the belts.

    In other cases, notes state force, travel, speeds and spectrum.

    Returns:
        Findings (severity, run, channel, message). A finding about a constant input names its run; each of
        the others concerns all runs together.
    """
    findings = constant_inputs(recordings, machine) + _overvoltage(recordings, machine)
    if rigid_motions(machine):
        motions = _measured_motions(data, machine)
        findings += _amplitude(recordings, motions, machine) + _coverage(motions, machine)
    return findings + _frequencies(recordings, machine)


def constant_inputs(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report, as advice, inputs that are constant in a run: the drive was not used or not logged.

    An input that is zero throughout a run is not reported if it changes in another run, because runs in which
    a drive is off are useful.
    """
    used = np.any([np.ptp(recording.inputs, axis=0) > 0.0 for recording in recordings], axis=0)
    return [
        Finding(
            "advice",
            recording.name,
            drive.channel,
            f"never changes, it is {command_in_words(float(values[0]), drive, machine)} throughout",
        )
        for recording in recordings
        for column, (drive, values) in enumerate(zip(machine.drives, recording.inputs.T, strict=True))
        if np.ptp(values) == 0.0 and (values[0] != 0.0 or not used[column])
    ]


def _overvoltage(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report inputs far above the rated voltage."""
    findings = []
    for column, drive in enumerate(machine.drives):
        largest = max(float(np.abs(recording.inputs[:, column]).max()) for recording in recordings)
        if largest > _OVERVOLTAGE * drive.rated_voltage:
            unit = channel_unit(drive.channel, machine)
            rated = f"rated {drive.rated_voltage:.4g} {unit}"
            kind = DRIVE_KINDS.get(drive.kind)
            doubt = "is the column in another unit or in %?"
            if kind.command in ("position", "speed"):
                doubt = (
                    f"is the column in another unit, or rated_{kind.command} of the machine file too small?"
                )
            if kind.fraction:  # no duty cycle exceeds 1
                doubt = "is the supply in another unit, or the rated voltage of the machine file too small?"
            message = f"reaches {largest:.4g} {unit}, {rated}: {doubt}"
            findings.append(Finding("advice", "", drive.channel, message))
    return findings


def _amplitude(
    recordings: Sequence[Recording], motions: Mapping[str, _MeasuredMotion], machine: Machine
) -> list[Finding]:
    """Report the drive force relative to Coulomb friction along each rigid motion, forward and backward."""
    if machine.drive_laws:  # their force also depends on the motion
        return []
    coulomb = np.array([c.coulomb for c in machine.coordinates])
    findings = []
    for name, motion in rigid_motions(machine).items():
        friction = float(np.abs(motion) @ coulomb)
        if friction == 0.0:
            continue
        gains = np.array(
            [d.gain * motion[machine.coordinate_names.index(d.coordinate)] for d in machine.drives]
        )
        ratio = np.concatenate([r.inputs @ gains for r in recordings]) / friction  # (rows of all runs,)
        high, low = float(ratio.max()), float(ratio.min())
        above = 100 * float(np.mean(np.abs(ratio) > 1.0))
        message = (
            f"drive force {low:+.3g} to {high:+.3g} times Coulomb friction, "
            f"above it {above:.0f} % of the time"
        )
        if max(high, -low) < 1.0:
            verdict = "it never breaks away"
            if name in motions and motions[name].moves:
                inputs = [d.channel for d, gain in zip(machine.drives, gains, strict=True) if gain]
                distance = f"{motions[name].span:.4g} {machine.coordinate(name).unit('position')}"
                verdict = (
                    f"by the machine file it never breaks away, but it moves by {distance}: "
                    f"is {' or '.join(inputs)} in another unit, or is the gain "
                    "of the drive or the Coulomb friction of the file wrong?"
                )
            findings.append(Finding("advice", "", name, f"{message}: {verdict}"))
        elif min(high, -low) < 1.0:
            findings.append(Finding("advice", "", name, f"{message}: in one direction only"))
        else:
            findings.append(Finding("note", "", name, message))
    return findings


def _frequencies(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report the spectrum of each input relative to the machine's lowest belt mode.

    What excites the belts is a force. A set point's power says little about it: a position has hardly any at
    the modes, although its accelerations excite them.
    """
    findings = []
    belts = belt_modes(machine)
    for column, drive in enumerate(machine.drives):
        channel, modes = drive.channel, [] if drive.law else belts
        grids, powers = [], []
        for recording in recordings:
            values = recording.inputs[:, column] - recording.inputs[:, column].mean()
            if len(values) >= _MIN_SPECTRUM_ROWS and np.any(values):
                period = float(np.median(np.diff(recording.time_s)))
                grids.append(np.fft.rfftfreq(len(values), period))
                powers.append(
                    np.abs(np.fft.rfft(values * np.hanning(len(values)))) ** 2 * period / len(values)
                )
        if not grids:
            continue
        frequency, power = np.concatenate(grids), np.concatenate(powers)
        order = np.argsort(frequency)
        frequency, power_below = frequency[order], np.cumsum(power[order])
        half, most = (
            float(frequency[np.searchsorted(power_below, p * power_below[-1])]) for p in (0.5, 0.95)
        )
        message = f"half of its power is below {half:.3g} Hz, 95 % below {most:.3g} Hz"
        fraction = power_below / power_below[-1]
        below_mode = float(np.interp(modes[0] * _MODE_MARGIN, frequency, fraction)) if modes else 0.0
        if modes and 1 - below_mode < _MODE_POWER:
            message += (
                f"; almost none near the lowest belt mode ({modes[0]:.1f} Hz): belts are poorly identifiable"
            )
            findings.append(Finding("advice", "", channel, message))
        else:
            findings.append(Finding("note", "", channel, message))
    return findings


def _measured_motions(data: Dataset, machine: Machine) -> dict[str, _MeasuredMotion]:
    """Return the motion that all runs together measure along each rigid motion; {} if no sensors tell it."""
    M = sensor_motions(machine)  # (sensors, motions)
    names = list(rigid_motions(machine))
    travels: list[Array] = []
    speeds: list[Array] = []
    noise = np.zeros(len(names))  # of the travel along each motion
    for run in data.runs:
        measured = np.isfinite(run.outputs).any(axis=0) & M.any(axis=1)  # sensors of positions
        if np.linalg.matrix_rank(M[measured]) < len(names) or len(run.time_s) < 3:
            continue
        span = comparison_window(run.outputs[:, measured], run.time_s, _WINDOW)
        bridged = bridge_blanks(run.outputs, run.time_s, span)
        # A row counts only if all sensors measure in it. Those that pause, as lasers at the end of their
        # range do, are not needed where the others determine the motion.
        rows = np.isfinite(bridged).sum(axis=0)
        steady = measured & (rows == rows[measured].max())
        if np.linalg.matrix_rank(M[steady]) == len(names):
            measured = steady
        size = np.linalg.norm(M[measured], axis=1)
        outputs = bridged[:, measured]
        weights = np.linalg.pinv(M[measured] / size[:, None]) / size  # (motions, sensors)
        travel = outputs @ weights.T  # (n, motions)
        noise = np.fmax(noise, np.abs(weights) @ np.fmax(data.noise, data.quantum)[measured])
        period = float(np.median(np.diff(run.time_s)))
        window = max(1, min(len(travel) - 1, round(span / period)))
        elapsed = run.time_s[window:] - run.time_s[:-window]
        travels.append(travel)
        speeds.append((travel[window:] - travel[:-window]) / elapsed[:, None])
    return {
        name: _MeasuredMotion(
            np.concatenate([t[:, k] for t in travels]),
            np.concatenate([s[:, k] for s in speeds]),
            float(noise[k]),
        )
        for k, name in enumerate(names if travels else ())
    }


def _coverage(motions: Mapping[str, _MeasuredMotion], machine: Machine) -> list[Finding]:
    """Report travel, speeds, directions and slow motion along each rigid motion."""
    findings = []
    for name, motion in motions.items():
        findings += _check_travel(name, motion.travel, machine)
        findings += _check_speed(name, motion.speed, machine)
    return findings


def _check_travel(name: str, travel: Array, machine: Machine) -> list[Finding]:
    """Report the travel of a coordinate relative to its range."""
    coordinate = machine.coordinate(name)
    low, high = float(np.fmin.reduce(travel)), float(np.fmax.reduce(travel))
    if np.isnan(low):  # the channels never measure together
        return []
    message = f"travels from {low:.4g} to {high:.4g} {coordinate.unit('position')}"
    if coordinate.range is None:
        return [Finding("note", "", name, message)]
    fraction = (high - low) / (coordinate.range[1] - coordinate.range[0])
    if fraction > _WIDE_TRAVEL:
        return [
            Finding("advice", "", name, f"{message}, more than its declared range {list(coordinate.range)}")
        ]
    message += f", {100 * fraction:.0f} % of its range"
    if fraction < _NARROW_TRAVEL:
        message += ": effects that depend on position are poorly identifiable"
        return [Finding("advice", "", name, message)]
    return [Finding("note", "", name, message)]


def _check_speed(name: str, speed: Array, machine: Machine) -> list[Finding]:
    """Report speeds of a coordinate, and whether it moves in both directions and slowly."""
    speed = speed[np.isfinite(speed)]
    if len(speed) == 0:
        return []
    unit = machine.coordinate(name).unit("speed")
    top = float(np.percentile(np.abs(speed), _TOP_PERCENTILE))
    moving = speed[np.abs(speed) > _MOVING * top]
    if top == 0.0 or len(moving) == 0:
        return []
    backward = float(np.mean(moving < 0))
    slow = float(np.mean(np.abs(moving) < _SLOW * top))
    message = f"speeds up to {top:.3g} {unit}, {100 * slow:.0f} % of the motion below a tenth of it"
    findings = [Finding("note", "", name, message)]
    if min(backward, 1 - backward) < _ONE_SIDED:
        direction, percent = ("backward" if backward > 0.5 else "forward"), 100 * max(backward, 1 - backward)
        message = (
            f"moves {direction} {percent:.0f} % of the time: "
            "direction-dependent friction is poorly identifiable"
        )
        findings.append(Finding("advice", "", name, message))
    if slow < _SLOW_TIME:
        message = (
            f"only {100 * slow:.1f} % of the motion is slow: friction at low speed is poorly identifiable"
        )
        findings.append(Finding("advice", "", name, message))
    return findings
