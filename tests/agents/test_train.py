"""Training end to end, small: recipes, files, resume, and that a little training already helps."""

import json

import numpy as np
import pytest
from hframe_gym.agents.agent import Agent
from hframe_gym.agents.recipe import load_recipe
from hframe_gym.agents.train import evaluate, train

from hframe_gym.env import HFrameVectorEnv
from hframe_gym.machine import BUILTIN


def test_recipes_are_listed_when_one_is_missing():
    with pytest.raises(ValueError, match="ppo on reach, sac on reach"):
        load_recipe("ppo", "juggle")


def test_ppo_learns_saves_and_resumes(tmp_path):
    lines = []
    score = train("ppo", steps=100_000, out=tmp_path, say=lines.append)
    machine = BUILTIN["hframe"]()
    agent = Agent.load(tmp_path)
    start = Agent(agent.policy.__class__(**agent.policy._get_constructor_parameters()), agent.card)
    assert score["median_mm"] < 0.8 * evaluate(start, machine, "reach", "default")["median_mm"]
    # The agent read back is the agent that was scored.
    assert evaluate(agent, machine, "reach", "default") == score
    assert json.loads((tmp_path / "agent.json").read_text())["steps"] >= 100_000
    assert len(lines) > 5

    train("ppo", steps=104_000, out=tmp_path, resume=True, say=lines.append)
    assert json.loads((tmp_path / "agent.json").read_text())["steps"] >= 104_000


def test_agent_acts_on_batches(tmp_path):
    train("sac", steps=400, out=tmp_path, say=lambda line: None)
    observation, _ = HFrameVectorEnv(5).reset(seed=0)
    actions = Agent.load(tmp_path).act(observation)
    assert actions.shape == (5, 2)
    assert np.abs(actions).max() <= 1.0


def test_nothing_to_resume_is_said(tmp_path):
    with pytest.raises(ValueError, match="nothing to resume"):
        train("ppo", steps=10, out=tmp_path, resume=True)


def test_folder_without_an_agent_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"agent\.json is missing"):
        Agent.load(tmp_path)
