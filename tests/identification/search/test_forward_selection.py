"""Tests of the selection of effects with scripted fits: each threshold from both sides.

Nothing is simulated. Fits have the costs that a test gives them, so that a test states what is decided and
why.
"""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import pytest

from hframe_gym.identification.fit.estimation import Fit, describe_gain
from hframe_gym.identification.judge.effect import hidden_by
from hframe_gym.identification.predict.prediction import SIMULATION
from hframe_gym.identification.search.forward_selection import EffectSearch
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
    Scripted,
    fit_with,
    selected,
)

# -- selection -----------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("rival_first", [True, False])
@pytest.mark.parametrize(("together", "found"), [(1.295, False), (1.2, True)])
def test_an_effect_must_explain_something_beside_one_that_chance_explains(
    scripted: Scripted, together: float, found: bool, rival_first: bool
) -> None:
    """Friction of a carriage was named where a similar one that explained more had failed as chance.

    So was the mesh of a belt, which is simpler and therefore tested first, where a payload explained as much.
    """
    scripted.variances = {PUSH.label: 1e4}
    if rival_first:
        scripted.trials = [[fit_with(PUSH, chi2=1.3), fit_with(DRAG, chi2=1.31)]]
    else:
        scripted.trials = [[fit_with(DRAG, chi2=1.301, free=4), fit_with(PUSH, chi2=1.3, free=5)]]
    scripted.again = [fit_with(PUSH, DRAG, chi2=together)]
    search = scripted.search()
    _, effects = search.run(fit_with(chi2=1.4))
    assert [s.effect for s in effects] == ([DRAG] if found else [])
    if not found:
        assert search.considered[DRAG.label].reason == hidden_by(PUSH.label)


def test_an_effect_needs_nothing_beside_one_that_explains_less(scripted: Scripted) -> None:
    scripted.variances = {PUSH.label: 1e4}
    trials = [fit_with(PUSH, chi2=1.301, free=4), fit_with(DRAG, chi2=1.3, free=5)]  # the simpler one first
    scripted.trials = [trials]
    _, effects = scripted.search().run(fit_with(chi2=1.4))
    assert [s.effect for s in effects] == [DRAG]


def test_an_effect_needs_nothing_beside_one_that_is_doubted_itself(scripted: Scripted) -> None:
    """The force of the first one is too small; it says nothing about the error."""
    scripted.force = {PUSH.label: 0.01}
    scripted.trials = [[fit_with(PUSH, chi2=1.3), fit_with(DRAG, chi2=1.31)]]
    _, effects = scripted.search().run(fit_with(chi2=1.4))
    assert [s.effect for s in effects] == [DRAG]


def test_structural_effects_are_tried_where_the_others_leave_enough(scripted: Scripted) -> None:
    scripted.structures = [[fit_with(FRAME, chi2=1.005)]]
    scripted.residue = {1.2: 1.0}  # it takes nearly all of the unexplained force
    _, effects = scripted.search().run(fit_with(chi2=1.2))
    assert [s.effect for s in effects] == [FRAME]


@pytest.mark.parametrize(("unknown_voltages", "tried"), [(True, True), (False, False)])
def test_structural_effects_are_tried_where_the_size_of_the_noise_is_not_known(
    scripted: Scripted, unknown_voltages: bool, tried: bool
) -> None:
    scripted.structures = [[fit_with(FRAME, chi2=0.9)]]
    data = SimpleNamespace(**{**vars(DATA), "has_voltage_errors": unknown_voltages})
    scripted.search(data).run(fit_with(chi2=0.9))
    assert (scripted.structures == []) == tried


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


@pytest.mark.parametrize(
    ("with_3_rad_s", "left", "found"),
    [(1.2, 1.0, True), (1.2, 1.5, False), (1.6, 1.0, False)],
    ids=["explains the simulation", "leaves a quarter", "nearly unexplained before"],
)
def test_what_all_observers_hide_is_searched_for_in_simulation(
    scripted: Scripted, with_3_rad_s: float, left: float, found: bool
) -> None:
    """An off-center encoder disk whose period is longer than the travel left 2.96, and 1.2 at 3 rad/s."""
    scripted.simulated = 3.0
    scripted.narrower = {
        60.0: fit_with(chi2=with_3_rad_s, bandwidth=3.0),
        3.0: fit_with(chi2=3.0, bandwidth=SIMULATION),
    }
    scripted.trials = [[], [], [fit_with(PUSH, chi2=left)]]
    _, effects = scripted.search().run(fit_with(chi2=1.05, bandwidth=60.0))
    assert [s.effect for s in effects] == ([PUSH] if found else [])


@pytest.mark.parametrize(
    ("chi2", "residue", "found"), [(10.0, 0.1, True), (10.0, 2.0, False), (1.49, 0.1, False)]
)
def test_two_effects_that_hide_each_other_are_selected_together(
    scripted: Scripted, chi2: float, residue: float, found: bool
) -> None:
    """The first one has less force than the rest without the second, and passes if it has more beside it."""
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
    push = dataclasses.replace(selected(PUSH), rival_effects=(STRIBECK, DRAG))
    current, chosen = fit_with(PUSH, SPRING, chi2=2.0), (push, selected(SPRING))
    fitted, effects = scripted.search()._exchange(current, chosen, chosen[:-1])
    if not replaced:
        assert (fitted, effects) == (current, chosen)
        return
    assert [s.effect for s in effects] == [SPRING, STRIBECK]
    assert effects[1].rival_effects == (PUSH, DRAG)  # the finest step decides between them
    assert effects[1].gain == pytest.approx(6.0 - chi2)
    assert fitted is scripted.replacement


@pytest.mark.parametrize(
    ("drawback_of", "kept"), [(STRIBECK, [PUSH, SPRING]), (PUSH, [SPRING, STRIBECK])], ids=["new", "old"]
)
def test_an_effect_with_a_drawback_replaces_no_earlier_one(
    scripted: Scripted, drawback_of: AppliedEffect, kept: list[AppliedEffect]
) -> None:
    """Friction that warms up fitted some runs of a flywheel better, and undid what others had confirmed."""

    def drawback(fitted: Fit) -> str:
        return "does not help" if drawback_of in fitted.machine.effects else ""

    scripted.without = {PUSH.label: fit_with(SPRING, chi2=6.0)}
    scripted.replacement = fit_with(SPRING, STRIBECK, chi2=1.5)
    search = EffectSearch(DATA, AXIS, CRITERIA, scripted.lines.append, drawback)
    chosen = (selected(PUSH), selected(SPRING))
    _, effects = search._exchange(fit_with(PUSH, SPRING, chi2=2.0), chosen, chosen[:-1])
    assert [s.effect for s in effects] == kept
    line = f"  {STRIBECK.label} does not replace {PUSH.label}: it does not help"
    assert scripted.lines.count(line) == (drawback_of is STRIBECK)


@pytest.mark.parametrize(
    ("without_drag", "force", "kept"),
    [(4.0, 1.0, [PUSH, DRAG]), (2.001, 1.0, [PUSH]), (4.0, 0.01, [PUSH])],
    ids=["both pass", "too small a gain", "too small a force"],
)
def test_effects_that_a_search_with_other_voltages_selected_must_pass_again(
    scripted: Scripted, without_drag: float, force: float, kept: list[AppliedEffect]
) -> None:
    scripted.force = {DRAG.label: force}
    scripted.without = {PUSH.label: fit_with(DRAG, chi2=6.0), DRAG.label: fit_with(PUSH, chi2=without_drag)}
    scripted.again = [fit_with(PUSH, DRAG, chi2=2.0), fit_with(PUSH, chi2=without_drag)]
    known = (selected(PUSH, 30.0), selected(DRAG, 20.0))
    fitted, effects = scripted.search().start_with(fit_with(chi2=10.0), known)
    assert [s.effect for s in effects] == kept
    assert list(fitted.machine.effects) == kept
    assert [s.gain for s in effects] == pytest.approx([4.0, 2.0] if DRAG in kept else [10.0 - without_drag])


@pytest.mark.parametrize(("rejected", "kept"), [(1, DRAG), (5, PUSH)], ids=["held", "interpolated"])
def test_after_a_search_with_held_voltages_the_last_effect_may_give_way_as_well(
    scripted: Scripted, rejected: int, kept: AppliedEffect
) -> None:
    scripted.without = {PUSH.label: fit_with(chi2=6.0)}
    scripted.again, scripted.replacement = [fit_with(PUSH, chi2=2.0)], fit_with(DRAG, chi2=1.5)
    data = SimpleNamespace(**{**vars(DATA), "updates_rejected": {rejected: 1}})
    _, effects = scripted.search(data).start_with(fit_with(chi2=6.0), (selected(PUSH),))
    assert [s.effect for s in effects] == [kept]


@pytest.mark.parametrize(("observer", "kept"), [(15.0, DRAG), (60.0, PUSH)])
def test_at_a_narrower_observer_the_last_effect_may_give_way_as_well(
    scripted: Scripted, observer: float, kept: AppliedEffect
) -> None:
    """An eccentric encoder explained more than the eccentric pulley at 60 rad/s, and less at 15 rad/s."""
    scripted.observer = observer
    scripted.without = {PUSH.label: fit_with(chi2=6.0)}
    scripted.trials, scripted.replacement = (
        [[fit_with(PUSH, chi2=2.0, bandwidth=60.0)]],
        fit_with(DRAG, chi2=1.5),
    )
    _, effects = scripted.search(max_effects=1).run(fit_with(chi2=6.0, bandwidth=60.0))
    assert [s.effect for s in effects] == [kept]


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


def test_an_effect_that_is_kept_is_compared_with_the_machine_that_has_all_others(scripted: Scripted) -> None:
    """Otherwise what later effects explain counts as the gain of an earlier one that added coordinates."""
    scripted.without = {PUSH.label: fit_with(DRAG, chi2=6.0), DRAG.label: fit_with(PUSH, chi2=3.0)}
    _, kept = scripted.search().prune(fit_with(PUSH, DRAG, chi2=2.0), (selected(PUSH), selected(DRAG)))
    assert [s.machine_without.effects for s in kept] == [(DRAG,), (PUSH,)]


def test_an_effect_on_which_another_rests_is_kept(scripted: Scripted) -> None:
    scripted.without = {FRAME.label: None}
    fitted, effects = scripted.search().prune(fit_with(FRAME, chi2=2.0), (selected(FRAME),))
    assert [s.effect for s in effects] == [FRAME]
    assert fitted.chi2 == 2.0


def test_an_effect_that_raises_the_error_is_not_said_to_reduce_it() -> None:
    before, better, worse = fit_with(chi2=500.5), fit_with(PUSH, chi2=99.0), fit_with(PUSH, chi2=533.5)
    assert describe_gain(before, better) == "reduces chi-squared per sample from 500.5 to 99 (simulation)"
    assert (
        describe_gain(before, worse)
        == "does not reduce chi-squared per sample (500.5, with it 533.5, simulation)"
    )
