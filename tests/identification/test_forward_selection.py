"""Tests of the selection of effects with scripted fits: each threshold from both sides.

Nothing is simulated. Fits have the costs that a test gives them, so that a test states what is decided and why.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import pytest

from hframe_gym.identification import Fit, forward_selection
from hframe_gym.identification.forward_selection import EffectSearch
from hframe_gym.machine import AppliedEffect
from tests.identification.scripted_fits import (
    AXIS,
    CRITERIA,
    DATA,
    DRAG,
    FRAME,
    PUSH,
    SPRING,
    STRIBECK,
    fit_with,
    selected,
)

pytestmark = pytest.mark.unit


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
            "long_run_variance": lambda fitted, data: self.variance,
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


# -- doubts ------------------------------------------------------------------------------------------------------------


def doubt(scripted: Scripted, without: float = 1.4, with_effect: float = 1.2, *effects: AppliedEffect) -> str:
    """Return the doubt about the last effect of a trial."""
    present = effects or (PUSH,)
    return scripted.search()._doubt(fit_with(*present[:-1], chi2=without), fit_with(*present, chi2=with_effect))


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
