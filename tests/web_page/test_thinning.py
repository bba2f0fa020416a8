"""Tests of the rows that remain of a long curve."""

from __future__ import annotations

import numpy as np

from hframe_gym.web_page import extreme_rows


def test_the_extremes_of_every_interval_and_curve_remain() -> None:
    first, second = np.zeros(1000), np.zeros(1000)
    first[123], first[777] = 5.0, -4.0
    second[456] = -3.0
    rows = extreme_rows([first, second], 10)
    assert {123, 456, 777} <= set(rows)
    assert len(rows) <= 40
    assert (np.diff(rows) > 0).all()


def test_a_gap_hides_no_extreme_and_one_that_fills_an_interval_remains() -> None:
    values = np.linspace(1.0, 2.0, 100)
    values[35:62] = np.nan
    rows = extreme_rows([values], 10)
    assert {30, 34, 40, 50, 62, 69} <= set(rows)
    assert set(np.flatnonzero(np.isnan(values))) & set(rows) == {40, 50}


def test_more_intervals_than_rows_keep_every_row() -> None:
    assert extreme_rows([np.array([2.0, 1.0, 3.0])], 10).tolist() == [0, 1, 2]
