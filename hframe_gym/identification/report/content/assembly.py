"""Collect the result of an identification: machines, effects, gains, causes of the rest, next experiment."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from ....machine import Machine
from ....preparation.dataset import Dataset
from ....preparation.runs.excerpt import NORMAL_SESSION, representative_part
from ...budget import Budget
from ...evidence.held_out import error_reduction, held_out_gain, is_excited
from ...evidence.tried_effects import ConsideredEffect, SelectedEffect
from ...fit.channel_errors import white_sensors
from ...fit.covariance import with_uncertainty
from ...fit.estimation import Fit
from ...fit.run_differences import RunDifferencesInWords
from ...fit.slow_logs import deviations_of_fits
from ...fit.start_estimation import refine_dataset
from ...forces.force_sizes import drive_force, effect_force
from ...judge.verdict import final_verdict
from ...predict.voltage_errors import simulation_error
from ...propose.causes import CONSTANT
from ...propose.dependences import Dependence, rank_dependences
from ...search.checked_search import CheckedOutcome
from ...validate.simpler_machines import Delivered
from ..diagnostics.experiment_design import design_discriminating_experiment
from .document import Hint, UnknownVoltages
from .result import IdentificationResult, RejectedEffect, Unfinished

_UNEXCITED = (
    "The held-out runs do not excite {}: the gain on them says nothing, and only the fitted runs confirm it. "
    "Hold out other runs with --hold-out for an independent test."
)
_MAX_NEAREST = 3  # Effects that a hint lists as the nearest of the library.
_MAX_DEPENDENCES = 6  # Variables that the report lists for the residual force.


def build_result(
    delivered: Delivered,
    found: CheckedOutcome,
    remarks: tuple[str, ...],
    differences: RunDifferencesInWords,
    budget: Budget,
    *,
    unstable: bool,
    rounded: bool = False,
) -> IdentificationResult:
    """Collect the result of what an identification delivers, and propose an experiment.

    The uncertainty of the parameters, the sizes of the effects and their gains on the held-out runs are
    computed here. The experiment is the run that would distinguish an effect from its rival, for the first
    effect with such a run.

    Args:
        delivered: The outcome with its machines and their errors.
        found: Outcome of the search, with the held-out runs that contradict the fitted ones.
        remarks: What the user should know about the runs, one sentence each.
        differences: Differences between the runs. If they explain the error, no variables are listed on which
            the missing force depends, because these would only reflect the differences.
        budget: Budget of the identification; its end shortens the estimate of the uncertainty.
        unstable: Whether an unstable motion causes the remaining simulation error.
        rounded: Whether rounded time stamps may cause it.
    """
    evaluated = delivered.evaluated
    outcome, selected = evaluated.outcome, evaluated.selected
    before, after, data = outcome.before, outcome.after, outcome.data
    refined_data = refine_dataset(data, after.machine)
    with budget.limiting(delivers=True):
        deviations = deviations_of_fits(after, refined_data)
    uncertain = with_uncertainty(after, refined_data, deviations=deviations)
    corrected = evaluated.after.machine.replace(uncertainty=uncertain.uncertainty)
    experiments = (  # designed one after the other until there is one
        design_discriminating_experiment(after, corrected, s.effect.label, s.rival_effects, refined_data)
        for s in selected
    )
    held_out = evaluated.held_out
    part = representative_part(data, before.machine, size=budget.session_part * NORMAL_SESSION)
    force_of_drives = drive_force(corrected, data)
    unfinished = (
        Unfinished(outcome.unfinished, budget.reason, budget.interrupted) if outcome.unfinished else None
    )
    result = IdentificationResult(
        verdict=final_verdict(outcome.verdict, any_effect=bool(selected)),
        declared=evaluated.declared,
        before=evaluated.before,
        after=dataclasses.replace(evaluated.after, machine=corrected),
        effects=selected,
        gains={s.effect.label: held_out_gain(s, corrected, held_out, after.bandwidth) for s in selected},
        considered=tuple(_rejected(c, data, held_out, after.bandwidth) for c in outcome.considered),
        sizes={s.effect.label: effect_force(corrected, s.effect, data) / force_of_drives for s in selected},
        dependence=() if differences.explain else _dependences_on_variables(before.machine, part),
        white=bool(white_sensors(corrected, held_out).all()),
        fitted=data,
        held_out=held_out,
        seconds=0.0,  # `identify` states the time, which includes this function
        experiment=next(filter(None, experiments), None),
        criteria=evaluated.test.criteria,
        excluded=(
            *remarks,
            *differences.sentences,
            *_unexcited_effects(selected, corrected, held_out, after.bandwidth),
            *found.messages,
        ),
        contradicting=found.differing,
        reason=evaluated.reason,
        unfinished=unfinished,
        plain=delivered.plain,
        unknown_voltages=_unknown_voltages(corrected, held_out, after),
        unstable=unstable,
        rounded_stamps=rounded,
    )
    return dataclasses.replace(result, hint=_hint(result))


def _dependences_on_variables(machine: Machine, data: Dataset) -> tuple[Dependence, ...]:
    """Return the variables on which the missing force depends; a constant force is a part of their curves."""
    ranked = rank_dependences(machine, data)
    return tuple([d for d in ranked if d.variable != CONSTANT][:_MAX_DEPENDENCES])


def _unknown_voltages(machine: Machine, held_out: Dataset, fitted: Fit) -> UnknownVoltages | None:
    """Return what the log does not say of the voltages, and which fit is delivered."""
    if not held_out.has_voltage_errors:
        return None
    errors = simulation_error(machine, held_out)
    by_channel = {s.channel: float(e) for s, e in zip(machine.sensors, errors, strict=True)}
    return UnknownVoltages(
        commands=machine.commands_in_words,
        changes_per_row=held_out.updates,
        period_s=held_out.period / held_out.updates,
        errors=by_channel,
        fitted_by="white residual" if fitted.covariance is None else "instruments",
    )


def _hint(result: IdentificationResult) -> Hint | None:
    """Return where the missing force acts and on what it depends, and the nearest effects, if none is named.

    If single sensors deviate although others would show an error of the motion, the first of them is the
    component.
    """
    if result.verdict != "unexplained" or not result.dependence:
        return None
    strongest: Dependence = result.dependence[0]
    component = strongest.component or next(iter(result.deviating_sensors), strongest.coordinate)
    nearest = sorted(result.considered, key=lambda entry: -entry.held_out_gain)
    labels = dict.fromkeys(entry.effect.label for entry in nearest if entry.held_out_gain > 0.0)
    return Hint(
        component=component,
        variable=strongest.variable,
        share=round(strongest.explained, 4),
        nearest=list(labels)[:_MAX_NEAREST],
    )


def _rejected(entry: ConsideredEffect, data: Dataset, held_out: Dataset, bandwidth: float) -> RejectedEffect:
    """Return a rejected effect with its force over that of the drives, and its gain on the held-out runs."""
    return RejectedEffect(
        entry.effect,
        effect_force(entry.machine, entry.effect, data) / drive_force(entry.machine, data),
        error_reduction(entry.machine_without, entry.machine, held_out, bandwidth),
        entry.reason,
    )


def _unexcited_effects(
    selected: Sequence[SelectedEffect], machine: Machine, held_out: Dataset, bandwidth: float
) -> tuple[str, ...]:
    """Return a sentence about the effects on which held-out runs do not depend: fitted ones confirm them."""
    effects = [s.effect.label for s in selected if not is_excited(s, machine, held_out, bandwidth)]
    return (_UNEXCITED.format(", ".join(effects)),) if effects else ()
