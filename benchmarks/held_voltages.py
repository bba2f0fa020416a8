"""Settling times that physics allows a controller whose voltages are held over control periods.

A benchmark compares them with those of `TimeOptimalReach`, whose voltages may change at any time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import override

from hframe_gym.arrays import Array
from hframe_gym.controllers.models.casadi_model import check_supported
from hframe_gym.controllers.planning.time_optimal import HOLD_S, TimeOptimalMotion, TimeOptimalReach
from hframe_gym.machine import Machine

PER_PERIOD = 4  # collocation intervals of a control period with held voltages
LATEST_PERIODS = 4  # periods in which a motion with held voltages is sought
HELD_GUESSES = (1.0,)  # one attempt, because the guess does not depend on the estimated time
SHORTEST_PART_S = 1e-4  # s, least distance of the entry from the ends of its period
AT_START_S = 2e-4  # s after the start of the period, within which the entry counts as at its start


class HeldVoltageReach:
    """Solver of the time-optimal control problem with voltages that are held over control periods.

    It gives the shortest settling time of a controller that changes its voltages at the start of each control
    period. The problem of `TimeOptimalReach` is solved with the last entry into the band in control period K,
    that is, with T between K - 1 and K periods. K starts where the motion ends whose voltages may change at
    any time, and grows until there is a solution.

    Args:
        machine: Machine whose motion is optimized, with its effects, which must have no memory.
        period: Control period, s.
        band: Radius of the band around the goal, m.

    Raises:
        InputError: If the machine has an effect that is not supported.
    """

    def __init__(self, machine: Machine, period: float = 0.01, *, band: float = 2e-4) -> None:
        check_supported(machine)
        self.machine, self.period, self.band = machine, period, band
        self._problems: dict[int, _HeldProblem] = {}

    def solve(
        self, start: ArrayLike, goal: ArrayLike, parameters: ArrayLike | None, free_s: float
    ) -> TimeOptimalMotion:
        """Compute the time-optimal motion into the band around the goal, with voltages held over each period.

        Args:
            start: Tool position at the start, m, shape (axes,).
            goal: Tool position of the goal, m, shape (axes,).
            parameters: All parameters in the order of `Machine.parameters`, SI, shape (P,), or None for the
                machine's.
            free_s: Duration of the time-optimal motion whose voltages may change at any time, s, as computed
                by `TimeOptimalReach`. The search starts in the control period in which this motion ends.

        Returns:
            Duration, s, and commanded voltages, V, shape (intervals, drives), for the intervals between
            `edges_s`. The attribute `solved` is False if no motion is found that ends in the period of
            `free_s` or in the next three.
        """
        first = max(1, int(np.ceil(free_s / self.period)))
        for last in range(first, first + LATEST_PERIODS):
            motion = self._problem(last).solve(start, goal, parameters, HELD_GUESSES)
            if motion.solved:
                break
        # An entry at the very start of its period means that IPOPT did not converge for the period before.
        while motion.solved and last > first and motion.time_s < (last - 1) * self.period + AT_START_S:
            before = self._problem(last - 1)
            before.warm_start = self._problem(last).without_last_period()
            earlier = before.solve(start, goal, parameters, HELD_GUESSES)
            before.warm_start = None
            if not earlier.solved:
                break
            motion, last = earlier, last - 1
        return motion

    def _problem(self, last: int) -> _HeldProblem:
        """Return the problem with the entry in period `last`."""
        if last not in self._problems:
            self._problems[last] = _HeldProblem(self.machine, last, self.period, self.band)
        return self._problems[last]


class _HeldProblem(TimeOptimalReach):
    """Time-optimal control problem with held voltages and a last entry into the band in a given period."""

    def __init__(self, machine: Machine, last: int, period: float, band: float) -> None:
        self._last, self._period = last, period
        holding = round(HOLD_S / period) * PER_PERIOD
        self._window = ((last - 1) * period + SHORTEST_PART_S, last * period - SHORTEST_PART_S)
        self.warm_start: Array | None = None  # unknowns from which IPOPT starts
        super().__init__(machine, band=band, intervals=(last * PER_PERIOD, PER_PERIOD + holding))

    @property
    @override
    def _duration_limits(self) -> tuple[float, float]:
        return self._window

    @override
    def _grid(self, duration: Any) -> list[tuple[Any, Any]]:
        """Return begin and length of intervals, s: equal parts of each period, twice as many in the last."""
        period, entry = self._period, self._last - 1
        parts = [(k * period, period) for k in range(entry)] + [(entry * period, duration - entry * period)]
        parts += [(duration, self._last * period - duration)]
        parts += [((self._last + k) * period, period) for k in range(round(HOLD_S / period))]
        return [(b + j * (w / PER_PERIOD), w / PER_PERIOD) for b, w in parts for j in range(PER_PERIOD)]

    @override
    def _continues_voltage(self, k: int) -> bool:
        """Return whether interval k has the voltages of the one before: not at the beginning of a period."""
        return k % PER_PERIOD != 0 or k == self._last * PER_PERIOD

    @override
    def _guess(self, start: Array, goal: Array, time_s: float) -> Array:
        """Return an initial guess with T in the middle of its period, which `time_s` thus does not change."""
        if self.warm_start is not None:
            return self.warm_start
        guess = super()._guess(start, goal, self._window[1])
        guess[0] = 0.5 * sum(self._window)
        return guess

    def without_last_period(self) -> Array:
        """Return the last solution as a guess for an entry at the end of the period before."""
        rows = self.solution[1:].reshape(sum(self.intervals), -1)
        entry, holding = (self._last - 1) * PER_PERIOD, self.intervals[1]
        before, after = rows[:entry], rows[self._last * PER_PERIOD :]
        at_entry = np.repeat(before[-1:], PER_PERIOD, axis=0)
        guess = np.concatenate([before, at_entry, after[: holding - PER_PERIOD]])
        return np.concatenate([[(self._last - 1) * self._period - 2.0 * SHORTEST_PART_S], guess.ravel()])
