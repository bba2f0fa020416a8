"""Judge an effect: whether it exists, given that it reduces the error of the fitted runs.

The best of some hundred candidates reduces any error somewhat. An effect is therefore doubted unless other
runs confirm it, the machine with it stays physical, neither chance nor another course of the voltages between
the rows explains the reduction, its force exceeds the one that remains unexplained, and it is no correction
to the formula of another effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from .chance import LongRunVariance, chance_deviations, chance_gain, exceeds_chance
from .criteria import SelectionCriteria
from .error import (
    CLEAR,
    FAR,
    FitError,
    Measured,
    is_enough,
    nearly_explains,
    required_gain,
    voltages_may_cause,
)

# Relative distance from a limit of a parameter's range within which a value counts as at the limit. Fits end
# within rounding errors of a limit, or within the tolerance of a logarithmic parameter.
AT_LIMIT = 0.01
# Largest plausible top speed under rated voltage with / without the effects. Even a machine without any
# friction does not reach twice the speed.
LARGEST_SPEED_RATIO = 5.0

BY_CHANCE = "reduces the error by no more than chance may, since the remaining error is correlated in time"
BY_VOLTAGES = "explains little more than chance may beside the voltages between the rows, which are not known"
NO_GAIN = "does not reduce the error of the held-out runs"


@dataclass(frozen=True)
class Chance:
    """A reduction of the cost, and the variance by which to compare it with chance.

    Attributes:
        gain: Reduction of the cost by the effect.
        variance: Variance of the residual in the effect's direction.
    """

    gain: float
    variance: LongRunVariance


@dataclass(frozen=True)
class Forces:
    """Root mean square forces, N.

    Attributes:
        effect: Force of the effect. For an effect without a force at the machine's coordinates: its reduction
            of the unexplained force.
        residue: Force that remains unexplained with the effect.
    """

    effect: float
    residue: float


@dataclass(frozen=True)
class Addition:
    """Force that an effect adds to another effect that depends on the same variable.

    Attributes:
        label: Label of the other effect.
        fraction: Added force / force of the other effect, dimensionless.
    """

    label: str
    fraction: float


@dataclass(frozen=True)
class Disagreement:
    """Disagreement of sensors that measure the same motions: sum of squares in units of their noise.

    Attributes:
        without: Sum without an effect, dimensionless.
        with_effect: Sum with the effect.
    """

    without: float
    with_effect: float


@dataclass(frozen=True)
class ParameterValue:
    """A fitted parameter of an effect with the limits of its range, in the parameter's unit.

    Attributes:
        name: Name of the parameter.
        unit: Its unit.
        value: Fitted value.
        limits: Limits at which the value has no meaning, such as 0.
        covered: Range of values that the motion of the runs can determine, for a width or a rate; otherwise
            None.
        covered_below: Whether the lower end of `covered` is such a limit, too.
        simpler: Name of the simpler effect that the effect is with a value of this parameter, by this value.
    """

    name: str
    unit: str
    value: float
    limits: tuple[float, ...] = ()
    covered: tuple[float, float] | None = None
    covered_below: bool = False
    simpler: Mapping[float, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Size:
    """An amplitude of a delivered effect: a parameter whose value 0 means that the effect is absent.

    Attributes:
        name: Name of the parameter.
        unit: Its unit.
        value: Fitted value, in this unit.
        std: Its standard deviation beside the parameters of the machine and of the other effects, in this
            unit. The effect's other parameters are held, because they mean nothing where the effect is
            absent, and so is a parameter of the machine that it multiplies.
    """

    name: str
    unit: str
    value: float
    std: float


@dataclass(frozen=True)
class SizeByFit:
    """An amplitude of an effect (0: absent), estimated by two fits that should agree.

    Attributes:
        name: Name of the parameter.
        value: Value in the tested fit, in its unit.
        other: Value in a fit that weighs fast errors more, or in one by instrumental variables.
        std: Function that returns the standard deviation of their difference; this takes seconds.
    """

    name: str
    value: float
    other: float
    std: Measured


@dataclass(frozen=True)
class MachineBehavior:
    """How a machine with effects behaves outside the recordings.

    Attributes:
        top_speeds: Function that returns the top speed under random rated voltage with the effects, infinite
            if the machine diverges, and without them, m/s.
        misnamed: Effects (name@site) with a parameter below the least value of what their name says
            (`EffectParameter.named_from`).
    """

    top_speeds: Callable[[], tuple[float, float]]
    misnamed: Sequence[str] = ()


@dataclass(frozen=True)
class EffectEvidence:
    """Evidence of the fitted runs for and against one effect.

    Attributes:
        without: Error without the effect.
        with_effect: Error with the effect.
        forceless: Whether the effect adds coordinates or changes the clock, and therefore has no force at the
            machine's coordinates.
        confirmed: Reduction of the cost in runs to which the effect was not fitted, by a linear model.
        confirmed_accurate: Function of the smallest reduction that confirms the effect. It returns the same
            with a complete fit without each piece, or, if that is less than its argument, an upper limit
            below it.
        fault: Why the machine with the effect is not physical, as `fault_of_machine` says.
        chance: Reduction and long-run variance at the observer of both fits.
        chance_narrower: The same at the next narrower observer; None for a simulation.
        forces: Forces of the effect and of the residue, at the observer of the fits.
        forces_accurate: The same at the most likely observer of the machine with the effect.
        additions: What the effect adds to each effect of another family that depends on the same variable.
        parameters: Its fitted parameters.
        beside_voltages: Reduction of the cost that unknown voltages between the rows cannot explain; None if
            the voltages are held.
        disagreement: Disagreement of the sensors without and with an error of one of them; None if the effect
            is none of a sensor, or no other sensor measures the same motions.
        sizes_by_observer: Amplitudes with the observer of the fits and with the one of largest bandwidth;
            None if the voltages are held, or if both are the same.
        sizes_by_instruments: Amplitudes by least squares and by instrumental variables; empty if the latter
            fail, None if the voltages are held.
    """

    without: FitError
    with_effect: FitError
    forceless: bool
    confirmed: Measured
    confirmed_accurate: Callable[[float], float]
    fault: Callable[[], str]
    chance: Callable[[], Chance]
    chance_narrower: Callable[[], Chance] | None
    forces: Callable[[], Forces]
    forces_accurate: Callable[[], Forces]
    additions: Callable[[], Iterable[Addition]]
    parameters: Sequence[ParameterValue] = ()
    beside_voltages: Measured | None = None
    disagreement: Callable[[], Disagreement] | None = None
    sizes_by_observer: Callable[[], Sequence[SizeByFit]] | None = None
    sizes_by_instruments: Callable[[], Sequence[SizeByFit]] | None = None

    @property
    def gain(self) -> float:
        """Reduction of the cost by the effect, dimensionless; negative if the effect increases it."""
        return self.without.cost - self.with_effect.cost


def enough_gain(error: FitError, criteria: SelectionCriteria, *, voltages_known: bool) -> float:
    """Return the smallest reduction of chi-squared per sample, dimensionless, to select an effect.

    It is `required_gain`, or only `min_gain` if unknown voltages between the rows may cause all of the error
    beyond the noise (`voltages_may_cause`): a true effect then need not remove a fraction of this error.

    Args:
        error: Error without the effect; with it, where the effect is tested beside the others.
        criteria: Decision thresholds `min_gain`, `min_gain_fraction` and `explained_chi2`.
        voltages_known: Whether the log contains all voltages; False if a controller changed them between the
            rows.
    """
    by_voltages = not voltages_known and voltages_may_cause(error, criteria)
    return criteria.min_gain if by_voltages else required_gain(error, criteria)


def doubt_about_candidate(evidence: EffectEvidence, criteria: SelectionCriteria) -> str:
    """Return why an effect that the search just added may not exist; "" if nothing speaks against it.

    These tests are always made, and the first that fails gives the reason: `simpler_effect`,
    `fault_of_machine`, a force as large as the one that remains unexplained (`min_force_ratio`), and no mere
    correction to the formula of another effect (`max_form_error`).

    The statistical tests are added if the machine without the effect has a chi-squared per sample below 1.5
    (`explained_chi2`), or if the effect removes less than `required_gain`: confirmation by runs to which it
    was not fitted, chance, disagreement of the sensors, unknown voltages between the rows, and equal size
    with every observer. Elsewhere missing effects would falsify them; `doubt_beside_others` makes them for
    every effect at the end of the search.

    Args:
        evidence: What the fitted runs say.
        criteria: Decision thresholds.

    Returns:
        Clause that follows "it ", or "".
    """
    large = is_enough(evidence.without, evidence.with_effect, required_gain(evidence.without, criteria))
    return _doubt(evidence, criteria, statistical=not large or nearly_explains(evidence.without, criteria))


def may_be_no_effect(doubt: str) -> bool:
    """Return whether a doubt, `BY_CHANCE` or `BY_VOLTAGES`, says that there may be no cause at all.

    All other doubts leave it possible that another effect is the cause.

    Args:
        doubt: Why the effect may not exist, as `doubt_about_candidate` returns it, or "".
    """
    return doubt in (BY_CHANCE, BY_VOLTAGES)


def hidden_by(label: str) -> str:
    """Return the doubt about an effect that explains little beyond another one: a clause after "it ".

    Args:
        label: Label of the other effect, name@site, which chance or unknown voltages may explain as well.
    """
    return f"explains little that {label} does not, which chance or unknown voltages may explain as well"


def doubt_beside_others(evidence: EffectEvidence, criteria: SelectionCriteria) -> str:
    """Return why an effect may not exist beside all other effects; "" if nothing speaks against it.

    It is doubted if it reduces the error by less than `enough_gain`, if a parameter is at a meaningless limit
    (`parameter_at_limit`), or if it fails any test of `doubt_about_candidate`, the statistical ones included.

    Args:
        evidence: What the fitted runs say with and without this effect, beside the others.
        criteria: Decision thresholds.

    Returns:
        Clause that follows "it ", or "".
    """
    enough = enough_gain(evidence.with_effect, criteria, voltages_known=evidence.beside_voltages is None)
    if not is_enough(evidence.without, evidence.with_effect, enough):
        return "has no effect on the error"
    return parameter_at_limit(evidence.parameters) or _doubt(evidence, criteria, statistical=True)


def _doubt(evidence: EffectEvidence, criteria: SelectionCriteria, *, statistical: bool) -> str:
    """Return the first reason against an effect; the order is that of the costs of the evidence."""
    return (
        simpler_effect(evidence.parameters)
        or evidence.fault()
        or (statistical and _by_chance(evidence, criteria))
        or (statistical and _in_the_motion(evidence))
        or (statistical and _by_voltages(evidence, criteria))
        or (statistical and _of_several_sizes(evidence, criteria))
        or _too_small(evidence, criteria)
        or _form_error(evidence, criteria)
        or (_unconfirmed(evidence, criteria) if statistical else "")
    )


def _in_the_motion(evidence: EffectEvidence) -> str:
    """Return the doubt that an error of a sensor imitates one of the motion; "" if it does not.

    What a model lacks moves all sensors of a motion alike. An error of one of them that imitates it reduces
    the errors of the prediction that follows all of them, but adds itself to what they say differently.
    """
    if evidence.disagreement is None:
        return ""
    measured = evidence.disagreement()
    if measured.with_effect <= measured.without:
        return ""
    return "makes the sensors of one motion disagree more: something else is in error than one of them"


def _by_voltages(evidence: EffectEvidence, criteria: SelectionCriteria) -> str:
    """Return the doubt that other voltages between the rows explain what the effect does; "" if they do not.

    Beside all that they may explain, the effect must reduce the error by clearly more than chance.
    """
    if evidence.beside_voltages is None:
        return ""
    if evidence.beside_voltages() >= CLEAR * chance_gain(evidence.chance().variance, criteria):
        return ""
    return BY_VOLTAGES


def _of_several_sizes(evidence: EffectEvidence, criteria: SelectionCriteria) -> str:
    """Return the doubt that an effect imitates what controllers do between the rows; "" if it has one size.

    What exists has the same size with every observer and by instruments.

    - A controller that answers vibrations between the rows changes their phase, as a damping of belts does,
      but by another amount: the wider the observer, the faster the error that determines the size, and the
      more of it is theirs.
    - Least squares take errors of the voltages for another division of the inertia into those of stage and
      pulleys, and a damping of belts or a late sensor for what that does to vibrations. Instruments do not
      contain these errors.

    A size that is not known well in one fit is no other one.
    """
    for sizes_by, where in (
        (evidence.sizes_by_observer, "in fast errors"),
        (evidence.sizes_by_instruments, "by instruments"),
    ):
        sizes = sizes_by() if sizes_by is not None else ()
        if sizes and all(_differs(size, criteria) for size in sizes):
            values = " and ".join(f"{s.name} = {s.other:.2g} instead of {s.value:.2g}" for s in sizes)
            return f"has another size {where} ({values}), as what imitates voltages between the rows does"
    return ""


def _differs(size: SizeByFit, criteria: SelectionCriteria) -> bool:
    """Return whether two fits of one size differ clearly, and by more than chance."""
    smaller, larger = sorted((size.value, size.other), key=abs)
    if CLEAR * smaller * math.copysign(1.0, larger) >= abs(larger):
        return False
    return abs(size.other - size.value) > chance_deviations(criteria) * size.std()


def _least_confirmed(gain: float, criteria: SelectionCriteria) -> float:
    """Return the reduction of the cost in runs to which an effect was not fitted that confirms a gain."""
    return criteria.min_confirmed_fraction * gain


def _unconfirmed(evidence: EffectEvidence, criteria: SelectionCriteria) -> str:
    """Return the doubt that an effect describes single runs, not the machine; "" if other runs confirm it."""
    gain = evidence.gain
    least = _least_confirmed(gain, criteria)
    if evidence.confirmed() >= least:
        return ""
    confirmed = evidence.confirmed_accurate(least)
    if confirmed >= least:
        return ""
    there = (
        f"no more than {100 * confirmed / gain:.0f} % of the gain"
        if confirmed >= 0.0
        else "their error grows with it"
    )
    return f"is not confirmed by runs that it was not fitted to ({there})"


def fault_of_machine(behavior: MachineBehavior) -> str:
    """Return why a machine with effects is not physical outside its recordings, or "" if it is physical.

    It is not if an effect has a parameter below the least value of what its name says, or if the machine,
    under voltages that switch at random between the rated ones, diverges or is more than five times
    (`LARGEST_SPEED_RATIO`) as fast as without the effects.

    Args:
        behavior: Top speeds and effects whose names do not fit their values.

    Returns:
        Clause that follows "it " (the effect), or "".
    """
    if behavior.misnamed:
        return f"has a sign with which {behavior.misnamed[0]} is not what its name says"
    with_effects, without = behavior.top_speeds()
    if not (math.isfinite(with_effects) and with_effects <= LARGEST_SPEED_RATIO * without):
        return "makes the machine diverge under random rated voltage"
    return ""


def _by_chance(evidence: EffectEvidence, criteria: SelectionCriteria) -> str:
    """Return the doubt that chance explains the gain, as the remaining error is correlated; "" if it cannot.

    In doubt, the gain with the next narrower observer decides: an observer hides slow errors, and with them
    what an effect explains, whereas model error imitates an effect the less, the longer it adds up.
    """
    for chance in filter(None, (evidence.chance, evidence.chance_narrower)):
        measured = chance()
        if exceeds_chance(measured.gain, measured.variance, criteria):
            return ""
    return BY_CHANCE


def _too_small(evidence: EffectEvidence, criteria: SelectionCriteria) -> str:
    """Return the doubt about an effect with less force than remains unexplained, or ""."""
    # Without a force of its own, an effect is compared with all that the observer corrects. In a slow log,
    # unknown voltages cause that, also in the true machine, as far as noise and they explain the data.
    if (
        evidence.forceless
        and evidence.beside_voltages is not None
        and nearly_explains(evidence.with_effect, criteria)
    ):
        return ""
    forces = evidence.forces()
    # An observer shows little of a slow force. Where the machine with an effect that has none of its own
    # nearly explains the data, rounding errors of encoders may be most of what the observer corrects, without
    # and with it.
    hidden = evidence.forceless and nearly_explains(evidence.with_effect, criteria)
    least = 0.0 if hidden else criteria.min_promised_force_ratio * forces.residue
    if least <= forces.effect < criteria.min_force_ratio * forces.residue:
        forces = evidence.forces_accurate()  # in doubt
    if forces.effect >= criteria.min_force_ratio * forces.residue:
        return ""
    verb = "explains" if evidence.forceless else "has"
    return f"{verb} a force of {forces.effect:.2g} N, where {forces.residue:.2g} N remain unexplained"


def _form_error(evidence: EffectEvidence, criteria: SelectionCriteria) -> str:
    """Return the doubt that an effect corrects the form of one of another family; "" if nothing says so."""
    # What an inexact form leaves has no simple formula itself. An effect that removes nearly all of an error
    # of several times the noise is therefore no correction of another effect's form. Without this rule, an
    # eddy-current brake is named falsely beside a Stribeck friction of another form, with 2 % of its force.
    before, after = evidence.without, evidence.with_effect
    if before.chi2 > FAR and after.excess < criteria.max_remaining * before.excess:
        return ""
    for addition in evidence.additions():
        if addition.fraction < criteria.max_form_error:
            percent = f"adds {100 * addition.fraction:.0f} % to the force of {addition.label}"
            return f"{percent}, which depends on the same variable: the form of that effect may be in error"
    return ""


def parameter_at_limit(parameters: Iterable[ParameterValue]) -> str:
    """Return the doubt about an effect that has a parameter at a meaningless limit of its range, or "".

    A value counts as at a limit within 1 % of it (`AT_LIMIT`): at one of `ParameterValue.limits`, at or above
    the upper end of `covered`, or at or below its lower end if `covered_below`. The data then ask for a value
    that the effect cannot have or the runs cannot determine: another effect may be the cause.

    Args:
        parameters: Fitted parameters of the effect.

    Returns:
        Clause that follows "it ", naming the first such parameter, or "".
    """
    for p in parameters:
        if p.covered is not None:
            low, high = (1.0 + AT_LIMIT) * p.covered[0], (1.0 - AT_LIMIT) * p.covered[1]
            if p.value >= high or (p.covered_below and p.value <= low):
                return (
                    f"fits only with {p.name} at the limit of what the runs cover ({p.value:.3g} {p.unit}): "
                    "they cannot tell it from a simpler cause"
                )
        for limit in p.limits:
            if math.isclose(p.value, limit, rel_tol=AT_LIMIT):
                return (
                    f"fits only with {p.name} at the limit of its range ({limit:g}): "
                    "another effect may imitate it"
                )
    return ""


def simpler_effect(parameters: Iterable[ParameterValue]) -> str:
    """Return the doubt that an effect is another one with fewer parameters, or "".

    It is if a parameter is within 1 % (`AT_LIMIT`) of a value of `ParameterValue.simpler`. One more parameter
    adapts to the error of the model, which explains so small a difference.

    Args:
        parameters: Fitted parameters of the effect.

    Returns:
        Clause that follows "it ", naming the simpler effect, or "".
    """
    for p in parameters:
        for value, name in p.simpler.items():
            if math.isclose(p.value, value, rel_tol=AT_LIMIT):
                return f"is {name}, which has fewer parameters: {p.name} = {p.value:.4g} instead of {value:g}"
    return ""


def uncertain_size(sizes: Sequence[Size], criteria: SelectionCriteria) -> str:
    """Return the doubt about an effect whose amplitudes all may be 0; "" if one is certain, or without any.

    An amplitude is certain if it is at least `chance_deviations` (4.9) standard deviations from 0. The final
    fit is tested because the search compared costs of fits with other observers and rows, and because a fit
    may end where the measurements hardly depend on the effect: then something else lowered the cost.

    Args:
        sizes: Amplitudes of the effect in the final fit.
        criteria: Decision threshold `chance`.

    Returns:
        Clause that follows "it ", with all amplitudes and their standard deviations, or "".
    """
    deviations = chance_deviations(criteria)
    if not sizes or any(abs(size.value) >= deviations * size.std for size in sizes):
        return ""
    values = " and ".join(f"{s.name} = {s.value:.2g} +- {s.std:.2g} {s.unit}" for s in sizes)
    return f"is not certain to exist: the final fit gives {values}"


@dataclass(frozen=True)
class TimingEvidence:
    """Evidence for a delay or lag of the drives, with an observer of larger bandwidth than the search's.

    Attributes:
        search: Costs without and with the effect, with the observer of the search.
        wide: The same with the wider observer.
        variance: Function that returns the variance of the residual in the effect's direction, with the wider
            observer.
        confirmed: Reduction of the cost in runs to which the effect was not fitted, with the wider observer,
            by a linear model.
        confirmed_accurate: As in `EffectEvidence`, with the wider observer.
        fault: Why the machine with the effect is not physical.
        held_out_gain: Function that returns the fraction of the held-out runs' error that the effect removes,
            with the wider observer; infinite without such runs.
    """

    search: tuple[float, float]
    wide: tuple[float, float]
    variance: Callable[[], LongRunVariance]
    confirmed: Measured
    confirmed_accurate: Callable[[float], float]
    fault: Callable[[], str]
    held_out_gain: Measured


def removed_fraction(without: float, with_effect: float) -> float:
    """Return the fraction of a cost that an effect removes, 1 - `with_effect` / `without`, dimensionless.

    Args:
        without: Cost without the effect, dimensionless, above 0.
        with_effect: Cost with it, dimensionless; a larger one gives a negative fraction.
    """
    return 1.0 - with_effect / without


def doubt_about_timing(evidence: TimingEvidence, criteria: SelectionCriteria) -> str:
    """Return why a delay or lag of the drives may not exist; "" if nothing speaks against it.

    Such an effect explains fast errors, so it is tested with an observer wider than that of the search. It is
    doubted, in this order, if it does not remove a larger fraction of the error with this observer than with
    the other one, if its gain does not exceed chance, if runs to which it was not fitted confirm less than 30
    % of the gain (`min_confirmed_fraction`), if the machine with it is not physical, or if it does not reduce
    the error of the held-out runs.

    Args:
        evidence: What the fitted and the held-out runs say.
        criteria: Decision thresholds `chance` and `min_confirmed_fraction`.

    Returns:
        Clause that follows "it ", or "".
    """
    gain = evidence.wide[0] - evidence.wide[1]
    if removed_fraction(*evidence.wide) <= max(removed_fraction(*evidence.search), 0.0):
        return "explains a slow error, not a fast one"
    if not exceeds_chance(gain, evidence.variance(), criteria):
        return BY_CHANCE
    least = _least_confirmed(gain, criteria)
    if not (evidence.confirmed() >= least or evidence.confirmed_accurate(least) >= least):
        return "is not confirmed by runs that it was not fitted to"
    return evidence.fault() or (NO_GAIN if not evidence.held_out_gain() > 0.0 else "")
