"""Fixtures of the tests of data validation."""

from __future__ import annotations

import pytest

from hframe_gym.recordings import Recording
from tests.example_runs import example_runs


@pytest.fixture
def runs() -> list[Recording]:
    """Return three good recordings of the H-frame."""
    return list(example_runs("rig_b")[:3])
