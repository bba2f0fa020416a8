"""Tables of evidence about runs: which contradicts, what differs, which observers are accepted."""

from __future__ import annotations

import math

import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge import run as judge
from hframe_gym.identification.judge.error import FitError
from hframe_gym.identification.judge.held_out import HeldOutEffect
from hframe_gym.identification.judge.run import HeldOutRun

CRITERIA = SelectionCriteria()


@pytest.mark.parametrize(
    ("ratios", "name"),
    [
        ({"a": 100.0, "b": 0.01}, None),  # fewer than three runs
        ({"a": 4.0, "b": 0.5, "c": 0.5, "d": 0.5}, None),
        ({"a": 0.2, "b": 0.2, "c": 10.1, "d": 0.2}, "c"),
        ({"a": 0.2, "b": 0.2, "c": 9.9, "d": 0.2}, None),
        ({"a": 0.2, "b": 13.0, "c": 11.0, "d": 0.2}, "b"),
        ({"a": 0.2, "b": math.nan, "c": 11.0}, None),
        ({"a": 0.2, "b": 1.0, "c": math.inf}, "c"),
    ],
)
def test_a_run_with_ten_times_the_error_of_the_others_contradicts(
    ratios: dict[str, float], name: str | None
) -> None:
    assert judge.contradicting_run(ratios) == name


@pytest.mark.parametrize(
    ("chi2", "fitted", "gains", "contradicts"),
    [
        (9.9, 0.5, None, False),  # ten times the error of the fit, which counts as at least that of the noise
        (10.1, 0.5, None, True),
        (29.0, 3.0, None, False),
        (31.0, 3.0, None, True),
        (31.0, 3.0, (0.5, 0.2), True),
        (31.0, 3.0, (-0.9, 0.2), True),
        (31.0, 3.0, (-1.1, 0.2), False),  # all effects together cause the error
        (31.0, 3.0, (0.9, 0.2, -1.1), False),  # one effect does
    ],
)
def test_a_held_out_run_contradicts_unless_effects_cause_its_error(
    chi2: float, fitted: float, gains: tuple[float, ...] | None, contradicts: bool
) -> None:
    run = HeldOutRun(FitError(chi2 * 50, 50), fitted, None if gains is None else lambda: gains)
    assert judge.contradicts(run) == contradicts


@pytest.mark.parametrize(("gain", "shows"), [(0.89, False), (0.91, True), (-1.0, False)])
def test_a_run_of_whose_error_effects_remove_nearly_all_may_remove_effects(gain: float, shows: bool) -> None:
    assert judge.shows_effects(gain) == shows


@pytest.mark.parametrize(
    ("explained", "chi2", "used"), [(True, 1e6, True), (False, 99.0, True), (False, 101.0, False)]
)
def test_a_suspect_is_used_unless_it_spoils_everything(explained: bool, chi2: float, used: bool) -> None:
    """The others leave an error of 10; together with the suspect, more than ten times that is too much."""
    assert judge.uses_all_runs(10.0, explained, lambda: chi2) == used


@pytest.mark.parametrize(
    ("different", "chi2", "differs"),
    [("c", 2.38, True), ("c", 2.42, False), ("a", 2.0, False), (None, 2.0, False)],
)
def test_a_suspect_that_differs_in_a_parameter(different: str | None, chi2: float, differs: bool) -> None:
    assert judge.differs_in_a_parameter("c", different, chi2, 2.0) == differs


@pytest.mark.parametrize(("chi2", "explained"), [(1.64, True), (1.66, False)])
def test_values_of_their_own_explain_in_units_of_the_innovations(chi2: float, explained: bool) -> None:
    assert judge.explains_all_runs(chi2, 1.1, CRITERIA) == explained


@pytest.mark.parametrize(
    ("common", "by_run", "explained"),
    [
        (1.502, 1.496, False),  # little less than what does not count as explained (a random rig)
        (1.70, 1.61, True),
        (1.70, 1.65, False),  # a tenth of the excess over 1.1 is required
        (10.0, 1.66, False),
    ],
)
def test_values_of_their_own_must_reduce_the_error_as_an_effect_must(
    common: float, by_run: float, explained: bool
) -> None:
    of_all, of_each = (FitError(chi2 * 1e4, 1e4, 60.0, widest=True, floor=1.1) for chi2 in (common, by_run))
    assert judge.explains_by_run(of_each, of_all, CRITERIA) == explained


@pytest.mark.parametrize(
    ("amounts", "shared", "differ", "drift", "different"),
    [
        ([0.0, 0.1, 0.2, 0.3], 0.5, True, True, None),
        ([0.3, 0.2, 0.21, 0.0], 0.5, True, True, None),  # two are the same within a twentieth of the range
        ([0.0, 0.3, 0.1, 0.2], 0.5, True, False, None),
        ([0.0, 0.3, 0.0, 0.01], 0.0, True, False, "b"),
        ([0.0, 0.04, 0.0, 0.02], 0.5, False, False, None),  # a tenth of the mean
    ],
)
def test_how_a_quantity_differs_between_runs(
    amounts: list[float], shared: float, differ: bool, drift: bool, different: str | None
) -> None:
    assert judge.amounts_differ(amounts, shared) == differ
    assert judge.amounts_drift(amounts) == drift
    assert judge.different_run(dict(zip("abcd", amounts, strict=True))) == different


@pytest.mark.parametrize(
    ("ratio", "accepted"), [(1.9, True), (2.1, False), (math.nan, False), (math.inf, False)]
)
def test_observers_of_the_runs_must_not_double_the_simulation_error(ratio: float, accepted: bool) -> None:
    assert judge.accepts_run_observers(math.log(ratio)) == accepted


@pytest.mark.parametrize(
    ("differing", "held_out", "fitted", "exchanged"), [(2, 2, 6, True), (1, 2, 6, False), (2, 2, 2, False)]
)
def test_other_runs_are_held_out_if_all_contradict(
    differing: int, held_out: int, fitted: int, exchanged: bool
) -> None:
    assert judge.exchanges_held_out(differing, held_out, fitted) == exchanged


@pytest.mark.parametrize(
    ("effects", "confirmed"),
    [
        ([(0.9, True), (0.1, True)], True),
        ([(0.9, True), (0.0, False)], False),  # they may be present in the contradictory run alone
        ([(0.9, True), (-0.1, True)], False),
        ([], False),
    ],
)
def test_runs_held_out_in_exchange_confirm_the_effects_that_they_depend_on(
    effects: list[tuple[float, bool]], confirmed: bool
) -> None:
    assert judge.exchange_confirms([HeldOutEffect(*effect) for effect in effects]) == confirmed
