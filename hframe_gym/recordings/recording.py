"""Read, validate and write recordings: files that hold one run of a machine each.

The file is a table whose first column is `time_s`, followed by the machine's channels by name in any order.
The cell of an output that was not measured is empty. Errors name file, row (1 is the first row below the
header) and column.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..errors import InputError
from ..files import atomic_file
from ..line_log import LineLog
from ..machine import DRIVE_KINDS, Drive, Machine, Trajectory
from .machine_file.machine_json import load_machine
from .quantities import split_unit
from .tables.table_file import (
    SUFFIXES,
    ForeignFormatError,
    compressed_by_name,
    import_command,
    read_table,
    recording_files,
    refuse_decreasing_times,
    refuse_rows,
)
from .tables.text_reader import Progress, cumulative
from .wrong_units import UNIT_WORDS, refuse_wrong_units

MIN_ROWS = 20_000  # rows that are read of each run; typical runs have fewer
# Endings of files that hold tables as a rule; text files are often notes.
_TABLE_SUFFIXES = (
    *(".csv", ".tsv", ".dat", ".mat", ".parquet", ".gz", ".xlsx", ".xls", ".ods", ".zip", ".7z", ".rar"),
)
_ROWS_PER_WRITE = 50_000  # so many rows are held in memory as text, a few tens of MB
_COMPRESSION = 4  # level of gzip; higher levels take several times as long and save a few percent
_LARGEST_DUTY = 1.05  # the noise of a measured duty cycle may exceed 1
# Limits of a simulation: at its longest step of 0.25 ms, a gap takes 2.4 million steps and a run 350 million.
LONGEST_GAP = 600.0  # s
LONGEST_RUN = 86_400.0  # s
MOST_LOST_ROWS = 20_000_000  # rows that `fill_gaps` may insert, 1 GB


@dataclass(frozen=True)
class Recording:
    """One run of a machine.

    Attributes:
        name: Name of the run: the file name without its ending.
        time_s: Sample times, s, strictly increasing, shape (n,).
        inputs: Command of each drive, V, A, Nm or its set point's unit, held until the next sample, in the
            order of the machine's drives, shape (n, drives). A duty cycle of a file is here a voltage.
        outputs: Measurements in the channels' units, in the order of the machine's sensors,
            shape (n, sensors); NaN where a value was not measured.
    """

    name: str
    time_s: Array
    inputs: Array
    outputs: Array

    def __post_init__(self) -> None:
        """Store rows one after the other, as the compiled code reads them; a transposed table is copied."""
        for name in ("time_s", "inputs", "outputs"):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name)))

    def rows(self, chosen: slice) -> Recording:
        """Return some rows of the run as a run of the same name; their times stay."""
        return Recording(self.name, self.time_s[chosen], self.inputs[chosen], self.outputs[chosen])


def load_recordings(
    folder: str | Path,
    machine: Machine | str | Path,
    progress: Callable[[int, int], None] | None = None,
    *,
    max_rows: int | None = None,
    log: LineLog = print,
) -> list[Recording]:
    """Load and check all recordings of a folder, one run of a machine per file.

    Args:
        folder: Folder of the runs; files with other endings than .csv, .csv.gz and .parquet, and hidden
            files, are ignored.
        machine: Machine that was recorded, or its name or file (`load_machine`); its channels name the
            columns.
        progress: Called with the number of bytes read so far and the total number.
        max_rows: Largest number of rows of all runs together, divided evenly among the runs: of each run, the
            first max_rows / number of runs rows are used, but at least 20,000. Default: all rows are used.
        log: Called with a line of text for each run of which only the beginning is used, and for what else
            lies in the folder that may be runs.

    Returns:
        The runs in the order of their file names.

    Raises:
        InputError: If the folder does not exist or has no recordings, two files are the same run (`a.csv`,
            `a.parquet`), or a file is invalid.
    """
    machine, path = load_machine(machine), Path(folder)
    convert = import_command(path, machine.name)
    if not path.is_dir():
        advice = f"is a file, give the folder of runs; a log becomes runs with {convert}"
        raise InputError(f"{path}: {advice if path.exists() else 'no such folder'}")
    files = recording_files(path)
    if not files:
        others = f"; logs of other formats become runs with {convert}"
        advice = others if any(path.iterdir()) else "; it is empty"
        raise InputError(f"{path}: no recordings ({', '.join(SUFFIXES)}) in this folder{advice}")
    if unread := _possible_runs(path, files):
        log(f"{path}: not read, because recordings end in {', '.join(SUFFIXES)}: {', '.join(unread)}")
    for first, second in pairwise(sorted(files, key=run_name)):
        if run_name(first) == run_name(second):
            raise InputError(
                f"{second}: the run {run_name(second)!r} exists twice, also as {first.name}; delete one"
            )
    add = cumulative(progress, sum(p.stat().st_size for p in files))
    if max_rows is None:
        return [load_recording(p, machine, progress=add) for p in files]
    rows = max(max_rows // len(files), MIN_ROWS)
    recordings = [load_recording(p, machine, progress=add, max_rows=rows + 1) for p in files]
    for i, recording in enumerate(recordings):
        if len(recording.time_s) > rows:
            recordings[i] = recording.rows(slice(rows))
            seconds = recording.time_s[rows - 1] - recording.time_s[0]
            log(f"{recording.name}: only the first {seconds:.4g} s ({rows} rows) are used, see --max-rows")
    return recordings


def _possible_runs(folder: Path, runs: Sequence[Path]) -> list[str]:
    """Return the names of a folder's files that may be runs as well, and of folders in it that have runs."""
    names = []
    for entry in sorted(folder.iterdir()):
        if entry.name.startswith(".") or entry in runs:
            continue
        if entry.is_dir() and (inside := recording_files(entry)):
            names.append(f"{entry.name}/ ({len(inside)} recording{'s' * (len(inside) > 1)})")
        elif entry.is_file() and entry.name.lower().endswith(_TABLE_SUFFIXES):
            names.append(entry.name)
    return names


def load_recording(
    path: str | Path,
    machine: Machine | str | Path,
    *,
    outputs_needed: bool = True,
    progress: Progress | None = None,
    max_rows: int | None = None,
) -> Recording:
    """Load and check one recording: the voltages and measurements of one run of a machine.

    Args:
        machine: Machine that was recorded, or its name or file (`load_machine`).
        outputs_needed: Whether the file must have output columns. False also accepts voltages alone; the
            outputs are then NaN.
        progress: Called with the number of bytes read since the last call.
        max_rows: Number of rows after which reading stops. Default: all rows are read.

    Raises:
        InputError: If the file cannot be read or has no rows, columns are missing or unknown, a time or input
            is empty or infinite, all outputs are empty, times do not increase, a gap exceeds 600 s or the run
            a day, or a channel is in a wrong unit. The message names the file, and row and column where there
            is one.
    """
    machine, path = load_machine(machine), Path(path)
    try:
        header, columns = read_table(path, progress, max_rows)
    except ForeignFormatError as error:
        raise InputError(f"{error}. Convert it: {import_command(path, machine.name)}") from None
    _check_header(path, header, machine, outputs_needed=outputs_needed)
    return recording_from_columns(path, columns, machine)


def recording_from_columns(path: Path, columns: Mapping[str, Array], machine: Machine) -> Recording:
    """Check the columns of a run and arrange them in the order of a machine's channels.

    Args:
        columns: Values by column, shape (n,) each: `time_s` (s), all inputs and any of the outputs, in the
            units that their names state.

    Returns:
        The run: times, shape (n,), inputs, shape (n, drives), and outputs, shape (n, sensors). Outputs
        without a column are NaN.

    Raises:
        InputError: If there are no rows, a time or input is empty or infinite, all outputs are empty, times
            do not increase, a gap exceeds 600 s or the run a day, or a channel is in a wrong unit. The
            message names the file, and row and column where there is one.
    """
    time_s = columns["time_s"]
    if len(time_s) == 0:
        raise InputError(f"{path}: no rows below the header")
    for name, column in columns.items():
        refuse_rows(path, name, column, np.isinf(column), "is infinite; correct the cell")
    for name in ("time_s", *machine.input_channels, *(c for c in machine.supply_channels if c in columns)):
        reason = "is empty. Times and inputs must have no gaps"
        reason += "" if name == "time_s" else "; hframe import keeps the value before it"
        refuse_rows(path, name, columns[name], np.isnan(columns[name]), reason)
    try:
        refuse_decreasing_times(path, time_s)
    except InputError as error:
        raise InputError(f"{error}: {_repair_of_times(path, time_s, machine)}") from None
    _refuse_gaps(path, time_s)
    inputs = np.column_stack([_voltages(path, columns, drive) for drive in machine.drives])
    unmeasured = np.full(len(time_s), np.nan)
    outputs = np.column_stack([columns.get(c, unmeasured) for c in machine.output_channels])
    if any(c in columns for c in machine.output_channels) and np.all(np.isnan(outputs)):
        raise InputError(
            f"{path}, columns {', '.join(machine.output_channels)}: all outputs are empty; "
            "one must be measured"
        )
    recording = Recording(run_name(path), time_s, inputs, outputs)
    refuse_wrong_units(path, recording.outputs, machine)
    return recording


def _repair_of_times(path: Path, time_s: Array, machine: Machine) -> str:
    """Say how times that do not increase can be repaired: a rate repairs repeated times, but no order."""
    if np.any(np.diff(time_s) < 0.0):
        return "are rows in a wrong order? Sort them, or delete those whose time is wrong"
    span = float(time_s[-1] - time_s[0])
    rate = f"{(len(time_s) - 1) / span:.4g}" if span > 0.0 else "1000"
    convert = f"{import_command(path, machine.name)} --map time_s={rate}Hz"
    return f"correct the time or delete the row. If the rows are regular: {convert}"


def _voltages(path: Path, columns: Mapping[str, Array], drive: Drive) -> Array:
    """Return a drive's commands in the unit of simulations: a duty cycle becomes a voltage of the supply."""
    values = columns[drive.channel]
    if not DRIVE_KINDS.get(drive.kind).fraction:
        return values
    reason = (
        "is no duty cycle from -1 to 1; state the factor of counts or percent: hframe import LOGS --out RUNS "
        f"--scale {drive.channel}=FACTOR, 0.01 for percent, 0.0039216 where 255 is the full duty cycle"
    )
    refuse_rows(path, drive.channel, values, np.abs(values) > _LARGEST_DUTY, reason)
    return values * columns.get(drive.supply, np.asarray(drive.rated_voltage))


def recorded_commands(machine: Machine, inputs: Array) -> Array:
    """Convert commands of a simulation to those that a file states, where a duty cycle is a fraction.

    Args:
        inputs: Commands as in `Recording.inputs`, V, A, Nm or the set point's unit, shape (n, drives).

    Returns:
        Commands of the same shape: voltages of drives of the kind "duty-cycle" divided by the rated voltage,
        all others unchanged; `inputs` itself if the machine has no such drive.
    """
    fractions = [DRIVE_KINDS.get(drive.kind).fraction for drive in machine.drives]
    if not any(fractions):
        return inputs
    return np.asarray(inputs / np.where(fractions, [drive.rated_voltage for drive in machine.drives], 1.0))


def _refuse_gaps(path: Path, time_s: Array) -> None:
    """Refuse runs that would take too long to simulate: long gaps, a long duration, or too many lost rows."""
    with np.errstate(over="ignore"):
        steps = np.diff(time_s)
        duration = float(time_s[-1] - time_s[0])
    if len(steps) and steps.max() > LONGEST_GAP:
        row = int(np.argmax(steps)) + 2
        reason = (
            f"{steps.max():.4g} s after row {row - 1}, gaps are at most "
            f"{LONGEST_GAP:g} s: split the run there"
        )
        raise InputError(f"{path}, row {row}, column time_s: {reason}")
    if duration > LONGEST_RUN:
        raise InputError(
            f"{path}: lasts {duration:.4g} s, runs are at most {LONGEST_RUN:g} s: is time_s in s?"
        )
    if len(steps) and duration > (MOST_LOST_ROWS + len(time_s)) * float(np.median(steps)):
        lost = f"gaps of more than {MOST_LOST_ROWS} rows in total at a period of {np.median(steps):.3g} s"
        raise InputError(f"{path}: has {lost}: split the run there")


def write_trajectory(path: str | Path, trajectory: Trajectory, inputs: Array, machine: Machine) -> None:
    """Write a simulated run as a recording, with nine digits, in text.

    Args:
        path: File to write, compressed if it ends in .gz; an existing one is replaced, or unchanged if
            writing fails.
        trajectory: Simulated run of n rows.
        inputs: Its commands as in `Recording.inputs`, V, A, Nm or the set point's unit, shape (n, drives).

    Raises:
        OSError: If the file cannot be written.
    """
    header = ["time_s", *machine.input_channels, *machine.output_channels]
    table = np.column_stack([trajectory.time_s, recorded_commands(machine, inputs), trajectory.outputs])
    with atomic_file(path) as file, compressed_by_name(Path(path), file) as stream:
        np.savetxt(stream, table, fmt="%.9g", delimiter=",", header=",".join(header), comments="")


def write_recording(
    path: Path, recording: Recording, machine: Machine, progress: Progress | None = None
) -> None:
    """Write a recording to a file, from which every number is read back exactly.

    Args:
        path: File to write, .csv, .csv.gz or .parquet; an existing one is replaced, or unchanged if writing
            fails.
        progress: Called with the number of rows written since the last call.

    Raises:
        OSError: If the file cannot be written.
        InputError: If the file is .parquet and pyarrow is not installed.
    """
    names = ["time_s", *machine.input_channels, *machine.output_channels]
    columns = [recording.time_s, *recorded_commands(machine, recording.inputs).T, *recording.outputs.T]
    if path.suffix == ".parquet":
        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError:
            raise InputError(
                f"{path.name}: writing Parquet files needs pip install 'hframe_gym[parquet]'"
            ) from None
        arrays = [pyarrow.array(column, from_pandas=True) for column in columns]
        with atomic_file(path) as raw:
            parquet.write_table(pyarrow.table(dict(zip(names, arrays, strict=True))), raw)
        if progress is not None:
            progress(len(recording.time_s))
        return
    with atomic_file(path) as raw, compressed_by_name(path, raw, _COMPRESSION) as file:
        file.write(f"{','.join(names)}\n".encode("ascii"))
        for begin in range(0, len(recording.time_s), _ROWS_PER_WRITE):
            cells = [_texts(column[begin : begin + _ROWS_PER_WRITE]) for column in columns]
            file.write("".join(f"{row}\n" for row in map(",".join, zip(*cells, strict=True))).encode("ascii"))
            if progress is not None:
                progress(len(cells[0]))


def _texts(values: Array) -> list[str]:
    """Return the shortest text of each value from which the same number is read; "" for NaN."""
    texts = list(map(repr, values.tolist()))
    for row in np.flatnonzero(np.isnan(values)).tolist():
        texts[row] = ""
    return texts


def run_name(path: Path) -> str:
    """Return the name of a run: its file name without folder and without .csv, .csv.gz or .parquet."""
    for suffix in SUFFIXES:
        if path.name.endswith(suffix):
            return path.name.removesuffix(suffix)
    return path.name


def _machine_question(path: Path) -> str:
    """Return the question if the right machine was named, with the machine file beside a run or folder."""
    files = [file for folder in path.parents[:2] if (file := folder / "machine.json").is_file()]
    beside = f"; {files[0]} lies beside them" if files else ""
    return f"Is this the machine of the recordings (--machine{beside})?"


def _check_header(path: Path, header: list[str], machine: Machine, *, outputs_needed: bool) -> None:
    """Refuse a header with unknown, repeated or missing columns."""
    expected = ["time_s", *machine.input_channels, *machine.output_channels]
    channels = f"machine {machine.name!r} has {', '.join(expected)}"
    convert = import_command(path, machine.name)
    for name in header:
        if header.count(name) > 1:
            raise InputError(f"{path}, column {name}: appears twice")
        if name in expected or name in machine.supply_channels:
            continue
        plain_name, unit = split_unit(name)
        wanted = [c for c in expected if split_unit(c)[0].lower() == plain_name.lower()]
        if unit and wanted and unit != split_unit(wanted[0])[1]:
            wrong = f"is in {UNIT_WORDS.get(unit, unit)}; recordings have {wanted[0]}"
            raise InputError(f"{path}, column {name}: {wrong}. Convert it: {convert}")
        advice = f"{_machine_question(path)} If it is, rename the column or leave it out: {convert}"
        raise InputError(f"{path}, column {name}: unknown; {channels}. {advice}")
    missing = [name for name in expected if name not in header]
    if not outputs_needed and not set(header) & set(machine.output_channels):
        missing = [name for name in missing if name not in machine.output_channels]
    if missing:
        advice = f"; a channel that was not measured is an empty column, which {convert} adds"
        if missing[0] not in machine.output_channels:
            advice = f"; {channels}. {_machine_question(path)} If it is, the column must be recorded"
        raise InputError(f"{path}, column {missing[0]}: missing (the header has {', '.join(header)}){advice}")
    if header[0] != "time_s":
        raise InputError(f"{path}, column {header[0]}: the first column must be time_s")
