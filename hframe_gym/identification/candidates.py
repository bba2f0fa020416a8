"""The candidates of the search: every effect of the library at every site, at several starting values of its shape.

The library gives sizes relative to the machine (0.3 of the typical force, a tenth of the top speed); `TypicalScales`
turns them into values. Periods along the travel are candidates where the periodogram of the missing force has its
peaks.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..effects import EFFECTS, effect_sites
from ..machine import AppliedEffect, Effect, Machine
from .dataset import Dataset, TypicalScales
from .free_parameters import FreeParameter
from .screening import has_no_small_version
from .sensor_properties import UNLIMITED

Array = NDArray[np.float64]
_MAX_SHAPES = 64  # Starting values per effect and site.
_END_FRACTION = 0.005  # Fraction of the measurements at an end of a range that makes it worth a try.

# Periodogram. Rates are counted in periods over the traveled distance.
_MIN_PERIODS, _MAX_PERIODS = 0.5, 150.0
_POINTS_PER_PERIOD = 4  # Grid points per resolvable period.
_BAND_EDGES = (3.0, 12.0, 40.0)
_SLOW_PERIODS = np.concatenate([np.arange(0.5, 3.0, 0.25), np.arange(3.0, 6.1, 0.5)])
_MAX_RATES = 6
_MAX_ROWS = 3000
_CHUNKS = 8  # Chunks of the grid, so that the recursion of the phase does not accumulate rounding errors.


@dataclass(frozen=True)
class Candidate:
    """An effect at a site with starting values of its shape.

    Attributes:
        effect: Definition of the effect.
        site: Where it acts.
        columns: Parameters of one or more perturbations of typical size, whose weighted sum is the effect; an effect
            without an amplitude has one, which is the effect itself.
        scales: Typical sizes at the site, by unit.
    """

    effect: Effect
    site: str
    columns: tuple[Mapping[str, float], ...]
    scales: Mapping[str, float]

    @property
    def label(self) -> str:
        """Name of the effect and its site, joined by @."""
        return f"{self.effect.name}@{self.site}"

    @property
    def fixed(self) -> bool:
        """Whether the effect has no amplitude that could be zero."""
        return not self.effect.amplitudes

    def applied(self, amounts: Sequence[float]) -> AppliedEffect:
        """Return the effect with given weights of its columns.

        Args:
            amounts: Weights, shape (columns,).

        Returns:
            The effect with its parameters, clipped to their bounds.
        """
        values = dict(self.columns[0])
        phase = next((p.name for p in self.effect.parameters if p.role == "phase"), None)
        names = self.effect.amplitudes
        if phase is not None:
            sine, cosine = amounts
            values[names[0]] *= float(np.hypot(sine, cosine))
            values[phase] = float(np.arctan2(cosine, sine))
        elif len(names) == len(self.columns):
            values |= {n: c[n] * float(a) for n, c, a in zip(names, self.columns, amounts, strict=True)}
        bounds = {p.name: (p.lower, p.upper) for p in self.effect.parameters}
        return self.effect.at(self.site, **{n: float(np.clip(v, *bounds[n])) for n, v in values.items()})


def candidates(
    machine: Machine,
    data: Dataset,
    scales: TypicalScales,
    missing_force: Mapping[str, Array],
    *,
    slow_friction: bool = False,
) -> list[Candidate]:
    """Return all candidates of the library that the machine does not have yet.

    Args:
        machine: Current machine.
        data: Prepared recordings.
        scales: Typical sizes on this machine.
        missing_force: Position, velocity and missing force by coordinate, shape (n, 3) each, see
            `residual.missing_force`.
        slow_friction: Whether to try all long periods of friction along the travel, beside the peaks of the
            periodogram.

    Returns:
        Candidates of effects that act through forces or readings; those that replace a part of the model are in
        `screening.screen_structures`.
    """
    present = {e.label for e in machine.effects}
    proposed: list[Candidate] = []
    for effect in EFFECTS.values():
        if has_no_small_version(effect) or effect.refitted:
            continue
        for site in effect_sites(effect, machine):
            if f"{effect.name}@{site}" in present:
                continue
            at_site = scales.of(machine.coordinate_of_site(site) or "")
            for shape in _shapes(effect, site, machine, data, at_site, missing_force, slow_friction):
                proposed.append(Candidate(effect, site, _columns(effect, shape, at_site), at_site))
    return proposed


def _columns(
    effect: Effect, shape: Mapping[str, float], scales: Mapping[str, float]
) -> tuple[Mapping[str, float], ...]:
    """Return the parameters of the perturbations that span an effect: sine and cosine, or each amplitude."""
    zero = dict.fromkeys(effect.amplitudes, 0.0)
    size = {p.name: p.scale * scales.get(p.unit, 1.0) for p in effect.parameters if p.amplitude}
    phase = next((p.name for p in effect.parameters if p.role == "phase"), None)
    if phase is not None:
        return tuple({**size, **shape, phase: angle} for angle in (0.0, np.pi / 2))
    return tuple({**zero, **shape, name: size[name]} for name in size) or (dict(shape),)


def _shapes(
    effect: Effect,
    site: str,
    machine: Machine,
    data: Dataset,
    scales: Mapping[str, float],
    missing_force: Mapping[str, Array],
    slow_friction: bool,
) -> list[Mapping[str, float]]:
    """Return the starting values of everything but amplitudes and phases."""
    if effect.name == "sensor_range":
        return _range_shapes(machine.output_channels.index(site), data)
    grids: dict[str, list[float]] = {}
    for p in effect.parameters:
        if p.role == "shape":
            grids[p.name] = [g * scales.get(p.unit, 1.0) for g in p.grid]
        elif p.role in ("rate", "period"):
            motion = missing_force[machine.coordinate_of_site(site) or ""]
            rates = periodogram_peaks(motion, friction=effect.coulomb is not None)
            if slow_friction and effect.coulomb:
                rates = np.concatenate([rates, slow_rates(motion[:, 0])])
            grids[p.name] = [float(rate) if p.role == "rate" else float(2 * np.pi / rate) for rate in rates]
    shapes = [dict(zip(grids, values, strict=True)) for values in itertools.product(*grids.values())]
    return list(shapes[:_MAX_SHAPES])


def _range_shapes(j: int, data: Dataset) -> list[Mapping[str, float]]:
    """Return the ends at which sensor j may saturate: its outermost measurements, where many lie together."""
    values = np.concatenate([run.outputs[:, j] for run in data.runs])
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return []
    ends = []
    for sign in (-1.0, 1.0):
        outward = sign * values
        top = float(np.percentile(outward, 99.9))
        outermost = outward > top - 4 * max(float(data.noise[j]), 1e-12)
        saturated = float(np.mean(outermost)) > _END_FRACTION
        ends.append(sign * float(np.median(outward[outermost])) if saturated else None)
    far = UNLIMITED * max(float(np.abs(values).max()), 1e-6)
    low, high = ends
    choices = [(low, None), (None, high), (low, high)]
    return [
        {"low": -far if a is None else a, "high": far if b is None else b}
        for a, b in choices
        if not (a is None and b is None)
    ]


def effect_parameters(effect: AppliedEffect, machine: Machine, scales: TypicalScales) -> tuple[FreeParameter, ...]:
    """Return the free parameters of an effect.

    Parameters that may be zero or negative are fitted linearly, all others as logarithms. Their values are those at
    theta = 0, except for a table, whose values are theta itself.

    Args:
        effect: Effect with its starting values.
        machine: Machine that it acts on.
        scales: Typical sizes on this machine.

    Returns:
        One free parameter for each that is not fixed.
    """
    at_site = scales.of(machine.coordinate_of_site(effect.site) or "")
    free = []
    for p in effect.definition.parameters:
        if p.role == "fixed":
            continue
        name, value = f"{effect.label}.{p.name}", effect.parameters[p.name]
        size = p.scale * at_site.get(p.unit, 1.0)
        if effect.definition.against:  # The values of a curve; its smoothness acts on the values themselves.
            free.append(
                FreeParameter(name, 0.0, prior=10.0, scale=size, lower=p.lower, upper=p.upper, along=effect.label)
            )
        elif p.amplitude or p.role == "phase":
            free.append(FreeParameter(name, value, prior=10.0, scale=size, lower=p.lower, upper=p.upper))
        elif p.role in ("rate", "period"):
            free.append(FreeParameter(name, value, prior=0.1, lower=p.lower, upper=p.upper))
        elif p.lower < 0.0 or value == 0.0:
            free.append(FreeParameter(name, value, prior=3.0, scale=size, lower=p.lower, upper=p.upper))
        else:
            free.append(FreeParameter(name, value, prior=1.0, lower=p.lower, upper=p.upper))
    return tuple(free)


def periodogram_peaks(motion: Array, *, friction: bool) -> Array:
    """Return the most likely rates of a sine of position in the missing force.

    The periodogram is that of least squares at each rate, beside a constant, viscous and dry friction.

    Args:
        motion: Position, velocity and missing force, in the coordinate's units, shape (n, 3).
        friction: Whether the sine modulates the friction level, so that its force changes sign with the velocity.

    Returns:
        Rates in rad per unit of position, best first, at most six.

    References:
        Lomb (1976), Least-squares frequency analysis of unequally spaced data.
    """
    position, velocity, force = motion.T
    travel = float(np.ptp(position))
    if travel <= 0.0:
        return np.zeros(0)
    moving = np.abs(velocity) > 0.02 * np.percentile(np.abs(velocity), 99)
    thin = max(1, int(moving.sum()) // _MAX_ROWS)
    position, velocity, force = (column[moving][::thin] for column in (position, velocity, force))
    basis, _ = np.linalg.qr(np.stack([np.ones_like(position), velocity, np.sign(velocity)], axis=1))
    force = force - basis @ (basis.T @ force)
    count = int((_MAX_PERIODS - _MIN_PERIODS) * _POINTS_PER_PERIOD)
    first, step = 2 * np.pi / travel * np.array([_MIN_PERIODS, 1.0 / _POINTS_PER_PERIOD])
    grid = first + step * np.arange(count)
    sign = np.sign(velocity) if friction else np.ones_like(velocity)
    power = np.concatenate(
        [
            _explained_power(len(rates), position, rates[0], step, sign, force, basis)
            for rates in np.array_split(grid, _CHUNKS)
        ]
    )
    # First the best rate of each band, because the observer's noise grows with the rate; then the best of all.
    band = np.searchsorted(_BAND_EDGES, grid * travel / (2 * np.pi))
    best_of_band = [np.flatnonzero(band == k)[np.argmax(power[band == k])] for k in np.unique(band)]
    peaks: list[float] = []
    for k in (*sorted(best_of_band, key=lambda k: -power[k]), *np.argsort(-power)):
        if all(abs(grid[k] - other) > 1.5 * np.pi / travel for other in peaks):
            peaks.append(float(grid[k]))
        if len(peaks) == _MAX_RATES:
            break
    return np.array(peaks)


def slow_rates(position: Array) -> Array:
    """Return all distinguishable rates of a few periods over the travel.

    A simulation shows their effect, though the observer's noise may hide it in the missing force.

    Args:
        position: Positions along all runs, in the coordinate's unit, shape (n,).

    Returns:
        Rates in rad per unit of position.
    """
    travel = float(np.ptp(position))
    return np.asarray(2 * np.pi / travel * _SLOW_PERIODS if travel > 0.0 else np.zeros(0))


def _explained_power(
    count: int, position: Array, first: float, step: float, sign: Array, force: Array, basis: Array
) -> Array:
    """Return the square sum that a sine and a cosine at each rate first + k step explain beyond the basis (count,).

    The waves of a rate are those of the rate before, turned by the step; their squares are waves of twice the rate.
    """
    factors = np.empty((count, len(position)), np.complex128)
    factors[0] = np.exp(1j * first * position)
    factors[1:] = np.exp(1j * step * position)
    waves = np.multiply.accumulate(factors, axis=0)
    projection = waves @ (sign * force)
    in_basis = waves @ (sign[:, None] * basis)
    double_rate = np.einsum("kn,kn->k", waves, waves)
    cc = 0.5 * (len(position) + double_rate.real) - np.sum(in_basis.real**2, axis=1)
    ss = 0.5 * (len(position) - double_rate.real) - np.sum(in_basis.imag**2, axis=1)
    cs = 0.5 * double_rate.imag - np.sum(in_basis.real * in_basis.imag, axis=1)
    determinant = np.maximum(cc * ss - cs**2, 1e-9 * cc * ss + 1e-300)
    explained = ss * projection.real**2 + cc * projection.imag**2 - 2 * cs * projection.real * projection.imag
    return np.asarray(explained / determinant)
