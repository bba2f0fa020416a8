"""Does PPO of stable-baselines3 learn with its default hyperparameters? Goal: a median of 1 mm in 60 s.

    python -m benchmarks.plain_ppo [--seeds 3] [--seconds 60] [--envs 4] [--learning-rate 1e-3] [--gamma 0.95]

The environment is `HFrame-v0` with `normalize=True` and nothing else, without randomization. Time is the
processor time of the training, which other programs on the machine hardly affect, without that of the
evaluations. After every second rollout the deterministic policy is evaluated on 256 episodes that no training
used: the distance to the goal at their end. Hyperparameters that are not given as options keep the default of
stable-baselines3. Settings, seeds and versions are in results/plain_ppo.json; `--reward dense` and the like
show what the environment's defaults contribute.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from benchmarks.results_file import write_results
from hframe_gym.agents.optional_dependencies import single_threaded_torch
from hframe_gym.envs import EnvConfig, HFrameVectorEnv
from hframe_gym.envs.sb3_vec_env import HFrameVecEnv
from tools.command_line import command_line

BAR = 1.0  # mm, median distance at the end of an episode
EPISODES, EPISODE_S = 256, 1.5
EVALUATION_SEED = 1_000_000
ENVS = 4
ROLLOUTS_PER_EVALUATION = 2


def final_distance_mm(model: Any, period: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the distances to the goal at the end of the evaluation episodes, mm, shape (EPISODES,)."""
    envs = HFrameVectorEnv(EPISODES, max_episode_steps=None, normalize=True, period=period)
    observation, info = envs.reset(seed=EVALUATION_SEED)
    for _ in range(round(EPISODE_S / period)):
        observation, _, _, _, info = envs.step(model.predict(observation, deterministic=True)[0])
    return 1e3 * np.asarray(info["distance_m"])


class Curve(BaseCallback):
    """Evaluate the policy before rollouts, and end the training when its processor time is spent.

    Args:
        seconds: Processor time of the training, s.
        period: Control period, s.

    Attributes:
        rows: One row of numbers per evaluation.
    """

    def __init__(self, seconds: float, period: float) -> None:
        super().__init__()
        self.rows: list[dict[str, float]] = []
        self._seconds, self._period, self._rollouts, self._evaluating = seconds, period, 0, 0.0

    def _on_training_start(self) -> None:
        self._began, self._began_wall = time.process_time(), time.monotonic()

    def _spent(self) -> float:
        return time.process_time() - self._began - self._evaluating

    def _on_rollout_start(self) -> None:
        spent = self._spent()
        if self._rollouts and (self._rollouts % ROLLOUTS_PER_EVALUATION == 0 or spent > self._seconds):
            began = time.process_time()
            distance = final_distance_mm(self.model, self._period)
            self._evaluating += time.process_time() - began
            self.rows.append(
                {
                    "steps": self.num_timesteps,
                    "cpu_s": round(spent, 1),
                    "wall_s": round(time.monotonic() - self._began_wall, 1),
                    "median_mm": float(np.median(distance)),
                    "within_5mm": float(np.mean(distance <= 5.0)),
                    "within_1mm": float(np.mean(distance <= 1.0)),
                }
            )
            print(self.rows[-1], flush=True)
        self._rollouts += 1

    def _on_step(self) -> bool:
        return self._spent() <= self._seconds or self._rollouts <= 1


def train(
    seed: int, seconds: float, envs: int, environment: dict[str, Any], algorithm: dict[str, Any]
) -> Any:
    """Train with a seed for a processor time in s; return the learning curve."""
    curve = Curve(seconds, environment.get("period", EnvConfig.period))
    vec = HFrameVecEnv(envs, normalize=True, **environment)
    with single_threaded_torch():
        PPO("MultiInputPolicy", vec, seed=seed, device="cpu", **algorithm).learn(10**9, callback=curve)
    return curve.rows


def main() -> None:
    """Train with every seed and write the learning curves."""
    parser = command_line(__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--envs", type=int, default=ENVS)
    parser.add_argument("--reward")
    parser.add_argument("--period", type=float)
    parser.add_argument("--learning-rate", type=float)
    parser.add_argument("--gamma", type=float)
    parser.add_argument("--n-steps", type=int)
    arguments = parser.parse_args()
    given = {key: value for key, value in vars(arguments).items() if value is not None}
    algorithm = {key: given[key] for key in ("learning_rate", "gamma", "n_steps") if key in given}
    environment = {key: given[key] for key in ("reward", "period") if key in given}
    content: dict[str, Any] = {
        "bar_mm": BAR,
        "envs": arguments.envs,
        "algorithm": algorithm,
        **environment,
        "runs": [],
    }
    for seed in range(arguments.seeds):
        print(f"seed {seed}", flush=True)
        curve = train(seed, arguments.seconds, arguments.envs, environment, algorithm)
        content["runs"].append(
            {"seed": seed, "best_mm": min(row["median_mm"] for row in curve), "curve": curve}
        )
    settings = {**environment, **algorithm} | ({} if arguments.envs == ENVS else {"envs": arguments.envs})
    name = "_".join(["plain_ppo", *(f"{key}_{value}" for key, value in settings.items())])
    write_results(name, content, seed=EVALUATION_SEED)


if __name__ == "__main__":
    main()
