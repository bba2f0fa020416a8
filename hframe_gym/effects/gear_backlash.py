"""Backlash of the gear between a motor, whose angle the encoder measures, and the pulley or load behind it.

The coordinate of the drive becomes the motor's side of the gap; the belts act on a coordinate behind it, with
the inertia J, the dry friction F and the viscous friction B, which the motor's side loses. A motor without
belts turns its load over the gap: no sensor need measure this load, because the motor turns without its
inertia until the teeth touch. Other effects at the coordinate, such as the weight of an arm, stay on the
motor's side. The teeth have the stiffness K and push where the angles of both sides differ by more than d,
half the gap. Their damping ratio Z, from 0 (elastic) to 1 (without rebound), ends the rebounds.
"""

import dataclasses
from collections.abc import Mapping

from ..dynamics.elementwise import maximum, minimum, sqrt, where
from ..machine import AppliedEffect, Belt, Effect, EffectParameter, Machine
from .belt_play import beyond_play

_LEAST_SHARE = 0.2  # of inertia and friction that remains before the gap


def damping(k, J, Z, per_radius):  # type: ignore[no-untyped-def]
    """Return the damping coefficient of the teeth in contact, Ns/m; the arguments are those of `tension`."""
    return 2.0 * Z * sqrt(k * J) * per_radius


def tension(s, rate, k, d, J, Z, per_radius):  # type: ignore[no-untyped-def]
    """Return the force of the teeth, N: k u + c u' on contact, u = s - clip(s, -d r, d r); they never pull.

    s: motor's side minus far side, m, rate: its rate, m/s, k: stiffness, N/m, d: half the gap, rad or m, J:
    inertia behind it, kg m^2, Z: damping ratio of its vibration against the teeth, per_radius: 1/r, 1/m.
    """
    pressed = beyond_play(s, d / per_radius)
    force = k * pressed + damping(k, J, Z, per_radius) * rate
    return where(pressed > 0.0, maximum(force, 0.0), where(pressed < 0.0, minimum(force, 0.0), 0.0))


def _names(machine: Machine, site: str) -> tuple[str, str, str]:
    """Return the names of a drive's coordinate, of the coordinate behind the gap, and of the teeth."""
    near = machine.drive(site).coordinate
    return near, f"{near}_load", EFFECT.belt.format(site=site)


def fits_site(machine: Machine, site: str) -> bool:
    """Return whether a drive can have a gap, with something behind it that this drive alone moves.

    Behind the gap there can be belts, or the load of a motor alone: while the teeth do not touch, the motor
    turns without its inertia, which the motor's encoder and current reveal. A carriage that a motor moves
    directly is excluded, because it would become two axes of the tool. The names of the added components must
    be unused.
    """
    near, far, teeth = _names(machine, site)
    drives = [d for d in machine.drives if d.coordinate == near]
    on_belts = any(near in b.extension for b in machine.belts)
    has_load = on_belts or machine.coordinate(near).kind == "rotary"
    free = far not in machine.coordinate_names and teeth not in (b.name for b in machine.belts)
    return len(drives) == 1 and has_load and free and f"{near}.mass" not in machine.ties


def structure(machine: Machine, effect: AppliedEffect) -> Machine:
    """Add the coordinate behind the gap and the teeth, and let the belts run on the new coordinate.

    Its inertia and friction and the stiffness of the teeth are tied to J, F, B and K.
    """
    near, far, teeth = _names(machine, effect.site)
    whole, values = machine.coordinate(near), effect.parameters
    motor = dataclasses.replace(
        whole,
        mass=max(whole.mass - values["J"], _LEAST_SHARE * whole.mass),
        coulomb=max(whole.coulomb - values["F"], _LEAST_SHARE * whole.coulomb),
        viscous=max(whole.viscous - values["B"], _LEAST_SHARE * whole.viscous),
    )
    load = dataclasses.replace(whole, name=far, mass=values["J"], viscous=values["B"], coulomb=values["F"])
    per_travel = 1.0 / whole.travel_per_unit**2
    ties = {
        f"{far}.mass": (f"{effect.label}.J", 1.0),
        f"{far}.viscous": (f"{effect.label}.B", 1.0),
        f"{far}.coulomb": (f"{effect.label}.F", 1.0),
        f"{far}.radius": (f"{near}.radius", 1.0),
        f"{teeth}.EA": (f"{effect.label}.K", per_travel),
    }

    def behind(row: Mapping[str, float]) -> dict[str, float]:
        return {far if name == near else name: factor for name, factor in row.items()}

    belts = [
        dataclasses.replace(b, extension=behind(b.extension), length=behind(b.length)) for b in machine.belts
    ]
    contact = Belt(teeth, values["K"] * per_travel, 1.0, {near: 1.0, far: -1.0})
    return machine.with_components(motor, load, *belts, contact, ties=ties)


def rigid(machine: Machine, effect: AppliedEffect) -> Machine:
    """Return the machine without the gap: the load turns with its motor, and the belts run on the motor."""
    near, far, teeth = _names(machine, effect.site)
    motor, load = machine.coordinate(near), machine.coordinate(far)
    whole = dataclasses.replace(
        motor,
        mass=motor.mass + load.mass,
        coulomb=motor.coulomb + load.coulomb,
        viscous=motor.viscous + load.viscous,
    )

    def before(row: Mapping[str, float]) -> dict[str, float]:
        return {near if name == far else name: factor for name, factor in row.items()}

    return dataclasses.replace(
        machine,
        coordinates=tuple(whole if c.name == near else c for c in machine.coordinates if c.name != far),
        belts=tuple(
            dataclasses.replace(b, extension=before(b.extension), length=before(b.length))
            for b in machine.belts
            if b.name != teeth
        ),
        ties={key: tie for key, tie in machine.ties.items() if key.rpartition(".")[0] not in (far, teeth)},
    )


EFFECT = Effect(
    name="gear_backlash",
    site="motor",
    belt="{site}_teeth",
    half_gap="d",
    formula="J far'' + B far' + F sign(far') = K u + 2 Z sqrt(K J) "
    "u' - belts, u = s - clip(s, -d, d), s = motor - far",
    source="Nordin and Gutman 2002, Automatica 38(10), the dead-zone model",
    tension=tension,
    damping=damping,
    structure=structure,
    rigid=rigid,
    fits_site=fits_site,
    impacts=True,
    parameters=(
        EffectParameter("d", "position", 0.0, 1.0, scale=1e-4, grid=(1e-4, 5e-4)),
        EffectParameter("J", "mass", 1e-12, 1e3, scale=0.1, grid=(0.05, 0.4)),
        EffectParameter("F", "force", 0.0, 1e3, scale=0.1, grid=(0.01,)),
        EffectParameter("B", "viscous", 0.0, 1e3, scale=0.1, grid=(0.1,)),
        EffectParameter("K", "stiffness", 1e-6, 1e12, scale=1e4, grid=(2e4,)),
        EffectParameter("Z", "1", 0.0, 1.0, scale=1.0, grid=(1.0,)),
    ),
)
