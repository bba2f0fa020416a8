"""How much faster are two workers of Ray than a plain run, and what does a task cost?

    nice -n -10 python -m benchmarks.ray_scaling [--repeats 3]      # needs the extra `ray`

Two kinds of tasks: training (PPO on reach, several seeds) and identification (the example rigs). The plain
run does the tasks one after the other in one process, with as many threads as there are cores, as
`hframe train` and `hframe identify` do. It takes turns with two workers of Ray, so that other load affects
both; a ratio is the plain run's time divided by Ray's. Ray's workers are running and have imported the
package; how long that takes is a figure of its own. Every result is compared with that of the plain run, bit
for bit.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.results_file import write_results
from hframe_gym.agents import train
from hframe_gym.identification import identify
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.parallel import LOCAL_RAY, map_tasks
from hframe_gym.recordings import load_recordings
from tools.command_line import command_line
from tools.posix import peak_megabytes, require_posix
from tools.repository import ROOT

WORKERS = 2
STEPS = 60_000  # of a training
SEEDS = (0, 1, 2, 3)
RIGS = ("rig_a", "rig_b", "rig_a", "rig_b")


class Done(NamedTuple):
    """Result of a task.

    Attributes:
        digest: Hash of the result, without times.
        cpu_s: Processor time, s.
        memory_MB: Largest memory of the process so far, MB.
    """

    digest: str
    cpu_s: float
    memory_MB: float


def measured(run: Callable[[], bytes]) -> Done:
    """Run a task and measure it."""
    begin = time.process_time()
    digest = hashlib.sha256(run()).hexdigest()
    return Done(digest, time.process_time() - begin, peak_megabytes())


def train_seed(seed: int, steps: int = STEPS) -> Done:
    """Train an agent and measure it."""

    def run() -> bytes:
        with tempfile.TemporaryDirectory() as folder:
            card = train("ppo", steps=steps, seed=seed, out=folder, log=lambda line: None)
            rows = [{k: v for k, v in row.items() if k not in ("seconds", "cpu_s")} for row in card["curve"]]
            return (Path(folder) / "policy.safetensors").read_bytes() + json.dumps(rows).encode()

    return measured(run)


def identify_rig(name: str) -> Done:
    """Identify an example rig and measure it."""

    def run() -> bytes:
        machine = BUILTIN_MACHINES["hframe"]()
        result = identify(load_recordings(ROOT / "examples" / name, machine), machine, budget=math.inf)
        return json.dumps({k: v for k, v in result.as_json().items() if k != "seconds"}).encode()

    return measured(run)


def timed(function: Callable[[Any], Done], items: Sequence[Any], ray: str | None) -> tuple[float, list[Done]]:
    """Return the wall time of all tasks, s, and their results."""
    begin = time.perf_counter()
    results = list(map_tasks(function, items, ray=ray))
    return time.perf_counter() - begin, results


def compare(function: Callable[[Any], Done], items: Sequence[Any], repeats: int) -> dict[str, Any]:
    """Time the plain run and Ray in turn."""
    plain, with_ray, equal = [], [], 0
    tasks: list[Done] = []
    for repeat in range(repeats):
        order = (None, LOCAL_RAY) if repeat % 2 == 0 else (LOCAL_RAY, None)
        runs = {ray: timed(function, items, ray) for ray in order}
        plain.append(runs[None][0])
        with_ray.append(runs[LOCAL_RAY][0])
        tasks += runs[LOCAL_RAY][1]
        equal += sum(a.digest == b.digest for a, b in zip(runs[None][1], runs[LOCAL_RAY][1], strict=True))
        print(
            f"  plain {plain[-1]:.1f} s, Ray {with_ray[-1]:.1f} s: {plain[-1] / with_ray[-1]:.2f}", flush=True
        )
    ratios = [p / r for p, r in zip(plain, with_ray, strict=True)]
    return {
        "tasks": len(items),
        "repeats": repeats,
        "plain_s": plain,
        "ray_s": with_ray,
        "ratio": statistics.median(ratios),
        "spread": [min(ratios), max(ratios)],
        "compared": repeats * len(items),
        "equal": equal,
        "cpu_s_per_task": statistics.median(task.cpu_s for task in tasks),
        "worker_memory_MB": max(task.memory_MB for task in tasks),
    }


def main() -> None:
    """Measure both kinds of tasks and write the results."""
    require_posix("benchmarks.ray_scaling")
    parser = command_line(__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    os.environ["RAY_worker_niceness"] = "0"  # noqa: SIM112 - the priority of the plain run; Ray's default is a low one
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    import ray

    begin = time.perf_counter()
    ray.init(address="local", num_cpus=WORKERS, include_dashboard=False, logging_level="ERROR")
    timed(warm_up, range(WORKERS), LOCAL_RAY)
    start = time.perf_counter() - begin
    warm_up(0)
    content: dict[str, Any] = {
        "workers": WORKERS,
        "steps": STEPS,
        "start_s": start,
        "load": os.getloadavg()[0],
    }
    for name, function, items in (("training", train_seed, SEEDS), ("identification", identify_rig, RIGS)):
        print(name, flush=True)
        content[name] = compare(function, items, repeats)
    training = content["training"]
    training["steps_per_s_per_core"] = STEPS / training["cpu_s_per_task"]
    write_results("ray_scaling", content, seed=SEEDS[0])


def warm_up(_: int) -> Done:
    """Import and compile what the tasks need."""
    train_seed(0, steps=1)
    return identify_rig("rig_b")


if __name__ == "__main__":
    main()
