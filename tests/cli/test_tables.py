"""Tables and lines that the commands print."""

from __future__ import annotations

import io

import pytest
from rich.console import Console
from rich.table import Table

from hframe_gym.cli.tables.identification import effect_lines, identification_table
from hframe_gym.cli.tables.machines import effect_table, machine_table
from hframe_gym.cli.tables.scores import BANDS, protocol_tables, score_table
from hframe_gym.data_validation import Finding, print_findings
from hframe_gym.effects import EFFECTS
from hframe_gym.effects.smooth_table import TABLE_FAMILY
from hframe_gym.machine import BUILTIN_MACHINES
from tests.cli.running import Command
from tests.identification.report.axis_results import effect_entry, report_with

pytestmark = pytest.mark.integration


def printed(table: Table, width: int) -> str:
    """Return a table as a terminal of a width shows it, and check that nothing is cut."""
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(table)
    text = console.export_text()
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width
    return text


@pytest.mark.parametrize("width", [80, 60])
@pytest.mark.parametrize("metric", ["settling_s", "contour_mm"])
def test_scores_are_not_cut(metric: str, width: int) -> None:
    success = {band: {"1mm": 1.0, "0.2mm": 0.998, "0.05mm": 0.125}[band] for band in BANDS}
    keys = BANDS if metric == "settling_s" else ("rms", "max")
    errors = {key: {"mean": 1.2345 + i} for i, key in enumerate(keys)}
    score = {"success": success, metric: errors, "tracking_mm": errors, "final_error_mm": {"mean": 0.0123}}
    names = ("pid", "my_package.my_controllers:a-controller")
    scores = {
        "task": "reach",
        "episodes": 512,
        "machine": "hframe",
        "randomize": "default",
        "sensors": "state",
    }
    text = printed(score_table({**scores, "seed": 0, "controllers": dict.fromkeys(names, score)}), width)
    assert "pid" in text.split()
    for number in ("100.0", "99.8", "12.5", *(f"{cell['mean']:.3f}" for cell in errors.values())):
        assert text.count(number) >= len(names)


def test_a_band_in_which_nothing_settles_has_no_settling_time() -> None:
    """The mean is then the episodes' length, which is no settling time; the rest says how near it came."""
    bands = {"1mm": 0.5, "0.2mm": 0.0, "0.05mm": 0.0}
    settling = {band: {"mean": 1.5} for band in bands}
    bound = {"0.2mm": {"ratio_of_means": {"mean": 5.9}}}
    left = {"mean": 2.26, "median": 2.26}
    score = {"success": bands, "settling_s": settling, "over_bound": bound, "final_error_mm": left}
    scores = {
        "task": "reach",
        "episodes": 512,
        "machine": "hframe",
        "randomize": "none",
        "sensors": "state",
        "seed": 0,
    }
    text = printed(score_table({**scores, "controllers": {"idle": score}}), 80)
    assert text.split()[-8:] == ["50.0", "0.0", "0.0", "1.500", "-", "-", "-", "2.26"]
    part = {f"settling_s.{band}": {"success": bands[band], "mean": 1.5, "ci95": (1.4, 1.5)} for band in bands}
    result = {
        "protocol": "reach-v1",
        "entry": {"name": "idle"},
        "scores": {"reach": {"final_error_mm": left, **part}},
    }
    (table,) = protocol_tables([result])
    # Nor a ratio to the bound.
    assert printed(table, 80).split()[-7:] == ["idle", "50.0", "0.0", "0.0", "-", "-", "2.26"]


@pytest.mark.parametrize("width", [80, 60])
def test_errors_of_an_identification_are_not_cut(width: int) -> None:
    channels = ("phi1_rad", "phi2_rad", "x_m", "bridge_left_m")
    errors = {channel: {"rmse": 1.2345e-5, "noise_ratio": 1234.5} for channel in channels} | {
        "force_error": 0.5
    }
    text = printed(identification_table(report_with(errors)), width)
    assert set(channels) <= set(text.split())
    assert text.count("0.0123 mrad") == text.count("12.3 µm") == 3 * 2
    assert text.count("1234 x") == 3 * len(channels)


@pytest.mark.parametrize("width", [80, 60])
def test_machines_and_effects_are_not_cut(width: int) -> None:
    assert set(BUILTIN_MACHINES) <= set(printed(machine_table(), width).split())
    assert set(EFFECTS) <= set(printed(effect_table(), width).split())


@pytest.mark.parametrize("width", [80, 60])
def test_findings_are_not_cut(width: int) -> None:
    findings = [
        Finding(
            "advice", "a_run_with_a_very_long_name_2026_11_22", "bottom.rest_length", "what was found " * 9
        )
    ]
    console = Console(width=width, record=True, file=io.StringIO(), force_terminal=True)
    print_findings(findings, console)
    text = console.export_text()
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width


@pytest.mark.parametrize("columns", [None, "80"])
@pytest.mark.parametrize("command", ["effects", "machines"])
def test_names_are_complete_where_the_output_is_no_terminal(
    command: str, columns: str | None, hframe_command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns:
        monkeypatch.setenv("COLUMNS", columns)
    names = set(EFFECTS if command == "effects" else BUILTIN_MACHINES)
    code, out, _ = hframe_command(command)
    assert code == 0
    assert names <= set(out.split())
    assert max(map(len, out.splitlines())) <= 80


def test_identified_effects_are_listed_with_their_parameters_and_a_table_by_its_points() -> None:
    values = {"dF": (2.8393, 4.2e-4, "N"), "n": (2.0, None, "1")}
    parameters = {k: dict(zip(("value", "std", "unit"), v, strict=True)) for k, v in values.items()}
    stribeck = effect_entry("stribeck_friction", "x", parameters=parameters)
    table = stribeck | {"name": "smooth_force[time]", "family": TABLE_FAMILY, "held_out_gain": 0.95}
    assert effect_lines(report_with(effects=[stribeck, table])) == [
        "smooth force[time] at x: a table of 1 points",
        "stribeck friction at x: dF = 2.8393 +- 0.00042 N, n = 2",
    ]


def test_a_time_constant_without_upper_end_is_listed_with_its_least_value() -> None:
    tau = {"value": 200.0, "std": 120.0, "unit": "s", "at_least": 91.9}
    warm_up = effect_entry("friction_warm_up", "machine", parameters={"tau": tau})
    assert effect_lines(report_with(effects=[warm_up])) == [
        "friction warm up at machine: tau at least 91.9 s"
    ]
