"""Tests of the sizes of forces: of effects, of drives, and of what remains unexplained."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, prepare
from hframe_gym.identification.fit.model_error import search_step
from hframe_gym.identification.forces import force_sizes
from hframe_gym.identification.forces.force_sizes import force_size
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH, predict, prediction_error
from hframe_gym.machine import AppliedEffect
from hframe_gym.recordings import Recording
from tests.identification.scripted_fits import AXIS, DATA, FRAME, HFRAME, PUSH, fit_with
from tests.identification.single_axis import axis_runs


@pytest.fixture
def axis_data() -> Dataset:
    """Return runs of the built-in axis."""
    return axis_runs(AXIS, rows=1500, volts=3.0)


def test_the_size_of_a_force_is_its_root_mean_square() -> None:
    assert force_size(np.array([[3.0, 4.0], [0.0, 0.0]])) == pytest.approx(np.sqrt(12.5))


def test_the_difference_of_forces_is_that_at_the_belt() -> None:
    """Torques are divided by the radius of the pulley."""
    inputs = np.zeros((100, 2))
    inputs[50:] = 2.0
    time_s = np.arange(100) * 1e-3
    data = prepare([Recording("run", time_s, inputs, HFRAME.simulate(time_s, inputs).outputs)], HFRAME)
    force = EFFECTS["constant_force"]
    other = HFRAME.with_effects(
        force.at("x", size=3.0), force.at("y", size=-4.0), force.at("phi2", size=12.0 * 0.0194)
    )
    assert force_sizes.force_difference(HFRAME, other, data) == pytest.approx(13.0)


def test_forces_are_compared_along_the_motion_of_the_first_machine(axis_data: Dataset) -> None:
    x = AXIS.coordinates[0]
    damped = AXIS.replace(coordinates=(dataclasses.replace(x, viscous=x.viscous + 2.0),))
    for first, second in ((AXIS, damped), (damped, AXIS)):
        speeds = [
            predict(first, run, SEARCH_BANDWIDTH, period=axis_data.period, states=True).velocities[0]
            for run in axis_data.runs
        ]
        expected = 2.0 * force_size(np.concatenate(speeds))
        assert force_sizes.force_difference(first, second, axis_data) == pytest.approx(expected)


def test_the_force_of_the_drives_is_at_the_belt() -> None:
    inputs = np.array([[3.0, -4.0], [0.0, 0.0]])
    data: Any = SimpleNamespace(runs=[SimpleNamespace(inputs=inputs)])
    drive = HFRAME.drives[0]
    assert force_sizes.drive_force(HFRAME, data) == pytest.approx(np.sqrt(12.5) * drive.gain / 0.0194)


@pytest.mark.parametrize("effect", [FRAME, EFFECTS["sensor_scale"].at("x_m", g=1.01)])
def test_no_force_describes_structures_and_measurements(effect: AppliedEffect) -> None:
    assert force_sizes.effect_force(AXIS, effect, DATA) == np.inf


def test_the_size_of_an_effect_is_its_force(axis_data: Dataset) -> None:
    data = axis_data
    assert force_sizes.effect_force(
        AXIS, EFFECTS["constant_force"].at("x", size=-0.3), data
    ) == pytest.approx(0.3)
    assert force_sizes.effect_force(AXIS, EFFECTS["sensor_scale"].at("x_m", g=1.01), data) == np.inf
    (drive,) = AXIS.drives
    rms = np.sqrt(np.mean(np.concatenate([run.inputs for run in data.runs]) ** 2))
    expected = rms * drive.gain / AXIS.coordinates[0].travel_per_unit
    assert force_sizes.drive_force(AXIS, data) == pytest.approx(expected)


@pytest.mark.parametrize("bandwidth", [0.0, 30.0])
def test_the_residue_is_the_correction_beyond_that_of_noise(axis_data: Dataset, bandwidth: float) -> None:
    """The observer corrects the velocity by bandwidth^2 * innovation; without one, by that of 3 rad/s."""
    [run] = axis_data.with_runs(["run_0"]).runs
    run.outputs[700:800] = np.nan  # a missing measurement has neither error nor noise
    pushed = fit_with(PUSH, chi2=1.0, bandwidth=bandwidth)
    data = dataclasses.replace(axis_data, runs=(run,))
    used = max(bandwidth, 3.0)
    motion = predict(pushed.machine, run, used, period=data.period, longest_step=search_step(used, data))
    innovation = prediction_error(run, data, motion.readings)[0]  # without the error of the sensor's zero
    measured = np.isfinite(run.outputs)
    power = np.sum((innovation**2 - run.noise**2)[measured]) / len(innovation)
    expected = used**2 * AXIS.coordinates[0].mass * np.sqrt(power)
    assert force_sizes.residue_force(pushed, data) == pytest.approx(expected, rel=1e-4)
    noisy = dataclasses.replace(run, noise=1e3 * run.noise)
    assert force_sizes.residue_force(pushed, dataclasses.replace(data, runs=(noisy,))) == 0.0


def test_noise_that_exceeds_that_at_rest_is_no_missing_force(axis_data: Dataset) -> None:
    """A force that is missing adds to the errors slowly, and remains."""
    data = axis_data.with_runs(["run_0"])
    [run] = data.runs
    noise = np.random.default_rng(2).normal(0.0, 2.0, run.outputs.shape) * run.noise
    noisy = dataclasses.replace(data, runs=(dataclasses.replace(run, outputs=run.outputs + noise),))
    exact, pushed = (fit_with(*effects, chi2=1.0, bandwidth=30.0) for effects in ((), (PUSH,)))
    by_noise = force_sizes.residue_force(exact, noisy)
    assert force_sizes.residue_force(exact, noisy, noise_of_motion=True) < 0.3 * by_noise
    lacking = force_sizes.residue_force(pushed, data)
    found = force_sizes.residue_force(pushed, noisy, noise_of_motion=True)
    assert found == pytest.approx(lacking, rel=0.1)


def test_what_an_effect_remembers_is_no_missing_force() -> None:
    """A winding that is hot when a run begins reduces all its forces; a fit takes this into account too."""
    heated = AXIS.with_effects(EFFECTS["winding_heat"].at("motor", a=0.01, tau=20.0))
    generator = np.random.default_rng(5)
    time_s = np.arange(1500) * 1e-3
    inputs = np.repeat(generator.uniform(-3.0, 3.0, (15, 1)), 100, axis=0)
    inputs[:50] = 0.0
    noise = generator.normal(0.0, 2e-5, (1500, 1))
    cold, hot = (
        prepare(
            [Recording("run", time_s, inputs, simulate(heated, time_s, inputs, start).outputs + noise)], AXIS
        )
        for start in ([0.0, 0.0, 0.0], [0.0, 0.0, 40.0])  # heat, A^2
    )
    fitted = fit_with(*heated.effects, chi2=1.0, bandwidth=60.0)
    without = fit_with(chi2=1.0, bandwidth=60.0)
    lost = force_sizes.residue_force(without, hot)
    assert force_sizes.residue_force(fitted, cold) < 0.1 * lost
    assert force_sizes.residue_force(fitted, hot) < 0.1 * lost
