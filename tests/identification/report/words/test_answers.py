"""Tests of the sentences that state a verdict, and of the tone of what is left."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hframe_gym.cli.tables.identification import identification_table
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset
from hframe_gym.identification.report.content.document import Evaluation, Formula, TableOfFormulas
from hframe_gym.identification.report.content.result import Verdict
from hframe_gym.identification.report.words.answers import removed_by_effects
from hframe_gym.identification.report.words.remainder import (
    largest_position_error,
    missing_forces,
    tone_of_remainder,
)
from hframe_gym.identification.report.words.verdict import verdict_in_words
from hframe_gym.machine import BUILTIN_MACHINES, Sensor
from tests.identification.report.axis_results import effect_entry, report_with, result_of
from tests.identification.single_axis import AXIS, axis_result, axis_runs


def test_a_multiple_of_the_noise_over_all_channels_is_not_stated_as_that_of_one() -> None:
    errors = {c: {"rmse": 2e-5, "noise_ratio": 1.0, "percent_of_motion": 0.5} for c in ("x_m", "y_m")}

    def sentence(channels: tuple[str, ...]) -> str:
        held_out = {c: errors[c] for c in channels}
        return verdict_in_words(report_with(held_out, verdict="no_effect", left=1.0))

    both, one = sentence(("x_m", "y_m")), sentence(("x_m",))
    assert "is 1 times the sensors' noise (at most 20 µm rms at x_m). Left" in both
    assert both.endswith("Left on the held-out runs: 0.5 % of the motion of the channel where that is most.")
    assert "is 1 times the sensors' noise (20 µm rms at x_m). Left" in one
    assert one.endswith("Left on the held-out runs: 0.5 % of the motion.")


def test_a_channel_at_its_noise_does_not_stand_for_what_is_left() -> None:
    """The noise of a current is 1.02 % of its motion; at the position, 0.09 % of the motion are left."""
    errors = {
        "x_m": {"rmse": 7e-5, "noise_ratio": 19.5, "percent_of_motion": 0.09},
        "i_A": {"rmse": 0.08, "noise_ratio": 0.98, "percent_of_motion": 1.02},
    }
    report = report_with(errors, verdict="effect_found", left=11.4)
    assert tone_of_remainder(report) == "neutral"
    expected = (
        "Left on the held-out runs: 0.09 % of the motion of the channel above its noise where that is most."
    )
    assert verdict_in_words(report).endswith(expected)


def test_the_error_of_the_sentence_is_the_root_mean_square_over_the_channels() -> None:
    errors = {
        c: {"rmse": 1e-3, "noise_ratio": ratio} for c, ratio in (("x_m", 7.0), ("y_m", 1.0), ("z_m", None))
    }
    sentence = verdict_in_words(report_with(errors, verdict="no_effect", left=5.0))
    assert "error of the declared model on the held-out runs is 5 times the sensors' noise" in sentence
    assert "An error of at most 1 mm rms at x_m is left" in sentence


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
    assert largest_position_error(Evaluation.model_validate({"held_out": held_out})) == largest


@pytest.mark.parametrize(
    ("explained", "left", "slower"), [(-0.001, 50.0, True), (0.6, 50.0, False), (0.3, 1.5, False)]
)
def test_effects_that_remove_little_of_a_slow_error_are_said_to(
    explained: float, left: float, slower: bool
) -> None:
    sentences = removed_by_effects(report_with(explained=explained, left=left))
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
    assert tone_of_remainder(report_with(errors, verdict=verdict, left=left)) == tone


def test_the_verdict_begins_with_friction_that_the_file_does_not_declare(data: Dataset) -> None:
    smooth = AXIS.replace({"x.coulomb": 0.0})
    result = result_of(data, "unexplained", AXIS)
    result = dataclasses.replace(result, declared=dataclasses.replace(result.declared, machine=smooth))
    report = result.as_report()
    (friction,) = report.undeclared_friction
    assert (friction.parameter, friction.value) == ("x.coulomb", AXIS.parameters["x.coulomb"])
    start = f"The machine has friction that its file does not declare: x.coulomb is {friction.value:g}"
    assert verdict_in_words(report).startswith(start)
    assert "friction" not in verdict_in_words(result_of(data, "unexplained", AXIS).as_report())


def test_several_effects_are_separated_by_commas() -> None:
    errors = {"x_m": {"rmse": 1e-3, "noise_ratio": 50.0}}
    report = report_with(
        errors,
        verdict="effect_found",
        effects=[effect_entry("cogging", "motor1"), effect_entry("belt_play", "belts")],
        after={"held_out": {"x_m": {"rmse": 2e-5, "noise_ratio": 1.0}}},
    )
    assert verdict_in_words(report) == (
        "The machine has 2 effects that its model lacks: cogging at motor1, belt play at belts. "
        "With them, the error on the held-out runs falls from 50 to 1 times the sensors' noise "
        "(20 µm rms at x_m)."
    )


@pytest.mark.parametrize(
    ("held_out", "last"),
    [
        (
            {"x_m": 3.0, "phi": 3.0},
            "; with the proposed formula (magnetic catch) in place of the table, "
            "it is 3 times the sensors' noise.",
        ),
        ({"x_m": 4.9, "phi": 4.9}, ". A table has straight pieces and names no cause."),
        ({}, ". A table has straight pieces and names no cause."),  # the formula was not compared
    ],
)
def test_what_a_table_leaves_is_compared_with_the_formula(held_out: dict[str, float], last: str) -> None:
    formula = Formula(
        terms=["magnetic catch"],
        formula="",
        parameters={},
        complexity=3,
        curve_error=1.0,
        fitted=3.0,
        held_out=held_out,
        recommended=True,
    )
    better = formula.model_copy(
        update={"terms": ["periodic"], "held_out": {"x_m": 0.9}, "recommended": False}
    )
    name = "smooth_force[position of x]"
    table = TableOfFormulas(
        table=f"{name}@x", complexity=24, fitted=5.0, held_out={}, formulas=[formula, better]
    )
    report = report_with(
        {"x_m": {"rmse": 2e-5, "noise_ratio": 5.0}},
        verdict="effect_found",
        effects=[effect_entry(name, "x")],
        left=5.0,
        proposed_formulas=[table],
    )
    sentence = verdict_in_words(report)
    assert sentence.endswith(f" An error of 20 µm rms at x_m is left{last}")


def test_a_refit_that_worsens_the_simulation_is_compared_with_the_declared_machine() -> None:
    ratios = {"declared": 20.0, "before": 40.0, "after": 10.0}
    stages = {
        stage: {"held_out": {"x_m": {"rmse": 1e-3, "noise_ratio": ratio}}} for stage, ratio in ratios.items()
    }
    report = report_with(verdict="effect_found", effects=[effect_entry("cogging", "motor")], **stages)
    assert "falls from 40 (with the declared parameters: 20) to 10 times" in verdict_in_words(report)


@pytest.mark.parametrize(
    ("percent", "unit"), [(0.5, "times the sensors' noise"), (180.0, "% of the drives' force")]
)
def test_the_force_is_stated_only_if_the_simulation_drifts(percent: float, unit: str) -> None:
    """Real recordings have errors far beyond the noise of an encoder, but small ones of the motion."""
    channel = {"x_m": {"rmse": 1e-3, "noise_ratio": 600.0, "percent_of_motion": percent}}
    errors = {**channel, "force_error": 2.0}
    sentence = verdict_in_words(
        report_with(errors, left=600.0, plain={"held_out": errors, "delivered": True})
    )
    size = "" if "force" in unit else " (1 mm rms at x_m)"
    assert f"{unit}{size}, and no known effect explains it. A plain fit of inertia and friction" in sentence
    assert f"{unit}{size}, and is delivered." in sentence


@pytest.mark.parametrize(("left", "stated"), [(15.0, True), (165.0, False)])
def test_the_error_of_a_machine_that_describes_without_a_name_is_stated(left: float, stated: bool) -> None:
    before, after = (
        {"held_out": {"x_m": {"rmse": 1e-5 * ratio, "noise_ratio": ratio}}} for ratio in (165.0, left)
    )
    sentence = verdict_in_words(report_with(before=before, after=after, left=left))
    assert "The error of the refitted model on the held-out runs is 165 times" in sentence
    delivered = "leaves 15 times the sensors' noise (150 µm rms at x_m), but names no cause."
    assert (delivered in sentence) == stated


@pytest.mark.parametrize(("verdict", "sensors"), [("unexplained", ("x_m",)), ("effect_found", ())])
def test_a_description_does_not_hide_which_sensor_deviates(
    data: Dataset, verdict: Verdict, sensors: tuple[str, ...]
) -> None:
    """An error of the laser's interpolation describes the runs of another cause at the same place."""
    refitted, described = (SimpleNamespace(deviating_sensors=names) for names in (("x_m",), ()))
    result: Any = dataclasses.replace(
        result_of(data, verdict, AXIS), before=cast("Any", refitted), after=cast("Any", described)
    )
    assert result.deviating_sensors == sensors


@pytest.mark.parametrize("verdict", ["effect_found", "no_effect", "unexplained"])
def test_what_is_left_is_stated_also_if_errors_are_those_of_the_force(verdict: str) -> None:
    errors = {"x_m": {"rmse": 1.0, "noise_ratio": 900.0}, "force_error": 0.06}
    # in the order of the explained force
    shares = (("velocity of y", "y", 0.26), ("velocity of x", "x", 0.31))
    depends_on = [dict(zip(("variable", "coordinate", "share"), s, strict=True)) for s in shares]
    report = report_with(
        errors,
        verdict=verdict,
        effects=[effect_entry("cogging", "motor")],
        left=900.0,
        residual={"depends_on": depends_on, "white": False},
    )
    sentence = verdict_in_words(report)
    assert "6 % of the drives' force" in sentence
    assert ("lacks on y depends most on velocity of y, which explains 26 %" in sentence) == (
        verdict == "unexplained"
    )
    left = "An error of 900 times the sensors' noise (1 m rms at x_m) is left"
    assert (left in sentence) == (verdict != "unexplained")


@pytest.mark.parametrize(
    ("others", "last"),
    [(None, ""), (1.02, " On the other held-out runs, it is 1.02 times the sensors' noise.")],
)
@pytest.mark.parametrize("runs", [["run_4"], ["run_4", "run_8"]])
def test_an_error_of_a_run_that_contradicts_the_others_has_a_known_cause(
    runs: list[str], others: float | None, last: str
) -> None:
    report = report_with(
        {"x_m": {"rmse": 0.02, "noise_ratio": 900.0}},
        verdict="no_effect",
        left=900.0,
        contradicting=runs,
        left_in_others=others,
    )
    sentence = verdict_in_words(report)
    subject = "run_4 contradicts" if len(runs) == 1 else "run_4 and run_8 contradict"
    assert sentence.startswith("No effect was found")
    assert sentence.endswith(
        f" An error of 20 mm rms at x_m is left, because {subject} the fitted runs (see the warnings).{last}"
    )


def test_errors_of_force_are_given_for_all_machines_or_for_none() -> None:
    """A coordinate that an effect adds has no drive, so that the corrected machine has no force error."""
    frame = EFFECTS["frame_resonance"].at("x", f0=10.0, zeta=0.05, r=0.1, s=0.5)
    result = axis_result(axis_runs(AXIS, rows=400, volts=2.0), AXIS.with_effects(frame))
    assert result.before.held_out.force is not None
    assert result.after.held_out.force is None
    report = result.as_report()
    assert all(evaluation.force_error is None for evaluation in report.machines.values())
    assert "the error on the held-out runs rises from" in verdict_in_words(report)
    assert identification_table(report).row_count == 1


@pytest.mark.parametrize(
    ("evaluations", "texts"),
    [  # percent of the drives' force, and N; a force is no part of drives that hardly act
        (((8.6, 3.1), (0.3, 0.1)), ["8.6 %", "0.3 %"]),
        (((4e5, 12.0), (90.0, 0.002)), ["12 N", "0.002 N"]),
        (((None, 12.0), (None, None)), ["12 N", ""]),
        (((None, None), (0.3, None)), ["", "0.3 %"]),
        (((150.0, None),), ["150 %"]),  # a result of an older version
    ],
)
def test_the_missing_force_has_one_unit_for_all_machines(
    evaluations: tuple[tuple[float | None, float | None], ...], texts: list[str]
) -> None:
    entries = [
        Evaluation.model_validate(
            {
                "held_out": {},
                "missing_force_percent": part,
                "missing_force": force if force is None else {"value": force, "unit": "N"},
            }
        )
        for part, force in evaluations
    ]
    assert missing_forces(entries) == texts


def test_the_missing_force_in_newtons_is_that_part_of_the_force_of_the_drives() -> None:
    """Of a drive that follows set points, whose commands are no force, it is the only one."""
    result = axis_result(axis_runs(AXIS, rows=400, volts=2.0), AXIS)
    errors = dataclasses.replace(result.before.held_out, lacking=0.5)
    servo = BUILTIN_MACHINES["servo"]()
    evaluations = [dataclasses.replace(result.before, machine=m, held_out=errors) for m in (AXIS, servo)]
    report = dataclasses.replace(result, before=evaluations[0], declared=evaluations[1]).as_report()
    volts = np.concatenate([run.inputs[:, 0] for run in result.held_out.runs])
    assert report.before.missing_force_percent == pytest.approx(50.0)
    assert report.before.missing_force is not None
    assert report.before.missing_force.unit == "N"
    expected = 0.5 * AXIS.drives[0].gain * np.sqrt(np.mean(volts**2))
    assert report.before.missing_force.value == pytest.approx(expected)
    assert report.declared.missing_force_percent is None
    assert report.declared.missing_force is not None
    assert report.declared.missing_force.unit == "Nm"


def test_accelerations_alone_tell_no_missing_force() -> None:
    """An observer corrects no motion by them, so that its corrections' force is 0 whatever is missing."""
    result = axis_result(axis_runs(AXIS, rows=400, volts=2.0), AXIS)
    felt = AXIS.replace(sensors=(Sensor("x_m", {"x": 1.0}, kind="acceleration"),))
    errors = dataclasses.replace(result.before.held_out, lacking=0.0)
    felt_result = dataclasses.replace(result.before, machine=felt, held_out=errors)
    report = dataclasses.replace(result, declared=felt_result).as_report()
    assert missing_forces([report.declared]) == [""]


def test_a_slow_log_is_named_first() -> None:
    errors = {"x_m": {"rmse": 1e-3, "noise_ratio": 50.0}}
    unknown: dict[str, Any] = {
        "changes_per_row": 5,
        "period_s": 1e-3,
        "errors": {"x_m": 3e-5, "y_m": 2e-5, "phi1_rad": 2e-3},
        "fitted_by": "white residual",
    }

    def sentence_about(unknown: dict[str, Any] | None) -> str:
        return verdict_in_words(report_with(errors, unknown_voltages=unknown))

    sentence = sentence_about(unknown)
    assert sentence.startswith(
        "The controller changes the voltages about 5 times between two rows of this log (every 1 ms)"
    )
    assert (
        "even the exact machine is therefore expected to err by 30 µm at x_m and 2 mrad at phi1_rad"
        in sentence
    )
    assert "cannot be found" in sentence
    too_large = sentence_about(unknown | {"errors": {"x_m": 2e-3}})
    assert "2 mm at x_m (rms); the machine that is delivered leaves only 1 mm at x_m, so that" in too_large
    assert "cannot be found" not in too_large
    assert "log every row of the controller" in sentence
    assert "two rows" not in sentence_about(None)
    assert "describe the drives by their set point" in sentence
    of_set_points = sentence_about(unknown | {"commands": "set points"})
    assert of_set_points.startswith("The controller changes the set points about 5 times")
    assert "log every row of the controller (every 1 ms)." in of_set_points
    assert "fit by instruments" not in sentence
    assert "fit by instruments" in sentence_about(unknown | {"fitted_by": "instruments"})
    either = sentence_about(unknown | {"late_currents": ["motor_A"]})
    assert either.startswith("Either the controller changes the voltages about 5 times between two rows")
    assert "or motor_A was read after the voltage of its own row had been applied." in either
    assert "first identify without motor_A (hframe import --map motor_A=none)" in either


def test_a_slow_log_tells_which_effects_it_may_hide() -> None:
    """They are those that reduce the error of the held-out runs as well, the most helpful one first."""
    known: dict[str, Any] = {"period_s": 1e-3, "errors": {"x_m": 3e-5}, "fitted_by": "white residual"}
    reason = "reduces the error by no more than chance may"
    damping = {"name": "belt_damping", "site": "belts", "parameters": {"c": 8.9e-4}, "size": 0.0052}
    yaw = {"name": "bridge_yaw", "site": "machine", "parameters": {"J": 0.0958, "w": 0.279}, "size": None}
    gains = {"held_out_gain": 0.038, "reason": reason}, {"held_out_gain": 0.025, "reason": reason}
    useless = yaw | {"site": "other", "held_out_gain": -0.01, "reason": reason}

    def sentence_about(**fields: Any) -> str:
        report = report_with({"x_m": {"rmse": 1e-3, "noise_ratio": 50.0}}, verdict="no_effect", **fields)
        return verdict_in_words(report)

    considered = [useless, yaw | gains[1], damping | gains[0]]
    slow = {"unknown_voltages": known | {"changes_per_row": 5}, "considered": considered}
    sentence = sentence_about(left=27.0, **slow)
    assert "are there: belt damping at belts (c = 0.00089, 0.52 % of the drives' force); " in sentence
    assert sentence.endswith("bridge yaw at machine (J = 0.096, w = 0.28).")
    assert sentence_about(left=27.0, **(slow | {"considered": [useless]})).endswith(
        "The log may hide effects in this error, also one that changes the motion by as much as is left: "
        "1 mm rms at x_m."
    )
    found = report_with({}, verdict="effect_found", left=27.0, effects=[effect_entry("cogging", "x")], **slow)
    assert "The log may hide further effects in this error, also one" in verdict_in_words(found)
    assert "hide" not in sentence_about(left=1.0, **slow)
    assert "hide" not in sentence_about(left=27.0, considered=considered)


@pytest.mark.parametrize(("effect", "hidden"), [("cogging", True), ("input_delay", False)])
def test_a_slow_log_tells_which_delay_of_the_drives_passes_for_fewer_changes(
    effect: str, hidden: bool
) -> None:
    """Twice as many changes as three in a row of 8 ms act earlier by 8 ms / 12."""
    unknown = {
        "changes_per_row": 3,
        "period_s": 8e-3 / 3,
        "errors": {"x_m": 3e-5},
        "fitted_by": "instruments",
    }
    found = [effect_entry(effect, "drives")]
    sentence = verdict_in_words(report_with(verdict="effect_found", effects=found, unknown_voltages=unknown))
    assert ("A delay or lag of the drives of up to 0.67 ms may be missed" in sentence) == hidden
