"""Directions of the drives: coordinates that a positive command moves against the count of their sensors.

The command of a motor with swapped wires, or of a bridge that is mounted the other way round, moves its
coordinate backwards. The balance of forces tells (`force_balance`): with positive inertia and friction, and
any spring, weight and offset, no machine explains such a motion, and it does if the sensors count the other
way. The rule is that of `hframe check`, applied to the changes of the forces over the session, so that it
also holds for a drive that holds a load. Changes do not tell swapped channels, which `hframe check` finds as
well: a force that hardly changes may seem to follow the motion of another coordinate.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ...machine import Machine, Sensor
from ...recordings import comparison_window
from ..dataset import PreparedRecording
from .force_balance import EXPLAINED, SPANS, explains_instead, force_balance
from .motion_windows import motion_windows


def turned_coordinates(machine: Machine, runs: Sequence[PreparedRecording]) -> tuple[str, ...]:
    """Find the coordinates that their drives move in the opposite direction to the declared one.

    Args:
        machine: Machine as declared. Machines with belts or effects on sensors are not checked: the direction
            of a coordinate would depend on others, and effect parameters would have to change.

    Returns:
        Names of the coordinates; none if the declared directions explain the motion, or if no directions do.
    """
    driven = tuple(dict.fromkeys(d.coordinate for d in machine.drives))
    of_sensors = any(e.definition.site == "sensor" for e in machine.effects)
    if machine.belts or of_sensors or not driven:
        return ()
    of_inputs = np.eye(len(machine.drives))
    for span in SPANS:  # short windows see fast motion, long ones suppress noise
        windows = [motion_windows(run, comparison_window(run.outputs, run.time_s, span)) for run in runs]
        declared = force_balance(windows, machine, np.eye(len(machine.sensors)), of_inputs)
        if declared is None or declared.of_changes < EXPLAINED:
            return ()
        left: dict[tuple[str, ...], float] = {}
        for count in range(1, len(driven) + 1):
            for names in combinations(driven, count):
                signs = np.diag([-1.0 if _counts(machine, s, names) else 1.0 for s in machine.sensors])
                balance = force_balance(windows, machine, signs, of_inputs)
                left[names] = np.inf if balance is None else balance.of_changes
        best = min(left, key=lambda names: left[names])
        if left[best] < EXPLAINED and explains_instead(left[best], declared.of_changes):
            return best
    return ()


def with_turned(machine: Machine, coordinates: Sequence[str]) -> Machine:
    """Return a copy of a machine in which the sensors of some coordinates have the opposite sign.

    Sensors that measure no direction of the motion keep theirs.

    Args:
        coordinates: Names of the coordinates, as `turned_coordinates` finds them.
    """
    turned = [
        dataclasses.replace(s, row={name: -factor for name, factor in s.row.items()})
        for s in machine.sensors
        if _counts(machine, s, coordinates)
    ]
    return machine.with_components(*turned)


def _counts(machine: Machine, sensor: Sensor, coordinates: Sequence[str]) -> bool:
    """Return whether a sensor measures the motion of one of the coordinates with its direction."""
    return sensor.has_direction and machine.coordinate_of_sensor(sensor) in coordinates
