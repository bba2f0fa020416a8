"""Training end to end, small: recipes, files, what resumes after a kill, and that a little training already helps."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from hframe_gym.agents.agent import Agent
from hframe_gym.agents.scoring import judge
from hframe_gym.agents.training import train

from hframe_gym.controllers import AdaptivePID
from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.evaluation import Scenario
from hframe_gym.machine import BUILTIN_MACHINES


def silent(line):
    pass


def test_ppo_learns_and_is_read_back_as_it_was(tmp_path):
    lines = []
    card = train("ppo", steps=200_000, out=tmp_path, say=lines.append)
    first, last = card["curve"][0], card["curve"][-1]
    assert last["final_error_mm"] < 0.2 * first["final_error_mm"]
    assert len(lines) == len(card["curve"]) > 5
    assert json.loads((tmp_path / "card.json").read_text()) == card
    trial = Scenario(randomize="default", episodes=256, seed=1_000_000)
    kept = next(row for row in card["curve"] if row["steps"] == card["kept"])
    assert kept["settling_s_0.2mm"] == min(row["settling_s_0.2mm"] for row in card["curve"])
    assert judge(Agent.load(tmp_path), trial).items() <= kept.items()


def test_adapting_begins_with_the_shipped_agent_and_draws_as_asked(tmp_path):
    machine = BUILTIN_MACHINES["hframe"]()
    heavier = machine.replace({"x.mass": 1.1 * machine.parameters["x.mass"]})
    card = train("adapt", heavier, steps=1, out=tmp_path, randomize="none", say=silent)
    assert card["curve"][0]["success_0.2mm"] > 0.95
    assert card["settings"]["env"]["randomize"] == "none"


def test_same_seed_same_agent(tmp_path):
    weights = []
    for name in ("a", "b"):
        train("residual", steps=4096, seed=3, out=tmp_path / name, say=silent)
        weights.append((tmp_path / name / "policy.safetensors").read_bytes())
    assert weights[0] == weights[1]


@pytest.mark.parametrize("task", ["reach", "track"])
def test_a_residual_begins_as_its_base(tmp_path, task):
    train("residual", task=task, steps=0, out=tmp_path, say=silent)
    agent, base = Agent.load(tmp_path), AdaptivePID(BUILTIN_MACHINES["hframe"](), 0.01)
    envs = HFrameVectorEnv(6, task=task)
    observation, _ = envs.reset(seed=0)
    for _ in range(20):
        actions = agent.act(observation)
        assert np.array_equal(actions, base.act(observation))
        observation = envs.step(actions)[0]


def test_a_residual_adds_no_more_than_its_authority(tmp_path):
    train("residual", steps=4096, out=tmp_path, say=silent)
    agent = Agent.load(tmp_path)
    agent.policy.action_net.bias.data.fill_(100.0)  # as much as it ever can
    observation, _ = HFrameVectorEnv(6).reset(seed=0)
    off = np.abs(agent.act(observation) - AdaptivePID(BUILTIN_MACHINES["hframe"](), 0.01).act(observation))
    assert 0.0 < off.max() <= agent.actuation.authority.most + 1e-6


def test_agent_forgets_on_reset(tmp_path):
    train("ppo", steps=1, out=tmp_path, say=silent)
    agent = Agent.load(tmp_path)
    envs = HFrameVectorEnv(5)
    observation, _ = envs.reset(seed=0)
    first = agent.act(observation)
    moved = envs.step(first)[0]
    assert np.abs(agent.act(moved)).max() <= 1.0
    mask = np.array([True, False, True, False, False])
    agent.reset(mask)
    again = agent.act(observation)
    assert np.array_equal(again[mask], first[mask])
    agent.reset()
    assert np.array_equal(agent.act(observation), first)


def test_other_sensors_than_in_training_are_refused(tmp_path):
    train("ppo", steps=1, out=tmp_path, say=silent)
    observation, _ = HFrameVectorEnv(2).reset(seed=0)
    observation["observation"] = observation["observation"][:, :4]
    with pytest.raises(ValueError, match=r"observation has shape \(2, 4\), it was trained on \(B, 8\)"):
        Agent.load(tmp_path).act(observation)


def test_machine_that_is_no_builtin_comes_back_whole(tmp_path):
    machine = BUILTIN_MACHINES["hframe"]()
    heavier = machine.replace({"x.mass": 1.5 * machine.parameters["x.mass"]})
    train("ppo", heavier, steps=1, out=tmp_path, say=silent)
    assert Agent.load(tmp_path).machine.parameters == heavier.parameters


def rows(folder):
    """The learning curve in a folder so far."""
    card = folder / "card.json"
    return json.loads(card.read_text())["curve"] if card.exists() else []


def test_resume_after_a_kill(tmp_path):
    code = "import sys; from hframe_gym.agents import train; train('sac', steps=60_000, out=sys.argv[1])"
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.DEVNULL) as running:
        deadline = time.monotonic() + 240.0
        while len(rows(tmp_path)) < 2 and time.monotonic() < deadline and running.poll() is None:
            time.sleep(0.05)
        os.kill(running.pid, signal.SIGKILL)
    before = rows(tmp_path)
    assert before[-1]["steps"] > 0
    Agent.load(tmp_path)
    steps = before[-1]["steps"] + 320
    card = train("sac", steps=steps, out=tmp_path, resume=True, say=silent)
    assert card["curve"][: len(before)] == before
    assert card["curve"][-1]["steps"] >= steps
    assert card["curve"][-1]["cpu_s"] > before[-1]["cpu_s"]


def test_nothing_to_resume_is_said(tmp_path):
    with pytest.raises(ValueError, match="nothing to resume"):
        train("ppo", steps=10, out=tmp_path, resume=True)


def test_other_runs_are_not_resumed(tmp_path):
    train("ppo", steps=1, out=tmp_path, say=silent)
    with pytest.raises(ValueError, match=r"holds a run of ppo_reach with seed 0, not of ppo_reach with seed 1"):
        train("ppo", steps=10, seed=1, out=tmp_path, resume=True)


def test_folder_without_an_agent_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"agent\.json is missing"):
        Agent.load(tmp_path)
