"""All runs of a session, prepared for a fit: gaps filled, initial states, zeros, noise estimated."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..errors import merge_run_warnings
from ..line_log import LineLog
from ..machine import Machine
from ..recordings import Recording, fill_gaps, shared_wraps, without_shared_wraps
from .clock.jitter import clock_jitter, noise_by_row
from .dataset import Dataset, PreparedRecording
from .forces.contradicted_sensors import without_contradictions
from .forces.drive_signs import turned_coordinates, with_turned
from .inputs.clock_voltages import clock_voltages
from .runs.without_power import WithoutPower, with_power, without_power
from .sensors.drive_off import DriveOff, without_drives_off
from .sensors.noise import independent_values, sensor_noise, sensor_quantum
from .sensors.saturation import Range, without_saturated
from .sensors.unmeasured_positions import without_unmeasured_positions
from .session_zeros import common_encoder_zeros
from .start.measured_state import estimate_initial_state
from .start.modeled_state import measured_initial_state
from .start.sensor_zeros import free_zeros, has_zero
from .usable import from_first_measurement, usable_run, without_unknown_voltage

_TURNED = (
    "A positive command moves {} against the direction in which its sensors count: "
    "with positive inertia and friction, the motion follows from the commands only that way round. "
    "The machines here count its sensors the other way (negative factors in `row`)."
)


class Session(NamedTuple):
    """Runs of a session as they can be fitted.

    Attributes:
        machine: Machine as declared, but with the directions of the drives that the runs show, and without
            sensors of positions if no run measures any.
        recordings: The runs as logged, from their first measurement on if they do not begin at rest, and
            unwrapped where only other runs tell how a sensor wraps. Without beginnings and ends in which the
            drives have no effect. If a drive was off, or two sensors contradict each other, without unusable
            measurements.
        usable: The recordings without unusable measurements, but with those at the end of a sensor's range.
        data: The runs prepared for a fit, without measurements at the end of a sensor's range.
        ranges: Ranges of the sensors that saturate, m or rad, by channel.
        statements: A sentence about sensors that are left out, and about each coordinate whose drive turns
            the other way than declared.
    """

    machine: Machine
    recordings: Sequence[Recording]
    usable: list[Recording]
    data: Dataset
    ranges: dict[str, Range]
    statements: tuple[str, ...] = ()


def prepare_session(recordings: Sequence[Recording], machine: Machine, log: LineLog) -> Session:
    """Prepare all runs of a session for a fit, and log what is not used.

    Position sensors without any measurement are left out, and measurements are unwrapped and cleaned
    (`usable_run`). Rows are left out in which a drive seems to be off (`without_drives_off`,
    `without_power`), and one of a speed and a position that contradict each other
    (`without_contradictions`). The sensors of coordinates that their drives move against the declared
    direction are turned.

    Args:
        recordings: Runs as logged.
        machine: Machine as declared.
        log: Called with a line of text for everything that is left out, unwrapped or turned, once for each.
    """
    log = _once(log)
    recordings, machine, statements = without_unmeasured_positions(recordings, machine)
    for statement in statements:
        log(statement)
    for (run, channel), wrap in shared_wraps(recordings, machine).items():
        unit = machine.sensor_unit(machine.sensor(channel))
        log(f"{run}: {channel} {wrap.describe(unit)}, as in other runs")
    recordings = without_shared_wraps(recordings, machine)
    begun = [from_first_measurement(recording, machine) for recording in recordings]
    for before, after in zip(recordings, begun, strict=True):
        if after is not before:
            count = len(before.time_s) - len(after.time_s)
            log(f"{before.name}: begins with its first measurement; rows not used: {count}")
    recordings = begun
    session = _prepared(recordings, machine, log)._replace(statements=statements)
    followed, off = without_drives_off(session.usable, machine)
    for rest in off:
        times = _interval(rest, followed)
        log(f"{rest.run}: {rest.sensor} is not used {times}: it does not follow {rest.command}")
    if off:
        recordings = [from_first_measurement(recording, machine) for recording in followed]
        session = _prepared(recordings, machine, log)._replace(statements=statements)
    dead = without_power(session.usable, session.data.noise, session.data.quantum, machine)
    powered = with_power(recordings, dead)
    shorter = {after.name for before, after in zip(recordings, powered, strict=True) if after is not before}
    for part in (part for part in dead if part.run in shorter):
        times = _interval(part, recordings)
        log(f"{part.run}: not used {times}: {' and '.join(part.commands)} without effect")
    if shorter:
        recordings = powered
        session = _prepared(recordings, machine, log)._replace(statements=statements)
    consistent, contradictions = without_contradictions(session.usable, session.data.runs, machine)
    if contradictions:
        recordings, machine, unmeasured = without_unmeasured_positions(consistent, machine)
        for statement in (*contradictions, *unmeasured):
            log(statement)
        statements = (*statements, *contradictions, *unmeasured)
        session = _prepared(recordings, machine, log)._replace(statements=statements)
    turned = turned_coordinates(machine, session.data.runs)
    if not turned:
        return session
    of_turned = tuple(map(_TURNED.format, turned))
    for statement in of_turned:
        log(statement)
    turned_machine = with_turned(machine, turned)
    session = _prepared(recordings, turned_machine, log)
    return session._replace(statements=(*statements, *of_turned))


def _once(log: LineLog) -> LineLog:
    """Return a log that passes on each line once: what is found changes how the session is prepared again."""
    known: set[str] = set()

    def logged(line: str) -> None:
        if line not in known:
            known.add(line)
            log(line)

    return logged


def _interval(part: DriveOff | WithoutPower, recordings: Sequence[Recording]) -> str:
    """Return from when to when a part of a run lasts; its rows may have other numbers than in the log."""
    [time_s] = [recording.time_s for recording in recordings if recording.name == part.run]
    return f"from {time_s[part.first]:.6g} s to {time_s[part.last]:.6g} s"


def _prepared(recordings: Sequence[Recording], machine: Machine, log: LineLog) -> Session:
    """Prepare all runs of a session with the directions of the drives of this machine."""
    usable = [usable_run(recording, machine, log).usable for recording in recordings]
    data, ranges = prepare_within_ranges(usable, machine)
    if ranges:
        log(f"saturated at the end of the range: {', '.join(ranges)}")
    if data.jitter:
        log(f"the clock {data.describe_jitter()}")
    for warning in merge_run_warnings((run.name, w) for run in data.runs for w in run.initial.warnings):
        log(f"warning: {warning}")
    return Session(machine, recordings, usable, data, ranges)


def prepare_within_ranges(usable: Sequence[Recording], machine: Machine) -> tuple[Dataset, dict[str, Range]]:
    """Prepare recordings like `prepare`, without the measurements at the ends of the sensors' ranges.

    Args:
        usable: Runs without other unusable measurements, see `usable_run`.
        machine: Machine as declared.

    Returns:
        Data set, and the ranges of the sensors that saturate, as `without_saturated` finds them.
    """
    data = prepare(usable, machine)
    inside, ranges = without_saturated(usable, machine, data.noise)
    return (prepare(inside, machine) if ranges else data), ranges


def prepare(recordings: Sequence[Recording], machine: Machine) -> Dataset:
    """Prepare recordings for a fit: fill gaps, and estimate initial states and properties of the sensors.

    Args:
        recordings: Runs of one rig, at least one.
        machine: Machine with the rig's coordinates, belts and sensors.

    Returns:
        Data set with one prepared recording per run: its initial state, and its measurements minus the
        sensors' zeros, in the sensors' units, shape (n, sensors). For all runs: noise and quantization step
        of each sensor, in the sensors' units, shape (sensors,), and the zeros of the encoders that have the
        same one in all runs.
    """
    filled = [without_unknown_voltage(fill_gaps(recording), machine) for recording in recordings]
    channels = [[recording.outputs[:, j] for recording in filled] for j in range(len(machine.sensors))]
    quanta = np.array(
        [sensor_quantum(c, s.resolution) for c, s in zip(channels, machine.sensors, strict=True)]
    )
    # Each run is estimated alone, which shows the encoders with the same zero in all runs, then again with
    # these zeros.
    separate = [estimate_initial_state(recording, machine) for recording in filled]
    zeros = common_encoder_zeros(separate, machine, quanta)
    initial = [
        measured_initial_state(r, machine, zeros, quanta, s) for r, s in zip(filled, separate, strict=True)
    ]
    rows = [state.resting_rows for state in initial]
    noise = np.array(
        [
            sensor_noise(channel, rows, quantum, sensor.noise)
            for channel, quantum, sensor in zip(channels, quanta, machine.sensors, strict=True)
        ]
    )
    jitter = _common_jitter(filled, machine, noise)
    of_position = [sensor.of_position for sensor in machine.sensors]
    runs = tuple(
        PreparedRecording(
            name=run.name,
            time_s=run.time_s,
            inputs=run.inputs,
            outputs=run.outputs - state.zeros,
            initial=state,
            noise=noise_by_row(run.time_s, run.outputs, noise, jitter),
            weights=independent_values(run.time_s, run.outputs, quanta),
            # Exact, because `fill_gaps` keeps the recorded times.
            dropped=np.isin(run.time_s, recorded.time_s, invert=True),
            clock_voltages=clock_voltages(run.time_s, run.inputs, run.outputs[:, of_position]),
        )
        for recorded, run, state in zip(recordings, filled, initial, strict=True)
    )
    return Dataset(runs, noise, quanta, free_zeros(machine), zeros, jitter, has_zero(machine))


def _common_jitter(recordings: Sequence[Recording], machine: Machine, noise: Array) -> float:
    """Return the jitter of the clock, s: the smallest of all encoders or, if none measured, of all sensors.

    Encoders resolve the jitter best. The smallest estimate is used, because vibration at one sensor looks
    like jitter.
    """
    channels = {j: [r.outputs[:, j] for r in recordings] for j in range(len(machine.sensors))}
    measured = [j for j, channel in channels.items() if any(np.isfinite(values).any() for values in channel)]
    measured = [j for j in measured if machine.sensors[j].of_position]
    encoders = [j for j in measured if machine.sensors[j].incremental]
    times = [r.time_s for r in recordings]
    return min((clock_jitter(times, channels[j], noise[j]) for j in encoders or measured), default=0.0)


def with_all_measurements(data: Dataset, recordings: Sequence[Recording]) -> Dataset:
    """Copy a data set with the measurements at the ends of sensors' ranges, which a fit leaves out.

    Args:
        data: Data set prepared from recordings whose saturated measurements were replaced by NaN.
        recordings: The same recordings with these measurements; recordings of other runs are ignored.

    Returns:
        Copy with all measurements minus the estimated zeros of the sensors.

    Raises:
        KeyError: If the recording of a run is missing.
    """
    outputs = {r.name: fill_gaps(r).outputs for r in recordings}
    runs = (
        dataclasses.replace(
            run,
            outputs=outputs[run.name] - run.initial.zeros,
            weights=independent_values(run.time_s, outputs[run.name], data.quantum),
        )
        for run in data.runs
    )
    return dataclasses.replace(data, runs=tuple(runs))
