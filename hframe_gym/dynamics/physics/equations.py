"""Equations of motion of a machine, stated once for numbers, arrays and symbolic expressions.

For the belt travel p of each coordinate (p = radius * angle for a pulley), in N and m:

    m dv/dt = f_belts + f_drive + f_effects - b v - F sign(v)                              (eq. 1-8, 36-37)

    belt i:   s = G p,  l = L + H p,  k = EA / l,  T = k s                                 (eq. 38-44)
              f_belts = -G' T - (1/2) s^2 dk/dp,  dk/dp = -(k / l) H (Sollmann et al. omit the second term)
    drive j:  f_drive = N Kt i / r,  i = (V - Ke N w) / R    (eq. 17, with the gear ratio that it omits)

At v = 0 Coulomb friction is a set: any force up to F. The back electromotive force Ke N w is part of the
viscous coefficient b. Effects enter at the places that `hframe_gym.machine.Effect` lists.

Values are floats, NumPy arrays (one entry per machine, per sample, or (variants, 1) against (samples,)),
traced expressions from which `kernel_source` generates the simulation kernel (compiled code), or CasADi
expressions.

References:
    Sollmann, Jouaneh and Lavender (2010), Dynamic Modeling of a Two-Axis, Parallel, H-Frame-Type XY
    Positioning System.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...machine import AppliedEffect, argument_names
from ..symbolic.elementwise import (
    absolute,
    copysign,
    fma,
    maximum,
    minimum,
    named,
    sign,
    update_if_any,
    where,
)
from .parameterized_machine import MotionPoint, Value
from .signals import SignalEquations


class ForceBalance(NamedTuple):
    """Forces along the belt travel of each coordinate (torque / radius for a pulley), N.

    Attributes:
        forces: Sum of all forces on each coordinate except viscous and Coulomb friction. The integrator keeps
            it constant over a step.
        coulomb: Coulomb friction force F (magnitude) of each coordinate; zero where an effect replaces it.
        arguments: Arguments of the formula `next_state` of effects, by index in `instances`, then by name:
            "level", the Coulomb friction force, N or Nm, or what an effect on a drive takes (`effect_state`).
    """

    forces: list[Value]
    coulomb: list[Value]
    arguments: dict[int, dict[str, Value]]


class Equations(SignalEquations):
    """Equations of motion of one machine.

    All forces act along the belt travel of a coordinate: N on a carriage, torque / radius (N) on a pulley.

    Args:
        values: Parameter values (floats, arrays or symbolic expressions) by full name, for example "x.mass";
            other parameters keep the machine's values.
    """

    # -- drives ----------------------------------------------------------------------------------------------

    def add_drive_forces(self, forces: Sequence[Value], motor_voltages: Sequence[Value]) -> list[Value]:
        """Add the force of each drive at standstill to the force on the one coordinate that it moves, N.

        With gear ratio N, torque constant Kt, voltage V, resistance R and radius r of the driven pulley, the
        force is N Kt V / (R r). The viscous coefficient contains the back-EMF (eq. 17 of Sollmann et al.
        2010). The force of a drive with a law is not added; it depends on the motion.
        """
        result = list(forces)
        for j, voltage in enumerate(motor_voltages):
            if self.drives[j].law_parameters:
                continue
            i = self.drive_coordinates[j]  # the drive moves this coordinate
            result[i] = fma(self.force_per_volt(j), voltage, result[i])
        return result

    def _standstill_force(self, i: int, motor_voltages: Sequence[Value]) -> Value:
        """Return what `add_drive_forces` adds to the force on coordinate i, N."""
        none = [0.0] * len(self.machine.coordinates)
        return self.add_drive_forces(none, motor_voltages)[i]

    def ohmic_current(self, j: int, point: MotionPoint, motor_voltage: Value) -> Value:
        """Return drive j's current (V - Ke N w) / R, A, without inductance (eq. 17 of Sollmann et al. 2010).

        V is the motor voltage, Ke the back-EMF constant, N the gear ratio (which eq. 17 omits), w the speed
        of the drive's coordinate (rad/s or m/s), and R the resistance. For a drive with a law, the result is
        only the torque of the law's damping, which the viscous coefficient contains.
        """
        speed = self.speed(point, self.drive_coordinates[j])
        drive = self.drives[j]
        if drive.law_parameters:
            return -(drive.damping / drive.gear_ratio) * speed
        return (motor_voltage - drive.emf_constant * speed) * (1.0 / drive.resistance)

    def _current_change(
        self,
        j: int,
        point: MotionPoint,
        motor_voltages: Sequence[Value],
        arguments: dict[int, dict[str, Value]],
    ) -> Value:
        """Return the force that its law and effects on current and torque of drive j add, N or Nm."""
        ohmic = named("ohmic_current", j, self.ohmic_current(j, point, motor_voltages[j]))
        current = self._changed_current(j, point, motor_voltages, ohmic, arguments)
        quantities = {"q": self.position(point, self.drive_coordinates[j])}
        for k, e in self.effects_at("torque", self.machine.drives[j].name):
            current = named("torque", k, self.evaluate(e, "torque", {"i": current, **quantities}))
        return self.drives[j].gear_ratio * self.drives[j].Kt * (current - ohmic)

    def _changed_current(
        self,
        j: int,
        point: MotionPoint,
        motor_voltages: Sequence[Value],
        current: Value,
        arguments: dict[int, dict[str, Value]],
    ) -> Value:
        """Apply effects on set point and current, and the law, of drive j to the current by Ohm's law, A."""
        command = motor_voltages[j]
        for k, e in self.effects_at("set_point", self.machine.drives[j].name):
            quantities = {"V": command, "q": self.position(point, self.drive_coordinates[j])}
            command = named("set_point", k, self.evaluate(e, "set_point", quantities))
        for k, e in self.effects_at("current", self.machine.drives[j].name):
            hooks = (e.definition.next_state, e.definition.current)
            of_state, of_current = (argument_names(hook) if hook else () for hook in hooks)
            given = {"i": current, "V": command}
            if "power" in of_state:
                given |= self._drawn_power(e, point, motor_voltages)
            # `effect_state` and `next_state` know the speed and the changes in their time.
            arguments[k] = self._drive_quantities(j, point, given, {*of_state} - {"v", "dq", "dv"})
            quantities = self._drive_quantities(j, point, given, of_current)
            quantities["z"] = self.effect_state(k, point, **arguments[k])
            current = named("current", k, self.evaluate(e, "current", quantities))
        return current

    def _drive_quantities(
        self, j: int, point: MotionPoint, given: Mapping[str, Value], names: Collection[str]
    ) -> dict[str, Value]:
        """Return what has one of the names: given quantities, the motion at drive j, its constants."""
        i = self.drive_coordinates[j]
        quantities: dict[str, Callable[[], Value]] = {
            "q": lambda: self.position(point, i),
            "v": lambda: self.speed(point, i),
            "dq": lambda: 0.0 if point.elapsed is None else 2.0 * point.elapsed * self.speed(point, i),
            "dv": lambda: point.gained[i] * self.per_radius(i) if point.gained else 0.0,
            "N": lambda: self.drives[j].gear_ratio,
            "R": lambda: self.drives[j].resistance,
        }
        taken = {name: value for name, value in given.items() if name in names}
        return taken | {name: value() for name, value in quantities.items() if name in names}

    def _drawn_power(
        self, effect: AppliedEffect, point: MotionPoint, motor_voltages: Sequence[Value]
    ) -> dict[str, Value]:
        """Return the power that an effect's drives draw together by Ohm's law, and that at standstill, W."""
        drives = effect.components(self.machine)
        power, stall_power = 0.0, 0.0
        for j, (drive, voltage) in enumerate(zip(self.machine.drives, motor_voltages, strict=True)):
            if drive.name in drives:
                power = power + voltage * self.ohmic_current(j, point, voltage)
                stall_power = stall_power + voltage * voltage / self.drives[j].resistance
        return {"power": power, "stall_power": stall_power}

    def current(self, j: int, point: MotionPoint, motor_voltages: Sequence[Value]) -> Value:
        """Return a drive's current, including its law and effects such as a limit or inductance.

        Args:
            j: Index of the drive.
            point: Belt travel (position, or radius * angle of a pulley), m, and its rate, m/s, of every
                coordinate, and the states of the effects.
            motor_voltages: Voltage at each motor, V: floats, arrays of one shape or symbolic expressions.

        Returns:
            Current, A, in the type of the arguments; for a drive with torque commands or a law, torque of the
            motor shaft, Nm.
        """
        ohmic = self.ohmic_current(j, point, motor_voltages[j])
        return self._changed_current(j, point, motor_voltages, ohmic, {})

    # -- forces ----------------------------------------------------------------------------------------------

    def force_balance(
        self, point: MotionPoint, motor_voltages: Sequence[Value], forces: Sequence[Value]
    ) -> ForceBalance:
        """Add the forces of effects to those of belts and drives, and determine the Coulomb friction force.

        Back-EMF counts as viscous friction and is in none of the forces.

        Args:
            motor_voltages: Voltage at the terminals of each motor, V.
            forces: Sum of the forces of belts and drives on each coordinate, N.

        Returns:
            The sum and the Coulomb friction force of each coordinate along its belt travel, N, and the
            arguments of the formulas by which effects advance their states (`next_state`).
        """
        arguments: dict[int, dict[str, Value]] = {}
        totals, levels = [], []
        for i, force in enumerate(forces):
            changes = [
                self._current_change(j, point, motor_voltages, arguments)
                for j, drive in enumerate(self.machine.drives)
                if self.drive_coordinates[j] == i
                and any(any(self.effects_at(hook, drive.name)) for hook in ("current", "torque"))
            ]
            level = self._coulomb_level(i, point, motor_voltages, changes)
            for k, e in self.effects_on("friction", i):  # dry friction by the effect, not by Coulomb's law
                arguments[k] = {"level": level * self.radius(i)}
                state = self.effect_state(k, point, **arguments[k])
                quantities = {**self._quantities(k, i, point), "z": state, **arguments[k]}
                force = force - self.evaluate(e, "friction", quantities) * self.per_radius(i)
                level = 0.0
            for k, e in self.effects_on("force", i):
                if not e.definition.active_region and not _needs_net_force(e):
                    quantities = self._with_state(k, i, point)
                    if "load" in argument_names(e.definition.force):
                        of_drives = self._standstill_force(i, motor_voltages)
                        quantities |= {"load": (forces[i] - of_drives) * self.radius(i)}
                    force = force + self.evaluate(e, "force", quantities) * self.per_radius(i)
            for change in changes:
                force = force + change * self.per_radius(i)
            totals.append(force)
            levels.append(level)
        totals = self._with_guarded_forces(totals, point)
        return ForceBalance(self._with_reactions(totals, levels, point), levels, arguments)

    def _coulomb_level(
        self, i: int, point: MotionPoint, motor_voltages: Sequence[Value], changes: Sequence[Value]
    ) -> Value:
        """Return coordinate i's Coulomb friction, N, never negative; `changes`: drive forces by effects."""
        level = self.coulomb(i)
        # Effects that scale the friction force come after those that add to it.
        effects = sorted(
            self.effects_on("coulomb", i), key=lambda e: "level" in argument_names(e[1].definition.coulomb)
        )
        for k, e in effects:
            quantities = {**self._with_state(k, i, point), "level": level * self.radius(i)}
            if "drive" in argument_names(e.definition.coulomb):
                quantities["drive"] = sum(changes, start=self._drive_force(i, point, motor_voltages))
            level = level + self.evaluate(e, "coulomb", quantities) * self.per_radius(i)
        return maximum(level, 0.0) if effects else level

    def _drive_force(self, i: int, point: MotionPoint, motor_voltages: Sequence[Value]) -> Value:
        """Return the force or torque of the drives of coordinate i by Ohm's law, with back-EMF, N or Nm."""
        force: Value = 0.0
        for j, drive in enumerate(self.drives):
            if self.drive_coordinates[j] == i:
                force = force + drive.gear_ratio * drive.Kt * self.ohmic_current(j, point, motor_voltages[j])
        return force

    def _force_of(self, k: int, i: int, point: MotionPoint) -> Value:
        """Return the force of effect k along the belt travel of coordinate i, N."""
        effect = self.instances[k].effect
        return self.evaluate(effect, "force", self._with_state(k, i, point)) * self.per_radius(i)

    def _with_guarded_forces(self, forces: list[Value], point: MotionPoint) -> list[Value]:
        """Add the forces that vanish for most machines; a kernel evaluates them only where one acts."""
        guarded = [
            k
            for k, e in enumerate(self.instances)
            if e.effect.definition.force and e.effect.definition.active_region
        ]
        if not guarded:
            return forces
        coordinates = [self.instances[k].coordinate for k in guarded]

        def active() -> Value:
            regions = [
                self.evaluate(self.instances[k].effect, "active_region", self._quantities(k, i, point))
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

    def _with_reactions(
        self, forces: list[Value], levels: Sequence[Value], point: MotionPoint
    ) -> list[Value]:
        """Add the forces between coordinates that effects add and those at their sites.

        The first act on the coordinates at the sites, the second depend on the net force there.
        """
        forces = list(forces)
        for k, instance in enumerate(self.instances):
            if instance.effect.definition.reaction:
                site, i = self.machine.coordinate_names.index(instance.component), instance.coordinate
                quantities = {**self._quantities(k, i, point), "m": self._inertia(i)}
                reaction = self.evaluate(instance.effect, "reaction", quantities)
                forces[site] = forces[site] + reaction * self.per_radius(site)
        result = list(forces)
        for k, instance in enumerate(self.instances):
            if _needs_net_force(instance.effect):
                site, i = self.machine.coordinate_names.index(instance.component), instance.coordinate
                v, level = point.speed[site], levels[site]
                static = minimum(maximum(forces[site], -level), level)
                friction = where(absolute(v) > 0.0, copysign(level, v), static)
                friction = friction + self.viscous(site, copysign(1.0, v)) * v
                quantities = {
                    "m": self._inertia(i),
                    "net": (forces[site] - friction) * self.radius(site),
                    "friction": friction * self.radius(site),
                }
                force = self.evaluate(
                    instance.effect, "force", {**self._with_state(k, i, point), **quantities}
                )
                result[i] = result[i] + force * self.per_radius(i)
        return result

    def _inertia(self, i: int) -> Value:
        """Return the mass or inertia of coordinate i in its own unit, kg or kg m^2."""
        return self.mass(i) * self.radius(i) * self.radius(i)

    def balance(
        self, point: MotionPoint, voltages: Sequence[Value], belt_forces: Sequence[Value] | None = None
    ) -> ForceBalance:
        """Return the sum of belt, drive and effect forces on each coordinate, and the Coulomb friction force.

        It computes belt and drive forces for `force_balance`, whose result it returns.

        Args:
            voltages: Commanded voltage of each drive, V, after its delay.
            belt_forces: Force of the belts on each coordinate, N, if it is known. Default: it is computed.
        """
        motor_voltages = self.motor_voltages(voltages)
        forces = self.belt_forces(point, self.belt_states(point)) if belt_forces is None else belt_forces
        return self.force_balance(point, motor_voltages, self.add_drive_forces(forces, motor_voltages))

    def net_forces(
        self,
        point: MotionPoint,
        voltages: Sequence[Value],
        direction: Callable[[Value], Value] = sign,
        *,
        belt_forces: Sequence[Value] | None = None,
    ) -> list[Value]:
        """Return the sum of all forces on each coordinate, N, with effects, viscous and Coulomb friction.

        Args:
            voltages: Commanded voltage of each drive, V, after its delay.
            direction: Function of the speed, m/s, that gives the direction of the motion in [-1, 1]: `sign`,
                or for optimization a smooth function such as tanh(v / v0) with a small speed v0.
            belt_forces: As in `balance`.
        """
        forces, coulomb, _ = self.balance(point, voltages, belt_forces)
        result = []
        for i, (force, level, v) in enumerate(zip(forces, coulomb, point.speed, strict=True)):
            sign_of_motion = direction(v)
            result.append(force - self.viscous(i, sign_of_motion) * v - level * sign_of_motion)
        return result

    def accelerations(
        self, point: MotionPoint, voltages: Sequence[Value], direction: Callable[[Value], Value] = sign
    ) -> list[Value]:
        """Return each coordinate's acceleration along its belt travel, m/s^2: net force divided by mass.

        The arguments are those of `net_forces`.
        """
        return [force / self.mass(i) for i, force in enumerate(self.net_forces(point, voltages, direction))]

    # -- arrays ----------------------------------------------------------------------------------------------

    def point(
        self,
        positions: Any,
        velocities: Any | None = None,
        time_s: Any = 0.0,
        effect_states: Mapping[int, Value] | None = None,
    ) -> MotionPoint:
        """Convert arrays of positions and velocities to a point of the motion at which forces are evaluated.

        Args:
            positions: Positions, m or rad, real or complex, shape (..., coordinates).
            velocities: Velocities, m/s or rad/s, shape (..., coordinates); None: at rest.
            time_s: Time since the machine was switched on, s, shape (...).
            effect_states: State of each effect that has one (bristle deflection, motor current, ...), SI,
                shape (...) each, by index in `instances`; None: all zero.
        """
        q = 1.0 * np.asarray(positions)  # real or complex
        v = np.zeros_like(q) if velocities is None else 1.0 * np.asarray(velocities)
        radii = [self.radius(i) for i in range(q.shape[-1])]
        return MotionPoint(
            [q[..., i] * radius for i, radius in enumerate(radii)],
            [v[..., i] * radius for i, radius in enumerate(radii)],
            time_s,
            effect_states or {},
        )

    def in_units(self, forces: Sequence[Value]) -> Any:
        """Convert forces along the belt travel to forces, N, or torques, Nm, shape (..., coordinates)."""
        return np.stack(np.broadcast_arrays(*(f * self.radius(i) for i, f in enumerate(forces))), axis=-1)


def _needs_net_force(effect: AppliedEffect) -> bool:
    """Return whether the force of an effect depends on the net force on the coordinate at its site."""
    return effect.definition.force is not None and "net" in argument_names(effect.definition.force)
