"""Tables of evidence about machines along an unstable motion."""

from __future__ import annotations

import math

import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge import unstable_motion as judge
from hframe_gym.identification.judge.unstable_motion import UnstableMotion

CRITERIA = SelectionCriteria()


@pytest.mark.parametrize(
    ("enlarged", "unstable"), [(1.0, False), (2.0, False), (2.1, True), (math.inf, True)]
)
def test_a_motion_that_leaves_more_than_noise_of_noise_is_unstable(enlarged: float, unstable: bool) -> None:
    assert judge.is_unstable(enlarged, CRITERIA) == unstable


@pytest.mark.parametrize(
    ("left", "enlarged", "predicted", "explained"),
    [
        (1596.0, 1.85e4, 1.08, True),  # a geared motor that passes the tops of its cogging
        (111.0, 2.3e4, 0.97, True),  # a pendulum, swung above its axis
        (111.0, 2.3e4, 1.23, False),  # the same with Stribeck friction that the machine lacks
        (2.5e4, 290.0, 1.0, False),  # more than the instability explains
        (111.0, 2.3e4, math.inf, False),
        (math.nan, math.inf, 1.0, False),  # the simulation diverges
    ],
)
def test_predictions_tell_a_machine_along_an_unstable_motion(
    left: float, enlarged: float, predicted: float, explained: bool
) -> None:
    motion = UnstableMotion(enlarged, predicted)
    assert judge.explains_unstable_motion(left, motion, CRITERIA) == explained


def test_a_stable_motion_explains_no_error() -> None:
    assert not judge.explains_unstable_motion(2.1, None, CRITERIA)
