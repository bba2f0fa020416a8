"""Write the result of an identification to a folder; `write_result` lists the files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ....arrays import Array
from ....files import atomic_file, output_batch, remove_file, write_text
from ....recordings import save_machine
from ..diagnostics.experiment_design import FILE
from .document import Report
from .plot_data import plot_data
from .provenance import provenance
from .result import IdentificationResult

if TYPE_CHECKING:
    from .formulas import TableComparison


def write_result(
    result: IdentificationResult,
    folder: Path,
    warnings: Sequence[str] = (),
    formulas: Sequence[TableComparison] = (),
    files: Sequence[Path] = (),
) -> Report:
    """Write the result of an identification to a folder; `build_report` then adds the plots and report.html.

    The files are report.json; declared.json, before.json and machine.json (the machine as declared, refitted,
    and with effects); plain.json (that of the plain fit); evidence.npz (`ResultCurves`); next_experiment.csv,
    if a run is proposed. They appear together or not at all, and replace those of an earlier result.

    Args:
        result: Result of an identification: machines, selected effects and fitted runs.
        folder: Folder to write to; created if it does not exist.
        warnings: Findings about the recordings, one line of text each, for `warnings` in report.json.
        formulas: Formulas that may replace each table (force interpolated over one variable) of the machine,
            with their errors, for `proposed_formulas` in report.json.
        files: Files of the recordings, for `made` in report.json, which tells where the result comes from.

    Returns:
        Content of report.json.

    Raises:
        InputError: If another process writes to the folder.
        OSError: If a file cannot be written.
    """
    arrays: dict[str, Any] = {name: _stored(name, a) for name, a in plot_data(result).as_arrays().items()}
    additions = {
        "warnings": [*result.notes, *warnings],
        "proposed_formulas": [comparison.as_entry() for comparison in formulas],
        "made": provenance(files),
    }
    report = result.as_report().model_copy(update=additions)
    with output_batch(folder):
        save_machine(result.declared.machine, folder / "declared.json")
        save_machine(result.before.machine, folder / "before.json")
        save_machine(result.after.machine, folder / "machine.json")
        if result.plain:
            save_machine(result.plain.evaluation.machine, folder / "plain.json")
        else:
            remove_file(folder / "plain.json")
        with atomic_file(folder / "evidence.npz") as file:
            np.savez_compressed(file, **arrays)
        if result.experiment:
            result.experiment.write(folder / FILE, result.declared.machine)
        else:
            remove_file(folder / FILE)
        write_text(folder / "report.json", json.dumps(report.as_json(), indent=1, allow_nan=False) + "\n")
    return report


def _stored(name: str, values: Array) -> NDArray[np.floating[Any]]:
    """Return a curve as it is stored; times of a clock that began long ago need 64 bits."""
    return values if name.endswith("/time_s") else values.astype(np.float32)
