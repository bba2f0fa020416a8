"""Formulas for tables: what the regression finds, and the file of a new effect."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS, unregister_effect
from hframe_gym.effects.formulas import (
    Curve,
    Formula,
    FormulaEffect,
    Term,
    fit_formulas,
    terms_of,
    write_effect_file,
)
from hframe_gym.effects.smooth_table import KNOTS, definition
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect, Machine

pytest.importorskip("sklearn")
Function = Callable[[np.ndarray], np.ndarray]

CURVES: dict[str, tuple[str, bool, float, float, Function]] = {
    "magnetic catch": (
        "position",
        True,
        -0.13,
        0.14,
        lambda u: -8.0 * (u - 0.06) / 0.012 * np.exp(0.5 - 0.5 * ((u - 0.06) / 0.012) ** 2),
    ),
    "periodic with 2 harmonics": (
        "position",
        True,
        -0.2,
        0.2,
        lambda u: 2.0 * np.sin(2 * np.pi * u / 0.2 + 0.4) + np.sin(2 * (2 * np.pi * u / 0.2 + 0.4)),
    ),
    "parabola": ("position", True, -0.15, 0.15, lambda u: -80.0 * (u + 0.15) ** 2),
    "decay": ("time", False, 0.0, 150.0, lambda u: 3.0 * np.exp(-u / 40.0)),
    "line": ("position", False, -0.1, 0.1, lambda u: 6.0 * u),
    "Stribeck": ("velocity", False, -0.5, 0.5, lambda u: 1.5 * np.exp(-((u / 0.04) ** 2))),
    "size": ("velocity", False, -0.8, 0.8, lambda u: 4.0 * np.abs(u)),
}


def curve_of(function: Function, low: float, high: float) -> Curve:
    """Return a table of a function with noise of 1 % of its size."""
    knots = np.linspace(low, high, KNOTS) + (high - low) / 200 * np.sin(np.arange(KNOTS))
    values = Curve(knots, knots, np.zeros((KNOTS, KNOTS)), np.zeros((KNOTS, 0))).projected(function)
    noise = 0.01 * float(np.std(values))
    values = values + noise * np.random.default_rng(5).standard_normal(KNOTS)
    return Curve(knots, values, noise**2 * np.eye(KNOTS), np.zeros((KNOTS, 0)))


@pytest.mark.parametrize("name", CURVES)
def test_the_form_of_a_curve_is_found(name: str) -> None:
    variable, force, low, high, function = CURVES[name]
    formulas = fit_formulas(curve_of(function, low, high), terms_of(variable, force=force))
    assert name in [formula.name for formula in formulas]
    best = min(formulas, key=lambda formula: formula.error)
    u = np.linspace(low, high, 400)
    assert np.std(best(u) - function(u)) < 0.05 * np.std(function(u))
    assert [f.complexity for f in formulas] == sorted(f.complexity for f in formulas)


def table_at(machine: Machine, name: str, site: str) -> AppliedEffect:
    """Return a table whose knots are from -1 to 1 and whose values are zero."""
    knots = {f"k{i:02d}": float(k) for i, k in enumerate(np.linspace(-1.0, 1.0, KNOTS))}
    return definition(name).at(site, **knots, **{f"f{i:02d}": 0.0 for i in range(KNOTS)})


def formula_of(*terms: Term) -> Formula:
    """Return a formula with the amplitudes 1, 2, ... and shapes near 0.3."""
    count = sum(len(term.expressions) for term in terms)
    shapes = tuple(tuple(0.3 + 0.1 * i for i in range(len(term.shapes))) for term in terms)
    return Formula(terms, tuple(1.0 + i for i in range(count)), shapes, 0.1)


EVERY_TERM = {
    t.name: (v, t) for v in ("position", "velocity", "path", "time") for t in terms_of(v, force=True)
}


@pytest.mark.parametrize("name", EVERY_TERM)
def test_the_written_hook_is_the_fitted_function(name: str, hframe: Machine) -> None:
    variable, term = EVERY_TERM[name]
    formula = formula_of(term, terms_of(variable, force=True)[1])
    table = table_at(hframe, f"smooth_force[{variable}{'' if variable == 'time' else ' of x'}]", "x")
    applied = FormulaEffect("proposal", formula, table, hframe).applied()
    u = np.linspace(-0.7, 0.8, 50)
    argument = {"position": "q", "velocity": "v", "time": "t", "path": "u"}[variable]
    np.testing.assert_allclose(applied("force", **{argument: u}), formula(u), rtol=1e-12)
    for parameter in applied.definition.parameters:
        assert parameter.lower < applied.parameters[parameter.name] < parameter.upper


@pytest.mark.parametrize(
    ("table", "site", "term"),
    [
        ("smooth_force[position of x]", "x", "step"),
        ("smooth_friction[position of y]", "x", "line"),
        ("smooth_friction[path of x]", "x", "decay"),
        ("smooth_friction[time]", "phi1", "decay"),
    ],
)
def test_a_written_effect_is_registered_and_simulates(
    table: str, site: str, term: str, hframe: Machine, tmp_path: Path
) -> None:
    variable = table.partition("[")[2].split()[0].rstrip("]")
    formula = formula_of(next(t for t in terms_of(variable, force=True) if t.name == term))
    effect = FormulaEffect("trial_effect", formula, table_at(hframe, table, site), hframe)
    path = tmp_path / "trial_effect.py"
    write_effect_file(effect, path)
    with pytest.raises(InputError, match="the file exists"):
        write_effect_file(effect, path)
    assert max(map(len, path.read_text().splitlines())) <= 120
    specification = importlib.util.spec_from_file_location("trial_effect", path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    try:
        specification.loader.exec_module(module)
        machine = hframe.with_effects(EFFECTS["trial_effect"].at(site, **effect.values))
    finally:
        unregister_effect("trial_effect")
        sys.modules.pop("trial_effect", None)
    time_s = np.arange(100) * 1e-3
    inputs = np.full((100, 2), 4.0) * [1.0, -0.3]
    with_effect, without = (simulate(m, time_s, inputs).outputs for m in (machine, hframe))
    assert np.isfinite(with_effect).all()
    assert np.abs(with_effect - without).max() > 1e-6


def test_a_name_that_is_no_identifier_is_refused(hframe: Machine) -> None:
    table = table_at(hframe, "smooth_force[position of x]", "x")
    for name in ("Rail Catch", "class", "2nd", "a-b"):
        with pytest.raises(ValueError, match="effect name"):
            FormulaEffect(name, formula_of(terms_of("position", force=True)[0]), table, hframe)


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sklearn.linear_model", None)
    curve = curve_of(lambda u: u, -1.0, 1.0)
    with pytest.raises(ImportError, match=r"hframe_gym\[formulas\]"):
        fit_formulas(curve, terms_of("position", force=True))


def test_effects_do_not_act_where_their_units_do_not_fit(hframe: Machine) -> None:
    formula = formula_of(terms_of("position", force=True)[0])
    effect = FormulaEffect("proposal", formula, table_at(hframe, "smooth_force[position of y]", "x"), hframe)
    defined = effect.definition()
    assert defined.fits_site is not None
    assert defined.fits is not None
    assert defined.fits_site(hframe, "y")
    assert not defined.fits_site(hframe, "phi1")
    assert not defined.fits(BUILTIN_MACHINES["axis"]())
