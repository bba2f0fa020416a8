"""Machine model of the controllers: full state in belt travel, rigid motion, friction, and operating points.

All positions are belt travel (p = radius * angle, m) and all forces act on travel (N), so that x, y and the motors have
the same scale.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from ..dynamics import Equations, ForceBalance, MotionPoint
from ..errors import InputError
from ..machine import AppliedEffect, Machine, argument_names, linearize, rest_state

Array = NDArray[np.float64]
AXES = ("x", "y")
GRID = (9, 7)  # operating points along x and y; the stiffness is within 5 % of that of the nearest point
# m/s: the direction of friction is tanh(v / REVERSAL_SPEED). Far below the speeds of a move, and far above what remains
# at its end, so that the voltage does not chatter with the sign of noise.
REVERSAL_SPEED = 0.02


class OperatingPointGrid:
    """Tool positions for which gains are designed, because the belts' stiffness depends on the position.

    Args:
        machine: Machine with a workspace.

    Attributes:
        points: Tool positions, m, shape (63, 2).
        span: Size of the workspace, m, shape (2,).

    Raises:
        InputError: If the workspace has no range.
    """

    def __init__(self, machine: Machine) -> None:
        ranges = [r for r in (machine.coordinate(axis).range for axis in AXES) if r is not None]
        if len(ranges) < len(AXES):
            raise InputError(f"machine {machine.name!r}: x and y need a range to be controlled in")
        self._lines = [np.linspace(low, high, count) for (low, high), count in zip(ranges, GRID, strict=True)]
        self.points: Array = np.array([[x, y] for x in self._lines[0] for y in self._lines[1]])
        self.span: Array = np.array([line[-1] - line[0] for line in self._lines])

    def nearest(self, position: Array) -> NDArray[np.intp]:
        """Return the index of the nearest operating point.

        Args:
            position: Tool positions, m, shape (B, 2).

        Returns:
            Indices into `points`, shape (B,).
        """
        i, j = (np.abs(position[:, k : k + 1] - line).argmin(axis=1) for k, line in enumerate(self._lines))
        return i * GRID[1] + j


class MotionModel:
    """Model of a machine with full-state measurement, n coordinates and two drives.

    Args:
        machine: Machine with the coordinates x, y and those of two drives.

    Attributes:
        machine: As given.
        observed: Coordinates in the order of a full-state observation.
        rigid: Travel of every coordinate per meter of x and of y with unstretched belts, shape (n, 2).
        mass: Mass of every coordinate, kg, shape (n,).
        viscous: Viscous friction with back-EMF, Ns/m, shape (n,).
        coulomb: Coulomb levels, N, shape (n,).
        drive: Force of the drives at rest, N/V, shape (n, 2).
        rated: Rated voltages, V, shape (2,).
        force_per_volt: Forces along the rigid x and y motion, N/V, shape (2, 2).

    Raises:
        InputError: If the machine has other coordinates than x, y and those of two drives, or its drives cannot push
            along both axes.
    """

    def __init__(self, machine: Machine) -> None:
        names = machine.coordinate_names
        self.machine = machine
        self.observed = (*AXES, *(d.coordinate for d in machine.drives if d.coordinate not in AXES))
        if len(machine.drives) != len(AXES) or sorted(self.observed) != sorted(names):
            raise InputError(
                f"machine {machine.name!r}: the controllers need two drives and no coordinates except x, y and those "
                f"of the drives; it has the coordinates {', '.join(names)} and the drives "
                f"{', '.join(d.name for d in machine.drives)}"
            )
        n = len(names)
        units = machine.travel_per_unit
        linear = [c.name for c in machine.coordinates if c.kind == "linear"]
        self.rigid = np.stack(
            [rest_state(machine, [float(c == axis) for c in linear])[:n] * units for axis in AXES], axis=1
        )
        self._declared = equations = Equations(dataclasses.replace(machine, effects=()))
        memoryless = tuple(e for e in machine.effects if _memoryless(e))
        self._with_effects = Equations(dataclasses.replace(machine, effects=memoryless))
        self.mass = np.array([equations.mass(i) for i in range(n)])
        self.coulomb = np.array([equations.coulomb(i) for i in range(n)])
        self.viscous = np.array([equations.viscous(i, 1.0) for i in range(n)])
        self.drive = np.zeros((n, len(machine.drives)))
        for j, d in enumerate(machine.drives):
            self.drive[names.index(d.coordinate), j] = equations.force_per_volt(j)
        self.rated = np.array([d.rated_voltage for d in machine.drives])
        self.force_per_volt = self.rigid.T @ self.drive
        if abs(np.linalg.det(self.force_per_volt)) < 1e-9 * np.abs(self.force_per_volt).max() ** 2:
            raise InputError(f"machine {machine.name!r}: its drives cannot push along both x and y")
        self._volts_per_force = np.linalg.inv(self.force_per_volt)
        order = np.array([self.observed.index(c) for c in names])
        self._order = np.concatenate([order, n + order])
        self._scale = np.tile(units, 2)

    def state(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Return the state of a full-state observation.

        Args:
            observation: `observation`, shape (B, 2 n): positions of x, y and the driven coordinates, then their
                velocities, in m, rad, m/s and rad/s.

        Returns:
            Travel and its velocity, m and m/s, shape (B, 2 n).

        Raises:
            InputError: If the observation has another number of entries.
        """
        values = np.asarray(observation["observation"], np.float64)
        if values.ndim != 2 or values.shape[1] != len(self._order):
            raise InputError(f"observation has shape {values.shape}, it must be (B, {len(self._order)})")
        return values[:, self._order] * self._scale

    def observation(self, state: Array) -> Array:
        """Return the full-state observation of states; the inverse of `state`.

        Args:
            state: Travel and its velocity, m and m/s, shape (B, 2 n).

        Returns:
            Observation, shape (B, 2 n).
        """
        return (state / self._scale)[:, np.argsort(self._order)]

    def goal_state(self, goal: NDArray[Any]) -> Array:
        """Return the state at rest with unstretched belts.

        Args:
            goal: Tool positions, m, shape (B, 2).

        Returns:
            States, shape (B, 2 n).
        """
        travel = np.asarray(goal, np.float64) @ self.rigid.T
        return np.concatenate([travel, np.zeros_like(travel)], axis=1)

    def tool_position(self, travel: Array) -> Array:
        """Return the tool position.

        Args:
            travel: Travel or states, m, shape (B, n or more).

        Returns:
            Tool positions, m, shape (B, 2).
        """
        return travel[:, [self.machine.coordinate_names.index(axis) for axis in AXES]]

    def elastic_travel(self, travel: Array) -> Array:
        """Return the travel beyond the rigid motion of the tool, which the belts' stretch allows.

        Args:
            travel: Travel or states, m, shape (B, n or more).

        Returns:
            Elastic part of the travel, m, shape (B, n); zero at x and y.
        """
        return travel[:, : len(self.mass)] - self.tool_position(travel) @ self.rigid.T

    def discretize(self, goal: Array, period: float) -> tuple[Array, Array, Array]:
        """Discretize the linear model with voltages and forces held over a period.

        Args:
            goal: Tool position at which the belts' stiffness is taken, m, shape (2,).
            period: Control period, s.

        Returns:
            A (2 n, 2 n), B (2 n, 2) for voltages and E (2 n, n) for a force on each coordinate.
        """
        space = linearize(self.machine, self.rigid @ goal / self.machine.travel_per_unit)
        A, B = space.A * self._scale[:, None] / self._scale, space.B * self._scale[:, None]
        E = np.vstack([np.zeros((len(self.mass),) * 2), np.diag(1.0 / self.mass)])
        block = np.zeros((len(A) + B.shape[1] + E.shape[1],) * 2)
        block[: len(A)] = np.hstack([A, B, E])
        held = expm(block * period)[: len(A)]
        first, second = len(A), len(A) + B.shape[1]
        return held[:, :first], held[:, first:second], held[:, second:]

    def effect_force(self, state: Array, elapsed_s: Array) -> Array:
        """Return the forces of the machine's effects other than friction.

        Effects with a memory or a table are left out.

        Args:
            state: Travel and its velocity, m and m/s, shape (B, 2 n).
            elapsed_s: Time since the episode's start, s, shape (B,).

        Returns:
            Forces on each coordinate, N, shape (B, n).
        """
        if not self._with_effects.machine.effects:
            return np.zeros((len(state), len(self.mass)))
        return _stack(self._balance(state, elapsed_s).held, state)

    def friction_force(self, state: Array, elapsed_s: Array) -> Array:
        """Return the nonlinear friction: Coulomb friction and that of the machine's effects.

        Args:
            state: Travel and its velocity, m and m/s, shape (B, 2 n).
            elapsed_s: Time since the episode's start, s, shape (B,).

        Returns:
            Forces on each coordinate, N, shape (B, n).
        """
        if not self._with_effects.machine.effects:
            return -self.coulomb * self._direction(state)
        level = _stack(self._balance(state, elapsed_s).coulomb, state)
        return self._effect_viscous_force(state) - level * self._direction(state)

    def effect_friction(self, state: Array, elapsed_s: Array) -> Array:
        """Return the friction of the machine's effects.

        Args:
            state: Travel and its velocity, m and m/s, shape (B, 2 n).
            elapsed_s: Time since the episode's start, s, shape (B,).

        Returns:
            Forces on each coordinate beyond Coulomb and viscous friction, N, shape (B, n).
        """
        return self.friction_force(state, elapsed_s) + self.coulomb * self._direction(state)

    def _balance(self, state: Array, elapsed_s: Array) -> ForceBalance:
        """Return the forces of the effects alone and the Coulomb levels."""
        n = len(self.mass)
        point = MotionPoint(list(state[:, :n].T), list(state[:, n:].T), elapsed_s)
        return self._with_effects.force_balance(point, [0.0] * len(self.rated), [0.0] * n)

    def _effect_viscous_force(self, state: Array) -> Array:
        """Return the force (B, n) of effects on viscous friction, N."""
        velocity = state[:, len(self.mass) :]
        side = np.where(velocity < 0.0, -1.0, 1.0)
        coefficients = [self._with_effects.viscous(i, side[:, i]) for i in range(len(self.mass))]
        return (self.viscous - _stack(coefficients, state)) * velocity

    def _direction(self, state: Array) -> Array:
        """Return the smoothed direction of motion of each coordinate (B, n), within [-1, 1]."""
        return np.tanh(state[:, len(self.mass) :] / REVERSAL_SPEED)

    def static_stretch(self, force: Array, goal: Array) -> Array:
        """Return the elastic travel of the motors at which the belts hold the tool against a force.

        Args:
            force: Force on each coordinate, N, shape (B, n).
            goal: Tool positions, m, shape (B, 2).

        Returns:
            Travel beyond that of unstretched belts, m, shape (B, n); zero at x and y.
        """
        names = self.machine.coordinate_names
        tool = [names.index(axis) for axis in AXES]
        motors = [i for i in range(len(names)) if i not in tool]
        travel = goal @ self.rigid.T
        belts = self._declared.belt_states(MotionPoint(list(travel.T), list(np.zeros_like(travel).T)))
        coupling = np.zeros((len(goal), len(tool), len(motors)))  # N/m
        for belt, state in zip(self.machine.belts, belts, strict=True):
            row = self.machine.coefficients(belt.extension)
            coupling += np.reshape(state.stiffness, (-1, 1, 1)) * np.outer(row[tool], row[motors])
        stretch = np.zeros_like(force)
        if motors:
            stretch[:, motors] = np.linalg.solve(coupling, force[:, tool, None])[..., 0]
        return stretch

    def voltage(self, force: Array) -> Array:
        """Return the voltages that give forces along the rigid x and y motion.

        Args:
            force: Forces, N, shape (B, 2).

        Returns:
            Voltages, V, shape (B, 2).
        """
        return force @ self._volts_per_force.T

    def disturbance_force(self, before: Array, after: Array, volts: Array, period: float) -> Array:
        """Measure the mean disturbance force over a period: what drives and viscous friction do not explain.

        Belts are internal forces of the rigid motion, and the mean velocity is distance over time, so that the momentum
        balance holds whatever the belts do.

        Args:
            before: States at the period's begin, shape (B, 2 n).
            after: States at its end, shape (B, 2 n).
            volts: Voltages at the motors in between, V, shape (B, 2).
            period: Control period, s.

        Returns:
            Forces along the rigid x and y motion, N, shape (B, 2).
        """
        n = len(self.mass)
        viscous = self.viscous * (after[:, :n] - before[:, :n])
        momentum = self.mass * (after[:, n:] - before[:, n:])
        return (viscous + momentum) @ self.rigid / period - volts @ self.force_per_volt.T

    def top_speed(self) -> Array:
        """Compute the steady velocity along x and along y alone at rated voltage.

        Returns:
            Velocities, m/s, shape (2,); zero where friction holds the axis.
        """
        push = np.abs(self.force_per_volt) @ self.rated
        friction = np.abs(self.rigid.T) @ self.coulomb
        return np.maximum(push - friction, 0.0) / np.maximum((self.rigid**2).T @ self.viscous, 1e-9)


def _memoryless(effect: AppliedEffect) -> bool:
    """Whether an effect's forces or friction follow from position, velocity and time of its coordinate alone."""
    hooks = [getattr(effect.definition, name) for name in ("force", "coulomb", "viscous")]
    arguments = {name for hook in hooks if hook for name in argument_names(hook)}
    return any(hooks) and not {"z", "u", "i"} & arguments


def _stack(values: Sequence[Any], state: Array) -> Array:
    """Return values of each coordinate, numbers or arrays (B,), as an array (B, n)."""
    return np.stack([np.broadcast_to(value, len(state)) for value in values], axis=1).astype(np.float64)
