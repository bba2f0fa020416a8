"""Write the results of a benchmark to benchmarks/results/NAME.json, with processor, versions and seed."""

from __future__ import annotations

import json
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

from hframe_gym.atomic_files import write_text
from hframe_gym.dynamics.simulation import threads

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
FIGURES = ROOT / "docs" / "figures"
_PACKAGES = ("numpy", "numba", "scipy", "gymnasium", "mujoco", "envpool", "stable-baselines3", "torch", "casadi")


def surroundings() -> dict[str, Any]:
    """Return the processor, the number of cores and the versions on which results depend."""
    versions = {}
    for package in _PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    machine = {"processor": platform.machine(), "cores": threads()}
    return {"python": platform.python_version(), "versions": versions, "machine": machine}


def write_results(name: str, content: dict[str, Any], *, seed: int | None) -> Path:
    """Write the results of a benchmark, completely or not at all.

    Args:
        name: Name of the file without its ending.
        content: Results as plain data.
        seed: Seed of the benchmark; None if each result has its individual one.

    Returns:
        Path of the file.
    """
    path = RESULTS / f"{name}.json"
    write_text(path, json.dumps({"seed": seed, **surroundings(), **content}, indent=1) + "\n")
    return path
