"""Training with stable-baselines3 on the native vector environment, by a recipe.

What a run leaves in its folder, each file whole at any time: the best agent so far by its evaluations, on draws that no
training sees (agent.json, machine.json, policy.safetensors), its card (card.json, README.md), tensorboard/, and
checkpoint.zip with replay.pkl, what `resume` needs (pickles of your own run, do not load other people's).
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..atomic_files import whole_file
from ..envs.tasks import TASKS, Task
from ..evaluation import Scenario
from ..evaluation.controller_factory import shipped
from ..machine import Machine
from ..recordings import load_machine
from .agent import SCHEMA, Agent, actuation_for, load_weights, policy_keywords
from .model_card import versions, write_card
from .optional_dependencies import load, one_thread
from .recipe import Recipe, load_recipe
from .scoring import deciding, judge, line

# Draws that no training sees: environment i of seed s begins with TRAINING_SEED + s * SEEDS_APART + i.
EVALUATION_SEED = 1_000_000
TRAINING_SEED = 10_000_000
SEEDS_APART = 100_000
EVALUATION_EPISODES = 256
REPORTS = 12  # evaluations and checkpoints in a run,
LEAST_APART = 2_000  # in steps of the environment


def train(
    algorithm: str | Recipe,
    machine: str | Path | Machine = "hframe",
    task: str = "reach",
    steps: int | None = None,
    seed: int = 0,
    resume: bool = False,
    out: str | Path = "agent",
    say: Callable[[str], None] = print,
    advance: Callable[[int, int], None] = lambda done, steps: None,
    randomize: str | None = None,
) -> dict[str, Any]:
    """Train an agent and write it to the folder `out`; gives its card.

    algorithm: a recipe or the name of one, "ppo", "sac", "sac_her" or "residual".  machine: a name, file or `Machine`.
    steps: of the environment, in all, those before a resume included; as many as the recipe says where not given.
    say: takes a line at each evaluation.  advance: is told how many steps are done, of how many, after each of the
    environments.
    randomize: what each episode draws of the machine, in place of the recipe's: "identified" for one whose file says
    how well it is known.

    The same seed gives the same agent, to the bit, on the same versions and processor; a resumed run goes on with
    other draws than one that was never stopped.

    Raises ValueError for an unknown algorithm or task or where there is nothing to resume, ImportError naming the extra
    `agents` where it is missing.
    """
    recipe = algorithm if isinstance(algorithm, Recipe) else load_recipe(algorithm, task)
    if randomize is not None:
        recipe = replace(recipe, env={**recipe.env, "randomize": randomize})
    steps = recipe.steps if steps is None else steps
    built = load_machine(machine)
    folder = Path(out)
    card = _begin(recipe, task, built, seed)
    environment = _environment(recipe, built, task)
    card["previews"] = len(environment.get_attr("batch", 0)[0].task.ahead_s)
    model = _resumed(recipe, folder, environment, card) if resume else _new_model(recipe, built, environment, seed)
    if recipe.start and not resume:
        load_weights(model.policy, shipped(recipe.start, task))
    model.set_logger(load("stable_baselines3.common.logger").configure(str(folder / "tensorboard"), ["tensorboard"]))
    environment.seed(TRAINING_SEED + seed * SEEDS_APART + model.num_timesteps)
    progress = _Progress(model, card, built, recipe, steps, folder, say, advance)
    if not resume:
        progress.report()
    with one_thread():
        model.learn(steps - model.num_timesteps, callback=progress, reset_num_timesteps=False)
    progress.report()
    environment.close()
    return progress.card


def _environment(recipe: Recipe, machine: Machine, task: str) -> Any:
    from ..envs.sb3_vec_env import HFrameVecEnv
    from .wrappers import ResidualActionVecEnv

    environment = HFrameVecEnv(**recipe.env, machine=machine, task=task_of(recipe.task, task))
    actuation = actuation_for(machine, recipe.actuation, recipe.period)
    return ResidualActionVecEnv(environment, actuation) if actuation else environment


def task_of(settings: dict[str, Any], task: str) -> Task:
    """The task by its name with a recipe's settings; lists, which TOML has, stand for tuples."""
    return TASKS[task](**{k: tuple(v) if isinstance(v, list) else v for k, v in settings.items()})


def _new_model(recipe: Recipe, machine: Machine, environment: Any, seed: int) -> Any:
    from .features import features_for

    sb3 = load("stable_baselines3")
    hindsight = {"replay_buffer_class": sb3.HerReplayBuffer, "replay_buffer_kwargs": recipe.hindsight}
    model = getattr(sb3, recipe.kind.upper())(
        "MultiInputPolicy",
        environment,
        seed=seed,
        device="cpu",
        policy_kwargs=policy_keywords(recipe.policy, features_for(machine)),
        **(hindsight if recipe.hindsight else {}),
        **recipe.settings,
    )
    if "base" in recipe.actuation:
        _begin_as_base(model.policy)
    return model


def _begin_as_base(policy: Any) -> None:
    """Set the layer that gives PPO's or SAC's mean action to zero: a correction begins with nothing to correct."""
    head = policy.action_net if hasattr(policy, "action_net") else policy.actor.mu
    for parameter in head.parameters():
        parameter.data.zero_()


def _resumed(recipe: Recipe, folder: Path, environment: Any, card: dict[str, Any]) -> Any:
    """The model of the folder's checkpoint; takes over into the card what its run had reported by then."""
    checkpoint, replay = folder / "checkpoint.zip", folder / "replay.pkl"
    if not checkpoint.is_file():
        raise ValueError(f"nothing to resume: {checkpoint} is not there")
    sb3 = load("stable_baselines3")
    model = getattr(sb3, recipe.kind.upper()).load(checkpoint, env=environment, device="cpu")
    if replay.is_file():
        model.load_replay_buffer(replay)
    before = json.loads((folder / "card.json").read_text("utf-8"))
    if (before["recipe"], before["seed"]) != (card["recipe"], card["seed"]):
        raise ValueError(
            f"nothing to resume: {folder} holds a run of {before['recipe']} with seed {before['seed']}, "
            f"not of {card['recipe']} with seed {card['seed']}"
        )
    card["curve"] = [row for row in before["curve"] if row["steps"] <= model.num_timesteps]
    card["kept"] = before["kept"]
    return model


def _begin(recipe: Recipe, task: str, machine: Machine, seed: int) -> dict[str, Any]:
    from .features import features_for

    return {
        "schema": SCHEMA,
        "name": recipe.name.removesuffix(f"_{task}"),
        "task": task,
        "kind": recipe.kind,
        "machine": machine.name,
        "seed": seed,
        "recipe": recipe.name,
        "settings": recipe.as_dict(),
        "period": recipe.period,
        "features": features_for(machine),
        "versions": versions(),
        "curve": [],
    }


class _Progress:
    """Evaluates, reports and saves now and then; stable-baselines3 calls it after every step of the environments."""

    def __init__(
        self,
        model: Any,
        card: dict[str, Any],
        machine: Machine,
        recipe: Recipe,
        steps: int,
        folder: Path,
        say: Callable[[str], None],
        advance: Callable[[int, int], None],
    ) -> None:
        self.model, self.card, self.machine, self.folder = model, card, machine, folder
        self.steps, self.say, self.advance = steps, say, advance
        self.actuation = actuation_for(machine, recipe.actuation, recipe.period)
        self.trial = Scenario(
            machine=machine,
            task=task_of(recipe.task, card["task"]),
            randomize=recipe.env["randomize"],
            period=recipe.period,
            episodes=EVALUATION_EPISODES,
            seed=EVALUATION_SEED,
        )
        self.interval = max(LEAST_APART, steps // REPORTS)
        self.next = model.num_timesteps + self.interval
        last = card["curve"][-1] if card["curve"] else {"seconds": 0.0, "cpu_s": 0.0}
        self._clocks = time.monotonic() - last["seconds"], time.process_time() - last["cpu_s"]

    def __call__(self, local: dict[str, Any], outer: dict[str, Any]) -> bool:
        self.advance(self.model.num_timesteps, self.steps)
        if self.model.num_timesteps >= self.next:
            self.next = self.model.num_timesteps + self.interval
            self.report()
        return True

    def report(self) -> None:
        """Score the agent as it is now; say it, and write card, checkpoint and, where it is the best so far, agent."""
        model, training = self.model, self.model.policy.training
        agent = Agent(model.policy, self.actuation, self.machine, self.card)
        row = {
            "steps": model.num_timesteps,
            "seconds": round(time.monotonic() - self._clocks[0], 1),
            "cpu_s": round(time.process_time() - self._clocks[1], 1),
            **judge(agent, self.trial),
        }
        model.policy.set_training_mode(training)
        self.card["curve"] = [*(r for r in self.card["curve"] if r["steps"] < row["steps"]), row]
        self.say(line(row))
        for key, value in row.items():
            if isinstance(value, float):
                model.logger.record(f"evaluation/{key}", value)
        model.logger.dump(model.num_timesteps)
        best = min(self.card["curve"], key=deciding)
        if deciding(row) <= deciding(best):
            agent.save(self.folder)
            self.card["kept"] = row["steps"]
        with whole_file(self.folder / "checkpoint.zip") as temporary:
            model.save(temporary)
        if getattr(model, "replay_buffer", None) is not None:
            with whole_file(self.folder / "replay.pkl") as temporary:
                model.save_replay_buffer(temporary)
        write_card(self.folder, self.card)
