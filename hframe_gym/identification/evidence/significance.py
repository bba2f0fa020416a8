"""Significance of an effect: the evidence for and against it that `judge.effect` asks for.

An effect that reduces the error may still not exist. Measured here are its gain in runs to which it was not
fitted (leave-one-run-out), the gain that chance may explain, its force and the one that remains unexplained.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache, cached_property, partial

import numpy as np

from ...machine import AppliedEffect, Machine
from ...preparation.dataset import Dataset
from ..fit.covariance import with_uncertainty
from ..fit.cross_validation import leave_one_out_gain, refitted_leave_one_out_gain
from ..fit.estimation import Fit
from ..fit.long_run_variance import long_run_variance
from ..fit.model_error import continue_fit, fit_with_model_error, has_narrowest_observer, narrower_observer
from ..fit.slow_logs import fit_by_instruments
from ..fit.start_estimation import refine_dataset
from ..forces.force_sizes import effect_force, force_difference, residue_force
from ..forces.missing_force import follow_runs, sensor_combinations
from ..judge import effect as judge
from ..judge.criteria import SelectionCriteria
from ..judge.effect import (
    Addition,
    Chance,
    Disagreement,
    EffectEvidence,
    Forces,
    SizeByFit,
)
from ..predict.prediction import SEARCH_BANDWIDTH
from .effect_parameters import parameter_values, sizes
from .effect_variables import depend_on_same_variable
from .plausibility import plausibility_fault
from .unknown_voltages import cost_beside_voltages


class TestedFit:
    """Fit of a machine with variants of it (other observers, other voltages) that tests of effects need.

    Each variant is computed when it is first needed, and once for all effects.

    Attributes:
        fitted: The fit.
        data: Runs that were fitted.
    """

    __test__ = False  # no test of pytest

    def __init__(self, fitted: Fit, data: Dataset) -> None:
        self.fitted, self.data = fitted, data

    @cached_property
    def narrower(self) -> Fit:
        """Fit of the same machine with the observer of the next smaller bandwidth (`narrower_observer`)."""
        return narrower_observer(self.fitted, self.data)

    @cached_property
    def wide(self) -> Fit:
        """Fit of the same machine with the observer of the largest bandwidth, 60 rad/s."""
        return continue_fit(self.fitted, self.data, SEARCH_BANDWIDTH)

    @cached_property
    def by_instruments(self) -> Fit | None:
        """Fit of the same machine by instrumental variables (`slow_logs.fit_by_instruments`).

        None if the voltages are held, or if the fit does not converge.
        """
        return fit_by_instruments(self.fitted, self.data)

    @cached_property
    def deviations(self) -> dict[str, float]:
        """Standard deviations of the effects' amplitudes in `fitted`, SI, by name@site.parameter."""
        return _deviations(self.fitted, self.data)

    @cached_property
    def wide_deviations(self) -> dict[str, float]:
        """Standard deviations of the effects' amplitudes in the fit `wide`, SI, by name@site.parameter."""
        return _deviations(self.wide, self.data)

    @cached_property
    def likeliest(self) -> Fit:
        """Fit with the observer under which the data are most likely (`fit_with_model_error`)."""
        return fit_with_model_error(self.fitted, self.data)

    @cached_property
    def cost_beside_voltages(self) -> float:
        """Cost, dimensionless, that remains after unknown voltages between the rows explain what they can."""
        return cost_beside_voltages(self.fitted, self.data)


def doubt_about_candidate(
    current: TestedFit, trial: Fit, criteria: SelectionCriteria, effect: AppliedEffect | None = None
) -> str:
    """Return why an effect that a search just added may not exist, or "" if it passes the tests.

    The evidence is collected from the fits; the rule is `judge.effect.doubt_about_candidate`.

    Args:
        current: Fit of the machine without the effect.
        trial: Fit of the machine with the effect. Both fits have the same observer bandwidth.
        criteria: Decision thresholds of the rule.
        effect: The effect. Default: the last one of the machine.

    Returns:
        Clause that follows "it ", such as "is not confirmed by runs that it was not fitted to".
    """
    effect = effect or trial.machine.effects[-1]
    evidence = effect_evidence(current, TestedFit(trial, current.data), effect)
    return judge.doubt_about_candidate(evidence, criteria)


def doubt_beside_others(
    reduced: Fit, complete: TestedFit, effect: AppliedEffect, criteria: SelectionCriteria
) -> str:
    """Return why an effect of a machine may not exist beside all others, or "" if it passes all tests.

    The evidence is collected from the fits; the rule is `judge.effect.doubt_beside_others`.

    Args:
        reduced: Fit of the machine with all other effects.
        complete: Fit of the machine with all effects. Both fits have the same observer bandwidth.
        effect: The effect.
        criteria: Decision thresholds of the rule.

    Returns:
        Clause that follows "it ", such as "has no effect on the error".
    """
    without = TestedFit(reduced, complete.data)
    return judge.doubt_beside_others(effect_evidence(without, complete, effect), criteria)


def effect_evidence(reduced: TestedFit, tested: TestedFit, effect: AppliedEffect) -> EffectEvidence:
    """Collect the evidence of the fitted runs for an effect, as the rules of `judge.effect` need it.

    What takes long is given as functions, which compute it when a rule calls them.

    Args:
        reduced: Fit of the machine without the effect.
        tested: Fit of the machine with the effect, at the same observer bandwidth.
        effect: The effect with its fitted parameters.
    """
    without, with_effect, data = reduced.fitted, tested.fitted, tested.data
    held = data.updates == 1

    def narrower() -> Chance:
        return _chance(reduced.narrower, tested.narrower, effect, data)

    def beside_voltages() -> float:
        return reduced.cost_beside_voltages - tested.cost_beside_voltages

    return EffectEvidence(
        without=without.error,
        with_effect=with_effect.error,
        forceless=_is_forceless(effect),
        confirmed=lambda: leave_one_out_gain(without, with_effect, data),
        confirmed_accurate=partial(refitted_leave_one_out_gain, without, with_effect, data),
        fault=lambda: plausibility_fault(with_effect.machine),
        chance=cache(lambda: _chance(without, with_effect, effect, data)),  # two tests need it
        chance_narrower=None if has_narrowest_observer(with_effect, data) else narrower,
        forces=lambda: _forces(without, with_effect, effect, data),
        forces_accurate=lambda: _forces_at_likeliest(without, tested, effect),
        additions=lambda: _additions(without, with_effect, effect, data),
        parameters=parameter_values(effect.label, with_effect),
        disagreement=_disagreement_of_sensors(without, with_effect, effect, data),
        beside_voltages=None if held else beside_voltages,
        sizes_by_observer=None
        if held or with_effect.error.widest
        else lambda: _sizes_by_observer(tested, effect.label),
        sizes_by_instruments=None if held else lambda: _sizes_by_instruments(tested, effect.label),
    )


def _deviations(fitted: Fit, data: Dataset) -> dict[str, float]:
    """Return the standard deviations of the sizes of all effects, by full name."""
    machine = with_uncertainty(fitted, data)
    return {
        f"{effect.label}.{size.name}": size.std
        for effect in machine.effects
        for size in sizes(effect, machine)
    }


def _sizes_by_observer(tested: TestedFit, label: str) -> list[SizeByFit]:
    """Return the sizes of an effect with the observer of the fit, and with the widest one."""

    def std(name: str) -> float:
        both = (tested.deviations, tested.wide_deviations)
        return math.hypot(*(by_name.get(name, math.inf) for by_name in both))

    return _sizes(tested.fitted, tested.wide, label, std)


def _sizes_by_instruments(tested: TestedFit, label: str) -> list[SizeByFit]:
    """Return the sizes of an effect by least squares, and by instruments; none if these find nothing.

    Where both fits are right, the variance of their difference is the difference of their variances, because
    least squares are the better of both (Hausman). That of the instruments is its limit.
    """
    found = tested.by_instruments
    if found is None:
        return []
    deviations = cache(lambda: _deviations(found, tested.data))
    return _sizes(tested.fitted, found, label, lambda name: deviations().get(name, math.inf))


def _sizes(fitted: Fit, other: Fit, label: str, std: Callable[[str], float]) -> list[SizeByFit]:
    """Return the sizes of an effect in two fits, and a function for their difference's standard deviation."""
    here, there = (next(e for e in f.machine.effects if e.label == label) for f in (fitted, other))
    fitted_names = {free.name for free in fitted.free}
    return [
        SizeByFit(
            p.name, here.parameters[p.name], there.parameters[p.name], partial(std, f"{label}.{p.name}")
        )
        for p in here.definition.parameters
        if p.amplitude and f"{label}.{p.name}" in fitted_names
    ]


def _chance(without: Fit, with_effect: Fit, effect: AppliedEffect, data: Dataset) -> Chance:
    """Return the gain of an effect and the variance that the residual has in its direction."""
    return Chance(without.cost - with_effect.cost, long_run_variance(with_effect, effect.label, data))


def _disagreement_of_sensors(
    without: Fit, with_effect: Fit, effect: AppliedEffect, data: Dataset
) -> Callable[[], Disagreement] | None:
    """Return measures of the sensors' disagreement without and with an error of one, if others see it."""
    machine = with_effect.machine
    if effect.definition.site != "sensor":
        return None
    combinations = sensor_combinations(machine, data)
    if not combinations[machine.output_channels.index(effect.site)].any():
        return None

    combined = combinations.any(axis=1)

    def squares(machine: Machine) -> float:
        # With its own zeros of the encoders: an error of a laser changes where the runs start.
        total, refined = 0.0, refine_dataset(data, machine)
        for run, followed in zip(refined.runs, follow_runs(machine, refined), strict=True):
            complete = np.isfinite(run.outputs[:, combined]).all(axis=1)
            total += float(np.sum((followed.innovation[complete] @ combinations) ** 2))
        return total

    return lambda: Disagreement(squares(without.machine), squares(with_effect.machine))


def _is_forceless(effect: AppliedEffect) -> bool:
    """Return whether an effect exerts no force on coordinates: it adds some, or changes the clock."""
    return bool(effect.definition.structure or effect.definition.clock)


def _forces(without: Fit, with_effect: Fit, effect: AppliedEffect, data: Dataset) -> Forces:
    """Return the force of an effect and the force that remains unexplained beside it, N."""
    if _is_forceless(effect):
        return _taken_force(without, with_effect, data)
    return Forces(effect_force(with_effect.machine, effect, data), residue_force(with_effect, data))


def _taken_force(without: Fit, with_effect: Fit, data: Dataset, *, accurate: bool = False) -> Forces:
    """Return what an effect takes from the unexplained force, and what remains, N.

    Args:
        accurate: Whether the noise of the motion counts where that at rest is less (`residue_force`).
    """
    residue = residue_force(with_effect, data)
    taken = math.sqrt(max(residue_force(without, data) ** 2 - residue**2, 0.0))
    return Forces(taken, residue_force(with_effect, data, noise_of_motion=True) if accurate else residue)


def _forces_at_likeliest(without: Fit, tested: TestedFit, effect: AppliedEffect) -> Forces:
    """Return the forces at the most likely observer; noise of the motion is no force that remains."""
    likeliest, data = tested.likeliest, tested.data
    if not _is_forceless(effect):
        return _forces(without, likeliest, effect, data)
    if likeliest.bandwidth != without.bandwidth:  # both of what one observer corrects
        without = continue_fit(without, data, likeliest.bandwidth)
    return _taken_force(without, likeliest, data, accurate=True)


def _additions(without: Fit, with_effect: Fit, effect: AppliedEffect, data: Dataset) -> Iterator[Addition]:
    """Return what an effect adds to each effect of another family that depends on the same variable.

    A clock corrects other effects, but none corrects the clock, which has no force that could be in error.
    """
    machine = with_effect.machine
    for other in machine.effects:
        if (
            other.definition.family != effect.definition.family
            and not other.definition.clock
            and depend_on_same_variable(effect, other, machine)
        ):
            # The force beyond what the parameters of the machine and of the other effect can represent.
            added = (
                _forces(without, with_effect, effect, data).effect
                if effect.definition.clock
                else force_difference(without.machine, machine, data)
            )
            yield Addition(other.label, added / max(effect_force(machine, other, data), 1e-12))
