"""Counters that begin anew with each run are named where nothing else measures the position."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.data_validation.origins import check_origins
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Sensor
from hframe_gym.recordings import Recording

TIME = np.arange(100) * 1e-3


def axis(*kinds: str) -> Machine:
    sensors = [Sensor(f"x{i}_m", {"x": 1.0}, kind=kind) for i, kind in enumerate(kinds)]
    return BUILTIN_MACHINES["axis"]().replace(sensors=tuple(sensors))


def runs(starts: list[float], ends: list[float], machine: Machine) -> list[Recording]:
    """Return runs that move evenly from a start to an end, m."""
    columns = [np.linspace(a, b, len(TIME)) for a, b in zip(starts, ends, strict=True)]
    return [
        Recording(f"run_{i}", TIME, np.zeros((len(TIME), 1)), np.column_stack([c] * len(machine.sensors)))
        for i, c in enumerate(columns)
    ]


def test_a_counter_that_was_reset_is_noted_with_the_run_that_ends_farthest() -> None:
    machine = axis("encoder")
    (note,) = check_origins(runs([0.0] * 4, [0.0, 0.02, -0.05, 0.0], machine), machine)
    assert (note.severity, note.channel) == ("note", "x0_m")
    assert "although run_2 ends at 0.05 m" in note.message


@pytest.mark.parametrize(
    ("kinds", "starts", "ends"),
    [
        (["encoder"], [0.0, 0.02, -0.05, 0.0], [0.02, -0.05, 0.0, 0.1]),  # it went on counting
        (["encoder"], [0.0] * 4, [1e-4, 0.0, 0.0, 1e-4]),  # nothing tells a return from a reset
        (["encoder", "laser"], [0.0] * 4, [0.0, 0.02, -0.05, 0.0]),  # the laser has the position
        (["laser"], [0.0] * 4, [0.0, 0.02, -0.05, 0.0]),
        (["encoder"], [0.0] * 2, [0.02, -0.05]),
    ],
)
def test_other_starts_are_not_noted(kinds: list[str], starts: list[float], ends: list[float]) -> None:
    machine = axis(*kinds)
    if max(abs(e) for e in ends) < 1e-3:  # the runs travel and return
        moved = runs(starts, [0.1] * 4, machine)
        for run, end in zip(moved, ends, strict=True):
            run.outputs[-1] = end
        assert check_origins(moved, machine) == []
    else:
        assert check_origins(runs(starts, ends, machine), machine) == []
