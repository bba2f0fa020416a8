"""Tests of the selection of effects with scripted fits: each threshold from both sides.

Nothing is simulated. Fits have the costs that a test gives them, so that a test states what is decided and why.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Fit, SelectedEffect
from hframe_gym.identification.evidence import significance
from hframe_gym.identification.evidence.tried_effects import Selection
from hframe_gym.identification.fit.estimation import describe_gain
from hframe_gym.identification.search import forward_selection
from hframe_gym.identification.search.forward_selection import EffectSearch
from hframe_gym.machine import AppliedEffect
from tests.identification.scripted_fits import (
    CRITERIA,
    DATA,
    DRAG,
    FRAME,
    PUSH,
    SPRING,
    STRIBECK,
    Scripted,
    fit_with,
    selected,
)

pytestmark = pytest.mark.unit
DAHL = EFFECTS["dahl_hysteresis"].at("x", F=0.3, L=1e-3)


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
    assert effects[0].rival_effects == (DRAG,)
    assert effects[0].rivals == (DRAG.label, *PUSH.definition.equivalent)
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
    assert considered.reason.startswith("has a force of 0.01 N")
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
    refusal = f"  {PUSH.label} is not selected: a reduction by 0.9 is required"
    assert (refusal in scripted.lines) != found


@pytest.mark.parametrize(("chi2", "found"), [(10.05, True), (10.2, False)])
def test_an_effect_must_make_up_for_a_less_likely_narrower_observer(
    scripted: Scripted, monkeypatch: pytest.MonkeyPatch, chi2: float, found: bool
) -> None:
    """A tenth of the excess is 0.9; the narrower observer is less likely by 1, so that the gain must be 1.9."""
    current, narrower = fit_with(chi2=10.0, bandwidth=60.0), fit_with(chi2=12.0, bandwidth=30.0)
    monkeypatch.setattr(forward_selection, "narrower_observer", lambda *_: narrower)
    monkeypatch.setattr(forward_selection, "likelihood_deficit", lambda *_: 1.0)
    scripted.trials = [[fit_with(DRAG, chi2=9.5, bandwidth=60.0)], [fit_with(PUSH, chi2=chi2, bandwidth=30.0)]]
    _, effects = scripted.search(max_effects=1).run(current)
    assert [s.effect for s in effects] == ([PUSH] if found else [])
    assert not found or effects[0].gain == pytest.approx(1.95)


@pytest.mark.parametrize(
    ("chi2", "simulated", "remaining", "found"),
    [(1.29, 1.51, 0.1, [PUSH]), (1.31, 1.51, 0.1, []), (1.29, 1.49, 0.1, []), (1.29, 1.51, 0.3, [])],
)
def test_a_slow_effect_is_found_with_a_much_narrower_observer(
    scripted: Scripted,
    monkeypatch: pytest.MonkeyPatch,
    chi2: float,
    simulated: float,
    remaining: float,
    found: list[AppliedEffect],
) -> None:
    """The model nearly explains the data with 15 rad/s, but not in simulation; the effect explains them there, too."""
    scripted.simulated = simulated
    monkeypatch.setattr(forward_selection, "unexplained_fraction", lambda _, trials, __: remaining if trials else 1.0)
    narrower = {60.0: fit_with(chi2=1.2, bandwidth=30.0), 30.0: fit_with(chi2=1.4, bandwidth=15.0)}
    narrower |= {15.0: fit_with(chi2=1.6, bandwidth=7.0)}  # the model explains too little: no effect is tried
    monkeypatch.setattr(forward_selection, "narrower_observer", lambda fitted, data: narrower[fitted.bandwidth])
    scripted.trials = [[], [], [fit_with(DRAG, chi2=1.17, bandwidth=30.0)], [fit_with(PUSH, chi2=chi2, bandwidth=15.0)]]
    search = scripted.search(max_effects=1, min_gain_fraction=0.25)
    _, effects = search.run(fit_with(chi2=1.1, bandwidth=60.0))
    assert [s.effect for s in effects] == found


def test_observers_with_which_the_model_explains_little_are_not_tried(
    scripted: Scripted, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the next narrower observer is tried in any case, first with the gain that makes up for its likelihood."""
    narrower = {60.0: fit_with(chi2=1.4, bandwidth=30.0), 30.0: fit_with(chi2=1.6, bandwidth=15.0)}
    monkeypatch.setattr(forward_selection, "narrower_observer", lambda fitted, data: narrower[fitted.bandwidth])
    scripted.trials = [[], [], [], [fit_with(PUSH, chi2=1.0, bandwidth=15.0)]]
    _, effects = scripted.search().run(fit_with(chi2=1.2, bandwidth=60.0))
    assert effects == ()
    assert len(scripted.trials) == 1


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


@pytest.mark.parametrize(("best", "tried"), [(DAHL, True), (PUSH, False)])
def test_friction_with_memory_is_tried_beside_a_force_with_memory(
    scripted: Scripted, monkeypatch: pytest.MonkeyPatch, best: AppliedEffect, tried: bool
) -> None:
    """A hysteresis may explain nearly all of the error that a bristle state of dry friction causes."""
    monkeypatch.setattr(forward_selection, "unexplained_fraction", lambda *arguments: 0.05)
    trials = [fit_with(SPRING, chi2=2.0), fit_with(best, chi2=1.2)]
    assert scripted.search()._worth_structures(fit_with(chi2=5.0, bandwidth=60.0), trials) == tried


@pytest.mark.parametrize(("chi2", "bandwidth", "compared"), [(1.4, 15.0, True), (1.6, 15.0, False), (1.4, 0.0, False)])
def test_rivals_are_compared_as_soon_as_the_model_nearly_explains_the_data(
    scripted: Scripted, monkeypatch: pytest.MonkeyPatch, chi2: float, bandwidth: float, compared: bool
) -> None:
    """A wrong one of two rivals may be all that is left; narrower observers would be tried for nothing."""

    def settle_rivals(search: EffectSearch, current: Fit, effects: tuple[SelectedEffect, ...]) -> Selection:
        return fit_with(DRAG, chi2=1.0), (selected(DRAG),)

    monkeypatch.setattr(EffectSearch, "settle_rivals", settle_rivals)
    scripted.trials = [[fit_with(PUSH, chi2=chi2, bandwidth=bandwidth)]]
    _, effects = scripted.search().run(fit_with(chi2=9.0, bandwidth=60.0))
    assert [s.effect for s in effects] == [DRAG if compared else PUSH]


@pytest.mark.parametrize(("chi2", "retried"), [(5.0, True), (7.1, False)])
def test_structural_effects_are_tried_again_once_the_error_is_clearly_smaller(
    scripted: Scripted, chi2: float, retried: bool
) -> None:
    """From an excess of 9, where no effect passed, two thirds are 6.03."""
    search = scripted.search()
    assert search.run(fit_with(chi2=10.0))[1] == ()
    scripted.structures = [[fit_with(FRAME, chi2=1.0)]]
    scripted.residue = {chi2: 1.0}
    _, effects = search.with_data(DATA).run(fit_with(chi2=chi2))
    assert [s.effect for s in effects] == ([FRAME] if retried else [])


def test_structural_effects_are_tried_again_beside_each_further_effect(scripted: Scripted) -> None:
    """Where another effect passed, a structural one was no more than less promising."""
    scripted.trials = [[fit_with(PUSH, chi2=9.0)]]
    scripted.structures = [[], [fit_with(PUSH, FRAME, chi2=1.0)]]
    scripted.residue = {9.0: 1.0}
    _, effects = scripted.search().run(fit_with(chi2=10.0))
    assert [s.effect for s in effects] == [PUSH, FRAME]


@pytest.mark.parametrize(("chi2", "residue", "found"), [(10.0, 0.1, True), (10.0, 2.0, False), (1.49, 0.1, False)])
def test_two_effects_that_hide_each_other_are_selected_together(
    scripted: Scripted, chi2: float, residue: float, found: bool
) -> None:
    """The first one has less force than what remains without the second, and passes if it has more beside it."""
    first = 0.7 * chi2
    scripted.residue = {first: 2.0, 1.005: residue}
    scripted.without = {PUSH.label: fit_with(DRAG, chi2=3.0)}
    scripted.force = {DRAG.label: 5.0}
    scripted.trials = [[fit_with(PUSH, chi2=first)], [fit_with(PUSH, DRAG, chi2=1.005)]]
    _, effects = scripted.search().run(fit_with(chi2=chi2))
    assert [s.effect for s in effects] == ([PUSH, DRAG] if found else [])


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
    text = significance.doubt_beside_others(fit_with(chi2=6.0), fit_with(PUSH, chi2=2.0), PUSH, DATA, CRITERIA)
    assert (reason in text) if reason else text == ""


def test_an_effect_that_raises_the_error_is_not_said_to_reduce_it() -> None:
    before, better, worse = fit_with(chi2=500.5), fit_with(PUSH, chi2=99.0), fit_with(PUSH, chi2=533.5)
    assert describe_gain(before, better) == "reduces chi-squared per sample from 500.5 to 99 (simulation)"
    assert describe_gain(before, worse) == "does not reduce chi-squared per sample (500.5, with it 533.5, simulation)"
