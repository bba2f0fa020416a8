"""The folder in which compiled code is cached."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest

from hframe_gym.files import cache_folder


def test_folder_without_write_access_is_skipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next candidate of `cache_folder` serves."""
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("HFRAME_CACHE", str(tmp_path / "file" / "below"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with pytest.warns(RuntimeWarning, match=r"below cannot be written.*is cached in .*Set HFRAME_CACHE"):
        assert cache_folder() == tmp_path / "cache" / "hframe_gym"
    assert cache_folder() == tmp_path / "cache" / "hframe_gym"  # says it once


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="each user of this system has a temporary folder")
def test_code_is_not_cached_in_a_temporary_folder_that_others_can_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody else could have prepared code there, which would be executed."""
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.delenv("HFRAME_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    shared = tmp_path / f"hframe_gym-{os.getuid()}"
    shared.mkdir()
    shared.chmod(0o777)
    with pytest.warns(RuntimeWarning, match="is cached in"):
        chosen = cache_folder()
    assert chosen != shared
    assert chosen.stat().st_mode & 0o077 == 0


def test_the_cache_is_in_a_private_temporary_folder_where_users_have_no_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.delenv("HFRAME_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setenv("LOGNAME", "me")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.delattr(os, "getuid", raising=False)
    with pytest.warns(RuntimeWarning, match="is cached in"):
        assert cache_folder() == tmp_path / "hframe_gym-me"
