"""Tests of the model error: its size, the bandwidth that it requires, and whether an effect stands out from it."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.dynamics import simulate_batch
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, Fit, default_free_parameters, fit, prepare
from hframe_gym.identification.effect_size import drive_force, effect_force
from hframe_gym.identification.model_error import (
    fit_with_model_error,
    information_loss,
    leave_one_out_gain,
    long_run_variance,
    residue_force,
)
from hframe_gym.identification.prediction import SEARCH_BANDWIDTH
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import Recording

pytestmark = pytest.mark.unit
NOISE = 20e-6  # m
ROWS = 1500


@pytest.fixture
def axis() -> Machine:
    """Return the built-in axis."""
    return BUILTIN_MACHINES["axis"]()


def smoothed(values: np.ndarray, rows: int) -> np.ndarray:
    """Return white noise smoothed over some rows, with a standard deviation of 1."""
    colored = np.convolve(values, np.exp(-np.arange(8 * rows) / rows), "same")
    return np.asarray(colored / np.std(colored))


def recordings(
    axis: Machine, *, residue: float = 0.0, color_rows: int = 0, forces: tuple[float, ...] = (0.0,) * 4
) -> Dataset:
    """Return runs of an axis, one per constant force (N), with a random slow force (N) and perhaps colored noise."""
    runs = []
    for k, size in enumerate(forces):
        rng = np.random.default_rng(k)
        time_s = np.arange(ROWS) * 1e-3
        inputs = np.where(time_s > 0.1, 1.5 * np.sin((8 + k) * time_s) + 0.7 * np.sin(31 * time_s), 0.0)[:, None]
        force = residue * smoothed(rng.normal(size=ROWS), 200)
        force[:120] = 0.0
        machine = axis.with_effects(EFFECTS["constant_force"].at("x", size=size)) if size else axis
        motion = simulate_batch(machine, time_s, inputs, extra_force=force[None, :, None], longest_step=0.125e-3)
        noise = rng.normal(size=ROWS)
        noise = NOISE * (smoothed(noise, color_rows) if color_rows else noise)
        runs.append(Recording(f"run_{k}", time_s, inputs, motion.readings[0] + noise[:, None]))
    return prepare(runs, axis)


def fitted_axis(axis: Machine, data: Dataset, *, constant_force: bool = False) -> Fit:
    """Return the fit of the axis at the bandwidth of the search, with or without a constant force."""
    machine = axis.with_effects(EFFECTS["constant_force"].at("x", size=0.05)) if constant_force else axis
    return fit(machine, default_free_parameters(machine), data, SEARCH_BANDWIDTH)


def test_an_exact_model_is_simulated(axis: Machine) -> None:
    data = recordings(axis)
    best = fit_with_model_error(fitted_axis(axis, data), data)
    assert best.bandwidth <= 3.0
    assert information_loss(best, data) == pytest.approx(1.0, abs=0.1)
    assert information_loss(fitted_axis(axis, data), data) > information_loss(best, data)


def test_a_residue_requires_an_observer_and_its_size_is_estimated(axis: Machine) -> None:
    data = recordings(axis, residue=0.1)
    best = fit_with_model_error(fitted_axis(axis, data), data)
    assert best.bandwidth > 3.0
    assert 0.02 < residue_force(best, data) < 0.2
    clean = recordings(axis)
    assert residue_force(fit_with_model_error(fitted_axis(axis, clean), clean), clean) < 0.002


def test_the_size_of_an_effect_is_its_force(axis: Machine) -> None:
    data = recordings(axis)
    assert effect_force(axis, EFFECTS["constant_force"].at("x", size=-0.3), data) == pytest.approx(0.3)
    assert effect_force(axis, EFFECTS["sensor_scale"].at("x_m", g=1.01), data) == np.inf
    (drive,) = axis.drives
    rms = np.sqrt(np.mean(np.concatenate([run.inputs for run in data.runs]) ** 2))
    expected = rms * drive.gain / axis.coordinates[0].travel_per_unit
    assert drive_force(axis, data) == pytest.approx(expected)


@pytest.mark.parametrize(("forces", "confirmed"), [((0.05,) * 4, True), ((0.0, 0.3, 0.0, 0.0), False)])
def test_an_effect_of_one_run_is_not_confirmed_by_the_others(
    axis: Machine, forces: tuple[float, ...], confirmed: bool
) -> None:
    data = recordings(axis, forces=forces)
    without, with_effect = fitted_axis(axis, data), fitted_axis(axis, data, constant_force=True)
    gain = without.cost - with_effect.cost
    assert gain > 100.0
    fraction = leave_one_out_gain(without, with_effect, data) / gain
    assert (fraction > 0.8) if confirmed else (fraction < 0.3)


def test_colored_noise_has_a_large_long_run_variance(axis: Machine) -> None:
    white, colored = (recordings(axis, color_rows=rows) for rows in (0, 20))
    values = [long_run_variance(fit_with_model_error(fitted_axis(axis, d), d), d) for d in (white, colored)]
    assert values[0] < 1.2
    assert values[1] > 2.0
