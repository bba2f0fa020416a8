"""The commands under test: short jobs that replace an old output in a working folder by a new one."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hframe_gym.effects import EFFECTS
from hframe_gym.files import STAGE, complete_commit, locked_folder
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import Recording, write_recording
from tools.repository import ROOT

Row = dict[str, Any]
TIMES = {"seconds", "cpu_s"}  # keys of JSON files that hold times
_TIMES_IN_PAGES = re.compile(rb"The identification took \d+ s")


@dataclass(frozen=True)
class Job:
    """A command with an old and a new output.

    Attributes:
        name: Name of the command.
        old: Arguments that write the old output; INPUTS stands for the folder of the inputs.
        new: Arguments that replace it.
        output: File or folder of the output in the working folder.
    """

    name: str
    old: tuple[str, ...]
    new: tuple[str, ...]
    output: str = "out"


JOBS = {
    "simulate": Job(
        "simulate",
        ("--machine", "axis", "--inputs", "INPUTS/a/run_1.csv", "--out", "out.csv"),
        ("--machine", "axis", "--inputs", "INPUTS/long/run_1.csv", "--out", "out.csv"),
        "out.csv",
    ),
    "identify": Job(
        "identify",
        ("INPUTS/a", "--machine", "axis", "--out", "out"),
        ("INPUTS/b", "--machine", "axis", "--out", "out"),
    ),
    "report": Job("report", (), ("out",)),
    "evaluate": Job(
        "evaluate",
        ("pid", "--episodes", "8", "--html", "--out", "out"),
        ("pid", "--episodes", "8", "--seed", "1", "--html", "--out", "out"),
    ),
    "export": Job(
        "export",
        ("pid", "--episodes", "4", "--out", "out"),
        ("textbook-pid", "--episodes", "60", "--out", "out"),
    ),
    "train": Job("train", (), ("ppo", "--steps", "8000", "--seed", "1", "--out", "out")),
}


class Finished(NamedTuple):
    """A finished command: exit code, standard output, lines of standard error, and duration, s."""

    code: int
    output: str
    errors: list[str]
    seconds: float


def environment(**variables: str) -> dict[str, str]:
    """Return the environment of a command: this checkout, and further variables."""
    return os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "120"} | variables


def start(
    words: tuple[str, ...], folder: Path, variables: Mapping[str, str] | None = None
) -> subprocess.Popen[str]:
    """Start an `hframe` command in a working folder, in a process group of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "hframe_gym", *words],
        cwd=folder,
        env=environment(**(variables or {})),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # Background jobs of a shell ignore SIGINT.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def finish(process: subprocess.Popen[str], begin: float = 0.0, timeout: float = 3600.0) -> Finished:
    """Wait for a command."""
    output, errors = process.communicate(timeout=timeout)
    return Finished(process.returncode, output, errors.strip().splitlines(), time.perf_counter() - begin)


def run(words: tuple[str, ...], folder: Path, variables: Mapping[str, str] | None = None) -> Finished:
    """Run an `hframe` command to its end."""
    begin = time.perf_counter()
    return finish(start(words, folder, variables), begin)


def words_of(job: Job, arguments: tuple[str, ...], inputs: Path) -> tuple[str, ...]:
    """Return the words of a command."""
    return (job.name, *(a.replace("INPUTS", str(inputs)) for a in arguments))


def write_inputs(folder: Path) -> None:
    """Write two small data sets of an axis with different hidden effects, and one long recording."""
    axis = BUILTIN_MACHINES["axis"]()
    truths = {
        "a": axis.with_effects(EFFECTS["stribeck_friction"].at("x", dF=0.8, vs=0.02)),
        "b": axis.with_effects(EFFECTS["constant_force"].at("x", size=0.7)),
    }
    for name, truth, rows in (*((n, t, 1000) for n, t in truths.items()), ("long", axis, 100_000)):
        rng = np.random.default_rng(rows)
        (folder / name).mkdir(parents=True)
        for k in range(1 if name == "long" else 3):
            time_s = np.arange(rows) * 1e-3
            inputs = np.repeat(rng.uniform(-2.0, 2.0, (rows // 50, 1)), 50, axis=0)
            inputs[:50] = 0.0
            outputs = truth.simulate(time_s, inputs).outputs + rng.normal(0.0, 20e-6, (rows, 1))
            write_recording(folder / name / f"run_{k + 1}.csv", Recording("", time_s, inputs, outputs), axis)


def contents(folder: Path) -> dict[str, bytes]:
    """Return the bytes of all files below a folder by relative path, times and TensorBoard logs left out."""
    files: dict[str, bytes] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_dir() and not any(path.iterdir()):
            files[f"{name}/"] = b""
        elif path.is_file() and "tensorboard" not in path.parts:
            files[name] = without_times(path)
    return files


def without_stages(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return contents without the hidden folders of unfinished files, which a killed process leaves."""
    return {name: content for name, content in files.items() if f"/{STAGE}" not in f"/{name}"}


def without_times(path: Path) -> bytes:
    """Return the content of a file; times in JSON files and reports are replaced."""
    content = path.read_bytes()
    if path.suffix == ".json":
        return json.dumps(_drop_times(json.loads(content))).encode()
    return _TIMES_IN_PAGES.sub(b"The identification took 0 s", content) if path.suffix == ".html" else content


def _drop_times(value: Any) -> Any:
    """Return JSON data without the keys in `TIMES`."""
    if isinstance(value, dict):
        return {key: _drop_times(item) for key, item in value.items() if key not in TIMES}
    return [_drop_times(item) for item in value] if isinstance(value, list) else value


class Stage:
    """Old and new output of all jobs, each in a working folder, with the duration of the new job.

    Args:
        folder: Folder for them and for the inputs.
        log: Called with a line of text.
    """

    def __init__(self, folder: Path, log: Callable[[str], None]) -> None:
        self.folder, self.inputs = folder, folder / "inputs"
        write_inputs(self.inputs)
        self.seconds: dict[str, float] = {}
        for job in JOBS.values():
            for state in ("old", "new"):
                work = folder / state / job.name
                work.mkdir(parents=True)
                if job.name == "report":  # the old output is a result without a report
                    self._run("identify", JOBS["identify"].old, work)
                    (work / "out" / "report.html").write_text("old")
                elif job.old:
                    self._run(job.name, job.old, work)
            self._run(job.name, job.new, work)  # compiles what the job needs
            shutil.rmtree(work / "out" / "tensorboard", ignore_errors=True)
            self.seconds[job.name] = self._run_again(job).seconds
            log(f"{job.name}: {self.seconds[job.name]:.1f} s")

    def _run(self, name: str, arguments: tuple[str, ...], work: Path) -> Finished:
        """Run a command, which must succeed."""
        finished = run(words_of(JOBS[name], arguments, self.inputs), work)
        if finished.code:
            raise SystemExit(f"hframe {name} failed: {finished.errors}")
        return finished

    def _run_again(self, job: Job) -> Finished:
        """Measure the duration of the new job."""
        work = self.fresh(job, "timed")
        return self._run(job.name, job.new, work)

    def fresh(self, job: Job, name: str) -> Path:
        """Return a new working folder with the old output of a job."""
        work = self.folder / "work" / f"{job.name}-{name}"
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(self.folder / "old" / job.name, work)
        return work

    def outcome_after_kill(self, job: Job, work: Path) -> str:
        """Return "old", "new" or what a command that reads the output finds, without unfinished files."""
        complete_commit(work / job.output)
        return self.outcome(job, work, without_stages(contents(work)))

    def outcome_for_next_writer(self, job: Job, work: Path) -> str:
        """Return "old", "new" or what the next command that writes there finds: unfinished files are gone."""
        with locked_folder(work if job.name == "simulate" else work / job.output):
            pass
        return self.outcome(job, work)

    def outcome(self, job: Job, work: Path, found: Mapping[str, bytes] | None = None) -> str:
        """Return "old", "new" or what a working folder (or `found`) has beside or instead of one of them."""
        found = contents(work) if found is None else found
        for state in ("new", "old"):
            expected = contents(self.folder / state / job.name)
            if found == expected:
                return state
        expected = contents(self.folder / "new" / job.name)
        return (
            f"neither: {sorted(n for n in found.keys() | expected.keys() if found.get(n) != expected.get(n))}"
        )


def row(group: str, what: str, tried: int, failures: list[str], note: str = "") -> Row:
    """Return a row of the fault table; `failures` lists what went wrong, once per failed try."""
    return {
        "group": group,
        "what": what,
        "tried": tried,
        "failed": len(failures),
        "note": note,
        "failures": failures,
    }
