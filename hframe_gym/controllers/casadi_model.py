"""A machine's equations of motion as CasADi expressions, with every number of `Machine.parameters` a symbol.

What the kernel integrates (machine/codegen.py), written for an optimiser that wants derivatives: belt travel p and its
speed v, M v' = drive - viscous friction - Coulomb friction - belts, with belts whose stiffness follows the carriage
(eq. 38-44) and what that pushes with, 1/2 s^2 dk/dq.  Coulomb friction is F tanh(v / turning), for sign(v) has no
derivative.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from ..machine import Machine
from ..machine.machine import Row


@dataclass(frozen=True)
class CasadiModel:
    """Functions of a machine with n coordinates, d drives and P parameters, in travel, m, and its speed, m/s.

    rate: (z (2 n), u (d), parameters (P), turning) -> z' (2 n), with u in shares of the rated voltage and turning,
    m/s, the speed around which friction turns over.  pull: (z, parameters) -> force of the belts on each travel (n), N.
    """

    rate: Any
    pull: Any


def equations(machine: Machine) -> CasadiModel:
    """The equations of a machine without effects.

    Raises ValueError for a machine with effects: their formulas speak to the kernel only.
    """
    if machine.effects:
        raise ValueError(
            f"machine {machine.name!r} has effects ({', '.join(e.label for e in machine.effects)}); "
            "its time-optimal motion is worked out for machines without"
        )
    n = len(machine.coordinates)
    symbols = ca.SX.sym("parameters", len(machine.parameters))
    value = dict(zip(machine.parameters, ca.vertsplit(symbols), strict=True))
    state, share, turning = ca.SX.sym("z", 2 * n), ca.SX.sym("u", len(machine.drives)), ca.SX.sym("turning")
    travel, speed = state[:n], state[n:]
    radius = [value[f"{c.name}.radius"] if c.kind == "rotary" else 1.0 for c in machine.coordinates]
    belts = _belt_forces(machine, value, travel)
    forces = list(belts)
    for i, c in enumerate(machine.coordinates):
        forces[i] -= value[f"{c.name}.viscous"] / radius[i] ** 2 * speed[i]
        forces[i] -= value[f"{c.name}.coulomb"] / radius[i] * ca.tanh(speed[i] / turning)
    for j, d in enumerate(machine.drives):
        i = machine.coordinate_names.index(d.coordinate)
        Kt, Ke, resistance, gear = (value[f"{d.name}.{key}"] for key in ("Kt", "Ke", "resistance", "gear_ratio"))
        volts = share[j] * d.rated_voltage - Ke * gear * speed[i] / radius[i]
        forces[i] += gear * Kt / resistance * volts / radius[i]
    masses = [value[f"{c.name}.mass"] / radius[i] ** 2 for i, c in enumerate(machine.coordinates)]
    change = ca.vertcat(speed, *(force / mass for force, mass in zip(forces, masses, strict=True)))
    return CasadiModel(
        ca.Function("rate", [state, share, symbols, turning], [change]),
        ca.Function("pull", [state, symbols], [ca.vertcat(*belts)]),
    )


def _belt_forces(machine: Machine, value: dict[str, Any], travel: Any) -> list[Any]:
    """Force of the belts on each coordinate's travel, N."""
    names = machine.coordinate_names

    def along(row: Row) -> Any:
        return sum(factor * travel[names.index(c)] for c, factor in row.items())

    forces = [ca.SX(0.0) for _ in names]
    for belt in machine.belts:
        stretch, length = along(belt.extension), value[f"{belt.name}.rest_length"] + along(belt.length)
        tension = value[f"{belt.name}.EA"] / length * stretch
        for c, factor in belt.extension.items():
            forces[names.index(c)] -= factor * tension
        for c, factor in belt.length.items():  # -1/2 s^2 dk/dq, with dk/dq = -k / length * factor
            forces[names.index(c)] += 0.5 * factor * tension * stretch / length
    return forces
