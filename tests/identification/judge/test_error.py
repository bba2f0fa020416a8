"""Tables of errors and what they permit to decide: each limit from both sides."""

from __future__ import annotations

import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge.error import (
    FitError,
    explains,
    is_better_start,
    is_enough,
    only_noise_is_left,
    required_gain,
    unexplained_fraction,
    voltages_may_cause,
)

CRITERIA = SelectionCriteria()


def error(chi2: float, bandwidth: float = 0.0, count: float = 1e4) -> FitError:
    """Return the error of a fit; the widest observer has 60 rad/s, and an exact machine 1.1 with it."""
    widest = bandwidth == 60.0
    return FitError(chi2 * count, count, bandwidth, widest, 1.1 if widest else 1.0)


@pytest.mark.parametrize(
    ("chi2", "bandwidth", "expected"),
    [(1.02, 60.0, 0.01), (1.09, 0.0, 0.01), (1.19, 60.0, 0.01), (3.0, 0.0, 0.2), (3.1, 60.0, 0.2)],
)
def test_the_smallest_gain_is_a_fraction_of_the_excess(
    chi2: float, bandwidth: float, expected: float
) -> None:
    assert required_gain(error(chi2, bandwidth), CRITERIA) == pytest.approx(expected)


@pytest.mark.parametrize(("after", "enough"), [(1.99, True), (2.02, False), (float("nan"), True)])
def test_a_gain_is_compared_per_sample(after: float, enough: bool) -> None:
    """A reduction that is no number stays until another test rejects it, as the cost of a fit is finite."""
    assert is_enough(error(2.9), error(after), 0.9) == enough


@pytest.mark.parametrize(("chi2", "may_cause"), [(2.99, True), (3.01, False)])
def test_unknown_voltages_may_cause_four_times_the_excess(chi2: float, may_cause: bool) -> None:
    assert voltages_may_cause(error(chi2), CRITERIA) == may_cause


@pytest.mark.parametrize(
    ("chi2", "bandwidth", "simulated", "without_effects", "explained"),
    [
        (1.49, 0.0, 1.49, True, True),
        (1.51, 0.0, 1.51, True, False),
        (1.2, 30.0, 900.0, True, True),
        (1.2, 60.0, 900.0, True, False),  # the observer corrects a missing force of any size
        (1.06, 60.0, 1.6, True, True),  # the noise of a tachometer drifts; nothing is missing
        (1.2, 60.0, 4.1, True, False),
        (1.2, 60.0, float("nan"), True, False),  # the simulation diverges
        (1.2, 60.0, 900.0, False, True),
        (1.51, 60.0, 1.6, False, False),
    ],
)
def test_what_explains_the_data(
    chi2: float, bandwidth: float, simulated: float, without_effects: bool, explained: bool
) -> None:
    what = error(chi2, bandwidth)
    found = explains(what, CRITERIA, without_effects=without_effects, simulated=lambda: simulated)
    assert found == explained


@pytest.mark.parametrize(("chi2", "only_noise"), [(1.005, True), (1.02, False)])
def test_only_noise(chi2: float, only_noise: bool) -> None:
    assert only_noise_is_left(error(chi2), CRITERIA) == only_noise


@pytest.mark.parametrize(
    ("chi2", "bandwidth", "best", "fraction"),
    [
        (3.0, 0.0, 2.0, 0.5),
        (3.1, 60.0, 2.1, 0.5),  # with the widest observer, an exact machine leaves 1.1
        (3.0, 0.0, None, 1.0),
        (3.0, 0.0, 4.0, 1.0),  # at most 1
        (3.0, 0.0, 0.5, 0.0),
    ],
)
def test_the_unexplained_fraction(chi2: float, bandwidth: float, best: float | None, fraction: float) -> None:
    trial = None if best is None else error(best, bandwidth)
    assert unexplained_fraction(error(chi2, bandwidth), trial) == pytest.approx(fraction)


@pytest.mark.parametrize(
    ("predicted", "simulated", "better"),
    [
        ((0.83, 1.0), (9.0, 1.0), True),
        ((0.84, 1.0), (9.0, 1.0), False),
        ((0.99, 1.0), (0.49, 1.0), True),
        ((0.99, 1.0), (0.51, 1.0), False),
        ((1.01, 1.0), (0.1, 1.0), False),  # a better simulation by chance
        ((1e9, float("inf")), (1.0, float("inf")), True),
    ],
)
def test_a_refit_starts_from_clearly_better_values(
    predicted: tuple[float, float], simulated: tuple[float, float], better: bool
) -> None:
    assert is_better_start(predicted, simulated) == better
