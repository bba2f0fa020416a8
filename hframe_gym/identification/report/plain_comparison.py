"""Compare the machine of the search with a plain fit of inertia and friction, and deliver no worse one.

Where the search names nothing, the remaining error of complete runs is described beside the better of both.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from ...machine import Machine
from ...preparation.sensor_properties import Range
from ...recordings import Recording
from ..budget import Budget
from ..evidence.tried_effects import Log
from ..fit.estimation import prediction_cost
from ..fit.plain_fit import PlainFit, equally_weighted, refined_equally
from ..judge.criteria import SelectionCriteria
from ..judge.verdict import description_helps, is_worse_than_plain, needs_description
from ..predict.prediction import SIMULATION
from ..search.description import describe_remainder
from .evaluation import Evaluated, evaluate, without_names
from .recording_simulation import ModelEvaluation, error_ratio, evaluate_held_out
from .result import PlainResult

_REFINED = (
    "The parameters were fitted again in simulation, because the plain fit of inertia and friction predicted the "
    "held-out runs better."
)
_WORSE_THAN_PLAIN = "predicts the held-out runs worse than a plain fit of inertia and friction"
_PLAIN_DELIVERED = (
    "The machine that is delivered is the plain fit of inertia and friction, because that of the search has {:.3g} "
    "times its error on the held-out runs; terms beside them: {}."
)
_DESCRIPTION = (
    "The machine that is delivered describes the remaining error by {}. They are no causes: other effects with similar "
    "forces might describe these runs as well. With them, the error on the held-out runs is {:.3g} times that without."
)


def at_least_plain(
    evaluated: Evaluated,
    plain: PlainFit | None,
    machine: Machine,
    ranges: dict[str, Range],
    recordings: Sequence[Recording],
    criteria: SelectionCriteria,
    log: Log,
    budget: Budget,
) -> tuple[PlainResult | None, Evaluated, str]:
    """Compare the outcome with the plain fit on the held-out runs, and deliver no machine that predicts them worse.

    Args:
        evaluated: Outcome of a search with its machines.
        plain: Plain fit to the fitted runs, if there is one.
        machine: Machine as declared.
        ranges: Ranges of the sensors that saturate, m or rad, by channel.
        recordings: All recordings as measured.
        criteria: Thresholds of the identification.
        log: Called with a line of text.
        budget: Budget of the identification, of which a description may use a part.

    Returns:
        The plain fit with its errors, the outcome that is delivered, and a sentence about what replaced the machine of
        the search; "" if that predicts the held-out runs at least as well.
    """
    if plain is None:
        return None, evaluated, ""
    outcome, validation = evaluated.outcome, evaluated.validation

    def errors_of(candidate: Machine) -> ModelEvaluation:
        return evaluate_held_out(candidate, outcome.data, validation, recordings, criteria)

    def is_worse(after: ModelEvaluation) -> bool:
        return is_worse_than_plain(error_ratio(after, reference), after.held_out.noise_ratio, criteria)

    reference = errors_of(plain.machine.replace(name=f"{machine.name}-plain"))
    result = PlainResult(reference, plain.terms)
    log(f"plain fit: {reference.held_out.noise_ratio:.4g} times the noise on the held-out runs")
    if not machine.belts:
        described = _described(
            evaluated, plain, reference, machine, ranges, recordings, criteria, log, budget
        )
        if described is not None:
            return result, *described
    if not is_worse(evaluated.after):
        return result, evaluated, ""
    if outcome.selected:  # their parameters were fitted to short predictions
        after = refined_equally(outcome.after, outcome.data)
        selected = tuple(s.with_values(after.machine) for s in outcome.selected)
        refined = outcome._replace(after=after, selected=selected)
        again = evaluate(refined, machine, ranges, validation, recordings, criteria)
        if not is_worse(again.after):
            return result, again, _REFINED
    sentence = _PLAIN_DELIVERED.format(
        error_ratio(evaluated.after, reference), ", ".join(plain.terms) or "none"
    )
    log(sentence)
    outcome = without_names(outcome, _WORSE_THAN_PLAIN) if outcome.selected else outcome
    outcome = outcome._replace(after=plain.simulated)
    delivered = evaluate(outcome, machine, ranges, validation, recordings, criteria)
    return dataclasses.replace(result, delivered=True), delivered, sentence


def _described(
    evaluated: Evaluated,
    plain: PlainFit,
    reference: ModelEvaluation,
    machine: Machine,
    ranges: dict[str, Range],
    recordings: Sequence[Recording],
    criteria: SelectionCriteria,
    log: Log,
    budget: Budget,
) -> tuple[Evaluated, str] | None:
    """Return an outcome without names whose machine describes what is left, and a sentence about it.

    None if effects are named, only noise is left, or the held-out runs are predicted no better with a description.
    """
    outcome = evaluated.outcome
    if not needs_description(outcome.verdict, len(outcome.selected), evaluated.after.held_out.noise_ratio):
        return None
    refit = refined_equally(outcome.before, outcome.data)
    equal = equally_weighted(outcome.data)
    start = min(
        (plain.simulated, refit), key=lambda fitted: prediction_cost(fitted.machine, equal, SIMULATION)
    )
    found = describe_remainder(start, outcome.data, criteria, log, budget)
    if found is None:
        return None
    fitted, labels = found
    plain_is_better = is_worse_than_plain(
        error_ratio(evaluated.before, reference), evaluated.before.held_out.noise_ratio, criteria
    )
    again = evaluate(
        outcome._replace(after=fitted), machine, ranges, evaluated.validation, recordings, criteria
    )
    ratio = error_ratio(again.after, reference if plain_is_better else evaluated.before)
    log(f"described by {', '.join(labels)}: {ratio:.3g} times the error on the held-out runs")
    return (again, _DESCRIPTION.format(", ".join(labels), ratio)) if description_helps(ratio) else None
