"""Tests of messages about several runs."""

from __future__ import annotations

from hframe_gym.errors import merge_run_warnings, name_runs


def test_runs_are_named_in_short() -> None:
    assert name_runs(["a"]) == name_runs(["a", "a"]) == "a"
    assert name_runs(["a", "b", "c"]) == "a and 2 more runs"


def test_warnings_of_several_runs_are_merged() -> None:
    warnings = [
        ("a", "No laser."),
        ("b", "No laser."),
        ("a: 2", "Moved."),
        ("c", "No laser."),
        ("a", "No laser."),
    ]
    assert merge_run_warnings(warnings) == ("a and 2 more runs: No laser.", "a: 2: Moved.")
    assert merge_run_warnings(warnings[:3])[0] == "a and 1 more run: No laser."
