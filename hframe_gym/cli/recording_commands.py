"""Commands on recordings of a machine: examples, import, check, identify, report."""

from __future__ import annotations

import os
import webbrowser
from collections.abc import Sequence
from contextlib import nullcontext
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ..atomic_files import output_batch, remove_file
from ..errors import InputError
from ..locked_folders import locked_folder
from .app import MachineOption, MaxRowsOption, OutOption, RecordingsArgument, app, console, log
from .support import FAULT_FOUND, progress_bar, require_folder, require_several_runs


class RunFormats(StrEnum):
    """File formats of recordings."""

    CSV_GZ = "csv.gz"
    CSV = "csv"
    PARQUET = "parquet"


@app.command()
def examples(
    out: Annotated[Path, typer.Option(help="Folder to create; an existing one is not replaced.")],
) -> None:
    """Copy the example recordings of two rigs, their description and the notebooks to a new folder.

    Example:  hframe examples --out examples
    """
    from ..recordings import copy_examples

    copied = copy_examples(out)
    log(f"wrote {', '.join(map(str, copied))}")
    log(f"Next: hframe check {out / 'rig_a'}, then hframe identify {out / 'rig_a'} --out {Path('out', 'rig_a')}")


@app.command("import")
def import_logs(
    logs: Annotated[Path, typer.Argument(help="A log, or a folder of logs: text, MATLAB .mat or Parquet.")],
    out: Annotated[Path, typer.Option(help="Folder for the recordings; existing runs are never replaced.")],
    machine: MachineOption = "hframe",
    map: Annotated[
        list[str] | None, typer.Option(help="CHANNEL=COLUMN, e.g. v1_V=U1, x_m='#4' (fourth column) or y_m=none.")
    ] = None,
    unit: Annotated[list[str] | None, typer.Option(help="CHANNEL=UNIT, e.g. phi1_rad=deg, v1_V=%, time_s=ms.")] = None,
    scale: Annotated[
        list[str] | None, typer.Option(help="CHANNEL=FACTOR to the channel's unit, e.g. x_m=0.001.")
    ] = None,
    mapping: Annotated[
        Path | None, typer.Option(help="TOML or JSON file with the tables map, unit and scale; options override it.")
    ] = None,
    split_at_rests: Annotated[
        bool, typer.Option("--split-at-rests", help="Cut each log into runs where the machine rests.")
    ] = False,
    min_rest: Annotated[
        float, typer.Option(min=0.01, max=3600.0, help="Shortest rest at which a log is cut, s.")
    ] = 0.5,
    format: Annotated[RunFormats, typer.Option(help="Format of the recordings.")] = RunFormats.CSV_GZ,
) -> None:
    """Convert logs to recordings: any separator, decimal mark and encoding, other names and units, several rates.

    Columns are assigned by --map, or if their name without unit is that of a channel ("X (mm)" for x_m). Nothing else
    is guessed. Everything that is converted, assumed or left out is printed. docs/import.md lists what is handled.

    Example:  hframe import log.txt --map v1_V=U1 --map v2_V=U2 --unit phi1_rad=deg --out runs --split-at-rests
    """
    from ..recordings import ImportSettings, MappingOptions, load_machine, parse_factor, read_mapping_file
    from ..recordings import import_logs as run_import

    from_file = read_mapping_file(mapping) if mapping is not None else MappingOptions()
    scales = {channel: parse_factor(f"--scale {channel}={value}", value) for channel, value in _pairs("scale", scale)}
    options = MappingOptions(
        {**from_file.columns, **dict(_pairs("map", map))},
        {**from_file.units, **dict(_pairs("unit", unit))},
        {**from_file.scales, **scales},
    )
    declared = load_machine(machine)
    settings = ImportSettings(options, split_at_rests, min_rest, format.value)
    with progress_bar("import") as progress:
        files = run_import(logs, out, declared, settings, log, progress)
    log(f"wrote {len(files)} run{'s' if len(files) > 1 else ''} to {out}. Next: hframe check {out} --machine {machine}")


@app.command()
def check(
    runs_dir: RecordingsArgument,
    machine: MachineOption = "hframe",
    json: Annotated[Path | None, typer.Option(help="Also write the findings to this file.")] = None,
    max_rows: MaxRowsOption = 4_000_000,
) -> None:
    """Check recordings before a fit: clock, sensors, wiring, excitation and which parameters can be estimated.

    The exit code is 1 if a fault is found (the data contradict themselves), else 0.

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
        raise typer.Exit(FAULT_FOUND)


@app.command()
def identify(
    runs_dir: RecordingsArgument,
    out: OutOption,
    machine: MachineOption = "hframe",
    hold_out: Annotated[
        list[str] | None, typer.Option(help="A run to evaluate on instead of fitting it; repeat for more runs.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, max=1024, help="Number of threads (default: all cores).")] = None,
    # Has no effect, because identification draws no random numbers; scripts that pass it keep working.
    seed: Annotated[int, typer.Option(hidden=True)] = 0,
    force: Annotated[
        bool, typer.Option("--force", help="Fit although `hframe check` finds faults in the data.")
    ] = False,
    max_rows: MaxRowsOption = 1_000_000,
) -> None:
    """Fit a machine to its recordings, find the effects that its model lacks, and verify them on held-out runs.

    The recordings are checked first; faults (see `hframe check`) stop the command before anything is fitted. Every
    fourth run is held out unless --hold-out names others: it is not fitted and gives the errors of the report. The
    folder --out receives report.json, the declared, refitted and corrected machine, report.html and its plots.

    Example:  hframe identify examples/rig_a --out out/rig_a
    """
    from ..identification import identify as run_identification
    from ..identification import write_result
    from ..identification.report import build_report, verdict_sentence
    from ..recordings import load_machine, load_recordings
    from .support import check_recordings_before_fit, log_time_estimate, proposed_formulas
    from .tables import identification_table

    if jobs:
        os.environ["HFRAME_THREADS"] = str(jobs)
    declared = load_machine(machine)
    with locked_folder(require_folder(out)):
        with progress_bar("reading") as progress:
            recordings = load_recordings(runs_dir, declared, progress, max_rows=max_rows, log=log)
        require_several_runs(recordings, runs_dir)
        findings = check_recordings_before_fit(recordings, declared, None if force else runs_dir, log)
        log_time_estimate(recordings, declared, log)
        result = run_identification(recordings, declared, held_out=hold_out or (), log=log)
        contents, channels = result.as_json(), list(declared.output_channels)
        console.print(identification_table(contents, channels))
        log(verdict_sentence(contents, channels))
        with output_batch(out):
            write_result(result, out, findings, proposed_formulas(result, log))
            problem = None
            try:
                build_report(out)
            except Exception as error:  # the result itself must not be lost
                remove_file(out / "report.html")  # of an older result
                problem = error
    if problem is not None and not isinstance(problem, ImportError):
        raise problem
    log(f"wrote {out / 'report.html'}" if problem is None else f"report.html not written: {problem}")


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(help="A folder that `hframe identify` wrote.")],
    open: Annotated[bool, typer.Option("--open", help="Open the report in the browser.")] = False,
) -> None:
    """Build report.html, one self-contained page, from the files of an identification.

    Example:  hframe report out/rig_a --open
    """
    from ..identification.report import build_report

    page = build_report(folder)
    log(f"wrote {page}")
    if open:
        webbrowser.open(page.resolve().as_uri())


def _pairs(option: str, values: Sequence[str] | None) -> list[tuple[str, str]]:
    """Split the values CHANNEL=VALUE of a repeated option."""
    pairs = []
    for text in values or ():
        channel, sign, value = text.partition("=")
        if not sign or not channel.strip():
            raise InputError(f"--{option} {text}: must be CHANNEL={'COLUMN' if option == 'map' else option.upper()}")
        pairs.append((channel.strip(), value.strip()))
    return pairs
