"""Convert values in the units of datasheets to those of machine.json, for messages about a wrong unit."""

from __future__ import annotations

import math

from ..quantities import QUANTITIES

_RPM = 2.0 * math.pi / 60.0  # rad/s
# Factors of units that no channel of a recording has, by the unit of machine.json.
_FACTORS: dict[str, dict[str, float]] = {
    "kg": {"g": 1e-3, "t": 1e3},
    "kg m^2": {"g cm^2": 1e-7, "kg cm^2": 1e-4, "g mm^2": 1e-9, "kg mm^2": 1e-6},
    "Nm/A": {"mNm/A": 1e-3, "Nmm/A": 1e-3, "Ncm/A": 1e-2},
    "Vs/rad": {
        "mVs/rad": 1e-3,
        "V/(rad/s)": 1.0,
        "V/rpm": 1.0 / _RPM,
        "mV/rpm": 1e-3 / _RPM,
        "V/krpm": 1e-3 / _RPM,
    },
    "ohm": {"mohm": 1e-3, "kohm": 1e3, "Ω": 1.0, "mΩ": 1e-3},
    "Nm": {"Nmm": 1e-3},
}
# A speed constant is the reciprocal of the back-EMF constant, and of the torque constant, which equals it.
_SPEED_CONSTANTS = {"rpm/V": _RPM, "rad/s/V": 1.0, "rad/(s V)": 1.0}


def _spelling(unit: str) -> str:
    """Return a unit without what is written in several ways: case, blanks, signs of products and powers."""
    unit = unit.replace("²", "2").replace("µ", "u").replace("μ", "u")
    return "".join(unit.split()).translate(str.maketrans("", "", "^*.·")).lower()


def converted(value: float, given: str, unit: str) -> float | None:
    """Convert a value to the unit of machine.json; None if the conversion is not known.

    Args:
        value: Value in the unit `given`.
        given: Unit that the file states, in any spelling. The case of a prefix does not count: no quantity
            here is in millions.
        unit: Unit that machine.json has.
    """
    factors = {unit: 1.0} | _FACTORS.get(unit, {})
    for quantity in QUANTITIES.values():
        if unit in quantity.units:
            factors |= {other: up / down for other, (up, down) in quantity.units.items()}
    by_spelling = {_spelling(other): factor for other, factor in factors.items()}
    if _spelling(given) in by_spelling:
        return value * by_spelling[_spelling(given)]
    constants = {_spelling(other): factor for other, factor in _SPEED_CONSTANTS.items()}
    if unit in ("Vs/rad", "Nm/A") and _spelling(given) in constants and value:
        return 1.0 / (constants[_spelling(given)] * value)
    return None
