"""Tests of the page of a result."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.cli.tables.identification import identification_table
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, write_result
from hframe_gym.identification.fit.channel_errors import ChannelError
from hframe_gym.identification.propose.dependences import Dependence
from hframe_gym.identification.report.content.document import Hint
from hframe_gym.identification.report.content.result import Unfinished, Verdict
from hframe_gym.identification.report.content.saved_result import read_report
from hframe_gym.identification.report.diagnostics.experiment_design import FILE
from hframe_gym.identification.report.page import build_report
from hframe_gym.identification.report.words.rows import parameter_rows
from hframe_gym.identification.report.words.verdict import verdict_in_words
from hframe_gym.identification.validate.machine_errors import PredictionErrors
from hframe_gym.identification.validate.simpler_machines import PlainResult
from hframe_gym.machine import BUILTIN_MACHINES, Uncertainty
from hframe_gym.version import __version__
from tests.identification.report.axis_results import PLAN, STRIBECK, TABLE, page_of, result_of
from tests.identification.single_axis import AXIS


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


def test_a_parameter_without_unit_shows_none() -> None:
    servo = BUILTIN_MACHINES["servo"]()
    identified = servo.replace(
        uncertainty=Uncertainty(tuple(servo.parameters), np.eye(len(servo.parameters)))
    )
    units = {row.name: row.unit for row in parameter_rows(identified, servo)}
    assert "" in units.values()
    assert not {"1", "-"} & set(units.values())


@pytest.mark.usefixtures("without_drawing")
def test_the_proposed_experiment_is_written_and_an_old_one_is_removed(data: Dataset, tmp_path: Path) -> None:
    write_result(result_of(data, "effect_found", STRIBECK, PLAN), tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["next_experiment"]["separates"] == ["stribeck_friction@x", "presliding@x"]
    assert report["next_experiment"]["file"] == FILE
    assert (tmp_path / FILE).read_text().splitlines()[0] == "time_s,v_V"
    page = page_of(result_of(data, "effect_found", STRIBECK), tmp_path)
    assert not (tmp_path / FILE).exists()
    assert "Next experiment" not in page


@pytest.mark.usefixtures("without_drawing")
def test_an_effect_of_an_unfinished_search_is_not_stated_as_the_whole(data: Dataset, tmp_path: Path) -> None:
    result = result_of(data, "effect_found", STRIBECK)
    complete = page_of(result, tmp_path)
    assert "the search is not complete" not in complete
    assert "No other effect of the library explains these runs as well." in complete
    ended = Unfinished("trial fit 2 of 5: cogging@motor", "the budget of 60 s of processor time ended")
    page = page_of(dataclasses.replace(result, unfinished=ended), tmp_path)
    assert re.search(r"<strong>Missing effects found[^<]*; the search is not complete</strong>", page)
    assert "No other effect that was tried explains these runs as well." in page


@pytest.mark.usefixtures("without_drawing")
def test_the_page_states_that_no_experiment_distinguishes_rivals(data: Dataset, tmp_path: Path) -> None:
    result = result_of(data, "effect_found", STRIBECK, PLAN)
    report = result.as_json() | {"next_experiment": None}
    write_result(result, tmp_path)
    (tmp_path / "report.json").write_text(json.dumps(report))
    assert "No experiment is proposed" in build_report(tmp_path).read_text()


@pytest.mark.usefixtures("without_drawing")
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


@pytest.mark.usefixtures("without_drawing")
def test_an_effect_that_makes_held_out_runs_worse_is_called_so(data: Dataset, tmp_path: Path) -> None:
    page = page_of(result_of(data, "effect_found", STRIBECK, gain=-0.0914), tmp_path)
    assert "It increases the squared error of the held-out runs by 9.14 %." in page


@pytest.mark.usefixtures("without_drawing")
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


@pytest.mark.usefixtures("without_drawing")
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


def test_the_plain_fit_stands_beside_the_other_machines(data: Dataset, tmp_path: Path) -> None:
    result = result_of(data, "effect_found", STRIBECK)
    result = dataclasses.replace(result, plain=PlainResult(result.before, ("constant_force@x",)))
    page = page_of(result, tmp_path)
    assert (
        "The plain fit has inertia and friction from the recordings alone, with constant force at x" in page
    )
    assert '<th scope="col">plain fit</th>' in page
    assert '"label": "plain fit"' in page


@pytest.mark.usefixtures("without_drawing")
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


@pytest.mark.usefixtures("without_drawing")
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


@pytest.mark.usefixtures("without_drawing")
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
    sentence = verdict_in_words(read_report(tmp_path))
    assert "infinitely many (its simulation diverges) times the sensors' noise" in sentence
    assert np.isnan(dataclasses.replace(result_of(data, "effect_found", STRIBECK), before=diverged).explained)


@pytest.mark.usefixtures("without_drawing")
def test_an_unexplained_error_is_stated_in_the_users_terms_with_a_hint(data: Dataset, tmp_path: Path) -> None:
    """The missing force depends on the current of the motor; effects for a part of it are no names."""
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
        "The search is not complete: the budget of 60 s of processor time "
        "ended (trial fit 2 of 5: cogging@motor); what would have followed was not tried. A larger --budget",
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
    table = identification_table(read_report(tmp_path))
    assert list(table.columns[2].cells) == ["5 mm\n250 x\n2.1 %"]
    assert "0.37 %" in str(table.caption)
