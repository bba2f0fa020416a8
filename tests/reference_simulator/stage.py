"""Simulate a stage under voltages that are held between samples."""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.optimize import brentq

from tests.reference_simulator.equations import DRY_FRICTION, derivative, state_size
from tests.reference_simulator.integrator import advance
from tests.reference_simulator.parameter_arrays import parameter_arrays
from tests.reference_simulator.rig import Array, Rig

_TIME_TOLERANCE_S = 1e-12  # two times closer than this are the same


class Stage:
    """Stage that advances step by step, at first at rest with unstretched belts.

    Attributes:
        rig: Parameters of the stage.
        time_s: Present time, s.
        mode: Modes of dry friction, shape (n,): 0 while a coordinate sticks, otherwise its direction of
            sliding.

    Args:
        rig: Parameters of the stage.
        start_xy: Position of the carriage, m, shape (2,).
        start_s: Start time on the session's clock, s.
        rtol: Relative tolerance of the integrator.
        atol: Absolute tolerance of the integrator, SI.
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
        self._arrays, self._measured = parameter_arrays(rig)
        coordinates = self._arrays.coordinates
        self._n = len(coordinates)
        self._z = np.zeros(state_size(self._arrays))
        self._z[: self._n] = self._unstretched(float(start_xy[0]), float(start_xy[1]))
        # A coordinate without friction never sticks, so it has no events.
        rigid = coordinates["bristle_stiffness"] == 0.0
        self._dry = np.any([coordinates[name] != 0.0 for name in DRY_FRICTION], axis=0) & rigid
        self.mode = np.zeros(self._n)
        self._volts = np.zeros(2)  # until the first command arrives
        self._pending: tuple[deque[tuple[float, float]], ...] = (deque(), deque())
        self._h = 1e-4

    def _unstretched(self, x: float, y: float) -> Array:
        """Return the coordinates (n,) at which no belt is stretched."""
        r, q = self.rig.pulley_radius_m, np.zeros(self._n)
        q[:4] = x, y, -(x + y) / r, (x - y) / r
        for j, (e, p) in enumerate(zip(self.rig.eccentricity_m, self.rig.eccentricity_phase, strict=True)):
            if e:
                concentric = q[2 + j]  # the angle of a pulley without eccentricity
                q[2 + j] = brentq(
                    _travel_error, concentric - 1.0, concentric + 1.0, (r, e, p, r * concentric)
                )
        if self.rig.idlers:
            q[4:6] = q[2:4]
            q[6:8] = -x / r - q[2], x / r - q[3]
            q[8:10] = -x / r - q[4], x / r - q[5]
        for j, encoder in enumerate(self._measured.encoders):
            q[encoder] = q[2 + j]
        if self.rig.payload:
            q[self._arrays.links[-1]["second"]] = y
        return q

    def _measure(self, offset: int) -> Array:
        """Return x, y, phi1, phi2 as sensors measure (offset 0), or their rates (offset n), shape (4,)."""
        n, z = self._n, self._z
        measured = z[
            [offset, offset + 1, offset + self._measured.encoders[0], offset + self._measured.encoders[1]]
        ]
        measured[0] += z[4 * n + 4 + (offset > 0)]
        if self._measured.yaw >= 0:
            yaw = self._measured.yaw
            measured[0] += z[1] * z[offset + yaw] + (z[n + 1] * z[yaw] if offset else 0.0)
        return measured

    @property
    def coordinates(self) -> Array:
        """Return all coordinates, m and rad, shape (n,): x, y, phi1, phi2 and those of further bodies."""
        return self._z[: self._n].copy()

    @property
    def position(self) -> Array:
        """Return x, y of the tool, m, and phi1, phi2 of the encoders, rad, shape (4,)."""
        return self._measure(0)

    @property
    def velocity(self) -> Array:
        """Return the rates of `position`, m/s and rad/s, shape (4,)."""
        return self._measure(self._n)

    @property
    def acceleration(self) -> Array:
        """Return accelerations of x, y, phi1, phi2 before the next command, m/s^2 and rad/s^2, shape (4,)."""
        dz, force, level = np.empty_like(self._z), np.empty(self._n), np.empty(self._n)
        derivative(self.time_s, self._z, self._volts, self.mode, self._arrays, dz, force, level)
        return dz[self._n : self._n + 4]

    @property
    def current(self) -> Array:
        """Return the currents of motor 1 and 2 just before the next command, A, shape (2,)."""
        rig, rates = self.rig, self._z[self._n + 2 : self._n + 4]
        ohmic = (self._volts - rig.gear_ratio * np.array(rig.emf_constant) * rates) / np.array(
            rig.resistance_ohm
        )
        lagged = self._z[2 * self._n : 2 * self._n + 2]
        amps = np.where(np.array(rig.electrical_lag_s) > 0.0, lagged, ohmic)
        return np.clip(amps, -np.array(rig.current_limit_A), rig.current_limit_A)

    def step(self, volts: tuple[float, float] | Array, until_s: float) -> None:
        """Hold the commanded voltages until a later time.

        Args:
            volts: Voltages of motor 1 and 2, V, shape (2,).
            until_s: Time to advance to, s.
        """
        for j in range(2):
            start = self.time_s + self.rig.input_delay_s[j]
            self._pending[j].append((start, float(volts[j])))
        while self.time_s < until_s - _TIME_TOLERANCE_S:
            due = until_s
            for j, queue in enumerate(self._pending):
                # A delayed command that is due within rounding of the present time takes effect now.
                while queue and queue[0][0] <= self.time_s + _TIME_TOLERANCE_S:
                    self._volts[j] = queue.popleft()[1]
                if queue:
                    due = min(due, queue[0][0])
            self._advance(due)

    def _advance(self, until_s: float) -> None:
        """Integrate to a time under the voltages that have arrived at the drives."""
        self._h = advance(
            self.time_s,
            until_s,
            self._h,
            self._z,
            self._volts,
            self.mode,
            self._dry,
            self._arrays,
            self.rtol,
            self.atol,
        )
        if not np.isfinite(self._h):
            raise RuntimeError(f"integration failed between t = {self.time_s} and {until_s} s")
        self.time_s = until_s


def _travel_error(angle: float, r: float, e: float, p: float, travel: float) -> float:
    """Return the belt travel of an eccentric pulley at an angle, minus the required travel."""
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
    """Simulate a voltage history from rest with unstretched belts.

    Args:
        rig: Parameters of the stage.
        time_s: Sample times, s, strictly increasing, shape (n,). Effects that depend on time use this clock.
        inputs: Voltages of motor 1 and 2, V, each held from its row until the next, shape (n, 2). With an
            input delay the drives receive 0 V until the first row arrives.
        start_xy: Position of the carriage at the first row, m, shape (2,).
        rtol: Relative tolerance of the integrator. The default is the oracle's.
        atol: Absolute tolerance of the integrator, SI. The default is the oracle's.

    Returns:
        Positions x, y, phi1, phi2, m and rad, shape (n, 4), and their rates, shape (n, 4).

    Raises:
        ValueError: If the inputs do not have two columns and one row per time.
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
    """Return the kinetic energy plus the energy of belts and cables of the 8th-order stage.

    Args:
        rig: Parameters of the stage.
        position: Coordinates x, y, phi1, phi2, m and rad, shape (..., 4).
        velocity: Rates of the coordinates, shape (..., 4).

    Returns:
        Energy, J, shape (...).
    """
    arrays, _ = parameter_arrays(rig)
    stretch = (position * arrays.coordinates["radius"]) @ arrays.rows.T
    stiffness = arrays.belts[:, 0] / (arrays.belts[:, 1] + position[..., :2] @ arrays.length_gradient.T)
    kinetic = 0.5 * (arrays.coordinates["mass"] * velocity**2).sum(axis=-1)
    trailing = arrays.coordinates["spring_stiffness"] * (position - arrays.coordinates["spring_rest"]) ** 2
    return kinetic + 0.5 * (stiffness * stretch**2).sum(axis=-1) + 0.5 * trailing.sum(axis=-1)
