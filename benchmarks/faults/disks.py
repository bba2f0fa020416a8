"""Full and read-only disks, mounted in a mount namespace of the command."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from benchmarks.faults.commands import JOBS, Finished, Job, Row, Stage, contents, environment, row, words_of
from tools.repository import ROOT

Log = Callable[[str], None]
DISK_MB = 64
FREE_BYTES = 16_000  # on the full disk


def in_namespace(script: str, folder: Path, **variables: str) -> Finished:
    """Run a shell script as root of a mount namespace of its own."""
    finished = subprocess.run(
        ["unshare", "--map-root-user", "--mount", "sh", "-c", script],
        cwd=folder,
        env=environment(**variables),
        capture_output=True,
        text=True,
    )
    return Finished(finished.returncode, finished.stdout, finished.stderr.strip().splitlines(), 0.0)


def possible() -> bool:
    """Return whether disks can be mounted in a namespace here."""
    return (
        shutil.which("unshare") is not None and in_namespace("mount -t tmpfs none /mnt", Path("/")).code == 0
    )


def command(job: Job, stage: Stage) -> str:
    """Return the shell command of a job."""
    return shlex.join([sys.executable, "-m", "hframe_gym", *words_of(job, job.new, stage.inputs)])


def disks(stage: Stage, log: Log) -> list[Row]:
    """Run the commands on full and read-only disks."""
    if not possible():
        return [row("disk", "full and read-only disks", 0, [], "not possible here: mounting is not allowed")]
    rows = [
        _full_disk(stage, log),
        _full_cache(stage, log),
        _read_only_work(stage, log),
        _read_only_home(stage, log),
    ]
    return [r for r in rows if r]


def _full_disk(stage: Stage, log: Log) -> Row:
    """Run each command with the old output on a disk that has no room for the new one."""
    failures = []
    for job in JOBS.values():
        work, after = stage.fresh(job, "full"), stage.folder / "work" / "after"
        shutil.rmtree(after, ignore_errors=True)
        script = f"""
            mount -t tmpfs -o size={DISK_MB}m none /mnt && cp -a {work}/. /mnt/ || exit 99
            touch /mnt/ballast; free=$(df -B1 --output=avail /mnt | tail -1)
            fallocate -l $((free - {FREE_BYTES})) /mnt/ballast || exit 98
            cd /mnt; {command(job, stage)}; code=$?
            rm -f /mnt/ballast; cp -a /mnt {after}; exit $code"""
        finished = in_namespace(script, stage.folder)
        outcome = stage.outcome(job, after) if job.name != "train" else _nothing_half(after)
        said = (
            len(finished.errors) == 1
            and "No space left" in finished.errors[0]
            and "out" in finished.errors[0]
        )
        if (finished.code, said, outcome) != (2, True, "old"):
            failures.append(f"{job.name}: code {finished.code}, {finished.errors[-3:]}, {outcome}")
    log(f"full disk: {failures}")
    return row(
        "disk", "output on a full disk, each command", len(JOBS), failures, "one line, code 2, the old output"
    )


def _nothing_half(folder: Path) -> str:
    """Return "old" if training left nothing but logs in its folder, else what it left."""
    left = [name for name in contents(folder) if not name.endswith("/")]
    return "old" if not left else str(left)


def _full_cache(stage: Stage, log: Log) -> Row:
    """Run commands with their compiled code on a full disk; another folder must serve, with a message."""
    failures = []
    for name in ("simulate", "evaluate"):
        job = JOBS[name]
        work = stage.fresh(job, "cache")
        script = f"""
            mount -t tmpfs -o size=1m none /mnt || exit 99
            cd {work}; XDG_CACHE_HOME=/mnt TMPDIR={stage.folder / "work"} {command(job, stage)}"""
        finished = in_namespace(script, stage.folder)
        said = [line for line in finished.errors if "compiled code is cached in" in line]
        if finished.code or len(said) != 1 or stage.outcome(job, work) != "new":
            failures.append(f"{name}: code {finished.code}, {finished.errors}")
    log(f"full cache: {failures}")
    return row(
        "disk", "cache of compiled code on a full disk", 2, failures, "another folder serves, one message"
    )


def _read_only_work(stage: Stage, log: Log) -> Row:
    """Run each command in a read-only working folder."""
    failures = []
    for job in JOBS.values():
        work = stage.fresh(job, "read-only")
        script = (
            f"mount --bind {work} {work} && mount -o remount,bind,ro {work} "
            f"&& cd {work} && {command(job, stage)}"
        )
        finished = in_namespace(script, stage.folder)
        outcome = stage.outcome(job, work) if job.name != "train" else _nothing_half(work)
        said = len(finished.errors) == 1 and "Read-only file system" in finished.errors[0]
        if (finished.code, said, outcome) != (2, True, "old"):
            failures.append(f"{job.name}: code {finished.code}, {finished.errors[-3:]}, {outcome}")
    log(f"read-only folder: {failures}")
    return row("disk", "read-only working folder, each command", len(JOBS), failures, "one line, code 2")


def _read_only_home(stage: Stage, log: Log) -> Row:
    """Run each command with a read-only HOME and a read-only package, both without cached compiled code."""
    failures = []
    package = stage.folder / "package"
    shutil.copytree(
        ROOT,
        package,
        ignore=shutil.ignore_patterns("__pycache__", ".git", "out", "results", "*.png"),
        symlinks=True,
    )
    home = stage.folder / "home"
    home.mkdir()
    for job in JOBS.values():
        work, temporary = stage.fresh(job, "home"), stage.folder / "work" / f"tmp-{job.name}"
        temporary.mkdir()
        protect = " && ".join(
            f"mount --bind {p} {p} && mount -o remount,bind,ro {p}" for p in (package, home)
        )
        variables = f"HOME={home} PYTHONPATH={package} TMPDIR={temporary}"
        script = (
            f"{protect} && cd {work} && unset XDG_CACHE_HOME HFRAME_CACHE NUMBA_CACHE_DIR; "
            f"{variables} {command(job, stage)}"
        )
        finished = in_namespace(script, stage.folder)
        said = [line for line in finished.errors if "compiled code is cached in" in line]
        outcome = stage.outcome(job, work) if job.name != "train" else "new"
        others = [line for line in finished.errors if line not in said and "atplotlib" not in line]
        compiles = job.name != "report"  # it simulates nothing
        if finished.code or len(said) != compiles or others or outcome != "new":
            failures.append(f"{job.name}: code {finished.code}, {finished.errors[-3:]}, {outcome}")
    log(f"read-only HOME and package: {failures}")
    note = "runs; one message names the folder that Numba uses instead"
    return row("disk", "read-only HOME and package folder, each command", len(JOBS), failures, note)
