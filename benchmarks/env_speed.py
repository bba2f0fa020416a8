"""How fast is the environment? Steps against EnvPool's and Gymnasium's Pendulum-v1, bare kernel, resets.

    python -m benchmarks.env_speed

All compared programs run in this process, in turn, with random actions that are drawn before the clock
starts. A ratio is the median over the repetitions; the spread gives their extremes. The kernel's fraction of
a step is given in processor time, which other programs do not affect, and in wall time. Seed and versions are
in results/env_speed.json.
"""

from __future__ import annotations

import gc
import time
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table

import hframe_gym  # noqa: F401  registers the environment
from benchmarks.kernel_batch import interleaved
from benchmarks.results_file import write_results
from hframe_gym.dynamics import LANES, in_parallel, kernel_for
from hframe_gym.dynamics.simulation import threads
from hframe_gym.envs import HFrameVectorEnv

# STEPS is one episode, so every run contains a reset of each environment.
SEED, ENVS, STEPS, REPEATS = 3, 4096, 150, 7
OPTIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "integration step 0.25 ms": {"longest_step": 0.25e-3},
    "wide randomization": {"randomize": "wide"},
    "sensors and drives of the rig": {"sensors": "rig", "drives": "rig"},
    "task track": {"task": "track"},
    "normalized, reward progress": {"normalize": True},
}


def seconds(run: Callable[[], object]) -> float:
    """Return the wall time of a call, s, after a garbage collection."""
    gc.collect()
    begin = time.perf_counter()
    run()
    return time.perf_counter() - begin


class Vector:
    """Vector environment under random actions.

    Args:
        count: Number of environments.
        **options: Options of the environment.
    """

    def __init__(self, count: int, **options: Any) -> None:
        self.envs = HFrameVectorEnv(count, **{"randomize": "default", **options})
        self.envs.reset(seed=SEED)
        self.actions = np.random.default_rng(SEED).uniform(-1, 1, (STEPS, count, 2)).astype(np.float32)
        # Start in the middle of an episode, where the stages are spread as they are on average.
        for action in self.actions[: STEPS // 2]:
            self.envs.step(action)

    def rate(self) -> float:
        """Return the environment steps per second."""

        def run() -> None:
            for action in self.actions:
                self.envs.step(action)

        return len(self.actions) * self.envs.num_envs / seconds(run)

    def beside_kernel(self) -> dict[str, tuple[float, float]]:
        """Measure an episode's steps, and the bare kernel on the same states and voltages, step by step.

        The bare kernel is that of the machine without end stops, with one call of `advance_blocks` per
        thread.

        Returns:
            Seconds of the steps and of the kernel, by clock: "processor" (time of all threads) and "wall".
        """
        simulator = self.envs.batch.simulator
        kernel = kernel_for(simulator.machine)
        parameters = np.empty((simulator.blocks, len(kernel.layout.parameters), LANES))
        derived = np.empty((simulator.blocks, len(kernel.layout.derived), LANES))
        arguments = parameters, derived, simulator.actuators.inputs, simulator.h, simulator.steps
        clocks = {"processor": time.process_time, "wall": time.perf_counter}
        spent = dict.fromkeys(clocks, np.zeros(2))
        for action in self.actions:
            state = simulator.state.copy()
            began = {name: clock() for name, clock in clocks.items()}
            self.envs.step(action)
            between = {name: clock() for name, clock in clocks.items()}
            parameters[:] = simulator.parameters[:, : parameters.shape[1]]
            kernel.prepare_blocks(parameters, simulator.h, 0, simulator.blocks, derived)

            def advance(first: int, last: int, state: Any = state) -> None:
                kernel.advance_blocks(state, *arguments, first, last)

            again = {name: clock() for name, clock in clocks.items()}
            in_parallel(advance, simulator.blocks)
            for name, clock in clocks.items():
                spent[name] = spent[name] + (between[name] - began[name], clock() - again[name])
        return {name: (float(step), float(kernel)) for name, (step, kernel) in spent.items()}

    def kernel_fraction(self, repeats: int) -> dict[str, Any]:
        """Return the fraction of a step that the bare kernel takes, by clock: median and extremes."""
        self.beside_kernel()
        runs = [self.beside_kernel() for _ in range(repeats)]
        fractions = {name: [run[name][1] / run[name][0] for run in runs] for name in ("processor", "wall")}
        return {
            name: {"share": float(np.median(each)), "spread": [min(each), max(each)]}
            for name, each in fractions.items()
        }


def envpool_rate() -> Callable[[], float]:
    """Return a function that measures EnvPool's Pendulum-v1, as many environments and threads, steps/s."""
    import envpool

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pool = envpool.make(
            "Pendulum-v1", env_type="gymnasium", num_envs=ENVS, num_threads=threads(), seed=SEED
        )
    actions = np.random.default_rng(SEED).uniform(-2, 2, (STEPS, ENVS, 1)).astype(np.float32)
    pool.reset()

    def rate() -> float:
        def run() -> None:
            for action in actions:
                pool.step(action)

        return STEPS * ENVS / seconds(run)

    return rate


def single_rate(name: str, size: int, steps: int = 3000) -> Callable[[], float]:
    """Return a function that measures one environment of `gym.make`, steps per second, resets included.

    Args:
        name: Id of the environment.
        size: Number of its actions.
        steps: Number of steps per measurement.

    Returns:
        Function that measures the rate, 1/s.
    """
    env = gym.make(name)
    env.reset(seed=SEED)
    limit = float(env.action_space.high[0])  # type: ignore[attr-defined]
    actions = np.random.default_rng(SEED).uniform(-limit, limit, (steps, size)).astype(np.float32)

    def rate() -> float:
        def run() -> None:
            for action in actions:
                _, _, terminated, truncated, _ = env.step(action)
                if terminated or truncated:
                    env.reset()

        return steps / seconds(run)

    return rate


def resets(count: int) -> dict[str, float]:
    """Measure resets among `count` environments, us: one; one with all observations; all, each."""
    envs = HFrameVectorEnv(count, randomize="default", autoreset_mode="Disabled")
    envs.reset(seed=SEED)
    one = np.array([count // 2])
    mask = np.zeros(count, np.bool_)
    mask[one] = True

    def median(run: Callable[[], object], repeats: int) -> float:
        run()
        return float(np.median([seconds(run) for _ in range(repeats)])) * 1e6

    return {
        "one_us": median(lambda: envs.batch.reset(one), 101),
        "one_through_reset_us": median(lambda: envs.reset(options={"reset_mask": mask}), 101),
        "all_us_per_environment": median(lambda: envs.batch.reset(np.arange(count)), 7) / count,
    }


def frames() -> float:
    """Return the pictures per second in mode rgb_array, including the step between two pictures."""
    env = gym.make("HFrame-v0", render_mode="rgb_array")
    env.reset(seed=SEED)
    env.render()

    def one() -> None:
        env.step(np.ones(2, np.float32))
        env.render()

    return 1.0 / float(np.median([seconds(one) for _ in range(100)]))


def main() -> None:
    """Run all measurements and write the results."""
    console = Console(width=130)
    content: dict[str, Any] = {"environments": ENVS, "threads": threads()}

    def show(title: str, ratio: Any, ours: str, theirs: str) -> dict[str, Any]:
        r = ratio.report()
        low, high = r["spread"]
        table.add_row(
            title,
            f"{ours} {r['ours_steps_per_s']:.3g}",
            f"{theirs} {r['theirs_steps_per_s']:.3g}",
            f"{r['ratio']:.3g}",
            f"{low:.3g} - {high:.3g}",
        )
        return r

    table = Table(
        title=f"Environment steps per second, medians of {REPEATS} alternating runs, {threads()} threads"
    )
    for column in ("what", "ours", "theirs", "ratio", "spread"):
        table.add_column(column)
    pool = envpool_rate()
    for name, options in OPTIONS.items():
        vector = Vector(ENVS, **options)
        repeats = REPEATS if name == "default" else 3
        content[f"over EnvPool's Pendulum: {name}"] = show(
            f"{ENVS} environments, {name}",
            interleaved(vector.rate, pool, repeats),
            "HFrame",
            "EnvPool Pendulum",
        )
        fractions = content[f"share of the bare kernel: {name}"] = vector.kernel_fraction(repeats)
        for clock, fraction in fractions.items():
            low, high = fraction["spread"]
            title = f"  of which the bare kernel, {clock} time"
            table.add_row(title, "", "", f"{fraction['share']:.3g}", f"{low:.3g} - {high:.3g}")
    content["single over gymnasium's Pendulum"] = show(
        "one environment, gym.make",
        interleaved(single_rate("HFrame-v0", 2), single_rate("Pendulum-v1", 1), REPEATS),
        "HFrame",
        "gymnasium Pendulum",
    )
    console.print(table)
    table = Table(title="Microseconds per reset, default randomization")
    for column in ("environments", "one of them", "one, with the observation of all", "all, per environment"):
        table.add_column(column, justify="right")
    for count in (64, 1024, 4096, 16384):
        row = content[f"reset among {count}"] = resets(count)
        table.add_row(str(count), *(f"{value:.3g}" for value in row.values()))
    console.print(table)
    content["pictures_per_s"] = frames()
    console.print(f"{content['pictures_per_s']:.0f} pictures per second (required 60)")
    write_results("env_speed", content, seed=SEED)


if __name__ == "__main__":
    main()
