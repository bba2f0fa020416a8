"""Convert a rig to the arrays that the compiled equations read."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.reference_simulator.rig import Array, Rig

_DEFAULTS = {f.name: f.default for f in dataclasses.fields(Rig)}


def _fields(length: int) -> list[str]:
    """Return the fields of Rig that are tuples of a length."""
    return [name for name, value in _DEFAULTS.items() if isinstance(value, tuple) and len(value) == length]


# Fields of Rig by what they describe. Bodies beyond the four coordinates get zeros except for what they are
# made of.
_OF_COORDINATE, _OF_DRIVE = _fields(4), _fields(2)
_OF_STAGE = [name for name, value in _DEFAULTS.items() if isinstance(value, int | float)]
_DIVISORS = dict.fromkeys(
    (
        "stribeck_velocity",
        "friction_wavelength",
        "friction_stale_path",
        "hysteresis_travel",
        "dahl_travel",
        "catch_width",
        "friction_age_s",
        "friction_age_path",
        "brake_speed",
    ),
    1.0,
)
COORDINATE = np.dtype(
    [(name, "f8") for name in [*_OF_COORDINATE, "radius", "eccentricity_m", "eccentricity_phase"]]
)
DRIVE = np.dtype(
    [("coordinate", "i8"), ("gain", "f8"), ("emf", "f8"), ("ohm", "f8"), *((n, "f8") for n in _OF_DRIVE)]
)
LINK = np.dtype(
    [("first", "i8"), ("second", "i8"), ("stiffness", "f8"), ("viscous", "f8"), ("half_gap", "f8")]
)
STAGE = np.dtype(
    [(name, "f8") for name in [*_OF_STAGE, "frame_w", "frame_zeta", "frame_ratio", "frame_ground"]]
)
# The nine belt sections of the 20th-order stage: lengths at x = y = 0, m (the paper's Table 4), the gradient
# of the lengths with respect to x and y, and the extension rows over x, y and the travel of eight pulleys
# (eq. 25-34, with signs that make K symmetric).
_SECTIONS = (0.781, 0.781, 0.3334, 0.3334, 0.3334, 0.3334, 0.281, 0.281, 0.6159)
_SECTION_GRADIENT = ((0, 0), (0, 0), (-1, 0), (-1, 0), (1, 0), (1, 0), (0, 1), (0, -1), (0, 0))
_SECTION_ROWS = (
    (0, 0, 1, 0, -1, 0, 0, 0, 0, 0),
    (0, 0, 0, 1, 0, -1, 0, 0, 0, 0),
    (1, 0, 1, 0, 0, 0, 1, 0, 0, 0),
    (1, 0, 0, -1, 0, 0, 0, -1, 0, 0),
    (1, 0, 0, 0, 1, 0, 0, 0, 1, 0),
    (1, 0, 0, 0, 0, -1, 0, 0, 0, -1),
    (0, 1, 0, 0, 0, 0, 0, 0, -1, 0),
    (0, 1, 0, 0, 0, 0, 0, 0, 0, -1),
    (0, 0, 0, 0, 0, 0, 1, -1, 0, 0),
)


class ParameterArrays(NamedTuple):
    """Parameters of a stage with n coordinates: x, y, phi1, phi2, the idlers, and the rig's other bodies."""

    coordinates: NDArray[Any]  # (n,) of COORDINATE
    drives: NDArray[Any]  # (2,) of DRIVE
    links: NDArray[Any]  # (links,) of LINK: springs between two coordinates
    stage: NDArray[Any]  # (1,) of STAGE
    belts: Array  # (belts, 3): EA, N; length at x = y = 0, m; factor of the damping
    length_gradient: Array  # (belts, 2): of the length with respect to x and y
    rows: Array  # (belts, n): extension over the coordinates' travel


class MeasuredCoordinates(NamedTuple):
    """Indices of coordinates that sensors measure: of the encoders, and of the bridge's yaw (-1: none)."""

    encoders: tuple[int, int]
    yaw: int


def parameter_arrays(rig: Rig) -> tuple[ParameterArrays, MeasuredCoordinates]:
    """Convert a rig to arrays.

    Args:
        rig: Parameters of the stage.

    Returns:
        The arrays, and the indices of the measured coordinates.

    Raises:
        ValueError: If the equations do not cover the rig's combination of effects.
    """
    _check(rig)
    four = np.zeros(4, COORDINATE)
    for name in _OF_COORDINATE:
        four[name] = getattr(rig, name)
    four["eccentricity_m"][2:], four["eccentricity_phase"][2:] = rig.eccentricity_m, rig.eccentricity_phase
    four["radius"] = 1.0, 1.0, rig.pulley_radius_m, rig.pulley_radius_m
    coordinates, links = list(four), []

    def add(**values: float) -> int:
        """Append a coordinate and return its index."""
        new = np.zeros(1, COORDINATE)[0]
        for name, value in ({"radius": 1.0} | _DIVISORS | values).items():
            new[name] = value
        coordinates.append(new)
        return len(coordinates) - 1

    if rig.idlers:
        _separate_idlers(rig, coordinates)
        for driven in (2, 3, 2, 3, 2, 3):
            pulley = coordinates[driven]
            add(mass=pulley["mass"], viscous=pulley["viscous"], radius=rig.pulley_radius_m)
    encoders = [2, 3]
    for j, half_gap in enumerate(rig.backlash_rad):
        if half_gap:
            pulley = coordinates[2 + j]
            fractions = dict.fromkeys(("mass", "coulomb"), rig.backlash_motor_fraction)
            fractions["viscous"] = rig.backlash_motor_viscous
            rotor = add(**{name: pulley[name] * fraction for name, fraction in fractions.items()})
            for name, fraction in fractions.items():
                pulley[name] *= 1.0 - fraction
            damping = 2.0 * rig.backlash_damping * math.sqrt(rig.backlash_stiffness * pulley["mass"])
            links.append((2 + j, rotor, rig.backlash_stiffness, damping, half_gap))
            encoders[j] = rotor
    if rig.payload:
        payload = add(mass=rig.payload.mass_kg)
        links.append((1, payload, rig.payload.stiffness, rig.payload.viscous, 0.0))
    yaw = -1
    if rig.yaw:
        yaw = add(mass=rig.yaw.inertia, viscous=rig.yaw.viscous, spring_stiffness=rig.yaw.stiffness)

    belts, length_gradient, rows = _belts(rig, len(coordinates))
    if rig.yaw:
        # Left and right; the bottom belt does not see yaw.
        rows[:2, yaw] = (rig.yaw.half_width_m, -rig.yaw.half_width_m)
    arrays = ParameterArrays(
        np.array(coordinates, COORDINATE),
        _drives(rig, encoders),
        np.array(links, LINK),
        _stage(rig),
        belts,
        length_gradient,
        rows,
    )
    return arrays, MeasuredCoordinates((encoders[0], encoders[1]), yaw)


def _check(rig: Rig) -> None:
    """Raise ValueError for combinations that the equations do not cover."""
    if rig.idlers and rig.yaw:
        raise ValueError("the yaw of a 20th-order stage is not modeled")
    if np.isfinite(rig.belt_pretension_N) and (rig.belt_damping_s or rig.belt_hardening or rig.belt_play_m):
        raise ValueError("belts that go slack cannot have damping, hardening or play here")
    level, breakaway = np.array(rig.coulomb), np.array(rig.coulomb) + np.array(rig.stribeck_force)
    if np.any(level < 0.0) or np.any((breakaway <= 0.0) & (breakaway < level)):
        raise ValueError("dry friction needs a Coulomb level >= 0 and a breakaway level > 0")


def _separate_idlers(rig: Rig, coordinates: list[Any]) -> None:
    """Undo the lumping of eq. 4-8, of idlers with motors and cart: half of a motor's is its idler's."""
    for name in ("mass", "viscous"):
        for i in (2, 3):
            coordinates[i][name] *= 0.5
        both = coordinates[2][name] + coordinates[3][name]
        coordinates[1][name] -= 2.0 * both / rig.pulley_radius_m**2


def _drives(rig: Rig, encoders: list[int]) -> NDArray[Any]:
    """Return the drives' parameters, shape (2,); a motor acts on the coordinate that its encoder measures."""
    drives = np.zeros(2, DRIVE)
    for name in _OF_DRIVE:
        drives[name] = getattr(rig, name)
    drives["coordinate"] = encoders
    drives["gain"] = rig.gear_ratio * np.array(rig.torque_constant)  # Nm at the pulley per ampere
    drives["emf"] = rig.gear_ratio * np.array(rig.emf_constant)
    drives["ohm"] = rig.resistance_ohm
    return drives


def _stage(rig: Rig) -> NDArray[Any]:
    """Return the parameters that belong to no single coordinate, shape (1,)."""
    stage = np.zeros(1, STAGE)
    for name in _OF_STAGE:
        stage[name] = getattr(rig, name)
    if rig.frame:
        hertz, zeta, ratio, stage["frame_ground"] = dataclasses.astuple(rig.frame)
        stage["frame_w"], stage["frame_zeta"], stage["frame_ratio"] = 2.0 * np.pi * hertz, zeta, ratio
    return stage


def _belts(rig: Rig, count: int) -> tuple[Array, Array, Array]:
    """Return EA, length, damping factor (belts, 3), length gradient (belts, 2), rows by travel (belts, n)."""
    if rig.idlers:
        lengths, gradient = np.array(_SECTIONS), np.array(_SECTION_GRADIENT, float)
        section_rows = np.array(_SECTION_ROWS, float)
        if len(set(rig.belt_EA_N)) > 1:
            raise ValueError("a 20th-order stage has one belt, hence one EA")
        if len(set(rig.belt_damping_factor)) > 1:
            raise ValueError("a 20th-order stage has one belt, hence one damping factor")
        strength = np.full(len(section_rows), rig.belt_EA_N[0])
        damping = np.full(len(section_rows), rig.belt_damping_factor[0])
    else:
        strength, lengths = np.array(rig.belt_EA_N), np.array(rig.belt_length_m)
        damping = np.array(rig.belt_damping_factor)
        gradient = np.array([[1.0, 1.0], [1.0, -1.0], [-2.0, 0.0]])
        section_rows = np.array([[1.0, 1.0, 1.0, 0.0], [1.0, -1.0, 0.0, -1.0], [-2.0, 0.0, -1.0, 1.0]])
    rows = np.zeros((len(section_rows), count))
    rows[:, : section_rows.shape[1]] = section_rows
    return np.stack([strength, lengths, damping], axis=1), gradient * float(rig.length_follows), rows
