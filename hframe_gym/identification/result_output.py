"""The folder that `identify` leaves: report.json, before.json, machine.json, evidence.npz, plots and report.html.

Where the leading effect has a rival that another run would tell from it, next_experiment.csv holds that run's voltages.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from ..atomic_files import write_text
from ..recordings import save_machine
from .experiment_design import FILE
from .plot_data import save_evidence
from .result import IdentificationResult


def write_answer(answer: IdentificationResult, folder: Path, warnings: Sequence[str] = ()) -> None:
    """Write everything but the plots and the page, each file whole; report.json last.

    warnings: what is odd about the recordings, for the page.
    """
    folder.mkdir(parents=True, exist_ok=True)
    save_machine(answer.declared.machine, folder / "declared.json")
    save_machine(answer.before.machine, folder / "before.json")
    save_machine(answer.after.machine, folder / "machine.json")
    save_evidence(answer, folder / "evidence.npz")
    if answer.experiment:
        answer.experiment.write(folder / FILE, answer.declared.machine)
    else:
        (folder / FILE).unlink(missing_ok=True)
    report = answer.as_json() | {"warnings": list(warnings)}
    write_text(folder / "report.json", json.dumps(report, indent=1, allow_nan=False) + "\n")
