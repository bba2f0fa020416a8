"""Tables of evidence about the voltages between the rows of a log and in its gaps."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hframe_gym.identification import SelectionCriteria
from hframe_gym.identification.judge import voltages as judge
from hframe_gym.identification.judge.error import FitError

CRITERIA = SelectionCriteria()


@pytest.mark.parametrize(("successive", "possible"), [(0.0, False), (0.5, False), (0.9, True)])
def test_only_commands_that_change_row_after_row_may_change_between_the_rows(
    successive: float, possible: bool
) -> None:
    assert judge.may_change_between_rows(successive) == possible


@pytest.mark.parametrize(
    ("held", "interpolated", "are_held"),
    [
        ([1.0, 5.0], [3.0, 4.0], True),  # one controller: the runs together decide
        ([1.0, 5.0], [3.0, 2.0], False),
        ([1.0, 5.0], [1.0, 5.0], False),  # no command changed across a gap
        ([1.0, math.inf], [3.0, 4.0], False),
        ([1.0, 5.0], [3.0, math.nan], False),
    ],
)
def test_commands_are_held_over_gaps_if_that_predicts_the_motion_better(
    held: list[float], interpolated: list[float], are_held: bool
) -> None:
    assert judge.commands_are_held_over_gaps(np.array(held), np.array(interpolated)) == are_held


@pytest.mark.parametrize(
    ("held", "updated", "better", "change"),
    [
        (31.0, 25.9, 1.0, True),  # held voltages leave 1.2 times the error beyond the noise
        (31.0, 26.1, 1.0, False),
        (31.0, 25.9, 0.5, False),
        (31.0, 25.9, 0.6, True),
        (1.0, 0.999, 1.0, False),  # nothing is left to explain
        (1.1, 1.05, 1.0, True),
    ],
)
def test_voltages_change_between_rows_if_held_ones_leave_clearly_more_in_most_runs(
    held: float, updated: float, better: float, change: bool
) -> None:
    errors = (FitError(1e5 * chi2, 1e5, 60.0) for chi2 in (held, updated))
    assert judge.voltages_change_between_rows(judge.UpdatesEvidence(*errors, better), CRITERIA) == change


@pytest.mark.parametrize(
    ("delay", "deviation", "other"), [(0.03, 0.006, True), (-0.03, 0.006, True), (0.013, 0.006, False)]
)
def test_the_voltages_are_counted_again_where_they_act_clearly_earlier_or_later(
    delay: float, deviation: float, other: bool
) -> None:
    assert judge.voltages_change_at_another_rate(delay, deviation) is other


@pytest.mark.parametrize(
    ("present", "other", "more"),
    [(9.70, 9.40, False), (9.70, 8.80, True), (2.9, 2.905, True), (0.85, 0.87, False)],
)
def test_another_number_of_changes_leaves_clearly_less_where_effects_are_missing(
    present: float, other: float, more: bool
) -> None:
    errors = (FitError(1e5 * chi2, 1e5, 60.0, floor=1.08) for chi2 in (present, other))
    assert judge.another_rate_explains_more(*errors, CRITERIA) is more


@pytest.mark.parametrize(
    ("fewer", "delayed", "delays"),
    [
        (1.496, 1.326, True),  # two changes a row; a delay of 1.8 ms in rows of 4 ms
        (1.334, 1.326, False),  # fewer changes need no effect
        (5.0, 3.2, False),  # what is missing may move the delay
    ],
)
def test_drives_delay_voltages_where_fewer_changes_explain_less(
    fewer: float, delayed: float, delays: bool
) -> None:
    errors = (FitError(1e5 * chi2, 1e5, 60.0, floor=1.0) for chi2 in (fewer, delayed))
    assert judge.drives_delay_voltages(*errors, CRITERIA) is delays


@pytest.mark.parametrize(
    ("simulated", "suffices"),
    [((0.0, 0.4), True), ((0.0, 0.5), False), ((5.0, 0.1), False), ((np.nan,), False)],
)
def test_interpolation_suffices_where_its_errors_are_far_below_the_noise(
    simulated: tuple[float, ...], suffices: bool
) -> None:
    assert judge.interpolation_suffices(np.array(simulated)) == suffices


@pytest.mark.parametrize(
    ("held", "updated", "expected", "change"),
    [
        (1.675, 1.625, 1.158, True),  # 1 kHz of a controller at 2 kHz
        (6.73, 6.52, 1.177, False),  # likewise, but two effects are missing
        (1.44, 1.63, 1.16, False),  # every voltage is logged
        (3.72, 12.2, 42.6, False),  # likewise, of a multisine
    ],
)
def test_the_error_that_interpolation_adds_is_no_sign_of_held_voltages(
    held: float, updated: float, expected: float, change: bool
) -> None:
    """Two changes a row add to the error what the log lacks, and yet reduce it."""
    errors = (FitError(1e5 * held, 1e5, 60.0, floor=1.09), FitError(1e5 * updated, 1e5, 60.0, floor=expected))
    assert judge.voltages_change_between_rows(judge.UpdatesEvidence(*errors, 1.0), CRITERIA) == change
