"""Test the scores of the identification benchmark."""

import pytest

from benchmarks.scoring import classify
from tests.rigs.cases import cases

RIGS = cases()


@pytest.mark.parametrize(
    ("rig", "verdict", "named", "score"),
    [
        ("none 1", "no_effect", [], "right"),
        ("none 1", "unexplained", [], "right"),
        ("none 1", "effect_found", ["constant_force@x"], "false alarm"),
        ("stribeck_friction@x full", "effect_found", ["stribeck_friction@x"], "right"),
        ("stribeck_friction@x full", "effect_found", ["stribeck_friction@y"], "wrong"),
        ("stribeck_friction@x full", "effect_found", ["stribeck_friction@x", "cogging@motor1"], "extra"),
        ("stribeck_friction@x full", "unexplained", [], "missed"),
        ("voltage_offset@motor1 full", "effect_found", ["constant_force@phi1"], "right"),
        ("gain_mismatch@motor2 full", "no_effect", [], "right"),
        ("gain_mismatch@motor2 full", "effect_found", ["constant_force@x"], "extra"),
        ("lugre@x full", "effect_found", ["presliding@x", "stribeck_friction@x"], "right"),
        ("lugre@x full", "effect_found", ["stribeck_friction@x"], "part"),
        ("stribeck_friction@x + input_delay@drives", "effect_found", ["input_delay@drives"], "part"),
        ("stribeck_friction@x + input_delay@drives", "effect_found", ["cogging@motor1"], "wrong"),
        ("magnetic catch", "effect_found", ["smooth_force[position of x]@x"], "right"),
        ("magnetic catch", "unexplained", [], "right"),
        ("magnetic catch", "no_effect", [], "missed"),
        ("magnetic catch", "effect_found", ["position_friction@x"], "wrong"),
    ],
)
def test_classify(rig, verdict, named, score):
    assert classify(RIGS[rig], verdict, named) == score
