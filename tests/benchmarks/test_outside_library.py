"""Test the scores of identifications of effects outside the library."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.outside_library import false_names, score_hint
from tests.rigs.outside_effects import FAMILIES, OutsideEffect


def effect(family: str, site: str) -> OutsideEffect:
    """Return an effect of a family at a site."""
    drawn = (FAMILIES[family](np.random.default_rng(seed)) for seed in range(50))
    return next(e for e in drawn if e.site == site)


def test_a_neighbor_is_acceptable_only_while_it_leaves_little() -> None:
    dwell = effect("dwell friction", "x")
    assert false_names(dwell, ["tustin_friction@x"], 100.0, 8.0) == []
    assert false_names(dwell, ["tustin_friction@x"], 100.0, 30.0) == []  # 9 % of the squared error
    assert false_names(dwell, ["tustin_friction@x"], 100.0, 40.0) == ["tustin_friction@x"]
    assert false_names(dwell, ["tustin_friction@y", "tustin_friction@x"], 100.0, 2.0) == ["tustin_friction@y"]


def test_a_table_over_the_right_variable_is_a_neighbor() -> None:
    rail = effect("bent rail", "x")
    names = ["smooth_friction[position of y]@x", "smooth_friction[position of x]@x"]
    assert false_names(rail, names, 50.0, 1.5) == names[1:]


@pytest.mark.parametrize(
    ("component", "variable", "scores"),
    [
        ("motor1", "heat of motor1", (True, True)),
        ("motor1", "position of phi1", (True, False)),
        ("motor2", "heat of motor2", (False, False)),
    ],
)
def test_hints_are_scored_by_component_and_variable(
    component: str, variable: str, scores: tuple[bool, bool]
) -> None:
    heat = effect("winding heat", "motor1")
    entry = {"component": component, "coordinate": "phi1", "variable": variable, "share": 0.5}
    hint = score_hint(heat, {"residual": {"depends_on": [entry]}}, [])
    assert (hint["right_component"], hint["right"]) == scores
    assert (
        score_hint(heat, {"residual": {"depends_on": []}, "hint": entry}, [])["right_component"] == scores[0]
    )


def test_a_rig_without_a_hint_is_wrong_unless_a_neighbor_is_named() -> None:
    ripple = effect("commutation ripple", "motor1")
    report = {"residual": {"depends_on": []}}
    assert not score_hint(ripple, report, [])["right"]
    assert score_hint(ripple, report, ["cogging@motor1"])["right"]
