"""Inverse dynamics: the voltages that a motion of the tool needs, from the machine's equations of motion.

On a rigid motion p(t) of the tool the belts keep their length, and every coordinate has the travel rigid * p.
The forces along the axes are then

    F = rigid' (m a - f_effects + b v + Fc sign(v)),          V = (force per volt)^-1 F,

with the mass m, the viscous coefficient b (back-EMF included) and the Coulomb friction Fc of every
coordinate. The command inverts the characteristic of the amplifier (gain, offset, dead band). Belts stretch
to transmit the forces; `motor_reference` gives the motor positions at which they do.

All functions work on floats, arrays and traced expressions.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...dynamics import Equations, MotionPoint
from ...dynamics.elementwise import sign
from ...errors import InputError
from ...machine import AppliedEffect, Machine, argument_names, rest_positions_per_axis
from ..base import refuse_drive_laws, require_linear_axes

Values = Mapping[str, Any] | None
BISECTIONS = 64  # halvings of the range of a command: the result is exact to rounding
_ROUNDING = 1e-9  # relative; coefficients of the kinematics closer to an integer than this are integers
_FORCE_HOOKS = ("force", "coulomb", "viscous")
_MEMORY = {"z", "i", "drive", "load"}  # arguments of hooks that the motion alone does not determine


class InverseDynamics:
    """Inverse dynamics of one machine.

    The methods' argument `values` has the values of the machine's parameters by full name, SI: numbers,
    arrays or traced expressions. None stands for the values of the machine.

    Attributes:
        machine: Machine without the effects in `left_out`.
        axes: Names of the tool's axes.
        rigid: Belt travel of every coordinate per travel of each axis, m/m, shape (coordinates, axes).
        left_out: Labels of effects that the formulas do not contain: those with a memory, on belts and
            sensors, delays, and forces that grow with those of drives or belts.
        limits: Largest command of each drive, V, shape (drives,).
        has_amplifiers: Whether each drive has effects on its voltage.
        elastic: Whether belts alone connect motors and tool, so that `motor_reference` applies.

    Raises:
        InputError: If the machine has not one drive per axis, or the drives cannot push along every axis.
    """

    def __init__(self, machine: Machine) -> None:
        refuse_drive_laws(machine, "inverse dynamics")
        self.axes = machine.tool_axes
        require_linear_axes(machine, "the source of a motion controller")
        if not self.axes or len(machine.drives) != len(self.axes):
            raise InputError(
                f"machine {machine.name!r}: inverse dynamics need a tool with one drive per axis; it has "
                f"{len(self.axes)} axes and {len(machine.drives)} drives"
            )
        self.machine = dataclasses.replace(
            machine, effects=tuple(e for e in machine.effects if _described(e))
        )
        self.left_out = tuple(e.label for e in machine.effects if not _described(e))
        self.rigid = _tidy(rest_positions_per_axis(machine) * machine.travel_per_unit[:, None])
        self._driven = [machine.coordinate_names.index(d.coordinate) for d in machine.drives]
        on_axes = self.rigid[self._driven].T  # (axes, drives)
        if np.linalg.matrix_rank(on_axes) < len(self.axes):
            raise InputError(
                f"machine {machine.name!r}: its drives cannot push along {' and '.join(self.axes)}"
            )
        self._drive_forces = _tidy(np.linalg.inv(on_axes))  # force of each drive per force along each axis
        ranges = [d.device_parameters["voltage_range"] for d in machine.drives]
        self.limits = np.array(ranges)
        self.has_amplifiers = [
            any(e.definition.voltage and d.name in e.components(machine) for e in self.machine.effects)
            for d in machine.drives
        ]
        self._tool = [machine.coordinate_names.index(a) for a in self.axes]
        others = set(range(len(machine.coordinates))) - {*self._tool, *self._driven}
        # Motor positions follow from the forces on the tool if belts alone connect both.
        self.elastic = bool(machine.belts) and not others and not set(self._tool) & set(self._driven)

    def coordinate_forces(
        self,
        values: Values,
        time: Any,
        position: Sequence[Any],
        velocity: Sequence[Any],
        acceleration: Sequence[Any],
    ) -> tuple[list[Any], list[Any]]:
        """Compute the force that each coordinate needs along its belt travel.

        Args:
            time: Time, s, for effects that change with it.
            position: Tool position, m, one value per axis.
            velocity: Tool velocity, m/s, one value per axis.
            acceleration: Tool acceleration, m/s^2, one value per axis.

        Returns:
            total: Force on each coordinate for inertia, friction and effects, N, one value per coordinate.
            friction: The part against dry friction and forces of effects, N, one value per coordinate.
        """
        equations = Equations(self.machine, values)
        travel, speed, rate = (self._along(vector) for vector in (position, velocity, acceleration))
        point = MotionPoint(travel, speed, time)
        count, drives = len(travel), len(self.machine.drives)
        balance = equations.force_balance(point, [0.0] * drives, [0.0] * count)
        friction, total = [], []
        for i in range(count):
            direction = sign(speed[i])
            friction.append(balance.coulomb[i] * direction - balance.forces[i])
            viscous = equations.viscous(i, direction) * speed[i]
            total.append(equations.mass(i) * rate[i] + viscous + friction[i])
        return total, friction

    def motor_voltages(self, values: Values, forces: Sequence[Any]) -> list[Any]:
        """Convert forces to the motor voltages that cause them, without voltage range and amplifier.

        Args:
            forces: Forces along the belt travel, N, one per coordinate, as `coordinate_forces` returns them:
                the total with the back-EMF.

        Returns:
            One voltage per drive, V, shape (drives,).
        """
        equations = Equations(self.machine, values)
        on_axes = [_sum_of(self.rigid[:, k], forces) for k in range(len(self.axes))]
        return [
            _sum_of(self._drive_forces[j], on_axes) / equations.force_per_volt(j)
            for j in range(len(self.machine.drives))
        ]

    def amplifier(self, values: Values, j: int, command: Any) -> Any:
        """Compute the voltage at the motor of drive j for its command, with gain, offset and dead band.

        Args:
            j: Index of the drive.
            command: Command, V: a number, an array or a traced expression.

        Returns:
            Voltage, V, of the same kind.
        """
        commands = [command if k == j else 0.0 for k in range(len(self.machine.drives))]
        return Equations(self.machine, values).motor_voltages(commands)[j]

    def commands(self, motor_voltages: Sequence[Any], invert: Callable[[int, Any], Any]) -> list[Any]:
        """Convert motor voltages, V, to the drive commands, V, that give them.

        Args:
            motor_voltages: Voltages, V, one value per drive.
            invert: Function of a drive's index and the motor voltage, V, that returns the command, V. It is
                called for drives with effects on their voltage; for others the command is the voltage.

        Returns:
            One command per drive, V.
        """
        return [
            invert(j, u) if has else u
            for j, (has, u) in enumerate(zip(self.has_amplifiers, motor_voltages, strict=True))
        ]

    def command(self, j: int, voltage: float) -> float:
        """Return the smallest command of a drive that gives a motor voltage, found by bisection.

        In the jump of a dead band, which no command reaches, it is the command for the next larger voltage.

        Args:
            j: Index of the drive.
            voltage: Voltage at the motor, V.

        Returns:
            Command, V, at most `limits[j]` in magnitude, also if this gives less than the voltage.
        """
        low, high = 0.0, float(self.limits[j])
        at_rest = self.amplifier(None, j, 0.0)
        if voltage == at_rest:
            return 0.0
        side = 1.0 if voltage > at_rest else -1.0
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            if side * self.amplifier(None, j, side * middle) < side * voltage:
                low = middle
            else:
                high = middle
        return side * high

    def motor_reference(self, values: Values, position: Sequence[Any], forces: Sequence[Any]) -> list[Any]:
        """Compute drive positions, rad or m, at which the belts transmit the forces that the tool needs.

        Args:
            position: Tool position, m, one value per axis.
            forces: Force that each coordinate needs, N, one value per coordinate: the total of
                `coordinate_forces`.

        Returns:
            One position per drive, of the coordinate on which it acts.
        """
        without_effects = dataclasses.replace(self.machine, effects=())
        equations = Equations(without_effects, self.machine.with_tied(values or {}))
        travel = self._along(position)
        belts = equations.belt_states(MotionPoint(travel, [0.0] * len(travel)))
        rows = [self.machine.coefficients(b.extension) for b in self.machine.belts]
        # Force on the tool per travel of the motors: -G_tool' diag(k) G_motors.
        coupling = [
            [_sum_of([-r[i] * r[j] for r in rows], [b.stiffness for b in belts]) for j in self._driven]
            for i in self._tool
        ]
        stretch = _solved(coupling, [forces[i] for i in self._tool])
        return [(travel[i] + s) * equations.per_radius(i) for i, s in zip(self._driven, stretch, strict=True)]

    def _along(self, vector: Sequence[Any]) -> list[Any]:
        """Return a quantity of every coordinate on a rigid motion from that of the axes."""
        return [_sum_of(row, vector) for row in self.rigid]


def _sum_of(row: Any, values: Sequence[Any]) -> Any:
    """Return the sum of row[i] * values[i]; factors 0, 1 and -1 cost no operation."""
    total: Any = 0.0
    for factor, value in zip(map(float, row), values, strict=True):
        if factor:
            term = value if abs(factor) == 1.0 else abs(factor) * value
            total = total + term if factor > 0.0 else total - term
    return total


def _solved(matrix: Sequence[Sequence[Any]], right: Sequence[Any]) -> list[Any]:
    """Solve one or two linear equations by Cramer's rule."""
    if len(right) == 1:
        return [right[0] / matrix[0][0]]
    (a, b), (c, d) = matrix
    determinant = a * d - b * c
    return [(d * right[0] - b * right[1]) / determinant, (a * right[1] - c * right[0]) / determinant]


def _tidy(matrix: NDArray[np.floating[Any]]) -> Array:
    """Return a matrix whose entries are integers where they differ from one by rounding only."""
    nearest = np.rint(matrix)
    return np.where(np.abs(matrix - nearest) <= _ROUNDING * np.maximum(np.abs(nearest), 1.0), nearest, matrix)


def _described(effect: AppliedEffect) -> bool:
    """Return whether formulas contain an effect: motion determines its force, or it acts on a voltage."""
    definition = effect.definition
    if definition.structure or definition.voltage:
        return True
    hooks = [getattr(definition, name) for name in _FORCE_HOOKS if getattr(definition, name)]
    arguments = {name for hook in hooks for name in argument_names(hook)}
    return bool(hooks) and not definition.next_state and not _MEMORY & arguments
