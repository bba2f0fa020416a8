"""Tables of evidence about effects that may imitate a parameter which differs from run to run."""

from __future__ import annotations

import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge import drift as judge
from hframe_gym.identification.judge.drift import DriftEvidence
from hframe_gym.identification.judge.error import FitError

CRITERIA = SelectionCriteria()


def error(chi2: float) -> FitError:
    """Return the error of a fit to 10,000 values with the widest observer."""
    return FitError(chi2 * 1e4, 1e4, 60.0, widest=True, floor=1.1)


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
