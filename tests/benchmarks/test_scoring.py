"""Test the scores of the identification benchmark."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.scoring import NameScore, classify, parameter_error, score_names
from tests.rigs.cases import cases
from tests.rigs.random_effects import DrawnEffect

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


def test_parameter_errors_and_what_is_counted_of_them_are_plain_data():
    case = RIGS["stribeck_friction@x full"]
    (hidden,) = case.hidden_effects
    true = case.true_parameters(hidden)
    estimated = {name: np.float64(1.1 * value) for name, value in true.items()}
    named = SimpleNamespace(effect=SimpleNamespace(label=hidden.label, parameters=estimated))
    errors = parameter_error(case, SimpleNamespace(effects=[named]))
    assert errors == pytest.approx({f"{hidden.label}.{name}": 0.1 for name in true if true[name]})
    assert json.dumps({"within": sum(error <= 0.2 for error in errors.values())})


def _effect(label, **fields):
    name, site = label.split("@")
    return DrawnEffect(name, site, 1.0, lambda rig, sensors: (rig, sensors), {}, {}, **fields)


@pytest.mark.parametrize(
    ("hidden", "verdict", "named", "identified", "extra"),
    [
        ([], "no_effect", {}, [], []),
        ([], "effect_found", {"cogging@motor1": []}, [], ["cogging@motor1"]),
        (["cogging@motor1"], "effect_found", {"cogging@motor1": []}, [True], []),
        (["cogging@motor1"], "effect_found", {"cogging@motor2": []}, [False], ["cogging@motor2"]),
        (["cogging@motor1"], "effect_found", {"position_friction@phi1": ["cogging@motor1"]}, [True], []),
        (["voltage_offset@motor2"], "effect_found", {"constant_force@phi2": []}, [True], []),
        (["friction_slope@x"], "effect_found", {"position_friction@x": []}, [True], []),
        (["electrical_lag@drives"], "effect_found", {"electrical_lag@drives": []}, [True], []),
        (
            ["electrical_lag@drives"],
            "effect_found",
            {"electrical_lag@motor1": [], "electrical_lag@motor2": []},
            [True],
            [],
        ),
        (["electrical_lag@drives"], "effect_found", {"electrical_lag@motor1": []}, [False], []),
        (
            ["electrical_lag@motor1"],
            "effect_found",
            {"electrical_lag@drives": []},
            [False],
            ["electrical_lag@drives"],
        ),
        (
            ["electrical_lag@drives"],
            "effect_found",
            {"input_delay@drives": []},
            [False],
            ["input_delay@drives"],
        ),
        (["input_delay@drives"], "effect_found", {"input_delay@drives": []}, [True], []),
        (["belt_damping@belts"], "effect_found", {"belt_damping@left": []}, [True], []),
        (["cogging@motor1", "belt_play@belts"], "effect_found", {"belt_play@belts": []}, [False, True], []),
    ],
)
def test_score_names(hidden, verdict, named, identified, extra):
    score = score_names([_effect(label) for label in hidden], verdict, named)
    assert list(score.identified) == identified
    assert list(score.extra) == extra


def test_score_of_effects_outside_the_library_and_of_absorbed_ones():
    catch = _effect("magnetic catch@x", accepted=("smooth_force[position of x]@x", ""))
    assert score_names([catch], "effect_found", {"smooth_force[position of x]@x": []}) == NameScore(
        (True,), ()
    )
    assert score_names([catch], "unexplained", {}) == NameScore((True,), ())
    assert score_names([catch], "no_effect", {}) == NameScore((False,), ())
    assert score_names([catch], "unexplained", {"cogging@motor1": []}) == NameScore(
        (False,), ("cogging@motor1",)
    )
    frame = _effect("frame resonance@x_m", accepted=("*mode*", ""))
    assert score_names([frame], "effect_found", {"added_mode@x_m": []}) == NameScore((True,), ())
    gain = _effect("gain_mismatch@motor1", absorbed=True)
    assert score_names([gain], "no_effect", {}) == NameScore((True,), ())


def test_a_table_that_describes_an_effect_off_the_librarys_form_identifies_it():
    """A constant force with a part that depends on the position is a force over the position."""
    table = "smooth_force[position of x]@x"
    force = _effect("constant_force@x", tables=(table,))
    assert score_names([force], "effect_found", {table: []}) == NameScore((True,), ())
    assert score_names([_effect("constant_force@x")], "effect_found", {table: []}).extra == (table,)
