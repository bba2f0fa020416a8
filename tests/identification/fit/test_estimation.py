"""Tests of parameter estimation on recordings of another simulator (examples/, tools.make_examples)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from scipy.optimize import OptimizeResult, lsq_linear

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, default_free_parameters, fit, prepare
from hframe_gym.identification.budget import Budget
from hframe_gym.identification.fit import estimation
from hframe_gym.identification.fit.estimation import Fit, prediction_cost
from hframe_gym.identification.fit.model_error import polish
from hframe_gym.identification.predict import free_parameters
from hframe_gym.identification.predict.free_parameters import (
    FreeParameter,
    bounded_step,
    prior_precision,
    step_in_values,
)
from hframe_gym.identification.predict.linearization import ResidualModel
from hframe_gym.identification.predict.prediction import POLISH_STEP, SEARCH_BANDWIDTH, SIMULATION
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import Recording
from tests.example_runs import example_runs
from tools.make_examples import TRUE_RIG


@pytest.fixture
def data(hframe: Machine) -> Dataset:
    """Return the recordings of the example rig without undeclared effects."""
    return prepare(example_runs("rig_b"), hframe)


@pytest.mark.oracle
def test_fit_recovers_the_parameters_of_the_reference_simulator(hframe: Machine, data: Dataset) -> None:
    first_fit = fit(hframe, default_free_parameters(hframe), data, SEARCH_BANDWIDTH)
    fitted = fit(hframe, default_free_parameters(hframe), data, SIMULATION, theta=first_fit.theta)
    assert fitted.chi2 < 1.1
    # Voltages determine forces only in units of the first motor's gain.
    gains = [k * g for k, g in zip(TRUE_RIG.torque_constant, TRUE_RIG.drive_gain, strict=True)]
    unit = gains[0] / hframe.drives[0].Kt
    values = fitted.machine.parameters
    for i, name in enumerate(("x", "y", "phi1", "phi2")):
        assert values[f"{name}.mass"] * unit == pytest.approx(TRUE_RIG.mass[i], rel=0.01)
        assert values[f"{name}.coulomb"] * unit == pytest.approx(TRUE_RIG.coulomb[i], rel=0.01)
    assert values["motor2.Kt"] * unit == pytest.approx(gains[1], rel=0.01)


def test_fit_reports_the_cost_of_its_machine(hframe: Machine, data: Dataset) -> None:
    two_runs = data.with_runs([run.name for run in data.runs[:2]])
    fitted = fit(hframe, default_free_parameters(hframe), two_runs, SEARCH_BANDWIDTH, iterations=3)
    assert fitted.cost == pytest.approx(prediction_cost(fitted.machine, two_runs, SEARCH_BANDWIDTH), rel=1e-7)
    assert fitted.cost < prediction_cost(hframe, two_runs, SEARCH_BANDWIDTH)
    assert fitted.chi2 == fitted.cost / two_runs.count


def test_a_fit_that_cannot_come_down_to_its_goal_ends_early(hframe: Machine, data: Dataset) -> None:
    """One that may reach it is the same as without a goal."""
    run = data.with_runs([data.runs[0].name])
    without_drives = hframe.replace({f"motor{j}.Kt": 1e-3 * hframe.drives[j - 1].Kt for j in (1, 2)})
    free = default_free_parameters(without_drives)
    complete, steps = _counted(without_drives, free, run, SEARCH_BANDWIDTH)
    assert steps > 3
    vain = _counted(without_drives, free, run, SEARCH_BANDWIDTH, goal=0.01 * complete.cost)
    assert vain[1] < steps
    assert vain[0].cost > 0.01 * complete.cost
    reached = fit(without_drives, free, run, SEARCH_BANDWIDTH, goal=1.01 * complete.cost)
    assert reached.cost == complete.cost


def test_a_step_that_keeps_its_promise_is_the_last_one(hframe: Machine, data: Dataset) -> None:
    """Near the minimum, the linear model is exact, and no second linearization has to confirm that."""
    run = data.with_runs([data.runs[0].name])
    free = default_free_parameters(hframe)
    fitted = fit(hframe, free, run, SEARCH_BANDWIDTH)
    near = fitted.theta + 1e-3
    again, steps = _counted(hframe, free, run, SEARCH_BANDWIDTH, theta=near)
    assert steps == 1
    assert again.cost == pytest.approx(fitted.cost, rel=1e-4)


@pytest.mark.parametrize(
    ("found", "next_decrease"),
    [
        ([10.0, 8.0], 0.0),
        ([9.0, 8.0], 0.225),  # (1 - 9 / 10)^2 of 10, times 9/4
        ([10.0, 7.0], 0.225),  # the first one by chance
        ([-math.inf, 8.0], math.inf),
    ],
)
def test_the_worst_trial_tells_what_a_further_step_would_add(
    found: list[float], next_decrease: float
) -> None:
    promised = np.array([10.0, 8.0])
    assert estimation._next_decrease(promised, np.array(found)) == pytest.approx(next_decrease)


@pytest.mark.parametrize(
    ("promised", "remaining", "lowest"),
    [
        (520.0, 10, 5400.0),  # one step along a curved valley; two iterations later, it was down at 5306
        (15.0, 10, 5700.0),
        (15.0, 2, 5860.0),
        (-1.0, 0, 5900.0),
    ],
)
def test_a_fit_may_come_down_to_what_was_promised_or_by_steps_like_the_last_one(
    promised: float, remaining: int, lowest: float
) -> None:
    assert estimation._lowest_cost(5920.0, 5900.0, promised, remaining) == lowest


def _counted(*arguments: Any, **options: Any) -> tuple[Fit, int]:
    """Return a fit, and the number of its iterations, before each of which it asks the budget."""
    steps: list[str] = []
    budget = Budget(progress=lambda doing, spent, seconds: steps.append(doing))
    with budget.limiting():
        return fit(*arguments, **options), len(steps)


def test_a_fit_ends_no_worse_than_it_starts(
    hframe: Machine, data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The costs of trials may promise too much, because they have the integration step of another machine."""
    run = data.with_runs([data.runs[0].name])
    free = default_free_parameters(hframe)
    start = fit(hframe, free, run, SEARCH_BANDWIDTH)

    def misled(trials: np.ndarray, costs: np.ndarray, theta: np.ndarray, cost: float) -> Any:
        return theta + 0.1, 0.5 * cost

    monkeypatch.setattr(estimation, "_best_trial", misled)
    for iterations in (1, 3):
        fitted = fit(hframe, free, run, SEARCH_BANDWIDTH, theta=start.theta, iterations=iterations)
        np.testing.assert_array_equal(fitted.theta, start.theta)
        assert fitted.cost == pytest.approx(start.cost, rel=1e-7)


@pytest.mark.parametrize(("determined", "kept"), [(np.multiply, 0), (np.add, 1)])
def test_a_step_has_an_end_where_the_determined_product_or_sum_remains(
    determined: Callable[..., Any], kept: int
) -> None:
    """Inertias of parts are a sum, a length and a stiffness a product."""
    free = [FreeParameter(name, 2.0, prior=1.0) for name in "ab"]
    steps = np.array([[-1e-3, 1e-3], [-0.5, 0.5]])
    ends = estimation._ends(free, np.zeros(2), steps)
    assert len(ends) == 3  # both ends of a short step are nearly the same
    results = determined(*(f.value(ends[1:, j]) for j, f in enumerate(free)))
    assert results[kept] == pytest.approx(4.0)
    assert abs(results[1 - kept] - 4.0) > 0.5


def test_a_step_in_values_moves_each_value_by_what_its_derivative_says() -> None:
    logarithmic = FreeParameter("a", 2.0, prior=1.0)
    linear = FreeParameter("b", 2.0, prior=1.0, scale=3.0, upper=9.0)
    free, theta = [logarithmic, linear], np.array([0.1, 0.2])
    for step in ([0.3, 0.4], [-0.9, -0.1]):
        moved = theta + step_in_values(free, theta, np.array([step]))[0]
        for f, before, change, after in zip(free, theta, step, moved, strict=True):
            assert f.value(after) == pytest.approx(f.value(before) + f.slope(before) * change)
    beyond = theta + step_in_values(free, theta, np.array([[-1.5, 5.0]]))[0]
    assert beyond == pytest.approx([-4.0, 7.0 / 3.0])  # no logarithm of a negative value; within the bounds


def test_parts_of_a_known_total_inertia_are_found_in_few_iterations(hframe: Machine) -> None:
    """The data determine the totals of motors and cart, of which those of the idlers are parts."""
    idlers = EFFECTS["idler_inertia"]
    machine = hframe.with_effects(idlers.at("machine", J_left=8e-5, J_right=4e-5, B_left=2e-3, B_right=5e-4))
    start = hframe.with_effects(
        idlers.at("machine", J_left=5.6e-5, J_right=5.6e-5, B_left=1e-3, B_right=1e-3)
    )
    data = prepare(list(_recordings(machine)), hframe)
    free = default_free_parameters(start)
    fitted = fit(start, free, data, SEARCH_BANDWIDTH, iterations=8)
    assert fitted.cost < prediction_cost(machine, data, SEARCH_BANDWIDTH)  # at the true values


def test_a_tight_prior_keeps_the_declared_parameters(hframe: Machine, data: Dataset) -> None:
    tight = [dataclasses.replace(f, prior=1e-9) for f in default_free_parameters(hframe)]
    fitted = fit(hframe, tight, data.with_runs([data.runs[0].name]), SEARCH_BANDWIDTH)
    for parameter in tight:
        assert fitted.values[parameter.name] == pytest.approx(
            hframe.parameters[parameter.name], rel=1e-6, abs=1e-9
        )
    np.testing.assert_allclose(fitted.theta, 0.0, atol=1e-8)


def test_a_linear_parameter_may_exceed_its_typical_size_by_far(hframe: Machine, data: Dataset) -> None:
    mass = hframe.parameters["x.mass"]
    free = FreeParameter("x.mass", 0.5 * mass, prior=10.0, scale=mass / 100)
    fitted = fit(hframe, [free], data.with_runs([data.runs[0].name]), SEARCH_BANDWIDTH)
    assert fitted.theta[0] > 40.0  # four standard deviations
    near = fit(
        hframe, [dataclasses.replace(free, scale=mass)], data.with_runs([data.runs[0].name]), SEARCH_BANDWIDTH
    )
    assert fitted.values["x.mass"] == pytest.approx(near.values["x.mass"], rel=0.01)


def test_a_start_from_which_the_machine_diverges_has_an_infinite_cost(hframe: Machine, data: Dataset) -> None:
    machine = hframe.with_effects(EFFECTS["cable_spring"].at("x", k=-1e6, q0=0.0))
    free = FreeParameter("cable_spring@x.k", -1e6, prior=10.0, scale=1e-6, lower=-1e6, upper=1e6)
    fitted = fit(machine, [free], data.with_runs([data.runs[0].name]), SIMULATION)
    assert fitted.cost == math.inf


@pytest.mark.parametrize("rounded", [False, True])
def test_a_step_within_limits_is_the_best_one_there(rounded: bool) -> None:
    """The unlimited minimum is outside the limits. Rounding may give the matrix a negative eigenvalue."""
    free = [
        FreeParameter("a", 1.0, prior=0.25),
        FreeParameter("b", 1.0, prior=0.5),
        FreeParameter("c", 0.0, 1.0, 1.0, lower=-math.inf),
    ]
    theta, gradient = np.array([0.2, 0.0, 0.0]), np.array([-3.0, 1.0, -0.5])
    hessian = np.array([[1.0, 0.9, 0.2], [0.9, 1.0, 0.1], [0.2, 0.1, 1.0]])
    if rounded:
        hessian = np.array([[1.0, 1.0, 0.0], [1.0, 1.0 - 1e-15, 0.0], [0.0, 0.0, 1.0]])
        assert np.linalg.eigvalsh(hessian)[0] < 0.0
    step = bounded_step(free, theta, hessian, gradient)
    assert np.all(np.abs(theta + step)[:2] <= [1.0, 2.0])

    def cost(steps: np.ndarray) -> np.ndarray:
        return 2.0 * steps @ gradient + np.einsum("ni,ij,nj->n", steps, hessian, steps)

    axes = np.linspace(-1.2, 0.8, 81), np.linspace(-2.0, 2.0, 81), np.linspace(-3.0, 3.0, 121)
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    assert cost(step[None])[0] <= cost(grid).min() + 1e-6


@pytest.mark.parametrize("on_any_platform", [False, True])
def test_a_step_is_finite_where_bounded_least_squares_divides_by_zero(
    on_any_platform: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last parameter changes no prediction and is at its limit: BVLS releases it and errs by rounding.

    Then it divides by the distance from its optimum, which is zero, and its solution is not a number (SciPy
    1.17). The numbers are rounded ones of a trial fit of belt play; whether they show it depends on the
    linear algebra library.
    """
    if on_any_platform:

        def without_solution(A: np.ndarray, b: np.ndarray, bounds: Any, method: str) -> Any:
            solution = lsq_linear(A, b, bounds, method=method)
            return OptimizeResult(x=np.full(6, np.nan)) if method == "bvls" else solution

        monkeypatch.setattr(free_parameters, "lsq_linear", without_solution)
    lower = np.array([-0.63, -1.7, -2.4, 0.0, -15.0, -1.0])
    upper = np.array([16.0, 3.9, 0.0, 0.8, 85.0, 0.0])
    gradient = np.array([-2e6, -2e5, -1e6, 6e6, -9e5, 0.0])
    hessian = np.array(
        [
            [53_700_000.0, 4_610_000.0, 351_000.0, 693_000.0, 110_000.0, 0.0],
            [4_610_000.0, 581_000.0, 83_700.0, 40_600.0, 54_200.0, 0.0],
            [351_000.0, 83_700.0, 1_200_000.0, 294_000.0, 151_000.0, 0.0],
            [693_000.0, 40_600.0, 294_000.0, 5_250_000.0, -379_000.0, 0.0],
            [110_000.0, 54_200.0, 151_000.0, -379_000.0, 114_000.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 10.4],
        ]
    )
    step = free_parameters._minimum_by_least_squares(hessian, gradient, (lower, upper))
    assert np.all((lower <= step) & (step <= upper))
    # Conditions for the minimum: the slope is zero, except where it points beyond a limit.
    slope, near = (hessian @ step + gradient) / np.sqrt(np.diag(hessian)), 1e-3
    assert np.all((slope > -near) | (step > upper - near))
    assert np.all((slope < near) | (step < lower + near))


def test_active_sets_find_the_minimum_of_bounded_least_squares() -> None:
    rng, settled = np.random.default_rng(0), 0
    for _ in range(60):
        count = int(rng.integers(1, 20))
        root = rng.normal(size=(count, count)) * np.exp(2.0 * rng.normal(size=count))
        hessian, gradient = root.T @ root + 0.01 * np.eye(count), np.exp(rng.normal(size=count)) - 1.0
        low = np.where(rng.random(count) < 0.2, -np.inf, -np.exp(rng.normal(size=count)))
        high = np.where(
            rng.random(count) < 0.2, np.inf, np.exp(rng.normal(size=count)) * (rng.random(count) < 0.8)
        )
        step = free_parameters._minimum_by_active_sets(hessian, gradient, low, high)
        if step is not None:
            settled += 1
            expected = free_parameters._minimum_by_least_squares(hessian, gradient, (low, high))
            assert np.all((low <= step) & (step <= high))
            costs = [2.0 * s @ gradient + s @ hessian @ s for s in (step, expected)]
            assert costs[0] <= costs[1] + 1e-9 * abs(costs[1])
    assert settled > 50


def test_a_step_keeps_linear_parameters_within_their_bounds() -> None:
    free = [FreeParameter("a", 2.0, prior=0.5, scale=2.0, lower=1.0, upper=6.0)]
    for gradient, value in ((1e3, 1.0), (-1e3, 6.0), (-1.0, 4.0)):
        step = bounded_step(free, np.zeros(1), np.eye(1), np.array([gradient]))
        assert free[0].value(step) == pytest.approx([value])


@pytest.mark.parametrize(("viscous", "back_emf"), [(0.1, 0.6), (0.15, 0.7)])
def test_parameters_that_act_alike_converge_to_the_most_probable_values(
    viscous: float, back_emf: float
) -> None:
    """The data determine the sum of viscous friction and back-EMF; the prior determines the difference.

    The expected decrease of the cost by a further step is that of a tenth of a standard deviation at most.
    """
    axis = BUILTIN_MACHINES["axis"]()
    values = axis.parameters
    machine = axis.replace(
        {"x.viscous": viscous * values["x.viscous"], "motor.Ke": back_emf * values["motor.Ke"]}
    )
    data = prepare(list(_recordings(machine)), axis)
    free = default_free_parameters(axis)
    fitted = polish(fit(axis, free, data, SIMULATION), data)
    equations = ResidualModel(fitted.machine, free, data, SIMULATION, POLISH_STEP).linearize(fitted.theta)
    precision = prior_precision(free) * fitted.chi2
    gradient = equations.normal_equations.gradient + precision @ fitted.theta
    step = -np.linalg.solve(equations.normal_equations.information + precision, gradient)
    assert -step @ gradient < 0.1 * fitted.chi2


def _recordings(machine: Machine) -> Iterator[Recording]:
    """Yield four runs of two seconds under random voltages, with the noise of the sensors."""
    rng = np.random.default_rng(1)
    for k in range(4):
        time_s = np.arange(2000) * 1e-3
        rated = [drive.rated_voltage for drive in machine.drives]
        inputs = 0.8 * np.repeat(rng.uniform(-1.0, 1.0, (40, len(rated))), 50, axis=0) * rated
        inputs[:100] = 0.0
        outputs = simulate(machine, time_s, inputs).outputs
        noise = rng.normal(0.0, 1.0, outputs.shape) * [sensor.noise or 1e-6 for sensor in machine.sensors]
        yield Recording(f"run_{k}", time_s, inputs, outputs + noise)
