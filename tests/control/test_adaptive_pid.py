"""Memory and the PID that adapts: estimates against the stages' own numbers, errors against the PID that does not."""

import numpy as np
import pytest
from hframe_gym.agents.adaptive import AdaptivePID
from hframe_gym.agents.memory import Memory

from hframe_gym.control import ModelPID
from hframe_gym.control.model import MotionModel
from hframe_gym.env import HFrameVectorEnv, Track
from hframe_gym.evaluate import Trial, rollout
from hframe_gym.machine import BUILTIN

MACHINE = BUILTIN["hframe"]()
COUNT, PERIOD = 32, 0.01


@pytest.fixture(scope="module")
def circled():
    """A memory after 1.5 s of a circle, and by how much friction, masses and belts of each stage are off."""
    envs = HFrameVectorEnv(COUNT, task=Track(), randomize="default", max_episode_steps=None)
    observation, info = envs.reset(seed=3)
    pid, memory = ModelPID(MACHINE, PERIOD), Memory(MotionModel(MACHINE), PERIOD)
    volts, before = np.zeros((COUNT, 2)), memory.model.state(observation)
    for period in range(150):
        state = memory.model.state(observation)
        memory.learn(before, state, volts, np.full(COUNT, period == 0))
        actions = np.clip(pid.act(observation), -1.0, 1.0)
        before, volts = state, actions * memory.model.rated
        observation = envs.step(actions)[0]
    names = [f"{c}.{key}" for key in ("coulomb", "mass") for c in MACHINE.coordinate_names]
    names.append(f"{MACHINE.belts[0].name}.EA")
    off = np.stack([info["parameters"][name] / MACHINE.parameters[name] - 1.0 for name in names], axis=1)
    return memory, off


def test_memory_finds_friction_masses_and_belts(circled):
    memory, off = circled
    wrong = np.sqrt(np.mean((memory.estimates - off) ** 2, axis=0))
    unknown = np.sqrt(np.mean(off**2, axis=0))
    # Friction on y is a twelfth of all there is; the motors' masses are a seventh of what moves.
    for column, most in ((0, 0.4), (2, 0.3), (3, 0.3), (4, 0.6), (8, 0.7)):
        assert wrong[column] < most * unknown[column]


def test_memory_forgets_where_an_episode_begins(circled):
    memory, _ = circled
    fresh = np.arange(COUNT) < 3
    rest = memory.model.goal_state(np.zeros((COUNT, 2)))
    kept = memory.estimates.copy()
    memory.learn(rest, rest, np.zeros((COUNT, 2)), fresh)
    assert np.all(memory.estimates[fresh] == 0.0)
    assert np.array_equal(memory.estimates[~fresh], kept[~fresh])


@pytest.mark.parametrize(("path", "most"), [("circle", 0.45), ("square", 0.8)])
def test_pid_that_adapts_is_closer_to_the_path(path, most):
    trial = Trial(task=Track(path=path), episodes=64, seed=7)
    rms = [
        np.sqrt(np.mean(rollout(kind(MACHINE, PERIOD), trial).contour ** 2, axis=1)).mean()
        for kind in (AdaptivePID, ModelPID)
    ]
    assert rms[0] < most * rms[1]


def test_on_the_machine_itself_it_is_the_pid():
    trial = Trial(task="reach", randomize="none", episodes=16, seed=7)
    first, second = (rollout(kind(MACHINE, PERIOD), trial).position for kind in (AdaptivePID, ModelPID))
    assert np.abs(first - second)[:, -1].max() < 5e-5
