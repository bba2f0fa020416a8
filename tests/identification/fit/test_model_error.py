"""Tests of the model error: its size, the bandwidth that it requires, and whether an effect stands out from it."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hframe_gym.dynamics import simulate_batch
from hframe_gym.effects import EFFECTS
from hframe_gym.effects.smooth_table import KNOTS, definition
from hframe_gym.identification import Dataset, Fit, default_free_parameters, fit, prepare
from hframe_gym.identification.fit import model_error
from hframe_gym.identification.fit.estimation import (
    costs_left_out,
    costs_of_some_left_out,
    prediction_cost,
)
from hframe_gym.identification.fit.long_run_variance import long_run_variance
from hframe_gym.identification.fit.model_error import (
    BANDWIDTHS,
    fit_with_model_error,
    leave_one_out_gain,
    likelihood_deficit,
    likelihood_loss,
    narrower_observer,
    pieces_left_out,
    ratios_to_others,
    refitted_leave_one_out_gain,
)
from hframe_gym.identification.forces.force_sizes import residue_force
from hframe_gym.identification.predict.free_parameters import FreeParameter
from hframe_gym.identification.predict.normal_equations import NormalEquations
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording
from tests.identification.scripted_fits import DATA, HFRAME, fit_with

NOISE = 20e-6  # m
TABLE = definition("smooth_friction[time]").at(
    "x", **{f"{c}{i:02d}": float(i) for c in "kf" for i in range(KNOTS)}
)
ROWS = 1500


def smoothed(values: np.ndarray, rows: int) -> np.ndarray:
    """Return white noise smoothed over some rows, with a standard deviation of 1."""
    colored = np.convolve(values, np.exp(-np.arange(8 * rows) / rows), "same")
    return np.asarray(colored / np.std(colored))


def recordings(
    axis: Machine,
    *,
    residue: float | tuple[float, ...] = 0.0,
    color_rows: int = 0,
    forces: tuple[float, ...] = (0.0,) * 4,
) -> Dataset:
    """Return runs of an axis, one per constant force (N), with a random slow force (N) and perhaps colored noise."""
    runs = []
    residues = residue if isinstance(residue, tuple) else (residue,) * len(forces)
    for k, (size, slow) in enumerate(zip(forces, residues, strict=True)):
        rng = np.random.default_rng(k)
        time_s = np.arange(ROWS) * 1e-3
        inputs = np.where(time_s > 0.1, 1.5 * np.sin((8 + k) * time_s) + 0.7 * np.sin(31 * time_s), 0.0)[
            :, None
        ]
        force = slow * smoothed(rng.normal(size=ROWS), 200)
        force[:120] = 0.0
        machine = axis.with_effects(EFFECTS["constant_force"].at("x", size=size)) if size else axis
        motion = simulate_batch(
            machine, time_s, inputs, extra_force=force[None, :, None], longest_step=0.125e-3
        )
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


@pytest.mark.parametrize(("forces", "confirmed"), [((0.05,) * 4, True), ((0.0, 0.3, 0.0, 0.0), False)])
def test_an_effect_of_one_run_is_not_confirmed_by_the_others(
    axis: Machine, forces: tuple[float, ...], confirmed: bool
) -> None:
    data = recordings(axis, forces=forces)
    without, with_effect = fitted_axis(axis, data), fitted_axis(axis, data, constant_force=True)
    gain = without.cost - with_effect.cost
    assert gain > 100.0
    for left_out_gain in (leave_one_out_gain, refitted_leave_one_out_gain):
        fraction = left_out_gain(without, with_effect, data) / gain
        assert (fraction > 0.8) if confirmed else (fraction < 0.3)


@pytest.mark.parametrize("count", [4, 2])
def test_true_fits_confirm_what_the_linear_model_does_where_it_holds(axis: Machine, count: int) -> None:
    """Four runs are left out whole, two in pieces."""
    data = recordings(axis, forces=(0.05,) * count)
    fits = fitted_axis(axis, data), fitted_axis(axis, data, constant_force=True)
    linear, refitted = leave_one_out_gain(*fits, data), refitted_leave_one_out_gain(*fits, data)
    np.testing.assert_allclose(refitted, linear, rtol=0.15)


def test_runs_are_left_out_until_the_others_cannot_confirm_an_effect(
    axis: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the second run has a force; without it, the others find none, and the second one has all of its error."""
    data = recordings(axis, forces=(0.0, 0.3, 0.0, 0.0))
    without, with_effect = fitted_axis(axis, data), fitted_axis(axis, data, constant_force=True)
    left_out: list[str] = []

    def refitted_cost(*arguments: Any) -> float:
        left_out.append(arguments[-1].runs[0].name)
        return original(*arguments)

    original = model_error._refitted_cost
    monkeypatch.setattr(model_error, "_refitted_cost", refitted_cost)
    least = 0.3 * (without.cost - with_effect.cost)
    limit = refitted_leave_one_out_gain(without, with_effect, data, least)
    assert left_out == [data.runs[1].name]
    assert refitted_leave_one_out_gain(without, with_effect, data) <= limit < least


# -- decisions with scripted fits --------------------------------------------------------------------------------------


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
    """Position gain K = 2 * bandwidth * period; innovations have 1 / (1 - K) times the variance of the noise."""
    data: Any = SimpleNamespace(
        period=1e-3, has_voltage_errors=False, runs=[SimpleNamespace(weights=np.ones((100, 1)))]
    )
    variance = 1.0 / (1.0 - 2.0 * 30.0 * 1e-3)
    loss = model_error.likelihood_loss(fit_with(chi2=1.3, bandwidth=30.0), data)
    assert loss == pytest.approx(1.3 / variance + np.log(variance))
    assert model_error.likelihood_loss(fit_with(chi2=1.3), data) == pytest.approx(1.3)
    slow: Any = SimpleNamespace(period=0.1, has_voltage_errors=False, runs=data.runs)
    assert model_error.likelihood_loss(fit_with(chi2=1.3, bandwidth=60.0), slow) == pytest.approx(
        0.13 + np.log(10.0)
    )


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


@pytest.mark.parametrize("names", ["abcde", "ab"])
def test_what_is_left_out_has_the_cost_of_a_fit_to_the_others(names: str) -> None:
    """Compare with a least-squares solution for each part; two runs are divided into four parts each."""
    rng = np.random.default_rng(0)
    rows = {name: (rng.normal(size=(2, 80)), rng.normal(size=80)) for name in names}
    free = tuple(FreeParameter(f"p{i}", 1.0, 0.5) for i in range(2))
    theta0 = np.array([0.3, -0.2])
    pieces = 1 if len(names) >= 4 else 4
    parts = [
        (j, r)
        for jacobian, residual in rows.values()
        for j, r in zip(np.array_split(jacobian, pieces, 1), np.array_split(residual, pieces), strict=True)
    ]
    everything = sum(float(np.sum((r + theta0 @ j) ** 2)) for j, r in parts)
    chi2 = everything / (80 * len(names))
    precision = np.eye(2) / 0.5**2 * max(1.0, chi2)
    expected = []
    for left_out in range(len(parts)):
        others = [part for k, part in enumerate(parts) if k != left_out]
        information = sum(j @ j.T for j, _ in others) + precision
        theta = -np.linalg.solve(information, sum(j @ r for j, r in others))
        costs = [float(np.sum((r + theta @ j) ** 2)) for j, r in parts]
        expected.append((costs[left_out], sum(costs) - costs[left_out]))
    equations = [
        piece
        for jacobian, residual in rows.values()
        for piece in NormalEquations.of_pieces(jacobian, residual + theta0 @ jacobian, 80, pieces)
    ]
    np.testing.assert_allclose(costs_left_out(equations, free, theta0), expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("forces", "confirmed"), [((1.0, 1.0, 1.0, 1.0), True), ((4.0, 0.0, 0.0, 0.0), False)]
)
def test_a_run_that_alone_determines_another_parameter_judges_an_effect_by_it(
    forces: tuple[float, ...], confirmed: bool
) -> None:
    """Only run 0 reaches the limit of a current, which is far from the declared one; the tested force acts as well."""
    rng = np.random.default_rng(1)
    limit, force = FreeParameter("limit", 1.0, 10.0), FreeParameter("force", 1.0, 10.0)
    rows = [rng.normal(size=(2, 400)) for _ in forces]
    rows[0][1] += 0.3 * rows[0][0]
    for jacobian in rows[1:]:
        jacobian[0] = 0.0
    measured = [rng.normal(size=400) - 30.0 * j[0] - f * j[1] for j, f in zip(rows, forces, strict=True)]

    def fitted_equations(used: slice) -> tuple[list[NormalEquations], np.ndarray]:
        jacobians = [jacobian[used] for jacobian in rows]
        precision = np.eye(len(jacobians[0])) / 10.0**2
        information = sum(j @ j.T for j in jacobians) + precision
        theta = -np.linalg.solve(information, sum(j @ r for j, r in zip(jacobians, measured, strict=True)))
        return [
            NormalEquations.from_rows(j, r + theta @ j) for j, r in zip(jacobians, measured, strict=True)
        ], theta

    without, _ = fitted_equations(slice(0, 1))
    with_effect, theta = fitted_equations(slice(0, 2))
    gain = sum(part.cost for part in without) - sum(part.cost for part in with_effect)
    tested = np.array([False, True])
    left = costs_of_some_left_out(with_effect, tested, (limit, force), theta)
    fraction = (sum(part.cost for part in without) - sum(left)) / gain
    assert (fraction > 0.95) if confirmed else (fraction < 0.0)


@pytest.mark.parametrize(
    ("table", "count", "pieces"),
    [(False, 4, 1), (False, 3, 3), (False, 1, 8), (True, 4, 2), (True, 3, 3)],
)
def test_what_is_left_out_to_confirm_an_effect(table: bool, count: int, pieces: int) -> None:
    """Some values of a table may depend on one run alone; without half of it, the other half determines them."""
    assert pieces_left_out(count, table=table) == pieces


def test_runs_of_different_length_are_compared_per_sample() -> None:
    costs = [(200.0, 150.0), (50.0, 300.0), (50.0, 300.0), (50.0, 300.0)]
    ratios = ratios_to_others(costs, [100, 500, 500, 500])
    assert ratios == pytest.approx([2.0 / 0.1, *[0.1 / (300.0 / 1100.0)] * 3])


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


def test_cross_validation_predicts_runs_that_were_not_fitted(axis: Machine) -> None:
    """A machine that fits three equal runs also predicts each of them; a run with a force of its own is no such run."""
    equal, other = recordings(axis), recordings(axis, forces=(0.0, 0.6, 0.0, 0.0))
    ratios = []
    for data in (equal, other):
        fitted = fitted_axis(axis, data, constant_force=True)
        ratios.append(
            model_error._cross_validated_cost(fitted, data) / prediction_cost(fitted.machine, data, 60.0)
        )
    assert ratios[0] < 1.05
    assert ratios[1] > 1.2


def test_one_run_confirms_no_other_fit(axis: Machine) -> None:
    data = recordings(axis, residue=0.1).with_runs(["run_0"])
    fitted = fitted_axis(axis, data)
    assert model_error.refined_in_simulation(fitted, data) is fitted
