"""Tables of rivals: which are equally good, which replace an effect, which remain."""

from __future__ import annotations

import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge import rival as judge
from hframe_gym.identification.judge.chance import LongRunVariance, chance_gain
from hframe_gym.identification.judge.error import FitError
from hframe_gym.identification.judge.rival import RivalEvidence, TrialEvidence

CRITERIA = SelectionCriteria()


def test_the_margin_is_three_percent_of_the_gain() -> None:
    assert judge.equal_margin(FitError(2e4, 1e4), 1e4, CRITERIA) == pytest.approx(300.0)


def test_of_equally_good_trials_the_simplest_comes_first() -> None:
    trials = [(1.031, 1, False), (1.0, 5, False), (1.0, 3, True), (1.029, 3, False)]
    assert sorted(trials, key=lambda t: judge.preference(*t, limit=1.03)) == [
        (1.029, 3, False),
        (1.0, 3, True),  # needs a part that the machine may not have
        (1.0, 5, False),
        (1.031, 1, False),
    ]


@pytest.mark.parametrize(
    ("chi2", "selected", "other", "ratio", "possible"),
    [
        (1.212, 1.167, 1.168, 1.0, True),  # within 3 % of the gain, 0.00135
        (1.212, 1.167, 1.174, 1.0, False),  # more than chance causes in white noise, 24 / 36000
        (
            1.212,
            1.167,
            1.174,
            40.0,
            True,
        ),  # the eccentric pulley beside an eccentric encoder: chance causes 0.027
        (1.212, 1.167, 1.19, 40.0, False),  # within chance, but it explains less than half as much
        (3.0, 1.6, 1.75, 1e4, False),  # what is left may be that of missing effects
        (3.0, 1.6, 1.65, 1.0, True),  # of which it leaves about the same: excesses of 0.65 and 0.6
        (1.82, 1.8, 1.811, 1.0, False),  # about the same, but it explains less than half as much
        (3.0, 1.4, 1.45, 1e4, True),
    ],
)
def test_an_effect_that_was_tried_may_be_the_cause(
    chi2: float, selected: float, other: float, ratio: float, possible: bool
) -> None:
    without, with_effect = (FitError(each * 36_000, 36_000) for each in (chi2, selected))
    evidence = TrialEvidence(without, with_effect, other * 36_000, lambda: LongRunVariance(ratio))
    assert judge.may_be_the_cause(evidence, CRITERIA) == possible


def test_the_variance_is_not_computed_where_it_does_not_matter() -> None:
    def variance() -> LongRunVariance:
        raise AssertionError

    error = FitError(2e4, 1e4), FitError(1e4, 1e4)
    assert judge.may_be_the_cause(TrialEvidence(*error, 1.01e4, variance), CRITERIA)
    assert not judge.may_be_the_cause(TrialEvidence(*error, 1.6e4, variance), CRITERIA)


@pytest.mark.parametrize(
    ("loss", "known", "replaces", "remains"),
    [
        (1.5, True, True, True),
        (1.99, True, False, True),
        (2.01, True, False, True),
        (2.02, True, False, False),
        (2.02, False, False, True),  # a pair is compared with the larger of both margins, here 0.03
        (2.04, False, False, False),
        (1.965, True, True, True),
        (1.975, True, False, True),
    ],
)
def test_a_rival_replaces_the_effect_or_is_forgotten_by_its_likelihood(
    loss: float, known: bool, replaces: bool, remains: bool
) -> None:
    """Chance may explain a difference of 0.015 if the effect is right, of 0.03 if the rival is."""
    evidence = RivalEvidence(2.0, 0.015, loss, 0.03, known)
    assert judge.is_likelier(evidence, evidence.loss) == replaces
    assert not judge.is_likelier(evidence, loss)  # another rival is as likely
    assert judge.remains_rival(evidence) == remains


def test_what_chance_may_cause() -> None:
    variance = LongRunVariance(2.0, parameters=2)
    least = chance_gain(variance, CRITERIA)
    assert judge.chance_margin(variance, 1e4, CRITERIA) == pytest.approx(least / 1e4)
    assert judge.largest_resembling_loss(variance, CRITERIA) == pytest.approx(2.0 * least)
