"""Train agents on the vector environment with the settings of a recipe, and resume interrupted runs.

A run writes to its folder the agent with the best evaluation so far (agent.json, machine.json,
policy.safetensors), its card (card.json, README.md), tensorboard/, and for `resume` checkpoint.zip,
replay.pkl and environment.pkl. These three are pickles, which execute code when they are loaded: they are
signed, and only files that this installation wrote are loaded (`checkpoint_signature`). After each evaluation
all files but the logs are replaced together. A run may therefore be killed at any time; `resume` continues it
as if it had not been interrupted.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from ..controllers import period_concern
from ..envs import EnvConfig, Task
from ..errors import InputError
from ..evaluation import Scenario, result_versions
from ..files import atomic_file, complete_commit, locked_folder, newest, output_batch
from ..line_log import LineLog
from ..machine import Machine
from ..recordings import load_machine
from .agent import Agent, load_weights, policy_class, policy_keywords, same_parameters
from .agent_files import RESUME_FILES, SCHEMA, read_training_card, refuse_to_replace
from .checkpoint_signature import refuse_unsigned, sign_checkpoint
from .controller_source import start_agent_folder
from .features import feature_parameters
from .model_card import EVALUATION_EPISODES, improves, progress_line, score_agent, write_card
from .optional_dependencies import (
    CONTRIB_ALGORITHMS,
    import_optional,
    require_training_packages,
    single_threaded_torch,
)
from .recipe import ALGORITHMS, Recipe, build_task, load_recipe, recipe_task, require_transfers
from .residual_action import residual_action

# Environment i of a run with seed s has the seed TRAINING_SEED + s * SEED_STRIDE + i. The seeds of the
# evaluation episodes are smaller, so that no training run contains these episodes.
EVALUATION_SEED = 1_000_000
TRAINING_SEED = 10_000_000
SEED_STRIDE = 100_000
EVALUATIONS_PER_RUN = 12
SHORTEST_INTERVAL = 2_000  # environment steps between evaluations

Progress = Callable[[int, int], None]


def train(
    algorithm: str | Recipe,
    machine: str | Path | Machine = "hframe",
    task: str = "reach",
    *,
    steps: int | None = None,
    seed: int = 0,
    randomize: str | None = None,
    out: str | Path = "agent",
    resume: bool = False,
    trust: bool = False,
    force: bool = False,
    log: LineLog = print,
    progress: Progress = lambda done, total: None,
) -> dict[str, Any]:
    """Train an agent by a recipe (settings) and write its version with the best scores to a folder.

    The same seed gives the same agent, bit for bit, with the same package versions on the same processor. A
    resumed run with the same number of steps gives the agent of an uninterrupted one, bit for bit; only times
    and logs differ.

    Args:
        algorithm: A recipe, or the first part of the name of a recipe in the package: "ppo" is the recipe
            ppo_reach for the task "reach". `recipe_names` lists them.
        machine: Machine to train on: object, built-in name such as "hframe", or path of a machine.json.
        task: Name of the task: "reach", "track", another registered one, or `module:name` (see
            `load_recipe`).
        steps: Environment steps in total, including those before a resume; the last rollout is completed.
            Default: the recipe's.
        seed: Seed of the network, the episodes and the algorithm, not negative.
        randomize: Randomization of the machine's parameters in place of the recipe's, for example
            "identified" for a machine.json with standard deviations.
        out: Folder for the agent and the checkpoint.
        resume: Continue from the checkpoint in `out`.
        trust: Resume also from a checkpoint that this installation did not write. Loading it executes code
            that it may contain.
        force: Replace an agent or checkpoint that `out` holds. Without it and `resume`, such a folder is
            refused.
        log: Function that receives one line of text after each evaluation.
        progress: Function that receives the number of environment steps done and the total, after each step.

    Returns:
        Contents of card.json: recipe, package versions and learning curve (`curve`, one row of scores per
        evaluation).

    Raises:
        InputError: If the recipe or task is unknown or does not fit the machine; if `out` holds a run and
            neither `resume` nor `force` is set; if `out` has no checkpoint of this recipe, machine and seed
            to resume, or one that this installation did not write and `trust` is not set; or if another
            process writes to `out`.
        ImportError: If the extra `agents` is not installed; the message names it.
    """
    recipe = algorithm if isinstance(algorithm, Recipe) else load_recipe(algorithm, task)
    if recipe.kind not in ALGORITHMS:
        raise InputError(
            f"recipe {recipe.name}: kind is {recipe.kind!r}, choose one of {', '.join(ALGORITHMS)}"
        )
    require_training_packages(recipe.kind)
    if randomize is not None:
        recipe = replace(recipe, env={**recipe.env, "randomize": randomize})
    # In all of it: the decomposition that draws the first weights has other last bits with more threads.
    with locked_folder(out), single_threaded_torch():
        declared = load_machine(machine)
        require_transfers(recipe, declared, task)
        if not (resume or force):
            refuse_to_replace(Path(out), recipe.name, task, declared.name, seed, alone=True)
        run = _Run(recipe, declared, task, seed, Path(out), log, progress)
        card = run.execute(recipe.steps if steps is None else steps, resume=resume, trust=trust)
        trained = card["curve"][-1]["steps"]
        if steps is not None and trained > steps:
            log(
                f"trained {trained} steps, not {steps}: "
                "a run ends with a whole rollout of all its environments"
            )
        return card


class _Run:
    """One training run: environment, model, periodic evaluations and files."""

    model: Any  # of stable-baselines3; built or loaded by `execute`
    total_steps: int
    evaluation_interval: int  # environment steps
    next_evaluation: int  # environment step
    start_time: float  # s, monotonic clock; such that the time before a resume counts
    start_cpu_time: float  # s, likewise
    kept_costs: Any = (
        None  # costs of the evaluation episodes of the agent that is kept, (B,); None before the first
    )
    improved_weights: dict[str, Any] | None = None  # of the agent to keep that is not saved yet
    evaluated: bool = False  # whether an evaluation is not saved yet

    def __init__(
        self,
        recipe: Recipe,
        machine: Machine,
        task: str,
        seed: int,
        folder: Path,
        log: LineLog,
        progress: Progress,
    ) -> None:
        self.recipe, self.machine, self.seed, self.folder = recipe, machine, seed, folder
        self.log, self.progress = log, progress
        concern = period_concern(machine, recipe.period)
        if concern:
            log(f"warning: {concern.partition(' (')[0]} in the recipe's [env]")
        built_task = build_task(recipe, task, machine.axis_unit)
        self.environment = _build_environment(recipe, machine, built_task)
        self.card = _new_card(recipe, machine, task, seed)
        self.card["previews"] = len(built_task.ahead_s)
        # Separate from the environment's mapping, which holds the history of the training episodes.
        self.evaluation_mapping = residual_action(machine, recipe.actuation, recipe.period)
        self.scenario = Scenario(
            machine=machine,
            task=built_task,
            randomize=recipe.randomize,
            sensors=recipe.env.get("sensors", EnvConfig.sensors),
            episodes=EVALUATION_EPISODES,
            seed=EVALUATION_SEED,
            period=recipe.period,
            drives=recipe.env.get("drives", EnvConfig.drives),
        )

    def execute(self, steps: int, *, resume: bool, trust: bool) -> dict[str, Any]:
        """Train up to a total number of steps and return the card; arguments as those of `train`."""
        recipe, task = self.recipe, self.card["task"]
        self.total_steps = steps
        self.evaluation_interval = max(SHORTEST_INTERVAL, steps // EVALUATIONS_PER_RUN)
        self.model = self._load_checkpoint(trust) if resume else self._new_model()
        if recipe.start and not resume:
            load_weights(
                self.model.policy, start_agent_folder(recipe, task, self.machine, self.card["previews"])
            )
        logger = import_optional("stable_baselines3.common.logger")
        self.model.set_logger(logger.configure(str(self.folder / "tensorboard"), ["tensorboard"]))
        if not resume:
            self.environment.seed(TRAINING_SEED + self.seed * SEED_STRIDE)
            self.next_evaluation = self.evaluation_interval
        last_row = self.card["curve"][-1] if self.card["curve"] else {"seconds": 0.0, "cpu_s": 0.0}
        self.start_time = time.monotonic() - last_row["seconds"]
        self.start_cpu_time = time.process_time() - last_row["cpu_s"]
        if not resume:
            self._evaluate()
            self._save()
        callback = import_module("hframe_gym.agents.sb3_adapters").TrainingCallback(
            self._after_step, self._save
        )
        self.model.learn(steps - self.model.num_timesteps, callback=callback, reset_num_timesteps=False)
        self._evaluate()
        self._save()
        self.environment.close()
        return self.card

    def _new_model(self) -> Any:
        """Build the model with random weights."""
        recipe = self.recipe
        adapters = import_module("hframe_gym.agents.sb3_adapters")
        replay: dict[str, Any] = {}
        if recipe.kind == "crossq":
            replay = {"replay_buffer_class": adapters.JointReplayBuffer}
        if recipe.hindsight:
            buffer = import_optional("stable_baselines3").HerReplayBuffer
            replay = {"replay_buffer_class": buffer, "replay_buffer_kwargs": recipe.hindsight}
        try:
            model = _algorithm(recipe.kind)(
                policy_class(recipe.kind, recipe.actuation),
                self.environment,
                seed=self.seed,
                device="cpu",
                policy_kwargs=policy_keywords(recipe.policy, self.card["features"]),
                **replay,
                **recipe.algorithm_keywords,
            )
        except TypeError as error:
            raise InputError(f"recipe {recipe.name}, tables algorithm and policy: {error}") from error
        if "base" in recipe.actuation:
            adapters.set_mean_action_to_zero(model.policy)
        return model

    def _load_checkpoint(self, trust: bool) -> Any:
        """Load the folder's checkpoint: model, environment, random numbers, and the card's learning curve."""
        complete_commit(self.folder)
        card_file, checkpoint, environment, replay = (self.folder / name for name in RESUME_FILES)
        for file in (card_file, checkpoint, environment):
            if not file.is_file():
                raise InputError(f"nothing to resume: {file} does not exist")
        previous = read_training_card(card_file)
        held, wanted = (f"{c['recipe']} on {c['task']} with seed {c['seed']}" for c in (previous, self.card))
        if held != wanted:
            raise InputError(f"nothing to resume: {self.folder} holds a run of {held}, not of {wanted}")
        kept_agent = Agent.load(self.folder)
        if not same_parameters(kept_agent.machine, self.machine):
            raise InputError(
                f"nothing to resume: {self.folder} holds a run on the machine {kept_agent.machine.name!r}, "
                f"whose parameters are not those of {self.machine.name!r}; "
                f"resume it with --machine {self.folder / 'machine.json'}"
            )
        for file in (checkpoint, environment, replay) if not trust else ():
            if file.is_file():
                refuse_unsigned(file)
        state = pickle.loads(environment.read_bytes())
        self.environment, self.next_evaluation = state["environment"], state["next_evaluation"]
        if self.recipe.kind == "apg":
            model = self._new_model()
            model.restore(checkpoint)
        else:
            algorithm = _algorithm(self.recipe.kind)
            model = algorithm.load(checkpoint, env=self.environment, device="cpu", force_reset=False)
        if replay.is_file():
            model.load_replay_buffer(replay, truncate_last_traj=False)
        self.card["curve"] = [row for row in previous["curve"] if row["steps"] <= model.num_timesteps]
        self.card["kept"] = previous["kept"]
        self.kept_costs = score_agent(kept_agent, self.scenario).costs
        adapters = import_module("hframe_gym.agents.sb3_adapters")
        adapters.set_random_state(model, state["random"])  # last: what is above may draw random numbers
        return model

    def _after_step(self) -> None:
        """Report progress and evaluate when it is time; stable-baselines3 calls this after every step."""
        self.progress(self.model.num_timesteps, self.total_steps)
        if self.model.num_timesteps >= self.next_evaluation:
            self.next_evaluation = self.model.num_timesteps + self.evaluation_interval
            self._evaluate()

    def _evaluate(self) -> None:
        """Score the current policy, log the scores, and keep a copy of it if it is the best."""
        model, was_training = self.model, self.model.policy.training
        policy = getattr(model, "evaluated_policy", model.policy)
        agent = Agent(policy, self.evaluation_mapping, self.machine, self.card)
        scores = score_agent(agent, self.scenario)
        row = {
            "steps": model.num_timesteps,
            "seconds": round(time.monotonic() - self.start_time, 1),
            "cpu_s": round(time.process_time() - self.start_cpu_time, 1),
            **scores.row,
        }
        model.policy.set_training_mode(was_training)
        self.card["curve"] = [*(r for r in self.card["curve"] if r["steps"] < row["steps"]), row]
        self.log(progress_line(row))
        for key, value in row.items():
            if isinstance(value, float):
                model.logger.record(f"evaluation/{key}", value)
        model.logger.dump(model.num_timesteps)
        if improves(scores.costs, self.kept_costs):
            self.improved_weights = agent.weights()  # a policy with gSDE cannot be copied
            self.card["kept"], self.kept_costs = row["steps"], scores.costs
        self.evaluated = True

    def _save(self) -> None:
        """Write the last evaluation, unless it is written: checkpoint, card and the agent to keep, together.

        It runs between two rollouts, where the state of the run consists of what these files hold.
        """
        if not self.evaluated:
            return
        model = self.model
        state = {
            "environment": self.environment,
            "next_evaluation": self.next_evaluation,
            "random": import_module("hframe_gym.agents.sb3_adapters").random_state(model),
        }
        _, checkpoint, environment, replay = RESUME_FILES
        pickles = {checkpoint: model.save, environment: lambda file: pickle.dump(state, file)}
        if getattr(model, "replay_buffer", None) is not None:
            pickles[replay] = model.save_replay_buffer
        with output_batch(self.folder):
            if self.improved_weights is not None:
                Agent(model.policy, None, self.machine, self.card).save(self.folder, self.improved_weights)
            for name, write in pickles.items():
                with atomic_file(self.folder / name) as file:
                    write(file)
                sign_checkpoint(newest(self.folder / name))
            write_card(self.folder, self.card)
        self.improved_weights, self.evaluated = None, False


def _algorithm(kind: str) -> Any:
    """Return the class of the algorithm of a recipe's kind."""
    if kind == "apg":
        from .analytic_gradient import AnalyticPolicyGradient

        return AnalyticPolicyGradient
    if kind == "sac":
        return import_module("hframe_gym.agents.averaged_sac").AveragedSAC
    package = import_optional("sb3_contrib" if kind in CONTRIB_ALGORITHMS else "stable_baselines3")
    return package.CrossQ if kind == "crossq" else getattr(package, kind.upper())


def _build_environment(recipe: Recipe, machine: Machine, task: Task) -> Any:
    """Build the vector environment of a recipe, with its action mapping."""
    from ..envs.sb3_vec_env import HFrameVecEnv
    from .sb3_adapters import ResidualActionVecEnv

    environment = HFrameVecEnv(**recipe.env, machine=machine, task=task)
    mapping = residual_action(machine, recipe.actuation, recipe.period)
    return ResidualActionVecEnv(environment, mapping) if mapping else environment


def _new_card(recipe: Recipe, machine: Machine, task: str, seed: int) -> dict[str, Any]:
    """Return the card of a run that begins."""
    libraries = ("gymnasium", *(["sb3-contrib"] if recipe.kind in CONTRIB_ALGORITHMS else []))
    return {
        "schema": SCHEMA,
        "name": recipe.name.removesuffix(f"_{recipe_task(task)}"),
        "task": task,
        "kind": recipe.kind,
        "machine": machine.name,
        "seed": seed,
        "recipe": recipe.name,
        "settings": recipe.as_dict(),
        "period": recipe.period,
        "features": feature_parameters(machine, recipe.period, **recipe.features),
        "versions": result_versions(libraries),
        "curve": [],
    }
