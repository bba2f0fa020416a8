"""Compare the machine of the search with a plain fit of inertia and friction, and deliver no worse one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from ...machine import Machine
from ...preparation.sensor_properties import Range
from ...recordings import Recording
from ..evidence.tried_effects import Log
from ..fit.plain_fit import PlainFit, refined_equally
from ..judge.criteria import SelectionCriteria
from ..judge.verdict import is_worse_than_plain
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


def at_least_plain(
    evaluated: Evaluated,
    plain: PlainFit | None,
    machine: Machine,
    ranges: dict[str, Range],
    recordings: Sequence[Recording],
    criteria: SelectionCriteria,
    log: Log,
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

    Returns:
        The plain fit with its errors, the outcome that is delivered, and a sentence about what replaced the machine of
        the search; "" if that predicts the held-out runs at least as well.
    """
    if plain is None:
        return None, evaluated, ""
    outcome, validation = evaluated.outcome, evaluated.validation

    def errors_of(candidate: Machine) -> ModelEvaluation:
        return evaluate_held_out(candidate, outcome.data, validation, recordings, criteria)

    reference = errors_of(plain.machine.replace(name=f"{machine.name}-plain"))
    result = PlainResult(reference, plain.terms)
    log(f"plain fit: {reference.held_out.noise_ratio:.4g} times the noise on the held-out runs")
    if not is_worse_than_plain(error_ratio(evaluated.after, reference)):
        return result, evaluated, ""
    if outcome.selected:  # their parameters were fitted to short predictions
        after = refined_equally(outcome.after, outcome.data)
        selected = tuple(s.with_values(after.machine) for s in outcome.selected)
        refined = outcome._replace(after=after, selected=selected)
        again = evaluate(refined, machine, ranges, validation, recordings, criteria)
        if not is_worse_than_plain(error_ratio(again.after, reference)):
            return result, again, _REFINED
    sentence = _PLAIN_DELIVERED.format(error_ratio(evaluated.after, reference), ", ".join(plain.terms) or "none")
    log(sentence)
    outcome = without_names(outcome, _WORSE_THAN_PLAIN) if outcome.selected else outcome
    outcome = outcome._replace(before=plain.simulated, after=plain.simulated)
    delivered = evaluate(outcome, machine, ranges, validation, recordings, criteria)
    return dataclasses.replace(result, delivered=True), delivered, sentence
