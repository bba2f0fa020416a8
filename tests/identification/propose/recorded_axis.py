"""A noisy recording of an axis, and candidates of effects that it may lack."""

from __future__ import annotations

import numpy as np

from hframe_gym.effects import EFFECTS
from hframe_gym.identification.propose.candidates import Candidate
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording

NOISE = 20e-6


def recorded(machine: Machine) -> Recording:
    """Return a noisy recording of an axis that moves back and forth."""
    time_s = np.arange(2000) * 1e-3
    inputs = np.where(time_s > 0.1, 1.5 * np.sin(9 * time_s) + 0.7 * np.sin(31 * time_s), 0.0)[:, None]
    noise = np.random.default_rng(0).normal(0.0, NOISE, (2000, 1))
    return Recording("run", time_s, inputs, machine.simulate(time_s, inputs).outputs + noise)


def candidate(name: str, site: str, **column: float) -> Candidate:
    """Return a candidate with one column."""
    return Candidate(EFFECTS[name], site, (column,), {})


CANDIDATES = [
    candidate("constant_force", "x", size=0.1),
    candidate("asymmetric_viscous", "x", a=0.1),
    candidate("cable_spring", "x", k=10.0, q0=0.0),
]
