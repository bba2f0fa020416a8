"""Recordings: one run of a rig a file, read with care.

The format is a table whose first column is `time_s`, with the machine's channels by name in any order.  An output that
was not measured is blank.  Whatever is wrong is said with file, row (1 is the first below the header) and column.
"""

from __future__ import annotations

import csv
import gzip
import io
import zlib
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..atomic_files import whole_file
from ..dynamics import Trajectory
from ..errors import InputError
from ..machine import Machine

SUFFIXES = (".csv", ".csv.gz", ".parquet")
# A unit that the contract does not use, by the ending that gives it away: (its name, the right ending).
_FOREIGN_UNITS = {"_mm": ("millimetres", "_m"), "_um": ("micrometres", "_m"), "_deg": ("degrees", "_rad")}
# Readings no H-frame or axis of the kind can have: positions beyond 20 m, angles beyond 2000 turns.
_LARGEST = {"_m": (20.0, "millimetres"), "_rad": (2000 * 2 * np.pi, "degrees")}
# A channel that spans this many times its coordinate's declared range is in another unit, not at another place.
_SPANS = 3.0

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Recording:
    """One run.  time_s (n,); inputs (n, drives), V; outputs (n, sensors), NaN where not measured; channel order is
    the machine's."""

    name: str
    time_s: Array
    inputs: Array
    outputs: Array


def is_recording(path: Path) -> bool:
    """Whether a file's name is that of a recording."""
    return path.name.endswith(SUFFIXES) and not path.name.startswith(".")


def load_recordings(folder: str | Path, machine: Machine) -> list[Recording]:
    """All runs of a folder, by name; other files in it are left alone.

    Raises InputError when there are none, two have one name (`a.csv`, `a.parquet`), or one is at fault.
    """
    path = Path(folder)
    if not path.is_dir():
        raise InputError(f"{path}: {'is a file, give the folder of runs' if path.exists() else 'no such folder'}")
    files = sorted(p for p in path.iterdir() if is_recording(p) and p.is_file())
    if not files:
        raise InputError(f"{path}: no recordings ({', '.join(SUFFIXES)}) in this folder")
    for first, second in pairwise(sorted(files, key=run_name)):
        if run_name(first) == run_name(second):
            raise InputError(f"{second}: the run {run_name(second)!r} is there twice, also as {first.name}")
    return [load_recording(p, machine) for p in files]


def load_recording(path: str | Path, machine: Machine, *, outputs_needed: bool = True) -> Recording:
    """One run of a machine.

    outputs_needed: whether a plain voltage history, without any output column, is refused.

    Raises InputError naming file, row and column for anything the format does not allow.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    header, columns = _read_parquet(path) if path.suffix == ".parquet" else _read_csv(path)
    _check_header(path, header, machine, outputs_needed=outputs_needed)
    time_s = columns["time_s"]
    if len(time_s) == 0:
        raise InputError(f"{path}: no rows")
    for name, column in columns.items():
        _refuse(path, name, column, np.isinf(column), "is infinite")
    for name in ("time_s", *machine.input_channels):
        _refuse(path, name, columns[name], np.isnan(columns[name]), "is blank; only outputs may have gaps")
    backward = np.flatnonzero(np.diff(time_s) <= 0)
    if len(backward):
        row = int(backward[0]) + 2
        kind = "repeats" if time_s[row - 1] == time_s[row - 2] else "goes back"
        raise InputError(
            f"{path}, row {row}, column time_s: {time_s[row - 1]:.9g} {kind} (after {time_s[row - 2]:.9g})"
        )
    inputs = np.column_stack([columns[c] for c in machine.input_channels])
    missing = np.full(len(time_s), np.nan)
    outputs = np.column_stack([columns.get(c, missing) for c in machine.output_channels])
    if any(c in columns for c in machine.output_channels) and np.all(np.isnan(outputs)):
        raise InputError(f"{path}, columns {', '.join(machine.output_channels)}: all outputs are blank")
    for j, channel in enumerate(machine.output_channels):
        for ending, (largest, suspect) in _LARGEST.items():
            if channel.endswith(ending):
                wild = np.abs(np.nan_to_num(outputs[:, j])) > largest
                _refuse(path, channel, outputs[:, j], wild, f"cannot be {ending[1:]}: {suspect}?")
    recording = Recording(run_name(path), time_s, inputs, outputs)
    _refuse_other_units(path, recording, machine)
    return recording


def write_trajectory(path: str | Path, trajectory: Trajectory, inputs: Array, machine: Machine) -> None:
    """Write a simulated run in the recordings' format (.csv or .csv.gz), whole or not at all."""
    header = ["time_s", *machine.input_channels, *machine.output_channels]
    table = np.column_stack([trajectory.time_s, inputs, trajectory.outputs])
    with whole_file(path) as temporary:
        opened = gzip.open(temporary, "wt") if str(path).endswith(".gz") else open(temporary, "w")  # noqa: SIM115
        with opened as file:
            file.write(",".join(header) + "\n")
            np.savetxt(file, table, fmt="%.9g", delimiter=",")


def run_name(path: Path) -> str:
    """A run's name: its file's, without the ending."""
    for suffix in SUFFIXES:
        if path.name.endswith(suffix):
            return path.name.removesuffix(suffix)
    return path.name


def _read_csv(path: Path) -> tuple[list[str], dict[str, Array]]:
    """NumPy's reader where every cell is a number (1e6 rows in 1.5 s), cell by cell where some are blank or wrong."""
    try:
        opened = gzip.open(path, "rb") if path.suffix == ".gz" else open(path, "rb")  # noqa: SIM115
        with opened as file:
            text = file.read().decode("utf-8-sig")
        first, _, body = text.lstrip().partition("\n")
        header = [name.strip() for name in next(csv.reader([first.strip()]), [])]
        if not header:
            raise InputError(f"{path}: empty")
        if not body.strip():
            return header, {name: np.zeros(0) for name in header}
        try:
            table = np.loadtxt(io.StringIO(body), delimiter=",", comments=None, ndmin=2)
        except ValueError:
            return header, _cell_by_cell(path, header, body)
    except (OSError, EOFError, UnicodeDecodeError, csv.Error, zlib.error) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    if table.shape[1] != len(header):
        raise InputError(f"{path}, row 1: {table.shape[1]} cells under {len(header)} columns")
    return header, dict(zip(header, np.ascontiguousarray(table.T), strict=True))


def _cell_by_cell(path: Path, header: list[str], body: str) -> dict[str, Array]:
    rows = [row for row in csv.reader(io.StringIO(body)) if row]
    for number, row in enumerate(rows, start=1):
        if len(row) != len(header):
            raise InputError(f"{path}, row {number}: {len(row)} cells under {len(header)} columns")
    columns: dict[str, Array] = {}
    for j, name in enumerate(header):
        cells = [row[j].strip() or "nan" for row in rows]
        try:
            columns[name] = np.array(cells, dtype=float)
        except ValueError:
            columns[name] = np.array([_number(path, i, name, cell) for i, cell in enumerate(cells, start=1)])
    return columns


def _number(path: Path, row: int, column: str, cell: object) -> float:
    try:
        return float("nan" if cell is None else cell)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise InputError(f"{path}, row {row}, column {column}: {cell!r} is not a number") from None


def _read_parquet(path: Path) -> tuple[list[str], dict[str, Array]]:
    try:
        import pyarrow.parquet as parquet
    except ImportError:
        raise InputError(f"{path}: reading parquet needs the extra: pip install 'hframe_gym[parquet]'") from None
    try:
        table = parquet.read_table(path)
    except Exception as error:
        raise InputError(f"{path}: cannot be read: {' '.join(str(error).split())}") from None
    columns = {}
    for name in table.column_names:
        column = table[name]
        if str(column.type) in ("double", "float", "halffloat") or str(column.type).startswith(("int", "uint")):
            columns[name] = column.cast("double").to_numpy()
        else:
            columns[name] = np.array([_number(path, i, name, v) for i, v in enumerate(column.to_pylist(), start=1)])
    return list(table.column_names), columns


def _check_header(path: Path, header: list[str], machine: Machine, *, outputs_needed: bool) -> None:
    expected = ["time_s", *machine.input_channels, *machine.output_channels]
    for name in header:
        if header.count(name) > 1:
            raise InputError(f"{path}, column {name}: appears twice")
        if name not in expected:
            for ending, (unit, right) in _FOREIGN_UNITS.items():
                if name.endswith(ending) and name.removesuffix(ending) + right in expected:
                    wanted = name.removesuffix(ending) + right
                    raise InputError(f"{path}, column {name}: is in {unit}; recordings have {wanted}")
            raise InputError(f"{path}, column {name}: unknown; machine {machine.name!r} has {', '.join(expected)}")
    missing = [name for name in expected if name not in header]
    voltages_only = not outputs_needed and not set(header) & set(machine.output_channels)
    if voltages_only:
        missing = [name for name in missing if name not in machine.output_channels]
    if missing:
        raise InputError(f"{path}, column {missing[0]}: missing (the header has {', '.join(header)})")
    if header[0] != "time_s":
        raise InputError(f"{path}, column {header[0]}: the first column must be time_s")


def _refuse(path: Path, name: str, column: Array, bad: NDArray[np.bool_], why: str) -> None:
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(f"{path}, row {row + 1}, column {name}: {column[row]:g} {why}")


def _refuse_other_units(path: Path, recording: Recording, machine: Machine) -> None:
    """Catch a channel in millimetres or degrees by its span, and by the ratios that unstretched belts impose."""
    kinds = {s.channel: machine.coordinate(next(iter(s.row))).kind for s in machine.sensors}
    for j, sensor in enumerate(machine.sensors):
        coordinate = machine.coordinate(next(iter(sensor.row)))
        readings = recording.outputs[:, j]
        if coordinate.range is not None and np.isfinite(readings).any():
            span, can = np.nanmax(readings) - np.nanmin(readings), coordinate.range[1] - coordinate.range[0]
            if span > _SPANS * can:
                suspect = "millimetres" if coordinate.kind == "linear" else "degrees"
                raise InputError(
                    f"{path}, column {sensor.channel}: moves by {span:.4g}, {coordinate.name} can move by {can:.4g}: "
                    f"{suspect}?"
                )
    factor = _angle_factor(recording, machine)
    if factor is not None and 25 < factor < 120:
        rotary = [channel for channel, kind in kinds.items() if kind == "rotary"]
        raise InputError(f"{path}, columns {', '.join(rotary)}: {factor:.0f} times what the belts allow: degrees?")
    if factor is not None and 1 / 2000 < factor < 1 / 300:
        linear = [channel for channel, kind in kinds.items() if kind == "linear"]
        raise InputError(
            f"{path}, columns {', '.join(linear)}: {1 / factor:.0f} times what the belts allow: millimetres?"
        )


def _angle_factor(recording: Recording, machine: Machine) -> float | None:
    """Size of the measured pulley travel over that which the measured carriage needs, or None if it did not move."""
    names = {next(iter(s.row)): j for j, s in enumerate(machine.sensors) if len(s.row) == 1}
    expected, found = 0.0, 0.0
    for belt in machine.belts:
        rotary = [c for c in belt.extension if machine.coordinate(c).kind == "rotary"]
        if len(rotary) != 1 or any(c not in names for c in belt.extension):
            continue
        c = rotary[0]
        angle = recording.outputs[:, names[c]] * machine.coordinate(c).radius * belt.extension[c]
        others = sum(f * recording.outputs[:, names[o]] for o, f in belt.extension.items() if o != c)
        both = np.isfinite(angle + others)
        if both.sum() > 2:
            expected += float(np.std(np.asarray(others)[both]))
            found += float(np.std(angle[both]))
    return found / expected if expected > 1e-3 else None
