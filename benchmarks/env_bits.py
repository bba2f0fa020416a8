"""Whether one seed gives the same bits everywhere: processes, thread counts, single, vector and stable-baselines3.

    python -m benchmarks.env_bits [--steps 10000]

Each way of running the environment is told by a digest for each of its first environments: SHA-256 over all
observations, those before and after a reset, rewards, drawn parameters, and ends (a cut in the step of an end is none).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.results_file import write_results
from hframe_gym.envs import HFrameEnv, HFrameVectorEnv

SEED, LIMIT = 11, 150
COMPARED = 3  # environments that have a digest
COUNT = 520  # environments of a vector: just enough for several threads
OPTIONS: dict[str, dict[str, Any]] = {
    "state, ideal": {"randomize": "wide"},
    "rig": {"randomize": "default", "sensors": "rig", "drives": "rig", "privileged": True, "ends": "terminate"},
    "track, 20th order": {"randomize": "default", "task": "track", "machine": "hframe-order20"},
}


def actions(steps: int) -> Iterator[NDArray[np.float32]]:
    """Random actions (COUNT, 2), held for five steps, so that stages get somewhere."""
    rng = np.random.default_rng(SEED)
    for step in range(steps):
        if step % 5 == 0:
            held = rng.uniform(-1.1, 1.1, (COUNT, 2)).astype(np.float32)
        yield held


class Digest:
    """The digest of one environment's history."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def add(self, observation: Mapping[str, NDArray[Any]], *numbers: float) -> None:
        for key in sorted(observation):
            self._hash.update(np.ascontiguousarray(observation[key]).tobytes())
        self._hash.update(np.array(numbers, np.float64).tobytes())

    def drawn(self, parameters: Mapping[str, float]) -> None:
        self.add({}, *(parameters[name] for name in sorted(parameters)))

    def __str__(self) -> str:
        return self._hash.hexdigest()[:16]


def single(steps: int, options: dict[str, Any]) -> list[str]:
    """Each environment by itself."""
    digests = []
    for b in range(COMPARED):
        digest, env, elapsed = Digest(), HFrameEnv(**options), 0
        observation, info = env.reset(seed=SEED + b)
        digest.add(observation)
        digest.drawn(info.get("parameters", {}))
        for action in actions(steps):
            observation, reward, terminated, _, _ = env.step(action[b])
            elapsed += 1
            digest.add(observation, reward, terminated, elapsed == LIMIT and not terminated)
            if terminated or elapsed == LIMIT:
                observation, info = env.reset()
                elapsed = 0
                digest.add(observation)
                digest.drawn(info.get("parameters", {}))
        digests.append(str(digest))
    return digests


def vector(steps: int, options: dict[str, Any]) -> list[str]:
    """The native vector environment, ends and resets in the same step."""
    envs = HFrameVectorEnv(COUNT, max_episode_steps=LIMIT, autoreset_mode="SameStep", **options)
    digests = [Digest() for _ in range(COMPARED)]

    def begun(b: int, observation: Any, info: Any) -> None:
        digests[b].add({key: value[b] for key, value in observation.items()})
        drawn = info.get("parameters", {})
        digests[b].drawn({name: column[b] for name, column in drawn.items() if not name.startswith("_")})

    observation, info = envs.reset(seed=SEED)
    for b in range(COMPARED):
        begun(b, observation, info)
    for action in actions(steps):
        observation, reward, terminated, truncated, info = envs.step(action)
        for b, digest in enumerate(digests):
            over = terminated[b] or truncated[b]
            seen = info["final_obs"][b] if over else {key: value[b] for key, value in observation.items()}
            digest.add(seen, reward[b], terminated[b], truncated[b] and not terminated[b])
            if over:
                begun(b, observation, info)
    return [str(digest) for digest in digests]


def stable_baselines3(steps: int, options: dict[str, Any]) -> list[str]:
    """The adapter for stable-baselines3."""
    from hframe_gym.envs.sb3_vec_env import HFrameVecEnv

    envs = HFrameVecEnv(COUNT, max_episode_steps=LIMIT, **options)
    digests = [Digest() for _ in range(COMPARED)]

    def begun(b: int, observation: Any) -> None:
        digests[b].add({key: value[b] for key, value in observation.items()})
        digests[b].drawn(envs.reset_infos[b].get("parameters", {}))

    envs.seed(SEED)
    observation = envs.reset()
    for b in range(COMPARED):
        begun(b, observation)
    for action in actions(steps):
        observation, reward, done, infos = envs.step(action)
        for b, digest in enumerate(digests):
            seen = infos[b].get("terminal_observation", {key: value[b] for key, value in observation.items()})
            cut = bool(infos[b].get("TimeLimit.truncated", False))
            digest.add(seen, reward[b], bool(done[b]) and not cut, cut)
            if done[b]:
                begun(b, observation)
    return [str(digest) for digest in digests]


WAYS: dict[str, Callable[[int, dict[str, Any]], list[str]]] = {
    "single": single,
    "vector": vector,
    "stable-baselines3": stable_baselines3,
}


def elsewhere(name: str, steps: int, threads: int) -> list[str]:
    """The vector environment in a new process with a number of threads."""
    command = [sys.executable, "-m", "benchmarks.env_bits", "--steps", str(steps), "--digest", name]
    answer = subprocess.run(
        command, env=os.environ | {"HFRAME_THREADS": str(threads)}, capture_output=True, text=True, check=True
    )
    found: list[str] = json.loads(answer.stdout)
    return found


def compare(name: str, steps: int) -> dict[str, list[str]]:
    """Digests of every way to run the environment with the options of that name."""
    options = OPTIONS[name]
    digests = {f"{way}": run(steps, options) for way, run in WAYS.items()}
    digests["vector again"] = vector(steps, options)
    for threads in (1, 2, 3):
        digests[f"new process, {threads} threads"] = elsewhere(name, steps, threads)
    return digests


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
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
        table = Table(title=f"{name}: {'the same bits everywhere' if content[name]['equal'] else 'DIFFERENT BITS'}")
        table.add_column("way")
        for b in range(COMPARED):
            table.add_column(f"environment {b}")
        for way, found in digests.items():
            table.add_row(way, *found)
        console.print(table)
    write_results("env_bits", content, seed=SEED)
    if not all(content[name]["equal"] for name in OPTIONS):
        sys.exit(1)


if __name__ == "__main__":
    main()
