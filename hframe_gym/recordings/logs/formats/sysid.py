"""Read the JSON files of SysId, the identification tool of WPILib: up to four tests, each a run.

The file has an object with the entries "sysid" (true), "test" (kind of the mechanism), "units" and
"unitsPerRotation", and a list of rows for each test. Positions and velocities are in rotations; a rotation is
`unitsPerRotation` of `units`. The angle of the gyroscope is in radians.

Files of frc-characterization, which SysId replaced, have the same tests without the entry "sysid", and
further columns. Most of them do not state the unit of positions, which the robot's program chose.

Logs of a robot mark the tests by a text in each row, such as "dynamic-forward", or "none" between them
(`tests_of_states`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from typing_extensions import override

from ....arrays import Array
from ....errors import InputError
from ....files import read_document, read_json, refuse_many_values
from ..foreign_files import is_json
from ..log import Log, vector_log
from .base import KNOWN_CONTENT, LOG_FORMATS, LogFormat

Place = TypeVar("Place", int, float)  # of a test: row or time, s
STATES = ("quasistatic-forward", "quasistatic-reverse", "dynamic-forward", "dynamic-reverse")
NO_TEST = "none"
TESTS = ("slow-forward", "slow-backward", "fast-forward", "fast-backward")
# Unit in which positions are given, and its number in one of the entry "units".
_UNITS = {
    "meters": ("m", 1.0),
    "feet": ("m", 0.3048),
    "inches": ("m", 0.0254),
    "radians": ("rad", 1.0),
    "degrees": ("deg", 1.0),
    "rotations": ("rev", 1.0),
}
_TWO_SIDES = tuple(
    f"{side} {column}" for column in ("voltage [V]", "position *", "velocity *") for side in "lr"
)
# Columns by their number, with the columns in the file's unit marked by a star.
_COLUMNS = {
    4: ("timestamp [s]", "voltage [V]", "position *", "velocity *"),
    9: ("timestamp [s]", *_TWO_SIDES, "angle [rad]", "angular rate [rad/s]"),
}
_FRC_CHARACTERIZATION_COLUMNS = {
    6: ("timestamp [s]", "battery [V]", "autospeed", "voltage [V]", "position *", "velocity *"),
    9: ("timestamp [s]", "battery [V]", "autospeed", *_TWO_SIDES),
    10: ("timestamp [s]", "battery [V]", "autospeed", *_TWO_SIDES, "angle [rad]"),
}
_ADVICE = "of JSON files only those of WPILib's SysId are read; export a table as CSV, one row per sample"


def are_states(texts: Iterable[str]) -> bool:
    """Return whether the texts of a column mark tests of SysId.

    They do if all are states of a test (`STATES`, such as "dynamic-forward") or "none", and not all are
    "none".
    """
    different = set(texts)
    return different <= {*STATES, NO_TEST} and not different <= {NO_TEST}


def tests_of_states(states: Sequence[str]) -> list[tuple[str, int, int]]:
    """Find the tests of SysId in the state of each row: successive rows of one state other than "none".

    Returns:
        State, index of the first row, and index after the last row of each test.
    """
    changes = [k for k in range(len(states)) if k == 0 or states[k] != states[k - 1]]
    ends = [*changes[1:], len(states)]
    return [
        (states[first], first, end)
        for first, end in zip(changes, ends, strict=True)
        if states[first] != NO_TEST
    ]


def numbered(tests: Sequence[tuple[str, Place, Place]]) -> list[tuple[str, Place, Place]]:
    """Make names of tests unique: those that occur more than once get a number, "dynamic-forward_2".

    Args:
        tests: Name, begin and end of each test; the ends are rows, or times in s.

    Returns:
        The tests in the same order with their new names.
    """
    counts, numbers = Counter(name for name, _, _ in tests), Counter[str]()
    different = []
    for name, begin, end in tests:
        numbers[name] += 1
        different.append((f"{name}_{numbers[name]}" if counts[name] > 1 else name, begin, end))
    return different


@LOG_FORMATS.register("sysid")
class SysIdLogs(LogFormat):
    """JSON files of SysId and frc-characterization; JSON of another kind is refused with advice."""

    suffixes = (".json",)
    precedence = KNOWN_CONTENT

    @override
    def recognizes(self, path: Path, start: bytes) -> bool:
        """Recognize JSON, except compressed JSON, which belongs to Klipper's data_logger."""
        return is_json(path, start) and not path.name.lower().endswith(".gz")

    @override
    def is_log(self, path: Path) -> bool:
        """Return whether a JSON file has rows of at least one test of SysId or frc-characterization."""
        try:
            text = read_document(path)
            return any(f'"{name}"' in text for name in TESTS) and _tests(read_json(path)) != {}
        except InputError:
            return False

    @override
    def open(self, path: Path) -> list[Log]:
        """Read the tests that have rows, slow ones first.

        Raises:
            InputError: If the file is no valid JSON, or has no tests.
        """
        try:
            content = read_json(path)
        except InputError as error:
            raise InputError(f"{error}; {_ADVICE}") from None
        tests = _tests(content)
        if not tests:
            raise InputError(f"{path}: is a JSON file without tests of SysId; {_ADVICE}")
        is_sysid = "sysid" in content
        unit, factor = _unit(path, content) if is_sysid or "units" in content else ("", 1.0)
        of_unit = (
            f"1 rotation is {factor:.6g} {unit}" if unit else "which does not state the unit of its positions"
        )
        program = (
            f"SysId file ({content.get('test', 'mechanism')})" if is_sysid else "file of frc-characterization"
        )
        layouts = _COLUMNS if is_sysid else _FRC_CHARACTERIZATION_COLUMNS
        return [
            vector_log(
                path, _columns(path, name, rows, layouts, unit, factor), f"a {program}, {of_unit}", name
            )
            for name, rows in tests.items()
        ]


def _tests(content: Any) -> dict[str, list[Any]]:
    """Return the rows of each test that has some; empty if the content is of another kind."""
    if not isinstance(content, dict) or content.get("sysid", True) is not True:
        return {}
    return {name: content[name] for name in TESTS if isinstance(content.get(name), list) and content[name]}


def _unit(path: Path, content: dict[str, Any]) -> tuple[str, float]:
    """Return the unit of positions, and their value after one rotation."""
    units: Any = content.get("units")
    per_rotation: Any = content.get("unitsPerRotation")
    if not isinstance(units, str) or units.lower() not in _UNITS:
        raise InputError(
            f"{path}, units: {units!r} is none of Meters, Feet, Inches, Radians, Degrees, Rotations"
        )
    if type(per_rotation) not in (int, float) or not 1e-30 <= abs(per_rotation) <= 1e30:
        raise InputError(f"{path}, unitsPerRotation: {per_rotation!r} is not a number of units")
    unit, factor = _UNITS[units.lower()]
    return unit, float(per_rotation) * factor


def _columns(
    path: Path, name: str, rows: list[Any], layouts: dict[int, tuple[str, ...]], unit: str, factor: float
) -> list[tuple[str, Array]]:
    """Return headers with units and values, shape (rows,) each, of the columns of a test."""
    width = len(rows[0]) if isinstance(rows[0], list) else 0
    if width not in layouts:
        raise InputError(f"{path}, {name}, row 1: must be a list of {' or '.join(map(str, layouts))} numbers")
    refuse_many_values(path, len(rows), width)
    for number, row in enumerate(rows, start=1):
        if (
            not isinstance(row, list)
            or len(row) != width
            or not all(type(cell) in (int, float) for cell in row)
        ):
            raise InputError(f"{path}, {name}, row {number}: must be a list of {width} numbers, as row 1")
    try:
        table = np.array(rows, dtype=np.float64)
    except OverflowError:
        raise InputError(
            f"{path}, {name}: has an integer beyond the range of floating-point numbers"
        ) from None
    columns = []
    for column, values in zip(layouts[width], table.T, strict=True):
        per_second = "/s" if "velocity" in column else ""
        header = column.replace(" *", f" [{unit}{per_second}]" if unit else "")
        columns.append((header, np.ascontiguousarray(values * factor if column.endswith(" *") else values)))
    return columns
