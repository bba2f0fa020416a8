"""Tables of trials: which candidates are worth a fit, and when the search goes on."""

from __future__ import annotations

import dataclasses
import math

import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge import trial as judge
from hframe_gym.identification.judge.error import FitError
from hframe_gym.identification.judge.trial import StructureEvidence

CRITERIA = SelectionCriteria()


def error(chi2: float, bandwidth: float = 0.0) -> FitError:
    """Return the error of a fit to 10,000 values; with the widest observer, an exact machine leaves 1.1."""
    widest = bandwidth == 60.0
    return FitError(chi2 * 1e4, 1e4, bandwidth, widest, 1.1 if widest else 1.0)


@pytest.mark.parametrize(("best", "least"), [(0.0, 60.0), (100.0, 60.0), (1000.0, 400.0)])
def test_the_least_promise_follows_from_the_required_gain_and_the_best(best: float, least: float) -> None:
    assert judge.least_promise(0.01, 1e4, best, CRITERIA) == pytest.approx(least)


@pytest.mark.parametrize(("size", "enough"), [(0.51, True), (0.49, False)])
def test_a_promised_force_is_half_of_the_residue(size: float, enough: bool) -> None:
    assert judge.promises_enough_force(size, 1.0, CRITERIA) == enough


@pytest.mark.parametrize(("best", "alone"), [(2.79, True), (2.81, False)])
def test_a_trial_that_leaves_a_fifth_explains_alone(best: float, alone: bool) -> None:
    assert judge.explains_alone(error(10.0), error(best), CRITERIA) == alone
    assert not judge.explains_alone(error(10.0), None, CRITERIA)


@pytest.mark.parametrize(("promise", "rival"), [(81.0, True), (79.0, False)])
def test_beside_a_candidate_that_explains_only_rivals_are_fitted(promise: float, rival: bool) -> None:
    assert judge.may_be_rival(promise, 100.0, CRITERIA) == rival
    assert judge.may_be_rival(1e-9, 0.0, CRITERIA)


@pytest.mark.parametrize(("promise", "may"), [(61.0, True), (59.0, False)])
def test_a_replacement_promises_three_fifths(promise: float, may: bool) -> None:
    assert judge.may_replace(promise, 100.0, CRITERIA) == may


@pytest.mark.parametrize(
    ("chi2", "any_trial", "at_limit", "elsewhere"),
    [
        (1.0, True, True, True),
        (9.0, False, False, True),
        (9.0, True, False, False),
        (1.2, False, False, False),
    ],
)
def test_when_candidates_are_also_tried_from_the_declared_parameters(
    chi2: float, any_trial: bool, at_limit: bool, elsewhere: bool
) -> None:
    """If a parameter is at its limit, or if nothing is promising although much error is left."""
    found = judge.may_be_local_minimum(
        error(chi2), CRITERIA, any_trial=any_trial, parameter_at_limit=at_limit
    )
    assert found == elsewhere


@pytest.mark.parametrize(("useful", "least"), [(0.5, 0.0), (2.0, 1.0), (50.0, 5.0)])
def test_the_least_promise_of_a_structure(useful: float, least: float) -> None:
    assert judge.least_structural_promise(useful, 1.0, CRITERIA) == pytest.approx(least)


@pytest.mark.parametrize(
    ("chi2", "bandwidth", "left", "worth"),
    [
        (1.06, 0.0, 0.51, True),
        (1.06, 0.0, 0.49, False),
        (1.013, 0.0, 0.51, True),  # a bridge that yaws by 13 % of the largest one, beside a late laser
        (1.009, 0.0, 0.51, False),
        (1.109, 60.0, 0.51, False),  # with the widest observer, an exact machine leaves 1.1
        (1.111, 60.0, 0.51, True),
        (1.06, 30.0, 0.51, True),
    ],
)
def test_when_structures_are_worth_a_trial(chi2: float, bandwidth: float, left: float, worth: bool) -> None:
    present = error(chi2, bandwidth)
    floor = 1.1 if bandwidth == 60.0 else 1.0
    best = error(floor + left * (chi2 - floor), bandwidth)
    assert (
        judge.is_worth_structures(StructureEvidence(present, best, False, math.nan, math.inf), CRITERIA)
        == worth
    )


@pytest.mark.parametrize(
    ("chi2", "bandwidth", "remembers", "worth"),
    [
        (5.0, 0.0, False, True),
        (7.1, 0.0, False, False),  # from an excess of 9 at the last trial, two thirds are 6.03
        (7.1, 0.0, True, False),
        (7.1, 30.0, False, True),  # with another observer
    ],
)
def test_structures_are_tried_again_once_the_error_is_clearly_smaller(
    chi2: float, bandwidth: float, remembers: bool, worth: bool
) -> None:
    evidence = StructureEvidence(error(chi2, bandwidth), None, remembers, 0.0, 9.0)
    assert judge.is_worth_structures(evidence, CRITERIA) == worth


def test_friction_with_memory_is_tried_beside_a_force_with_memory() -> None:
    """A hysteresis may explain nearly all of the error that a bristle state of dry friction causes."""
    small = StructureEvidence(error(5.0, 60.0), error(1.2, 60.0), True, math.nan, math.inf)
    assert judge.is_worth_structures(small, CRITERIA)
    assert not judge.is_worth_structures(dataclasses.replace(small, best_remembers=False), CRITERIA)


@pytest.mark.parametrize(("chi2", "worth"), [(2.44, True), (2.46, False)])
def test_a_trial_must_reach_half_of_the_gain(chi2: float, worth: bool) -> None:
    assert judge.is_worth_convergence(error(2.9), error(chi2), 0.9, CRITERIA) == worth


@pytest.mark.parametrize(("other", "later"), [(51.0, True), (49.0, False), (0.0, False)])
def test_an_effect_at_a_limit_gives_way_unless_it_explains_twice_as_much(other: float, later: bool) -> None:
    assert judge.gives_way(100.0, other) == later


@pytest.mark.parametrize(
    ("chi2", "selected", "goes_on"), [(1.02, 0, True), (1.005, 0, False), (9.0, 4, True), (9.0, 5, False)]
)
def test_the_search_ends_at_the_noise_or_at_five_effects(chi2: float, selected: int, goes_on: bool) -> None:
    assert judge.search_goes_on(error(chi2), selected, CRITERIA) == goes_on


def test_an_error_as_small_as_noise_of_unknown_size_may_have_a_cause() -> None:
    assert judge.search_goes_on(error(0.6), 0, CRITERIA, noise_known=False)
    assert not judge.search_goes_on(error(0.6), 5, CRITERIA, noise_known=False)


@pytest.mark.parametrize(
    ("chi2", "selected", "worth"), [(10.0, 0, True), (1.49, 0, False), (10.0, 3, True), (10.0, 4, False)]
)
def test_pairs_are_searched_for_where_much_is_left(chi2: float, selected: int, worth: bool) -> None:
    assert judge.is_worth_searching_pairs(error(chi2), selected, CRITERIA) == worth


@pytest.mark.parametrize(
    ("chi2", "bandwidth", "worth"), [(1.4, 15.0, True), (1.6, 15.0, False), (1.4, 0.0, False)]
)
def test_rivals_are_compared_as_soon_as_the_model_nearly_explains(
    chi2: float, bandwidth: float, worth: bool
) -> None:
    """A wrong one of two rivals may be all that is left; narrower observers would be tried for nothing."""
    assert judge.is_worth_comparing_rivals(error(chi2, bandwidth), CRITERIA) == worth


@pytest.mark.parametrize(
    ("chi2", "bandwidth", "simulated", "worth"),
    [(1.49, 15.0, 1.51, True), (1.51, 15.0, 1.6, False), (1.4, 15.0, 1.49, False), (1.4, 0.0, 1.6, False)],
)
def test_narrower_observers_are_tried_while_the_model_nearly_explains(
    chi2: float, bandwidth: float, simulated: float, worth: bool
) -> None:
    assert judge.is_worth_narrower_observer(error(chi2, bandwidth), error(simulated), CRITERIA) == worth
