"""Describe a random rig as a machine of the package: its true machine, and the values to find."""

from __future__ import annotations

import numpy as np

from hframe_gym.effects import EFFECTS
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from tests.reference_simulator import COORDINATES, Rig
from tests.rigs.hidden_effects import MOTORS
from tests.rigs.random_effects import DrawnEffect, library_parameters
from tests.rigs.random_rigs import RandomRig

_BELTS = ("left", "right", "bottom")


def true_machine(random_rig: RandomRig) -> Machine | None:
    """Return the machine whose simulation is the rig without its residue.

    Args:
        random_rig: The rig.

    Returns:
        The declared machine with the true parameters and the hidden effects in the library's form, without
        what is off that form; None if the library does not have a hidden effect.
    """
    if not all(effect.in_library for effect in random_rig.hidden_effects):
        return None
    rig = random_rig.stage[0]
    machine = BUILTIN_MACHINES["hframe"]().replace(base_parameters(rig), name="true")
    for effect in random_rig.hidden_effects:
        values = library_parameters(effect, rig)
        machine = machine.with_effects(
            *(EFFECTS[effect.name].at(site, **values) for site in effect.library_sites())
        )
        if effect.name == "idler_inertia":
            machine = machine.replace(_without_idlers(rig))
    return machine


def base_parameters(rig: Rig) -> dict[str, float]:
    """Return the parameters of a rig that the machine file declares.

    Args:
        rig: The rig; the gain of its drives is not included, because it is an effect.

    Returns:
        Values by full name of the parameter, SI.
    """
    values: dict[str, float] = {}
    for i, name in enumerate(COORDINATES):
        values |= {
            f"{name}.mass": rig.mass[i],
            f"{name}.viscous": rig.viscous[i],
            f"{name}.coulomb": rig.coulomb[i],
        }
    for i, belt in enumerate(_BELTS):
        values |= {f"{belt}.EA": rig.belt_EA_N[i], f"{belt}.rest_length": rig.belt_length_m[i]}
    for j, motor in enumerate(MOTORS):
        values |= {
            f"{motor}.Kt": rig.torque_constant[j],
            f"{motor}.Ke": rig.emf_constant[j],
            f"{motor}.resistance": rig.resistance_ohm[j],
        }
    return values


def _without_idlers(rig: Rig) -> dict[str, float]:
    """Return mass and friction of motors and cart without the idlers', for which the library has limits."""
    values: dict[str, float] = {}
    for name, of_coordinate in (("mass", rig.mass), ("viscous", rig.viscous)):
        both = 0.5 * (of_coordinate[2] + of_coordinate[3])
        values |= {f"phi1.{name}": 0.5 * of_coordinate[2], f"phi2.{name}": 0.5 * of_coordinate[3]}
        values |= {f"y.{name}": of_coordinate[1] - 2.0 * both / rig.pulley_radius_m**2}
    return values


def identified_values(random_rig: RandomRig) -> dict[str, float]:
    """Return the values that identification should find for the parameters of a rig.

    Voltages determine forces only relative to the gain of motor 1, whose declared value is not fitted.
    Therefore all forces, masses and belts appear multiplied by the declared gain over the true one.

    Args:
        random_rig: The rig, whose effects have the library's form.

    Returns:
        Values by full name (x.mass, cogging@motor1.A), SI. Parameters for which no value can be given are
        missing.
    """
    rig, declared = random_rig.stage[0], Rig()
    # A factor of the voltage is equivalent to one of the torque constant and its inverse of the back-EMF
    # constant.
    per_volt = np.array(rig.drive_gain) * np.array(rig.torque_constant) / np.array(rig.resistance_ohm)
    scale = declared.torque_constant[0] / declared.resistance_ohm[0] / per_volt[0]
    values = {
        name: value * scale
        for name, value in base_parameters(rig).items()
        if name.endswith((".mass", ".viscous", ".coulomb", ".EA"))
    }
    values |= {f"{belt}.rest_length": length for belt, length in zip(_BELTS, rig.belt_length_m, strict=True)}
    for j, motor in enumerate(MOTORS):
        values[f"{motor}.Kt"] = per_volt[j] * scale * declared.resistance_ohm[j]
        values[f"{motor}.Ke"] = rig.emf_constant[j] / rig.drive_gain[j]
    if any(effect.name == "idler_inertia" for effect in random_rig.hidden_effects):
        changed = ("y.mass", "y.viscous", "phi1.mass", "phi1.viscous", "phi2.mass", "phi2.viscous")
        values = {
            name: v for name, v in values.items() if name not in changed and not name.endswith(".rest_length")
        }
    for effect in random_rig.hidden_effects:
        values |= _identified_effect(effect, rig, scale)
    return values


def _identified_effect(effect: DrawnEffect, rig: Rig, scale: float) -> dict[str, float]:
    """Return the values that identification should find for the parameters of an effect, by full name."""
    values: dict[str, float] = {}
    if effect.absorbed or effect.off_form or not effect.in_library:
        return values
    per_volt = 1.0 / np.array(rig.drive_gain)  # voltages behind the gain that the torque constant absorbs
    per_ampere = np.array(rig.resistance_ohm) * per_volt / Rig().resistance_ohm
    for site in (*effect.library_sites(), effect.site):
        drives = [MOTORS.index(site)] if site in MOTORS else [0, 1] if site == "drives" else []
        for name, value in library_parameters(effect, rig).items():
            if effect.scales_with.get(name) == "force":
                value = value * scale
            elif drives and (effect.scales_with.get(name) == "current" or name in ("V0", "Vd")):
                factors = (per_volt if name in ("V0", "Vd") else per_ampere)[drives]
                if np.ptp(factors) > 0.0:  # a value that both drives share has no common factor
                    continue
                value = value * factors[0]
            values[f"{effect.name}@{site}.{name}"] = float(value)
    return values
