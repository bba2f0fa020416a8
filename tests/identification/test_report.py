"""The folder and its page, from answers put together by hand on a single axis."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS, get_effect
from hframe_gym.effects.smooth_table import KNOTS
from hframe_gym.errors import InputError
from hframe_gym.identification import Dataset, IdentificationResult, SelectedEffect, prepare
from hframe_gym.identification.experiment_design import FILE, ExperimentDesign
from hframe_gym.identification.report import build_report
from hframe_gym.identification.residual import Dependence, channel_errors, force_error
from hframe_gym.identification.result import ModelEvaluation, PredictionErrors, Verdict
from hframe_gym.identification.result_output import write_answer
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Uncertainty
from hframe_gym.recordings import Recording

AXIS = BUILTIN_MACHINES["axis"]()
STRIBECK = AXIS.with_effects(EFFECTS["stribeck_friction"].at("x", dF=0.8, vs=0.02))
CURVE = {f"k{i:02d}": 0.01 * i - 0.12 for i in range(KNOTS)} | {f"f{i:02d}": 0.1 * np.sin(i) for i in range(KNOTS)}
TABLE = AXIS.with_effects(get_effect("smooth_force[position of x]").at("x", **CURVE))
PLAN = ExperimentDesign(
    ("stribeck_friction@x", "presliding@x"), np.arange(5) * 1e-3, np.zeros((5, 1)), sigma=40.0, rms=0.5, channel="x_m"
)


@pytest.fixture(scope="module")
def data() -> Dataset:
    """Three runs of the axis with Stribeck friction, 0.5 s each."""
    rng = np.random.default_rng(3)
    recordings = []
    for k in range(3):
        time_s = np.arange(500) * 1e-3
        inputs = np.repeat(rng.uniform(-2.0, 2.0, (10, 1)), 50, axis=0)
        inputs[:50] = 0.0
        outputs = simulate(STRIBECK, time_s, inputs).outputs + rng.normal(0.0, 20e-6, (500, 1))
        recordings.append(Recording(f"run_{k}", time_s, inputs, outputs))
    return prepare(recordings, AXIS)


def answer(
    data: Dataset, verdict: Verdict, after: Machine, plan: ExperimentDesign | None = None
) -> IdentificationResult:
    judge = data.only(["run_2"])
    names = ("x.mass", "x.viscous", *(f"{e.label}.{key}" for e in after.effects for key in e.parameters))
    after = after.replace(uncertainty=Uncertainty(names, 1e-6 * np.eye(len(names))))
    before, last = (
        ModelEvaluation(m, PredictionErrors(channel_errors(m, judge), force_error(m, judge))) for m in (AXIS, after)
    )
    rivals = ("presliding@x",) if plan else ()
    return IdentificationResult(
        verdict=verdict,
        declared=before,
        before=before,
        after=last,
        found=tuple(SelectedEffect(e, rivals, 1.0, AXIS) for e in after.effects),
        gains={e.label: 0.97 for e in after.effects},
        dependence=(Dependence("velocity of x", "x", 0.8),),
        white=True,
        fitted=data.only(["run_0", "run_1"]),
        held_out=judge,
        seconds=3.0,
        experiment=plan,
    )


def page_of(found: IdentificationResult, folder: Path, warnings: tuple[str, ...] = ()) -> str:
    write_answer(found, folder, warnings)
    return build_report(folder).read_text()


def test_the_page_of_an_effect(data: Dataset, tmp_path: Path) -> None:
    page = page_of(answer(data, "effect_found", STRIBECK, PLAN), tmp_path, ("advice: run_0: odd",))
    for said in (
        "stribeck friction at x",
        "F(v) = Fc + dF exp(-(v/vs)^2)",
        "dF = 0.8 ± 0.001 N",
        "Takes 97 % off",
        "do not tell it from presliding@x",
        "40 standard deviations",
        FILE,
        "advice: run_0: odd",
        "velocity of x",
    ):
        assert said in page
    assert "http" not in page
    assert {p.stem for p in (tmp_path / "plots").iterdir()} == {
        *("coverage", "error_by_channel", "error_over_time", "residual_force")
    }


def test_the_answer_is_a_file_and_so_is_the_experiment(data: Dataset, tmp_path: Path) -> None:
    page_of(answer(data, "effect_found", STRIBECK, PLAN), tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["next_experiment"]["separates"] == ["stribeck_friction@x", "presliding@x"]
    assert report["next_experiment"]["file"] == FILE
    assert (tmp_path / FILE).read_text().splitlines()[0] == "time_s,v_V"
    page = page_of(answer(data, "effect_found", STRIBECK), tmp_path)
    assert not (tmp_path / FILE).exists()
    assert "The next experiment" not in page


def test_rivals_that_no_run_tells_apart_are_said(data: Dataset, tmp_path: Path) -> None:
    found = answer(data, "effect_found", STRIBECK, PLAN)
    report = found.as_json() | {"next_experiment": None}
    write_answer(found, tmp_path)
    (tmp_path / "report.json").write_text(json.dumps(report))
    assert "None is proposed" in build_report(tmp_path).read_text()


def test_errors_by_run_are_those_of_the_machines(data: Dataset, tmp_path: Path) -> None:
    page = page_of(answer(data, "effect_found", STRIBECK), tmp_path)
    run = data.only(["run_2"]).runs[0]
    ratios = []
    for machine in (AXIS, STRIBECK):
        left = run.outputs[:, 0] - simulate(machine, run.time_s, run.inputs, run.start, longest_step=1e-4).outputs[:, 0]
        ratios.append(float(np.sqrt(np.mean((left - left[25:50].mean()) ** 2)) / data.noise[0]))
    before, after = (float(v) for v in re.search(r"<td>([\d.e+]+) → ([\d.e+]+)</td>", page).groups())  # type: ignore[union-attr]
    assert before == pytest.approx(ratios[0], rel=0.02)
    assert after == pytest.approx(ratios[1], rel=0.02)
    assert after < 1.1 < 5 < before


def test_a_table_is_drawn_and_named_as_what_it_is(data: Dataset, tmp_path: Path) -> None:
    page = page_of(answer(data, "effect_found", TABLE), tmp_path)
    assert "smooth force[position of x] at x" in page
    assert "No formula of the library explains this" in page
    assert "@x.f07" not in page
    assert (tmp_path / "plots" / "tables.png").is_file()
    page_of(answer(data, "no_effect", AXIS), tmp_path)
    assert not (tmp_path / "plots" / "tables.png").exists()


@pytest.mark.parametrize(
    ("verdict", "said"), [("no_effect", "Nothing is missing"), ("unexplained", "no known effect explains it")]
)
def test_without_an_effect(verdict: Verdict, said: str, data: Dataset, tmp_path: Path) -> None:
    page = page_of(answer(data, verdict, AXIS), tmp_path)
    assert said in page
    assert "No effect." in page


def test_a_folder_without_an_answer_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no report\.json here"):
        build_report(tmp_path)
