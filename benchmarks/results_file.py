"""Write the results of a benchmark to benchmarks/results/NAME.json, with processor, versions and seed."""

from __future__ import annotations

import json
import os
import platform
from pathlib import Path
from typing import Any

from hframe_gym.dynamics.simulation import threads
from hframe_gym.evaluation import result_versions
from hframe_gym.files import write_text
from tools.repository import RESULTS, ROOT

# Beside those on which all results depend.
_FURTHER_PACKAGES = ("gymnasium", "mujoco", "envpool", "casadi")


def data_root() -> Path:
    """Return the folder of recordings that are not shipped: $HFRAME_DATA, else ../shared/data."""
    return Path(os.environ.get("HFRAME_DATA") or ROOT.parent / "shared" / "data")


def surroundings() -> dict[str, Any]:
    """Return the processor, the number of cores and the versions on which results depend."""
    machine = {"processor": platform.machine(), "cores": threads()}
    versions = result_versions(_FURTHER_PACKAGES)
    return {"python": versions.pop("python"), "versions": versions, "machine": machine}


def save_figure(figure: Any, path: Path) -> None:
    """Save a matplotlib figure without a version stamp, so that equal figures give equal files; close it."""
    import matplotlib.pyplot as plt

    figure.savefig(path, dpi=150, metadata={"Software": None})
    plt.close(figure)


def write_results(name: str, content: dict[str, Any], *, seed: int | None) -> Path:
    """Write the results of a benchmark, completely or not at all, and return the path of the file.

    Args:
        name: Name of the file without its ending.
        content: Results as plain data.
        seed: Seed of the benchmark; None if each result has its individual one.
    """
    path = RESULTS / f"{name}.json"
    write_text(path, json.dumps({"seed": seed, **surroundings(), **content}, indent=1) + "\n")
    return path
