"""Idlers with inertia: the 20th-order model of Sollmann et al. (2010), eq. 25-34; each pulley a coordinate.

Each belt becomes its three sections between pulleys. They have the same EA, and their lengths have the
proportions of Table 4. The 8th-order model lumps the inertia J and the friction B of the idlers into motors
and cart (eq. 4-8); here both are subtracted there: M_cart - 4 J/r^2, J_M - J. The idlers of one side are
equal.
"""

import dataclasses
import itertools
from collections.abc import Sequence

from ..machine import AppliedEffect, Belt, Coordinate, Effect, EffectParameter, Machine, Row
from ..machine.presets import SECTIONS

# Names of the H-frame's components by which this module refers to them; `_roles` finds their names in a
# machine. Sections by belt: (suffix of the name, number in the paper, extension, length). The first one keeps
# the parameters and the name of the belt.
_SECTIONS: dict[str, tuple[tuple[str, int, Row, Row], ...]] = {
    "left": (
        ("", 1, {"phi1": 1, "phi3": -1}, {}),
        ("_rail", 5, {"x": 1, "phi3": 1, "phi7": 1}, {"x": 1}),
        ("_cart", 7, {"y": 1, "phi7": -1}, {"y": 1}),
    ),
    "right": (
        ("", 2, {"phi2": -1, "phi4": 1}, {}),
        ("_rail", 6, {"x": 1, "phi4": -1, "phi8": -1}, {"x": 1}),
        ("_cart", 8, {"y": -1, "phi8": 1}, {"y": -1}),
    ),
    "bottom": (
        ("", 9, {"phi5": 1, "phi6": -1}, {}),
        ("_left", 3, {"x": -1, "phi1": -1, "phi5": -1}, {"x": -1}),
        ("_right", 4, {"x": -1, "phi2": 1, "phi6": 1}, {"x": -1}),
    ),
}
_ROWS: dict[str, Row] = {
    "left": {"x": 1, "y": 1, "phi1": 1},
    "right": {"x": 1, "y": -1, "phi2": -1},
    "bottom": {"x": -2, "phi1": -1, "phi2": 1},
}
_LENGTH = ".rest_length"  # end of the names of parameters that ties connect
_SIDES = (("left", "phi1", (3, 5, 7)), ("right", "phi2", (4, 6, 8)))


def _roles(machine: Machine) -> dict[str, str]:
    """Return each component's name in the machine by its name here, empty unless an H-frame has the belts."""
    rows = [(dict(b.extension), b.name) for b in machine.belts]
    coordinates = ("x", "y", "phi1", "phi2")
    stretched_by = [name for name in machine.coordinate_names if any(name in row for row, _ in rows)]
    if len(rows) != len(_ROWS) or len(stretched_by) != len(coordinates):
        return {}
    for names in itertools.permutations(stretched_by):
        roles = dict(zip(coordinates, names, strict=True))
        wanted = {belt: {roles[c]: factor for c, factor in row.items()} for belt, row in _ROWS.items()}
        if all(any(row == extension for extension, _ in rows) for row in wanted.values()):
            belts = {
                belt: next(name for extension, name in rows if extension == row)
                for belt, row in wanted.items()
            }
            return roles | belts
    return {}


def fits(machine: Machine) -> bool:
    """Return whether a machine can have this effect: belts of the 8th-order model, no ties, free names."""
    roles = _roles(machine)
    if not roles or machine.ties:
        return False
    added = {f"phi{i}" for *_, numbers in _SIDES for i in numbers}
    added |= {roles[b] + suffix for b, sections in _SECTIONS.items() for suffix, *_ in sections if suffix}
    return not added & {*roles.values(), *(d.name for d in machine.drives)}


def structure(machine: Machine, effect: AppliedEffect) -> Machine:
    """Add the idlers phi3..phi8, split each belt in three, and subtract the idlers from motors and cart.

    The result is the machine of 20th order. Parameters of idlers and sections are tied to the effect, the
    inertias of one idler, J_left and J_right, kg m^2, and its viscous friction, B_left and B_right, Nms, and
    to the belts.
    """
    roles = _roles(machine)
    radius = machine.coordinate(roles["phi1"]).radius
    idlers, lumped = [], {}
    ties: dict[str, tuple[str, float]] = {}
    cart = machine.coordinate(roles["y"])
    for side, motor, numbers in _SIDES:
        inertia, viscous = (effect.parameters[f"{symbol}_{side}"] for symbol in "JB")
        for i in numbers:
            c = Coordinate(f"phi{i}", inertia, viscous, kind="rotary", radius=radius)
            idlers.append(c)
            ties |= {f"{c.name}.mass": (f"{effect.label}.J_{side}", 1.0)}
            ties |= {f"{c.name}.viscous": (f"{effect.label}.B_{side}", 1.0)}
            ties |= {f"{c.name}.coulomb": (f"{effect.label}.B_{side}", 0.0)}
            ties |= {f"{c.name}.radius": (f"{roles['phi1']}.radius", 1.0)}
        lumped[roles[motor]] = _without(machine.coordinate(roles[motor]), inertia, viscous)
        cart = _without(cart, 2.0 * inertia / radius**2, 2.0 * viscous / radius**2)
    lumped[cart.name] = cart
    belts = []
    role_of = {name: role for role, name in roles.items()}
    for b in machine.belts:
        sections = _SECTIONS[role_of[b.name]]
        total = sum(SECTIONS[number - 1] for _, number, _, _ in sections)
        fractions = [SECTIONS[number - 1] / total for _, number, _, _ in sections]
        for (suffix, _, *rows), fraction in zip(sections, fractions, strict=True):
            name = b.name + suffix
            extension, length = ({roles.get(c, c): factor for c, factor in row.items()} for row in rows)
            belts.append(Belt(name, b.EA, fraction * b.rest_length, extension, length if b.length else {}))
            if suffix:
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


def rigid(machine: Machine, effect: AppliedEffect) -> Machine:
    """Return the machine of 8th order: belts in one piece, the idlers lumped into motors and cart."""
    idlers = {f"phi{i}" for *_, numbers in _SIDES for i in numbers}
    owner = {  # belt by each of its sections but the first, which has the belt's name
        tied.removesuffix(_LENGTH): belt.removesuffix(_LENGTH)
        for tied, (belt, _) in machine.ties.items()
        if tied.endswith(_LENGTH)
    }
    pieces: dict[str, list[Belt]] = {}
    for b in machine.belts:
        pieces.setdefault(owner.get(b.name, b.name), []).append(b)

    def total(rows: Sequence[Row]) -> dict[str, float]:
        sums = {name: sum(row.get(name, 0.0) for row in rows) for name in machine.coordinate_names}
        return {name: factor for name, factor in sums.items() if factor}

    whole = dataclasses.replace(
        machine,
        coordinates=tuple(c for c in machine.coordinates if c.name not in idlers),
        belts=tuple(
            dataclasses.replace(
                of_belt[0],
                rest_length=sum(b.rest_length for b in of_belt),
                extension=total([b.extension for b in of_belt]),
                length=total([b.length for b in of_belt]),
            )
            for of_belt in pieces.values()
        ),
        ties={
            key: tie for key, tie in machine.ties.items() if key.rpartition(".")[0] not in {*idlers, *owner}
        },
    )
    roles = _roles(whole)
    lumped = {name: whole.coordinate(roles[name]) for name in ("phi1", "phi2", "y")}
    for _, motor, numbers in _SIDES:
        idler = machine.coordinate(f"phi{numbers[0]}")
        lumped[motor] = _with(lumped[motor], idler.mass, idler.viscous)
        per_travel = 2.0 / idler.radius**2
        lumped["y"] = _with(lumped["y"], per_travel * idler.mass, per_travel * idler.viscous)
    return whole.with_components(*lumped.values())


def _with(c: Coordinate, mass: float, friction: float) -> Coordinate:
    """Return a coordinate with what the 8th-order model lumps into it."""
    return dataclasses.replace(c, mass=c.mass + mass, viscous=c.viscous + friction)


EFFECT = Effect(
    name="idler_inertia",
    site="machine",
    formula="J phi_i'' + B phi_i' = r (T_before - T_after), i = 3..8",
    source="Sollmann et al., eq. 25-34 with errata",
    structure=structure,
    rigid=rigid,
    fits=fits,
    parameters=(
        EffectParameter("J_left", "kg m^2", 2e-6, 1.0, scale=1e-5, grid=(2e-5, 5.6e-5)),
        EffectParameter("J_right", "kg m^2", 2e-6, 1.0, scale=1e-5, grid=(2e-5, 5.6e-5)),
        EffectParameter("B_left", "Nms", 0.0, 1.0, scale=1e-3, grid=(1e-3,)),
        EffectParameter("B_right", "Nms", 0.0, 1.0, scale=1e-3, grid=(1e-3,)),
    ),
)
