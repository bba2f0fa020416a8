"""Tests of prediction: observer gains, residuals in units of the noise, sensors' zeros and blocks of rows."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, prepare
from hframe_gym.identification.forces.missing_force import smooth_force_residual
from hframe_gym.identification.predict.error_loops import mean_errors, scaled_errors
from hframe_gym.identification.predict.prediction import (
    SEARCH_BANDWIDTH,
    SIMULATION,
    map_runs,
    observer_gains,
    predict,
    prediction_error,
    residuals,
    sensor_innovation_variance,
)
from hframe_gym.machine import BUILTIN_MACHINES, Machine, rest_state
from hframe_gym.preparation.dataset import PreparedRecording
from hframe_gym.recordings import Recording


def recorded(machine: Machine, name: str = "run", rows: int = 600) -> Recording:
    """Return a noise-free recording of a machine: at rest for 100 ms, then a voltage step."""
    time_s = np.arange(rows) * 1e-3
    inputs = np.where(time_s[:, None] > 0.1, 1.0, 0.0) * np.ones(len(machine.drives))
    return Recording(name, time_s, inputs, machine.simulate(time_s, inputs).outputs)


@pytest.fixture
def data(axis: Machine) -> Dataset:
    """Return a data set of one noise-free run of the axis, with noise of 1 um for its weights."""
    prepared = prepare([recorded(axis)], axis)
    runs = tuple(dataclasses.replace(run, noise=np.full_like(run.outputs, 1e-6)) for run in prepared.runs)
    return dataclasses.replace(prepared, runs=runs, noise=np.array([1e-6]), quantum=np.array([0.0]))


def test_observer_is_critically_damped(axis: Machine) -> None:
    """The error of a free mass decays by 6 % per sample (60 rad/s at 1 kHz), up to the discretization."""
    period = 1e-3
    position_gain, velocity_gain = observer_gains(axis, period)[:, 0]
    transition = np.array([[1.0, period], [0.0, 1.0]]) @ (
        np.eye(2) - [[position_gain, 0.0], [velocity_gain, 0.0]]
    )
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(transition)), 0.94, atol=0.02)


@pytest.mark.parametrize("period", [1e-3, 5e-3, 10e-3])
def test_innovations_have_the_variance_of_the_gains_that_the_observer_has(
    axis: Machine, period: float
) -> None:
    """In slow logs, the gains are limited. At 100 Hz, an exact machine had seemed to leave a quarter."""
    position_gain = observer_gains(axis, period)[0, 0]
    variance = sensor_innovation_variance(axis, period, SEARCH_BANDWIDTH)
    np.testing.assert_allclose(variance, 1.0 / (1.0 - position_gain))


@pytest.mark.parametrize("name", ["belt-axis", "corexy"])
def test_what_no_sensor_corrects_follows_without_stretching_belts(name: str) -> None:
    """A motor without encoder behind a measured carriage, or carriages behind two encoders."""
    machine = BUILTIN_MACHINES[name]()
    kind = "linear" if name == "belt-axis" else "rotary"
    measured = [s for s in machine.sensors if machine.coordinate(s.coordinate).kind == kind]
    alone = machine.replace(sensors=tuple(measured))
    gains = observer_gains(alone, 1e-3)
    count = len(alone.coordinates)
    assert (np.abs(gains).max(axis=1) > 0.0).all()
    for half in (gains[:count], gains[count:]):
        travel = half * alone.travel_per_unit[:, None]
        stretch = [alone.coefficients(belt.extension) @ travel for belt in alone.belts]
        assert np.abs(stretch).max() < 1e-12 * np.abs(travel).max()


@pytest.mark.parametrize("bandwidth", [SEARCH_BANDWIDTH, SIMULATION])
def test_the_true_machine_leaves_no_residual(axis: Machine, data: Dataset, bandwidth: float) -> None:
    motion = predict(axis, data.runs[0], bandwidth, period=data.period, longest_step=0.125e-3)
    assert np.abs(residuals(data.runs[0], data, motion.readings)).max() < 0.5


def test_one_step_prediction_keeps_the_error_of_a_wrong_model_small(axis: Machine, data: Dataset) -> None:
    wrong = axis.replace({"x.mass": 1.2 * axis.parameters["x.mass"]})
    errors = [
        np.abs(
            residuals(
                data.runs[0], data, predict(wrong, data.runs[0], bandwidth, period=data.period).readings
            )
        ).max()
        for bandwidth in (SEARCH_BANDWIDTH, SIMULATION)
    ]
    assert errors[0] < 0.05 * errors[1]


def test_extra_measurement_is_added_to_the_prediction(axis: Machine, data: Dataset) -> None:
    run = data.runs[0]
    plain = predict(axis, run, SIMULATION, period=data.period).readings
    extra = np.full((2, *run.outputs.shape), 1e-3) * np.array([1.0, 2.0])[:, None, None]
    shifted = predict(axis, run, SIMULATION, period=data.period, extra_measurement=extra).readings
    np.testing.assert_allclose(shifted - plain, extra, atol=1e-15)


def test_prediction_error_is_relative_to_the_rows_at_rest(data: Dataset) -> None:
    run = data.runs[0]
    shift = np.full((1, *run.outputs.shape), 3e-3)
    shift[:, run.initial.resting_rows :] += 1e-3
    error = prediction_error(run, data, run.outputs - shift)[0]
    np.testing.assert_allclose(error[: run.initial.resting_rows], 0.0, atol=1e-12)
    np.testing.assert_allclose(error[run.initial.resting_rows :], 1e-3, atol=1e-12)
    quantized = dataclasses.replace(data, quantum=np.array([0.4e-3]))
    np.testing.assert_allclose(
        prediction_error(run, quantized, run.outputs - shift)[0], error - 0.2e-3, atol=1e-12
    )


def test_the_beginning_of_a_run_may_end_before_its_rest(data: Dataset) -> None:
    initial = dataclasses.replace(data.runs[0].initial, resting_rows=200)
    run = dataclasses.replace(data.runs[0], initial=initial).first_rows(60)
    error = prediction_error(run, data, run.outputs[None] - 3e-3)
    np.testing.assert_allclose(error, 0.0, atol=1e-12)


def test_values_that_were_not_measured_leave_no_residual(axis: Machine, data: Dataset) -> None:
    outputs, weights = data.runs[0].outputs.copy(), data.runs[0].weights.copy()
    outputs[300:310], weights[300:310] = np.nan, 0.0
    run = dataclasses.replace(data.runs[0], outputs=outputs, weights=weights)
    far = np.linspace(0.0, 5.0, len(outputs))[None, :, None]
    assert not prediction_error(run, data, far)[:, 300:310].any()
    prediction = np.zeros((1, *outputs.shape))
    error = residuals(run, data, prediction)[0]
    assert np.all(np.isfinite(error))
    assert not error[300:310].any()
    assert error[320:].any()


def test_blocks_keep_the_size_of_slow_residuals_and_of_white_noise(data: Dataset) -> None:
    run = data.runs[0]
    slow = np.sin(2 * np.pi * run.time_s / 0.6)[None, :, None] * 1e-5
    slow[:, : run.initial.resting_rows] = 0.0
    full, blocks = (residuals(run, data, run.outputs + slow, rows) for rows in (1, 4))
    assert blocks.shape == (1, full.shape[1] // 4)
    assert np.sum(blocks**2) == pytest.approx(np.sum(full**2), rel=0.01)
    noise = np.random.default_rng(0).normal(0.0, 1e-6, (1, *run.outputs.shape))
    assert np.std(residuals(run, data, run.outputs + noise, 4)) == pytest.approx(1.0, abs=0.2)


def test_results_of_runs_keep_their_order(axis: Machine) -> None:
    data = prepare([recorded(axis, name, rows) for name, rows in (("long", 900), ("short", 300))], axis)
    assert list(map_runs(lambda run: run.name, data)) == ["long", "short"]


def test_a_function_of_a_run_may_ask_for_all_runs(axis: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads that wait for each other would never end."""
    monkeypatch.setenv("HFRAME_THREADS", "2")
    data = prepare([recorded(axis, name, 300) for name in ("a", "b")], axis)

    def names(run: PreparedRecording) -> str:
        return run.name + "".join(map_runs(lambda other: other.name, data))

    assert list(map_runs(names, data)) == ["aab", "bab"]


def test_after_an_error_in_a_run_no_other_goes_on(axis: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HFRAME_THREADS", "2")
    data = prepare([recorded(axis, name, 300) for name in ("a", "b")], axis)
    ended = []

    def fail_or_end(run: PreparedRecording) -> None:
        if run.name == "a":
            raise ZeroDivisionError
        time.sleep(0.05)
        ended.append(run.name)

    with pytest.raises(ZeroDivisionError):
        list(map_runs(fail_or_end, data))
    assert ended in (["b"], [])
    before = list(ended)
    time.sleep(0.1)
    assert ended == before


@pytest.mark.parametrize(
    ("rows", "sensors", "rows_per_block"), [(37, 4, 1), (64, 2, 1), (5, 1, 1), (37, 3, 4)]
)
def test_loops_over_predictions_are_those_of_numpy(rows: int, sensors: int, rows_per_block: int) -> None:
    rng = np.random.default_rng(0)
    measured, weights = rng.normal(size=(rows, sensors)), rng.random((rows, sensors))
    predicted, zeros = rng.normal(size=(3, rows, sensors)), rng.normal(size=(3, sensors))
    means = mean_errors(measured, predicted, weights, 2, rows)
    expected = np.sum((weights * (measured - predicted))[:, 2:], axis=1) / weights[2:].sum(axis=0)
    np.testing.assert_allclose(means, expected, rtol=1e-12)
    errors = (measured - predicted - zeros[:, None]) * weights
    complete = rows // rows_per_block * rows_per_block
    blocks = errors[:, :complete].reshape(3, -1, rows_per_block, sensors).sum(axis=2)
    found = scaled_errors(measured, predicted, zeros, weights, rows_per_block)
    np.testing.assert_allclose(found, blocks, rtol=1e-12, atol=1e-15)


def test_the_true_machine_lacks_no_force_where_an_effect_falsifies_the_position_at_rest() -> None:
    """The laser reads 2 % too much, so that the encoders count from another position than the laser."""
    hframe = BUILTIN_MACHINES["hframe"]()
    true = hframe.with_effects(EFFECTS["sensor_scale"].at("x_m", g=0.02))
    time_s = np.arange(600) * 1e-3
    inputs = np.where(time_s[:, None] > 0.1, 3.0, 0.0) * np.array([1.0, -1.0])
    outputs = true.simulate(time_s, inputs, rest_state(true, [0.1, 0.05])).outputs
    prepared = prepare([Recording("run", time_s, inputs, outputs)], hframe)
    assert np.abs(smooth_force_residual(hframe, prepared.runs[0], prepared)).max() > 0.5
    assert np.abs(smooth_force_residual(true, prepared.runs[0], prepared)).max() < 1e-3  # N and Nm
