"""Export of episodes to Minari data sets, for offline reinforcement learning and imitation.

All episodes of a chunk run in one native vector environment. Environment i of a vector equals the single
environment of the same seed to the bit, so the environment that Minari recovers from a data set repeats every
episode exactly.
"""

from __future__ import annotations

import copy
import importlib
import json
import re
import shutil
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from typing_extensions import override

from ..arrays import Actions, KeyedObservation, Mask
from ..controllers import Controller
from ..dynamics import NotFiniteError
from ..envs import HFrameVectorEnv, as_task
from ..errors import InputError, naming_extra
from ..files import atomic_file, output_batch, scratch_folder
from ..machine import BUILTIN_MACHINES, Machine
from ..recordings import machine_to_dict, save_machine
from ..version import __version__
from .controller_creation import make_controller
from .scenario import Scenario

RANDOM = "random"  # name of a data set of uniformly random actions
EXPERT = "predictive"  # controller whose mean return is the upper reference score
REFERENCE_EPISODES, REFERENCE_SEED = 64, 1_000_000
CHUNK = 256  # episodes in memory at a time: about 5 MB of float32 arrays
MACHINE_FILE = "machine.json"


class RandomActions(Controller):
    """Uniformly random actions, to compare offline data sets; a reset begins the same sequence again."""

    feedback: ClassVar[Literal["observation"]] = "observation"
    knowledge: ClassVar[str] = "nothing"

    def __init__(self, machine: Machine, period: float = 0.01) -> None:
        super().__init__(machine, period)
        self._episodes, self._generator = 0, np.random.default_rng(0)

    @override
    def reset(self, mask: Mask | None = None) -> None:
        """Seed the random actions of all machines by the number of resets so far, whatever `mask` is."""
        self._episodes += 1
        self._generator = np.random.default_rng(self._episodes)

    @override
    def act(self, observation: KeyedObservation) -> Actions:
        """Return independent actions that are uniform in [-1, 1]."""
        shape = len(observation["desired_goal"]), len(self.machine.drives)
        return self._generator.uniform(-1.0, 1.0, shape)


def dataset_controller(name: str, scenario: Scenario) -> Controller:
    """Return the controller of a data set: "random" for random actions, else as `make_controller`.

    Args:
        name: "random", name of a registered controller, `module:name` of one, or folder of a trained agent.

    Raises:
        InputError: If the controller is unknown or cannot run in this scenario.
    """
    if name == RANDOM:
        return RandomActions(scenario.declared_machine, scenario.period)
    return make_controller(name, scenario)


class ExportedDataset(NamedTuple):
    """A Minari data set on disk.

    Attributes:
        dataset_id: Name for `minari.load_dataset`, for example "hframe/reach/pid-v0".
        folder: Folder of the data set, below the folder that `MINARI_DATASETS_PATH` names.
        episodes: Number of episodes.
        steps: Number of steps of all episodes.
        mean_return: Mean over the episodes of the sum of rewards.
        success_rate: Fraction of the episodes that end within the task's band around the goal, 0 to 1.
    """

    dataset_id: str
    folder: Path
    episodes: int
    steps: int
    mean_return: float
    success_rate: float


def export_dataset(
    name: str,
    scenario: Scenario,
    out: str | Path,
    *,
    normalize: bool = False,
    flat: bool = False,
    author: str | None = None,
    reference: bool = False,
) -> ExportedDataset:
    """Simulate the episodes of a scenario with one controller and write them as a Minari data set.

    The id of the data set is MACHINE/TASK/CONTROLLER-v0. Minari finds it if the environment variable
    `MINARI_DATASETS_PATH` names the folder `out`. Observations, rewards and infos are those of `HFrame-v0`
    with the scenario's options (`HFrameTrack-v0` for a task with a path); actions are the applied fractions
    of the rated voltages, float32. The metadata of each episode contain its seed. The metadata of the data
    set contain the controller, the machine with all parameters, the options of the environment and the
    version of this package.

    Args:
        name: Name of a registered controller, such as "pid", `module:name` of one, folder of a trained agent,
            or "random" for uniformly random actions.
        scenario: Machine, task, randomization, sensors, drives, number of episodes, seed, period and
            duration.
        out: Folder for data sets; created if it does not exist.
        normalize: Whether observations and goals are stored as (value - center) / scale, about -1 to 1:
            positions over their range, velocities over the no-load speed. The controller always receives SI
            units.
        flat: Whether a stored observation is one array instead of a dict of arrays.
        author: Author in the metadata. Default: none.
        reference: Whether the metadata have reference scores for `minari.get_normalized_score`: the mean
            returns of random actions (0) and of the controller "predictive" (1) in 64 other episodes.

    Raises:
        InputError: If the controller is unknown or cannot run in this scenario, an option of the scenario is
            not the name of a preset, the control period is not 0.01 s in a task with a path, the simulated
            motion diverges, or the data set exists already.
        ImportError: If the extra `minari` is not installed; the message names the pip command.
    """
    storage_class, buffer_class = _import_minari()
    label = re.sub(r"[^\w-]+", "-", Path(name).name)
    machine_label = re.sub(r"[^\w-]+", "-", scenario.declared_machine.name)
    dataset_id = f"{machine_label}/{scenario.task_name}/{label}-v0"
    out = Path(out).resolve()  # Minari joins relative paths twice
    folder = out / dataset_id
    if folder.exists():
        raise InputError(
            f"{folder}: a data set of this name exists already; delete it or choose another --out"
        )
    spec = _env_spec(scenario, folder, normalize=normalize, flat=flat)
    controller = dataset_controller(name, scenario)
    metadata = _metadata(dataset_id, name, controller, scenario, author)
    if reference:
        scores = [
            _mean_return(dataset_controller(other, scenario), spec, scenario, buffer_class)
            for other in (RANDOM, EXPERT)
        ]
        metadata |= {
            "ref_min_score": scores[0],
            "ref_max_score": scores[1],
            "num_episodes_average_score": REFERENCE_EPISODES,
        }
    # Minari writes files by path: in the system's temporary folder (TMPDIR), so that a kill leaves nothing in
    # `out`.
    with output_batch(out), scratch_folder() as temporary:
        if spec.kwargs["machine"] == str(folder / MACHINE_FILE):
            save_machine(scenario.declared_machine, folder / MACHINE_FILE)
        one = _vector_env(spec, scenario, 1)
        spaces = one.single_observation_space, one.single_action_space
        storage = storage_class.new(temporary / "data", *spaces, spec, jpeg_encoding=False)
        storage.update_metadata(metadata)
        means = _write_episodes(storage, buffer_class, controller, spec, scenario)
        for path in sorted(p for p in temporary.rglob("*") if p.is_file()):
            with path.open("rb") as source, atomic_file(folder / path.relative_to(temporary)) as file:
                shutil.copyfileobj(source, file)
    return ExportedDataset(
        dataset_id, folder, scenario.episodes, scenario.episodes * scenario.periods, *means
    )


def _write_episodes(
    storage: Any, buffer_class: Any, controller: Controller, spec: EnvSpec, scenario: Scenario
) -> tuple[float, float]:
    """Simulate and store all episodes, `CHUNK` at a time; return the mean return and the success rate."""
    returns: list[float] = []
    successes: list[bool] = []
    for first in range(0, scenario.episodes, CHUNK):
        envs = _vector_env(spec, scenario, min(CHUNK, scenario.episodes - first))
        episodes = _record(controller, envs, scenario.seed + first, buffer_class)
        storage.update_episodes(episodes)
        returns += [float(np.sum(episode.rewards)) for episode in episodes]
        successes += [bool(episode.infos["is_success"][-1]) for episode in episodes]
    return float(np.mean(returns)), float(np.mean(successes))


def _mean_return(controller: Controller, spec: EnvSpec, scenario: Scenario, buffer_class: Any) -> float:
    """Return the mean over REFERENCE_EPISODES episodes of the sum of the rewards of a controller."""
    envs = _vector_env(spec, scenario, REFERENCE_EPISODES)
    episodes = _record(controller, envs, REFERENCE_SEED, buffer_class)
    return float(np.mean([np.sum(episode.rewards) for episode in episodes]))


def _import_minari() -> tuple[Any, Any]:
    """Return Minari's classes MinariStorage and EpisodeBuffer; raise ImportError with the pip command."""
    with naming_extra("minari", "data sets need minari and h5py"):
        importlib.import_module("h5py")
        storage = importlib.import_module("minari.dataset.minari_storage")
        buffer = importlib.import_module("minari.data_collector")
    return storage.MinariStorage, buffer.EpisodeBuffer


def _env_spec(scenario: Scenario, folder: Path, *, normalize: bool, flat: bool) -> EnvSpec:
    """Return the specification from which `gym.make` makes the environment of a scenario again.

    A machine that is not a preset is read from the machine.json in the folder of the data set.
    """
    if scenario.controller_task != as_task(scenario.task, scenario.declared_machine.axis_unit):
        raise InputError(
            f"task {scenario.task_name} at a period of {scenario.period:g} s: the controller "
            "needs a preview of goals at this period, which the data set's environment cannot state; "
            "export this task at a period of 0.01 s"
        )
    options: dict[str, Any] = {
        key: getattr(scenario, key) for key in ("task", "randomize", "sensors", "drives")
    }
    for option, value in options.items():
        if not isinstance(value, str):
            raise InputError(f"{option} is {value!r}: a data set can only state the name of a preset")
    is_preset = isinstance(scenario.machine, str) and scenario.machine in BUILTIN_MACHINES
    options["machine"] = scenario.machine if is_preset else str(folder / MACHINE_FILE)
    options |= {"period": scenario.period, "normalize": normalize, "flat": flat}
    spec = copy.deepcopy(gym.spec("HFrameTrack-v0" if scenario.metrics == "track" else "HFrame-v0"))
    spec.kwargs = options
    spec.max_episode_steps = scenario.periods
    return spec


def _vector_env(spec: EnvSpec, scenario: Scenario, count: int) -> HFrameVectorEnv:
    """Make `count` environments of a specification, with the machine of the scenario."""
    options = {**spec.kwargs, "machine": scenario.declared_machine}
    try:
        return HFrameVectorEnv(
            count, max_episode_steps=spec.max_episode_steps, autoreset_mode="Disabled", **options
        )
    except ValueError as error:
        raise InputError(str(error)) from None


def _record(controller: Controller, envs: HFrameVectorEnv, seed: int, buffer_class: Any) -> list[Any]:
    """Simulate one episode per environment, seeds seed, seed + 1, ..., and return Minari's buffers."""
    observation, info = envs.reset(seed=seed)
    controller.reset()
    observations, infos, steps, over = [observation], [_without_masks(info)], [], False
    try:
        while not over:
            # Controllers take observations in SI units by key, whatever the data set stores.
            actions = np.clip(controller.act(envs.batch.observe()), -1.0, 1.0).astype(np.float32)
            observation, reward, terminated, truncated, info = envs.step(actions)
            observations.append(observation)
            infos.append(_without_masks(info))
            steps.append((actions, reward, terminated, truncated))
            # Nothing terminates with end stops, so all episodes have the same length.
            over = bool(truncated.all())
    except NotFiniteError as error:
        name = envs.machine.name
        raise InputError(
            f"machine {name!r}: the simulated motion diverges under this controller ({error})"
        ) from None
    in_time = [_stack(values) for values in (observations, infos)]
    actions, rewards, terminations, truncations = (
        np.stack(column, axis=1) for column in zip(*steps, strict=True)
    )
    return [
        buffer_class(
            seed=seed + b,
            observations=_row(in_time[0], b),
            actions=actions[b],
            rewards=rewards[b],
            terminations=terminations[b],
            truncations=truncations[b],
            infos=_row(in_time[1], b),
        )
        for b in range(envs.num_envs)
    ]


def _without_masks(info: dict[str, Any]) -> dict[str, Any]:
    """Return an info of a vector environment without the masks "_key", also in `parameters`."""
    return {
        key: _without_masks(value) if isinstance(value, dict) else value
        for key, value in info.items()
        if not key.startswith("_")
    }


def _stack(moments: list[Any]) -> Any:
    """Stack arrays (B, ...) of n moments to arrays (B, n, ...), in dictionaries or not."""
    if isinstance(moments[0], dict):
        return {key: _stack([moment[key] for moment in moments]) for key in moments[0]}
    return np.stack(moments, axis=1)


def _row(arrays: Any, b: int) -> Any:
    """Return row b of arrays (B, ...), in dictionaries or not."""
    return {key: _row(value, b) for key, value in arrays.items()} if isinstance(arrays, dict) else arrays[b]


def _metadata(
    dataset_id: str, name: str, controller: Controller, scenario: Scenario, author: str | None
) -> dict[str, Any]:
    """Return a data set's metadata as plain data: Minari's fields, then this package's below "hframe"."""
    machine = scenario.declared_machine
    card = getattr(controller, "card", None)  # of a trained agent
    metadata: dict[str, Any] = {
        "dataset_id": dataset_id,
        "minari_version": version("minari"),
        "algorithm_name": name if card is None else f"{card['recipe']}, seed {card['seed']}",
        "description": (
            f"{scenario.episodes} episodes of {name} on the machine {machine.name}, "
            f"task {scenario.task_name}, randomize {scenario.randomize}, "
            f"sensors {scenario.sensors}, drives {scenario.drives}, control period {scenario.period:g} s; "
            f"episode i has the seed {scenario.seed} + i. Written by hframe export."
        ),
        "requirements": [f"hframe_gym=={__version__}"],
        "hframe": {
            "version": __version__,
            "controller": name,
            "controller_class": type(controller).__name__,
            "agent": None if card is None else json.loads(json.dumps(card)),
            "machine": machine_to_dict(machine),
            "task": scenario.task_name,
            "randomize": scenario.randomize,
            "sensors": scenario.sensors,
            "drives": scenario.drives,
            "seed": scenario.seed,
            "period_s": scenario.period,
            "duration_s": scenario.duration_s,
        },
    }
    return metadata if author is None else {**metadata, "author": {author}}
