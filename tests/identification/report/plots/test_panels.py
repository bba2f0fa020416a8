"""Tests of the plots of a page: over time, over position and speed, and correlations."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from hframe_gym.identification import Dataset
from hframe_gym.identification.report.content.plot_data import plot_data
from hframe_gym.identification.report.plots.correlations import CONFIDENCE, correlation
from hframe_gym.identification.report.plots.error_dependence import error_panels
from hframe_gym.identification.report.plots.panels import report_panels
from tests.identification.report.axis_results import STRIBECK, result_of
from tests.identification.single_axis import AXIS


def test_a_channel_that_was_not_measured_has_no_plot_over_time(data: Dataset) -> None:
    result = result_of(data, "no_effect", AXIS)
    curves = plot_data(result)
    assert len(report_panels(result.as_report(), curves, AXIS, AXIS)["error_over_time"]) == 1
    run = curves.runs["run_2"]
    curves.runs["run_2"] = dataclasses.replace(run, measured=np.full_like(run.measured, np.nan))
    assert report_panels(result.as_report(), curves, AXIS, AXIS)["error_over_time"] == []


def test_errors_over_position_and_speed_lie_in_the_region_of_white_noise_only_if_they_are(
    data: Dataset,
) -> None:
    result = result_of(data, "effect_found", STRIBECK)
    report, curves = result.as_report(), plot_data(result)
    noise, rng = data.noise[0], np.random.default_rng(0)
    measured = curves.runs["run_2"].measured[:, 0]
    fractions = []
    for part in (0.0, 20.0):
        curves.runs["run_2"].errors["after"] = (
            noise * rng.normal(size=len(measured)) + part * noise * measured / measured.max()
        )[:, None]
        over_position, over_speed = error_panels(report, curves, AXIS)
        assert "over speed of x" in over_speed.title
        match = re.search(r"outside the band: ([\d.]+) %", over_position.title)
        assert match is not None
        fractions.append(float(match[1]))
    assert fractions[0] < 10.0
    assert fractions[1] > 60.0


def test_white_noise_stays_in_the_region_and_a_late_response_does_not() -> None:
    rng = np.random.default_rng(1)
    noise, command = rng.normal(size=(2, 20_000))
    limit = CONFIDENCE / np.sqrt(20_000)
    outside = np.abs(correlation(command, noise, 400)) > limit
    assert 0.0 < outside.mean() < 0.03  # 1 % on average
    late = noise + 0.1 * np.concatenate([np.zeros(7), command[:-7]])
    assert np.argmax(correlation(command, late, 400)) == 7
    assert correlation(command, late, 400)[7] == pytest.approx(0.1, abs=0.02)
    assert correlation(noise, noise, 3)[0] == pytest.approx(1.0)
    assert not correlation(np.ones(100), noise[:100], 5).any()
