"""Simulation of machines over recordings, in batches."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..machine.kinematics import rest_state
from ..machine.machine import Machine
from .kernel import Kernel, kernel_for
from .simd import LANES

LONGEST_STEP = 0.25e-3  # s; 0.2 um median error over 0.4 s of random voltages (benchmarks/accuracy.py)

_BEYOND = 1e6  # m, rad, or that a second: no such stage, and no such number travels on

Array = NDArray[np.float64]
_NOTHING = np.zeros((0, 0))
_NO_SERIES = np.zeros((0, 0, 0))


@dataclass(frozen=True)
class Trajectory:
    """What a machine did.

    time_s (n,); positions and velocities (n, coordinates) in m, rad and per second; outputs (n, sensors), noise-free,
    with their channels' names.
    """

    time_s: Array
    positions: Array
    velocities: Array
    outputs: Array
    channels: tuple[str, ...]


class NotFiniteError(ArithmeticError):
    """A simulation left all bounds: the machine's parameters or inputs are impossible."""


def threads() -> int:
    """How many threads batches use: `$HFRAME_THREADS`, else every core that this process may use."""
    explicit = os.environ.get("HFRAME_THREADS")
    return max(1, int(explicit)) if explicit else _cores(os.getpid())


@lru_cache(maxsize=1)
def _cores(process: int) -> int:
    """Cores that this process may use, asked for once a process."""
    return len(os.sched_getaffinity(0))


def in_parallel(run: Callable[[int, int], None], blocks: int) -> None:
    """Call run(first, last) on ranges that cover all blocks, one range a thread."""
    count = min(threads(), blocks)
    if count <= 1:
        run(0, blocks)
        return
    edges = [blocks * i // count for i in range(count + 1)]
    pool = _pool(os.getpid(), count - 1)
    others = [pool.submit(run, *own) for own in itertools.pairwise(edges[1:])]
    run(edges[0], edges[1])
    for other in others:
        other.result()


@lru_cache(maxsize=4)
def _pool(process: int, workers: int) -> ThreadPoolExecutor:
    """Threads kept between calls; a forked process does not inherit them, so it makes its own."""
    return ThreadPoolExecutor(workers, thread_name_prefix="hframe")


def parameter_batch(machine: Machine, changes: dict[str, Array] | None = None) -> Array:
    """Parameters (B, P) of a batch of machines of one shape: the machine's own, with arrays (B,) in place of some."""
    values = machine.parameters
    changes = changes or {}
    batch = max((len(v) for v in changes.values()), default=1)
    table = np.tile(np.array(list(values.values())), (batch, 1))
    for name, column in changes.items():
        table[:, list(values).index(name)] = column
    return table


class Motion(NamedTuple):
    """A batch over one time grid, own units: positions (B, n, coordinates), velocities the same, readings
    (B, n, sensors); what was not asked for is empty."""

    positions: Array
    velocities: Array
    readings: Array


def simulate_batch(
    machine: Machine,
    time_s: Array,
    inputs: Array,
    *,
    parameters: Array | None = None,
    start: Array | None = None,
    extra_force: Array | None = None,
    measured: Array | None = None,
    gains: Array | None = None,
    longest_step: float = LONGEST_STEP,
    states: bool = True,
    readings: bool = True,
    parallel: bool = True,
) -> Motion:
    """The motion of a batch of machines of one shape.

    inputs (n, inputs) or (B, n, inputs), V; parameters (B, P) in the order of `Machine.parameters`; start (2 c,) or
    (B, 2 c), own units; extra_force (n, c) or (B, n, c), N or Nm, held; measured (n, sensors) or (B, n, sensors) with
    gains (2 c, sensors): output injection, state += gains @ (measured - reading) at every row, own units.  parallel:
    spread blocks of lanes over threads (off where the caller spreads recordings).
    """
    kernel: Kernel = kernel_for(machine, forced=extra_force is not None)
    count = len(machine.coordinates)
    radii = machine.radii

    def series(values: Array | None) -> Array:
        if values is None:
            return _NO_SERIES
        return np.ascontiguousarray(values if np.ndim(values) == 3 else np.asarray(values)[None], float)

    inputs, force, observed = series(inputs), series(extra_force), series(measured)
    parameters = parameter_batch(machine) if parameters is None else parameters
    start = np.atleast_2d(rest_state(machine) if start is None else start)
    batch = max(map(len, (inputs, parameters, start, force, observed)))
    # Copies: a broadcast row would be read-only, which is another type to Numba and a second compilation.
    parameters = np.array(np.broadcast_to(parameters, (batch, parameters.shape[1])), order="C")
    travel = np.array(np.broadcast_to(start * np.tile(radii, 2), (batch, 2 * count)), order="C")
    force = np.ascontiguousarray(force / radii) if len(force) else np.zeros((1, 1, count))
    travel_gains = gains * np.tile(radii, 2)[:, None] if gains is not None else _NOTHING
    grid = np.ascontiguousarray(time_s, float)
    out = np.empty((batch, len(grid), 2 * count)) if states else _NO_SERIES
    shown = np.empty((batch, len(grid), len(machine.sensors))) if readings else _NO_SERIES

    def run(first: int, last: int) -> None:
        kernel.rollout(
            grid, inputs, parameters, travel, observed, travel_gains, force, longest_step, first, last, out, shown
        )

    blocks = -(-batch // LANES)
    if parallel:
        in_parallel(run, blocks)
    else:
        run(0, blocks)
    if states:
        out /= np.tile(radii, 2)
    return Motion(out[..., :count], out[..., count:], shown)


def rollout(machine: Machine, time_s: Array, inputs: Array, *, velocities: bool = False, **options: Any) -> Array:
    """Positions (B, n, coordinates), with velocities behind them if asked; options as of `simulate_batch`."""
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
    """The machine's free run under voltages inputs (n, inputs), each held from its time until the next.

    initial: state (2 c,) (default: at rest, belts unstretched, at the origin).  offset: of the sensors' zeros
    (sensors,), added to the outputs.  longest_step: of the integrator, s.

    Raises ValueError for arrays that do not fit, NotFiniteError when the motion leaves all bounds.
    """
    grid = np.asarray(time_s, float)
    voltages = np.asarray(inputs, float)
    if grid.ndim != 1 or len(grid) == 0 or np.any(np.diff(grid) <= 0) or not np.all(np.isfinite(grid)):
        raise ValueError("time_s must be a row of finite, strictly increasing times")
    if voltages.shape != (len(grid), len(machine.drives)):
        expected = (len(grid), len(machine.drives))
        raise ValueError(f"inputs have shape {voltages.shape}, machine {machine.name!r} needs {expected}")
    if not np.all(np.isfinite(voltages)):
        row, column = map(int, np.argwhere(~np.isfinite(voltages))[0])
        raise ValueError(f"inputs: row {row}, {machine.input_channels[column]} is {voltages[row, column]}")
    start = None if initial is None else np.asarray(initial, float)
    motion = simulate_batch(machine, grid, voltages, start=start, longest_step=longest_step)
    wild = ~(np.abs(np.concatenate(motion, axis=2)[0]) < _BEYOND)
    if wild.any():
        row = int(np.argwhere(wild)[0][0])
        raise NotFiniteError(
            f"machine {machine.name!r}: the motion leaves all bounds at t = {grid[row]:g} s; "
            f"is it stiffer than steps of {longest_step:g} s can follow?"
        )
    outputs = motion.readings[0] + np.asarray(offset, float)
    return Trajectory(grid, motion.positions[0], motion.velocities[0], outputs, machine.output_channels)
