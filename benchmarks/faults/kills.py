"""Kill -9, SIGINT and SIGTERM at random moments, and two runs into one folder."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from benchmarks.faults.commands import (
    JOBS,
    Job,
    Row,
    Stage,
    contents,
    finish,
    row,
    run,
    start,
    without_stages,
    words_of,
)
from hframe_gym.files import STAGE, complete_commit

SEED = 15
KILLS = {"simulate": 36, "report": 20, "export": 18, "identify": 14, "evaluate": 14, "train": 8}
RUN_AGAIN_EVERY = 4  # kills
SIGNALS_PER_COMMAND = 2
SIGNALS = {signal.SIGINT: (130, "interrupted"), signal.SIGTERM: (143, "terminated")}
Log = Callable[[str], None]


def kills(stage: Stage, log: Log) -> list[Row]:
    """Kill commands at random moments, half of them in a run's last third, where the output is written."""
    rng = np.random.default_rng(SEED)
    rows = []
    for name, count in KILLS.items():
        if name == "train":
            continue
        job, outcomes = JOBS[name], Counter[str]()
        failures, unfinished = [], 0
        for k in range(count):
            duration = stage.seconds[name]
            moment = (
                rng.uniform(0.0, 1.05 * duration) if k % 2 else rng.uniform(0.7 * duration, 1.05 * duration)
            )
            work = stage.fresh(job, "killed")
            kill_after(words_of(job, job.new, stage.inputs), work, moment)
            unfinished += any(work.rglob(f"{STAGE}*"))
            outcome = stage.outcome_after_kill(job, work)
            outcomes[outcome.partition(":")[0]] += 1
            if outcome not in ("old", "new"):
                failures.append(f"after {moment:.2f} s: {outcome}")
            if k % RUN_AGAIN_EVERY:
                if stage.outcome_for_next_writer(job, work) != outcome:
                    failures.append(f"after {moment:.2f} s: the next writer finds other files")
                continue
            if run(words_of(job, job.new, stage.inputs), work).code not in _codes_of_repetition(job, outcome):
                failures.append(f"after {moment:.2f} s: the command does not run again")
            elif stage.outcome(job, work) != "new":
                failures.append(f"after {moment:.2f} s: running it again gives {stage.outcome(job, work)}")
        note = (
            f"old output {outcomes['old']} times, new output {outcomes['new']} times; "
            f"unfinished files {unfinished} times, gone at the next writer; run again: the new output"
        )
        rows.append(row("kill -9", f"`{name}`", count, failures, note))
        log(f"kill -9 {name}: {dict(outcomes)} {failures}")
    return [*rows, _killed_training(stage, rng, log)]


def _codes_of_repetition(job: Job, outcome: str) -> tuple[int, ...]:
    """Return the allowed exit codes when a command runs once more: export refuses to replace a data set."""
    return (2,) if job.name == "export" and outcome == "new" else (0,)


def kill_after(words: tuple[str, ...], work: Path, seconds: float) -> None:
    """Start a command and kill its process group after some time."""
    process = start(words, work)
    time.sleep(seconds)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def _killed_training(stage: Stage, rng: np.random.Generator, log: Log) -> Row:
    """Kill training up to three times per run, resume each time, and compare with the unbroken run."""
    job, failures, kinds = JOBS["train"], list[str](), Counter[str]()
    words = words_of(job, job.new, stage.inputs)
    expected = {n: c for n, c in contents(stage.folder / "new" / "train").items() if _is_result(n)}
    killed = 0
    while killed < KILLS["train"]:
        work, resume = stage.fresh(job, "killed"), False
        for _ in range(4):
            kill_after(
                (*words, "--resume") if resume else words,
                work,
                rng.uniform(0.3, 1.0) * stage.seconds["train"],
            )
            killed += 1
            complete_commit(work / job.output)
            names = set(without_stages(contents(work)))
            resume = "out/checkpoint.zip" in names
            complete = {"out/agent.json", "out/policy.safetensors", "out/machine.json", "out/card.json"}
            kinds["with" if resume else "without"] += 1
            if resume and not complete <= names:
                failures.append(f"kill {killed}: the folder holds {sorted(names)}")
        if run((*words, "--resume") if resume else words, work).code:
            failures.append(f"kill {killed}: --resume failed")
            continue
        if left := sorted(n for n in contents(work) if f"/{STAGE}" in n):
            failures.append(f"kill {killed}: after the end, the folder holds {left}")
        result = {n: c for n, c in contents(work).items() if _is_result(n)}
        if result != expected:
            different = sorted(n for n in result.keys() | expected.keys() if result.get(n) != expected.get(n))
            failures.append(f"kill {killed}: other than the unbroken run: {different}")
    note = (
        f"{kinds['with']} times with a checkpoint; agent and learning curve after `--resume` equal to the bit"
    )
    log(f"kill -9 train: {dict(kinds)} {failures}")
    return row("kill -9", "`train`, then `--resume`", killed, failures, note)


def _is_result(name: str) -> bool:
    """Return whether a file of training must be equal; the others hold times, versions and states."""
    return Path(name).name in ("agent.json", "machine.json", "policy.safetensors", "card.json")


def signals(stage: Stage, log: Log) -> list[Row]:
    """Send SIGINT and SIGTERM at random moments: one line, the right exit code, the old or the new output."""
    rng = np.random.default_rng(SEED)
    rows = []
    for number, (code, word) in SIGNALS.items():
        failures, tried = [], 0
        for job in JOBS.values():
            for _ in range(SIGNALS_PER_COMMAND):
                work = stage.fresh(job, "signal")
                process = start(words_of(job, job.new, stage.inputs), work)
                _wait_for_handlers(process)
                time.sleep(rng.uniform(0.0, 0.9 * stage.seconds[job.name]))
                process.send_signal(number)
                finished = finish(process, timeout=60)
                tried += 1
                outcome = stage.outcome(job, work) if job.name != "train" else "new"
                ended = finished.code == 0 and outcome == "new"  # the run was over before the signal
                if not ended and (finished.code, len(finished.errors), outcome in ("old", "new")) != (
                    code,
                    1,
                    True,
                ):
                    failures.append(f"{job.name}: code {finished.code}, {finished.errors}, {outcome}")
                elif not ended and word not in finished.errors[0]:
                    failures.append(f"{job.name}: {finished.errors}")
        note = f"exit code {code}, one line; after the first 0.2 s, in which Python starts"
        rows.append(
            row("signal", f"{number.name} in each of the {len(JOBS)} commands", tried, failures, note)
        )
        log(f"{number.name}: {failures}")
    return rows


def _wait_for_handlers(process: subprocess.Popen[str]) -> None:
    """Wait until a command handles SIGTERM."""
    while process.poll() is None:
        status = Path(f"/proc/{process.pid}/status").read_text()
        if int(status.partition("SigCgt:")[2].split()[0], 16) >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(0.01)


def collisions(stage: Stage, log: Log) -> list[Row]:
    """Start a second run into the folder of a running one, and a third one after the first was killed."""
    refused, after_kill, tried = list[str](), list[str](), 0
    for name in ("identify", "evaluate", "export", "train", "report"):
        job = JOBS[name]
        words = words_of(job, job.new, stage.inputs)
        work = stage.fresh(job, "collision")
        first = start(words, work)
        _wait_for_lock(work / "out", first)
        second = run(words, work)
        tried += 1
        if first.poll() is None and not (
            second.code == 2
            and len(second.errors) == 1
            and "another hframe command is writing" in second.errors[0]
        ):
            refused.append(f"{name}: code {second.code}, {second.errors}")
        with suppress(ProcessLookupError):
            os.killpg(first.pid, signal.SIGKILL)
        first.communicate()
        third = run(words, work)
        if third.code and not (name == "export" and "exists already" in third.errors[0]):
            after_kill.append(f"{name}: code {third.code}, {third.errors}")
    log(f"collisions: {refused} {after_kill}")
    return [
        row(
            "two runs",
            "second run into the folder of a running one",
            tried,
            refused,
            "refused in one line, code 2",
        ),
        row("two runs", "third run after the first was killed", tried, after_kill, "no lock remains"),
    ]


def _wait_for_lock(folder: Path, process: subprocess.Popen[str]) -> None:
    """Wait until a process has the folder's lock file open, which it has while the folder is locked."""
    lock = str((folder / STAGE / "lock").resolve())
    while process.poll() is None:
        links = Path(f"/proc/{process.pid}/fd").glob("*")
        if any(os.path.realpath(link) == lock for link in links if link.is_symlink()):
            return
        time.sleep(0.02)
