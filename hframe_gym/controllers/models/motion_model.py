"""Machine model for controller design: full state in belt travel, rigid motion, friction, operating points.

All positions are belt travel in m (radius * angle of a rotary coordinate) and all forces act along it, in N,
so that x, y and the motors have the same scale. The positions of a rotary tool axis are travel as well:
`axis_travel` converts goals, which environments give in rad. In a *rigid motion* the belts do not stretch.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import (
    Array,
    CoordinateForces,
    ElapsedTimes,
    KeyedObservation,
    ToolPositions,
    TravelStates,
    Volts,
)
from ...dynamics import Equations, ForceBalance, MotionPoint, linearize, matrix_exponential
from ...errors import InputError
from ...machine import (
    AppliedEffect,
    Machine,
    argument_names,
    observed_coordinates,
    rest_positions_per_axis,
    rigid_counterpart,
)

GRID = (9, 7)  # operating points along x and y; the stiffness is within 5 % of that of the nearest point
# m/s: the direction of compensated friction is tanh(v / FRICTION_COMPENSATION_SPEED). Far below the speeds of
# a move, and far above what remains at its end, so that the voltage does not chatter with the sign of noise.
FRICTION_COMPENSATION_SPEED = 0.02
# Samples of a period that give the mean force of an effect: ten resolve teeth of 2 mm up to 1 m/s at 10 ms.
_MEAN_SAMPLES = 10


def axis_travel_per_unit(machine: Machine) -> Array:
    """Return belt travel per position of each tool axis, shape (axes,): 1, or a radius, m/rad, if rotary."""
    return np.array([machine.coordinate(axis).travel_per_unit for axis in machine.tool_axes])


class OperatingPointGrid:
    """Grid of tool positions for which gains are designed, as the belts' stiffness depends on the position.

    Attributes:
        points: Tool positions of the grid, 9 x 7 for x and y and 9 for one axis, m of belt travel,
            shape (points, axes).
        span: Size of the workspace along each axis, m of belt travel, shape (axes,).

    Raises:
        InputError: If an axis has no range.
    """

    def __init__(self, machine: Machine) -> None:
        axes = machine.tool_axes
        declared = [r for r in machine.axis_ranges if r is not None]
        if len(declared) < len(axes):
            raise InputError(
                f"machine {machine.name!r}: {' and '.join(axes)} must have a range to be controlled in. "
                'Add "range": [low, high] in m to each of these coordinates in the machine.json'
            )
        ranges = np.array(declared) * axis_travel_per_unit(machine)[:, None]
        self._lines = [
            np.linspace(low, high, count) for (low, high), count in zip(ranges, GRID, strict=False)
        ]
        self._shape = tuple(len(line) for line in self._lines)
        self.points: Array = np.stack(np.meshgrid(*self._lines, indexing="ij"), axis=-1).reshape(
            -1, len(axes)
        )
        self.span: Array = np.array([line[-1] - line[0] for line in self._lines])

    def nearest(self, position: ToolPositions) -> NDArray[np.intp]:
        """Find the operating point nearest to each tool position, as an index into `points`, shape (B,)."""
        lines = [np.abs(position[:, k : k + 1] - line).argmin(axis=1) for k, line in enumerate(self._lines)]
        return np.asarray(np.ravel_multi_index(tuple(lines), self._shape), np.intp)


class MotionModel:
    """Model for controller design: a machine with n coordinates and one drive per axis, in belt travel.

    Args:
        machine: Machine with the coordinates of its tool (x and y, or one axis) and those of as many drives.
            Coordinates that effects add do not move in the model (`rigid_counterpart`).

    Attributes:
        machine: Machine without the coordinates that effects add.
        simulated: The same with the loads that swing slowly (`slow_loads`), for simulations
            (`SimulatedMotion`).
        axes: Names of the tool's coordinates, ("x", "y") or one name.
        tool: Indices of these coordinates in the machine's order.
        observed: Coordinate names in the order of a full-state observation.
        axis_radii: Travel per position of each axis, which is 1 for a linear one, m/m or m/rad,
            shape (axes,).
        rigid: Belt travel of every coordinate per meter of each axis with unstretched belts, m/m,
            shape (n, axes).
        mass: Mass of every coordinate, of rotary ones inertia / radius^2, kg, shape (n,).
        viscous: Viscous friction coefficients including back-EMF, Ns/m, shape (n,).
        coulomb: Magnitudes of the Coulomb friction forces, N, shape (n,).
        drive: Force on every coordinate per volt of each drive at zero speed, N/V, shape (n, drives).
        rated: Rated voltages, V, shape (drives,).
        force_per_volt: Forces along the axes per volt of each drive, with belts that do not stretch, N/V,
            shape (axes, drives).

    Raises:
        InputError: If the machine has other coordinates than those of its tool and its drives, not one drive
            per axis, drives that cannot push along every axis, or drives that follow a set point.
    """

    def __init__(self, machine: Machine) -> None:
        self.simulated = rigid_counterpart(machine, with_slow_loads=True)
        machine = rigid_counterpart(machine)
        names = machine.coordinate_names
        following = [d.name for d in machine.drives if d.law]
        if following:
            raise InputError(
                f"machine {machine.name!r}: the torque of {' and '.join(following)} "
                "follows a law of its own, and this controller computes voltages, currents or torques; "
                "drives that follow a set point have their loops inside: use the controller set-point"
            )
        self.machine = machine
        self.axes = axes = machine.tool_axes
        self.observed = observed_coordinates(machine)
        if not axes or len(machine.drives) != len(axes) or sorted(self.observed) != sorted(names):
            raise InputError(
                f"machine {machine.name!r}: the controllers need one or two axes, linear or rotary, "
                "one drive per axis and no other coordinates than those of axes and drives; it has the "
                f"coordinates {', '.join(names)} and the drives {', '.join(d.name for d in machine.drives)}"
            )
        n = len(names)
        units = machine.travel_per_unit  # 1 for linear coordinates, radius for rotary ones, m/rad
        self.axis_radii = axis_travel_per_unit(machine)
        self.rigid = rest_positions_per_axis(machine) * units[:, None] / self.axis_radii
        self._declared = equations = Equations(dataclasses.replace(machine, effects=()))
        memoryless = tuple(e for e in machine.effects if _memoryless(e))
        self._with_effects = Equations(dataclasses.replace(machine, effects=memoryless))
        self.tool = [names.index(axis) for axis in axes]
        self.mass = np.array([equations.mass(i) for i in range(n)])
        self.coulomb = np.array([equations.coulomb(i) for i in range(n)])
        self.viscous = np.array([equations.viscous(i, 1.0) for i in range(n)])
        self.drive = np.zeros((n, len(machine.drives)))
        for j, d in enumerate(machine.drives):
            self.drive[names.index(d.coordinate), j] = equations.force_per_volt(j)
        self.rated = np.array([d.rated_voltage for d in machine.drives])
        self.force_per_volt = self.rigid.T @ self.drive
        if abs(np.linalg.det(self.force_per_volt)) <= 1e-9 * np.abs(self.force_per_volt).max() ** len(axes):
            raise InputError(f"machine {machine.name!r}: its drives cannot push along {' and '.join(axes)}")
        self._volts_per_force = np.linalg.inv(self.force_per_volt)
        order = np.array([self.observed.index(c) for c in names])  # columns of an observation's positions
        self._order = np.concatenate([order, n + order])
        self._scale = np.tile(units, 2)

    def state(self, observation: KeyedObservation) -> TravelStates:
        """Convert a full-state observation to a state; InputError if it has the wrong number of entries."""
        values = np.asarray(observation["observation"], np.float64)
        if values.ndim != 2 or values.shape[1] != len(self._order):
            raise InputError(f"observation has shape {values.shape}, it must be (B, {len(self._order)})")
        return values[:, self._order] * self._scale

    def observation(self, state: TravelStates) -> Array:
        """Convert states to full-state observations, shape (B, 2 n), the inverse of the method `state`."""
        return (state / self._scale)[:, np.argsort(self._order)]

    def axis_travel(self, position: NDArray[Any]) -> ToolPositions:
        """Convert the tool `position` of an environment, m or rad, shape (..., axes), to belt travel, m."""
        return np.asarray(position, np.float64) * self.axis_radii

    def goal_state(self, goal: NDArray[Any]) -> TravelStates:
        """Compute the states at rest with unstretched belts at tool positions.

        Args:
            goal: Tool positions, m of belt travel (`axis_travel`), shape (B, axes).
        """
        travel = np.asarray(goal, np.float64) @ self.rigid.T
        return np.concatenate([travel, np.zeros_like(travel)], axis=1)

    def path_velocities(self, state: TravelStates, goals: Array, period: float) -> Array:
        """Compute the velocities of the coordinates now and along previewed goals, m/s, shape (B, 1 + P, n).

        Args:
            goals: Tool goals now and at the ends of P periods, m, shape (B, 1 + P, axes).
            period: Control period, s.
        """
        ahead = np.diff(goals, axis=1) / period @ self.rigid.T
        return np.concatenate([state[:, None, len(self.mass) :], ahead], axis=1)

    def tool_position(self, travel: Array) -> ToolPositions:
        """Select the tool position, m, from `travel`, m, or from states, shape (B, n or 2 n)."""
        return travel[:, self.tool]

    def elastic_travel(self, travel: Array) -> Array:
        """Compute how far belt stretch moves the coordinates from the rigid motion, m, shape (B, n).

        Args:
            travel: Travels of all coordinates, m, shape (B, n), or states, shape (B, 2 n).
        """
        return travel[:, : len(self.mass)] - self.tool_position(travel) @ self.rigid.T

    @property
    def rigid_part(self) -> Array:
        """Matrix from states to positions and velocities of the rigid motion, shape (2 * axes, 2 n).

        The rigid motion is the one with unstretched belts that has the same momentum along each axis;
        vibrations of the belts have none.
        """
        momentum = self.rigid.T * self.mass
        return np.asarray(np.kron(np.eye(2), np.linalg.solve(momentum @ self.rigid, momentum)), np.float64)

    def discretize(self, goal: Array, period: float, *, rigid: bool = False) -> tuple[Array, Array, Array]:
        """Linearize the machine, without Coulomb friction, and discretize it with zero-order hold.

        Args:
            goal: Tool position of the linearization, m of belt travel, shape (axes,).
            period: Control period, s.
            rigid: Whether belts are rigid. The state is then `rigid_part` times that of `TravelStates`, so
                that S = 2 * axes; otherwise S = 2 n.

        Returns:
            Matrices of the step from the state, m and m/s, to that of the next period, SI: of the state,
            shape (S, S); of the voltages, shape (S, drives); of a force on each of the n coordinates,
            shape (S, n).
        """
        space = linearize(self.machine, self.rigid @ goal / self.machine.travel_per_unit)
        A, B = space.A * self._scale[:, None] / self._scale, space.B * self._scale[:, None]
        E = np.vstack([np.zeros((len(self.mass),) * 2), np.diag(1.0 / self.mass)])
        if rigid:
            average = self.rigid_part
            A, B, E = average @ A @ np.kron(np.eye(2), self.rigid), average @ B, average @ E
        block = np.zeros((len(A) + B.shape[1] + E.shape[1],) * 2)
        block[: len(A)] = np.hstack([A, B, E])
        # The exponential of [[A, B, E], [0, 0, 0]] * period holds the three discrete-time matrices in its
        # first rows.
        discrete = matrix_exponential(block * period)[: len(A)]
        first, second = len(A), len(A) + B.shape[1]
        return discrete[:, :first], discrete[:, first:second], discrete[:, second:]

    def effect_force(self, state: TravelStates, elapsed_s: ElapsedTimes) -> CoordinateForces:
        """Compute the forces of the machine's effects other than friction.

        Not included: effects with a memory or a lookup table, and effects on belts, drives and sensors.
        """
        if not self._with_effects.machine.effects:
            return np.zeros((len(state), len(self.mass)))
        return _stack(self._balance(state, elapsed_s).forces, state)

    def mean_effect_force(
        self, middle: TravelStates, elapsed_s: ElapsedTimes, period: float
    ) -> CoordinateForces:
        """Compute the mean of `effect_force` over a control period that is passed at constant speed.

        A voltage that is held can oppose no more than this mean. Teeth of a belt that pass at 150 Hz,
        evaluated once in each period of 10 ms, look like a force of 50 Hz, which a feedforward would apply.

        Args:
            middle: States in the middle of the period.
            elapsed_s: Times there.
            period: Control period, s.
        """
        if not self._with_effects.machine.effects:
            return np.zeros((len(middle), len(self.mass)))
        n, count = len(self.mass), len(middle)
        after_s = period * np.repeat((np.arange(_MEAN_SAMPLES) + 0.5) / _MEAN_SAMPLES - 0.5, count)
        states = np.tile(middle, (_MEAN_SAMPLES, 1))
        states[:, :n] += after_s[:, None] * states[:, n:]
        forces = self.effect_force(states, np.tile(elapsed_s, _MEAN_SAMPLES) + after_s)
        return np.asarray(forces.reshape(_MEAN_SAMPLES, count, n).mean(axis=0))

    def friction_force(self, state: TravelStates, elapsed_s: ElapsedTimes) -> CoordinateForces:
        """Compute the friction force -F tanh(v / (20 mm/s)) and the friction that effects add to it.

        Not included: viscous friction of the nominal model, effects with a memory or a lookup table, and
        effects by which friction grows with the drive force.
        """
        if not self._with_effects.machine.effects:
            return -self.coulomb * self._direction(state)
        level = _stack(self._balance(state, elapsed_s).coulomb, state)
        return self._effect_viscous_force(state) - level * self._direction(state)

    def effect_friction(self, state: TravelStates, elapsed_s: ElapsedTimes) -> CoordinateForces:
        """Compute the force by which effects change the Coulomb friction.

        It is negative if it brakes positive motion.
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
        return np.tanh(state[:, len(self.mass) :] / FRICTION_COMPENSATION_SPEED)

    def static_stretch(self, force: CoordinateForces, goal: ToolPositions) -> Array:
        """Compute the motor travel that lets stretched belts hold a force on the tool at rest.

        The result is belt travel, m, shape (B, n), 0 for the tool axes. Forces on other coordinates are not
        used.
        """
        if not force.any():
            return np.zeros_like(force)
        tool = self.tool
        motors = [i for i in range(len(self.mass)) if i not in tool]
        travel = goal @ self.rigid.T
        belts = self._declared.belt_states(MotionPoint(list(travel.T), list(np.zeros_like(travel).T)))
        coupling = np.zeros((len(goal), len(tool), len(motors)))  # force on the tool per motor travel, N/m
        for belt, state in zip(self.machine.belts, belts, strict=True):
            row = self.machine.coefficients(belt.extension)
            coupling += np.reshape(state.stiffness, (-1, 1, 1)) * np.outer(row[tool], row[motors])
        stretch = np.zeros_like(force)
        if motors:
            stretch[:, motors] = np.linalg.solve(coupling, force[:, tool, None])[..., 0]
        return stretch

    def voltage(self, force: Array) -> Volts:
        """Compute the voltages, not limited, for a `force`, N, shape (B, axes), at rest with rigid belts."""
        return force @ self._volts_per_force.T

    def disturbance_force(
        self, before: TravelStates, after: TravelStates, volts: Volts, period: float
    ) -> Array:
        """Compute the mean disturbance force along the axes from the momentum balance of the rigid motion.

        Force = change of momentum / period + viscous friction - drive force, N, shape (B, axes); Coulomb
        friction is part of it. Belt forces are internal and cancel. States are those at the start and at the
        end of the `period`, s.
        """
        n = len(self.mass)
        viscous_impulse = self.viscous * (after[:, :n] - before[:, :n])  # Ns
        momentum_change = self.mass * (after[:, n:] - before[:, n:])  # Ns
        return (viscous_impulse + momentum_change) @ self.rigid / period - volts @ self.force_per_volt.T

    def top_speed(self) -> Array:
        """Compute the steady speed along each axis at rated voltage, m/s, shape (axes,); the others rest.

        It is zero where Coulomb friction exceeds the drive force.
        """
        return self._largest_force() / np.maximum((self.rigid**2).T @ self.viscous, 1e-9)

    def top_acceleration(self) -> Array:
        """Compute the acceleration along each axis from rest, m/s^2, shape (axes,), at the rated voltages.

        Only the axis moves. It is zero where Coulomb friction exceeds the drive force.
        """
        return self._largest_force() / ((self.rigid**2).T @ self.mass)

    def _largest_force(self) -> Array:
        """Return the force along each axis at the rated voltages, less Coulomb friction, N, shape (axes,)."""
        drive_force = np.abs(self.force_per_volt) @ self.rated
        friction = np.abs(self.rigid.T) @ self.coulomb
        return np.maximum(drive_force - friction, 0.0)


def _memoryless(effect: AppliedEffect) -> bool:
    """Return whether an effect's forces and friction depend on its coordinate's motion and time only."""
    hooks = [getattr(effect.definition, name) for name in ("force", "coulomb", "viscous")]
    arguments = {name for hook in hooks if hook for name in argument_names(hook)}
    return any(hooks) and not {"z", "u", "i", "drive", "load"} & arguments


def _stack(values: Sequence[Any], state: Array) -> Array:
    """Return values of each coordinate, numbers or arrays (B,), as an array (B, n)."""
    return np.stack([np.broadcast_to(value, len(state)) for value in values], axis=1).astype(np.float64)
