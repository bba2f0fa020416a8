"""Judge trials: which candidates of the search are worth a fit, and when the search goes on.

These rules save time. Where they decide wrongly, a true effect is not tried; no false one is named.
"""

from __future__ import annotations

from dataclasses import dataclass

from .criteria import SelectionCriteria
from .error import CLEAR, FitError, nearly_explains, only_noise_is_left, unexplained_fraction


def least_promise(enough: float, count: float, best: float, criteria: SelectionCriteria) -> float:
    """Return the promise of a candidate, the linearized reduction of the cost, from which on it is fitted.

    It is the larger of 60 % (`linear_gain_ratio`) of the required reduction and 40 % (`min_promise`) of the
    best candidate's promise, dimensionless.

    Args:
        enough: Reduction of chi-squared per sample that an effect must reach, dimensionless.
        count: Number of measured values, dimensionless.
        best: Largest promise of a candidate, dimensionless; 0 without candidates.
        criteria: Decision thresholds `linear_gain_ratio` and `min_promise`.
    """
    return max(criteria.linear_gain_ratio * enough * count, criteria.min_promise * best)


def promises_enough_force(size: float, residue: float, criteria: SelectionCriteria) -> bool:
    """Return whether a candidate's force is at least half of the one that would remain unexplained.

    Args:
        size: Root mean square force of the candidate, by a linearization, N.
        residue: Root mean square force that remains unexplained, N.
        criteria: Decision threshold `min_promised_force_ratio`, the half.
    """
    return size >= criteria.min_promised_force_ratio * residue


def explains_alone(error: FitError, best: FitError | None, criteria: SelectionCriteria) -> bool:
    """Return whether the best trial explains the data, so that only its possible rivals are fitted besides.

    It does if it leaves less than 20 % (`rival_remainder`) of the excess.

    Args:
        error: Error of the fit without the trial's effect.
        best: Error of the best trial, of the same observer; None without trials.
        criteria: Decision threshold `rival_remainder`.
    """
    return unexplained_fraction(error, best) < criteria.rival_remainder


def may_be_rival(promise: float, explaining: float, criteria: SelectionCriteria) -> bool:
    """Return whether a candidate promises more than 80 % (`rival_promise`) of the one that explains the data.

    Only then is it fitted as a possible rival.

    Args:
        promise: Linearized reduction of the cost by the candidate, dimensionless.
        explaining: Linearized reduction by the candidate that explains the data, dimensionless; 0 if there is
            none.
        criteria: Decision threshold `rival_promise`.
    """
    return promise > criteria.rival_promise * explaining


def may_replace(promise: float, gain: float, criteria: SelectionCriteria) -> bool:
    """Return whether an effect promises at least 60 % (`linear_gain_ratio`) of what a removed one explains.

    Args:
        promise: Linearized reduction of the cost by the other effect, without the removed one, dimensionless.
        gain: Reduction of the cost by the removed effect, dimensionless.
        criteria: Decision threshold `linear_gain_ratio`.
    """
    return not promise < criteria.linear_gain_ratio * gain


def may_be_local_minimum(
    error: FitError, criteria: SelectionCriteria, *, any_trial: bool, parameter_at_limit: bool
) -> bool:
    """Return whether to try candidates from the declared parameters too, in case of a local minimum.

    It may if a parameter is at its limit, or if chi-squared per sample is above 1.5 (`explained_chi2`) and no
    candidate is worth a fit.

    Args:
        error: Error of the present fit.
        criteria: Decision threshold `explained_chi2`.
        any_trial: Whether a candidate was worth a fit at the present parameters.
        parameter_at_limit: Whether a parameter of the fit is at its limit.
    """
    return parameter_at_limit or (not any_trial and error.chi2 > criteria.explained_chi2)


def least_structural_promise(useful: float, enough: float, criteria: SelectionCriteria) -> float:
    """Return the promise from which on an effect that replaces a part of the model is fitted.

    A promise is here the linearized reduction of chi-squared per sample, dimensionless. The result is the
    larger of the required reduction and 10 % (`min_structural_promise`) of the best other trial's; 0, so that
    all are fitted, if no other trial reaches the required reduction, because a linearization underestimates
    the gain of such effects.

    Args:
        useful: Largest reduction of chi-squared per sample by a trial with another effect, dimensionless.
        enough: Reduction of chi-squared per sample that an effect must reach, dimensionless.
        criteria: Decision threshold `min_structural_promise`.
    """
    return max(enough, criteria.min_structural_promise * useful) if useful >= enough else 0.0


@dataclass(frozen=True)
class StructureEvidence:
    """Evidence for the decision to try structural effects, which replace a part of the model.

    Attributes:
        error: Error of the present fit.
        best: Smallest error of a trial with another effect; None without trials.
        best_remembers: Whether this trial adds a force with memory; friction with memory, a structure, is
            similar.
        failed_bandwidth: Bandwidth at which structures were last tried in vain, rad/s; not a number if never.
        failed_excess: Excess of the error at that time.
    """

    error: FitError
    best: FitError | None
    best_remembers: bool
    failed_bandwidth: float
    failed_excess: float


def is_worth_structures(evidence: StructureEvidence, criteria: SelectionCriteria) -> bool:
    """Return whether to try effects that replace a part of the model, which must be compiled first.

    They are not tried if they were tried in vain with the same observer and the excess has not fallen to 0.67
    (`structural_retry`) of its value then. Otherwise they are tried if the best other trial adds a force with
    memory, or if it leaves more than half (`structural_remainder`) of an excess above 0.01 (`min_gain`).

    Args:
        evidence: The present errors, and those at the last trial of such effects.
        criteria: Decision thresholds `structural_retry`, `structural_remainder` and `min_gain`.
    """
    error = evidence.error
    if (
        error.bandwidth == evidence.failed_bandwidth
        and error.excess > criteria.structural_retry * evidence.failed_excess
    ):
        return False
    if evidence.best_remembers:
        return True
    left = unexplained_fraction(error, evidence.best)
    return left > criteria.structural_remainder and error.excess > criteria.min_gain


def is_worth_convergence(
    error: FitError, trial: FitError, enough: float, criteria: SelectionCriteria
) -> bool:
    """Return whether to continue the fit of a trial after its first iterations.

    It is if the cost is at most `largest_useful_cost`.

    Args:
        error: Error without the effect.
        trial: Error of the trial after these iterations.
        enough: Reduction of chi-squared per sample that an effect must reach, dimensionless.
        criteria: Decision threshold `min_trial_gain`.
    """
    return not trial.cost > largest_useful_cost(error, enough, criteria)


def largest_useful_cost(error: FitError, enough: float, criteria: SelectionCriteria) -> float:
    """Return the cost of a trial after its first iterations, dimensionless, above which its fit ends.

    Up to it, the trial has reached half (`min_trial_gain`) of the required reduction.

    Args:
        error: Error without the effect.
        enough: Reduction of chi-squared per sample that an effect must reach, dimensionless.
        criteria: Decision threshold `min_trial_gain`.
    """
    return error.cost - criteria.min_trial_gain * enough * error.count


def gives_way(gain: float, best_other: float) -> bool:
    """Return whether to put a trial with a parameter at its limit behind the trials without one.

    It gives way if one of these reduces the cost by more than half of what it does. Its effect would be
    removed at the end (`judge.effect.parameter_at_limit`), and hide until then what another effect explains.
    Where it explains far more, it may be a true effect, whose parameter moves when the missing effects are
    found.

    Args:
        gain: Reduction of the cost by the trial, dimensionless.
        best_other: Largest reduction by a trial without such a parameter, dimensionless.
    """
    return CLEAR * best_other > gain


def search_goes_on(
    error: FitError, selected: int, criteria: SelectionCriteria, *, noise_known: bool = True
) -> bool:
    """Return whether to search for another effect.

    It goes on while fewer than five effects (`max_effects`) are selected and more than noise is left
    (`only_noise_is_left`).

    Args:
        error: Error with the effects selected up to now.
        selected: Number of selected effects.
        criteria: Decision thresholds `max_effects` and `min_gain`.
        noise_known: Whether the size of the noise is known. If not, the error is not compared with it: what
            unknown voltages between the rows of a log cause is known within a factor of four only.
    """
    return selected < criteria.max_effects and not (noise_known and only_noise_is_left(error, criteria))


def is_worth_searching_pairs(error: FitError, selected: int, criteria: SelectionCriteria) -> bool:
    """Return whether to search for two effects that reduce the error only together.

    It is if chi-squared per sample is at least 1.5 (`explained_chi2`) and two more effects are allowed. A
    pair that fits a smaller rest may not exist.

    Args:
        error: Error with the effects selected up to now.
        selected: Number of selected effects.
        criteria: Decision thresholds `explained_chi2` and `max_effects`.
    """
    return not nearly_explains(error, criteria) and selected + 2 <= criteria.max_effects


def is_worth_comparing_rivals(error: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether to compare the selected effects with their rivals before the next step of the search.

    It is if the error with an observer (not in simulation) has a chi-squared per sample below 1.5
    (`explained_chi2`): a rival in place of a wrong effect may then remove the rest.
    """
    return not error.simulated and nearly_explains(error, criteria)


def is_worth_narrower_observer(wider: FitError, simulated: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether to search for effects with the next smaller observer bandwidth, at last in simulation.

    Chi-squared per sample must be below 1.5 (`explained_chi2`) with the present observer, but not in
    simulation. An error of a sensor that changes over the complete travel, for example, is too slow for all
    observers.

    Args:
        wider: Error with the present observer; if this is a simulation, the result is False.
        simulated: Error of the same machine in simulation.
        criteria: Decision threshold `explained_chi2`.
    """
    return not wider.simulated and wider.chi2 < criteria.explained_chi2 <= simulated.chi2
