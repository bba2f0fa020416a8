"""Fitting a machine's parameters: Levenberg-Marquardt by brute force, one lane of the kernel a perturbed parameter.

Positive parameters are fitted as logarithms, all with a mild Gaussian prior around the declared machine, so that what
the data cannot tell stays where it was declared.  Several dampings are tried at once; friction needs no smoothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..dynamics.simulation import threads
from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .initial_state_projection import Projection, projection
from .prediction import SEARCH_STEP, Mode, predict, residuals

Array = NDArray[np.float64]
T = TypeVar("T")

_STEP = 1e-4  # forward difference, in units of theta
_REACH = 4.0  # how many standard deviations of its prior a parameter may go; further is a wrong model
_DAMPINGS = 10.0 ** np.array([-6.0, -4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0])


@dataclass(frozen=True)
class FreeParameter:
    """One fitted parameter: value = center exp(theta) or, where `scale` is given, center + scale theta.

    prior: standard deviation of theta around 0.  lower, upper: bounds of the value.  along: the curve that this one is
    a value of, the others beside it in order: its bends in theta are about one.
    """

    name: str
    center: float
    prior: float
    scale: float | None = None
    lower: float = 0.0
    upper: float = math.inf
    along: str = ""

    def value(self, theta: Array) -> Array:
        raw = self.center * np.exp(theta) if self.scale is None else self.center + self.scale * theta
        return np.clip(raw, self.lower, self.upper)

    def theta(self, value: float) -> float:
        """What gives this value."""
        return math.log(value / self.center) if self.scale is None else (value - self.center) / self.scale

    def slope(self, theta: float) -> float:
        """d value / d theta."""
        return self.center * math.exp(theta) if self.scale is None else self.scale


@dataclass(frozen=True)
class Fit:
    """A fitted machine: theta of its free parameters, cost (sum of squares in noise units, and with the prior), the
    number of measured values, and the information matrix without the prior."""

    machine: Machine
    free: tuple[FreeParameter, ...]
    theta: Array
    cost: float
    count: int
    mode: Mode
    information: Array = field(repr=False)

    @property
    def chi2(self) -> float:
        """Cost per measured value: one when only the sensors' noise is left."""
        return self.cost / self.count

    @property
    def values(self) -> dict[str, float]:
        return {f.name: float(f.value(t)) for f, t in zip(self.free, self.theta, strict=True)}


def default_free_parameters(machine: Machine, *, effects: bool = True) -> tuple[FreeParameter, ...]:
    """What of a machine is refitted: masses, friction, belts, every drive's gain but the first, declared effects.

    Voltages tell only ratios to the motor gain, so the first drive's stays.  Back-EMF acts as viscous friction does, so
    their sum is what the data tell; it may be less than the declared back-EMF alone, which therefore moves too.
    Friction and gain of each motor are free to differ.  A friction that is declared as zero may rise.
    """
    force = typical_force(machine)
    free = []
    for c in machine.coordinates:
        radius = c.radius if c.kind == "rotary" else 1.0
        free.append(FreeParameter(f"{c.name}.mass", c.mass, prior=0.3))
        for key, size in (("viscous", force * radius**2), ("coulomb", 0.1 * force * radius)):
            value = getattr(c, key)
            scale = None if value > 0 else 0.1 * size
            free.append(FreeParameter(f"{c.name}.{key}", value, prior=0.7 if value > 0 else 1.0, scale=scale))
    for b in machine.belts:
        free.append(FreeParameter(f"{b.name}.EA", b.EA, prior=0.3))
        if b.length:
            free.append(FreeParameter(f"{b.name}.rest_length", b.rest_length, prior=0.1))
    free += [FreeParameter(f"{d.name}.Kt", d.Kt, prior=0.2) for d in machine.drives[1:]]
    free += [FreeParameter(f"{d.name}.Ke", d.Ke, prior=0.2) for d in machine.drives if d.Ke > 0.0]
    for e in machine.effects if effects else ():
        for p in e.definition.parameters:
            value = e.parameters[p.name]
            if p.role != "fixed" and value != 0.0:
                signed = p.lower < 0.0
                scale = (1.0 if p.role == "phase" else abs(value)) if signed else None
                free.append(
                    FreeParameter(f"{e.label}.{p.name}", value, prior=0.5, scale=scale, lower=p.lower, upper=p.upper)
                )
    return tuple(f for f in free if f.name not in machine.ties)


def typical_force(machine: Machine) -> float:
    """A tenth of the rated force of all drives at rest, N of travel: what matters on this machine."""
    total = 0.0
    for d in machine.drives:
        c = machine.coordinate(d.coordinate)
        total += d.gain * d.rated_voltage / (c.radius if c.kind == "rotary" else 1.0)
    return 0.1 * total


def second_difference_penalty(count: int) -> Array:
    """Products of the second differences of a curve's values (count, count)."""
    second = np.diff(np.eye(count), n=2, axis=0)
    found: Array = second.T @ second
    return found


def prior_precision(free: Sequence[FreeParameter]) -> Array:
    """Of theta (k, k): each around 0 by its own, and the second differences of curves around 0."""
    precision = np.diag([1.0 / f.prior**2 for f in free])
    for curve in dict.fromkeys(f.along for f in free if f.along):
        place = np.array([f.along == curve for f in free])
        precision[np.ix_(place, place)] += second_difference_penalty(int(place.sum()))
    return precision


def parameter_table(machine: Machine, free: Sequence[FreeParameter], theta: Array) -> Array:
    """Kernel parameters (B, P) for theta (B, k)."""
    names = list(machine.parameters)
    table = np.tile(np.array(list(machine.parameters.values())), (len(theta), 1))
    for j, f in enumerate(free):
        table[:, names.index(f.name)] = f.value(theta[:, j])
    return table


def over_runs(function: Callable[[PreparedRecording], T], data: Dataset) -> Iterator[T]:
    """Apply a function to every run, longest first on all cores, results in order."""
    count = min(threads(), len(data.runs))
    if count == 1:
        yield from map(function, data.runs)
        return
    with ThreadPoolExecutor(count) as pool:
        yield from pool.map(function, data.runs)


def cost_of(machine: Machine, data: Dataset, mode: Mode, *, longest_step: float = SEARCH_STEP) -> float:
    """Sum of squares in noise units of a machine as it is."""

    def of(run: PreparedRecording) -> float:
        left = residuals(run, data, predict(machine, run, mode, period=data.period, longest_step=longest_step).readings)
        return float(np.sum(left**2))

    total = sum(over_runs(of, data))
    return total if math.isfinite(total) else math.inf


def fit(
    machine: Machine,
    free: Sequence[FreeParameter],
    data: Dataset,
    mode: Mode,
    *,
    theta: Array | None = None,
    iterations: int = 25,
    tolerance: float = 1e-4,
    longest_step: float = SEARCH_STEP,
) -> Fit:
    """The parameters with the least cost from theta (default: the machine's own values).

    tolerance: relative gain of an iteration below which the search ends.
    """
    free = tuple(free)
    at = np.zeros(len(free)) if theta is None else np.array(theta, float)
    prior = precision = prior_precision(free)
    reach = _REACH * np.array([f.prior for f in free])
    period = data.period
    here = machine  # at the last Jacobian: runs start where this one rests

    def left(run: PreparedRecording, thetas: Array) -> Array:
        table = parameter_table(machine, free, thetas)
        motion = predict(here, run, mode, period=period, parameters=table, longest_step=longest_step)
        return residuals(run, data, motion.readings)

    projections: dict[str, Projection | None] = {}

    def without_start(run: PreparedRecording, left: Array) -> Array:
        project = projections.get(run.name)
        return left if project is None else project(left)

    def gram(thetas: Array) -> Array:
        """Sum over runs of the products of (Jacobian columns, residual), (k + 1, k + 1)."""
        nonlocal here
        here = machine.replace({f.name: float(f.value(t)) for f, t in zip(free, thetas[0], strict=True)})

        def of(run: PreparedRecording) -> Array:
            projections[run.name] = projection(here, run, data, mode, longest_step)
            r = without_start(run, left(run, thetas))
            columns = np.vstack([(r[1:] - r[0]) / _STEP, r[:1]])
            return columns @ columns.T

        return np.sum(list(over_runs(of, data)), axis=0)

    def costs(thetas: Array) -> Array:
        parts = over_runs(lambda run: np.einsum("bi,bi->b", r := without_start(run, left(run, thetas)), r), data)
        total = np.sum(list(parts), axis=0) + np.einsum("bi,ij,bj->b", thetas, precision, thetas)
        return np.where(np.isfinite(total), total, np.inf)

    information = np.zeros((len(free), len(free)))
    cost = math.inf
    for _ in range(iterations):
        products = gram(np.vstack([at, at + _STEP * np.eye(len(free))]))
        information = products[:-1, :-1]
        # A model that misses by chi2 times the noise is that much less sure of its data: the prior keeps its weight.
        precision = prior * max(1.0, products[-1, -1] / data.count)
        cost = products[-1, -1] + float(at @ precision @ at)
        hessian = information + precision
        gradient = products[:-1, -1] + precision @ at
        trials = np.array(
            [at - np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient) for damping in _DAMPINGS]
        )
        trials = np.clip(trials, -reach, reach)
        found = costs(trials)
        best = int(np.argmin(found))
        if not found[best] < cost:
            break
        gain = cost - found[best]
        at, cost = trials[best], float(found[best])
        if gain < tolerance * cost:
            break
    fitted = machine.replace({f.name: float(f.value(t)) for f, t in zip(free, at, strict=True)})
    plain = cost - float(at @ precision @ at)
    return Fit(fitted, free, at, plain, data.count, mode, information)
