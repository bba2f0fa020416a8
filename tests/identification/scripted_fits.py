"""Fits with scripted costs, effects and runs, for tests of decisions in which nothing is simulated."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Fit, SelectedEffect, SelectionCriteria
from hframe_gym.identification.free_parameters import FreeParameter
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect

COUNT = 10_000  # measured values
CRITERIA = SelectionCriteria()
AXIS, HFRAME = BUILTIN_MACHINES["axis"](), BUILTIN_MACHINES["hframe"]()
PUSH = EFFECTS["constant_force"].at("x", size=0.3)
DRAG = EFFECTS["quadratic_drag"].at("x", c=4.0)
SPRING = EFFECTS["cable_spring"].at("x", k=6.0, q0=0.05)
STRIBECK = EFFECTS["stribeck_friction"].at("x", dF=3.0, vs=0.04)
FRAME = EFFECTS["frame_resonance"].at("x", f0=19.0, zeta=0.05, r=0.05, s=0.8)
DATA: Any = SimpleNamespace(count=COUNT)


def fit_with(*effects: AppliedEffect, chi2: float, free: int = 4, bandwidth: float = 0.0) -> Fit:
    """Return a fit of the axis with effects, and a chi-squared per sample."""
    parameters = tuple(FreeParameter(f"p{i}", 1.0, 1.0) for i in range(free))
    machine = dataclasses.replace(AXIS, effects=effects)
    return Fit(machine, parameters, np.zeros(free), chi2 * COUNT, COUNT, bandwidth, np.eye(free))


def selected(effect: AppliedEffect, gain: float = 1.0) -> SelectedEffect:
    """Return a selected effect."""
    return SelectedEffect(effect, (), gain, AXIS)


def runs(names: str) -> Any:
    """Return data with runs that have one letter each as a name."""
    return SimpleNamespace(
        runs=[SimpleNamespace(name=name, count=COUNT // 4) for name in names], count=COUNT, with_runs=runs
    )
