"""Tests of the result folder and of its page, for results of a single axis that are put together by hand."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.cli.tables import identification_table
from hframe_gym.controllers import TextbookPID
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS, get_effect
from hframe_gym.effects.smooth_table import KNOTS
from hframe_gym.identification import Dataset, IdentificationResult, write_result
from hframe_gym.identification.fit.channel_errors import ChannelError
from hframe_gym.identification.fit.missing_force import Dependence
from hframe_gym.identification.report.answers import (
    largest_position_error,
    removed_by_effects,
    tone_of_remainder,
    verdict_sentence,
)
from hframe_gym.identification.report.correlations import CONFIDENCE, correlation
from hframe_gym.identification.report.curves import page_curves, worst_first
from hframe_gym.identification.report.document import Hint, UnknownVoltages
from hframe_gym.identification.report.effect_curves import effect_curve
from hframe_gym.identification.report.error_dependence import error_panels
from hframe_gym.identification.report.experiment_design import FILE, ExperimentDesign
from hframe_gym.identification.report.instructions import next_steps
from hframe_gym.identification.report.page import build_report
from hframe_gym.identification.report.plot_data import plot_data
from hframe_gym.identification.report.plots import report_panels
from hframe_gym.identification.report.result import Unfinished, Verdict
from hframe_gym.identification.report.saved_result import load_result, next_command
from hframe_gym.identification.validate.machine_errors import PredictionErrors
from hframe_gym.identification.validate.simpler_machines import PlainResult
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Uncertainty
from hframe_gym.version import __version__
from hframe_gym.web_page import Panel, save_panels
from tests.identification.single_axis import AXIS, PRESLIDING, axis_result, axis_runs

STRIBECK = AXIS.with_effects(EFFECTS["stribeck_friction"].at("x", dF=0.8, vs=0.02))
CURVE = {f"k{i:02d}": 0.01 * i - 0.12 for i in range(KNOTS)} | {
    f"f{i:02d}": 0.1 * np.sin(i) for i in range(KNOTS)
}
TABLE = AXIS.with_effects(get_effect("smooth_force[position of x]").at("x", **CURVE))
PLAN = ExperimentDesign(
    ("stribeck_friction@x", "presliding@x"),
    np.arange(5) * 1e-3,
    np.zeros((5, 1)),
    sigma=40.0,
    rms=0.5,
    channel="x_m",
)


@pytest.fixture(scope="module")
def data() -> Dataset:
    """Return three runs of the axis with Stribeck friction, 0.5 s each. The data set is immutable."""
    return axis_runs(STRIBECK, rows=500, volts=2.0)


def result_of(
    data: Dataset, verdict: Verdict, after: Machine, plan: ExperimentDesign | None = None, gain: float = 0.97
) -> IdentificationResult:
    """Return a result with a corrected machine, evaluated on the last run."""
    names = ("x.mass", "x.viscous", *(f"{e.label}.{key}" for e in after.effects for key in e.parameters))
    after = after.replace(uncertainty=Uncertainty(names, 1e-6 * np.eye(len(names))))
    return axis_result(
        data,
        after,
        gain=gain,
        rivals=(PRESLIDING,) if plan else (),
        verdict=verdict,
        dependence=(Dependence("velocity of x", "x", 0.8),),
        experiment=plan,
    )


def page_of(result: IdentificationResult, folder: Path, warnings: tuple[str, ...] = ()) -> str:
    """Write a result and return its page."""
    write_result(result, folder, warnings)
    return build_report(folder).read_text()


def test_the_page_describes_an_effect(data: Dataset, tmp_path: Path) -> None:
    page = page_of(result_of(data, "effect_found", STRIBECK, PLAN), tmp_path, ("advice: run_0: odd",))
    for text in (
        "The machine has an effect that its model lacks: stribeck friction at x.",
        "F(v) = Fc + dF exp(-(v/vs)^2)",
        "dF = 0.8 ± 0.001 N",
        "It removes 97 % of the squared error",
        "cannot distinguish this effect from: presliding@x",
        "40 standard deviations",
        FILE,
        "advice: run_0: odd",
        "velocity of x",
    ):
        assert text in page
    assert "://" not in page  # self-contained
    assert {p.stem for p in (tmp_path / "plots").iterdir()} == {
        *("correlations", "coverage", "effects", "error_by_channel"),
        *("error_over_motion", "error_over_time", "residual_force"),
    }


def test_the_proposed_experiment_is_written_and_an_old_one_is_removed(data: Dataset, tmp_path: Path) -> None:
    write_result(result_of(data, "effect_found", STRIBECK, PLAN), tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["next_experiment"]["separates"] == ["stribeck_friction@x", "presliding@x"]
    assert report["next_experiment"]["file"] == FILE
    assert (tmp_path / FILE).read_text().splitlines()[0] == "time_s,v_V"
    page = page_of(result_of(data, "effect_found", STRIBECK), tmp_path)
    assert not (tmp_path / FILE).exists()
    assert "Next experiment" not in page


def test_what_is_written_is_read_again(data: Dataset, tmp_path: Path) -> None:
    """Both follow from one declaration, so that no field is lost on the way to the page."""
    unknown = UnknownVoltages(
        changes_per_row=4, period_s=1e-3, errors={"x_m": 1e-5}, fitted_by="white residual"
    )
    result = dataclasses.replace(result_of(data, "effect_found", STRIBECK, PLAN), unknown_voltages=unknown)
    write_result(result, tmp_path)
    written = json.loads((tmp_path / "report.json").read_text())
    assert written["unknown_voltages"] == unknown.as_json()
    assert_contains(load_result(tmp_path).report, written)


def assert_contains(read: Any, written: Any) -> None:
    """Compare everything that was written with what was read, which may have defaults beside it."""
    if isinstance(written, dict):
        assert written.keys() <= read.keys()
        for key, value in written.items():
            assert_contains(read[key], value)
    elif isinstance(written, list):
        for one, other in zip(read, written, strict=True):
            assert_contains(one, other)
    else:
        assert read == written


@pytest.mark.parametrize(
    ("sigma", "promise"), [(40.0, "by 40 standard"), (2.35e8, "clearly (by more than 100 standard")]
)
def test_the_proposed_experiment_promises_no_more_than_is_known(sigma: float, promise: str) -> None:
    why = dataclasses.replace(PLAN, sigma=sigma).why
    assert f"their predictions should differ {promise} deviations of the sensors' noise" in why
    assert "e+" not in why


@pytest.mark.parametrize(
    ("change", "commands"),
    [
        ({}, "voltages"),
        ({"kind": "duty-cycle"}, "duty cycles"),
        ({"kind": "current", "Ke": 0.0, "resistance": 1.0}, "currents"),
    ],
)
def test_the_proposed_experiment_names_what_is_commanded(
    data: Dataset, tmp_path: Path, change: dict[str, Any], commands: str
) -> None:
    write_result(result_of(data, "effect_found", STRIBECK, PLAN), tmp_path)
    saved = load_result(tmp_path)
    machine = saved.machine.replace(drives=(dataclasses.replace(saved.machine.drives[0], **change),))
    steps = next_steps(dataclasses.replace(saved, machine=machine), tmp_path, [], ["run_2"])
    assert any(f"Apply the {commands} of " in step["text"] for step in steps)


def test_an_effect_of_an_unfinished_search_is_not_stated_as_the_whole(data: Dataset, tmp_path: Path) -> None:
    result = result_of(data, "effect_found", STRIBECK)
    complete = page_of(result, tmp_path)
    assert "the search is not complete" not in complete
    assert "No other effect of the library explains these runs as well." in complete
    ended = Unfinished("trial fit 2 of 5: cogging@motor", "the budget of 60 s of processor time ended")
    page = page_of(dataclasses.replace(result, unfinished=ended), tmp_path)
    assert re.search(r"<strong>Missing effects found[^<]*; the search is not complete</strong>", page)
    assert "No other effect that was tried explains these runs as well." in page


def test_the_page_states_that_no_experiment_distinguishes_rivals(data: Dataset, tmp_path: Path) -> None:
    result = result_of(data, "effect_found", STRIBECK, PLAN)
    report = result.as_json() | {"next_experiment": None}
    write_result(result, tmp_path)
    (tmp_path / "report.json").write_text(json.dumps(report))
    assert "No experiment is proposed" in build_report(tmp_path).read_text()


def test_a_channel_that_was_not_measured_has_no_plot_over_time(data: Dataset) -> None:
    result = result_of(data, "no_effect", AXIS)
    curves = plot_data(result)
    assert len(report_panels(result.as_json(), curves, AXIS, AXIS)["error_over_time"]) == 1
    curves |= {"run_2/measured": np.full_like(curves["run_2/measured"], np.nan)}
    assert report_panels(result.as_json(), curves, AXIS, AXIS)["error_over_time"] == []


def test_the_page_states_that_no_recording_distinguishes_equivalent_causes(
    data: Dataset, tmp_path: Path
) -> None:
    result = result_of(data, "effect_found", AXIS.with_effects(EFFECTS["constant_force"].at("x", size=0.5)))
    equivalent, *others = [*EFFECTS["constant_force"].equivalent, "tilt@x"]
    sentence = f"No recording can distinguish constant force at x from {equivalent}."
    write_result(result, tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    for rivals in ([equivalent], [equivalent, *others]):
        report["effects"][0]["rivals"] = rivals
        (tmp_path / "report.json").write_text(json.dumps(report))
        steps = build_report(tmp_path).read_text().partition("What now")[2]
        assert (sentence in steps) == (rivals == [equivalent])
        assert ("No experiment is proposed" in steps) == (rivals != [equivalent])
        assert f"constant force at x from {rivals[-1]}." in steps


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


def test_an_effect_that_makes_held_out_runs_worse_is_called_so(data: Dataset, tmp_path: Path) -> None:
    page = page_of(result_of(data, "effect_found", STRIBECK, gain=-0.0914), tmp_path)
    assert "It increases the squared error of the held-out runs by 9.14 %." in page


@pytest.mark.parametrize(
    ("explained", "left", "slower"), [(-0.001, 50.0, True), (0.6, 50.0, False), (0.3, 1.5, False)]
)
def test_effects_that_remove_little_of_a_slow_error_are_said_to(
    explained: float, left: float, slower: bool
) -> None:
    sentences = removed_by_effects({"explained": explained, "left": left})
    assert f"remove {100 * max(explained, 0.0):.3g} % of the squared error" in sentences[0]
    assert any("A slower cause that no effect explains" in text for text in sentences) == slower


def test_curves_of_the_page_are_those_of_the_machines_worst_run_first(data: Dataset) -> None:
    result = result_of(data, "effect_found", STRIBECK)
    report, curves = result.as_json(), plot_data(result)
    noise = report["after"]["held_out"]["x_m"]["rmse"] / report["after"]["held_out"]["x_m"]["noise_ratio"]
    for name, factor in (("run_8", 1.0), ("run_9", 3.0)):  # two more runs, the second of which is the worst
        curves |= {
            f"{name}/{key}": curves[f"run_2/{key}"] for key in ("time_s", "measured", "declared", "before")
        }
        curves[f"{name}/after"] = factor * noise * np.ones((500, 1))
    report["runs"]["held_out"] = ["run_8", "run_9"]
    drawn = page_curves(report, curves, ["x_m"])
    assert [run["label"] for run in drawn["runs"]] == ["run_9: 3 × noise", "run_8: 1 × noise"]
    assert [machine["key"] for machine in drawn["machines"]] == ["declared", "before", "after"]
    (channel,) = drawn["runs"][0]["channels"]
    error = np.frombuffer(base64.b64decode(channel["errors"]["before"]), "<f4")
    assert error == pytest.approx(curves["run_9/before"][:, 0], rel=1e-6)
    curves["run_8/after"] = np.full((500, 1), np.nan)  # diverges
    assert worst_first(report, curves, ["x_m"]) == ["run_8", "run_9"]


def test_the_first_screen_answers_what_is_wrong_how_sure_how_much_is_left_on_which_run_and_what_now(
    data: Dataset, tmp_path: Path
) -> None:
    write_result(result_of(data, "effect_found", STRIBECK, PLAN), tmp_path)
    page = build_report(tmp_path).read_text()
    found = re.findall(r"<dt>([^<]*)</dt><dd>(.*?)</dd></div>", page, re.DOTALL)
    answered = {question: " ".join(text.split()) for question, text in found}
    for question, text in {
        "What is wrong": "The machine has an effect that its model lacks: stribeck friction at x.",
        "How sure": "These runs do not tell apart: stribeck friction at x (or presliding@x).",
        "How much is left": " µm rms at x_m, ",
        "On which run": "run_2: ",
        "What now": "identify again with it.",
    }.items():
        assert text in answered[question], question


def test_errors_over_position_and_speed_lie_in_the_region_of_white_noise_only_if_they_are(
    data: Dataset,
) -> None:
    result = result_of(data, "effect_found", STRIBECK)
    report, curves = result.as_json(), plot_data(result)
    noise, rng = data.noise[0], np.random.default_rng(0)
    measured = curves["run_2/measured"][:, 0]
    fractions = []
    for part in (0.0, 20.0):
        curves["run_2/after"] = (
            noise * rng.normal(size=len(measured)) + part * noise * measured / measured.max()
        )[:, None]
        over_position, over_speed = error_panels(report, curves, AXIS)
        assert "over speed of x" in over_speed.title
        match = re.search(r"outside the band: ([\d.]+) %", over_position.title)
        assert match is not None
        fractions.append(float(match[1]))
    assert fractions[0] < 10.0
    assert fractions[1] > 60.0


def test_a_long_curve_keeps_its_peaks_and_the_page_stays_small(data: Dataset) -> None:
    report = result_of(data, "effect_found", STRIBECK).as_json()
    report["plain"] = report["before"]
    report["runs"]["held_out"] = [f"run_{k}" for k in range(20)]
    time_s = 1e6 + 1e-3 * np.arange(100_000)
    errors = 1e-5 * np.sin(time_s)[:, None]
    errors[54_321] = 7e-3
    values = dict.fromkeys(("measured", "declared", "before", "after", "plain"), errors) | {"time_s": time_s}
    curves = {f"{run}/{key}": value for run in report["runs"]["held_out"] for key, value in values.items()}
    drawn = page_curves(report, curves, ["x_m"])
    assert [machine["label"] for machine in drawn["machines"]] == [
        "as declared",
        "plain fit",
        "refitted",
        "with effects",
    ]
    assert len(json.dumps(drawn)) < 2e6
    (channel,) = drawn["runs"][0]["channels"]
    error, times = (
        np.frombuffer(base64.b64decode(text), "<f4") for text in (channel["errors"]["after"], channel["time"])
    )
    assert times[np.argmax(error)] == pytest.approx(54.321, abs=1e-4)
    assert error.max() == pytest.approx(7e-3)


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


def test_an_effect_is_drawn_with_the_band_of_its_parameters(data: Dataset) -> None:
    """The level Fc + dF exp(-(v/vs)^2) has the variance of its linear terms; Fc and dF are anticorrelated."""
    curves = plot_data(result_of(data, "effect_found", STRIBECK))
    level = AXIS.coordinates[0].coulomb
    covariance = np.array([[0.04, -0.018, 0.0], [-0.018, 0.01, 0.0], [0.0, 0.0, 1e-6]])
    names = ("x.coulomb", "stribeck_friction@x.dF", "stribeck_friction@x.vs")
    machine = STRIBECK.replace(uncertainty=Uncertainty(names, covariance))
    curve = effect_curve(machine.effects[0], machine, curves)
    assert curve is not None
    assert (curve.variable, curve.quantity) == ("velocity of x, m/s", "dry friction on x, N")
    assert curve.x.max() == pytest.approx(min(8 * 0.02, np.abs(curves["coverage/velocity of x"]).max()))
    shape = np.exp(-((curve.x / 0.02) ** 2))
    assert curve.y == pytest.approx(np.sign(curve.x) * (level + 0.8 * shape))
    by_width = 0.8 * shape * 2 * curve.x**2 / 0.02**3
    variance = 0.04 + 0.01 * shape**2 - 2 * 0.018 * shape + 1e-6 * by_width**2
    assert curve.std == pytest.approx(np.sqrt(variance), rel=1e-3)
    report = result_of(data, "effect_found", machine).as_json()
    assert len(report_panels(report, curves, machine, AXIS)["effects"]) == 1
    assert not report_panels(report, curves, machine, declared=machine)["effects"]


def test_a_periodic_torque_is_drawn_over_its_periods_and_a_state_has_no_curve(data: Dataset) -> None:
    curves = plot_data(result_of(data, "effect_found", STRIBECK))
    stage = BUILTIN_MACHINES["hframe"]().with_effects(EFFECTS["cogging"].at("motor1", A=0.01, n=50.0, p=0.3))
    cogging = effect_curve(stage.effects[0], stage, curves)
    assert cogging is not None
    assert cogging.variable == "position of phi1, rad"
    assert cogging.x[-1] == pytest.approx(12 * 2 * np.pi / 50)
    assert cogging.y == pytest.approx(0.01 * np.sin(50 * cogging.x + 0.3))
    assert not cogging.std.any()  # not known
    assert effect_curve(PRESLIDING, AXIS.with_effects(PRESLIDING), curves) is None
    assert effect_curve(TABLE.effects[0], TABLE, curves) is None


def test_the_page_tells_where_the_result_comes_from(data: Dataset, tmp_path: Path) -> None:
    (tmp_path / "run_0.csv").write_text("time_s\n")
    write_result(result_of(data, "no_effect", AXIS), tmp_path / "out", files=[tmp_path / "run_0.csv"])
    made = json.loads((tmp_path / "out" / "report.json").read_text())["made"]
    digest = hashlib.sha256(b"time_s\n").hexdigest()
    assert set(made) == {"software", "time", "files"}  # no name of a user: pages are passed on
    assert made["files"] == [{"name": "run_0.csv", "bytes": 7, "sha256": digest}]
    foot = build_report(tmp_path / "out").read_text().partition("<footer>")[2]
    day, clock = made["time"][:10], made["time"][11:16]
    words = f"Identified on {day} at {clock} UTC with hframe_gym {__version__}, from 1 file."
    assert words in " ".join(foot.split())
    assert digest[:16] in foot


@pytest.mark.parametrize(
    ("variable", "text"),
    [
        (
            "velocity of x",
            "Record runs that isolate it: move x at six or more constant speeds in both directions",
        ),
        ("current of motor", "accelerate motor with voltages from small ones to the largest"),
        ("time", "begin cold, and repeat the same motion"),
        ("v_V", "move slowly and fast, one axis at a time, over the full travel"),
    ],
)
def test_the_run_to_record_follows_from_the_dependence(
    variable: str, text: str, data: Dataset, tmp_path: Path
) -> None:
    write_result(result_of(data, "unexplained", AXIS), tmp_path)
    saved = load_result(tmp_path)
    saved.report["residual"]["depends_on"][0]["variable"] = variable
    (step,) = next_steps(saved, tmp_path, (), ["run_2"])
    assert text in step["text"]
    assert step["command"].startswith("hframe identify RUNS --machine")


def test_a_counter_of_pulses_is_replaced_and_undeclared_friction_declared(
    data: Dataset, tmp_path: Path
) -> None:
    write_result(result_of(data, "unexplained", AXIS), tmp_path)
    saved = load_result(tmp_path)
    counter = dataclasses.replace(AXIS.sensors[0], channel="x_m_s", kind="unsigned-speed")
    saved = dataclasses.replace(saved, machine=AXIS.replace(sensors=(counter,)))
    saved.report["undeclared_friction"] = [
        {"parameter": "x.coulomb", "value": 3.0, "std": None, "unit": "N", "percent_of_drives": None}
    ]
    sensor, friction = next_steps(saved, tmp_path, (), ["run_2"])
    assert "Add a sensor that shows the direction" in sensor["text"]
    assert friction["text"] == "Declare the friction in declared.json: x.coulomb 3 N."


def test_the_steps_name_what_to_measure_and_a_controller_with_its_period(
    data: Dataset, tmp_path: Path
) -> None:
    write_result(result_of(data, "no_effect", AXIS), tmp_path, ("advice: odd",))
    saved = load_result(tmp_path)
    group = {
        "parameters": ["x.viscous", "motor.Ke"],
        "determined": [{"weights": {"x.viscous": 1.0, "motor.Ke": 5.0}}],
    }
    saved.report.update({"not_separable": [group], "left": 1.0})
    control, measure, findings = next_steps(saved, tmp_path, (), ["run_2"])
    assert "determine motor.Ke (take it from the data sheet of the motor, or turn" in measure["text"]
    assert "determine only x.viscous + 5 motor.Ke." in measure["text"]
    assert (
        "on the refitted machine, pid first, with a control period of 10 ms. A textbook PID"
        in control["text"]
    )
    assert control["command"].startswith("hframe evaluate pid")
    assert "Read the findings about the recordings (1)" in findings["text"]
    saved.report["left"] = 3205.0
    assert any(
        "Look at run_2, the run with the largest error" in s["text"]
        for s in next_steps(saved, tmp_path, (), ["run_2"])
    )


def test_the_period_of_a_textbook_controller_is_the_longest_one_that_is_stable(
    data: Dataset, tmp_path: Path
) -> None:
    stage = BUILTIN_MACHINES["hframe"]()
    periods = [p for p in (0.01, 0.005, 0.002, 0.001, 0.0005) if TextbookPID(stage, p).concern() is None]
    write_result(result_of(data, "no_effect", AXIS), tmp_path)
    saved = dataclasses.replace(load_result(tmp_path), machine=stage)
    saved.report["left"] = 1.0
    (step,) = next_steps(saved, tmp_path, (), ["run_2"])
    expected = {0.01: "is stable at this period as well", 0.005: "needs 5 ms or less", 0.002: "needs 2 ms or less",
                0.001: "needs 1 ms or less", 0.0005: "needs 0.5 ms or less"}  # fmt: skip
    assert f"A textbook PID {expected[periods[0]]}." in step["text"]


def test_white_noise_stays_in_the_region_and_a_late_response_does_not() -> None:
    rng = np.random.default_rng(1)
    noise, command = rng.normal(size=(2, 20_000))
    limit = CONFIDENCE / np.sqrt(20_000)
    outside = np.abs(correlation(command, noise, 400)) > limit
    assert 0.0 < outside.mean() < 0.03  # 1 % on average
    late = noise + 0.1 * np.concatenate([np.zeros(7), command[:-7]])
    assert np.argmax(correlation(command, late, 400)) == 7
    assert correlation(command, late, 400)[7] == pytest.approx(0.1, abs=0.02)
    assert correlation(noise, noise, 3)[0] == pytest.approx(1.0)
    assert not correlation(np.ones(100), noise[:100], 5).any()


def test_the_plain_fit_stands_beside_the_other_machines(data: Dataset, tmp_path: Path) -> None:
    result = result_of(data, "effect_found", STRIBECK)
    result = dataclasses.replace(result, plain=PlainResult(result.before, ("constant_force@x",)))
    page = page_of(result, tmp_path)
    assert (
        "The plain fit has inertia and friction from the recordings alone, with constant force at x" in page
    )
    assert '<th scope="col">plain fit</th>' in page
    assert '"label": "plain fit"' in page


def test_errors_by_run_are_those_of_the_machines(data: Dataset, tmp_path: Path) -> None:
    page = page_of(result_of(data, "effect_found", STRIBECK), tmp_path)
    run = data.with_runs(["run_2"]).runs[0]
    ratios = []
    for machine in (AXIS, STRIBECK):
        trajectory = simulate(machine, run.time_s, run.inputs, run.initial.state, longest_step=1e-4)
        error = run.outputs[:, 0] - trajectory.outputs[:, 0]
        ratios.append(float(np.sqrt(np.mean((error - error[25:50].mean()) ** 2)) / data.noise[0]))
    match = re.search(r"<td>([\d.e+]+) → ([\d.e+]+)</td>", page)
    assert match is not None
    before, after = map(float, match.groups())
    assert before == pytest.approx(ratios[0], rel=0.02)
    assert after == pytest.approx(ratios[1], rel=0.02)
    assert after < 1.1 < 5 < before


def test_the_page_lists_parameters_that_the_runs_do_not_separate(data: Dataset, tmp_path: Path) -> None:
    result = result_of(data, "no_effect", AXIS)
    machine = result.after.machine
    viscous, emf = AXIS.parameters["x.viscous"], AXIS.parameters["motor.Ke"]
    change = np.array([0.5 * viscous, -0.1 * emf])
    uncertainty = Uncertainty(("x.viscous", "motor.Ke"), np.outer(change, change) + 1e-12 * np.eye(2))
    result = dataclasses.replace(
        result, after=dataclasses.replace(result.after, machine=machine.replace(uncertainty=uncertainty))
    )
    page = page_of(result, tmp_path)
    weight = 5.0 * viscous / emf
    assert f"x.viscous, motor.Ke: x.viscous + {weight:.3g} motor.Ke = {6.0 * viscous:.5g} ±" in page
    (entry,) = json.loads((tmp_path / "report.json").read_text())["not_separable"]
    assert entry["parameters"] == ["x.viscous", "motor.Ke"]
    assert entry["determined"][0]["weights"] == pytest.approx({"x.viscous": 1.0, "motor.Ke": weight})


def test_a_table_is_drawn_and_named_as_a_table(data: Dataset, tmp_path: Path) -> None:
    page = page_of(result_of(data, "effect_found", TABLE), tmp_path)
    assert "smooth force[position of x] at x" in page
    assert "No formula of the library explains this" in page
    assert "@x.f07" not in page
    assert (tmp_path / "plots" / "tables.png").is_file()
    page_of(result_of(data, "no_effect", AXIS), tmp_path)
    assert not (tmp_path / "plots" / "tables.png").exists()


def test_a_description_is_drawn_without_a_name(data: Dataset, tmp_path: Path) -> None:
    """The delivered machine has an effect that is not named as a cause."""
    result = result_of(data, "unexplained", STRIBECK)
    page = page_of(dataclasses.replace(result, effects=()), tmp_path)
    assert "The machine describes a part of the remaining error" in page
    assert (tmp_path / "plots" / "effects.png").is_file()


@pytest.mark.parametrize(
    ("verdict", "text"),
    [
        ("no_effect", "No missing effect found"),
        ("unexplained", "The model lacks something that no known effect explains."),
    ],
)
def test_the_page_without_an_effect(verdict: Verdict, text: str, data: Dataset, tmp_path: Path) -> None:
    page = page_of(result_of(data, verdict, AXIS), tmp_path)
    assert text in page
    assert "No effect was identified." in page


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


def test_a_machine_that_diverges_has_no_error_but_a_cause(data: Dataset, tmp_path: Path) -> None:
    result = result_of(data, "no_effect", AXIS)
    none = dict.fromkeys(AXIS.output_channels, ChannelError(None, None))
    diverged = dataclasses.replace(
        result.before, held_out=PredictionErrors(none, result.before.held_out.force), diverged=("run_2",)
    )
    result = dataclasses.replace(result, declared=diverged, before=diverged)
    page = page_of(result, tmp_path)
    assert "∞ × noise" in page
    assert "The simulation of the declared machine diverges on run_2" in page
    assert "(amplifier limit, emergency stop, wrong scale)" in page
    assert "nan" not in page.replace("finance", "").lower().split("<body", 1)[1].split("<svg", 1)[0]
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["declared"]["held_out"]["x_m"] == {"rmse": None, "noise_ratio": None}
    sentence = verdict_sentence(report, ["x_m"])
    assert "infinitely many (its simulation diverges) times the sensors' noise" in sentence
    assert np.isnan(dataclasses.replace(result_of(data, "effect_found", STRIBECK), before=diverged).explained)


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


def test_what_is_left_without_the_runs_that_contradict_is_in_the_report(data: Dataset) -> None:
    result = result_of(data, "effect_found", STRIBECK)
    noise = data.noise[0]
    errors = {"run_1": np.full((5, 1), 3.0 * noise), "run_2": np.full((5, 1), 40.0 * noise)}
    result = dataclasses.replace(result, after=dataclasses.replace(result.after, errors=errors))
    one, all_runs = (
        dataclasses.replace(result, contradicting=names) for names in (("run_2",), ("run_1", "run_2"))
    )
    assert one.as_json()["contradicting"] == ["run_2"]
    assert one.as_json()["left_in_others"] == pytest.approx(3.0)
    assert all_runs.as_json()["left_in_others"] is None


def test_after_an_unexplained_error_comes_the_report_and_not_the_check_that_has_passed() -> None:
    assert next_command("unexplained", AXIS, Path("out/rig")) == "hframe report out/rig --open"
    assert next_command("no_effect", AXIS, Path("out/rig")).startswith(
        "hframe evaluate pid --machine out/rig/machine"
    )


def test_the_next_command_has_a_control_period_at_which_the_belts_can_be_damped() -> None:
    assert "--period" not in next_command("no_effect", BUILTIN_MACHINES["hframe"](), Path("out/rig"))
    command = next_command("no_effect", BUILTIN_MACHINES["corexy"](), Path("out/a rig"))
    words = shlex.split(command)
    assert words[words.index("--period") + 1] == "0.002"  # belts at 82 Hz
    assert words[-2:] == ["--out", str(Path("out/a rig/control"))]


def test_titles_in_picture_files_are_not_cut_off(tmp_path: Path) -> None:
    panel = Panel(
        "Force that the model lacks on carriage_x, against velocity of carriage_x", "", lambda axes: None, 2.8
    )
    save_panels([panel], tmp_path / "plot.svg")
    texts = re.findall(
        r"<text[^>]*>([^<]*)</text>|<tspan[^>]*>([^<]*)</tspan>", (tmp_path / "plot.svg").read_text()
    )
    title = [line for pair in texts for line in pair if re.search("[a-z]{2}", line)]
    assert " ".join(title) == panel.title
    assert max(map(len, title)) <= 44


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


def test_an_unexplained_error_is_stated_in_the_users_terms_with_a_hint(data: Dataset, tmp_path: Path) -> None:
    """The missing force depends on the current of the motor; effects that describe a part of it are no names."""
    result = result_of(data, "unexplained", AXIS)
    held_out = PredictionErrors({"x_m": ChannelError(5e-3, 250.0, 0.021)}, None, 0.0037)
    worse = dataclasses.replace(result.before, held_out=held_out)
    result = dataclasses.replace(
        result,
        before=worse,
        after=worse,
        dependence=(Dependence("current of motor", "x", 0.62),),
        hint=Hint(
            component="x",
            variable="current of motor",
            share=0.62,
            nearest=["current_limit@motor", "load_friction@motor"],
        ),
        reason="10 % of the squared error remain with the effects",
        unfinished=Unfinished(
            "trial fit 2 of 5: cogging@motor", "the budget of 60 s of processor time ended"
        ),
    )
    page = page_of(result, tmp_path)
    for text in (
        "5 mm rms at x_m, 250 times the sensors&#39; noise; 2.1 % of the motion",
        "a missing force of 0.37 % of that of the drives.",
        "No name is given: 10 % of the squared error remain with the effects.",
        "lacks on x depends most on current of motor, which explains 62 % of its variance.",
        "The nearest effects of the library, which are no causes: current_limit@motor, load_friction@motor.",
        "The search is not complete: the budget of 60 s of processor time ended (trial fit 2 of 5: cogging@motor).",
        "2.1 % of motion",
    ):
        assert text in page, text
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["hint"] == {
        "component": "x",
        "variable": "current of motor",
        "share": 0.62,
        "nearest": ["current_limit@motor", "load_friction@motor"],
    }
    (now, command) = re.search(r"<dt>What now</dt><dd>([^<]*)<pre[^>]*><code>([^<]*)</code>", page).groups()
    assert "The search ended early" in now
    assert command.endswith("--budget inf")
    assert report["before"]["missing_force_percent"] == pytest.approx(0.37)
    assert report["before"]["held_out"]["x_m"]["percent_of_motion"] == pytest.approx(2.1)
    table = identification_table(report, AXIS.output_channels)
    assert list(table.columns[2].cells) == ["5 mm\n(250x, 2.1 %)"]
    assert "0.37 %" in str(table.caption)


def test_the_next_command_is_one_that_the_machine_permits() -> None:
    """Controllers move a tool within a range; a machine without either can be simulated, but not evaluated."""
    (x,) = AXIS.coordinates
    boundless = AXIS.replace(coordinates=(dataclasses.replace(x, range=None),))
    assert next_command("effect_found", boundless, Path("out/rig")) == "hframe report out/rig --open"
    assert next_command("effect_found", AXIS, Path("out/rig")).startswith(
        "hframe evaluate pid --machine out/rig/"
    )


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
