"""H-frame belt stages: simulation, Gymnasium environments, and identification of missing model effects.

Importing the package registers the environments `HFrame-v0` and `HFrameTrack-v0` with Gymnasium, as well as
`HFrameFlat-v0` and `HFrameTrackFlat-v0`, whose observation is one array. The names below load their
subpackage when they are first used:

    Machine              machine model: coordinates, belts, drives, sensors, effects
    load_machine         read a machine.json, or return a preset by name
    save_machine         write a machine.json
    simulate             simulate a machine over a voltage history
    Trajectory           result of a simulation: states and sensor outputs over time
    load_recordings      read the recordings of a folder
    check_recordings     report faults and gaps in recordings before identification
    identify             fit a machine to recordings and find the effects that its model lacks
    EFFECTS              library of effects (friction, delay, ...) by name
    HFrameEnv            Gymnasium environment of one machine
    HFrameVectorEnv      Gymnasium vector environment of many machines
    make_controller      create a controller by name
    evaluate             evaluate controllers on a task
    InputError           exception for invalid files and arguments
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import gymnasium as gym

from .errors import InputError
from .machine import SIMULATORS
from .version import __version__

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .data_validation import check_recordings
    from .dynamics import simulate
    from .effects import EFFECTS
    from .envs import HFrameEnv, HFrameVectorEnv
    from .evaluation import evaluate, make_controller
    from .identification import identify
    from .machine import Machine, Trajectory
    from .recordings import load_machine, load_recordings, save_machine

__all__ = [
    "EFFECTS",
    "HFrameEnv",
    "HFrameVectorEnv",
    "InputError",
    "Machine",
    "Trajectory",
    "__version__",
    "check_recordings",
    "evaluate",
    "identify",
    "load_machine",
    "load_recordings",
    "make_controller",
    "save_machine",
    "simulate",
]

_SUBPACKAGES = {
    "EFFECTS": "effects",
    "HFrameEnv": "envs",
    "HFrameVectorEnv": "envs",
    "Machine": "machine",
    "Trajectory": "machine",
    "check_recordings": "data_validation",
    "evaluate": "evaluation",
    "identify": "identification",
    "load_machine": "recordings",
    "load_recordings": "recordings",
    "make_controller": "evaluation",
    "save_machine": "recordings",
    "simulate": "dynamics",
}

# 1.5 s at the default period: the longest move takes half of it, a lap of the circle a third.
_EPISODE_STEPS = 150
# Environment, vector environment and keywords by id; only names, so that the import does not load the
# simulator.
_REACH = "hframe_gym.envs:HFrameEnv", "hframe_gym.envs:HFrameVectorEnv"
_TRACK = "hframe_gym.envs:HFrameTrackEnv", "hframe_gym.envs:HFrameTrackVectorEnv"
_ENVIRONMENTS: dict[str, tuple[tuple[str, str], dict[str, Any]]] = {
    "HFrame-v0": (_REACH, {}),
    "HFrameTrack-v0": (_TRACK, {}),
    "HFrameFlat-v0": (_REACH, {"flat": True}),
    "HFrameTrackFlat-v0": (_TRACK, {"flat": True}),
}


def __getattr__(name: str) -> Any:
    """Load a public name from its subpackage at first use."""
    if name not in _SUBPACKAGES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_SUBPACKAGES[name]}", __name__), name)


def __dir__() -> list[str]:
    """List the public names, loaded or not."""
    return sorted({*globals(), *__all__})


@SIMULATORS.register("default")
def _simulate(
    machine: Machine, time_s: ArrayLike, inputs: ArrayLike, initial: ArrayLike | None = None
) -> Trajectory:
    """Simulate a machine for `Machine.simulate`; the package `machine` does not depend on `dynamics`."""
    from .dynamics import simulate

    return simulate(machine, time_s, inputs, initial)  # type: ignore[return-value]


def _register_environments() -> None:
    """Register the environments with Gymnasium, except for an id that is registered already."""
    for name, ((entry_point, vector_entry_point), keywords) in _ENVIRONMENTS.items():
        if name not in gym.registry:
            gym.register(
                name,
                entry_point=entry_point,
                vector_entry_point=vector_entry_point,
                max_episode_steps=_EPISODE_STEPS,
                kwargs=keywords,
            )


_register_environments()
