"""The result of an identification, and its conversion to the content of report.json."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ....errors import merge_run_warnings
from ....machine import METERS, AppliedEffect
from ....preparation.dataset import Dataset
from ...evidence.tried_effects import SelectedEffect
from ...fit.channel_errors import errors_by_channel
from ...forces.force_sizes import drive_force
from ...judge.criteria import SelectionCriteria
from ...judge.verdict import Verdict
from ...predict.prediction import observer_gains
from ...propose.dependences import Dependence
from ...validate.machine_errors import ModelEvaluation, PredictionErrors
from ...validate.simpler_machines import PlainResult
from ..diagnostics.experiment_design import FILE, ExperimentDesign
from ..diagnostics.inseparable_parameters import inseparable_parameters
from ..diagnostics.parameter_diagnostics import parameters_at_limit, undeclared_friction
from ..diagnostics.slow_changes import slow_change
from . import document


@dataclass(frozen=True)
class RejectedEffect:
    """An effect that reduces the error of the fitted runs but failed a test.

    Attributes:
        effect: The effect with the parameters of its trial fit.
        size: Force of the effect relative to that of the drives, root mean squares over the fitted runs;
            infinite if no force describes it.
        held_out_gain: Fraction of the squared prediction error on the held-out runs that the effect removes;
            negative if it increases the error.
        reason: Why it was rejected; a clause that follows "it ".
    """

    effect: AppliedEffect
    size: float
    held_out_gain: float
    reason: str


def _finite_or_none(value: float) -> float | None:
    """Return None for a value that JSON cannot hold."""
    return value if math.isfinite(value) else None


def _percent(ratio: float | None) -> float | None:
    """Return a ratio in percent; None if it is not known."""
    return None if ratio is None else _finite_or_none(100.0 * ratio)


class Unfinished(NamedTuple):
    """A search that ended before it was complete.

    Attributes:
        stage: Activity of the search when it ended, in words.
        reason: Why it ended, in words.
        interrupted: Whether the user ended it.
    """

    stage: str
    reason: str
    interrupted: bool = False


@dataclass(frozen=True)
class IdentificationResult:
    """Result of `identify`.

    Attributes:
        verdict: "effect_found", "no_effect" (the refitted machine explains the data) or "unexplained" (an
            error remains that no effect explains).
        declared: The machine as declared.
        before: The machine with its parameters refitted.
        after: The machine with the selected effects.
        effects: Selected effects.
        gains: Fraction of the squared error on the held-out runs that each effect removes, by label
            (name@site); negative if the effect increases the error.
        sizes: Force of each effect relative to that of the drives, root mean squares, by label; infinite if
            no force describes the effect.
        considered: Effects that reduced the error of the fitted runs but failed a test.
        dependence: Variables that the residual force of the refitted machine depends on, strongest first.
        white: Whether the machine with the selected effects leaves only the sensors' noise.
        fitted: Runs that were fitted.
        held_out: Runs that nothing was fitted to.
        seconds: Duration of the identification, s.
        experiment: Run that would distinguish the leading effect from its rival, where there is one.
        criteria: Decision thresholds that were used.
        excluded: One sentence for each run that was not used, or that was held out and contradicts the fitted
            ones.
        contradicting: Names of the held-out runs that contradict the fitted ones.
        reason: Why the held-out runs do not permit another verdict than "unexplained", in words with numbers;
            "" if the search itself found no explanation, or one was found.
        hint: What the missing force depends on, if no effect is named and it depends on something.
        unfinished: What the search was doing when its budget ended; None if it is complete.
        plain: Plain fit of inertia and friction, for comparison; None if the runs permit none.
        unknown_voltages: What the log does not say of the voltages; None if it contains all of them.
        unstable: Whether an unstable motion is the cause of the simulation error that is left.
        rounded_stamps: Whether rounded time stamps may be this cause.
    """

    verdict: Verdict
    declared: ModelEvaluation
    before: ModelEvaluation
    after: ModelEvaluation
    effects: tuple[SelectedEffect, ...]
    gains: dict[str, float]
    sizes: dict[str, float]
    considered: tuple[RejectedEffect, ...]
    dependence: tuple[Dependence, ...]
    white: bool
    fitted: Dataset
    held_out: Dataset
    seconds: float
    experiment: ExperimentDesign | None = None
    criteria: SelectionCriteria = field(default_factory=SelectionCriteria)
    excluded: tuple[str, ...] = ()
    contradicting: tuple[str, ...] = ()
    reason: str = ""
    hint: document.Hint | None = None
    unfinished: Unfinished | None = None
    plain: PlainResult | None = None
    unknown_voltages: document.UnknownVoltages | None = None
    unstable: bool = False
    rounded_stamps: bool = False

    @property
    def explained(self) -> float:
        """Fraction of squared error beyond noise, on held-out runs, that effects remove; 0 without effects.

        It is negative if they increase the error, and NaN if a simulation diverges.
        """
        before, after = (max(e.held_out.noise_ratio**2 - 1.0, 0.0) for e in (self.before, self.after))
        return 0.0 if not self.effects or before <= 0.0 else 1.0 - after / before  # NaN if one diverges

    @property
    def left(self) -> float:
        """Ratio of simulation error to noise on the held-out runs, rms over the channels; 1: noise alone.

        It is NaN if the simulation diverges.
        """
        return self.after.held_out.noise_ratio

    @property
    def left_in_others(self) -> float:
        """The ratio `left` over the held-out runs that do not contradict the fitted ones.

        It is NaN if all contradict them, or if the simulation diverges.
        """
        errors = [error for name, error in self.after.errors.items() if name not in self.contradicting]
        channels = errors_by_channel(errors, self.after.machine, self.held_out.noise) if errors else {}
        return PredictionErrors(channels, None).noise_ratio

    @property
    def evaluations(self) -> dict[str, ModelEvaluation]:
        """Machines with their errors, by the names "declared", "before" (refitted), "after" (delivered)."""
        return dict(zip(document.STAGES, (self.declared, self.before, self.after), strict=True))

    @property
    def deviating_sensors(self) -> tuple[str, ...]:
        """Sensors that alone deviate from the delivered machine, while others agree with it.

        For an unexplained error, the refitted machine is used, because a description of the error would hide
        its origin.
        """
        return (self.before if self.verdict == "unexplained" else self.after).deviating_sensors

    @property
    def limit_warnings(self) -> tuple[str, ...]:
        """Warnings about parameters of the delivered machine at a limit, one sentence each."""
        return tuple(parameters_at_limit(self.after.machine, self.declared.machine).values())

    @property
    def slow_changes(self) -> tuple[str, ...]:
        """Notes on effects whose time constant the runs are too short to show, one sentence each."""
        changes = (slow_change(s.effect, self.after.machine) for s in self.effects)
        return tuple(change.describe() for change in changes if change)

    @property
    def divergence_warnings(self) -> tuple[str, ...]:
        """Warnings about the declared, refitted or delivered machine if it diverges on a held-out run.

        They are one sentence for each such machine, which names the runs.
        """
        models = (("declared", self.declared), ("refitted", self.before), ("corrected", self.after))
        why = (
            "less than the recorded voltage acts (amplifier limit, emergency stop, "
            "wrong scale), or masses are wrong"
        )
        text = f"The simulation of the {{}} machine diverges on {{}}, so it has no error: {why}."
        return tuple(
            text.format(stage, ", ".join(model.diverged)) for stage, model in models if model.diverged
        )

    @property
    def run_warnings(self) -> tuple[str, ...]:
        """Warnings about runs that were not used and about uncertain initial states, one sentence each."""
        fitted = [(run.name, w) for run in self.fitted.runs for w in run.initial.warnings]
        return (*self.excluded, *merge_run_warnings([*fitted, *self.after.warnings]))

    @property
    def notes(self) -> tuple[str, ...]:
        """All warnings of this class in one sequence: at limits, slow changes, divergence, runs."""
        return (*self.limit_warnings, *self.slow_changes, *self.divergence_warnings, *self.run_warnings)

    def as_json(self) -> dict[str, Any]:
        """Return the content of report.json as plain data: numbers, text, lists, dictionaries."""
        return self.as_report().as_json()

    def as_report(self) -> document.Report:
        """Return the content of report.json, except what `write_result` adds: warnings, formulas, origin."""
        # Forces are compared only if all machines have them.
        with_force = all(e.held_out.force is not None for e in self.evaluations.values())
        declared, before, after = (
            document.Evaluation(
                held_out=_errors(evaluation.held_out, with_force=with_force),
                **_missing_force(evaluation, self.held_out),
            )
            for evaluation in self.evaluations.values()
        )
        unfinished, experiment = self.unfinished, self.experiment
        return document.Report(
            schema=document.SCHEMA,
            verdict=self.verdict,
            runs=document.Runs(
                fitted=[r.name for r in self.fitted.runs], held_out=[r.name for r in self.held_out.runs]
            ),
            reason=self.reason,
            unfinished=document.UnfinishedSearch(stage=unfinished.stage, reason=unfinished.reason)
            if unfinished
            else None,
            unknown_voltages=self.unknown_voltages,
            contradicting=list(self.contradicting),
            declared=declared,
            before=before,
            after=after,
            plain=_plain(self.plain, self.held_out) if self.plain else None,
            effects=[self._effect(selected) for selected in self.effects],
            residual=document.Residual(
                depends_on=[
                    document.Dependence(
                        variable=d.variable,
                        coordinate=d.coordinate,
                        component=d.component or d.coordinate,
                        share=round(d.explained, 4),
                    )
                    for d in self.dependence
                ],
                white=self.white,
                sensors=list(self.deviating_sensors),
            ),
            explained=_finite_or_none(self.explained),
            left=_finite_or_none(self.left),
            left_in_others=_finite_or_none(self.left_in_others),
            unstable=self.unstable,
            rounded_stamps=self.rounded_stamps,
            hint=self.hint,
            considered=[_considered(entry) for entry in self.considered],
            not_separable=self._not_separable(),
            undeclared_friction=[
                document.UndeclaredFriction(
                    parameter=friction.name,
                    value=friction.value,
                    std=friction.std,
                    unit=friction.unit,
                    percent_of_drives=_percent(friction.share),
                )
                for friction in undeclared_friction(self.after.machine, self.declared.machine)
            ],
            next_experiment=document.Experiment(
                separates=list(experiment.separates), file=FILE, why=experiment.why
            )
            if experiment
            else None,
            seconds=round(self.seconds, 2),
            criteria=self.criteria.as_json(),
        )

    def _not_separable(self) -> list[document.NotSeparable]:
        """Return the parameters that the data do not separate as in report.json."""
        machine = self.after.machine
        return [
            document.NotSeparable(
                parameters=list(group.names),
                determined=[
                    document.DeterminedSum(**determined._asdict()) for determined in group.determined(machine)
                ],
            )
            for group in inseparable_parameters(machine, self.declared.machine)
        ]

    def _effect(self, selected: SelectedEffect) -> document.Effect:
        """Return one effect as in report.json."""
        machine, effect = self.after.machine, selected.effect
        stds = {
            key: machine.uncertainty.std(f"{effect.label}.{key}") if machine.uncertainty else None
            for key in effect.parameters
        }
        parameters = {
            key: document.ParameterValue(value=value, std=stds[key], unit=machine.effect_unit(effect, key))
            for key, value in effect.parameters.items()
        }
        if change := slow_change(effect, machine):
            parameters[change.parameter].at_least = change.least
        return document.Effect(
            name=effect.name,
            family=effect.definition.family,
            site=effect.site,
            parameters=parameters,
            size=_finite_or_none(self.sizes[effect.label]),
            held_out_gain=self.gains[effect.label],
            rivals=list(selected.rivals),
        )


def _errors(
    errors: PredictionErrors, *, with_force: bool = True
) -> dict[str, document.ChannelErrors | float]:
    """Return the errors of a machine as in report.json."""
    by_channel: dict[str, document.ChannelErrors | float] = {}
    for channel, error in errors.channels.items():
        motion = {} if error.motion_ratio is None else {"percent_of_motion": 100.0 * error.motion_ratio}
        by_channel[channel] = document.ChannelErrors(rmse=error.rmse, noise_ratio=error.noise_ratio, **motion)
    if with_force and errors.force is not None:
        by_channel["force_error"] = errors.force
    return by_channel


def _missing_force(evaluation: ModelEvaluation, held_out: Dataset) -> dict[str, Any]:
    """Return the force that a machine lacks on the held-out runs as in report.json."""
    machine, lacking = evaluation.machine, evaluation.held_out.lacking
    if not observer_gains(machine, held_out.period).any():
        return {"missing_force_percent": None}  # accelerations alone correct no motion
    # A set point is no force; there the ratio only compares machines.
    percent = None if machine.drive_laws else _percent(lacking)
    if lacking is None or not math.isfinite(lacking):
        return {"missing_force_percent": percent}
    unit = machine.axis_unit
    size = lacking * drive_force(machine, held_out) / unit.per_meter
    force = document.Force(value=size, unit="N" if unit is METERS else "Nm")
    return {"missing_force_percent": percent, "missing_force": force}


def _plain(plain: PlainResult, held_out: Dataset) -> document.Plain:
    """Return the plain fit as in report.json."""
    return document.Plain(
        held_out=_errors(plain.evaluation.held_out),
        **_missing_force(plain.evaluation, held_out),
        terms=list(plain.terms),
        delivered=plain.delivered,
    )


def _considered(rejected: RejectedEffect) -> document.Considered:
    """Return a rejected effect as in report.json."""
    return document.Considered(
        name=rejected.effect.name,
        site=rejected.effect.site,
        parameters={name: float(value) for name, value in rejected.effect.parameters.items()},
        size=_finite_or_none(rejected.size),
        held_out_gain=_finite_or_none(rejected.held_out_gain),
        reason=rejected.reason,
    )
