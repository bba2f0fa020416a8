"""Episodes of a controller in the environment, recorded ten times a control period, and the scores of several.

Same seed, same episodes: starts, goals and machine parameters are the environment's own draws for that seed, and no
controller touches them.  The environment runs at the recording's rate with the action held for a control period;
settling is judged on those samples, so a settling time is known to a tenth of a control period.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..atomic_files import write_text
from ..controllers import Controller
from ..envs import HFrameVectorEnv
from ..envs.parameter_index import numbers
from ..machine import Machine
from .bound_times import known_bounds
from .episodes import Episodes
from .metrics import scores
from .scenario import Scenario

Array = NDArray[np.float64]
SAMPLES = 10  # a control period


class _Parameters:
    """The drawn numbers of every episode's tables, each (B,), by full name."""

    def __init__(self, envs: HFrameVectorEnv) -> None:
        table = envs.batch.stages.parameters
        self.machine = envs.batch.machine
        self.rows = table.transpose(0, 2, 1).reshape(-1, table.shape[1])[: envs.num_envs].copy()

    def __call__(self, owner: str, key: str) -> Array:
        return numbers(self.machine, f"{owner}.{key}", self.rows)


def _travel(envs: HFrameVectorEnv) -> Array:
    """Travel of all coordinates of all stages, (B, n), m, in full precision."""
    state = envs.batch.stages.state
    rows: Array = state.transpose(0, 2, 1).reshape(-1, state.shape[1])[: envs.num_envs]
    return rows[:, : len(envs.batch.machine.coordinates)].copy()


def _belt_force(machine: Machine, values: _Parameters, travel: Array) -> Array:
    """The largest tension (B,) among the belts beyond their pretension, N."""
    largest = np.zeros(len(travel))
    for belt in machine.belts:
        length = values(belt.name, "rest_length") + travel @ machine.row(belt.length)
        tension = values(belt.name, "EA") / length * (travel @ machine.row(belt.extension))
        largest = np.maximum(largest, np.abs(tension))
    return largest


def _energy(machine: Machine, values: _Parameters, moved: Array, volts: Array, time_s: float) -> Array:
    """Energy (B,) drawn by the drives, J, while travel changed by moved (B, n), m, under held volts (B, drives)."""
    energy = np.zeros(len(moved))
    for j, d in enumerate(machine.drives):
        i = machine.coordinate_names.index(d.coordinate)
        radius = values(d.coordinate, "radius") if machine.coordinates[i].kind == "rotary" else 1.0
        # The charge: the current is linear in the speed, and the speed's mean is the way over the time.
        back_emf = values(d.name, "Ke") * values(d.name, "gear_ratio") * moved[:, i] / radius
        energy += volts[:, j] * (volts[:, j] * time_s - back_emf) / values(d.name, "resistance")
    return energy


def rollout(controller: Controller, trial: Scenario) -> Episodes:
    """The episodes of one controller on the draws of a trial.

    Raises ValueError for settings that the environment refuses, or fewer than one control period.
    """
    sample_s = trial.period / SAMPLES
    envs = HFrameVectorEnv(
        trial.episodes,
        max_episode_steps=None,
        machine=trial.machine,
        task=trial.own_task,
        randomize=trial.randomize,
        sensors=trial.sensors,
        period=sample_s,
    )
    samples = trial.periods * SAMPLES + 1
    observation, info = envs.reset(seed=trial.seed)
    stage = envs.batch.machine
    values = _Parameters(envs)
    rated = np.array([d.rated_voltage for d in stage.drives])
    axes = [stage.coordinate_names.index(axis) for axis in ("x", "y")]
    travel = _travel(envs)
    position, goal = np.empty((2, trial.episodes, samples, 2))
    contour = np.empty((trial.episodes, samples)) if "contour_m" in info else None
    volts = np.empty((trial.episodes, trial.periods, len(rated)))
    energy, peak = np.zeros(trial.episodes), _belt_force(stage, values, travel)
    actions = np.zeros((trial.episodes, len(rated)))
    controller.reset()
    for i in range(samples):
        position[:, i], goal[:, i] = travel[:, axes], observation["desired_goal"]
        if contour is not None:
            contour[:, i] = info["contour_m"]
        if i == samples - 1:
            break
        if i % SAMPLES == 0:
            actions = np.clip(controller.act(observation), -1.0, 1.0)
            volts[:, i // SAMPLES] = actions * rated
        observation, _, _, _, info = envs.step(actions)
        before, travel = travel, _travel(envs)
        energy += _energy(stage, values, travel - before, actions * rated, sample_s)
        peak = np.maximum(peak, _belt_force(stage, values, travel))
    time_s = sample_s * np.arange(samples, dtype=np.float64)
    return Episodes(time_s, position, goal, contour, volts, rated, energy, peak)


def evaluate(controllers: Mapping[str, Controller], trial: Scenario) -> tuple[dict[str, Any], dict[str, Episodes]]:
    """Scores of controllers, by name, on the draws of a trial, and their episodes.

    The scores are plain data: `{"schema": 1, "machine", "task", "randomize", "episodes", "seed", "sensors", "period_s",
    "controllers"}`.

    Raises ValueError as `rollout` does.
    """
    runs = {name: rollout(controller, trial) for name, controller in controllers.items()}
    machine, randomize, bound_s = trial.machine, trial.randomize, known_bounds(trial)
    answer = {
        "schema": 1,
        "machine": machine.name if isinstance(machine, Machine) else str(machine),
        "task": trial.task if isinstance(trial.task, str) else repr(trial.task),
        "randomize": randomize if isinstance(randomize, str) else [repr(rule) for rule in randomize],
        "episodes": trial.episodes,
        "seed": trial.seed,
        "sensors": trial.sensors if isinstance(trial.sensors, str) else repr(trial.sensors),
        "period_s": trial.period,
        "controllers": {name: scores(run, bound_s, seed=trial.seed) for name, run in runs.items()},
    }
    return answer, runs


def write_scores(folder: str | Path, answer: Mapping[str, Any]) -> Path:
    """Write scores.json into a folder, whole or not at all; the folder is made if it is not there.

    Raises ValueError for a number that JSON cannot hold.
    """
    path = Path(folder) / "scores.json"
    write_text(path, json.dumps(answer, indent=2, allow_nan=False) + "\n")
    return path
