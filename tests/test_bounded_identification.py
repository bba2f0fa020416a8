"""Tests of `hframe identify` with a budget and with Ctrl-C: what is printed and written, in which order."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hframe_gym import progress_records
from hframe_gym.cli import app
from hframe_gym.cli import progress as cli_progress
from hframe_gym.cli.messages import print_warning
from hframe_gym.cli.progress import finishing_on_interrupt, search_progress
from hframe_gym.identification.budget import Budget, error_so_far, note_error, spend
from hframe_gym.recordings import save_machine, write_recording
from tests.identification.single_axis import AXIS, limited_runs

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def limited(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with runs of an axis whose current is limited, and its machine file."""
    folder = tmp_path_factory.mktemp("limited")
    (folder / "runs").mkdir()
    for run in limited_runs([3.0, 3.0, 9.0, 9.0, 3.0]):
        write_recording(folder / "runs" / f"{run.name}.csv", run, AXIS)
    save_machine(AXIS, folder / "axis.json")
    return folder


def identify(folder: Path, out: Path, *options: str) -> tuple[int, str]:
    """Run `hframe identify`; return its exit code and what it prints."""
    words = [
        "identify",
        str(folder / "runs"),
        "--machine",
        str(folder / "axis.json"),
        "--out",
        str(out),
        *options,
    ]
    result = CliRunner().invoke(app, words, catch_exceptions=False)
    return result.exit_code, result.stdout


@pytest.mark.usefixtures("without_drawing")
def test_a_budget_of_zero_only_refits_and_says_so(limited: Path, tmp_path: Path) -> None:
    code, printed = identify(limited, tmp_path, "--budget", "0")
    assert code == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["verdict"] == "unexplained"
    assert report["unfinished"]["reason"] == "the budget of 0 s of processor time ended"
    assert "at most about 0 s of processor time" in printed
    assert "The search is not complete" in printed
    page = (tmp_path / "report.html").read_text()
    assert "The search is not complete" in page
    assert f"hframe identify RUNS --machine {tmp_path / 'declared.json'} --out {tmp_path}" in page
    result, notes, following = (printed.index(text) for text in ("Result: ", "Notes (", "Next: "))
    assert result < notes < following


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Let Ctrl-C interrupt, although a shell starts background jobs with the signal ignored."""
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, previous)


@pytest.mark.usefixtures("interruptible", "without_drawing")
def test_an_interrupted_search_writes_what_it_found(
    limited: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(doing: str, spent: float, seconds: float) -> None:
        if doing.startswith("trial fit"):
            os.kill(os.getpid(), signal.SIGINT)

    progress = cli_progress.search_progress

    class Interrupting:
        def __init__(self, log: Callable[[str], None]) -> None:
            self.inner = progress(log)

        def __enter__(self) -> Callable[[str, float, float], None]:
            self.inner.__enter__()
            return interrupt

        def __exit__(self, *error: object) -> None:
            self.inner.__exit__(None, None, None)

    monkeypatch.setattr("hframe_gym.cli.identify_commands.search_progress", Interrupting)
    code, _ = identify(limited, tmp_path)
    assert code == 130
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["unfinished"]["reason"].startswith("interrupted after")
    assert report["unfinished"]["stage"].startswith("trial fit")


def test_a_second_interrupt_and_one_outside_a_search_end_the_command() -> None:
    budget, ended = Budget(), []
    previous = signal.signal(signal.SIGINT, lambda number, frame: ended.append(number))
    try:
        with finishing_on_interrupt(budget):
            os.kill(os.getpid(), signal.SIGINT)
            assert len(ended) == 1
            with budget.limiting():
                spend("screening")
                os.kill(os.getpid(), signal.SIGINT)
                assert (budget.interrupted, len(ended)) == (True, 1)
                os.kill(os.getpid(), signal.SIGINT)
                assert len(ended) == 2
        handler = signal.getsignal(signal.SIGINT)
        assert callable(handler)
        os.kill(os.getpid(), signal.SIGINT)
        assert len(ended) == 3
    finally:
        signal.signal(signal.SIGINT, previous)


def test_other_threads_leave_the_signal_alone() -> None:
    before, seen = signal.getsignal(signal.SIGINT), []

    def work() -> None:
        with finishing_on_interrupt(Budget()):
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [before]


def test_progress_is_a_plain_line_every_ten_seconds_where_there_is_no_terminal() -> None:
    lines: list[str] = []
    with search_progress(lines.append) as progress:
        for spent in (1.0, 12.0, 13.0, 21.0, 22.5):
            progress(f"trial fit {spent:g}", spent, 120.0)
        progress("the last", 40.0, float("inf"))
    assert lines == [
        "  trial fit 12 (12 s of at most 120)",
        "  trial fit 22.5 (22 s of at most 120)",
        "  the last (40 s)",
    ]


def test_warnings_about_numbers_and_of_other_libraries_are_not_for_the_user(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HFRAME_DEBUG", raising=False)
    print_warning("overflow encountered in square", RuntimeWarning)
    print_warning("a length in millimeters?", UserWarning)
    print_warning(
        "Objective did not converge", UserWarning, "/venv/lib/site-packages/sklearn/linear_model/_cd.py"
    )
    assert capsys.readouterr().err == "hframe: warning: a length in millimeters?\n"
    monkeypatch.setenv("HFRAME_DEBUG", "1")
    print_warning("overflow encountered in square", RuntimeWarning)
    assert "overflow" in capsys.readouterr().err


def test_progress_for_a_program_has_the_error_of_the_best_machine_so_far(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HFRAME_PROGRESS", "json")
    with search_progress(lambda line: None) as progress:
        budget = Budget(120.0, clock=lambda: 3.0, progress=progress)
        with budget.limiting():
            note_error(25.5)
            spend("trial fit 1")
            spend("trial fit 2")  # at once, so that it is left out
    records = map(progress_records.record_of, capsys.readouterr().out.split("\n"))
    assert [record for record in records if record is not None] == [
        {"doing": "trial fit 1", "spent": 0.0, "budget": 120.0, "error": 25.5}
    ]
    assert error_so_far() is None
