"""What chance explains: the quantiles of the F distribution."""

from __future__ import annotations

import math

import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge.chance import (
    LongRunVariance,
    chance_deviations,
    chance_gain,
    exceeds_chance,
)

CRITERIA = SelectionCriteria()


@pytest.mark.parametrize(
    ("variance", "gain"),
    [
        (
            LongRunVariance(1.0, 1, 10**7),
            23.93,
        ),  # chi-squared with one degree of freedom, at one in a million
        (LongRunVariance(1.0, 4, 10**7), 33.38),
        (LongRunVariance(7.0, 1, 10**7), 7 * 23.93),
        (LongRunVariance(1.0, 1, 24), 42.30),  # few blocks estimate a variance inaccurately
        (LongRunVariance(math.inf), math.inf),
    ],
)
def test_the_gain_that_chance_hardly_reaches(variance: LongRunVariance, gain: float) -> None:
    assert chance_gain(variance, CRITERIA) == pytest.approx(gain, rel=1e-3)
    assert exceeds_chance(1.01 * gain, variance, CRITERIA)
    assert math.isinf(gain) or not exceeds_chance(0.99 * gain, variance, CRITERIA)


def test_the_deviation_that_chance_hardly_reaches() -> None:
    assert chance_deviations(CRITERIA) ** 2 == pytest.approx(
        chance_gain(LongRunVariance(1.0, 1, 10**7), CRITERIA), rel=1e-3
    )
