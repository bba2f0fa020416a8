"""Effects planted in the benchmark's rigs: what each changes, how big it is, and what an identification may call it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tests.reference_simulator import COORDINATES, Rig, Yaw
from tests.reference_simulator.sensors import Sensors
from tests.rigs.excitation import MAX_VOLTAGE_V

MOTORS = ("motor1", "motor2")
CHANNELS = ("phi1_rad", "phi2_rad", "x_m", "y_m")
Build = Callable[[Rig, Sensors], tuple[Rig, Sensors]]


@dataclass(frozen=True)
class Planted:
    """An effect of a rig.

    accepted: labels (name@site) that mean this effect. also: labels that do no harm beside it. truth: its parameters by
    the library's names; voltages tell only ratios to the motors' gain, so those in ``forces`` scale with it.
    silent: the declared parameters can take it up, so finding nothing is right too.
    """

    label: str
    build: Build
    accepted: tuple[str, ...]
    truth: dict[str, float]
    forces: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    silent: bool = False


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


def at_place(rig: Rig, sensors: Sensors, *, places: tuple[str, ...], site: str, **values: float) -> tuple[Rig, Sensors]:
    """A rig (and its sensors) with fields changed at one place."""
    changed = {}
    owner: Any = sensors if places == CHANNELS else rig
    for name, value in values.items():
        changed[name] = _at(places, site, value, getattr(owner, name))
    if places == CHANNELS:
        return rig, dataclasses.replace(sensors, **changed)
    return dataclasses.replace(rig, **changed), sensors


def whole(rig: Rig, sensors: Sensors, **values: Any) -> tuple[Rig, Sensors]:
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
    same: tuple[str, ...] = (),
    also: tuple[str, ...] = (),
    silent: bool = False,
) -> Planted:
    label = f"{name}@{site}"
    return Planted(label, build, (label, *same), truth, forces, also, silent)


def _stall_amps(rig: Rig) -> float:
    """Through a motor at rest at the excitation's highest voltage."""
    return MAX_VOLTAGE_V / rig.resistance_ohm[0]


def stall_tension(rig: Rig) -> float:
    return rig.gear_ratio * rig.torque_constant[0] * _stall_amps(rig) / rig.pulley_radius_m


def _limited(rig: Rig, sensors: Sensors, *, site: str, share: float) -> tuple[Rig, Sensors]:
    """A current limit at a share of what the rig's own motor draws: every rig meets it as often."""
    return at_place(rig, sensors, places=MOTORS, site=site, current_limit_A=share * _stall_amps(rig))


def _loose(rig: Rig, sensors: Sensors, *, share: float) -> tuple[Rig, Sensors]:
    """Belts with a share of the tension that the rig's own motor can pull with."""
    return dataclasses.replace(rig, belt_pretension_N=share * stall_tension(rig)), sensors


def _sized(site: str, linear: float, rotary: float) -> float:
    return rotary if site.startswith("phi") else linear


def effect(name: str, site: str, size: float) -> Planted:
    """A library effect at a share of its full size. Full is what a used machine may well have."""
    coordinate = partial(at_place, places=COORDINATES, site=site)
    motor = partial(at_place, places=MOTORS, site=site)
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
            share = 1.0 - 0.6 * size
            return _plant(name, site, partial(_limited, site=site, share=share), {"I": share * _stall_amps(Rig())})
        case "electrical_lag":
            tau = size * 1.5e-3
            return _plant(name, site, partial(motor, electrical_lag_s=tau), {"tau": tau})
        case "input_delay":
            late = size * 2e-3
            return _plant(name, site, partial(whole, input_delay_s=(late, late)), {"d": late})
        case "asymmetric_viscous":
            share = size * 0.3
            return _plant(name, site, partial(coordinate, viscous_asymmetry=share), {"a": share})
        case "quadratic_drag":
            drag = size * _sized(site, 40.0, 1e-4)
            return _plant(name, site, partial(coordinate, quadratic_drag=drag), {"c": drag}, forces=("c",))
        case "cable_spring":
            k, rest = size * 20.0, 0.05
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
            pulley = partial(at_place, places=COORDINATES, site=f"phi{site[-1]}")
            build = partial(pulley, wave_force=torque, wave_number=order, wave_phase=0.5)
            return _plant(name, site, build, {"A": torque, "n": order}, forces=("A",))
        case "eccentric_pulley":
            e = size * 0.2e-3
            return _plant(name, site, partial(motor, eccentricity_m=e, eccentricity_phase=0.7), {"e": e})
        case "belt_play":
            half = size * 0.15e-3
            return _plant(name, site, partial(whole, belt_play_m=half), {"d": half})
        case "belt_damping":
            late = size * 1e-3
            return _plant(name, site, partial(whole, belt_damping_s=late), {"c": late})
        case "belt_slack":
            share = 0.5 - 0.35 * size
            return _plant(name, site, partial(_loose, share=share), {"T0": share * stall_tension(Rig())})
        case "belt_hardening":
            hard = size * 5e4
            return _plant(name, site, partial(whole, belt_hardening=hard), {"h": hard})
        case "bridge_yaw":
            yaw = Yaw(stiffness=15e3 / size)
            return _plant(
                name, site, partial(whole, yaw=yaw), {"k": yaw.stiffness, "w": yaw.half_width_m}, forces=("k",)
            )
        case "idler_inertia":
            return _plant(name, site, partial(whole, idlers=True), {})
        case "sensor_skew":
            a = size * 5e-3
            return _plant(name, site, partial(whole, skew=(0.0, a)), {"a": a})
        case "sensor_scale":
            gain = 1.0 + 0.02 * size
            build = partial(at_place, places=CHANNELS, site=site, scale=gain)
            return _plant(name, site, build, {"g": gain - 1.0})
        case "sensor_range":
            end = 0.16 - 0.11 * size  # full: the paper's 100 mm
            return _plant(name, site, partial(whole, range_x_m=(-end, end)), {"low": -end, "high": end})
        case "sensor_delay":
            late = size * 2e-3
            build = partial(at_place, places=CHANNELS, site=site, delay_s=late)
            return _plant(name, site, build, {"d": late})
        case "presliding":
            stiffness = _sized(site, 1e4, 10.0) / size
            build = partial(coordinate, bristle_stiffness=stiffness)
            return _plant(name, site, build, {"s0": stiffness}, forces=("s0",))
        case "lugre":
            stiffness, damping = 2e4 / size, 100.0
            build = partial(
                coordinate, bristle_stiffness=stiffness, bristle_damping=damping, stribeck_force=1.5 * size,
                stribeck_velocity=0.03,
            )  # fmt: skip
            also, same = (f"stribeck_friction@{site}",), (f"presliding@{site}",)
            return _plant(name, site, build, {"s0": stiffness}, forces=("s0",), same=same, also=also)
    raise ValueError(f"no effect is called {name!r}")
