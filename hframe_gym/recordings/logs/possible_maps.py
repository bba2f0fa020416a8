"""Decide whether a column of a log can be a channel of a machine, by their physical quantities."""

from __future__ import annotations

from ...machine import Machine
from ..quantities import QUANTITIES, Meaning
from .measurement_units import ALL_SPEED_UNITS, SI_UNITS, TIME, accepted_units, channel_dimension

# What the output of a controller is often named after, although it is a voltage: a "torque" or "speed" that
# is written to an amplifier. For these the user may state a unit of voltage.
_COMMANDED = ("current", "torque", "force", "power", "speed", "position")
_VOLTS = ("V", "mV")
# What a sketch writes to its PWM is often called "speed" or "power".
_WRITTEN_TO_PWM = ("speed", "power")
# Percent and per unit mean a fraction of the supply voltage for these names ("throttle position"), and a
# fraction of a rated value for others, such as a torque.
_FRACTION_OF_VOLTAGE = (*_WRITTEN_TO_PWM, "position")
# Units of the signals of sensors and amplifiers with an analog output; a factor converts them to what they
# stand for.
_ANALOG_UNITS = ("V", "mV", "mA")
_AMPLIFIER_COMMANDS = ("current", "torque", "force")
_MOTIONS = ("length", "angle")
_COUNTS = ("row number", "count")


def obstacle(machine: Machine, channel: str, column: Meaning, unit: str | None, *, scaled: bool) -> str:
    """Return why a column cannot be a channel, because it is another physical quantity, or "" if it can.

    A unit in the log is certain, a name is a guess: a unit that the user states overrides the name if a
    controller's output may have such a name. A column whose header says nothing can be any quantity.

    Args:
        unit: Unit that the user stated for the channel (--unit); None if none is stated.
        scaled: Whether the user stated a factor (--scale).

    Returns:
        Two quantities and what is possible, as the end of a message, without a stop at its end; "" if the
        column can be the channel.
    """
    if not column.quantity or _is_possible(machine, channel, column, unit, scaled):
        return ""
    dimension = channel_dimension(machine, channel)
    advice = _advice(machine, channel, column)
    return f"{column.in_words}, and {channel} is {QUANTITIES[dimension].article} {dimension}; {advice}"


def _is_possible(machine: Machine, channel: str, column: Meaning, unit: str | None, scaled: bool) -> bool:
    """Return whether a column of a known quantity can be a channel."""
    dimension, family = channel_dimension(machine, channel), column.family
    if family == (QUANTITIES[dimension].family or dimension):
        # A name may say that the motion is of the other kind, which only a unit or a factor converts.
        other_motion = (
            column.evidence == "name" and column.quantity in _MOTIONS and column.quantity != dimension
        )
        return not other_motion or scaled or unit is not None
    if channel == TIME and column.evidence == "name" and unit in accepted_units(machine, TIME):
        # The curve's name of a plotting tool, "effort_x,effort_y"; times that do not rise are refused.
        return True
    if channel == TIME:
        return family in _COUNTS and (scaled or unit is not None)
    if family == "count":
        return True
    if channel in machine.supply_channels:
        return scaled or unit in _VOLTS
    if channel in machine.output_channels:
        return _can_be_measurement(machine, channel, column, unit, scaled)
    return _can_be_command(machine, channel, column, unit, scaled)


def _can_be_measurement(
    machine: Machine, channel: str, column: Meaning, unit: str | None, scaled: bool
) -> bool:
    """Return whether a column of another quantity can be what a sensor measures."""
    is_position = channel_dimension(machine, channel) in _MOTIONS
    if column.evidence == "name" and not is_position and unit in accepted_units(machine, channel):
        return True
    if column.family == "row number":  # counts of an encoder, which are also called ticks
        return scaled
    if column.family == "speed":
        if unit is None:
            return column.evidence == "unit"
        return unit in ALL_SPEED_UNITS or unit not in accepted_units(machine, channel)
    if column.family == "current" and column.evidence == "name":  # or a present value, "current_speed"
        return scaled or unit in accepted_units(machine, channel)
    return scaled and (column.unit in _ANALOG_UNITS or (column.family == "voltage" and not column.unit))


def _can_be_command(machine: Machine, channel: str, column: Meaning, unit: str | None, scaled: bool) -> bool:
    """Return whether a column of another quantity can be the command of a drive."""
    dimension, family = channel_dimension(machine, channel), column.family
    if family == "duty cycle":
        return column.unit != "" or unit is not None or scaled
    if column.evidence == "unit":
        if column.unit in accepted_units(machine, channel):
            return True
        # The command of an amplifier that controls the speed, or the monitor of one that controls the
        # current.
        return scaled and (family == "speed" or (column.unit in _VOLTS and dimension != "voltage"))
    if unit in _VOLTS and dimension == "voltage":
        return family in _COMMANDED
    if unit in ("%", "pu"):
        return family in _FRACTION_OF_VOLTAGE
    if unit is not None:
        return unit in accepted_units(machine, channel) and family in _COMMANDED
    is_current = family in _AMPLIFIER_COMMANDS and _has_no_back_emf(machine, channel)
    return scaled and (family in _WRITTEN_TO_PWM or is_current)


def _has_no_back_emf(machine: Machine, channel: str) -> bool:
    """Return whether the drive of an input is declared as an amplifier that controls the current."""
    return machine.drives[machine.input_channels.index(channel)].Ke == 0.0


def _option_of_unit(machine: Machine, channel: str) -> str:
    """Return the option --unit with the units that a channel's column may have."""
    return f"--unit {channel}=UNIT ({', '.join(accepted_units(machine, channel))})"


def _advice(machine: Machine, channel: str, column: Meaning) -> str:
    """Return what is possible in place of an impossible map."""
    family = column.family
    by_unit = _option_of_unit(machine, channel)
    unit_or_factor = f"state its unit by {by_unit}, or a factor by --scale {channel}=FACTOR"
    if channel == TIME:
        if family in _COUNTS:
            return (
                f"state the rate of its steps by --unit {TIME}=8kHz, "
                f"or a factor to s by --scale {TIME}=FACTOR"
            )
        advice = f"for a log without a column of time state the rate of its rows, e.g. --map {TIME}=200Hz"
        if column.evidence == "name":
            return f"{advice}; add --unit {TIME}=s if the column is a time in spite of its name"
        return advice
    if channel in machine.input_channels:
        if family in _AMPLIFIER_COMMANDS and _has_no_back_emf(machine, channel):
            return unit_or_factor
        if family in _AMPLIFIER_COMMANDS:
            return _advice_about_commands(channel, column)
        if family == "duty cycle":
            return (
                f"state its unit by --unit {channel}=% or --unit {channel}=pu (1 is the rated voltage), "
                f"or the volts of one step by --scale {channel}=FACTOR"
            )
        if family == "voltage":
            return "describe its drive with the kind voltage and a channel such as u_V (docs/own_machine.md)"
        commanded = channel_dimension(machine, channel)
        advice = f"map the {commanded} that was commanded; a log without its commands cannot be used"
        if commanded == "voltage":
            advice = "map the voltage or the duty cycle that was applied"
        if family in _COMMANDED and column.evidence == "name":
            unit = SI_UNITS[commanded]
            return (
                f"{advice}, or add --unit {channel}={unit} if the column is "
                f"the {commanded} in spite of its name"
            )
        return advice
    dimension = channel_dimension(machine, channel)
    if dimension not in _MOTIONS:
        advice = f"map a measured {dimension}"
        if column.evidence == "name":
            return (
                f"{advice}, or state the unit by {by_unit} if the column is "
                f"the {dimension} in spite of its name"
            )
        if column.unit in _ANALOG_UNITS:
            return f"{advice}, or state the factor to {SI_UNITS[dimension]} by --scale {channel}=FACTOR"
        return advice
    if family == "position":
        return unit_or_factor
    if family == "speed":
        si_units = ", ".join(unit for unit in accepted_units(machine, channel) if unit in ALL_SPEED_UNITS)
        return f"a speed is integrated to it if its unit is one of {si_units}: --unit {channel}=UNIT"
    if family in ("voltage", "current") and column.unit in ("", *_ANALOG_UNITS):
        return (
            f"if it is the signal of a sensor, state the factor to {SI_UNITS[dimension]} "
            f"by --scale {channel}=FACTOR"
        )
    return "map a position, or a speed, which is integrated"


def _advice_about_commands(channel: str, column: Meaning) -> str:
    """Say how a machine with a current, torque or force as its input is described."""
    description = {
        "current": "the kind current and the channel i_A",
        "torque": "the kind torque and the channel torque_Nm",
        "force": "Ke 0, resistance 1, Kt 1, gear_ratio 1 and the channel force_N",
    }
    advice = (
        f"map the voltage that was applied, or, if the amplifier controls the {column.family}, "
        f"describe its drive with {description[column.family]} (docs/own_machine.md)"
    )
    if column.evidence == "name" and not column.unit:
        return f"{advice}; add --unit {channel}=V only if the column is a voltage in spite of its name"
    return advice
