"""Loops around a kernel's step: whole recordings (`rollout`) and control periods (`advance_blocks`).

These functions are templates: `kernel.py` copies their text behind the `prepare`, `delays` and `advance` of a machine's
shape, so that Numba inlines and caches them together.  They run without the interpreter lock, each on its own range of
blocks; a block is `LANES` stages.
"""
# mypy: ignore-errors

from __future__ import annotations

import numpy as np

from .simd import LANES

# Set by the generated text of a shape; here only so that a reader and the linter know the names.
COORDINATES = STATES = INPUTS = SENSORS = PARAMETERS = DERIVED = 0
DELAYED = LAGGED = FORCED = False
prepare = delays = advance = read_sensors = lags = inlined = None


def held_mean(time, values, start, end, hint):
    """Mean over [start, end] of an input held from each time until the next (before the first: the first value)."""
    i = hint
    while i > 0 and time[i] > start:
        i -= 1
    total = 0.0
    at = start
    while True:
        until = end if i + 1 >= time.shape[0] else min(end, time[i + 1])
        if until > at:
            total += values[i] * (until - at)
            at = until
        if at >= end or i + 1 >= time.shape[0]:
            return total / (end - start)
        i += 1


def interpolated(rows, i, lane, j, back):
    """Entry (j, lane) of rows (n, sensors, LANES), of which i are there, `back` rows before the last: quadratically."""
    at = max(0.0, i - back)
    k = min(max(1, int(at + 0.5)), i - 1)
    if i < 2:
        return rows[0, j, lane]
    u = at - k
    left, middle, right = rows[k - 1, j, lane], rows[k, j, lane], rows[k + 1, j, lane]
    return middle + 0.5 * u * (right - left) + 0.5 * u * u * (right - 2.0 * middle + left)


def rollout(time, inputs, parameters, start, measured, gains, extra, longest_step, first, last, out, readings):
    """Simulate stages first*LANES .. last*LANES-1 over a recording.

    time (n,) s; inputs (1 or B, n, INPUTS) V, held until the next row; parameters (B, PARAMETERS); start
    (B, 2 COORDINATES) travel and velocity; measured (1 or B, n, SENSORS) or none for a free run, NaN where not
    measured; gains (2 COORDINATES, SENSORS) of the output injection; extra (1 or B, n, COORDINATES) N, held, where the
    kernel takes it; longest_step s; out (B, n, k) gets the first k rows of the state; readings (B, n, SENSORS), or
    none, what the sensors show.
    """
    S = np.zeros((STATES, LANES))
    P = np.zeros((PARAMETERS, LANES))
    C = np.zeros((DERIVED, LANES))
    D = np.zeros((INPUTS, LANES))
    W = np.zeros((COORDINATES, LANES))
    R = np.zeros((SENSORS, LANES))
    L = np.zeros((SENSORS, LANES))
    longest = 1
    for i in range(time.shape[0] - 1):
        longest = max(longest, int(np.ceil((time[i + 1] - time[i]) / longest_step - 1e-6)))
    U = np.zeros((INPUTS * longest if DELAYED else INPUTS, LANES))
    stages = parameters.shape[0]
    own_inputs = inputs.shape[0] > 1
    own_extra = extra.shape[0] > 1
    observed = measured.shape[0] > 0
    own_measured = measured.shape[0] > 1
    read = observed or readings.shape[0] > 0
    past = np.zeros((time.shape[0] if LAGGED else 0, SENSORS, LANES))
    for block in range(first, last):
        # A block that is not full repeats its first stage in the lanes left over.
        for lane in range(LANES):
            b = block * LANES + lane
            b = b if b < stages else block * LANES
            for k in range(PARAMETERS):
                P[k, lane] = parameters[b, k]
            for k in range(2 * COORDINATES):
                S[k, lane] = start[b, k]
            S[2 * COORDINATES, lane] = time[0]
            for k in range(2 * COORDINATES + 1, STATES):
                S[k, lane] = 0.0
        if DELAYED:
            delays(P, D)
        if LAGGED:
            lags(P, L)
        period = -1.0
        h = longest_step
        steps = 1
        for i in range(time.shape[0]):
            own = min(LANES, stages - block * LANES)
            if out.shape[0] > 0:
                for lane in range(own):
                    for k in range(out.shape[2]):
                        out[block * LANES + lane, i, k] = S[k, lane]
            if read:
                read_sensors(S, P, R)
                if LAGGED:
                    past[i] = R
                    late = max(1e-12, time[i] - time[max(0, i - 1)])
                    for j in range(SENSORS):
                        for lane in range(LANES):
                            if L[j, lane] > 0.0:
                                R[j, lane] = interpolated(past, i, lane, j, L[j, lane] / late)
            if readings.shape[0] > 0:
                for lane in range(own):
                    for j in range(SENSORS):
                        readings[block * LANES + lane, i, j] = R[j, lane]
            if observed:
                for j in range(SENSORS):
                    for lane in range(own):
                        shown = measured[block * LANES + lane if own_measured else 0, i, j]
                        if np.isfinite(shown):
                            D_j = shown - R[j, lane]
                            for k in range(2 * COORDINATES):
                                S[k, lane] += gains[k, j] * D_j
            if i + 1 == time.shape[0]:
                break
            dt = time[i + 1] - time[i]
            if abs(dt - period) > 1e-6 * dt:
                period = dt
                steps = max(1, int(np.ceil(dt / longest_step - 1e-6)))
                h = dt / steps
                prepare(P, C, h)
            for lane in range(LANES):
                b = block * LANES + lane
                b = b if b < stages else block * LANES
                u = b if own_inputs else 0
                if DELAYED:
                    for s in range(steps):
                        for k in range(INPUTS):
                            begin = time[i] + s * h - D[k, lane]
                            U[s * INPUTS + k, lane] = held_mean(time, inputs[u, :, k], begin, begin + h, i)
                else:
                    for k in range(INPUTS):
                        U[k, lane] = inputs[u, i, k]
                if FORCED:
                    e = b if own_extra else 0
                    for k in range(COORDINATES):
                        W[k, lane] = extra[e, i, k]
            advance(S, P, C, U, W, h, steps)


def prepare_blocks(parameters, h, first, last, derived):
    """Derived numbers (blocks, DERIVED, LANES) of blocks first..last-1 for steps of h, s.

    parameters (blocks, PARAMETERS, LANES).
    """
    for block in range(first, last):
        prepare(parameters[block], derived[block], h)


def advance_blocks(state, parameters, derived, inputs, h, steps, first, last):
    """Advance blocks first..last-1 in place by `steps` steps of h with held inputs.

    state (blocks, STATES, LANES): travel, velocity, time, effects' own; inputs (blocks, INPUTS, LANES) V, or one such
    set for each step in (blocks, steps * INPUTS, LANES) where a drive is delayed.
    """
    W = np.zeros((COORDINATES, LANES))
    for block in range(first, last):
        advance(state[block], parameters[block], derived[block], inputs[block], W, h, steps)


def read_blocks(state, parameters, first, last, readings):
    """Evaluate every sensor of blocks first..last-1 at the present state, without its delay.

    Args:
        state: Travel, velocity, time and effect states, shape (blocks, STATES, LANES).
        parameters: Machine parameters, shape (blocks, PARAMETERS, LANES).
        first: First block.
        last: Block after the last one.
        readings: Output, ideal readings in the channels' units, shape (blocks, SENSORS, LANES).
    """
    for block in range(first, last):
        read_sensors(state[block], parameters[block], readings[block])


def sensor_delay_blocks(parameters, first, last, sensor_delays):
    """Evaluate the delay of every sensor of blocks first..last-1.

    Args:
        parameters: Machine parameters, shape (blocks, PARAMETERS, LANES).
        first: First block.
        last: Block after the last one.
        sensor_delays: Output, s, shape (blocks, SENSORS, LANES).
    """
    for block in range(first, last):
        lags(parameters[block], sensor_delays[block])


def drive_delay_blocks(parameters, first, last, drive_delays):
    """Evaluate the delay of every drive of blocks first..last-1.

    Args:
        parameters: Machine parameters, shape (blocks, PARAMETERS, LANES).
        first: First block.
        last: Block after the last one.
        drive_delays: Output, s, shape (blocks, INPUTS, LANES).
    """
    for block in range(first, last):
        delays(parameters[block], drive_delays[block])
