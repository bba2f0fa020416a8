"""Commands on recordings of a machine: examples, import and check."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from ..errors import InputError
from ..operating_system import quoted
from .application import app
from .identify_steps import proposed_output
from .messages import FAULT_FOUND
from .options import MachineOption, MaxRowsOption, RecordingsArgument, RunFormats
from .output import console, log
from .progress import progress_bar

if TYPE_CHECKING:
    from ..recordings import MappingOptions


@app.command()
def examples(out: Annotated[Path, Option(help="Folder to create; an existing one is not replaced.")]) -> None:
    """Copy the example recordings of two rigs, their description and example notebooks to a new folder.

    Example:  hframe examples --out examples
    """
    from ..recordings import copy_examples

    copied = copy_examples(out)
    log(f"wrote {', '.join(map(str, copied))}")
    log(
        f"Next: hframe check {out / 'rig_a'}, then hframe identify {out / 'rig_a'} "
        f"--out {Path('out', 'rig_a')}"
    )


@app.command("import")
def import_logs(
    logs: Annotated[
        list[Path],
        Argument(help="Logs or folders of logs: text, MATLAB, Parquet, LeRobot, WPILib, ROS, MCAP, Klipper."),
    ],
    out: Annotated[Path, Option(help="Folder for the recordings; existing runs are never replaced.")],
    machine: MachineOption = "hframe",
    map: Annotated[
        list[str] | None,
        Option(
            help="CHANNEL=COLUMN, e.g. v1_V=U1, x_m='#4' (fourth column), "
            "y_m=none, or time_s=200Hz without a column."
        ),
    ] = None,
    unit: Annotated[
        list[str] | None,
        Option(help="CHANNEL=UNIT, e.g. phi1_rad=deg, v1_V=%, time_s=ms, or time_s=8kHz for a counter."),
    ] = None,
    scale: Annotated[
        list[str] | None, Option(help="CHANNEL=FACTOR to the channel's unit: x_m=0.001.")
    ] = None,
    mapping: Annotated[
        Path | None,
        Option(help="TOML or JSON file with the tables map, unit and scale; options override it."),
    ] = None,
    split_at_rests: Annotated[
        bool, Option("--split-at-rests", help="Cut each log into runs where the machine rests.")
    ] = False,
    min_rest: Annotated[
        float, Option(min=0.01, max=3600.0, help="Shortest rest at which a log is cut, s.")
    ] = 0.5,
    split_every: Annotated[
        float | None,
        Option(
            min=0.5,
            max=3600.0,
            help="Cut each log into runs of about this duration, s, also where the machine moves.",
        ),
    ] = None,
    cut: Annotated[
        list[str] | None,
        Option(help="FROM:TO, s: keep this part of each log as a run; LOG=FROM:TO of one log; repeatable."),
    ] = None,
    join: Annotated[
        list[Path] | None,
        Option(help="Another file with columns of the same motion, such as the commands; repeat for more."),
    ] = None,
    format: Annotated[RunFormats, Option(help="Format of the recordings.")] = RunFormats.CSV_GZ,
) -> None:
    """Convert logs of controllers and data loggers to recordings, which the other commands read.

    Logs may have any separator, decimal mark and encoding, other names and units, and several sampling rates.
    A column is assigned by --map, or if it alone has the name of a channel, with any unit ("X (mm)" for x_m).
    Nothing else is guessed, and a column of another physical quantity is refused. "A + B" adds columns, "A -
    B" subtracts them. A table shows what each column was taken for. docs/import.md lists what is handled.

    Example:  hframe import log.txt --map v1_V=U1 --map v2_V=U2 --unit x_m=mm --out runs --split-at-rests
    """
    from ..recordings import ImportSettings, load_machine, parse_interval
    from ..recordings import import_logs as run_import

    options = _mapping_options(mapping, map, unit, scale)
    intervals = tuple(parse_interval(text) for text in cut or ())
    settings = ImportSettings(
        options, split_at_rests, min_rest, format.value, split_every, intervals, tuple(join or ())
    )
    with progress_bar("import") as progress:
        files = run_import(logs, out, load_machine(machine), settings, log, progress)
    next_command = f"hframe check {quoted(str(out))} --machine {quoted(machine)}"
    log(f"wrote {len(files)} run{'s' if len(files) > 1 else ''} to {out}. Next: {next_command}")


def _mapping_options(
    file: Path | None,
    columns: Sequence[str] | None,
    units: Sequence[str] | None,
    scales: Sequence[str] | None,
) -> MappingOptions:
    """Return what --map, --unit and --scale assign to the channels, and --mapping where they do not."""
    from ..recordings import MappingOptions, parse_factor, read_mapping_file

    from_file = read_mapping_file(file) if file is not None else MappingOptions()
    factors = {
        channel: parse_factor(f"--scale {channel}={value}", value)
        for channel, value in _pairs("scale", scales)
    }
    return MappingOptions(
        {**from_file.columns, **dict(_pairs("map", columns))},
        {**from_file.units, **dict(_pairs("unit", units))},
        {**from_file.scales, **factors},
    )


def _pairs(option: str, values: Sequence[str] | None) -> list[tuple[str, str]]:
    """Split the values CHANNEL=VALUE of a repeated option."""
    pairs = []
    for text in values or ():
        channel, sign, value = text.partition("=")
        if not sign or not channel.strip():
            raise InputError(
                f"--{option} {text}: must be CHANNEL={'COLUMN' if option == 'map' else option.upper()}"
            )
        pairs.append((channel.strip(), value.strip()))
    return pairs


@app.command()
def check(
    runs_dir: RecordingsArgument,
    machine: MachineOption = "hframe",
    json: Annotated[Path | None, Option(help="Also write the findings to this file.")] = None,
    max_rows: MaxRowsOption = 4_000_000,
) -> None:
    """Check recordings before a fit: clock, sensors, wiring, excitation, and which parameters they determine.

    The exit code is 1 if there is a fault (an error in the data, such as a wrong sign), else 0.

    Example:  hframe check examples/rig_a
    """
    from ..data_validation import check_recordings, print_findings, write_findings
    from ..recordings import load_machine, load_recordings

    declared = load_machine(machine)
    with progress_bar("reading") as progress:
        recordings = load_recordings(runs_dir, declared, progress, max_rows=max_rows, log=log)
    with console.status("checking") if console.is_terminal else nullcontext():
        findings = check_recordings(recordings, declared)
    print_findings(findings, console)
    if json is not None:
        write_findings(findings, json)
        log(f"wrote {json}")
    if any(finding.severity == "fault" for finding in findings):
        log(
            "Next: correct what the faults name, and check again; "
            "`hframe identify` stops at faults without --force"
        )
        raise typer.Exit(FAULT_FOUND)
    words = (str(runs_dir), "--machine", machine, "--out", str(proposed_output(runs_dir)))
    log(f"Next: hframe identify {' '.join(map(quoted, words))}")
