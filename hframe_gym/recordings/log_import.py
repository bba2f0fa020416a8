"""Convert logs of controllers and data loggers to recordings, one run per log or cut where the machine rests."""

from __future__ import annotations

import dataclasses
import gzip
import tomllib
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from ..atomic_files import atomic_file, output_batch
from ..errors import InputError
from ..file_limits import read_document, read_json
from ..machine import Machine
from .cleaning import GAP_PERIODS
from .log_conversion import LogConverter, split_at_rests
from .log_file import Log, find_logs, log_name, open_log
from .log_mapping import TIME, ChannelSource, MappingOptions, map_columns
from .measurement_units import parse_factor
from .recording import Recording, run_name
from .table_file import SUFFIXES, Array
from .text_reader import Progress

RunFormat = Literal["csv.gz", "csv", "parquet"]
Say = Callable[[str], None]

_ROWS_PER_WRITE = 50_000
_LONG_RUN = 60.0  # s
_COMPRESSION = 4  # of gzip; higher levels take several times as long for a few percent


@dataclass(frozen=True)
class ImportSettings:
    """How logs become recordings.

    Attributes:
        mapping: What the user states about the columns.
        split: Whether to cut the logs into runs at their rests.
        min_rest: Shortest rest at which a log is cut, s.
        run_format: Format of the recordings.
    """

    mapping: MappingOptions = field(default_factory=MappingOptions)
    split: bool = False
    min_rest: float = 0.5
    run_format: RunFormat = "csv.gz"


def import_logs(
    logs: str | Path,
    out: str | Path,
    machine: Machine,
    settings: ImportSettings = ImportSettings(),
    say: Say = print,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Convert logs, which a controller or data logger wrote, to recordings of a machine, the input of identification.

    The recordings appear in the folder together after all logs have been converted, so that a faulty log leaves it
    unchanged.

    Args:
        logs: A log, or a folder of logs.
        out: Folder for the recordings; created if it does not exist. Existing runs are never replaced.
        machine: Machine that was logged; the names of its input and output channels are the columns of the recordings.
        settings: Mapping of columns, and whether to cut the logs into runs.
        say: Called with a line of text for everything that was done or assumed.
        progress: Called with the work done and the total work, both in bytes that are read and written.

    Returns:
        Files of the recordings.

    Raises:
        InputError: If a log is invalid, its columns cannot be assigned, or a run of the same name exists in the folder.
            Nothing is written then.
    """
    paths, others = find_logs(logs)
    folder = Path(out)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--out {folder}: is a file, but must be a folder")
    existing = {run_name(p) for p in folder.iterdir() if p.name.endswith(SUFFIXES)} if folder.exists() else set()
    if others:
        say(f"not read, no logs by their ending: {', '.join(p.name for p in others)}")
    # Reading and writing take about the same time.
    total, done = 2 * sum(path.stat().st_size for path in paths), 0

    def add(count: int) -> None:
        nonlocal done
        done += count
        if progress is not None:
            progress(done, total)

    importer = _Importer(machine, settings, say, add)
    written: list[Path] = []
    with output_batch(folder):
        for path in paths:
            for run in importer.runs(path):
                if run.name in existing:
                    raise InputError(f"{folder}: the run {run.name!r} exists; choose another --out or delete it")
                file = folder / f"{run.name}.{settings.run_format}"
                write_recording(file, run, machine, importer.count_rows)
                written.append(file)
    return written


def read_mapping_file(path: str | Path) -> MappingOptions:
    """Read a mapping file, which assigns a column of a log and its unit to each channel of the machine.

    It is TOML or JSON with up to three tables: `map` (column of each channel), `unit` and `scale` (factor).

    Args:
        path: File ending in .toml or .json.

    Returns:
        Columns, units and factors by channel, for `map_columns`.

    Raises:
        InputError: If the file cannot be read or has other tables or values. The message names file and field.
    """
    path = Path(path)
    try:
        is_json = path.suffix.lower() == ".json"
        content = read_json(path) if is_json else tomllib.loads(read_document(path, "utf-8-sig"))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{path}: is not a valid TOML file: {error}") from None
    tables: dict[str, dict[str, str | float]] = {"map": {}, "unit": {}, "scale": {}}
    for name, table in content.items() if isinstance(content, dict) else ():
        if name not in tables or not isinstance(table, dict):
            raise InputError(f"{path}, {name}: a mapping has the tables {', '.join(tables)}")
        tables[name] = table
    scales = {channel: parse_factor(f"{path}, scale.{channel}", factor) for channel, factor in tables["scale"].items()}
    columns, units = ({c: str(value) for c, value in tables[name].items()} for name in ("map", "unit"))
    return MappingOptions(columns, units, scales)


def write_recording(path: Path, recording: Recording, machine: Machine, progress: Progress | None = None) -> None:
    """Write a recording to a file, from which every number is read back exactly.

    Args:
        path: File to write: .csv, .csv.gz (compressed) or .parquet.
        recording: Run to write (times, s; voltages, V; measurements, m or rad); NaN becomes an empty cell.
        machine: Machine that was recorded; its channels name the columns.
        progress: Called with the number of rows written since the last call.

    Raises:
        OSError: If the file cannot be written.
        InputError: If a Parquet file is written without pyarrow.
    """
    names = [TIME, *machine.input_channels, *machine.output_channels]
    columns = [recording.time_s, *recording.inputs.T, *recording.outputs.T]
    if path.suffix == ".parquet":
        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError:
            raise InputError(f"{path.name}: writing Parquet files needs pip install 'hframe_gym[parquet]'") from None
        arrays = [pyarrow.array(column, from_pandas=True) for column in columns]
        with atomic_file(path) as raw:
            parquet.write_table(pyarrow.table(dict(zip(names, arrays, strict=True))), raw)
        if progress is not None:
            progress(len(recording.time_s))
        return
    with atomic_file(path) as raw:
        # Without name and time, equal recordings are equal files.
        packed = gzip.GzipFile("", "wb", _COMPRESSION, raw, mtime=0) if path.suffix == ".gz" else None
        with packed or nullcontext(raw) as file:
            file.write(f"{','.join(names)}\n".encode("ascii"))
            for begin in range(0, len(recording.time_s), _ROWS_PER_WRITE):
                cells = [_texts(column[begin : begin + _ROWS_PER_WRITE]) for column in columns]
                file.write("".join(f"{row}\n" for row in map(",".join, zip(*cells, strict=True))).encode("ascii"))
                if progress is not None:
                    progress(len(cells[0]))


def _texts(values: Array) -> list[str]:
    """Return the shortest texts that read back as the values; NaN is empty."""
    texts = list(map(repr, values.tolist()))
    for row in np.flatnonzero(np.isnan(values)).tolist():
        texts[row] = ""
    return texts


class _Importer:
    """Converts logs one after the other and says what it does."""

    def __init__(self, machine: Machine, settings: ImportSettings, say: Say, progress: Progress) -> None:
        self._machine, self._settings, self._say, self._progress = machine, settings, say, progress
        self._converter = LogConverter(machine)
        self._said: list[str] = []
        self._bytes_per_row = 0.0

    def runs(self, path: Path) -> list[Recording]:
        """Convert a log and return its runs."""
        log = open_log(path)
        sources = map_columns(log, self._machine, self._settings.mapping)
        self._say_mapping(log, sources)
        recording, remarks = self._converter.convert(log, sources, self._progress)
        recording = dataclasses.replace(recording, name=log_name(path))
        self._bytes_per_row = path.stat().st_size / len(recording.time_s)
        remarks += _clock_remarks(recording.time_s)
        runs = [recording]
        if self._settings.split:
            runs, more = split_at_rests(recording, self._machine, self._settings.min_rest)
            remarks += more
        elif recording.time_s[-1] - recording.time_s[0] > _LONG_RUN:
            remarks.append("a long run; --split-at-rests cuts it into several, which identification needs")
        for remark in remarks:
            self._say(f"  {remark}")
        return runs

    def count_rows(self, rows: int) -> None:
        """Report rows of the last log as written."""
        self._progress(round(rows * self._bytes_per_row))

    def _say_mapping(self, log: Log, sources: Sequence[ChannelSource]) -> None:
        """Say the format of a log and the origin of each channel, unless they are as in the log before."""
        lines = [f"  {remark}" for remark in log.remarks]
        width = max(len(source.channel) for source in sources)
        for source in sources:
            origin = source.column.header if source.column else "no column"
            remark = f" ({source.remark})" if source.remark else ""
            lines.append(f"  {source.channel:{width}} <- {origin}{remark}")
        used = [source.column for source in sources]
        unused = [column.header for column in log.columns if column not in used]
        lines += [f"  not used: {', '.join(unused)}"] if unused else []
        if lines == self._said:
            self._say(f"{log.path.name}: format and columns as before")
        else:
            self._say(f"{log.path.name}:")
            for line in lines:
                self._say(line)
        self._said = lines


def _clock_remarks(time_s: Array) -> list[str]:
    """Return rows, duration, rate and gaps in words."""
    steps = np.diff(time_s)
    if len(steps) == 0:
        return [f"{len(time_s)} row"]
    period = float(np.median(steps))
    remarks = [f"{len(time_s)} rows, {time_s[-1] - time_s[0]:.4g} s at {1 / period:.4g} Hz"]
    gaps = np.flatnonzero(steps > GAP_PERIODS * period)
    if len(gaps):
        longest = gaps[np.argmax(steps[gaps])]
        lost = float(np.sum(steps[gaps]) - len(gaps) * period)
        plural = "s" if len(gaps) > 1 else ""
        where = f"the longest {steps[longest]:.3g} s at time_s = {time_s[longest]:.6g}"
        remarks.append(f"{len(gaps)} gap{plural} in time, {lost:.3g} s lost in total, {where}")
    return remarks
