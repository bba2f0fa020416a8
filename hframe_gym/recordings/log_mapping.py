"""Assign the columns of a log to the channels of a machine, and convert their values to the channels' units."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ..errors import InputError
from ..machine import Machine
from .log_file import ROW_NUMBER, Log, LogColumn
from .measurement_units import (
    DUTY_UNITS,
    SI_UNITS,
    SPEED_UNITS,
    UNITS,
    Conversion,
    Dimension,
    channel_dimensions,
    normalize_unit,
    parse_rate,
    shaft_drive,
    split_unit,
    units_of,
    unknown_unit_text,
)

TIME = "time_s"
NOT_MEASURED = "none"  # in place of a column: the output has no column in the log
_TIME_NAMES = ("time", "t", "timestamp", "zeit", "elapsedtime", "seconds", "sec")  # without signs, in lower case
# First letters of names that are suggested for a channel, never assigned without the user.
_FIRST_LETTERS: dict[Dimension, str] = {"voltage": "uv", "length": "xyzp", "angle": "paqe", "time": "t"}


@dataclass(frozen=True)
class MappingOptions:
    """What the user states about the columns of logs; everything else follows from names and units in the log.

    Attributes:
        columns: Column by channel: its name with or without its unit, "#3" for the third column, or "none" for an
            output that was not measured. For "time_s", also a rate such as "200Hz": the log has no column of time, and
            its rows are equally spaced.
        units: Unit of the column by channel, for example {"phi1_rad": "deg", "v1_V": "%"}.
        scales: Factor by channel. It is applied to the values of the column, behind the conversion from a unit that
            `units` states; a unit in the header is then ignored.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    scales: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ChannelSource:
    """Origin of a channel's values.

    Attributes:
        channel: Name of the channel, or "time_s".
        column: Column of the log; None if the output was not measured.
        time: Source of the times of its samples; None for a time itself and without a column.
        conversion: Conversion to the unit of the channel.
        remark: What is converted or assumed, in words; "" if there is nothing to say.
        assumed: Whether neither the log nor the user states the unit.
        is_speed: Whether the column is a speed, whose integral is the channel.
        stated: Whether the user states the unit or a factor.
    """

    channel: str
    column: LogColumn | None
    time: ChannelSource | None
    conversion: Conversion
    remark: str
    assumed: bool = False
    is_speed: bool = False
    stated: bool = False


def map_columns(log: Log, machine: Machine, options: MappingOptions) -> list[ChannelSource]:
    """Assign the columns of a log to the channels of a machine.

    A column belongs to a channel if the options say so, or if its name without unit is that of exactly one channel ("X
    [mm]", "x_mm" and "x" for x_m). Nothing else is guessed.

    Args:
        log: Opened log with its columns.
        machine: Machine that was logged.
        options: Columns, units and factors that the user assigns to channels.

    Returns:
        Sources (column and conversion of units): first those of the times, then one per channel of the machine, inputs
        before outputs. If the log has several columns of time, each channel refers to the one of the same length, or
        else to the nearest one to its left.

    Raises:
        InputError: If a channel has no column or several, or a unit is unknown. The message lists columns and channels,
            and options to complete.
    """
    dimensions = channel_dimensions(machine)
    for option, keys in (("map", options.columns), ("unit", options.units), ("scale", options.scales)):
        unknown = [key for key in keys if key not in (TIME, *dimensions)]
        if unknown:
            raise InputError(f"--{option} {unknown[0]}=...: no such channel; {_channels_text(machine)}")
    times = _time_columns(log, options)
    assigned: dict[str, LogColumn | None] = {
        channel: _named_column(log, channel, options.columns[channel], machine)
        for channel in dimensions
        if channel in options.columns
    }
    _refuse_repeated_columns(log, machine, assigned)
    _assign_by_name(log, machine, times, assigned)
    time_sources = {time.header: _source(log, TIME, time, None, "time", machine, options) for time in times}
    sources = []
    for channel, dimension in dimensions.items():
        column = assigned[channel]
        time_source = time_sources[_time_of(log, column, times).header] if column else None
        sources.append(_source(log, channel, column, time_source, dimension, machine, options))
    idle = [time for time in time_sources.values() if time not in [source.time for source in sources]]
    if idle:
        choices = " or ".join(shlex.quote(f"{TIME}={column.header}") for column in times)
        raise InputError(f"{log.path}: several columns may be the time ({_list(times)}): add --map {choices}")
    return [*time_sources.values(), *sources]


def _assign_by_name(
    log: Log, machine: Machine, times: Sequence[LogColumn], assigned: dict[str, LogColumn | None]
) -> None:
    """Add the channels to an assignment that the names of columns identify; refuse the log if one is missing."""
    taken = [*times, *assigned.values()]
    missing = [] if times else [TIME]
    for channel in [channel for channel in channel_dimensions(machine) if channel not in assigned]:
        matches = [column for column in _matching_columns(log, channel) if column not in taken]
        if len(matches) == 1:
            assigned[channel] = matches[0]
        else:
            missing.append(channel)
    used = [*times, *assigned.values()]
    unused = [column for column in log.columns if column not in used and column.kind != "text"]
    if missing and (unused or set(missing) & {TIME, *machine.input_channels}):
        raise InputError(_missing_text(log, machine, missing, unused))
    assigned |= dict.fromkeys(missing)  # no column is left that these outputs could be


def _refuse_repeated_columns(log: Log, machine: Machine, assigned: Mapping[str, LogColumn | None]) -> None:
    """Refuse a column that the user assigns to two measurements; one voltage may supply two drives."""
    used: dict[str, str] = {}
    for channel in machine.output_channels:
        column = assigned.get(channel)
        if column is not None and used.setdefault(column.header, channel) != channel:
            options = f"--map {used[column.header]}={column.header} --map {channel}={column.header}"
            raise InputError(f"{log.path}: {options}: one column cannot be two measurements; correct one of them")


def _matching_columns(log: Log, channel: str) -> list[LogColumn]:
    """Return the columns whose name is that of a channel and no speeds, only the identical one if there is one."""
    identical = [column for column in log.columns if column.header == channel]
    speeds = [unit for units in SPEED_UNITS.values() for unit in units]
    named = [column for column in log.columns if _bare(column.name) == _bare(split_unit(channel)[0])]
    return identical or [column for column in named if column.unit not in speeds]


def _bare(name: str) -> str:
    """Return a name without signs and blanks, in lower case."""
    return re.sub(r"[^\w#]|_", "", name.lower())


def _time_columns(log: Log, options: MappingOptions) -> list[LogColumn]:
    """Return the columns of time: those that the user names or that are named like a time; for a rate, row numbers."""
    reference = options.columns.get(TIME)
    if reference is not None:
        if parse_rate(reference) is not None:
            return [LogColumn(f"row number at {reference.strip()}", "row number", "", ROW_NUMBER)]
        try:
            return [_find_column(log, TIME, reference)]
        except InputError:
            if "," not in reference:
                raise
            return [_find_column(log, TIME, part.strip()) for part in reference.split(",")]
    identical = [column for column in log.columns if column.header == TIME]
    named = [column for column in log.columns if _bare(column.name.rpartition(".")[2]) in _TIME_NAMES]
    return identical or named


def _named_column(log: Log, channel: str, reference: str, machine: Machine) -> LogColumn | None:
    """Return the column that the user names for a channel, None for an output that was not measured."""
    if reference.lower() in (NOT_MEASURED, ""):
        if channel not in machine.output_channels:
            raise InputError(f"--map {channel}={reference}: only outputs may be left out; {_channels_text(machine)}")
        return None
    return _find_column(log, channel, reference)


def _find_column(log: Log, channel: str, reference: str) -> LogColumn:
    """Return the column that a reference names: by its header, its name without unit, or its number (#3)."""
    if re.fullmatch(r"#\d+", reference) and 1 <= int(reference[1:]) <= len(log.columns):
        return log.columns[int(reference[1:]) - 1]
    for columns in (
        [c for c in log.columns if c.header == reference],
        [c for c in log.columns if c.header.lower() == reference.lower()],
        [c for c in log.columns if c.name.lower() == reference.lower()],
    ):
        if len(columns) == 1:
            return columns[0]
    problem = "several columns have this name" if columns else "there is no such column"
    raise InputError(f"{log.path}: --map {channel}={reference}: {problem}; the columns are {_list(log.columns)}")


def _time_of(log: Log, column: LogColumn, times: Sequence[LogColumn]) -> LogColumn:
    """Return the time of a column: of several the one of the same length, or the last one to the left."""
    if times[0].kind == ROW_NUMBER:
        return times[0]
    if column.rows is not None:
        same = [time for time in times if time.rows == column.rows]
        if not same:
            lengths = ", ".join(f"{time.header} {time.rows}" for time in times)
            others = [c.header for c in log.columns if c.rows == column.rows and c != column]
            names = ",".join([*(time.header for time in times), *(others if len(others) == 1 else ["COLUMN"])])
            advice = f"call its time t or time, or name all times: --map {shlex.quote(f'{TIME}={names}')}"
            advice += f" (of this length: {', '.join(others)})" if len(others) > 1 else ""
            advice = advice if others else "the log needs a time of this length"
            problem = f"has {column.rows} values, but the times have: {lengths}"
            raise InputError(f"{log.path}, {column.header}: {problem}; {advice}")
        times = same
        if len(same) > 1:
            choices = " or ".join(f"--map {TIME}={time.header}" for time in same)
            raise InputError(f"{log.path}: several times have the length of {column.header}: add {choices}")
    position = log.columns.index(column)
    left = [time for time in times if log.columns.index(time) < position]
    return left[-1] if left else times[0]


def _source(
    log: Log,
    channel: str,
    column: LogColumn | None,
    time: ChannelSource | None,
    dimension: Dimension,
    machine: Machine,
    options: MappingOptions,
) -> ChannelSource:
    """Return the source of a channel with its conversion: from the options, or from the unit that the log states."""
    if column is None:
        return ChannelSource(channel, None, None, Conversion(), "not measured: the cells stay empty")
    if column.kind == ROW_NUMBER:
        return ChannelSource(
            channel, column, None, Conversion(1.0, parse_rate(options.columns[channel]) or 1.0), "to s"
        )
    stated, scale = options.units.get(channel), options.scales.get(channel)
    unit = normalize_unit(stated) if stated is not None else "" if scale is not None else column.unit
    si_unit, speeds = SI_UNITS[dimension], SPEED_UNITS.get(dimension, {})
    if stated is None and scale is not None and column.unit in speeds:
        advice = f"add --unit {channel}={column.unit}, and it is integrated to {channel}"
        raise InputError(f"{log.path}, column {column.header}: a speed is no {dimension}; {advice}")
    conversion, remarks = Conversion(), list[str]()
    shaft = shaft_drive(machine, channel)
    if column.kind == "stamp" and dimension != "time":
        raise InputError(f"{log.path}, column {column.header}: has dates or times, which cannot be {channel}")
    if column.kind == "stamp":
        remarks.append("time stamps to s")
    elif unit in UNITS[dimension]:
        conversion = Conversion(*UNITS[dimension][unit])
        remarks += [f"{unit} to {si_unit}"] if unit != si_unit else []
    elif unit in speeds:
        conversion = Conversion(*speeds[unit])
        remarks.append(f"a speed, {unit} to {si_unit}/s, integrated from 0: drifts with every error of the speed")
    elif unit in DUTY_UNITS and dimension == "voltage":
        drive = next(drive for drive in machine.drives if drive.channel == channel)
        conversion = Conversion(drive.rated_voltage, DUTY_UNITS[unit])
        remarks.append(f"duty cycle, 100 % is {drive.rated_voltage:.6g} V, the rated voltage of {drive.name}")
    elif unit in UNITS["angle"] and shaft is not None:
        conversion = Conversion(*UNITS["angle"][unit]).scaled(1.0 / shaft.gear_ratio)
        remarks.append(f"angle of {shaft.name}, {unit} to rad, divided by its gear ratio, {shaft.gear_ratio:.6g} rad/m")
    elif unit:
        raise InputError(f"{log.path}, column {column.header}: {unknown_unit_text(machine, channel, unit)}")
    elif scale is None:
        remarks.append(f"no unit, taken as {si_unit}")
    if scale is not None:
        conversion = conversion.scaled(scale)
        remarks.append(f"times {scale:.9g}")
    assumed = scale is None and not unit and column.kind != "stamp"
    by_user = stated is not None or scale is not None
    return ChannelSource(channel, column, time, conversion, ", ".join(remarks), assumed, unit in speeds, by_user)


def _missing_text(log: Log, machine: Machine, missing: Sequence[str], unused: Sequence[LogColumn]) -> str:
    """Return the message about channels without a column, with options to complete."""
    proposals = _proposed_columns(machine, missing, unused)
    options = [f"--map {shlex.quote(f'{channel}={name}')}" for channel, name in proposals.items()]
    several = {channel: _matching_columns(log, channel) for channel in missing if channel != TIME}
    ambiguous = [f"{channel} may be {_list(columns)}" for channel, columns in several.items() if len(columns) > 1]
    problem = "; ".join(ambiguous) or f"no column is named like {', '.join(missing)}"
    absent = [channel for channel in missing if channel in machine.output_channels]
    none = f" (or {absent[0]}={NOT_MEASURED}, if it was not measured)" if absent else ""
    none += f"; {TIME}=200Hz stands for 200 rows per second without a column of time" if TIME in missing else ""
    advice = f"Check and add: {' '.join(options)}{none}"
    if not unused and TIME not in missing:
        advice = "No column is left for a voltage: it must be recorded (a drive at rest has a column of zeros)"
    return (
        f"{log.path}: {problem}. Columns of the log: {_list(log.columns)}. Not assigned: {_list(unused) or 'none'}. "
        f"{_channels_text(machine)}. {advice}"
    )


def _proposed_columns(machine: Machine, missing: Sequence[str], unused: Sequence[LogColumn]) -> dict[str, str]:
    """Propose a column for each channel without one, by unit and first letter; "COLUMN" where there is none or doubt.

    A channel with few candidates is served first. Of fewer columns than channels that can only be them, none is
    proposed.
    """
    candidates: dict[str, list[LogColumn]] = {}
    for channel in missing:
        letters = _FIRST_LETTERS[channel_dimensions(machine).get(channel, "time")]
        candidates[channel] = [column for column in unused if column.unit in units_of(machine, channel)] or [
            column for column in unused if not column.unit and _bare(column.name)[:1] in letters
        ]
        if not candidates[channel] and len(unused) == 1 and not unused[0].unit and channel != TIME:
            candidates[channel] = list(unused)
    proposed = dict.fromkeys(missing, "COLUMN")
    taken: list[LogColumn] = []
    for channel in sorted(missing, key=lambda channel: len(candidates[channel])):
        free = [column for column in candidates[channel] if column not in taken]
        rivals = [c for c in missing if proposed[c] == "COLUMN" and all(column in free for column in candidates[c])]
        if len(free) >= len([c for c in rivals if candidates[c]]) and free:
            proposed[channel] = free[0].header
            taken.append(free[0])
    return proposed


def _channels_text(machine: Machine) -> str:
    """Return a sentence with the channels of a machine."""
    inputs, outputs = ", ".join(machine.input_channels), ", ".join(machine.output_channels)
    return f"Machine {machine.name!r} has {TIME}, inputs {inputs} and outputs {outputs}"


def _list(columns: Sequence[LogColumn]) -> str:
    """Return the headers of columns as a list in words; a unit from a row of units follows in brackets."""
    return ", ".join(c.header if c.name != c.header or not c.unit else f"{c.header} [{c.unit}]" for c in columns)
