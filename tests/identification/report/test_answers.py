"""Tests of the sentences that state a verdict, and of the tone of what is left."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from hframe_gym.cli.tables import identification_table
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset
from hframe_gym.identification.report.answers import (
    largest_position_error,
    removed_by_effects,
    tone_of_remainder,
    verdict_sentence,
)
from tests.identification.report.axis_results import result_of
from tests.identification.single_axis import AXIS, axis_result, axis_runs


def test_a_multiple_of_the_noise_over_all_channels_is_not_stated_as_that_of_one() -> None:
    errors = {c: {"rmse": 2e-5, "noise_ratio": 1.0, "percent_of_motion": 0.5} for c in ("x_m", "y_m")}

    def sentence(channels: tuple[str, ...]) -> str:
        held_out = {c: errors[c] for c in channels}
        stages = {stage: {"held_out": held_out} for stage in ("declared", "before", "after")}
        return verdict_sentence({"verdict": "no_effect", "effects": [], "left": 1.0, **stages}, channels)

    assert "20 µm rms at x_m; over all channels 1 times the sensors' noise; 0.5 %" in sentence(("x_m", "y_m"))
    assert "20 µm rms at x_m, 1 times the sensors' noise; 0.5 %" in sentence(("x_m",))


def test_the_error_of_the_sentence_is_the_root_mean_square_over_the_channels() -> None:
    errors = {
        c: {"rmse": 1e-3, "noise_ratio": ratio} for c, ratio in (("x_m", 7.0), ("y_m", 1.0), ("z_m", None))
    }
    report = {
        "verdict": "no_effect",
        "effects": [],
        "left": 5.0,
        **{stage: {"held_out": errors} for stage in ("declared", "before", "after")},
    }
    sentence = verdict_sentence(report, list(errors))
    assert "error of the declared model on the held-out runs is 5 times the sensors' noise" in sentence
    assert "An error of 5 times the sensors' noise (1 mm rms at x_m) is left" in sentence


@pytest.mark.parametrize(
    ("errors", "largest"),
    [
        ({"phi_rad": (0.0054, 11.8), "phi_rad_s": (0.159, 1.01)}, "5.4 mrad rms at phi_rad"),
        ({"phi_rad": (0.02, 40.0), "x_m": (1e-3, 2.0), "y_m": (2e-3, 1.0)}, "2 mm rms at y_m"),
        ({"v_m_s": (0.01, 9.0), "i_A": (0.2, 1.0)}, "0.01 m/s rms at v_m_s"),
    ],
)
def test_errors_in_different_units_are_not_compared(
    errors: dict[str, tuple[float, float]], largest: str
) -> None:
    held_out = {c: {"rmse": rmse, "noise_ratio": ratio} for c, (rmse, ratio) in errors.items()}
    assert largest_position_error(held_out) == largest


@pytest.mark.parametrize(
    ("explained", "left", "slower"), [(-0.001, 50.0, True), (0.6, 50.0, False), (0.3, 1.5, False)]
)
def test_effects_that_remove_little_of_a_slow_error_are_said_to(
    explained: float, left: float, slower: bool
) -> None:
    sentences = removed_by_effects({"explained": explained, "left": left})
    assert f"remove {100 * max(explained, 0.0):.3g} % of the squared error" in sentences[0]
    assert any("A slower cause that no effect explains" in text for text in sentences) == slower


@pytest.mark.parametrize(
    ("verdict", "left", "percent", "tone"),
    [
        ("effect_found", 1.1, 0.2, "good"),
        ("no_effect", 1.1, 0.2, "good"),
        ("no_effect", 1.1, 30.0, "warning"),  # the noise is a third of the motion
        ("effect_found", 3205.0, 0.4, "neutral"),
        ("effect_found", 3205.0, 12.0, "warning"),
        ("effect_found", 3205.0, None, "warning"),
        ("unexplained", 1.1, 0.2, "neutral"),
        ("unexplained", 900.0, 9.0, "warning"),
        ("no_effect", None, None, "warning"),  # diverges
    ],
)
def test_the_tone_of_the_page_is_that_of_what_is_left(
    verdict: str, left: float | None, percent: float | None, tone: str
) -> None:
    errors = {"x_m": {"rmse": 1e-3, "noise_ratio": left, "percent_of_motion": percent}, "force_error": 0.1}
    assert tone_of_remainder({"verdict": verdict, "left": left, "after": {"held_out": errors}}) == tone


def test_the_verdict_begins_with_friction_that_the_file_does_not_declare(data: Dataset) -> None:
    smooth = AXIS.replace({"x.coulomb": 0.0})
    result = result_of(data, "unexplained", AXIS)
    result = dataclasses.replace(result, declared=dataclasses.replace(result.declared, machine=smooth))
    report = result.as_json()
    (friction,) = report["undeclared_friction"]
    assert (friction["parameter"], friction["value"]) == ("x.coulomb", AXIS.parameters["x.coulomb"])
    start = f"The machine has friction that its file does not declare: x.coulomb is {friction['value']:g}"
    assert verdict_sentence(report, AXIS.output_channels).startswith(start)
    assert "friction" not in verdict_sentence(
        result_of(data, "unexplained", AXIS).as_json(), AXIS.output_channels
    )


def test_several_effects_are_separated_by_commas() -> None:
    errors = {"x_m": {"rmse": 1e-3, "noise_ratio": 50.0}}
    report = {
        "verdict": "effect_found",
        "effects": [{"name": "cogging", "site": "motor1"}, {"name": "belt_play", "site": "belts"}],
        "declared": {"held_out": errors},
        "before": {"held_out": errors},
        "after": {"held_out": {"x_m": {"rmse": 2e-5, "noise_ratio": 1.0}}},
    }
    assert verdict_sentence(report, ["x_m"]) == (
        "The machine has 2 effects that its model lacks: cogging at motor1, belt play at belts. With them, the error "
        "on the held-out runs falls from 50 to 1 times the sensors' noise."
    )


@pytest.mark.parametrize(
    ("held_out", "last"),
    [
        (
            {"x_m": 3.0, "phi": 3.0},
            "; with the proposed formula (magnetic catch) in place of the table, it is 3 times.",
        ),
        ({"x_m": 4.9, "phi": 4.9}, ". A table has straight pieces and names no cause."),
        ({}, ". A table has straight pieces and names no cause."),  # the formula was not compared
    ],
)
def test_what_a_table_leaves_is_compared_with_the_formula(held_out: dict[str, float], last: str) -> None:
    errors = {"held_out": {"x_m": {"rmse": 2e-5, "noise_ratio": 5.0}}}
    formula = {"terms": ["magnetic catch"], "held_out": held_out, "recommended": True}
    better = formula | {"terms": ["periodic"], "held_out": {"x_m": 0.9}, "recommended": False}
    report = {
        "verdict": "effect_found",
        "effects": [{"name": "smooth_force[position of x]", "site": "x"}],
        "left": 5.0,
        "proposed_formulas": [{"formulas": [formula, better]}],
    }
    sentence = verdict_sentence(report | dict.fromkeys(("declared", "before", "after"), errors), ["x_m"])
    assert sentence.endswith(f" An error of 5 times the sensors' noise (20 µm rms at x_m) is left{last}")


def test_a_refit_that_worsens_the_simulation_is_compared_with_the_declared_machine() -> None:
    ratios = {"declared": 20.0, "before": 40.0, "after": 10.0}
    stages = {
        stage: {"held_out": {"x_m": {"rmse": 1e-3, "noise_ratio": ratio}}} for stage, ratio in ratios.items()
    }
    report = {"verdict": "effect_found", "effects": [{"name": "cogging", "site": "motor"}], **stages}
    assert "falls from 40 (with the declared parameters: 20) to 10 times" in verdict_sentence(report, ["x_m"])


@pytest.mark.parametrize(
    ("percent", "unit"), [(0.5, "times the sensors' noise"), (180.0, "% of the drives' force")]
)
def test_the_force_is_stated_only_if_the_simulation_drifts(percent: float, unit: str) -> None:
    """Real recordings have errors far beyond the noise of an encoder, but small ones of the motion."""
    channel = {"x_m": {"rmse": 1e-3, "noise_ratio": 600.0, "percent_of_motion": percent}}
    errors = {"held_out": {**channel, "force_error": 2.0}}
    report = {"verdict": "unexplained", "effects": [], "left": 600.0, "residual": {"depends_on": []}}
    report |= dict.fromkeys(("declared", "before", "after"), errors) | {"plain": {"delivered": True}}
    sentence = verdict_sentence(report, ["x_m"])
    assert f"{unit}, and no known effect explains it. A plain fit of inertia and friction leaves" in sentence


@pytest.mark.parametrize("verdict", ["effect_found", "no_effect", "unexplained"])
def test_what_is_left_is_stated_also_if_errors_are_those_of_the_force(verdict: str) -> None:
    errors = {"held_out": {"x_m": {"rmse": 1.0, "noise_ratio": 900.0}, "force_error": 0.06}}
    report = {"verdict": verdict, "effects": [{"name": "cogging", "site": "motor"}], "left": 900.0}
    # in the order of the explained force
    shares = (
        ("velocity of y", "y", 0.26),
        ("velocity of x", "x", 0.31),
    )
    report["residual"] = {
        "depends_on": [dict(zip(("variable", "coordinate", "share"), s, strict=True)) for s in shares]
    }
    sentence = verdict_sentence(report | dict.fromkeys(("declared", "before", "after"), errors), ["x_m"])
    assert "6 % of the drives' force" in sentence
    assert ("lacks on y depends most on velocity of y, which explains 26 %" in sentence) == (
        verdict == "unexplained"
    )
    left = "An error of 900 times the sensors' noise (1 m rms at x_m) is left"
    assert (left in sentence) == (verdict != "unexplained")


@pytest.mark.parametrize(
    ("others", "last"), [(None, ""), (1.02, " On the other held-out runs, it is 1.02 times.")]
)
@pytest.mark.parametrize("runs", [["run_4"], ["run_4", "run_8"]])
def test_an_error_of_a_run_that_contradicts_the_others_has_a_known_cause(
    runs: list[str], others: float | None, last: str
) -> None:
    errors = {"held_out": {"x_m": {"rmse": 0.02, "noise_ratio": 900.0}}}
    report = {
        "verdict": "no_effect",
        "effects": [],
        "left": 900.0,
        "contradicting": runs,
        "left_in_others": others,
    }
    sentence = verdict_sentence(report | dict.fromkeys(("declared", "before", "after"), errors), ["x_m"])
    subject = "run_4 contradicts" if len(runs) == 1 else "run_4 and run_8 contradict"
    assert sentence.startswith("No effect was found")
    assert sentence.endswith(
        f" An error of 900 times the sensors' noise (20 mm rms at x_m) is left, because {subject} the fitted runs "
        f"(see the warnings).{last}"
    )


def test_errors_of_force_are_given_for_all_machines_or_for_none() -> None:
    """A coordinate that an effect adds has no drive, so that the corrected machine has no error of the force."""
    frame = EFFECTS["frame_resonance"].at("x", f0=10.0, zeta=0.05, r=0.1, s=0.5)
    result = axis_result(axis_runs(AXIS, rows=400, volts=2.0), AXIS.with_effects(frame))
    assert result.before.held_out.force is not None
    assert result.after.held_out.force is None
    report = result.as_json()
    assert all("force_error" not in report[stage]["held_out"] for stage in ("declared", "before", "after"))
    assert "the error on the held-out runs rises from" in verdict_sentence(report, AXIS.output_channels)
    assert identification_table(report, AXIS.output_channels).row_count == 1


def test_a_slow_log_is_named_first() -> None:
    errors = {"x_m": {"rmse": 1e-3, "noise_ratio": 50.0}}
    unknown: dict[str, Any] = {
        "changes_per_row": 5,
        "period_s": 1e-3,
        "errors": {"x_m": 3e-5, "y_m": 2e-5, "phi1_rad": 2e-3},
        "fitted_by": "white residual",
    }
    report = {
        "verdict": "unexplained",
        "effects": [],
        "unknown_voltages": unknown,
        "residual": {"depends_on": []},
    } | {stage: {"held_out": errors} for stage in ("declared", "before", "after")}
    sentence = verdict_sentence(report, ["x_m"])
    assert sentence.startswith(
        "The controller changes the voltages about 5 times between two rows of this log (every 1 ms)"
    )
    assert "errs by 30 µm at x_m and 2 mrad at phi1_rad (rms)" in sentence
    assert "log every row of the controller" in sentence
    assert "two rows" not in verdict_sentence(report | {"unknown_voltages": None}, ["x_m"])
    assert "describe the drives by their set point" in sentence
    of_set_points = verdict_sentence(
        report | {"unknown_voltages": unknown | {"commands": "set points"}}, ["x_m"]
    )
    assert of_set_points.startswith("The controller changes the set points about 5 times")
    assert "log every row of the controller (every 1 ms)." in of_set_points
    unknown["fitted_by"] = "instruments"
    assert "fit by instruments" not in sentence
    assert "fit by instruments" in verdict_sentence(report, ["x_m"])
