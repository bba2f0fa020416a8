"""Loops around a kernel's step: recordings (`rollout`) and control periods (`advance_blocks`).

The functions of a kernel are given by their addresses, and the sizes of a machine by numbers or the shapes of
arrays, so that these loops are compiled once for all machines. They run without the interpreter lock, each on
a range of blocks; a block is `LANES` machines, side by side in the last axis of the arrays.
"""
# mypy: ignore-errors

from __future__ import annotations

import numpy as np

from .blocks import read_block
from .compiled import compiled, compiled_only
from .machine_code import LANES
from .native_calls import call_at


@compiled_only
def _held_mean(time, values, start: float, end: float, hint: int) -> float:
    """Return the mean over [start, end] of an input that is held; the search begins at index `hint`."""
    i = hint
    while i > 0 and time[i] > start:
        i -= 1
    total, reached = 0.0, start
    while True:
        until = end if i + 1 >= time.shape[0] else min(end, time[i + 1])
        if until > reached:
            total += values[i] * (until - reached)
            reached = until
        if reached >= end or i + 1 >= time.shape[0]:
            return total / (end - start)
        i += 1


@compiled_only
def _parabola(time, i: int, delay: float) -> tuple:
    """Return the middle one of three samples, and the weights of its neighbors, at time[i] - delay."""
    if i == 0:
        return 0, 0.0, 0.0
    t = max(time[0], time[i] - delay)
    # at even sampling at most one sample away
    k = max(1, i - 1 - int(min(delay / (time[i] - time[i - 1]), i)))
    while k > 1 and t < 0.5 * (time[k - 1] + time[k]):
        k -= 1
    while k < i - 1 and t > 0.5 * (time[k] + time[k + 1]):
        k += 1
    u, h1 = t - time[k], time[k] - time[k - 1]
    if i == 1:
        return k, -u / h1, 0.0
    h2 = time[k + 1] - time[k]
    return k, u * (u - h2) / (h1 * (h1 + h2)), u * (u + h1) / (h2 * (h1 + h2))


@compiled_only
def _most_steps(time, longest_step: float) -> int:
    """Return the largest number of steps, of at most `longest_step`, s, that an interval needs."""
    steps = 1
    for i in range(time.shape[0] - 1):
        steps = max(steps, int(np.ceil((time[i + 1] - time[i]) / longest_step - 1e-6)))
    return steps


@compiled_only
def _copy_lanes(block: int, row: int, values, table) -> None:
    """Copy values (k, LANES) of a block to one row of its machines in a table (B, rows, k)."""
    first = block * LANES
    # Without a view of the row, which would cost a third of the time of a simulation.
    if first + LANES <= table.shape[0]:  # a constant number of machines: twice as fast
        for lane in range(LANES):
            for k in range(table.shape[2]):
                table[first + lane, row, k] = values[k, lane]
    else:
        for lane in range(table.shape[0] - first):
            for k in range(table.shape[2]):
                table[first + lane, row, k] = values[k, lane]


@compiled_only
def _delay_readings(time, i: int, sensor_delays, past_readings, reading) -> None:
    """Delay each sensor's reading (sensors, LANES) of sample i by a parabola through earlier ones."""
    for j in range(reading.shape[0]):
        for lane in range(reading.shape[1]):
            past_readings[i, j, lane] = reading[j, lane]
    for j in range(reading.shape[0]):
        delay, k, before, after = 0.0, i, 0.0, 0.0
        for lane in range(LANES):
            if sensor_delays[j, lane] != delay:  # machines of a block mostly have the same delay
                delay = sensor_delays[j, lane]
                k, before, after = _parabola(time, i, delay)
            if delay > 0.0:
                previous, middle = past_readings[max(0, k - 1), j, lane], past_readings[k, j, lane]
                following = past_readings[min(k + 1, i), j, lane]
                reading[j, lane] = middle + before * (previous - middle) + after * (following - middle)


@compiled_only
def _inject_outputs(block: int, row: int, measured, gains, reading, innovation, state) -> None:
    """Add gains @ (measured - reading) to the state of a block, as an observer does."""
    for j in range(reading.shape[0]):
        if measured.shape[0] == 1:
            measurement = measured[0, row, j]
            if not np.isfinite(measurement):
                continue
            for lane in range(LANES):
                innovation[j, lane] = measurement - reading[j, lane]
        else:
            for lane in range(LANES):
                measurement = measured[min(block * LANES + lane, measured.shape[0] - 1), row, j]
                innovation[j, lane] = measurement - reading[j, lane] if np.isfinite(measurement) else 0.0
        for k in range(gains.shape[0]):
            gain = gains[k, j]
            if gain != 0.0:  # most sensors correct one coordinate
                for lane in range(LANES):
                    state[k, lane] += gain * innovation[j, lane]


@compiled_only
def _hold_inputs(
    block: int,
    drives_delayed: bool,
    forced: bool,
    time,
    i: int,
    row: int,
    steps: int,
    h: float,
    inputs,
    extra,
    drive_delays,
    voltages,
    external_forces,
) -> None:
    """Set voltages, with delays the means of every step, and external forces until the next sample."""
    for k in range(drive_delays.shape[0]):
        if drives_delayed:
            # Machines of a block mostly have the voltages and the delay of its first one.
            for lane in range(LANES):
                if lane > 0 and inputs.shape[0] == 1 and drive_delays[k, lane] == drive_delays[k, 0]:
                    continue
                u = min(block * LANES + lane, inputs.shape[0] - 1)
                for s in range(steps):
                    begin = time[i] + s * h - drive_delays[k, lane]
                    mean = _held_mean(time, inputs[u, :, k], begin, begin + h, i)
                    if lane == 0:
                        voltages[s * drive_delays.shape[0] + k, :] = mean
                    else:
                        voltages[s * drive_delays.shape[0] + k, lane] = mean
        elif inputs.shape[0] == 1:
            voltage = inputs[0, i, k]
            for lane in range(LANES):
                voltages[k, lane] = voltage
        else:
            for lane in range(LANES):
                voltages[k, lane] = inputs[min(block * LANES + lane, inputs.shape[0] - 1), i, k]
    if forced:
        for k in range(external_forces.shape[0]):
            for lane in range(LANES):
                external_forces[k, lane] = extra[min(block * LANES + lane, extra.shape[0] - 1), row, k]


@compiled
def rollout(
    functions: tuple,
    sizes: tuple,
    flags: tuple,
    time,
    inputs,
    parameters,
    start,
    measured,
    gains,
    offsets,
    extra,
    longest_step: float,
    every: int,
    first: int,
    last: int,
    out,
    readings,
) -> None:
    """Simulate blocks first..last-1 of the B machines over a recording.

    Args:
        functions: Addresses of the kernel's functions, in the order of `kernel_source.FUNCTIONS`.
        sizes: Numbers of coordinates, rows of the state, drives, sensors, parameters and step constants.
        flags: Whether a drive has a delay, a sensor has a delay, and external forces act.
        time: Sample times, s, shape (N,).
        inputs: Voltages, V, shape (1 or B, N, drives), held until the next sample.
        parameters: Machine parameters, SI, shape (B, parameters).
        start: First state without its time: belt travel (radius * angle), m, rate, m/s, effects,
            shape (B, rows - 1).
        measured: Measurements to correct the state, in the sensors' units, shape (1 or B, rows, sensors), NaN
            where missing; or empty.
        gains: Change of travel and its rate per error, m and m/s per m or rad,
            shape (2 * coordinates, sensors).
        offsets: Added to the readings of each machine, in the sensors' units, shape (B, sensors); or empty.
        extra: External forces, N, held until the next row, shape (1 or B, rows, coordinates); used if they
            act.
        longest_step: Largest step of the integrator, s.
        every: Samples from one row of the recording to the next: more than one if voltages change between the
            rows.
        first: First block.
        last: Block after the last one.
        out: Output, first k rows of the state (travel, m; its rate, m/s) in the rows, shape (B, rows, k), or
            empty.
        readings: Output, sensor readings, in the sensors' units, shape (B, rows, sensors); empty if not
            needed.
    """
    prepare, voltage_delays, advance, read_sensors, measurement_delays = functions
    coordinates, rows, drives, sensors, constants, derived_rows = sizes
    drives_delayed, sensors_delayed, forced = flags
    state = np.zeros((rows, LANES))
    block_parameters = np.zeros((constants, LANES))
    derived = np.zeros((derived_rows, LANES))
    drive_delays = np.zeros((drives, LANES))
    sensor_delays = np.zeros((sensors, LANES))
    external_forces = np.zeros((coordinates, LANES))
    reading = np.zeros((sensors, LANES))
    offset = np.zeros((sensors, LANES))
    innovation = np.zeros((sensors, LANES))
    past_readings = np.zeros((time.shape[0] if sensors_delayed else 0, sensors, LANES))
    voltages = np.zeros((drives * _most_steps(time, longest_step) if drives_delayed else drives, LANES))
    for block in range(first, last):
        begin, moving = block * LANES, 2 * coordinates
        read_block(parameters, begin, block_parameters)
        read_block(start[:, :moving], begin, state[:moving])
        state[moving] = time[0]
        read_block(start[:, moving:], begin, state[moving + 1 :])
        if offsets.shape[0] > 0:
            read_block(offsets, begin, offset)
        if drives_delayed:
            call_at(voltage_delays, block_parameters, drive_delays)
        if sensors_delayed:
            call_at(measurement_delays, block_parameters, sensor_delays)
        period, h, steps = -1.0, longest_step, 1
        for i in range(time.shape[0]):
            row, in_row = i // every, i % every == 0
            if in_row:
                _copy_lanes(block, row, state, out)
            if (in_row or sensors_delayed) and (measured.shape[0] > 0 or readings.shape[0] > 0):
                call_at(read_sensors, state, block_parameters, reading)
                if sensors_delayed:
                    _delay_readings(time, i, sensor_delays, past_readings, reading)
                if offsets.shape[0] > 0:
                    for j in range(sensors):
                        for lane in range(LANES):
                            reading[j, lane] += offset[j, lane]
                if in_row:
                    _copy_lanes(block, row, reading, readings)
            if in_row and measured.shape[0] > 0:
                _inject_outputs(block, row, measured, gains, reading, innovation, state)
            if i + 1 == time.shape[0]:
                break
            dt = time[i + 1] - time[i]
            if abs(dt - period) > 1e-6 * dt:
                period = dt
                steps = max(1, int(np.ceil(dt / longest_step - 1e-6)))
                h = dt / steps
                call_at(prepare, block_parameters, derived, h)
            _hold_inputs(
                block,
                drives_delayed,
                forced,
                time,
                i,
                row,
                steps,
                h,
                inputs,
                extra,
                drive_delays,
                voltages,
                external_forces,
            )
            call_at(advance, state, block_parameters, derived, voltages, external_forces, h, steps)


@compiled
def prepare_blocks(prepare: int, parameters, h: float, first: int, last: int, derived) -> None:
    """Compute the constants that a step needs (decay factors, reciprocals, ...) for blocks first..last-1.

    Args:
        prepare: Address of the kernel's function that does this for one block.
        parameters: Machine parameters, SI, shape (blocks, parameters, LANES).
        h: Step of the integrator, s.
        derived: Output: derived constants, SI, shape (blocks, constants, LANES).
    """
    for block in range(first, last):
        call_at(prepare, parameters[block], derived[block], h)


@compiled
def advance_blocks(
    advance: int,
    coordinates: int,
    state,
    parameters,
    derived,
    inputs,
    h: float,
    steps: int,
    first: int,
    last: int,
) -> None:
    """Advance the machines of blocks first..last-1 by some steps with constant voltages, in place.

    Args:
        advance: Address of the kernel's function that does this for one block.
        coordinates: Number of coordinates.
        state: Belt travel (m), its rate (m/s), time (s) and effect states, shape (blocks, rows, LANES).
        parameters: Machine parameters, SI, shape (blocks, parameters, LANES).
        derived: Constants that `prepare_blocks` computes from parameters and h,
            shape (blocks, constants, LANES).
        inputs: Voltages, V, shape (blocks, drives, LANES); if a drive is delayed, one set per step, shape
            (blocks, steps * drives, LANES).
        h: Step of the integrator, s.
        steps: Number of steps.
    """
    no_forces = np.zeros((coordinates, LANES))
    for block in range(first, last):
        call_at(advance, state[block], parameters[block], derived[block], inputs[block], no_forces, h, steps)


@compiled
def read_blocks(read_sensors: int, state, parameters, first: int, last: int, readings) -> None:
    """Compute the readings of blocks first..last-1, without delay.

    Args:
        read_sensors: Address of the kernel's function that does this for one block.
        state: Belt travel (m), its rate (m/s), time (s) and effect states, shape (blocks, rows, LANES).
        parameters: Machine parameters, SI, shape (blocks, parameters, LANES).
        readings: Output, readings without delay, in the sensors' units, shape (blocks, sensors, LANES).
    """
    for block in range(first, last):
        call_at(read_sensors, state[block], parameters[block], readings[block])


@compiled
def delay_blocks(delays: int, parameters, first: int, last: int, out) -> None:
    """Compute the delays of the drives or sensors of blocks first..last-1.

    The generated function at the address `delays` evaluates them.

    Args:
        parameters: Parameters of the machines, SI, shape (blocks, parameters, LANES).
        out: Output, delays, s, shape (blocks, drives or sensors, LANES).
    """
    for block in range(first, last):
        call_at(delays, parameters[block], out[block])
