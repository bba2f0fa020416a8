"""The plausibility of a machine with identified effects: whether it is physical where no recording reaches.

A fit constrains an effect only where the recordings reach. Beyond, a belt that softens with extension may
lose all tension, and a machine file that simulates its recordings may then diverge under the voltages of a
controller in training.
"""

from __future__ import annotations

import dataclasses
import math
from functools import lru_cache

import numpy as np

from ...arrays import Array
from ...dynamics import simulate_batch
from ...machine import Machine, rest_state
from ..judge.effect import MachineBehavior, fault_of_machine

_HISTORIES, _SECONDS, _PERIOD = 4, 2.0, 1e-3  # s
# s, mean time between two jumps of a voltage; longer ones drive a carriage out of its workspace.
_MEAN_HOLD = 0.02


def top_speeds(machine: Machine) -> tuple[float, float]:
    """Return the top speeds of a machine with and without its effects under 2 s of random rated voltage.

    Every voltage switches between the positive and the negative rated one at random times (random telegraph
    signal). Only the time before the machine without effects leaves its workspace is evaluated; of a machine
    without effects, all of it.

    Returns:
        Largest rate of the belt travel with the effects and without them, m/s, equal if there are none;
        infinite if the motion diverges.
    """
    _, speeds = _random_motions(machine)
    if not machine.effects:
        return _top(speeds), _top(speeds)
    return speeds_inside(machine, speeds, *_random_motions(_without_effects(machine)))


def speeds_inside(machine: Machine, speeds: Array, positions: Array, reference: Array) -> tuple[float, float]:
    """Return the top speeds with and without effects before the machine without effects leaves its workspace.

    It leaves the workspace where a linear coordinate with a range leaves this range. Each voltage history is
    evaluated up to that time.

    Args:
        machine: The machine, with the ranges of its coordinates.
        speeds: Magnitudes of the speeds with the effects, as rates of the belt travel, m/s, shape (voltage
            histories, n samples, coordinates).
        positions: Positions without the effects, m or rad, of the same shape.
        reference: Magnitudes of the speeds without the effects, m/s, of the same shape.

    Returns:
        Largest speed with the effects, infinite if that motion diverges, and without them, m/s.
    """
    # Also without its effects a machine may leave its workspace, where belts become infinitely stiff.
    inside = np.ones(positions.shape[:2], np.bool_)
    for i, coordinate in enumerate(machine.coordinates):
        if coordinate.kind == "linear" and coordinate.range:
            low, high = coordinate.range
            inside &= (positions[..., i] >= low) & (positions[..., i] <= high)
    inside = np.logical_and.accumulate(inside, axis=1)
    return _top(speeds[inside]), float(reference[inside].max())


def _top(speeds: Array) -> float:
    """Return the largest of some speeds, m/s; infinite if one is not finite."""
    return float(speeds.max()) if np.isfinite(speeds).all() else math.inf


def plausibility_fault(machine: Machine) -> str:
    """Return why a machine is not physical outside its fitted recordings, or "" if it is.

    Returns:
        Clause that follows "it", for example "makes the machine diverge under random rated voltage"; empty if
        there is no fault (`judge.effect.fault_of_machine`).
    """
    misnamed = [
        effect.label
        for effect in machine.effects
        for parameter in effect.definition.parameters
        if effect.parameters[parameter.name] < parameter.named_from
    ]
    return fault_of_machine(MachineBehavior(lambda: top_speeds(machine), misnamed))


def _without_effects(machine: Machine) -> Machine:
    """Return the machine without effects, except for those that added coordinates or belts."""
    return dataclasses.replace(machine, effects=tuple(e for e in machine.effects if e.definition.structure))


def _random_motions(machine: Machine) -> tuple[Array, Array]:
    """Simulate a machine, at rest in the middle of its workspace at first, under random rated voltages.

    Return positions, m or rad, and magnitudes of the belt travel's rates, m/s, (histories, n, coordinates)
    each.
    """
    rated = np.array([drive.rated_voltage for drive in machine.drives])
    inputs = _random_telegraph(len(rated)) * rated
    time_s = np.arange(inputs.shape[1], dtype=np.float64) * _PERIOD
    ranges = [c.range or (0.0, 0.0) for c in machine.coordinates if c.kind == "linear"]
    start = rest_state(machine, np.mean(np.reshape(ranges, (-1, 2)), axis=1))
    motion = simulate_batch(machine, time_s, inputs, start=start, readings=False)
    return motion.positions, np.abs(motion.velocities) * machine.travel_per_unit


@lru_cache(maxsize=8)
def _random_telegraph(drives: int) -> Array:
    """Return random telegraph signals of +1 and -1, shape (histories, n, drives)."""
    rng = np.random.default_rng(0)
    shape = (_HISTORIES, round(_SECONDS / _PERIOD), drives)
    switches = rng.random(shape) < _PERIOD / _MEAN_HOLD
    first = rng.choice([-1.0, 1.0], (_HISTORIES, 1, drives))
    return first * np.where(np.cumsum(switches, axis=1) % 2, -1.0, 1.0)
