"""The batch of machines with dead time, against the simulation of one machine."""

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.dynamics.simulation import LONGEST_STEP
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import HFrameEnv, RandomizeParameter, Reach, Uniform
from hframe_gym.machine import BUILTIN_MACHINES


def delayed_machine(delay):
    """Return the machine with a dead time, s."""
    return BUILTIN_MACHINES["hframe"]().with_effects(EFFECTS["input_delay"].at("drives", d=delay))


@pytest.mark.parametrize("delay", [0.0, 0.0031, 0.01, 0.0234])
def test_dead_time_equals_the_simulation(delay):
    machine = delayed_machine(delay)
    env = HFrameEnv(
        machine=machine, task=Reach(start=(0.0, 0.0), target=(0.1, 0.0)), longest_step=LONGEST_STEP
    )
    env.reset(seed=0)
    volts = np.random.default_rng(1).uniform(-12, 12, (20, 2))
    for row in volts:
        env.step(row / 12)
    # The simulation extends the first voltage into the past. An episode begins without voltage.
    inputs = np.concatenate([np.zeros((1, 2)), volts, volts[-1:]])
    run = simulate(machine, np.arange(-1, 21) * 0.01, inputs)
    n = len(machine.coordinates)
    state = env.batch.simulator.state[0, : 2 * n, 0]
    expected = np.concatenate([run.positions[-1], run.velocities[-1]]) * np.tile(machine.travel_per_unit, 2)
    np.testing.assert_allclose(state, expected, rtol=1e-9, atol=1e-12)


def test_a_dead_time_can_be_randomized():
    env = HFrameEnv(machine=delayed_machine(0.004), randomize=[RandomizeParameter("*.d", Uniform(0.5, 3.0))])
    _, info = env.reset(seed=0)
    delay = info["parameters"]["input_delay@drives.d"]
    assert 0.002 <= delay <= 0.012
    np.testing.assert_array_equal(env.batch.simulator.actuators.delays[0, :, 0], [delay, delay])


def test_a_reset_forgets_delayed_voltages():
    env = HFrameEnv(machine=delayed_machine(0.015))
    env.reset(seed=0)
    env.step(np.ones(2))
    start, _ = env.reset(seed=1)
    observation, *_ = env.step(np.zeros(2))
    np.testing.assert_array_equal(observation["observation"], start["observation"])
