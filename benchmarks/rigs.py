"""The rigs of the identification benchmark: what each hides, and what an identification may call it.

    python -m benchmarks.rigs                              # list them
    python -m benchmarks.rigs NAME... --out DIR [--jobs N] # record them: DIR/NAME/runs/*.csv.gz, machine.json, ...

NAME is a rig's name or that of a set. Every rig's parameters are 5 to 20 % away from those declared, each by a draw of
its own; the seed is the name.
"""

from __future__ import annotations

import argparse
import dataclasses
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

from benchmarks.reference import COORDINATES, Frame, Payload, Rig, Yaw
from benchmarks.reference.sensors import Sensors

SIZES = {"full": 1.0, "20%": 0.2, "5%": 0.05}
MOTORS = ("motor1", "motor2")
CHANNELS = ("phi1_rad", "phi2_rad", "x_m", "y_m")
Build = Callable[[Rig, Sensors], tuple[Rig, Sensors]]


@dataclass(frozen=True)
class Planted:
    """An effect of a rig.

    accepted: labels (name@site) that mean this effect. also: labels that do no harm beside it. truth: its parameters by
    the library's names; voltages tell only ratios to the motors' gain and resistance, so those in ``forces`` scale with
    the one and those in ``amps`` with the other.
    silent: the declared parameters can take it up, so finding nothing is right too.
    """

    label: str
    build: Build
    accepted: tuple[str, ...]
    truth: dict[str, float]
    forces: tuple[str, ...] = ()
    amps: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    silent: bool = False


@dataclass(frozen=True)
class Case:
    """A rig to identify: 12 or 4 runs of 2 s. ``start_share``: of the travel, in which runs start."""

    name: str
    group: str
    kind: Literal["library", "none", "outside"]
    size: str
    planted: tuple[Planted, ...]
    runs: int = 12
    start_share: float = 0.6

    @property
    def seed(self) -> int:
        return zlib.crc32(self.name.encode())

    def rig(self) -> tuple[Rig, Sensors]:
        """The stage and its sensors."""
        rig, sensors = drawn(np.random.default_rng([self.seed, 1])), Sensors()
        for planted in self.planted:
            rig, sensors = planted.build(rig, sensors)
        return rig, sensors

    def truth(self, planted: Planted) -> dict[str, float]:
        """The planted effect's parameters as a fit in which motor 1 is as declared must find them."""
        rig, declared = self.rig()[0], Rig()
        ohm = declared.resistance_ohm[0] / rig.resistance_ohm[0]
        gain = declared.torque_constant[0] / rig.torque_constant[0] / ohm
        return {
            name: value * (gain if name in planted.forces else 1.0) / (ohm if name in planted.amps else 1.0)
            for name, value in planted.truth.items()
        }


def drawn(rng: np.random.Generator) -> Rig:
    """The declared stage with every parameter 5 to 20 % off, one way or the other. One belt: one EA."""
    declared = Rig()

    def off(values: tuple[float, ...]) -> Any:
        return tuple(float(v * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.2))) for v in values)

    constant, (ohm,) = off(declared.torque_constant), off(declared.resistance_ohm[:1])
    return dataclasses.replace(
        declared,
        mass=off(declared.mass),
        viscous=off(declared.viscous),
        coulomb=off(declared.coulomb),
        belt_EA_N=off(declared.belt_EA_N[:1]) * 3,
        torque_constant=constant,
        emf_constant=constant,
        resistance_ohm=(ohm, ohm),
    )


def _at(places: tuple[str, ...], site: str, value: float, others: tuple[float, ...]) -> Any:
    """``others`` with the entry of one place replaced."""
    return tuple(value if place == site else other for place, other in zip(places, others, strict=True))


def _set(rig: Rig, sensors: Sensors, *, places: tuple[str, ...], site: str, **values: float) -> tuple[Rig, Sensors]:
    """A rig (and its sensors) with fields changed at one place."""
    changed = {}
    owner: Any = sensors if places == CHANNELS else rig
    for name, value in values.items():
        changed[name] = _at(places, site, value, getattr(owner, name))
    if places == CHANNELS:
        return rig, dataclasses.replace(sensors, **changed)
    return dataclasses.replace(rig, **changed), sensors


def _whole(rig: Rig, sensors: Sensors, **values: Any) -> tuple[Rig, Sensors]:
    """A rig with whole fields changed, or its sensors for fields that are theirs."""
    of_sensors = {f.name for f in dataclasses.fields(Sensors)}
    seen = {name: value for name, value in values.items() if name in of_sensors}
    made = {name: value for name, value in values.items() if name not in of_sensors}
    return dataclasses.replace(rig, **made), dataclasses.replace(sensors, **seen)


def _plant(
    name: str,
    site: str,
    build: Build,
    truth: dict[str, float],
    *,
    forces: tuple[str, ...] = (),
    amps: tuple[str, ...] = (),
    same: tuple[str, ...] = (),
    also: tuple[str, ...] = (),
    silent: bool = False,
) -> Planted:
    label = f"{name}@{site}"
    return Planted(label, build, (label, *same), truth, forces, amps, also, silent)


def _sized(site: str, linear: float, rotary: float) -> float:
    return rotary if site.startswith("phi") else linear


def effect(name: str, site: str, size: float) -> Planted:
    """A library effect at a share of its full size. Full is what a used machine may well have."""
    coordinate = partial(_set, places=COORDINATES, site=site)
    motor = partial(_set, places=MOTORS, site=site)
    match name:
        case "stribeck_friction":
            force = size * {"x": 3.0, "y": 0.8, "phi1": 0.03, "phi2": 0.03}[site]
            speed = _sized(site, 0.04, 2.5)
            build = partial(coordinate, stribeck_force=force, stribeck_velocity=speed)
            return _plant(name, site, build, {"dF": force, "vs": speed}, forces=("dF",))
        case "constant_force":
            force = size * _sized(site, 0.8, 0.02)
            same = tuple(f"voltage_offset@{m}" for m, c in zip(MOTORS, COORDINATES[2:], strict=True) if c == site)
            return _plant(
                name, site, partial(coordinate, constant_force=force), {"size": force}, forces=("size",), same=same
            )
        case "voltage_offset":
            volts = size * 0.15
            same = (f"constant_force@phi{site[-1]}",)
            return _plant(name, site, partial(motor, voltage_offset_V=volts), {"V0": volts}, same=same)
        case "gain_mismatch":
            gain = 1.0 - 0.1 * size
            return _plant(name, site, partial(motor, drive_gain=gain), {"g": gain - 1.0}, silent=True)
        case "dead_band":
            volts = size * 0.4
            return _plant(name, site, partial(motor, dead_band_V=volts), {"Vd": volts})
        case "current_limit":
            amps = 9.0 - 5.0 * size  # a command of 8 V wants 11 A at rest
            return _plant(name, site, partial(motor, current_limit_A=amps), {"I": amps}, amps=("I",))
        case "electrical_lag":
            tau = size * 1.5e-3
            return _plant(name, site, partial(motor, electrical_lag_s=tau), {"tau": tau})
        case "input_delay":
            late = size * 2e-3
            return _plant(name, site, partial(_whole, input_delay_s=(late, late)), {"d": late})
        case "asymmetric_viscous":
            share = size * 0.3
            return _plant(name, site, partial(coordinate, viscous_asymmetry=share), {"a": share})
        case "quadratic_drag":
            drag = size * _sized(site, 40.0, 1e-4)
            return _plant(name, site, partial(coordinate, quadratic_drag=drag), {"c": drag}, forces=("c",))
        case "cable_spring":
            k, rest = size * 60.0, 0.05
            build = partial(coordinate, spring_stiffness=k, spring_rest=rest)
            return _plant(name, site, build, {"k": k, "q0": rest}, forces=("k",))
        case "position_friction":
            force, length = size * _sized(site, {"x": 1.2, "y": 0.3}.get(site, 0.0), 0.03), _sized(site, 0.1, 2 * np.pi)
            build = partial(coordinate, friction_wave=force, friction_wavelength=length, friction_phase=1.0)
            return _plant(name, site, build, {"A": force, "L": length}, forces=("A",))
        case "friction_slope":
            slope = size * {"x": 5.0, "y": 1.5}[site]
            build = partial(coordinate, friction_slope=slope)
            return _plant(name, site, build, {"s": slope}, forces=("s",))
        case "cogging":
            torque, order = size * 0.03, 4 * 5.9  # four periods a turn of the motor
            pulley = partial(_set, places=COORDINATES, site=f"phi{site[-1]}")
            build = partial(pulley, wave_force=torque, wave_number=order, wave_phase=0.5)
            return _plant(name, site, build, {"A": torque, "n": order}, forces=("A",))
        case "eccentric_pulley":
            e = size * 0.2e-3
            return _plant(name, site, partial(motor, eccentricity_m=e, eccentricity_phase=0.7), {"e": e})
        case "belt_play":
            half = size * 0.15e-3
            return _plant(name, site, partial(_whole, belt_play_m=half), {"d": half})
        case "belt_damping":
            late = size * 1e-3
            return _plant(name, site, partial(_whole, belt_damping_s=late), {"c": late})
        case "belt_slack":
            tension = 32.0 - 20.0 * size
            build = partial(_whole, belt_pretension_N=tension)
            return _plant(name, site, build, {"T0": tension}, forces=("T0",))
        case "belt_hardening":
            hard = size * 5e4
            return _plant(name, site, partial(_whole, belt_hardening=hard), {"h": hard})
        case "bridge_yaw":
            yaw = Yaw(stiffness=15e3 / size)
            return _plant(
                name, site, partial(_whole, yaw=yaw), {"k": yaw.stiffness, "w": yaw.half_width_m}, forces=("k",)
            )
        case "idler_inertia":
            return _plant(name, site, partial(_whole, idlers=True), {})
        case "sensor_skew":
            a = size * 5e-3
            return _plant(name, site, partial(_whole, skew=(0.0, a)), {"a": a})
        case "sensor_scale":
            gain = 1.0 + 0.02 * size
            build = partial(_set, places=CHANNELS, site=site, scale=gain)
            return _plant(name, site, build, {"g": gain - 1.0})
        case "sensor_range":
            end = 0.16 - 0.11 * size  # full: the paper's 100 mm
            return _plant(name, site, partial(_whole, range_x_m=(-end, end)), {"low": -end, "high": end})
        case "sensor_delay":
            late = size * 2e-3
            build = partial(_set, places=CHANNELS, site=site, delay_s=late)
            return _plant(name, site, build, {"d": late})
        case "presliding":
            stiffness = _sized(site, 1e4, 10.0) / size
            build = partial(coordinate, bristle_stiffness=stiffness)
            return _plant(name, site, build, {"s0": stiffness}, forces=("s0",))
        case "lugre":
            stiffness, damping = 2e4 / size, 100.0
            build = partial(
                coordinate, bristle_stiffness=stiffness, bristle_damping=damping, stribeck_force=1.5,
                stribeck_velocity=0.03,
            )  # fmt: skip
            also, same = (f"stribeck_friction@{site}",), (f"presliding@{site}",)
            return _plant(name, site, build, {"s0": stiffness}, forces=("s0",), same=same, also=also)
    raise ValueError(f"no effect is called {name!r}")


# Each effect of the library at the site where a rig has it most likely, and at others that the full size tries as well.
SITES: dict[str, tuple[str, ...]] = {
    "stribeck_friction": ("x", "y", "phi1"),
    "constant_force": ("y", "phi2"),
    "voltage_offset": ("motor1",),
    "gain_mismatch": ("motor2",),
    "dead_band": ("motor1",),
    "current_limit": ("motor1",),
    "electrical_lag": ("motor2",),
    "input_delay": ("drives",),
    "asymmetric_viscous": ("x", "phi1"),
    "quadratic_drag": ("x", "y"),
    "cable_spring": ("x", "y"),
    "position_friction": ("x", "phi2"),
    "friction_slope": ("x",),
    "cogging": ("motor1", "motor2"),
    "eccentric_pulley": ("motor2",),
    "belt_play": ("belts",),
    "belt_damping": ("belts",),
    "belt_slack": ("belts",),
    "belt_hardening": ("belts",),
    "bridge_yaw": ("machine",),
    "sensor_skew": ("y_m",),
    "sensor_scale": ("x_m",),
    "sensor_range": ("x_m",),
    "sensor_delay": ("x_m",),
    "presliding": ("x", "phi1"),
    "lugre": ("x",),
}
PAIRS = (
    ("stribeck_friction@x", "input_delay@drives"),
    ("stribeck_friction@x", "constant_force@y"),
    ("cogging@motor1", "stribeck_friction@y"),
    ("bridge_yaw@machine", "cogging@motor2"),
    ("cable_spring@x", "sensor_skew@y_m"),
    ("belt_damping@belts", "asymmetric_viscous@x"),
    ("eccentric_pulley@motor2", "quadratic_drag@y"),
    ("presliding@phi1", "input_delay@drives"),
    ("belt_play@belts", "position_friction@x"),
    ("dead_band@motor1", "voltage_offset@motor2"),
)
TRIPLES = (
    ("stribeck_friction@x", "input_delay@drives", "cable_spring@y"),
    ("bridge_yaw@machine", "stribeck_friction@y", "sensor_skew@y_m"),
    ("cogging@motor1", "cogging@motor2", "stribeck_friction@x"),
    ("belt_damping@belts", "eccentric_pulley@motor2", "constant_force@y"),
    ("input_delay@drives", "electrical_lag@motor2", "asymmetric_viscous@x"),
    ("position_friction@x", "sensor_delay@x_m", "dead_band@motor1"),
)
FOUR_RUNS = (
    *((e, "full") for e in ("stribeck_friction@x", "constant_force@y", "input_delay@drives", "cogging@motor1")),
    *((e, "full") for e in ("bridge_yaw@machine", "eccentric_pulley@motor2", "belt_damping@belts", "cable_spring@x")),
    *((e, "20%") for e in ("stribeck_friction@x", "asymmetric_viscous@x", "sensor_skew@y_m", "position_friction@x")),
)


def _outside() -> dict[str, tuple[tuple[str, ...], Build]]:
    """Rigs that lack what no library entry says: by name, what may be said beside `unexplained`, and the build.

    A table says which variable a force or a friction level follows; what has memory or a resonance of its own is none.
    """
    x, y = (partial(_set, places=COORDINATES, site=site) for site in "xy")
    motor = partial(_set, places=MOTORS)
    everywhere = [f"smooth_friction[{v}]@{c}" for c in COORDINATES for v in ("time", f"path of {c}")]
    return {
        "magnetic catch": (
            ("smooth_force[position of x]@x",),
            partial(x, catch_force=8.0, catch_place=0.06, catch_width=0.012),
        ),
        "rail magnets": (
            ("smooth_force[position of x]@x",),
            partial(x, wave_force=2.5, wave_number=2 * np.pi / 0.032, wave_phase=0.4),
        ),
        "warm-up": (("smooth_friction[time]@x",), partial(x, friction_cold=1.5)),
        "wear by run": (tuple(everywhere), partial(_whole, friction_per_run=0.06)),
        "bent rail": (("smooth_friction[position of y]@x",), partial(x, friction_cross_place=6.0)),
        "y rubs when x moves": (("smooth_friction[velocity of x]@y",), partial(y, friction_cross_speed=4.0)),
        "loose payload": ((), partial(_whole, payload=Payload())),
        "soft frame": ((), partial(_whole, frame=Frame())),
        "gear backlash": ((), partial(_whole, backlash_rad=(0.012, 0.0))),
        "cable chain": (("presliding@x",), partial(x, hysteresis_force=4.0, hysteresis_travel=0.008)),
        "hot motor": ((), partial(motor, site="motor1", heating_loss=0.02)),
        "commutation ripple": ((), partial(motor, site="motor2", current_ripple=0.12, current_ripple_order=35.4)),
    }


def _split(label: str, size: float) -> Planted:
    name, site = label.split("@")
    return effect(name, site, size)


def cases() -> dict[str, Case]:
    """All rigs by name."""
    made: list[Case] = []
    for name, sites in SITES.items():
        share = 0.15 if name == "sensor_range" else 0.6  # it starts where the laser sees it
        for site in sites:
            case = partial(Case, kind="library", start_share=share)
            label = f"{name}@{site}"
            made.append(case(f"{label} full", "library-full", size="full", planted=(effect(name, site, 1.0),)))
            for size in ("20%", "5%") if site == sites[0] else ():
                planted = (effect(name, site, SIZES[size]),)
                made.append(case(f"{label} {size}", "library-small", size=size, planted=planted))
    for group, combinations in (("pairs", PAIRS), ("triples", TRIPLES)):
        for labels in combinations:
            planted = tuple(_split(label, 1.0) for label in labels)
            made.append(Case(" + ".join(labels), group, "library", "full", planted))
    for label, size in FOUR_RUNS:
        made.append(Case(f"{label} {size}, 4 runs", "four-runs", "library", size, (_split(label, SIZES[size]),), 4))
    for i in range(3):
        made.append(Case(f"idlers {i + 1}", "order20", "library", "full", (effect("idler_inertia", "machine", 1.0),)))
    made += [Case(f"none {i + 1}", "none", "none", "", (), 12 if i < 14 else 4) for i in range(24)]
    for name, (accepted, build) in _outside().items():
        made.append(Case(name, "outside", "outside", "full", (Planted(name, build, accepted, {}),)))
    return {case.name: case for case in made}


def chosen(names: list[str]) -> list[Case]:
    """The rigs of these names or sets. Raises ValueError for one that is neither."""
    known = cases()
    groups = {case.group for case in known.values()}
    found: dict[str, Case] = {}
    for name in names:
        some = (
            [c for c in known.values() if name in (c.name, c.group, "all")] if name != "all" else list(known.values())
        )
        if not some:
            raise ValueError(f"{name!r} is neither a rig nor a set; sets are all, {', '.join(sorted(groups))}")
        found |= {c.name: c for c in some}
    return list(found.values())


def main() -> None:
    from benchmarks.sessions import DEFAULT_FOLDER, recorded  # it needs this table

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--out", default=DEFAULT_FOLDER)
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    if not arguments.names:
        for case in cases().values():
            print(f"{case.group:14} {case.name}")
        return
    for session in recorded(chosen(arguments.names), arguments.out, arguments.jobs):
        print(session.folder, flush=True)


if __name__ == "__main__":
    main()
