"""Time the kernel on a batch of stages, and two rates in turn; used by the speed benchmarks."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hframe_gym.arrays import Array
from hframe_gym.dynamics import LANES, in_blocks, in_parallel, kernel_for
from hframe_gym.dynamics.simulation import parameter_batch
from hframe_gym.machine import Machine

SEED = 7
STEP, HOLD = 0.25e-3, 40  # s; steps for which a voltage is held
PERIODS = 10  # voltages of a history
VOLTS = 6.0  # amplitude of the random voltages
REPEATS = 7
_CHUNK = 32  # blocks of SIMD lanes that are advanced together


def random_voltages(batch: int, inputs: int = 2) -> Array:
    """Return random voltages of some stages with some drives, V, shape (PERIODS, batch, inputs)."""
    return np.random.default_rng(SEED).uniform(-VOLTS, VOLTS, (PERIODS, batch, inputs))


@dataclass
class KernelBatch:
    """Batch of stages in blocks of SIMD lanes, compiled and ready to run.

    Args:
        machine: Machine of all stages.
        batch: Number of stages.
    """

    machine: Machine
    batch: int

    def __post_init__(self) -> None:
        m = self.machine
        self.kernel = kernel_for(m)
        # (blocks, parameters, LANES)
        self.parameters = in_blocks(np.tile(parameter_batch(m), (self.batch, 1)))
        self.blocks = len(self.parameters)
        self.derived = np.zeros((self.blocks, len(self.kernel.layout.derived), LANES))
        self.kernel.prepare_blocks(self.parameters, STEP, 0, self.blocks, self.derived)
        self.inputs = [in_blocks(u) for u in random_voltages(self.batch, inputs=len(m.drives))]
        self.state = np.zeros((self.blocks, 2 * len(m.coordinates) + 1, LANES))
        # Compile before the first clock starts.
        self.kernel.advance_blocks(self.state, self.parameters, self.derived, self.inputs[0], STEP, 0, 0, 0)

    def bytes_per_stage(self) -> float:
        """Return the memory of a stage: state, parameters, derived parameters and voltages, bytes."""
        arrays = (self.state, self.parameters, self.derived, self.inputs[0])
        return sum(a.nbytes for a in arrays) / (self.blocks * LANES)

    def advance(self, first: int, last: int) -> None:
        """Advance some blocks through their history.

        As in MuJoCo's rollout, a chunk of stages goes through its complete history before the next, so that
        it stays in the cache.

        Args:
            first: First block.
            last: Block after the last.
        """
        for begin in range(first, last, _CHUNK):
            end = min(begin + _CHUNK, last)
            for u in self.inputs:
                self.kernel.advance_blocks(
                    self.state, self.parameters, self.derived, u, STEP, HOLD, begin, end
                )

    def rate(self, *, parallel: bool, least: float = 0.1) -> float:
        """Return the integrator steps per second, from rest.

        Args:
            parallel: Whether to use all cores.
            least: Minimum duration of the measurement, s.

        Returns:
            Steps of all stages together, 1/s.
        """
        run = (
            (lambda: in_parallel(self.advance, self.blocks))
            if parallel
            else (lambda: self.advance(0, self.blocks))
        )
        steps = 0
        begin = time.perf_counter()
        while (spent := time.perf_counter() - begin) < least or steps == 0:
            self.state[:] = 0.0
            run()
            steps += self.batch * HOLD * len(self.inputs)
        return steps / spent


@dataclass(frozen=True)
class Ratio:
    """Rates of two simulators that were measured in turn, 1/s."""

    ours: list[float]
    theirs: list[float]

    @property
    def each(self) -> list[float]:
        """Return the ratio of every pair."""
        return [a / b for a, b in zip(self.ours, self.theirs, strict=True)]

    def report(self) -> dict[str, Any]:
        """Return median and extremes of the ratios, and the median rates, as plain data."""
        return {
            "ratio": statistics.median(self.each),
            "spread": [min(self.each), max(self.each)],
            "ours_steps_per_s": statistics.median(self.ours),
            "theirs_steps_per_s": statistics.median(self.theirs),
        }


def interleaved(ours: Callable[[], float], theirs: Callable[[], float], repeats: int = REPEATS) -> Ratio:
    """Measure two rates in turn; one round before the first is not counted.

    Args:
        ours: Function that returns this package's rate, 1/s.
        theirs: Function that returns the other's rate, 1/s.
        repeats: Number of pairs.
    """
    ours(), theirs()
    pairs = [(ours(), theirs()) for _ in range(repeats)]
    return Ratio([a for a, _ in pairs], [b for _, b in pairs])
