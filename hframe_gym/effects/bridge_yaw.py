"""Yaw of the bridge: a coordinate `yaw` with inertia J, stiffness k, damping c and half-width w.

The bridge moves along the first axis of the tool, here x, and the cart on it along the second one, here y.
The extension of the left belt follows x + w yaw, that of the right belt x - w yaw, that of the bottom belt x.
The tool is at x + y yaw. The effect explains an oscillation of 0.2 mm in x during y-moves, which Sollmann et
al. (2010), section V, report without explanation.
"""

import dataclasses
import math

from ..machine import AppliedEffect, Coordinate, Effect, EffectParameter, Machine


def force(q, k):  # type: ignore[no-untyped-def]
    """Return the guides' restoring torque on the yaw angle, -k q, Nm; q: angle, rad, k: stiffness, Nm/rad."""
    return -k * q


def _sides(machine: Machine) -> dict[str, float]:
    """Return, for each belt along both tool axes, the side of the bridge (+1 or -1) on which it acts."""
    bridge, cart = machine.tool_axes
    rows = {b.name: b.extension for b in machine.belts}
    return {name: row[cart] / row[bridge] for name, row in rows.items() if row.get(bridge) and row.get(cart)}


def fits(machine: Machine) -> bool:
    """Return whether a machine can have this effect: belts on both sides of the bridge, no coordinate `yaw`.

    The bridge must move along the first axis, which then has the larger mass, because the bridge carries the
    cart.
    """
    if len(machine.tool_axes) != 2 or "yaw" in machine.coordinate_names:
        return False
    bridge, cart = (machine.coordinate(axis) for axis in machine.tool_axes)
    return set(_sides(machine).values()) == {1.0, -1.0} and bridge.mass >= cart.mass


def structure(machine: Machine, effect: AppliedEffect) -> Machine:
    """Add the coordinate `yaw`, its part in belt extensions, and the product y yaw to sensors that read x.

    The mass, viscous friction and radius of the coordinate are tied to J, kg m^2, c, Nms, and w, m; k is in
    Nm/rad.
    """
    values = effect.parameters
    yaw = Coordinate("yaw", values["J"], values["c"], kind="rotary", radius=values["w"])
    sides = _sides(machine)
    bridge, cart = machine.tool_axes
    belts = [
        dataclasses.replace(b, extension={**b.extension, "yaw": sides[b.name]})
        for b in machine.belts
        if b.name in sides
    ]
    sensors = [
        dataclasses.replace(s, row={**s.row, f"{cart}*yaw": s.row[bridge]})
        for s in machine.sensors
        if s.row.get(bridge)
    ]
    ties = {
        "yaw.mass": ("J", 1.0),
        "yaw.viscous": ("c", 1.0),
        "yaw.coulomb": ("c", 0.0),
        "yaw.radius": ("w", 1.0),
    }
    tied = {name: (f"{effect.label}.{key}", factor) for name, (key, factor) in ties.items()}
    return machine.with_components(yaw, *belts, *sensors, ties=tied)


def fastest(machine: Machine, effect: AppliedEffect) -> float:
    """Return the natural frequency of the yaw angle on the guides, sqrt(k/J), rad/s."""
    return math.sqrt(effect.parameters["k"] / effect.parameters["J"])


EFFECT = Effect(
    name="bridge_yaw",
    site="machine",
    formula="J yaw'' + c yaw' + k yaw = w (T_r - T_l); tool at x + y yaw",
    source="racking of gantries; Sollmann et al. 2010, section V",
    force=force,
    coordinate="yaw",
    structure=structure,
    fits=fits,
    fastest=fastest,
    parameters=(
        EffectParameter("J", "kg m^2", 1e-5, 1e3, scale=0.1, grid=(0.03, 0.15)),
        EffectParameter("k", "Nm/rad", 1.0, 1e8, scale=100.0, grid=(500.0, 2e3, 8e3, 3e4)),
        EffectParameter("c", "Nms", 0.0, 1e4, scale=1.0, grid=(1.0,)),
        EffectParameter("w", "m", 1e-3, 10.0, scale=0.1, grid=(0.25,)),
    ),
)
