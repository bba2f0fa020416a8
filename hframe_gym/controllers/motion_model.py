"""A machine as its controllers see it: full state in belt travel, rigid motion, and what resists it.

All positions here are travel (p = radius * angle, m), all forces act on travel (N): x, y and the motors have one scale.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from ..machine import AppliedEffect, Machine, linearize, rest_state
from ..machine.effect import asked
from .operating_points import AXES

Array = NDArray[np.float64]
# m/s: below it a coordinate counts as turning around, and its Coulomb friction is given in part.  Far below any speed
# of a move, far above what is left of one at its end.
TURNING = 0.02


class MotionModel:
    """The numbers of a machine with full-state measurement, n coordinates and two drives.

    Attributes: rigid (n, 2), travel of every coordinate per metre of x and of y with unstretched belts; mass, viscous
    (with back-EMF) and coulomb (n,), kg, Ns/m, N; drive (n, 2), N/V; rated (2,), V; force_per_volt (2, 2), N/V, forces
    along the rigid x and y motion.

    Raises ValueError for a machine without x, y and two drives, with coordinates that are not observed, or whose drives
    cannot push along both axes.
    """

    def __init__(self, machine: Machine) -> None:
        names = machine.coordinate_names
        self.machine = machine
        self.observed = (*AXES, *(d.coordinate for d in machine.drives if d.coordinate not in AXES))
        if len(machine.drives) != len(AXES) or sorted(self.observed) != sorted(names):
            raise ValueError(
                f"machine {machine.name!r}: full-state control needs the coordinates x, y and those of two drives, "
                f"and no others; it has {', '.join(names)} and {len(machine.drives)} drives"
            )
        n = len(names)
        radii = machine.radii
        linear = [c.name for c in machine.coordinates if c.kind == "linear"]
        self.rigid = np.stack(
            [rest_state(machine, [float(c == axis) for c in linear])[:n] * radii for axis in AXES], axis=1
        )
        self.mass = np.array([c.mass for c in machine.coordinates]) / radii**2
        self.coulomb = np.array([c.coulomb for c in machine.coordinates]) / radii
        self.viscous = np.array([c.viscous for c in machine.coordinates]) / radii**2
        self.drive = np.zeros((n, len(machine.drives)))
        for j, d in enumerate(machine.drives):
            i = names.index(d.coordinate)
            self.drive[i, j] = d.gain / radii[i]
            self.viscous[i] += d.back_emf / radii[i] ** 2
        self.rated = np.array([d.rated_voltage for d in machine.drives])
        self.force_per_volt = self.rigid.T @ self.drive
        if abs(np.linalg.det(self.force_per_volt)) < 1e-9 * np.abs(self.force_per_volt).max() ** 2:
            raise ValueError(f"machine {machine.name!r}: its drives cannot push along both x and y")
        self._volts_per_force = np.linalg.inv(self.force_per_volt)
        self._order = np.array([self.observed.index(c) for c in names])
        self._order = np.concatenate([self._order, n + self._order])

    def state(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Travel and its speed (B, 2 n), m and m/s, from `observation` (B, 2 n): positions of x, y and the driven
        coordinates, then their velocities, in their own units.

        Raises ValueError for another number of entries.
        """
        values = np.asarray(observation["observation"], np.float64)
        if values.ndim != 2 or values.shape[1] != len(self._order):
            raise ValueError(f"observation has shape {values.shape}, it must be (B, {len(self._order)})")
        return values[:, self._order] * np.tile(self.machine.radii, 2)

    def observation(self, state: Array) -> Array:
        """`state` in reverse: what a full-state observation of states (B, 2 n) is, (B, 2 n)."""
        return (state / np.tile(self.machine.radii, 2))[:, np.argsort(self._order)]

    def goal_state(self, goal: NDArray[Any]) -> Array:
        """State (B, 2 n) at rest with unstretched belts where the tool is at goal (B, 2), m."""
        travel = np.asarray(goal, np.float64) @ self.rigid.T
        return np.concatenate([travel, np.zeros_like(travel)], axis=1)

    def tool(self, travel: Array) -> Array:
        """Where the tool is (B, 2), m, from travel (B, n or more)."""
        return travel[:, [self.machine.coordinate_names.index(axis) for axis in AXES]]

    def stretch(self, travel: Array) -> Array:
        """What travel (B, n or more), m, has beyond the rigid motion of its tool, (B, n): zero at x and y."""
        return travel[:, : len(self.mass)] - self.tool(travel) @ self.rigid.T

    def discretize(self, goal: Array, period: float) -> tuple[Array, Array, Array]:
        """A (2 n, 2 n), B (2 n, 2) and E (2 n, n) over a period (s) in which voltages and a force on each coordinate
        are held, with the belts' stiffness at goal (2,), m."""
        space = linearize(self.machine, self.rigid @ goal / self.machine.radii)
        scale = np.tile(self.machine.radii, 2)
        A, B = space.A * scale[:, None] / scale, space.B * scale[:, None]
        E = np.vstack([np.zeros((len(self.mass),) * 2), np.diag(1.0 / self.mass)])
        block = np.zeros((len(A) + B.shape[1] + E.shape[1],) * 2)
        block[: len(A)] = np.hstack([A, B, E])
        held = expm(block * period)[: len(A)]
        first, second = len(A), len(A) + B.shape[1]
        return held[:, :first], held[:, first:second], held[:, second:]

    def pushes(self, state: Array, elapsed_s: Array) -> Array:
        """Force (B, n), N, of the machine's effects that act also on a stage at rest.

        state (B, 2 n) travel and speed; elapsed_s (B,) since the episode began.
        """
        force = np.zeros((len(state), len(self.mass)))
        for e, i, q, v, radius in self._effects(state):
            if _told(e, "force"):
                force[:, i] += e("force", q=q, v=v, t=elapsed_s) / radius
        return force

    def friction(self, state: Array, elapsed_s: Array) -> Array:
        """Force (B, n), N, of friction that is not linear: Coulomb's and the effects'.  Arguments as for `pushes`."""
        return self.effects_friction(state, elapsed_s) - self.coulomb * self._direction(state)

    def effects_friction(self, state: Array, elapsed_s: Array) -> Array:
        """The effects' share of `friction`."""
        direction = self._direction(state)
        force = np.zeros((len(state), len(self.mass)))
        for e, i, q, v, radius in self._effects(state):
            if _told(e, "coulomb"):
                force[:, i] -= e("coulomb", q=q, v=v, t=elapsed_s) / radius * direction[:, i]
            if _told(e, "viscous"):
                b = self.machine.coordinates[i].viscous
                force[:, i] -= (e("viscous", b=b, direction=np.where(v < 0.0, -1.0, 1.0)) - b) * v / radius
        return force

    def _direction(self, state: Array) -> Array:
        # Never beyond one in size, and smooth through zero so that a voltage does not chatter with the sign of noise.
        return np.tanh(state[:, len(self.mass) :] / TURNING)

    def _effects(self, state: Array) -> Iterator[tuple[AppliedEffect, int, Array, Array, float]]:
        """Effects at coordinates and motors: each with coordinate, position and speed in own units (B,), and radius."""
        for e in self.machine.effects:
            coordinate = self.machine.site_coordinate(e.site)
            if coordinate is not None:
                i = self.machine.coordinate_names.index(coordinate)
                radius = float(self.machine.radii[i])
                yield e, i, state[:, i] / radius, state[:, len(self.mass) + i] / radius, radius

    def held_stretch(self, force: Array, goal: Array) -> Array:
        """Where motors (B, n), m, beyond unstretched belts hold the tool at goal (B, 2), m, against force (B, n), N.

        Zero at x and y.
        """
        names = self.machine.coordinate_names
        tool = [names.index(axis) for axis in AXES]
        motors = [i for i in range(len(names)) if i not in tool]
        coupling = np.zeros((len(goal), len(tool), len(motors)))
        for belt in self.machine.belts:
            row = self.machine.row(belt.extension)
            length = belt.rest_length + goal @ self.rigid.T @ self.machine.row(belt.length)
            coupling += (belt.EA / length)[:, None, None] * np.outer(row[tool], row[motors])
        stretch = np.zeros_like(force)
        if motors:
            stretch[:, motors] = np.linalg.solve(coupling, force[:, tool, None])[..., 0]
        return stretch

    def voltage(self, force: Array) -> Array:
        """Voltages (B, 2), V, that give force (B, 2), N, along rigid x and y."""
        return force @ self._volts_per_force.T

    def disturbance(self, before: Array, after: Array, volts: Array, period: float) -> Array:
        """Mean force (B, 2) along rigid x and y, N, over a period: what drives and viscous friction do not explain.

        before, after: states (B, 2 n); volts (B, 2) held between.  Belts are internal forces of a rigid motion and drop
        out, and the mean of a speed is the distance over the time: so the balance holds whatever the belts do.
        """
        n = len(self.mass)
        moved = self.viscous * (after[:, :n] - before[:, :n])
        gained = self.mass * (after[:, n:] - before[:, n:])
        return (moved + gained) @ self.rigid / period - volts @ self.force_per_volt.T

    def top_speed(self) -> Array:
        """Steady speed (2,) along x and y alone at rated voltage, m/s; zero where friction holds the axis."""
        push = np.abs(self.force_per_volt) @ self.rated
        drag = np.abs(self.rigid.T) @ self.coulomb
        return np.maximum(push - drag, 0.0) / np.maximum((self.rigid**2).T @ self.viscous, 1e-9)


def _told(effect: AppliedEffect, contribution: str) -> bool:
    """Whether an effect has a contribution, and one that follows from position, speed and time alone."""
    function = getattr(effect.definition, contribution)
    if function is None:
        return False
    return not {"z", "u", "i"} & set(asked(function))
