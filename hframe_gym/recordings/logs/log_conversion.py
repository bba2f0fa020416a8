"""Convert the columns of a log to a recording."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...errors import InputError
from ...machine import Machine
from ..cleaning import missing_rows, usual_step
from ..quantization import exact_quantum
from ..recording import Recording, recording_from_columns
from ..tables.table_file import refuse_decreasing_times
from ..tables.text_reader import Progress
from ..wrapping import find_wrap, known_moduli, unwrapped
from ..wrong_units import WrongUnitError
from .log import ROW_NUMBER, Log
from .log_clock import (
    clock_sections,
    continued_counter,
    continued_over_midnight,
    repair_of_times,
    replaced_rows,
)
from .log_files import run_of
from .log_mapping import ChannelSource
from .measurement_units import TIME, Conversion, channel_dimension

Mask = NDArray[np.bool_]
Values = dict[str, NDArray[Any]]  # values of the log's columns by header

# Samples of several time columns that differ by less than this fraction of the shortest sampling period form
# one row.
_SAME_TIME = 1e-3
_MOST_INSERTED = 20  # rows between two merged rows; a longer step is a gap whatever its cause
_LONG_STEP = 0.5  # s; times without a unit at longer steps are probably in another unit than seconds
# Likely unit of times without a unit by their step: below a limit, unit, steps per second. Logs have 20 Hz to
# 20 kHz.
_TIME_UNITS = ((50.0, "ms", 1e3), (50e3, "us", 1e6), (np.inf, "ns", 1e9))


class EmptyLogError(InputError):
    """A log has columns, but no rows, as of a logger that was stopped at once."""


class LogConverter:
    """Converts the logs of one session to recordings with a common clock.

    Attributes:
        day: Midnight before the first time stamp of the first log; the times of all logs count from it. None
            until a time stamp is read.
    """

    def __init__(self, machine: Machine) -> None:
        """Create a converter for the logs of a session."""
        self.machine = machine
        self.day: np.datetime64 | None = None

    def convert(
        self, log: Log, sources: Sequence[ChannelSource], progress: Progress | None = None
    ) -> tuple[list[Recording], list[str]]:
        """Read a log and convert its channels to SI units, in one recording for each start of its clock.

        Channels may have different sampling rates, each rate with its column of time; rows are merged by
        time. Where a channel has no value in a row, a voltage keeps its last value and a measurement is NaN.
        A column of speeds is integrated to positions, from 0 on. Time stamps count from midnight before the
        session's first time stamp.

        Args:
            sources: Columns of the times and of each channel with their conversion to SI, from `map_columns`.
            progress: Called with the number of bytes read since the last call.

        Returns:
            recordings: One recording with the name of the run, or NAME_01, NAME_02, ... if the clock
                restarts: times, s, shape (n,), commands, shape (n, drives), and measurements, shape (n,
                sensors). It begins where all commands have a value.
            remarks: Sentences for the user about rows that were left out, held or merged.

        Raises:
            EmptyLogError: If the log has no rows.
            InputError: If a cell is not a number, times do not increase, or a channel is empty or in a wrong
                unit.
        """
        needed = list({source.column.header: source.column for source in sources if source.column}.values())
        in_file = [column for column in needed if column.kind != ROW_NUMBER]
        values, remarks = log.read(in_file, progress)
        if not any(map(len, values)):
            raise EmptyLogError(f"{log.place}: no rows below the header")
        by_header = {column.header: array for column, array in zip(in_file, values, strict=True)}
        del values  # so that `_columns` can release the arrays
        for counter in (column for column in needed if column.kind == ROW_NUMBER):
            by_header[counter.header] = np.arange(_common_length(log, by_header), dtype=np.float64)
        sections = self._sections(log, sources, by_header, remarks)
        recordings = []
        for number, (first_row, section) in enumerate(sections, start=1):
            name = run_of(log) if len(sections) == 1 else f"{run_of(log)}_{number:02d}"
            try:
                recording = self._recording(log, sources, section, remarks)
            except InputError as error:
                origin = (
                    f"; rows count from row {first_row + 1}, where the clock restarts" if first_row else ""
                )
                raise InputError(f"{error}{origin}") from None
            recordings.append(dataclasses.replace(recording, name=name))
        return recordings, list(dict.fromkeys(remarks))

    def _sections(
        self, log: Log, sources: Sequence[ChannelSource], by_header: Values, remarks: list[str]
    ) -> list[tuple[int, Values]]:
        """Return first row and values of each section between starts of the clock, and report starts."""
        times = [source for source in sources if source.channel == TIME and source.column is not None]
        if len(times) != 1:
            return [(0, by_header)]
        time_s = self._seconds(log, times[0], by_header, [])
        sections = clock_sections(time_s)
        if len(sections) == 1 and sections[0] == slice(0, len(time_s)):
            return [(0, by_header)]
        if len(sections) > 1:
            rows = ", ".join(str(section.start + 1) for section in sections[1:])
            remarks.append(
                f"the clock restarts: cut into {len(sections)} runs (new runs begin in row {rows})"
            )
        left_out = len(time_s) - sum(section.stop - section.start for section in sections)
        if left_out:
            rows = "rows" if left_out > 1 else "row"
            remarks.append(
                f"{left_out} {rows} left out beside a restart of the clock, with fewer than ten times"
            )
        return [
            (rows.start, {header: values[rows] for header, values in by_header.items()}) for rows in sections
        ]

    def _recording(
        self, log: Log, sources: Sequence[ChannelSource], by_header: Values, remarks: list[str]
    ) -> Recording:
        """Return the recording of the values between two starts of the clock; append to the remarks."""
        try:
            time_s, columns = self._columns(log, sources, by_header, remarks)
            return recording_from_columns(log.place, {TIME: time_s, **columns}, self.machine)
        except WrongUnitError as error:
            raise InputError(_unit_advice(error, sources)) from None
        except InputError as error:
            message = str(error)
            header_of = {
                s.channel: s.column.header for s in sources if s.column and s.column.header != s.channel
            }
            origins = [
                f"{channel} is the column {header!r}"
                for channel, header in header_of.items()
                if channel in message
            ]
            raise InputError("; ".join([message, *origins])) from None

    def _columns(
        self, log: Log, sources: Sequence[ChannelSource], by_header: Values, remarks: list[str]
    ) -> tuple[Array, dict[str, Array]]:
        """Return times, s, and values of each channel in its unit; append remarks, and empty `by_header`."""
        times = [source for source in sources if source.channel == TIME and source.column is not None]
        tables = [self._table(log, time, sources, by_header, remarks) for time in times]
        if self.day is not None and any(
            time.column is not None and time.column.kind == "stamp" for time in times
        ):
            date = f" of {self.day}" if self.day > np.datetime64("1970-01-01") else ""
            remarks.append(f"time_s counts from midnight{date}; time zones are ignored")
        by_header.clear()  # so that the values of a long log are in memory only once
        if len(tables) > 1:
            _refuse_separate_times(log, times, [time_s for time_s, _ in tables])
            time_s, columns = _without_false_gaps(*_merge(tables), [times for times, _ in tables])
            lengths = [
                f"{len(t)} of {time.column.header}"
                for (t, _), time in zip(tables, times, strict=True)
                if time.column
            ]
            remarks.append(f"several columns of time, merged to {len(time_s)} rows ({', '.join(lengths)})")
        else:
            time_s, columns = tables[0]
        return _hold_inputs(time_s, columns, self.machine, remarks)

    def _table(
        self,
        log: Log,
        time: ChannelSource,
        sources: Sequence[ChannelSource],
        by_header: Values,
        remarks: list[str],
    ) -> tuple[Array, dict[str, Array]]:
        """Return one column of time, s, and the values of its channels, without rows that have no time."""
        time_s = self._seconds(log, time, by_header, remarks)
        has_time = np.isfinite(time_s)
        if not has_time.all():
            count = int(np.sum(~has_time))
            remarks.append(f"{count} row{'s' if count > 1 else ''} without a time left out")
        own = [
            s for s in sources if s.time is not None and s.time.column is time.column and s.column is not None
        ]
        _refuse_other_lengths(log, time, own, by_header)
        repeated = _repeated_rows(time_s, [by_header[s.column.header] for s in own if s.column is not None])
        if repeated.any():
            count = int(np.sum(repeated))
            verb = "s left out that repeat" if count > 1 else " left out that repeats"
            remarks.append(f"{count} row{verb} the row before and its time")
        replaced, remark = (np.zeros_like(repeated), "") if repeated.any() else replaced_rows(time_s)
        remarks += [remark] * bool(remark)
        kept = has_time & ~repeated & ~replaced
        rows = kept if not kept.all() else slice(None)
        time_s = time_s[rows]
        try:
            refuse_decreasing_times(log.place, time_s)
        except InputError as error:
            raise InputError(f"{error}{repair_of_times(time_s)}") from None
        channels = {}
        for source in own:
            assert source.column is not None
            values = by_header[source.column.header][rows]
            if source.channel in self.machine.output_channels and not source.integrate:
                values, remark = self._without_wrap(source.channel, values, time_s)
                remarks += [remark] * bool(remark)
            if source.column.unit == "%" and not source.set_by_user and _is_fraction(values):
                remarks.append(
                    f"{source.channel}: never exceeds 1 %; if 1 is full, add --unit {source.channel}=pu"
                )
            values = source.conversion.apply(values)
            channels[source.channel] = _integrate(time_s, values) if source.integrate else values
        return time_s, channels

    def _without_wrap(self, channel: str, values: Array, time_s: Array) -> tuple[Array, str]:
        """Unwrap the values of an output, in the unit of the log, and say so; return others as given."""
        # Encoders of motors may measure the travel of a carriage, so that turns may wrap in a channel in m as
        # well.
        sensor = self.machine.sensor(channel)
        if not sensor.of_position:
            return values, ""
        angle = channel_dimension(self.machine, channel) == "angle" or sensor.incremental
        measured = values[np.isfinite(values)]
        # Counts have the quantum 1.
        quantum = 1.0 if np.array_equal(measured, np.rint(measured)) else exact_quantum(values)
        wrap = find_wrap(values, known_moduli(quantum, angle=angle))
        if wrap is None:
            return values, ""
        jumps = f"{wrap.jumps} jump{'s' if wrap.jumps > 1 else ''}"
        remark = f"{channel}: starts anew after {wrap.name}, made continuous ({jumps})"
        if wrap.lost:
            remark += f"; {wrap.describe_lost()}"
        return unwrapped(values, wrap.modulus, time_s), remark

    def _seconds(self, log: Log, source: ChannelSource, by_header: Values, remarks: list[str]) -> Array:
        """Return a column's times, s; NaN where a cell is empty. Clocks that start anew are continued."""
        assert source.column is not None
        values = by_header[source.column.header]
        if source.column.kind == "stamp":
            stamps = values[~np.isnat(values)]
            if self.day is None and len(stamps):
                self.day = stamps[0].astype("datetime64[D]")
            nanoseconds = (values - (self.day or np.datetime64(0, "D"))).astype("timedelta64[ns]")
            time_s = np.where(np.isnat(values), np.nan, nanoseconds.astype(np.int64) / 1e9)
        else:
            values, remark = continued_counter(values)
            remarks += [remark] * bool(remark)
            time_s = source.conversion.apply(values)
        time_s, remark = continued_over_midnight(time_s)
        remarks += [remark] * bool(remark)
        finite = time_s[np.isfinite(time_s)]
        step = float(np.median(np.diff(finite))) if len(finite) > 1 else 0.0
        if source.column.kind != "stamp" and source.unit_is_assumed and step >= _LONG_STEP:
            unit, factor = next(
                ((u, f) for longest, u, f in _TIME_UNITS if step < longest), _TIME_UNITS[-1][1:]
            )
            raise InputError(
                f"{log.place}, column {source.column.header}: "
                f"has no unit and steps of {step:g}, which are long for seconds; "
                f"state its unit by --unit {TIME}={unit} (rows at {factor / step:.4g} Hz), or ms, us, ns, s"
            )
        return time_s


def _refuse_other_lengths(
    log: Log, time: ChannelSource, sources: Sequence[ChannelSource], by_header: Values
) -> None:
    """Refuse columns with another number of rows than their time, which are of another, joined file."""
    assert time.column is not None
    rows = len(by_header[time.column.header])
    for source in sources:
        if source.column is not None and (count := len(by_header[source.column.header])) != rows:
            raise InputError(
                f"{log.place}: {source.column.header} has {count} rows, but {time.column.header} has {rows}; "
                "a file without a column of time is joined row by row, "
                "so that both need equally many: add its times to it"
            )


def _repeated_rows(time_s: Array, columns: Sequence[Array]) -> Mask:
    """Return the rows that equal the row before in time and all values; none if one repeats only the time."""
    repeated = np.zeros(len(time_s), np.bool_)
    rows = np.flatnonzero(np.diff(time_s) == 0.0) + 1
    for values in columns:
        now, before = values[rows], values[rows - 1]
        if not np.all((now == before) | (np.isnan(now) & np.isnan(before))):
            return repeated
    repeated[rows] = len(columns) > 0
    return repeated


def _unit_advice(error: WrongUnitError, sources: Sequence[ChannelSource]) -> str:
    """Return the message about values that are probably in another unit, with the options that correct it.

    Stating the unit that the error proposes helps only where a column was read as SI. If the log states
    another unit, or the column is a speed, the values themselves may be wrong.
    """
    wrong = [source for source in sources if source.channel in error.channels and source.column is not None]
    origins = "; ".join(
        f"{source.channel} is the column {source.column.header!r}"
        + (f" ({source.remark})" if source.remark else "")
        for source in wrong
        if source.column is not None
    )
    from_user = [source.channel for source in wrong if source.set_by_user]
    if from_user:
        return (
            f"{error.problem}. Correct --unit {from_user[0]}=UNIT or --scale {from_user[0]}=FACTOR: {origins}"
        )
    read_as_si = [
        source.channel for source in wrong if source.conversion == Conversion() and not source.integrate
    ]
    if read_as_si:
        return (
            f"{error} If so, add {' '.join(f'--unit {channel}={error.unit}' for channel in read_as_si)}: "
            f"{origins}"
        )
    options = f"--unit {wrong[0].channel}=UNIT or --scale {wrong[0].channel}=FACTOR"
    return (
        f"{error.problem}. The values in the log are suspect; check them, or correct their unit by "
        f"{options}: {origins}"
    )


def _integrate(time_s: Array, speed: Array) -> Array:
    """Integrate a speed over time from 0 by the trapezoidal rule; empty cells (NaN) stay empty."""
    from scipy.integrate import cumulative_trapezoid

    measured = np.isfinite(speed)
    position = np.full(len(speed), np.nan)
    if measured.any():
        position[measured] = cumulative_trapezoid(speed[measured], time_s[measured], initial=0.0)
    return position


def _is_fraction(values: Array) -> bool:
    """Return whether values in percent are probably fractions of 1: none exceeds 1, some reach 0.1."""
    largest = float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0))
    return 0.1 <= largest <= 1.0


def _refuse_separate_times(log: Log, times: Sequence[ChannelSource], tables: Sequence[Array]) -> None:
    """Refuse columns of time, s, without a common moment, such as seconds since the start and since 1970."""
    spans = [
        (float(time_s[0]), float(time_s[-1]), time.column.header)
        for time_s, time in zip(tables, times, strict=True)
        if len(time_s) and time.column is not None
    ]
    if max(begin for begin, _, _ in spans) > min(end for _, end, _ in spans):
        listed = ", ".join(f"{header} is from {begin:.9g} to {end:.9g} s" for begin, end, header in spans)
        raise InputError(
            f"{log.place}: the times have no moment in common: {listed}; "
            "the clocks must have the same zero, so correct the times of one"
        )


def _common_length(log: Log, by_header: Values) -> int:
    """Return the number of rows that all columns have; refuse a log whose columns differ."""
    lengths = {header: len(values) for header, values in by_header.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{header} has {length}" for header, length in lengths.items())
        raise InputError(
            f"{log.place}: the columns have different numbers of rows ({listed}), so one rate does not fit"
        )
    return next(iter(lengths.values()))


def _merge(tables: Sequence[tuple[Array, dict[str, Array]]]) -> tuple[Array, dict[str, Array]]:
    """Merge tables (times and channels) to one; a channel is NaN in rows of other tables."""
    times = np.concatenate([time_s for time_s, _ in tables])
    order = np.argsort(times, kind="stable")
    ordered = times[order]
    period = min((float(np.median(np.diff(time_s))) for time_s, _ in tables if len(time_s) > 1), default=0.0)
    is_new = np.concatenate([[True], np.diff(ordered) > _SAME_TIME * period])
    merged_row = np.empty(len(times), np.int64)  # by row of the concatenated tables
    merged_row[order] = np.cumsum(is_new) - 1
    merged, start = ordered[is_new], 0
    columns: dict[str, Array] = {}
    for time_s, channels in tables:
        rows = merged_row[start : start + len(time_s)]
        for channel, values in channels.items():
            columns[channel] = np.full(len(merged), np.nan)
            columns[channel][rows] = values
        start += len(time_s)
    return merged, columns


def _without_false_gaps(
    time_s: Array, columns: dict[str, Array], tables: Sequence[Array]
) -> tuple[Array, dict[str, Array]]:
    """Insert empty rows where merged rows are uneven although no table lacks rows, to avoid gaps."""
    steps, period = np.diff(time_s), usual_step(time_s)
    uneven = np.flatnonzero(missing_rows(time_s))
    for times in tables:
        own = np.diff(times)
        if len(own):
            step = np.searchsorted(times, time_s[uneven], "right") - 1
            lost = missing_rows(times)[np.clip(step, 0, len(own) - 1)] > 0
            uneven = uneven[~(lost & (step >= 0) & (step < len(own)))]
    counts = np.rint(steps[uneven] / period).astype(int) - 1
    uneven, counts = uneven[counts <= _MOST_INSERTED], counts[counts <= _MOST_INSERTED]
    if not len(uneven):
        return time_s, columns
    number = np.concatenate([np.arange(1, count + 1) for count in counts])
    row = np.repeat(uneven, counts)
    inserted = time_s[row] + steps[row] * number / (np.repeat(counts, counts) + 1)
    order = np.argsort(np.concatenate([time_s, inserted]), kind="stable")
    empty = np.full(len(inserted), np.nan)
    filled = {channel: np.concatenate([values, empty])[order] for channel, values in columns.items()}
    return np.concatenate([time_s, inserted])[order], filled


def _hold_inputs(
    time_s: Array, columns: dict[str, Array], machine: Machine, remarks: list[str]
) -> tuple[Array, dict[str, Array]]:
    """Hold inputs over empty cells, leave out first rows where an input has none; append remarks."""
    begin = 0
    for channel in (*machine.input_channels, *machine.supply_channels):
        values = columns[channel]
        has_value = ~np.isnan(values)
        if has_value.all() or not has_value.any():
            continue
        begin = max(begin, int(np.argmax(has_value)))
        held_row = np.maximum.accumulate(np.where(has_value, np.arange(len(values)), 0))
        columns[channel] = values[held_row]
        count = int(np.sum(~has_value))
        verb = "are" if count > 1 else "is"
        remarks.append(
            f"{channel}: {count} of {len(values)} cells {verb} empty; the value before each is held"
        )
    if begin:
        first = f"{begin} rows are" if begin > 1 else "row is"
        remarks.append(f"the first {first} left out, an input has no value there yet")
        return time_s[begin:], {channel: values[begin:] for channel, values in columns.items()}
    return time_s, columns
