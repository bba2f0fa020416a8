"""Commands on recordings of a machine: check, identify, report."""

from __future__ import annotations

import os
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from .app import MachineOption, OutOption, RecordingsArgument, app, console, log
from .support import FAULT_FOUND, reading_progress, require_folder, require_several_runs


@app.command()
def check(
    runs_dir: RecordingsArgument,
    machine: MachineOption = "hframe",
    json: Annotated[Path | None, typer.Option(help="Also write the findings to this file.")] = None,
) -> None:
    """Check recordings before a fit: clock, sensors, wiring, excitation and which parameters can be estimated.

    The exit code is 1 if a fault is found (the data contradict themselves), else 0.

    Example:  hframe check examples/rig_a
    """
    from ..data_validation import check_recordings, print_findings, write_findings
    from ..recordings import load_machine, load_recordings

    declared = load_machine(machine)
    with reading_progress("reading") as progress:
        recordings = load_recordings(runs_dir, declared, progress)
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
    jobs: Annotated[int | None, typer.Option(min=1, help="Number of threads (default: all cores).")] = None,
    seed: Annotated[int, typer.Option(help="Accepted for scripts; identification is deterministic.")] = 0,
    force: Annotated[
        bool, typer.Option("--force", help="Fit although `hframe check` finds faults in the data.")
    ] = False,
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
    from .support import check_recordings_before_fit, proposed_formulas
    from .tables import identification_table

    if jobs:
        os.environ["HFRAME_THREADS"] = str(jobs)
    declared = load_machine(machine)
    require_folder(out)
    with reading_progress("reading") as progress:
        recordings = load_recordings(runs_dir, declared, progress)
    require_several_runs(recordings, runs_dir)
    findings = check_recordings_before_fit(recordings, declared, None if force else runs_dir, log)
    result = run_identification(recordings, declared, held_out=hold_out or (), log=log)
    write_result(result, out, findings, proposed_formulas(result, log))
    contents, channels = result.as_json(), list(declared.output_channels)
    console.print(identification_table(contents, channels))
    log(verdict_sentence(contents, channels))
    try:
        log(f"wrote {build_report(out)}")
    except ImportError as error:
        log(f"report.html not written: {error}")


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
