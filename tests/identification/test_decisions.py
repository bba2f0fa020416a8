"""The decisions of identification by themselves: each threshold from both sides, each verdict, with scripted fits.

Nothing is simulated. Fits have the costs that a test gives them, so that a test states what is decided and why.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.identification import (
    Fit,
    SelectedEffect,
    SelectionCriteria,
    effect_size,
    forward_selection,
    held_out,
    hold_out,
    model_error,
    rivals,
    search,
)
from hframe_gym.identification.effect_size import depend_on_same_variable, force_size
from hframe_gym.identification.forward_selection import EffectSearch
from hframe_gym.identification.free_parameters import FreeParameter
from hframe_gym.identification.model_error import minimum_gain
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect, Machine

pytestmark = pytest.mark.unit

COUNT = 10_000  # measured values
CRITERIA = SelectionCriteria()
AXIS, HFRAME = BUILTIN_MACHINES["axis"](), BUILTIN_MACHINES["hframe"]()
PUSH = EFFECTS["constant_force"].at("x", size=0.3)
DRAG = EFFECTS["quadratic_drag"].at("x", c=4.0)
SPRING = EFFECTS["cable_spring"].at("x", k=6.0, q0=0.05)
STRIBECK = EFFECTS["stribeck_friction"].at("x", dF=3.0, vs=0.04)
COGGING = EFFECTS["cogging"].at("motor1", A=0.03, n=23.6, p=0.5)
FRAME = EFFECTS["frame_resonance"].at("x", f0=19.0, zeta=0.05, r=0.05, s=0.8)
DATA: Any = SimpleNamespace(count=COUNT)
QUIET: Callable[[str], None] = lambda line: None  # noqa: E731


def fit_with(*effects: AppliedEffect, chi2: float, free: int = 4, bandwidth: float = 0.0) -> Fit:
    """Return a fit of the axis with effects, and a chi-squared per sample."""
    parameters = tuple(FreeParameter(f"p{i}", 1.0, 1.0) for i in range(free))
    machine = dataclasses.replace(AXIS, effects=effects)
    return Fit(machine, parameters, np.zeros(free), chi2 * COUNT, COUNT, bandwidth, np.eye(free))


def selected(effect: AppliedEffect, gain: float = 1.0) -> SelectedEffect:
    """Return a selected effect."""
    return SelectedEffect(effect, (), gain, AXIS)


class Scripted:
    """Replaces what `EffectSearch` computes: forces, residues, gains and variances by label, neutral by default."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.force: dict[str, float] = {}
        self.residue: dict[float, float] = {}  # by chi-squared of the fit
        self.confirmed, self.variance, self.fault, self.difference = 1.0, 1.0, "", 1.0
        self.trials: list[list[Fit]] = []
        self.structures: list[list[Fit]] = []
        self.without: dict[str, Fit | None] = {}
        self.replacement: Fit | None = None
        self.lines: list[str] = []
        replaced: Mapping[str, Callable[..., Any]] = {
            "effect_force": lambda machine, effect, data: self.force.get(effect.label, 1.0),
            "residue_force": lambda fitted, data: self.residue.get(fitted.chi2, 0.1),
            "leave_one_out_gain": lambda a, b, data: self.confirmed * (a.cost - b.cost),
            "long_run_variance": lambda fitted, label, data: self.variance,
            "validation_fault": lambda machine: self.fault,
            "force_difference": lambda a, b, data: self.difference,
            "fit_with_model_error": lambda fitted, data: fitted,
            "converge": lambda fitted, data, thorough: fitted,
            "trial_fits": lambda current, data, enough, criteria: self.trials.pop(0) if self.trials else [],
            "structural_trial_fits": lambda *arguments: self.structures.pop(0) if self.structures else [],
            "unexplained_fraction": lambda current, trials, criteria: 1.0,
            "without_effect": lambda current, label, *rest, **more: self.without.get(label),
            "replacement_fit": lambda *arguments: self.replacement,
        }
        for name, function in replaced.items():
            monkeypatch.setattr(forward_selection, name, function)

    def search(self, **criteria: float) -> EffectSearch:
        """Return a search with changed criteria."""
        changed = dataclasses.replace(CRITERIA, **criteria)  # type: ignore[arg-type]
        return EffectSearch(DATA, AXIS, changed, self.lines.append)


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> Scripted:
    """Return a script of everything that a search computes."""
    return Scripted(monkeypatch)


# -- gains, margins and rivals -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("chi2", "bandwidth", "count", "expected"),
    [
        (1.02, 60.0, 10**6, CRITERIA.min_gain_one_step),
        (1.02, 30.0, 10**6, CRITERIA.min_gain_simulation),
        (1.02, 0.0, 10**6, CRITERIA.min_gain_simulation),
        (1.02, 0.0, 10**4, CRITERIA.min_total_gain / 10**4),
        (3.0, 0.0, 10**6, 2.0 * CRITERIA.min_gain_fraction),
    ],
)
def test_the_smallest_gain_follows_from_prediction_length_and_error(
    chi2: float, bandwidth: float, count: int, expected: float
) -> None:
    fitted = dataclasses.replace(fit_with(chi2=1.0, bandwidth=bandwidth), count=count, cost=chi2 * count)
    assert minimum_gain(fitted, CRITERIA) == pytest.approx(expected)


def test_of_trials_as_good_as_the_best_the_simplest_comes_first() -> None:
    current = fit_with(chi2=2.0)
    best, simple, poor = (
        fit_with(effect, chi2=chi2, free=free)
        for effect, chi2, free in ((PUSH, 1.0, 5), (DRAG, 1.029, 3), (SPRING, 1.031, 1))
    )
    order = rivals.simplest_first([poor, best, simple], current, DATA, CRITERIA)
    assert order == [simple, best, poor]
    assert rivals.simplest_first([], current, DATA, CRITERIA) == []
    # 3 % of the gain is the margin; of a small gain it is 0.002 per sample.
    assert rivals._margin(current, 1.0 * COUNT, DATA, CRITERIA) == pytest.approx(0.03 * COUNT)
    assert rivals._margin(current, 1.99 * COUNT, DATA, CRITERIA) == pytest.approx(0.002 * COUNT)


def test_rivals_are_other_effects_within_the_margin() -> None:
    current, best = fit_with(chi2=2.0), fit_with(PUSH, chi2=1.0)
    close, same, far = fit_with(DRAG, chi2=1.029), fit_with(PUSH, chi2=1.001), fit_with(SPRING, chi2=1.031)
    assert rivals.close_rivals([best, same, close, close, far], current, DATA, CRITERIA) == (DRAG,)


# -- doubts ------------------------------------------------------------------------------------------------------------


def doubt(scripted: Scripted, without: float = 1.4, with_effect: float = 1.2, *effects: AppliedEffect) -> str:
    """Return the doubt about the last effect of a trial."""
    present = effects or (PUSH,)
    return scripted.search()._doubt(fit_with(*present[:-1], chi2=without), fit_with(*present, chi2=with_effect))


@pytest.mark.parametrize(("loss", "found"), [(1.5, True), (1.99, False)])
def test_a_rival_that_is_more_likely_replaces_an_effect(
    monkeypatch: pytest.MonkeyPatch, loss: float, found: bool
) -> None:
    """Chance may explain a difference of 30 long-run variances, here 0.015 per value."""
    current, other = fit_with(PUSH, chi2=2.0), fit_with(DRAG, chi2=loss)
    losses = {id(current): 2.0, id(other): loss}
    replaced: Mapping[str, Callable[..., Any]] = {
        "information_loss": lambda fitted, data: losses[id(fitted)],
        "fit_in_place_of": lambda current, label, rival, data: other,
        "polish": lambda fitted, data: fitted,
        "at_bandwidth": lambda fitted, bandwidth, data: fitted,
        "long_run_variance": lambda fitted, label, data: 0.015 * COUNT / CRITERIA.min_chance_gain,
    }
    for name, function in replaced.items():
        monkeypatch.setattr(rivals, name, function)
    assert rivals.more_likely_rival(current, PUSH.label, (DRAG,), DATA, CRITERIA) is (other if found else None)
    assert rivals.more_likely_rival(current, PUSH.label, (PUSH,), DATA, CRITERIA) is None  # the machine has it


def test_an_effect_without_doubt(scripted: Scripted) -> None:
    assert doubt(scripted) == ""


@pytest.mark.parametrize(("fraction", "sure"), [(0.31, True), (0.29, False)])
def test_other_runs_must_confirm_an_effect(scripted: Scripted, fraction: float, sure: bool) -> None:
    scripted.confirmed = fraction
    text = doubt(scripted)
    assert text == ("" if sure else "is not confirmed by runs that it was not fitted to (29 % of the gain)")
    # While much is unexplained, a fit without one run says little.
    assert doubt(scripted, 1.6, 1.2) == ""


@pytest.mark.parametrize(("variance", "sure"), [(65.0, True), (68.0, False)])
def test_chance_may_explain_a_small_gain(scripted: Scripted, variance: float, sure: bool) -> None:
    scripted.variance = variance  # the gain is 2000, the smallest one 30 times the variance
    assert ("chance" not in doubt(scripted)) == sure


@pytest.mark.parametrize(("force", "sure"), [(1.01, True), (0.99, False)])
def test_the_force_of_an_effect_must_exceed_the_unexplained_one(scripted: Scripted, force: float, sure: bool) -> None:
    scripted.force, scripted.residue = {PUSH.label: 0.2 * force}, {1.2: 0.2}
    text = doubt(scripted)
    assert text == ("" if sure else "has a force of 2e+02 mN, where 2e+02 mN remain unexplained")


@pytest.mark.parametrize(("before", "sure"), [(0.15, True), (0.13, False), (0.05, False)])
def test_a_structural_effect_must_halve_the_unexplained_power(scripted: Scripted, before: float, sure: bool) -> None:
    """Its size is what it takes from the unexplained force: the root of the difference of the squares."""
    scripted.residue = {1.4: before, 1.2: 0.1}
    assert ("remain unexplained" not in doubt(scripted, 1.4, 1.2, FRAME)) == sure


@pytest.mark.parametrize(("difference", "sure"), [(0.21, True), (0.19, False)])
def test_a_small_addition_to_the_same_variable_is_an_error_of_form(
    scripted: Scripted, difference: float, sure: bool
) -> None:
    scripted.difference = difference
    text = doubt(scripted, 1.4, 1.2, STRIBECK, DRAG)
    assert ("the form of that effect may be in error" not in text) == sure
    assert sure or "adds 19 % to the force of stribeck_friction@x" in text
    assert doubt(scripted, 1.4, 1.2, SPRING, DRAG) == ""  # position and speed


def test_a_faulty_machine_is_doubted(scripted: Scripted) -> None:
    scripted.fault = "makes the machine unstable"
    assert doubt(scripted) == scripted.fault


# -- selection ---------------------------------------------------------------------------------------------------------


def test_effects_are_added_until_only_noise_is_left(scripted: Scripted) -> None:
    scripted.trials = [
        [fit_with(PUSH, chi2=2.0), fit_with(DRAG, chi2=2.05)],
        [fit_with(PUSH, SPRING, chi2=1.005)],
        [fit_with(PUSH, SPRING, STRIBECK, chi2=0.5)],
    ]
    fitted, effects = scripted.search().run(fit_with(chi2=10.0))
    assert [s.effect for s in effects] == [PUSH, SPRING]
    assert [s.gain for s in effects] == pytest.approx([8.0, 0.995])
    assert effects[0].rivals[0] == DRAG.label
    assert effects[0].rival_effects == (DRAG,)
    assert effects[0].machine_without.effects == ()
    assert effects[1].machine_without.effects == (PUSH,)
    assert fitted.chi2 == pytest.approx(1.005)
    assert len(scripted.trials) == 1  # chi-squared 1.005 is below the level of noise: the search stopped


def test_no_more_effects_than_allowed(scripted: Scripted) -> None:
    scripted.trials = [[fit_with(PUSH, chi2=5.0)], [fit_with(PUSH, DRAG, chi2=3.0)]]
    _, effects = scripted.search(max_effects=1).run(fit_with(chi2=10.0))
    assert [s.effect for s in effects] == [PUSH]


def test_a_doubtful_best_candidate_gives_way_and_is_remembered(scripted: Scripted) -> None:
    scripted.force = {PUSH.label: 0.01}
    scripted.trials = [[fit_with(PUSH, chi2=2.0), fit_with(DRAG, chi2=3.0)]]
    search_ = scripted.search()
    _, effects = search_.run(fit_with(chi2=10.0))
    assert [s.effect for s in effects] == [DRAG]
    considered = search_.considered[PUSH.label]
    assert considered.reason.startswith("has a force of 10 mN")
    assert considered.machine_without.effects == ()
    assert search_.with_data(DATA).considered == search_.considered
    # If it is selected later after all, it is no longer among those that failed.
    scripted.force = {}
    scripted.trials = [[fit_with(DRAG, PUSH, chi2=1.0)]]
    _, effects = search_.run(fit_with(DRAG, chi2=3.0), effects)
    assert [s.effect for s in effects] == [DRAG, PUSH]
    assert search_.considered == {}


@pytest.mark.parametrize(("chi2", "found"), [(1.99, True), (2.02, False)])
def test_a_gain_below_the_smallest_one_is_not_selected(scripted: Scripted, chi2: float, found: bool) -> None:
    """A tenth of the excess of 10 over 1 is 0.9; here from 2.9."""
    scripted.trials = [[fit_with(PUSH, chi2=chi2)]]
    _, effects = scripted.search(min_gain_fraction=0.473684).run(fit_with(chi2=2.9))  # 0.9 of an excess of 1.9
    assert bool(effects) == found


@pytest.mark.parametrize(("chi2", "tried"), [(2.4, 2), (2.5, 0)])
def test_candidates_far_below_the_smallest_gain_are_not_even_converged(
    scripted: Scripted, chi2: float, tried: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of the smallest gain, 0.45, must be reached by the first iterations of a fit."""
    scripted.trials = [[fit_with(PUSH, chi2=chi2), fit_with(DRAG, chi2=chi2)]]
    converged = []
    monkeypatch.setattr(forward_selection, "converge", lambda f, data, thorough: converged.append(thorough) or f)
    scripted.search(min_gain_fraction=0.473684).run(fit_with(chi2=2.9))
    assert converged == [True] * tried


def test_structural_effects_are_tried_where_the_others_leave_enough(scripted: Scripted) -> None:
    scripted.structures = [[fit_with(FRAME, chi2=1.005)]]
    scripted.residue = {1.2: 1.0}  # it takes nearly all of the unexplained force
    _, effects = scripted.search().run(fit_with(chi2=1.2))
    assert [s.effect for s in effects] == [FRAME]


@pytest.mark.parametrize(
    ("chi2", "bandwidth", "left", "worth"),
    [
        (1.06, 0.0, 0.51, True),
        (1.06, 0.0, 0.49, False),
        (1.04, 0.0, 0.51, False),
        (1.14, 60.0, 0.51, False),
        (1.16, 60.0, 0.51, True),
        (1.06, 30.0, 0.51, True),
    ],
)
def test_when_structural_effects_are_worth_a_trial(
    scripted: Scripted, monkeypatch: pytest.MonkeyPatch, chi2: float, bandwidth: float, left: float, worth: bool
) -> None:
    """They must be compiled. In one-step prediction a correct model reaches 1.1, not 1."""
    monkeypatch.setattr(forward_selection, "unexplained_fraction", lambda *arguments: left)
    assert scripted.search()._worth_structures(fit_with(chi2=chi2, bandwidth=bandwidth), []) == worth


@pytest.mark.parametrize(("chi2", "retried"), [(5.0, True), (7.1, False)])
def test_structural_effects_are_tried_again_once_the_error_is_clearly_smaller(
    scripted: Scripted, chi2: float, retried: bool
) -> None:
    """From an excess of 9, two thirds are 6.03."""
    scripted.trials = [[fit_with(PUSH, chi2=chi2)]]
    scripted.structures = [[], [fit_with(PUSH, FRAME, chi2=1.0)]]
    scripted.residue = {chi2: 1.0}
    _, effects = scripted.search().run(fit_with(chi2=10.0))
    assert [s.effect for s in effects] == ([PUSH, FRAME] if retried else [PUSH])


@pytest.mark.parametrize(
    ("chi2", "doubtful", "replaced"), [(1.5, False, True), (1.95, False, False), (1.5, True, False)]
)
def test_a_better_effect_replaces_an_earlier_one(
    scripted: Scripted, chi2: float, doubtful: bool, replaced: bool
) -> None:
    scripted.without = {PUSH.label: fit_with(SPRING, chi2=6.0)}
    scripted.replacement = fit_with(SPRING, STRIBECK, chi2=chi2)
    scripted.fault = "is unstable" if doubtful else ""
    current, chosen = fit_with(PUSH, SPRING, chi2=2.0), (selected(PUSH), selected(SPRING))
    fitted, effects = scripted.search()._exchange(current, chosen)
    if not replaced:
        assert (fitted, effects) == (current, chosen)
        return
    assert [s.effect for s in effects] == [SPRING, STRIBECK]
    assert effects[1].gain == pytest.approx(6.0 - chi2)
    assert fitted is scripted.replacement


def test_nothing_is_exchanged_where_only_noise_is_left(scripted: Scripted) -> None:
    scripted.without = {PUSH.label: fit_with(SPRING, chi2=6.0)}
    scripted.replacement = fit_with(SPRING, STRIBECK, chi2=0.5)
    current = fit_with(PUSH, SPRING, chi2=1.005)
    assert scripted.search()._exchange(current, (selected(PUSH), selected(SPRING)))[0] is current


def test_the_weakest_superfluous_effect_is_removed_first(scripted: Scripted) -> None:
    """Without drag the error is the same; the push is then examined again and stays."""
    scripted.without = {PUSH.label: fit_with(DRAG, chi2=2.0), DRAG.label: fit_with(PUSH, chi2=2.0)}
    search_ = scripted.search()
    chosen = (selected(PUSH, 3.0), selected(DRAG, 0.5))
    scripted.without = {DRAG.label: fit_with(PUSH, chi2=2.01), PUSH.label: fit_with(chi2=6.0)}
    fitted, effects = search_.prune(fit_with(PUSH, DRAG, chi2=2.0), chosen)
    assert [s.effect for s in effects] == [PUSH]
    assert fitted.chi2 == pytest.approx(2.01)
    assert list(search_.considered) == [DRAG.label]
    assert search_.considered[DRAG.label].reason == "has no effect on the error"


def test_an_effect_on_which_another_rests_is_kept(scripted: Scripted) -> None:
    scripted.without = {FRAME.label: None}
    fitted, effects = scripted.search().prune(fit_with(FRAME, chi2=2.0), (selected(FRAME),))
    assert [s.effect for s in effects] == [FRAME]
    assert fitted.chi2 == 2.0


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({}, ""),
        ({"confirmed": 0.1}, "is not confirmed"),
        ({"fault": "is unstable"}, "is unstable"),
        ({"variance": 1e6}, "chance"),
        ({"residue": {2.0: 5.0}}, "remain unexplained"),
    ],
)
def test_each_test_is_repeated_beside_all_effects(scripted: Scripted, change: Mapping[str, Any], reason: str) -> None:
    for name, value in change.items():
        setattr(scripted, name, value)
    text = scripted.search()._doubt_beside_others(fit_with(chi2=6.0), fit_with(PUSH, chi2=2.0), PUSH)
    assert (reason in text) if reason else text == ""


# -- verdict -----------------------------------------------------------------------------------------------------------


class ScriptedSearch:
    """Replaces what `search_effects` calls: fits have the chi-squared that `chi2_of` gives by the effects' labels."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.before, self.after = 10.0, 10.0
        self.effects: tuple[SelectedEffect, ...] = ()
        self.tables: list[tuple[Fit, tuple[SelectedEffect, ...]]] = []
        self.pruned: tuple[SelectedEffect, ...] | None = None
        self.wide = 10.0  # chi-squared at the bandwidth of the search
        self.suspect: str | None = None
        script = self

        class FakeEffectSearch:
            def __init__(self, data: Any, plain: Machine, criteria: SelectionCriteria, log: Any) -> None:
                self.considered: dict[str, Any] = {}

            def run(self, current: Fit, chosen: tuple[SelectedEffect, ...] = ()) -> Any:
                found = script.effects or chosen
                return fit_with(*(s.effect for s in found), chi2=script.after), found

            def settle_rivals(self, current: Fit, chosen: tuple[SelectedEffect, ...]) -> Any:
                return current, chosen

            def prune(self, current: Fit, chosen: tuple[SelectedEffect, ...]) -> Any:
                return current, chosen if script.pruned is None else script.pruned

        replaced: Mapping[str, Callable[..., Any]] = {
            "fit": lambda machine, free, data, bandwidth, theta=None: fit_with(*machine.effects, chi2=script.before),
            "default_free_parameters": lambda machine: (),
            "polish": lambda fitted, data: fitted,
            "converge": lambda fitted, data, thorough: fitted,
            "fit_with_model_error": lambda fitted, data: fitted,
            "refine_starts": lambda data, machine: data,
            # The simulation has no say: it is as bad with the effects as without.
            "prediction_cost": lambda machine, data, bandwidth: (
                COUNT * (script.wide if bandwidth and machine.effects else 10.0)
            ),
            "refined_in_simulation": lambda fitted, data: fitted,
            "add_tables": lambda start, known, data, criteria, max_tables, log: (
                script.tables.pop(0) if script.tables else (start, known)
            ),
            "contradicting_run": lambda fitted, data: script.suspect,
            "EffectSearch": FakeEffectSearch,
        }
        for name, function in replaced.items():
            monkeypatch.setattr(search, name, function)

    def run(self) -> search.SearchOutcome:
        """Search in four runs."""
        return search.search_effects(AXIS, runs("abcd"), CRITERIA, QUIET)


def runs(names: str) -> Any:
    """Return data with runs that have one letter each as a name."""
    return SimpleNamespace(
        runs=[SimpleNamespace(name=name, count=COUNT // 4) for name in names], count=COUNT, with_runs=runs
    )


@pytest.fixture
def scripted_search(monkeypatch: pytest.MonkeyPatch) -> ScriptedSearch:
    """Return a script of fits, effects and tables."""
    return ScriptedSearch(monkeypatch)


@pytest.mark.parametrize(("chi2", "verdict"), [(1.49, "effect_found"), (1.51, "unexplained")])
def test_effects_that_leave_only_noise_are_found(scripted_search: ScriptedSearch, chi2: float, verdict: str) -> None:
    scripted_search.effects, scripted_search.after = (selected(PUSH),), chi2
    outcome = scripted_search.run()
    assert outcome.verdict == verdict
    found = verdict == "effect_found"
    assert [s.effect for s in outcome.selected] == ([PUSH] if found else [])
    assert outcome.after.chi2 == (chi2 if found else 10.0)
    assert not outcome.before_explains
    assert outcome.contradiction is None


def test_without_effects_a_machine_that_explains_the_data_is_right(scripted_search: ScriptedSearch) -> None:
    scripted_search.before = scripted_search.after = 1.2
    outcome = scripted_search.run()
    assert (outcome.verdict, outcome.before_explains, outcome.after) == ("no_effect", True, outcome.before)


@pytest.mark.parametrize(("wide", "verdict"), [(3.3, "effect_found"), (3.4, "unexplained")])
def test_known_effects_are_reported_if_they_remove_three_quarters(
    scripted_search: ScriptedSearch, wide: float, verdict: str
) -> None:
    """Three quarters of the excess of chi-squared, 10, over the 1.1 that a correct model reaches."""
    scripted_search.effects, scripted_search.after, scripted_search.wide = (selected(PUSH),), 3.0, wide
    outcome = scripted_search.run()
    assert outcome.verdict == verdict
    # An effect that was found but is not reported is not forgotten.
    assert [c.effect for c in outcome.considered] == ([] if verdict == "effect_found" else [PUSH])


def test_nothing_is_found_where_nothing_was_selected(scripted_search: ScriptedSearch) -> None:
    scripted_search.after, scripted_search.wide = 3.0, 0.1
    outcome = scripted_search.run()
    assert (outcome.verdict, outcome.selected) == ("unexplained", ())


@pytest.mark.parametrize(
    ("chi2", "wide", "kept", "found"),
    [(1.4, 9.0, True, True), (1.6, 0.9, True, True), (1.6, 1.1, True, False), (1.4, 9.0, False, False)],
)
def test_a_table_is_found_if_it_explains_or_removes_nine_tenths(
    scripted_search: ScriptedSearch, chi2: float, wide: float, kept: bool, found: bool
) -> None:
    table = fit_with(SPRING, chi2=chi2), (selected(SPRING),)
    scripted_search.tables, scripted_search.wide = [table], wide
    scripted_search.pruned = None if kept else ()
    outcome = scripted_search.run()
    assert outcome.verdict == ("effect_found" if found else "unexplained")
    assert [s.effect for s in outcome.selected] == ([SPRING] if found else [])


def test_a_table_beside_an_effect_must_add_to_it(scripted_search: ScriptedSearch) -> None:
    """The first table explains nothing; the second search, beside the effect, finds none."""
    scripted_search.effects, scripted_search.after = (selected(PUSH),), 3.0
    scripted_search.tables = [(fit_with(chi2=10.0), ()), (fit_with(PUSH, chi2=1.0), (selected(PUSH),))]
    assert scripted_search.run().verdict == "unexplained"
    scripted_search.tables = [
        (fit_with(chi2=10.0), ()),
        (fit_with(PUSH, SPRING, chi2=1.0), (selected(PUSH), selected(SPRING))),
    ]
    outcome = scripted_search.run()
    assert (outcome.verdict, [s.effect for s in outcome.selected]) == ("effect_found", [PUSH, SPRING])


@pytest.mark.parametrize(("explained_by_more", "contradiction"), [(False, "c"), (True, None)])
def test_a_run_that_no_effect_reconciles_with_the_others_is_left_out(
    scripted_search: ScriptedSearch, monkeypatch: pytest.MonkeyPatch, explained_by_more: bool, contradiction: str | None
) -> None:
    scripted_search.suspect, scripted_search.before, scripted_search.after = "c", 1.2, 1.2
    limits: list[float] = []

    def explains(fitted: Fit, initial: float, criteria: SelectionCriteria) -> bool:
        limits.append(initial)
        return explained_by_more

    monkeypatch.setattr(search._Search, "_explains", lambda self, fitted: True)
    monkeypatch.setattr(search, "explains", explains)
    outcome = scripted_search.run()
    assert outcome.contradiction == contradiction
    assert limits == [1.2]
    assert "".join(run.name for run in outcome.data.runs) == ("abd" if contradiction else "abcd")


def test_a_suspect_run_is_used_if_the_others_are_not_explained_either(scripted_search: ScriptedSearch) -> None:
    scripted_search.suspect = "c"
    outcome = scripted_search.run()
    assert (outcome.contradiction, outcome.verdict, len(outcome.data.runs)) == (None, "unexplained", 4)


@pytest.mark.parametrize(
    ("chi2", "initial", "explained"), [(1.49, 1.0, True), (1.51, 1.0, False), (1.9, 2e4, True), (2.1, 2e4, False)]
)
def test_what_explains_the_data(chi2: float, initial: float, explained: bool) -> None:
    """Chi-squared below 1.5, or a ten-thousandth of a large initial value."""
    assert model_error.explains(fit_with(chi2=chi2), initial, CRITERIA) == explained


# -- model error -------------------------------------------------------------------------------------------------------


def test_a_narrow_observer_needs_short_steps() -> None:
    assert model_error.search_step(60.0) == model_error.SEARCH_STEP
    assert model_error.search_step(30.0) == model_error.search_step(0.0) == 0.25e-3


@pytest.mark.parametrize(
    ("losses", "expected"),
    [
        ({60: 5.0, 30: 4.0, 15: 3.0, 7: 3.5, 3: 1.0, 0: 9.0}, 15.0),  # it stops at the first increase
        ({60: 5.0, 30: 4.0, 15: 3.0, 7: 2.5, 3: 1.0, 0: 9.0}, 3.0),
        ({60: 5.0, 30: 6.0, 15: 3.0, 7: 2.5, 3: 1.0, 0: 4.0}, 0.0),  # the simulation is tried in any case
        ({60: 5.0, 30: 5.0, 15: 3.0, 7: 2.5, 3: 1.0, 0: 5.0}, 60.0),  # equal is not better
    ],
)
def test_the_bandwidth_has_the_largest_likelihood(
    monkeypatch: pytest.MonkeyPatch, losses: Mapping[int, float], expected: float
) -> None:
    monkeypatch.setattr(model_error, "information_loss", lambda fitted, data: losses[int(fitted.bandwidth)])
    monkeypatch.setattr(
        model_error, "at_bandwidth", lambda fitted, bandwidth, data: dataclasses.replace(fitted, bandwidth=bandwidth)
    )
    assert model_error.fit_with_model_error(fit_with(chi2=2.0, bandwidth=60.0), DATA).bandwidth == expected
    simulated = fit_with(chi2=2.0, bandwidth=0.0)
    assert model_error.fit_with_model_error(simulated, DATA) is simulated


def test_the_loss_is_chi_squared_in_units_of_the_innovations_variance() -> None:
    """Position gain K = 2 * bandwidth * period; innovations have 1 / (1 - K) times the variance of the noise."""
    data: Any = SimpleNamespace(period=1e-3, runs=[SimpleNamespace(counted=np.ones((100, 1)))])
    variance = 1.0 / (1.0 - 2.0 * 30.0 * 1e-3)
    loss = model_error.information_loss(fit_with(chi2=1.3, bandwidth=30.0), data)
    assert loss == pytest.approx(1.3 / variance + np.log(variance))
    assert model_error.information_loss(fit_with(chi2=1.3), data) == pytest.approx(1.3)
    slow: Any = SimpleNamespace(period=0.1, runs=data.runs)
    assert model_error.information_loss(fit_with(chi2=1.3, bandwidth=60.0), slow) == pytest.approx(0.13 + np.log(10.0))


def test_sensors_count_by_their_number_of_measurements() -> None:
    """A laser beside encoders has 5/12 of their bandwidth."""
    machine = HFRAME
    counted = np.zeros((90, 4))
    counted[:, 0], counted[:30, 2] = 1.0, 1.0
    data: Any = SimpleNamespace(period=1e-3, runs=[SimpleNamespace(counted=counted)])
    fitted = dataclasses.replace(fit_with(chi2=1.0, bandwidth=60.0), machine=machine)
    encoder, laser = 1.0 / (1.0 - 0.12), 1.0 / (1.0 - 0.05)
    expected = 1.0 / (0.75 * encoder + 0.25 * laser) + 0.75 * np.log(encoder) + 0.25 * np.log(laser)
    assert model_error.information_loss(fitted, data) == pytest.approx(expected)


class LinearModel:
    """Linear residual r + J theta of each run, in place of a machine."""

    ROWS: Mapping[str, tuple[np.ndarray, np.ndarray]] = {}

    def __init__(self, *arguments: Any) -> None:
        pass

    def linearize_run(self, run: Any, theta: np.ndarray) -> Any:
        jacobian, residual = self.ROWS[run.name]
        return SimpleNamespace(jacobian=jacobian, residual=residual + theta @ jacobian)


@pytest.mark.parametrize("names", ["abcde", "ab"])
def test_left_out_costs_are_those_of_fits_to_the_others(monkeypatch: pytest.MonkeyPatch, names: str) -> None:
    """Compare with a least-squares solution for each part; two runs are divided into four parts each."""
    rng = np.random.default_rng(0)
    rows = {name: (rng.normal(size=(2, 80)), rng.normal(size=80)) for name in names}
    monkeypatch.setattr(LinearModel, "ROWS", rows)
    monkeypatch.setattr(model_error, "ResidualModel", LinearModel)
    monkeypatch.setattr(model_error, "map_runs", lambda function, data: map(function, data.runs))
    free = tuple(FreeParameter(f"p{i}", 1.0, 0.5) for i in range(2))
    fitted = dataclasses.replace(fit_with(chi2=1.0), free=free, theta=np.array([0.3, -0.2]))
    data: Any = SimpleNamespace(runs=[SimpleNamespace(name=name, count=80) for name in names])
    pieces = 1 if len(names) >= 4 else 4
    parts = [
        (j, r)
        for jacobian, residual in rows.values()
        for j, r in zip(np.array_split(jacobian, pieces, 1), np.array_split(residual, pieces), strict=True)
    ]
    everything = sum(float(np.sum((r + fitted.theta @ j) ** 2)) for j, r in parts)
    chi2 = everything / (80 * len(names))
    precision = np.eye(2) / 0.5**2 * max(1.0, chi2)
    expected = []
    for left_out in range(len(parts)):
        others = [part for k, part in enumerate(parts) if k != left_out]
        information = sum(j @ j.T for j, _ in others) + precision
        theta = -np.linalg.solve(information, sum(j @ r for j, r in others))
        costs = [float(np.sum((r + theta @ j) ** 2)) for j, r in parts]
        expected.append((costs[left_out], sum(costs) - costs[left_out]))
    np.testing.assert_allclose(model_error._left_out_costs(fitted, data, pieces), expected, rtol=1e-9)
    total = sum(cost for cost, _ in expected)
    assert model_error._leave_one_out_cost(fitted, data) == pytest.approx(total)
    better = dataclasses.replace(fitted, theta=fitted.theta)
    assert model_error.leave_one_out_gain(fitted, better, data) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("costs", "name"),
    [
        ([(100.0, 1.0)] * 2, None),  # fewer than three runs
        ([(40.0, 30.0), (10.0, 60.0), (10.0, 60.0), (10.0, 60.0)], None),
        ([(10.0, 130.0), (10.0, 130.0), (110.0, 30.0), (10.0, 130.0)], "c"),
        ([(10.0, 130.0), (10.0, 130.0), (99.0, 30.0), (10.0, 130.0)], None),
        ([(10.0, 130.0), (130.0, 30.0), (110.0, 30.0), (10.0, 130.0)], "b"),
    ],
)
def test_a_run_with_ten_times_the_error_of_the_others_contradicts(
    monkeypatch: pytest.MonkeyPatch, costs: list[tuple[float, float]], name: str | None
) -> None:
    monkeypatch.setattr(model_error, "_left_out_costs", lambda fitted, data, pieces: costs)
    data = runs("abcd"[: len(costs)])
    assert model_error.contradicting_run(fit_with(chi2=1.0), data) == name


def test_runs_of_different_length_are_compared_per_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        model_error, "_left_out_costs", lambda *arguments: [(200.0, 150.0), (50.0, 300.0), (50.0, 300.0), (50.0, 300.0)]
    )
    data = runs("abcd")
    data.runs[0].count = 100
    for run in data.runs[1:]:
        run.count = 500
    assert model_error.contradicting_run(fit_with(chi2=1.0), data) == "a"  # 2.0 against 0.1 per sample


# -- sizes -------------------------------------------------------------------------------------------------------------


def test_the_size_of_a_force_is_its_root_mean_square() -> None:
    assert force_size(np.array([[3.0, 4.0], [0.0, 0.0]])) == pytest.approx(np.sqrt(12.5))


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        (STRIBECK, DRAG, True),
        (STRIBECK, SPRING, False),
        (STRIBECK, EFFECTS["quadratic_drag"].at("y", c=4.0), False),
        (
            EFFECTS["cogging"].at("motor1", A=0.03, n=23.6, p=0.5),
            EFFECTS["cable_spring"].at("phi1", k=6.0, q0=0.0),
            False,
        ),
        (EFFECTS["friction_slope"].at("x", s=1.0), SPRING, True),
        (EFFECTS["friction_slope"].at("phi1", s=0.1), EFFECTS["cable_spring"].at("phi1", k=6.0, q0=0.0), True),
    ],
)
def test_which_effects_depend_on_the_same_variable(first: AppliedEffect, second: AppliedEffect, same: bool) -> None:
    """Periodic ones only on that of other periodic ones."""
    assert depend_on_same_variable(first, second, HFRAME) == same
    assert depend_on_same_variable(second, first, HFRAME) == same


def test_the_difference_of_forces_is_that_at_the_belt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Torques are divided by the radius of the pulley; the motion is that of the first machine."""
    other = dataclasses.replace(HFRAME, name="other")
    moved: list[str] = []

    def predict(machine: Machine, run: Any, bandwidth: float, period: float, states: bool) -> Any:
        assert (bandwidth, period, states) == (60.0, 1e-3, True)
        moved.append(machine.name)
        return SimpleNamespace(positions=np.zeros((1, 5, 4)), velocities=np.zeros((1, 5, 4)))

    forces = {HFRAME.name: np.full((5, 4), 0.1), "other": np.tile([3.1, 4.1, 0.1, 0.1 + 12.0 * 0.0194], (5, 1))}
    monkeypatch.setattr(effect_size, "predict", predict)
    monkeypatch.setattr(effect_size, "map_runs", lambda function, data: map(function, data.runs))
    monkeypatch.setattr(effect_size, "net_forces", lambda machine, *record: forces[machine.name])
    data: Any = SimpleNamespace(period=1e-3, runs=[SimpleNamespace(time_s=np.arange(5.0), inputs=np.zeros((5, 2)))] * 2)
    assert effect_size.force_difference(HFRAME, other, data) == pytest.approx(13.0)
    assert set(moved) == {HFRAME.name}


def test_the_force_of_the_drives_is_at_the_belt() -> None:
    inputs = np.array([[3.0, -4.0], [0.0, 0.0]])
    data: Any = SimpleNamespace(runs=[SimpleNamespace(inputs=inputs)])
    drive = HFRAME.drives[0]
    assert effect_size.drive_force(HFRAME, data) == pytest.approx(np.sqrt(12.5) * drive.gain / 0.0194)


@pytest.mark.parametrize("bandwidth", [0.0, 30.0])
def test_the_residue_is_the_correction_beyond_that_of_noise(monkeypatch: pytest.MonkeyPatch, bandwidth: float) -> None:
    """The observer corrects the velocity by bandwidth^2 times the innovation; without one, by that of 3 rad/s."""
    innovation = np.array([[3e-3], [-5e-3], [np.nan], [1e-3]])
    run: Any = SimpleNamespace(outputs=innovation, noise=np.array([1e-3]))
    data: Any = SimpleNamespace(period=1e-3, runs=[run])
    monkeypatch.setattr(model_error, "predict", lambda *arguments, **more: SimpleNamespace(readings=None))
    monkeypatch.setattr(model_error, "prediction_error", lambda run, data, readings: innovation[None])
    monkeypatch.setattr(model_error, "map_runs", lambda function, data: map(function, data.runs))
    power = (9.0 + 25.0 + 1.0 - 3.0) / 4.0 * 1e-6  # m^2; the missing measurement has neither error nor noise
    mass = AXIS.coordinates[0].mass
    expected = max(bandwidth, 3.0) ** 2 * mass * np.sqrt(power)
    assert model_error.residue_force(fit_with(chi2=1.0, bandwidth=bandwidth), data) == pytest.approx(expected)
    run.noise = np.array([9e-3])
    assert model_error.residue_force(fit_with(chi2=1.0), data) == 0.0


@pytest.mark.parametrize(("period", "rows"), [(1e-3, 50), (0.2, 1)])
def test_the_long_run_variance_is_that_of_sums_over_50_ms(
    monkeypatch: pytest.MonkeyPatch, period: float, rows: int
) -> None:
    sums = {4: np.array([[1.0, 3.0], [1.0, -1.0]]), 1: np.array([[0.5, 0.1]])}

    def residuals(run: Any, data: Any, readings: Any, summed: int) -> np.ndarray:
        assert summed == rows
        return np.ravel(sums[run])[None]

    monkeypatch.setattr(model_error, "predict", lambda *arguments, **more: SimpleNamespace(readings=None))
    monkeypatch.setattr(model_error, "residuals", residuals)
    monkeypatch.setattr(model_error, "map_runs", lambda function, data: map(function, data.runs))
    machine = dataclasses.replace(HFRAME, sensors=HFRAME.sensors[:2])
    fitted = dataclasses.replace(fit_with(chi2=1.0), machine=machine)
    assert model_error.long_run_variance(fitted, SimpleNamespace(period=period, runs=[4])) == pytest.approx(5.0)
    assert model_error.long_run_variance(fitted, SimpleNamespace(period=period, runs=[1])) == 1.0


@pytest.mark.parametrize("effect", [FRAME, EFFECTS["sensor_scale"].at("x_m", g=1.01)])
def test_no_force_describes_structures_and_measurements(effect: AppliedEffect) -> None:
    assert effect_size.effect_force(AXIS, effect, DATA) == np.inf


# -- held-out runs -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("count", "expected"),
    [(2, ("r1",)), (3, ("r2",)), (4, ("r3",)), (7, ("r3",)), (8, ("r3", "r7"))],
)
def test_every_fourth_run_is_held_out(count: int, expected: tuple[str, ...]) -> None:
    recordings: Any = [SimpleNamespace(name=f"r{i}") for i in range(count)]
    assert hold_out(recordings) == expected
    assert hold_out(recordings, ["r0"]) == ("r0",)
    with pytest.raises(InputError, match="--hold-out nothing: no such run"):
        hold_out(recordings, ["r0", "nothing"])
    with pytest.raises(InputError, match="at least one must be left to fit"):
        hold_out(recordings, [f"r{i}" for i in range(count)])


def test_a_single_run_cannot_be_held_out() -> None:
    recordings: Any = [SimpleNamespace(name="r0")]
    with pytest.raises(InputError, match="runs: 1, held out: 1"):
        hold_out(recordings)


def by_effects(values: Mapping[tuple[str, ...], float | None]) -> Callable[..., Any]:
    """Return a function of a machine that looks up a value by its effects' names."""
    return lambda machine, *rest, **more: values[tuple(e.name for e in machine.effects)]


def test_the_held_out_gain_compares_forces_or_costs(monkeypatch: pytest.MonkeyPatch) -> None:
    with_both, with_drag = (dataclasses.replace(AXIS, effects=effects) for effects in ((PUSH, DRAG), (DRAG,)))
    names = ("constant_force", "quadratic_drag"), ("quadratic_drag",), ()
    monkeypatch.setattr(held_out, "force_error", by_effects(dict(zip(names, (0.1, 0.2, 0.4), strict=True))))
    monkeypatch.setattr(held_out, "prediction_cost", by_effects(dict(zip(names, (30.0, 40.0, 60.0), strict=True))))
    one = selected(PUSH)
    assert held_out.held_out_gain(one, with_both, DATA, 60.0) == pytest.approx(0.75)
    assert held_out.held_out_gain(one, with_both, DATA, 0.0) == pytest.approx(0.25)
    assert held_out.error_reduction(with_both, with_drag, DATA, 0.0) == pytest.approx(-1.0 / 3.0)
    monkeypatch.setattr(held_out, "force_error", by_effects(dict(zip(names, (0.1, None, 0.4), strict=True))))
    assert held_out.error_reduction(with_drag, with_both, DATA, 60.0) == pytest.approx(0.25)


def test_the_gain_of_a_structure_compares_with_the_machine_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the effect alone, its coordinate would stay."""
    monkeypatch.setattr(held_out, "prediction_cost", by_effects({("frame_resonance",): 1.0, (): 4.0, ("x",): 9.0}))
    gain = held_out.held_out_gain(selected(FRAME), dataclasses.replace(AXIS, effects=(FRAME,)), DATA, 0.0)
    assert gain == pytest.approx(0.75)


@pytest.mark.parametrize(("force", "excited"), [(0.051, True), (0.049, False)])
def test_a_twentieth_of_the_fitted_force_is_excitation(
    monkeypatch: pytest.MonkeyPatch, force: float, excited: bool
) -> None:
    fitted, validation = runs("ab"), runs("c")
    monkeypatch.setattr(held_out, "effect_force", lambda m, e, data: 2.0 if data is fitted else 2.0 * force)
    assert held_out.is_excited(PUSH, AXIS, validation, fitted) == excited
    for effect in (FRAME, EFFECTS["sensor_scale"].at("x_m", g=1.01), EFFECTS["sensor_delay"].at("x_m", d=1e-3)):
        assert held_out.is_excited(effect, AXIS, validation, fitted)


@pytest.mark.parametrize(("chi2", "limit"), [(0.5, 10.0), (3.0, 30.0)])
def test_held_out_runs_that_contradict_are_named(monkeypatch: pytest.MonkeyPatch, chi2: float, limit: float) -> None:
    """More than ten times the error of the fit, which counts as at least that of the noise."""
    costs = {"a": 0.99 * limit, "b": 1.01 * limit, "c": 5.0 * limit}

    def with_runs(names: list[str]) -> Any:
        return SimpleNamespace(runs=[SimpleNamespace(name=name) for name in names], count=50)

    data: Any = SimpleNamespace(runs=[SimpleNamespace(name=name) for name in "abc"], with_runs=with_runs)
    monkeypatch.setattr(
        held_out, "prediction_cost", lambda machine, run, bandwidth, longest_step: costs[run.runs[0].name] * run.count
    )
    assert held_out.contradicting_held_out_runs(fit_with(chi2=chi2), data) == ("b", "c")
