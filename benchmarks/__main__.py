"""Every benchmark, one after the other, and the tables made from them:  python -m benchmarks"""

from __future__ import annotations

import subprocess
import sys

ALL = (
    ("benchmarks.paper",),
    ("benchmarks.accuracy",),
    ("benchmarks.throughput",),
    ("benchmarks.env_speed",),
    ("benchmarks.env_bits",),
    ("benchmarks.env_soak",),
    ("benchmarks.identification", "examples", "all"),
    ("benchmarks.real_machines", "all"),
    ("benchmarks.controllers",),
    ("benchmarks.bound",),
    ("benchmarks.her",),
    ("benchmarks.agents", "score"),
    ("benchmarks.closed_loop",),
    ("tools.tables",),
)

if __name__ == "__main__":
    for command in ALL:
        print(f"\n== {' '.join(command)}", flush=True)
        subprocess.run([sys.executable, "-m", *command], check=True)
