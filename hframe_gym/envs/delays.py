"""Delays of drives and sensors: the longest possible ones, and the past readings for late sensors."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Literal

import numpy as np

from ..arrays import Index, LaneReadings
from ..dynamics import LANES
from ..dynamics.codegen.compiled import compiled
from ..machine import Machine


def longest_delay(
    machine: Machine, components: Iterable[str], hook: Literal["delay", "measurement_delay"]
) -> float:
    """Return the longest delay, s, that the bounds of effects permit for any of some components.

    0 without such effects.

    Args:
        components: Names of drives or channels of sensors.
        hook: Formula of the effects: "delay" of drives, "measurement_delay" of sensors.
    """
    longest = 0.0
    for component in components:
        delays = 0.0
        for effect in machine.effects:
            formula = getattr(effect.definition, hook)
            if formula and component in effect.components(machine):
                delays += float(formula(*(p.upper for p in effect.definition.parameters)))
        longest = max(longest, delays)
    return longest


class DelayLine:
    """Keep a history of ideal measurements, one entry per integration step, for sensors with a delay.

    Args:
        machine: Machine with its sensors and their delays, which are effects.
        blocks: Number of blocks; a block is LANES environments, which are integrated together.
        h: Integration step, s.

    Attributes:
        delays: Delay of each sensor, s, shape (blocks, sensors, LANES). The simulator writes them at reset.
    """

    def __init__(self, machine: Machine, blocks: int, h: float) -> None:
        self._h = h
        sensors = len(machine.sensors)
        longest = longest_delay(machine, (s.channel for s in machine.sensors), "measurement_delay")
        self._depth = math.ceil(longest / h) + 3
        self._history = np.zeros((blocks, self._depth, sensors, LANES))
        self.delays = np.zeros((blocks, sensors, LANES))

    def fill(self, index: Index, readings: LaneReadings) -> None:
        """Fill the histories of k environments with their present measurements, as if at rest until now."""
        block, lane = np.divmod(index, LANES)
        self._history[block, :, :, lane] = readings[block, :, lane][:, None]

    def record(self, readings: LaneReadings, step: int, first: int, last: int) -> None:
        """Store the measurements of environments in blocks `first` to `last` - 1 after an integration step.

        They overwrite the oldest ones. The number of the step counts over all episodes and is the same for
        all environments.
        """
        self._history[first:last, step % self._depth] = readings[first:last]

    def read(self, step: int, first: int, last: int, out: LaneReadings) -> None:
        """Write the delayed measurements of the environments in blocks `first` to `last` - 1 to `out`.

        The measurement of a sensor with the delay T is the ideal one at the time T before the last recorded
        `step`, interpolated between recorded values. Before the start of the episode, it is the one at the
        start.
        """
        _interpolate(self._history, self.delays, self._h, step, first, last, out)


@compiled
def _interpolate(history: Any, delays: Any, h: float, step: int, first: int, last: int, out: Any) -> None:
    """Write measurements at time step * h - delay by a parabola through the three nearest records, to out."""
    depth = history.shape[1]
    for block in range(first, last):
        for j in range(out.shape[1]):
            for lane in range(LANES):
                back = min(delays[block, j, lane] / h, depth - 2.0)
                if back <= 0.0:
                    out[block, j, lane] = history[block, step % depth, j, lane]
                    continue
                middle = max(1, int(back + 0.5))
                u = middle - back  # in steps, towards the present
                newer = history[block, (step - middle + 1) % depth, j, lane]
                here = history[block, (step - middle) % depth, j, lane]
                older = history[block, (step - middle - 1) % depth, j, lane]
                out[block, j, lane] = (
                    here + 0.5 * u * (newer - older) + 0.5 * u * u * (newer - 2.0 * here + older)
                )
