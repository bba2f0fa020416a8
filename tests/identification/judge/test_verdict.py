"""Tables of evidence about the verdict of a search in the fitted runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge import cause
from hframe_gym.identification.judge import verdict as judge
from hframe_gym.identification.judge.cause import CauseEvidence
from hframe_gym.identification.judge.error import FitError
from hframe_gym.identification.judge.verdict import DriftEvidence, PartialEvidence, Verdict

CRITERIA = SelectionCriteria()


def error(chi2: float) -> FitError:
    """Return the error of a fit to 10,000 values with the widest observer."""
    return FitError(chi2 * 1e4, 1e4, 60.0, widest=True, floor=1.1)


@pytest.mark.parametrize(
    ("wide", "simulated", "most"),
    [
        ((3.3, 10.0), (10.0, 10.0), True),  # three quarters of the excess over the 1.1 of a correct model
        ((3.4, 10.0), (10.0, 10.0), False),
        ((9.0, 10.0), (1.6, 10.9), True),  # or of the root mean square error in simulation
        ((9.0, 10.0), (1.7, 10.9), False),
        ((1.0, 1.0), (1.0, 1.0), False),
    ],
)
def test_effects_must_remove_three_quarters(
    wide: tuple[float, float], simulated: tuple[float, float], most: bool
) -> None:
    errors = error(wide[0]), error(wide[1])
    assert judge.explains_most(PartialEvidence(errors, simulated), CRITERIA) == most


@pytest.mark.parametrize(
    ("any_effect", "drift", "explained", "verdict", "reason"),
    [
        (True, "", True, "effect_found", ""),
        (False, "", True, "no_effect", ""),
        (True, "x.mass", True, "unexplained", "less well than another value of x.mass in each run"),
    ],
)
def test_the_verdict_on_effects_of_the_library(
    any_effect: bool, drift: str, explained: bool, verdict: Verdict, reason: str
) -> None:
    decided = judge.verdict_of_effects(any_effect, drift, lambda: explained)
    assert decided is not None
    assert decided[0] == verdict
    assert reason in decided[1]
    assert judge.verdict_of_effects(any_effect, "", lambda: False) is None


@pytest.mark.parametrize(
    ("any_effect", "runs_differ", "voltages", "wide", "verdict"),
    [
        (True, False, False, 3.3, "effect_found"),
        (True, False, False, 3.4, "unexplained"),
        (True, True, False, 3.3, "unexplained"),
        (False, False, False, 0.1, "unexplained"),
        (True, False, True, 9.9, "effect_found"),
        (True, True, True, 9.9, "unexplained"),
        (False, False, True, 9.9, "unexplained"),
    ],
)
def test_the_verdict_where_an_error_remains(
    any_effect: bool, runs_differ: bool, voltages: bool, wide: float, verdict: Verdict
) -> None:
    partial = PartialEvidence((error(wide), error(10.0)), (10.0, 10.0))
    decided, reason = judge.verdict_of_rest(
        any_effect, lambda: runs_differ, voltages, lambda: partial, CRITERIA
    )
    assert decided == verdict
    assert bool(reason) == (verdict == "unexplained")


@pytest.mark.parametrize(
    ("unknowns", "values", "explained", "by_run", "imitated"),
    [
        (2, 5, False, 1.2, True),
        (2, 5, False, 1.36, False),  # the difference is no better
        (2, 5, False, None, False),
        (2, 5, True, 1.2, False),  # the effect explains the runs in simulation
        (0, 5, False, 1.2, False),  # no effect over time
        (4, 1, False, 1.36, True),  # of two runs, an effect over time must be better
        (4, 1, False, 1.5, False),
        (4, 0, False, 1.2, False),  # a single run differs from no other
    ],
)
def test_an_effect_over_time_may_imitate_a_parameter_that_differs_from_run_to_run(
    unknowns: int, values: int, explained: bool, by_run: float | None, imitated: bool
) -> None:
    evidence = DriftEvidence(
        unknowns,
        values,
        lambda: explained,
        lambda: error(1.38),
        lambda: error(2.0),
        lambda: by_run and error(by_run),
    )
    assert judge.imitates_drift(evidence, CRITERIA) == imitated


@pytest.mark.parametrize(
    ("without", "imitated"),
    [
        (1.50, False),  # values in each run reduce the error less than an effect must (a random rig)
        (1.52, True),
        (None, False),
    ],
)
def test_values_in_each_run_that_explain_little_are_not_imitated(
    without: float | None, imitated: bool
) -> None:
    evidence = DriftEvidence(
        11, 8, lambda: False, lambda: error(1.466), lambda: without and error(without), lambda: error(1.472)
    )
    assert judge.imitates_drift(evidence, CRITERIA) == imitated


@pytest.mark.parametrize(
    ("any_effect", "refitted_explains", "verdict"),
    [(True, True, "effect_found"), (False, True, "no_effect"), (False, False, "unexplained")],
)
def test_without_the_last_effect_the_refitted_machine_decides(
    any_effect: bool, refitted_explains: bool, verdict: Verdict
) -> None:
    assert judge.verdict_after_removal("effect_found", any_effect, refitted_explains) == verdict


@pytest.mark.parametrize(
    ("explained", "certain", "fraction", "counts"),
    [(6.0, 1.0, 0.06, True), (4.0, 1.0, 0.06, False), (6.0, 1.0, 0.04, False), (6.0, -0.1, 0.06, False)],
)
def test_a_variable_is_a_cause_from_a_twentieth_on(
    explained: float, certain: float, fraction: float, counts: bool
) -> None:
    evidence = CauseEvidence(explained, certain, fraction, beyond_noise=100.0, plain=True)
    assert cause.is_cause(evidence) == counts


def test_a_special_variable_must_explain_clearly_more() -> None:
    plain, special = (CauseEvidence(50.0, 40.0, 0.5, 100.0, plain=plain) for plain in (True, False))
    assert cause.rank_of_cause(plain, 100.0) == pytest.approx(0.4)
    assert cause.rank_of_cause(special, 100.0) == pytest.approx(0.38)
    assert cause.beyond_noise(100.0, 20.0) == 80.0
    assert cause.beyond_noise(25.0, 20.0) == 10.0


@pytest.mark.parametrize(
    ("matches", "named"),
    [
        ([[True, False]], True),
        ([[False, True]], False),  # another cause leads
        ([[True, False], [False, True]], True),
        ([[True, False], [False, False]], False),
        ([[]], False),
        ([], False),
    ],
)
def test_effects_name_the_causes(matches: list[list[bool]], named: bool) -> None:
    assert cause.names_causes(matches) == named


@pytest.mark.parametrize(
    ("ratio", "left", "worse"),
    [
        (5.7, 3.0, True),
        (1.004, 3.0, False),  # chance
        (1.006, 3.0, True),
        (1.09, 1.9, False),  # what noise explains is hardly an error
        (1.1, 1.9, True),  # but the noise is the same for both
        (4.7, 1.05, False),  # an error below the noise counts as the noise
        (4.7, 1e-11, False),
        (0.0, 1.0, False),  # the simpler machine diverges
        (float("inf"), float("nan"), True),  # it diverges
    ],
)
def test_a_machine_that_leaves_more_than_noise_may_be_worse_than_the_plain_fit(
    ratio: float, left: float, worse: bool
) -> None:
    assert judge.is_worse_than(ratio, left, CRITERIA) == worse


NAN = float("nan")


@pytest.mark.parametrize(
    ("machine", "simpler", "prevail"),
    [
        (([[1.1]], [[1.2]]), ([[90.0]], [[900.0]]), True),  # cogging whose tops the motion passes
        (([[1.1]], [[1.2]]), ([[2.1]], [[2.3]]), False),  # not clearly more
        (([[1.6]], [[1.2]]), ([[90.0]], [[900.0]]), False),  # model error, as of real machines
        (([[0.2]], [[0.2]]), ([[1.4]], [[1.4]]), False),  # the noise is too large, and explains both
        (([[1.1]], [[40.0]]), ([[2.3]], [[20.0]]), False),  # the observer hides a slow force
        (
            ([[1.0], [1.6]], [[1.0], [1.6]]),
            ([[90.0], [90.0]], [[90.0], [90.0]]),
            False,
        ),  # one run is not explained
        (([[1.0], [1.1]], [[1.0], [1.1]]), ([[1.1], [90.0]], [[1.1], [90.0]]), True),
        (
            ([[1.6, 1.0, 1.0]], [[1.6, 1.0, 1.0]]),
            ([[90.0, 1.0, 1.0]], [[90.0, 1.0, 1.0]]),
            False,
        ),  # one sensor
        (([[1.1, NAN]], [[1.1, NAN]]), ([[90.0, NAN]], [[90.0, NAN]]), True),  # a sensor measures nothing
        (([[NAN]], [[NAN]]), ([[90.0]], [[90.0]]), False),
        (([[1.1]], [[1.1]]), ([[float("inf")]], [[float("inf")]]), True),  # the simpler machine diverges
        (([[float("inf")]], [[float("inf")]]), ([[90.0]], [[90.0]]), False),
    ],
)
def test_predictions_prevail_over_simulations_where_they_leave_no_doubt(
    machine: tuple[Any, Any], simpler: tuple[Any, Any], prevail: bool
) -> None:
    of_machine, of_simpler = (judge.PredictionsByRun(*map(np.array, chi2)) for chi2 in (machine, simpler))
    assert judge.predictions_prevail(of_machine, lambda: of_simpler, CRITERIA) == prevail


@pytest.mark.parametrize(
    ("lacking", "without", "contradicted"),
    [
        (0.36, 0.066, True),  # a cart under a relay: a swinging payload that does not exist
        (0.05, 0.066, False),
        (0.067, 0.066, False),  # equal
    ],
)
def test_effects_with_which_more_force_is_missing_are_contradicted(
    lacking: float, without: float, contradicted: bool
) -> None:
    assert judge.forces_contradict(lacking, without) == contradicted
