"""Tests of rivals (effects that explain data equally well) by scripted fits: order, margin, replacement."""

from __future__ import annotations

import dataclasses
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import default_free_parameters, fit
from hframe_gym.identification.evidence import rivals
from hframe_gym.identification.fit.estimation import Fit
from hframe_gym.identification.fit.model_error import likelihood_loss
from hframe_gym.identification.judge.chance import LongRunVariance
from hframe_gym.identification.predict.prediction import POLISH_STEP
from hframe_gym.machine import AppliedEffect
from tests.identification.scripted_fits import AXIS, CRITERIA, DRAG, HFRAME, PUSH, SPRING, fit_with
from tests.identification.single_axis import axis_runs

VOLTAGE_OFFSET = EFFECTS["voltage_offset"]


def test_of_trials_as_good_as_the_best_the_simplest_comes_first() -> None:
    current = fit_with(chi2=2.0)
    best, simple, poor = (
        fit_with(effect, chi2=chi2, free=free)
        for effect, chi2, free in ((PUSH, 1.0, 5), (DRAG, 1.029, 3), (SPRING, 1.031, 1))
    )
    order = rivals.simplest_first([poor, best, simple], current, CRITERIA)
    assert order == [simple, best, poor]
    assert rivals.simplest_first([], current, CRITERIA) == []


def test_an_effect_at_the_limit_of_its_range_is_tried_after_others_that_explain_half_as_much() -> None:
    (size,) = PUSH.definition.parameters
    limited = fit_with(PUSH.with_parameters({size.name: size.upper}), chi2=1.0)
    half, less = fit_with(DRAG, chi2=1.4), fit_with(SPRING, chi2=1.6)
    current = fit_with(chi2=2.0)
    assert rivals.limited_last([limited, half, less], current) == [half, less, limited]
    assert rivals.limited_last([limited, less], current) == [limited, less]
    assert rivals.limited_last([limited], current) == [limited]


def test_rivals_are_other_effects_within_the_margin() -> None:
    current, best = fit_with(chi2=2.0), fit_with(PUSH, chi2=1.0)
    close, same, far = fit_with(DRAG, chi2=1.029), fit_with(PUSH, chi2=1.001), fit_with(SPRING, chi2=1.031)
    trials = [best, same, close, close, far]
    # 300 of the cost of 10,000 are 3 % of the gain; chance causes differences of 24 times the ratio.
    for ratio, expected in ((1.0, (DRAG,)), (20.0, (DRAG, SPRING))):
        variance = partial(LongRunVariance, ratio)
        assert rivals.close_rivals(trials, current, variance, CRITERIA) == expected


@pytest.mark.parametrize(
    ("duration", "voltages_known", "hidden"), [(1e-3, False, True), (1e-3, True, False), (5e-3, False, False)]
)
def test_a_delay_and_a_lag_within_a_row_of_a_log_without_all_voltages_are_not_told_apart(
    duration: float, voltages_known: bool, hidden: bool
) -> None:
    """Here the lag explains far more, beyond all chance, but voltages within a row of 4 ms are unknown."""
    data: Any = SimpleNamespace(has_voltage_errors=not voltages_known, period=4e-3)
    lag, delay = (
        EFFECTS["electrical_lag"].at("drives", tau=duration),
        EFFECTS["input_delay"].at("drives", d=duration),
    )
    assert rivals.hidden_rivals(lag, data) == ((delay,) if hidden else ())
    assert rivals.hidden_rivals(delay, data) == ((lag,) if hidden else ())
    assert rivals.hidden_rivals(PUSH, data) == ()
    if hidden:
        compared = rivals.compare_rivals(fit_with(lag, chi2=1.0), lag.label, [delay], data, CRITERIA)
        assert compared == rivals.ComparedRivals(None, (delay,))


def test_a_fit_is_polished_at_its_bandwidth_and_in_simulation() -> None:
    """The runs of an exact machine are most likely in simulation, and parameters 5 % off are corrected."""
    data = axis_runs(AXIS, rows=500, volts=3.0)
    x = AXIS.coordinates[0]
    wrong = AXIS.replace(coordinates=(dataclasses.replace(x, mass=1.05 * x.mass),))
    start = fit(wrong, default_free_parameters(wrong), data, 30.0)
    polished = rivals.most_likely_fit(start, data)
    assert (polished.bandwidth, polished.longest_step) == (0.0, POLISH_STEP)
    assert likelihood_loss(polished, data) < likelihood_loss(start, data)


def test_two_constant_forces_may_be_two_others() -> None:
    """They are tried at the coordinates without one; a voltage offset of a drive acts on its pulley."""
    force = EFFECTS["constant_force"]
    on_y, on_pulley, offset = (
        force.at("y", size=0.5),
        force.at("phi2", size=0.01),
        VOLTAGE_OFFSET.at("motor2", V0=0.1),
    )
    machine = HFRAME.with_effects(on_y, offset)
    of_force = rivals.rivals_in_combination(on_y, (), [offset, on_pulley], machine)
    assert {r.label for r in of_force} == {"constant_force@x", "constant_force@phi1"}
    of_offset = rivals.rivals_in_combination(offset, (on_pulley,), [on_y], machine)
    assert {r.label for r in of_offset} == {"constant_force@x", "voltage_offset@motor1"}
    assert all(value == 0.0 for r in (*of_force, *of_offset) for value in r.parameters.values())


def test_an_effect_without_a_companion_of_its_kind_has_no_further_rivals() -> None:
    spring = EFFECTS["cable_spring"].at("x", k=6.0, q0=0.05)
    push = EFFECTS["constant_force"].at("y", size=0.5)
    assert rivals.rivals_in_combination(push, (), [spring], HFRAME.with_effects(push, spring)) == ()
    # A spring has two parameters: no fit can start from its absence.
    springs = spring, EFFECTS["cable_spring"].at("y", k=6.0, q0=0.05)
    assert rivals.rivals_in_combination(springs[0], (), [springs[1]], HFRAME.with_effects(*springs)) == ()


def test_an_effect_that_adds_coordinates_keeps_its_rivals_untried() -> None:
    """Without it, other parts of the machine would have no mass: no rival can take its place."""
    resonance = EFFECTS["frame_resonance"].at("x", f0=20.0, zeta=0.05, r=0.2, s=0.0)
    current = dataclasses.replace(fit_with(chi2=1.0), machine=AXIS.with_effects(resonance))
    compared = rivals.compare_rivals(
        current, resonance.label, (PUSH,), axis_runs(AXIS, rows=20, volts=3.0), CRITERIA
    )
    assert compared == (None, (PUSH,))


def test_an_effect_of_the_machine_remains_no_rival_of_another_one() -> None:
    """What explained nearly as much as a spring while both were missing is there beside it."""
    current = fit_with(SPRING, PUSH, chi2=1.0)
    data = axis_runs(AXIS, rows=20, volts=3.0)
    assert rivals.compare_rivals(current, SPRING.label, (PUSH,), data, CRITERIA) == (None, ())


@pytest.mark.parametrize(("n", "better"), [(0.9998, False), (12.0, True)])
def test_a_rival_that_is_the_simpler_effect_itself_is_dropped(
    monkeypatch: pytest.MonkeyPatch, n: float, better: bool
) -> None:
    """An interpolation error of one period a turn is an eccentric encoder."""
    eccentric = EFFECTS["eccentric_encoder"].at("phi1_rad", A=0.02, p=0.7)
    other = EFFECTS["interpolation_error"].at("phi1_rad", A=0.02, n=n, p=0.7)

    def fitted(effect: AppliedEffect, chi2: float) -> Fit:
        return dataclasses.replace(fit_with(chi2=chi2), machine=HFRAME.with_effects(effect))

    monkeypatch.setattr(rivals, "fit_in_place_of", lambda *_, **__: fitted(other, 1.0))
    monkeypatch.setattr(rivals, "most_likely_fit", lambda start, *_: start)
    monkeypatch.setattr(rivals, "likelihood_loss", lambda fitted, _: fitted.chi2)
    monkeypatch.setattr(rivals, "long_run_variance", lambda *_: LongRunVariance(1.0))
    monkeypatch.setattr(rivals, "_goal", lambda *_: 0.0)
    data: Any = SimpleNamespace(count=1e4, has_voltage_errors=False)
    compared = rivals.compare_rivals(fitted(eccentric, 1.1), eccentric.label, (other,), data, CRITERIA)
    assert (compared.better is not None) == better
    assert compared.remaining == ((other,) if better else ())
