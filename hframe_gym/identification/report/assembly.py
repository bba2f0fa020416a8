"""Collect the result of an identification: machines, effects, gains, causes of what is left, next experiment."""

from __future__ import annotations

import dataclasses

from ...preparation.dataset import Dataset
from ..evidence.held_out import error_reduction, held_out_gain, is_excited
from ..evidence.tried_effects import ConsideredEffect
from ..fit.force_sizes import drive_force, effect_force
from ..fit.residual import Dependence, white_sensors
from ..fit.start_estimation import refine_dataset
from ..judge.verdict import final_verdict
from ..propose.dependences import rank_dependences
from .evaluation import Evaluated
from .experiment_design import design_discriminating_experiment
from .result import Hint, IdentificationResult, PlainResult, RejectedEffect, Unfinished

_UNEXCITED = (
    "The held-out runs do not excite {}: the gain on them says nothing, and only the fitted runs confirm it. Hold out "
    "other runs with --hold-out for an independent test."
)
_MAX_NEAREST = 3  # Effects that a hint lists as the nearest of the library.
_MAX_DEPENDENCES = 6  # Variables that the report lists for the residual force.


def build_result(
    evaluated: Evaluated, reason: str, unfinished: Unfinished | None, plain: PlainResult | None
) -> IdentificationResult:
    """Collect the result of an evaluated outcome, and propose an experiment.

    Args:
        evaluated: The outcome with its machines and their errors.
        reason: Why the held-out runs contradict the verdict of the search; "" if they do not.
        unfinished: What the search did when its budget ended; None if it is complete.
        plain: Plain fit with its errors, if there is one.
    """
    outcome, selected, refined = evaluated.outcome, evaluated.selected, evaluated.refined
    before, after, data = outcome.before, outcome.after, outcome.data
    corrected = evaluated.after.machine
    experiments = (
        design_discriminating_experiment(after, corrected, s.effect.label, s.rival_effects, refined)
        for s in selected
    )
    validation = refine_dataset(evaluated.test.validation, corrected, data)
    drives = drive_force(corrected, data)
    result = IdentificationResult(
        verdict=final_verdict(outcome.verdict, any_effect=bool(selected)),
        declared=evaluated.declared,
        before=evaluated.before,
        after=evaluated.after,
        effects=selected,
        gains={s.effect.label: held_out_gain(s, corrected, validation, after.bandwidth) for s in selected},
        considered=tuple(_rejected(c, data, validation, after.bandwidth) for c in outcome.considered),
        sizes={s.effect.label: effect_force(corrected, s.effect, data) / drives for s in selected},
        dependence=tuple(rank_dependences(before.machine, data)[:_MAX_DEPENDENCES]),
        white=bool(white_sensors(corrected, validation).all()),
        fitted=data,
        held_out=validation,
        seconds=0.0,
        experiment=next(filter(None, experiments), None),
        criteria=evaluated.test.criteria,
    )
    return dataclasses.replace(result, reason=reason, hint=_hint(result), unfinished=unfinished, plain=plain)


def _hint(result: IdentificationResult) -> Hint | None:
    """Return where the missing force acts and on what it depends, and the nearest effects, if none is named.

    If single sensors deviate although others would show an error of the motion, the first of them is the component.
    """
    if result.verdict != "unexplained" or not result.dependence:
        return None
    strongest: Dependence = result.dependence[0]
    component = strongest.component or next(iter(result.after.deviating_sensors), strongest.coordinate)
    nearest = sorted(result.considered, key=lambda entry: -entry.held_out_gain)
    labels = dict.fromkeys(entry.effect.label for entry in nearest if entry.held_out_gain > 0.0)
    return Hint(component, strongest.variable, strongest.explained, tuple(labels)[:_MAX_NEAREST])


def _rejected(
    entry: ConsideredEffect, data: Dataset, validation: Dataset, bandwidth: float
) -> RejectedEffect:
    """Return a rejected effect with its size and its gain on the held-out runs."""
    return RejectedEffect(
        entry.effect,
        effect_force(entry.machine, entry.effect, data) / drive_force(entry.machine, data),
        error_reduction(entry.machine_without, entry.machine, validation, bandwidth),
        entry.reason,
    )


def unexcited_effects(result: IdentificationResult, bandwidth: float) -> tuple[str, ...]:
    """Return a sentence about the effects on which the held-out runs do not depend; only fitted runs confirm them.

    Args:
        result: Result of an identification.
        bandwidth: Bandwidth of the observer of the final fit, rad/s; 0 for a simulation.
    """
    machine = result.after.machine
    effects = [
        s.effect.label for s in result.effects if not is_excited(s, machine, result.held_out, bandwidth)
    ]
    return (_UNEXCITED.format(", ".join(effects)),) if effects else ()
