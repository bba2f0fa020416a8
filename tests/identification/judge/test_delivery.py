"""Tables of evidence about the machine that is delivered."""

from __future__ import annotations

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


@pytest.mark.parametrize(
    ("ratio", "predicted", "helps"),
    [
        (0.91, None, True),
        (0.92, None, False),
        (0.09, 440.0, False),  # a pendulum above its axis: backlash that does not exist
        (0.09, 0.83, True),
        (0.92, 0.83, False),
    ],
)
def test_a_description_helps_where_the_error_says_something(
    ratio: float, predicted: float | None, helps: bool
) -> None:
    assert judge.description_helps(ratio, predicted) == helps


@pytest.mark.parametrize(
    ("explained", "contradicts_all", "decides"),
    [
        (True, True, False),  # a run with another gain
        (True, False, True),  # it agrees with the simpler machine
        (False, True, True),  # no machine is right anyway
    ],
)
def test_a_held_out_run_that_contradicts_all_machines_does_not_choose(
    explained: bool, contradicts_all: bool, decides: bool
) -> None:
    assert judge.held_out_run_decides(explained, contradicts_all=contradicts_all) == decides
