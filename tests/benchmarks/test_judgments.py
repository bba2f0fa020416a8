"""Tests of recorded judgments: what is kept, what is unknown, and how other thresholds are tried."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from benchmarks.judgments import (
    Chosen,
    Judgment,
    Record,
    Threshold,
    as_bytes,
    changed,
    changed_judgments,
    from_bytes,
    recorded,
    thresholds,
)
from hframe_gym.identification import Fit, SelectionCriteria
from hframe_gym.identification.judge import error, observer, table
from hframe_gym.identification.judge.error import FitError
from hframe_gym.identification.search import model_search
from tests.identification.scripted_fits import fit_with

WITHOUT, WITH = FitError(3e4, 1e4), FitError(2.7e4, 1e4)


def record_of(judgments: list[Judgment]) -> Record:
    """Return a record, written and read again, so that nothing can be computed any more."""
    return from_bytes(as_bytes(Record("rig", "", "no_effect", {}, [], 0.0, judgments)))


def test_a_limit_that_another_rule_compares_is_computed_again() -> None:
    """The gain of 0.3 is enough for a tenth of the excess, which is 0.2, but not for a fifth."""
    with recorded() as judgments:
        enough = model_search.required_gain(WITHOUT, SelectionCriteria())
        assert model_search.is_enough(WITHOUT, WITH, enough)
    assert [j.rule for j in judgments] == ["required_gain", "is_enough"]
    assert model_search.is_enough is error.is_enough
    record = record_of(judgments)
    assert list(changed_judgments([record], {})) == []
    with changed(Threshold("min_gain_fraction"), 2.0) as changes:
        ((_, judgment, result),) = changed_judgments([record], changes)
    assert (judgment.rule, judgment.result, result) == ("is_enough", True, False)


def test_constants_are_changed_in_all_rules_that_use_them() -> None:
    evidence = table.TableEvidence(False, 0.99, 10.0, 10.0)
    with recorded() as judgments:
        assert table.accepts_table(evidence)
    record = record_of(judgments)
    with changed(Threshold("FAR", error), 2.0) as changes:
        assert len(list(changed_judgments([record], changes))) == 1
    assert table.FAR == error.FAR == 10.0


def test_numbers_that_no_rule_asked_for_are_unknown() -> None:
    fits = [fit_with(chi2=chi2) for chi2 in (3.0, 2.0, 2.5, 1.0, 9.0)]

    def narrowing() -> Iterator[tuple[Fit, float]]:
        yield from ((fitted, fitted.chi2) for fitted in fits[:4])

    with recorded() as judgments:
        assert observer.likeliest(narrowing(), (fits[4], 9.0)) is fits[1]
    (judgment,) = record_of(judgments).judgments
    assert judgment.again({}) == judgment.result == Chosen(1)  # a record holds no fits
    with pytest.raises(LookupError):  # the fourth loss was not asked for
        list(judgment.arguments[0][0])


def test_the_thresholds_are_the_fields_without_effort_and_the_constants_beside_rules() -> None:
    names = [threshold.name for threshold in thresholds()]
    assert {"explained_chi2", "FAR", "MIN_EXCITATION"} <= set(names)
    assert "max_effects" not in names  # it says how much the search tries
    assert len(names) == len(set(names)) <= 30
