"""Tests of the size of effects: the force at the belt, and which effects depend on the same variable."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import effect_size
from hframe_gym.identification.effect_size import depend_on_same_variable, force_size
from hframe_gym.machine import AppliedEffect, Machine
from tests.identification.axis_results import axis_runs
from tests.identification.scripted_fits import AXIS, DATA, DRAG, FRAME, HFRAME, SPRING, STRIBECK

pytestmark = pytest.mark.unit


def test_the_size_of_a_force_is_its_root_mean_square() -> None:
    assert force_size(np.array([[3.0, 4.0], [0.0, 0.0]])) == pytest.approx(np.sqrt(12.5))


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        (STRIBECK, DRAG, True),
        (STRIBECK, SPRING, False),
        (STRIBECK, EFFECTS["quadratic_drag"].at("y", c=4.0), False),
        (
            EFFECTS["cogging"].at("motor1", A=0.03, n=23.6, p=0.5),
            EFFECTS["cable_spring"].at("phi1", k=6.0, q0=0.0),
            False,
        ),
        (EFFECTS["friction_slope"].at("x", s=1.0), SPRING, True),
        (EFFECTS["friction_slope"].at("phi1", s=0.1), EFFECTS["cable_spring"].at("phi1", k=6.0, q0=0.0), True),
    ],
)
def test_which_effects_depend_on_the_same_variable(first: AppliedEffect, second: AppliedEffect, same: bool) -> None:
    """Periodic ones only on that of other periodic ones."""
    assert depend_on_same_variable(first, second, HFRAME) == same
    assert depend_on_same_variable(second, first, HFRAME) == same


def test_the_difference_of_forces_is_that_at_the_belt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Torques are divided by the radius of the pulley; the motion is that of the first machine."""
    other = dataclasses.replace(HFRAME, name="other")
    moved: list[str] = []

    def predict(machine: Machine, run: Any, bandwidth: float, period: float, states: bool) -> Any:
        assert (bandwidth, period, states) == (60.0, 1e-3, True)
        moved.append(machine.name)
        return SimpleNamespace(positions=np.zeros((1, 5, 4)), velocities=np.zeros((1, 5, 4)))

    forces = {HFRAME.name: np.full((5, 4), 0.1), "other": np.tile([3.1, 4.1, 0.1, 0.1 + 12.0 * 0.0194], (5, 1))}
    monkeypatch.setattr(effect_size, "predict", predict)
    monkeypatch.setattr(effect_size, "map_runs", lambda function, data: map(function, data.runs))
    monkeypatch.setattr(effect_size, "net_forces", lambda machine, *record: forces[machine.name])
    data: Any = SimpleNamespace(period=1e-3, runs=[SimpleNamespace(time_s=np.arange(5.0), inputs=np.zeros((5, 2)))] * 2)
    assert effect_size.force_difference(HFRAME, other, data) == pytest.approx(13.0)
    assert set(moved) == {HFRAME.name}


def test_the_force_of_the_drives_is_at_the_belt() -> None:
    inputs = np.array([[3.0, -4.0], [0.0, 0.0]])
    data: Any = SimpleNamespace(runs=[SimpleNamespace(inputs=inputs)])
    drive = HFRAME.drives[0]
    assert effect_size.drive_force(HFRAME, data) == pytest.approx(np.sqrt(12.5) * drive.gain / 0.0194)


@pytest.mark.parametrize("effect", [FRAME, EFFECTS["sensor_scale"].at("x_m", g=1.01)])
def test_no_force_describes_structures_and_measurements(effect: AppliedEffect) -> None:
    assert effect_size.effect_force(AXIS, effect, DATA) == np.inf


def test_the_size_of_an_effect_is_its_force() -> None:
    data = axis_runs(AXIS, rows=1500, volts=3.0)
    assert effect_size.effect_force(AXIS, EFFECTS["constant_force"].at("x", size=-0.3), data) == pytest.approx(0.3)
    assert effect_size.effect_force(AXIS, EFFECTS["sensor_scale"].at("x_m", g=1.01), data) == np.inf
    (drive,) = AXIS.drives
    rms = np.sqrt(np.mean(np.concatenate([run.inputs for run in data.runs]) ** 2))
    expected = rms * drive.gain / AXIS.coordinates[0].travel_per_unit
    assert effect_size.drive_force(AXIS, data) == pytest.approx(expected)
