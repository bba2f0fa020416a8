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

from ..atomic import write_text
from ..control import Controller
from ..env import HFrameVectorEnv
from ..env.batch import MachineLike
from ..env.randomisation import Randomise
from ..machine import Machine
from .episodes import Episodes
from .scorecard import scores

Array = NDArray[np.float64]
SAMPLES = 10  # a control period
DURATION = 1.5  # s, twice the longest move


class _Parameters:
    """The drawn parameters of every episode, each (B,), by full name."""

    def __init__(self, envs: HFrameVectorEnv) -> None:
        table = envs.batch.stages.parameters
        rows = table.transpose(0, 2, 1).reshape(-1, table.shape[1])[: envs.num_envs]
        names = list(envs.batch.machine.parameters)
        self.by_name: dict[str, Array] = {name: rows[:, i].copy() for i, name in enumerate(names)}

    def __call__(self, owner: str, key: str) -> Array:
        return self.by_name[f"{owner}.{key}"]


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


def rollout(
    controller: Controller,
    machine: MachineLike = "hframe",
    *,
    randomize: Randomise = "default",
    episodes: int = 512,
    seed: int = 0,
    period: float = 0.01,
    duration_s: float = DURATION,
) -> Episodes:
    """The episodes of one controller on the draws of a seed; episode b is the environment's of seed + b.

    machine: the stage as declared, around which `randomize` draws.  period: of control, s.

    Raises ValueError for settings that the environment refuses, or fewer than one control period.
    """
    periods = round(duration_s / period)
    if periods < 1:
        raise ValueError(f"duration_s is {duration_s!r}, it must hold at least one control period of {period:g} s")
    sample_s = period / SAMPLES
    envs = HFrameVectorEnv(
        episodes, max_episode_steps=None, machine=machine, randomize=randomize, period=sample_s
    )  # fmt: skip
    observation, _ = envs.reset(seed=seed)
    stage = envs.batch.machine
    values = _Parameters(envs)
    rated = np.array([d.rated_voltage for d in stage.drives])
    axes = [stage.coordinate_names.index(axis) for axis in ("x", "y")]
    travel = _travel(envs)
    position = np.empty((episodes, periods * SAMPLES + 1, 2))
    position[:, 0] = travel[:, axes]
    volts = np.empty((episodes, periods, len(rated)))
    energy, peak = np.zeros(episodes), _belt_force(stage, values, travel)
    controller.reset()
    for k in range(periods):
        actions = np.clip(controller.act(observation), -1.0, 1.0)
        volts[:, k] = actions * rated
        for sample in range(SAMPLES):
            observation = envs.step(actions)[0]
            before, travel = travel, _travel(envs)
            position[:, k * SAMPLES + sample + 1] = travel[:, axes]
            energy += _energy(stage, values, travel - before, volts[:, k], sample_s)
            peak = np.maximum(peak, _belt_force(stage, values, travel))
    goal = observation["desired_goal"].astype(np.float64)
    time_s = sample_s * np.arange(position.shape[1], dtype=np.float64)
    return Episodes(time_s, position, goal, volts, rated, energy, peak)


def evaluate(
    controllers: Mapping[str, Controller],
    machine: MachineLike = "hframe",
    *,
    randomize: Randomise = "default",
    episodes: int = 512,
    seed: int = 0,
    period: float = 0.01,
    duration_s: float = DURATION,
    bound_s: Array | None = None,
) -> tuple[dict[str, Any], dict[str, Episodes]]:
    """Scores of controllers, by name, on the same draws (see `rollout`), and their episodes.

    bound_s: least possible time to 0.2 mm of each draw (episodes,), s, where it was computed.
    The scores are plain data: `{"schema": 1, "machine", "randomize", "episodes", "seed", "controllers"}`.

    Raises ValueError as `rollout` does.
    """
    runs = {
        name: rollout(
            controller, machine, randomize=randomize, episodes=episodes, seed=seed, period=period, duration_s=duration_s
        )
        for name, controller in controllers.items()
    }
    answer = {
        "schema": 1,
        "machine": machine.name if isinstance(machine, Machine) else str(machine),
        "randomize": randomize if isinstance(randomize, str) else [repr(rule) for rule in randomize],
        "episodes": episodes,
        "seed": seed,
        "controllers": {name: scores(run, bound_s, seed=seed) for name, run in runs.items()},
    }
    return answer, runs


def write_scores(folder: str | Path, answer: Mapping[str, Any]) -> Path:
    """Write scores.json into a folder, whole or not at all; the folder is made if it is not there.

    Raises ValueError for a number that JSON cannot hold.
    """
    path = Path(folder) / "scores.json"
    write_text(path, json.dumps(answer, indent=2, allow_nan=False) + "\n")
    return path
