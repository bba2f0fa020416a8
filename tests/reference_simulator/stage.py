"""One stage in motion, stepped with held voltages."""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.optimize import brentq

from tests.reference_simulator.equations import EXTRA
from tests.reference_simulator.integrate import advance
from tests.reference_simulator.rig import Array, Rig
from tests.reference_simulator.tables import tables

_INSTANT_S = 1e-12  # less than this apart, two times of the clock are one
_DRY = ("coulomb", "stribeck_force", "friction_wave", "friction_slope", "friction_cross_place", "friction_cross_speed")


class Stage:
    """At rest at first with unstretched belts; ``step`` it.

    ``position`` and ``velocity`` are (4,) at ``time_s``: x, y of the tool and phi1, phi2 of the encoders. ``mode`` is 0
    where a coordinate sticks, else the direction in which it slides.
    """

    def __init__(
        self,
        rig: Rig,
        start_xy: tuple[float, float] | Array = (0.0, 0.0),
        start_s: float = 0.0,
        *,
        rtol: float = 1e-10,
        atol: float = 1e-13,
    ) -> None:
        self.rig, self.time_s, self.rtol, self.atol = rig, float(start_s), rtol, atol
        self._tables, self._places = tables(rig)
        coordinates = self._tables.coordinates
        self._n = len(coordinates)
        self._z = np.zeros(4 * self._n + EXTRA)
        self._z[: self._n] = self._resting(float(start_xy[0]), float(start_xy[1]))
        # Frictionless coordinates never stick, whatever their velocity: no events for them.
        rigid = coordinates["bristle_stiffness"] == 0.0
        self._dry = np.any([coordinates[name] != 0.0 for name in _DRY], axis=0) & rigid
        self.mode = np.zeros(self._n)
        self._volts = np.zeros(2)  # before the first command nothing is driven
        self._pending: tuple[deque[tuple[float, float]], ...] = (deque(), deque())
        self._h = 1e-4

    def _resting(self, x: float, y: float) -> Array:
        """Coordinates (n,) at which no belt is stretched."""
        r, q = self.rig.pulley_radius_m, np.zeros(self._n)
        q[:4] = x, y, -(x + y) / r, (x - y) / r
        for j, (e, p) in enumerate(zip(self.rig.eccentricity_m, self.rig.eccentricity_phase, strict=True)):
            if e:
                round_ = q[2 + j]  # where it would be if the pulley were
                q[2 + j] = brentq(_travel_error, round_ - 1.0, round_ + 1.0, (r, e, p, r * round_))
        if self.rig.idlers:
            q[4:6] = q[2:4]
            q[6:8] = -x / r - q[2], x / r - q[3]
            q[8:10] = -x / r - q[4], x / r - q[5]
        for j, place in enumerate(self._places.encoders):
            q[place] = q[2 + j]
        if self.rig.payload:
            q[self._tables.links[-1]["second"]] = y
        return q

    def _seen(self, at: int) -> Array:
        """x, y, phi1, phi2 as the sensors see them (at = 0), or their rates (at = n)."""
        n, z = self._n, self._z
        seen = z[[at, at + 1, at + self._places.encoders[0], at + self._places.encoders[1]]]
        seen[0] += z[4 * n + 4 + (at > 0)]
        if self._places.yaw >= 0:
            yaw = self._places.yaw
            seen[0] += z[1] * z[at + yaw] + (z[n + 1] * z[yaw] if at else 0.0)
        return seen

    @property
    def position(self) -> Array:
        return self._seen(0)

    @property
    def velocity(self) -> Array:
        return self._seen(self._n)

    def step(self, volts: tuple[float, float] | Array, until_s: float) -> None:
        """Hold the commanded voltages (2,) [V] from now until ``until_s``."""
        for j in range(2):
            start = self.time_s + self.rig.input_delay_s[j]
            self._pending[j].append((start, float(volts[j])))
        while self.time_s < until_s - _INSTANT_S:
            due = until_s
            for j, queue in enumerate(self._pending):
                # A delayed command due within rounding of now is due now: no piece is that short.
                while queue and queue[0][0] <= self.time_s + _INSTANT_S:
                    self._volts[j] = queue.popleft()[1]
                if queue:
                    due = min(due, queue[0][0])
            self._advance(due)

    def _advance(self, until_s: float) -> None:
        self._h = advance(
            self.time_s,
            until_s,
            self._h,
            self._z,
            self._volts,
            self.mode,
            self._dry,
            self._tables,
            self.rtol,
            self.atol,
        )
        if not np.isfinite(self._h):
            raise RuntimeError(f"integration failed between t = {self.time_s} and {until_s} s")
        self.time_s = until_s


def _travel_error(angle: float, r: float, e: float, p: float, travel: float) -> float:
    """Belt travel of an eccentric pulley at an angle, less that wanted."""
    return r * angle + e * float(np.sin(angle + p)) - travel


def simulate(
    rig: Rig,
    time_s: Array,
    inputs: Array,
    start_xy: tuple[float, float] | Array = (0.0, 0.0),
    *,
    rtol: float = 1e-10,
    atol: float = 1e-13,
) -> tuple[Array, Array]:
    """Simulate a recording's inputs from rest with unstretched belts.

    Args:
        rig: the stage.
        time_s: (n,) strictly increasing [s]; effects that depend on time see this clock.
        inputs: (n, 2) voltages of motor 1 and 2 [V], each held from its row until the next.
            With an input delay the drives get 0 V until the first row arrives.
        start_xy: (2,) position of the carriage at the first row [m].
        rtol, atol: the integrator's tolerances; the defaults are the oracle's.

    Returns:
        positions (n, 4) [m, m, rad, rad] and velocities (n, 4), at the rows' times.
    """
    time_s, inputs = np.asarray(time_s, dtype=float), np.asarray(inputs, dtype=float)
    if inputs.shape != (len(time_s), 2):
        raise ValueError(f"inputs have shape {inputs.shape}, not ({len(time_s)}, 2)")
    stage = Stage(rig, start_xy, time_s[0], rtol=rtol, atol=atol)
    positions, velocities = np.empty((len(time_s), 4)), np.empty((len(time_s), 4))
    positions[0], velocities[0] = stage.position, stage.velocity
    for row in range(1, len(time_s)):
        stage.step(inputs[row - 1], time_s[row])
        positions[row], velocities[row] = stage.position, stage.velocity
    return positions, velocities


def energy(rig: Rig, position: Array, velocity: Array) -> Array:
    """Kinetic energy plus that of the belts and cables [J] of the 8th-order stage, (...) from (..., 4) and (..., 4)."""
    made, _ = tables(rig)
    stretch = (position * made.coordinates["radius"]) @ made.rows.T
    stiffness = made.belts[:, 0] / (made.belts[:, 1] + position[..., :2] @ made.growth.T)
    kinetic = 0.5 * (made.coordinates["mass"] * velocity**2).sum(axis=-1)
    trailing = made.coordinates["spring_stiffness"] * (position - made.coordinates["spring_rest"]) ** 2
    return kinetic + 0.5 * (stiffness * stretch**2).sum(axis=-1) + 0.5 * trailing.sum(axis=-1)
