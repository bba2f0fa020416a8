"""Tables of evidence about the machine that is delivered."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge import delivery as judge

CRITERIA = SelectionCriteria()


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
