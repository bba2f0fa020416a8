"""Tests of the held-out runs: their choice, the gain of effects on them, and runs that contradict the fit."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.identification import held_out, hold_out
from tests.identification.scripted_fits import AXIS, DATA, DRAG, FRAME, PUSH, fit_with, runs, selected

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(
    ("count", "expected"),
    [(2, ("r1",)), (3, ("r2",)), (4, ("r3",)), (7, ("r3",)), (8, ("r3", "r7"))],
)
def test_every_fourth_run_is_held_out(count: int, expected: tuple[str, ...]) -> None:
    recordings: Any = [SimpleNamespace(name=f"r{i}") for i in range(count)]
    assert hold_out(recordings) == expected
    assert hold_out(recordings, ["r0"]) == ("r0",)
    with pytest.raises(InputError, match="--hold-out nothing: no such run"):
        hold_out(recordings, ["r0", "nothing"])
    with pytest.raises(InputError, match="at least one must be left to fit"):
        hold_out(recordings, [f"r{i}" for i in range(count)])


def test_a_single_run_cannot_be_held_out() -> None:
    recordings: Any = [SimpleNamespace(name="r0")]
    with pytest.raises(InputError, match="runs: 1, held out: 1"):
        hold_out(recordings)


def by_effects(values: Mapping[tuple[str, ...], float | None]) -> Callable[..., Any]:
    """Return a function of a machine that looks up a value by its effects' names."""
    return lambda machine, *rest, **more: values[tuple(e.name for e in machine.effects)]


def test_the_held_out_gain_compares_forces_or_costs(monkeypatch: pytest.MonkeyPatch) -> None:
    with_both, with_drag = (dataclasses.replace(AXIS, effects=effects) for effects in ((PUSH, DRAG), (DRAG,)))
    names = ("constant_force", "quadratic_drag"), ("quadratic_drag",), ()
    monkeypatch.setattr(held_out, "force_error", by_effects(dict(zip(names, (0.1, 0.2, 0.4), strict=True))))
    monkeypatch.setattr(held_out, "prediction_cost", by_effects(dict(zip(names, (30.0, 40.0, 60.0), strict=True))))
    one = selected(PUSH)
    assert held_out.held_out_gain(one, with_both, DATA, 60.0) == pytest.approx(0.75)
    assert held_out.held_out_gain(one, with_both, DATA, 0.0) == pytest.approx(0.25)
    assert held_out.error_reduction(with_both, with_drag, DATA, 0.0) == pytest.approx(-1.0 / 3.0)
    monkeypatch.setattr(held_out, "force_error", by_effects(dict(zip(names, (0.1, None, 0.4), strict=True))))
    assert held_out.error_reduction(with_drag, with_both, DATA, 60.0) == pytest.approx(0.25)


def test_the_gain_of_a_structure_compares_with_the_machine_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the effect alone, its coordinate would stay."""
    monkeypatch.setattr(held_out, "prediction_cost", by_effects({("frame_resonance",): 1.0, (): 4.0, ("x",): 9.0}))
    gain = held_out.held_out_gain(selected(FRAME), dataclasses.replace(AXIS, effects=(FRAME,)), DATA, 0.0)
    assert gain == pytest.approx(0.75)


@pytest.mark.parametrize(("change", "excited"), [(0.51, True), (0.49, False), (np.nan, True)])
def test_an_effect_that_hardly_changes_a_prediction_is_not_excited(
    monkeypatch: pytest.MonkeyPatch, change: float, excited: bool
) -> None:
    """The change is compared with a twentieth of the error, which is 10; a machine that diverges without it changes."""
    errors = {("constant_force",): np.full(50, 10.0), (): np.full(50, 10.0 + change)}
    monkeypatch.setattr(
        held_out, "prediction_residuals", lambda machine, *_, **__: errors[tuple(e.name for e in machine.effects)]
    )
    monkeypatch.setattr(held_out, "map_runs", lambda function, data: map(function, data.runs))
    assert held_out.is_excited(selected(PUSH), dataclasses.replace(AXIS, effects=(PUSH,)), runs("c"), 60.0) == excited


@pytest.mark.parametrize(("chi2", "limit"), [(0.5, 10.0), (3.0, 30.0)])
def test_held_out_runs_that_contradict_are_named(monkeypatch: pytest.MonkeyPatch, chi2: float, limit: float) -> None:
    """More than ten times the error of the fit, which counts as at least that of the noise."""
    costs = {"a": 0.99 * limit, "b": 1.01 * limit, "c": 5.0 * limit}
    single_runs = [SimpleNamespace(runs=[SimpleNamespace(name=name)], count=50) for name in costs]
    data: Any = SimpleNamespace(single_runs=lambda: single_runs)
    monkeypatch.setattr(
        held_out, "prediction_cost", lambda machine, run, bandwidth, longest_step: costs[run.runs[0].name] * run.count
    )
    assert held_out.contradicting_held_out_runs(fit_with(chi2=chi2), data) == ("b", "c")
