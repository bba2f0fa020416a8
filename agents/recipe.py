"""Recipes: how an algorithm is trained on a task, as data files beside this one."""

from __future__ import annotations

import tomllib
from dataclasses import asdict, dataclass, field
from importlib import resources
from typing import Any

from ..envs.config import EnvConfig


@dataclass(frozen=True)
class Linear:
    """A rate that goes linearly from first to last as the share of a run that remains goes from 1 to 0, and stays so.

    A run may end a little later than asked for: it ends with a whole round.
    """

    first: float
    last: float

    def __call__(self, remaining: float) -> float:
        return self.last + (self.first - self.last) * max(remaining, 0.0)


@dataclass(frozen=True)
class Recipe:
    """How to train.

    kind: "ppo" or "sac".  steps: of the environment, enough for the scores of the shipped agents.  env: keywords of
    `HFrameVecEnv`.  algorithm, policy: keywords of the stable-baselines3 class and its policy; a pair in `algorithm`
    stands for a rate that goes from one to the other over the run.  task: keywords of the task.  actuation: keywords of
    `ResidualAction`, empty where the policy's outputs are the actions.  hindsight: keywords of `HerReplayBuffer`, empty for
    the plain buffer.  start: the shipped agent, by what its name begins with, that training goes on from; empty for
    none.
    """

    name: str
    kind: str
    steps: int
    env: dict[str, Any]
    algorithm: dict[str, Any]
    policy: dict[str, Any]
    task: dict[str, Any] = field(default_factory=dict)
    actuation: dict[str, Any] = field(default_factory=dict)
    hindsight: dict[str, Any] = field(default_factory=dict)
    start: str = ""

    @property
    def settings(self) -> dict[str, Any]:
        """`algorithm` as the class takes it, rates as functions."""
        return {k: Linear(*v) if isinstance(v, list) else v for k, v in self.algorithm.items()}

    @property
    def period(self) -> float:
        """Of control, s."""
        return float(self.env.get("period", EnvConfig.period))

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def load_recipe(name: str, task: str) -> Recipe:
    """The recipe NAME_TASK.toml: "ppo", "sac", "sac_her" or "residual" on a task.

    Raises ValueError listing the recipes there are.
    """
    folder = resources.files(__package__) / "recipes"
    file = folder / f"{name}_{task}.toml"
    if not file.is_file():
        known = sorted(" on ".join(f.name.removesuffix(".toml").rsplit("_", 1)) for f in folder.iterdir())
        raise ValueError(f"there is no recipe for {name} on {task}; there are {', '.join(known)}")
    return Recipe(name=f"{name}_{task}", **tomllib.loads(file.read_text("utf-8")))
