"""Formulas in place of a table: refitted machine, report.json, and `hframe effects new` from the folder."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from hframe_gym import cli, registry
from hframe_gym.effects import EFFECTS, unregister_effect
from hframe_gym.effects.formulas import Formula, FormulaEffect, terms_of
from hframe_gym.effects.smooth_table import KNOTS, definition
from hframe_gym.errors import InputError
from hframe_gym.identification import IdentificationResult, write_result
from hframe_gym.identification.report.content.formulas import TableComparison, compare_formulas, tables_of
from hframe_gym.identification.report.content.saved_result import formulas_of_folder
from hframe_gym.identification.report.page import build_report
from hframe_gym.machine import Machine, Uncertainty
from hframe_gym.recordings import load_machine
from tests.identification.single_axis import AXIS, axis_result, axis_runs

pytestmark = pytest.mark.integration
pytest.importorskip("sklearn")

PULL, CENTER, WIDTH, DEVIATION = 6.0, 0.05, 0.04, 0.02  # N, m, m, N


def pull(q: np.ndarray) -> np.ndarray:
    """Return the force of a magnetic catch, N."""
    z = (q - CENTER) / WIDTH
    return -PULL * z * np.exp(0.5 - 0.5 * z * z)


def with_table() -> Machine:
    """Return the axis with a table of the catch."""
    knots = np.linspace(-0.15, 0.25, KNOTS)
    values = pull(knots) + DEVIATION * np.random.default_rng(2).standard_normal(KNOTS)
    parameters = {f"k{i:02d}": float(k) for i, k in enumerate(knots)}
    parameters |= {f"f{i:02d}": float(v) for i, v in enumerate(values)}
    machine = AXIS.with_effects(definition("smooth_force[position of x]").at("x", **parameters))
    names = tuple(f"{machine.effects[0].label}.f{i:02d}" for i in range(KNOTS))
    return machine.replace(uncertainty=Uncertainty(names, DEVIATION**2 * np.eye(KNOTS)))


@pytest.fixture(scope="module")
def result() -> IdentificationResult:
    """Return a result whose corrected machine has the table, from three runs of 1 s. It is immutable."""
    catch = next(term for term in terms_of("position", force=True) if term.name == "magnetic catch")
    formula = Formula((catch,), (PULL,), ((CENTER, WIDTH),), 0.0)
    truth = AXIS.with_effects(FormulaEffect("truth", formula, with_table().effects[0], AXIS).applied())
    return axis_result(axis_runs(truth, rows=1000, volts=4.0), with_table())


@pytest.fixture(scope="module")
def comparison(result: IdentificationResult) -> TableComparison:
    """Return the formulas for the table. The comparison is immutable."""
    [comparison] = compare_formulas(result)
    return comparison


@pytest.fixture
def folder(result: IdentificationResult, comparison: TableComparison, tmp_path: Path) -> Path:
    """Return the folder of the result with its formulas."""
    write_result(result, tmp_path / "result", (), [comparison])
    return tmp_path / "result"


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], None]]:
    """Return a function that sets HFRAME_PLUGINS for one test."""

    def use(value: str) -> None:
        monkeypatch.setenv(registry.PLUGIN_VARIABLE, value)
        registry.load_plugins.cache_clear()

    path = list(sys.path)
    yield use
    monkeypatch.delenv(registry.PLUGIN_VARIABLE, raising=False)
    sys.path[:] = path
    sys.modules.pop("rail_catch", None)
    if "rail_catch" in EFFECTS:
        unregister_effect("rail_catch")


def test_the_formula_is_as_good_as_the_table(
    result: IdentificationResult, comparison: TableComparison
) -> None:
    [chosen] = [formula for formula in comparison.formulas if formula.recommended]
    assert comparison.table == tables_of(result.after.machine)[0]
    assert chosen.effect.formula.name == "magnetic catch"
    assert chosen.mean_noise_ratio < 1.2 * comparison.mean_noise_ratio
    # Voltages determine forces only relative to the declared drive, so the force may differ by its gain.
    assert chosen.effect.values["center"] == pytest.approx(CENTER, abs=5e-3)
    assert chosen.effect.values["A"] == pytest.approx(PULL, rel=0.2)


def test_the_report_lists_table_and_formulas(folder: Path, comparison: TableComparison) -> None:
    [entry] = json.loads((folder / "report.json").read_text())["proposed_formulas"]
    assert entry["table"] == comparison.table.label
    assert entry["complexity"] == KNOTS
    assert [f["complexity"] for f in entry["formulas"]] == [
        f.effect.formula.complexity for f in comparison.formulas
    ]
    assert comparison.formulas[0].effect.text in build_report(folder).read_text()


def run(*words: object) -> None:
    """Run the command in this process."""
    cli.app([*map(str, words)], standalone_mode=False)


def test_a_written_effect_is_used_by_the_commands(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    plugins: Callable[[str], None],
    comparison: TableComparison,
) -> None:
    path = folder / "rail_catch.py"
    run("effects", "new", "rail_catch", "--from", folder, "--out", path)
    printed = capsys.readouterr().out
    assert "magnetic catch" in printed
    assert "(recommended)" in printed
    assert "Error on the held-out runs" in path.read_text()
    [chosen] = [formula for formula in comparison.formulas if formula.recommended]
    machine = json.loads((folder / "declared.json").read_text())
    units = {"A": "N", "center": "m", "width": "m"}
    values = {name: {"value": value, "unit": units[name]} for name, value in chosen.effect.values.items()}
    machine["effects"] = [{"name": "rail_catch", "site": "x", "parameters": values}]
    (folder / "with_effect.json").write_text(json.dumps(machine))
    with pytest.raises(InputError, match="no such effect"):
        load_machine(folder / "with_effect.json")
    plugins(str(path))
    loaded = load_machine(folder / "with_effect.json")
    q = np.linspace(-0.2, 0.2, 9)
    np.testing.assert_allclose(loaded.effects[0]("force", q=q), chosen.effect.formula(q), rtol=1e-9)


def test_a_folder_without_compared_formulas_serves_as_well(
    result: IdentificationResult, tmp_path: Path
) -> None:
    write_result(result, tmp_path)
    formulas = formulas_of_folder(tmp_path, "rail_catch")
    [chosen] = [formula for formula in formulas if formula.recommended]
    assert chosen.effect.formula.name == "magnetic catch"
    assert not chosen.held_out
    assert "fitted to the table alone" in chosen.effect.source()


@pytest.mark.parametrize(
    ("name", "table", "message"),
    [
        ("Cable", "", "effect name"),
        ("cogging", "", "exists"),
        ("cable", "smooth_force[time]@x", "no such table"),
    ],
)
def test_what_cannot_be_written_is_refused(name: str, table: str, message: str, folder: Path) -> None:
    with pytest.raises(InputError, match=message):
        formulas_of_folder(folder, name, table)


def test_a_machine_without_a_table_has_no_formulas(result: IdentificationResult, tmp_path: Path) -> None:
    plain = dataclasses.replace(result, after=result.before, effects=(), gains={}, verdict="no_effect")
    assert compare_formulas(plain) == ()
    write_result(plain, tmp_path)
    with pytest.raises(InputError, match="no table"):
        formulas_of_folder(tmp_path, "cable")


def test_a_plugin_that_cannot_be_imported_is_named(plugins: Callable[[str], None], tmp_path: Path) -> None:
    plugins(str(tmp_path / "missing.py"))
    with pytest.raises(InputError, match=r"HFRAME_PLUGINS: plugin .*missing\.py"):
        registry.load_plugins()
