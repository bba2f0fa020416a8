"""Tests of the decision thresholds."""

from __future__ import annotations

import dataclasses

import pytest

from hframe_gym.identification import SelectionCriteria

pytestmark = pytest.mark.unit


def test_every_threshold_is_documented_and_printed() -> None:
    criteria = SelectionCriteria(max_effects=3)
    names = [field.name for field in dataclasses.fields(SelectionCriteria)]
    lines = str(criteria).splitlines()
    assert [line.partition(" = ")[0] for line in lines] == names
    assert "max_effects = 3" in lines
    for name in names:
        assert f"        {name}: " in (SelectionCriteria.__doc__ or "")


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_impossible_thresholds_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match="explained_chi2"):
        SelectionCriteria(explained_chi2=value)
