"""Tests of the compensation of dead time and of the drives' static nonlinearities."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from hframe_gym.controllers import DeadTime, InputInversion, ModelBasedController
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.evaluation import Scenario, rollout, score_episodes
from hframe_gym.machine import Machine

pytestmark = pytest.mark.integration

PERIOD = 0.01


def delayed(machine: Machine, delay_s: float) -> Machine:
    """Return the machine with a dead time of both drives."""
    return machine.with_effects(EFFECTS["input_delay"].at("drives", d=delay_s))


def with_dead_band(machine: Machine, drop: float = 1.0) -> Machine:
    """Return the machine with a dead band at motor 1 and a voltage offset at motor 2."""
    return machine.with_effects(
        EFFECTS["dead_band"].at("motor1", Vd=0.4, drop=drop), EFFECTS["voltage_offset"].at("motor2", V0=0.5)
    )


@pytest.mark.parametrize("delay_s", [0.004, 0.01, 0.013, 0.03])
def test_predicts_the_state_of_the_delayed_machine(hframe: Machine, delay_s: float) -> None:
    """The reference is a finely sampled simulation of the delayed machine."""
    machine = delayed(hframe, delay_s)
    volts = np.random.default_rng(0).uniform(-8.0, 8.0, (12, 2))
    dead_time = DeadTime(machine, PERIOD)
    dead_time.reset(np.ones(1, np.bool_))
    for row in volts:
        dead_time.send(row[None])
    fine = 1e-3 * np.arange(200)
    held = np.vstack([np.repeat(volts, 10, axis=0), np.zeros((80, 2))])
    motion = simulate(machine, fine, held)
    states = np.hstack([motion.positions, motion.velocities]) * np.tile(machine.travel_per_unit, 2)
    predicted = dead_time.predict(states[120:121])
    expected = states[120 + round(delay_s / 1e-3)]
    np.testing.assert_allclose(predicted[0, :4], expected[:4], atol=2e-6)
    np.testing.assert_allclose(predicted[0, 4:], expected[4:], atol=1e-3)


def test_mean_voltage_that_arrived(hframe: Machine) -> None:
    dead_time = DeadTime(delayed(hframe, 0.013), PERIOD)
    dead_time.reset(np.ones(1, np.bool_))
    for value in (1.0, 2.0, 4.0, 8.0):
        dead_time.send(np.full((1, 2), value))
    # In the last period, 30 to 40 ms, the voltages sent at 10 ms arrive until 33 ms, then those sent at
    # 20 ms.
    np.testing.assert_allclose(dead_time.mean_arrived(), 0.3 * 2.0 + 0.7 * 4.0)
    times, volts = dead_time.arrived_history()
    np.testing.assert_allclose(times, [0.0, 0.003, 0.01])
    np.testing.assert_allclose(volts[0], [[2.0, 2.0], [4.0, 4.0], [4.0, 4.0]])


def test_voltages_arrive_at_once_without_a_dead_time(hframe: Machine) -> None:
    dead_time = DeadTime(hframe, PERIOD)
    dead_time.reset(np.ones(1, np.bool_))
    dead_time.send(np.array([[3.0, -1.0]]))
    times, volts = dead_time.arrived_history()
    np.testing.assert_allclose(times, [0.0, 0.01])
    np.testing.assert_allclose(volts, [[[3.0, -1.0], [3.0, -1.0]]])


def test_goals_are_shifted_by_the_dead_time(hframe: Machine) -> None:
    goals = np.stack([np.linspace(0.0, 1.0, 11), np.linspace(2.0, 3.0, 11)], axis=1)[None]
    dead_time = DeadTime(delayed(hframe, 0.015), PERIOD)
    np.testing.assert_allclose(dead_time.delayed_goals(goals)[0, :, 0], np.arange(0.15, 1.0, 0.1))
    with pytest.raises(InputError, match="ends within the dead time"):
        dead_time.delayed_goals(goals[:, :3])


def test_first_control_period_imports_nothing(hframe: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "scipy.interpolate", raising=False)
    DeadTime(hframe, PERIOD)
    assert "scipy.interpolate" not in sys.modules
    dead_time = DeadTime(delayed(hframe, 0.015), PERIOD)
    imported = set(sys.modules)
    dead_time.delayed_goals(np.zeros((1, 11, 2)))
    assert set(sys.modules) == imported


def test_controller_that_models_the_dead_time_settles(hframe: Machine) -> None:
    machine = delayed(hframe, 0.01)
    scenario = Scenario(machine, randomize="none", episodes=16, duration_s=1.0)
    with_model = score_episodes(rollout(ModelBasedController(machine), scenario))
    without_model = score_episodes(rollout(ModelBasedController(hframe), scenario))
    assert with_model["success"]["0.2mm"] == 1.0
    assert without_model["success"]["0.2mm"] < 0.5


def test_commands_give_the_motors_the_desired_voltages(hframe: Machine) -> None:
    """By the formulas: 0.4 V more where the dead band removes them, 0.5 V less where the offset adds them."""
    desired = np.array([[1.0, 1.0], [-0.05, -2.0], [0.0, 0.5]])
    inversion = InputInversion(with_dead_band(hframe))
    command = inversion.command(desired)
    np.testing.assert_allclose(command, [[1.4, 0.5], [-0.45, -2.5], [0.0, 0.0]], atol=5e-3)
    np.testing.assert_allclose(inversion.motor_voltage(command), desired, atol=1e-6)


def test_commands_stay_within_the_rated_voltage(hframe: Machine) -> None:
    command = InputInversion(with_dead_band(hframe)).command(np.array([[11.9, 12.0], [-30.0, -12.0]]))
    np.testing.assert_allclose(command, [[12.0, 11.5], [-12.0, -12.0]])


def test_drives_without_effects_are_not_changed(hframe: Machine) -> None:
    volts = np.random.default_rng(0).uniform(-12.0, 12.0, (5, 2))
    np.testing.assert_array_equal(InputInversion(hframe).command(volts), volts)


@pytest.mark.parametrize(("drop", "ratio"), [(0.0, 0.75), (1.0, 0.3)], ids=["switch", "dead zone"])
def test_contour_error_is_smaller_with_a_modeled_dead_band(
    hframe: Machine, drop: float, ratio: float
) -> None:
    machine = with_dead_band(hframe, drop)
    scenario = Scenario(machine, "track", randomize="none", episodes=8, seed=3)
    errors = []
    for model in (hframe, machine):
        contour = rollout(ModelBasedController(model), scenario).contour
        assert contour is not None
        errors.append(np.sqrt(np.mean(contour**2)))
    assert errors[1] < ratio * errors[0]
