"""A frame on soft feet: it swings under a carriage's reaction and carries that carriage's sensor along.

The coordinate `frame` is the displacement f of the frame, in m (an angle at a radius of 1 m), that the sensor
adds to the position of the carriage. The frame is much heavier than the carriage, so that it does not act
back on it. r is the ratio of the carriage's mass to that of the frame; it is negative for a sensor on the
frame and positive for one beside it. The frame carries the motors. Where it carries the rails too, friction
acts inside it (s = 0); where the rails stand on the ground, the frame bears the force of the belts without
the friction (s = 1).
"""

import dataclasses
import math

from ..machine import AppliedEffect, Coordinate, Effect, EffectParameter, Machine


def force(q, v, m, net, friction, f0, zeta, r, s):  # type: ignore[no-untyped-def]
    """Return the force m f'' = -m (w^2 f + 2 zeta w f') - r (m x'' + s friction), N, with w = 2 pi f0.

    q, v: displacement f and speed f' of the frame; m: mass of the carriage; net: its mass times its
    acceleration x''; friction: that on the carriage, positive against positive motion; f0: natural frequency,
    Hz; zeta: damping ratio; r: mass of the carriage / mass of the frame, negative for a sensor on the frame,
    positive for one beside it; s: fraction of the friction that the ground bears, 0 to 1.
    """
    w = 2.0 * math.pi * f0
    return -m * w * (w * q + 2.0 * zeta * v) - r * (net + s * friction)


def fits(machine: Machine) -> bool:
    """Return whether a machine can have this effect: it has no coordinate `frame` yet."""
    return "frame" not in machine.coordinate_names


def fits_site(machine: Machine, site: str) -> bool:
    """Return whether the effect can act at a coordinate, which must be linear and measured by a sensor."""
    return machine.coordinate(site).kind == "linear" and any(s.coordinate == site for s in machine.sensors)


def structure(machine: Machine, effect: AppliedEffect) -> Machine:
    """Add the coordinate of the frame, and its displacement to the readings of the sensors of the carriage.

    The mass of the coordinate is tied to that of the carriage, the effect's site; it has no friction.
    """
    carriage = machine.coordinate(effect.site)
    frame = Coordinate("frame", carriage.mass, kind="rotary", radius=1.0)
    sensors = [
        dataclasses.replace(s, row={**s.row, "frame": s.row[carriage.name]})
        for s in machine.sensors
        if s.coordinate == carriage.name
    ]
    mass, factor = machine.untied(f"{carriage.name}.mass")
    ties = {"frame.mass": (mass, factor)}
    ties |= {f"frame.{friction}": (f"{effect.label}.zeta", 0.0) for friction in ("viscous", "coulomb")}
    return machine.with_components(frame, *sensors, ties=ties)


def fastest(machine: Machine, effect: AppliedEffect) -> float:
    """Return the natural frequency of the frame, rad/s, or the rate of its damping, 2 zeta w."""
    return 2.0 * math.pi * effect.parameters["f0"] * max(1.0, 2.0 * effect.parameters["zeta"])


EFFECT = Effect(
    name="frame_resonance",
    site="coordinate",
    formula="f'' + 2 zeta w f' + w^2 f = -r (x'' + s F/m), w = 2 pi f0; measurement = x + f",
    source="linear oscillator with base excitation; Rankers 1997, Machine dynamics in mechatronic systems",
    force=force,
    coordinate="frame",
    structure=structure,
    fits=fits,
    fits_site=fits_site,
    fastest=fastest,
    parameters=(
        EffectParameter(
            "f0", "Hz", 0.5, 500.0, scale=10.0, grid=(7.0, 9.0, 11.5, 15.0, 19.0, 24.0, 31.0, 40.0)
        ),
        EffectParameter("zeta", "1", 0.0, 1.0, scale=0.05, grid=(0.05,)),
        EffectParameter("r", "1", -1.0, 1.0, scale=0.03, grid=(0.03, -0.03), role="amplitude"),
        # The bounds allow for the uncertainty of 0 and 1.
        EffectParameter("s", "1", -0.5, 1.5, scale=0.5, grid=(0.5,)),
    ),
)
