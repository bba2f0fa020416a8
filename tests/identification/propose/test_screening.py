"""Tests of screening: it ranks the effect that is missing first and predicts what a fit would save."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, Fit, default_free_parameters, fit, prepare, screen
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH, SIMULATION
from hframe_gym.identification.propose.screening import Screening
from hframe_gym.machine import Machine
from tests.identification.propose.recorded_axis import CANDIDATES, candidate, recorded


def fit_without_effect(axis: Machine, effect_size: float) -> tuple[Fit, Dataset]:
    """Return a fit of the axis to a recording of the same axis with a constant force, N."""
    data = prepare([recorded(axis.with_effects(EFFECTS["constant_force"].at("x", size=effect_size)))], axis)
    return fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH), data


def test_missing_effect_ranks_first_with_its_size(axis: Machine) -> None:
    fitted, data = fit_without_effect(axis, 0.3)
    best = screen(fitted, CANDIDATES, data)[0]
    assert best.candidate.label == "constant_force@x"
    assert best.candidate.applied(best.amounts).parameters["size"] == pytest.approx(0.3, rel=0.1)
    machine = fitted.machine.with_effects(best.candidate.applied(best.amounts))
    with_effect = fit(machine, default_free_parameters(machine), data, SEARCH_BANDWIDTH)
    assert best.gain == pytest.approx(fitted.cost - with_effect.cost, rel=0.3)


def test_candidates_save_next_to_nothing_where_no_effect_is_missing(axis: Machine) -> None:
    fitted, data = fit_without_effect(axis, 0.0)
    assert max(s.gain for s in screen(fitted, CANDIDATES, data)) < 0.02 * data.count


def test_amount_stays_within_the_bounds_of_the_parameter(axis: Machine) -> None:
    """A sensor delay cannot be negative: a sensor that leads saves nothing."""
    data = prepare([recorded(axis)], axis)
    early = dataclasses.replace(data.runs[0], outputs=np.roll(data.runs[0].outputs, -2, axis=0))
    late = dataclasses.replace(data.runs[0], outputs=np.roll(data.runs[0].outputs, 2, axis=0))
    gains = []
    for run in (early, late):
        shifted = dataclasses.replace(data, runs=(run,))
        fitted = fit(axis, default_free_parameters(axis)[:1], shifted, SIMULATION)
        gains.append(screen(fitted, [candidate("sensor_delay", "x_m", d=1e-3)], shifted)[0].gain)
    assert gains[0] == 0.0
    assert gains[1] > 0.5 * data.count


def test_a_parameter_at_its_limit_takes_nothing_from_an_effect(axis: Machine) -> None:
    """Without back-EMF, the declared damping falls to its limits. Below, it would act like the bridge."""
    axis = axis.replace({"x.viscous": 0.1})
    data = prepare([recorded(axis.with_effects(EFFECTS["coasting_bridge"].at("motor", U=100.0)))], axis)
    fitted = fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH)
    assert {f.name for f, t in zip(fitted.free, fitted.theta, strict=True) if f.at_limit(t)} == {
        "x.viscous", "motor.Ke"
    }  # fmt: skip
    bridge = candidate("coasting_bridge", "motor", U=3.0)
    best = screen(fitted, [*CANDIDATES, bridge], data)[0]
    assert best.candidate is bridge
    machine = fitted.machine.with_effects(bridge.applied(best.amounts))
    with_effect = fit(machine, default_free_parameters(machine), data, SEARCH_BANDWIDTH)
    assert best.gain == pytest.approx(fitted.cost - with_effect.cost, rel=0.3)


def test_another_effect_in_place_of_one_saves_what_a_fit_would(axis: Machine) -> None:
    """A cable explains part of what the constant force does; a force that falls with speed explains less."""
    wrong = EFFECTS["constant_force"].at("x", size=0.1)
    data = prepare([recorded(axis.with_effects(EFFECTS["cable_spring"].at("x", k=20.0, q0=0.0)))], axis)
    machine = axis.with_effects(wrong)
    free = default_free_parameters(machine)
    fitted = fit(machine, free, data, SEARCH_BANDWIDTH)
    bare = fitted.machine.replace(effects=())
    others = CANDIDATES[1:]
    ranked, gain = Screening.of(fitted, others, data, without={wrong.label: bare}).in_place_of(wrong.label)
    without = fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH)
    assert gain == pytest.approx(without.cost - fitted.cost, rel=0.1, abs=0.02 * without.cost)
    assert ranked[0].candidate.label == "cable_spring@x"
    cable = axis.with_effects(ranked[0].candidate.applied(ranked[0].amounts))
    found = fit(cable, default_free_parameters(cable), data, SEARCH_BANDWIDTH)
    assert ranked[0].gain == pytest.approx(without.cost - found.cost, rel=0.1)


def test_a_machine_that_diverges_without_an_effect_keeps_it(axis: Machine) -> None:
    fitted, data = fit_without_effect(axis, 0.3)
    diverging = axis.with_effects(EFFECTS["cable_spring"].at("x", k=-1e6, q0=0.01))
    screening = Screening.of(fitted, CANDIDATES, data, without={"constant_force@x": diverging})
    assert screening.in_place_of("constant_force@x") == ([], np.inf)
    assert screening.ranked()[0].candidate.label == "constant_force@x"


def test_no_candidates_give_no_scores(axis: Machine) -> None:
    fitted, data = fit_without_effect(axis, 0.0)
    assert screen(fitted, [], data) == []
