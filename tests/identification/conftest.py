"""Fixtures of the tests of identification."""

from __future__ import annotations

import pytest

from tests.identification.scripted_fits import Scripted


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> Scripted:
    """Return a script of everything that a search computes."""
    return Scripted(monkeypatch)
