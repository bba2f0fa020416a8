"""Tables of evidence about the verdict of a search in the fitted runs."""

from __future__ import annotations

import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge import verdict as judge
from hframe_gym.identification.judge.error import FitError
from hframe_gym.identification.judge.verdict import PartialEvidence, Verdict

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
    ("fitted", "left", "reason"),
    [
        (
            error(1.7),
            1.06,
            "chi-squared per sample is 1.7 with an observer of 60 rad/s, and up to 1.5 counts",
        ),
        (error(1.3), 1.06, "only predictions with an observer of 60 rad/s follow them"),
        (FitError(1.7e4, 1e4), 1.06, "chi-squared per sample is 1.7 in simulation"),
        (FitError(1.3e4, 1e4, 15.0), 1.06, ""),  # another reason, such as a parameter that differs by run
        (error(9.0), 5.0, ""),  # the error of the held-out runs says it
        (error(9.0), float("nan"), ""),
    ],
)
def test_an_unexplained_verdict_beside_explained_held_out_runs_has_a_reason(
    fitted: FitError, left: float, reason: str
) -> None:
    found = judge.fault_of_fitted_runs(fitted, left, CRITERIA)
    assert (reason in found) if reason else not found


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
    ("any_effect", "refitted_explains", "verdict"),
    [(True, True, "effect_found"), (False, True, "no_effect"), (False, False, "unexplained")],
)
def test_without_the_last_effect_the_refitted_machine_decides(
    any_effect: bool, refitted_explains: bool, verdict: Verdict
) -> None:
    assert judge.verdict_after_removal("effect_found", any_effect, refitted_explains) == verdict
