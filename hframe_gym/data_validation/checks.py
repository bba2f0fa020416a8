"""Check recordings before identification: clock, sensors, wiring, excitation and parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..identification import Dataset
from ..machine import Machine
from ..preparation.clock.regular_clock import with_regular_clock
from ..preparation.runs.left_out import copied_runs, short_runs
from ..preparation.runs.moving import runs_that_should_move, turns_steadily
from ..preparation.sensors.noise import noise_at_rest
from ..preparation.session import prepare_within_ranges
from ..preparation.start.rest import InitialRest, without_moving_start
from ..preparation.usable import usable_run
from ..recordings import (
    Recording,
    jumps_between_ends,
    peak_to_peak,
    shared_wraps,
    without_outliers,
    without_repetitions,
    without_shared_wraps,
    without_silences,
    without_wraps,
    wraps_of,
)
from .current_timing import check_currents
from .excitation import check_excitation, constant_inputs
from .findings import Finding, Severity, channel_unit
from .identifiability import check_parameters
from .input_noise import check_input_noise
from .origins import check_origins
from .run_signs import check_signs_of_runs
from .runs_apart import check_inputs_of_runs, check_rates, check_travel_of_runs
from .sampling import (
    check_input_timing,
    check_sampling,
    check_voltages_between_rows,
    overlapping_clocks,
    sampling_rate,
    slow_sensors,
    times_in_milliseconds,
)
from .scales import check_scales
from .speeds import check_computed_speeds, check_speeds, check_speeds_in_parts
from .starts import check_power, check_starts
from .stuck_outputs import NOISE_SPAN, check_drives_off, stuck_outputs
from .swapped_drives import check_swapped_currents, check_swapped_set_points
from .wiring import check_wiring

_MIN_JUMPS = 2  # a single one may be a step, or a connection that was lost meanwhile
_MIN_REST = 0.05  # s; a shorter rest hardly determines the initial state and the sensors' zeros
_REST_TOLERANCE = 1e-6  # s; times in a file are rounded
# Fraction of a channel's span in all runs; a run without input that moves by more has lost its input.
_MOVES = 0.1
_ROUNDED = 1.01  # times the rounding error; a sensor with less noise has none beside it
_MORE_NOISE = 3.0  # ratio of measured to declared noise above which the noise is reported as advice


def check_recordings(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Check recordings of a machine before identification.

    The checks cover the clock, the timing of the voltages, the rest before the motion, the sensors (noise,
    outliers, wrapped, empty, stuck or clipped channels), the wiring (signs, swapped channels, units, gear
    ratios), starts from rest against a command, the excitation, and the precision with which parameters can
    be estimated. A run that is too short gets one finding of severity "advice" and no checks. If the times of
    a run appear to be in milliseconds, only this is reported.

    Returns:
        Findings (severity, run, channel, message) sorted by severity: faults first, then advice, then notes.
    """
    recordings, too_short = _without_short_runs(recordings)
    if wrong_times := times_in_milliseconds(recordings):
        return wrong_times
    recordings, wrapped = _with_shared_wraps(recordings, machine)
    cleaned, rests, data, moving = _prepared(recordings, machine)
    findings = [
        *too_short,
        *wrapped,
        sampling_rate(recordings),
        *overlapping_clocks(recordings),
        *check_origins(recordings, machine),
        *_sensor_noise(data, machine),
    ]
    for copy, reason in copied_runs(recordings).items():
        findings.append(Finding("advice", copy, "", f"{reason}: it is not used"))
    if data.jitter:
        findings.append(Finding("note", "", "time_s", f"the clock {data.describe_jitter()}"))
    findings += _faults_and_advice(recordings, cleaned, rests, data, moving, machine)
    silent = runs_that_should_move(data, machine, moving)
    for recording, rest in zip(cleaned, rests, strict=True):
        findings += _short_rest(recording, rest, data) + _unmeasured_outputs(recording, machine)
        if not _moves(recording, data, machine):
            message = "nothing moves in this run: it only determines the noise of the sensors"
            if recording.name in silent:
                message = (
                    f"nothing moves in this run, although {silent[recording.name]} "
                    "starts to move with no more: was the sensor read, and was the drive on? It is not fitted"
                )
            findings.append(Finding("advice", recording.name, "", message))
    findings += check_excitation(cleaned, data, machine)
    if moving:
        findings += check_parameters(data.with_runs(moving), machine)
    return _by_severity(findings)


def check_before_fit(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Find faults in recordings that make a fit meaningless, and defects that impair it.

    `hframe identify` calls this function first. It makes those checks of `check_recordings` that concern the
    quality of the data: clock, slow sensors, wraps, outliers, motion without input, inputs that never change
    or are logged late, stuck or clipped outputs, wiring (signs, swapped channels, units, gear ratios), speeds
    that contradict positions, and starts from rest against a command. It does not check whether the
    excitation suffices.

    Returns:
        Findings (severity, run, channel, message): first those of severity "fault", which make a fit
        meaningless, then those of severity "advice".
    """
    recordings, too_short = _without_short_runs(recordings)
    if wrong_times := times_in_milliseconds(recordings):
        return wrong_times
    recordings, wrapped = _with_shared_wraps(recordings, machine)
    cleaned, rests, data, moving = _prepared(recordings, machine)
    findings = too_short + wrapped + _faults_and_advice(recordings, cleaned, rests, data, moving, machine)
    findings += constant_inputs(recordings, machine)
    return _by_severity([finding for finding in findings if finding.severity != "note"])


def _with_shared_wraps(
    recordings: Sequence[Recording], machine: Machine
) -> tuple[Sequence[Recording], list[Finding]]:
    """Return the runs without wraps that only other runs show, and advice on angles that jump."""
    advice = _shared_wraps(recordings, machine) + _unknown_turns(recordings, machine)
    return without_shared_wraps(recordings, machine), advice


def _without_short_runs(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Finding]]:
    """Return the runs without those that are too short for identification, and advice on these."""
    short = short_runs(recordings)
    advice = [Finding("advice", run, "time_s", f"{reason}: it is not used") for run, reason in short.items()]
    return [recording for recording in recordings if recording.name not in short], advice


def _prepared(
    recordings: Sequence[Recording], machine: Machine
) -> tuple[list[Recording], list[InitialRest], Dataset, list[str]]:
    """Return the runs without outliers, their rests, the runs prepared for a fit, and moving runs' names."""
    runs = [usable_run(recording, machine) for recording in recordings]
    cleaned, rests = [run.measured for run in runs], [run.rest for run in runs]
    data, _ = prepare_within_ranges([run.usable for run in runs], machine)
    moving = [
        recording.name
        for recording in cleaned
        if _moves(recording, data, machine) and len(recording.time_s) > 2
    ]
    return cleaned, rests, data, moving


def _faults_and_advice(
    recordings: Sequence[Recording],
    cleaned: Sequence[Recording],
    rests: Sequence[InitialRest],
    data: Dataset,
    moving: Sequence[str],
    machine: Machine,
) -> list[Finding]:
    """Check sensors, sampling, motion without input, stuck outputs, wiring and the timing of inputs.

    The runs are given as recorded, without outliers (`cleaned`, with their `rests`), and prepared for a fit
    (`data`).
    """
    findings = slow_sensors([without_wraps(recording, machine) for recording in recordings], machine)
    for recording in recordings:
        continuous = without_wraps(recording, machine)
        regular, jitter_s = with_regular_clock(continuous, machine)
        findings += check_sampling(regular, jitter_s) + _wraps(recording, machine)
        distinct = without_repetitions(continuous)
        plausible = without_outliers(distinct, machine)
        findings += _outliers(distinct, plausible, machine) + _silences(plausible, machine)
    findings += _motion_without_input(cleaned, rests, machine) + check_input_noise(recordings, machine)
    if not moving:
        message = "nothing moves in any run: are the drives powered and the sensors connected?"
        return [*findings, Finding("fault", "", "", message)]
    moved = [recording for recording in cleaned if recording.name in moving]
    findings += check_rates(moved) + check_inputs_of_runs(data.with_runs(moving), machine)
    findings += _position_checks(moved, data, machine) + check_speeds(moved, machine)
    findings += check_drives_off(moved, machine) + check_power(moved, data, machine)
    findings += check_speeds_in_parts(moved, machine) + check_computed_speeds(moved, machine)
    if not any(finding.severity == "fault" for finding in findings):
        findings += check_swapped_set_points(data.with_runs(moving).runs, machine)
    if not any(finding.severity == "fault" for finding in findings):
        findings += check_starts(moved, data, machine)
    if not any(finding.severity == "fault" for finding in findings):
        findings += check_signs_of_runs(data.with_runs(moving).runs, machine)
    if any(finding.severity == "fault" for finding in findings):
        return findings  # a fit would be meaningless
    moving_data = data.with_runs(moving)
    if swapped := check_swapped_currents(moving_data.runs, machine):
        return findings + swapped
    late = check_input_timing(moving_data, machine)
    if any(finding.severity == "fault" for finding in late):
        return findings + late  # currents belong to the voltages of their own rows then, and rightly so
    return (
        findings
        + check_currents(moved, machine)
        + (late or check_voltages_between_rows(moving_data, machine))
    )


def _position_checks(recordings: Sequence[Recording], data: Dataset, machine: Machine) -> list[Finding]:
    """Check stuck outputs, wiring and scales of the sensors of positions, by the kinematics."""
    of_position = machine.position_sensors
    if not of_position.any():
        return []
    positions = data.with_runs([recording.name for recording in recordings])
    if not of_position.all():
        sensors = [sensor for sensor in machine.sensors if sensor.of_position]
        others = [sensor.channel for sensor in machine.sensors if not sensor.of_position]
        machine = machine.replace(
            sensors=tuple(sensors), effects=tuple(e for e in machine.effects if e.site not in others)
        )
        recordings = [dataclasses.replace(r, outputs=r.outputs[:, of_position]) for r in recordings]
        usable = [without_moving_start(recording, machine) for recording in recordings]
        positions, _ = prepare_within_ranges(usable, machine)
    stuck = stuck_outputs(recordings, machine)
    positions = _without_stuck_outputs(positions, stuck, machine)
    apart = check_travel_of_runs(positions, machine)
    if apart:
        # Swapped sensors move by other ratios in each run as well. Otherwise a run has another unit, and all
        # runs together would have the scale of none.
        wiring = check_wiring(positions, machine)
        swapped = [finding for finding in wiring if finding.severity == "fault" and not finding.run]
        return stuck + (swapped or apart)
    return stuck + check_wiring(positions, machine) + check_scales(positions, machine)


def _without_stuck_outputs(data: Dataset, stuck: Sequence[Finding], machine: Machine) -> Dataset:
    """Return runs without the measurements of sensors that are certainly stuck, whose travel has no scale."""
    faults = {(finding.run, finding.channel) for finding in stuck if finding.severity == "fault"}
    runs = []
    for run in data.runs:
        columns = [(run.name, channel) in faults for channel in machine.output_channels]
        runs.append(dataclasses.replace(run, outputs=np.where(columns, np.nan, run.outputs)))
    return dataclasses.replace(data, runs=tuple(runs))


def _wraps(recording: Recording, machine: Machine) -> list[Finding]:
    """Report the angles and counters of one run that wrap."""
    return [
        Finding("advice", recording.name, channel, wrap.describe(channel_unit(channel, machine)))
        for channel, wrap in wraps_of(recording, machine).items()
    ]


def _shared_wraps(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report the angles and counters of some runs that wrap as in other runs."""
    return [
        Finding("advice", run, channel, f"{wrap.describe(channel_unit(channel, machine))}, as in other runs")
        for (run, channel), wrap in shared_wraps(recordings, machine).items()
    ]


def _unknown_turns(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report angles that jump from one end of their values to the other, by no turn that is known."""
    shared = shared_wraps(recordings, machine)
    findings = []
    for j, sensor in enumerate(machine.sensors):
        if not sensor.of_position or machine.coordinate(sensor.coordinate).kind != "rotary":
            continue
        values = [recording.outputs[:, j] for recording in recordings]
        measured = np.concatenate([each[np.isfinite(each)] for each in values])
        if not len(measured):
            continue
        low, high = float(measured.min()), float(measured.max())
        unit = channel_unit(sensor.channel, machine)
        for recording, each in zip(recordings, values, strict=True):
            known = (recording.name, sensor.channel) in shared or sensor.channel in wraps_of(
                recording, machine
            )
            jumps = None if known else jumps_between_ends(each, low, high)
            if jumps is None or len(jumps.rows) < _MIN_JUMPS:
                continue
            message = (
                f"jumps {len(jumps.rows)} times between the ends of its values, the first time in row "
                f"{jumps.rows[0] + 1} (from {jumps.before:.4g} to {jumps.after:.4g} {unit}), which no motion "
                "does, and by no turn that is known: does the sensor turn through a dead angle? If its unit "
                'is right, declare it as "absolute-angle", which makes its turns of 2 pi rad continuous; '
                "otherwise correct its unit or scale"
            )
            findings.append(Finding("advice", recording.name, sensor.channel, message))
    return findings


def _by_severity(findings: Sequence[Finding]) -> list[Finding]:
    """Return findings sorted by severity."""
    order = ("fault", "advice", "note")
    return sorted(findings, key=lambda finding: order.index(finding.severity))


def _motion_without_input(
    recordings: Sequence[Recording], rests: Sequence[InitialRest], machine: Machine
) -> list[Finding]:
    """Report runs in which the machine moves before the first input, or without any."""
    spans = peak_to_peak(np.concatenate([recording.outputs for recording in recordings]))
    findings = []
    for recording, rest in zip(recordings, rests, strict=True):
        if not rest.moving.any():
            continue
        names = [
            channel for channel, moving in zip(machine.output_channels, rest.moving, strict=True) if moving
        ]
        severity: Severity = "advice"
        if not np.any(recording.inputs) and np.any(
            (peak_to_peak(recording.outputs) > _MOVES * spans)[rest.moving]
        ):
            severity = "fault"
        message = _describe_motion(recording, rest, names, machine)
        findings.append(Finding(severity, recording.name, "", message))
    return findings


def _describe_motion(recording: Recording, rest: InitialRest, names: Sequence[str], machine: Machine) -> str:
    """Return a sentence about the motion of some sensors without input, and what to do about it."""
    sensors = f"{', '.join(names)} move{'s' if len(names) == 1 else ''}"
    inputs = " and ".join(machine.input_channels)
    if not np.any(recording.inputs):
        return (
            f"{sensors} while {inputs} {'is' if len(machine.drives) == 1 else 'are'} 0 throughout: "
            "the voltage was not logged, or something else moved the machine. "
            "Correct the column, or delete the run"
        )
    if rest.lead_s:
        return (
            f"{sensors} {1e3 * rest.lead_s:.0f} ms or more before the first input: is {inputs} logged late, "
            "or did something else move the machine? A fit needs the voltage at the time at which it acts"
        )
    if rest.first:
        milliseconds = 1e3 * float(recording.time_s[rest.first] - recording.time_s[0])
        return (
            f"the machine still moves when the run begins: the first {milliseconds:.0f} ms are not used. "
            "Let it come to rest before the recording"
        )
    return (
        "the machine moves before the first input, "
        "so its initial velocity is estimated from the first measurements. "
        "Let it come to rest before the recording, unless a force or an offset of the voltage moves it"
    )


def _short_rest(recording: Recording, rest: InitialRest, data: Dataset) -> list[Finding]:
    """Report a run that begins in motion, or whose rest is too short for the start and the sensors' zeros.

    A run that begins with an input but without motion, as under closed-loop control, has a known initial
    state.
    """
    if rest.moving.any():
        return []  # reported by `_motion_without_input`
    if rest.rows == 1:
        if not any(run.initial.velocity.any() for run in data.runs if run.name == recording.name):
            return []
        message = (
            "begins in motion, so the initial velocity is estimated from the first measurements: "
            "begin the recording at rest if you can"
        )
        return [Finding("advice", recording.name, "", message)]
    seconds = float(recording.time_s[rest.rows - 1] - recording.time_s[0])
    if seconds >= _MIN_REST - _REST_TOLERANCE:
        return []
    message = (
        f"{rest.rows} rows ({1e3 * seconds:.3g} ms) at rest before the first input: "
        "initial state and zeros of the encoders are uncertain"
    )
    return [Finding("advice", recording.name, "", message)]


def _sensor_noise(data: Dataset, machine: Machine) -> list[Finding]:
    """Report noise and quantum of each channel beside the declared values."""
    findings = []
    for j, sensor in enumerate(machine.sensors):
        if not any(np.isfinite(run.outputs[:, j]).any() for run in data.runs):
            continue
        noise, quantum = float(data.noise[j]), float(data.quantum[j])
        unit = machine.sensor_unit(sensor)
        steps = f", steps of {quantum:.3g} {unit}" if quantum else ""
        declared = max(sensor.noise, sensor.resolution / np.sqrt(12))
        message = (
            f"noise {noise:.3g} {unit}{steps} (declared: noise {sensor.noise:.3g}, "
            f"steps {sensor.resolution:.3g})"
        )
        rounded = noise <= _ROUNDED * quantum / np.sqrt(12)
        resting_rows = [run.initial.resting_rows for run in data.runs]
        at_rest = noise_at_rest([run.outputs[:, j] for run in data.runs], resting_rows)
        if not sensor.noise and not rounded and at_rest is None:
            message += ", estimated during motion: too few rows are at rest"
        severity: Severity = "advice" if 0 < _MORE_NOISE * declared < noise else "note"
        findings.append(Finding(severity, "", sensor.channel, message))
    return findings


def _unmeasured_outputs(recording: Recording, machine: Machine) -> list[Finding]:
    """Report outputs with empty cells."""
    findings = []
    for channel, values in zip(machine.output_channels, recording.outputs.T, strict=True):
        fraction = float(np.mean(np.isnan(values)))
        if fraction == 1.0:
            message = "was not measured in this run; if there is no such sensor, leave it out of machine.json"
            findings.append(Finding("advice", recording.name, channel, message))
        elif fraction:
            findings.append(
                Finding("note", recording.name, channel, f"{100 * fraction:.3g} % of its rows are empty")
            )
    return findings


def _silences(recording: Recording, machine: Machine) -> list[Finding]:
    """Report how long each channel of one run without outliers repeated a value because no new one came."""
    kept = np.isfinite(without_silences(recording, machine).outputs)
    removed = np.isfinite(recording.outputs) & ~kept  # (n, sensors)
    findings = []
    for channel, values, rows in zip(machine.output_channels, recording.outputs.T, removed.T, strict=True):
        if rows.any():
            present = np.flatnonzero(np.isfinite(values))
            seconds = float(np.diff(recording.time_s[present])[rows[present[:-1]]].sum())
            first = int(np.argmax(rows))
            message = (
                f"repeats a value from row {first + 1} ({values[first]:.4g}) on, "
                f"{seconds:.2g} s in all, and goes on where the motion has arrived meanwhile: "
                "was the connection lost? These rows are excluded, as if these cells were empty"
            )
            findings.append(Finding("advice", recording.name, channel, message))
    return findings


def _moves(recording: Recording, data: Dataset, machine: Machine) -> bool:
    """Return whether any channel moves by more than its noise and quantum, or shows a steady speed."""
    moved = peak_to_peak(recording.outputs) > np.maximum(NOISE_SPAN * data.noise, 2 * data.quantum)
    return bool(moved.any()) or turns_steadily(recording.outputs, data.noise, machine)


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
