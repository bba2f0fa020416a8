"""Recipes: how an algorithm is trained on a task, as data files beside this one."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources
from typing import Any


@dataclass(frozen=True)
class Linear:
    """A rate that goes linearly from first to last as the share of a run that remains goes from 1 to 0."""

    first: float
    last: float

    def __call__(self, remaining: float) -> float:
        return self.last + (self.first - self.last) * remaining


@dataclass(frozen=True)
class Recipe:
    """env: keywords of `HFrameVecEnv`.  algorithm, policy: keywords of the stable-baselines3 class and its policy.

    A pair in `algorithm` stands for a rate that goes from one to the other over the run.
    """

    name: str
    env: dict[str, Any]
    algorithm: dict[str, Any]
    policy: dict[str, Any]

    @property
    def settings(self) -> dict[str, Any]:
        """`algorithm` as the class takes it, rates as functions."""
        return {k: Linear(*v) if isinstance(v, list) else v for k, v in self.algorithm.items()}


def load_recipe(algorithm: str, task: str) -> Recipe:
    """The recipe of an algorithm ("ppo", "sac") on a task.

    Raises ValueError listing the recipes there are.
    """
    folder = resources.files(__package__) / "recipes"
    file = folder / f"{algorithm}_{task}.toml"
    if not file.is_file():
        known = sorted(f.name.removesuffix(".toml").replace("_", " on ") for f in folder.iterdir())
        raise ValueError(f"there is no recipe for {algorithm} on {task}; there are {', '.join(known)}")
    content = tomllib.loads(file.read_text("utf-8"))
    return Recipe(f"{algorithm}_{task}", content["env"], content["algorithm"], content["policy"])
