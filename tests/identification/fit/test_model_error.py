"""Tests of the model error: its size, and the observer that it requires."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hframe_gym.identification.fit import model_error
from hframe_gym.identification.fit.estimation import (
    prediction_cost,
)
from hframe_gym.identification.fit.long_run_variance import long_run_variance
from hframe_gym.identification.fit.model_error import (
    BANDWIDTHS,
    fit_with_model_error,
    likelihood_deficit,
    likelihood_loss,
    narrower_observer,
)
from hframe_gym.identification.forces.force_sizes import residue_force
from hframe_gym.machine import Machine
from tests.identification.fit.residue_runs import fitted_axis, recordings
from tests.identification.scripted_fits import DATA, HFRAME, fit_with


def test_an_exact_model_is_simulated(axis: Machine) -> None:
    data = recordings(axis)
    best = fit_with_model_error(fitted_axis(axis, data), data)
    assert best.bandwidth <= 3.0
    assert likelihood_loss(best, data) == pytest.approx(1.0, abs=0.1)
    assert likelihood_loss(fitted_axis(axis, data), data) > likelihood_loss(best, data)


def test_a_residue_requires_an_observer_and_its_size_is_estimated(axis: Machine) -> None:
    data = recordings(axis, residue=0.1)
    best = fit_with_model_error(fitted_axis(axis, data), data)
    assert best.bandwidth > 3.0
    assert 0.02 < residue_force(best, data) < 0.2
    clean = recordings(axis)
    assert residue_force(fit_with_model_error(fitted_axis(axis, clean), clean), clean) < 0.002


def test_colored_noise_has_a_large_long_run_variance(axis: Machine) -> None:
    white, colored = (recordings(axis, color_rows=rows) for rows in (0, 20))
    fits = [
        fit_with_model_error(fitted_axis(axis, data, constant_force=True), data) for data in (white, colored)
    ]
    values = [
        long_run_variance(f, "constant_force@x", d).ratio for f, d in zip(fits, (white, colored), strict=True)
    ]
    assert values[0] < 3.0
    assert values[1] > 2.0 * values[0]


# -- decisions with scripted fits ----------------------------------------------------------------------------


def test_a_narrow_observer_needs_short_steps() -> None:
    assert model_error.search_step(60.0, DATA) == model_error.SEARCH_STEP
    assert model_error.search_step(30.0, DATA) == model_error.search_step(0.0, DATA) == 0.25e-3


def test_errors_of_voltages_are_larger_than_those_of_steps() -> None:
    data = SimpleNamespace(has_voltage_errors=True)
    assert model_error.search_step(15.0, data) == model_error.SEARCH_STEP
    assert model_error.search_step(0.0, data) == 0.25e-3  # nothing corrects errors of the steps


def test_a_fit_in_simulation_needs_no_other_observer() -> None:
    simulated = fit_with(chi2=2.0, bandwidth=0.0)
    assert model_error.fit_with_model_error(simulated, DATA) is simulated


def test_the_loss_is_chi_squared_in_units_of_the_innovations_variance() -> None:
    """Position gain K = 2 * bandwidth * period; innovations have 1 / (1 - K) times the variance of the noise.

    In slow logs, the observer has the gains of 5 ms.
    """
    data: Any = SimpleNamespace(
        period=1e-3, has_voltage_errors=False, runs=[SimpleNamespace(weights=np.ones((100, 1)))]
    )
    variance = 1.0 / (1.0 - 2.0 * 30.0 * 1e-3)
    loss = model_error.likelihood_loss(fit_with(chi2=1.3, bandwidth=30.0), data)
    assert loss == pytest.approx(1.3 / variance + np.log(variance))
    assert model_error.likelihood_loss(fit_with(chi2=1.3), data) == pytest.approx(1.3)
    slow: Any = SimpleNamespace(period=0.1, has_voltage_errors=False, runs=data.runs)
    variance = 1.0 / (1.0 - 2.0 * 60.0 * 5e-3)
    loss = model_error.likelihood_loss(fit_with(chi2=1.3, bandwidth=60.0), slow)
    assert loss == pytest.approx(1.3 / variance + np.log(variance))


def test_sensors_count_by_their_number_of_measurements() -> None:
    """A laser beside encoders has 5/12 of their bandwidth."""
    machine = HFRAME
    weights = np.zeros((90, 4))
    weights[:, 0], weights[:30, 2] = 1.0, 1.0
    data: Any = SimpleNamespace(
        period=1e-3, has_voltage_errors=False, runs=[SimpleNamespace(weights=weights)]
    )
    fitted = dataclasses.replace(fit_with(chi2=1.0, bandwidth=60.0), machine=machine)
    encoder, laser = 1.0 / (1.0 - 0.12), 1.0 / (1.0 - 0.05)
    expected = 1.0 / (0.75 * encoder + 0.25 * laser) + 0.75 * np.log(encoder) + 0.25 * np.log(laser)
    assert model_error.likelihood_loss(fitted, data) == pytest.approx(expected)


def test_the_next_narrower_observer_and_the_gain_that_makes_it_as_likely(axis: Machine) -> None:
    data = recordings(axis, residue=0.1)
    best = fit_with_model_error(fitted_axis(axis, data), data)
    narrower = narrower_observer(best, data)
    gain = likelihood_deficit(narrower, best, data)
    assert narrower.bandwidth == max(b for b in BANDWIDTHS if b < best.bandwidth)
    assert gain > 0.0
    as_likely = dataclasses.replace(narrower, cost=narrower.cost - gain * narrower.count)
    assert likelihood_loss(as_likely, data) == pytest.approx(likelihood_loss(best, data))


def test_the_final_fit_is_the_one_that_simulates_best(axis: Machine) -> None:
    data = recordings(axis, residue=0.1)
    best = fit_with_model_error(fitted_axis(axis, data), data)
    refined = model_error.refined_in_simulation(best, data)
    costs = [prediction_cost(f.machine, data, 0.0) for f in (refined, best)]
    assert costs[0] <= costs[1]


def test_a_fit_in_simulation_stays_as_it_is(axis: Machine) -> None:
    data = recordings(axis)
    best = fit_with_model_error(fitted_axis(axis, data), data)
    assert best.bandwidth == 0.0
    assert model_error.refined_in_simulation(best, data) is best


def test_one_run_confirms_no_other_fit(axis: Machine) -> None:
    data = recordings(axis, residue=0.1).with_runs(["run_0"])
    fitted = fitted_axis(axis, data)
    assert model_error.refined_in_simulation(fitted, data) is fitted
