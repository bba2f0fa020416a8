"""Tests of the significance of an effect: its force, the unexplained force, and the doubts about it."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification.evidence import significance
from hframe_gym.identification.evidence.significance import depend_on_same_variable
from hframe_gym.identification.fit import force_sizes
from hframe_gym.identification.fit.force_sizes import force_size
from hframe_gym.identification.predict.free_parameters import FreeParameter
from hframe_gym.machine import AppliedEffect, Machine
from tests.identification.axis_results import axis_runs
from tests.identification.scripted_fits import (
    AXIS,
    DATA,
    DRAG,
    FRAME,
    HFRAME,
    PUSH,
    SPRING,
    STRIBECK,
    fit_with,
)

pytestmark = pytest.mark.unit


def test_the_size_of_a_force_is_its_root_mean_square() -> None:
    assert force_size(np.array([[3.0, 4.0], [0.0, 0.0]])) == pytest.approx(np.sqrt(12.5))


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        (STRIBECK, DRAG, True),
        (STRIBECK, SPRING, False),
        (FRAME, SPRING, False),  # the frame's own position and speed
        (FRAME, STRIBECK, False),
        (STRIBECK, EFFECTS["quadratic_drag"].at("y", c=4.0), False),
        (
            EFFECTS["cogging"].at("motor1", A=0.03, n=23.6, p=0.5),
            EFFECTS["cable_spring"].at("phi1", k=6.0, q0=0.0),
            False,
        ),
        (EFFECTS["friction_slope"].at("x", s=1.0), SPRING, True),
        (
            EFFECTS["friction_slope"].at("phi1", s=0.1),
            EFFECTS["cable_spring"].at("phi1", k=6.0, q0=0.0),
            True,
        ),
    ],
)
def test_which_effects_depend_on_the_same_variable(
    first: AppliedEffect, second: AppliedEffect, same: bool
) -> None:
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

    forces = {
        HFRAME.name: np.full((5, 4), 0.1),
        "other": np.tile([3.1, 4.1, 0.1, 0.1 + 12.0 * 0.0194], (5, 1)),
    }
    monkeypatch.setattr(force_sizes, "predict", predict)
    monkeypatch.setattr(force_sizes, "map_runs", lambda function, data: map(function, data.runs))
    monkeypatch.setattr(force_sizes, "net_forces", lambda machine, *record: forces[machine.name])
    data: Any = SimpleNamespace(
        period=1e-3, runs=[SimpleNamespace(time_s=np.arange(5.0), inputs=np.zeros((5, 2)))] * 2
    )
    assert force_sizes.force_difference(HFRAME, other, data) == pytest.approx(13.0)
    assert set(moved) == {HFRAME.name}


def test_the_force_of_the_drives_is_at_the_belt() -> None:
    inputs = np.array([[3.0, -4.0], [0.0, 0.0]])
    data: Any = SimpleNamespace(runs=[SimpleNamespace(inputs=inputs)])
    drive = HFRAME.drives[0]
    assert force_sizes.drive_force(HFRAME, data) == pytest.approx(np.sqrt(12.5) * drive.gain / 0.0194)


@pytest.mark.parametrize("effect", [FRAME, EFFECTS["sensor_scale"].at("x_m", g=1.01)])
def test_no_force_describes_structures_and_measurements(effect: AppliedEffect) -> None:
    assert force_sizes.effect_force(AXIS, effect, DATA) == np.inf


def test_the_size_of_an_effect_is_its_force() -> None:
    data = axis_runs(AXIS, rows=1500, volts=3.0)
    assert force_sizes.effect_force(
        AXIS, EFFECTS["constant_force"].at("x", size=-0.3), data
    ) == pytest.approx(0.3)
    assert force_sizes.effect_force(AXIS, EFFECTS["sensor_scale"].at("x_m", g=1.01), data) == np.inf
    (drive,) = AXIS.drives
    rms = np.sqrt(np.mean(np.concatenate([run.inputs for run in data.runs]) ** 2))
    expected = rms * drive.gain / AXIS.coordinates[0].travel_per_unit
    assert force_sizes.drive_force(AXIS, data) == pytest.approx(expected)


@pytest.mark.parametrize("bandwidth", [0.0, 30.0])
def test_the_residue_is_the_correction_beyond_that_of_noise(
    monkeypatch: pytest.MonkeyPatch, bandwidth: float
) -> None:
    """The observer corrects the velocity by bandwidth^2 times the innovation; without one, by that of 3 rad/s."""
    innovation = np.array([[3e-3], [-5e-3], [np.nan], [1e-3]])
    run: Any = SimpleNamespace(outputs=innovation, noise=np.array([1e-3]))
    data: Any = SimpleNamespace(period=1e-3, runs=[run])
    monkeypatch.setattr(force_sizes, "predict", lambda *arguments, **more: SimpleNamespace(readings=None))
    monkeypatch.setattr(force_sizes, "prediction_error", lambda run, data, readings: innovation[None])
    monkeypatch.setattr(force_sizes, "map_runs", lambda function, data: map(function, data.runs))
    power = (9.0 + 25.0 + 1.0 - 3.0) / 4.0 * 1e-6  # m^2; the missing measurement has neither error nor noise
    mass = AXIS.coordinates[0].mass
    expected = max(bandwidth, 3.0) ** 2 * mass * np.sqrt(power)
    assert force_sizes.residue_force(fit_with(chi2=1.0, bandwidth=bandwidth), data) == pytest.approx(expected)
    run.noise = np.array([9e-3])
    assert force_sizes.residue_force(fit_with(chi2=1.0), data) == 0.0


class CorrelatedResidual:
    """Residual of runs of 4 s at 1 kHz: constant over sequences of rows; the influence of two parameters.

    The first parameter, of the machine, has the influence of a sine; the second one, of the effect, is constant.
    """

    def __init__(self, *arguments: Any) -> None:
        pass

    def at(self, theta: np.ndarray) -> Any:
        return self  # the model is linear

    def linearize_run(self, run: Any) -> Any:
        """Return Jacobian (2, 4000) and residual (4000,) of a run, which is a pair of seed and correlation in rows."""
        seed, rows = run
        residual = np.repeat(np.random.default_rng(seed).normal(size=4000 // rows), rows)
        sine = np.sin(np.arange(4000) * 2e-3 * np.pi)
        return SimpleNamespace(jacobian=np.array([sine, np.ones(4000)]), residual=residual)


@pytest.mark.parametrize("rows", [1, 20, 200, 4000])
def test_a_residual_that_is_constant_over_some_rows_has_that_many_times_the_variance(
    monkeypatch: pytest.MonkeyPatch, rows: int
) -> None:
    monkeypatch.setattr(significance, "ResidualModel", CorrelatedResidual)
    monkeypatch.setattr(significance, "map_runs", lambda function, data: map(function, data.runs))
    free = (FreeParameter("x.mass", 1.0, 0.3), FreeParameter(f"{PUSH.label}.size", 1.0, 1e6, scale=1.0))
    fitted = dataclasses.replace(fit_with(PUSH, chi2=1.0), free=free, theta=np.zeros(2))
    data: Any = SimpleNamespace(period=1e-3, runs=[(seed, rows) for seed in range(100)])
    # 800 blocks of 0.5 s; the largest of three estimates, the last one of 100 runs.
    assert significance.long_run_variance(fitted, PUSH.label, data) == pytest.approx(rows, rel=0.35)


def test_few_blocks_require_a_larger_gain(monkeypatch: pytest.MonkeyPatch) -> None:
    """The quantile of F(1, 8) at one in ten thousand is 3.35 times that of the chi-squared distribution."""
    monkeypatch.setattr(significance, "ResidualModel", CorrelatedResidual)
    monkeypatch.setattr(significance, "map_runs", lambda function, data: map(function, data.runs))
    free = (FreeParameter("x.mass", 1.0, 0.3), FreeParameter(f"{PUSH.label}.size", 1.0, 1e6, scale=1.0))
    fitted = dataclasses.replace(fit_with(PUSH, chi2=1.0), free=free, theta=np.zeros(2))
    run = (0, 200)
    one, many = (
        significance.long_run_variance(fitted, PUSH.label, SimpleNamespace(period=1e-3, runs=[run] * n))
        for n in (1, 1000)
    )
    assert one / many == pytest.approx(3.35, rel=0.01)
