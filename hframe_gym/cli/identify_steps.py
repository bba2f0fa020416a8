"""Steps of `hframe identify` around the identification: find rigs, check recordings, propose formulas."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from ..line_log import LineLog

if TYPE_CHECKING:
    from ..data_validation import Finding
    from ..identification import IdentificationResult
    from ..identification.report.content.formulas import TableComparison
    from ..machine import Machine
    from ..recordings import Recording


def rig_folders(folder: Path) -> list[Path]:
    """List the subfolders with recordings, one per rig; none if the folder itself contains recordings.

    This distinguishes an identification of one rig from that of several.
    """
    from ..recordings import recording_files

    if not folder.is_dir() or recording_files(folder):
        return []
    return sorted(path for path in folder.iterdir() if path.is_dir() and recording_files(path))


def proposed_output(recordings: Path) -> Path:
    """Propose a folder for results: out/NAME, or out/NAME_identified if the recordings are in the first."""
    name = recordings.resolve().name
    folder = Path("out", name)
    return folder if folder.resolve() != recordings.resolve() else Path("out", f"{name}_identified")


def require_several_runs(recordings: Sequence[Recording], folder: Path) -> None:
    """Raise an InputError if a folder has only one run; the message says how to cut it into several.

    An identification needs at least two runs: one is held out to verify the result.
    """
    if len(recordings) != 1:
        return
    run = recordings[0]
    file = next(path for path in sorted(folder.iterdir()) if path.name.startswith(f"{run.name}."))
    seconds = run.time_s[-1] - run.time_s[0]
    options = "--split-at-rests (--split-every 5 if it has none; and the --machine of this command)"
    raise InputError(
        f"{folder}: has the single run {run.name!r} of {seconds:.4g} s; at least two are needed, because one "
        f"is held out. Record more runs, or cut it at its rests: hframe import {file} --out RUNS {options}"
    )


def check_recordings_before_fit(
    recordings: Sequence[Recording], machine: Machine, refuse: Path | None, log: LineLog
) -> list[Finding]:
    """Check recordings before an identification, print the faults, and stop if there is one.

    A fault is a finding that is certainly an error in the data, for example a stuck sensor or a wrong sign.

    Args:
        refuse: Folder to name in the error. None: faults are printed, but raise no error.
        log: Called with a line of text for every group of similar faults, and for the number of other
            findings.

    Returns:
        All findings of `check_before_fit`, not grouped.

    Raises:
        InputError: If there is a fault and `refuse` is given.
    """
    from ..data_validation import check_before_fit, group_findings, refuse_faults

    findings = check_before_fit(recordings, machine)
    groups = group_findings(findings)
    others = [finding for finding in groups if finding.severity != "fault"]
    for finding in groups:
        if finding.severity == "fault":
            log(str(finding))
    if others:
        log(
            f"{len(others)} note{'s' if len(others) > 1 else ''} about the recordings; they follow the result"
        )
    if refuse is not None:
        refuse_faults(findings, refuse)
    return findings


def proposed_formulas(result: IdentificationResult, log: LineLog) -> tuple[TableComparison, ...]:
    """Propose formulas for the forces that an identification could only describe by tables of values.

    Such a table stands for a force that no known effect explains.

    Args:
        result: Result of the identification.
        log: Called with lines of text: the progress, or why nothing is proposed.

    Returns:
        Proposed formulas of each table; none without tables, or without scikit-learn.
    """
    from ..identification.report.content.formulas import compare_formulas

    try:
        return compare_formulas(result, log)
    except ImportError as error:
        log(f"no formulas proposed for the tables: {error}")
        return ()
