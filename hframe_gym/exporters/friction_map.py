"""Map of the friction of each coordinate over its speed, and over a position where effects depend on one."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from typing_extensions import override

from ..arrays import Array
from ..dynamics import Equations, MotionPoint
from ..machine import (
    AppliedEffect,
    Machine,
    argument_names,
    motion_limits,
    rest_state,
    rigid_motions,
    standard_deviations,
)
from .base import EXPORTERS, Files, MachineExporter, axis_range, commented, option, plain

# Speeds over the highest one. Stribeck curves bend at a hundredth to a tenth of it.
_SPEEDS = np.geomspace(1e-4, 1.0, 41)
_POINTS = 49  # positions over the range of a smooth dependence
_POINTS_PER_PERIOD, _MOST_POINTS = 16, 1001
_SLIDE_M = 10.0  # m, belt travel after which effects with a memory (bristles) slide steadily
_DEFAULT_SPEED = 1.0  # m/s of belt travel, where the machine states no highest speed
_DRY_HOOKS = ("coulomb", "friction", "viscous")


@EXPORTERS.register("friction-map")
@dataclass(frozen=True, kw_only=True)
class FrictionMapExporter(MachineExporter):
    """Write each coordinate's friction as a table over speed, and over position if effects depend on it.

    friction_map.csv has the force (N) or torque (Nm) that a drive needs at constant speed against dry
    friction, viscous friction and forces of effects, with its standard deviation where the machine was
    identified. Dry friction is that of steady sliding. Back-EMF is not in it.

    Example:  hframe export friction-map --machine axis --out friction.csv
    """

    time: float = option(
        3600.0, "Time since the machine was switched on, s, for effects that change as it warms up."
    )

    @override
    def files(self, machine: Machine) -> Files:
        """Write friction_map.csv."""
        header = self.header(
            machine,
            "Force or torque against the motion at constant speed, in the unit of the column "
            "unit (N or Nm); speeds m/s or",
            "rad/s, positions m or rad. total = dry + viscous + effects. Empty: not identified, "
            "or no dependence on position.",
            "Steady sliding, no drive torque (friction that grows with it comes on top), "
            f"{self.time:g} s after power-on.",
            "Back-EMF of the motors is not part of the friction.",
        )
        lines = ["coordinate,unit,position_of,position,speed,dry,viscous,effects,total,total_std"]
        for i, coordinate in enumerate(machine.coordinates):
            if coordinate.name in machine.spring_loaded:
                continue
            leaders: list[int | None] = [*_leaders(machine, i)]
            for leader in leaders or [None]:
                lines += self._rows(machine, i, leader)
        return {"friction_map.csv": commented(header, "#") + "\n".join(lines) + "\n"}

    def _rows(self, machine: Machine, i: int, leader: int | None) -> list[str]:
        """Return the lines of coordinate i over the position of `leader`; None: over speed only."""
        c = machine.coordinates[i]
        highest = _highest_speed(machine, i)
        positions = np.array([np.nan]) if leader is None else _positions(machine, leader)
        fractions = _SPEEDS if leader is None else _SPEEDS[::2]
        speeds = highest * np.concatenate([-fractions[::-1], fractions])
        q, v = (grid.ravel() for grid in np.meshgrid(positions, speeds, indexing="ij"))
        dry, viscous, effects = friction_parts(machine, i, v, leader, q, self.time)
        total = dry + viscous + effects
        std = standard_deviations(
            machine, lambda m: np.sum(friction_parts(m, i, v, leader, q, self.time), axis=0)
        )
        name, where = plain(c.name), "" if leader is None else plain(machine.coordinate_names[leader])
        columns = [q, v, dry, viscous, effects, total, np.full(len(v), np.nan) if std is None else std]
        return [
            ",".join([name, c.unit("force"), where, *("" if np.isnan(x) else repr(x) for x in row)])
            for row in zip(*(column.tolist() for column in columns), strict=True)
        ]


def friction_parts(
    machine: Machine, i: int, speed: Array, leader: int | None, position: Array, time_s: float
) -> tuple[Array, Array, Array]:
    """Compute the force against the motion of one coordinate at constant speed, while the others rest.

    Args:
        i: Index of the coordinate.
        speed: Speeds of the coordinate, m/s or rad/s, not zero, shape (n,).
        leader: Index of a coordinate whose position varies; None if all positions are 0.
        position: Position of this coordinate at each speed, m or rad, shape (n,); ignored without a `leader`.
        time_s: Time since the machine was switched on, s.

    Returns:
        dry: Dry friction of steady sliding, with the sign of the speed, N or Nm, shape (n,).
        viscous: Viscous friction, N or Nm, shape (n,).
        effects: Forces of effects that are no friction, with opposite sign, N or Nm, shape (n,).
    """
    frictional = tuple(e for e in machine.effects if _is_friction(e) or e.definition.structure)
    dry, viscous, forces = _against(
        dataclasses.replace(machine, effects=frictional), i, speed, leader, position, time_s
    )
    all_dry, all_viscous, all_forces = _against(machine, i, speed, leader, position, time_s)
    effects = all_dry + all_viscous + all_forces - (dry + viscous + forces)
    # Forces of frictional effects: dry friction that replaces Coulomb's law.
    return (dry + forces, viscous, effects)


def _against(
    machine: Machine, i: int, speed: Array, leader: int | None, position: Array, time_s: float
) -> tuple[Array, Array, Array]:
    """Return Coulomb friction, viscous friction and other forces against coordinate i's motion, N or Nm."""
    # Without the loops of drives that follow a set point, which damp the motion, too.
    open_loop = [dataclasses.replace(d, kind="torque", law_parameters={}) for d in machine.drives if d.law]
    acting = tuple(e for e in machine.effects if not e.definition.set_point)
    equations = Equations(dataclasses.replace(machine, effects=acting).with_components(*open_loop))
    count, radius = len(machine.coordinates), equations.radius(i)
    rest = rest_state(machine)[:count] * machine.travel_per_unit
    travel, rate = [np.full(len(speed), r) for r in rest], [np.zeros(len(speed)) for _ in range(count)]
    if leader is not None:
        travel[leader] = position * machine.travel_per_unit[leader]
    rate[i] = speed * radius
    point = MotionPoint(travel, rate, time_s, {}, _SLIDE_M / np.abs(rate[i]))
    # The voltages at which no current flows.
    open_circuit = [
        d.emf_constant * equations.speed(point, j)
        for d, j in zip(equations.drives, equations.drive_coordinates, strict=True)
    ]
    balance = equations.force_balance(point, open_circuit, [0.0] * count)
    back_emf = sum(
        d.back_emf for d, j in zip(machine.drives, equations.drive_coordinates, strict=True) if j == i
    )
    direction = np.sign(speed)
    viscous = (equations.viscous(i, direction) * radius**2 - back_emf) * speed
    parts = balance.coulomb[i] * radius * direction, viscous, -balance.forces[i] * radius
    dry, viscous, forces = (np.array(np.broadcast_to(part, speed.shape), float) for part in parts)
    return dry, viscous, forces


def _is_friction(effect: AppliedEffect) -> bool:
    """Return whether an effect changes dry or viscous friction."""
    return any(getattr(effect.definition, hook) for hook in _DRY_HOOKS)


def _leaders(machine: Machine, i: int) -> list[int]:
    """Return the coordinates on whose position effects on coordinate i depend."""
    found = []
    for instance in Equations(machine).instances:
        definition = instance.effect.definition
        hooks = [getattr(definition, h) for h in (*_DRY_HOOKS, "force") if getattr(definition, h)]
        if instance.coordinate != i or not hooks or definition.structure:
            continue
        if any("q" in argument_names(hook) for hook in hooks):
            found.append(i)
        variable, _, name = definition.against.partition(" of ")
        if variable == "position":
            found.append(machine.coordinate_names.index(name))
    return list(dict.fromkeys(found))


def _positions(machine: Machine, leader: int) -> Array:
    """Return positions over a carriage's range or a pulley's turn, dense enough for periodic effects."""
    c = machine.coordinates[leader]
    low, high = axis_range(c)
    points = _POINTS
    for instance in Equations(machine).instances:
        for p in instance.effect.definition.parameters if instance.coordinate == leader else ():
            value = abs(instance.effect.parameters[p.name])
            periods = {"rate": value / (2.0 * np.pi), "period": 1.0 / value if value else 0.0}.get(
                p.role, 0.0
            )
            points = max(points, int(_POINTS_PER_PERIOD * periods * (high - low)) + 1)
    return np.linspace(low, high, min(points, _MOST_POINTS))


def _highest_speed(machine: Machine, i: int) -> float:
    """Return the highest steady speed of a coordinate at rated voltage, m/s or rad/s."""
    limits, motions = motion_limits(machine), rigid_motions(machine)
    speeds = [limits[name].speed * abs(float(motion[i])) for name, motion in motions.items()]
    known = [speed for speed in speeds if np.isfinite(speed) and speed > 1e-6]
    return max(known, default=_DEFAULT_SPEED / machine.travel_per_unit[i])
