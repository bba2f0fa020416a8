"""Candidates of the search: effects at sites with starting values, which strategies propose.

A strategy is a function of what the search knows (`SearchState`), in the registry `STRATEGIES`. The modules
in `strategies/` register those of the package. A proposal costs only a part of one simulation: `screening`
ranks all of them, and only the best are fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...arrays import Array
from ...effects import effect_sites
from ...effects.smooth_table import TABLE_FAMILY
from ...errors import InputError, is_number, suggestion
from ...machine import AppliedEffect, Effect, EffectParameter, Machine
from ...preparation.dataset import Dataset
from ...registry import Registry
from ..fit.estimation import Fit
from ..forces.missing_force import follow_runs, missing_force, sensor_errors
from ..predict.free_parameters import FreeParameter
from ..predict.prediction import SEARCH_BANDWIDTH
from .periodogram import MIN_FORCE_PERIODS, MIN_FRICTION_PERIODS
from .typical_scales import LONGEST_RUN, SESSION, TypicalScales, typical_scales

_LEAST_PERIOD_PRIOR = 0.1  # relative
_ROUNDING = 0.01  # relative; predictions with different observers have slightly different travels


@dataclass(frozen=True)
class Candidate:
    """An effect at a site with starting values of its shape parameters (widths, speeds, spatial rates).

    Attributes:
        effect: Definition of the effect.
        site: Name of the coordinate, drive or sensor on which the effect acts, or "machine".
        columns: Basis functions of the effect (for example sine and cosine), whose weighted sum is the
            effect. Each is a complete set of effect parameters, by parameter name, with the amplitude at its
            typical size. An effect without an amplitude has a single set, which is the effect itself.
        scales: Typical sizes at the site (force, speed, ...), by unit of the effect's parameters.
    """

    effect: Effect
    site: str
    columns: tuple[Mapping[str, float], ...]
    scales: Mapping[str, float]

    @property
    def label(self) -> str:
        """Name of the effect and its component, such as "stribeck_friction@x"."""
        return f"{self.effect.name}@{self.site}"

    @property
    def has_no_amplitude(self) -> bool:
        """Whether the effect has no amplitude parameter; its only basis function then has no weight."""
        return not self.effect.amplitudes

    def differs_in_thresholds(self, other: Candidate) -> bool:
        """Check whether another candidate for the same effect differs from this one only in its thresholds.

        A threshold is a parameter on which predictions depend in steps. A fit tries several values of it, so
        that two such candidates lead to the same fit.

        Args:
            other: Candidate with other starting values of the effect.

        Returns:
            True if all parameters that are neither thresholds nor amplitudes have the same starting values.
        """
        shapes = (p for p in self.effect.parameters if p.role not in ("switch", "amplitude"))
        return all(self.columns[0][p.name] == other.columns[0][p.name] for p in shapes)

    def applied(self, amounts: Sequence[float]) -> AppliedEffect:
        """Return the effect with given weights of its basis functions (`columns`).

        Args:
            amounts: Weight of each basis function, dimensionless, shape (basis functions,); a weight of 1
                gives the typical amplitude. The number of basis functions depends on the parameters of the
                effect:

                - With a phase, there are two, sine and cosine; amplitude and phase follow from their weights.
                - Without a phase, there is one per amplitude; the amplitude is its typical size * weight.
                - With neither, there is one, the effect itself; its weight is ignored.

        Returns:
            Effect on the candidate's component, with its parameters, SI, clipped to their bounds.
        """
        values = dict(self.columns[0])
        phase = next((p.name for p in self.effect.parameters if p.role == "phase"), None)
        names = self.effect.amplitudes
        if phase is not None:  # a sin(u) + b cos(u) = sqrt(a^2 + b^2) sin(u + atan2(b, a))
            sine, cosine = amounts
            values[names[0]] *= float(np.hypot(sine, cosine))
            values[phase] = float(np.arctan2(cosine, sine))
        elif len(names) == len(self.columns):  # one basis function per amplitude
            values |= {n: c[n] * float(a) for n, c, a in zip(names, self.columns, amounts, strict=True)}
        bounds = {p.name: (p.lower, p.upper) for p in self.effect.parameters}
        return self.effect.at(self.site, **{n: float(np.clip(v, *bounds[n])) for n, v in values.items()})


@dataclass(frozen=True)
class SearchState:
    """State of a search: the argument of the strategies that propose effects.

    Attributes:
        machine: Machine with the effects that have been selected so far.
        data: Prepared recordings that are fitted.
        scales: Typical sizes of force, speed, ... at each component.
        missing_force: By coordinate name, an array of shape (n, 3) over all rows of all runs with the columns
            position, velocity and missing force (the force that the model lacks): m, m/s, N or rad, rad/s,
            Nm. The runs follow each other as in `data.runs`.
        slow: Whether an observer of small bandwidth is used, which shows slowly changing errors.
        sensor_errors: By channel of the sensors of positions, an array of shape (n, 3) with the columns
            position, velocity and error of the sensor (`missing_force.sensor_errors`). The strategy `library`
            proposes no periodic errors of other sensors.
    """

    machine: Machine
    data: Dataset
    scales: TypicalScales
    missing_force: Mapping[str, Array]
    slow: bool = False
    sensor_errors: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, fitted: Fit, data: Dataset) -> SearchState:
        """Create the state of a search from a fit.

        Args:
            fitted: Fit of the machine with the effects that have been selected so far.

        Returns:
            State with the missing force of each coordinate and the errors of each sensor, shape (n, 3) each.
        """
        followed = follow_runs(fitted.machine, data)
        return cls(
            fitted.machine,
            data,
            typical_scales(fitted, data),
            missing_force(fitted.machine, data, followed=followed),
            slow=fitted.bandwidth < SEARCH_BANDWIDTH,
            sensor_errors=sensor_errors(fitted.machine, followed),
        )

    def sites(self, effect: Effect) -> tuple[str, ...]:
        """Return the components at which a strategy may propose an effect.

        There are none for effects that replace a part of the model (they add coordinates or replace dry
        friction), which `structures.screen_structures` tries. For an effect that a refit of the machine's
        parameters can represent, there are only sites where an effect shared by all drives follows it: before
        a shared dead band, for example, the drive's gain has another influence than its torque constant.
        Components are left out where the machine has the effect, or lacks another one that it requires.
        """
        if effect.replaces_model_part:
            return ()
        present = {e.label for e in self.machine.effects}
        return tuple(
            site
            for site in effect_sites(effect, self.machine)
            if f"{effect.name}@{site}" not in present
            and (not effect.requires or f"{effect.requires}@{site}" in present)
            and not (effect.refitted and not self._is_followed(effect, site))
        )

    def _is_followed(self, effect: Effect, site: str) -> bool:
        """Return whether an effect that several drives share changes the voltage after one of one drive."""
        after = (e for e in self.machine.effects if e.definition.signal_order > effect.signal_order)
        shared = any(e.definition.voltage is not None and e.site == "drives" for e in after)
        return shared and site != "drives" and len(self.machine.drives) > 1

    def sizes(self, effect: Effect, site: str) -> Mapping[str, float]:
        """Return the typical sizes of force, speed and so on at the site of an effect.

        Args:
            effect: Effect that acts there.
            site: Component on which it acts.

        Returns:
            Typical size, SI, by the keys of `TypicalScales.of`.
        """
        return _scales_at(effect, site, self.machine, self.scales)

    def unexplained(self, effect: Effect, site: str) -> Array:
        """Return position, velocity and unexplained error at the component of an effect, shape (n, 3).

        For an effect of a sensor it is the sensor's error (`sensor_errors`), otherwise the missing force on
        the coordinate on which the effect acts (`missing_force`).

        Args:
            effect: Effect that acts on a sensor or a coordinate, also through a drive.
            site: Component on which it acts.

        Returns:
            Columns in m, m/s and N, or rad, rad/s and Nm, or with the error in the sensor's unit. No rows for
            a sensor of something else than a position.

        Raises:
            KeyError: If the effect acts on no single coordinate.
        """
        if effect.site == "sensor":
            return self.sensor_errors.get(site, np.zeros((0, 3)))
        return self.missing_force[self.machine.coordinate_of_site(site, effect.site) or ""]

    def covers(self, effect: Effect, site: str, values: Mapping[str, float]) -> bool:
        """Return whether the runs can determine an effect with given parameter values.

        Each value must lie within the range of `coverage` at this site.

        Args:
            effect: Effect at the site.
            site: Where it acts.
            values: Values of some or all of its parameters, SI, by name.
        """
        sizes = self.sizes(effect, site)
        limits = {p.name: coverage(p, sizes) for p in effect.parameters if p.name in values}
        return all(
            (1.0 - _ROUNDING) * low <= values[name] <= (1.0 + _ROUNDING) * high
            for name, (low, high) in limits.items()
        )

    def candidate(self, effect: Effect, site: str, values: Mapping[str, float]) -> Candidate:
        """Return an effect at a site as a candidate with given starting values.

        Its amplitudes get their typical sizes. An effect with a phase gets two basis functions, sine and
        cosine.

        Args:
            effect: Effect to propose.
            site: One of `sites`.
            values: Starting values, SI, by name, of all parameters of the effect but amplitude and phase.

        Raises:
            InputError: If the effect cannot act at the site, a value is missing or not finite, or no such
                parameter exists.
        """
        _refuse_site(effect, site, self.machine)
        names = {p.name for p in effect.parameters if p.role not in ("amplitude", "phase")}
        if set(values) != names:
            needed, given = (", ".join(sorted(each)) or "no values" for each in (names, values))
            raise InputError(f"a candidate of {effect.name} starts from {needed}, not from {given}")
        _refuse_values(effect, site, values)
        sizes = self.sizes(effect, site)
        return Candidate(effect, site, _columns(effect, values, sizes), sizes)


Strategy = Callable[[SearchState], Iterable[Candidate]]
STRATEGIES: Registry[Strategy] = Registry("proposal strategy", package=f"{__package__}.strategies")


def candidates(state: SearchState) -> list[Candidate]:
    """Return what all strategies propose: effects that the machine may lack, at sites, with starting values.

    Args:
        state: State of the search.

    Returns:
        Candidates, those of one strategy after those of another, in the order of the strategies' names.
        Proposals at components that are not in `SearchState.sites`, such as where the machine has the effect
        already, and with values that the runs cannot show, are left out.

    Raises:
        TypeError: If a strategy returns something else than candidates; the message names it.
        InputError: If a strategy proposes an effect where it cannot act, or from values that are not finite.
    """
    proposed = [candidate for name in sorted(STRATEGIES) for candidate in _proposed(name, state)]
    sites = {c.effect.name: state.sites(c.effect) for c in proposed}
    return [
        c for c in proposed if c.site in sites[c.effect.name] and state.covers(c.effect, c.site, c.columns[0])
    ]


def _proposed(name: str, state: SearchState) -> list[Candidate]:
    """Return the candidates of a strategy; errors name it, as where it returns something else."""
    try:
        proposed = STRATEGIES.get(name)(state)
        found = list(proposed) if isinstance(proposed, Iterable) else [proposed]
        for candidate in found:
            if not isinstance(candidate, Candidate):
                raise TypeError(f"proposes {candidate!r}; it must yield state.candidate(...)")
            _refuse_site(candidate.effect, candidate.site, state.machine)
            for column in candidate.columns:
                _refuse_values(candidate.effect, candidate.site, column)
    except (InputError, TypeError) as error:
        kind = InputError if isinstance(error, InputError) else TypeError
        raise kind(f"proposal strategy {name}: {error}") from error
    return found


def _refuse_site(effect: Effect, site: str, machine: Machine) -> None:
    """Refuse a component of a machine on which an effect cannot act."""
    sites = effect.possible_sites(machine)
    if site not in sites:
        hint = suggestion(site, sites) or f"; its sites are {', '.join(sites) or 'none'}"
        raise InputError(
            f"{effect.name} cannot act at {site!r}{hint}. state.sites(effect) lists where to try it"
        )


def _refuse_values(effect: Effect, site: str, values: Mapping[str, float]) -> None:
    """Refuse a starting value of an effect that is not a finite number."""
    for parameter, value in values.items():
        if not is_number(value):
            raise InputError(
                f"{effect.name}@{site} starts from {parameter} = {value!r}, which must be finite"
            )


def is_required(machine: Machine, label: str) -> bool:
    """Check whether an effect must stay in a machine because another effect of the machine requires it.

    Args:
        label: Label (name@component) of the effect that may be required.

    Returns:
        True if an effect on the same component names it in `Effect.requires`.
    """
    return any(f"{e.definition.requires}@{e.site}" == label for e in machine.effects)


def _scales_at(effect: Effect, site: str, machine: Machine, scales: TypicalScales) -> Mapping[str, float]:
    """Return the typical sizes at a site; of all drives together, those of the one with the largest current.

    It reaches a common limit before the others do.
    """
    if site == "drives" and site not in [d.name for d in machine.drives]:
        of_drives = [scales.of(machine.coordinate_of_site(d.name, effect.site) or "") for d in machine.drives]
        return max(of_drives, key=lambda sizes: sizes.get("A", 0.0))
    return scales.of(machine.coordinate_of_site(site, effect.site) or "")


def _columns(
    effect: Effect, shape: Mapping[str, float], scales: Mapping[str, float]
) -> tuple[Mapping[str, float], ...]:
    """Return the parameter sets of an effect's basis functions: sine and cosine, or one per amplitude."""
    zero = dict.fromkeys(effect.amplitudes, 0.0)
    size = {p.name: p.scale * scales.get(p.unit, 1.0) for p in effect.parameters if p.amplitude}
    phase = next((p.name for p in effect.parameters if p.role == "phase"), None)
    if phase is not None:
        return tuple({**size, **shape, phase: angle} for angle in (0.0, np.pi / 2))
    return tuple({**zero, **shape, name: size[name]} for name in size) or (dict(shape),)


def covered_by_runs(parameter: EffectParameter) -> bool:
    """Return whether the motion of the runs limits which values of a parameter they can determine.

    Args:
        parameter: Parameter of an effect.

    Returns:
        True for periods and spatial rates, speed scales, natural frequencies, and time constants of changes
        over the session; False for all others, such as amplitudes.
    """
    return parameter.role in ("period", "rate") or (
        parameter.role == "shape" and parameter.unit in ("speed", "s", "Hz")
    )


def coverage(parameter: EffectParameter, scales: Mapping[str, float]) -> tuple[float, float]:
    """Return the smallest and largest value of an effect's parameter that the runs can determine.

    A period longer than the travel cannot be distinguished from a slope, a speed scale above the highest
    speed from viscous friction, a time constant longer than the session from a change at a constant rate. A
    load that does not complete one oscillation within a run acts like a spring and friction.

    Args:
        parameter: Parameter of the effect.
        scales: Typical sizes at its component, by unit (`TypicalScales`).

    Returns:
        Smallest and largest value, SI; -inf and inf where the runs set no limit, as for any parameter for
        which `covered_by_runs` is False.
    """
    if not covered_by_runs(parameter):
        return -np.inf, np.inf
    if parameter.unit == "Hz":
        return 1.0 / scales.get(LONGEST_RUN, np.inf), np.inf
    if parameter.role == "rate":
        return 2 * np.pi * MIN_FORCE_PERIODS / scales.get("position", np.inf), np.inf
    key = "position" if parameter.role == "period" else SESSION if parameter.unit == "s" else parameter.unit
    return -np.inf, scales.get(key, np.inf)


def effect_parameters(
    effect: AppliedEffect, machine: Machine, scales: TypicalScales
) -> tuple[FreeParameter, ...]:
    """List the parameters of an effect that a fit changes (free parameters), with their priors and bounds.

    The optimizer changes one dimensionless variable theta per parameter. With the starting value and the
    typical size of a parameter, its value is start * exp(theta) if it must be positive, and start + size *
    theta for an amplitude, a phase, a parameter that may be zero or negative, or one that starts at its upper
    bound, from which a logarithm does not reach zero. The ordinates of a table (a curve given by its values
    at knots) are size * theta.

    Args:
        effect: Effect with its starting values.
        machine: Machine that it acts on.
        scales: Typical sizes of force, speed and so on, by the unit of the parameter.

    Returns:
        One free parameter for every parameter of the effect, except parameters that its definition declares
        as fixed.
    """
    at_site = _scales_at(effect.definition, effect.site, machine, scales)
    free = []
    for p in effect.definition.parameters:
        if p.role == "fixed":
            continue
        name, value = f"{effect.label}.{p.name}", effect.parameters[p.name]
        size = p.scale * at_site.get(p.unit, 1.0)
        if p.amplitude and any(p.grid):  # its starting values differ by orders of magnitude
            size = max(size, abs(value))
        lower, upper = _bounds(p, value, at_site)
        if effect.definition.family == TABLE_FAMILY:
            # Centered at zero, because the prior of a smooth curve (`along`) penalizes differences of the
            # ordinates.
            free.append(
                FreeParameter(name, 0.0, prior=10.0, scale=size, lower=lower, upper=upper, along=effect.label)
            )
        elif p.amplitude or p.role == "phase":
            free.append(FreeParameter(name, value, prior=10.0, scale=size, lower=lower, upper=upper))
        elif p.role in ("rate", "period"):
            free.append(
                FreeParameter(name, value, prior=_period_prior(p, value, at_site), lower=lower, upper=upper)
            )
        elif p.lower < 0.0 or value in (0.0, p.upper):
            free.append(FreeParameter(name, value, prior=3.0, scale=size, lower=lower, upper=upper))
        else:
            free.append(FreeParameter(name, value, 1.0, lower=lower, upper=upper, switch=p.role == "switch"))
    return tuple(free)


def _period_prior(parameter: EffectParameter, value: float, scales: Mapping[str, float]) -> float:
    """Return the relative standard deviation of a period or rate: half a period over the positions' range."""
    span = scales.get("position", 0.0)  # range of the positions
    periods = span * value / (2 * np.pi) if parameter.role == "rate" else span / value
    return max(_LEAST_PERIOD_PRIOR, 0.5 / max(periods, MIN_FRICTION_PERIODS))


def _bounds(parameter: EffectParameter, value: float, scales: Mapping[str, float]) -> tuple[float, float]:
    """Return the bounds between which a fit may change a parameter of this value.

    They are those of its definition, without values that the recorded motion cannot distinguish from another
    effect. A time constant longer than the session, at which the effect is a change at a constant rate and
    remains itself (`EffectParameter.slope_of`), is only no starting value.
    """
    least, most = (-np.inf, np.inf) if parameter.slope_of else coverage(parameter, scales)
    lower = max(parameter.lower, least)
    upper = min(parameter.upper, most, parameter.largest * scales.get(parameter.unit, 1.0))
    return min(lower, value), max(upper, value)
