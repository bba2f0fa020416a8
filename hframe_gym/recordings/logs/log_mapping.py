"""Assign the columns of a log to the channels of a machine, and determine the conversion of each."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from ...errors import InputError, suggestion
from ...machine import DRIVE_KINDS, Machine, rest_positions_per_axis
from ...operating_system import quoted
from ..quantities import TIME_HEADERS, normalize_unit
from .column_proposals import NO_PROPOSAL, proposed_headers
from .log import ROW_NUMBER, Log, LogColumn, headers_text, plain_name
from .measurement_units import (
    ALL_SPEED_UNITS,
    SI_UNITS,
    SPEED_UNITS,
    TIME,
    Conversion,
    UnitConversion,
    accepted_units,
    channel_dimension,
    parse_rate,
    scaled_speed_message,
    wrong_unit_message,
)
from .possible_maps import obstacle

NOT_MEASURED = "none"  # given instead of a column: the output was not measured
_EXAMPLE_RATE = "200Hz"  # in messages
_LENGTHS = {"mm": 1e-3, "m": 1.0}  # m, units of set points of a tool
# A reference to columns to which a number is added, such as "pwm - 127.5".
_NUMBER_ADDED = re.compile(r"(.*\S)\s*([+-])\s*(\d+\.?\d*)\s*")
# Names of a column of sample times, in lower case, without blanks and punctuation; "xvalue" is that of
# LabVIEW.
_TIME_NAMES = ("time", "t", "timestamp", "zeit", "elapsedtime", "seconds", "sec", "xvalue", *TIME_HEADERS)


@dataclass(frozen=True)
class MappingOptions:
    """Column, unit and factor that the user assigned to channels.

    Unassigned channels are matched by the names and units in the log.

    Attributes:
        columns: Column by channel: its name with or without its unit, "#3" for the third column, a sum or
            difference of columns such as "x + y", or "none" for an output that was not measured. For
            "time_s", also several columns separated by commas, or a rate such as "200Hz" if the log has no
            time column and its rows are equally spaced.
        units: Unit of the column by channel, for example {"phi1_rad": "deg", "v1_V": "%"}. It replaces the
            unit in the header.
        scales: Factor by channel. With `units`, values are first converted from that unit, then multiplied.
            Without `units`, the unit in the header is ignored and the factor converts to the channel's unit.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    scales: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ChannelSource:
    """Column of a log that holds a channel, and how to convert it to the channel's unit.

    Attributes:
        channel: Name of the channel, or "time_s".
        column: Column of the log. None if the output was not measured.
        time: `ChannelSource` of the sample times. None if this source is itself a time, or if it has no
            column.
        conversion: Conversion to the unit of the channel; for a speed, to that unit per second.
        remark: What is converted or assumed, in words; "" if the values are used unchanged.
        unit_is_assumed: Whether neither the log nor the user states the unit, so that SI is assumed.
        integrate: Whether the column is a speed, whose integral over time is the channel.
        set_by_user: Whether the user stated the unit or a factor (options --unit, --scale, or a mapping
            file).
    """

    channel: str
    column: LogColumn | None
    time: ChannelSource | None
    conversion: Conversion
    remark: str
    unit_is_assumed: bool = False
    integrate: bool = False
    set_by_user: bool = False


def map_columns(log: Log, machine: Machine, options: MappingOptions) -> list[ChannelSource]:
    """Assign the columns of a log to the channels of a machine.

    A column belongs to a channel if the options say so, or if it is the only one that has the name of the
    channel, with any unit or none ("X [mm]", "x_mm" or "x" for x_m). Nothing else is guessed.

    Returns:
        Sources (column and conversion of units): first those of the times, then one per channel of the
        machine: inputs, supply voltages, outputs (sensors). The `time` of a channel is the column of time of
        the same length (MATLAB) or, in a table, the nearest one to its left. The `column` of an output that
        was not measured is None. The options say so (`--map NAME=none`); without them, an output counts as
        not measured if no column has its name and all columns but those of text are assigned.

    Raises:
        InputError: If the time, an input or a supply voltage has no column; if an output has none and may
            have been measured; if several columns may be the same channel, or one is assigned to two outputs;
            if an option names no channel or no column; if a unit is unknown; or if a drive with back-EMF has
            a current or torque as its input. The message proposes options.
    """
    return _LogMapping(log, machine, options).sources()


class ProposedColumns(NamedTuple):
    """Columns of a log that may be the times and channels of a machine, before the user has assigned any.

    Attributes:
        named: Header by channel, for the columns that `map_columns` assigns by their names.
        proposed: Header by channel, for columns that the user should confirm; a channel without one is in
            neither.
    """

    named: dict[str, str]
    proposed: dict[str, str]


def propose_columns(log: Log, machine: Machine) -> ProposedColumns:
    """Assign columns of a log to channels by name, as `map_columns` does, and propose others for the rest.

    Returns:
        Headers of the columns by channel: `named`, those that the names assign, and `proposed`, those that
        the user should confirm (`proposed_headers`). A channel may be in neither.
    """
    return _LogMapping(log, machine, MappingOptions()).proposals()


class _LogMapping:
    """Assigns the columns of one log to the channels of a machine."""

    def __init__(self, log: Log, machine: Machine, options: MappingOptions) -> None:
        self.log, self.machine, self.options = log, machine, options
        self.channels = (*machine.input_channels, *machine.supply_channels, *machine.output_channels)

    def sources(self) -> list[ChannelSource]:
        """Return the sources of the times and of all channels, see `map_columns`."""
        self._refuse_unknown_channels()
        self._refuse_back_emf()
        times = self._time_columns()
        columns = self._assigned_columns(times)
        time_of = {
            column.header: self._time_of(column, times) for column in columns.values() if column is not None
        }
        used = time_of.values()
        # Each timeseries of a MATLAB file has its own time; those of series that are no channel are no
        # choice.
        times = [time for time in times if time in used or not _structure(time)]
        times = [*times, *(time for time in self.log.times if time in used)]
        time_sources = {time.header: self._source(TIME, time, None) for time in times}
        sources = []
        for channel in self.channels:
            column = columns[channel]
            time_source = time_sources[time_of[column.header].header] if column is not None else None
            sources.append(self._source(channel, column, time_source))
        used_times = [source.time for source in sources]
        if any(time not in used_times for time in time_sources.values()):
            choices = " or ".join(_map_option(TIME, time.header) for time in times)
            problem = f"several columns may be the time ({headers_text(times)})"
            raise InputError(f"{self.log.path}: {problem}: add {choices}")
        return [*time_sources.values(), *sources]

    def proposals(self) -> ProposedColumns:
        """Return the columns with the names of channels, and proposals for the other channels."""
        times = self._time_columns()
        named = {channel: self._named_like(channel) for channel in self.channels}
        assigned = {TIME: times[0].header} if times else {}
        assigned |= {channel: columns[0].header for channel, columns in named.items() if len(columns) == 1}
        taken = [*(time.header for time in times), *assigned.values()]
        unused = [c for c in self.log.columns if c.header not in taken and c.kind != "text"]
        missing = [channel for channel in (TIME, *self.channels) if channel not in assigned]
        proposed = proposed_headers(self.machine, missing, unused)
        return ProposedColumns(
            assigned, {c: header for c, header in proposed.items() if header != NO_PROPOSAL}
        )

    def _refuse_unknown_channels(self) -> None:
        """Refuse options for channels that the machine does not have."""
        options = {"map": self.options.columns, "unit": self.options.units, "scale": self.options.scales}
        for option, by_channel in options.items():
            for channel in by_channel:
                if channel not in (TIME, *self.channels):
                    near = suggestion(channel, (TIME, *self.channels))
                    raise InputError(
                        f"--{option} {channel}=...: no such channel. {self._channels_text()}{near}"
                    )

    def _refuse_back_emf(self) -> None:
        """Refuse a machine with the input current_A or torque_Nm whose drive takes it for a voltage."""
        for channel, drive in zip(self.machine.input_channels, self.machine.drives, strict=True):
            dimension = channel_dimension(self.machine, channel)
            if dimension not in ("voltage", "duty cycle") and drive.Ke != 0.0:
                problem = f"{channel} is a {dimension} by its name, but its drive {drive.name} has a back-EMF"
                form = f"the kind {dimension}" if dimension in DRIVE_KINDS else "Ke 0 and resistance 1"
                advice = f"an amplifier that controls the {dimension} has {form} (docs/own_machine.md)"
                raise InputError(f"machine {self.machine.name!r}: {problem}; {advice}")

    def _time_columns(self) -> list[LogColumn]:
        """Return the columns of time: those that the user names, or else those named like a time.

        If the user states a rate, this is the row number, which is not a column of the file. None are
        returned for a log in which each column states its time.
        """
        reference = self.options.columns.get(TIME)
        if reference is None and self.log.times:
            return []  # each column has its own
        if reference is None:
            files = dict.fromkeys(column.file for column in self.log.columns)
            return [time for file in files for time in self._times_by_name(file)]
        if parse_rate(reference) is not None:
            return [LogColumn(f"row number at {reference.strip()}", "row number", "", ROW_NUMBER)]
        is_list = "," in reference and not self.log.columns_called(reference)
        references = [part.strip() for part in reference.split(",")] if is_list else [reference]
        return [self._column_of_reference(TIME, part) for part in references]

    def _times_by_name(self, file: str) -> list[LogColumn]:
        """Return the columns named like a time, of the log itself or of a file that was joined."""
        columns = [column for column in self.log.columns if column.file == file]
        named = [
            column
            for column in columns
            if plain_name(column.name.rpartition(".")[2]) in _TIME_NAMES
            and (column.meaning.evidence != "unit" or column.meaning.quantity == "time")
        ]
        return [column for column in columns if column.header == TIME] or named

    def _assigned_columns(self, times: Sequence[LogColumn]) -> dict[str, LogColumn | None]:
        """Return the column of each channel, from the user or its name; None for an unmeasured output.

        The log is refused if a channel has no column, unless it is an output and no column is unassigned.
        """
        mapped = [channel for channel in self.channels if channel in self.options.columns]
        columns = {channel: self._column_from_user(channel) for channel in mapped}
        self._refuse_repeated_columns(columns)
        taken = [*times, *columns.values()]
        missing = [] if times or self.log.times else [TIME]
        for channel in [channel for channel in self.channels if channel not in columns]:
            named = [column for column in self._named_like(channel) if column not in taken]
            if len(named) == 1:
                columns[channel] = named[0]
            else:
                missing.append(channel)
        used = [*times, *(part for column in columns.values() if column for part in column.in_file)]
        unused = [column for column in self.log.columns if column not in used and column.kind != "text"]
        if missing and (unused or not set(missing) <= set(self.machine.output_channels)):
            raise InputError(self._missing_text(missing, unused))
        return columns | dict.fromkeys(missing)

    def _named_like(self, channel: str) -> list[LogColumn]:
        """Return the columns with the name of a channel, except those with another quantity's unit."""
        return [
            column
            for column in self.log.columns_named_like(channel)
            if column.header == channel
            or column.meaning.evidence != "unit"
            or (not self._obstacle(channel, column) and column.meaning.family != "speed")
        ]

    def _obstacle(self, channel: str, column: LogColumn) -> str:
        """Say why a column cannot be a channel, see `obstacle`; "" if it can."""
        unit = self.options.units.get(channel)
        stated = None if unit is None else normalize_unit(unit)
        return obstacle(self.machine, channel, column.meaning, stated, scaled=channel in self.options.scales)

    def _column_from_user(self, channel: str) -> LogColumn | None:
        """Return the column that the user named for a channel; None for an output that was not measured."""
        reference = self.options.columns[channel]
        if reference.lower() not in (NOT_MEASURED, ""):
            return self._column_of_reference(channel, reference)
        if channel not in self.machine.output_channels:
            option = _map_option(channel, reference)
            raise InputError(f"{option}: only outputs may be left out. {self._channels_text()}")
        return None

    def _refuse_repeated_columns(self, columns: Mapping[str, LogColumn | None]) -> None:
        """Refuse a column that the user assigned to two measurements; one voltage may supply two drives."""
        channel_of: dict[str, str] = {}
        for channel in self.machine.output_channels:
            column = columns.get(channel)
            if column is None:
                continue
            first = channel_of.setdefault(column.header, channel)
            if first != channel:
                options = f"{_map_option(first, column.header)} {_map_option(channel, column.header)}"
                problem = "one column cannot be two measurements; correct one of them"
                raise InputError(f"{self.log.path}: {options}: {problem}{self._if_not_measured(channel)}")

    def _column_of_reference(self, channel: str, reference: str) -> LogColumn:
        """Return the one column that a user's reference names, or the sum of columns and a number."""
        columns = self.log.columns_called(reference)
        if len(columns) == 1:
            return columns[0]
        if not columns and (terms := self.log.terms_called(reference)):
            return self._sum(channel, reference, terms)
        if not columns and (number := _NUMBER_ADDED.fullmatch(reference)):
            terms = self.log.terms_called(number[1])
            if terms:
                return self._sum(channel, reference, terms, float(number[2] + number[3]))
        problem = "several columns have this name" if columns else "there is no such column"
        problem += f"; the columns are {headers_text(self.log.columns)}{self._if_not_measured(channel)}"
        raise InputError(f"{self.log.path}: {_map_option(channel, reference)}: {problem}")

    def _sum(
        self,
        channel: str,
        reference: str,
        terms: tuple[tuple[float, LogColumn], ...],
        constant: float = 0.0,
    ) -> LogColumn:
        """Return the sum of columns, which must have one unit and one time, and a constant in this unit."""
        first = terms[0][1]
        for _, other in terms:
            differences = {
                f"{other.header} contains no numbers": other.kind != "number",
                (
                    f"{first.header} is in {first.unit or 'no unit'} "
                    f"and {other.header} in {other.unit or 'no unit'}"
                ): other.unit != first.unit,
                f"{first.header} and {other.header} have different times": (
                    (other.rows, other.time) != (first.rows, first.time)
                ),
            }
            for problem in (text for text, found in differences.items() if found):
                raise InputError(
                    f"{self.log.path}: {_map_option(channel, reference)}: {problem}; "
                    "only numbers of one unit that were logged together can be added"
                )
        header = "".join(f" {'-' if sign < 0.0 else '+'} {column.header}" for sign, column in terms)
        header = header.removeprefix(" + ").strip()
        if constant:
            header += f" {'-' if constant < 0.0 else '+'} {abs(constant):g}"
        return LogColumn(header, header, first.unit, "number", first.rows, first.time, terms, constant)

    def _time_of(self, column: LogColumn, times: Sequence[LogColumn]) -> LogColumn:
        """Return a column's time: the stated one, that of equal length, or in a table the next left."""
        column = column.in_file[0]
        if column.time is not None:
            same = [time for time in times if time.time == column.time]  # another time that the user named
            return same[0] if same else column.time
        own = [time for time in times if time.file == column.file]
        if times[0].kind == ROW_NUMBER or not own:
            return times[0]  # of another file that was joined: row by row
        times = own
        if column.rows is not None:
            return self._time_of_equal_length(column, times)
        position = self.log.columns.index
        preceding = [time for time in times if position(time) < position(column)]
        return max(preceding, key=position) if preceding else times[0]

    def _time_of_equal_length(self, column: LogColumn, times: Sequence[LogColumn]) -> LogColumn:
        """Return the time with as many values as a column, in a file of vectors of different lengths."""
        equal = [time for time in times if time.rows == column.rows]
        own = [time for time in equal if _structure(time) == _structure(column)]
        for found in (equal, own):
            if len(found) == 1:
                return found[0]
        if equal:
            choices = " or ".join(_map_option(TIME, time.header) for time in equal)
            raise InputError(
                f"{self.log.path}: several times have the length of {column.header}: add {choices}"
            )
        lengths = ", ".join(f"{time.header} {time.rows}" for time in times)
        problem = f"has {column.rows} values, but the times have: {lengths}"
        raise InputError(
            f"{self.log.path}, {column.header}: {problem}; {self._advice_about_time(column, times)}"
        )

    def _advice_about_time(self, column: LogColumn, times: Sequence[LogColumn]) -> str:
        """Say how to give a column a time, if none of the times has its length."""
        candidates = [c.header for c in self.log.columns if c.rows == column.rows and c != column]
        if not candidates:
            return "the log needs a time of this length"
        its_time = candidates[0] if len(candidates) == 1 else "COLUMN"
        option = _map_option(TIME, ",".join([*(time.header for time in times), its_time]))
        advice = f"rename its time to t or time in the log, or list all times: {option}"
        return advice if len(candidates) == 1 else f"{advice} (of this length: {', '.join(candidates)})"

    def _source(self, channel: str, column: LogColumn | None, time: ChannelSource | None) -> ChannelSource:
        """Return the source of a channel, with the conversion of its column."""
        if column is None:
            return ChannelSource(channel, None, None, Conversion(), "not measured: the cells stay empty")
        if column.kind == ROW_NUMBER:
            rate = parse_rate(self.options.columns[channel])
            assert rate is not None
            return ChannelSource(channel, column, None, Conversion(denominator=rate), "to s")
        if column.kind == "stamp":
            if channel == TIME:
                return ChannelSource(channel, column, None, Conversion(), "time stamps to s")
            problem = f"contains dates or times of day; {channel} needs numbers. Map another column to it"
            raise InputError(
                f"{self.log.path}, column {column.header}: {problem}{self._if_not_measured(channel)}"
            )
        problem = self._obstacle(channel, column)
        if problem:
            place = _map_option(channel, self.options.columns.get(channel, column.header))
            raise InputError(
                f"{self.log.path}: {place}: {column.header} is {problem}{self._if_not_measured(channel)}"
            )
        set_by_user = channel in self.options.units or channel in self.options.scales
        is_assumed = self._stated_unit(channel, column) is None and channel not in self.options.scales
        conversion, integrate, remark = self._conversion(channel, column)
        return ChannelSource(channel, column, time, conversion, remark, is_assumed, integrate, set_by_user)

    def _conversion(self, channel: str, column: LogColumn) -> UnitConversion:
        """Return the conversion of a column from the stated unit, if any, followed by the user's factor."""
        unit, scale = self._stated_unit(channel, column), self.options.scales.get(channel)
        accepted = accepted_units(self.machine, channel)
        rate = parse_rate(unit) if unit is not None and channel == TIME else None
        if rate is not None:  # of a counter
            accepted[str(unit)] = UnitConversion(Conversion(denominator=rate), False, f"steps at {unit} to s")
        where = f"{self.log.path}, column {column.header}"
        if unit is not None and unit not in accepted:
            raise InputError(f"{where}: {wrong_unit_message(self.machine, channel, unit)}")
        integrated = channel_dimension(self.machine, channel) in SPEED_UNITS
        if unit is None and column.unit in ALL_SPEED_UNITS and integrated:
            raise InputError(f"{where}: {scaled_speed_message(self.machine, channel, column.unit)}")
        if unit is not None:
            from_unit = accepted[unit]
        else:
            assumption = f"no unit, taken as {SI_UNITS[channel_dimension(self.machine, channel)]}"
            from_unit = UnitConversion(Conversion(), False, assumption if scale is None else "")
        if scale is None:
            return from_unit
        remark = ", ".join(filter(None, [from_unit.remark, f"times {scale:.9g}"]))
        return UnitConversion(from_unit.conversion.scaled(scale), from_unit.integrate, remark)

    def _stated_unit(self, channel: str, column: LogColumn) -> str | None:
        """Return a column's unit that the user or the log states; None if a mere factor replaces it."""
        if channel in self.options.units:
            return normalize_unit(self.options.units[channel]) or None
        return None if channel in self.options.scales else column.unit or None

    def _missing_text(self, missing: Sequence[str], unused: Sequence[LogColumn]) -> str:
        """Return the message about channels without a column, with options to complete."""
        similar = {channel: self._named_like(channel) for channel in missing if channel != TIME}
        ambiguous = [
            f"{channel} may be {headers_text(columns)}"
            for channel, columns in similar.items()
            if len(columns) > 1
        ]
        problem = "; ".join(ambiguous) or f"no column is named like {', '.join(missing)}"
        assigned = [column for column in self.log.columns if column not in unused]
        if len(unused) > max(1, 2 * len(assigned)):  # rather than nearly the same list again
            not_assigned = f"all but {headers_text(assigned)}" if assigned else "all"
        else:
            not_assigned = headers_text(unused) or "none"
        return (
            f"{self.log.path}: {problem}. Columns of the log: {headers_text(self.log.columns)}. "
            f"Not assigned: {not_assigned}. {self._channels_text()}. "
            f"{self._advice_about_missing(missing, unused)}"
        )

    def _advice_about_missing(self, missing: Sequence[str], unused: Sequence[LogColumn]) -> str:
        """Return the advice that ends the message about channels without a column."""
        if not unused and TIME not in missing:
            inputs = [channel for channel in missing if channel in self.machine.input_channels]
            problem = (
                f"No column is unassigned, but {', '.join(inputs)} "
                f"{'has' if len(inputs) == 1 else 'have'} none"
            )
            return (
                f"{problem}. The commands must be recorded: "
                "add those of another file by --join FILE, or a column of zeros for a drive that was not used"
            )
        proposals = proposed_headers(self.machine, missing, unused)
        counters = [column for column in unused if _counts_rows(column)]
        has_no_time = TIME in missing and (
            bool(counters) or all(column.meaning.quantity or column.unit for column in unused)
        )
        if has_no_time and proposals[TIME] == NO_PROPOSAL:
            proposals[TIME] = _EXAMPLE_RATE
        sums = self._sums_of_set_points(missing, unused)
        options = (sums.get(channel) or _map_option(channel, proposals[channel]) for channel in missing)
        advice = f"Check and add: {' '.join(options)}"
        outputs = [channel for channel in missing if channel in self.machine.output_channels]
        if outputs:
            advice += f" (or {outputs[0]}={NOT_MEASURED}, if it was not measured)"
        if TIME in missing and proposals[TIME] == _EXAMPLE_RATE:
            advice += f"; no column is a time, so state the rate of the rows in place of {_EXAMPLE_RATE}"
            if counters:
                counter = _map_option(TIME, counters[0].header)
                advice += (
                    f", or, if {counters[0].header} counts at a known rate and rows may be missing, "
                    f"{counter} --unit {TIME}={_EXAMPLE_RATE}"
                )
        elif TIME in missing:
            advice += f"; if the log has no time column, state the rate, e.g. {TIME}={_EXAMPLE_RATE}"
        without = [
            channel
            for channel in missing
            if channel != TIME and proposals[channel] == NO_PROPOSAL and channel not in sums
        ]
        if without:
            advice += "; --join FILE adds the columns of another file with the same motion"
        of_tool = "" if sums else self._advice_about_tool(missing)
        return advice + self._explained_obstacle(without, unused) + of_tool

    def _rates_of_tool(self, channels: Sequence[str]) -> dict[str, tuple[float, float]]:
        """Return the commands per m along x and y, by channel, of motors that move a tool together."""
        machine = self.machine
        of_coordinate = {machine.input_channels[k]: c for c, k in machine.position_commands.items()}
        found = {}
        for channel in (channel for channel in channels if channel in of_coordinate):
            rates = rest_positions_per_axis(machine)[
                machine.coordinate_names.index(of_coordinate[channel])
            ].tolist()
            if len(rates) == 2 and rates[0] != 0.0 and math.isclose(abs(rates[1]), abs(rates[0])):
                found[channel] = (rates[0], rates[1])
        return found

    def _sums_of_set_points(self, channels: Sequence[str], unused: Sequence[LogColumn]) -> dict[str, str]:
        """Return the options that give motors their commands from columns with set points of the tool.

        Empty unless exactly one column in mm, or in m, has the name of each axis as a word of its name.
        """
        lengths = [c for c in unused if c.unit in _LENGTHS and c.meaning.family == "position"]
        along = [
            [c for c in lengths if axis.lower() in re.split(r"[^a-z0-9]+", c.name.lower())]
            for axis in self.machine.tool_axes
        ]
        if len(along) != 2 or any(len(columns) != 1 for columns in along):
            return {}
        if along[0][0].unit != along[1][0].unit:
            return {}
        x, y = along[0][0].header, along[1][0].header
        meters = _LENGTHS[along[0][0].unit]
        rates = self._rates_of_tool(channels)
        return {channel: _option_of_sum(channel, x, y, *rates[channel], meters) for channel in rates}

    def _advice_about_tool(self, channels: Sequence[str]) -> str:
        """Say how the motors' commands follow from set points of a tool that motors move together."""
        rates = self._rates_of_tool(channels)
        if not rates:
            return ""
        options = [
            _option_of_sum(channel, "X", "Y", rate, other, 1e-3) for channel, (rate, other) in rates.items()
        ]
        return (
            ". If the log has set points of the tool, X and Y in mm, the motors follow sum and difference: "
            f"{' '.join(options)} (with the names of the columns; for m 1000 times the factors)"
        )

    def _explained_obstacle(self, channels: Sequence[str], unused: Sequence[LogColumn]) -> str:
        """Say for the first channel without a proposal why the first column of a known quantity is not it.

        A second clock needs no explanation.
        """
        for channel in channels:
            for column in (column for column in unused if column.meaning.quantity != "time"):
                problem = self._obstacle(channel, column)
                if problem:
                    return f". {column.header} is {problem}"
        return ""

    def _if_not_measured(self, channel: str) -> str:
        """Return the sentence on how to leave out an output, to end a message; "" for other channels."""
        if channel not in self.machine.output_channels:
            return ""
        return f". If {channel} was not measured, add {_map_option(channel, NOT_MEASURED)}"

    def _channels_text(self) -> str:
        """Return a sentence with the channels of the machine."""
        inputs = ", ".join((*self.machine.input_channels, *self.machine.supply_channels))
        outputs = ", ".join(self.machine.output_channels)
        return f"Machine {self.machine.name!r} has {TIME}, inputs {inputs} and outputs {outputs}"


def _counts_rows(column: LogColumn) -> bool:
    """Return whether a column counts rows or ticks, by its name."""
    return column.meaning.quantity == "row number" and not column.meaning.role


def _structure(column: LogColumn) -> str:
    """Return the structure or timeseries of a file of vectors that a column is a member of, "" if of none."""
    return column.name.rpartition(".")[0] if column.rows is not None else ""


def _map_option(channel: str, reference: str) -> str:
    """Return the option that assigns a column to a channel, quoted for a shell."""
    return f"--map {quoted(f'{channel}={reference}')}"


def _option_of_sum(channel: str, x: str, y: str, rate: float, other: float, meters: float) -> str:
    """Return the options that give a motor the sum or difference of the columns of a tool's set points.

    Args:
        x: Column of the set point along the first axis; `y` is that along the second.
        rate: Command per m along the first axis, rad/m or m/m; `other` is that along the second.
        meters: Unit of the columns, m.
    """
    total = f"{x} {'+' if other * rate > 0.0 else '-'} {y}"
    return f"{_map_option(channel, total)} --scale {channel}={rate * meters:.6g}"
