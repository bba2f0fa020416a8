"""Tables of evidence about tables of force and friction."""

from __future__ import annotations

import math

import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge import table as judge
from hframe_gym.identification.judge.error import FitError
from hframe_gym.identification.judge.table import TableEvidence

CRITERIA = SelectionCriteria()


def error(chi2: float) -> FitError:
    """Return the error of a fit to 10,000 values with the widest observer."""
    return FitError(chi2 * 1e4, 1e4, 60.0, widest=True, floor=1.1)


@pytest.mark.parametrize(
    ("ratio", "table", "knots"),
    [(0.39, True, True), (0.41, False, True), (1.01, False, False), (math.inf, False, False)],
)
def test_data_that_were_left_out_confirm_a_table_or_its_knots(ratio: float, table: bool, knots: bool) -> None:
    assert judge.confirms_table(ratio, CRITERIA) == table
    assert judge.confirms_knots(ratio) == knots


@pytest.mark.parametrize(("after", "moves"), [(1.90, True), (1.92, False)])
def test_knots_move_for_the_gain_of_an_effect(after: float, moves: bool) -> None:
    assert judge.moves_knots(error(2.0), error(after), CRITERIA) == moves


@pytest.mark.parametrize(
    ("explained", "excess", "refitted", "with_effects", "effects", "accepted"),
    [
        (True, 9.0, 10.0, 10.0, 0, True),
        (False, 0.99, 10.0, 10.0, 0, True),
        (False, 1.01, 10.0, 10.0, 0, False),
        (False, 0.99, 10.0, 5.0, 0, False),  # beside effects that leave 5, a tenth of that
        (False, 0.79, 10.0, 1.6, 2, True),  # half of what two effects leave
        (False, 0.81, 10.0, 1.6, 2, False),
        (False, 0.79, 10.0, 1.6, 1, False),  # one effect is no imitation of a curve
        (False, 0.79, 7.0, 1.6, 2, False),  # but more than a tenth of the refitted machine's
    ],
)
def test_a_table_is_accepted_if_it_explains_or_leaves_little(
    explained: bool, excess: float, refitted: float, with_effects: float, effects: int, accepted: bool
) -> None:
    evidence = TableEvidence(explained, excess, refitted, with_effects, effects)
    assert judge.accepts_table(evidence) == accepted


def test_a_table_need_not_remove_the_noise() -> None:
    """With the widest observer, noise alone leaves 1.1; a tenth of what exceeds that in 21.4 is 2.03."""
    excess = [error(chi2).excess for chi2 in (2.15, 126.8, 21.4)]
    assert judge.accepts_table(TableEvidence(False, *excess))
    assert not judge.accepts_table(TableEvidence(False, excess[0] + 1.1, *excess[1:]))


@pytest.mark.parametrize(("table", "curve"), [(0.9, True), (1.1, False)])
def test_a_table_shows_a_curve_that_effects_imitate_if_it_halves_the_error_of_the_simulation(
    table: float, curve: bool
) -> None:
    assert judge.is_one_curve(table, 2.0) == curve


@pytest.mark.parametrize(
    ("errors", "recommended"), [([1.09, 1.0], 0), ([1.1, 1.0], 1), ([3.0, 2.0, 1.9], 1), ([], None)]
)
def test_the_simplest_formula_that_is_as_good_as_the_best_is_recommended(
    errors: list[float], recommended: int | None
) -> None:
    assert judge.recommended_formula(errors) == recommended


@pytest.mark.parametrize(("formula", "better"), [(0.9, True), (0.92, False)])
def test_a_formula_is_better_than_its_table_from_a_sixth_of_the_squared_error(
    formula: float, better: bool
) -> None:
    assert judge.is_better_than_table(formula, 1.0) == better
