"""Reach the verdict: by the fitted runs, then by the held-out ones, against whose error names must hold.

A search decides by the fitted runs, in units of the noise that it estimated. Both may deceive it: a noise
that is too large explains every error, and the best of a few hundred effects removes a part of almost any
error. The errors of the held-out runs, in units of the sensors' noise at rest, depend on neither.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from .criteria import SelectionCriteria
from .drift import less_well_than_by_run
from .error import AS_GOOD, CLEAR, SIZE_OF_VOLTAGES, FitError, nearly_explains
from .unstable_motion import UnstableMotion, largest_grown_error, predictions_explain

Verdict = Literal["effect_found", "no_effect", "unexplained"]


@dataclass(frozen=True)
class VerdictEvidence:
    """Evidence of the held-out runs about the refitted machine (before) and the machine with effects (after).

    Runs that contradict the fitted ones do not count, unless all of them do. A machine whose simulation
    diverges has infinite errors.

    Attributes:
        left: Simulation error with the effects, in multiples of the noise at rest, rms over channels. In a
            log slower than its controller, in multiples of what noise and the unknown voltages between the
            rows cause together; without `stamps_known`, in multiples of what noise and rounding cause.
        left_before: The same without effects.
        motion: Simulation error with the effects relative to the motion, rms over the channels.
        lacking: Missing force of the machine with effects, relative to the force of the drives.
        remaining_prediction: Fraction of the squared error of predictions, beyond the noise at rest, that the
            effects leave. An observer corrects these predictions by the measurements.
        causes_named: Whether the effects act where the force comes from that is missing without them
            (`dependences.agree_with_causes`).
        remaining_fast: The same fraction as `remaining_prediction` with the widest observer, which hides slow
            forces.
        reduction: Actual / expected reduction of the squared prediction error by the effects, dimensionless.
            The expected one, of true effects, is the square of their change of the predictions.
        reduction_std: Standard deviation of `reduction` of true effects, because the error that is left is
            correlated in time. Only for a log slower than its controller.
        reduction_by_chance: Value of `reduction` that effects which do not exist hardly ever reach.
        voltages_known: Whether the log contains all voltages.
        stamps_known: False if no effect is named, more than noise is left, and rounded stamps cause more
            than noise as well (`rounding_counts`).
        predicted: Squared error of predictions / that of an exact machine, which noise and unknown voltages
            or rounded stamps cause: the larger value of the widest observer and the one that judges effects.
            Only where voltages or stamps are not known, if no effect is named.
        unstable: Evidence about the motion if it is unstable; None if it is stable or only noise is left.
    """

    left: float
    left_before: float
    motion: float
    lacking: float
    remaining_prediction: float
    causes_named: bool = False
    voltages_known: bool = True
    stamps_known: bool = True
    remaining_fast: float = math.inf
    reduction: float = 0.0
    reduction_std: float = 0.0
    reduction_by_chance: float = math.inf
    predicted: float = 1.0
    unstable: UnstableMotion | None = None

    @property
    def remaining_simulation(self) -> float:
        """Fraction of the squared simulation error beyond the noise that remains with the effects."""
        return remaining(self.left**2, self.left_before**2, 1.0)

    @property
    def removes_enough(self) -> bool:
        """Whether the effects reduce the squared prediction error by what true effects of their size would.

        The ratio `reduction` must be at least 1 / 1.2. If it exceeds what chance reaches
        (`reduction_by_chance`), its standard deviation is added first.
        """
        short = self.reduction_std if self.reduction >= self.reduction_by_chance else 0.0
        return AS_GOOD * (self.reduction + short) >= 1.0

    @property
    def in_words(self) -> str:
        """The simulation error left on the held-out runs, or that it diverges, as a clause for the report."""
        force = (
            f" and {100 * self.lacking:.2g} % of the drives' force are"
            if 0.0 < self.lacking < math.inf  # 0: less than the noise of the sensors shows
            else " is"
        )
        if not math.isfinite(self.left):
            return "the simulation of the held-out runs diverges"
        unknown = self.unknown_in_words
        cause = f"what noise and {unknown} cause" if unknown else "the noise of the sensors"
        return f"{self.left:.3g} times {cause}{force} left on the held-out runs"

    @property
    def unknown_in_words(self) -> str:
        """What the log does not tell accurately, for the report; empty if it tells all."""
        if not self.voltages_known:
            return "the unknown voltages between the rows"
        return "" if self.stamps_known else "the rounding of the time stamps"


def remaining(after: float, before: float, floor: float) -> float:
    """Return the fraction of a squared error, beyond that of an exact machine, that remains with effects.

    It is (`after` - `floor`) / (`before` - `floor`), where negative differences count as 0.

    Args:
        after: Mean squared error with the effects / noise variance, dimensionless.
        before: The same without them, dimensionless.
        floor: The same of an exact machine, dimensionless.

    Returns:
        Fraction, 0 or more; infinite if the machine with effects diverges, or if it leaves an error where
        there was none.
    """
    left, total = max(after - floor, 0.0), max(before - floor, 0.0)
    if not math.isfinite(left):
        return math.inf
    return 0.0 if left == 0.0 else left / total if total > 0.0 else math.inf


def rounding_counts(changes: float) -> bool:
    """Return whether rounded time stamps count beside the noise: they cause more of a simulation error.

    Args:
        changes: What other times with the same stamps change in the simulation, rms, in multiples of the
            noise, of the sensor with the largest value. More than 1 counts. Infinite if the machine diverges
            at such times: that tells nothing about the error.
    """
    return 1.0 < changes < math.inf


def error_beyond_noise(motion: float, left: float) -> float:
    """Return the largest error that a machine may have beside the noise, relative to the motion.

    The square of the result is the part of the squared error beyond the noise, but at least 1 - 1 / 1.2 of
    the squared error, because the noise is not known more accurately than that.

    Args:
        motion: Root mean square error, noise included, as a fraction of the root mean square motion.
        left: The same error in multiples of the noise, dimensionless.

    Returns:
        Fraction of the motion, dimensionless, at most `motion`.
    """
    part = max(1.0 - 1.0 / left**2, 1.0 - 1.0 / AS_GOOD) if left > 0.0 else 1.0
    return motion * math.sqrt(part)


def contradiction_of_no_effect(evidence: VerdictEvidence, criteria: SelectionCriteria) -> str:
    """Return why the held-out runs contradict the verdict "no_effect", or "" if they do not.

    They contradict it in three cases:

    - The simulation error exceeds twice the noise (`max_noise_ratio_explained`), in a log slower than its
      controller four times what noise and unknown voltages cause, with rounded stamps twice what noise and
      rounding cause, along an unstable motion `largest_grown_error`.
    - Predictions, in which such errors do not add up, are not explained: along an unstable motion by
      `predictions_explain`, in a log slower than its controller or with rounded stamps with 1.5 times
      (`explained_chi2`) the squared error of an exact machine or more.
    - What the noise may hide, `error_beyond_noise`, exceeds 10 % (`max_motion_error`) of the motion.

    Args:
        evidence: What the held-out runs say. The refitted machine, which is the one of this verdict, is taken
            as the machine with effects.
        criteria: Decision thresholds `max_noise_ratio_explained`, `explained_chi2` and `max_motion_error`.

    Returns:
        A clause with the error and its limit, or "".
    """
    motion, left, unstable = evidence.motion, evidence.left, evidence.unstable
    explained = criteria.max_noise_ratio_explained * (1.0 if evidence.voltages_known else SIZE_OF_VOLTAGES)
    if unstable is not None:
        explained = largest_grown_error(unstable, criteria)
    if not evidence.left <= explained:
        allowed = f"; up to {explained:g} times counts as explained" if math.isfinite(evidence.left) else ""
        return f"{evidence.in_words}{allowed}"
    if unstable is not None:
        if not predictions_explain(unstable):
            return (
                "the motion of the held-out runs is unstable, and the squared error of their predictions is "
                f"{unstable.predicted:.3g} times that of an exact machine; "
                f"up to {AS_GOOD:g} times counts as explained"
            )
        motion, left = motion / left, 1.0  # an error that grew hides nothing; the noise may
    if not evidence.predicted < criteria.explained_chi2:
        return (
            f"the squared error of predictions of the held-out runs is {evidence.predicted:.3g} times what "
            f"noise and {evidence.unknown_in_words} cause; "
            f"up to {criteria.explained_chi2:g} times counts as explained"
        )
    beyond = error_beyond_noise(motion, left)
    if not beyond <= criteria.max_motion_error:
        return (
            "the error is at the noise of the sensors, but that may hide "
            f"{100 * beyond:.2g} % of the motion: too much to tell whether an effect is missing"
        )
    return ""


def fault_of_fitted_runs(error: FitError, left: float, criteria: SelectionCriteria) -> str:
    """Return why a machine without effects explains the held-out runs, but not the fitted ones.

    The held-out runs are explained if they leave at most twice the noise (`max_noise_ratio_explained`). The
    fitted ones are not if their chi-squared per sample is at least 1.5 (`explained_chi2`), or if they need
    the widest observer, which hides forces of any size.

    Args:
        error: Error of the fitted runs with the most likely observer.
        left: Simulation error of the held-out runs, in multiples of the noise, rms over channels.
        criteria: Decision thresholds `max_noise_ratio_explained` and `explained_chi2`.

    Returns:
        A clause; "" if the held-out runs have an error as well, or the fitted runs have none.
    """
    if not left <= criteria.max_noise_ratio_explained:
        return ""
    held_out = f"the held-out runs are explained ({left:.3g} times the noise), but the fitted runs are not"
    observer = f"with an observer of {error.bandwidth:.3g} rad/s" if error.bandwidth else "in simulation"
    if not nearly_explains(error, criteria):
        return (
            f"{held_out}: their chi-squared per sample is {error.chi2:.3g} {observer}, "
            f"and up to {criteria.explained_chi2:g} counts as explained"
        )
    if not error.widest:
        return ""
    return (
        f"{held_out}: only predictions {observer} follow them, which hides forces of any size, and their "
        f"simulation leaves more than {criteria.max_noise_ratio_explained:g} times the noise"
    )


def contradiction_of_names(evidence: VerdictEvidence, explained: bool, criteria: SelectionCriteria) -> str:
    """Return why the held-out runs do not permit naming the effects, or "" if they do.

    Names are permitted in three cases:

    - The simulation leaves no more than twice the noise (`max_noise_ratio_explained`).
    - The rest has another cause, and the effects remove what effects of their size must (`removes_enough`).
      The other cause is unknown voltages if the fitted runs are explained; otherwise it is a slow force,
      beside effects that act where the missing force comes from and leave no more than 25 %
      (`max_partial_excess`) of the error with the widest observer.
    - They leave a small fraction of the squared prediction error. If the fitted runs are explained, this is
      half, and the same fraction in simulation suffices unless the motion is unstable. Otherwise it is 25 %
      if the effects act where the missing force comes from, else 3 % (`max_remaining`).

    Args:
        evidence: Evidence of the held-out runs.
        explained: Whether the machine with effects explains the fitted runs, at the noise and the observer of
            the fit.
        criteria: Decision thresholds `max_noise_ratio_explained`, `max_remaining` and `max_partial_excess`.

    Returns:
        A clause with the remaining error and its limit, or "".
    """
    if evidence.left <= criteria.max_noise_ratio_explained:
        return ""
    # In a simulation, errors of a force add up, so that the parameters that are fitted beside a wrong effect
    # may reduce its error many times; the error of predictions counts. But of a machine that nearly fits, an
    # observer hides much. Along an unstable motion, a simulation errs by chance.
    measured = evidence.remaining_prediction
    if explained and evidence.unstable is None:
        measured = min(measured, evidence.remaining_simulation)
    # What has another cause may leave more than the effects remove: the unknown voltages of a slow log, whose
    # size is known within a factor of four only, or a slow force beside effects that leave little of what is
    # fast. The effects hold if they remove as much as they must: of one that imitates a part of the error,
    # less is seen elsewhere.
    if explained:
        other_cause = not evidence.voltages_known
    else:
        other_cause = evidence.causes_named and evidence.remaining_fast <= criteria.max_partial_excess
    if other_cause and evidence.removes_enough:
        return ""
    # Of a real machine, a tenth of the error may remain whatever is added. Effects that are its main causes
    # hold all the same; a wrong effect that imitates a cause acts elsewhere, or depends on another variable.
    partial = criteria.max_partial_excess if evidence.causes_named else criteria.max_remaining
    limit = (
        1.0 / CLEAR if explained else partial
    )  # this holds where the noise of the fit was estimated too large
    if measured <= limit:
        return ""
    return (
        f"{100 * min(measured, 1.0):.3g} % of the squared error remain with the effects "
        f"({evidence.in_words}); effects are named if at most {100 * limit:.2g} % remain"
    )


# Bandwidth of the observer with which the held-out runs judge effects, rad/s: slow enough to show what a
# missing force does over some tenths of a second, fast enough that its errors do not add up over the run
# (synthetic rigs).
JUDGING_BANDWIDTH = 15.0


@dataclass(frozen=True)
class PartialEvidence:
    """Errors of the machine with effects and of the refitted machine, in units of the noise.

    Attributes:
        wide: Errors with the widest observer, which hides slow ones: with effects, without.
        simulated: Chi-squared per sample of the simulation: with effects, without.
    """

    wide: tuple[FitError, FitError]
    simulated: tuple[float, float]


def explains_most(evidence: PartialEvidence, criteria: SelectionCriteria) -> bool:
    """Return whether effects remove most of the error beyond the noise: they leave less than 25 % of it.

    It suffices that one of two errors falls below this fraction (`max_partial_excess`): the excess with the
    widest observer, or the root mean square error beyond the noise in simulation.

    Args:
        evidence: Errors with and without effects.
        criteria: Decision threshold `max_partial_excess`.
    """
    wide, wide_before = (error.excess for error in evidence.wide)
    error, error_before = (math.sqrt(max(chi2 - 1.0, 0.0)) for chi2 in evidence.simulated)
    limit = criteria.max_partial_excess
    return wide < limit * wide_before or error < limit * error_before


def verdict_of_effects(
    any_effect: bool, drift: str, explained: Callable[[], bool]
) -> tuple[Verdict, str] | None:
    """Return the verdict on effects of the library, unless a table may still change it.

    Args:
        any_effect: Whether effects passed all tests.
        drift: Name of a parameter that differs from run to run, which these effects imitate; "" if there is
            none.
        explained: Function that returns whether the machine with the effects explains the data.

    Returns:
        With a drift, "unexplained" and the reason why the effects are removed (a clause that follows "it ");
        `explained` is then not called. If the machine explains the data, "effect_found" or, without effects,
        "no_effect", and "". Else None: a table may explain the error.
    """
    if drift:
        return "unexplained", less_well_than_by_run(drift)
    if explained():
        return ("effect_found" if any_effect else "no_effect"), ""
    return None


def verdict_of_rest(
    any_effect: bool,
    runs_differ: Callable[[], bool],
    voltages_may_cause: bool,
    evidence: Callable[[], PartialEvidence],
    criteria: SelectionCriteria,
) -> tuple[Verdict, str]:
    """Return the verdict if neither effects nor a table explain the data, and why the effects are removed.

    "effect_found" with "" if there are effects, separate values in each run do not explain the runs, and
    either unknown voltages may cause the rest or the effects remove most of the error (`explains_most`).
    Otherwise "unexplained" with the reason for removing the effects, a clause that follows "it ".

    Args:
        any_effect: Whether effects passed all tests.
        runs_differ: Function that returns whether another value of a parameter in each run explains the runs,
            as no effect can.
        voltages_may_cause: Whether unknown voltages between the rows may cause all that is left. The held-out
            runs then test the effects by what they remove.
        evidence: Function that returns the errors with and without effects.
        criteria: Decision threshold `max_partial_excess`.
    """
    if any_effect and not runs_differ() and (voltages_may_cause or explains_most(evidence(), criteria)):
        return "effect_found", ""
    return "unexplained", "leaves most of the error, also together with the other effects"


def verdict_after_removal(verdict: Verdict, any_effect: bool, refitted_explains: bool) -> Verdict:
    """Return the verdict after the held-out runs have removed effects.

    Args:
        verdict: Verdict of the search, which stays if effects are left.
        any_effect: Whether effects are left.
        refitted_explains: Whether the refitted machine explains the fitted runs. Without effects, the verdict
            is then "no_effect", else "unexplained".
    """
    if any_effect:
        return verdict
    return "no_effect" if refitted_explains else "unexplained"


def final_verdict(verdict: Verdict, *, any_effect: bool) -> Verdict:
    """Return the verdict of the report: "effect_found" in place of "no_effect" if a sensor saturates.

    Args:
        verdict: Verdict of the search and of the held-out runs, which does not count saturated sensors as
            effects.
        any_effect: Whether the corrected machine has effects, those of saturated sensors included.
    """
    return "effect_found" if any_effect and verdict == "no_effect" else verdict
