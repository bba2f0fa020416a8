"""The folder that `identify` leaves: report.json, before.json, machine.json, evidence.npz, plots and report.html."""

from __future__ import annotations

import json
from pathlib import Path

from ..files import save_machine, write_text
from .answer import Answer
from .evidence import save_evidence


def write_answer(answer: Answer, folder: Path) -> None:
    """Write everything but the plots and the page, each file whole; report.json last."""
    folder.mkdir(parents=True, exist_ok=True)
    save_machine(answer.declared.machine, folder / "declared.json")
    save_machine(answer.before.machine, folder / "before.json")
    save_machine(answer.after.machine, folder / "machine.json")
    save_evidence(answer, folder / "evidence.npz")
    write_text(folder / "report.json", json.dumps(answer.as_json(), indent=1, allow_nan=False) + "\n")
