"""Tests of the runs that are left out."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.preparation.runs.left_out import copied_runs
from hframe_gym.recordings import Recording


@pytest.mark.parametrize(
    ("present", "kept", "copies"),
    [
        ("wabc", "", {"w": "contains a and 2 more runs, used in its place"}),
        ("wa", "", {"a": "is a part of w, the same in every row"}),  # most of the log is in no other run
        ("wab", "w", dict.fromkeys("ab", "is a part of w, the same in every row")),
        ("wa", "a", {"w": "contains a, used in its place"}),
        ("abd", "", {}),  # the same motion at other times
    ],
)
def test_of_a_log_that_is_there_whole_and_in_parts_the_parts_are_used(
    present: str, kept: str, copies: dict[str, str]
) -> None:
    time_s = np.arange(300) / 100.0
    values = np.random.default_rng(0).normal(size=(2, 300, 1))
    values[1, 100:110] = np.nan  # not measured
    rows = {"w": slice(0, 300), "a": slice(0, 100), "b": slice(100, 200), "c": slice(200, 300)}
    runs = {name: Recording(name, time_s[part], *values[:, part]) for name, part in rows.items()}
    runs["d"] = Recording("d", time_s[:50] + 0.5, *values[:, :50])
    assert copied_runs([runs[name] for name in present], kept) == copies
