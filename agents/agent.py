"""An agent on disk: policy.safetensors holds the weights, agent.json how to build the policy, machine.json its machine.

Loading one runs no code of it, so an agent may come from anywhere.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..atomic_files import whole_file, write_text
from ..machine import Machine
from ..recordings import load_machine, save_machine
from .optional_dependencies import load, one_thread
from .residual_action import ResidualAction

SCHEMA = 2
STATED = ("schema", "name", "task", "kind", "machine", "seed", "recipe", "settings", "period", "features", "previews")
# Networks of stable-baselines3's policies that judge and do not act; an agent on disk goes without.
CRITICS = ("critic", "value_net", "mlp_extractor.value_net")


def policy_keywords(policy: Mapping[str, Any], features: Mapping[str, Any]) -> dict[str, Any]:
    """`policy_kwargs` of stable-baselines3 from a recipe's [policy] and the keywords of the features."""
    load("stable_baselines3")
    from .features import StageFeatures

    return {**policy, "features_extractor_class": StageFeatures, "features_extractor_kwargs": dict(features)}


class Agent:
    """A trained policy as a controller (see `hframe_gym.controllers.Controller`): its mean action for each stage.

    policy: of stable-baselines3.  actuation: between it and the stages, or None where its outputs are the actions.
    machine: what it was trained on.  card: what agent.json says.
    """

    def __init__(
        self, policy: Any, actuation: ResidualAction | None, machine: Machine, card: Mapping[str, Any]
    ) -> None:
        self.policy = policy
        self.actuation = actuation
        self.machine = machine
        self.card = dict(card)

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """Actions (B, drives) in [-1, 1] for observations, each (B, n).

        Raises ValueError for observations of another size than the agent was trained on, as other sensors give.
        """
        for key, space in self.policy.observation_space.spaces.items():
            if key in observation and observation[key].shape[1:] != space.shape:
                raise ValueError(
                    f"agent {self.card['name']}: {key} has shape {observation[key].shape}, it was trained on "
                    f"(B, {space.shape[0]})"
                )
        seen = self.actuation.see(observation) if self.actuation else dict(observation)
        with one_thread():
            outputs, _ = self.policy.predict(seen, deterministic=True)
        return self.actuation.apply(outputs) if self.actuation else np.asarray(outputs, np.float64)

    def applied(self, actions: NDArray[np.float64]) -> None:
        """The stages were given actions (B, drives) in [-1, 1], and not what `act` answered last."""
        if self.actuation:
            self.actuation.applied(actions)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the stages of mask (B,), or all."""
        if self.actuation:
            self.actuation.reset(mask)

    def save(self, folder: str | Path) -> None:
        """Write policy.safetensors, agent.json and machine.json, each whole."""
        safetensors = load("safetensors.torch")
        state = self.policy.state_dict()
        weights = {name: value.contiguous() for name, value in state.items() if not name.startswith(CRITICS)}
        with whole_file(Path(folder) / "policy.safetensors") as temporary:
            safetensors.save_file(weights, temporary)
        save_machine(self.machine, Path(folder) / "machine.json")
        stated = {key: self.card[key] for key in STATED}
        write_text(Path(folder) / "agent.json", json.dumps(stated, indent=1) + "\n")

    @classmethod
    def load(cls, folder: str | Path) -> Agent:
        """The agent in a folder.

        Raises ValueError when its files are missing or of another schema.
        """
        from ..envs.spaces import action_space, observation_space

        path = Path(folder)
        for name in ("agent.json", "machine.json", "policy.safetensors"):
            if not (path / name).is_file():
                raise ValueError(f"{path} is not an agent: {name} is missing")
        card = json.loads((path / "agent.json").read_text("utf-8"))
        if card.get("schema") != SCHEMA:
            raise ValueError(f"{path / 'agent.json'}: schema is {card.get('schema')!r}, this version reads {SCHEMA}")
        machine = load_machine(path / "machine.json")
        actuation = actuation_for(machine, card["settings"]["actuation"], card["period"])
        space = observation_space(machine, card["previews"])
        kind = load("stable_baselines3.ppo" if card["kind"] == "ppo" else "stable_baselines3.sac")
        policy = kind.MultiInputPolicy(
            actuation.space(space) if actuation else space,
            action_space(machine),
            lambda _: 0.0,
            **policy_keywords(card["settings"]["policy"], card["features"]),
        )
        load_weights(policy, path)
        policy.set_training_mode(False)
        return cls(policy, actuation, machine, card)


def load_weights(policy: Any, folder: Path) -> None:
    """Give a policy the weights in a folder, all but those of critics.

    Raises ValueError naming the weights that are not there, or that the policy has no place for.
    """
    weights = load("safetensors.torch").load_file(folder / "policy.safetensors")
    missing, unexpected = policy.load_state_dict(weights, strict=False)
    strangers = [*unexpected, *(name for name in missing if not name.startswith(CRITICS))]
    if strangers:
        raise ValueError(f"{folder / 'policy.safetensors'} does not fit the policy: {', '.join(sorted(strangers))}")


def actuation_for(machine: Machine, settings: Mapping[str, Any], period: float) -> ResidualAction | None:
    """The actuation of a recipe's [actuation], None where that is empty."""
    return ResidualAction(machine, period, **settings) if settings else None
