"""Where a benchmark leaves its numbers: benchmarks/results/NAME.json, with the machine, the versions and the seed."""

from __future__ import annotations

import json
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

from hframe_gym.atomic_files import write_text
from hframe_gym.dynamics.simulation import threads

RESULTS = Path(__file__).parent / "results"
_PACKAGES = ("numpy", "numba", "scipy", "gymnasium", "mujoco", "envpool", "stable-baselines3", "torch", "casadi")


def surroundings() -> dict[str, Any]:
    """Processor, cores and versions that a number depends on."""
    versions = {}
    for package in _PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    machine = {"processor": platform.machine(), "cores": threads()}
    return {"python": platform.python_version(), "versions": versions, "machine": machine}


def write_results(name: str, content: dict[str, Any], *, seed: int | None) -> Path:
    """Write a benchmark's numbers, whole."""
    path = RESULTS / f"{name}.json"
    write_text(path, json.dumps({"seed": seed, **surroundings(), **content}, indent=1) + "\n")
    return path
