"""Good recordings, and functions that plant mistakes in them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from hframe_gym.arrays import Array
from hframe_gym.data_validation import Finding
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording

PHI1, PHI2, X, Y = range(4)  # columns of the outputs


def faults(findings: list[Finding]) -> list[str]:
    """Return the faults as lines."""
    return [str(finding) for finding in findings if finding.severity == "fault"]


def with_change(
    runs: list[Recording], change: Callable[[Array, Array], tuple[Array, Array]]
) -> list[Recording]:
    """Return the runs with inputs and outputs passed through a function."""
    parts = [change(run.inputs.copy(), run.outputs.copy()) for run in runs]
    return [dataclasses.replace(run, inputs=u, outputs=y) for run, (u, y) in zip(runs, parts, strict=True)]


def with_column(runs: list[Recording], column: int, change: Callable[[Array], Array]) -> list[Recording]:
    """Return the runs with one column of the outputs passed through a function."""

    def change_column(u: Array, y: Array) -> tuple[Array, Array]:
        y[:, column] = change(y[:, column])
        return u, y

    return with_change(runs, change_column)


def measure(machine: Machine, outputs: Array, seed: int = 0) -> Array:
    """Return ideal outputs (n, sensors) with the declared noise and resolution."""
    normal = np.random.default_rng(seed).standard_normal(outputs.shape)
    measured = outputs + normal * [s.noise for s in machine.sensors]
    for j, sensor in enumerate(machine.sensors):
        if sensor.resolution:
            measured[:, j] = np.rint(measured[:, j] / sensor.resolution) * sensor.resolution
    return measured
