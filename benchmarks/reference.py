"""An independent simulator of the H-frame stage: the oracle and the rig of the benchmarks.

It shares neither code nor method with ``hframe_gym``. The equations come straight from the
Lagrangian of the 8th-order model, friction is event-driven (every coordinate sticks or slides in a
known direction, and nothing is regularised), and between events SciPy's DOP853 integrates a smooth
system to tight tolerances. Slow and exact: about half a second for a second of stage at 1 kHz.

Coordinates, always in this order: x (bridge) [m], y (cart) [m], phi1, phi2 (belt pulleys) [rad].
Belts, in this order: left, right, bottom. Drives: motor 1 on phi1, motor 2 on phi2.
"""

from __future__ import annotations

import warnings
from collections import deque

import numpy as np
from numba import njit
from scipy.integrate import DOP853
from scipy.optimize import brentq

from benchmarks.rigs import Array, Rig, tables

# A stuck coordinate lets go this much (relative) above its breakaway level, so that it leaves with
# an acceleration of the right sign whatever the rounding of the event's time.
_INSTANT_S = 1e-12  # less than this apart, two times of the clock are one
_RELEASE = 1e-9
_SAMPLES = 8  # points of every integration step at which events are looked for


@njit(cache=True)
def _smooth_force(
    z: Array, volts: Array, coordinates: Array, drives: Array, belts: Array
) -> Array:  # pragma: no cover - compiled
    """Every force but dry friction, (4,)."""
    force = np.empty(4)
    for i in range(4):
        q, v = z[i], z[4 + i]
        viscous = coordinates[1, i] * (1.0 + coordinates[2, i] * np.sign(v))
        force[i] = coordinates[6, i] - viscous * v - coordinates[7, i] * v * abs(v)
        force[i] -= coordinates[8, i] * (q - coordinates[9, i])
    for j in range(2):
        torque = drives[0, j] * volts[j] + drives[1, j] - drives[2, j] * z[6 + j]
        torque += drives[3, j] * np.sin(drives[4, j] * z[2 + j] + drives[5, j])
        force[2 + j] += torque
    for b in range(3):
        length = belts[b, 1] + belts[b, 2] * z[0] + belts[b, 3] * z[1]
        k = belts[b, 0] / length
        s = 0.0
        for i in range(4):
            s += belts[b, 4 + i] * z[i]
        for i in range(4):
            force[i] -= k * s * belts[b, 4 + i]
        # -1/2 s^2 dk/dq with dk/dq = -k/length dlength/dq: a stretched belt also pulls the
        # carriage to where it is softer. Without it energy is not conserved.
        for i in range(2):
            force[i] += 0.5 * s * s * k / length * belts[b, 2 + i]
    return force


@njit(cache=True)
def _accelerate(force: Array, z: Array, mode: Array, coordinates: Array) -> Array:  # pragma: no cover - compiled
    """d/dt of (q, v) in the given modes, (8,); a stuck coordinate stays."""
    dz = np.zeros(8)
    for i in range(4):
        if mode[i] != 0.0:
            v = z[4 + i]
            dry = coordinates[3, i]
            if coordinates[4, i] != 0.0:
                dry += coordinates[4, i] * np.exp(-((v / coordinates[5, i]) ** 2))
            dz[i] = v
            dz[4 + i] = (force[i] - mode[i] * dry) / coordinates[0, i]
    return dz


@njit(cache=True)
def _smooth_rhs(
    z: Array, volts: Array, mode: Array, coordinates: Array, drives: Array, belts: Array
) -> Array:  # pragma: no cover - compiled
    force = _smooth_force(z, volts, coordinates, drives, belts)
    return _accelerate(force, z, mode, coordinates)


class Stage:
    """One stage in motion, at rest at first with unstretched belts: ``step`` it with held voltages.

    ``position`` and ``velocity`` are (4,) at ``time_s``. ``mode`` (4,) is 0 where a coordinate
    sticks, else the direction in which it slides.
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
        x, y = (float(value) for value in start_xy)
        r = rig.pulley_radius_m
        self.rig, self.time_s, self.rtol, self.atol = rig, float(start_s), rtol, atol
        self._tables = tables(rig)
        self._z = np.array([x, y, -(x + y) / r, (x - y) / r, 0.0, 0.0, 0.0, 0.0])
        self._level = self._tables[0][3] + self._tables[0][4]
        # Frictionless coordinates never stick, whatever their velocity: no events for them.
        self._dry = np.any(self._tables[0][3:5] != 0.0, axis=0)
        self.mode = np.zeros(4)
        self._volts = np.zeros(2)  # before the first command nothing is driven
        self._pending: tuple[deque[tuple[float, float]], ...] = (deque(), deque())
        self._h = np.inf

    @property
    def position(self) -> Array:
        return self._z[:4].copy()

    @property
    def velocity(self) -> Array:
        return self._z[4:].copy()

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

    def _force(self, t: float, z: Array) -> Array:
        force = _smooth_force(z, self._volts, *self._tables)
        if self.rig.extra_force is not None:
            force += self.rig.extra_force(t, z[:4], z[4:])
        return force

    def _rhs(self, t: float, z: Array) -> Array:
        if self.rig.extra_force is None:
            return _smooth_rhs(z, self._volts, self.mode, *self._tables)
        return _accelerate(self._force(t, z), z, self.mode, self._tables[0])

    def _margin(self, t: float, z: Array, i: int) -> float:
        """What coordinate i has left until its mode ends: speed, or force below breakaway."""
        if self.mode[i] != 0.0:
            return self.mode[i] * z[4 + i]
        return self._level[i] * (1.0 + _RELEASE) - abs(self._force(t, z)[i])

    def _resolve(self) -> None:
        """Choose the modes of the coordinates that stand still: the force may have jumped."""
        force = self._force(self.time_s, self._z)
        for i in range(4):
            if not self._dry[i]:
                self.mode[i] = 1.0
            elif self._z[4 + i] == 0.0:
                held = abs(force[i]) <= self._level[i] * (1.0 + _RELEASE)
                self.mode[i] = 0.0 if held else np.sign(force[i])

    def _advance(self, until_s: float) -> None:
        """Integrate to ``until_s`` under constant voltages, event by event."""
        self._resolve()
        for _ in range(10_000):
            event = self._smooth_piece(until_s)
            if event is None:
                return
            if self.mode[event] != 0.0:  # stopped: stick, or turn round
                self._z[4 + event] = 0.0
                self.mode[event] = 0.0
                force = self._force(self.time_s, self._z)[event]
                if abs(force) > self._level[event] * (1.0 + _RELEASE):
                    self.mode[event] = np.sign(force)
            else:  # broke away
                self.mode[event] = np.sign(self._force(self.time_s, self._z)[event])
        raise RuntimeError(f"friction events do not end at t = {self.time_s} s")

    def _smooth_piece(self, until_s: float) -> int | None:
        """Integrate in the present modes; the coordinate whose mode ended, None at ``until_s``."""
        if until_s <= self.time_s:
            return None
        first = min(self._h, until_s - self.time_s)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            solver = DOP853(
                self._rhs,
                self.time_s,
                self._z,
                until_s,
                rtol=self.rtol,
                atol=self.atol,
                first_step=first,
            )
        while solver.status == "running":
            message = solver.step()
            if solver.status == "failed":
                raise RuntimeError(f"integration failed at t = {solver.t} s: {message}")
            event = self._first_event(solver)
            if event is not None:
                self.time_s, self._z, index = event
                return index
            self.time_s, self._z = solver.t, solver.y.copy()
            self._h = solver.h_abs
        return None

    def _first_event(self, solver: DOP853) -> tuple[float, Array, int] | None:
        """The earliest end of a mode within the solver's last step: its time, state, coordinate."""
        dense = solver.dense_output()
        times = np.linspace(solver.t_old, solver.t, _SAMPLES + 1)
        states = dense(times).T
        best: tuple[float, Array, int] | None = None
        for i in np.flatnonzero(self._dry):
            margins = [self._margin(t, z, i) for t, z in zip(times, states, strict=True)]
            if min(margins[1:]) > 0.0:
                continue
            # A coordinate that starts to slide starts with a margin of zero: that is no event.
            ends = [n for n in range(1, _SAMPLES + 1) if margins[n] <= 0.0 < margins[n - 1]]
            if margins[1] <= 0.0 and not margins[0] > 0.0:
                t = times[0] if self.mode[i] == 0.0 else times[1]
            elif ends:
                a, b = times[ends[0] - 1], times[ends[0]]
                t = float(brentq(lambda s, i=i: self._margin(s, dense(s), i), a, b, xtol=1e-15))
            else:
                continue
            if best is None or t < best[0]:
                best = (t, dense(t), int(i))
        return best


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
        rtol, atol: DOP853's tolerances; the defaults are the oracle's.

    Returns:
        positions (n, 4) [m, m, rad, rad] and velocities (n, 4), at the rows' times.
    """
    time_s, inputs = np.asarray(time_s, dtype=float), np.asarray(inputs, dtype=float)
    if inputs.shape != (len(time_s), 2):
        raise ValueError(f"inputs have shape {inputs.shape}, not ({len(time_s)}, 2)")
    stage = Stage(rig, start_xy, time_s[0], rtol=rtol, atol=atol)
    states = np.empty((len(time_s), 8))
    states[0] = stage._z
    for row in range(1, len(time_s)):
        stage.step(inputs[row - 1], time_s[row])
        states[row] = stage._z
    return states[:, :4].copy(), states[:, 4:].copy()


def energy(rig: Rig, position: Array, velocity: Array) -> Array:
    """Kinetic energy plus that of the belts and cables [J], (...) from (..., 4) and (..., 4)."""
    coordinates, _, belts = tables(rig)
    stretch = position @ belts[:, 4:].T
    stiffness = belts[:, 0] / (belts[:, 1] + position[..., :2] @ belts[:, 2:4].T)
    kinetic = 0.5 * (coordinates[0] * velocity**2).sum(axis=-1)
    cable = 0.5 * (coordinates[8] * (position - coordinates[9]) ** 2).sum(axis=-1)
    return kinetic + 0.5 * (stiffness * stretch**2).sum(axis=-1) + cable
