"""Tests of the removal of effects that the held-out runs do not confirm."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import (
    Dataset,
    Fit,
    SelectedEffect,
    SelectionCriteria,
    default_free_parameters,
    fit,
    prepare,
)
from hframe_gym.identification.evidence.held_out import (
    contradicting_held_out_runs,
    held_out_gain,
    worsens_simulation,
)
from hframe_gym.identification.judge.effect import BY_CHANCE, BY_VOLTAGES
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH, SIMULATION
from hframe_gym.identification.propose.trial_fits import without_effect
from hframe_gym.identification.search import checked_search
from hframe_gym.identification.search.checked_search import (
    CheckedOutcome,
    _contradicting_runs,
    exchanged_if_better,
    without_unconfirmed,
)
from hframe_gym.identification.search.outcome import SearchOutcome
from hframe_gym.identification.validate.evaluation import with_certain_effects
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording

NOISE = 20e-6  # m
CRITERIA = SelectionCriteria()


def recorded(machine: Machine, seed: int, noise: float = NOISE) -> Recording:
    """Return a recording of a moving axis with noise of a standard deviation, m."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(1000) * 1e-3
    inputs = np.where(time_s > 0.1, 1.5 * np.sin((8 + seed) * time_s) + 0.7 * np.sin(31 * time_s), 0.0)[
        :, None
    ]
    errors = rng.normal(0.0, noise, (len(time_s), 1))
    return Recording(f"run_{seed}", time_s, inputs, machine.simulate(time_s, inputs).outputs + errors)


def outcome_with_force(
    axis: Machine, data: Dataset, size: float, before_explains: bool
) -> tuple[Fit, SearchOutcome]:
    """Return the fit of the axis, and an outcome that selected a constant force, N."""
    before = fit(axis, default_free_parameters(axis), data, SIMULATION)
    machine = axis.with_effects(EFFECTS["constant_force"].at("x", size=size))
    after = fit(machine, default_free_parameters(machine), data, SIMULATION, iterations=1)
    selected = SelectedEffect(machine.effects[0], 1.0, axis).with_values(after.machine)
    return before, SearchOutcome(before, before_explains, True, "effect_found", after, (selected,), (), data)


@pytest.mark.parametrize(("before_explains", "verdict"), [(True, "no_effect"), (False, "unexplained")])
def test_an_effect_that_held_out_runs_deny_is_removed(
    axis: Machine, before_explains: bool, verdict: str
) -> None:
    """Without the last effect the verdict says whether the refitted machine explains the data."""
    pushed = axis.with_effects(EFFECTS["constant_force"].at("x", size=0.3))
    data, held_out = prepare([recorded(pushed, 0)], axis), prepare([recorded(axis, 1)], axis)
    before, outcome = outcome_with_force(axis, data, 0.3, before_explains)
    removed = without_unconfirmed(outcome, held_out, CRITERIA, lambda line: None)
    assert removed.verdict == verdict
    assert removed.selected == ()
    assert removed.after is before
    assert [entry.effect.label for entry in removed.considered] == ["constant_force@x"]
    assert removed.considered[0].reason == "does not reduce the error of the held-out runs"


@pytest.mark.parametrize(("hidden", "kept"), [(0.0, False), (0.01, True)])
def test_an_effect_whose_size_is_not_certain_in_the_end_is_removed(
    axis: Machine, hidden: float, kept: bool
) -> None:
    """A last fit may give a value that no test of the search has seen."""
    pushed = axis.with_effects(EFFECTS["constant_force"].at("x", size=hidden))
    data = prepare([recorded(pushed, 0)], axis)
    before, outcome = outcome_with_force(axis, data, 0.01, True)
    certain = with_certain_effects(outcome, CRITERIA, lambda line: None)
    assert bool(certain.selected) == kept
    if kept:
        assert certain is outcome
    else:
        assert certain.after is before
        assert certain.verdict == "no_effect"
        assert certain.considered[0].reason.startswith("is not certain to exist: the final fit gives size = ")


@pytest.mark.parametrize(("lag", "delay", "kept"), [(2e-4, 1e-3, True), (0.0, 0.0, False)])
def test_inputs_that_act_later_are_no_doubt_about_a_lag(
    axis: Machine, lag: float, delay: float, kept: bool
) -> None:
    """The residual of a lag in place of a delay indicates a delay: no doubt that something is late."""
    timing = EFFECTS["electrical_lag"].at("motor", tau=lag), EFFECTS["input_delay"].at("drives", d=delay)
    late = axis.with_effects(*(timing if lag else ()))
    data = prepare([recorded(late, seed, noise=2e-8) for seed in (0, 2)], axis)
    before = fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH)
    machine = axis.with_effects(EFFECTS["electrical_lag"].at("motor", tau=2e-4))
    after = fit(machine, default_free_parameters(machine), data, SEARCH_BANDWIDTH)
    selected = SelectedEffect(machine.effects[0], 1.0, axis).with_values(after.machine)
    outcome = SearchOutcome(before, False, True, "effect_found", after, (selected,), (), data)
    certain = with_certain_effects(outcome, CRITERIA, lambda line: None)
    assert bool(certain.selected) == kept


def test_an_effect_that_held_out_runs_confirm_stays(axis: Machine) -> None:
    pushed = axis.with_effects(EFFECTS["constant_force"].at("x", size=0.3))
    data, held_out = prepare([recorded(pushed, 0)], axis), prepare([recorded(pushed, 1)], axis)
    _, outcome = outcome_with_force(axis, data, 0.3, False)
    assert without_unconfirmed(outcome, held_out, CRITERIA, lambda line: None) == outcome


@pytest.mark.parametrize(("hidden", "contradicting"), [(0.0, ()), (0.9, ("run_1",))])
def test_a_held_out_run_whose_error_an_effect_causes_does_not_contradict(
    axis: Machine, hidden: float, contradicting: tuple[str, ...]
) -> None:
    """A constant force of the fitted run only spoils the other; a larger one there is not its fault."""
    force = EFFECTS["constant_force"]
    pushed, other = (axis.with_effects(force.at("x", size=size)) for size in (0.3, hidden))
    data, held_out = prepare([recorded(pushed, 0)], axis), prepare([recorded(other, 1)], axis)
    _, outcome = outcome_with_force(axis, data, 0.3, False)
    assert contradicting_held_out_runs(outcome.after, outcome.before.machine, (), held_out) == ("run_1",)
    assert _contradicting_runs(outcome, held_out) == contradicting


@pytest.mark.parametrize(("wind", "judges"), [(0.1, True), (3.0, False)])
def test_a_contradicting_run_of_which_effects_explain_most_may_remove_effects(
    axis: Machine, wind: float, judges: bool
) -> None:
    """It has the spring that was found, and a force that the model lacks in place of the constant one."""
    spring, push = EFFECTS["cable_spring"].at("x", k=30.0, q0=0.0), EFFECTS["constant_force"]
    found = spring, push.at("x", size=0.02)
    data = prepare([recorded(axis.with_effects(*found), seed) for seed in (0, 2)], axis)
    held_out = prepare([recorded(axis.with_effects(spring, push.at("x", size=-wind)), 1)], axis)
    before = fit(axis, default_free_parameters(axis), data, SIMULATION)
    machine = axis.with_effects(*found)
    after = fit(machine, default_free_parameters(machine), data, SIMULATION, iterations=1)
    selected = tuple(SelectedEffect(e, 1.0, axis).with_values(after.machine) for e in after.machine.effects)
    outcome = SearchOutcome(before, False, True, "effect_found", after, selected, (), data)
    checked = CheckedOutcome(outcome, held_out, _contradicting_runs(outcome, held_out))
    assert checked.differing == ("run_1",)
    assert checked.agreeing.runs == ()
    assert [run.name for run in checked.judging.runs] == (["run_1"] if judges else [])
    kept = without_unconfirmed(outcome, checked.judging, CRITERIA, lambda line: None).selected
    assert [s.effect.name for s in kept] == [e.name for e in (found[:1] if judges else found)]


@pytest.mark.parametrize(
    ("doubt", "kept"), [(BY_VOLTAGES, False), (BY_CHANCE, False), ("has a force of 0.5 N", True), ("", True)]
)
def test_after_a_removal_chance_or_unknown_voltages_may_explain_another_effect(
    axis: Machine, monkeypatch: pytest.MonkeyPatch, doubt: str, kept: bool
) -> None:
    """Only the effect that is gone had told it from them; a larger error alone says nothing about it."""
    monkeypatch.setattr(checked_search, "doubt_beside_others", lambda *evidence: doubt)
    push, spring = (
        EFFECTS["constant_force"].at("x", size=0.3),
        EFFECTS["cable_spring"].at("x", k=30.0, q0=0.0),
    )
    found = axis.with_effects(push, spring)
    data = prepare([recorded(found, seed) for seed in (0, 2)], axis)
    held_out = prepare([recorded(axis.with_effects(spring), 1)], axis)
    before = fit(axis, default_free_parameters(axis), data, SIMULATION)
    after = fit(found, default_free_parameters(found), data, SIMULATION, iterations=1)
    selected = tuple(SelectedEffect(e, 1.0, axis).with_values(after.machine) for e in found.effects)
    outcome = SearchOutcome(before, False, True, "effect_found", after, selected, (), data)
    removed = without_unconfirmed(outcome, held_out, CRITERIA, lambda line: None)
    assert [s.effect.name for s in removed.selected] == (["cable_spring"] if kept else [])
    assert [c.reason for c in removed.considered][1:] == ([] if kept else [doubt])


def outcome_with_spurious_friction(axis: Machine) -> tuple[SearchOutcome, Dataset]:
    """Return an outcome with Tustin friction beside too low a Coulomb friction, and held-out runs.

    The refitted machine has neither error.
    """
    data, held_out = prepare([recorded(axis, 0)], axis), prepare([recorded(axis, 1)], axis)
    before = fit(axis, default_free_parameters(axis), data, SIMULATION)
    friction = EFFECTS["tustin_friction"].at("x", dF=0.25, vs=10.0)
    after = dataclasses.replace(before, machine=axis.replace({"x.coulomb": 0.7}).with_effects(friction))
    selected = (SelectedEffect(friction, 1.0, axis),)
    return SearchOutcome(before, False, True, "effect_found", after, selected, (), data), held_out


def test_effects_that_worsen_the_simulation_of_held_out_runs_are_removed(axis: Machine) -> None:
    """The effect reduces the error of Coulomb friction fitted too low; the refitted machine needs none."""
    outcome, held_out = outcome_with_spurious_friction(axis)
    before, after = outcome.before.machine, outcome.after.machine
    assert held_out_gain(outcome.selected[0], after, held_out, SIMULATION) > 0.5
    assert worsens_simulation(before, after, held_out)
    assert not worsens_simulation(after, before, held_out)
    removed = without_unconfirmed(outcome, held_out, CRITERIA, lambda line: None)
    assert (removed.verdict, removed.selected) == ("unexplained", ())
    reason = (
        "reduces the error of the held-out runs, but they are simulated worse with it than without effects"
    )
    assert removed.considered[0].reason == reason


def test_a_run_that_the_effects_together_spoil_does_not_contradict(axis: Machine) -> None:
    """The effect reduces the error of the machine fitted with it; the one refitted without it has none."""
    outcome, held_out = outcome_with_spurious_friction(axis)
    assert contradicting_held_out_runs(outcome.after, outcome.before.machine, (), held_out) == ("run_1",)
    assert _contradicting_runs(outcome, held_out) == ()


def test_of_two_refuted_effects_the_one_that_requires_the_other_is_removed_first(axis: Machine) -> None:
    """An overtone of cogging is not identified without cogging; the held-out run shows neither."""
    cogging, overtone = (
        EFFECTS[name].at("motor", A=0.1, n=rate, p=0.3)
        for name, rate in (("cogging", 4.0), ("second_cogging", 8.0))
    )
    cogged = axis.with_effects(cogging, overtone)
    data, held_out = prepare([recorded(cogged, 0)], axis), prepare([recorded(axis, 1)], axis)
    before = fit(axis, default_free_parameters(axis), data, SIMULATION)
    after = fit(cogged, default_free_parameters(cogged), data, SIMULATION, iterations=1)
    assert without_effect(after, cogging.label, data, before.machine) is None
    selected = tuple(SelectedEffect(e, 1.0, axis).with_values(after.machine) for e in cogged.effects)
    outcome = SearchOutcome(before, True, True, "effect_found", after, selected, (), data)
    lines: list[str] = []
    removed = without_unconfirmed(outcome, held_out, CRITERIA, lines.append)
    assert removed.selected == ()
    assert [line.split()[0] for line in lines] == [overtone.label, cogging.label]


@pytest.mark.parametrize(("present", "named"), [(True, True), (False, False)])
def test_the_run_that_is_held_out_in_exchange_confirms_an_effect(
    axis: Machine, present: bool, named: bool
) -> None:
    """All other runs are fitted then; without the force in this run, another run must confirm it."""
    pushed = axis.with_effects(EFFECTS["constant_force"].at("x", size=0.3))
    data = prepare([recorded(pushed, 0), recorded(pushed, 2)], axis)
    run = prepare([recorded(pushed if present else axis, 1)], axis)
    before, outcome = outcome_with_force(axis, data, 0.3, True)
    first = SearchOutcome(before, True, True, "no_effect", before, (), (), data)
    held_out: list[str] = []

    def search_without(names: Sequence[str]) -> CheckedOutcome:
        held_out.extend(names)
        return CheckedOutcome(outcome, run, ())

    found = exchanged_if_better(CheckedOutcome(first, run, ("run_1",)), search_without, lambda line: None)
    assert held_out == ["run_0"]
    assert [s.effect.label for s in found.outcome.selected] == (["constant_force@x"] if named else [])
    assert bool(found.hint) != named
