"""Idlers with inertia: the 20th-order model of Sollmann et al. (2010), eq. 25-34; every pulley is a coordinate.

Each belt becomes its three sections between pulleys. They have the same EA, and their lengths have the proportions of
Table 4. The 8th-order model lumps the inertia J and the friction B of the idlers into motors and cart (eq. 4-8); here
both are subtracted there: M_cart - 4 J/r^2, J_M - J. The idlers of one side are equal.
"""

import dataclasses

from ..machine import AppliedEffect, Belt, Coordinate, Effect, EffectParameter, Machine, Row
from ..machine.presets import SECTIONS

# Sections by belt: (name, number in the paper, extension, length). The first one keeps the parameters of the belt.
_SECTIONS: dict[str, tuple[tuple[str, int, Row, Row], ...]] = {
    "left": (
        ("left", 1, {"phi1": 1, "phi3": -1}, {}),
        ("left_rail", 5, {"x": 1, "phi3": 1, "phi7": 1}, {"x": 1}),
        ("left_cart", 7, {"y": 1, "phi7": -1}, {"y": 1}),
    ),
    "right": (
        ("right", 2, {"phi2": -1, "phi4": 1}, {}),
        ("right_rail", 6, {"x": 1, "phi4": -1, "phi8": -1}, {"x": 1}),
        ("right_cart", 8, {"y": -1, "phi8": 1}, {"y": -1}),
    ),
    "bottom": (
        ("bottom", 9, {"phi5": 1, "phi6": -1}, {}),
        ("bottom_left", 3, {"x": -1, "phi1": -1, "phi5": -1}, {"x": -1}),
        ("bottom_right", 4, {"x": -1, "phi2": 1, "phi6": 1}, {"x": -1}),
    ),
}
_ROWS: dict[str, Row] = {
    "left": {"x": 1, "y": 1, "phi1": 1},
    "right": {"x": 1, "y": -1, "phi2": -1},
    "bottom": {"x": -2, "phi1": -1, "phi2": 1},
}
_SIDES = (("left", "phi1", (3, 5, 7)), ("right", "phi2", (4, 6, 8)))


def fits(machine: Machine) -> bool:
    """Check whether a machine can have this effect: it needs the belts of the 8th-order model and no ties.

    Args:
        machine: The machine.

    Returns:
        True if the effect can be added.
    """
    return {b.name: dict(b.extension) for b in machine.belts} == _ROWS and not machine.ties


def structure(machine: Machine, effect: AppliedEffect) -> Machine:
    """Add the idlers phi3..phi8, split each belt in three, and subtract the idlers from motors and cart.

    Args:
        machine: Machine with the belts of the 8th-order model.
        effect: This effect with the inertia J, kg m^2, and the viscous friction B, Nms, of an idler, per side.

    Returns:
        The machine of 20th order; the parameters of idlers and sections are tied to the effect and the belts.
    """
    radius = machine.coordinate("phi1").radius
    idlers, lumped = [], {}
    ties: dict[str, tuple[str, float]] = {}
    cart = machine.coordinate("y")
    for side, motor, numbers in _SIDES:
        inertia, viscous = (effect.parameters[f"{symbol}_{side}"] for symbol in "JB")
        for i in numbers:
            c = Coordinate(f"phi{i}", inertia, viscous, kind="rotary", radius=radius)
            idlers.append(c)
            ties |= {f"{c.name}.mass": (f"{effect.label}.J_{side}", 1.0)}
            ties |= {f"{c.name}.viscous": (f"{effect.label}.B_{side}", 1.0)}
            ties |= {f"{c.name}.coulomb": (f"{effect.label}.B_{side}", 0.0), f"{c.name}.radius": ("phi1.radius", 1.0)}
        lumped[motor] = _without(machine.coordinate(motor), inertia, viscous)
        cart = _without(cart, 2.0 * inertia / radius**2, 2.0 * viscous / radius**2)
    lumped["y"] = cart
    belts = []
    for b in machine.belts:
        total = sum(SECTIONS[number - 1] for _, number, _, _ in _SECTIONS[b.name])
        fractions = [SECTIONS[number - 1] / total for _, number, _, _ in _SECTIONS[b.name]]
        for (name, _, extension, length), fraction in zip(_SECTIONS[b.name], fractions, strict=True):
            belts.append(Belt(name, b.EA, fraction * b.rest_length, extension, length if b.length else {}))
            if name != b.name:
                ties |= {f"{name}.EA": (f"{b.name}.EA", 1.0)}
                ties |= {f"{name}.rest_length": (f"{b.name}.rest_length", fraction / fractions[0])}
    return dataclasses.replace(
        machine,
        coordinates=(
            *(lumped.get(c.name, c) for c in machine.coordinates),
            *sorted(idlers, key=lambda c: c.name),
        ),
        belts=tuple(belts),
        ties={**machine.ties, **ties},
    )


def _without(c: Coordinate, mass: float, friction: float) -> Coordinate:
    """Return a coordinate without what the 8th-order model lumps into it; at least a fifth remains."""
    return dataclasses.replace(
        c, mass=max(c.mass - mass, 0.2 * c.mass), viscous=max(c.viscous - friction, 0.2 * c.viscous)
    )


EFFECT = Effect(
    name="idler_inertia",
    family="idler_inertia",
    site="machine",
    formula="J phi_i'' + B phi_i' = r (T_before - T_after), i = 3..8",
    source="Sollmann et al., eq. 25-34 with errata",
    structure=structure,
    fits=fits,
    parameters=(
        EffectParameter("J_left", "kg m^2", 2e-6, 1.0, scale=1e-5, grid=(2e-5, 5.6e-5)),
        EffectParameter("J_right", "kg m^2", 2e-6, 1.0, scale=1e-5, grid=(2e-5, 5.6e-5)),
        EffectParameter("B_left", "Nms", 0.0, 1.0, scale=1e-3, grid=(1e-3,)),
        EffectParameter("B_right", "Nms", 0.0, 1.0, scale=1e-3, grid=(1e-3,)),
    ),
)
