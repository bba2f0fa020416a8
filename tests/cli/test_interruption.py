"""Signals end a command with one line and the right exit code; answers do not depend on circumstances."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from filelock import FileLock
from typer.testing import CliRunner

from benchmarks.faults.determinism import determinism
from hframe_gym.cli import app
from hframe_gym.cli.messages import describe_failure

ROOT = Path(__file__).parents[2]
needs_signals = pytest.mark.skipif(
    sys.platform == "win32", reason="Windows cannot send SIGINT or SIGTERM to a process"
)
# Runs the entry point of the command with another command line application.
_COMMAND = """
import sys, time
import hframe_gym.__main__ as entry
import hframe_gym.cli as cli
entry._SECONDS_TO_CLEAN_UP = 0.3
def run(words, **options):
{body}
cli._command = lambda: run
entry.main()
"""
SLEEP = "    print('ready', flush=True)\n    time.sleep(60)"
CONVERTED = (
    "    try:\n        print('ready', flush=True)\n        time.sleep(60)\n"
    "    except BaseException:\n        raise ImportError('initialization failed') from None"
)
SWALLOWED = (
    "    while True:\n        try:\n            print('ready', flush=True)\n            time.sleep(60)\n"
    "        except BaseException:\n            pass"
)


def start(body: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", _COMMAND.format(body=body)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


@needs_signals
@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]
)
@pytest.mark.parametrize("body", [SLEEP, CONVERTED, SWALLOWED], ids=["unwinds", "converted", "swallowed"])
def test_a_signal_ends_the_command_with_one_line(
    body: str, number: signal.Signals, code: int, word: str
) -> None:
    """Also where a library converts the exception to another one, or ignores it."""
    with start(body) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    assert errors == f"hframe: {word}; files are unchanged or complete\n"
    assert process.returncode == code


@needs_signals
def test_an_ignored_signal_stays_ignored() -> None:
    """Commands in the background of a script, and those started by nohup, are not interrupted."""
    body = "    print('ready', flush=True)\n    time.sleep(0.5)"
    code = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n" + _COMMAND.format(body=body)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGINT)
    assert process.returncode == 0


@pytest.mark.parametrize(
    "words",
    [
        ("evaluate", "pid", "--episodes", "1"),
        ("identify", str(ROOT / "examples" / "rig_a")),
        ("train", "ppo"),
    ],
    ids=lambda words: words[0],
)
def test_a_folder_in_use_is_refused(words: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / ".hframe").mkdir()
    with FileLock(tmp_path / ".hframe" / "lock"):  # as another process would
        result = CliRunner().invoke(app, [*words, "--out", str(tmp_path)])
    assert result.exception is not None
    code, line = describe_failure(result.exception)  # type: ignore[arg-type]
    assert code == 2
    assert line == f"{tmp_path}: another hframe command is writing to this folder; wait or choose another one"
    assert [p.name for p in tmp_path.iterdir()] == [".hframe"]


def test_a_full_disk_is_the_inputs_fault_even_without_a_path() -> None:
    code, line = describe_failure(OSError(errno.ENOSPC, "No space left on device"))
    assert code == 2
    assert line.startswith("writing: No space left on device; make room")


@pytest.mark.slow
def test_answers_are_equal_to_the_byte_under_all_conditions() -> None:
    assert [row["failures"] for row in determinism(print)] == [[], []]
