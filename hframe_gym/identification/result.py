"""identify's answer: the verdict and its evidence, as data and as report.json."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from ..machine import Machine
from .dataset import Dataset
from .experiment_design import ExperimentDesign
from .forward_selection import SelectedEffect
from .residual import ChannelError, Dependence

Verdict = Literal["effect_found", "no_effect", "unexplained"]
SCHEMA = 1


@dataclass(frozen=True)
class PredictionErrors:
    """Free-run error per output channel, and the relative force error where the machine has one."""

    channels: dict[str, ChannelError]
    force: float | None

    def as_json(self) -> dict[str, Any]:
        content: dict[str, Any] = {c: {"rmse": e.rmse, "noise_ratio": e.noise_ratio} for c, e in self.channels.items()}
        return content if self.force is None else content | {"force_error": self.force}


@dataclass(frozen=True)
class ModelEvaluation:
    """A machine and its error on the runs that nothing was fitted to."""

    machine: Machine
    held_out: PredictionErrors


@dataclass(frozen=True)
class IdentificationResult:
    """What `identify` found out.

    declared: the machine as given; before: its own parameters refitted; after: with the effects.  gains: by effect, the
    share of the held-out squared error (in noise units) that leaving it out would add.  experiment: the run that would
    tell the leading effect from its rival, where one would.
    """

    verdict: Verdict
    declared: ModelEvaluation
    before: ModelEvaluation
    after: ModelEvaluation
    found: tuple[SelectedEffect, ...]
    gains: dict[str, float]
    dependence: tuple[Dependence, ...]
    white: bool
    fitted: Dataset
    held_out: Dataset
    seconds: float
    experiment: ExperimentDesign | None = None

    def as_json(self) -> dict[str, Any]:
        """report.json, schema 1."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "runs": {"fitted": [r.name for r in self.fitted.runs], "held_out": [r.name for r in self.held_out.runs]},
            "declared": {"held_out": self.declared.held_out.as_json()},
            "before": {"held_out": self.before.held_out.as_json()},
            "after": {"held_out": self.after.held_out.as_json()},
            "effects": [self._effect(f) for f in self.found],
            "residual": {
                "depends_on": [
                    {"variable": d.variable, "coordinate": d.coordinate, "share": round(d.share, 4)}
                    for d in self.dependence
                ],
                "white": self.white,
            },
            "next_experiment": self.experiment.as_json() if self.experiment else None,
            "seconds": round(self.seconds, 2),
        }

    def _effect(self, found: SelectedEffect) -> dict[str, Any]:
        machine, effect = self.after.machine, found.effect
        parameters = {}
        for key, value in effect.parameters.items():
            std = machine.uncertainty.std(f"{effect.label}.{key}") if machine.uncertainty else None
            parameters[key] = {"value": value, "std": std, "unit": machine.effect_unit(effect, key)}
        return {
            "name": effect.name,
            "family": effect.definition.family,
            "site": effect.site,
            "parameters": parameters,
            "held_out_gain": self.gains[effect.label],
            "rivals": list(found.rivals),
        }
