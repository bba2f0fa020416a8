"""What differs between operating systems, calculated for each of them here."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from hframe_gym import operating_system
from hframe_gym.operating_system import cores, quoted, reused_memory, user_folder


@pytest.mark.parametrize(
    ("kind", "system", "variables", "folder"),
    [
        ("cache", "linux", {}, "HOME/.cache"),
        ("cache", "linux", {"XDG_CACHE_HOME": "/fast"}, "/fast"),
        ("cache", "darwin", {}, "HOME/Library/Caches"),
        ("cache", "win32", {"LOCALAPPDATA": "C:/Users/me/AppData/Local"}, "C:/Users/me/AppData/Local"),
        ("cache", "win32", {}, "HOME/AppData/Local"),
        ("cache", "freebsd14", {}, "HOME/.cache"),
        ("data", "linux", {}, "HOME/.local/share"),
        ("data", "darwin", {}, "HOME/Library/Application Support"),
        ("data", "win32", {"LOCALAPPDATA": "C:/Users/me/AppData/Local"}, "C:/Users/me/AppData/Local"),
    ],
)
def test_folders_of_a_user(kind: str, system: str, variables: dict[str, str], folder: str) -> None:
    expected = Path(folder.replace("HOME", os.path.expanduser("~")))
    assert user_folder(kind, system, variables) == expected  # type: ignore[arg-type]


def test_words_are_quoted_for_the_shell_of_the_system() -> None:
    assert quoted(r"C:\logs\run 1.csv", "win32") == r'"C:\logs\run 1.csv"'
    assert quoted(r"C:\logs\run_1.csv", "win32") == r"C:\logs\run_1.csv"
    assert quoted("/logs/run 1.csv", "linux") == "'/logs/run 1.csv'"


@pytest.mark.parametrize("absent", [(), ("process_cpu_count",), ("process_cpu_count", "sched_getaffinity")])
def test_cores_are_counted_by_what_the_system_offers(
    absent: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in absent:
        monkeypatch.delattr(os, name, raising=False)
    operating_system._cores.cache_clear()
    assert 1 <= cores() <= (os.cpu_count() or 1)
    operating_system._cores.cache_clear()


def test_memory_of_freed_arrays_is_kept_only_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[int, ...]] = []
    library = SimpleNamespace(
        mallopt=lambda *option: calls.append(option), malloc_trim=lambda *kept: calls.append(kept)
    )
    monkeypatch.setattr(operating_system.sys, "platform", "linux")
    monkeypatch.setattr(operating_system.ctypes, "CDLL", lambda _: library)
    with reused_memory():
        kept = dict(calls)
        calls.clear()
    assert calls[-1] == (0,)  # returned
    assert {option: size < kept[option] for option, size in calls[:-1]} == {-1: True, -3: True}


@pytest.mark.parametrize("system", ["linux", "darwin", "win32"])
def test_other_libraries_of_memory_are_left_as_they_are(monkeypatch: pytest.MonkeyPatch, system: str) -> None:
    monkeypatch.setattr(operating_system.sys, "platform", system)
    monkeypatch.setattr(operating_system.ctypes, "CDLL", lambda _: SimpleNamespace())
    with reused_memory():
        pass
