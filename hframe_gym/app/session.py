"""A session: a folder with a machine, logs and results, and the command line of each step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from ..errors import InputError
from ..files import atomic_file, write_text
from ..machine import Machine
from ..operating_system import quoted
from ..recordings import Interval, find_logs, load_machine, recording_files

MACHINE, LOGS, RUNS, RESULT, EXPORTS = "machine.json", "logs", "runs", "result", "export"
CONTROL = "control"  # beside the machine that was controlled, where `hframe identify` proposes it as well
FINDINGS = "check.json"
SCRIPT = "commands.sh"  # all commands of the session, in the order in which they ran
_SCRIPT_HEAD = (
    '#!/bin/sh\n# The commands of this session; a line that failed is marked.\ncd "$(dirname "$0")"\n'
)


@dataclass
class ImportChoices:
    """What the user chose for the import of logs.

    Attributes:
        columns: Column by channel, or "none", or a rate such as "200Hz" for the times.
        units: Unit by channel where it is not that of the log.
        scales: Factor by channel, as text.
        split: How logs are cut: "" (as they are), "rests" or "every".
        seconds: Shortest rest for "rests", or duration of a run for "every", s.
        intervals: Parts of logs to keep; they replace `split`.
    """

    columns: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    scales: dict[str, str] = field(default_factory=dict)
    split: str = ""
    seconds: float = 0.5
    intervals: list[Interval] = field(default_factory=list)


@dataclass(frozen=True)
class Session:
    """Folder of a session, with the files of the commands; each can be used without the window."""

    folder: Path

    def create(self) -> None:
        """Create the session's folder and its folder for logs, unless they exist.

        Raise an InputError if the path is a file.
        """
        if self.folder.exists() and not self.folder.is_dir():
            raise InputError(f"{self.folder}: is a file, but must be the folder of a session")
        (self.folder / LOGS).mkdir(parents=True, exist_ok=True)

    def path(self, *parts: str) -> Path:
        """Return the path of a file in the session's folder."""
        return self.folder.joinpath(*parts)

    @property
    def machine(self) -> Machine | None:
        """The declared machine, or None if there is none yet.

        An InputError is raised if its file is faulty.
        """
        return load_machine(self.path(MACHINE)) if self.path(MACHINE).exists() else None

    @property
    def logs(self) -> list[Path]:
        """Logs in the session's folder of logs, see `find_logs`; none if it is empty."""
        if not any(self.path(LOGS).iterdir()):
            return []
        return find_logs(self.path(LOGS))[0]

    @property
    def runs(self) -> list[Path]:
        """Files of the imported runs."""
        return recording_files(self.path(RUNS)) if self.path(RUNS).is_dir() else []

    @property
    def corrected(self) -> str:
        """File of the machine for controllers and exports, relative to the session's folder.

        It is the identified machine, or the declared one before an identification.
        """
        return f"{RESULT}/{MACHINE}" if self.path(RESULT, MACHINE).exists() else MACHINE

    @property
    def control(self) -> str:
        """Folder for comparisons of controllers on the machine `corrected`, relative to the session."""
        return control_folder(self.corrected)

    def log_path(self, name: str) -> Path:
        """Return the path at which to store a log that the user dropped; it replaces one of the same name.

        Args:
            name: Name of the file; folders in it are ignored.

        Raises:
            InputError: If the name is not that of a file.
        """
        base = name.replace("\\", "/").rpartition("/")[2]
        if base.startswith(".") or not base:
            raise InputError(f"{name!r} is not the name of a log")
        return self.path(LOGS, base)

    def remove_log(self, path: Path) -> None:
        """Delete a log of the session; do nothing for a path outside its folder of logs."""
        if path.parent == self.path(LOGS):
            path.unlink(missing_ok=True)

    def use_machine(self, content: bytes) -> Machine:
        """Store a machine.json that the user dropped, and return its machine; the present one is replaced.

        Args:
            content: Bytes of the file.

        Raises:
            InputError: If it is faulty; the machine of the session then stays as it was.
        """
        trial = self.path("machine.dropped.json")
        with atomic_file(trial) as file:
            file.write(content)
        try:
            machine = load_machine(trial)
            trial.replace(self.path(MACHINE))
        except InputError as error:
            raise InputError(str(error).replace(str(trial), "machine.json")) from None
        finally:
            trial.unlink(missing_ok=True)
        return machine

    def aside_command(self, *names: str) -> list[list[str]]:
        """Return the command that moves former results to a new folder of the session; nothing is deleted.

        Args:
            names: Files and folders of the session; those that do not exist are left out.

        Returns:
            One command, "mkdir", the new folder and what is moved there; none if nothing exists.
        """
        existing = [name for name in names if self.path(name).exists()]
        number = 1
        while self.path(f"earlier_{number}").exists():
            number += 1
        return [["mkdir", f"earlier_{number}", *existing]] if existing else []

    def set_aside(self, folder: str, *names: str) -> None:
        """Move files and folders of the session, which must exist, to a new folder within it.

        Args:
            folder: Name of the new folder.
            *names: What is moved there.

        Raises:
            FileExistsError: If the folder exists.
        """
        self.path(folder).mkdir()
        for name in names:
            self.path(name).replace(self.path(folder, name))

    def record(self, words: Sequence[str], exit_code: int) -> None:
        """Append a command to the session's script; a command that failed becomes a comment.

        Args:
            words: Words after "hframe", see `command_text`.
            exit_code: Exit code with which the command ended; 0 for success.
        """
        script = self.path(SCRIPT)
        text = script.read_text(encoding="utf-8") if script.exists() else _SCRIPT_HEAD
        line = command_text(words) if exit_code == 0 else f"# exit code {exit_code}: {command_text(words)}"
        write_text(script, f"{text}{line}\n")


def command_text(words: Sequence[str]) -> str:
    """Write a command as the user would type it, in one line.

    Args:
        words: Words after "hframe", or those of `Session.aside_command`, which begin with "mkdir".
    """
    line = " ".join(map(quoted, words))
    if words[0] != "mkdir":
        return f"hframe {line}"
    return f"mkdir {words[1]} && mv {' '.join(map(quoted, words[2:]))} {words[1]}"


def new_machine_command(like: str, values: Mapping[str, str | bool | Sequence[str]]) -> list[str]:
    """Return the words after "hframe" of the command that writes a session's machine, or replaces it.

    Args:
        like: Name of the template.
        values: Values by name of the option of `hframe machines new`, without dashes, or by name of a
            parameter such as "x.mass" (`--set`); empty ones are left out. An option that is repeated has a
            list, a switch True or False.
    """
    words = ["machines", "new", "--like", like]
    for name, value in values.items():
        if isinstance(value, bool):
            words.append(f"--{name}" if value else f"--no-{name}")
            continue
        texts = (value,) if isinstance(value, str) else value
        for text in filter(None, map(str.strip, texts)):
            words += ["--set", f"{name}={text}"] if "." in name else [f"--{name}", text]
    return [*words, "--out", MACHINE, "--force"]


def import_command(choices: ImportChoices) -> list[str]:
    """Return the words after "hframe" of the command that imports the logs of a session."""
    words = ["import", LOGS, "--machine", MACHINE]
    for option, values in (
        ("--map", choices.columns),
        ("--unit", choices.units),
        ("--scale", choices.scales),
    ):
        for channel, value in values.items():
            if value:
                words += [option, f"{channel}={value}"]
    if choices.intervals:
        for interval in choices.intervals:
            name = f"{interval.log}=" if interval.log else ""
            words += ["--cut", f"{name}{interval.begin:.9g}:{interval.end:.9g}"]
    elif choices.split == "rests":
        words += ["--split-at-rests", "--min-rest", f"{choices.seconds:g}"]
    elif choices.split == "every":
        words += ["--split-every", f"{choices.seconds:g}"]
    return [*words, "--out", RUNS]


def check_command() -> list[str]:
    """Return the words after "hframe" of the command that checks the runs of a session."""
    return ["check", RUNS, "--machine", MACHINE, "--json", FINDINGS]


def identify_command(hold_out: Sequence[str], budget: str, force: bool) -> list[str]:
    """Return the command that identifies the machine of a session; it runs in the session's folder.

    Args:
        hold_out: Names of held-out runs; empty for the default.
        budget: Processor time, s, as text; empty for the default.
        force: Whether to fit although the runs have faults.

    Returns:
        Words after "hframe".
    """
    words = ["identify", RUNS, "--machine", MACHINE]
    for name in hold_out:
        words += ["--hold-out", name]
    if budget.strip():
        words += ["--budget", budget.strip()]
    return [*words, *(["--force"] if force else []), "--out", RESULT]


def control_folder(machine: str) -> str:
    """Return the folder for comparisons of controllers on a machine, relative to the session's folder."""
    return (PurePosixPath(machine).parent / CONTROL).as_posix()


def evaluate_command(
    controllers: Sequence[str],
    machine: str,
    *,
    task: str,
    randomize: str,
    period: str,
    episodes: int,
    motions: int,
) -> list[str]:
    """Return the command that compares controllers on a machine.

    Args:
        period: Control period, s, as text.
        motions: Number of episodes whose motion is stored.

    Returns:
        Words after "hframe".
    """
    words = ["evaluate", *controllers, "--machine", machine, "--task", task, "--randomize", randomize]
    words += ["--period", period.strip()] if period.strip() else []
    words += ["--episodes", str(episodes), "--motions", str(motions), "--html"]
    return [*words, "--out", control_folder(machine)]


def export_command(
    kind: str, machine: str | None, options: Mapping[str, str], arguments: Sequence[str]
) -> list[str]:
    """Return the command of an export.

    Args:
        options: Values by name of the option; "" for a switch.
        arguments: Words without option, such as controllers.

    Returns:
        Words after "hframe".
    """
    words = ["export", kind, *arguments, *(["--machine", machine] if machine else [])]
    for name, value in options.items():
        words += [f"--{name.replace('_', '-')}", *([value] if value else [])]
    return [*words, "--out", f"{EXPORTS}/{kind}"]
