"""Tests of messages about several runs and about names, and of the check of numbers."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from hframe_gym.errors import example_names, is_number, merge_run_warnings, name_runs


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


def test_an_unknown_name_is_answered_with_similar_names_or_the_first_ones() -> None:
    names = ("x.mass", "y.mass", "motor1.Kt", "motor2.Kt")
    assert example_names("motor3.Kt", names).startswith("names are, for example, motor2.Kt, motor1.Kt")
    assert example_names("?", names) == "names are, for example, x.mass, y.mass, motor1.Kt"


@pytest.mark.parametrize(
    ("value", "number"),
    [(1, True), (0.5, True), (np.float32(0.5), True), (np.int64(3), True), (Fraction(1, 3), True)]
    + [(value, False) for value in (True, "1", None, math.inf, math.nan, 1j, np.complex64(1.0), 10**400)],
)
def test_numbers_are_finite_and_real(value: object, number: bool) -> None:
    assert is_number(value) is number
