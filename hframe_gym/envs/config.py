"""What an environment is made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from ..machine import Machine
from .actuator_presets import ActuatorsLike
from .domain_randomization import RandomizationLike
from .rewards import RewardLike
from .sensors import SensorsLike
from .tasks import TaskLike

MachineLike: TypeAlias = Machine | str | Path
Ends = Literal["stops", "terminate"]

# Taken from the reward when an episode ends at the workspace's edge: as much as a hundred steps can lose, so that
# leaving does not pay.
PENALTY = 100.0
# s.  After 0.4 s of random voltages up to 12 V the tool is off by 1.1 um (median; 3 um at most), with 0.25 ms by 0.2 um
# (0.8 um) (benchmarks/accuracy.py): a twentieth of a laser's noise, for half the time.
LONGEST_STEP = 0.5e-3


@dataclass(frozen=True)
class EnvConfig:
    """Every keyword of `gym.make("HFrame-v0", ...)` but the rendering.

    machine: a `Machine`, a built-in name or the path of a machine.json.
    task: "reach", "track" or a `Task`.
    reward: "dense", "sparse" (0 within the task's band, else -1) or a function of (achieved, desired), (n, 2) -> (n,).
    randomize: "none" (the machine as it is), "default", "wide", "identified" or a list of rules.
    sensors: what is observed: "state", the full true state, "rig", the paper's encoders and lasers, or `Sensors`.
    drives: what applies the voltages: "ideal", "rig", a 12-bit converter and 12 A, or `Actuators`.
    privileged: whether the observation has the true state and the drawn parameters as well, for a critic in training.
    ends: what the edge of the workspace is: "stops", rubber buffers, or "terminate", the end of the episode with
        `penalty`.  Buffers learn better: with an episode's end, giving up becomes a choice that has to be priced out.
    period: of control, s.  longest_step: of the integrator, s.

    Raises ValueError for values that none of these are.
    """

    machine: MachineLike = "hframe"
    task: TaskLike = "reach"
    reward: RewardLike = "dense"
    randomize: RandomizationLike = "none"
    sensors: SensorsLike = "state"
    drives: ActuatorsLike = "ideal"
    privileged: bool = False
    ends: Ends = "stops"
    penalty: float = PENALTY
    period: float = 0.01
    longest_step: float = LONGEST_STEP

    def __post_init__(self) -> None:
        if self.ends not in ("stops", "terminate"):
            raise ValueError(f"ends is {self.ends!r}, choose 'stops' or 'terminate'")
        if not isinstance(self.privileged, bool):
            raise ValueError(f"privileged is {self.privileged!r}, it must be True or False")
        if not (np.isfinite(self.penalty) and self.penalty >= 0.0):
            raise ValueError(f"penalty is {self.penalty!r}, it must be a number that is not negative")


def as_machine(machine: MachineLike) -> Machine:
    """The machine itself, or the one of a built-in name or file."""
    if isinstance(machine, Machine):
        return machine
    from ..recordings import load_machine

    return load_machine(machine)
