"""Simulation of machines over voltage histories: one machine, or a batch of machines with the same structure.

`simulate` checks its arguments and the motion of one machine, and adds names to it. `simulate_batch`
simulates many machines at once, and `rollout` returns its positions as one array; neither checks anything.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, ParameterRows, Times
from ..errors import InputError
from ..machine import Machine, Trajectory, require_machine, rest_state
from ..operating_system import cores
from .codegen.kernel import kernel_for
from .codegen.machine_code import LANES
from .physics.effect_instances import instances_with_state

MOST_STEPS = 1_000_000_000  # of one simulation; it takes minutes
LONGEST_STEP = 0.25e-3  # s; 0.2 um median error over 0.4 s of random voltages (benchmarks/accuracy.py)

DIVERGED = 1e6  # m, rad, or per second; no machine of this kind gets anywhere near


class NotFiniteError(ArithmeticError):
    """A motion diverged: parameters or inputs are impossible, or the step is too long for them."""


def threads() -> int:
    """Return the number of threads for simulating a batch: `$HFRAME_THREADS`, or the available cores.

    Raises:
        InputError: If the environment variable is set to something other than a whole number.
    """
    explicit = os.environ.get("HFRAME_THREADS")
    if not explicit:
        return cores()
    try:
        return max(1, int(explicit))
    except ValueError:
        raise InputError(
            f"HFRAME_THREADS is {explicit!r}; set it to a number of threads, or unset it"
        ) from None


def in_parallel(run: Callable[[int, int], None], blocks: int, parallel: bool = True) -> None:
    """Process blocks of `LANES` machines in several threads; return when all are done.

    Args:
        run: Function (first, end) that processes the blocks first to end - 1. It is called in several threads
            at once with different ranges; to gain speed, it must release Python's global interpreter lock.
            Its exceptions are raised here.
        parallel: False for all blocks in this thread.
    """
    count = min(threads(), blocks) if parallel else 1
    if count <= 1:
        run(0, blocks)
        return
    edges = [blocks * i // count for i in range(count + 1)]
    pool = _pool(os.getpid(), count - 1)
    others = [pool.submit(run, *block_range) for block_range in itertools.pairwise(edges[1:])]
    run(edges[0], edges[1])
    for other in others:
        other.result()


@lru_cache(maxsize=4)
def _pool(process: int, workers: int) -> ThreadPoolExecutor:
    """Return threads that are kept between calls; a forked process makes new ones instead."""
    return ThreadPoolExecutor(workers, thread_name_prefix="hframe")


def parameter_batch(machine: Machine) -> ParameterRows:
    """Return the parameters of a machine as a batch of one machine."""
    return np.array([list(machine.parameters.values())])


class Motion(NamedTuple):
    """Motion of B machines at N common sample times; arrays that were not requested are empty.

    Attributes:
        positions: Positions, m or rad, shape (B, N, coordinates).
        velocities: Velocities, m/s or rad/s, shape (B, N, coordinates).
        readings: Noise-free sensor readings in the channels' units, shape (B, N, sensors).
        effects: States of the effects, SI, in the order of the machine's effects, shape (B, N, states).
    """

    positions: Array
    velocities: Array
    readings: Array
    effects: Array


def simulate_batch(
    machine: Machine,
    time_s: Times,
    inputs: Array,
    *,
    parameters: ParameterRows | None = None,
    start: Array | None = None,
    extra_force: Array | None = None,
    measured: Array | None = None,
    gains: Array | None = None,
    offsets: Array | None = None,
    longest_step: float = LONGEST_STEP,
    every: int = 1,
    states: bool = True,
    readings: bool = True,
    effects: bool = False,
    parallel: bool = True,
) -> Motion:
    """Simulate B machines that differ in parameter values only, over N samples; arguments are not checked.

    Samples are where voltages may change. The rows of a recording are all samples, or fewer (`every`).

    Args:
        machine: One of the machines; it gives the equations of motion and the default parameters.
        inputs: Voltages, V, held from each sample until the next, shape (N, drives) for all machines or (B,
            N, drives).
        parameters: Parameters in the order of `machine.parameters`, SI, shape (B, parameters), or (1,
            parameters) for all machines. Default: those of `machine`.
        start: Positions (m, rad), then velocities (m/s, rad/s), at the first sample, shape (2 * coordinates,)
            or (B, 2 * coordinates); default: at rest at the origin. States of the effects (SI, in the order
            of the machine's effects) may follow in further columns; without them they are zero.
        extra_force: External force, N or Nm, held until the next row, shape (rows, coordinates) or
            (B, rows, coordinates).
        measured: Measurements that correct the simulation (observer), in the sensors' units,
            shape (rows, sensors) or (B, rows, sensors), NaN where not measured.
        gains: Observer gains, SI, shape (2 * coordinates, sensors): in every row gains @ (measured - reading)
            is added to the positions (first rows) and velocities (last rows). None: no correction.
        offsets: Added to the readings of each machine, in the sensors' units, shape (B, sensors). Default: 0.
        longest_step: Largest step of the integrator, s.
        every: Samples from one row to the next; the first sample is a row.
        states: Whether to return positions and velocities.
        readings: Whether to return the sensors' readings.
        effects: Whether to return the states of effects, with positions and velocities. A motion goes on from
            its end if they follow the positions and velocities of the next `start`.
        parallel: Whether to distribute the machines over threads; False if the caller does so.

    Returns:
        The motion in the rows, arrays of shape (B, rows, ...), with NaN or large values where it diverges.
    """
    count, radii = len(machine.coordinates), machine.travel_per_unit
    kernel = kernel_for(machine, forced=extra_force is not None)
    # The kernel works in belt travel, m: position times radius, and its rate.
    to_travel = np.tile(radii, 2)
    given = np.atleast_2d(rest_state(machine) if start is None else start)
    first_states = np.zeros((len(given), kernel.states - 1))  # a row of the kernel's state also has the time
    first_states[:, : given.shape[1]] = given
    first_states[:, : 2 * count] *= to_travel
    parameters = parameter_batch(machine) if parameters is None else parameters
    inputs, force, measurements = _series(inputs), _series(extra_force), _series(measured)
    shifts = np.zeros((0, 0)) if offsets is None else _plain(offsets)
    batch = max(map(len, (inputs, parameters, first_states, force, measurements, shifts)))
    first_states, parameters = _one_row_each(first_states, batch), _one_row_each(parameters, batch)
    time = _plain(time_s)
    rows = (len(time) - 1) // every + 1
    force = np.ascontiguousarray(force / radii) if len(force) else np.zeros((1, 1, count))
    travel_gains = (
        np.zeros((2 * count, len(machine.sensors))) if gains is None else gains * to_travel[:, None]
    )
    # Columns: travel, its rate; then, with `effects`, the time and the states of effects.
    width = kernel.states if effects else 2 * count
    state_series = np.empty((batch if states else 0, rows, width))
    reading_series = np.empty((batch if readings else 0, rows, len(machine.sensors)))

    arguments = time, inputs, parameters, first_states, measurements, travel_gains, shifts, force

    def simulate_blocks(first: int, end: int) -> None:
        kernel.rollout(*arguments, longest_step, every, first, end, state_series, reading_series)

    in_parallel(simulate_blocks, -(-batch // LANES), parallel)
    moving = state_series[..., : 2 * count]
    moving /= to_travel
    return Motion(
        moving[..., :count], moving[..., count:], reading_series, state_series[..., 2 * count + 1 :]
    )


def _series(values: Array | None) -> Array:
    """Return values over samples with a batch axis, shape (1 or B, N, k); shape (0, 0, 0) for None."""
    if values is None:
        return np.zeros((0, 0, 0))
    return _plain(values if np.ndim(values) == 3 else np.asarray(values)[None])


def _plain(values: Array) -> Array:
    """Return values as contiguous, writable float64; Numba would compile again for read-only arrays."""
    return np.require(values, float, ["C", "W"])


def _one_row_each(values: Array, batch: int) -> Array:
    """Return one row per machine, shape (batch, k), of values of shape (1 or batch, k).

    The rows are copies: a broadcast row would be read-only, which is another type to Numba and a second
    compilation.
    """
    return np.array(np.broadcast_to(values, (batch, values.shape[1])), order="C")


def rollout(
    machine: Machine, time_s: Times, inputs: Array, *, velocities: bool = False, **options: Any
) -> Array:
    """Return the positions of a simulation by `simulate_batch`.

    Args:
        inputs: Voltages, V, held from each sample until the next, shape (N, drives) or (B, N, drives).
        velocities: Whether to append the velocities, m/s or rad/s, to the positions.
        **options: Keyword arguments of `simulate_batch`, but `readings`: `parameters`, `start`, ...

    Returns:
        Positions, m or rad, shape (B, N, coordinates), or with velocities (B, N, 2 * coordinates).
    """
    motion = simulate_batch(machine, time_s, inputs, readings=False, **options)
    return np.concatenate(motion[:2], axis=2) if velocities else motion.positions


def simulate(
    machine: Machine,
    time_s: ArrayLike,
    inputs: ArrayLike,
    initial: ArrayLike | None = None,
    *,
    offset: ArrayLike = 0.0,
    longest_step: float = LONGEST_STEP,
) -> Trajectory:
    """Simulate a machine over a history of commands, each held until the next sample.

    Args:
        time_s: Sample times, s, strictly increasing, shape (N,).
        inputs: Command of each drive, in its unit (`Machine.command_unit`), usually V, shape (N, drives).
        initial: Positions (m, rad), then velocities (m/s, rad/s), at the first sample,
            shape (2 * coordinates,). The internal states of all effects that have one (a hysteresis, for
            example) may follow, in the order of `machine.effects`; without them they are zero. Default: at
            rest at the origin with unstretched belts.
        offset: Constant that is added to the readings of each sensor, in the sensors' units, shape (sensors,)
            or one number.
        longest_step: Largest step of the integrator, s.

    Returns:
        Motion at every sample: arrays of shape (N, coordinates) or (N, sensors).

    Raises:
        ValueError: If the shapes do not fit the machine, times do not increase or span more than 1e9 steps,
            the longest step is not positive, or a value is not finite.
        NotFiniteError: If the motion diverges; the message names time and coordinate.

    References:
        Sollmann, Jouaneh and Lavender (2010), eq. 36-44.
    """
    require_machine(machine)
    grid = np.asarray(time_s, float)
    voltages = np.asarray(inputs, float)
    if not 0.0 < longest_step < np.inf:
        raise ValueError(f"longest_step is {longest_step!r}, it must be a positive number of seconds")
    if grid.ndim == 1 and len(grid) and grid[-1] - grid[0] > MOST_STEPS * longest_step:
        raise ValueError(f"time_s spans {grid[-1] - grid[0]:g} s, which are more than {MOST_STEPS:.0e} steps")
    if grid.ndim != 1 or len(grid) == 0 or np.any(np.diff(grid) <= 0) or not np.all(np.isfinite(grid)):
        raise ValueError("time_s must be one-dimensional, finite and strictly increasing")
    if voltages.shape != (len(grid), len(machine.drives)):
        expected = (len(grid), len(machine.drives))
        raise ValueError(f"inputs have shape {voltages.shape}, machine {machine.name!r} needs {expected}")
    if not np.all(np.isfinite(voltages)):
        row, column = map(int, np.argwhere(~np.isfinite(voltages))[0])
        raise ValueError(f"inputs: row {row}, {machine.input_channels[column]} is {voltages[row, column]}")
    start = None if initial is None else np.asarray(initial, float)
    size = 2 * len(machine.coordinates)
    if start is not None and start.shape not in ((size,), (size + len(instances_with_state(machine)),)):
        raise ValueError(f"initial has shape {start.shape}, machine {machine.name!r} needs {(size,)}")
    motion = simulate_batch(machine, grid, voltages, start=start, longest_step=longest_step)
    _check_finite(machine, grid, motion, longest_step)
    outputs = motion.readings[0] + np.asarray(offset, float)
    return Trajectory(grid, motion.positions[0], motion.velocities[0], outputs, machine.output_channels)


def _check_finite(machine: Machine, time_s: Array, motion: Motion, longest_step: float) -> None:
    """Raise NotFiniteError if the motion of the first machine has a value that no machine reaches, or NaN."""
    state = np.concatenate(motion, axis=2)[0]
    diverged = ~(np.abs(state) < DIVERGED)
    if diverged.any():
        row, column = map(int, np.argwhere(diverged)[0])
        names = (*machine.coordinate_names, *(f"velocity of {c}" for c in machine.coordinate_names))
        quantity = (*names, *machine.output_channels)[column]
        raise NotFiniteError(
            f"machine {machine.name!r}: the simulated motion diverges at t = {time_s[row]:g} s ({quantity}). "
            f"Check masses and belt stiffness, or simulate with a step shorter than {longest_step:g} s."
        )
