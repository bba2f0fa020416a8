"""Draw hidden effects at random: family, site, size and shape, with the library's parameters of it.

The size is a fraction of the full size, log-uniform from 3 % to 100 %. Full sizes (x; y; phi1 and phi2 where
it depends on the coordinate), what a used machine may plausibly have:

| effect | full size |
|---|---|
| stribeck_friction | dF 3 N; 0.8 N; 0.03 Nm (negative: a quarter of it), vs 20 to 80 mm/s or 1.5 to 4 rad/s |
| constant_force | 0.8 N; 0.8 N; 0.02 Nm |
| voltage_offset, gain_mismatch, dead_band | 0.35 V, 10 %, 0.4 V |
| current_limit | from the current at 8 V and standstill down to 40 % of it |
| electrical_lag, input_delay, sensor_delay | 1.5 ms, 2 ms, 2 ms |
| asymmetric_viscous | 30 % |
| quadratic_drag | 40 Ns^2/m^2; 40 Ns^2/m^2; 1e-4 Nms^2 |
| cable_spring | 20 N/m, unstretched within 0.1 m of the center |
| position_friction | 1.2 N; 0.3 N; 0.03 Nm, period 20 to 150 mm or a revolution divided by 1 to 6 |
| friction_slope | 5 N/m; 1.5 N/m |
| cogging | 0.03 Nm, 4 to 40 periods per revolution |
| unbalance | 0.03 Nm |
| load_friction | 0.15 |
| eccentric_pulley | 0.2 mm |
| belt_play, belt_damping, belt_hardening | 0.2 mm, 1 ms, 5e4 1/m^2 |
| belt_slack | pretension from 50 % of the motor's pull at 8 V down to 15 % |
| bridge_yaw | k from 130 kNm/rad (3 %) down to 4 kNm/rad, J 0.04 to 0.12, c 0.5 to 3 Nms, w 0.2 to 0.3 m |
| idler_inertia | always as the paper has it |
| sensor_skew, sensor_scale | 5 mrad, 2 % |
| sensor_range | end of the range from 160 mm (x) or 110 mm (y) down to 50 mm |
| presliding | bristle stiffness from 330 kN/m (3 %) down to 10 kN/m; the same in y; 330 to 10 Nm/rad |
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tests.reference_simulator import COORDINATES, Frame, Rig, Yaw
from tests.rigs.hidden_effects import (
    CHANNELS,
    MOTORS,
    Build,
    change_fields,
    change_site,
    limit_current,
    loosen_belts,
    stall_tension,
)

SMALLEST_SIZE = 0.03
_BOTH = "drives"  # site of an effect that acts on both drives alike
_ALL_COORDINATES = COORDINATES
_AXES = ("x", "y")

# Sites at which an effect of the library is drawn.
SITES: dict[str, tuple[str, ...]] = {
    "stribeck_friction": _ALL_COORDINATES,
    "constant_force": _ALL_COORDINATES,
    "voltage_offset": MOTORS,
    "gain_mismatch": MOTORS,
    "dead_band": (*MOTORS, _BOTH),
    "current_limit": (*MOTORS, _BOTH),
    "electrical_lag": (*MOTORS, _BOTH),
    "input_delay": (*MOTORS, _BOTH),
    "asymmetric_viscous": _ALL_COORDINATES,
    "quadratic_drag": _ALL_COORDINATES,
    "cable_spring": _AXES,
    "position_friction": _ALL_COORDINATES,
    "friction_slope": _AXES,
    "cogging": MOTORS,
    "unbalance": ("phi1", "phi2"),
    "load_friction": MOTORS,
    "eccentric_pulley": MOTORS,
    "belt_play": ("belts",),
    "belt_damping": ("belts",),
    "belt_slack": ("belts",),
    "belt_hardening": ("belts",),
    "bridge_yaw": ("machine",),
    "idler_inertia": ("machine",),
    "sensor_skew": ("x_m", "y_m"),
    "sensor_scale": ("x_m", "y_m"),
    "sensor_range": ("x_m", "y_m"),
    "sensor_delay": ("x_m", "y_m"),
    "presliding": _ALL_COORDINATES,
}
# Families that are drawn less often, relative to 1: the refit absorbs the first, the second has no size.
WEIGHTS = {"gain_mismatch": 0.4, "idler_inertia": 0.4}
# Only one effect of each of these sets is drawn for a rig.
_EXCLUSIVE = (
    frozenset({"belt_play", "belt_damping", "belt_slack", "belt_hardening"}),
    frozenset({"bridge_yaw", "idler_inertia"}),
    frozenset({"position_friction", "friction_slope"}),
)
# Families with a version 10 to 20 % off the library's form.
OFF_FORM = ("stribeck_friction", "constant_force", "cogging", "belt_damping")


@dataclass(frozen=True)
class DrawnEffect:
    """Effect that a random rig hides.

    Attributes:
        name: Name in the library; of an effect outside the library a description.
        site: Its site; "drives" for an effect on both drives.
        size: Fraction of the full size.
        build: Function that adds the effect to a rig and its sensors.
        parameters: The effect's parameters by the library's names, SI; empty outside the library.
        scales_with: By name of the parameter, how its identified value depends on the motors' gains, which
            voltages do not determine: "force" or "current".
        accepted: Labels that identify an effect outside the library; "" for the verdict "unexplained".
        absorbed: Whether refitting the declared parameters explains the effect, so that naming none is
            correct too.
        off_form: How the effect differs from the library's form; empty if it does not.
        tables: Labels of tables that describe such an effect completely, so that they identify it as well.
    """

    name: str
    site: str
    size: float
    build: Build
    parameters: dict[str, float]
    scales_with: dict[str, str]
    accepted: tuple[str, ...] = ()
    absorbed: bool = False
    off_form: str = ""
    tables: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """The effect as name@site."""
        return f"{self.name}@{self.site}"

    @property
    def in_library(self) -> bool:
        """Whether the library has the effect, so that its name alone identifies it."""
        return not self.accepted

    def library_sites(self) -> tuple[str, ...]:
        """Return the sites at which the library's effect has to act to give this one."""
        return MOTORS if self.site == _BOTH else (self.site,)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is uniformly distributed."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _by_site(site: str, x: float, y: float, phi: float) -> float:
    """Return the value for a coordinate."""
    return {"x": x, "y": y}.get(site, phi)


def draw_effects(rng: np.random.Generator, count: int) -> list[DrawnEffect]:
    """Draw distinct effects of the library that can act together and that a recording can tell apart.

    Args:
        rng: Source of the draw.
        count: Number of effects.

    Returns:
        The effects.
    """
    names, weights = list(SITES), np.array([WEIGHTS.get(name, 1.0) for name in SITES])
    drawn: list[DrawnEffect] = []
    used: set[str] = set()
    while len(drawn) < count:
        name = str(rng.choice(names, p=weights / weights.sum()))
        site = str(rng.choice(SITES[name]))
        size = 1.0 if name == "idler_inertia" else log_uniform(rng, SMALLEST_SIZE, 1.0)
        place = site.replace("motor", "phi")
        excluded = {name}.union(*(group for group in _EXCLUSIVE if name in group))
        if place in used or any(effect.name in excluded for effect in drawn):
            continue
        used.add(place)
        drawn.append(draw_effect(name, site, size, rng))
    return drawn


def draw_effect(name: str, site: str, size: float, rng: np.random.Generator) -> DrawnEffect:
    """Return an effect of the library with random shape parameters and signs.

    Args:
        name: Name of the effect in the library.
        site: Its site.
        size: Fraction of the full size.
        rng: Source of shape and sign.

    Returns:
        The effect.
    """
    for draw in (_friction, _force, _drive, _belt, _sensor):
        effect = draw(name, site, size, rng)
        if effect is not None:
            return effect
    raise ValueError(f"unknown effect {name!r}")


def _friction(name: str, site: str, size: float, rng: np.random.Generator) -> DrawnEffect | None:
    """Return an effect on the dry or viscous friction of a coordinate."""
    at = partial(partial, change_site, sites=COORDINATES, site=site)
    rotary = site.startswith("phi")
    make = partial(DrawnEffect, name, site)
    match name:
        case "stribeck_friction":
            if rng.random() < 0.15:  # friction that rises with speed
                size = -0.25 * size
            force = size * _by_site(site, 3.0, 0.8, 0.03)
            speed = log_uniform(rng, 1.5, 4.0) if rotary else log_uniform(rng, 0.02, 0.08)
            build = at(stribeck_force=force, stribeck_velocity=speed)
            return make(abs(size), build, {"dF": force, "vs": speed}, {"dF": "force"})
        case "asymmetric_viscous":
            a = _sign(rng) * size * 0.3
            return make(size, at(viscous_asymmetry=a), {"a": a}, {})
        case "position_friction":
            force, phase = size * _by_site(site, 1.2, 0.3, 0.03), rng.uniform(0.0, 2.0 * np.pi)
            length = 2.0 * np.pi / rng.integers(1, 7) if rotary else log_uniform(rng, 0.02, 0.15)
            build = at(friction_wave=force, friction_wavelength=length, friction_phase=phase)
            return make(size, build, {"A": force, "L": length, "p": phase}, {"A": "force"})
        case "friction_slope":
            slope = _sign(rng) * size * _by_site(site, 5.0, 1.5, 0.0)
            return make(size, at(friction_slope=slope), {"s": slope}, {"s": "force"})
        case "presliding":
            stiffness = _by_site(site, 1e4, 1e4, 10.0) / size
            damping = float(rng.choice([0.0, rng.uniform(0.2, 1.0)])) * _by_site(site, 60.0, 30.0, 0.01)
            build = at(bristle_stiffness=stiffness, bristle_damping=damping)
            return make(size, build, {"s0": stiffness, "s1": damping}, {"s0": "force", "s1": "force"})
    return None


def _force(name: str, site: str, size: float, rng: np.random.Generator) -> DrawnEffect | None:
    """Return an effect that is a force on a coordinate."""
    at = partial(partial, change_site, sites=COORDINATES, site=site)
    make = partial(DrawnEffect, name, site)
    match name:
        case "constant_force":
            force = _sign(rng) * size * _by_site(site, 0.8, 0.8, 0.02)
            return make(size, at(constant_force=force), {"size": force}, {"size": "force"})
        case "quadratic_drag":
            drag = size * _by_site(site, 40.0, 40.0, 1e-4)
            return make(size, at(quadratic_drag=drag), {"c": drag}, {"c": "force"})
        case "cable_spring":
            k, rest = size * 20.0, float(rng.uniform(-0.1, 0.1))
            return make(size, at(spring_stiffness=k, spring_rest=rest), {"k": k, "q0": rest}, {"k": "force"})
        case "cogging":
            torque, order, phase = size * 0.03, log_uniform(rng, 4.0, 40.0), rng.uniform(0.0, 2.0 * np.pi)
            build = partial(
                change_site, sites=COORDINATES, site=f"phi{site[-1]}",
                wave_force=torque, wave_number=order, wave_phase=phase,
            )  # fmt: skip
            return make(size, build, {"A": torque, "n": order, "p": phase}, {"A": "force"})
        case "unbalance":
            torque, phase = size * 0.03, rng.uniform(0.0, 2.0 * np.pi)
            build = at(wave_force=torque, wave_number=1.0, wave_phase=phase)
            return make(size, build, {"A": torque, "p": phase}, {"A": "force"})
    return None


def _drive(name: str, site: str, size: float, rng: np.random.Generator) -> DrawnEffect | None:
    """Return an effect on one drive, or on both alike."""
    make = partial(DrawnEffect, name, site)

    def at(**values: float) -> Build:
        if site == _BOTH:
            return partial(change_fields, **{field: (value, value) for field, value in values.items()})
        return partial(change_site, sites=MOTORS, site=site, **values)

    match name:
        case "voltage_offset":
            volts = _sign(rng) * size * 0.35
            return make(size, at(voltage_offset_V=volts), {"V0": volts}, {})
        case "gain_mismatch":
            g = _sign(rng) * size * 0.1
            return make(size, at(drive_gain=1.0 + g), {"g": g}, {}, absorbed=True)
        case "dead_band":
            volts = size * 0.4
            return make(size, at(dead_band_V=volts), {"Vd": volts, "drop": 1.0}, {})
        case "current_limit":
            fraction = 1.0 - 0.6 * size
            motors = MOTORS if site == _BOTH else (site,)
            return make(
                size,
                partial(_limited, motors=motors, fraction=fraction),
                {"fraction": fraction},
                {"I": "current"},
            )
        case "electrical_lag":
            tau = size * 1.5e-3
            return make(size, at(electrical_lag_s=tau), {"tau": tau}, {})
        case "input_delay":
            delay = size * 2e-3
            return make(size, at(input_delay_s=delay), {"d": delay}, {})
        case "load_friction":
            mu = size * 0.15
            return make(size, at(load_friction=mu), {"mu": mu}, {})
        case "eccentric_pulley":
            e, phase = size * 0.2e-3, rng.uniform(0.0, 2.0 * np.pi)
            return make(size, at(eccentricity_m=e, eccentricity_phase=phase), {"e": e, "p": phase}, {})
    return None


def _limited(rig: Rig, sensors: Any, *, motors: tuple[str, ...], fraction: float) -> Any:
    """Limit the current of some motors."""
    for motor in motors:
        rig, sensors = limit_current(rig, sensors, site=motor, fraction=fraction)
    return rig, sensors


def _belt(name: str, site: str, size: float, rng: np.random.Generator) -> DrawnEffect | None:
    """Return an effect on the belts or on the structure of the machine."""
    make = partial(DrawnEffect, name, site, size)
    match name:
        case "belt_play":
            d = size * 0.2e-3
            return make(partial(change_fields, belt_play_m=d), {"d": d}, {})
        case "belt_damping":
            c = size * 1e-3
            return make(partial(change_fields, belt_damping_s=c), {"c": c}, {})
        case "belt_slack":
            fraction = 0.5 - 0.35 * size
            return make(partial(loosen_belts, fraction=fraction), {"fraction": fraction}, {"T0": "force"})
        case "belt_hardening":
            h = size * 5e4
            return make(partial(change_fields, belt_hardening=h), {"h": h}, {})
        case "bridge_yaw":
            yaw = Yaw(rng.uniform(0.04, 0.12), 4000.0 / size, rng.uniform(0.5, 3.0), rng.uniform(0.2, 0.3))
            values = {"J": yaw.inertia, "k": yaw.stiffness, "c": yaw.viscous, "w": yaw.half_width_m}
            return make(partial(change_fields, yaw=yaw), values, dict.fromkeys(("J", "k", "c"), "force"))
        case "idler_inertia":
            names = ("J_left", "J_right", "B_left", "B_right")
            return make(partial(change_fields, idlers=True), {}, dict.fromkeys(names, "force"))
    return None


def _sensor(name: str, site: str, size: float, rng: np.random.Generator) -> DrawnEffect | None:
    """Return an effect on a laser."""
    make = partial(DrawnEffect, name, site, size)
    at = partial(partial, change_site, sites=CHANNELS, site=site)
    match name:
        case "sensor_skew":
            a = _sign(rng) * size * 5e-3
            skew = (a, 0.0) if site == "x_m" else (0.0, a)
            return make(partial(change_fields, skew=skew), {"a": a}, {})
        case "sensor_scale":
            g = _sign(rng) * size * 0.02
            return make(at(scale=1.0 + g), {"g": g}, {})
        case "sensor_range":
            end, field = (
                (0.16 - 0.11 * size, "range_x_m") if site == "x_m" else (0.11 - 0.06 * size, "range_y_m")
            )
            return make(partial(change_fields, **{field: (-end, end)}), {"low": -end, "high": end}, {})
        case "sensor_delay":
            d = size * 2e-3
            return make(at(delay_s=d), {"d": d}, {})
    return None


def library_parameters(effect: DrawnEffect, rig: Rig) -> dict[str, float]:
    """Return the library's parameters of an effect in a rig, including those that depend on the rig.

    Args:
        effect: Effect of the library.
        rig: The rig with all its effects.

    Returns:
        Parameters by name, SI.
    """
    match effect.name:
        case "current_limit":
            j = MOTORS.index(effect.library_sites()[0])
            return {"I": rig.current_limit_A[j]}
        case "belt_slack":
            return {"T0": effect.parameters["fraction"] * stall_tension(rig)}
        case "idler_inertia":
            # The idlers of a belt run have half of the inertia and friction of its motor.
            sides = {"left": 2, "right": 3}
            inertia = {f"J_{side}": 0.5 * rig.mass[i] for side, i in sides.items()}
            return inertia | {f"B_{side}": 0.5 * rig.viscous[i] for side, i in sides.items()}
    return effect.parameters


def draw_off_form(rng: np.random.Generator) -> DrawnEffect:
    """Draw an effect of full or half size that is 10 to 20 % off the library's form.

    Args:
        rng: Source of the draw.

    Returns:
        The effect; its parameters are those of the nearest library form.
    """
    name = str(rng.choice(OFF_FORM))
    site = "x" if name == "constant_force" else str(rng.choice(SITES[name]))
    effect = draw_effect(name, site, float(rng.uniform(0.4, 1.0)), rng)
    deviation = float(rng.uniform(0.1, 0.2)) * _sign(rng)
    more: dict[str, Any]
    match name:
        case "stribeck_friction":
            more, text = {"stribeck_exponent": 2.0 * (1.0 + deviation)}, "exponent {:+.0%}"
        case "cogging":
            site, text = f"phi{site[-1]}", "second harmonic of {:+.0%}"
            more = {"wave_second": deviation}
        case "constant_force":
            text = "{:+.0%} at 30 mm, as a sine of the position with a period of 0.12 m"
            more = {"wave_force": deviation * effect.parameters["size"], "wave_number": 2.0 * np.pi / 0.12}
        case _:
            factors = (1.0 + deviation, 1.0 - deviation, 1.0)
            more = {"belt_damping_factor": factors}
            text = "{:+.0%} in the left belt, the opposite in the right one"
    change: Build
    if name == "belt_damping":
        change = partial(change_fields, **more)
    else:
        change = partial(change_site, sites=COORDINATES, site=site, **more)
    return DrawnEffect(
        effect.name,
        effect.site,
        effect.size,
        partial(_in_turn, builds=(effect.build, change)),
        effect.parameters,
        effect.scales_with,
        off_form=text.format(deviation),
        tables=(f"smooth_force[position of {site}]@{site}",) if name == "constant_force" else (),
    )


def _in_turn(rig: Rig, sensors: Any, *, builds: tuple[Build, ...]) -> Any:
    """Apply several changes one after the other."""
    for build in builds:
        rig, sensors = build(rig, sensors)
    return rig, sensors


def draw_outside(rng: np.random.Generator) -> DrawnEffect:
    """Draw an effect that the library does not have.

    Args:
        rng: Source of the draw.

    Returns:
        The effect, with the labels that identify it.
    """
    size = log_uniform(rng, 0.3, 1.0)
    axis = str(rng.choice(_AXES))
    small = 0.3 if axis == "y" else 1.0
    at = partial(partial, change_site, sites=COORDINATES, site=axis)
    warm_up = ("friction_warm_up@machine", *(f"smooth_friction[time]@{c}" for c in COORDINATES))
    choices: dict[str, tuple[str, Callable[[], Build], tuple[str, ...]]] = {
        "magnetic catch": (
            axis,
            lambda: at(
                catch_force=8.0 * size * small,
                catch_position=float(rng.uniform(-0.06, 0.06)),
                catch_width=float(rng.uniform(0.008, 0.015)),
            ),
            (f"smooth_force[position of {axis}]@{axis}",),
        ),
        "warm-up": (
            "machine",
            lambda: partial(
                change_fields, friction_cold=(1.5 * size,) * 4, warm_up_s=float(rng.uniform(10.0, 40.0))
            ),
            warm_up,
        ),
        "frame resonance": (
            "x_m",
            lambda: partial(change_fields, frame=Frame(float(rng.uniform(8.0, 25.0)), 0.05, 0.05 * size)),
            ("*frame*", "*mode*", "*resonance*"),
        ),
        "cable with memory": (
            axis,
            lambda: at(
                hysteresis_force=4.0 * size * small, hysteresis_travel=float(rng.uniform(0.003, 0.01))
            ),
            (f"presliding@{axis}", f"*hysteresis*@{axis}", f"*memory*@{axis}"),
        ),
    }
    name = str(rng.choice(list(choices)))
    site, build, accepted = choices[name]
    return DrawnEffect(name, site, size, build(), {}, {}, accepted=(*accepted, ""))
