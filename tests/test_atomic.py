"""Atomic files: a failed write leaves no trace."""

from __future__ import annotations

from pathlib import Path

import pytest

from hframe_gym.atomic_files import atomic_file, write_text


def test_a_failed_write_keeps_the_old_file_and_leaves_no_temporary_file(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    write_text(path, "old")

    def fail() -> None:
        with atomic_file(path) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_is_written_into_a_new_folder_and_is_readable_by_others(tmp_path: Path) -> None:
    path = tmp_path / "new" / "out.txt"
    write_text(path, "text µ")
    assert path.read_text(encoding="utf-8") == "text µ"
    assert path.stat().st_mode & 0o777 == 0o644
