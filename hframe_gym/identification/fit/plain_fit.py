"""The plain fit: inertia, friction and a few constant terms from the recordings alone, not the machine file.

It is what an engineer does first. Inverse dynamics: along each rigid motion z, the force of the drives is

    F = a (M z'') + b z' + c sign(z') + o   (+ s sin z + r cos z for an angle)

with averages over windows in place of derivatives, so that no noise is differentiated, and a robust loss. No
declared value enters, except for the directions of drives and sensors and the force per volt of the drives,
which sets the unit of force. Then an output-error fit: the machine is simulated over the runs, without
feedback of measurements, and its errors in meters or radians are minimized. All measurements of a sensor
count alike, also those that the preparation holds for less accurate, because the result is compared with
other machines by this error.

Where no sensor shows the direction of a motion (a counter of pulses), there is no balance of forces, and no
observer leads to the solution. Such fits in simulation start from many points, because they have many local
minima.

The plain fit serves twice. Its values are starting values where the declared ones are wrong by a factor. And
no machine that identification delivers may predict the held-out runs worse.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import nnls
from scipy.stats import qmc

from ...arrays import Array
from ...effects import EFFECTS
from ...machine import AppliedEffect, Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ...preparation.forces.force_equations import force_equations, leading_motions
from ...preparation.forces.motion_windows import MotionWindows, motion_windows
from ...preparation.runs.excerpt import NORMAL_SESSION, representative_part
from ...recordings import bridge_blanks, comparison_window
from ..budget import PLAIN_FIT_PART, Budget, goes_on
from ..judge.chance import LongRunVariance, chance_gain, exceeds_chance
from ..judge.criteria import SelectionCriteria
from ..judge.effect import AT_LIMIT
from ..judge.error import is_better_start
from ..predict.free_parameters import FreeParameter, default_free_parameters, typical_force, values_at
from ..predict.prediction import SEARCH_BANDWIDTH, SIMULATION
from .estimation import Fit, fit, prediction_cost
from .long_run_variance import long_run_variance

# Lengths of the windows, s. Short ones see fast motion, long ones suppress noise; the simulation decides
# between them.
_SPANS = (0.02, 0.05, 0.1, 0.2, 0.4)
_REWEIGHTINGS = 10  # of the rows by their residuals
_ROBUST = 1.5  # residuals beyond this multiple of the median count less
# Shortest time constant, in windows: with less inertia, all of the motion follows the force within a window,
# and the regression shows no inertia at all.
_SHORTEST_TIME_CONSTANT = 0.1
# Fraction of the drives' force, root mean square, of the least dry and the least viscous friction from which
# a fit starts: a logarithm has limits, and these then reach from 0.02 % to half of that force.
_LEAST_FRICTION = 0.01
_LEAST_RATIO = 1e-3  # of friction to the declared one; a fit in logarithms needs a value above zero
_WIDE_PRIOR = 1.0  # standard deviation of a logarithm; its limits are then a factor of 55
_GUIDING_BANDWIDTH = 3.0  # rad/s, of an observer that leads an output-error fit to its solution
_TERM_PRIOR = 10.0  # in typical sizes of a term
_NO_LIMIT = 100.0  # times a declared limit; beyond the factor of 55 by which the fits change it
# Points at which a simulation is compared, and the best of them from which it is fitted, where nothing else
# leads to the solution. On CED, three of 32 fitted points reach the minimum, and one of the best 16 of 64.
_POINTS, _FITTED_POINTS = 64, 16
# Of logarithms, to either side; other parameters extend from 0 to twice as many multiples of their scale.
_POINTS_SPREAD = 1.5
# A term (offset, weight, delay) counts where at most one of 100 that do not exist removes as much of the
# error by chance: it is no name, and the held-out runs drop it if it does harm.
_TERM_CRITERIA = SelectionCriteria(chance=0.01)


class _Balance(NamedTuple):
    """Coefficients of the balance of forces along a rigid motion.

    Attributes:
        inertia: Inertia relative to the declared one, dimensionless.
        viscous: Viscous friction with the back-EMF, SI.
        dry: Dry friction, N or Nm.
        offset: Force that the drives exert at rest, N or Nm.
        weight: Nm, of sin(z) and cos(z), beside the offset; (0, 0) for a translation.
    """

    inertia: float
    viscous: float
    dry: float
    offset: float
    weight: tuple[float, float]


class _Removal(NamedTuple):
    """What a plain fit loses without one of its terms.

    Attributes:
        fitted: Fit without the term.
        gain: Reduction of the cost by the term, dimensionless.
        variance: Variance of the residual with the term, in the direction in which it changes the
            predictions.
    """

    fitted: Fit
    gain: float
    variance: LongRunVariance


@dataclass(frozen=True)
class PlainFit:
    """Result of a plain fit.

    Attributes:
        start: The machine with the inertia and friction of the inverse dynamics, without further terms. If
            there is no inverse dynamics (a drive that follows a set point, or no sensor that shows a
            direction), those of the output-error fit.
        fits: Output-error fits with different terms beside inertia and friction: a constant force, a weight
            or an input delay, as effects of their machines. The last one has all terms that the runs show,
            the others fewer.
        uncertain: Fits with further terms, whose reduction of the error on the fitted runs may be chance.
            Other runs may confirm them.
        seconds: Processor time after which the fit ended incomplete, s; None if it is complete.
    """

    start: Machine
    fits: tuple[Fit, ...]
    uncertain: tuple[Fit, ...] = ()
    seconds: float | None = None

    @property
    def simulated(self) -> Fit:
        """The output-error fit (a simulation) with all terms that the runs show: the last of `fits`."""
        return self.fits[-1]

    @property
    def simpler(self) -> tuple[PlainFit, ...]:
        """Plain fits with fewer terms than this one, that without terms first."""
        return tuple(PlainFit(self.start, (fit,), seconds=self.seconds) for fit in self.fits[:-1])

    @property
    def extended(self) -> tuple[PlainFit, ...]:
        """Plain fits with this fit's terms and uncertain ones in addition, the fewest first."""
        return tuple(PlainFit(self.start, (fit,), seconds=self.seconds) for fit in self.uncertain)

    @property
    def machine(self) -> Machine:
        """Machine of the output-error fit with all terms."""
        return self.simulated.machine

    @property
    def terms(self) -> tuple[str, ...]:
        """Labels, name@site, of the fitted constant force, weight and input delay; not declared ones."""
        declared = {e.label for e in self.start.effects}
        return tuple(e.label for e in self.machine.effects if e.label not in declared)


def plain_fit(machine: Machine, data: Dataset, budget: Budget | None = None) -> PlainFit | None:
    """Fit inertia, viscous and dry friction, and, if it helps, a constant force, a weight and an input delay.

    A term is kept if at most one of 100 that do not exist removes as much of the error by chance. Machines
    with belts are not refined in simulation: their rigid motion says nothing about belts.

    Args:
        machine: Machine as declared; it supplies the structure, the unit of force and declared effects.
        budget: Budget of the identification; the fit ends with its best parameters after its part of the
            budget. Default: no limit.

    Returns:
        The fit; None if the runs determine no motion, or no machine of this kind can be simulated over them.
    """
    budget = budget or Budget()
    stage = budget.until(1.0, PLAIN_FIT_PART * budget.seconds) if budget.seconds > 0.0 else Budget()
    equal = representative_part(equally_weighted(data), machine, size=budget.session_part * NORMAL_SESSION)
    with stage.limiting(delivers=True):
        fitted = _fitted(machine, data, equal)
        complete = goes_on()
    return fitted if complete or fitted is None else dataclasses.replace(fitted, seconds=stage.spent)


def _fitted(machine: Machine, data: Dataset, equal: Dataset) -> PlainFit | None:
    """Return the plain fit to equally weighted runs; None if there is none."""
    offsets: tuple[AppliedEffect, ...] = ()
    if not machine.shows_direction:
        points = _fits_from_points(machine, equal)
        if not points:
            return None
        best = min(points, key=_finite_cost)
        start, free = best.machine, wide_parameters(best.machine)
    else:
        # The torque of a drive with a law depends on its unknown gains: no inverse dynamics, but output error
        # at once. No balance shows a constant force then, so that it is tried from zero.
        starts = (
            starting_values(machine, data) if not machine.drive_laws else [(machine, _absent_forces(machine))]
        )
        costs = [
            min(prediction_cost(m, equal, SIMULATION) for m in (start, start.with_effects(*offsets)))
            for start, offsets in starts
        ]
        if not costs or not math.isfinite(min(costs)):
            return None
        start, offsets = starts[int(np.argmin(costs))]
        free = wide_parameters(start)
        cost, count = prediction_cost(start, equal, SIMULATION), len(free)
        best = Fit(start, free, np.zeros(count), cost, equal.count, SIMULATION, np.zeros((count, count)))
        if machine.belts:
            return PlainFit(start, (best,))
        best = min((best, *_output_error_fits(start, free, equal)), key=_finite_cost)
        if machine.drive_laws:
            start, free = best.machine, wide_parameters(best.machine)
    present = {e.label for e in machine.effects}
    terms = tuple(e for e in _terms(start, offsets) if e.label not in present)
    return _with_terms(start, best, terms, equal, _without_limits(machine) if machine.drive_laws else start)


def _with_terms(
    start: Machine, without: Fit, terms: Sequence[AppliedEffect], equal: Dataset, other: Machine
) -> PlainFit:
    """Add the terms that reduce the error, and tell those that the runs show from those that chance explains.

    A term is judged beside all others, because what another one lacks hides it: the terms are first added
    without a test, and then removed again, the least certain one first.

    Args:
        other: Machine from which a fit with a term begins, beside the fit without it.
    """
    fits = [without]
    for term in terms:
        if not goes_on():
            break
        trial = _fit_with_term(other, fits[-1], term, equal)
        if _adds_term(trial, fits[-1], term):
            fits.append(trial)
    candidates = {term.label for term in terms}
    known = {_labels(fitted, candidates): fitted for fitted in fits}
    certain = fits[-1]
    while labels := _labels(certain, candidates):
        if not goes_on():
            return PlainFit(start, tuple(fits))
        removals = [_removal(certain, label, candidates, known, equal) for label in labels]
        weakest = min(
            removals, key=lambda removal: removal.gain / chance_gain(removal.variance, _TERM_CRITERIA)
        )
        if exceeds_chance(weakest.gain, weakest.variance, _TERM_CRITERIA):
            break
        certain = weakest.fitted
    shown = set(_labels(certain, candidates))
    simplest_first = sorted(known, key=len)
    return PlainFit(
        start,
        tuple(known[labels] for labels in simplest_first if shown.issuperset(labels)),
        tuple(known[labels] for labels in simplest_first if shown < set(labels)),
    )


def _labels(fitted: Fit, candidates: Container[str]) -> tuple[str, ...]:
    """Return the labels of the terms that a fit has."""
    return tuple(e.label for e in fitted.machine.effects if e.label in candidates)


def _removal(
    fitted: Fit, label: str, candidates: Container[str], known: dict[tuple[str, ...], Fit], equal: Dataset
) -> _Removal:
    """Fit without one term, if this is not known yet."""
    others = tuple(other for other in _labels(fitted, candidates) if other != label)
    if others not in known:
        effects = tuple(e for e in fitted.machine.effects if e.label != label)
        machine = dataclasses.replace(fitted.machine, effects=effects)
        kept = [k for k, p in enumerate(fitted.free) if not p.name.startswith(f"{label}.")]
        free = tuple(fitted.free[k] for k in kept)
        known[others] = fit(machine, free, equal, SIMULATION, theta=fitted.theta[kept])
    if not _is_present(fitted, label):  # a term beside it took all of it: it is the first to go
        return _Removal(known[others], 0.0, LongRunVariance(1.0))
    gain = known[others].cost - fitted.cost
    return _Removal(known[others], gain, long_run_variance(fitted, label, equal))


def _adds_term(trial: Fit, without: Fit, term: AppliedEffect) -> bool:
    """Return whether a fit with a term has a smaller error by this term, and not by what it only imitates."""
    return trial.cost < without.cost and _is_present(trial, term.label) and not _ends_at_limit(trial, term)


def _is_present(fitted: Fit, label: str) -> bool:
    """Return whether a term's parameters act: with a size of zero, it gains the cost's rounding at most."""
    acting = {parameter.name for parameter in wide_parameters(fitted.machine)}
    return any(p.name in acting for p in fitted.free if p.name.startswith(f"{label}."))


def _ends_at_limit(fitted: Fit, term: AppliedEffect) -> bool:
    """Return whether a delay ends at the limit of its range: it then takes the place of something else."""
    if not term.definition.delay:
        return False
    present = next(e for e in fitted.machine.effects if e.label == term.label)
    return any(present.parameters[p.name] >= (1.0 - AT_LIMIT) * p.upper for p in term.definition.parameters)


def _fit_with_term(start: Machine, fitted: Fit, term: AppliedEffect, equal: Dataset) -> Fit:
    """Fit with one term more, from the fit without it and from another machine."""
    machine, parameters = fitted.machine, _term_parameters(term, fitted.machine)
    trials = [fit(machine.with_effects(term), (*wide_parameters(machine), *parameters), equal, SIMULATION)]
    if not term.definition.delay:
        # Without the term, friction took its place, so that the way back from the fit may be barred.
        own = {e.label for e in start.effects}
        again = start.with_effects(*(e for e in machine.effects if e.label not in own))
        free = (*wide_parameters(again), *parameters)
        trials += _output_error_fits(again.with_effects(term), free, equal)
    best = min(trials, key=_finite_cost)
    if best.cost < fitted.cost:
        return best
    # A size from the balance belongs to the inertia and friction there. Beside those of the fit without the
    # term, it led away: a fit that begins at that one can only become better.
    absent = dataclasses.replace(term, parameters=dict.fromkeys(term.parameters, 0.0))
    free = (*wide_parameters(machine), *_term_parameters(absent, machine))
    return min(best, fit(machine.with_effects(absent), free, equal, SIMULATION), key=_finite_cost)


def _fits_from_points(machine: Machine, data: Dataset) -> list[Fit]:
    """Fit in simulation from the best of many points; let undeclared friction be a tenth of the force."""
    force = typical_force(machine)
    frictions = {f"{c.name}.coulomb": force * c.travel_per_unit for c in machine.coordinates if not c.coulomb}
    start = machine.replace(frictions)
    free = wide_parameters(start)
    points = qmc.Sobol(len(free), seed=0).random(_POINTS)
    thetas = [
        np.array(
            [
                _POINTS_SPREAD * (2.0 * x - 1.0)
                if p.scale is None
                else p.theta(2.0 * _POINTS_SPREAD * x * p.scale)
                for x, p in zip(point, free, strict=True)
            ]
        )
        for point in points
    ]
    costs = [prediction_cost(start.replace(values_at(free, theta)), data, SIMULATION) for theta in thetas]
    finite = [i for i in np.argsort(costs).tolist() if math.isfinite(costs[i])]
    fits: list[Fit] = []
    for i in finite[:_FITTED_POINTS]:
        fits.append(fit(start, free, data, SIMULATION, theta=thetas[i]))
        if not goes_on():
            break
    return fits


def _output_error_fits(machine: Machine, free: Sequence[FreeParameter], data: Dataset) -> list[Fit]:
    """Fit in simulation, which has more local minima, from a machine and from where an observer leads."""
    fits = [fit(machine, free, data, SIMULATION)]
    if goes_on():
        guided = fit(machine, free, data, _GUIDING_BANDWIDTH)
        fits.append(fit(machine, free, data, SIMULATION, theta=guided.theta))
    return fits


def _finite_cost(fitted: Fit) -> float:
    return fitted.cost if math.isfinite(fitted.cost) else math.inf


def equally_weighted(data: Dataset) -> Dataset:
    """Copy a data set so that all measurements of a sensor have the same weight and noise.

    Returns:
        Copy in which the cost of a simulation is the sum of its squared errors, in units of each sensor's
        noise, as in an evaluation.
    """
    runs = (
        dataclasses.replace(
            run,
            noise=np.broadcast_to(data.noise, run.noise.shape),
            weights=np.where(np.isfinite(run.outputs), 1.0, 0.0),
        )
        for run in data.runs
    )
    return dataclasses.replace(data, runs=tuple(runs), means_are_zeros=False)


def refined_equally(fitted: Fit, data: Dataset) -> Fit:
    """Fit the parameters again in simulation, with equal weights of all measurements, as in a plain fit.

    Args:
        fitted: Fit with any observer and any effects.

    Returns:
        Fit of the same parameters; `fitted` itself if it has the smaller error.
    """
    equal = equally_weighted(data)
    refined = fit(fitted.machine, fitted.free, equal, SIMULATION, theta=fitted.theta)
    return refined if refined.cost < prediction_cost(fitted.machine, equal, SIMULATION) else fitted


def wide_parameters(machine: Machine) -> tuple[FreeParameter, ...]:
    """Return the parameters of `default_free_parameters` with priors so wide that data alone determine them.

    Phases of declared effects are added if they are zero, unless the machine ties them: a phase is an angle
    like any other, for example that at which an arm hangs, and its value 0 does not mean that the effect is
    absent. An effect is absent, and has no free parameters, if all its other parameters are zero or fixed.

    Args:
        machine: Machine with the starting values.

    Returns:
        Free parameters, centered on the machine's values. Viscous friction, back-EMF and dry friction that is
        declared as zero may take any value from 0 on.
    """
    free = default_free_parameters(machine)
    known = {parameter.name for parameter in free}
    present = {parameter.name.rpartition(".")[0] for parameter in free if parameter.of_effect}
    phases = (
        FreeParameter(
            f"{effect.label}.{p.name}", 0.0, _TERM_PRIOR, scale=p.scale, lower=p.lower, upper=p.upper
        )
        for effect in machine.effects
        for p in effect.definition.parameters
        if p.role == "phase" and effect.label in present
    )

    def widened(parameter: FreeParameter) -> FreeParameter:
        if parameter.of_effect:
            return dataclasses.replace(parameter, prior=_TERM_PRIOR)
        if parameter.scale is None:
            return dataclasses.replace(parameter, prior=_WIDE_PRIOR)
        return dataclasses.replace(parameter, prior=_TERM_PRIOR, lower=0.0, upper=math.inf)

    added = (phase for phase in phases if phase.name not in known and phase.name not in machine.ties)
    return (*map(widened, free), *added)


def _absent_forces(machine: Machine) -> tuple[AppliedEffect, ...]:
    """Return a constant force of size zero at each coordinate that is driven."""
    driven = {drive.coordinate for drive in machine.drives}
    constant = EFFECTS["constant_force"]
    return tuple(constant.at(c.name, size=0.0) for c in machine.coordinates if c.name in driven)


def _without_limits(machine: Machine) -> Machine:
    """Return a machine whose drives reach no limit of speed or torque.

    At a limit, the motion hardly depends on the gains, and a fit can end where friction takes nearly all of
    the torque.
    """
    largest = {
        f"{law.site}.{p.name}": p.upper
        for law in machine.drive_laws
        for p in law.definition.parameters
        if p.name in ("speed_limit", "torque_limit")
    }
    known = machine.parameters
    return machine.replace(
        {n: min(_NO_LIMIT * known[n], limit) for n, limit in largest.items() if n in known}
    )


def _terms(machine: Machine, offsets: Sequence[AppliedEffect]) -> Iterable[AppliedEffect]:
    """Yield what a plain fit may need beside inertia and friction: offsets, weights, and an input delay."""
    yield from offsets
    for c in machine.coordinates if machine.position_sensors.any() else ():
        if c.kind == "rotary":
            yield EFFECTS["unbalance"].at(c.name, A=0.0, p=0.0)
    yield EFFECTS["input_delay"].at("drives", d=0.0)


def _term_parameters(effect: AppliedEffect, machine: Machine) -> tuple[FreeParameter, ...]:
    """Return the parameters of a term, as linear ones; a weight A sin(q + p) starts at a phase of zero."""
    force = typical_force(machine)
    free = []
    for p in effect.definition.parameters:
        name, value = f"{effect.label}.{p.name}", effect.parameters[p.name]
        size = p.scale
        if p.unit == "force":
            size *= force * machine.coordinate(effect.site).travel_per_unit
        if p.role != "fixed":
            free.append(FreeParameter(name, value, _TERM_PRIOR, scale=size, lower=p.lower, upper=p.upper))
    return tuple(free)


def starting_values(machine: Machine, data: Dataset) -> list[tuple[Machine, tuple[AppliedEffect, ...]]]:
    """Determine inertia and friction from the balance of forces over short windows of time.

    Windows of 0.02 to 0.4 s are tried, because short ones see fast motion and long ones suppress noise.

    Args:
        machine: Machine as declared.
        data: Runs to fit.

    Returns:
        For each length of the windows, a machine with these values and the constant forces of its balance;
        empty if the runs determine no motion. With a declared weight there are two variants: with the
        declared size and with that of the balance, since small angles hardly distinguish it from a constant
        force. If the balance determines neither inertia nor viscous friction (constant speed in each run),
        the declared machine, since a simulation from rest determines both.
    """
    R = leading_motions(machine)
    measured, runs = _with_positions(machine, data.runs)
    found: list[tuple[Machine, tuple[AppliedEffect, ...]]] = []
    moves = False
    for span in _SPANS if len(R) else ():
        windows = [motion_windows(r, comparison_window(r.outputs, r.time_s, span)) for r in runs]
        coefficients = _balance(measured, R, windows, span)
        moves = moves or coefficients is not None
        if coefficients:
            names = {k: machine.coordinate_names[int(np.argmax(np.abs(R[k]) > 0.0))] for k in coefficients}
            forces = (EFFECTS["constant_force"].at(names[k], size=-b.offset) for k, b in coefficients.items())
            present = {e.label for e in machine.effects}
            added = tuple(e for e in forces if e.label not in present)
            start = _with_coefficients(machine, R, coefficients)
            found.append((start, added))
            weights = _weights(machine, {names[k]: b.weight for k, b in coefficients.items()})
            if weights:
                found.append((start.replace(weights), added))
    return found or ([(machine, ())] if moves else [])


def _with_positions(
    machine: Machine, runs: Sequence[PreparedRecording]
) -> tuple[Machine, list[PreparedRecording]]:
    """Return a machine and its runs with integrated speeds as positions, if it measures no positions."""
    speeds = np.array([s.of_velocity for s in machine.sensors], np.bool_)
    if machine.position_sensors.any() or not speeds.any():
        return machine, list(runs)
    encoders = [dataclasses.replace(s, kind="encoder") for s in machine.sensors if s.of_velocity]

    def integrated(run: PreparedRecording) -> PreparedRecording:
        """Integrate by trapezoids, across rows in which the sensor did not measure."""
        values = np.nan_to_num(bridge_blanks(run.outputs, run.time_s, math.inf))
        positions = cumulative_trapezoid(values, run.time_s, axis=0, initial=0.0)
        return dataclasses.replace(run, outputs=np.where(speeds, positions, run.outputs))

    return machine.with_components(*encoders), [integrated(run) for run in runs]


def _balance(
    machine: Machine, R: Array, windows: Sequence[MotionWindows], span: float
) -> dict[int, _Balance] | None:
    """Return the balance of each motion that shows inertia or viscous friction; None if none moves."""
    mass = np.array([c.mass for c in machine.coordinates])
    declared = np.diag(R @ (mass[:, None] * R.T))
    as_measured = np.eye(len(machine.sensors)), np.eye(len(machine.drives))
    determined = [e for e in force_equations(windows, machine, *as_measured, spring=False) if e.determined]
    found = {}
    for equations in determined:
        coefficients = _robust_nonnegative(equations.columns, equations.force)
        inertia, viscous, dry = map(float, coefficients[:3])
        offset, *weight = map(float, coefficients[3::2] - coefficients[4::2])
        least = _SHORTEST_TIME_CONSTANT * span * viscous / declared[equations.motion]
        least_force = _LEAST_FRICTION * float(np.sqrt(np.mean(equations.force**2)))
        dry = max(dry, least_force)
        viscous = max(viscous, least_force / float(np.sqrt(np.mean(equations.columns[:, 1] ** 2))))
        if max(inertia, least) > 0.0:
            sine, cosine = weight or (0.0, 0.0)
            found[equations.motion] = _Balance(max(inertia, least), viscous, dry, offset, (sine, cosine))
    return found if determined else None


def _robust_nonnegative(columns: Array, values: Array) -> Array:
    """Solve columns @ x = values for x >= 0 by least squares in which large residuals count less (Huber)."""
    scale = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    weights = np.ones(len(values))
    solution = np.zeros(columns.shape[1])
    for _ in range(_REWEIGHTINGS):
        solution, _ = nnls(columns / scale * weights[:, None], values * weights)
        residual = np.abs(values - columns / scale @ solution)
        limit = max(_ROBUST * float(np.median(residual)), np.finfo(float).tiny)
        weights = 1.0 / np.sqrt(np.maximum(1.0, residual / limit))
    return np.asarray(solution / scale)


def _weights(machine: Machine, found: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Return the amplitudes, Nm, of the weights that a machine declares, with their declared phases."""
    amplitudes = {}
    for effect in machine.effects:
        if effect.name == "unbalance" and effect.site in found:
            sine, cosine = found[effect.site]
            phase = effect.parameters["p"]
            amplitudes[f"{effect.label}.A"] = -sine * math.cos(phase) - cosine * math.sin(phase)
    return amplitudes


def _with_coefficients(machine: Machine, R: Array, found: Mapping[int, _Balance]) -> Machine:
    """Return a machine whose inertia and friction along rigid motions are those of the balance.

    The parameters of each coordinate keep their ratio to those of other coordinates of the same motion.
    """
    names = machine.coordinate_names
    mass = np.array([c.mass for c in machine.coordinates])
    dry = np.array([c.coulomb for c in machine.coordinates])
    back_emf = np.sum([machine.coefficients({d.coordinate: d.back_emf}) for d in machine.drives], axis=0)
    damping = np.array([c.viscous for c in machine.coordinates]) + back_emf
    motions = R[list(found)]
    inertias, dampings, frictions = np.array([(b.inertia, b.viscous, b.dry) for b in found.values()]).T
    masses = mass * _ratios(motions**2 * mass, inertias)
    of_damping = _ratios(
        motions**2 * damping, dampings / np.maximum(motions**2 @ damping, np.finfo(float).tiny)
    )
    of_friction = _ratios(
        np.abs(motions) * dry, frictions / np.maximum(np.abs(motions) @ dry, np.finfo(float).tiny)
    )
    values: dict[str, float] = {}
    for i, (name, c) in enumerate(zip(names, machine.coordinates, strict=True)):
        values |= {
            f"{name}.mass": float(masses[i]),
            f"{name}.viscous": float(c.viscous * of_damping[i]),
            f"{name}.coulomb": float(c.coulomb * of_friction[i]),
        }
    for motion, viscous, friction in zip(motions, dampings, frictions, strict=True):
        leading = int(np.argmax(np.abs(motion) > 0.0))  # it takes all friction where none is declared
        if not (motion**2 @ damping) > 0.0:
            values[f"{names[leading]}.viscous"] = float(viscous)
        if not (np.abs(motion) @ dry) > 0.0:
            values[f"{names[leading]}.coulomb"] = float(friction)
    for drive in machine.drives:
        values[f"{drive.name}.Ke"] = float(drive.Ke * of_damping[names.index(drive.coordinate)])
    return machine.replace(
        {n: v for n, v in values.items() if n in machine.parameters and n not in machine.ties}
    )


def _ratios(shares: Array, ratios: Array) -> Array:
    """Return a factor for each coordinate: the mean ratio of the motions, weighted by its share in each."""
    total = shares.sum(axis=0)
    logarithms = np.log(np.maximum(ratios, _LEAST_RATIO)) @ shares
    return np.exp(np.divide(logarithms, total, out=np.zeros_like(total), where=total > 0.0))


def better_start(machine: Machine, data: Dataset, plain: PlainFit | None) -> Machine:
    """Choose the machine from which a refit starts: as declared, or with the values of the plain fit.

    A refit keeps each parameter within a range around the start. The plain values are used if three
    conditions hold: one of them lies outside the range around the declared values, the refit from the
    declared values ends at a limit, and the refit from the plain values is better by
    `judge.error.is_better_start`. Without a sensor that shows a direction, only the last condition counts,
    because a refit may end at another minimum.

    Args:
        machine: Machine as declared.
        data: Runs to fit.
        plain: Plain fit to these runs, if there is one.

    Returns:
        `machine` or `plain.start`.
    """
    many_minima = not machine.shows_direction
    if plain is None or not (many_minima or outside_limits(machine, plain.start)):
        return machine
    refits = [fit(m, default_free_parameters(m), data, SEARCH_BANDWIDTH) for m in (machine, plain.start)]
    declared, other = refits
    if not math.isfinite(other.cost):
        return machine
    ends_inside = not any(map(FreeParameter.at_limit, declared.free, declared.theta))
    if math.isfinite(declared.cost) and ends_inside and not many_minima:
        return machine
    equal = equally_weighted(data)
    simulated = [prediction_cost(f.machine, equal, SIMULATION) for f in refits]
    better = is_better_start((other.cost, declared.cost), (simulated[1], simulated[0]))
    return plain.start if better else machine


def outside_limits(declared: Machine, machine: Machine) -> tuple[str, ...]:
    """Return the names of parameters whose values a refit from the declared ones could not reach.

    A refit keeps each parameter within limits around its declared value (`FreeParameter.theta_limits`).
    Friction below its lower limit does not count, because it is small in any case.

    Args:
        declared: Machine as declared.
        machine: Machine with other values.

    Returns:
        Full names such as "x.mass".
    """
    names = []
    for parameter in default_free_parameters(declared):
        value = machine.parameters.get(parameter.name, 0.0)
        low, high = parameter.theta_limits
        if parameter.name.endswith((".viscous", ".coulomb")):
            low = -math.inf
        if parameter.scale is None and value <= 0.0:
            continue
        if not low <= parameter.theta(value) <= high:
            names.append(parameter.name)
    return tuple(names)
