"""Loops around a kernel's step: recordings (`rollout`) and control periods (`advance_blocks`).

These functions are templates. `kernel` appends their text to the generated functions of a machine's shape, so that
Numba inlines and caches them together. They run without the interpreter lock, each on a range of blocks; a block
is `LANES` machines, side by side in the last axis of the arrays.
"""
# mypy: ignore-errors

from __future__ import annotations

import numpy as np

from .simd import LANES

# The generated module sets these names; they are here for readers and for the linter.
COORDINATES = STATES = INPUTS = SENSORS = PARAMETERS = DERIVED = 0
DELAYED = LAGGED = FORCED = False
prepare = voltage_delays = advance = read_sensors = measurement_delays = None


def held_mean(time, values, start: float, end: float, hint: int) -> float:
    """Return the mean over [start, end] of an input that is held from each time until the next.

    Args:
        time: Sample times, s, ascending, shape (n,).
        values: Input at the samples, any unit, shape (n,); the first value also acts before the first sample.
        start: Start of the interval, s.
        end: End of the interval, s, later than `start`; it may be later than the last sample.
        hint: Index of the sample at which the search for the start of the interval begins; any index is allowed.

    Returns:
        Mean value, in the unit of `values`.
    """
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


def parabola(time, i: int, delay: float) -> tuple:
    """Return weights that interpolate a delayed value of a signal by a parabola through three of its samples.

    Args:
        time: Sample times, s, ascending, shape (n,).
        i: Index of the present sample; later ones are not used. With two samples (i = 1) the interpolation is linear.
        delay: Time before the present sample, s; times before the first sample count as that sample.

    Returns:
        Index k of the middle sample, weight a of sample k - 1 and weight b of sample k + 1; sample k has 1 - a - b.
    """
    if i == 0:
        return 0, 0.0, 0.0
    t = max(time[0], time[i] - delay)
    k = max(1, i - 1 - int(min(delay / (time[i] - time[i - 1]), i)))  # at even sampling at most one sample away
    while k > 1 and t < 0.5 * (time[k - 1] + time[k]):
        k -= 1
    while k < i - 1 and t > 0.5 * (time[k] + time[k + 1]):
        k += 1
    u, h1 = t - time[k], time[k] - time[k - 1]
    if i == 1:
        return k, -u / h1, 0.0
    h2 = time[k + 1] - time[k]
    return k, u * (u - h2) / (h1 * (h1 + h2)), u * (u + h1) / (h2 * (h1 + h2))


def most_steps(time, longest_step: float) -> int:
    """Return the largest number of integration steps between two consecutive samples.

    Args:
        time: Sample times, s, shape (n,).
        longest_step: Largest step of the integrator, s.

    Returns:
        Number of steps, at least 1.
    """
    steps = 1
    for i in range(time.shape[0] - 1):
        steps = max(steps, int(np.ceil((time[i + 1] - time[i]) / longest_step - 1e-6)))
    return steps


def start_block(block: int, start_time: float, parameters, start, state, block_parameters) -> None:
    """Copy parameters and initial states of up to LANES of B machines to the arrays of a block, one column (lane) each.

    A block is LANES machines that the processor simulates side by side. Columns without a machine repeat the first
    machine of the block. COORDINATES, PARAMETERS and STATES are numbers of entries per machine.

    Args:
        block: Index of the block; it simulates the machines block * LANES to block * LANES + LANES - 1.
        start_time: Time of the first sample, s.
        parameters: Parameters of all machines, SI, shape (B, PARAMETERS).
        start: Belt travel (radius * angle of a pulley), m, its rate, m/s, and effect states, of all machines, shape
            (B, STATES - 1).
        state: Output: belt travel, m, its rate, m/s, time, s, and effect states, shape (STATES, LANES).
        block_parameters: Output: parameters, SI, shape (PARAMETERS, LANES).
    """
    for lane in range(LANES):
        b = block * LANES + (lane if block * LANES + lane < parameters.shape[0] else 0)
        for k in range(PARAMETERS):
            block_parameters[k, lane] = parameters[b, k]
        for k in range(2 * COORDINATES):
            state[k, lane] = start[b, k]
        state[2 * COORDINATES, lane] = start_time
        for k in range(2 * COORDINATES + 1, STATES):
            state[k, lane] = start[b, k - 1]


def copy_lanes(block: int, i: int, rows, table) -> None:
    """Copy values of a block (LANES machines, simulated side by side) to one sample of a table over all samples.

    Args:
        block: Index of the block; its columns (lanes) are the machines from block * LANES on.
        i: Index of the sample.
        rows: Values of the block (states or readings, any unit), shape (k or more, LANES); the first k rows are copied.
        table: Output for B machines and n samples, in the unit of the rows, shape (B, n, k); if empty, nothing is done.
    """
    for lane in range(min(LANES, table.shape[0] - block * LANES)):
        for k in range(table.shape[2]):
            table[block * LANES + lane, i, k] = rows[k, lane]


def delay_readings(time, i: int, sensor_delays, past_readings, reading) -> None:
    """Delay the readings of one sample by each sensor's delay, for a block (LANES machines, simulated side by side).

    The readings become row i of `past_readings`. Those of sensors with a delay are then interpolated between its rows.

    Args:
        time: Sample times, s, shape (n,).
        i: Index of the sample.
        sensor_delays: Delay of each sensor, s, shape (SENSORS, LANES), one machine per column.
        past_readings: Readings without delay, m or rad, shape (n, SENSORS, LANES), up to sample i - 1; row i is added.
        reading: Readings of sample i, m or rad, shape (SENSORS, LANES): without delay on entry, delayed on return.
    """
    past_readings[i] = reading
    for j in range(SENSORS):
        delay, k, before, after = 0.0, i, 0.0, 0.0
        for lane in range(LANES):
            if sensor_delays[j, lane] != delay:  # machines of a block mostly have the same delay
                delay = sensor_delays[j, lane]
                k, before, after = parabola(time, i, delay)
            if delay > 0.0:
                previous, middle = past_readings[max(0, k - 1), j, lane], past_readings[k, j, lane]
                following = past_readings[min(k + 1, i), j, lane]
                reading[j, lane] = middle + before * (previous - middle) + after * (following - middle)


def inject_outputs(block: int, i: int, machines: int, measured, gains, reading, state) -> None:
    """Correct the states of a block (LANES machines, simulated side by side) by measurements, as an observer does.

    The correction gains @ (measured - reading) is added to the state (output injection). COORDINATES, SENSORS and
    STATES are numbers of entries per machine.

    Args:
        block: Index of the block; its columns (lanes) are the machines from block * LANES on.
        i: Index of the sample.
        machines: Number of machines B.
        measured: Measurements, m or rad, shape (1 or B, n, SENSORS), NaN where not measured.
        gains: Change of belt travel (m) and of its rate (m/s) per m or rad of error, shape (2 * COORDINATES, SENSORS).
        reading: Simulated readings, m or rad, shape (SENSORS, LANES).
        state: Belt travel, m, its rate, m/s, time, s, and effect states, corrected in place, shape (STATES, LANES).
    """
    for lane in range(min(LANES, machines - block * LANES)):
        for j in range(SENSORS):
            measurement = measured[block * LANES + lane if measured.shape[0] > 1 else 0, i, j]
            if np.isfinite(measurement):
                innovation = measurement - reading[j, lane]
                for k in range(2 * COORDINATES):
                    state[k, lane] += gains[k, j] * innovation


def hold_inputs(
    block: int, parameters, time, i: int, steps: int, h: float, inputs, extra, drive_delays, voltages, external_forces
) -> None:
    """Set voltages and external forces of a block (LANES machines, simulated side by side) until the next sample.

    COORDINATES, INPUTS and PARAMETERS are the numbers of coordinates, drives and parameters per machine.

    Args:
        block: Index of the block; its columns (lanes) are the machines from block * LANES on.
        parameters: Parameters of all B machines, SI, shape (B, PARAMETERS).
        time: Sample times, s, shape (n,).
        i: Index of the sample.
        steps: Number of steps until the next sample.
        h: Length of a step, s.
        inputs: Voltages, V, shape (1 or B, n, INPUTS).
        extra: External forces along the belt travel, N, shape (1 or B, n, COORDINATES).
        drive_delays: Delay of each drive, s, shape (INPUTS, LANES).
        voltages: Output, V, shape (INPUTS, LANES); if a drive has a delay, the mean voltages of every step, shape
            (steps * INPUTS, LANES).
        external_forces: Output, N, shape (COORDINATES, LANES).
    """
    for lane in range(LANES):
        b = block * LANES + (lane if block * LANES + lane < parameters.shape[0] else 0)
        u = b if inputs.shape[0] > 1 else 0
        if DELAYED:
            for s in range(steps):
                for k in range(INPUTS):
                    begin = time[i] + s * h - drive_delays[k, lane]
                    voltages[s * INPUTS + k, lane] = held_mean(time, inputs[u, :, k], begin, begin + h, i)
        else:
            for k in range(INPUTS):
                voltages[k, lane] = inputs[u, i, k]
        if FORCED:
            e = b if extra.shape[0] > 1 else 0
            for k in range(COORDINATES):
                external_forces[k, lane] = extra[e, i, k]


def rollout(
    time, inputs, parameters, start, measured, gains, extra, longest_step: float, first: int, last: int, out, readings
) -> None:
    """Simulate blocks first..last-1 over a recording; a block is LANES of the B machines, simulated side by side.

    COORDINATES, INPUTS (drives), PARAMETERS, SENSORS and STATES (rows of the state) are numbers per machine.

    Args:
        time: Sample times, s, shape (n,).
        inputs: Voltages, V, shape (1 or B, n, INPUTS), held until the next sample.
        parameters: Machine parameters, SI, shape (B, PARAMETERS).
        start: First state without its time: belt travel (radius * angle), m, rate, m/s, effects, shape (B, STATES - 1).
        measured: Measurements to correct the state, m or rad, shape (1 or B, n, SENSORS), NaN where missing; or empty.
        gains: Change of travel and its rate per error, m and m/s per m or rad, shape (2 * COORDINATES, SENSORS).
        extra: External forces, N, held until the next sample, shape (1 or B, n, COORDINATES). Only used if FORCED.
        longest_step: Largest step of the integrator, s.
        first: Index of the first block.
        last: Index after the last block.
        out: Output, first k rows of the state (travel, m; its rate, m/s) at the samples, shape (B, n, k), or empty.
        readings: Output, sensor readings, m or rad, shape (B, n, SENSORS); empty if not needed.
    """
    state = np.zeros((STATES, LANES))
    block_parameters = np.zeros((PARAMETERS, LANES))
    derived = np.zeros((DERIVED, LANES))
    drive_delays = np.zeros((INPUTS, LANES))
    sensor_delays = np.zeros((SENSORS, LANES))
    external_forces = np.zeros((COORDINATES, LANES))
    reading = np.zeros((SENSORS, LANES))
    past_readings = np.zeros((time.shape[0] if LAGGED else 0, SENSORS, LANES))
    voltages = np.zeros((INPUTS * most_steps(time, longest_step) if DELAYED else INPUTS, LANES))
    for block in range(first, last):
        start_block(block, time[0], parameters, start, state, block_parameters)
        if DELAYED:
            voltage_delays(block_parameters, drive_delays)
        if LAGGED:
            measurement_delays(block_parameters, sensor_delays)
        period, h, steps = -1.0, longest_step, 1
        for i in range(time.shape[0]):
            copy_lanes(block, i, state, out)
            if measured.shape[0] > 0 or readings.shape[0] > 0:
                read_sensors(state, block_parameters, reading)
                if LAGGED:
                    delay_readings(time, i, sensor_delays, past_readings, reading)
                copy_lanes(block, i, reading, readings)
            if measured.shape[0] > 0:
                inject_outputs(block, i, parameters.shape[0], measured, gains, reading, state)
            if i + 1 == time.shape[0]:
                break
            dt = time[i + 1] - time[i]
            if abs(dt - period) > 1e-6 * dt:
                period = dt
                steps = max(1, int(np.ceil(dt / longest_step - 1e-6)))
                h = dt / steps
                prepare(block_parameters, derived, h)
            hold_inputs(block, parameters, time, i, steps, h, inputs, extra, drive_delays, voltages, external_forces)
            advance(state, block_parameters, derived, voltages, external_forces, h, steps)


def prepare_blocks(parameters, h: float, first: int, last: int, derived) -> None:
    """Compute the constants that a step needs (decay factors, reciprocals, ...) for the machines of some blocks.

    A block is LANES machines, simulated side by side, each with PARAMETERS parameters and DERIVED such constants.

    Args:
        parameters: Machine parameters, SI, shape (blocks, PARAMETERS, LANES).
        h: Step of the integrator, s.
        first: Index of the first block.
        last: Index after the last block.
        derived: Output: derived constants, SI, shape (blocks, DERIVED, LANES).
    """
    for block in range(first, last):
        prepare(parameters[block], derived[block], h)


def advance_blocks(state, parameters, derived, inputs, h: float, steps: int, first: int, last: int) -> None:
    """Advance the machines of blocks first..last-1 by some steps with constant voltages, in place.

    A block is LANES machines, simulated side by side. DERIVED, INPUTS, PARAMETERS and STATES are the numbers of
    constants, drives and so on per machine.

    Args:
        state: Belt travel (m), its rate (m/s), time (s) and effect states, shape (blocks, STATES, LANES).
        parameters: Machine parameters, SI, shape (blocks, PARAMETERS, LANES).
        derived: Constants that `prepare_blocks` computes from parameters and h, shape (blocks, DERIVED, LANES).
        inputs: Voltages, V, shape (blocks, INPUTS, LANES); if a drive is delayed, one set per step, shape
            (blocks, steps * INPUTS, LANES).
        h: Step of the integrator, s.
        steps: Number of steps.
        first: Index of the first block.
        last: Index after the last block.
    """
    external_forces = np.zeros((COORDINATES, LANES))
    for block in range(first, last):
        advance(state[block], parameters[block], derived[block], inputs[block], external_forces, h, steps)


def read_blocks(state, parameters, first: int, last: int, readings) -> None:
    """Compute the readings of blocks first..last-1 (LANES machines each, simulated side by side), without delay.

    Args:
        state: Belt travel (m), its rate (m/s), time (s) and effect states, shape (blocks, STATES, LANES).
        parameters: Machine parameters, SI, shape (blocks, PARAMETERS, LANES).
        first: Index of the first block.
        last: Index after the last block.
        readings: Output, readings without delay, m or rad, shape (blocks, SENSORS, LANES) for SENSORS sensors.
    """
    for block in range(first, last):
        read_sensors(state[block], parameters[block], readings[block])


def sensor_delay_blocks(parameters, first: int, last: int, sensor_delays) -> None:
    """Compute the sensors' delays for blocks first..last-1 (LANES machines each, simulated side by side).

    Args:
        parameters: Parameters of the machines, SI, shape (blocks, PARAMETERS, LANES), PARAMETERS of them each.
        first: Index of the first block.
        last: Index after the last block.
        sensor_delays: Output, delays, s, shape (blocks, SENSORS, LANES) for SENSORS sensors.
    """
    for block in range(first, last):
        measurement_delays(parameters[block], sensor_delays[block])


def drive_delay_blocks(parameters, first: int, last: int, drive_delays) -> None:
    """Compute the drives' delays for blocks first..last-1 (LANES machines each, simulated side by side).

    Args:
        parameters: Parameters of the machines, SI, shape (blocks, PARAMETERS, LANES), PARAMETERS of them each.
        first: Index of the first block.
        last: Index after the last block.
        drive_delays: Output, delays, s, shape (blocks, INPUTS, LANES) for INPUTS drives.
    """
    for block in range(first, last):
        voltage_delays(parameters[block], drive_delays[block])
