"""Loads that swing on the carriages of a machine: their motion and force follow from the carriage's.

No sensor sees such a load. It is an oscillator that the acceleration of its carriage drives; if it rests when
an episode starts, the velocities of the carriage tell its motion. A controller is designed for the carriage
without the load (`rigid_counterpart`), and knows the force of the load ahead.
"""

from __future__ import annotations

import numpy as np

from ...arrays import Array, CoordinateForces, Mask, TravelStates
from ...dynamics import matrix_exponential
from ...machine import AppliedEffect, Machine, rigid_counterpart, slow_loads


class SwingingLoads:
    """The slowly swinging loads, L per machine, of B machines, with their deflections from rest.

    Args:
        machine: Machine with the effects that add the loads.
        period: Control period, s.

    Attributes:
        last_force: Mean force of the loads on each coordinate in the last period, N along the belt travel,
            shape (B, n) for the n coordinates of the machine without the loads.
    """

    def __init__(self, machine: Machine, period: float) -> None:
        rigid = rigid_counterpart(machine)
        self._period, self._loads = period, slow_loads(machine)
        names, units = rigid.coordinate_names, rigid.travel_per_unit
        self._sites = [names.index(load.site) for load in self._loads]
        # m of belt travel per unit of the coordinate
        self._units = np.array([units[site] for site in self._sites])
        self._count = len(names)
        self._motion: list[tuple[Array, Array, Array]] = [
            _discrete_motion(load, rigid.coordinate(load.site).mass, period) for load in self._loads
        ]
        # Deflection and its rate, in the units of the coordinates.
        self._state = np.zeros((0, len(self._loads), 2))
        self.last_force = np.zeros((0, self._count))

    def __bool__(self) -> bool:
        """Whether the machine has such a load."""
        return bool(self._loads)

    def follow(self, before: TravelStates, after: TravelStates, starts: Mask) -> None:
        """Update the loads' motion from the carriages' motion in the control period that has ended.

        Args:
            before: States at the beginning of the period.
            after: States at its end.
            starts: Machines whose episode starts with `after`: their loads rest.
        """
        if len(self._state) != len(after):
            self._state = np.zeros((len(after), len(self._loads), 2))
        velocities = np.stack([before[:, self._count :], after[:, self._count :]], axis=1)
        forces, self._state = self._moved(velocities)
        self.last_force = np.where(starts[:, None], 0.0, forces[:, 0])
        self._state[starts] = 0.0

    def forces(self, velocities: Array) -> Array:
        """Return mean forces on the coordinates in coming periods, N along the belt travel, shape (B, H, n).

        Args:
            velocities: Velocities of the coordinates now and at the ends of the H periods, m/s,
                shape (B, 1 + H, n).
        """
        return self._moved(velocities)[0]

    def coming_force(self, state: TravelStates) -> CoordinateForces:
        """Return the loads' mean forces on each coordinate in the next period, N, at constant velocity."""
        return self.forces(np.repeat(state[:, None, self._count :], 2, axis=1))[:, 0]

    def _moved(self, velocities: Array) -> tuple[Array, Array]:
        """Return mean forces (B, H, n) in periods from velocities (B, 1 + H, n), and the last state."""
        accelerations = np.diff(velocities, axis=1) / self._period
        forces, states = np.zeros_like(accelerations), self._state.copy()
        for k, (site, unit, (free, driven, reaction)) in enumerate(
            zip(self._sites, self._units, self._motion, strict=True)
        ):
            state = states[:, k]
            for period in range(accelerations.shape[1]):
                before = state
                state = before @ free.T + np.outer(accelerations[:, period, site] / unit, driven)
                forces[:, period, site] += 0.5 * (before + state) @ reaction / unit
            states[:, k] = state
        return forces, states


def _discrete_motion(load: AppliedEffect, mass: float, period: float) -> tuple[Array, Array, Array]:
    """Return a load's motion over a period, free (2, 2) and from an acceleration (2,), and its force (2,)."""
    zero = {"q": 0.0, "v": 0.0, "m": mass, "net": 0.0}
    rates = np.zeros((3, 3))
    rates[0, 1] = 1.0
    units = {"q": 1.0, "v": 1.0, "net": mass}  # net: of an acceleration of 1
    rates[1] = [load("force", **(zero | {key: unit})) / mass for key, unit in units.items()]
    discrete = matrix_exponential(rates * period)
    reaction = np.array([load("reaction", **(zero | {key: 1.0})) for key in "qv"])
    return discrete[:2, :2], discrete[:2, 2], reaction
