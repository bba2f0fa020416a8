"""Tables of errors and what they permit to decide: each limit from both sides."""

from __future__ import annotations

import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge.error import (
    FitError,
    explains,
    is_enough,
    noise_floor,
    only_noise_is_left,
    required_gain,
    unexplained_fraction,
)

pytestmark = pytest.mark.unit
CRITERIA = SelectionCriteria()


def error(chi2: float, bandwidth: float = 0.0, count: float = 1e4) -> FitError:
    """Return the error of a fit; the widest observer has 60 rad/s."""
    return FitError(chi2 * count, count, bandwidth, bandwidth == 60.0)


@pytest.mark.parametrize(
    ("chi2", "bandwidth", "count", "expected"),
    [
        (1.02, 60.0, 1e6, CRITERIA.min_gain_one_step),
        (1.02, 30.0, 1e6, CRITERIA.min_gain_simulation),
        (1.02, 0.0, 1e6, CRITERIA.min_gain_simulation),
        (1.02, 0.0, 1e4, CRITERIA.min_total_gain / 1e4),
        (3.0, 0.0, 1e6, 2.0 * CRITERIA.min_gain_fraction),
    ],
)
def test_the_smallest_gain_follows_from_prediction_length_and_error(
    chi2: float, bandwidth: float, count: float, expected: float
) -> None:
    assert required_gain(error(chi2, bandwidth, count), CRITERIA) == pytest.approx(expected)


@pytest.mark.parametrize(("after", "enough"), [(1.99, True), (2.02, False), (float("nan"), True)])
def test_a_gain_is_compared_per_sample(after: float, enough: bool) -> None:
    """A reduction that is not a number stays until another test rejects it, as the cost of a fit is finite."""
    assert is_enough(error(2.9), error(after), 0.9) == enough


@pytest.mark.parametrize(
    ("chi2", "initial", "bandwidth", "without_effects", "explained"),
    [
        (1.49, 1.0, 0.0, True, True),
        (1.51, 1.0, 0.0, True, False),
        (1.9, 2e4, 0.0, True, True),  # a ten-thousandth of a large initial value
        (2.1, 2e4, 0.0, True, False),
        (1.2, 1.0, 30.0, True, True),
        (1.2, 1.0, 60.0, True, False),  # the observer corrects a missing force of any size
        (1.2, 1.0, 60.0, False, True),
    ],
)
def test_what_explains_the_data(
    chi2: float, initial: float, bandwidth: float, without_effects: bool, explained: bool
) -> None:
    assert explains(error(chi2, bandwidth), initial, CRITERIA, without_effects=without_effects) == explained


@pytest.mark.parametrize(("chi2", "only_noise"), [(1.005, True), (1.02, False)])
def test_only_noise(chi2: float, only_noise: bool) -> None:
    assert only_noise_is_left(error(chi2), CRITERIA) == only_noise


@pytest.mark.parametrize(
    ("chi2", "bandwidth", "best", "fraction"),
    [
        (3.0, 0.0, 2.0, 0.5),
        (3.1, 60.0, 2.1, 0.5),  # in one-step prediction a correct model reaches 1.1
        (3.0, 0.0, None, 1.0),
        (3.0, 0.0, 4.0, 1.0),  # at most 1
        (3.0, 0.0, 0.5, -0.25),
    ],
)
def test_the_unexplained_fraction(chi2: float, bandwidth: float, best: float | None, fraction: float) -> None:
    trial = None if best is None else error(best, bandwidth)
    assert unexplained_fraction(error(chi2, bandwidth), trial, CRITERIA) == pytest.approx(fraction)
    assert noise_floor(error(1.0, bandwidth), CRITERIA) == (1.1 if bandwidth else 1.0)
