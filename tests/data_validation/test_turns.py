"""Angles that jump between the ends of their values."""

from __future__ import annotations

import numpy as np

from hframe_gym.data_validation import check_before_fit
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Sensor
from hframe_gym.recordings import Recording

TIME = 2e-3 * np.arange(2000)


def motor(kind: str) -> Machine:
    """Return a motor with one sensor of the angle of its shaft."""
    sensor = Sensor("shaft", {"shaft": 1.0}, noise=1e-3, kind=kind)
    return BUILTIN_MACHINES["motor"]().replace(sensors=(sensor,))


def turns(kind: str, *offsets: float) -> list[str]:
    """Return the findings about turns of runs with a potentiometer whose ends are 5 rad apart."""
    inputs = np.sign(np.sin(3.0 * TIME))[:, None]
    runs = [
        Recording(
            f"run_{i}", TIME, inputs, np.minimum((8.0 * np.sin(1.5 * TIME) + offset) % 5.5, 5.0)[:, None]
        )
        for i, offset in enumerate(offsets)
    ]
    words = "between the ends", "wraps"
    return [str(f) for f in check_before_fit(runs, motor(kind)) if any(word in f.message for word in words)]


def test_jumps_of_an_unknown_size_are_told_with_run_and_row() -> None:
    lines = turns("encoder", 0.0, 1.0)
    assert len(lines) == 2
    assert lines[0].startswith("advice: run_0, shaft: jumps ")
    assert "the first time in row 254 (from 5 to " in lines[0]
    assert '"absolute-angle"' in lines[0]


def test_declared_turns_are_continuous() -> None:
    lines = turns("absolute-angle", 0.0)
    assert len(lines) == 1
    assert "wraps" in lines[0]
