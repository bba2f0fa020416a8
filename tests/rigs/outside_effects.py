"""Draw effects that real machines have: where each acts, on what it depends, similar library effects.

The library lacks them, apart from those of `IN_LIBRARY`.

| family | what acts | drawn size |
|---|---|---|
| torque saturation | torque constant falls with current, Kt / (1 + (i/I)^2) | 10 to 40 % of it at 8 A |
| supply sag | inner resistance of the supply that both bridges share | 6 to 20 % of 12 V at 6 A |
| winding heat | resistance rises with the heat of i^2 | 5 to 20 % at 2 A, within 1 to 4 s |
| gear backlash | gap between the rotor, with the encoder, and the pulley | 1.5 to 6 mrad of half gap |
| dwell friction | dry friction a ln(1 + age/tau) of the contact | 10 to 40 % of the level per e-fold of age |
| belt mesh | teeth of the belt, force grows with the tension | 0.6 to 2.5 N, pitch 2, 3 or 5 mm |
| payload swing | pendulum below the cart, which moves along y | 10 to 30 % of the cart's mass, 4 to 20 cm |
| belt relaxation | spring and damper in series beside every belt | 15 to 50 % of the stiffness, 5 to 50 ms |
| scale interpolation | periodic error of a laser over the position | 3 to 15 times the noise, 2 to 20 mm |
| bent scale | quadratic error of a laser | 0.3 to 2 mm at 150 mm |
| eccentric encoder | error once per turn of pulley or motor | 4 to 20 mrad |
| clock drift | the sampling clock changes its rate during a run | 1 to 4 % from the first row to the last |
| bent rail | dry friction of the bridge depends on y | 30 to 80 % of the level at 100 mm |
| commutation ripple | torque constant depends on the rotor's angle | 4 to 15 % |
| dead time | voltage that a bridge loses against the current | 0.1 to 0.4 V |
| belt creep | belt slips on a motor's pulley with the force it transmits | 1 to 6 mm per second at 15 N |
| eddy brake | drag c v / (1 + (v/v0)^2) | 0.6 to 2.5 N at most |
| gas spring | spring that stiffens towards one end | 1.5 to 6 N at 150 mm |

A drive has 15 to 80 N at the belt at 1.5 to 8 V and standstill, and moves with 10 to 30 N.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from tests.reference_simulator import COORDINATES, Payload, Rig
from tests.reference_simulator.sensors import LASER_NOISE_M
from tests.rigs.hidden_effects import CHANNELS, MOTORS, Build, change_fields, change_site
from tests.rigs.random_effects import log_uniform

_CART_KG = Rig().mass[1]
_GRAVITY = 9.81
_TWO_MOTORS = "drives"


@dataclass(frozen=True)
class OutsideEffect:
    """Effect outside the library, as a rig hides it.

    Attributes:
        family: Name of the family.
        site: Where it acts: a coordinate, motor, sensor, "drives", "belts" or "clock".
        note: Its size in words.
        build: Function that adds it to a rig and its sensors.
        components: Components at which a hint is right: `site` and what moves or measures only with it.
        variables: Patterns (fnmatch) of the variables on which it depends.
        neighbors: Patterns (fnmatch) of effect labels, name@site, that are near it in kind: same component,
            and same variable or same mechanism. To name one is acceptable while it leaves little.
        drift: Change of the clock's rate from the first row to the last of a run.
    """

    family: str
    site: str
    note: str
    build: Build
    components: tuple[str, ...]
    variables: tuple[str, ...]
    neighbors: tuple[str, ...]
    drift: float = 0.0

    @property
    def label(self) -> str:
        """The effect as family@site."""
        return f"{self.family}@{self.site}"


def _of_drive(site: str) -> tuple[str, ...]:
    """Return the components of a drive: the motor and the coordinate on which alone it acts."""
    return (*MOTORS, "phi1", "phi2", "drives") if site == _TWO_MOTORS else (site, f"phi{site[-1]}", "drives")


def _labels(names: str, *sites: str) -> tuple[str, ...]:
    """Return patterns of labels for names, separated by blanks, at any of some sites."""
    return tuple(f"{name}@{site}" for name in names.split() for site in sites)


def _unchanged(rig: Rig, sensors: object) -> tuple[Rig, object]:
    return rig, sensors


def _torque_saturation(rng: np.random.Generator) -> OutsideEffect:
    site, loss = str(rng.choice([*MOTORS, _TWO_MOTORS])), log_uniform(rng, 0.1, 0.4)
    amps = 8.0 / np.sqrt(loss / (1.0 - loss))
    values = tuple(amps if site in (motor, _TWO_MOTORS) else np.inf for motor in MOTORS)
    return OutsideEffect(
        "torque saturation",
        site,
        f"{loss:.0%} less torque at 8 A",
        partial(change_fields, torque_saturation_A=values),
        _of_drive(site),
        ("current of *", "v?_V"),
        _labels("current_limit voltage_limit", *_sites(site)),
    )


def _sites(site: str) -> tuple[str, ...]:
    """Return the sites at which the library may place an effect of a drive."""
    return (*MOTORS, _TWO_MOTORS) if site == _TWO_MOTORS else (site, _TWO_MOTORS)


def _supply_sag(rng: np.random.Generator) -> OutsideEffect:
    sag = log_uniform(rng, 0.06, 0.2)
    build = partial(change_fields, supply_ohm=sag * 12.0 / 6.0, supply_s=float(rng.uniform(0.002, 0.02)))
    return OutsideEffect(
        "supply sag",
        _TWO_MOTORS,
        f"{sag:.0%} of 12 V at 6 A",
        build,
        _of_drive(_TWO_MOTORS),
        ("power of *", "current of *", "v?_V", "energy"),
        _labels("voltage_limit current_limit", *_sites(_TWO_MOTORS)),
    )


def _winding_heat(rng: np.random.Generator) -> OutsideEffect:
    site, rise, seconds = str(rng.choice(MOTORS)), log_uniform(rng, 0.05, 0.2), float(rng.uniform(1.0, 4.0))
    build = partial(change_site, sites=MOTORS, site=site, heating_ohm=rise / 4.0, heating_s=seconds)
    return OutsideEffect(
        "winding heat",
        site,
        f"{rise:.0%} more resistance at 2 A after {seconds:.1f} s",
        build,
        _of_drive(site),
        ("heat of *", "time*", "energy"),
        _labels("gain_mismatch", *MOTORS),
    )


def _gear_backlash(rng: np.random.Generator) -> OutsideEffect:
    site, gap = str(rng.choice(MOTORS)), log_uniform(rng, 0.0015, 0.006)
    values = tuple(gap if site == motor else 0.0 for motor in MOTORS)
    phi = f"phi{site[-1]}"
    return OutsideEffect(
        "gear backlash",
        site,
        f"half gap {1e3 * gap:.1f} mrad",
        partial(change_fields, backlash_rad=values),
        (*_of_drive(site), f"{phi}_rad"),
        ("load of *", "current of *", "velocity of phi*", "acceleration of phi*", "v?_V"),
        (*_labels("belt_play", "belts"), *_labels("presliding *hysteresis", phi)),
    )


def _dwell_friction(rng: np.random.Generator) -> OutsideEffect:
    site, rise = str(rng.choice(["x", "phi1", "phi2"])), log_uniform(rng, 0.1, 0.4)
    path = log_uniform(rng, 1e-4, 1e-3) * (1.0 if site == "x" else 50.0)
    build = partial(change_site, sites=COORDINATES, site=site, friction_age=rise, friction_age_path=path)
    return OutsideEffect(
        "dwell friction",
        site,
        f"{rise:.0%} per e-fold of age",
        build,
        _of_drive(f"motor{site[-1]}") if site != "x" else (site,),
        ("dwell of *", f"velocity of {site}"),
        _labels("stribeck_friction tustin_friction presliding", site),
    )


def _belt_mesh(rng: np.random.Generator) -> OutsideEffect:
    site = str(rng.choice(MOTORS))
    force = log_uniform(rng, 0.6, 2.5)
    pitch = float(rng.choice([2e-3, 3e-3, 5e-3]))
    build = partial(change_site, sites=MOTORS, site=site, mesh_force_N=force, mesh_pitch_m=pitch)
    phi = f"phi{site[-1]}"
    return OutsideEffect(
        "belt mesh",
        site,
        f"{force:.2g} N, pitch {1e3 * pitch:.0f} mm",
        build,
        _of_drive(site),
        (f"position of {phi}", f"angle of {phi}"),
        _labels("cogging second_cogging position_friction unbalance", site, phi),
    )


def _payload_swing(rng: np.random.Generator) -> OutsideEffect:
    fraction, length = log_uniform(rng, 0.1, 0.3), log_uniform(rng, 0.04, 0.2)
    mass = fraction * _CART_KG
    natural = np.sqrt(_GRAVITY / length)
    payload = Payload(mass, mass * natural**2, 2.0 * float(rng.uniform(0.01, 0.05)) * mass * natural)
    return OutsideEffect(
        "payload swing",
        "y",
        f"{1e3 * mass:.0f} g at {1e3 * length:.0f} mm",
        partial(change_fields, payload=payload),
        ("y",),
        ("acceleration of y", "position of y", "velocity of y", "time*"),
        _labels("frame_resonance", "y"),
    )


def _belt_relaxation(rng: np.random.Generator) -> OutsideEffect:
    part, seconds = log_uniform(rng, 0.15, 0.5), log_uniform(rng, 0.005, 0.05)
    build = partial(change_fields, belt_relaxation=part, belt_relaxation_s=seconds)
    return OutsideEffect(
        "belt relaxation",
        "belts",
        f"{part:.0%} of the stiffness within {1e3 * seconds:.0f} ms",
        build,
        ("belts", "left", "right", "bottom"),
        ("tension*", "load of *", "current of *"),
        _labels("belt_damping", "belts"),
    )


def _scale_interpolation(rng: np.random.Generator) -> OutsideEffect:
    site = str(rng.choice(CHANNELS[2:]))
    size = log_uniform(rng, 3.0, 15.0)
    period = log_uniform(rng, 2e-3, 20e-3)
    build = partial(
        change_site,
        sites=CHANNELS,
        site=site,
        wave=size * LASER_NOISE_M,
        wave_period=period,
        wave_phase=float(rng.uniform(0.0, 2.0 * np.pi)),
    )
    return OutsideEffect(
        "scale interpolation",
        site,
        f"{1e6 * size * LASER_NOISE_M:.0f} um, period {1e3 * period:.1f} mm",
        build,
        (site, site[0]),
        (f"position of {site[0]}",),
        _labels("sensor_scale", site),
    )


def _bent_scale(rng: np.random.Generator) -> OutsideEffect:
    site, error = str(rng.choice(CHANNELS[2:])), log_uniform(rng, 0.3e-3, 2e-3)
    build = partial(
        change_site, sites=CHANNELS, site=site, bend=float(rng.choice([-1.0, 1.0])) * error / 0.15**2
    )
    return OutsideEffect(
        "bent scale",
        site,
        f"{1e3 * error:.1f} mm at 150 mm",
        build,
        (site, site[0]),
        (f"position of {site[0]}",),
        _labels("sensor_scale", site),
    )


def _eccentric_encoder(rng: np.random.Generator) -> OutsideEffect:
    motor, error = str(rng.choice(MOTORS)), log_uniform(rng, 4e-3, 20e-3)
    period = 2.0 * np.pi / float(rng.choice([1.0, 5.9]))
    phi = f"phi{motor[-1]}"
    build = partial(
        change_site,
        sites=CHANNELS,
        site=f"{phi}_rad",
        wave=error,
        wave_period=period,
        wave_phase=float(rng.uniform(0.0, 2.0 * np.pi)),
    )
    return OutsideEffect(
        "eccentric encoder",
        f"{phi}_rad",
        f"{1e3 * error:.0f} mrad every {period:.2f} rad",
        build,
        (f"{phi}_rad", phi),
        (f"position of {phi}", f"angle of {phi}"),
        _labels("eccentric_pulley", motor),
    )


def _clock_drift(rng: np.random.Generator) -> OutsideEffect:
    drift = log_uniform(rng, 0.01, 0.04) * float(rng.choice([-1.0, 1.0]))
    return OutsideEffect(
        "clock drift",
        "clock",
        f"{drift:+.1%} within a run",
        _unchanged,
        ("clock", "time"),
        ("time*", "clock"),
        (),
        drift,
    )


def _bent_rail(rng: np.random.Generator) -> OutsideEffect:
    part = float(rng.choice([-1.0, 1.0])) * log_uniform(rng, 0.3, 0.8)
    slope = part * Rig().coulomb[0] / 0.1
    return OutsideEffect(
        "bent rail",
        "x",
        f"{part:+.0%} friction at y = 100 mm",
        partial(change_site, sites=COORDINATES, site="x", friction_cross_position=slope),
        ("x",),
        ("position of y",),
        ("smooth_friction[[]position of y]@x",),
    )


def _commutation_ripple(rng: np.random.Generator) -> OutsideEffect:
    site, part = str(rng.choice(MOTORS)), log_uniform(rng, 0.04, 0.15)
    order = 5.9 * float(rng.choice([2.0, 4.0, 6.0]))
    build = partial(change_site, sites=MOTORS, site=site, current_ripple=part, current_ripple_order=order)
    phi = f"phi{site[-1]}"
    return OutsideEffect(
        "commutation ripple",
        site,
        f"{part:.0%}, {order:.1f} periods per turn",
        build,
        _of_drive(site),
        (f"position of {phi}", f"angle of {phi}"),
        _labels("cogging second_cogging", site),
    )


def _dead_time(rng: np.random.Generator) -> OutsideEffect:
    site, volts = str(rng.choice(MOTORS)), log_uniform(rng, 0.1, 0.4)
    return OutsideEffect(
        "dead time",
        site,
        f"{volts:.2f} V",
        partial(change_site, sites=MOTORS, site=site, dead_time_V=volts),
        _of_drive(site),
        ("current of *", "v?_V"),
        _labels("dead_band", *_sites(site)),
    )


def _belt_creep(rng: np.random.Generator) -> OutsideEffect:
    site, speed = str(rng.choice(MOTORS)), log_uniform(rng, 1e-3, 6e-3)
    values = tuple(speed / 15.0 if site == motor else 0.0 for motor in MOTORS)
    phi = f"phi{site[-1]}"
    return OutsideEffect(
        "belt creep",
        site,
        f"{1e3 * speed:.1f} mm/s at 15 N",
        partial(change_fields, belt_creep=values),
        (*_of_drive(site), f"{phi}_rad", "belts"),
        ("impulse of *", "tension*", "load of *", "current of *"),
        _labels("belt_damping", "belts"),
    )


def _eddy_brake(rng: np.random.Generator) -> OutsideEffect:
    site, force, speed = "x", log_uniform(rng, 0.6, 2.5), float(rng.uniform(0.08, 0.25))
    build = partial(
        change_site, sites=COORDINATES, site=site, brake_drag=2.0 * force / speed, brake_speed=speed
    )
    return OutsideEffect(
        "eddy brake",
        site,
        f"{force:.2g} N at {1e3 * speed:.0f} mm/s",
        build,
        (site,),
        (f"velocity of {site}",),
        _labels("quadratic_drag stribeck_friction tustin_friction", site),
    )


def _gas_spring(rng: np.random.Generator) -> OutsideEffect:
    site = str(rng.choice(["x", "y"]))
    force = log_uniform(rng, 1.5, 6.0) * (1.0 if site == "x" else 0.4)
    stiffness, length = force / 0.15, float(rng.uniform(0.25, 0.5))
    build = partial(
        change_site,
        sites=COORDINATES,
        site=site,
        spring_stiffness=stiffness,
        spring_square=stiffness / length,
        spring_rest=float(rng.uniform(-0.1, 0.1)),
    )
    return OutsideEffect(
        "gas spring",
        site,
        f"{force:.2g} N at 150 mm",
        build,
        (site,),
        (f"position of {site}",),
        (*_labels("cable_spring", site), f"smooth_force[[]position of {site}]@{site}"),
    )


FAMILIES: dict[str, Callable[[np.random.Generator], OutsideEffect]] = {
    "torque saturation": _torque_saturation,
    "supply sag": _supply_sag,
    "winding heat": _winding_heat,
    "gear backlash": _gear_backlash,
    "dwell friction": _dwell_friction,
    "belt mesh": _belt_mesh,
    "payload swing": _payload_swing,
    "belt relaxation": _belt_relaxation,
    "scale interpolation": _scale_interpolation,
    "bent scale": _bent_scale,
    "eccentric encoder": _eccentric_encoder,
    "clock drift": _clock_drift,
    "bent rail": _bent_rail,
    "commutation ripple": _commutation_ripple,
    "dead time": _dead_time,
    "belt creep": _belt_creep,
    "eddy brake": _eddy_brake,
    "gas spring": _gas_spring,
}
# The library has these by now.
IN_LIBRARY = frozenset(
    {
        "torque saturation",
        "supply sag",
        "winding heat",
        "gear backlash",
        "dwell friction",
        "belt mesh",
        "clock drift",
        "payload swing",
        "scale interpolation",
        "eccentric encoder",
        "commutation ripple",
        "dead time",
        "eddy brake",
    }
)
