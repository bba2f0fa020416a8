"""The same command and seed under other conditions: each byte of the answer must be equal, times left out."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from benchmarks.faults.commands import Row, row, run
from tools.repository import ROOT

Log = Callable[[str], None]
RIG = ROOT / "examples" / "rig_a"
_SECONDS = re.compile(rb'^ "seconds": .*\n', re.MULTILINE)  # of report.json; the only line that may differ
ANSWERS = {
    "identify": ("report.json", "machine.json", "before.json", "declared.json"),
    "evaluate": ("scores.json",),
}
CONDITIONS: dict[str, Mapping[str, str]] = {
    "first run": {},
    "repeated": {},
    "1 thread": {"HFRAME_THREADS": "1", "OMP_NUM_THREADS": "1"},
    "2 threads": {"HFRAME_THREADS": "2", "OMP_NUM_THREADS": "2"},
    "PYTHONHASHSEED=1": {"PYTHONHASHSEED": "1"},
    "PYTHONHASHSEED=2": {"PYTHONHASHSEED": "2"},
    "files in another order": {},
    "empty cache of compiled code": {
        "XDG_CACHE_HOME": "EMPTY",
        "HFRAME_CACHE": "EMPTY",
        "NUMBA_CACHE_DIR": "EMPTY",
    },
}


def answers(command: str, condition: str, folder: Path) -> dict[str, bytes]:
    """Run a command under a condition and return its answer, bytes by file, without the line of seconds."""
    folder.mkdir(parents=True)
    variables = {
        key: value.replace("EMPTY", str(folder / "cache")) for key, value in CONDITIONS[condition].items()
    }
    if command == "identify":
        runs = folder / "runs"
        runs.mkdir()
        files = sorted(RIG.iterdir(), reverse=condition == "files in another order")
        for file in files:  # most file systems list files in an order that depends on their creation
            shutil.copy(file, runs)
        jobs = ("--jobs", variables["HFRAME_THREADS"]) if "HFRAME_THREADS" in variables else ()
        words: tuple[str, ...] = ("identify", str(runs), "--out", "out", *jobs)
    else:
        words = ("evaluate", "pid", "adaptive-pid", "ppo", "--episodes", "24", "--out", "out")
    finished = run(words, folder, variables)
    if finished.code:
        raise SystemExit(f"hframe {command} failed ({condition}): {finished.errors}")
    return {name: _SECONDS.sub(b"", (folder / "out" / name).read_bytes()) for name in ANSWERS[command]}


def determinism(log: Log) -> list[Row]:
    """Compare the answers of identify and evaluate under all conditions with those of the first run."""
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        for command, files in ANSWERS.items():
            conditions = [c for c in CONDITIONS if command == "identify" or "files" not in c]
            found = {
                c: answers(command, c, Path(temporary) / command / str(i)) for i, c in enumerate(conditions)
            }
            reference = found.pop("first run")
            failures = [
                f"{condition}: {name}"
                for condition, answer in found.items()
                for name in files
                if answer[name] != reference[name]
            ]
            what = f"`{command}`: {', '.join(found)}"
            rows.append(
                row("determinism", what, len(found), failures, f"{', '.join(files)} equal to the byte")
            )
            log(f"determinism {command}: {failures}")
    return rows
