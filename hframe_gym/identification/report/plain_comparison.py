"""Compare the machine of the search with a plain fit of inertia and friction, and deliver no worse one.

Where the search names nothing, the remaining error of complete runs is described beside the better of both.
"""

from __future__ import annotations

import dataclasses

from ..budget import Budget
from ..evidence.tried_effects import Log
from ..fit.estimation import prediction_cost
from ..fit.plain_fit import PlainFit, equally_weighted, refined_equally
from ..judge.verdict import description_helps, is_worse_than_plain, needs_description
from ..predict.prediction import SIMULATION
from ..search.description import describe_remainder
from .evaluation import Evaluated, without_names
from .recording_simulation import ModelEvaluation, error_ratio
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
    evaluated: Evaluated, plain: PlainFit | None, log: Log, budget: Budget
) -> tuple[PlainResult | None, Evaluated, str]:
    """Compare the outcome with the plain fit on the held-out runs, and deliver no machine that predicts them worse.

    Args:
        evaluated: Outcome of a search with its machines.
        plain: Plain fit to the fitted runs, if there is one.
        log: Called with a line of text.
        budget: Budget of the identification, of which a description may use a part.

    Returns:
        The plain fit with its errors, the outcome that is delivered, and a sentence about what replaced the machine of
        the search; "" if that predicts the held-out runs at least as well.
    """
    if plain is None:
        return None, evaluated, ""
    outcome, test = evaluated.outcome, evaluated.test
    reference = test.errors(plain.machine.replace(name=f"{test.machine.name}-plain"), outcome.data)

    def is_worse(model: ModelEvaluation) -> bool:
        return is_worse_than_plain(error_ratio(model, reference), model.held_out.noise_ratio, test.criteria)

    result = PlainResult(reference, plain.terms)
    log(f"plain fit: {reference.held_out.noise_ratio:.4g} times the noise on the held-out runs")
    if not test.machine.belts:
        base = reference if is_worse(evaluated.before) else evaluated.before
        described = _described(evaluated, plain, base, log, budget)
        if described is not None:
            return result, *described
    if not is_worse(evaluated.after):
        return result, evaluated, ""
    if outcome.selected:  # their parameters were fitted to short predictions
        after = refined_equally(outcome.after, outcome.data)
        selected = tuple(s.with_values(after.machine) for s in outcome.selected)
        again = test.evaluate(outcome._replace(after=after, selected=selected))
        if not is_worse(again.after):
            return result, again, _REFINED
    sentence = _PLAIN_DELIVERED.format(
        error_ratio(evaluated.after, reference), ", ".join(plain.terms) or "none"
    )
    log(sentence)
    outcome = without_names(outcome, _WORSE_THAN_PLAIN) if outcome.selected else outcome
    delivered = test.evaluate(outcome._replace(after=plain.simulated))
    return dataclasses.replace(result, delivered=True), delivered, sentence


def _described(
    evaluated: Evaluated, plain: PlainFit, base: ModelEvaluation, log: Log, budget: Budget
) -> tuple[Evaluated, str] | None:
    """Return an outcome without names whose machine describes what is left, and a sentence about it.

    None if effects are named, only noise is left, or the held-out runs are predicted no better than by `base`, the
    machine without a description.
    """
    outcome, test = evaluated.outcome, evaluated.test
    left = evaluated.after.held_out.noise_ratio
    if not needs_description(outcome.verdict, len(outcome.selected), left, test.criteria):
        return None
    refit = refined_equally(outcome.before, outcome.data)
    equal = equally_weighted(outcome.data)
    start = min(
        (plain.simulated, refit), key=lambda fitted: prediction_cost(fitted.machine, equal, SIMULATION)
    )
    found = describe_remainder(start, outcome.data, test.criteria, log, budget)
    if found is None:
        return None
    fitted, labels = found
    again = test.evaluate(outcome._replace(after=fitted))
    ratio = error_ratio(again.after, base)
    log(f"described by {', '.join(labels)}: {ratio:.3g} times the error on the held-out runs")
    return (again, _DESCRIPTION.format(", ".join(labels), ratio)) if description_helps(ratio) else None
