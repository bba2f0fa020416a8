"""Tests of the linearized residual: derivatives, normal equations, elimination, initial-state projection."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.dynamics.simulation import Motion
from hframe_gym.identification import (
    Dataset,
    FreeParameter,
    PreparedRecording,
    default_free_parameters,
    prepare,
)
from hframe_gym.identification.predict.free_parameters import parameter_table, prior_precision, values_at
from hframe_gym.identification.predict.linearization import ResidualModel, forward_differences
from hframe_gym.identification.predict.normal_equations import NormalEquations
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH, SIMULATION
from hframe_gym.machine import BUILTIN_MACHINES, Coordinate, Machine
from hframe_gym.recordings import Recording
from tests.example_runs import example_runs


@pytest.fixture
def cart() -> Machine:
    """Return an axis with viscous friction only, whose motion has a closed form."""
    axis = BUILTIN_MACHINES["axis"]()
    return axis.replace(coordinates=(Coordinate("x", mass=2.0, viscous=5.0),)).replace(
        {f"{axis.drives[0].name}.Ke": 0}
    )


@pytest.fixture
def hframe_runs(hframe: Machine) -> Dataset:
    """Return two example recordings of the H-frame."""
    return prepare(example_runs("rig_b")[:2], hframe)


def step_response(cart: Machine, time_s: np.ndarray, mass: float, viscous: float) -> np.ndarray:
    """Return x(t) (n,) after a step of 3 V: x = F/b (t - tau (1 - exp(-t/tau))), tau = m/b."""
    force, tau = 3.0 * cart.drives[0].gain, mass / viscous
    return force / viscous * (time_s - tau * (1 - np.exp(-time_s / tau)))


def test_free_parameters_are_logarithmic_or_linear() -> None:
    logarithmic = FreeParameter("m", 2.0, prior=0.3)
    assert logarithmic.value(np.array([0.0, np.log(2)])) == pytest.approx([2.0, 4.0])
    assert logarithmic.slope(0.5) == pytest.approx(2.0 * np.exp(0.5))
    linear = FreeParameter("c", 0.0, prior=1.0, scale=0.5)
    assert linear.value(np.array([-1.0, 3.0])) == pytest.approx([0.0, 1.5])
    for parameter in (logarithmic, linear):
        assert parameter.value(np.array(parameter.theta(1.7))) == pytest.approx(1.7)


def test_default_free_parameters_exclude_the_first_motor_gain(hframe: Machine) -> None:
    names = {f.name for f in default_free_parameters(hframe)}
    assert "motor2.Kt" in names
    assert "motor1.Kt" not in names
    assert {"x.mass", "phi2.coulomb", "left.EA", "motor1.Ke"} <= names


def test_prior_of_a_curve_penalizes_its_second_differences() -> None:
    curve = [FreeParameter(f"f{i}", 0.0, prior=10.0, scale=1.0, along="curve") for i in range(4)]
    precision = prior_precision([FreeParameter("m", 1.0, prior=0.5), *curve])
    straight, bent = np.array([0, 1, 2, 3, 4.0]), np.array([0, 1, 0, 1, 0.0])
    assert straight @ precision @ straight == pytest.approx(30 / 100)
    assert bent @ precision @ bent == pytest.approx(2 / 100 + 4 + 4)
    assert precision[0, 0] == pytest.approx(4.0)


def test_parameter_table_replaces_only_free_parameters(hframe: Machine) -> None:
    free = [FreeParameter("x.mass", 4.0, prior=0.3), FreeParameter("left.EA", 1e4, prior=0.3)]
    thetas = np.array([[0.0, 0.0], [0.1, -0.2]])
    table = parameter_table(hframe, free, thetas)
    for row, theta in zip(table, thetas, strict=True):
        expected = hframe.replace(values_at(free, theta)).parameters
        np.testing.assert_allclose(row, list(expected.values()))


def test_jacobian_matches_the_closed_form(cart: Machine) -> None:
    time_s = np.arange(1500) * 1e-3
    position = step_response(cart, time_s, 2.0, 5.0)
    data = prepare([Recording("run", time_s, np.full((1500, 1), 3.0), position[:, None])], cart)
    free = (FreeParameter("x.mass", 2.0, prior=0.3), FreeParameter("x.viscous", 5.0, prior=0.7))
    model = ResidualModel(cart, free, data, SIMULATION)
    linear = model.at(np.zeros(2)).linearize_run(data.runs[0])
    h = 1e-5
    for row, (dm, db) in zip(linear.jacobian, ((h, 0.0), (0.0, h)), strict=True):
        slope = (
            step_response(cart, time_s, 2.0 * np.exp(dm), 5.0 * np.exp(db))
            - step_response(cart, time_s, 2.0 * np.exp(-dm), 5.0 * np.exp(-db))
        ) / (2 * h)
        slope -= slope.mean()  # the sensor is not quantized, so the zero of the run is fitted
        np.testing.assert_allclose(row * data.noise[0], -slope, atol=1e-3 * np.abs(slope).max())


def test_normal_equations_are_products_summed_over_runs() -> None:
    rng = np.random.default_rng(0)
    runs = [(rng.normal(size=(3, n)), rng.normal(size=n), rng.normal(size=(2, n))) for n in (20, 30)]
    total = NormalEquations.total(NormalEquations.from_rows(J, r, E) for J, r, E in runs)
    J, r, E = (np.concatenate([run[i] for run in runs], axis=-1) for i in range(3))
    np.testing.assert_allclose(total.information, J @ J.T)
    np.testing.assert_allclose(total.gradient, J @ r)
    np.testing.assert_allclose(total.cross_products, J @ E.T)
    np.testing.assert_allclose(total.response_information, E @ E.T)
    np.testing.assert_allclose(total.response_gradient, E @ r)
    assert total.cost == pytest.approx(r @ r)
    assert total.count == 50
    assert total.chi2 == pytest.approx(r @ r / 50)


def test_elimination_equals_a_joint_least_squares_fit() -> None:
    rng = np.random.default_rng(1)
    J, r, E = rng.normal(size=(3, 40)), rng.normal(size=40), rng.normal(size=(2, 40))
    reduced = NormalEquations.from_rows(J, r, E).eliminate_parameters(np.zeros((3, 3)))
    amounts = -np.linalg.solve(reduced.response_information, reduced.response_gradient)
    joint = np.linalg.lstsq(np.vstack([J, E]).T, -r, rcond=None)[0]
    np.testing.assert_allclose(amounts, joint[3:])


def test_responses_are_summed_beside_the_jacobian(cart: Machine) -> None:
    """A response that repeats the Jacobian's first column is eliminated entirely."""
    time_s = np.arange(900) * 1e-3
    position = step_response(cart, time_s, 2.0, 5.0)
    runs = [Recording(n, time_s, np.full((900, 1), 3.0), position[:, None]) for n in ("one", "two")]
    data = prepare(runs, cart)
    free = default_free_parameters(cart)[:3]
    model = ResidualModel(cart, free, data, SEARCH_BANDWIDTH, rows_per_block=4)
    plain = {run.name: model.at(np.zeros(3)).linearize_run(run) for run in data.runs}

    def responses(run: PreparedRecording, motion: Motion) -> np.ndarray:
        assert motion.positions.shape == (1, len(run.time_s), 1)
        return 2.0 * plain[run.name].jacobian[:1]

    equations = model.linearize(np.zeros(3), responses).normal_equations
    np.testing.assert_allclose(equations.cross_products[:, 0], 2.0 * equations.information[:, 0], rtol=1e-9)
    reduced = equations.eliminate_parameters(np.zeros((3, 3)))
    assert abs(reduced.response_information[0, 0]) < 1e-9 * equations.response_information[0, 0]


@pytest.mark.parametrize("bandwidth", [SEARCH_BANDWIDTH, SIMULATION])
def test_costs_agree_with_the_linearization_at_its_expansion_point(
    hframe: Machine, hframe_runs: Dataset, bandwidth: float
) -> None:
    model = ResidualModel(hframe, default_free_parameters(hframe)[:3], hframe_runs, bandwidth)
    linearization = model.linearize(np.zeros(3))
    (cost,) = linearization.costs(np.zeros((1, 3)))
    assert cost == pytest.approx(linearization.normal_equations.cost, rel=1e-9)


def test_forward_differences_are_per_unit_step() -> None:
    values = np.array([[1.0, 1.0], [1.5, 1.0], [1.0, 0.0]])
    np.testing.assert_allclose(forward_differences(values, 0.5), [[1.0, 0.0], [0.0, -2.0]])
