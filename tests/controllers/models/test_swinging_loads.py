"""Tests of loads whose motion follows from their carriage, against simulations of the whole machine."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.controllers.models.swinging_loads import SwingingLoads
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import Machine, rest_state
from tests.controllers.closed_loop import PERIOD

PERIODS = 60
RATIO, F0_HZ = 0.3, 1.8


def with_load(machine: Machine, f0: float = F0_HZ) -> Machine:
    return machine.with_effects(EFFECTS["payload_swing"].at("y", f0=f0, zeta=0.05, r=RATIO))


def test_a_load_follows_from_the_velocities_of_its_carriage(hframe: Machine) -> None:
    machine = with_load(hframe)
    time_s = PERIOD * np.arange(PERIODS + 1)
    volts = np.repeat(np.random.default_rng(0).uniform(-9.0, 9.0, (PERIODS // 5, 2)), 5, axis=0)
    volts = np.vstack([volts, volts[-1:]])
    start = rest_state(machine, np.array([0.05, -0.05]))
    motion = simulate(machine, time_s, volts, start)
    scale = machine.travel_per_unit[:4]
    states = np.hstack([motion.positions[:, :4] * scale, motion.velocities[:, :4] * scale])
    deflection, rate = motion.positions[:, 4], motion.velocities[:, 4]
    w = 2.0 * np.pi * F0_HZ
    force = RATIO * machine.coordinate("y").mass * (w**2 * deflection + 2.0 * 0.05 * w * rate)
    loads = SwingingLoads(machine, PERIOD)
    loads.follow(states[:1], states[:1], np.array([True]))
    expected = loads.forces(states[None, :, 4:])[0]
    for k in range(PERIODS):
        loads.follow(states[k : k + 1], states[k + 1 : k + 2], np.array([False]))
        np.testing.assert_allclose(loads.last_force[0], expected[k], atol=1e-12)
    mean = 0.5 * (force[1:] + force[:-1])
    assert np.abs(mean).max() > 1.0
    np.testing.assert_allclose(expected[:, 1], mean, atol=0.02 * np.abs(mean).max())
    assert not expected[:, [0, 2, 3]].any()


def test_a_load_rests_when_an_episode_starts(hframe: Machine) -> None:
    loads = SwingingLoads(with_load(hframe), PERIOD)
    states = np.zeros((2, 8))
    moved = states.copy()
    moved[:, 5] = 0.1
    loads.follow(states, moved, np.array([False, True]))
    assert loads.last_force[0, 1] < 0.0  # the load stays behind and pulls
    force = loads.coming_force(moved)
    assert force[0, 1] < 0.0
    assert not force[1].any()
    assert not loads.last_force[1].any()


@pytest.mark.parametrize(("f0", "slow"), [(F0_HZ, True), (8.0, False)])
def test_a_fast_load_moves_with_its_carriage(hframe: Machine, f0: float, slow: bool) -> None:
    loads = SwingingLoads(with_load(hframe, f0), PERIOD)
    loads.follow(np.zeros((1, 8)), np.ones((1, 8)), np.array([False]))
    assert loads.last_force.any() == slow
