"""Judge trials: which candidates of the search are worth a fit, and when the search goes on.

These rules save time. Where they decide wrongly, a true effect is not tried; no false one is named.
"""

from __future__ import annotations

from dataclasses import dataclass

from .criteria import SelectionCriteria
from .error import CLEAR, FitError, nearly_explains, only_noise_is_left, unexplained_fraction


def least_promise(enough: float, count: float, best: float, criteria: SelectionCriteria) -> float:
    """Return the linearized reduction of the cost, dimensionless, that makes a candidate worth a fit.

    Args:
        enough: Reduction of chi-squared per sample that the search requires, dimensionless.
        count: Number of measured values, dimensionless.
        best: Largest linearized reduction of the cost by a candidate, dimensionless; 0 without candidates.
        criteria: Decision thresholds `linear_gain_ratio` and `min_promise`.
    """
    return max(criteria.linear_gain_ratio * enough * count, criteria.min_promise * best)


def promises_enough_force(size: float, residue: float, criteria: SelectionCriteria) -> bool:
    """Return whether a candidate's force may exceed the force that would remain unexplained.

    Args:
        size: Linearized force of the candidate, N.
        residue: Force that remains unexplained, N.
        criteria: Decision threshold `min_promised_force_ratio`.
    """
    return size >= criteria.min_promised_force_ratio * residue


def explains_alone(error: FitError, best: FitError | None, criteria: SelectionCriteria) -> bool:
    """Return whether the best trial explains the data, so that only its possible rivals are fitted.

    Args:
        error: Error of the fit without the trial's effect.
        best: Error of the best trial, of the same observer; None without trials.
        criteria: Decision threshold `rival_remainder`.
    """
    return unexplained_fraction(error, best) < criteria.rival_remainder


def may_be_rival(promise: float, explaining: float, criteria: SelectionCriteria) -> bool:
    """Return whether a candidate may be a rival of the candidate that explains the data.

    Args:
        promise: Linearized reduction of the cost by the candidate, dimensionless.
        explaining: Linearized reduction by the candidate that explains the data, dimensionless; 0 if there is
            none.
        criteria: Decision threshold `rival_promise`.
    """
    return promise > criteria.rival_promise * explaining


def may_replace(promise: float, gain: float, criteria: SelectionCriteria) -> bool:
    """Return whether another effect may explain as much as the one that is removed.

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

    Args:
        error: Error of the present fit.
        criteria: Decision threshold `explained_chi2`.
        any_trial: Whether a candidate was promising at the present parameters.
        parameter_at_limit: Whether a parameter of the fit is at its limit.
    """
    return parameter_at_limit or (not any_trial and error.chi2 > criteria.explained_chi2)


def least_structural_promise(useful: float, enough: float, criteria: SelectionCriteria) -> float:
    """Return the linearized gain, dimensionless, above which a structural effect is fitted.

    A structural effect replaces a part of the model. If no other effect is useful, every candidate may be
    needed, because the linearization underestimates their gain.

    Args:
        useful: Best gain of a trial with another effect, chi-squared per sample, dimensionless.
        enough: Gain that the search requires, chi-squared per sample, dimensionless.
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
    """Return whether to try structural effects (replacing a part of the model): others leave much error.

    Their simulations must first be compiled. After an unsuccessful attempt, the error must have become
    clearly smaller. They are not tried for an excess below the least gain of an effect either.

    Args:
        evidence: The present errors, and those at the last trial.
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
    """Return whether to continue the fit of a trial: its first iterations gain enough of what is required.

    Args:
        error: Error without the effect.
        trial: Error of the trial.
        enough: Required gain, chi-squared per sample, dimensionless.
        criteria: Decision threshold `min_trial_gain`.
    """
    return not trial.cost > largest_useful_cost(error, enough, criteria)


def largest_useful_cost(error: FitError, enough: float, criteria: SelectionCriteria) -> float:
    """Return the cost of a trial, dimensionless, above which its fit is not continued.

    Args:
        error: Error without the effect.
        enough: Required gain, chi-squared per sample, dimensionless.
        criteria: Decision threshold `min_trial_gain`.
    """
    return error.cost - criteria.min_trial_gain * enough * error.count


def gives_way(gain: float, best_other: float) -> bool:
    """Return whether to put a trial with a parameter at its limit behind trials without such a parameter.

    Its effect would be removed at the end (`judge.effect.parameter_at_limit`); until then, it would hide what
    another effect explains. But while other effects are missing, a true effect may be at a limit as well, and
    explain far more.

    Args:
        gain: Reduction of the cost by the trial, dimensionless.
        best_other: Largest reduction by a trial without such a parameter, dimensionless.
    """
    return CLEAR * best_other > gain


def search_goes_on(
    error: FitError, selected: int, criteria: SelectionCriteria, *, noise_known: bool = True
) -> bool:
    """Return whether to search for another effect: more than noise is left, and more effects are allowed.

    Args:
        error: Error with the effects selected up to now.
        selected: Number of selected effects.
        criteria: Decision thresholds `max_effects` and `min_gain`.
        noise_known: Whether the size of the noise is known, so that an error of that size has no other cause.
            The errors of voltages between the rows of a log are known within a factor of four only.
    """
    return selected < criteria.max_effects and not (noise_known and only_noise_is_left(error, criteria))


def is_worth_searching_pairs(error: FitError, selected: int, criteria: SelectionCriteria) -> bool:
    """Return whether to search for two effects that reduce the error only together.

    It is not worth it if the selected effects nearly explain the data: a pair that fits the small rest may
    not exist.

    Args:
        error: Error with the effects selected up to now.
        selected: Number of selected effects.
        criteria: Decision thresholds `explained_chi2` and `max_effects`.
    """
    return not nearly_explains(error, criteria) and selected + 2 <= criteria.max_effects


def is_worth_comparing_rivals(error: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether to compare rivals before the next step, because a wrong effect may be the only fault."""
    return not error.simulated and nearly_explains(error, criteria)


def is_worth_narrower_observer(wider: FitError, simulated: FitError, criteria: SelectionCriteria) -> bool:
    """Return whether to search for effects with the next smaller observer bandwidth, at last in simulation.

    The model must nearly explain the data with the present observer, while much error is left in simulation.
    An error of a sensor that changes over the whole travel, for example, is too slow for all observers.

    Args:
        wider: Error with the present observer.
        simulated: Error of the same machine in simulation.
        criteria: Decision threshold `explained_chi2`.
    """
    return not wider.simulated and wider.chi2 < criteria.explained_chi2 <= simulated.chi2
