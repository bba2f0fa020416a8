"""Time-optimal bounds of episodes, looked up in the package by what determines the episode."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from .scenario import EpisodeConditions, Scenario, episode_conditions

BOUNDS_FILE = "bound_times_data/hframe_reach.json"


class StoredBounds(NamedTuple):
    """Time-optimal bounds of B episodes, from the file of bounds in the package.

    Attributes:
        times_s: Shortest possible time to settle within 0.2 mm of the goal in each episode, s, shape (B,),
            NaN where unknown; None if unknown for all.
        reason: Why some or all episodes have no bound; None if all have one.
    """

    times_s: Array | None
    reason: str | None


def condition_digests(conditions: EpisodeConditions) -> list[str]:
    """Compute a hash of each episode's machine, start and goal, as the key of stored time-optimal bounds.

    Before hashing (the first 16 hexadecimal digits of SHA-256), numbers are rounded to nine significant
    digits. Seed, control period and sensors are not hashed.
    """
    machine = conditions.machine
    coordinates = [(c.name, c.kind) for c in machine.coordinates]
    belts = [[machine.coefficients(row).tolist() for row in (b.extension, b.length)] for b in machine.belts]
    drives = [(d.coordinate, d.rated_voltage) for d in machine.drives]
    structure = json.dumps([list(machine.parameters), coordinates, belts, drives])
    rows = np.concatenate([conditions.parameters, conditions.start, conditions.goal], axis=1).tolist()
    texts = (structure + " ".join(f"{value:.9g}" for value in row) for row in rows)
    return [hashlib.sha256(text.encode()).hexdigest()[:16] for text in texts]


@cache
def _bounds_by_digest() -> dict[str, float]:
    """Return the stored settling times to 0.2 mm, s, by digest; from `python -m benchmarks.bound`."""
    content = json.loads((resources.files("hframe_gym.evaluation") / BOUNDS_FILE).read_text("utf-8"))
    return {row["draw"]: row["time_s"] for row in content["draws"] if row["time_s"] is not None}


def stored_bounds(scenario: Scenario) -> StoredBounds:
    """Look up the time-optimal bounds of a scenario's episodes.

    Returns:
        Shortest possible settling times within 0.2 mm, s, shape (B,), NaN where none is stored, None if none
        is stored for any episode; and, unless all are known, the reason. None are stored for goals that move
        and for machines with effects.

    Raises:
        ValueError: If the scenario is invalid.
    """
    if scenario.controller_task.ahead_s:  # the task previews goals, so that its goal moves
        return StoredBounds(None, "bounds exist for goals that do not move only")
    conditions = episode_conditions(scenario)
    if conditions.machine.effects:
        name = conditions.machine.name
        return StoredBounds(
            None, f"no bound on the settling time is stored for {name!r}, because it has effects"
        )
    times = np.array([_bounds_by_digest().get(digest, np.nan) for digest in condition_digests(conditions)])
    missing = int(np.isnan(times).sum())
    if not missing:
        return StoredBounds(times, None)
    reason = (
        f"no bound is stored for {missing} of {len(times)} episodes; bounds are stored for "
        "the machine 'hframe', randomize 'default' and seeds 0 to 511 and 1000 to 1511 (see docs/bound.md)"
    )
    return StoredBounds(None if missing == len(times) else times, reason)
