"""The recordings of examples/, read once per process."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import Recording, load_recordings

EXAMPLES = Path(__file__).parents[1] / "examples"


@cache
def example_runs(rig: str) -> tuple[Recording, ...]:
    """Return the recordings of a folder of examples/, such as rig_a; tests share them, read-only."""
    runs = tuple(load_recordings(EXAMPLES / rig, BUILTIN_MACHINES["hframe"]()))
    for run in runs:
        for array in (run.time_s, run.inputs, run.outputs):
            array.setflags(write=False)
    return runs
