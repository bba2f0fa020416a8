"""Entry `history`: PPO corrects `pid` and observes the last eight control periods, so that it can adapt.

    python -m benchmarks.gap run history            # or history-seed1, ...

The first run trains two policies, for moves and for paths, on machines with the parameters of the
randomization "wide" around the declared one, about two minutes in all, and keeps them in out/gap. What
differs from the declared machine shows in how the tool answered to the voltages, which the policy observes:
features of state, goal and commands of each period (`hframe_gym.agents.features`). It knows nothing of the
plants: no recording, no practice.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnvWrapper
from typing_extensions import override

from benchmarks.gap.control_loop import PERIOD_S
from benchmarks.gap.entries import GapEntry, from_measurements
from benchmarks.gap.recorder import Recorder
from hframe_gym.agents.features import OBSERVATION_KEYS, feature_matrix, feature_parameters
from hframe_gym.agents.optional_dependencies import single_threaded_torch
from hframe_gym.agents.residual_action import ResidualAction
from hframe_gym.agents.sb3_adapters import ResidualActionVecEnv, set_mean_action_to_zero
from hframe_gym.arrays import Actions, KeyedObservation, Mask
from hframe_gym.controllers import Controller
from hframe_gym.envs import Reach, Task, Track
from hframe_gym.envs.sb3_vec_env import HFrameVecEnv
from hframe_gym.machine import Machine
from tests.reference_simulator import Array

PERIODS = 8  # of the history: 80 ms, a third of a move
FEATURE_KEYS = ("observation", "desired_goal", "preview", "last_action", "base_action")
AUTHORITY = {"least": 0.02, "most": 0.3}  # as in the recipe `residual`
TASKS: dict[str, Task] = {
    "reach": Reach(band=2e-4),
    "track": Track(path=("circle", "square"), size=0.05, speed=0.3),
}
STEPS = {"reach": 300_000, "track": 150_000}
# As in the recipes `residual` of both tasks: a period outside the band costs 1, and the distance to a path.
ENVIRONMENT = {"reach": ("sparse", 80), "track": ("dense", 75)}  # reward, control periods
DISCOUNT = {"reach": 0.95, "track": 0.9}
ENVIRONMENTS = 64
SETTINGS: dict[str, Any] = {
    "n_steps": 64,
    "batch_size": 1024,
    "n_epochs": 5,
    "gae_lambda": 0.9,
    "target_kl": 0.01,
    "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -2.5},
}
# Environment i has the seed FIRST_SEED + seed * SEED_STRIDE + i: no episode of a protocol.
FIRST_SEED, SEED_STRIDE = 20_000_000, 100_000


class History:
    """Features of the last control periods of a batch of machines, the present one first.

    Args:
        space: Space of the observations that `ResidualAction` returns.
        machine: Declared machine.
    """

    def __init__(self, space: spaces.Dict, machine: Machine) -> None:
        self._keys = [key for key in OBSERVATION_KEYS if key in FEATURE_KEYS and key in space.spaces]
        sizes = {key: int(np.prod(space[key].shape or ())) for key in self._keys}
        geometry = feature_parameters(machine, PERIOD_S)
        arrays = np.array(geometry["radii"]), np.array(geometry["rest"])
        self._matrix, self._factors = feature_matrix(sizes, *arrays)
        self.size = PERIODS * len(self._factors)
        self._frames = np.zeros((0, PERIODS, len(self._factors)))

    def frame(self, observation: Mapping[str, Array]) -> Array:
        """Compute the features of one period, dimensionless, shape (B, features)."""
        scaled = np.hstack([observation[key] for key in self._keys]) @ self._matrix
        return np.asarray(np.sign(scaled) * np.log1p(np.abs(scaled)) * self._factors)

    def push(self, observation: Mapping[str, Array], starting: Mask | None = None) -> Array:
        """Add a period, and return the history, shape (B, size); machines that start get it repeated.

        Args:
            observation: Observations of the period, of `ResidualAction`.
            starting: Which machines start an episode, shape (B,); None: all.
        """
        now = self.frame(observation)[:, None]
        repeated = np.repeat(now, PERIODS, axis=1)
        if starting is None or len(self._frames) != len(now):
            self._frames = repeated
        else:
            moved = np.concatenate([now, self._frames[:, :-1]], axis=1)
            self._frames = np.where(starting[:, None, None], repeated, moved)
        return self._frames.reshape(len(now), -1).astype(np.float32)

    def ended(self, observation: Mapping[str, Array], b: int) -> Array:
        """Return the history of machine b with the last observation of its episode, shape (size,)."""
        now = self.frame({key: np.asarray(observation[key])[None] for key in self._keys})
        return np.concatenate([now, self._frames[b, :-1]]).ravel().astype(np.float32)


class HistoryVecEnv(VecEnvWrapper):  # type: ignore[misc]
    """Vector environment of residual actions that observes the history.

    Args:
        environment: Environments with residual actions.
        machine: Declared machine.
    """

    def __init__(self, environment: ResidualActionVecEnv, machine: Machine) -> None:
        assert isinstance(environment.observation_space, spaces.Dict)
        self.history = History(environment.observation_space, machine)
        box = spaces.Box(-np.inf, np.inf, (self.history.size,), np.float32)
        super().__init__(environment, observation_space=box)

    @override
    def reset(self) -> Array:
        return self.history.push(self.venv.reset())  # type: ignore[arg-type]

    @override
    def step_wait(self) -> tuple[Array, Array, Array, list[dict[str, Any]]]:
        observation, reward, done, infos = self.venv.step_wait()
        for b in np.flatnonzero(done).tolist():
            infos[b]["terminal_observation"] = self.history.ended(infos[b]["terminal_observation"], b)
        return self.history.push(observation, done), reward, done, infos  # type: ignore[arg-type]


def train(machine: Machine, task: str, seed: int, steps: int) -> PPO:
    """Train the policy of a task.

    Args:
        machine: Declared machine.
        task: "reach" or "track".
        seed: Seed of network, episodes and algorithm.
        steps: Environment steps.
    """
    reward, length = ENVIRONMENT[task]
    envs = HFrameVecEnv(
        ENVIRONMENTS,
        machine=machine,
        task=TASKS[task],
        randomize="wide",
        reward=reward,
        max_episode_steps=length,
    )
    envs.seed(FIRST_SEED + seed * SEED_STRIDE)
    mapping = ResidualAction(machine, PERIOD_S, base="pid", **AUTHORITY)
    observed = HistoryVecEnv(ResidualActionVecEnv(envs, mapping), machine)
    with single_threaded_torch():
        rate = {"learning_rate": lambda left: 3e-4 * left}
        settings = {**SETTINGS, **rate, "gamma": DISCOUNT[task]}
        model = PPO("MlpPolicy", observed, **settings, seed=seed, device="cpu")
        set_mean_action_to_zero(model.policy)  # the policy begins as `pid`
        model.learn(steps)
    return model


class HistoryController(Controller):
    """The policy, from the full state.

    Args:
        machine: Declared machine.
        model: Trained model.
    """

    feedback = "estimated_state"

    def __init__(self, machine: Machine, model: Any) -> None:
        super().__init__(machine, PERIOD_S)
        self._mapping = ResidualAction(machine, PERIOD_S, base="pid", **AUTHORITY)
        self._model = model
        self._history: History | None = None
        self._starting: Mask | None = None

    @override
    def reset(self, mask: Mask | None = None) -> None:
        self._mapping.reset(mask)
        self._starting = mask
        if mask is None:
            self._history = None

    @override
    def act(self, observation: KeyedObservation) -> Actions:
        augmented = self._mapping.augment(observation)
        if self._history is None:
            boxes = {key: spaces.Box(-np.inf, np.inf, rows.shape[1:]) for key, rows in augmented.items()}
            self._history, self._starting = History(spaces.Dict(boxes), self.machine), None
        history = self._history.push(augmented, self._starting)
        self._starting = np.zeros(len(history), np.bool_)
        with single_threaded_torch():
            outputs, _ = self._model.predict(history, deterministic=True)
        return self._mapping.action(outputs)

    @override
    def replace_last_action(self, actions: Actions) -> None:
        self._mapping.replace_last_action(actions)


class HistoryPolicy(GapEntry):
    """Policies for moves and paths that observe a history.

    Attributes:
        seed: Seed of their training.
    """

    learned = True
    knowledge = "declared machine, history of 8 periods"
    seed: ClassVar[int] = 0

    @override
    def prepare(self, declared: Machine, recorder: Recorder, folder: Path) -> None:
        self.machine, self.models = declared, {}
        code = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:8]
        for task, steps in STEPS.items():
            file = folder.parent / "history" / f"{task}-seed{self.seed}-{code}.zip"
            if not file.is_file():
                file.parent.mkdir(parents=True, exist_ok=True)
                train(declared, task, self.seed, steps).save(file)
            self.models[task] = PPO.load(file, device="cpu")

    @override
    def controller(self, task: Task) -> Controller:
        return from_measurements(HistoryController(self.machine, self.models[task.name]), self.machine)
