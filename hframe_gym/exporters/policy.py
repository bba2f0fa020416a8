"""A trained policy as TorchScript and ONNX, with the contract of its observations."""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import override

from ..errors import InputError
from ..files import output_folder
from ..line_log import LineLog
from ..machine import observed_coordinates
from ..version import NAME_AND_VERSION
from .base import EXPORTERS, Exporter, argument, json_text, option, write_export

OPSET = 17  # of ONNX, from 2022; runtimes since then have it
_MEANINGS = {
    "desired_goal": "goal of the tool now, m",
    "preview": "goals at the ends of the next periods, m",
    "last_observation": (
        "`observation` of the previous period; in the first period of a motion, that of this one"
    ),
    "last_action": "`action` of the previous period, as applied; 0 in the first period of a motion",
}


@EXPORTERS.register("policy")
@dataclass(frozen=True, kw_only=True)
class PolicyExporter(Exporter):
    """Write a trained agent as policy.pt (TorchScript), policy.onnx and policy.json (its inputs and outputs).

    The network includes the scaling of the observations and the conversion of its outputs to voltages, so
    that nothing else is needed at runtime. An agent that corrects a controller, observes estimated parameters
    or weights transfers (residual, sac, apg) needs these computations as well and is refused. ONNX needs the
    package onnx; without it, policy.onnx is left out.

    Example:  hframe export policy ppo --out out/policy
    """

    agent: str = argument("A shipped agent ({agents}) or the folder of a trained agent.")
    task: str = option("reach", "Task of a shipped agent: {tasks}.")

    @override
    def write(self, out: str | Path, log: LineLog = lambda line: None) -> None:
        """Write policy.pt, policy.json and, if the package onnx is installed, policy.onnx."""
        folder = output_folder(out)
        write_export(folder, self.files(log), log)

    def files(self, log: LineLog = lambda line: None) -> dict[str, bytes]:
        """Convert the agent to the content of each file; the log gets a line that says why a file is missing.

        Raises:
            InputError: If there is no such agent, it is a model of stable-baselines3, or its actions need
                more than a network.
            ImportError: If the extra `agents` is not installed.
        """
        from ..agents import Agent, shipped_agent_folder

        if self.agent.endswith(".zip"):
            raise InputError(
                f"{self.agent}: models of stable-baselines3 are not exported, only agents in folders, which "
                "`hframe train` writes, and shipped ones. Train one (hframe train ppo), "
                "or export the model by the means of stable-baselines3 (its documentation, Exporting models)"
            )
        folder = (
            Path(self.agent) if Path(self.agent).is_dir() else shipped_agent_folder(self.agent, self.task)
        )
        agent = Agent.load(folder)
        network, keys, example = _network(agent)
        files = {"policy.pt": _torch_script(network, example)}
        try:
            files["policy.onnx"] = _onnx(network, keys, example)
        except ImportError:
            log("policy.onnx is left out: it needs onnx: pip install 'hframe_gym[onnx]'")
        files["policy.json"] = json_text(_contract(agent, keys, example, folder.resolve().name)).encode()
        return files


def _network(agent: Any) -> tuple[Any, list[str], tuple[Any, ...]]:
    """Return the complete network, the names of its inputs and inputs for tracing."""
    import torch

    mapping, policy = agent.mapping, agent.policy
    needs = []
    if mapping is not None:
        needs = [
            text
            for text, present in (
                ("the actions of another controller", mapping.base is not None),
                ("estimates of the machine's parameters", "estimates" in policy.observation_space.spaces),
                ("planned transfers to the goal", mapping.bank is not None),
            )
            if present
        ]
    if needs:
        raise InputError(
            f"agent {agent.card['name']}: its actions need {' and '.join(needs)}, which are no network; "
            "export an agent without them, for example ppo"
        )
    keys = [key for key in policy.features_extractor.keys]  # noqa: C416  (a torch module, not a dict)
    if mapping is not None and "last_action" not in keys:
        keys.append("last_action")

    class Network(torch.nn.Module):
        """Policy with deterministic actions, from observations in SI to fractions of the rated voltages."""

        def __init__(self) -> None:
            super().__init__()
            self.policy = policy

        def forward(self, *inputs: torch.Tensor) -> torch.Tensor:
            observation = dict(zip(keys, inputs, strict=True))
            if hasattr(self.policy, "action_net"):
                latent = self.policy.mlp_extractor.forward_actor(self.policy.features_extractor(observation))
                output = self.policy.action_net(latent).clip(-1.0, 1.0)
            else:
                output = self.policy.actor(observation, deterministic=True)
            if mapping is None:
                return output
            state, goal = observation["observation"], observation["desired_goal"]
            distance = mapping.meters * torch.linalg.vector_norm(goal - state[:, : goal.shape[1]], dim=1)
            speed = mapping.meters * torch.linalg.vector_norm(state[:, mapping.tool_speeds], dim=1)
            action: torch.Tensor = mapping.parts(distance, speed, observation["last_action"]).action(output)
            return action.clip(-1.0, 1.0)

    spaces = policy.observation_space.spaces
    rng = np.random.default_rng(0)
    example = tuple(
        torch.as_tensor(0.1 * rng.uniform(-1.0, 1.0, (2, *spaces[key].shape)).astype(np.float32))
        for key in keys
    )
    return Network().eval(), keys, example


def _torch_script(network: Any, example: tuple[Any, ...]) -> bytes:
    """Return the network as TorchScript."""
    import torch

    buffer = io.BytesIO()
    trace: Any = torch.jit.trace
    with torch.no_grad(), warnings.catch_warnings():
        # PyTorch announces a successor, torch.export, whose files depend on the version of PyTorch.
        warnings.simplefilter("ignore")
        torch.jit.save(trace(network, example), buffer)
    return buffer.getvalue()


def _onnx(network: Any, keys: list[str], example: tuple[Any, ...]) -> bytes:
    """Return the network in the format ONNX, for any batch size; ImportError without the package onnx."""
    import importlib

    import torch

    importlib.import_module("onnx")
    export: Any = torch.onnx.export  # which also writes to buffers, unlike its annotation
    buffer = io.BytesIO()
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        export(
            network,
            example,
            buffer,
            input_names=keys,
            output_names=["action"],
            dynamic_axes={name: {0: "batch"} for name in (*keys, "action")},
            opset_version=OPSET,
            dynamo=False,
        )
    return buffer.getvalue()


def _contract(agent: Any, keys: list[str], example: tuple[Any, ...], name: str) -> dict[str, Any]:
    """Return the description of inputs and outputs."""
    machine = agent.machine
    observed = observed_coordinates(machine)
    sensors = agent.card["settings"].get("env", {}).get("sensors", "state")
    entries = [f"position of {n}, {machine.coordinate(n).unit('position')}" for n in observed]
    entries += [f"velocity of {n}, {machine.coordinate(n).unit('speed')}" for n in observed]
    inputs = []
    for key, tensor in zip(keys, example, strict=True):
        about: dict[str, Any] = {"name": key, "shape": ["batch", tensor.shape[1]], "type": "float32"}
        about["meaning"] = _MEANINGS.get(key, "state of the machine, SI")
        if key == "observation":
            about["entries"] = entries
        inputs.append(about)
    return {
        "provenance": {
            "software": NAME_AND_VERSION,
            "export": "policy",
            "agent": name,
            "machine": machine.name,
        },
        "period_s": agent.period,
        "task": agent.card["task"],
        "axes": list(machine.tool_axes),
        "trained_with_sensors": sensors,
        "inputs": inputs,
        "outputs": [
            {
                "name": "action",
                "shape": ["batch", len(machine.drives)],
                "type": "float32",
                "meaning": "voltage of each drive divided by its rated voltage, in [-1, 1], for one period",
                "entries": [
                    {"channel": d.channel, "rated_voltage_V": d.rated_voltage} for d in machine.drives
                ],
            }
        ],
    }
