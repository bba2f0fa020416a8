"""Tests of simulations that go on from the memory of the one before: effects' states and loads that swing."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.arrays import Array
from hframe_gym.controllers import MotionModel, ParameterWindow
from hframe_gym.controllers.models.simulated_motion import SimulatedMotion
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import Machine, rest_state
from tests.controllers.closed_loop import PERIOD

PERIODS, START = 12, np.array([0.05, -0.05])
REMEMBERED = {
    "eccentric pulley": EFFECTS["eccentric_pulley"].at("motor2", e=2e-4, p=0.4),
    "swinging load": EFFECTS["payload_swing"].at("y", f0=1.8, zeta=0.05, r=0.3),
    "hysteresis": EFFECTS["bouc_wen_hysteresis"].at("x", F=3.0, L=2e-3),
}


def moved(machine: Machine) -> tuple[Array, Array, Array]:
    """Return model states (PERIODS + 1, 2 n), memories, and voltages (PERIODS, 2) of a simulation."""
    model = MotionModel(machine)
    volts = np.repeat(np.random.default_rng(0).uniform(-9.0, 9.0, (PERIODS // 3, 2)), 3, axis=0)
    motion = SimulatedMotion(model)
    at_rest = rest_state(machine, START)[:4] * model.machine.travel_per_unit
    states, memories = motion.simulate(
        np.concatenate([at_rest, np.zeros(4)])[None],
        np.zeros((1, motion.memory_size)),
        PERIOD * np.arange(PERIODS + 1),
        np.vstack([volts, volts[-1:]])[None],
    )
    return states[0], memories[0], volts


@pytest.mark.parametrize("name", REMEMBERED)
def test_periods_that_go_on_from_a_memory_are_one_motion(hframe: Machine, name: str) -> None:
    machine = hframe.with_effects(REMEMBERED[name])
    states, memories, volts = moved(machine)
    motion = SimulatedMotion(MotionModel(machine))
    time_s, k = PERIOD * np.arange(PERIODS + 1), PERIODS // 2
    whole = simulate(machine, time_s, np.vstack([volts, volts[-1:]]), rest_state(machine, START))
    np.testing.assert_allclose(states[:, 0], whole.positions[:, 0], atol=1e-9)
    later = slice(k, None), np.vstack([volts[k:], volts[-1:]])[None]
    again, remembered = motion.simulate(states[k : k + 1], memories[k : k + 1], time_s[later[0]], later[1])
    np.testing.assert_allclose(again[0], states[k:], atol=1e-9)
    np.testing.assert_allclose(remembered[0], memories[k:], atol=1e-9)
    forgetful, _ = motion.simulate(states[k : k + 1], 0.0 * memories[:1], time_s[later[0]], later[1])
    assert np.abs(forgetful[0] - states[k:])[:, :2].max() > 1e-5  # m


@pytest.mark.parametrize("name", REMEMBERED)
def test_what_a_machine_remembers_is_not_taken_for_a_missing_voltage(hframe: Machine, name: str) -> None:
    machine = hframe.with_effects(REMEMBERED[name])
    states, memories, volts = moved(machine)
    model = MotionModel(machine)
    window = ParameterWindow(model, PERIOD)
    rated = model.rated
    window.update(states[:1], states[:1], volts[:1] / rated, np.array([True]))
    for k in range(PERIODS):
        window.update(states[k : k + 1], states[k + 1 : k + 2], volts[k : k + 1] / rated, np.array([False]))
    assert window.noise_ratio[0] < 1.2
    assert np.abs(window.offset).max() < 1e-3  # V
    np.testing.assert_allclose(window.memory[0], memories[-1], atol=1e-3 * np.abs(memories).max())
    window.update(states[:1], states[:1], volts[:1] / rated, np.array([True]))
    assert not window.memory.any()


def test_a_load_stays_in_place_if_its_carriage_is_found_elsewhere(hframe: Machine) -> None:
    machine = hframe.with_effects(REMEMBERED["hysteresis"], REMEMBERED["swinging load"])
    motion = SimulatedMotion(MotionModel(machine))
    simulated = np.zeros((1, 8))
    measured = simulated.copy()
    measured[0, [1, 5]] = 1e-3, 0.02  # y, its velocity
    corrected = motion.corrected(np.array([[0.01, 0.5, 2.0]]), simulated, measured)
    np.testing.assert_allclose(corrected, [[0.009, 0.48, 2.0]], rtol=1e-12)


def test_a_machine_without_effects_remembers_nothing(hframe: Machine) -> None:
    assert SimulatedMotion(MotionModel(hframe)).memory_size == 0
