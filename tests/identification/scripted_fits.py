"""Fits with scripted costs, effects and runs, for tests of decisions in which nothing is simulated."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Fit, SelectedEffect, SelectionCriteria
from hframe_gym.identification.evidence import significance
from hframe_gym.identification.judge.chance import LongRunVariance
from hframe_gym.identification.predict.free_parameters import FreeParameter
from hframe_gym.identification.search import forward_selection
from hframe_gym.identification.search.forward_selection import EffectSearch
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect

COUNT = 10_000  # measured values
CRITERIA = SelectionCriteria()
AXIS, HFRAME = BUILTIN_MACHINES["axis"](), BUILTIN_MACHINES["hframe"]()
PUSH = EFFECTS["constant_force"].at("x", size=0.3)
DRAG = EFFECTS["quadratic_drag"].at("x", c=4.0)
SPRING = EFFECTS["cable_spring"].at("x", k=6.0, q0=0.05)
STRIBECK = EFFECTS["stribeck_friction"].at("x", dF=3.0, vs=0.04)
FRAME = EFFECTS["frame_resonance"].at("x", f0=19.0, zeta=0.05, r=0.05, s=0.8)
CLOCK = EFFECTS["clock_drift"].at("machine", a=-5e-4)


class Runs(SimpleNamespace):
    """Attributes of a data set; as with a `Dataset`, only the same object is equal."""

    __eq__, __hash__ = object.__eq__, object.__hash__


DATA: Any = Runs(count=COUNT, updates=1, has_voltage_errors=False, updates_rejected={})


def fit_with(*effects: AppliedEffect, chi2: float, free: int = 4, bandwidth: float = 0.0) -> Fit:
    """Return a fit of the axis with effects, and a chi-squared per sample."""
    parameters = tuple(FreeParameter(f"p{i}", 1.0, 1.0) for i in range(free))
    machine = dataclasses.replace(AXIS, effects=effects)
    return Fit(machine, parameters, np.zeros(free), chi2 * COUNT, COUNT, bandwidth, np.eye(free))


def selected(effect: AppliedEffect, gain: float = 1.0) -> SelectedEffect:
    """Return a selected effect."""
    return SelectedEffect(effect, gain, AXIS)


def runs(names: str) -> Any:
    """Return data with runs that have one letter each as a name."""
    return Runs(
        runs=[SimpleNamespace(name=name, count=COUNT // 4) for name in names],
        count=COUNT,
        updates=1,
        has_voltage_errors=False,
        with_runs=runs,
    )


class Scripted:
    """Replaces what search and effects' tests compute: forces, gains, variances; neutral by default."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.force: dict[str, float] = {}
        self.residue: dict[float, float] = {}  # by chi-squared of the fit
        self.residue_beyond_noise: dict[float, float] = {}  # beyond the noise of the motion, where it differs
        self.drives = 10.0
        self.confirmed, self.variance, self.fault = 1.0, 1.0, ""
        self.variances: dict[str, float] = {}  # by label of an effect, where they differ from `variance`
        self.simulated = 100.0  # chi-squared per sample of a simulation without effects
        self.narrower: dict[float, Fit] = {}  # by bandwidth, the fit with the next narrower observer
        self.observer: float | None = (
            None  # bandwidth of the observer that is most likely, if it is another one
        )
        self.trials: list[list[Fit]] = []
        self.structures: list[list[Fit]] = []
        self.without: dict[str, Fit | None] = {}
        self.replacement: Fit | None = None
        self.again: list[Fit] = []  # fits with effects that an earlier search selected
        self.lines: list[str] = []
        replaced: Mapping[str, Callable[..., Any]] = {
            "effect_force": lambda machine, effect, data: self.force.get(effect.label, 1.0),
            "drive_force": lambda machine, data: self.drives,
            "residue_force": lambda fitted, data, noise_of_motion=False: (
                self.residue_beyond_noise if noise_of_motion else self.residue
            ).get(fitted.chi2, self.residue.get(fitted.chi2, 0.1)),
            "leave_one_out_gain": lambda a, b, data: self.confirmed * (a.cost - b.cost),
            "long_run_variance": lambda fitted, label, data: LongRunVariance(
                self.variances.get(label, self.variance)
            ),
            "plausibility_fault": lambda machine: self.fault,
            "fit_with_model_error": lambda fitted, data: (
                fitted if self.observer is None else dataclasses.replace(fitted, bandwidth=self.observer)
            ),
            "with_probable_starts": lambda current, data, criteria: (current, data),
            "other_updates": lambda current, data, criteria: None,
            "narrower_observer": lambda fitted, data: self.narrower.get(fitted.bandwidth, fitted),
            "continue_fit": lambda fitted, data, bandwidth: (
                fitted if fitted.machine.effects else fit_with(chi2=self.simulated, bandwidth=bandwidth)
            ),
            "likelihood_deficit": lambda fitted, reference, data: math.inf,
            "converge": lambda fitted, data, thorough: fitted,
            "trial_fits": lambda *arguments: self.trials.pop(0) if self.trials else [],
            "structural_trial_fits": lambda *arguments: self.structures.pop(0) if self.structures else [],
            "without_effect": lambda current, label, *rest, **more: self.without.get(label),
            "screened_fit": lambda current, data, without: None,
            "replacement_fit": self._replaced,
            "fit_with_effects": lambda current, effects, data: self.again.pop(0),
        }
        for name, function in replaced.items():
            for module in (significance, forward_selection):
                if hasattr(module, name):
                    monkeypatch.setattr(module, name, function)

    def _replaced(self, current: Fit, label: str, *rest: object) -> tuple[Fit, Fit] | None:
        """Return the fits without an effect and with another one in its place."""
        reduced = self.without.get(label)
        return None if reduced is None or self.replacement is None else (reduced, self.replacement)

    def search(self, data: Any = DATA, **criteria: float) -> EffectSearch:
        """Return a search with changed criteria."""
        changed = dataclasses.replace(CRITERIA, **criteria)  # type: ignore[arg-type]
        return EffectSearch(data, AXIS, changed, self.lines.append)
