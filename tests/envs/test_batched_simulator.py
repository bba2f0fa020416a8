"""Stages against the machine's own simulation, where drives are late."""

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.dynamics.simulation import LONGEST_STEP
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import HFrameEnv, RandomizeParameter, Reach
from hframe_gym.envs.distributions import Uniform
from hframe_gym.machine import BUILTIN_MACHINES


def late_machine(delay):
    return BUILTIN_MACHINES["hframe"]().with_effects(EFFECTS["input_delay"].at("drives", d=delay))


@pytest.mark.parametrize("delay", [0.0, 0.0031, 0.01, 0.0234])
def test_late_drives_match_the_simulation(delay):
    machine = late_machine(delay)
    env = HFrameEnv(machine=machine, task=Reach(start=(0.0, 0.0), target=(0.1, 0.0)), longest_step=LONGEST_STEP)
    env.reset(seed=0)
    volts = np.random.default_rng(1).uniform(-12, 12, (20, 2))
    for row in volts:
        env.step(row / 12)
    # The simulation takes the first voltage for the time before; an episode begins with none.
    inputs = np.concatenate([np.zeros((1, 2)), volts, volts[-1:]])
    run = simulate(machine, np.arange(-1, 21) * 0.01, inputs)
    n = len(machine.coordinates)
    state = env.batch.stages.state[0, : 2 * n, 0]
    expected = np.concatenate([run.positions[-1], run.velocities[-1]]) * np.tile(machine.radii, 2)
    np.testing.assert_allclose(state, expected, rtol=1e-9, atol=1e-12)


def test_delay_may_be_drawn():
    env = HFrameEnv(machine=late_machine(0.004), randomize=[RandomizeParameter("*.d", Uniform(0.5, 3.0))])
    _, info = env.reset(seed=0)
    drawn = info["parameters"]["input_delay@drives.d"]
    assert 0.002 <= drawn <= 0.012
    np.testing.assert_array_equal(env.batch.stages.supply.delays[0, :, 0], [drawn, drawn])


def test_a_reset_forgets_voltages_on_their_way():
    env = HFrameEnv(machine=late_machine(0.015))
    env.reset(seed=0)
    env.step(np.ones(2))
    start, _ = env.reset(seed=1)
    observation, *_ = env.step(np.zeros(2))
    np.testing.assert_array_equal(observation["observation"], start["observation"])
