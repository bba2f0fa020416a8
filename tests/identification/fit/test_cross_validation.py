"""Tests of costs in data to which parameters were not fitted."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.identification.fit import cross_validation
from hframe_gym.identification.fit.cross_validation import (
    costs_left_out,
    costs_of_some_left_out,
    cross_validated_cost,
    leave_one_out_gain,
    pieces_left_out,
    ratios_to_others,
    refitted_leave_one_out_gain,
)
from hframe_gym.identification.fit.estimation import prediction_cost
from hframe_gym.identification.predict.free_parameters import FreeParameter
from hframe_gym.identification.predict.normal_equations import NormalEquations
from hframe_gym.machine import Machine
from tests.identification.fit.residue_runs import fitted_axis, recordings


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


def test_runs_are_left_out_until_the_others_cannot_confirm_an_effect(axis: Machine) -> None:
    """Only the second run has a force; without it, the others find none, and its whole error is left."""
    data = recordings(axis, forces=(0.0, 0.3, 0.0, 0.0))
    without, with_effect = fitted_axis(axis, data), fitted_axis(axis, data, constant_force=True)
    gain = without.cost - with_effect.cost
    limit = refitted_leave_one_out_gain(without, with_effect, data, 0.3 * gain)
    # The second run alone is left out, the others have the cost of the fit.
    others, second = data.leaving_out(1, 1)
    tested = np.array([f.name.startswith("constant_force") for f in with_effect.free])
    left_out = cross_validation._refitted_cost(with_effect, tested, data, others, second)
    fitted = prediction_cost(with_effect.machine, second, with_effect.bandwidth)
    assert limit == pytest.approx(gain + fitted - left_out, rel=1e-6)
    assert refitted_leave_one_out_gain(without, with_effect, data) < limit < 0.3 * gain


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
    """Run 0 alone reaches a current limit, which is far from the declared one; the force acts too."""
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
    """Some values of a table may depend on one run alone; without its half, the other half tells them."""
    assert pieces_left_out(count, table=table) == pieces


def test_runs_of_different_length_are_compared_per_sample() -> None:
    costs = [(200.0, 150.0), (50.0, 300.0), (50.0, 300.0), (50.0, 300.0)]
    ratios = ratios_to_others(costs, [100, 500, 500, 500])
    assert ratios == pytest.approx([2.0 / 0.1, *[0.1 / (300.0 / 1100.0)] * 3])


def test_cross_validation_predicts_runs_that_were_not_fitted(axis: Machine) -> None:
    """A machine that fits three equal runs also predicts each of them; one with its own force differs."""
    equal, other = recordings(axis), recordings(axis, forces=(0.0, 0.6, 0.0, 0.0))
    ratios = []
    for data in (equal, other):
        fitted = fitted_axis(axis, data, constant_force=True)
        ratios.append(cross_validated_cost(fitted, data) / prediction_cost(fitted.machine, data, 60.0))
    assert ratios[0] < 1.05
    assert ratios[1] > 1.2
