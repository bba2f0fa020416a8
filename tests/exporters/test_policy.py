"""An exported policy gives the actions of the agent, step by step in an episode."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.errors import InputError
from hframe_gym.exporters import EXPORTERS

torch = pytest.importorskip("torch", reason="needs the extra agents: pip install '.[agents]'")
pytestmark = pytest.mark.integration
PERIODS = 40


def exported(agent: str, task: str, out: Path) -> tuple[dict[str, Any], list[str]]:
    lines: list[str] = []
    EXPORTERS.get("policy")(agent=agent, task=task).write(out, lines.append)  # type: ignore[call-arg]
    return json.loads((out / "policy.json").read_text()), lines


def largest_difference(task: str, contract: dict[str, Any], evaluate: Any, count: int = 3) -> float:
    """Run the agent in an environment, and the exported network on the inputs that its contract names."""
    from hframe_gym.agents import Agent, shipped_agent_folder

    agent = Agent.load(shipped_agent_folder("ppo", task))
    envs = HFrameVectorEnv(count, task=task, randomize="default")
    envs.reset(seed=5)
    names = [about["name"] for about in contract["inputs"]]
    last_observation, last_action, largest = None, np.zeros((count, 2), np.float32), 0.0
    for _ in range(PERIODS):
        observation = envs.batch.observe()
        actions = agent.act(observation)
        last_observation = observation["observation"] if last_observation is None else last_observation
        inputs = {**observation, "last_observation": last_observation, "last_action": last_action}
        found = evaluate({name: np.asarray(inputs[name], np.float32) for name in names})
        largest = max(largest, float(np.abs(found - actions).max()))
        last_observation, last_action = observation["observation"], actions
        envs.step(actions.astype(np.float32))
    return largest


@pytest.mark.parametrize("task", ["reach", "track"])
def test_torch_script_gives_the_agents_actions(task: str, tmp_path: Path) -> None:
    contract, _ = exported("ppo", task, tmp_path)
    network = torch.jit.load(tmp_path / "policy.pt")

    def evaluate(inputs: dict[str, np.ndarray]) -> np.ndarray:
        with torch.no_grad():
            return np.asarray(network(*(torch.as_tensor(values) for values in inputs.values())))

    assert largest_difference(task, contract, evaluate) < 1e-6
    assert contract["period_s"] == 0.01
    assert contract["task"] == task
    [output] = contract["outputs"]
    assert [entry["channel"] for entry in output["entries"]] == ["v1_V", "v2_V"]
    observation = next(about for about in contract["inputs"] if about["name"] == "observation")
    assert len(observation["entries"]) == observation["shape"][1] == 8
    assert observation["entries"][0] == "position of x, m"


@pytest.mark.parametrize("task", ["reach", "track"])
def test_onnx_gives_the_agents_actions(task: str, tmp_path: Path) -> None:
    pytest.importorskip("onnx", reason="needs onnx: pip install '.[onnx]'")
    runtime = pytest.importorskip("onnxruntime", reason="needs onnxruntime: pip install '.[onnx]'")
    contract, _ = exported("ppo", task, tmp_path)
    session = runtime.InferenceSession(tmp_path / "policy.onnx")
    assert [i.name for i in session.get_inputs()] == [about["name"] for about in contract["inputs"]]

    def evaluate(inputs: dict[str, np.ndarray]) -> np.ndarray:
        return np.asarray(session.run(["action"], inputs)[0])

    assert largest_difference(task, contract, evaluate, 64) < 1e-6
    # For few rows PyTorch sums products in another order. The agent's actions then differ from those of the
    # same weights in double precision by 7e-6, and from its actions in a large batch by as much, because
    # features of 0.1 mm are differences of positions in single precision.
    assert largest_difference(task, contract, evaluate, 1) < 1e-5


def test_without_onnx_a_line_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib

    real = importlib.import_module

    def absent(name: str, *arguments: Any) -> Any:
        if name == "onnx":
            raise ImportError(name)
        return real(name, *arguments)

    monkeypatch.setattr(importlib, "import_module", absent)
    _, lines = exported("ppo", "reach", tmp_path)
    assert lines[0].startswith("policy.onnx is left out: it needs onnx: pip install")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["policy.json", "policy.pt"]


@pytest.mark.parametrize(
    ("agent", "reason"),
    [
        (
            "residual",
            "its actions need the actions of another controller and estimates of the machine's parameters",
        ),
        ("apg", "its actions need estimates of the machine's parameters, which"),
        ("sac", "planned transfers to the goal"),
    ],
)
def test_agents_that_need_more_than_a_network_are_refused(agent: str, reason: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=reason):
        exported(agent, "reach", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_agent_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no shipped agent 'nobody'"):
        exported("nobody", "reach", tmp_path)


def test_a_model_of_stable_baselines3_is_refused_as_such(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a_ppo\.zip: models of stable-baselines3 are not exported"):
        exported("a_ppo.zip", "reach", tmp_path)
