"""A load that hangs from an axis of the tool or is mounted flexibly: an oscillator without a sensor.

The coordinate `payload_SITE` is the deflection d of the load from its place on the carriage, in m along a
linear axis (an angle at a radius of 1 m), in rad on a rotary one. For a pendulum of length l, w^2 = g / l.
With the load, the carriage of the declared mass becomes one of this mass divided by 1 + r, which carries r
times its own mass.
"""

import dataclasses
import math

from ..machine import AppliedEffect, Coordinate, Effect, EffectParameter, Machine


def reaction(q, v, m, f0, zeta, r):  # type: ignore[no-untyped-def]
    """Return the force of the load on the carriage, r m (w^2 d + 2 zeta w d'), N or Nm, with w = 2 pi f0.

    q, v: deflection d of the load and its rate; m: mass of the carriage; f0: natural frequency with the
    carriage held, Hz; zeta: damping ratio; r: mass of the load / mass of the carriage.
    """
    w = 2.0 * math.pi * f0
    return r * m * w * (w * q + 2.0 * zeta * v)


def force(q, v, m, net, f0, zeta):  # type: ignore[no-untyped-def]
    """Return the force m d'' = -m (w^2 d + 2 zeta w d') - m x'', N or Nm, net = m x'' on the carriage."""
    return -reaction(q, v, m, f0, zeta, 1.0) - net


def initial_spread(level, m, f0, r):  # type: ignore[no-untyped-def]
    """Return standard deviations of the load's deflection and its rate when a recording begins.

    The units are m and m/s, or rad and rad/s. The load may still swing, but so little that dry friction,
    `level`, N or Nm, holds the carriage of mass m.
    """
    w = 2.0 * math.pi * f0
    deflection = level / (r * m * w * w)
    return deflection, w * deflection


def fits_site(machine: Machine, site: str) -> bool:
    """Return whether the effect can act at a coordinate, which must be an axis of the tool."""
    return site in machine.tool_axes


def structure(machine: Machine, effect: AppliedEffect) -> Machine:
    """Add the coordinate of the deflection, without friction, and take the load's mass from the carriage.

    The mass of the coordinate is tied to that of the carriage.
    """
    name, ratio = effect.coordinate, effect.parameters["r"]
    carriage = machine.coordinate(effect.site)
    carriage = dataclasses.replace(carriage, mass=carriage.mass / (1.0 + ratio))
    load = Coordinate(name, carriage.mass, kind="rotary", radius=1.0)
    ties = {f"{name}.mass": (f"{carriage.name}.mass", 1.0)}
    ties |= {f"{name}.{friction}": (f"{effect.label}.zeta", 0.0) for friction in ("viscous", "coulomb")}
    return machine.with_components(carriage, load, ties=ties)


def rigid(machine: Machine, effect: AppliedEffect) -> Machine:
    """Return the machine without the swinging load: its mass moves with the carriage again."""
    carriage = machine.coordinate(effect.site)
    return machine.replace({f"{carriage.name}.mass": carriage.mass * (1.0 + effect.parameters["r"])})


def fastest(machine: Machine, effect: AppliedEffect) -> float:
    """Return the rate, rad/s, of load and carriage against each other, w sqrt(1 + r), or its damping."""
    values = effect.parameters
    w, total = 2.0 * math.pi * values["f0"], 1.0 + values["r"]
    return w * max(math.sqrt(total), 2.0 * values["zeta"] * total)


EFFECT = Effect(
    name="payload_swing",
    site="coordinate",
    formula="d'' + 2 zeta w d' + w^2 d = -x'', w = 2 pi f0; f = r m (w^2 d + 2 zeta w d')",
    source="vibration absorber; Den Hartog 1956, Mechanical Vibrations, 4th edition, section 3.2",
    force=force,
    reaction=reaction,
    initial_spread=initial_spread,
    coordinate="payload_{site}",
    structure=structure,
    rigid=rigid,
    fits_site=fits_site,
    fastest=fastest,
    parameters=(
        EffectParameter(
            "f0",
            "Hz",
            0.05,
            500.0,
            scale=3.0,
            grid=(0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0),
        ),
        EffectParameter("zeta", "1", 0.0, 1.0, scale=0.05, grid=(0.03,)),
        EffectParameter("r", "1", 1e-3, 100.0, scale=0.1, grid=(0.15,)),
    ),
)
