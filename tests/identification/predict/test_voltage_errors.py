"""Tests of the errors of voltages that are interpolated between the rows of a log."""

from __future__ import annotations

import dataclasses
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hframe_gym.arrays import Array
from hframe_gym.effects import get_effect
from hframe_gym.identification import (
    Dataset,
    Fit,
    SelectionCriteria,
    default_free_parameters,
    fit,
    identify,
    prepare,
)
from hframe_gym.identification.budget import Budget
from hframe_gym.identification.evidence.effect_parameters import sizes
from hframe_gym.identification.evidence.held_out import worsens_simulation
from hframe_gym.identification.fit.channel_errors import channel_errors
from hframe_gym.identification.fit.covariance import with_uncertainty
from hframe_gym.identification.fit.estimation import prediction_cost
from hframe_gym.identification.fit.model_error import bandwidths_for, continue_fit
from hframe_gym.identification.fit.slow_logs import (
    _between,
    _by_instruments,
    _equations_with_delay,
    _smoothed,
    deviations_of_fits,
    fit_by_instruments,
    fit_slow_log,
)
from hframe_gym.identification.fit.voltage_updates import count_updates, other_updates
from hframe_gym.identification.judge.verdict import JUDGING_BANDWIDTH
from hframe_gym.identification.predict.free_parameters import prior_precision
from hframe_gym.identification.predict.prediction import (
    NARROWEST_WITH_VOLTAGE_ERRORS,
    SEARCH_BANDWIDTH,
    SIMULATION,
    sensor_innovation_variance,
    whitened,
)
from hframe_gym.identification.predict.start_uncertainty import prediction_residuals
from hframe_gym.identification.predict.voltage_errors import (
    InterpolationErrors,
    interpolation_variance,
    mean_voltage_variance,
    simulation_error,
    with_voltage_errors,
)
from hframe_gym.identification.report.words.remainder import reason_of_remainder
from hframe_gym.identification.report.words.verdict import verdict_in_words
from hframe_gym.identification.validate.evaluation import _quiet
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.preparation.inputs.clock_voltages import ClockVoltages, updated_inputs_of_clock
from hframe_gym.recordings import Recording
from tests.identification.controlled_runs import controlled_run, every, random_places

AXIS = BUILTIN_MACHINES["belt-axis"]()
RIG = AXIS.replace({"x.mass": 1.1 * AXIS.parameters["x.mass"]})
ROWS = 1500
RUNS = 6
UPDATES = 4  # of the voltage from one row of the log to the next


def controlled(seed: int) -> Recording:
    """Return a run of a controller that reads the encoder of the motor, with its rounding errors."""
    rng = np.random.default_rng(seed)
    angles = random_places(rng, ROWS) / AXIS.coordinates[1].radius
    noise = rng.normal(0.0, [sensor.noise for sensor in AXIS.sensors], (ROWS, 2))
    return controlled_run(f"run_{seed}", RIG, angles, noise, window=60, gains=(10.0, 0.05))


@cache
def slow_log() -> Dataset:
    """Return logs with every fourth row of the runs."""
    return prepare([every(controlled(seed), UPDATES) for seed in range(RUNS)], AXIS)


@cache
def interpolated() -> Dataset:
    """Return the logs with interpolated voltages, without regard to their errors."""
    return slow_log().with_updates(UPDATES)


@cache
def with_errors() -> Dataset:
    """Return the logs with interpolated voltages and their errors."""
    return with_voltage_errors(AXIS, interpolated())


@cache
def least_squares() -> Fit:
    """Return the fit that knows nothing of the errors."""
    return fit(AXIS, default_free_parameters(AXIS), interpolated(), SEARCH_BANDWIDTH)


def errors(fitted: Fit) -> Array:
    """Return the relative errors of the masses of carriage and pulley."""
    return np.array([fitted.values[name] / RIG.parameters[name] - 1.0 for name in ("x.mass", "phi.mass")])


def test_the_exact_machine_leaves_white_residuals_with_the_variance_of_noise() -> None:
    narrow = NARROWEST_WITH_VOLTAGE_ERRORS
    raw, white = (prediction_cost(RIG, data, narrow) / data.count for data in (interpolated(), with_errors()))
    assert raw > 2.0
    assert 0.5 < white < 1.4  # the errors of this controller, which differentiates rounding errors, alternate
    residual = prediction_residuals(RIG, with_errors().runs[0], with_errors(), narrow).reshape(-1, 2)
    assert np.all(np.abs(np.sum(residual[1:] * residual[:-1], axis=0)) < 0.4 * np.sum(residual**2, axis=0))


def test_held_out_runs_count_unknown_voltages_in_units_of_the_noise_at_rest() -> None:
    """These voltages pass for jitter, which raises the noise; the exact machine must not seem wrong."""
    evaluated: Any = SimpleNamespace(held_out=with_errors(), before=SimpleNamespace(machine=AXIS))
    assert with_errors().jitter > 0.0
    quiet = _quiet(evaluated, with_errors().runs)
    assert (
        prediction_cost(RIG, quiet, JUDGING_BANDWIDTH) < 2.0 * quiet.count
    )  # 31 in units of the larger noise


def test_the_right_machine_does_not_seem_worse_because_unknown_voltages_add_up() -> None:
    """In simulations, 3 % less friction make up for a part of what these voltages do; predictions deny it."""
    smooth = RIG.replace({"x.coulomb": 0.97 * RIG.parameters["x.coulomb"]})
    assert worsens_simulation(smooth, RIG, interpolated())
    assert not worsens_simulation(smooth, RIG, with_errors())
    assert worsens_simulation(RIG, smooth, with_errors())


def test_residuals_are_whitened_window_by_window() -> None:
    """Each value has unit variance given those before it; memory does not grow with the observer's time."""
    data = with_errors()
    run, machine = data.runs[0].first_rows(203), AXIS
    errors_of_run = InterpolationErrors(machine, run, data)
    for bandwidth in (SEARCH_BANDWIDTH, NARROWEST_WITH_VOLTAGE_ERRORS):
        responses = errors_of_run.responses(bandwidth)
        noise = sensor_innovation_variance(machine, data.period, bandwidth)
        covariance = (responses @ responses.T).toarray() + np.diag(np.tile(noise, 203))
        root = np.linalg.cholesky(covariance)
        white = errors_of_run.whitening(bandwidth)(root.T)
        correlation = white.T @ white
        np.testing.assert_allclose(np.diag(correlation), 1.0, atol=1e-5)
        assert np.sqrt(np.mean((correlation - np.eye(406)) ** 2)) < 0.02
        exact = 2.0 * np.log(np.diag(root))
        assert 0.0 <= np.mean(errors_of_run.log_variance(bandwidth)) - np.mean(exact) < 0.03
        assert (
            errors_of_run.whitening(bandwidth).factors.nbytes <= 400 * 203
        )  # bytes a row, whatever the observer


def test_a_wrong_zero_of_an_encoder_behind_belts_leaves_no_white_residual() -> None:
    """The mean error over the run is mostly that of the voltages; belts adapted to the rest of a zero."""
    run = with_errors().runs[0]
    errors_of_run = InterpolationErrors(AXIS, run, interpolated())
    wrong = np.zeros_like(run.outputs)
    wrong[:, 0] = 1e-3 / run.noise[:, 0] * np.sqrt(run.weights[:, 0])  # rad, in units of the noise
    residual = np.random.default_rng(0).normal(size=wrong.size)
    right, shifted = errors_of_run.whiten(np.array([residual, residual + wrong.ravel()]), SEARCH_BANDWIDTH)
    np.testing.assert_allclose(shifted, right, atol=1e-6)
    assert np.sum(errors_of_run.whitening(SEARCH_BANDWIDTH)(wrong.reshape(1, -1)) ** 2) > 10.0


def test_residuals_of_sensors_with_known_zeros_are_whitened_alone() -> None:
    run = with_errors().runs[0].first_rows(203)
    quantum, behind = np.full(2, 1e-6), np.zeros(2, bool)
    known = dataclasses.replace(interpolated(), quantum=quantum, behind_belts=behind)
    errors_of_run = InterpolationErrors(AXIS, run, known)
    residual = np.random.default_rng(0).normal(size=(1, run.outputs.size))
    white = errors_of_run.whiten(residual, SEARCH_BANDWIDTH)
    np.testing.assert_array_equal(white, errors_of_run.whitening(SEARCH_BANDWIDTH)(residual))


def test_the_errors_of_voltages_no_longer_make_a_pulley_too_heavy() -> None:
    """The voltage before a row contains the controller's answer to its rounding error."""
    fitted = continue_fit(least_squares(), with_errors(), NARROWEST_WITH_VOLTAGE_ERRORS)
    assert errors(least_squares())[1] > 0.02
    assert np.abs(errors(fitted)[1]) < 0.5 * errors(least_squares())[1]


@pytest.mark.parametrize("first", [UPDATES - 1, UPDATES + 2])
def test_the_changes_of_the_voltage_are_counted(first: int) -> None:
    assert count_updates(least_squares(), with_errors().with_updates(first)) == UPDATES


def test_a_search_asks_again_how_often_the_voltages_change() -> None:
    criteria, more = SelectionCriteria(), with_errors().with_updates(2 * UPDATES)
    fitted = continue_fit(least_squares(), more, SEARCH_BANDWIDTH)
    found = other_updates(fitted, more, criteria)
    assert found is not None
    assert found.per_row == UPDATES
    assert other_updates(fitted, dataclasses.replace(more, updates_rejected={UPDATES: 0}), criteria) is None
    right = continue_fit(least_squares(), with_errors(), NARROWEST_WITH_VOLTAGE_ERRORS)
    assert other_updates(right, with_errors(), criteria) is None


def test_the_statistics_predict_the_error_of_a_simulation() -> None:
    data = with_errors()
    expected = simulation_error(RIG, data)
    actual = np.array([error.rmse for error in channel_errors(RIG, data).values()])
    assert np.all(expected > 2.0 * data.noise)
    assert np.all((expected > 0.4 * actual) & (expected < 5.0 * actual))


def test_where_the_voltages_are_held_nothing_changes() -> None:
    residual, data = np.ones((2, 6)), slow_log()
    assert whitened(residual, data.runs[0], SEARCH_BANDWIDTH) is residual
    assert not simulation_error(RIG, data).any()
    assert bandwidths_for(data)[-1] == SIMULATION


def test_resting_voltages_have_no_error() -> None:
    inputs = np.zeros((100, 1))
    inputs[50:60, 0] = np.random.default_rng(0).normal(size=10)
    variance = interpolation_variance(inputs)
    assert variance.shape == (99, 1)
    assert np.all(variance[:40] == 0.0)
    assert np.all(variance[52:58] > 0.0)


def test_steps_that_are_not_logged_answer_the_jitter_of_the_clock_as_the_rows_do() -> None:
    """The rows' own answers are known and removed; those between them are as large, and no row shows them."""
    rng, first = np.random.default_rng(0), slow_log().runs[0]
    rows = len(first.time_s)
    answers = rng.normal(0.0, 0.05, (UPDATES * rows, 1))
    wandering = np.cumsum(rng.normal(0.0, 0.01, (UPDATES * rows, 1)), axis=0)
    volts = wandering + answers
    clock = ClockVoltages(np.zeros((rows, 1)), answers[::UPDATES])
    run = dataclasses.replace(first, inputs=volts[::UPDATES], clock_voltages=clock, updates=UPDATES)
    known = updated_inputs_of_clock(run.time_s, run.inputs, clock, UPDATES)[:-1]
    missed = (volts[: len(known)] - known).reshape(rows - 1, UPDATES).mean(axis=1)
    expected = mean_voltage_variance(run).mean()
    assert np.mean(missed**2) == pytest.approx(expected, rel=0.25)
    assert interpolation_variance(run.without_clock_answers()).mean() < 0.3 * expected


def test_instruments_weigh_a_pulley_that_least_squares_find_too_heavy() -> None:
    found = _by_instruments(least_squares(), interpolated())
    assert found is not None
    masses = np.array([found.machine.parameters[name] for name in ("x.mass", "phi.mass")])
    exact = np.array([RIG.parameters[name] for name in ("x.mass", "phi.mass")])
    assert np.all(np.abs(masses / exact - 1.0) < 0.5 * np.abs(errors(least_squares())))
    equations = _equations_with_delay(least_squares(), found.theta, interpolated())
    assert equations is not None
    covariance, by_delay = equations.covariance(prior_precision(least_squares().free), found.theta)
    fitted = dataclasses.replace(
        least_squares(),
        machine=found.machine,
        theta=found.theta,
        covariance=covariance,
        change_by_delay=by_delay,
    )
    uncertainty = with_uncertainty(fitted, interpolated()).uncertainty
    assert uncertainty is not None
    deviations = np.array([uncertainty.std(name) for name in ("x.mass", "phi.mass")], float)
    assert np.all(np.abs(masses - exact) < 3.0 * deviations)
    assert np.all(deviations < 0.05 * exact)


def test_instruments_find_no_damping_of_belts_where_none_is() -> None:
    """From a damping of 1 ms, ten steps suffice; that of least squares depends on the voltages' errors."""
    damped = least_squares().machine.with_effects(get_effect("belt_damping").at("belts", c=1e-3))
    started = fit(damped, default_free_parameters(damped), with_errors(), SEARCH_BANDWIDTH, iterations=0)
    assert started.values["belt_damping@belts.c"] == pytest.approx(1e-3)
    found = fit_by_instruments(started, with_errors())
    assert found is not None
    (size,) = sizes(found.machine.effects[0], with_uncertainty(found, with_errors()))
    assert abs(size.value) < 4.9 * size.std
    assert size.std < 1e-4
    assert fit_by_instruments(least_squares(), slow_log()) is None


def test_a_delay_that_the_residual_indicates_is_no_doubt_about_a_delay() -> None:
    """Of a fit by instruments as well, the variance has a part for it only where no delay is asked for."""
    found = fit_by_instruments(least_squares(), with_errors())
    assert found is not None
    assert found.covariance is not None
    assert found.change_by_delay is not None
    late = dataclasses.replace(found, change_by_delay=np.sqrt(np.diag(found.covariance)))
    with_part, without = (
        with_uncertainty(late, with_errors(), indicated_delay=indicated).uncertainty
        for indicated in (True, False)
    )
    assert with_part is not None
    assert without is not None
    np.testing.assert_allclose(np.diag(with_part.covariance), 2.0 * np.diag(without.covariance))


def test_parameters_lie_between_those_of_least_squares_and_of_instruments() -> None:
    found = _by_instruments(least_squares(), interpolated())
    assert found is not None
    assert _between(least_squares(), found, 0.0).machine == least_squares().machine
    theta, machine = _between(least_squares(), found, 0.25)
    np.testing.assert_allclose(theta, 0.75 * least_squares().theta + 0.25 * found.theta)
    masses = [m.parameters["phi.mass"] for m in (found.machine, machine, least_squares().machine)]
    assert masses == sorted(masses)


def test_instruments_do_not_contain_the_jitter_of_the_clock() -> None:
    """A controller differentiates it, so that its voltages err with the times of the rows."""
    run, rng = slow_log().runs[0], np.random.default_rng(0)
    time_s = run.time_s + rng.uniform(-0.2, 0.2, len(run.time_s)) * slow_log().period
    moving = np.column_stack([time_s**2, time_s])
    smooth = _smoothed(dataclasses.replace(run, time_s=time_s, outputs=moving))
    at_its_times = np.column_stack([smooth.time_s**2, smooth.time_s])
    assert np.abs(smooth.outputs - at_its_times).max() < 5e-5  # 1e-3 at the times of the rows
    assert np.std(smooth.time_s - run.time_s) < 0.5 * np.std(time_s - run.time_s)


def test_a_log_with_held_voltages_or_few_rows_is_not_fitted_by_instruments() -> None:
    few = dataclasses.replace(with_errors(), runs=tuple(run.first_rows(20) for run in with_errors().runs))
    assert fit_slow_log(least_squares(), few) is least_squares()
    assert fit_slow_log(least_squares(), slow_log()) is least_squares()
    with Budget(0.0).limiting(delivers=True):
        assert fit_slow_log(least_squares(), with_errors()) is least_squares()


def test_fits_that_weigh_errors_otherwise_widen_the_intervals() -> None:
    """A fit that knows nothing of the errors takes the pulley for 3 % heavier; others do not, and say so."""
    deviations = deviations_of_fits(least_squares(), with_errors())
    assert deviations.shape == (3, len(least_squares().theta))
    alone, widened = (
        with_uncertainty(least_squares(), with_errors(), deviations=d).uncertainty for d in (None, deviations)
    )
    assert alone is not None
    assert widened is not None
    error = abs(least_squares().values["phi.mass"] - RIG.parameters["phi.mass"])
    stds = [u.std("phi.mass") or 0.0 for u in (alone, widened)]
    assert stds[1] > 1.5 * stds[0]
    assert error < 1.96 * stds[1]


def test_held_voltages_and_a_budget_that_ended_widen_no_interval() -> None:
    assert len(deviations_of_fits(least_squares(), slow_log())) == 0
    declared = fit(RIG, (), with_errors(), SEARCH_BANDWIDTH)
    assert deviations_of_fits(declared, with_errors()).shape == (0, 0)
    with Budget(0.0).limiting(delivers=True):
        assert len(deviations_of_fits(least_squares(), with_errors())) == 0


def test_unknown_voltages_explain_the_error_of_an_exact_machine() -> None:
    """The report says that they may hide effects."""
    result = identify([every(controlled(seed), UPDATES) for seed in range(4)], AXIS)
    assert result.verdict == "no_effect"
    assert not result.effects
    assert result.left is not None
    assert result.left > 2.0  # times the noise
    assert "the unknown voltages between the rows may cause" in reason_of_remainder(result.as_report())
    assert "even the exact machine is therefore expected to err by" in verdict_in_words(result.as_report())
