"""Machines with every effect of the library move in the environment as in `Machine.simulate`."""

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.dynamics.simulation import LONGEST_STEP
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import HFrameEnv, HFrameVectorEnv, Reach
from hframe_gym.machine import BUILTIN_MACHINES
from tests.effects.one_of_each import CASES, ELSEWHERE

pytestmark = pytest.mark.integration

# One effect of each kind: with a state, with a state at a drive, at a belt, with a new coordinate and
# products in sensor rows, with tied belts, with parts that collide, with a drive that follows a position.
FAST = (
    "presliding",
    "electrical_lag",
    "belt_slack",
    "bridge_yaw",
    "idler_inertia",
    "gear_backlash",
    "servo_dead_band",
)
MACHINES = {**{name: ("hframe", case) for name, case in CASES.items()}, **ELSEWHERE}
NAMES = [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in MACHINES]
REST = 3  # periods without a command at first: delayed voltages from before the start differ
REACH = {"hframe": Reach(start=(0.02, 0.01), target=(0.1, 0.0)), "servo": Reach(start=(0.3,), target=(-0.2,))}


def machine_with(name):
    """Return the machine with an effect."""
    preset, case = MACHINES[name]
    return BUILTIN_MACHINES[preset]().with_effects(case.effect)


@pytest.mark.parametrize("name", NAMES)
def test_motion_equals_the_simulation(name):
    machine = machine_with(name)
    env = HFrameEnv(machine=machine, task=REACH[MACHINES[name][0]], longest_step=LONGEST_STEP)
    actions = np.random.default_rng(1).uniform(-1, 1, (15, len(machine.drives)))
    rated = np.array([drive.rated_voltage for drive in machine.drives])
    actions[:REST] = 0.0
    commands = np.concatenate([actions, actions[-1:]]) * rated
    run = simulate(machine, np.arange(16) * 0.01, commands, env_start(env))
    n = len(machine.coordinates)
    expected = np.concatenate([run.positions[-1], run.velocities[-1]]) * np.tile(machine.travel_per_unit, 2)
    for _ in range(2):  # the second episode does not depend on the first
        env.reset(seed=0)
        for action in actions:
            observation, *_ = env.step(action)
        state = env.batch.simulator.state[0, : 2 * n, 0]
        np.testing.assert_allclose(state, expected, rtol=1e-8, atol=1e-11)
        tool = run.positions[-1][: len(env.batch.workspace)].copy()
        if "yaw" in machine.coordinate_names:
            tool[0] += tool[1] * run.positions[-1][machine.coordinate_names.index("yaw")]
        np.testing.assert_allclose(observation["achieved_goal"], tool, rtol=1e-6)
        np.testing.assert_allclose(env.batch.simulator.tool_positions()[0], tool, rtol=1e-8)


def test_stiff_teeth_have_the_steps_that_they_need():
    """At the default step of 0.5 ms, teeth of 3000 Nm/rad make the motion diverge."""
    _, case = MACHINES["gear_backlash"]
    machine = BUILTIN_MACHINES["hframe"]().with_effects(
        EFFECTS["gear_backlash"].at(case.site, **{**case.parameters, "K": 3000.0})
    )
    env = HFrameEnv(machine=machine, task=REACH["hframe"])
    step = env.batch.simulator.h
    assert step * machine.highest_frequency <= 0.75
    actions = np.random.default_rng(1).uniform(-1, 1, (15, 2))
    commands = 12.0 * np.concatenate([actions, actions[-1:]])
    exact = simulate(machine, np.arange(16) * 0.01, commands, env_start(env), longest_step=0.1 * step)
    env.reset(seed=0)
    for action in actions:
        env.step(action)
    np.testing.assert_allclose(env.batch.simulator.tool_positions()[0], exact.positions[-1][:2], atol=5e-6)


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
