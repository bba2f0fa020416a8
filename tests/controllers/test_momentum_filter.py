"""Tests of the online estimation: against an independent simulator, and on randomized stages."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers import AdaptiveController, MomentumFilter, MotionModel
from hframe_gym.machine import Machine
from tests.controllers.closed_loop import PERIOD, circles, closed_loop, random_stages
from tests.reference_simulator import Rig, Stage

pytestmark = pytest.mark.integration

FRICTION_X, FRICTION_PHI1, FRICTION_PHI2, MASS_X, BELTS = 0, 2, 3, 4, 8  # columns of the estimates


def filter_after(machine: Machine, rig: Rig, periods: int) -> MomentumFilter:
    """Return a filter that has observed a rig of the independent simulator under sinusoidal voltages."""
    model = MotionModel(machine)
    estimator, stage = MomentumFilter(model, PERIOD), Stage(rig, np.zeros(2), rtol=1e-7, atol=1e-10)

    def measured_state() -> np.ndarray:
        return model.state({"observation": np.concatenate([stage.position, stage.velocity])[None]})

    before, starts, no_force = measured_state(), np.ones(1, np.bool_), np.zeros((1, 4))
    estimator.update(before, before, np.zeros((1, 2)), no_force, starts)
    for k in range(periods):
        t = k * PERIOD
        volts = np.array([4.0 * np.sin(19.0 * t) + 3.0 * np.sin(41.0 * t), 4.0 * np.sin(26.0 * t + 1.0)])
        stage.step(volts, t + PERIOD)
        after = measured_state()
        estimator.update(before, after, volts[None], no_force, ~starts)
        before = after
    return estimator


@pytest.mark.oracle
def test_estimates_approach_the_parameters_of_an_independent_simulator(hframe: Machine) -> None:
    declared = Rig()
    coulomb, mass = declared.coulomb, declared.mass
    rig = Rig(
        coulomb=(1.5 * coulomb[0], coulomb[1], 1.3 * coulomb[2], 0.7 * coulomb[3]),
        mass=(1.1 * mass[0], *mass[1:]),
        belt_EA_N=tuple(0.8 * EA for EA in declared.belt_EA_N),
    )
    estimates = filter_after(hframe, rig, 150).estimates[0]
    expected = {FRICTION_X: 0.5, FRICTION_PHI1: 0.3, FRICTION_PHI2: -0.3, MASS_X: 0.1, BELTS: -0.2}
    for column, value in expected.items():
        assert estimates[column] == pytest.approx(value, abs=0.25 * abs(value)), column


@pytest.mark.oracle
def test_estimates_stay_near_zero_on_the_declared_machine(hframe: Machine) -> None:
    estimator = filter_after(hframe, Rig(), 150)
    columns = [FRICTION_X, FRICTION_PHI1, FRICTION_PHI2, MASS_X, BELTS]
    assert np.abs(estimator.estimates[0, columns]).max() < 0.1
    np.testing.assert_allclose(estimator.mass_ratio, 1.0, atol=0.05)
    np.testing.assert_allclose(estimator.stiffness_ratio, 1.0 + estimator.estimates[:, BELTS])


def test_randomized_stages_are_identified_within_a_circle(hframe: Machine) -> None:
    count = 48
    goals, changes = circles(count, 6, periods=150), random_stages(hframe, count, 7)
    adaptive = AdaptiveController(hframe, PERIOD)
    closed_loop(adaptive, hframe, goals[:, 0], goals, changes=changes, periods=150)
    belt = f"{hframe.belts[0].name}.EA"
    # Largest root mean square error relative to the parameter's standard deviation among the stages.
    limits = {
        (FRICTION_X, "x.coulomb"): 0.4,
        (FRICTION_PHI1, "phi1.coulomb"): 0.3,
        (FRICTION_PHI2, "phi2.coulomb"): 0.3,
        (MASS_X, "x.mass"): 0.6,
        (BELTS, belt): 0.8,
    }
    for (column, name), limit in limits.items():
        true_error = changes[name] / hframe.parameters[name] - 1.0
        rms = np.sqrt(np.mean((adaptive.estimates[:, column] - true_error) ** 2))
        assert rms < limit * true_error.std(), name


@pytest.mark.oracle
def test_estimates_are_cleared_where_an_episode_starts(hframe: Machine) -> None:
    estimator = filter_after(hframe, Rig(), 20)
    rest = estimator.model.goal_state(np.zeros((1, 2)))
    assert np.abs(estimator.estimates).max() > 0.0
    estimator.update(rest, rest, np.zeros((1, 2)), np.zeros((1, 4)), np.ones(1, np.bool_))
    assert np.all(estimator.estimates == 0.0)
