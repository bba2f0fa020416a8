"""Define the effects that the rigs hide: what each changes, its size, and names that identify it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tests.reference_simulator import COORDINATES, Frame, Payload, Rig, Yaw
from tests.reference_simulator.sensors import Sensors
from tests.rigs.excitation import MAX_VOLTAGE_V

MOTORS = ("motor1", "motor2")
CHANNELS = ("phi1_rad", "phi2_rad", "x_m", "y_m")
Build = Callable[[Rig, Sensors], tuple[Rig, Sensors]]


@dataclass(frozen=True)
class HiddenEffect:
    """Effect of a rig that its machine file does not declare.

    Attributes:
        label: The effect as name@site.
        build: Function that adds the effect to a rig and its sensors.
        accepted: Labels that identify this effect correctly.
        parameters: The effect's parameters by the library's names, SI.
        scale_with_gain: Names of the parameters that are forces. From voltages only their ratio to the
            motors' gain is identifiable.
        tolerated: Labels that are acceptable in addition to an accepted one.
        absorbed: Whether refitting the declared parameters can explain the effect, so that naming none is
            correct too.
    """

    label: str
    build: Build
    accepted: tuple[str, ...]
    parameters: dict[str, float]
    scale_with_gain: tuple[str, ...] = ()
    tolerated: tuple[str, ...] = ()
    absorbed: bool = False


def random_rig(rng: np.random.Generator) -> Rig:
    """Return the declared stage with every parameter changed by 5 to 20 %, up or down; all belts have one EA.

    Args:
        rng: Source of the changes.

    Returns:
        The changed stage.
    """
    declared = Rig()

    def vary(values: tuple[float, ...]) -> Any:
        return tuple(float(v * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.2))) for v in values)

    constant, (ohm,) = vary(declared.torque_constant), vary(declared.resistance_ohm[:1])
    return dataclasses.replace(
        declared,
        mass=vary(declared.mass),
        viscous=vary(declared.viscous),
        coulomb=vary(declared.coulomb),
        belt_EA_N=vary(declared.belt_EA_N[:1]) * 3,
        torque_constant=constant,
        emf_constant=constant,
        resistance_ohm=(ohm, ohm),
    )


def _replace_at(sites: tuple[str, ...], site: str, value: float, values: tuple[float, ...]) -> Any:
    """Return the values with the one of a site replaced."""
    return tuple(value if name == site else other for name, other in zip(sites, values, strict=True))


def change_site(
    rig: Rig, sensors: Sensors, *, sites: tuple[str, ...], site: str, **values: float
) -> tuple[Rig, Sensors]:
    """Change fields of a rig, or of its sensors, at one site.

    Args:
        rig: Stage to change.
        sensors: Sensors to change.
        sites: Names of the fields' entries: coordinates, motors or channels. With channels the fields are the
            sensors'.
        site: Entry to change.
        **values: New value of the entry by field.

    Returns:
        The changed rig and sensors.
    """
    changed = {}
    parent: Any = sensors if sites == CHANNELS else rig
    for name, value in values.items():
        changed[name] = _replace_at(sites, site, value, getattr(parent, name))
    if sites == CHANNELS:
        return rig, dataclasses.replace(sensors, **changed)
    return dataclasses.replace(rig, **changed), sensors


def change_fields(rig: Rig, sensors: Sensors, **values: Any) -> tuple[Rig, Sensors]:
    """Replace complete fields of a rig or of its sensors.

    Args:
        rig: Stage to change.
        sensors: Sensors to change.
        **values: New value by the name of the field.

    Returns:
        The changed rig and sensors.
    """
    of_sensors = {f.name for f in dataclasses.fields(Sensors)}
    sensor_fields = {name: value for name, value in values.items() if name in of_sensors}
    rig_fields = {name: value for name, value in values.items() if name not in of_sensors}
    return dataclasses.replace(rig, **rig_fields), dataclasses.replace(sensors, **sensor_fields)


def _hidden(
    name: str,
    site: str,
    build: Build,
    parameters: dict[str, float],
    *,
    forces: tuple[str, ...] = (),
    equivalent: tuple[str, ...] = (),
    tolerated: tuple[str, ...] = (),
    absorbed: bool = False,
) -> HiddenEffect:
    """Return a hidden effect that is accepted under its label and equivalent ones."""
    label = f"{name}@{site}"
    return HiddenEffect(label, build, (label, *equivalent), parameters, forces, tolerated, absorbed)


def _stall_amps(rig: Rig) -> float:
    """Return the current through a motor at rest at the maximum voltage of the excitation, A."""
    return MAX_VOLTAGE_V / rig.resistance_ohm[0]


def stall_tension(rig: Rig) -> float:
    """Return the belt tension with which motor 1 pulls at rest at the maximum voltage of the excitation.

    Args:
        rig: Parameters of the stage.

    Returns:
        Tension, N.
    """
    return rig.gear_ratio * rig.torque_constant[0] * _stall_amps(rig) / rig.pulley_radius_m


def limit_current(rig: Rig, sensors: Sensors, *, site: str, fraction: float) -> tuple[Rig, Sensors]:
    """Limit the current to a fraction of the motor's stall current, so that all rigs reach it equally often.

    Args:
        rig: Stage to change.
        sensors: Its sensors.
        site: Motor.
        fraction: Fraction of the stall current.

    Returns:
        The changed rig and the sensors.
    """
    return change_site(rig, sensors, sites=MOTORS, site=site, current_limit_A=fraction * _stall_amps(rig))


def loosen_belts(rig: Rig, sensors: Sensors, *, fraction: float) -> tuple[Rig, Sensors]:
    """Pretension the belts with a fraction of the tension with which the motor can pull.

    Args:
        rig: Stage to change.
        sensors: Its sensors.
        fraction: Fraction of the tension.

    Returns:
        The changed rig and the sensors.
    """
    return dataclasses.replace(rig, belt_pretension_N=fraction * stall_tension(rig)), sensors


def hang_payload(rig: Rig, sensors: Sensors, *, fraction: float, hertz: float) -> tuple[Rig, Sensors]:
    """Hang a payload from the cart that swings along y, with a damping ratio of 3 %.

    Args:
        rig: Stage to change.
        sensors: Its sensors.
        fraction: Mass of the payload as a fraction of the cart's.
        hertz: Natural frequency with the cart held, Hz.

    Returns:
        The changed rig and the sensors.
    """
    mass, w = fraction * rig.mass[1], 2.0 * np.pi * hertz
    return dataclasses.replace(rig, payload=Payload(mass, mass * w * w, 2.0 * 0.03 * w * mass)), sensors


def _per_kind(site: str, linear: float, rotary: float) -> float:
    """Return the value for a linear coordinate (x, y) or a rotary one (phi1, phi2)."""
    return rotary if site.startswith("phi") else linear


def effect(name: str, site: str, size: float) -> HiddenEffect:
    """Return an effect of the library as a hidden effect.

    Args:
        name: Name of the effect in the library, or "lugre".
        site: Site of the effect.
        size: Amplitude relative to the full size, which is what a used machine may plausibly have.

    Returns:
        The hidden effect.

    Raises:
        ValueError: If no effect has this name.
    """
    coordinate = partial(change_site, sites=COORDINATES, site=site)
    motor = partial(change_site, sites=MOTORS, site=site)
    match name:
        case "stribeck_friction" | "tustin_friction":
            force = size * {"x": 3.0, "y": 0.8, "phi1": 0.03, "phi2": 0.03}[site]
            speed, exponent = _per_kind(site, 0.04, 2.5), 1.0 if name == "tustin_friction" else 2.0
            build = partial(
                coordinate, stribeck_force=force, stribeck_velocity=speed, stribeck_exponent=exponent
            )
            return _hidden(name, site, build, {"dF": force, "vs": speed}, forces=("dF",))
        case "dwell_friction":
            rise, path = 0.4 * size, _per_kind(site, 3e-4, 0.015)
            build = partial(coordinate, friction_age=rise, friction_age_path=path)
            parameters = {"dF": rise * Rig().coulomb[COORDINATES.index(site)], "tau": 0.02, "D": path}
            return _hidden(name, site, build, parameters, forces=("dF",))
        case "constant_force":
            force = size * _per_kind(site, 0.8, 0.02)
            equivalent = tuple(
                f"voltage_offset@{m}" for m, c in zip(MOTORS, COORDINATES[2:], strict=True) if c == site
            )
            return _hidden(
                name,
                site,
                partial(coordinate, constant_force=force),
                {"size": force},
                forces=("size",),
                equivalent=equivalent,
            )
        case "voltage_offset":
            volts = size * 0.15
            equivalent = (f"constant_force@phi{site[-1]}",)
            return _hidden(
                name, site, partial(motor, voltage_offset_V=volts), {"V0": volts}, equivalent=equivalent
            )
        case "gain_mismatch":
            gain = 1.0 - 0.1 * size
            return _hidden(name, site, partial(motor, drive_gain=gain), {"g": gain - 1.0}, absorbed=True)
        case "dead_band":
            volts = size * 0.4
            return _hidden(name, site, partial(motor, dead_band_V=volts), {"Vd": volts})
        case "current_limit":
            fraction = 1.0 - 0.6 * size
            build = partial(limit_current, site=site, fraction=fraction)
            return _hidden(name, site, build, {"I": fraction * _stall_amps(Rig())})
        case "voltage_limit":
            volts = (1.0 - 0.6 * size) * MAX_VOLTAGE_V
            return _hidden(name, site, partial(motor, voltage_limit_V=volts), {"U": volts})
        case "coasting_bridge":
            volts = MAX_VOLTAGE_V / size
            return _hidden(name, site, partial(motor, coasting_V=volts), {"U": volts})
        case "inverter_dead_time":
            volts = size * 0.4
            return _hidden(name, site, partial(motor, dead_time_V=volts), {"Vd": volts})
        case "commutation_ripple":
            ripple, order = 0.15 * size, 4 * 5.9
            build = partial(motor, current_ripple=ripple, current_ripple_order=order)
            return _hidden(name, site, build, {"a": ripple, "n": order})
        case "torque_saturation":
            amps = 10.0 / np.sqrt(size)
            return _hidden(name, site, partial(motor, torque_saturation_A=amps), {"s": amps**-2})
        case "winding_heat":  # the resistance itself is not identifiable, so neither is its rise per A^2
            build = partial(motor, heating_ohm=0.05 * size, heating_s=2.0)
            return _hidden(name, site, build, {"tau": 2.0})
        case "supply_sag":  # the same holds for the sag per power
            build = partial(change_fields, supply_ohm=0.4 * size, supply_s=8e-3)
            return _hidden(name, site, build, {"tau": 8e-3})
        case "electrical_lag":
            tau = size * 1.5e-3
            return _hidden(name, site, partial(motor, electrical_lag_s=tau), {"tau": tau})
        case "input_delay":
            delay = size * 2e-3
            delays = (
                (delay, delay)
                if site == "drives"
                else tuple(delay * (site == m) for m in ("motor1", "motor2"))
            )
            return _hidden(name, site, partial(change_fields, input_delay_s=delays), {"d": delay})
        case "asymmetric_viscous":
            asymmetry = size * 0.3
            return _hidden(name, site, partial(coordinate, viscous_asymmetry=asymmetry), {"a": asymmetry})
        case "quadratic_drag":
            drag = size * _per_kind(site, 40.0, 1e-4)
            return _hidden(name, site, partial(coordinate, quadratic_drag=drag), {"c": drag}, forces=("c",))
        case "eddy_brake":
            drag, speed = size * _per_kind(site, 25.0, 0.01), _per_kind(site, 0.1, 5.0)
            build = partial(coordinate, brake_drag=drag, brake_speed=speed)
            return _hidden(name, site, build, {"c": drag, "v0": speed}, forces=("c",))
        case "cable_spring":
            k, rest = size * 20.0, 0.05
            build = partial(coordinate, spring_stiffness=k, spring_rest=rest)
            return _hidden(name, site, build, {"k": k, "q0": rest}, forces=("k",))
        case "position_friction":
            force = size * _per_kind(site, {"x": 1.2, "y": 0.3}.get(site, 0.0), 0.03)
            length = _per_kind(site, 0.1, 2 * np.pi)
            build = partial(coordinate, friction_wave=force, friction_wavelength=length, friction_phase=1.0)
            return _hidden(name, site, build, {"A": force, "L": length}, forces=("A",))
        case "friction_slope":
            slope = size * {"x": 5.0, "y": 1.5}[site]
            build = partial(coordinate, friction_slope=slope)
            return _hidden(name, site, build, {"s": slope}, forces=("s",))
        case "cogging":
            torque, order = size * 0.03, 4 * 5.9  # four periods per revolution of the motor
            pulley = partial(change_site, sites=COORDINATES, site=f"phi{site[-1]}")
            build = partial(pulley, wave_force=torque, wave_number=order, wave_phase=0.5)
            return _hidden(name, site, build, {"A": torque, "n": order}, forces=("A",))
        case "belt_mesh":
            part, pitch, tension = size * 0.1, 5e-3, Rig().mesh_tension_N
            forces = tuple(part * tension if site == m else 0.0 for m in MOTORS)
            build = partial(
                change_fields, mesh_force_N=forces, mesh_pitch_m=(pitch, pitch), mesh_unloaded=0.0
            )
            return _hidden(
                name,
                site,
                build,
                {"A": part, "n": 2.0 * np.pi * Rig().pulley_radius_m / pitch},
                forces=("A",),
            )
        case "second_cogging":  # beside cogging at full size, which has the same motor
            torque, order = 0.4 * size * 0.03, 2 * 4 * 5.9
            pulley = partial(change_site, sites=COORDINATES, site=f"phi{site[-1]}")
            return _hidden(
                name, site, partial(pulley, wave_second=0.4 * size), {"A": torque, "n": order}, forces=("A",)
            )
        case "unbalance":
            torque = size * 0.03
            build = partial(coordinate, wave_force=torque, wave_number=1.0, wave_phase=0.5)
            return _hidden(name, site, build, {"A": torque}, forces=("A",))
        case "load_friction":
            mu = size * 0.15
            return _hidden(name, site, partial(motor, load_friction=mu), {"mu": mu})
        case "eccentric_pulley":
            e = size * 0.2e-3
            return _hidden(name, site, partial(motor, eccentricity_m=e, eccentricity_phase=0.7), {"e": e})
        case "belt_play":
            half = size * 0.15e-3
            return _hidden(name, site, partial(change_fields, belt_play_m=half), {"d": half})
        case "gear_backlash":
            gap = size * 6e-3
            values = tuple(gap if site == m else 0.0 for m in MOTORS)
            return _hidden(name, site, partial(change_fields, backlash_rad=values), {"d": gap})
        case "belt_damping":
            damping = size * 1e-3
            return _hidden(name, site, partial(change_fields, belt_damping_s=damping), {"c": damping})
        case "belt_slack":
            fraction = 0.5 - 0.35 * size
            return _hidden(
                name, site, partial(loosen_belts, fraction=fraction), {"T0": fraction * stall_tension(Rig())}
            )
        case "belt_hardening":
            hardening = size * 5e4
            return _hidden(name, site, partial(change_fields, belt_hardening=hardening), {"h": hardening})
        case "bridge_yaw":
            yaw = Yaw(stiffness=15e3 / size)
            return _hidden(
                name,
                site,
                partial(change_fields, yaw=yaw),
                {"k": yaw.stiffness, "w": yaw.half_width_m},
                forces=("k",),
            )
        case "payload_swing":
            build = partial(hang_payload, fraction=0.3 * size, hertz=1.6)
            return _hidden(name, site, build, {"f0": 1.6, "r": 0.3 * size})
        case "idler_inertia":
            return _hidden(name, site, partial(change_fields, idlers=True), {})
        case "sensor_skew":
            a = size * 5e-3
            return _hidden(name, site, partial(change_fields, skew=(0.0, a)), {"a": a})
        case "sensor_scale":
            gain = 1.0 + 0.02 * size
            build = partial(change_site, sites=CHANNELS, site=site, scale=gain)
            return _hidden(name, site, build, {"g": gain - 1.0})
        case "eccentric_encoder":
            error = size * 0.02
            build = partial(change_site, sites=CHANNELS, site=site, wave=error, wave_phase=0.7)
            return _hidden(name, site, build, {"A": error, "p": 0.7})
        case "interpolation_error":
            error, period = 0.1e-3 * size, 7e-3
            build = partial(
                change_site, sites=CHANNELS, site=site, wave=error, wave_period=period, wave_phase=0.7
            )
            return _hidden(name, site, build, {"A": error, "n": 2.0 * np.pi / period})
        case "sensor_range":
            end = 0.16 - 0.11 * size  # full: the paper's 100 mm
            return _hidden(
                name, site, partial(change_fields, range_x_m=(-end, end)), {"low": -end, "high": end}
            )
        case "sensor_delay":
            delay = size * 2e-3
            build = partial(change_site, sites=CHANNELS, site=site, delay_s=delay)
            return _hidden(name, site, build, {"d": delay})
        case "presliding":
            stiffness = _per_kind(site, 1e4, 10.0) / size
            build = partial(coordinate, bristle_stiffness=stiffness)
            return _hidden(name, site, build, {"s0": stiffness}, forces=("s0",))
        case "dahl_hysteresis":
            force, travel = size * {"x": 4.0, "y": 1.2}[site], 6e-3
            build = partial(coordinate, dahl_force=force, dahl_travel=travel)
            return _hidden(name, site, build, {"F": force, "L": travel}, forces=("F",))
        case "bouc_wen_hysteresis":
            force, travel = size * 4.0, 8e-3
            build = partial(coordinate, hysteresis_force=force, hysteresis_travel=travel)
            return _hidden(name, site, build, {"F": force, "L": travel}, forces=("F",))
        case "friction_warm_up":
            build = partial(change_fields, friction_cold=(1.5 * size,) * 4, warm_up_s=12.0)
            return _hidden(name, site, build, {"a": 1.5 * size, "tau": 12.0})
        case "frame_resonance":
            ratio = size * 0.05
            build = partial(change_fields, frame=Frame(hertz=15.0, mass_ratio=ratio))
            return _hidden(name, site, build, {"f0": 15.0, "zeta": 0.05, "r": ratio, "s": 0.0})
        case "lugre":
            stiffness, damping = 2e4 / size, 100.0
            build = partial(
                coordinate, bristle_stiffness=stiffness, bristle_damping=damping, stribeck_force=1.5 * size,
                stribeck_velocity=0.03,
            )  # fmt: skip
            tolerated, equivalent = (f"stribeck_friction@{site}",), (f"presliding@{site}",)
            return _hidden(
                name,
                site,
                build,
                {"s0": stiffness},
                forces=("s0",),
                equivalent=equivalent,
                tolerated=tolerated,
            )
    raise ValueError(f"unknown effect {name!r}")
