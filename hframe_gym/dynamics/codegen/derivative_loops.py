"""Loops around the derivatives of a kernel's step: forward over equal periods with held voltages, and back.

As in `time_loops`, a block is `LANES` machines, side by side in the last axis of the arrays of a block. The way back
needs the state before every step. Only those at the ends of the periods are kept; the others are computed again, period
by period, so that they stay in the processor's cache.
"""
# mypy: ignore-errors

from __future__ import annotations

import numpy as np

from .compiled import compiled, compiled_only
from .machine_code import LANES
from .native_calls import call_at


@compiled_only
def _load_lanes(block: int, k: int, table, rows) -> None:
    """Copy row k of a table over periods, shape (B, periods, rows), to the lanes of a block."""
    for lane in range(LANES):
        b = block * LANES + lane
        if b >= table.shape[0]:
            b = block * LANES  # lanes without a machine repeat the first one
        for row in range(rows.shape[0]):
            rows[row, lane] = table[b, k, row]


@compiled_only
def _load_parameters(block: int, parameters, rows) -> None:
    """Copy the parameters of the machines of a block, shape (B, parameters), to its lanes."""
    for lane in range(LANES):
        b = block * LANES + lane
        if b >= parameters.shape[0]:
            b = block * LANES
        for row in range(rows.shape[0]):
            rows[row, lane] = parameters[b, row]


@compiled_only
def _set_voltages(
    block: int, k: int, before: int, steps: int, h: float, inputs, delays, delayed: bool, out
) -> None:
    """Set the voltages of a period: one row per drive, or with delays the mean voltages of each step.

    Args:
        block: Index of the block.
        k: Index of the period.
        before: Number of periods before the first one whose voltages are given.
        steps: Number of steps per period.
        h: Length of a step, s.
        inputs: Voltages, V, shape (B, before + periods, drives); the first ones also act earlier.
        delays: Delay of each drive, s, shape (drives, LANES).
        delayed: Whether a drive has a delay.
        out: Output, V, shape (drives or steps * drives, LANES).
    """
    for lane in range(LANES):
        b = block * LANES + lane
        if b >= inputs.shape[0]:
            b = block * LANES
        for j in range(delays.shape[0]):
            if not delayed:
                out[j, lane] = inputs[b, before + k, j]
                continue
            for s in range(steps):
                begin = (before + k) * steps + s - delays[j, lane] / h  # in steps
                i = int(np.floor(begin / steps + 1e-9))  # period in which the interval begins
                later = max(0.0, begin + 1.0 - (i + 1) * steps)  # part of the step in the next period
                value = inputs[b, max(i, 0), j]
                if later > 0.0:
                    value += later * (inputs[b, max(i + 1, 0), j] - value)
                out[s * delays.shape[0] + j, lane] = value


@compiled_only
def _add_voltages_back(
    block: int,
    k: int,
    before: int,
    steps: int,
    h: float,
    inputs,
    delays,
    delayed: bool,
    adjoint,
    out,
    delays_out,
) -> None:
    """Add the derivatives by the voltages of a period; the transpose of `_set_voltages`.

    Args:
        block: Index of the block.
        k: Index of the period.
        before: Number of periods before the first one whose voltages are given.
        steps: Number of steps per period.
        h: Length of a step, s.
        inputs: Voltages, V, shape (B, before + periods, drives).
        delays: Delay of each drive, s, shape (drives, LANES).
        delayed: Whether a drive has a delay.
        adjoint: Derivatives by the voltages of the steps, 1/V, shape (drives or steps * drives, LANES).
        out: Output, derivatives by the voltages, 1/V, shape (B, before + periods, drives).
        delays_out: Output, derivatives by the delays, 1/s, shape (drives, LANES).
    """
    for lane in range(min(LANES, out.shape[0] - block * LANES)):
        b = block * LANES + lane
        for j in range(delays.shape[0]):
            if not delayed:
                out[b, before + k, j] += adjoint[j, lane]
                continue
            for s in range(steps):
                change = adjoint[s * delays.shape[0] + j, lane]
                begin = (before + k) * steps + s - delays[j, lane] / h
                i = int(np.floor(begin / steps + 1e-9))
                later = max(0.0, begin + 1.0 - (i + 1) * steps)
                out[b, max(i, 0), j] += (1.0 - later) * change
                if later > 0.0:
                    out[b, max(i + 1, 0), j] += later * change
                    rise = inputs[b, max(i + 1, 0), j] - inputs[b, max(i, 0), j]
                    delays_out[j, lane] -= change * rise / h


@compiled
def periods_forward(
    functions: tuple,
    sizes: tuple,
    delayed: bool,
    before: int,
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
        before: Number of periods before the first one whose voltages are given.
        inputs: Voltages, V, shape (B, before + periods, drives).
        parameters: Machine parameters, SI, shape (B, parameters).
        h: Length of a step, s.
        steps: Number of steps per period.
        first: Index of the first block.
        last: Index after the last block.
        states: Belt travel, m, its rate, m/s, time, s, and effect states at the ends of the periods, shape (B, periods
            + 1, rows); the first ones are given, the others are the output.
    """
    prepare, voltage_delays, advance = functions
    coordinates, constants, drives = sizes
    block_parameters = np.zeros((parameters.shape[1], LANES))
    derived = np.zeros((constants, LANES))
    delays = np.zeros((drives, LANES))
    voltages = np.zeros((drives * (steps if delayed else 1), LANES))
    state = np.zeros((states.shape[2], LANES))
    no_forces = np.zeros((coordinates, LANES))
    for block in range(first, last):
        _load_parameters(block, parameters, block_parameters)
        call_at(prepare, block_parameters, derived, h)
        if delayed:
            call_at(voltage_delays, block_parameters, delays)
        _load_lanes(block, 0, states, state)
        for k in range(states.shape[1] - 1):
            _set_voltages(block, k, before, steps, h, inputs, delays, delayed, voltages)
            call_at(advance, state, block_parameters, derived, voltages, no_forces, h, steps)
            for lane in range(min(LANES, states.shape[0] - block * LANES)):
                for row in range(states.shape[2]):
                    states[block * LANES + lane, k + 1, row] = state[row, lane]


@compiled
def periods_back(
    functions: tuple,
    sizes: tuple,
    flags: tuple,
    before: int,
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
    """Compute derivatives of a number by start, voltages and parameters from those by the states of each period's end.

    Args:
        functions: Addresses of prepare, voltage_delays, advance, step_back (with or without parameters), prepare_back
            and voltage_delays_back.
        sizes: Numbers of coordinates, step constants and drives.
        flags: Whether a drive has a delay, and whether to compute derivatives by the parameters.
        before: Number of periods before the first one whose voltages are given.
        inputs: Voltages, V, shape (B, before + periods, drives).
        parameters: Machine parameters, SI, shape (B, parameters).
        h: Length of a step, s.
        steps: Number of steps per period.
        first: Index of the first block.
        last: Index after the last block.
        states: Belt travel, m, its rate, m/s, time, s, and effect states, shape (B, periods + 1, rows).
        adjoint: Derivatives by these states, 1/m, s/m, ..., shape (B, periods + 1, rows); those by time are ignored.
        start_out: Output, derivatives by the first states, shape (B, rows).
        inputs_out: Output, derivatives by the voltages, 1/V, shape (B, before + periods, drives); zero on entry.
        parameters_out: Output, derivatives by the parameters, shape (B, parameters).
    """
    prepare, voltage_delays, advance, step_back, prepare_back, voltage_delays_back = functions
    coordinates, constants, drives = sizes
    delayed, by_parameters = flags
    rows = states.shape[2]
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
        lanes = min(LANES, states.shape[0] - block * LANES)
        _load_parameters(block, parameters, block_parameters)
        call_at(prepare, block_parameters, derived, h)
        if delayed:
            call_at(voltage_delays, block_parameters, delays)
        adjoint_delays[:] = 0.0
        adjoint_derived[:] = 0.0
        adjoint_parameters[:] = 0.0
        block_adjoint[:] = 0.0
        for k in range(states.shape[1] - 2, -1, -1):
            for lane in range(lanes):
                for row in range(rows):
                    block_adjoint[row, lane] += adjoint[block * LANES + lane, k + 1, row]
            _load_lanes(block, k, states, history[0])
            _set_voltages(block, k, before, steps, h, inputs, delays, delayed, voltages)
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
                k,
                before,
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
        for lane in range(lanes):
            b = block * LANES + lane
            for row in range(rows):
                start_out[b, row] = block_adjoint[row, lane] + adjoint[b, 0, row]
            for row in range(parameters.shape[1]):
                parameters_out[b, row] = adjoint_parameters[row, lane]


@compiled
def readings_back(
    read_sensors_back: int, states, parameters, adjoint, first: int, last: int, states_out, parameters_out
) -> None:
    """Compute derivatives of a number by states and parameters from those by the sensor readings, without delay.

    Args:
        read_sensors_back: Address of the function.
        states: Belt travel, m, and further rows, shape (B, n, rows).
        parameters: Machine parameters, SI, shape (B, parameters).
        adjoint: Derivatives by the readings, 1/m or 1/rad, shape (B, n, sensors).
        first: Index of the first block.
        last: Index after the last block.
        states_out: Output, derivatives by the states, shape (B, n, rows).
        parameters_out: Output, derivatives by the parameters, shape (B, parameters).
    """
    block_parameters = np.zeros((parameters.shape[1], LANES))
    adjoint_parameters = np.zeros((parameters.shape[1], LANES))
    state = np.zeros((states.shape[2], LANES))
    adjoint_state = np.zeros((states.shape[2], LANES))
    of_readings = np.zeros((adjoint.shape[2], LANES))
    for block in range(first, last):
        lanes = min(LANES, states.shape[0] - block * LANES)
        _load_parameters(block, parameters, block_parameters)
        adjoint_parameters[:] = 0.0
        for k in range(states.shape[1]):
            _load_lanes(block, k, states, state)
            _load_lanes(block, k, adjoint, of_readings)
            adjoint_state[:] = 0.0
            call_at(
                read_sensors_back, state, block_parameters, of_readings, adjoint_state, adjoint_parameters
            )
            for lane in range(lanes):
                for row in range(states.shape[2]):
                    states_out[block * LANES + lane, k, row] = adjoint_state[row, lane]
        for lane in range(lanes):
            for row in range(parameters.shape[1]):
                parameters_out[block * LANES + lane, row] = adjoint_parameters[row, lane]


@compiled
def readings_forward(read_sensors: int, states, parameters, first: int, last: int, readings) -> None:
    """Compute the sensor readings of blocks first..last-1, without delay.

    Args:
        read_sensors: Address of the kernel's function.
        states: Belt travel, m, and further rows, shape (B, n, rows).
        parameters: Machine parameters, SI, shape (B, parameters).
        first: Index of the first block.
        last: Index after the last block.
        readings: Output, m or rad, shape (B, n, sensors).
    """
    block_parameters = np.zeros((parameters.shape[1], LANES))
    state = np.zeros((states.shape[2], LANES))
    reading = np.zeros((readings.shape[2], LANES))
    for block in range(first, last):
        _load_parameters(block, parameters, block_parameters)
        for k in range(states.shape[1]):
            _load_lanes(block, k, states, state)
            call_at(read_sensors, state, block_parameters, reading)
            for lane in range(min(LANES, states.shape[0] - block * LANES)):
                for j in range(readings.shape[2]):
                    readings[block * LANES + lane, k, j] = reading[j, lane]
