"""Machines with every effect of the library move in the environment as in `Machine.simulate`."""

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.dynamics.simulation import LONGEST_STEP
from hframe_gym.effects import EFFECTS, effect_sites
from hframe_gym.envs import HFrameEnv, HFrameVectorEnv, Reach
from hframe_gym.machine import BUILTIN_MACHINES

pytestmark = pytest.mark.integration

# One effect of each kind: with a state, with a state at a drive, at a belt, with a new coordinate and
# products in sensor rows, with tied belts.
FAST = ("presliding", "electrical_lag", "belt_slack", "bridge_yaw", "idler_inertia")
# Parameters for which the effect matters, where the amplitude's scale and the first value of the grid are too
# small.
NUMBERS = {
    "eccentric_pulley": {"e": 1e-4, "p": 0.5},
    "belt_play": {"d": 0.15e-3},
    "belt_slack": {"T0": 15.0},
    "bridge_yaw": {"J": 0.06, "k": 4000.0, "c": 0.6, "w": 0.3},
    "electrical_lag": {"tau": 1.5e-3},
    "idler_inertia": {"J_left": 0.5e-4, "J_right": 0.5e-4, "B_left": 0.0018, "B_right": 0.0018},
    "input_delay": {"d": 2.3e-3},
    "presliding": {"s0": 1e4, "s1": 60.0},
}
NAMES = [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in EFFECTS]
REST = 3  # periods without voltage at first: delayed voltages from before the start differ


def machine_with(name):
    """Return the machine with an effect."""
    plain = BUILTIN_MACHINES["hframe"]()
    effect = EFFECTS[name]
    guesses = {p.name: p.scale if p.amplitude else p.grid[0] or p.scale for p in effect.parameters}
    return plain.with_effects(effect.at(effect_sites(effect, plain)[0], **NUMBERS.get(name, guesses)))


@pytest.mark.parametrize("name", NAMES)
def test_motion_equals_the_simulation(name):
    machine = machine_with(name)
    env = HFrameEnv(
        machine=machine, task=Reach(start=(0.02, 0.01), target=(0.1, 0.0)), longest_step=LONGEST_STEP
    )
    volts = np.random.default_rng(1).uniform(-12, 12, (15, 2))
    volts[:REST] = 0.0
    run = simulate(machine, np.arange(16) * 0.01, np.concatenate([volts, volts[-1:]]), env_start(env))
    n = len(machine.coordinates)
    expected = np.concatenate([run.positions[-1], run.velocities[-1]]) * np.tile(machine.travel_per_unit, 2)
    for _ in range(2):  # the second episode does not depend on the first
        env.reset(seed=0)
        for row in volts:
            observation, *_ = env.step(row / 12)
        state = env.batch.simulator.state[0, : 2 * n, 0]
        np.testing.assert_allclose(state, expected, rtol=1e-8, atol=1e-11)
        tool = run.positions[-1][:2].copy()
        if "yaw" in machine.coordinate_names:
            tool[0] += tool[1] * run.positions[-1][machine.coordinate_names.index("yaw")]
        np.testing.assert_allclose(observation["achieved_goal"], tool, rtol=1e-6)
        np.testing.assert_allclose(env.batch.simulator.tool_positions()[0], tool, rtol=1e-8)


def env_start(env):
    """Return the state in which the environment begins, in the coordinates' units, shape (2 n,)."""
    env.reset(seed=0)
    machine = env.batch.machine
    return env.batch.simulator.state[0, : 2 * len(machine.coordinates), 0] / np.tile(
        machine.travel_per_unit, 2
    )


@pytest.mark.parametrize("name", ["bridge_yaw", "idler_inertia"])
def test_structural_effects_with_randomization_sensors_and_actuators(name):
    options = {"randomize": "wide", "sensors": "rig", "drives": "rig", "privileged": True}
    envs = HFrameVectorEnv(9, machine=machine_with(name), **options)
    observation, _ = envs.reset(seed=0)
    for action in np.random.default_rng(0).uniform(-1, 1, (30, 9, 2)).astype(np.float32):
        observation, reward, *_ = envs.step(action)
    assert envs.observation_space.contains(observation)
    assert np.isfinite(reward).all()
    names = [e.name for e in envs.privileged_entries]
    added = names.index("yaw" if name == "bridge_yaw" else "phi7")
    assert np.ptp(observation["privileged"][:, added]) > 0.0
