"""Tests of report.json: what is in it, and that reading it gives what was written."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.identification import Dataset, write_result
from hframe_gym.identification.report.content.document import UnknownVoltages
from hframe_gym.identification.report.content.saved_result import load_result
from tests.identification.report.axis_results import PLAN, STRIBECK, result_of


def test_what_is_written_is_read_again(data: Dataset, tmp_path: Path) -> None:
    """Both follow from one declaration, so that no field is lost on the way to the page."""
    unknown = UnknownVoltages(
        changes_per_row=4, period_s=1e-3, errors={"x_m": 1e-5}, fitted_by="white residual"
    )
    result = dataclasses.replace(
        result_of(data, "effect_found", STRIBECK, PLAN), unknown_voltages=unknown, unstable=True
    )
    write_result(result, tmp_path)
    written = json.loads((tmp_path / "report.json").read_text())
    assert written["unknown_voltages"] == unknown.as_json()
    assert written["unstable"] is True
    assert load_result(tmp_path).report.as_json() == written


def test_what_is_left_without_the_runs_that_contradict_is_in_the_report(data: Dataset) -> None:
    result = result_of(data, "effect_found", STRIBECK)
    noise = data.noise[0]
    errors = {"run_1": np.full((5, 1), 3.0 * noise), "run_2": np.full((5, 1), 40.0 * noise)}
    result = dataclasses.replace(result, after=dataclasses.replace(result.after, errors=errors))
    one, all_runs = (
        dataclasses.replace(result, contradicting=names) for names in (("run_2",), ("run_1", "run_2"))
    )
    assert one.as_json()["contradicting"] == ["run_2"]
    assert one.as_json()["left_in_others"] == pytest.approx(3.0)
    assert all_runs.as_json()["left_in_others"] is None
