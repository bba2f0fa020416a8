"""Does a seed give the same bits in every process, with every thread count and through every interface?

    python -m benchmarks.env_bits [--steps 10000]

Compared: the single environment, the native vector environment, the adapter for stable-baselines3, and new
processes with 1, 2 and 3 threads. Each is summarized by one digest per environment: SHA-256 over all
observations (before and after resets), rewards, sampled parameters, terminations and truncations (a
truncation in the step of a termination does not count). The exit code is 1 if any digest differs.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.results_file import write_results
from hframe_gym.envs import HFrameEnv, HFrameVectorEnv
from tools.command_line import command_line

SEED, LIMIT = 11, 150
COMPARED = 3  # environments that have a digest
COUNT = 520  # environments of a vector: enough for several threads
OPTIONS: dict[str, dict[str, Any]] = {
    "state, ideal": {"randomize": "wide"},
    "rig": {
        "randomize": "default",
        "sensors": "rig",
        "drives": "rig",
        "privileged": True,
        "ends": "terminate",
    },
    "track, 20th order": {"randomize": "default", "task": "track", "machine": "hframe-order20"},
}


def actions(steps: int) -> Iterator[NDArray[np.float32]]:
    """Yield random actions (COUNT, 2), each held for five steps so that the stages move far."""
    rng = np.random.default_rng(SEED)
    for step in range(steps):
        if step % 5 == 0:
            held = rng.uniform(-1.1, 1.1, (COUNT, 2)).astype(np.float32)
        yield held


class Digest:
    """Digest of one environment's history."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def add(self, observation: Mapping[str, NDArray[Any]], *values: float) -> None:
        """Add an observation and numbers."""
        for key in sorted(observation):
            self._hash.update(np.ascontiguousarray(observation[key]).tobytes())
        self._hash.update(np.array(values, np.float64).tobytes())

    def add_parameters(self, parameters: Mapping[str, float]) -> None:
        """Add sampled parameters, in alphabetical order."""
        self.add({}, *(parameters[name] for name in sorted(parameters)))

    def __str__(self) -> str:
        return self._hash.hexdigest()[:16]


def single(steps: int, options: dict[str, Any]) -> list[str]:
    """Run each environment by itself and return the digests."""
    digests = []
    for b in range(COMPARED):
        digest, env, elapsed = Digest(), HFrameEnv(**options), 0
        observation, info = env.reset(seed=SEED + b)
        digest.add(observation)
        digest.add_parameters(info.get("parameters", {}))
        for action in actions(steps):
            observation, reward, terminated, _, _ = env.step(action[b])
            elapsed += 1
            digest.add(observation, reward, terminated, elapsed == LIMIT and not terminated)
            if terminated or elapsed == LIMIT:
                observation, info = env.reset()
                elapsed = 0
                digest.add(observation)
                digest.add_parameters(info.get("parameters", {}))
        digests.append(str(digest))
    return digests


def vector(steps: int, options: dict[str, Any]) -> list[str]:
    """Run the native vector environment with resets in the step of an end, and return the digests."""
    envs = HFrameVectorEnv(COUNT, max_episode_steps=LIMIT, autoreset_mode="SameStep", **options)
    digests = [Digest() for _ in range(COMPARED)]

    def add_start(b: int, observation: Any, info: Any) -> None:
        digests[b].add({key: value[b] for key, value in observation.items()})
        sampled = info.get("parameters", {})
        digests[b].add_parameters(
            {name: column[b] for name, column in sampled.items() if not name.startswith("_")}
        )

    observation, info = envs.reset(seed=SEED)
    for b in range(COMPARED):
        add_start(b, observation, info)
    for action in actions(steps):
        observation, reward, terminated, truncated, info = envs.step(action)
        for b, digest in enumerate(digests):
            over = terminated[b] or truncated[b]
            final = info["final_obs"][b] if over else {key: value[b] for key, value in observation.items()}
            digest.add(final, reward[b], terminated[b], truncated[b] and not terminated[b])
            if over:
                add_start(b, observation, info)
    return [str(digest) for digest in digests]


def stable_baselines3(steps: int, options: dict[str, Any]) -> list[str]:
    """Run the adapter for stable-baselines3 and return the digests."""
    from hframe_gym.envs.sb3_vec_env import HFrameVecEnv

    envs = HFrameVecEnv(COUNT, max_episode_steps=LIMIT, **options)
    digests = [Digest() for _ in range(COMPARED)]

    def add_start(b: int, observation: Any) -> None:
        digests[b].add({key: value[b] for key, value in observation.items()})
        digests[b].add_parameters(envs.reset_infos[b].get("parameters", {}))

    envs.seed(SEED)
    observation = envs.reset()
    for b in range(COMPARED):
        add_start(b, observation)
    for action in actions(steps):
        observation, reward, done, infos = envs.step(action)
        for b, digest in enumerate(digests):
            final = infos[b].get(
                "terminal_observation", {key: value[b] for key, value in observation.items()}
            )
            truncated = bool(infos[b].get("TimeLimit.truncated", False))
            digest.add(final, reward[b], bool(done[b]) and not truncated, truncated)
            if done[b]:
                add_start(b, observation)
    return [str(digest) for digest in digests]


WAYS: dict[str, Callable[[int, dict[str, Any]], list[str]]] = {
    "single": single,
    "vector": vector,
    "stable-baselines3": stable_baselines3,
}


def in_new_process(name: str, steps: int, threads: int) -> list[str]:
    """Return the digests of the vector environment in a new process with a number of threads."""
    command = [sys.executable, "-m", "benchmarks.env_bits", "--steps", str(steps), "--digest", name]
    process = subprocess.run(
        command,
        cwd=Path(__file__).parents[1],
        env=os.environ | {"HFRAME_THREADS": str(threads)},
        capture_output=True,
        text=True,
        check=True,
    )
    digests: list[str] = json.loads(process.stdout)
    return digests


def compare(name: str, steps: int) -> dict[str, list[str]]:
    """Return the digests of every way to run the environment, for the options of a name."""
    options = OPTIONS[name]
    digests = {f"{way}": run(steps, options) for way, run in WAYS.items()}
    digests["vector again"] = vector(steps, options)
    for threads in (1, 2, 3):
        digests[f"new process, {threads} threads"] = in_new_process(name, steps, threads)
    return digests


def main() -> None:
    """Compare the digests, print them and write the results."""
    parser = command_line(__doc__)
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--digest", choices=OPTIONS, help="print the vector environment's digests only")
    arguments = parser.parse_args()
    if arguments.digest:
        print(json.dumps(vector(arguments.steps, OPTIONS[arguments.digest])))
        return
    console = Console(width=120)
    content: dict[str, Any] = {"steps": arguments.steps, "environments_compared": COMPARED}
    for name in OPTIONS:
        digests = compare(name, arguments.steps)
        content[name] = {"equal": len({tuple(d) for d in digests.values()}) == 1, "digests": digests}
        table = Table(
            title=f"{name}: {'same bits everywhere' if content[name]['equal'] else 'DIFFERENT BITS'}"
        )
        table.add_column("way")
        for b in range(COMPARED):
            table.add_column(f"environment {b}")
        for way, by_environment in digests.items():
            table.add_row(way, *by_environment)
        console.print(table)
    write_results("env_bits", content, seed=SEED)
    if not all(content[name]["equal"] for name in OPTIONS):
        sys.exit(1)


if __name__ == "__main__":
    main()
