"""Represent findings about recordings, print them and write them as JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..errors import InputError, name_runs
from ..files import write_text
from ..machine import DRIVE_KINDS, Drive, Machine

Severity = Literal["fault", "advice", "note"]

_SCHEMA_VERSION = 1
_STYLES: dict[Severity, str] = {"fault": "bold red", "advice": "yellow", "note": "dim"}


@dataclass(frozen=True)
class Finding:
    """One result of a check of recordings.

    Attributes:
        severity: "fault" for a certain mistake in the data, which makes a fit meaningless; "advice" for
            something that is suspect or impairs identification; "note" for a property of the data.
        run: Name of the recording, or "" if the finding is about all of them.
        channel: Name of the column, coordinate or parameter that the finding is about, or "".
        message: What was found, as one sentence.
    """

    severity: Severity
    run: str
    channel: str
    message: str

    def __str__(self) -> str:
        """Return the finding as one line of text: "severity: run, channel: message"."""
        subject = ", ".join(part for part in (self.run, self.channel) if part)
        return (
            f"{self.severity}: {subject}: {self.message}" if subject else f"{self.severity}: {self.message}"
        )


def channel_unit(channel: str, machine: Machine) -> str:
    """Return the unit in which messages state the values of a channel.

    Args:
        channel: Name of an input or output of the machine.

    Returns:
        The unit of the drive's command or of the sensor. Where the kind does not determine it, the end of the
        channel's name does: "A" or "Nm" for a drive of the kind "voltage", "m" or "rad" for a sensor of
        positions.
    """
    ending = channel.rpartition("_")[2]
    if channel in machine.input_channels:
        drive = machine.drives[machine.input_channels.index(channel)]
        if drive.kind != "voltage":
            return machine.command_unit(drive)
        return ending if ending in ("A", "Nm") else "V"
    sensor = machine.sensor(channel)
    return ending if sensor.of_position and ending in ("m", "rad") else machine.sensor_unit(sensor)


def command_in_words(value: float, drive: Drive, machine: Machine) -> str:
    """Format a drive's command with its unit, as its channel has it, for a message.

    Args:
        value: Command as in `Recording.inputs`, in the unit of simulations: V, A, Nm, or that of a set point.

    Returns:
        Number and unit, such as "3 V". A duty cycle, which is a voltage in simulations, is stated as a
        fraction of the rated voltage with the voltage in brackets.
    """
    text = f"{value + 0.0:.4g} {channel_unit(drive.channel, machine)}"  # never -0
    if not DRIVE_KINDS.get(drive.kind).fraction:
        return text
    return f"{value / drive.rated_voltage + 0.0:.4g} of the rated voltage ({text})"


def group_findings(findings: Sequence[Finding]) -> list[Finding]:
    """Merge equal findings of several runs into one, so that a defect of all runs is printed only once.

    Findings belong to one group if severity, channel and message are equal; numbers in the message may
    differ. Findings about all runs together (`run` is "") are merged only if their messages are identical.

    Returns:
        The first finding of each group, in the order of first occurrence. Its `run` names the first run and
        the number of further ones, for example "run_01 and 2 more runs".
    """
    groups: dict[tuple[str, str, str, bool], list[Finding]] = {}
    for finding in findings:
        text = re.sub(r"\d[\d.e+-]*", "#", finding.message) if finding.run else finding.message
        groups.setdefault((finding.severity, finding.channel, text, bool(finding.run)), []).append(finding)
    return [_merged(group) for group in groups.values()]


def _merged(group: list[Finding]) -> Finding:
    """Return the first finding of a group with the number of further runs, if the group has several runs."""
    return replace(group[0], run=name_runs([finding.run for finding in group]))


def print_findings(findings: Sequence[Finding], console: Console) -> None:
    """Print the number of findings of each severity, then the findings.

    `group_findings` merges equal findings of several runs first. A terminal shows a table, other output one
    line of text per finding.
    """
    groups = group_findings(findings)
    plurals = {"fault": "faults", "advice": "advice", "note": "notes"}
    counts = (f"{plurals[kind]}: {sum(finding.severity == kind for finding in groups)}" for kind in _STYLES)
    console.print(", ".join(counts), markup=False, highlight=False)
    if console.is_terminal:
        table = Table(box=None)
        for column in ("", "run", "channel", "finding"):
            table.add_column(column, overflow="fold")  # names are never cut
        for finding in groups:
            severity = f"[{_STYLES[finding.severity]}]{finding.severity}[/]"
            table.add_row(severity, finding.run, finding.channel, escape(finding.message))
        console.print(table, soft_wrap=False)
    else:
        for finding in groups:
            console.print(str(finding), markup=False, highlight=False)


def refuse_faults(findings: Sequence[Finding], folder: Path) -> None:
    """Raise an error if a finding is a fault.

    Args:
        folder: Folder of the recordings, for the message.

    Raises:
        InputError: If there is a fault. The message lists all, with file and channel, and names --force.
    """
    faults = [finding for finding in findings if finding.severity == "fault"]
    if not faults:
        return
    lines = []
    for fault in group_findings(faults):
        file = f"{folder / fault.run}" if fault.run else f"all runs of {folder}"
        lines.append(f"{file}{f', column {fault.channel}' if fault.channel else ''}: {fault.message}")
    raise InputError(
        f"faults in the data, nothing was fitted (--force fits nevertheless): {'; '.join(lines)}"
    )


def write_findings(findings: Sequence[Finding], path: Path) -> None:
    """Write findings as JSON: `{"schema": 1, "findings": [{"severity", "run", "channel", "message"}]}`.

    Args:
        path: File to write; its folder is created if it does not exist, an existing file is replaced.
    """
    content = {"schema": _SCHEMA_VERSION, "findings": [asdict(f) for f in findings]}
    write_text(path, json.dumps(content, indent=1) + "\n")
