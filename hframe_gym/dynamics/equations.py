"""Equations of motion of a machine, stated once for values of any algebra.

For the belt travel p of each coordinate (p = radius * angle for a pulley), in N and m:

    m dv/dt = f_belts + f_drive + f_effects - b v - F sign(v)                                      (eq. 1-8, 36-37)

    belt i:   s = G p,  l = L + H p,  k = EA / l,  T = k s                                         (eq. 38-44)
              f_belts = -G' T - (1/2) s^2 dk/dp,  dk/dp = -(k / l) H        (the paper omits the second term)
    drive j:  f_drive = N Kt i / r,  i = (V - Ke N w) / R            (eq. 17, with the gear ratio that it omits)

At v = 0 Coulomb friction is a set: any force up to F. The back electromotive force Ke N w is part of the viscous
coefficient b. Effects enter at the places that `hframe_gym.machine.effect` lists.

Values are floats, NumPy arrays (one entry per machine, per sample, or (variants, 1) against (samples,)), traced
expressions from which `kernel_source` generates the kernel, or CasADi expressions.

References:
    Sollmann, Jouaneh and Lavender (2010), Dynamic Modeling of a Two-Axis, Parallel, H-Frame-Type XY Positioning System.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from .elementwise import fma, maximum, named, reciprocals, sign, update_if_any
from .parameterized_machine import MotionPoint, ParameterizedMachine, Value, add_combination, combination


class BeltState(NamedTuple):
    """State of one belt.

    Attributes:
        extension: s, m.
        rate: ds/dt, m/s.
        stiffness: k = EA / l, N/m.
        tension: T beyond the pretension, N.
        stiffness_force: e = -(1/2) s^2 dk/dl, N: force per unit of dl/dp; 0 for constant length.
        net_tension: T - e, N: acts where extension and length follow a coordinate alike.
    """

    extension: Value
    rate: Value
    stiffness: Value
    tension: Value
    stiffness_force: Value
    net_tension: Value


class ForceBalance(NamedTuple):
    """Forces on the travel of each coordinate, N.

    Attributes:
        held: All forces but viscous and Coulomb friction.
        coulomb: Coulomb level F; zero where an effect replaces Coulomb friction.
        arguments: By effect index, further arguments of `next_state` at this point.
    """

    held: list[Value]
    coulomb: list[Value]
    arguments: dict[int, dict[str, Value]]


class Equations(ParameterizedMachine):
    """Equations of motion of one machine.

    Args:
        machine: Machine with its effects.
        values: Parameter values by full name; parameters that are missing keep the machine's values.
    """

    # -- belts -----------------------------------------------------------------------------------------------------

    def belt_states(self, point: MotionPoint) -> list[BeltState]:
        """Return the state of each belt (eq. 38-44)."""
        travel = [self._belt_travel(i, point) for i in range(len(point.travel))]
        speed = [v * arm for v, arm in zip(point.speed, self._lever_arms(point), strict=True)]
        extensions, lengths = [], {}
        for b, (row, length_row) in enumerate(zip(self.extension_rows, self.length_rows, strict=True)):
            if not length_row:
                extensions.append(named("extension", b, combination(row, travel)))
                continue
            # The carriage's displacement changes extension and length alike; motors change the extension only.
            displacement = named("displacement", b, combination(length_row, travel))
            shared = all(row.get(i) == factor for i, factor in length_row.items())
            rest = {i: factor for i, factor in row.items() if not shared or i not in length_row}
            extension = add_combination(displacement, rest, travel) if shared else combination(rest, travel)
            extensions.append(named("extension", b, extension))
            rest_length = self.parameter(f"{self.machine.belts[b].name}.rest_length")
            lengths[b] = named("length", b, rest_length + displacement)
        per_length = {
            b: named("per_length", b, value)
            for b, value in zip(lengths, reciprocals(list(lengths.values())), strict=True)
        }
        rates = [combination(row, speed) for row in self.extension_rows]
        return [self._belt_state(b, s, rates[b], per_length.get(b)) for b, s in enumerate(extensions)]

    def _belt_state(self, b: int, extension: Value, rate: Value, per_length: Value | None) -> BeltState:
        """Return the state of belt b; per_length: 1/l, 1/m, None for constant stiffness."""
        s, name = extension, self.machine.belts[b].name
        k = self.constant_stiffness(b) if per_length is None else self.parameter(f"{name}.EA") * per_length
        k = named("stiffness", b, k)
        linear = k * s
        tension = linear
        for _, e in self.effects_at("tension", "belts", name):
            tension = tension + (self.evaluate(e, "tension", {"s": s, "rate": rate, "k": k}) - linear)
        tension = named("tension", b, tension)
        if per_length is None:
            return BeltState(s, rate, k, tension, 0.0, tension)
        effects = self.effects_at("energy_slope", "belts", name)
        slopes = [self.evaluate(e, "energy_slope", {"s": s, "k": k}) for _, e in effects]
        if slopes:  # dV/dk in place of s^2/2
            slope = slopes[0]
            for more in slopes[1:]:
                slope = slope + (more - 0.5 * s * s)
            force = named("stiffness_force", b, slope * k * per_length)
            return BeltState(s, rate, k, tension, force, named("net_tension", b, tension - force))
        strain = named("strain", b, s * per_length)
        net = named("net_tension", b, fma(-0.5 * strain, tension, tension))
        return BeltState(s, rate, k, tension, 0.5 * strain * tension, net)

    def _pulley_quantities(self, k: int, i: int, point: MotionPoint) -> dict[str, Value]:
        return {"q": self.position(point, i), "z": self.effect_state(k, point), "per_radius": self.per_radius(i)}

    def _belt_travel(self, i: int, point: MotionPoint) -> Value:
        """Return the travel of coordinate i for the belts, m, with the part that an eccentric pulley adds."""
        travel = point.travel[i]
        for k, e in self.effects_on("belt_travel", i):
            travel = travel + self.evaluate(e, "belt_travel", self._pulley_quantities(k, i, point))
        return travel

    def _lever_arms(self, point: MotionPoint) -> list[Value]:
        """Return d(belt travel)/d(travel) of each coordinate: 1 except for eccentric pulleys."""
        arms: list[Value] = []
        for i in range(len(point.travel)):
            effects = list(self.effects_on("lever_arm", i))
            added = [self.evaluate(e, "lever_arm", self._pulley_quantities(k, i, point)) for k, e in effects]
            arms.append(1.0 + sum(added[1:], added[0]) * self.per_radius(i) if added else 1.0)
        return arms

    def belt_forces(self, point: MotionPoint, belts: Sequence[BeltState]) -> list[Value]:
        """Return the force of the belts on the travel of each coordinate, N: -G' T - (1/2) s^2 dk/dp."""
        forces = []
        for i, arm in enumerate(self._lever_arms(point)):
            row: dict[int, float] = {}
            terms: list[Value] = []
            for b, belt in enumerate(belts):
                stretch, lengthen = (rows[b].get(i, 0.0) for rows in (self.extension_rows, self.length_rows))
                if lengthen and lengthen == stretch:
                    parts = [(-stretch, belt.net_tension)]
                else:
                    parts = [(-stretch, belt.tension), (lengthen, belt.stiffness_force)]
                for factor, value in parts:
                    if factor:
                        row[len(terms)] = factor
                        terms.append(value)
            forces.append(combination(row, terms) * arm)
        return forces

    # -- drives ----------------------------------------------------------------------------------------------------

    def motor_voltages(self, voltages: Sequence[Value]) -> list[Value]:
        """Return the voltages at the motors, V, for those that the controller commands, V."""
        result = []
        for j, (drive, voltage) in enumerate(zip(self.machine.drives, voltages, strict=True)):
            for _, e in self.effects_at("voltage", drive.name, "drives"):
                voltage = self.evaluate(e, "voltage", {"V": voltage})
            result.append(named("voltage", j, voltage))
        return result

    def add_drive_forces(self, forces: Sequence[Value], motor_voltages: Sequence[Value]) -> list[Value]:
        """Add the forces of the drives at standstill to forces on each coordinate, N (eq. 17 with w = 0)."""
        result = list(forces)
        for j, voltage in enumerate(motor_voltages):
            i = self.drive_coordinates[j]
            result[i] = fma(self.force_per_volt(j), voltage, result[i])
        return result

    def ohmic_current(self, j: int, point: MotionPoint, motor_voltage: Value) -> Value:
        """Return the current (V - Ke N w) / R of drive j, A (eq. 17)."""
        speed = self.speed(point, self.drive_coordinates[j])
        return (motor_voltage - self._emf_constant(j) * speed) * (1.0 / self._of_drive(j, "resistance"))

    def _current_change(
        self, j: int, point: MotionPoint, motor_voltage: Value, arguments: dict[int, dict[str, Value]]
    ) -> Value:
        """Return the force that effects on the current of drive j add, N or Nm."""
        ohmic = named("ohmic_current", j, self.ohmic_current(j, point, motor_voltage))
        current = ohmic
        for k, e in self.effects_at("current", self.machine.drives[j].name):
            arguments[k] = {"i": current}
            state = self.effect_state(k, point, i=current)
            current = named("current", k, self.evaluate(e, "current", {"i": current, "z": state}))
        return self._of_drive(j, "gear_ratio") * self._of_drive(j, "Kt") * (current - ohmic)

    # -- forces ----------------------------------------------------------------------------------------------------

    def force_balance(
        self, point: MotionPoint, motor_voltages: Sequence[Value], forces: Sequence[Value]
    ) -> ForceBalance:
        """Add the forces of the effects.

        Args:
            point: Point of the motion.
            motor_voltages: Voltages at the motors, V, see `motor_voltages`.
            forces: Forces of belts and drives at standstill on each coordinate, N.

        Returns:
            All forces but friction, and the Coulomb level.
        """
        arguments: dict[int, dict[str, Value]] = {}
        held, levels = [], []
        for i, force in enumerate(forces):
            level = self._coulomb_level(i, point)
            for k, e in self.effects_on("friction", i):  # dry friction by the effect, not by Coulomb's law
                arguments[k] = {"level": level * self.radius(i)}
                state = self.effect_state(k, point, **arguments[k])
                quantities = {**self._quantities(k, i, point), "z": state, **arguments[k]}
                force = force - self.evaluate(e, "friction", quantities) * self.per_radius(i)
                level = 0.0
            for k, e in self.effects_on("force", i):
                if not e.definition.active_region:
                    force = force + self._force_of(k, i, point)
            for j, drive in enumerate(self.machine.drives):
                if self.drive_coordinates[j] == i and any(self.effects_at("current", drive.name)):
                    change = self._current_change(j, point, motor_voltages[j], arguments)
                    force = force + change * self.per_radius(i)
            held.append(force)
            levels.append(level)
        return ForceBalance(self._with_guarded_forces(held, point), levels, arguments)

    def _coulomb_level(self, i: int, point: MotionPoint) -> Value:
        """Return the Coulomb level of coordinate i with its effects, N; never negative."""
        level = self.coulomb(i)
        effects = list(self.effects_on("coulomb", i))
        for k, e in effects:
            level = level + self.evaluate(e, "coulomb", self._with_state(k, i, point)) * self.per_radius(i)
        return maximum(level, 0.0) if effects else level

    def _force_of(self, k: int, i: int, point: MotionPoint) -> Value:
        """Return the force of effect k on the travel of coordinate i, N."""
        effect = self.machine.effects[k]
        return self.evaluate(effect, "force", self._with_state(k, i, point)) * self.per_radius(i)

    def _with_guarded_forces(self, forces: list[Value], point: MotionPoint) -> list[Value]:
        """Add the forces that vanish for most machines; a kernel evaluates them only where one of them acts."""
        guarded = [k for k, e in enumerate(self.machine.effects) if e.definition.force and e.definition.active_region]
        if not guarded:
            return forces
        coordinates = [self._effect_coordinates[k] for k in guarded]

        def active() -> Value:
            regions = [
                self.evaluate(self.machine.effects[k], "active_region", self._quantities(k, i, point))
                for k, i in zip(guarded, coordinates, strict=True)
            ]
            condition = regions[0]
            for region in regions[1:]:
                condition = condition | region
            return condition

        def update(values: Sequence[Value]) -> list[Value]:
            result = dict(zip(touched, values, strict=True))
            for k, i in zip(guarded, coordinates, strict=True):
                result[i] = result[i] + self._force_of(k, i, point)
            return list(result.values())

        touched = list(dict.fromkeys(coordinates))
        updated = dict(zip(touched, update_if_any(active, [forces[i] for i in touched], update), strict=True))
        return [updated.get(i, force) for i, force in enumerate(forces)]

    def balance(self, point: MotionPoint, voltages: Sequence[Value]) -> ForceBalance:
        """Return all forces at a point under the given commanded voltages, V."""
        motor_voltages = self.motor_voltages(voltages)
        forces = self.belt_forces(point, self.belt_states(point))
        return self.force_balance(point, motor_voltages, self.add_drive_forces(forces, motor_voltages))

    def net_forces(
        self, point: MotionPoint, voltages: Sequence[Value], direction: Callable[[Value], Value] = sign
    ) -> list[Value]:
        """Return the sum of all forces on the travel of each coordinate, N, with friction.

        Args:
            point: Point of the motion.
            voltages: Commanded voltages, V.
            direction: Direction of the motion as a function of speed, m/s: `sign`, or a smooth function such as
                tanh(v / turning) for optimization.
        """
        held, coulomb, _ = self.balance(point, voltages)
        sides = [direction(v) for v in point.speed]
        return [
            force - self.viscous(i, side) * v - level * side
            for i, (force, level, v, side) in enumerate(zip(held, coulomb, point.speed, sides, strict=True))
        ]

    def accelerations(
        self, point: MotionPoint, voltages: Sequence[Value], direction: Callable[[Value], Value] = sign
    ) -> list[Value]:
        """Return the acceleration of the travel of each coordinate, m/s^2; arguments as of `net_forces`."""
        return [force / self.mass(i) for i, force in enumerate(self.net_forces(point, voltages, direction))]

    # -- arrays ----------------------------------------------------------------------------------------------------

    def point(
        self,
        positions: Any,
        velocities: Any | None = None,
        time_s: Any = 0.0,
        effect_states: Mapping[int, Value] | None = None,
    ) -> MotionPoint:
        """Return the point or points of a motion given as arrays.

        Args:
            positions: Positions (..., coordinates) in the coordinates' units.
            velocities: Velocities of the same shape; None: at rest.
            time_s: Times (...), s.
            effect_states: States of the effects by index.
        """
        q = np.asarray(positions, float)
        v = np.zeros_like(q) if velocities is None else np.asarray(velocities, float)
        radii = [self.radius(i) for i in range(q.shape[-1])]
        return MotionPoint(
            [q[..., i] * radius for i, radius in enumerate(radii)],
            [v[..., i] * radius for i, radius in enumerate(radii)],
            time_s,
            effect_states or {},
        )

    def in_units(self, forces: Sequence[Value]) -> Any:
        """Return forces on the travel, N, as array (..., coordinates) in the coordinates' units (N or Nm)."""
        return np.stack(np.broadcast_arrays(*(f * self.radius(i) for i, f in enumerate(forces))), axis=-1)
