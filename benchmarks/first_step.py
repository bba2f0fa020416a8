"""Processor time from `import` to the first step of an environment, with an empty and with a filled cache.

    python -m benchmarks.first_step [--repeats 3]

Each measurement is a new process. The empty cache is an empty folder for the machine code of this package and
of Numba. Processor time is that of the process, all threads included; other load on the machine makes it
longer.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile

from rich.console import Console
from rich.table import Table

from benchmarks.results_file import write_results
from tools.command_line import command_line

CASES = {
    "default": "{}",
    "sensors='rig'": "{'sensors': 'rig'}",
    "task='track'": "{'task': 'track'}",
    "randomize='default', normalize=True": "{'randomize': 'default', 'normalize': True}",
}
_SCRIPT = """
import time
import gymnasium as gym, hframe_gym
env = gym.make("HFrame-v0", **{arguments})
env.reset(seed=0)
env.step(env.action_space.sample())
print(time.process_time())
"""


def seconds(arguments: str, cache: str) -> float:
    """Return the processor time of a process that takes one step, s."""
    environment = os.environ | {"HFRAME_CACHE": cache, "NUMBA_CACHE_DIR": f"{cache}/numba"}
    command = [sys.executable, "-c", _SCRIPT.replace("{arguments}", arguments)]
    return float(subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout)


def main() -> None:
    """Measure, print and store the times."""
    parser = command_line(__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    table = Table("environment", "empty cache, s", "filled cache, s")
    results = {}
    for name, arguments in CASES.items():
        empty, filled = [], []
        for _ in range(repeats):
            with tempfile.TemporaryDirectory() as cache:
                empty.append(seconds(arguments, cache))
                filled.append(seconds(arguments, cache))
        results[name] = {"empty_s": statistics.median(empty), "filled_s": statistics.median(filled)}
        table.add_row(name, *(f"{value:.2f}" for value in results[name].values()))
    Console().print(table)
    write_results("first_step", {"cases": results}, seed=None)


if __name__ == "__main__":
    main()
