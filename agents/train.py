"""Training with stable-baselines3 on the native vector environment, by a recipe.

What a run leaves in its folder, each file whole at any time: agent.json with policy.safetensors (the agent as it is
now), and checkpoint.zip (everything that `resume` needs; a pickle of your own run, do not load other people's).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hframe_gym.atomic import whole_file
from hframe_gym.files import load_machine
from hframe_gym.machine import Machine

from .agent import SCHEMA, Agent, policy_keywords
from .extra import load, one_thread
from .recipe import Recipe, load_recipe

EVALUATION_SEED = 1_000_000
EVALUATION_EPISODES = 256
REPORTS = 20  # lines of progress and checkpoints in a run


def train(
    algorithm: str,
    machine: str | Path | Machine = "hframe",
    task: str = "reach",
    steps: int = 1_000_000,
    seed: int = 0,
    resume: bool = False,
    out: str | Path = "agent",
    say: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Train an agent and write it to the folder `out`; gives the evaluation at the end.

    algorithm: "ppo" or "sac".  machine: a name, file or `Machine`.  steps: of the environment, in all, those before a
    resume included.  say: takes each line of progress.

    Raises ValueError for an unknown algorithm or task or where there is nothing to resume, ImportError naming the extra
    `agents` where it is missing.
    """
    recipe = load_recipe(algorithm, task)
    sb3 = load("stable_baselines3")
    kind = {"ppo": sb3.PPO, "sac": sb3.SAC}[algorithm]
    built = load_machine(machine)
    folder = Path(out)
    checkpoint = folder / "checkpoint.zip"
    from hframe_gym.env.sb3 import HFrameVecEnv

    environment = HFrameVecEnv(**recipe.env, machine=built, task=task)
    if resume:
        if not checkpoint.is_file():
            raise ValueError(f"nothing to resume: {checkpoint} is not there")
        model = kind.load(checkpoint, env=environment, device="cpu")
    else:
        model = _new_model(kind, recipe, built, environment, seed)
    card = _card(algorithm, task, machine, built, recipe, seed)
    progress = _Progress(model, card, built, steps, folder, say)
    with one_thread():
        model.learn(steps - model.num_timesteps, callback=progress, reset_num_timesteps=False)
    score = progress.report()
    environment.close()
    return score


class _Progress:
    """Evaluates, reports and saves now and then; stable-baselines3 calls it after every step of the environments."""

    def __init__(
        self, model: Any, card: dict[str, Any], machine: Machine, steps: int, folder: Path, say: Callable[[str], None]
    ) -> None:
        self.model, self.card, self.machine, self.folder, self.say = model, card, machine, folder, say
        self.interval = max(1, steps // REPORTS)
        self.begin, self.before = time.monotonic(), model.num_timesteps
        self.next = self.before + self.interval

    def __call__(self, local: dict[str, Any], outer: dict[str, Any]) -> bool:
        if self.model.num_timesteps >= self.next:
            self.next += self.interval
            self.report()
        return True

    def report(self) -> dict[str, Any]:
        """The score of the agent as it is now; says it, and writes agent and checkpoint."""
        steps = self.model.num_timesteps
        training = self.model.policy.training
        score = evaluate(Agent(self.model.policy, self.card), self.machine, self.card["task"], self.card["randomize"])
        self.model.policy.set_training_mode(training)
        seconds = time.monotonic() - self.begin
        self.say(
            f"{steps:>10d} steps  {seconds:7.1f} s  {(steps - self.before) / seconds:8.0f} steps/s  final distance "
            f"{score['median_mm']:8.3f} mm median, {score['mean_mm']:8.3f} mean; within 1 mm {score['within_1mm']:.3f}"
        )
        Agent(self.model.policy, {**self.card, "steps": steps, "evaluation": score}).save(self.folder)
        with whole_file(self.folder / "checkpoint.zip") as temporary:
            self.model.save(temporary)
        return score


def _new_model(kind: Any, recipe: Recipe, machine: Machine, environment: Any, seed: int) -> Any:
    from .features import features_for

    return kind(
        "MultiInputPolicy",
        environment,
        seed=seed,
        device="cpu",
        policy_kwargs=policy_keywords(recipe.policy, features_for(machine)),
        **recipe.settings,
    )


def _card(
    algorithm: str, task: str, machine: str | Path | Machine, built: Machine, recipe: Recipe, seed: int
) -> dict[str, Any]:
    from .features import features_for

    return {
        "schema": SCHEMA,
        "algorithm": algorithm,
        "task": task,
        "machine": built.name if isinstance(machine, Machine) else str(machine),
        "seed": seed,
        "recipe": recipe.name,
        "randomize": recipe.env["randomize"],
        "env": recipe.env,
        "algorithm_settings": recipe.algorithm,
        "policy": recipe.policy,
        "features": features_for(built),
    }


def evaluate(agent: Agent, machine: Machine, task: str, randomize: str) -> dict[str, Any]:
    """Distance to the goal at the end of fixed unseen episodes: median, mean (mm) and the share within 1 mm."""
    from hframe_gym.env import HFrameVectorEnv

    envs = HFrameVectorEnv(
        EVALUATION_EPISODES, machine=machine, task=task, randomize=randomize, autoreset_mode="SameStep"
    )
    observation, _ = envs.reset(seed=EVALUATION_SEED)
    over = np.zeros(EVALUATION_EPISODES, np.bool_)
    info: dict[str, Any] = {}
    while not over.all():
        observation, _, terminated, truncated, info = envs.step(agent.act(observation))
        over |= terminated | truncated
    distance = 1e3 * info["final_info"]["distance_m"]
    return {
        "episodes": EVALUATION_EPISODES,
        "median_mm": float(np.median(distance)),
        "mean_mm": float(distance.mean()),
        "within_1mm": float((distance <= 1.0).mean()),
    }
