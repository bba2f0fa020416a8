"""Tests of the adaptive controller, compared with the model-based one on stages unlike their machine file.

Its online estimation is tested against an independent simulator and on randomized stages.
"""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers import AdaptiveController, ModelBasedController, MomentumFilter, MotionModel
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import Track
from hframe_gym.errors import InputError
from hframe_gym.evaluation import Scenario, rollout
from hframe_gym.machine import Machine
from tests.controllers.closed_loop import PERIOD, PREVIEW, circles, closed_loop, random_points, random_stages
from tests.reference_simulator import Rig, Stage

pytestmark = pytest.mark.integration

COUNT = 32
FRICTION_X, FRICTION_PHI1, FRICTION_PHI2, MASS_X, BELTS = 0, 2, 3, 4, 8  # columns of the estimates
MODELED_EFFECTS = {
    "none": (),
    "dead band": (EFFECTS["dead_band"].at("motor1", Vd=0.5, drop=0.5),),
    "forces": (
        EFFECTS["stribeck_friction"].at("x", dF=1.5, vs=0.03),
        EFFECTS["constant_force"].at("y", size=5.0),
    ),
}


@pytest.mark.parametrize("effects", MODELED_EFFECTS)
def test_tracks_circles_more_accurately(hframe: Machine, effects: str) -> None:
    machine = hframe.with_effects(*MODELED_EFFECTS[effects])
    goals, changes = circles(COUNT, 2), random_stages(hframe, COUNT, 3)
    adaptive_rms, model_based_rms = [
        np.sqrt(
            np.mean(
                closed_loop(kind(machine, PERIOD), machine, goals[:, 0], goals, changes=changes).error ** 2
            )
        )
        for kind in (AdaptiveController, ModelBasedController)
    ]
    assert adaptive_rms < 0.6 * model_based_rms


def test_tracks_circles_more_accurately_with_a_dead_time(hframe: Machine) -> None:
    machine = hframe.with_effects(EFFECTS["input_delay"].at("drives", d=0.013))
    scenario = Scenario(machine, task=Track(previews=12), episodes=COUNT, seed=7)
    adaptive_rms, model_based_rms = [
        np.sqrt(np.mean(rollout(kind(machine, PERIOD), scenario).contour ** 2, axis=1)).mean()
        for kind in (AdaptiveController, ModelBasedController)
    ]
    assert adaptive_rms < 0.85 * model_based_rms


def test_randomized_stages_come_to_rest_at_their_goals(hframe: Machine, adaptive: AdaptiveController) -> None:
    start, goal = random_points(COUNT, 4), random_points(COUNT, 5)
    loop = closed_loop(adaptive, hframe, start, goal, changes=random_stages(hframe, COUNT, 6))
    assert loop.error[:, -10:].max() < 5e-5


def test_ends_where_the_model_based_controller_does_on_the_nominal_machine(
    hframe: Machine, adaptive: AdaptiveController, model_based: ModelBasedController
) -> None:
    start, goal = random_points(COUNT, 4), random_points(COUNT, 5)
    first, second = (closed_loop(c, hframe, start, goal).error for c in (adaptive, model_based))
    assert np.abs(first - second)[:, -1].max() < 5e-5


def test_reset_clears_the_memory(hframe: Machine, adaptive: AdaptiveController) -> None:
    goals, changes = circles(3, 4, periods=30), random_stages(hframe, 3, 5)
    first, second = (
        closed_loop(adaptive, hframe, goals[:, 0], goals, changes=changes, periods=30) for _ in range(2)
    )
    np.testing.assert_array_equal(first.actions, second.actions)


def test_a_fixed_goal_after_a_path_needs_no_friction_of_the_path(
    hframe: Machine, adaptive: AdaptiveController
) -> None:
    """Environments pass fixed goals without a reset of all stages at once."""
    goals, changes = circles(3, 4, periods=5), random_stages(hframe, 3, 5)
    closed_loop(adaptive, hframe, goals[:, 0], goals, changes=changes, periods=5)
    assert np.any(adaptive.expected_friction)
    adaptive.act({"observation": np.zeros((3, 8)), "desired_goal": np.zeros((3, 2))})
    assert not np.any(adaptive.expected_friction)


def test_features_have_their_declared_sizes(hframe: Machine, adaptive: AdaptiveController) -> None:
    goals = circles(3, 4, periods=2)
    closed_loop(adaptive, hframe, goals[:, 0], goals, periods=2)
    for name, size in adaptive.feature_sizes.items():
        assert getattr(adaptive, name).shape == (3, size)


def test_preview_that_is_too_short_is_rejected(adaptive: AdaptiveController) -> None:
    observation = {"observation": np.zeros((1, 8)), "desired_goal": np.zeros((1, 2))}
    adaptive.act(observation | {"preview": np.zeros((1, 2 * PREVIEW))})
    with pytest.raises(InputError, match="the preview ends 3 periods after the dead time, 4 are needed"):
        adaptive.act(observation | {"preview": np.zeros((1, 6))})


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
