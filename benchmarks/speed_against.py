"""Is this checkout as fast as another one? Both are timed in turn, in one run.

    python -m benchmarks.speed_against PATH_OF_OTHER_CHECKOUT [--repeats 9] [--only MEASURE]

Each checkout runs in a separate process with the same interpreter. The processes take turns, so that other
load on the machine affects both equally. A ratio is this checkout's rate divided by the other's: the median
over the repetitions; the spread gives their extremes. Ratios are given in processor time (of all threads),
which other programs hardly affect, and in wall time. One round before the first is not counted, because it
compiles the kernels.

Measures:
    kernel: integrator steps per second of a batch of 4096 stages on all cores (`KernelBatch` of that
        checkout's benchmarks; needs the extra `bench`, because older checkouts import MuJoCo beside it).
    recording: simulations per second of one recording of 2 s at 1 kHz by `Machine.simulate`.
    vector: environment steps per second of 4096 environments by `gym.make_vec`, default randomization.
    rig: the same with the sensors and drives of the rig.
    small: the same of 32 environments, where the calls take most of the time.
    single: environment steps per second of one environment by `gym.make`, resets included.
    normalized: the same with `normalize=True`.
    track: the same of `HFrameTrack-v0`.

Nothing is written to benchmarks/results/, because a ratio belongs to two commits. The exit code is 1 if a
ratio in processor time is below --bar.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from tools.command_line import command_line

ROOT = Path(__file__).resolve().parents[1]
MEASURES = ("kernel", "recording", "vector", "rig", "small", "single", "normalized", "track")
BAR = 0.95

# Runs in each checkout. It uses only names that all checkouts have: those of the contract, and KernelBatch.
_WORKER = """
import json, sys, time
import numpy as np
import gymnasium as gym
import hframe_gym

SEED, COUNT = 3, 4096

def kernel():
    try:
        from benchmarks.kernel_batch import KernelBatch
    except ImportError:
        from benchmarks.throughput import KernelBatch
    batch = KernelBatch(hframe_gym.load_machine("hframe"), COUNT)
    def run():
        begin = time.perf_counter()
        return batch.rate(parallel=True, least=0.5) * (time.perf_counter() - begin)
    return timed(run)

def recording():
    machine = hframe_gym.load_machine("hframe")
    time_s = np.arange(2001) * 1e-3
    inputs = np.repeat(np.random.default_rng(SEED).uniform(-6.0, 6.0, (201, 2)), 10, axis=0)[:2001]
    def run():
        for _ in range(200):
            machine.simulate(time_s, inputs)
        return 200
    return timed(run)

def vector(count=COUNT, steps=150, **options):
    envs = gym.make_vec("HFrame-v0", num_envs=count, randomize="default", **options)
    envs.reset(seed=SEED)
    actions = np.random.default_rng(SEED).uniform(-1, 1, (steps, count, 2)).astype(np.float32)
    def run():
        for action in actions:
            envs.step(action)
        return steps * count
    return timed(run)

def single(name="HFrame-v0", **options):
    env = gym.make(name, **options)
    env.reset(seed=SEED)
    actions = np.random.default_rng(SEED).uniform(-1, 1, (3000, 2)).astype(np.float32)
    def run():
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return len(actions)
    return timed(run)

def timed(run):
    def rates():
        clocks = time.process_time, time.perf_counter
        begin = [clock() for clock in clocks]
        count = run()
        return [count / (clock() - start) for clock, start in zip(clocks, begin)]
    return rates

MAKE = {"kernel": kernel, "recording": recording, "vector": vector,
        "rig": lambda: vector(sensors="rig", drives="rig"), "small": lambda: vector(32, 3000),
        "single": single, "normalized": lambda: single(normalize=True),
        "track": lambda: single("HFrameTrack-v0")}
ready = {}
answers = sys.stdout
sys.stdout = sys.stderr
for line in sys.stdin:
    name = line.strip()
    try:
        if name not in ready:
            ready[name] = MAKE[name]()
        answer = {"rates": ready[name]()}
    except Exception as error:
        answer = {"error": f"{type(error).__name__}: {error}"}
    print(json.dumps(answer), file=answers, flush=True)
"""


class Checkout:
    """Process that times one checkout.

    Args:
        path: Root of the checkout.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._process = subprocess.Popen(
            [sys.executable, "-c", _WORKER],
            cwd=path,
            env=os.environ | {"PYTHONPATH": os.pathsep.join([str(path), os.environ.get("PYTHONPATH", "")])},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def rates(self, measure: str) -> tuple[float, float]:
        """Time a measure once.

        Args:
            measure: One of `MEASURES`.

        Returns:
            Rates per second of processor time and of wall time, 1/s.

        Raises:
            RuntimeError: If the checkout cannot run the measure.
        """
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.write(f"{measure}\n")
        self._process.stdin.flush()
        answer: dict[str, Any] = json.loads(
            self._process.stdout.readline() or '{"error": "the process ended"}'
        )
        if "error" in answer:
            raise RuntimeError(f"{self.path}: {answer['error']}")
        processor, wall = answer["rates"]
        return float(processor), float(wall)

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait()


def compare(this: Checkout, other: Checkout, measure: str, repeats: int) -> NDArray[np.float64]:
    """Time a measure in both checkouts, alternating.

    Args:
        this: Checkout in the ratio's numerator.
        other: Checkout in the ratio's denominator.
        measure: One of `MEASURES`.
        repeats: Number of pairs.

    Returns:
        Rates, 1/s, shape (repeats, 2, 2): pair; this and other checkout; processor and wall time.
    """
    this.rates(measure)
    other.rates(measure)
    pairs = []
    for i in range(repeats):
        # The order alternates as well, so that a drift of the machine's speed cancels.
        order = (this, other) if i % 2 == 0 else (other, this)
        rates = {checkout: checkout.rates(measure) for checkout in order}
        pairs.append((rates[this], rates[other]))
    return np.array(pairs)


def main() -> None:
    """Compare the checkouts and print the ratios."""
    parser = command_line(__doc__)
    parser.add_argument(
        "other", type=Path, help="root of the other checkout, for example of `git worktree add`"
    )
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--only", choices=MEASURES, action="append", default=[], help="measure only this")
    parser.add_argument("--bar", type=float, default=BAR, help=f"smallest acceptable ratio (default {BAR:g})")
    arguments = parser.parse_args()
    this, other = Checkout(ROOT), Checkout(arguments.other.resolve())
    console = Console(width=110)
    table = Table("measure", "this, 1/s", "other, 1/s", "ratio, processor time", "ratio, wall time")
    failed = False
    for measure in arguments.only or MEASURES:
        try:
            rates = compare(this, other, measure, arguments.repeats)
        except RuntimeError as error:
            table.add_row(measure, "", "", "skipped", str(error).splitlines()[0])
            continue
        ratios = rates[:, 0] / rates[:, 1]  # (repeats, clocks)
        failed |= bool(np.median(ratios[:, 0]) < arguments.bar)
        cells = [f"{value:.4g}" for value in np.median(rates[:, :, 1], axis=0)]
        cells += [f"{np.median(r):.3f} ({r.min():.3f} to {r.max():.3f})" for r in ratios.T]
        table.add_row(measure, *cells)
        console.print(f"{measure}: {cells[2]}", highlight=False)
    this.close()
    other.close()
    console.print(table)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
