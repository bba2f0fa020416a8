"""Tests of the curves of a page: errors of runs, and effects."""

from __future__ import annotations

import base64
import dataclasses
import json

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset
from hframe_gym.identification.report.content.document import Plain
from hframe_gym.identification.report.content.plot_data import plot_data
from hframe_gym.identification.report.content.result_curves import ResultCurves, RunCurves
from hframe_gym.identification.report.plots.effect_curves import effect_curve
from hframe_gym.identification.report.plots.held_out_curves import page_curves, worst_first
from hframe_gym.identification.report.plots.panels import report_panels
from hframe_gym.machine import BUILTIN_MACHINES, Uncertainty
from tests.identification.report.axis_results import STRIBECK, TABLE, result_of
from tests.identification.single_axis import AXIS, PRESLIDING


def test_curves_of_the_page_are_those_of_the_machines_worst_run_first(data: Dataset) -> None:
    result = result_of(data, "effect_found", STRIBECK)
    report, curves = result.as_report(), plot_data(result)
    noise = report.noise_of("x_m")
    assert noise is not None
    for name, factor in (("run_8", 1.0), ("run_9", 3.0)):  # two more runs, the second of which is the worst
        run = curves.runs["run_2"]
        errors = run.errors | {"after": factor * noise * np.ones((500, 1))}
        curves.runs[name] = dataclasses.replace(run, errors=errors)
    report.runs.held_out = ["run_8", "run_9"]
    drawn = page_curves(report, curves)
    assert [run["label"] for run in drawn["runs"]] == ["run_9: 3 × noise", "run_8: 1 × noise"]
    assert [machine["key"] for machine in drawn["machines"]] == ["declared", "before", "after"]
    (channel,) = drawn["runs"][0]["channels"]
    error = np.frombuffer(base64.b64decode(channel["errors"]["before"]), "<f4")
    assert error == pytest.approx(curves.runs["run_9"].errors["before"][:, 0], rel=1e-6)
    curves.runs["run_8"].errors["after"] = np.full((500, 1), np.nan)  # diverges
    assert worst_first(report, curves) == ["run_8", "run_9"]


def test_a_long_curve_keeps_its_peaks_and_the_page_stays_small(data: Dataset) -> None:
    report = result_of(data, "effect_found", STRIBECK).as_report()
    report.plain = Plain(held_out=report.before.held_out)
    report.runs.held_out = [f"run_{k}" for k in range(20)]
    time_s = 1e6 + 1e-3 * np.arange(100_000)
    errors = 1e-5 * np.sin(time_s)[:, None]
    errors[54_321] = 7e-3
    run = RunCurves(time_s, errors, dict.fromkeys(("declared", "before", "after", "plain"), errors))
    curves = ResultCurves(dict.fromkeys(report.runs.held_out, run), None, {})
    drawn = page_curves(report, curves)
    assert [machine["label"] for machine in drawn["machines"]] == [
        "as declared",
        "plain fit",
        "refitted",
        "with effects",
    ]
    assert len(json.dumps(drawn)) < 2e6
    (channel,) = drawn["runs"][0]["channels"]
    error, times = (
        np.frombuffer(base64.b64decode(text), "<f4") for text in (channel["errors"]["after"], channel["time"])
    )
    assert times[np.argmax(error)] == pytest.approx(54.321, abs=1e-4)
    assert error.max() == pytest.approx(7e-3)


def test_an_effect_is_drawn_with_the_band_of_its_parameters(data: Dataset) -> None:
    """The level Fc + dF exp(-(v/vs)^2) has the variance of its linear terms; Fc and dF are anticorrelated."""
    curves = plot_data(result_of(data, "effect_found", STRIBECK))
    level = AXIS.coordinates[0].coulomb
    covariance = np.array([[0.04, -0.018, 0.0], [-0.018, 0.01, 0.0], [0.0, 0.0, 1e-6]])
    names = ("x.coulomb", "stribeck_friction@x.dF", "stribeck_friction@x.vs")
    machine = STRIBECK.replace(uncertainty=Uncertainty(names, covariance))
    curve = effect_curve(machine.effects[0], machine, curves)
    assert curve is not None
    assert (curve.variable, curve.quantity) == ("velocity of x, m/s", "dry friction on x, N")
    assert curve.x.max() == pytest.approx(min(8 * 0.02, np.abs(curves.coverage["velocity of x"]).max()))
    shape = np.exp(-((curve.x / 0.02) ** 2))
    assert curve.y == pytest.approx(np.sign(curve.x) * (level + 0.8 * shape))
    by_width = 0.8 * shape * 2 * curve.x**2 / 0.02**3
    variance = 0.04 + 0.01 * shape**2 - 2 * 0.018 * shape + 1e-6 * by_width**2
    assert curve.std == pytest.approx(np.sqrt(variance), rel=1e-3)
    report = result_of(data, "effect_found", machine).as_report()
    assert len(report_panels(report, curves, machine, AXIS)["effects"]) == 1
    assert not report_panels(report, curves, machine, declared=machine)["effects"]


def test_a_periodic_torque_is_drawn_over_its_periods_and_a_state_has_no_curve(data: Dataset) -> None:
    curves = plot_data(result_of(data, "effect_found", STRIBECK))
    stage = BUILTIN_MACHINES["hframe"]().with_effects(EFFECTS["cogging"].at("motor1", A=0.01, n=50.0, p=0.3))
    cogging = effect_curve(stage.effects[0], stage, curves)
    assert cogging is not None
    assert cogging.variable == "position of phi1, rad"
    assert cogging.x[-1] == pytest.approx(12 * 2 * np.pi / 50)
    assert cogging.y == pytest.approx(0.01 * np.sin(50 * cogging.x + 0.3))
    assert not cogging.std.any()  # not known
    assert effect_curve(PRESLIDING, AXIS.with_effects(PRESLIDING), curves) is None
    assert effect_curve(TABLE.effects[0], TABLE, curves) is None
