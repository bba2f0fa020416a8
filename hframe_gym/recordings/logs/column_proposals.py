"""Propose columns of a log for channels that no column's name matches."""

from __future__ import annotations

from collections.abc import Sequence

from ...machine import Machine
from ..quantities import QUANTITIES, meaning_of
from .log import LogColumn, plain_name
from .measurement_units import TIME, Dimension, accepted_units, channel_dimension
from .possible_maps import obstacle

NO_PROPOSAL = "COLUMN"  # in the proposed options, where no column may be the channel
# First letters of columns that a message proposes for a channel: u, v for voltages; x, y, z, "pos" for
# lengths; "phi", "angle", q, "encoder" for angles. Such a column is never assigned before the user confirms
# it.
_FIRST_LETTERS: dict[Dimension, str] = {
    "voltage": "uv",
    "length": "xyzp",
    "angle": "paqe",
    "time": "t",
    "current": "i",
    "torque": "tm",
    "force": "f",
    "duty cycle": "d",
    "linear speed": "v",
    "angular speed": "wo",
    "linear acceleration": "a",
    "angular acceleration": "a",
}
_INPUT_NAMES = ("u", "input", "cmd", "command", "control")  # of what drives a machine, in any quantity
# Quantities whose commands are set points.
_SET_POINTS = ("length", "angle", "linear speed", "angular speed")


def proposed_headers(machine: Machine, missing: Sequence[str], unused: Sequence[LogColumn]) -> dict[str, str]:
    """Propose the header of a column for each unassigned channel, for the user to confirm.

    A column may be a channel by its unit, else by a name of its quantity, else by its first letter, such as u
    or v for a voltage. A column whose quantity is exactly that of one channel is not proposed for another
    channel, which would need a conversion. If several channels compete for fewer columns, none of them gets a
    proposal.

    Args:
        missing: Names of the channels without a column, and "time_s" if the times have none.
        unused: Columns of the log that no channel uses.

    Returns:
        Header by channel in `missing`; "COLUMN" (`NO_PROPOSAL`) if no column may be the channel.
    """
    candidates = {channel: _candidates(machine, channel, unused) for channel in missing}
    alike = {
        channel: [column for column in columns if column.meaning.family == _family(machine, channel)]
        for channel, columns in candidates.items()
    }
    claimed = [column for columns in alike.values() for column in columns]
    for channel, columns in candidates.items():
        candidates[channel] = alike[channel] or [column for column in columns if column not in claimed]
    proposed: dict[str, LogColumn] = {}
    for channel in sorted(missing, key=lambda channel: len(candidates[channel])):
        free = [column for column in candidates[channel] if column not in proposed.values()]
        unserved = [other for other in missing if other not in proposed and candidates[other]]
        competitors = [other for other in unserved if set(candidates[other]) <= set(free)]
        if free and len(competitors) <= len(free):
            proposed[channel] = free[0]
    return {channel: proposed[channel].header if channel in proposed else NO_PROPOSAL for channel in missing}


def _candidates(machine: Machine, channel: str, unused: Sequence[LogColumn]) -> list[LogColumn]:
    """Return the columns that may be a channel, the likeliest kind only.

    These are the columns with a unit of its quantity, else those that name it or count, else those with a
    unit that can be converted to it, else those that name another quantity that can be, else, for the command
    of a drive that follows a set point, those that are set points by name, else, for a command, those called
    "u", "input2" and the like, else those that begin with its letters, else the only one. A set point is not
    proposed for an output.
    """
    possible = [column for column in unused if _is_proposable(machine, channel, column)]
    accepted, dimension = accepted_units(machine, channel), channel_dimension(machine, channel)
    with_unit = [column for column in possible if column.unit in accepted]
    family = _family(machine, channel)
    of_family = [column for column in with_unit if column.meaning.family == family]
    named = [column for column in possible if column.meaning.quantity and column not in with_unit]
    named_so = [column for column in named if column.meaning.family in (family, "count")]
    letters = tuple(_FIRST_LETTERS[dimension])
    unknown = [column for column in possible if not column.meaning.quantity and not column.unit]
    follows = channel in machine.input_channels and dimension in _SET_POINTS
    set_points = [column for column in unknown if follows and column.meaning.role == "set point"]
    is_input = channel in machine.input_channels
    inputs = [c for c in unknown if is_input and plain_name(c.name).rstrip("0123456789") in _INPUT_NAMES]
    by_letter = [column for column in unknown if plain_name(column.name).startswith(letters)]
    only_one = unknown if len(unused) == 1 and channel != TIME else []
    return of_family or named_so or with_unit or named or set_points or inputs or by_letter or only_one


def _family(machine: Machine, channel: str) -> str:
    """Return the family of the quantity of a channel."""
    dimension = channel_dimension(machine, channel)
    return QUANTITIES[dimension].family or dimension


def _is_proposable(machine: Machine, channel: str, column: LogColumn) -> bool:
    """Return whether a column can be a channel by its quantity, perhaps once the user states its unit."""
    meaning = column.meaning
    if channel == TIME and meaning.quantity == "row number":
        return False  # without the rate of its steps, it is no time
    is_output = channel in machine.output_channels
    if is_output and meaning.role:
        return False
    if not is_output and _is_signal_of_sensor(column):
        return False
    if meaning.quantity == "duty cycle" and channel in machine.input_channels:
        return True
    counts_for_input = meaning.family in ("count", "row number") and not is_output
    return not counts_for_input and not obstacle(machine, channel, meaning, None, scaled=False)


def _is_signal_of_sensor(column: LogColumn) -> bool:
    """Return whether a column has the voltage of an analog sensor, such as "encoder_V", by its name."""
    named = meaning_of(column.name, "").family
    return column.meaning.quantity == "voltage" and named in ("position", "speed", "acceleration")
