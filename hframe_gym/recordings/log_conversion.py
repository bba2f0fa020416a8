"""Convert the columns of a log to a recording, and cut a long recording into runs at its rests."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from ..errors import InputError
from ..machine import Machine
from .log_file import ROW_NUMBER, Log
from .log_mapping import ChannelSource
from .measurement_units import TIME, Conversion, WrongUnitError
from .recording import Recording, recording_from_columns
from .table_file import Array, refuse_decreasing_times
from .text_reader import Progress

Mask = NDArray[np.bool_]

_SAME_TIME = 1e-3  # of the shortest period; samples of several time columns that are nearer belong to one row
_LONG_STEP = 0.5  # s; a longer sampling period of a time without a unit is probably in another unit

_REST_NOISE = 10.0  # standard deviations of its noise by which a channel at rest may vary, peak to peak
_REST_STEPS = 2.5  # quantization steps by which a channel at rest may vary
_MAX_REST_SPAN = 0.01  # of the channel's span in the log; more is a motion, however noisy the channel seems
_INPUT_TOLERANCE = 1e-3  # of the rated voltage, by which a measured voltage at rest may vary


class LogConverter:
    """Converts the logs of one session to recordings with a common clock.

    Attributes:
        machine: Machine that was logged.
        day: Midnight from which time stamps are counted, that before the first time stamp of the first log; None before
            that is read.
    """

    def __init__(self, machine: Machine) -> None:
        """Create a converter for the logs of a session.

        Args:
            machine: Machine that was logged.
        """
        self.machine = machine
        self.day: np.datetime64 | None = None

    def convert(
        self, log: Log, sources: Sequence[ChannelSource], progress: Progress | None = None
    ) -> tuple[Recording, list[str]]:
        """Read a log and convert it to one recording.

        A log may hold channels of several sampling rates, in one table with empty cells or with several columns of
        time, whose rows are merged. Where the table has no value, a voltage keeps its last value and a measurement is
        NaN.

        Args:
            log: Opened log.
            sources: For the times and each channel, column of the log and conversion to SI (`map_columns` finds them).
            progress: Called with the number of bytes read since the last call.

        Returns:
            recording: Recording of the complete log with the name of its file: times, s, shape (n,), voltages, V, shape
                (n, drives), and measurements, m or rad, shape (n, sensors).
            remarks: Sentences for the user about rows that were left out, held or merged.

        Raises:
            InputError: If a cell is not a number, times do not increase, or a channel is empty or in a wrong unit.
        """
        needed = list({source.column.header: source.column for source in sources if source.column}.values())
        in_file = [column for column in needed if column.kind != ROW_NUMBER]
        values, remarks = log.read(in_file, progress)
        by_header = {column.header: array for column, array in zip(in_file, values, strict=True)}
        del values
        for counter in (column for column in needed if column.kind == ROW_NUMBER):
            by_header[counter.header] = np.arange(_common_length(log, by_header), dtype=np.float64)
        try:
            time_s, columns = self._columns(log, sources, by_header, remarks)
            return recording_from_columns(log.path, {TIME: time_s, **columns}, self.machine), remarks
        except WrongUnitError as error:
            raise InputError(_unit_advice(error, sources)) from None
        except InputError as error:
            text = str(error)
            origin = {s.channel: s.column.header for s in sources if s.column and s.column.header != s.channel}
            named = [f"{channel} is the column {header!r}" for channel, header in origin.items() if channel in text]
            if "goes back" in text:
                text += "; did the clock restart? Cut the file there"
            raise InputError("; ".join([text, *named])) from None

    def _columns(
        self, log: Log, sources: Sequence[ChannelSource], by_header: dict[str, NDArray[Any]], remarks: list[str]
    ) -> tuple[Array, dict[str, Array]]:
        """Return times, s, and the values of each channel in its unit; append to the remarks."""
        times = [source for source in sources if source.channel == TIME and source.column is not None]
        bases: list[tuple[Array, dict[str, Array]]] = []  # times and channels of each column of time
        for time in times:
            time_s = self._seconds(log, time, by_header)
            timed = np.isfinite(time_s)
            if not timed.all():
                remarks.append(f"{int(np.sum(~timed))} rows without a time left out")
            refuse_decreasing_times(log.path, time_s[timed] if not timed.all() else time_s)
            channels = {}
            for source in sources:
                if source.time is not None and source.time.column is time.column and source.column is not None:
                    converted = source.conversion.apply(by_header[source.column.header])
                    values = converted if timed.all() else converted[timed]
                    channels[source.channel] = _integrate(time_s[timed], values) if source.integrate else values
            bases.append((time_s[timed], channels))
        if self.day is not None:
            date = f" of {self.day}" if self.day > np.datetime64("1970-01-01") else ""
            remarks.append(f"time_s counts from midnight{date}; time zones are ignored")
        by_header.clear()  # the values of a long log are held only once
        time_s, columns = bases[0] if len(bases) == 1 else _merge(bases)
        if len(bases) > 1:
            parts = [f"{len(base)} of {t.column.header}" for (base, _), t in zip(bases, times, strict=True) if t.column]
            remarks.append(f"several columns of time, merged to {len(time_s)} rows ({', '.join(parts)})")
        return _hold_inputs(time_s, columns, self.machine, remarks)

    def _seconds(self, log: Log, source: ChannelSource, by_header: Mapping[str, NDArray[Any]]) -> Array:
        """Return the times of a column in seconds, NaN where it is empty."""
        assert source.column is not None
        values = by_header[source.column.header]
        if source.column.kind == "stamp":
            valid = values[~np.isnat(values)]
            if self.day is None and len(valid):
                self.day = valid[0].astype("datetime64[D]")
            nanoseconds = (values - (self.day or np.datetime64(0, "D"))).astype("timedelta64[ns]")
            return np.where(np.isnat(values), np.nan, nanoseconds.astype(np.int64) / 1e9)
        time_s = source.conversion.apply(values)
        finite = time_s[np.isfinite(time_s)]
        step = float(np.median(np.diff(finite))) if len(finite) > 1 else 0.0
        if source.unit_is_assumed and step >= _LONG_STEP:
            raise InputError(
                f"{log.path}, column {source.column.header}: has no unit and steps of {step:g}, which are long for "
                f"seconds; state its unit by --unit {TIME}=ms (or us, ns, s)"
            )
        return time_s


def _unit_advice(error: WrongUnitError, sources: Sequence[ChannelSource]) -> str:
    """Return the message about a wrong unit, with the options that correct it.

    The unit that the error proposes is passed on for columns in SI only: where the user or the log has stated another
    unit, or the column is an integrated speed, the values may as well be wrong.
    """
    wrong = [source for source in sources if source.channel in error.channels and source.column is not None]
    remarks = [f" ({source.remark})" if source.remark else "" for source in wrong]
    columns = "; ".join(
        f"{source.channel} is the column {source.column.header!r}{remark}"
        for source, remark in zip(wrong, remarks, strict=True)
        if source.column is not None
    )
    for source in wrong:
        if source.set_by_user:
            options = f"--unit {source.channel}=UNIT or --scale {source.channel}=FACTOR"
            return f"{error.problem}. Correct {options}: {columns}"
    in_si = [source.channel for source in wrong if source.conversion == Conversion() and not source.integrate]
    if in_si:
        return f"{error} If so, add {' '.join(f'--unit {channel}={error.unit}' for channel in in_si)}: {columns}"
    channel = wrong[0].channel
    advice = f"check them, or correct their unit by --unit {channel}=UNIT or --scale {channel}=FACTOR"
    return f"{error.problem}. The values in the log are suspect; {advice}: {columns}"


def _integrate(time_s: Array, speed: Array) -> Array:
    """Integrate a speed over time from 0 by the trapezoidal rule; empty cells (NaN) stay empty."""
    measured = np.isfinite(speed)
    position = np.full(len(speed), np.nan)
    if measured.any():
        position[measured] = cumulative_trapezoid(speed[measured], time_s[measured], initial=0.0)
    return position


def _common_length(log: Log, by_header: Mapping[str, NDArray[Any]]) -> int:
    """Return the number of rows that all columns have; refuse a log whose columns differ."""
    lengths = {header: len(values) for header, values in by_header.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{header} has {length}" for header, length in lengths.items())
        raise InputError(f"{log.path}: the columns have different numbers of rows ({listed}), so one rate does not fit")
    return next(iter(lengths.values()))


def split_at_rests(recording: Recording, machine: Machine, min_rest: float) -> tuple[list[Recording], list[str]]:
    """Cut a recording into runs that begin and end at rest.

    The machine rests where no input and no output changes by more than noise for at least `min_rest`. Each rest between
    two motions is cut in the middle. A longer rest is shortened, so that a run has at most `min_rest` of it at its
    beginning and at its end.

    Args:
        recording: Recording of several motions (times, s; voltages, V; measurements, m or rad).
        machine: Machine that was recorded.
        min_rest: Shortest rest at which the recording is cut, s.

    Returns:
        runs: One recording per motion (measurements of shape (n, sensors)), named NAME_01, NAME_02, ...; their times
            are those of the recording.
        remarks: Sentences for the user about what was left out.

    Raises:
        InputError: If the machine never rests for `min_rest`, or never moves.
    """
    time_s = recording.time_s
    resting = _resting_rows(recording, machine, min_rest)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], resting.astype(np.int8), [0]])))
    first, last = edges[::2], edges[1::2] - 1  # rows of each rest
    if len(first) == 0:
        raise InputError(f"{recording.name}: nothing rests for {min_rest:g} s, so it cannot be cut; reduce --min-rest")
    if resting.all():
        raise InputError(f"{recording.name}: nothing moves, so there are no runs to cut")
    middle = (time_s[first] + time_s[last]) / 2
    begins = np.searchsorted(time_s, np.maximum(middle, time_s[last] - min_rest))
    ends = np.searchsorted(time_s, np.minimum(middle, time_s[first] + min_rest), side="right")
    begins[0] = np.searchsorted(time_s, max(time_s[0], time_s[last[0]] - min_rest)) if first[0] == 0 else begins[0]
    ends[-1] = len(time_s) if last[-1] == len(time_s) - 1 and len(first) > 1 else ends[-1]
    pieces = list(zip(begins[:-1], ends[1:], strict=True))
    remarks = []
    if first[0] > 0:
        remarks.append(f"the first {time_s[first[0]] - time_s[0]:.4g} s left out, they do not begin at rest")
    if last[-1] < len(time_s) - 1:
        pieces.append((begins[-1], len(time_s)))
        remarks.append("the last run does not end at rest")
    digits = max(2, len(str(len(pieces))))
    runs = []
    for number, (begin, end) in enumerate(pieces, start=1):
        rows = slice(int(begin), int(end))
        runs.append(
            dataclasses.replace(
                recording,
                name=f"{recording.name}_{number:0{digits}d}",
                time_s=time_s[rows],
                inputs=recording.inputs[rows],
                outputs=recording.outputs[rows],
            )
        )
    idle = time_s[-1] - time_s[0] - sum(float(run.time_s[-1] - run.time_s[0]) for run in runs)
    seconds = [float(run.time_s[-1] - run.time_s[0]) for run in runs]
    count = "1 run of" if len(runs) == 1 else f"{len(runs)} runs of {min(seconds):.3g} to"
    remarks.append(f"cut at rests of {min_rest:g} s and more: {count} {max(seconds):.3g} s, {idle:.4g} s left out")
    return runs, remarks


def _merge(bases: Sequence[tuple[Array, dict[str, Array]]]) -> tuple[Array, dict[str, Array]]:
    """Merge tables with times of their own; cells are NaN in the rows of other tables."""
    times = np.concatenate([time_s for time_s, _ in bases])
    order = np.argsort(times, kind="stable")
    ordered = times[order]
    period = min(float(np.median(np.diff(time_s))) for time_s, _ in bases if len(time_s) > 1)
    is_new = np.concatenate([[True], np.diff(ordered) > _SAME_TIME * period])
    row_of = np.empty(len(times), np.int64)
    row_of[order] = np.cumsum(is_new) - 1
    merged, start = ordered[is_new], 0
    columns: dict[str, Array] = {}
    for time_s, channels in bases:
        rows = row_of[start : start + len(time_s)]
        for channel, values in channels.items():
            columns[channel] = np.full(len(merged), np.nan)
            columns[channel][rows] = values
        start += len(time_s)
    return merged, columns


def _hold_inputs(
    time_s: Array, columns: dict[str, Array], machine: Machine, remarks: list[str]
) -> tuple[Array, dict[str, Array]]:
    """Hold inputs over empty cells, and leave out the rows before every input has a value; append to the remarks."""
    begin = 0
    for channel in machine.input_channels:
        values = columns[channel]
        known = ~np.isnan(values)
        if known.all() or not known.any():
            continue
        begin = max(begin, int(np.argmax(known)))
        row = np.maximum.accumulate(np.where(known, np.arange(len(values)), 0))
        columns[channel] = values[row]
        empty = f"{int(np.sum(~known))} of {len(values)} cells are empty"
        remarks.append(f"{channel}: {empty}; the value before each is held")
    if begin:
        remarks.append(f"the first {begin} rows left out, an input has no value there yet")
        return time_s[begin:], {channel: values[begin:] for channel, values in columns.items()}
    return time_s, columns


def _resting_rows(recording: Recording, machine: Machine, min_rest: float) -> Mask:
    """Return the rows that belong to an interval of the given length, s, in which nothing moves."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    n = len(recording.time_s)
    period = float(np.median(np.diff(recording.time_s))) if n > 1 else min_rest
    window = max(2, round(min_rest / period) + 1)
    if window > n:
        return np.zeros(n, np.bool_)
    still = np.ones(n - window + 1, np.bool_)  # by the first row of the window
    for values, tolerance in _channels_with_tolerance(recording, machine):
        center = window // 2
        high = maximum_filter1d(values, window, mode="nearest")[center : center + len(still)]
        low = minimum_filter1d(values, window, mode="nearest")[center : center + len(still)]
        still &= high - low <= tolerance
    # A row rests if any window that contains it is still.
    count = np.concatenate([[0], np.cumsum(still)])
    rows = np.arange(n)
    return count[np.minimum(rows + 1, len(still))] > count[np.maximum(rows - window + 1, 0).clip(max=len(still))]


def _channels_with_tolerance(recording: Recording, machine: Machine) -> list[tuple[Array, float]]:
    """Return the values of each channel without empty cells, and by how much it may vary at rest."""
    channels = []
    for values, drive in zip(recording.inputs.T, machine.drives, strict=True):
        tolerance = max(_INPUT_TOLERANCE * drive.rated_voltage, _natural_variation(values))
        channels.append((values, min(tolerance, _MAX_REST_SPAN * float(np.ptp(values)))))
    for values, sensor in zip(recording.outputs.T, machine.sensors, strict=True):
        measured = np.flatnonzero(np.isfinite(values))
        if len(measured) == 0:
            continue
        declared = max(_REST_NOISE * sensor.noise, _REST_STEPS * sensor.resolution)
        natural = min(_natural_variation(values[measured]), _MAX_REST_SPAN * float(np.ptp(values[measured])))
        held = values[measured[np.clip(np.searchsorted(measured, np.arange(len(values)), "right") - 1, 0, None)]]
        channels.append((held, max(declared, natural)))
    return channels


def _natural_variation(values: Array) -> float:
    """Return the peak-to-peak variation of a resting channel from its noise and its smallest step."""
    changes = np.abs(np.diff(values))
    smallest = float(np.min(changes, where=changes > 0.0, initial=np.inf))
    noise = 1.4826 * float(np.median(np.abs(np.diff(values, 2)))) / np.sqrt(6.0) if len(values) > 2 else 0.0
    return max(_REST_STEPS * smallest if np.isfinite(smallest) else 0.0, _REST_NOISE * noise)
