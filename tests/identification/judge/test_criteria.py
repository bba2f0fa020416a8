"""Tests of the decision thresholds."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
import re
from pathlib import Path

import pytest

from hframe_gym.identification import SelectionCriteria, judge


def test_every_threshold_is_documented_and_printed() -> None:
    criteria = SelectionCriteria(max_effects=3)
    names = [field.name for field in dataclasses.fields(SelectionCriteria)]
    lines = str(criteria).splitlines()
    assert [line.partition(" = ")[0] for line in lines] == names
    assert "max_effects = 3" in lines
    for name in names:
        assert f"        {name}: " in "".join(each.__doc__ or "" for each in SelectionCriteria.__mro__)


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_impossible_thresholds_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match="explained_chi2"):
        SelectionCriteria(explained_chi2=value)


# Calibrated on rigs without effects by benchmarks/identification.py: run it before you change one of them.
CALIBRATED = SelectionCriteria(
    min_gain=0.01,
    chance=1e-6,
    min_gain_fraction=0.1,
    rival_gain_fraction=0.97,
    min_trial_gain=0.5,
    min_confirmed_fraction=0.3,
    min_force_ratio=1.0,
    max_form_error=0.2,
    max_effects=5,
    max_full_fits=6,
    min_promise=0.4,
    rival_promise=0.8,
    min_structural_promise=0.1,
    min_promised_force_ratio=0.5,
    linear_gain_ratio=0.6,
    rival_remainder=0.2,
    structural_remainder=0.5,
    structural_retry=0.67,
    max_screened_tables=6,
    max_tables_per_coordinate=3,
    max_table_cross_validation=0.4,
    cross_validation_blocks=8,
    max_drift=0.3,
    explained_chi2=1.5,
    max_partial_excess=0.25,
    max_noise_ratio_explained=2.0,
    max_motion_error=0.1,
    max_remaining=0.03,
)


def test_the_thresholds_are_the_calibrated_ones() -> None:
    """A threshold changes verdicts, so none changes unnoticed."""
    assert SelectionCriteria() == CALIBRATED


@pytest.mark.parametrize("value", [0.0, 5.0])
def test_thresholds_that_are_zero_or_more_are_accepted(value: float) -> None:
    assert SelectionCriteria(explained_chi2=value).explained_chi2 == value


def test_the_page_states_the_numbers_of_the_code() -> None:
    """Of How it decides: "10 % of the excess (`min_gain_fraction`)" in text, "`CLEAR` 2" in the table."""
    page = (Path(__file__).parents[3] / "docs/how_it_decides.md").read_text("utf-8")
    text, _, table = page.partition("## The numbers that decide")
    number = r"(?<![\w.])(\d[\d.]*(?:e-?\d+)?)( %)?"
    stated = [
        (name, value, percent) for value, percent, name in re.findall(number + r"[^`(|\d]*\(`(\w+)`\)", text)
    ]
    stated += re.findall(r"`(\w+)` " + number, table.partition("\n## ")[0])
    assert len(stated) >= 30
    values = dataclasses.asdict(SelectionCriteria())
    for module in pkgutil.iter_modules(judge.__path__):
        values |= vars(importlib.import_module(f"{judge.__name__}.{module.name}"))
    for name, value, percent in stated:
        assert float(value) * (0.01 if percent else 1.0) == pytest.approx(values[name]), name
