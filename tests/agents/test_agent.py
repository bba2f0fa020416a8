"""Agents on disk: loading, refusing damaged files, acting, and comparing machines with an evaluation's."""

import json
import shutil

import numpy as np
import pytest

from hframe_gym.agents import Agent, shipped_agent_folder, train
from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES


@pytest.fixture
def copied_agent(tmp_path):
    """Return a copy of the first shipped PPO agent, which a test may damage."""
    return shutil.copytree(shipped_agent_folder("ppo", "reach"), tmp_path / "agent")


def test_reset_clears_the_history_of_the_masked_environments():
    agent = Agent.load(shipped_agent_folder("ppo", "reach"))
    envs = HFrameVectorEnv(5)
    observation, _ = envs.reset(seed=0)
    first = agent.act(observation)
    moved = envs.step(first)[0]
    assert np.abs(agent.act(moved)).max() <= 1.0
    mask = np.array([True, False, True, False, False])
    agent.reset(mask)
    after_reset = agent.act(observation)
    assert np.array_equal(after_reset[mask], first[mask])
    assert not np.array_equal(after_reset[~mask], first[~mask])
    agent.reset()
    assert np.array_equal(agent.act(observation), first)


def test_observations_of_another_size_are_refused():
    observation, _ = HFrameVectorEnv(2).reset(seed=0)
    observation["observation"] = observation["observation"][:, :4]
    with pytest.raises(
        InputError, match=r"observation has shape \(2, 4\), but the agent was trained on \(batch, 8\)"
    ):
        Agent.load(shipped_agent_folder("ppo", "reach")).act(observation)


@pytest.mark.train
def test_the_machine_of_the_training_is_saved_with_the_agent(tmp_path):
    machine = BUILTIN_MACHINES["hframe"]()
    heavier = machine.replace({"x.mass": 1.5 * machine.parameters["x.mass"]})
    train("ppo", heavier, steps=1, out=tmp_path, log=lambda line: None)
    assert Agent.load(tmp_path).machine.parameters == heavier.parameters


def test_the_laws_of_an_agent_are_designed_for_the_given_machine():
    folder = shipped_agent_folder("ppo_mix", "reach")
    trained_on = Agent.load(folder)
    observation, _ = HFrameVectorEnv(2).reset(seed=0)
    action = trained_on.act(observation)
    assert np.array_equal(Agent.load(folder, trained_on.machine).act(observation), action)
    declared = trained_on.machine.parameters
    weaker = trained_on.machine.replace({f"motor{i}.Kt": 0.5 * declared[f"motor{i}.Kt"] for i in (1, 2)})
    agent = Agent.load(folder, weaker)
    agent.act(observation)
    volts, volts_before = (np.abs(of.mapping.laws.volts).mean() for of in (agent, trained_on))
    assert 1.5 * volts_before < volts < 3.0 * volts_before
    assert agent.card["features"] != trained_on.card["features"]
    with pytest.raises(InputError, match="was trained on a machine with 2 axes"):
        Agent.load(folder, BUILTIN_MACHINES["axis"]())


def test_a_saved_copy_acts_like_the_original(tmp_path):
    agent = Agent.load(shipped_agent_folder("residual", "reach"))
    agent.save(tmp_path)
    observation, _ = HFrameVectorEnv(4, randomize="default").reset(seed=3)
    assert np.array_equal(Agent.load(tmp_path).act(observation), agent.act(observation))


@pytest.mark.parametrize("name", ["agent.json", "machine.json", "policy.safetensors"])
def test_a_missing_file_is_named(copied_agent, name):
    (copied_agent / name).unlink()
    with pytest.raises(InputError, match=f"is not an agent: {name} is missing"):
        Agent.load(copied_agent)


@pytest.mark.parametrize("name", ["agent.json", "machine.json", "policy.safetensors"])
def test_a_truncated_file_is_named(copied_agent, name):
    contents = (copied_agent / name).read_bytes()
    (copied_agent / name).write_bytes(contents[: len(contents) // 2])
    with pytest.raises(InputError, match=name):
        Agent.load(copied_agent)


def test_missing_entries_and_other_schemas_are_refused(copied_agent):
    card = json.loads((copied_agent / "agent.json").read_text())
    (copied_agent / "agent.json").write_text(json.dumps({k: v for k, v in card.items() if k != "features"}))
    with pytest.raises(InputError, match="entries are missing: features"):
        Agent.load(copied_agent)
    (copied_agent / "agent.json").write_text(json.dumps({**card, "schema": 99}))
    with pytest.raises(InputError, match="schema is 99, this version reads 2"):
        Agent.load(copied_agent)


def test_weights_of_another_policy_are_refused(copied_agent):
    shutil.copy(
        shipped_agent_folder("sac", "reach") / "policy.safetensors", copied_agent / "policy.safetensors"
    )
    with pytest.raises(InputError, match=r"policy\.safetensors: .*actor"):
        Agent.load(copied_agent)


def test_mismatch_names_machine_parameters_period_and_sensors():
    agent = Agent.load(shipped_agent_folder("ppo", "reach"))
    machine = BUILTIN_MACHINES["hframe"]()
    assert agent.mismatch(machine, 0.01) is None
    linear = agent.mismatch(BUILTIN_MACHINES["hframe-linear"](), 0.01)
    assert "agent ppo: trained on machine 'hframe', evaluated on 'hframe-linear'" in linear
    heavier = machine.replace({"x.mass": 1.5 * machine.parameters["x.mass"]})
    assert "trained on a machine 'hframe' with other parameters" in agent.mismatch(heavier, 0.01)
    assert "control period of 0.01 s, evaluated at 0.002 s" in agent.mismatch(machine, 0.002)
    assert "trained with sensors 'state', evaluated with 'rig'" in agent.mismatch(machine, 0.01, "rig")
