"""Convert logs of a controller or data logger to recordings.

Each log becomes one run, or several, cut where the machine rests or into pieces of equal duration.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from ...arrays import Array
from ...errors import InputError, name_runs
from ...files import output_batch, output_folder, read_document, read_json
from ...line_log import LineLog
from ...machine import Machine
from ...operating_system import quoted
from ..cleaning import missing_rows, usual_step
from ..recording import Recording, run_name, write_recording
from ..tables.table_file import SUFFIXES
from ..tables.text_reader import Progress, cumulative
from .foreign_files import refuse_foreign_file
from .log import Log, headers_text
from .log_conversion import EmptyLogError, LogConverter
from .log_files import find_logs, log_size, start_of
from .log_join import open_joined
from .log_mapping import ChannelSource, MappingOptions, map_columns
from .log_rests import split_at_rests
from .measurement_units import channel_dimension

RunFormat = Literal["csv.gz", "csv", "parquet"]

# s; a single motion takes a few seconds, so that a longer log probably holds several, with rests between
# them.
_LONG_RUN = 60.0
_UNUSED_ROWS = 20  # columns that are not used and get a row of the table; logs of machine tools have hundreds


class Interval(NamedTuple):
    """Part of a log that becomes a run.

    Attributes:
        log: Name of the log's file without its ending; "" for every log.
        begin: First time, s, in the times of the recording.
        end: Last time, s.
    """

    log: str
    begin: float
    end: float


def parse_interval(text: str) -> Interval:
    """Read a time interval, s, of the option --cut: "FROM:TO", or "LOG=FROM:TO" for one of several logs.

    Raises:
        InputError: If the text is not of this form, or the end is not after the beginning.
    """
    name, _, span = text.rpartition("=")
    first, _, last = span.partition(":")
    try:
        interval = Interval(name.strip(), float(first), float(last))
    except ValueError:
        raise InputError(
            f"--cut {text}: write FROM:TO or LOG=FROM:TO with times in s, such as 2.5:10"
        ) from None
    if not interval.begin < interval.end:  # also if one is not a number
        raise InputError(f"--cut {text}: the end must be after the beginning")
    return interval


@dataclass(frozen=True)
class ImportSettings:
    """Settings of the conversion of logs to recordings.

    Attributes:
        mapping: Column, unit and factor that the user assigned to channels.
        split: Whether to cut each log into runs where the machine rests.
        min_rest: Shortest rest at which a log is cut, s.
        run_format: Ending of the recordings' files, which selects their format.
        every: Approximate length of the runs into which each log is cut, s, also where the machine moves.
            None: logs are not cut into equal pieces.
        intervals: Parts of the logs that become runs; a log for which there is none is imported whole.
        join: Files whose columns belong to each log, such as that of the commands; see `--join`.
    """

    mapping: MappingOptions = field(default_factory=MappingOptions)
    split: bool = False
    min_rest: float = 0.5
    run_format: RunFormat = "csv.gz"
    every: float | None = None
    intervals: tuple[Interval, ...] = ()
    join: tuple[Path, ...] = ()


def import_logs(
    logs: str | Path | Sequence[str | Path],
    out: str | Path,
    machine: Machine,
    settings: ImportSettings = ImportSettings(),
    log: LineLog = print,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Convert the logs of a controller or data logger to recordings of a machine.

    The recordings are moved into the folder together, after all logs have been converted; a faulty log leaves
    the folder unchanged.

    Args:
        logs: A log, a folder of logs, or several of both.
        out: Folder for the recordings; created if it does not exist. Existing runs are never replaced.
        machine: Machine that was logged; the names of its input and output channels are the columns of the
            recordings.
        settings: Columns and units that the user assigned to channels, and whether to cut the logs into runs.
        log: Called with a line of text for everything that is converted, assumed or left out.
        progress: Called with the work done and the total work, both in bytes of the logs; reading and writing
            count once each.

    Returns:
        Files of the recordings, in the order of the logs and of the times in each.

    Raises:
        InputError: If a log is invalid, its columns cannot be assigned, or a run of the same name exists in
            the folder. In all these cases nothing is written.
        OSError: If the folder cannot be written.
    """
    if settings.split and settings.every is not None:
        raise InputError("--split-at-rests and --split-every exclude each other: choose one")
    if settings.intervals and (settings.split or settings.every is not None):
        raise InputError("--cut and --split-at-rests or --split-every exclude each other: choose one")
    sources = [logs] if isinstance(logs, str | Path) else list(logs)
    found = [find_logs(source) for source in sources]
    paths = list(dict.fromkeys(path for logs_of_source, _ in found for path in logs_of_source))
    other_files = [path for _, others in found for path in others]
    joined = {path.resolve() for path in settings.join}
    paths = [path for path in paths if path.resolve() not in joined]
    folder = output_folder(out)
    existing = (
        {run_name(p) for p in folder.iterdir() if p.name.endswith(SUFFIXES)} if folder.exists() else set()
    )
    _report_skipped(other_files, log)
    # Each byte counts twice: once for reading, once for writing, which take about as long.
    total = 2 * sum(map(log_size, paths))
    several = len(paths) + len(existing) > 1
    importer = _Importer(machine, settings, log, cumulative(progress, total), several, len(paths) > 1)
    written: list[Path] = []
    with output_batch(folder):
        for path in paths:
            for run in importer.runs(path):
                if run.name in existing:
                    raise InputError(
                        f"{folder}: the run {run.name!r} exists; choose another --out or delete it"
                    )
                file = folder / f"{run.name}.{settings.run_format}"
                if file in written:
                    raise InputError(
                        f"{path}: another log has given the run {run.name!r}; choose another --out for it"
                    )
                write_recording(file, run, machine, importer.count_rows)
                written.append(file)
        if not written:
            raise InputError(
                f"{', '.join(map(str, sources))}: none of its {len(paths)} logs has rows below the header"
            )
        importer.refuse_unused_intervals()
    if others := importer.of_these_logs(existing):
        before = f"{folder} has runs of these logs from before ({name_runs(others)})"
        log(f"{before}: delete them unless they are other recordings")
    return written


def _report_skipped(files: Sequence[Path], log: LineLog) -> None:
    """Report what is not imported of a folder; of spreadsheets and archives, say what to do with them."""
    others = []
    for file in files:
        try:
            refuse_foreign_file(file, start_of(file))
        except InputError as error:
            log(f"skipped: {error}")
        else:
            others.append(file.name + "/" * file.is_dir())
    if others:
        log(f"skipped (by their names or content, no logs): {', '.join(others)}")


def read_mapping_file(path: str | Path) -> MappingOptions:
    """Read a mapping file, which assigns a column of a log and its unit to each channel of the machine.

    It has up to three tables with entries CHANNEL = VALUE: `map` (name of the column in the log), `unit`
    (unit of the column) and `scale` (factor, applied after the conversion from `unit`). In TOML, for example:
    map.v1_V = "U1", unit.phi1_rad = "deg", scale.x_m = 0.001.

    Raises:
        InputError: If the file cannot be read or has other tables or values. The message names file and
            field.
    """
    path = Path(path)
    try:
        is_json = path.suffix.lower() == ".json"
        content = read_json(path) if is_json else tomllib.loads(read_document(path))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{path}: is not a valid TOML file: {error}") from None
    tables: dict[str, dict[str, Any]] = {"map": {}, "unit": {}, "scale": {}}
    contents = "a mapping file may have map, unit and scale, each with entries CHANNEL = VALUE"
    if not isinstance(content, dict):
        raise InputError(f"{path}: has no tables; {contents}")
    for name, table in content.items():
        if name not in tables or not isinstance(table, dict):
            raise InputError(
                f"{path}, {name}: {'not a table' if name in tables else 'unknown table'}; {contents}"
            )
        tables[name] = table
    scales = {
        channel: parse_factor(f"{path}, scale.{channel}", factor)
        for channel, factor in tables["scale"].items()
    }
    for name in ("map", "unit"):
        for channel, value in tables[name].items():
            if not isinstance(value, str):
                advice = 'must be text in quotes, such as "U1"; "#3" is the third column'
                raise InputError(f"{path}, {name}.{channel}: {value!r} {advice}")
    return MappingOptions(tables["map"], tables["unit"], scales)


def parse_factor(where: str, factor: object) -> float:
    """Read a dimensionless factor, a number or a text, by which values of a log's column are multiplied.

    Args:
        where: File and field, or option, that has the factor, for the message.

    Raises:
        InputError: If it is not a number, or its absolute value is not from 1e-30 to 1e30.
    """
    try:
        value = 0.0 if isinstance(factor, bool) else float(factor)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        value = 0.0
    if not 1e-30 <= abs(value) <= 1e30:
        raise InputError(f"{where}: {factor!r} is not a factor; give a number such as 0.001")
    return value


class _Importer:
    """Converts the logs of one session, one by one, and tells the user what it converts or assumes."""

    def __init__(
        self,
        machine: Machine,
        settings: ImportSettings,
        log: LineLog,
        progress: Progress,
        several: bool,
        one_of_many: bool,
    ) -> None:
        self._machine, self._settings, self._log, self._progress = machine, settings, log, progress
        self._several = several  # whether the folder of the recordings will have several runs
        self._one_of_many = one_of_many  # whether other logs are left if one is empty
        self._converter = LogConverter(machine)
        self._last_mapping: list[str] = []
        self._numbered: dict[str, tuple[str, str]] = {}  # log and header that a "#2" of the user first was
        self._names: list[str] = []  # of the logs, before they are cut
        self._bytes_per_row = 0.0

    def runs(self, path: Path) -> Iterator[Recording]:
        """Convert a file and yield its runs, one log of the file after the other."""
        if self._one_of_many and path.is_file() and not path.stat().st_size:
            self._log(f"{path.name}:")
            self._log("  left out: the file is empty")
            return
        logs = open_joined(path, self._settings.join)
        ends = np.linspace(0, log_size(path), len(logs) + 1, dtype=int)
        for log, size in zip(logs, np.diff(ends).tolist(), strict=True):
            yield from self._runs_of(log, size)

    def _runs_of(self, log: Log, size: int) -> list[Recording]:
        """Convert a log, which takes a size in bytes of its file, and return its runs."""
        self._refuse_other_order(log)
        sources = map_columns(log, self._machine, self._settings.mapping)
        self._log_mapping(log, sources)
        try:
            recordings, remarks = self._converted(log, sources, size)
        except EmptyLogError:
            if not self._one_of_many:
                raise
            self._log("  left out: no rows below the header")
            return []
        self._bytes_per_row = size / sum(len(recording.time_s) for recording in recordings)
        for remark in remarks:
            self._log(f"  {remark}")
        return [run for recording in recordings for run in self._cut(recording)]

    def _converted(
        self, log: Log, sources: Sequence[ChannelSource], size: int
    ) -> tuple[list[Recording], list[str]]:
        """Convert a log, and report its size as read, although readers of a part may read the whole file."""
        left = size

        def count(read: int) -> None:
            nonlocal left
            read = min(read, left)
            left -= read
            self._progress(read)

        converted = self._converter.convert(log, sources, count)
        count(size)
        return converted

    def _refuse_other_order(self, log: Log) -> None:
        """Refuse a log in which a user's number is another column than in the logs before, by its name."""
        headers = [column.header for column in log.columns]
        for channel, reference in self._settings.mapping.columns.items():
            for number in re.findall(r"#\d+", reference):
                if not 1 <= int(number[1:]) <= len(headers):
                    continue
                header = headers[int(number[1:]) - 1]
                first, before = self._numbered.setdefault(number, (log.title, header))
                if header != before and before in headers:
                    option = f"--map {quoted(f'{channel}={reference}')}"
                    here = f"column {number[1:]} is {header!r}, and in {first} it is {before!r}"
                    place = f"which is column {headers.index(before) + 1} here"
                    raise InputError(
                        f"{log.place}: {option}: {here}, {place}: name the columns in place of their numbers"
                    )

    def _cut(self, recording: Recording) -> list[Recording]:
        """Return the runs into which a recording is cut, and report its duration."""
        remarks = _clock_remarks(recording.time_s)
        runs = [recording]
        self._names.append(recording.name)
        intervals = [i for i in self._settings.intervals if i.log in ("", recording.name)]
        if intervals:
            runs = _parts(recording, intervals)
            remarks.append(f"cut to {', '.join(f'{i.begin:g} to {i.end:g} s' for i in intervals)}")
        elif self._settings.split:
            runs, split_remarks = split_at_rests(recording, self._machine, self._settings.min_rest)
            remarks += split_remarks
        elif self._settings.every is not None:
            runs = _equal_parts(recording, self._settings.every)
            remarks.append(
                f"cut into runs of {runs[0].time_s[-1] - runs[0].time_s[0]:.3g} s, which may begin in motion"
            )
        elif not self._several and recording.time_s[-1] - recording.time_s[0] >= _LONG_RUN:
            remarks.append(
                f"{_LONG_RUN:g} s or longer: identification needs several runs; "
                "--split-at-rests cuts this one, or --split-every 10 if it has no rests"
            )
        for remark in remarks:
            self._log(f"  {remark}")
        return runs

    def of_these_logs(self, runs: Iterable[str]) -> list[str]:
        """Return the runs that are named as these logs, or as parts of them."""
        parts = (rf"{re.escape(name)}(_\d\d+)?" for name in self._names)
        return sorted(filter(re.compile("|".join(parts)).fullmatch, runs))

    def refuse_unused_intervals(self) -> None:
        """Raise an error if an interval names a log that was not imported."""
        for interval in self._settings.intervals:
            if interval.log and interval.log not in self._names:
                names = ", ".join(self._names)
                raise InputError(f"--cut {interval.log}=...: there is no such log; the logs are {names}")

    def count_rows(self, rows: int) -> None:
        """Report the progress of writing the last log, by its number of rows."""
        self._progress(round(rows * self._bytes_per_row))

    def _log_mapping(self, log: Log, sources: Sequence[ChannelSource]) -> None:
        """Report a log's format and what each column was taken for, unless it is as for the log before."""
        lines = [f"  {line}" for line in (*log.remarks, *_column_table(log, sources, self._machine))]
        if lines == self._last_mapping:
            self._log(f"{log.title}: same format and columns as the log before")
        else:
            self._log(f"{log.title}:")
            for line in lines:
                self._log(line)
        self._last_mapping = lines


def _column_table(log: Log, sources: Sequence[ChannelSource], machine: Machine) -> list[str]:
    """Return lines of a table of the log's columns: quantity, unit, and the channel that each became."""
    rows = [("column", "quantity", "unit", "channel")]
    for source in sources:
        remark = f" ({source.remark})" if source.remark else ""
        if source.column is None:
            rows.append(("none", "", "", f"{source.channel}{remark}"))
            continue
        meaning = source.column.meaning
        quantity = meaning.quantity or channel_dimension(machine, source.channel)
        role = f", {meaning.role}" * bool(meaning.role)
        rows.append(
            (source.column.header, f"{quantity}{role}", source.column.unit, f"{source.channel}{remark}")
        )
    used = [column for source in sources if source.column for column in source.column.in_file]
    unused = [column for column in log.columns if column not in used]
    for column in unused[:_UNUSED_ROWS]:
        role = f", {column.meaning.role}" * bool(column.meaning.role)
        quantity = column.meaning.quantity or ("text" if column.kind == "text" else "")
        rows.append((column.header, f"{quantity}{role}".strip(", "), column.unit, "not used"))
    widths = [max(len(row[k]) for row in rows) for k in range(3)]
    lines = []
    for row in rows:
        cells = [(cell or "-").ljust(width) for cell, width in zip(row, widths, strict=False)]
        lines.append("  ".join([*cells, row[3]]))
    others = unused[_UNUSED_ROWS:]
    return [*lines, f"and {len(others)} more that are not used: {headers_text(others)}"] if others else lines


def _parts(recording: Recording, intervals: Sequence[Interval]) -> list[Recording]:
    """Return the parts of a recording within intervals, named NAME_01, NAME_02, ... if there are several."""
    time_s, runs = recording.time_s, []
    for number, interval in enumerate(intervals, start=1):
        rows = slice(
            np.searchsorted(time_s, interval.begin), np.searchsorted(time_s, interval.end, side="right")
        )
        if len(time_s[rows]) < 2:
            asked, span = (
                f"{_clock_time(begin)} to {_clock_time(end)} s"
                for begin, end in ((interval.begin, interval.end), (time_s[0], time_s[-1]))
            )
            raise InputError(f"{recording.name}: there are no rows from {asked}; it has {span}")
        name = recording.name if len(intervals) == 1 else f"{recording.name}_{number:02d}"
        runs.append(Recording(name, time_s[rows], recording.inputs[rows], recording.outputs[rows]))
    return runs


def _equal_parts(recording: Recording, seconds: float) -> list[Recording]:
    """Cut a recording into runs of about equal duration, s, named NAME_01, NAME_02, ...; their times stay."""
    time_s = recording.time_s
    count = max(1, round(float(time_s[-1] - time_s[0]) / seconds))
    edges = np.searchsorted(time_s, np.linspace(time_s[0], time_s[-1], count + 1)[1:-1])
    digits = max(2, len(str(count)))
    parts = zip(*(np.split(a, edges) for a in (time_s, recording.inputs, recording.outputs)), strict=True)
    return [Recording(f"{recording.name}_{n:0{digits}d}", *part) for n, part in enumerate(parts, start=1)]


def _clock_time(seconds: float) -> str:
    """Write a time, s, to 0.1 ms: that of a clock in epoch seconds has ten digits before the point."""
    return f"{round(float(seconds), 4):.15g}"


def _clock_remarks(time_s: Array) -> list[str]:
    """Return remarks about the number of rows, the duration, the sampling rate and the gaps."""
    steps = np.diff(time_s)
    if len(steps) == 0:
        return [f"{len(time_s)} row"]
    median, usual = float(np.median(steps)), usual_step(time_s)
    # The mean: of stamps in whole ms, the median is a whole number.
    period = float(np.mean(steps[missing_rows(time_s) == 0]))
    rate = f"{1 / period:.4g} Hz" if usual == median else f"irregular times, up to {1e3 * usual:.3g} ms apart"
    remarks = [f"{len(time_s)} rows, {time_s[-1] - time_s[0]:.4g} s at {rate}"]
    gaps = np.flatnonzero(missing_rows(time_s))
    if len(gaps):
        longest = gaps[np.argmax(steps[gaps])]
        lost = float(np.sum(steps[gaps]) - len(gaps) * usual)
        plural = "s" if len(gaps) > 1 else ""
        where = f"the longest {steps[longest]:.3g} s at time_s = {_clock_time(time_s[longest])}"
        remarks.append(f"{len(gaps)} gap{plural} in time, {lost:.3g} s lost in total, {where}")
    return remarks
