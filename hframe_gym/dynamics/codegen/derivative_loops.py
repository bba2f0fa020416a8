"""Loops around the derivatives of a kernel's step: forward over equal periods with held voltages, and back.

As in `time_loops`, a block is `LANES` machines, side by side in the last axis of the arrays of a block. The
way back needs the state before every step. Only those at the ends of the periods are kept; the others are
computed again, period by period, so that they stay in the processor's cache.
"""
# mypy: ignore-errors

from __future__ import annotations

import numpy as np

from .blocks import read_block, write_block
from .compiled import compiled, compiled_only
from .machine_code import LANES
from .native_calls import call_at


@compiled_only
def _delayed_interval(k: int, s: int, steps: int, delay: float, h: float) -> tuple:
    """Find the periods whose voltages act during step s of period k after a delay, s.

    Return the period that acts first, the next one, and the fraction of the step, of length h in s, in which
    the latter acts. Before the first period, its voltage acts.
    """
    begin = k * steps + s - delay / h  # of the interval in which the voltages were commanded, in steps
    i = int(np.floor(begin / steps + 1e-9))  # not the period before because of rounding
    later = max(0.0, begin + 1.0 - (i + 1) * steps)
    return max(i, 0), max(i + 1, 0), later


@compiled_only
def _set_voltages(block: int, k: int, steps: int, h: float, inputs, delays, delayed: bool, out) -> None:
    """Set the voltages of a period, V: one row per drive, or with delays the mean voltages of each step.

    inputs (B, earlier and simulated periods, drives) V; delays (drives, LANES) s; h: length of a step, s. out
    (drives or steps * drives, LANES).
    """
    for lane in range(LANES):
        b = min(block * LANES + lane, inputs.shape[0] - 1)
        for j in range(delays.shape[0]):
            if not delayed:
                out[j, lane] = inputs[b, k, j]
                continue
            for s in range(steps):
                i, following, later = _delayed_interval(k, s, steps, delays[j, lane], h)
                value = inputs[b, i, j]
                if later > 0.0:
                    value += later * (inputs[b, following, j] - value)
                out[s * delays.shape[0] + j, lane] = value


@compiled_only
def _add_voltages_back(
    block: int, k: int, steps: int, h: float, inputs, delays, delayed: bool, adjoint, out, delays_out
) -> None:
    """Add derivatives by voltages, 1/V, and delays, 1/s, of a period; the transpose of `_set_voltages`."""
    for lane in range(min(LANES, out.shape[0] - block * LANES)):
        b = block * LANES + lane
        for j in range(delays.shape[0]):
            if not delayed:
                out[b, k, j] += adjoint[j, lane]
                continue
            for s in range(steps):
                change = adjoint[s * delays.shape[0] + j, lane]
                i, following, later = _delayed_interval(k, s, steps, delays[j, lane], h)
                out[b, i, j] += (1.0 - later) * change
                if later > 0.0:
                    out[b, following, j] += later * change
                    rise = inputs[b, following, j] - inputs[b, i, j]
                    delays_out[j, lane] -= change * rise / h


@compiled_only
def _add_block(rows, begin: int, block) -> None:
    """Add the rows of LANES machines from index `begin` on to the columns of a block; see `read_block`."""
    for lane in range(min(LANES, rows.shape[0] - begin)):
        for k in range(rows.shape[1]):
            block[k, lane] += rows[begin + lane, k]


@compiled
def periods_forward(
    functions: tuple,
    sizes: tuple,
    delayed: bool,
    inputs,
    parameters,
    h: float,
    steps: int,
    first: int,
    last: int,
    states,
) -> None:
    """Simulate blocks first..last-1 over equal periods in which the voltages are held.

    Args:
        functions: Addresses of the kernel's functions prepare, voltage_delays and advance.
        sizes: Numbers of coordinates, step constants and drives.
        delayed: Whether a drive has a delay.
        inputs: Voltages, V, shape (B, earlier + simulated periods, drives); the shape of `states` gives the
            number of simulated periods. Before the first period, its voltages act.
        parameters: Machine parameters, SI, shape (B, parameters).
        h: Length of a step, s.
        steps: Number of steps per period.
        first: First block.
        last: Block after the last one.
        states: Belt travel, m, its rate, m/s, time, s, and effect states at the ends of the periods,
            shape (B, periods + 1, rows); the first ones are given, the others are the output.
    """
    prepare, voltage_delays, advance = functions
    coordinates, constants, drives = sizes
    earlier = inputs.shape[1] - (states.shape[1] - 1)
    block_parameters = np.zeros((parameters.shape[1], LANES))
    derived = np.zeros((constants, LANES))
    delays = np.zeros((drives, LANES))
    voltages = np.zeros((drives * (steps if delayed else 1), LANES))
    state = np.zeros((states.shape[2], LANES))
    no_forces = np.zeros((coordinates, LANES))
    for block in range(first, last):
        read_block(parameters, block * LANES, block_parameters)
        call_at(prepare, block_parameters, derived, h)
        if delayed:
            call_at(voltage_delays, block_parameters, delays)
        read_block(states[:, 0], block * LANES, state)
        for k in range(states.shape[1] - 1):
            _set_voltages(block, earlier + k, steps, h, inputs, delays, delayed, voltages)
            call_at(advance, state, block_parameters, derived, voltages, no_forces, h, steps)
            write_block(state, block * LANES, states.shape[2], states[:, k + 1])


@compiled
def periods_back(
    functions: tuple,
    sizes: tuple,
    flags: tuple,
    inputs,
    parameters,
    h: float,
    steps: int,
    first: int,
    last: int,
    states,
    adjoint,
    start_out,
    inputs_out,
    parameters_out,
) -> None:
    """Compute gradients by start, voltages and parameters from derivatives by the states (reverse mode).

    The other arguments are those of `periods_forward`.

    Args:
        functions: Addresses of prepare, voltage_delays, advance, step_back (with or without parameters),
            prepare_back and voltage_delays_back.
        flags: Whether a drive has a delay, and whether to compute derivatives with respect to the parameters.
        inputs: Voltages, V, shape (B, earlier + simulated periods, drives).
        parameters: Machine parameters, SI, shape (B, parameters).
        h: Length of a step, s.
        states: States that `periods_forward` computed, shape (B, periods + 1, rows).
        adjoint: Derivatives with respect to the states, 1/m, s/m, ..., shape (B, periods + 1, rows); the
            row of time is ignored.
        start_out: Output, derivatives with respect to the first states, shape (B, rows).
        inputs_out: Output, derivatives with respect to the voltages, 1/V, in the shape of `inputs`; zero on
            entry.
        parameters_out: Output, derivatives with respect to the parameters, shape (B, parameters).
    """
    prepare, voltage_delays, advance, step_back, prepare_back, voltage_delays_back = functions
    coordinates, constants, drives = sizes
    delayed, by_parameters = flags
    rows = states.shape[2]
    earlier = inputs.shape[1] - (states.shape[1] - 1)
    block_parameters = np.zeros((parameters.shape[1], LANES))
    derived = np.zeros((constants, LANES))
    delays = np.zeros((drives, LANES))
    of_step = drives if delayed else 0  # rows of the voltages from a step to the next
    voltages = np.zeros((drives * (steps if delayed else 1), LANES))
    history = np.zeros((steps + 1, rows, LANES))
    no_forces = np.zeros((coordinates, LANES))
    block_adjoint = np.zeros((rows, LANES))
    adjoint_voltages = np.zeros(voltages.shape)
    adjoint_delays = np.zeros((drives, LANES))
    adjoint_derived = np.zeros((constants, LANES))
    adjoint_parameters = np.zeros((parameters.shape[1], LANES))
    for block in range(first, last):
        read_block(parameters, block * LANES, block_parameters)
        call_at(prepare, block_parameters, derived, h)
        if delayed:
            call_at(voltage_delays, block_parameters, delays)
        adjoint_delays[:] = 0.0
        adjoint_derived[:] = 0.0
        adjoint_parameters[:] = 0.0
        block_adjoint[:] = 0.0
        for k in range(states.shape[1] - 2, -1, -1):
            _add_block(adjoint[:, k + 1], block * LANES, block_adjoint)
            read_block(states[:, k], block * LANES, history[0])
            _set_voltages(block, earlier + k, steps, h, inputs, delays, delayed, voltages)
            for s in range(steps - 1):
                history[s + 1] = history[s]
                of_this = voltages[s * of_step :]
                call_at(advance, history[s + 1], block_parameters, derived, of_this, no_forces, h, 1)
            adjoint_voltages[:] = 0.0
            for s in range(steps - 1, -1, -1):
                call_at(
                    step_back,
                    history[s],
                    block_parameters,
                    derived,
                    voltages[s * of_step :],
                    block_adjoint,
                    adjoint_parameters,
                    adjoint_derived,
                    adjoint_voltages[s * of_step :],
                    h,
                )
            _add_voltages_back(
                block,
                earlier + k,
                steps,
                h,
                inputs,
                delays,
                delayed,
                adjoint_voltages,
                inputs_out,
                adjoint_delays,
            )
        if by_parameters:
            call_at(prepare_back, block_parameters, adjoint_derived, adjoint_parameters, h)
            if delayed:
                call_at(voltage_delays_back, block_parameters, adjoint_delays, adjoint_parameters)
        _add_block(adjoint[:, 0], block * LANES, block_adjoint)
        write_block(block_adjoint, block * LANES, rows, start_out)
        write_block(adjoint_parameters, block * LANES, parameters.shape[1], parameters_out)


@compiled
def readings_back(
    read_sensors_back: int, states, parameters, adjoint, first: int, last: int, states_out, parameters_out
) -> None:
    """Compute derivatives of a scalar by states and parameters from those by the sensor readings.

    It is the reverse mode of `readings_forward`, for blocks first..last-1: each derivative by a state or
    parameter is the sum over all readings of the given derivative times that of the reading. The sensors'
    delays are ignored.

    Args:
        read_sensors_back: Address of the kernel's compiled function that does this for one block and time.
        states: Belt travel, m, and further rows, shape (B, N, rows).
        parameters: Machine parameters, SI, shape (B, parameters).
        adjoint: Derivatives with respect to the readings, 1 / unit of the sensor, shape (B, N, sensors).
        states_out: Output, overwritten, derivatives with respect to the states, shape (B, N, rows).
        parameters_out: Output, overwritten, derivatives with respect to the parameters, summed over the N
            times, shape (B, parameters).
    """
    block_parameters = np.zeros((parameters.shape[1], LANES))
    adjoint_parameters = np.zeros((parameters.shape[1], LANES))
    state = np.zeros((states.shape[2], LANES))
    adjoint_state = np.zeros((states.shape[2], LANES))
    of_readings = np.zeros((adjoint.shape[2], LANES))
    for block in range(first, last):
        read_block(parameters, block * LANES, block_parameters)
        adjoint_parameters[:] = 0.0
        for k in range(states.shape[1]):
            read_block(states[:, k], block * LANES, state)
            read_block(adjoint[:, k], block * LANES, of_readings)
            adjoint_state[:] = 0.0
            call_at(
                read_sensors_back, state, block_parameters, of_readings, adjoint_state, adjoint_parameters
            )
            write_block(adjoint_state, block * LANES, states.shape[2], states_out[:, k])
        write_block(adjoint_parameters, block * LANES, parameters.shape[1], parameters_out)


@compiled
def readings_forward(read_sensors: int, states, parameters, first: int, last: int, readings) -> None:
    """Compute the sensor readings of blocks first..last-1, without delay.

    Args:
        read_sensors: Address of the kernel's compiled function that does this for one block and time.
        states: Belt travel, m, and further rows, shape (B, N, rows).
        parameters: Machine parameters, SI, shape (B, parameters).
        readings: Output, in the sensors' units, shape (B, N, sensors).
    """
    block_parameters = np.zeros((parameters.shape[1], LANES))
    state = np.zeros((states.shape[2], LANES))
    reading = np.zeros((readings.shape[2], LANES))
    for block in range(first, last):
        read_block(parameters, block * LANES, block_parameters)
        for k in range(states.shape[1]):
            read_block(states[:, k], block * LANES, state)
            call_at(read_sensors, state, block_parameters, reading)
            write_block(reading, block * LANES, readings.shape[2], readings[:, k])
