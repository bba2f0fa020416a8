"""Tests of what the window does without a user interface: session, jobs, curves and drawings."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.app.jobs import Job, Progress
from hframe_gym.app.log_columns import thinned, view_log
from hframe_gym.app.server import serve
from hframe_gym.app.session import (
    ImportChoices,
    Session,
    command_text,
    evaluate_command,
    export_command,
    identify_command,
    import_command,
    new_machine_command,
)
from hframe_gym.app.stage_drawing import drawing_of, read_motions
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, stage_geometry
from hframe_gym.recordings import Interval, MappingOptions, parse_interval, save_machine
from tests.app.driver import foreign_logs


@pytest.fixture
def session(tmp_path: Path) -> Session:
    made = Session(tmp_path / "session")
    made.create()
    return made


def test_choices_of_an_import_become_options() -> None:
    choices = ImportChoices({"x_m": "Weg [mm]", "v_V": "#2"}, {"x_m": "mm"}, {"v_V": "0.5"})
    choices.intervals = [Interval("log", 0.5, 2.25)]
    assert command_text(import_command(choices)) == (
        "hframe import logs --machine machine.json --map 'x_m=Weg [mm]' "
        "--map 'v_V=#2' --unit x_m=mm --scale v_V=0.5 --cut log=0.5:2.25 --out runs"
    )
    rests = import_command(ImportChoices(split="rests", seconds=0.25))
    assert rests[-5:] == ["--split-at-rests", "--min-rest", "0.25", "--out", "runs"]


def test_other_commands() -> None:
    assert new_machine_command("axis", {"travel": "0.4", "mass": ""})[3:6] == ["axis", "--travel", "0.4"]
    chosen = {"sensor": ["speed@x", "current@motor"], "linear-sensor": False, "x.mass": "2"}
    assert new_machine_command("axis", chosen)[4:-3] == [
        "--sensor", "speed@x", "--sensor", "current@motor", "--no-linear-sensor", "--set", "x.mass=2"
    ]  # fmt: skip
    assert identify_command(["run_1"], " 20 ", True)[4:] == [
        "--hold-out",
        "run_1",
        "--budget",
        "20",
        "--force",
        "--out",
        "result",
    ]
    options: dict[str, Any] = {
        "task": "reach",
        "randomize": "none",
        "period": "",
        "episodes": 8,
        "motions": 2,
    }
    words = evaluate_command(["pid"], "machine.json", **options)
    assert "--period" not in words
    assert words[-1] == "control"
    assert evaluate_command(["pid"], "result/machine.json", **options)[-1] == "result/control"
    assert export_command("c", "machine.json", {"period": "0.002", "flat": ""}, ["pid"])[1:] == [
        "c", "pid", "--machine", "machine.json", "--period", "0.002", "--flat", "--out", "export/c",
    ]  # fmt: skip


def test_results_of_earlier_runs_are_set_aside_and_not_deleted(session: Session) -> None:
    assert session.aside_command("runs", "result") == []
    session.path("result").mkdir()
    session.path("result", "report.json").write_text("{}")
    (command,) = session.aside_command("runs", "result")
    assert command_text(command) == "mkdir earlier_1 && mv result earlier_1"
    session.set_aside(*command[1:])
    assert session.path("earlier_1", "result", "report.json").read_text() == "{}"
    session.path("result").mkdir()
    assert session.aside_command("result")[0][1] == "earlier_2"


@pytest.mark.parametrize("name", ["../../etc/passwd", "C:\\logs\\passwd"])
def test_a_dropped_log_stays_in_the_session(session: Session, name: str) -> None:
    assert session.log_path(name) == session.path("logs", "passwd")
    for wrong in ("..", "", "logs/", ".hidden"):
        with pytest.raises(InputError, match="not the name of a log"):
            session.log_path(wrong)


def test_a_faulty_machine_does_not_replace_the_machine(session: Session, tmp_path: Path) -> None:
    save_machine(BUILTIN_MACHINES["axis"](), tmp_path / "good.json")
    session.use_machine((tmp_path / "good.json").read_bytes())
    with pytest.raises(InputError, match=r"^machine\.json"):
        session.use_machine(b'{"schema": 1}')
    assert session.machine is not None
    assert session.machine.name == "axis"
    assert sorted(path.name for path in session.folder.iterdir()) == ["logs", "machine.json"]


@pytest.mark.integration
def test_a_job_runs_commands_until_one_fails_and_records_them(session: Session) -> None:
    good = new_machine_command("axis", {})
    bad = ["machines", "show", "missing.json"]
    job = Job(session, [good, bad, good])
    job.wait(120.0)
    assert job.exit_code == 2
    assert session.path("machine.json").exists()
    assert any("missing.json" in line for line in job.lines)
    script = session.path("commands.sh").read_text().splitlines()
    assert script[-2:] == [command_text(good), f"# exit code 2: {command_text(bad)}"]


def test_progress_keeps_each_error_once() -> None:
    progress = Progress()
    for spent, error in ((0.5, None), (1.0, 25.0), (2.0, 25.0), (3.0, 1.5)):
        progress.update({"doing": "trial fit", "spent": spent, "budget": 120.0, "error": error})
    assert progress.errors == [(1.0, 25.0), (3.0, 1.5)]
    assert (progress.doing, progress.spent, progress.total) == ("trial fit", 3.0, 120.0)


def test_a_thinned_curve_keeps_peaks_gaps_and_its_limits() -> None:
    time = np.arange(200_000) * 1e-3
    values = np.sin(time)
    values[123_456], values[77] = 50.0, -40.0
    values[50_000:60_000] = math.nan
    points = thinned(time, values, count=400)
    assert len(points) <= 400
    assert [time[123_456], 50.0] in points
    assert [time[77], -40.0] in points
    assert any(v is None for _, v in points)
    assert [t for t, _ in points] == sorted(t for t, _ in points)
    zoomed = thinned(time, values, 100.0, 100.05, count=400)
    assert len(zoomed) == pytest.approx(52, abs=2)
    short = thinned(time[:5], values[:5])
    assert short == [[t, v] for t, v in zip(time[:5].tolist(), values[:5].tolist(), strict=True)]


def test_columns_of_a_log_are_shown_as_what_the_import_takes_them_for(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(foreign_logs(1)["Messung_1.csv"])
    machine = BUILTIN_MACHINES["axis"]()
    incomplete = view_log(path, machine, MappingOptions())
    assert "no column is named like" in incomplete.problem
    assert [curve.note[:8] for curve in incomplete.curves] == ["not used"] * len(incomplete.curves)
    assert not incomplete.has_time
    view = view_log(path, machine, MappingOptions({"v_V": "Sollspannung", "x_m": "Weg"}))
    notes = {curve.name: curve.note for curve in view.curves}
    assert notes == {
        "Sollspannung [V]": "→ v_V",
        "Weg [mm]": "→ x_m (mm to m, drawn converted)",
        "Temperatur [°C]": "not used, degC",
    }
    position = next(curve for curve in view.curves if curve.name == "Weg [mm]")
    assert view.has_time
    assert position.time[-1] == pytest.approx(1.499)
    assert np.abs(position.values).max() < 0.5


@pytest.mark.parametrize("name", ["hframe", "corexy", "axis"])
def test_the_drawing_follows_the_tool(name: str) -> None:
    machine = BUILTIN_MACHINES[name]()
    drawing, geometry = drawing_of(machine), stage_geometry(machine)
    assert drawing is not None
    x, y = 0.07, 0.0 if name == "axis" else -0.04
    expected = [point for line in geometry.sections(x, y).values() for point in line] + list(
        geometry.pulleys(x, y)
    )
    drawn = [
        (a + b * x + c * y, d + e * x + f * y)
        for shape in drawing["shapes"]
        if shape["role"] in ("belt", "pulley", "motor")
        for a, b, c, d, e, f in shape["points"]
    ]
    assert np.allclose(drawn, expected, atol=1e-5)
    tool = next(shape for shape in drawing["shapes"] if shape["role"] == "tool")
    center = np.mean([(a + b * x + c * y, d + e * x + f * y) for a, b, c, d, e, f in tool["points"]], axis=0)
    assert np.allclose(center, (x, y))


def test_motions_have_as_many_frames_as_a_display_shows(tmp_path: Path) -> None:
    lines = ["episode,time_s,x_m,x_goal_m,v_V"]
    lines += [f"{e},{k * 1e-3},{k * 1e-4},0.1,{e}" for e in (0, 1) for k in range(101)]
    path = tmp_path / "pid.csv"
    path.write_text("\n".join(lines))
    motions = read_motions(path, BUILTIN_MACHINES["axis"]())
    assert [len(motion["tool"]) for motion in motions] == [11, 11]
    assert motions[0]["frame_s"] == pytest.approx(0.01)
    assert motions[0]["tool"][-1] == (0.01, 0.0)
    assert motions[1]["volts"][3] == [1.0]


def test_a_rotary_axis_is_an_arm_that_follows_the_angle(tmp_path: Path) -> None:
    motor = BUILTIN_MACHINES["motor"]()
    drawing = drawing_of(motor)
    assert drawing is not None
    arm = next(shape for shape in drawing["shapes"] if shape["role"] == "belt")
    end = arm["points"][1]
    assert end == [0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    lines = ["episode,time_s,shaft_rad,shaft_goal_rad,v_V"]
    lines += [f"0,{k * 1e-3},{k * 0.01},1.0,{k}" for k in range(101)]
    path = tmp_path / "pid.csv"
    path.write_text("\n".join(lines))
    (motion,) = read_motions(path, motor)
    assert motion["unit"] == "mrad"
    assert motion["distance"][0] == pytest.approx(1000.0)
    assert motion["tool"][-1] == pytest.approx((0.1 * np.cos(1.0), 0.1 * np.sin(1.0)))


@pytest.mark.parametrize("text", ["2", "a:3", "log=3:3", "4:2", "1:2:3", "nan:3"])
def test_an_interval_that_cannot_be_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--cut"):
        parse_interval(text)


def test_an_interval_may_name_its_log() -> None:
    assert parse_interval("2.5:10") == Interval("", 2.5, 10.0)
    assert parse_interval("run_01=-1:3e1") == Interval("run_01", -1.0, 30.0)


def test_without_the_extra_the_message_says_how_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "nicegui", None)
    with pytest.raises(ImportError, match=r"hframe_gym\[app\]"):
        serve(tmp_path / "session", 0, open_browser=False, log=print)
    assert not (tmp_path / "session").exists()


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("nicegui", reason="the extra app is not installed")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="must be the folder of a session"):
        serve(tmp_path / "file", 0, open_browser=False, log=print)
