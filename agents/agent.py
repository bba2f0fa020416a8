"""An agent on disk: policy.safetensors holds the weights, agent.json how to build the policy.

Loading one runs no code of it, so an agent may come from anywhere.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hframe_gym.atomic import whole_file, write_text

from .extra import load, one_thread

SCHEMA = 1


def policy_keywords(policy: Mapping[str, Any], features: Mapping[str, Any]) -> dict[str, Any]:
    """`policy_kwargs` of stable-baselines3 from a recipe's [policy] and the keywords of the features."""
    load("stable_baselines3")
    from .features import ReachFeatures

    return {**policy, "features_extractor_class": ReachFeatures, "features_extractor_kwargs": dict(features)}


class Agent:
    """A trained policy as a controller: `act` gives the mean action for each stage of a batch."""

    def __init__(self, policy: Any, card: Mapping[str, Any]) -> None:
        self.policy = policy
        self.card = dict(card)

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """Actions (B, drives) in [-1, 1] for observations, each (B, n)."""
        with one_thread():
            actions, _ = self.policy.predict(dict(observation), deterministic=True)
        return np.asarray(actions, np.float64)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """A policy remembers nothing."""

    def save(self, folder: str | Path) -> None:
        """Write policy.safetensors and agent.json, each whole."""
        safetensors = load("safetensors.torch")
        weights = {name: value.contiguous() for name, value in self.policy.state_dict().items()}
        with whole_file(Path(folder) / "policy.safetensors") as temporary:
            safetensors.save_file(weights, temporary)
        write_text(Path(folder) / "agent.json", json.dumps(self.card, indent=2) + "\n")

    @classmethod
    def load(cls, folder: str | Path) -> Agent:
        """The agent in a folder.

        Raises ValueError when its files are missing or of another schema.
        """
        from hframe_gym.env.spaces import action_space, observation_space
        from hframe_gym.files import load_machine

        path = Path(folder)
        for name in ("agent.json", "policy.safetensors"):
            if not (path / name).is_file():
                raise ValueError(f"{path} is not an agent: {name} is missing")
        card = json.loads((path / "agent.json").read_text("utf-8"))
        if card.get("schema") != SCHEMA:
            raise ValueError(f"{path / 'agent.json'}: schema is {card.get('schema')!r}, this version reads {SCHEMA}")
        machine = load_machine(card["machine"])
        kind = load("stable_baselines3.ppo" if card["algorithm"] == "ppo" else "stable_baselines3.sac")
        policy = kind.MultiInputPolicy(
            observation_space(machine),
            action_space(machine),
            lambda _: 0.0,
            **policy_keywords(card["policy"], card["features"]),
        )
        policy.load_state_dict(load("safetensors.torch").load_file(path / "policy.safetensors"))
        policy.set_training_mode(False)
        return cls(policy, card)
