"""Fixtures of the tests of results and their pages."""

from __future__ import annotations

import pytest

from hframe_gym.identification import Dataset
from tests.identification.report.axis_results import STRIBECK
from tests.identification.single_axis import axis_runs


@pytest.fixture(scope="session")
def data() -> Dataset:
    """Return three runs of the axis with Stribeck friction, 0.5 s each. The data set is immutable."""
    return axis_runs(STRIBECK, rows=500, volts=2.0)
