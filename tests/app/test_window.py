"""Tests of the window `hframe app` in headless Chromium."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest

from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import load_machine, save_machine
from tests.app.driver import STAGES, Visitor, foreign_logs, newcomers_session, served, visitor_of
from tests.browser import SCHEMES, WIDTHS

pytest.importorskip("nicegui", reason="the extra app is not installed")
pytestmark = pytest.mark.integration

EXAMPLES = Path(__file__).parents[2] / "examples"

# What is wider than the display although it does not scroll by itself, and fields and buttons without a name.
_FAULTS = """
const width = document.documentElement.scrollWidth;
const wide = width > innerWidth ? ['the page is ' + width + ' wide'] : [];
const main = [...document.querySelectorAll('main[data-stage]')].find((e) => e.offsetParent);
const named = (e) => e.innerText || e.ariaLabel || e.title || e.closest('label') || e.closest('.q-uploader');
const buttons = [...main.querySelectorAll('button, input:not([type=file])')]
    .filter((e) => e.offsetParent && !named(e));
return [...wide, ...buttons.map((e) => 'no name: ' + e.outerHTML.slice(0, 200))];
"""


def faults_of(visitor: Visitor) -> list[str]:
    """Return what is wrong with the stage that is displayed, and messages of the console."""
    faults = list(visitor.driver.execute_script(_FAULTS))
    return faults + [f"console: {entry['message']}" for entry in visitor.driver.get_log("browser")]


def test_a_newcomer_gets_from_a_dropped_log_to_exports_and_can_repeat_it_by_script(tmp_path: Path) -> None:
    session = tmp_path / "session"
    with visitor_of(session) as visitor:
        began = time.monotonic()
        texts = newcomers_session(visitor)
        assert time.monotonic() - began < 300.0
        assert "Weg [mm]" in texts["dropped"]
        assert "Sollspannung [V]" in texts["dropped"]
        assert "Messung_4" in texts["logs"]
        assert "No faults" in texts["check"]
        assert "stribeck friction" in texts["results"].lower()
        assert "textbook-pid" in texts["control"]
        assert "export/fmu/stage.fmu" in texts["fmu"]
        faults = faults_of(visitor)
        # What is checked depends on the width; the scheme only changes colors.
        for width, scheme in zip(WIDTHS, SCHEMES, strict=True):
            visitor.look(width, scheme)
            for key in STAGES:
                visitor.go(key)
                faults += [f"{key}, {width}, {scheme}: {fault}" for fault in faults_of(visitor)]
        assert faults == []
    corrected = load_machine(session / "result" / "machine.json")
    assert [effect.label for effect in corrected.effects] == ["stribeck_friction@x"]
    assert corrected.effects[0].parameters["dF"] == pytest.approx(1.5, rel=0.02)
    commands = (session / "commands.sh").read_text().splitlines()
    assert [line.split()[1] for line in commands if line.startswith("hframe")] == [
        "machines", "import", "check", "identify", "evaluate", "export", "export",
    ]  # fmt: skip
    repeated = next(line for line in commands if line.startswith("hframe import"))
    assert "--unit x_m=mm" in repeated


def test_runs_are_cut_with_the_mouse_and_by_numbers_and_a_wrong_column_is_explained(tmp_path: Path) -> None:
    session = tmp_path / "session"
    (session / "logs").mkdir(parents=True)
    (session / "logs" / "one.csv").write_bytes(foreign_logs(1)["Messung_1.csv"])
    save_machine(BUILTIN_MACHINES["axis"](), session / "machine.json")
    with visitor_of(session) as visitor:
        visitor.look(1280, "light")
        visitor.go("logs")
        visitor.until("document.querySelectorAll('main[data-stage=logs] canvas').length > 0", 30.0)
        visitor.choose("[data-channel=x_m]", "Temperatur")
        visitor.until(
            "document.querySelector('main[data-stage=logs]').innerText.includes('Not yet complete')", 10.0
        )
        visitor.choose("[data-channel=x_m]", "Weg")
        visitor.click_text("[data-split] .q-radio", "keep the intervals")
        visitor.until("document.querySelector('[data-cut=add]')", 10.0)
        visitor.drag_over_chart(0.1, 0.5)
        visitor.until("document.querySelector('main[data-stage=logs]').innerText.includes('one: 0.')", 10.0)
        visitor.fill("[data-cut=from]", "0.9")
        visitor.fill("[data-cut=to]", "1.4")
        visitor.click("[data-cut=add]")
        visitor.until(
            "document.querySelector('main[data-stage=logs]').innerText.includes('one: 0.9 to 1.4 s')", 10.0
        )
        visitor.run("logs", 60.0)
    runs = sorted(path.name for path in (session / "runs").iterdir())
    assert runs == ["one_01.csv.gz", "one_02.csv.gz"]


def test_an_identification_that_is_stopped_keeps_the_best_machine(tmp_path: Path) -> None:
    session = tmp_path / "session"
    session.mkdir()
    shutil.copytree(EXAMPLES / "rig_a", session / "runs")
    save_machine(BUILTIN_MACHINES["hframe"](), session / "machine.json")
    with visitor_of(session) as visitor:
        visitor.look(390, "dark")
        visitor.go("identify")
        visitor.fill("[data-budget]", "100")
        visitor.until(
            "document.querySelector('main[data-stage=identify]').innerText.includes('--budget 100')", 10.0
        )
        visitor.click("[data-run=identify]")
        visitor.until(
            "document.querySelector('main[data-stage=identify]').innerText.includes('Error of the best')",
            120.0,
        )
        visitor.click_text("main[data-stage=identify] button", "Stop and keep the best")
        ended = "document.querySelector('main[data-stage=identify] .hf-details summary')?.innerText"
        visitor.until(f"/(done in|exit code) [\\d.]+/.test({ended})", 120.0)
    report = json.loads((session / "result" / "report.json").read_text())
    assert report["unfinished"]["reason"].startswith("interrupted")
    assert (session / "result" / "report.html").exists()


def test_stages_are_reached_and_commands_run_by_keyboard_alone(tmp_path: Path) -> None:
    keys = pytest.importorskip("selenium.webdriver.common.keys").Keys
    with visitor_of(tmp_path / "session") as visitor:
        visitor.look(1280, "light")
        visitor.tab_to("e.innerText?.startsWith('One axis')")
        visitor.press(keys.SPACE)
        visitor.until(
            "document.querySelector('main[data-stage=machine]').innerText.includes('--like axis')", 10.0
        )
        visitor.tab_to("e.closest('[data-option=travel]') || e.matches('[data-option=travel]')")
        visitor.press("0.4")
        visitor.tab_to("e.dataset.run === 'machine'")
        visitor.press(keys.ENTER)
        visitor.until(
            "/done in/.test(document.querySelector('main[data-stage=machine] summary')?.innerText)", 60.0
        )
        visitor.tab_to("e.matches('.q-tab')")
        visitor.press(keys.ARROW_RIGHT)
        visitor.press(keys.ENTER)
        visitor.until("document.querySelector('main[data-stage=logs]')?.offsetParent", 10.0)
    assert load_machine(tmp_path / "session" / "machine.json").coordinate("x").range == pytest.approx(
        (-0.2, 0.2)
    )


def test_a_machine_is_created_with_sensors_of_what_the_log_has(tmp_path: Path) -> None:
    stage = "document.querySelector('main[data-stage=machine]').innerText"
    with visitor_of(tmp_path / "session") as visitor:
        visitor.look(1280, "light")
        visitor.click_text("main[data-stage=machine] .q-radio", "One axis")
        visitor.until(f"{stage}.includes('--like axis')", 10.0)
        visitor.choose("[data-option=sensor]", "current of motor, A")
        visitor.until(f"{stage}.includes('--sensor current@motor')", 10.0)
        visitor.run("machine", 60.0)
    assert load_machine(tmp_path / "session" / "machine.json").output_channels == ("x_m", "motor_A")


def test_a_dropped_machine_replaces_the_machine_and_a_faulty_one_is_explained(tmp_path: Path) -> None:
    good = tmp_path / "own.json"
    save_machine(BUILTIN_MACHINES["corexy"](), good)
    with visitor_of(tmp_path / "session") as visitor:
        visitor.look(390, "light")
        visitor.drop({"faulty.json": b'{"schema": 1}'}, "main[data-stage=machine] .q-uploader")
        visitor.until("document.querySelector('.q-notification')?.innerText.includes('machine.json')", 10.0)
        visitor.drop({"own.json": good.read_bytes()}, "main[data-stage=machine] .q-uploader")
        visitor.until("document.querySelectorAll('main[data-stage=machine] .sv-motor').length === 2", 20.0)
    assert load_machine(tmp_path / "session" / "machine.json").name == "corexy"


def test_a_log_of_a_million_rows_is_drawn_with_its_peak(tmp_path: Path) -> None:
    session = tmp_path / "session"
    (session / "logs").mkdir(parents=True)
    rows = 1_000_000
    volts = np.zeros(rows)
    volts[654_321] = 9.0  # one sample
    time_ms = np.arange(rows)
    table = np.column_stack([time_ms, volts, np.sin(time_ms * 1e-5)])
    np.savetxt(
        session / "logs" / "long.csv",
        table,
        fmt=("%d", "%g", "%.6f"),
        delimiter=";",
        header="time_ms;v_V;x_m",
        comments="",
    )
    save_machine(BUILTIN_MACHINES["axis"](), session / "machine.json")
    with visitor_of(session) as visitor:
        visitor.look(1280, "light")
        visitor.go("logs")
        began = time.monotonic()
        visitor.until("document.querySelectorAll('main[data-stage=logs] canvas').length > 0", 60.0)
        assert time.monotonic() - began < 30.0
        data = visitor.driver.execute_script(
            "const e = document.querySelector('main[data-stage=logs] .nicegui-echart');"
            "return getElement(parseInt(e.id.slice(1))).chart.getOption().series[0].data"
        )
        assert len(data) <= 1600
        assert [654.321, 9.0] in data


def test_requests_without_the_token_or_from_another_site_are_refused(tmp_path: Path) -> None:
    with served(tmp_path / "session") as address:
        plain = address.partition("?")[0]
        for url in (plain, f"{plain}session/machine.json", f"{plain}?token=wrong"):
            with pytest.raises(HTTPError) as refused:
                urlopen(url)
            assert refused.value.code == 403
            refused.value.close()
        with urlopen(address) as answer:
            policy = answer.headers["content-security-policy"]
            assert "default-src 'self'" in policy
            page = answer.read().decode()
        assert "https://" not in page.replace("https://nicegui.io", "") or 'src="https://' not in page
