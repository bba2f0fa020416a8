"""Commands on identifications: identify and report."""

from __future__ import annotations

import dataclasses
import os
import sys
import time
import webbrowser
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer
from typer import Argument, Option

from ..errors import InputError
from ..files import files_of, locked_folder, output_batch, output_folder, remove_file, write_files
from ..line_log import LineLog
from ..parallel import map_tasks
from .application import CommandWithChoices, app
from .identify_steps import (
    check_recordings_before_fit,
    proposed_formulas,
    proposed_output,
    require_several_runs,
    rig_folders,
)
from .messages import INTERNAL_ERROR, describe_failure
from .options import MachineOption, MaxRowsOption, OutOption, RayOption
from .output import closed_output_tolerated, console, log, plain_text
from .progress import finishing_on_interrupt, progress_bar, search_progress

if TYPE_CHECKING:
    from ..data_validation import Finding
    from ..identification import IdentificationResult
    from ..identification.budget import Progress
    from ..identification.report.content.document import Report
    from ..machine import Machine
    from ..recordings import Recording

_REPORT_S = 6.0  # processor time for report.json and report.html; libraries and plots took 5 s on busy cores
_INTERRUPTED = 130  # exit code after Ctrl-C, as of every command; the result of the search so far was written
_Identification = Callable[..., Any]  # `_check_and_identify` with the options of the command


@app.command(cls=CommandWithChoices)
def identify(
    runs_dir: Annotated[
        Path, Argument(help="A folder of recordings, one run per file; or of such folders, one per rig.")
    ],
    out: OutOption,
    machine: MachineOption = "hframe",
    hold_out: Annotated[list[str] | None, Option(help="Run (file name without ending); repeatable.")] = None,
    jobs: Annotated[
        int | None,
        Option(
            min=1,
            max=1024,
            help="Number of threads (default: all cores); "
            "with several rigs, number of rigs at a time (default: 1).",
        ),
    ] = None,
    # Kept for scripts that pass it.
    seed: Annotated[int, Option(hidden=True, help="No effect: identification draws no random numbers.")] = 0,
    force: Annotated[
        bool, Option("--force", help="Fit although `hframe check` finds faults in the data.")
    ] = False,
    max_rows: MaxRowsOption = 1_000_000,
    budget: Annotated[
        float | None,
        Option(
            min=0.0,
            help="Processor time for a rig, s (default: 120), "
            "all threads together, from reading its files to its report. "
            "The search ends in time with the best machine so far (0: refit only; inf: no limit).",
        ),
    ] = None,
    ray: RayOption = None,
) -> None:
    """Fit a machine to recordings; find effects (friction, ...) that it lacks, verified on held-out runs.

    The recordings are checked first; faults (errors in the data, such as a wrong sign, that `hframe check`
    lists) stop the command before anything is fitted. A held-out run is not used for fitting; the errors in
    the report are those on held-out runs. One of each four runs with similar voltages is held out unless
    --hold-out names others. The folder --out receives report.json, the declared, refitted and corrected
    machine, report.html and its plots; with several rigs, it receives a folder with these files for each rig.
    Ctrl-C during the search ends it with what was found so far.

    Example:  hframe identify examples/rig_a --out out/rig_a
    """
    began = time.process_time()
    from ..identification.report.words.instructions import next_command
    from ..recordings import load_machine

    if out.resolve() == runs_dir.resolve():
        other = proposed_output(runs_dir)
        raise InputError(f"--out {out}: is the folder of the recordings; give another one, such as {other}")
    declared, rigs = load_machine(machine), rig_folders(runs_dir)
    check_and_identify = partial(_check_and_identify, declared, hold_out or (), force, budget)
    with locked_folder(output_folder(out)):
        if rigs or ray is not None:
            outputs = {rig: out / rig.name for rig in rigs} or {runs_dir: out}
            read = [
                _Rig(rig, folder, _runs_or_error(rig, declared, max_rows)) for rig, folder in outputs.items()
            ]
            _identify_rigs(check_and_identify, read, jobs or 1, ray)
            return
        if jobs:
            os.environ["HFRAME_THREADS"] = str(jobs)
        result, page_error = _identify_rig(
            check_and_identify, runs_dir, _load_runs(runs_dir, declared, max_rows), out, began
        )
    if page_error is not None and not isinstance(page_error, ImportError):
        raise page_error
    log(f"wrote {out / 'report.html'}" if page_error is None else f"report.html not written: {page_error}")
    log(f"Next: {next_command(result.verdict, result.after.machine, out)}")
    if result.unfinished is not None and result.unfinished.interrupted:
        raise typer.Exit(_INTERRUPTED)


def _identify_rig(
    check_and_identify: _Identification, runs_dir: Path, recordings: list[Recording], out: Path, began: float
) -> tuple[IdentificationResult, Exception | None]:
    """Identify one rig, write and print its result; return it with the error of report.html, if any.

    The budget counts the processor time since the command began, s.
    """
    from ..identification.report.words.verdict import verdict_in_words
    from .tables.identification import effect_lines, identification_table

    with search_progress(log) as progress:
        result, findings = check_and_identify(
            runs_dir, recordings, log, progress, spent=time.process_time() - began
        )
    report, page_error = _write_rig(result, findings, runs_dir, out, out, log)
    console.print(identification_table(report))
    log(f"Result: {verdict_in_words(report)}")
    for line in effect_lines(report):
        log(f"  {line}")
    _log_notes(result, findings)
    return result, page_error


def _log_notes(result: IdentificationResult, findings: Sequence[Finding]) -> None:
    """Print what else the user should know: first about the result, then about the recordings."""
    from ..data_validation import group_findings

    notes = [
        *result.notes,
        *(str(finding) for finding in group_findings(findings) if finding.severity != "fault"),
    ]
    if notes:
        log(f"Notes ({len(notes)}):")
        for note in notes:
            log(f"  - {note}")


def _load_runs(folder: Path, machine: Machine, max_rows: int) -> list[Recording]:
    """Load the runs of a rig, at least two."""
    from ..recordings import load_recordings

    with progress_bar(f"reading {folder.name}") as progress:
        recordings = load_recordings(folder, machine, progress, max_rows=max_rows, log=log)
    require_several_runs(recordings, folder)
    return recordings


def _runs_or_error(folder: Path, machine: Machine, max_rows: int) -> list[Recording] | InputError:
    """Load the runs of one of several rigs; an error must not stop the others."""
    try:
        return _load_runs(folder, machine, max_rows)
    except InputError as error:
        return error


def _check_and_identify(
    machine: Machine,
    hold_out: Sequence[str],
    force: bool,
    budget_s: float | None,
    folder: Path,
    recordings: list[Recording],
    log: LineLog,
    progress: Progress | None = None,
    spent: float = 0.0,
) -> tuple[IdentificationResult, list[Finding]]:
    """Check and identify the runs of a rig; return the result and the findings about the data.

    A part of the budget was spent before, s; another one is left for the report.
    """
    from ..identification import identify as run_identification
    from ..identification.budget import DEFAULT_SECONDS, Budget

    seconds = DEFAULT_SECONDS if budget_s is None else budget_s
    budget = Budget(seconds, spent=spent, afterwards=_REPORT_S, progress=progress)
    findings = check_recordings_before_fit(recordings, machine, None if force else folder, log)
    with finishing_on_interrupt(budget) if progress else nullcontext():  # of several rigs, Ctrl-C ends all
        result = run_identification(recordings, machine, held_out=hold_out, log=log, budget=budget)
    return _with_late_currents(result, recordings, machine), findings


def _with_late_currents(
    result: IdentificationResult, recordings: Sequence[Recording], machine: Machine
) -> IdentificationResult:
    """Return a result that names the currents which may have made the log look slower than its controller."""
    from ..data_validation import currents_after_their_voltage

    if (unknown := result.unknown_voltages) is None:
        return result
    late = list(currents_after_their_voltage(recordings, machine))
    return dataclasses.replace(result, unknown_voltages=unknown.model_copy(update={"late_currents": late}))


def _write_rig(
    result: IdentificationResult,
    findings: Sequence[Finding],
    runs_dir: Path,
    folder: Path,
    out: Path,
    log: LineLog,
) -> tuple[Report, Exception | None]:
    """Write the files of a result to a folder; an error in report.html is returned, so the others are kept.

    Args:
        findings: What was found in the recordings before the fit.
        folder: Folder to write; of a worker, a temporary one.
        out: Folder in which the user finds the files, as the page names it.
        log: Called with a line of text.

    Returns:
        Content of report.json, and the error that prevented report.html; None if it was written.
    """
    from ..data_validation import group_findings
    from ..identification import write_result
    from ..identification.report.page import build_report
    from ..recordings import recording_files

    log("writing the report and its figures")
    with output_batch(folder):
        comparisons = proposed_formulas(result, log)
        texts = list(map(str, group_findings(findings)))
        report = write_result(result, folder, texts, comparisons, recording_files(runs_dir))
        try:
            build_report(folder, out)
        except Exception as error:
            remove_file(folder / "report.html")  # of an older result
            return report, error
    return report, None


class _Rig(NamedTuple):
    """What a worker gets: a folder of runs, the result's folder, and the runs or the error of reading."""

    runs_dir: Path
    out: Path
    recordings: list[Recording] | InputError


class _IdentifiedRig(NamedTuple):
    """What a worker returns: the verdict or an error, and the files of the result by name."""

    message: str
    files: dict[str, bytes]
    exit_code: int = 0


def _identify_rigs(check_and_identify: _Identification, rigs: list[_Rig], jobs: int, ray: str | None) -> None:
    """Identify rigs in worker processes; the errors of some end the command after the others are complete."""
    errors: list[_IdentifiedRig] = []
    done = 0
    with progress_bar("identifying") as progress:

        def write(index: int, identified: _IdentifiedRig) -> None:
            nonlocal done
            done += 1
            out, name = rigs[index].out, rigs[index].runs_dir.name
            if identified.files:
                with output_batch(out):
                    remove_file(out / "report.html")  # of an older result; the new one may lack it
                    write_files(out, identified.files)
            if identified.exit_code:
                errors.append(identified)
                print(plain_text(f"hframe: {name}: {identified.message}"), file=sys.stderr)
            else:
                log(f"{name}: {identified.message}")
                log(f"{name}: wrote {out} ({done} of {len(rigs)})")
            progress(done, len(rigs))

        progress(0, len(rigs))
        run = partial(_identify_in_worker, check_and_identify, not console.is_terminal)
        for _ in map_tasks(run, rigs, jobs=jobs, ray=ray, completed=write):
            pass
    if errors:
        raise typer.Exit(min(identified.exit_code for identified in errors))


def _identify_in_worker(check_and_identify: _Identification, show_lines: bool, rig: _Rig) -> _IdentifiedRig:
    """Identify a rig in a temporary folder; print what it does line by line, or nothing beside a bar."""
    from ..identification.report.words.verdict import verdict_in_words

    def log(line: str) -> None:
        if show_lines:
            with closed_output_tolerated():
                print(plain_text(f"{rig.runs_dir.name}: {line}"))

    try:
        if isinstance(rig.recordings, InputError):
            raise rig.recordings
        result, findings = check_and_identify(rig.runs_dir, rig.recordings, log)
        (report, page_error), files = files_of(
            lambda folder: _write_rig(result, findings, rig.runs_dir, folder, rig.out, log)
        )
        if page_error is not None and not isinstance(page_error, ImportError):
            return _IdentifiedRig(describe_failure(page_error)[1], files, INTERNAL_ERROR)
        verdict = verdict_in_words(report)
        return _IdentifiedRig(
            verdict if page_error is None else f"{verdict} No report.html: {page_error}", files
        )
    except Exception as error:  # the other rigs must not be lost
        code, line = describe_failure(error)
        return _IdentifiedRig(line, {}, code)


@app.command()
def report(
    folder: Annotated[Path, Argument(help="A folder that `hframe identify` wrote.")],
    open: Annotated[bool, Option("--open", help="Open the report in the browser.")] = False,
) -> None:
    """Build report.html, one self-contained page, from the files of an identification.

    Example:  hframe report out/rig_a --open
    """
    from ..identification.report.page import build_report

    page = build_report(folder)
    log(f"wrote {page}")
    if open:
        webbrowser.open(page.resolve().as_uri())
