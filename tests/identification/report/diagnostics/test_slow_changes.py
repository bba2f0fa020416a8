"""Tests of what is reported of effects whose time constant is longer than the runs."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset
from hframe_gym.identification.report.content.document import Report
from hframe_gym.identification.report.diagnostics.slow_changes import slow_change
from hframe_gym.identification.report.words.rows import effect_rows
from hframe_gym.machine import AppliedEffect, Machine, Uncertainty
from tests.identification.single_axis import AXIS, axis_result, axis_runs

WARM_UP = EFFECTS["friction_warm_up"].at("machine", a=0.5, tau=200.0)
HEAT = EFFECTS["winding_heat"].at("motor", a=0.1, tau=60.0)


def with_relative_std(effect: AppliedEffect, of_tau: float, of_rate: float) -> Machine:
    """Return an axis with an effect whose tau, and rate a / tau, have independent relative deviations."""
    machine = AXIS.with_effects(effect)
    a, tau = effect.parameters["a"], effect.parameters["tau"]
    # a = rate tau, so that a changes by a of_tau with tau.
    factor = np.array([[a * of_rate, a * of_tau], [0.0, tau * of_tau]])
    names = (f"{effect.label}.a", f"{effect.label}.tau")
    return machine.replace(uncertainty=Uncertainty(names, factor @ factor.T))


def test_a_poorly_determined_time_constant_has_a_least_value_and_a_rate() -> None:
    change = slow_change(WARM_UP, with_relative_std(WARM_UP, 0.6, 0.02))
    assert change is not None
    assert change.least == pytest.approx(200.0 / (1.0 + 1.96 * 0.6), rel=1e-3)
    assert change.rate == pytest.approx(0.5 / 200.0)
    assert change.rate_std == pytest.approx(0.02 * 0.5 / 200.0)
    text = change.describe()
    assert "a / tau = 15 +- 0.3 % per minute" in text
    assert "tau is at least 91.9 s" in text


def test_the_rate_of_an_amplitude_with_a_unit_states_it() -> None:
    change = slow_change(HEAT, with_relative_std(HEAT, 1.0, 0.1))
    assert change is not None
    assert "a / tau = 10 +- 1 % per A^2 and minute" in change.describe()


@pytest.mark.parametrize("of_tau", [0.05, 0.19])
def test_a_known_time_constant_is_no_slow_change(of_tau: float) -> None:
    assert slow_change(WARM_UP, with_relative_std(WARM_UP, of_tau, 0.01)) is None


def test_other_effects_and_machines_without_uncertainty_have_no_slow_change() -> None:
    assert slow_change(WARM_UP, AXIS.with_effects(WARM_UP)) is None
    stribeck = EFFECTS["stribeck_friction"].at("x", dF=0.3, vs=0.1)
    names = (f"{stribeck.label}.dF", f"{stribeck.label}.vs")
    machine = AXIS.with_effects(stribeck).replace(uncertainty=Uncertainty(names, np.eye(2)))
    assert slow_change(stribeck, machine) is None


def slow_runs() -> Dataset:
    """Return three runs of an axis."""
    return axis_runs(AXIS, rows=500, volts=6.0)


def test_the_report_states_the_least_value_in_place_of_a_deviation() -> None:
    result = axis_result(slow_runs(), with_relative_std(WARM_UP, 0.6, 0.02))
    assert any("tau is at least 91.9 s" in note for note in result.notes)
    written = result.as_json()["effects"][0]["parameters"]
    assert written["tau"]["at_least"] == pytest.approx(91.9, rel=1e-3)
    assert "at_least" not in written["a"]
    report = Report.model_validate(result.as_json() | {"schema": 1})
    (row,) = effect_rows(report, result.after.machine)
    of_tau = next(p for p in row.parameters if p.name == "tau")
    assert (of_tau.value, of_tau.std) == ("2e+02 (at least 92)", "")
