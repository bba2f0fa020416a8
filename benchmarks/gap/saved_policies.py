"""Entry of policies that were trained elsewhere: models of stable-baselines3 and folders of `hframe train`.

    python -m benchmarks.gap run my_reach.zip+my_track.zip            # trained on the full state
    python -m benchmarks.gap run my_reach.zip+my_track.zip@machine    # trained with sensors="machine"
    python -m benchmarks.gap run my_agent       # a folder with reach and track, or reach.zip and track.zip

The first controls the moves, the second, which was trained on the task `track`, circles and squares. Policies
that were trained on the full state observe the estimates of the package's state estimator of the declared
machine, those that were trained with `sensors="machine"` the measurements of the plant and their rates. The
lasers of "rig" have a range of 100 mm, those of the plants see the whole workspace. The files of models do
not say which sensors they observe.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
from typing_extensions import override

from benchmarks.gap.control_loop import PERIOD_S
from benchmarks.gap.entries import GapEntry, from_measurements
from benchmarks.gap.recorder import Recorder
from hframe_gym.arrays import Actions, KeyedObservation, Mask
from hframe_gym.controllers import Controller, EpisodeStarts
from hframe_gym.envs import Task
from hframe_gym.errors import InputError
from hframe_gym.evaluation import CONTROLLER_SOURCES, ControllerFiles, Scenario, make_controller
from hframe_gym.evaluation.protocols.entries import agent_of_task
from hframe_gym.machine import Machine
from hframe_gym.registry import load_plugins
from tests.reference_simulator import Array

JOINT, MEASURED = "+", "@machine"  # between the names of the two policies, and after them
_TASKS = ("reach", "track")


class SavedPolicies(GapEntry):
    """A policy for moves and one for paths, each of a file or a folder.

    Attributes:
        paths: Files or folders by task, "reach" and "track".
        measured: Whether they observe measurements instead of estimates of the full state.
    """

    learned = True
    knowledge = "as the policies do"
    paths: ClassVar[dict[str, str]] = {}
    measured: ClassVar[bool] = False

    @classmethod
    @override
    def files(cls) -> list[Path]:
        return [file for task in cls.paths for file in _described(cls.paths[task], Scenario(task=task)).files]

    @override
    def prepare(self, declared: Machine, recorder: Recorder, folder: Path) -> None:
        self.machine = declared

    @override
    def controller(self, task: Task) -> Controller:
        sensors = "machine" if self.measured else "state"
        scenario = Scenario(self.machine, task, "none", sensors, period=PERIOD_S)
        policy = make_controller(self.paths[task.name], scenario)
        return MeasuredRates(policy) if self.measured else from_measurements(policy, self.machine)


class MeasuredRates(Controller):
    """A controller that also observes the measurements' rates, as in an environment that observes sensors.

    A rate is the difference of the last two measurements over the control period, zero when an episode
    begins.
    """

    feedback = "observation"

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller.machine, controller.period)
        self._controller, self._starts = controller, EpisodeStarts()
        self._before: Array = np.zeros((0, 0))

    @override
    def reset(self, mask: Mask | None = None) -> None:
        self._controller.reset(mask)
        self._starts.reset(mask)

    @override
    def act(self, observation: KeyedObservation) -> Actions:
        now = np.asarray(observation["observation"], np.float64)
        if self._starts.resize(len(now)):
            self._before = now
        before = np.where(self._starts.mask[:, None], now, self._before)
        self._before = now
        self._starts.clear()
        full = np.hstack([now, (now - before) / self.period])
        arrays = {key: np.asarray(values, np.float32) for key, values in observation.items()}
        return self._controller.act({**arrays, "observation": full.astype(np.float32)})


class Named(NamedTuple):
    """What the name of an entry of saved policies means.

    Attributes:
        label: Name in results.
        paths: Files or folders by task.
        measured: Whether they observe measurements instead of estimates of the full state.
    """

    label: str
    paths: dict[str, str]
    measured: bool


def read_name(name: str) -> Named | None:
    """Return what a name of an entry means; None if it names no files or folders.

    Raises:
        InputError: If a file or folder is missing.
    """
    named = name.removesuffix(MEASURED)
    found = [agent_of_task(Path(named), task) for task in _TASKS]
    parts, label = [str(part) for part in found if part], Path(named).name
    if len(parts) < len(_TASKS):
        parts = named.split(JOINT)
        label = JOINT.join(Path(part).stem for part in parts)
        if not any(part.endswith(".zip") or Path(part).is_dir() for part in parts):
            return None
    if len(parts) != len(_TASKS):
        raise InputError(f"entry {name!r}: name a policy for moves and one for paths, REACH{JOINT}TRACK")
    for part in parts:
        if not Path(part).exists():
            raise InputError(f"entry {name!r}: {part}: there is no such file or folder")
    return Named(label, dict(zip(_TASKS, parts, strict=True)), name.endswith(MEASURED))


def _described(path: str, scenario: Scenario) -> ControllerFiles:
    """Return the files of a policy."""
    load_plugins()  # sources of controllers among them
    for source in CONTROLLER_SOURCES:
        described = CONTROLLER_SOURCES.get(source).files(path, scenario)
        if described is not None:
            return described
    raise InputError(f"{path}: is no model of stable-baselines3 and no folder of hframe train")
