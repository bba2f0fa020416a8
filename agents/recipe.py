"""Recipes: settings of a training (algorithm, task, environment, policy), stored as TOML in `recipes/`."""

from __future__ import annotations

import tomllib
from dataclasses import asdict, dataclass, field, fields, replace
from importlib import resources
from pathlib import Path
from typing import Any

from ..controllers import MotionModel, TransferDesign
from ..envs import TASKS, EnvConfig, Task, as_task
from ..errors import InputError, suggestion
from ..files import read_document
from ..machine import METERS, AxisUnit, Machine

ALGORITHMS = ("ppo", "sac", "tqc", "crossq", "apg")
# Options of the environment that a recipe cannot set: `train` sets the first two, and the features of
# policies expect a dict of observations in SI units.
FIXED_OPTIONS = ("machine", "task", "normalize", "flat", "error")


@dataclass(frozen=True)
class LinearSchedule:
    """Rate, such as a learning rate, that changes linearly over a training run; called by stable-baselines3.

    Attributes:
        first: Rate at the first step.
        last: Rate at the last step, and beyond it: a run ends with a complete rollout, a little after its
            last step.
    """

    first: float
    last: float

    def __call__(self, remaining: float) -> float:
        """Interpolate the rate, in the unit of `first`, at the fraction of the run that remains (1: start).

        Beyond the last step, the fraction is negative and counts as 0.
        """
        return self.last + (self.first - self.last) * max(remaining, 0.0)


@dataclass(frozen=True)
class Recipe:
    """Settings of a training run of stable-baselines3 or by analytic gradients.

    Attributes:
        name: Name of the recipe, ALGORITHM_TASK, for example "ppo_reach".
        kind: Algorithm, one of `ALGORITHMS`: "ppo" or "sac" of stable-baselines3, "tqc" or "crossq" of
            sb3-contrib, or "apg" (`AnalyticPolicyGradient`).
        steps: Environment steps of a run.
        env: Keyword arguments of the vector environment `HFrameVecEnv`, without machine, task, normalize and
            flat. Agents are scored with the same randomization, sensors and drives.
        algorithm: Keyword arguments of the algorithm's class. A pair is a rate that changes linearly from the
            first value to the second over the run.
        policy: Keyword arguments of its policy class.
        task: Keyword arguments of the task class.
        actuation: Keyword arguments of `ResidualAction`, which converts the policy's outputs to actions; if
            empty, the outputs are the actions.
        hindsight: Keyword arguments of `HerReplayBuffer`; if empty, the replay buffer is the algorithm's
            default.
        features: Keyword arguments of `feature_parameters` beside machine and period.
        start: Name of an agent that comes with the package and from whose weights training starts; empty to
            start from random weights.

    Raises:
        InputError: If `env` has one of the excluded keyword arguments, or `policy` has `use_sde`.
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
    features: dict[str, Any] = field(default_factory=dict)
    start: str = ""

    def __post_init__(self) -> None:
        for option in FIXED_OPTIONS:
            if option in self.env:
                raise InputError(
                    f"recipe {self.name}: env has the option {option}; machine and task "
                    "are arguments of `train`, and agents observe a dict in SI units; remove the option"
                )
        if "use_sde" in self.policy:  # the algorithm passes it to its policy
            raise InputError(f"recipe {self.name}: policy has use_sde; move it to algorithm")

    @property
    def algorithm_keywords(self) -> dict[str, Any]:
        """Keyword arguments of the training algorithm's class: the entries of `algorithm`.

        Every pair [first, last] becomes a `LinearSchedule`, a rate that changes linearly from first to last
        in the run.
        """
        return {k: LinearSchedule(*v) if isinstance(v, list) else v for k, v in self.algorithm.items()}

    @property
    def period(self) -> float:
        """Control period of the training environment, s: `env["period"]`, or 0.01 s if it is not stated."""
        return float(self.env.get("period", EnvConfig.period))

    @property
    def randomize(self) -> Any:
        """Randomization of the training environment's machine: `env["randomize"]`, or "none" by default."""
        return self.env.get("randomize", EnvConfig.randomize)

    @property
    def longest_transfer(self) -> int:
        """Duration of the longest transfer (motion to rest at the goal) that the recipe uses; -1 without any.

        It counts in control periods beyond the shortest transfer, like the entries `transfers` of `features`
        and `actuation`.
        """
        return max((*self.features.get("transfers", ()), *self.actuation.get("transfers", ())), default=-1)

    def as_dict(self) -> dict[str, Any]:
        """Convert the recipe to a dictionary of its attributes, for card.json."""
        return asdict(self)


def recipe_names() -> tuple[str, ...]:
    """List the recipes that come with the package, as "ppo_reach" (ALGORITHM_TASK), sorted."""
    files = (resources.files(__package__) / "recipes").iterdir()
    return tuple(sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml")))


def require_transfers(recipe: Recipe, machine: Machine, task: str) -> None:
    """Check that a machine's workspace is large enough for the recipe's transfers (motions to rest).

    Args:
        task: Name of the task of the training, for the recipes that the message proposes.

    Raises:
        InputError: If the longest transfer of the recipe does not exist for the machine. The message proposes
            recipes whose transfers do.
    """
    needed, task = recipe.longest_transfer, recipe_task(task)
    if needed < 0:
        return
    designed = TransferDesign(MotionModel(machine), recipe.period)
    available = designed.longest - designed.shortest
    if needed <= available:
        return
    others = [
        load_recipe(name.removesuffix(f"_{task}"), task)
        for name in recipe_names()
        if name.endswith(f"_{task}")
    ]
    suitable = [
        r.name.removesuffix(f"_{task}") for r in others if r.longest_transfer <= available and not r.start
    ]
    raise InputError(
        f"recipe {recipe.name}: needs motions that last up to {needed} control periods longer than the "
        f"shortest one, but the longest in the workspace of machine {machine.name!r} "
        f"last {available} periods longer; choose a recipe without them: {', '.join(suitable)}"
    )


def build_task(recipe: Recipe, name: str, unit: AxisUnit = METERS) -> Task:
    """Build the task of a training run with the recipe's settings (`Recipe.task`).

    Recipes state lengths in m. If the unit of the axes is rad, they hold as angles at the end of an arm of
    0.1 m.

    Args:
        name: Name of a registered task, or `module:name`.
        unit: Unit of the tool's axes.

    Raises:
        InputError: If the task is unknown, its class does not have the keywords of `recipe.task`, or its
            observation has another number of future goals (`Task.ahead_s`) than the features of the recipe
            use.
    """
    # TOML has no tuples.
    settings: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in recipe.task.items()}
    for key in set(TASKS.get(name).lengths) & set(settings):
        settings[key] *= unit.per_meter
    try:
        task = as_task(name, unit, **settings)
    except TypeError as error:
        raise InputError(f"recipe {recipe.name}, table task: {error}") from error
    used, observed = recipe.features.get("preview", 0), len(task.ahead_s)
    if used and used != observed:
        raise InputError(
            f"recipe {recipe.name}: uses {used} future goals, but the task {name} shows {observed} "
            f"(ahead_s); let the task show {used}, or choose a recipe that takes any number: ppo, residual"
        )
    return task


def recipe_task(task: str) -> str:
    """Return the task whose recipes and shipped agents are used for a task.

    It is the task itself if the package has recipes for it; else the task with recipes that has the same
    metrics: "reach" if an episode has a fixed goal, "track" if the goal moves along a path.

    Raises:
        InputError: If the task is unknown or its module cannot be imported.
    """
    with_recipes = {name.rpartition("_")[2] for name in recipe_names()}
    return task if task in with_recipes else TASKS.get(task).metrics


def load_recipe(name: str, task: str) -> Recipe:
    """Load the settings of a training run (a recipe) for an algorithm and a task.

    A task without recipes has those of the task with the same metrics (`recipe_task`), with its own default
    settings in place of the recipe's.

    Args:
        name: First part of the recipe's name, for example "ppo", "sac", "sac_her", "residual" or "adapt", or
            the path of a recipe of your own, a file that ends in .toml. With `base = "ppo"`, the file states
            only the differences from the package's recipe `ppo`.
        task: Name of the task, for example "reach", or `module:name`.

    Raises:
        InputError: If the task is unknown, a file is no recipe, or there is no such recipe; the message lists
            the available recipes.
    """
    if name.endswith(".toml"):
        return _read_recipe(Path(name), task)
    trained = recipe_task(task)
    file = resources.files(__package__) / "recipes" / f"{name}_{trained}.toml"
    if not file.is_file():
        names = {recipe.rpartition("_")[0] for recipe in recipe_names()}
        listed = ", ".join(" on ".join(recipe.rsplit("_", 1)) for recipe in recipe_names())
        likewise = "" if trained == task else f" (the task {task} has the recipes of {trained})"
        meant = suggestion(name, names)
        if name in recipe_names():  # with the name of its task, as in the list of recipes of the folder
            meant = "; did you mean {!r} for the task {}?".format(*name.rsplit("_", 1))
        raise InputError(
            f"there is no recipe for {name} on {trained}{likewise}; choose one of: {listed}{meant}"
        )
    recipe = Recipe(name=f"{name}_{trained}", **tomllib.loads(file.read_text("utf-8")))
    return recipe if trained == task else replace(recipe, task={})


def _read_recipe(path: Path, task: str) -> Recipe:
    """Read a recipe from a file of the user, complete or as changes of the one that it names as `base`."""
    try:
        content = tomllib.loads(read_document(path))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{path}: is no valid TOML: {error}") from None
    forms = {
        f.name: {"str": str, "int": int}.get(str(f.type), dict) for f in fields(Recipe) if f.name != "name"
    }
    for key, value in content.items():
        form = forms.get(key, str if key == "base" else None)
        if form is None:
            choices = ", ".join(("base", *forms))
            raise InputError(
                f"{path}: {key} is no entry of a recipe, which has {choices}{suggestion(key, forms)}"
            )
        if type(value) is not form:
            wanted = {str: "a text", int: "a whole number", dict: f"a table [{key}]"}[form]
            raise InputError(f"{path}: {key} is {value!r}, it must be {wanted}")
    base = content.pop("base", "")
    if base:
        recipe = load_recipe(base, task)
        tables = {k: {**getattr(recipe, k), **v} for k, v in content.items() if isinstance(v, dict)}
        return replace(recipe, name=path.stem, **content | tables)
    missing = [key for key in ("kind", "steps", "env", "algorithm", "policy") if key not in content]
    if missing:
        raise InputError(
            f'{path}: {missing[0]} is missing; state it, or the recipe that this one changes: base = "ppo"'
        )
    return Recipe(name=path.stem, **content)
