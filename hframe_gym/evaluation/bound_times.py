"""Least possible settling times that come with the package, by draw.

A draw is what no controller can choose: the stage's parameters, where it starts and where it is to go.  Its bound
(control/bound.py; minutes for hundreds) is looked up by a digest of just these, so a bound can only ever meet the draw
that it was worked out for, whatever seed, sensors or period a trial has.  `python -m benchmarks.bound` fills the file.
"""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache
from importlib import resources
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..envs import HFrameVectorEnv
from ..machine import Machine
from .scenario import Scenario

Array = NDArray[np.float64]
FILE = "bound_times_data/hframe_reach.json"


class EpisodeDraws(NamedTuple):
    """What the episodes of a trial draw: parameters (B, P), in the order of `Machine.parameters`; start and goal
    (B, 2), m."""

    machine: Machine
    parameters: Array
    start: Array
    goal: Array


def drawn(trial: Scenario) -> EpisodeDraws:
    """The draws of a trial, of its environment itself.

    Raises ValueError for settings that the environment refuses.
    """
    envs = HFrameVectorEnv(
        trial.episodes, max_episode_steps=None, machine=trial.machine, task=trial.own_task, randomize=trial.randomize
    )
    observation, _ = envs.reset(seed=trial.seed)
    batch, everyone = envs.batch, np.arange(trial.episodes)
    columns = [batch.stages.values(everyone, i) for i in range(len(batch.machine.parameters))]
    goal = np.asarray(observation["desired_goal"], np.float64)
    return EpisodeDraws(batch.machine, np.stack(columns, axis=1), batch.stages.tools().copy(), goal)


def digests(draws: EpisodeDraws) -> list[str]:
    """16 hexadecimal digits for each draw, of the machine's tables and of all its numbers to nine digits."""
    machine = draws.machine
    tables = [
        machine.parameters,
        [(c.name, c.kind) for c in machine.coordinates],
        [(machine.row(b.extension).tolist(), machine.row(b.length).tolist()) for b in machine.belts],
        [(d.coordinate, d.rated_voltage) for d in machine.drives],
    ]
    shape = json.dumps([list(tables[0]), *tables[1:]])
    rows = np.concatenate([draws.parameters, draws.start, draws.goal], axis=1).tolist()
    texts = (shape + " ".join(f"{value:.9g}" for value in row) for row in rows)
    return [hashlib.sha256(text.encode()).hexdigest()[:16] for text in texts]


@lru_cache(maxsize=1)
def stored() -> dict[str, float]:
    """Least settling times to 0.2 mm, s, of the draws that were solved, by digest."""
    content = json.loads((resources.files("hframe_gym.evaluation") / FILE).read_text())
    return {row["draw"]: row["time_s"] for row in content["draws"] if row["time_s"] is not None}


def known_bounds(trial: Scenario) -> Array | None:
    """Least settling time to 0.2 mm of each episode (B,), s, NaN where it is not known; None where none is.

    They are of stages without effects that reach a point.
    """
    if trial.own_task.ahead_s:
        return None
    draws = drawn(trial)
    if draws.machine.effects:
        return None
    times = np.array([stored().get(digest, np.nan) for digest in digests(draws)])
    return None if np.isnan(times).all() else times
