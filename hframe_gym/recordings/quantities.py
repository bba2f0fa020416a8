"""The physical quantities of logs' columns: their units and names, and how they are recognized.

This module is the one place that knows which units and names belong to which quantity. A unit is evidence; a
name is a guess, which the user may correct.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Literal, NamedTuple

import numpy as np

Evidence = Literal["unit", "name", ""]
Factors = dict[str, tuple[float, float]]  # factor to the SI unit as numerator and denominator, by unit


@dataclass(frozen=True)
class Quantity:
    """A physical quantity that a column of a log may have.

    Attributes:
        article: "a" or "an".
        units: Factor to the SI unit as numerator and denominator, by unit, beginning with the SI unit.
            Dividing by 1000 rounds correctly, multiplying by 0.001 does not.
        names: Words in headers that name the quantity, in lower case, in English, German and French,
            separated by blanks.
        family: Quantities of one family differ only by the kind of motion (linear or rotary).
    """

    article: str
    units: Factors = field(default_factory=dict)
    names: str = ""
    family: str = ""

    @cached_property
    def words(self) -> tuple[str, ...]:
        """The words in headers that name the quantity, in lower case."""
        return tuple(self.names.split())


# "position", "speed" and "acceleration" have no units: a name alone does not say whether the motion is linear
# or rotary. Units that no channel has are listed so that they are recognized; their factors are not used.
QUANTITIES: dict[str, Quantity] = {
    "time": Quantity(
        "a",
        {"s": (1, 1), "ms": (1, 1e3), "us": (1, 1e6), "ns": (1, 1e9), "min": (60, 1)},
        "time timestamp zeit uhrzeit zeitstempel elapsed seconds sec millis "
        "micros clock date datum messzeit laufzeit",
    ),
    "voltage": Quantity("a", {"V": (1, 1), "mV": (1, 1e3)}, "voltage volt volts spannung vbus vbat"),
    "duty cycle": Quantity(
        "a", {"%": (1, 100), "pu": (1, 1)}, "duty dutycycle pwm throttle tastgrad aussteuerung"
    ),
    "current": Quantity("a", {"A": (1, 1), "mA": (1, 1e3)}, "current amps ampere amperage strom courant iq"),
    "torque": Quantity(
        "a", {"Nm": (1, 1), "mNm": (1, 1e3), "Ncm": (1, 1e2)}, "torque moment drehmoment couple tau effort"
    ),
    "force": Quantity("a", {"N": (1, 1), "mN": (1, 1e3), "kN": (1e3, 1)}, "force kraft thrust"),
    "length": Quantity(
        "a",
        {
            "m": (1, 1),
            "cm": (1, 1e2),
            "mm": (1, 1e3),
            "um": (1, 1e6),
            "nm": (1, 1e9),
            "in": (0.0254, 1),
            "ft": (0.3048, 1),
        },
        "displacement distance stroke travel weg hub abstand",
        "position",
    ),
    "angle": Quantity(
        "an",
        {"rad": (1, 1), "mrad": (1, 1e3), "deg": (np.pi, 180), "rev": (2 * np.pi, 1)},
        "angle winkel theta phi rotation rotations turns heading yaw pitch roll",
        "position",
    ),
    # The symbols of a joint's position, speed and acceleration in robotics are in `_JOINT`.
    "position": Quantity("a", {}, "position pos encoder laser", "position"),
    "linear speed": Quantity(
        "a",
        {
            "m/s": (1, 1),
            "mm/s": (1, 1e3),
            "cm/s": (1, 1e2),
            "mm/min": (1, 6e4),
            "in/s": (0.0254, 1),
            "ft/s": (0.3048, 1),
        },
        "",
        "speed",
    ),
    "angular speed": Quantity(
        "an",
        {"rad/s": (1, 1), "deg/s": (np.pi, 180), "rpm": (2 * np.pi, 60), "rev/s": (2 * np.pi, 1)},
        "rpm rps omega drehzahl gyro",
        "speed",
    ),
    "speed": Quantity(
        "a",
        {},
        "speed velocity vel velo geschwindigkeit vitesse tacho tachometer rate "
        "dot xdot ydot qdot phidot thetadot dphi dtheta",
        "speed",
    ),
    "linear acceleration": Quantity(
        "a", {"m/s^2": (1, 1), "mm/s^2": (1, 1e3), "g": (9.80665, 1)}, "", "acceleration"
    ),
    "angular acceleration": Quantity("an", {"rad/s^2": (1, 1), "deg/s^2": (np.pi, 180)}, "", "acceleration"),
    "acceleration": Quantity(
        "an",
        {},
        "acceleration accel acc beschleunigung ddot xddot yddot qddot phiddot thetaddot",
        "acceleration",
    ),
    "temperature": Quantity(
        "a", {"degC": (1, 1), "K": (1, 1), "degF": (1, 1)}, "temperature temp temperatur"
    ),
    "power": Quantity("a", {"W": (1, 1), "kW": (1e3, 1)}, "power leistung puissance"),
    "frequency": Quantity("a", {"Hz": (1, 1), "kHz": (1e3, 1)}, "frequency freq frequenz"),
    "pressure": Quantity("a", {"bar": (1e5, 1), "Pa": (1, 1)}, "pressure druck pression"),
    "row number": Quantity("a", {}, "index idx sample samples timestep tick ticks seq sequence row frame"),
    "gain": Quantity("a", {}, "gain gains kp ki kd"),  # of a controller: "vel_gain" of an ODrive is no speed
    "state": Quantity("a", {}, "state status flag flags mode fault valid enable enabled trigger event"),
}
# Units of a number without a dimension: encoder counts, converter steps, bits, and marks of a column without
# a unit.
COUNT_UNITS = (
    *("counts", "count", "cts", "inc", "incr", "increments", "increment", "pulses", "pulse"),
    *("ink", "inkr", "inkremente", "inkrement", "impulse", "imp", "impulsions"),
    *("ticks", "tick", "steps", "step", "schritte", "pasos", "pulsos", "cuentas"),
)
_WITHOUT_DIMENSION = {*COUNT_UNITS, "bit", "bits", "lsb", "bool", "digits", "-", "1", "#", "n/a"}

# Other spellings of units. Those of one letter and "nm" depend on the case of the letters.
_SPELLINGS = {
    "s": ("sec", "secs", "second", "seconds"),
    "ms": ("msec", "millis", "milliseconds"),
    "us": ("usec", "µs", "μs", "micros", "microseconds"),
    "ns": ("nsec", "nanoseconds"),
    "min": ("minutes",),
    "V": ("volt", "volts"),
    "mV": ("millivolts",),
    "A": ("amp", "amps", "ampere", "amperes"),
    "m": ("meter", "meters", "metres"),
    "mm": ("millimeter", "millimeters", "millimetres"),
    "um": ("µm", "μm", "micrometers"),
    "in": ("inch", "inches"),
    "ft": ("foot", "feet"),
    "rad": ("radian", "radians"),
    "deg": ("°", "degree", "degrees"),
    "rev": ("turn", "turns", "revs", "revolutions", "rotation", "rotations"),
    "m/s": ("mps", "m/sec"),
    "mm/s": ("mmps", "mm/sec"),
    "in/s": ("in/sec", "inch/s", "inches/s"),
    "ft/s": ("ft/sec", "feet/s"),
    "rad/s": ("radps", "rad/sec"),
    "deg/s": ("dps", "°/s", "deg/sec", "degps"),
    "rpm": ("1/min", "u/min", "rev/min", "r/min", "min^-1", "1/minute", "tr/min", "tours/min"),
    "rev/s": ("rps", "turn/s", "turns/s", "rotations/s", "1/s", "rev/sec", "tr/s"),
    "m/s^2": ("mps2", "m/s2", "m/s/s", "m/sec^2"),
    "mm/s^2": ("mmps2", "mm/s2", "mm/s/s"),
    "rad/s^2": ("rad/s2", "radps2", "rad/s/s"),
    "deg/s^2": ("deg/s2", "dps2", "°/s^2"),
    "degC": ("°c", "celsius", "c"),
    "degF": ("°f", "fahrenheit"),
    "K": ("kelvin",),
    "Nm": ("n-m", "newtonmeters", "newton-meters"),
    "%": ("percent", "pct", "duty"),
    "pu": ("p.u.",),
}
_CANONICAL = [unit for quantity in QUANTITIES.values() for unit in quantity.units]
_KNOWN = {unit.lower(): unit for unit in reversed(_CANONICAL) if unit != "nm"}
_KNOWN |= {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings}
_QUANTITY_OF_UNIT = {unit: name for name, quantity in QUANTITIES.items() for unit in quantity.units}
# Endings without brackets that are units only if the name before them agrees ("current_A", but not
# "phase_A"), because they are also letters that number things, or words ("x_min", "v_in").
_NEEDS_NAME = {
    "A": "i",
    "N": "f",
    "C": "t",
    "K": "t",
    "W": "p",
    "g": "a",
    "Hz": "f",
    "bar": "p",
    "s": "t",
    "min": "t",
}
# Units of time that are also the complete header of its column: "ms" in traces of servo drives, "millis" on
# an Arduino. "us" and "min" are not: they may be a supply voltage and a minimum.
TIME_HEADERS = ("ms", *_SPELLINGS["ms"], *_SPELLINGS["us"])
# Names of a voltage or current before "_m" and "_in", which then stand for the motor and the input.
_ELECTRICAL = re.compile(r"[uvi][a-z]?\d*")

_LONGEST_HEADER = 200  # characters; a longer text is no name with a unit, and the patterns would take long
_BRACKETED = re.compile(r"(?P<name>.*?)[\s_]*[\[(<{]\s*(?P<unit>[^\])>}]*?)\s*[\])>}]\s*")
_AFTER_BLANK = re.compile(r"(?P<name>.*\S)(?:\s+in\s+|[\s_]+)(?P<unit>\S+/\S+)")  # "n in 1/min", "v m/s"
_SUFFIX = re.compile(r"(?P<name>.*[^\s_./])(?:[\s_./]+|\s+in\s+)(?P<unit>[^\s_./]+)")
# Units of speeds and accelerations in names that have no room for a slash: "vel_rad_s", "acc_m_per_s2",
# "feed_mm_min".
_QUOTIENT = re.compile(
    r"(?P<name>.*[^\s_./])[\s_.]+(?P<unit>rad|deg|rev|turns?|mm|cm|m)(?:_per_|/|_)(?P<time>s|sec|min)"
    r"(?P<square>\^?2|²)?",
    re.IGNORECASE,
)
_TOKENS = re.compile(r"[A-ZÄÖÜ]+(?![a-zäöü])|[A-ZÄÖÜ]?[a-zäöüßéèêµ]+")
# Symbols of the joints of a robot, with or without the number of the joint: "q_0", "actual_qd_1", "ddq[2]".
# They are no words: a "voltage q" is that of the quadrature axis.
_JOINT_ROLES = "actual|act|measured|meas|joint|ist|target|desired|des|commanded|cmd|ref|soll"
_JOINT = re.compile(
    rf"(?:(?:{_JOINT_ROLES})_)*(?P<symbol>q|qd|dq|qdd|ddq)_?\d*"
    rf"(?:_(?:{_JOINT_ROLES}|(?P<desired>d)))?(?:_?\d+|\[\d+\])?"
)
_JOINT_QUANTITIES = {
    "q": "position",
    "qd": "speed",
    "dq": "speed",
    "qdd": "acceleration",
    "ddq": "acceleration",
}
_INDEXED = re.compile(r".*[^\W\d]\[\d+\]")  # item of a list, "q[0]", and no unit
_LONG = 5  # letters; a shorter word is recognized only if it stands alone: "pos" is not in "possible"

# Words that say what a value is for. A set point is no measurement, a control error no position.
_SET_POINT = (
    *("target", "setpoint", "set", "reference", "ref", "command", "commanded", "cmd"),
    *("goal", "desired", "des", "demand", "action"),
    *("soll", "sollwert", "vorgabe", "consigne"),
)
_DEVIATION = ("error", "err", "deviation", "regelabweichung")
Role = Literal["set point", "control error", ""]


class Meaning(NamedTuple):
    """What a column of a log contains.

    Attributes:
        quantity: Key of `QUANTITIES`, or "count" for a number without a dimension; "" if the header says
            nothing.
        unit: Unit as `normalize_unit` spells it; "" if the header has none.
        evidence: Whether the quantity follows from the unit, or is guessed from the name alone.
        role: Whether the name says that the value is a set point or a control error.
    """

    quantity: str
    unit: str
    evidence: Evidence
    role: Role

    @property
    def family(self) -> str:
        """Quantity without the kind of motion: "position", "speed" or "acceleration", linear or rotary.

        Any other quantity is its own family; "" if the quantity is unknown.
        """
        quantity = QUANTITIES.get(self.quantity)
        return quantity.family or self.quantity if quantity is not None else self.quantity

    @property
    def in_words(self) -> str:
        """The quantity with an article and its unit, "a current in A"; else "a current by its name"."""
        article = QUANTITIES[self.quantity].article if self.quantity in QUANTITIES else "a"
        words = f"{article} {self.quantity}"
        return (
            f"{words} in {'percent' if self.unit == '%' else self.unit}"
            if self.unit
            else f"{words} by its name"
        )


def normalize_unit(text: str) -> str:
    """Return the usual spelling of a unit: "mm" for "[Millimeters]", "m/s^2" for "m/s²".

    The unit is that of a quantity in `QUANTITIES`, or of a duty cycle, "%" or "pu" (per unit, 1 is the rated
    voltage). A text that is none of them is returned without brackets.
    """
    plain = text.strip().strip("[](){}<>").strip()
    if plain in _QUANTITY_OF_UNIT:
        return plain
    compact = re.sub(r"[\s·*]", "", plain).replace("²", "^2").replace("⁻¹", "^-1").replace("⁻²", "^-2")
    compact = re.sub(r"(?<=[a-z°])(?:s\^?-1)$", "/s", re.sub(r"(?<=[a-z°])(?:s\^?-2)$", "/s^2", compact))
    if compact in _QUANTITY_OF_UNIT:
        return compact
    lower = compact.lower()
    # Points end abbreviations: "deg./s".
    return _KNOWN.get(lower) or _KNOWN.get(lower.replace(".", ""), plain)


def is_unit(text: str) -> bool:
    """Return whether a cell of a row of units is a unit, or a mark such as "[#]" or "-" for no unit."""
    unit = normalize_unit(text)
    return unit in _QUANTITY_OF_UNIT or unit.lower() in _WITHOUT_DIMENSION


def split_unit(header: str) -> tuple[str, str]:
    """Split a column's header into name and unit: "Pos X [mm]", "x_mm", "x (mm)", "x in mm", "vel_rad_s".

    Returns:
        name: Name without the unit.
        unit: Unit in its usual spelling, such as "mm" or "rpm"; "" if the header has none. Any text in
            brackets is a unit. Without brackets, only known units are recognized, and those of one letter,
            such as "A", only if the name agrees: "current_A" and "i1_A" have a unit, "phase_A" has none. The
            word rpm is a unit wherever it is, and "ms", "millis" or "micros" alone are a time.
    """
    plain = header.strip()
    if len(plain) > _LONGEST_HEADER:
        return plain, ""
    match = None if _INDEXED.fullmatch(plain) else _BRACKETED.fullmatch(header)
    if match and match["name"]:
        return match["name"].strip(), normalize_unit(match["unit"])
    match = _QUOTIENT.fullmatch(plain)
    if match:
        per = "min" if match["time"].lower() == "min" else "s"
        unit = normalize_unit(f"{match['unit']}/{per}{'^2' if match['square'] else ''}")
        if unit in _QUANTITY_OF_UNIT:
            return match["name"], unit
    match = _AFTER_BLANK.fullmatch(plain) or _SUFFIX.fullmatch(plain)
    if match and _is_ending(match["name"], match["unit"]):
        return re.sub(r"\s+in$", "", match["name"]).strip(), normalize_unit(match["unit"])
    if "rpm" in _tokens(plain):  # a unit wherever it stands: "RPM", "rpm1", "motorRPM_left"
        return plain, "rpm"
    if plain.lower() in TIME_HEADERS:
        return plain, normalize_unit(plain)
    return plain, ""


def _is_ending(name: str, ending: str) -> bool:
    """Return whether the last part of a header is a unit rather than part of the name."""
    unit = normalize_unit(ending)
    if unit not in _QUANTITY_OF_UNIT:
        return False
    named = _named_quantity(name)
    family = Meaning(named, "", "name", "").family
    same = family == Meaning(_QUANTITY_OF_UNIT[unit], "", "unit", "").family
    if unit in _NEEDS_NAME:
        letter = re.fullmatch(rf"{_NEEDS_NAME[unit]}[a-z]?\d*", name.lower())
        is_unit_itself = ending == unit or len(ending) > 2  # "t_s" and "t_sec", but not "t_S"
        return same or (is_unit_itself and letter is not None)
    if unit in ("m", "in"):
        return same or (not named and _ELECTRICAL.fullmatch(name.lower()) is None)
    return True


@lru_cache(maxsize=4096)
def meaning_of(name: str, unit: str) -> Meaning:
    """Determine what a column contains from its name and its unit.

    The unit decides, unless several quantities have it: percent is a duty cycle unless the name states
    another quantity ("torque [%]"), and "nm" is a length unless the name is that of a torque.

    Args:
        name: Name of the column without its unit.
        unit: Unit in the spelling of `normalize_unit`; "" if none is stated.
    """
    named, role = _named_quantity(name), _role(name)
    quantity = _QUANTITY_OF_UNIT.get(unit, "")
    if unit == "nm" and named == "torque":
        return Meaning("torque", "Nm", "unit", role)
    if quantity == "duty cycle":
        percent_of = named if named not in ("", "voltage", "duty cycle") else quantity
        return Meaning(percent_of, unit, "unit" if percent_of == quantity else "name", role)
    if quantity:
        return Meaning(quantity, unit, "unit", role)
    if unit.lower() in _WITHOUT_DIMENSION and not named:
        return Meaning("count", unit, "unit", role)
    return Meaning(named, "", "name" if named else "", role)


def _tokens(name: str) -> list[str]:
    """Return the words of a name in lower case: "motorRPM_set" has motor, rpm and set."""
    return [token.lower() for token in _TOKENS.findall(name)]


def _is_word(token: str, word: str) -> bool:
    """Return whether a token is a word, or a compound with it at an end ("Motorstrom", "Istposition")."""
    return token == word or (len(word) >= _LONG and (token.startswith(word) or token.endswith(word)))


def _named_quantity(name: str) -> str:
    """Return the quantity that the last matching word of a name stands for; "" if there is none.

    The last word decides: a "torque current" is a current. Therefore "current", which also means "present",
    is overruled by a word after it ("current position").
    """
    joint = _JOINT.fullmatch(name)
    found = _JOINT_QUANTITIES[joint["symbol"]] if joint else ""
    for token in () if joint else _tokens(name):
        longest = 0
        for quantity, entry in QUANTITIES.items():
            for word in entry.words:
                if len(word) > longest and _is_word(token, word):
                    found, longest = quantity, len(word)
    return found


def _role(name: str) -> Role:
    """Return whether a name says that the value is a set point or a control error."""
    joint = _JOINT.fullmatch(name)
    if joint and joint["desired"]:
        return "set point"
    for token in _tokens(name):
        if any(_is_word(token, word) for word in _DEVIATION):
            return "control error"
        if any(_is_word(token, word) for word in _SET_POINT) or token.startswith("soll"):
            return "set point"
    return ""
