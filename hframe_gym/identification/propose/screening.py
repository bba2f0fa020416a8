"""Rank candidate effects by the reduction of the cost that a linearized model predicts, without fitting any.

The cost is chi-squared, the sum of squared residuals in units of the noise. A candidate effect of small size adds a
known force, or a known change of a measurement, along the fitted machine's motion. The response of the predicted
measurements to it is one column of the linearized residual. After elimination of the machine's free parameters, the
squared correlation of column and residual is the reduction of the cost that a fit of the candidate would achieve.

Effects that replace a part of the model cannot have a small size: structural effects add coordinates (a yawing bridge,
idlers with inertia), others replace dry friction (presliding). Each of their starting values is simulated instead, and
the difference from the present machine's prediction is the column.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...dynamics import Equations
from ...dynamics.motion_forces import KnownMotion, ohmic_currents
from ...dynamics.simulation import Motion, parameter_batch
from ...effects import EFFECTS, effect_sites
from ...effects.smooth_table import TABLE_FAMILY
from ...machine import UNITS, AppliedEffect, Effect, Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ..budget import spender
from ..fit.estimation import Fit
from ..fit.typical_scales import TypicalScales
from ..predict.free_parameters import FreeParameter, prior_precision, second_difference_penalty
from ..predict.linearization import DIFFERENCE_STEP, ResidualModel
from ..predict.normal_equations import NormalEquations
from ..predict.prediction import mechanical_rows_per_block, predict
from .candidates import Candidate

_COLUMNS_AT_ONCE = 64  # simulated together: their forces stay in the processor's cache, and memory is bounded
_MIMICKED = 1e-6  # fraction of a column's square below which the machine's parameters explain it entirely
_RIDGE = 1e-9
_SMALL_FRACTION = 1e-4  # fraction of the typical amplitude at which a nonlinear effect is linearized
_FITTED_STRUCTURES = 3  # effects that replace a part of the model and are fitted


class Perturbation(NamedTuple):
    """Forces and changes of measurements that the basis functions of candidate effects cause along a motion.

    One column is one basis function of an effect (for example a sine or a cosine) at its typical size; n is the number
    of samples.

    Attributes:
        force: Force on every coordinate, N or Nm, shape (columns, n, coordinates).
        measurement: Change of the sensors' output, in the sensors' units, shape (columns, n, sensors).
    """

    force: Array
    measurement: Array


class ScoredCandidate(NamedTuple):
    """A candidate with its predicted benefit.

    Attributes:
        candidate: Effect, site and starting values.
        gain: Predicted reduction of chi-squared, summed over all samples.
        amounts: Weights of its basis functions (`Candidate.columns`) with which this reduction is reached,
            dimensionless.
    """

    candidate: Candidate
    gain: float
    amounts: tuple[float, ...]


class Resemblance(NamedTuple):
    """An effect that moves the machine in the recorded runs nearly as another one does.

    Attributes:
        effect: The effect, with the parameters with which it resembles the other one most.
        loss: Increase of chi-squared if it takes the place of the other one, to first order.
    """

    effect: AppliedEffect
    loss: float


@dataclass(frozen=True)
class Screening:
    """Candidates of a fitted machine, beside the linearized residual that ranks them.

    A candidate is a weighted sum of basis functions, such as sine and cosine. The residual is linearized with respect
    to these weights and the machine's free parameters. The best weights and parameters follow from a linear equation.

    Attributes:
        fit: Fit of the machine without the candidates; they are evaluated at its observer bandwidth.
        data: Runs that were fitted.
        candidates: Effects, sites (components) and starting values to compare.
        removed: Labels (name@site) of effects of the machine that may be removed.
        compared: Labels of effects of the machine that the candidates may resemble.
        equations: Products of the residual. Its perturbations are the removal of each effect in `removed`, in a machine
            that is otherwise the same, then each effect in `compared`, then the basis functions of the candidates.
    """

    fit: Fit
    data: Dataset
    candidates: Sequence[Candidate]
    removed: tuple[str, ...]
    compared: tuple[str, ...]
    equations: NormalEquations

    @classmethod
    def of(
        cls,
        fit: Fit,
        candidates: Sequence[Candidate],
        data: Dataset,
        *,
        without: Mapping[str, Machine] | None = None,
        compared: Sequence[Candidate] = (),
    ) -> Screening:
        """Linearize the residual of a fit.

        Args:
            fit: Fit of the machine without the candidates.
            candidates: Candidates, at least one.
            data: Runs that were fitted.
            without: By the label of an effect, the fitted machine without it. Default: none.
            compared: Effects that the candidates may resemble, each with its parameters as the only column; they
                neither add coordinates nor replace dry friction.
        """
        model, may_go_on, without = _screening_model(fit, data), spender(), without or {}
        own = [
            machine._replace(step=_difference_step(effect))
            for effect in compared
            for machine in perturbed_machines(model.machine, [effect])
        ]
        perturbed = [*own, *perturbed_machines(model.machine, candidates)]

        def responses(run: PreparedRecording, motion: Motion) -> Array:
            may_go_on()
            fitted = model.residuals(run, motion.readings)
            of_removals = [_prediction_residual(model, machine, run) - fitted for machine in without.values()]
            return np.vstack([*of_removals, _responses(model, perturbed, run, motion)])

        equations = model.linearize(fit.theta, responses).normal_equations
        labels = tuple(effect.label for effect in compared)
        return cls(fit, data, candidates, tuple(without), labels, equations)

    def ranked(self) -> list[ScoredCandidate]:
        """Rank the candidates by the reduction of chi-squared that the linearized model predicts, if they are added.

        Returns:
            Candidates with the weights of their basis functions and the reduction of chi-squared (summed over all
            samples, dimensionless), in the order of decreasing reduction. It is 0 if only an amplitude outside its
            bounds would reduce chi-squared, or if the machine's free parameters can represent the candidate.
        """
        return self._ranked(self.equations, self.fit.free)[0]

    def in_place_of(self, label: str) -> tuple[list[ScoredCandidate], float]:
        """Rank the candidates by the same reduction, from the machine without one of the removable effects.

        Args:
            label: Label of the effect.

        Returns:
            The other effects that do not need this one, as from `ranked`, and the reduction of chi-squared by the
            effect itself; no candidate and infinity if the machine without it diverges.
        """
        equations = self.equations.with_added(self.removed.index(label))
        if not math.isfinite(equations.cost):
            return [], math.inf
        free = self._free_without(label)
        ranked, least_cost = self._ranked(equations, free)
        others = [scored for scored in ranked if not _needs(scored.candidate, label)]
        return others, least_cost - self.equations.cost

    def resembling(self, label: str) -> list[Resemblance]:
        """Find the candidates that these runs hardly distinguish from one of the compared effects.

        What the effect changes in the predictions is a regressor over the recorded motion, as is every basis function
        of the candidates; what the machine's free parameters can reproduce of them is removed. The part of the effect's
        regressor that a candidate's cannot represent is what the runs show of the difference between both. In a single
        sine, for example, position and speed are one variable, at constant speed position and time are.

        Args:
            label: Label of the effect.

        Returns:
            Each candidate effect and site once, without those that need the effect; the most similar one first.
        """
        own = len(self.removed) + self.compared.index(label)
        free = self._free_without(label)
        equations = self.equations.of_some(self._kept(free), np.array([own, *self._of_candidates()]))
        ridge = np.diag(_RIDGE * np.diag(equations.information))
        products = equations.eliminate_parameters(prior_precision(free) + ridge).response_information
        size, found = float(products[0, 0]), dict[str, Resemblance]()
        for candidate, columns in self._with_columns(1):
            if _needs(candidate, label):
                continue
            information = products[np.ix_(columns, columns)]
            before = np.diag(equations.response_information)[columns]
            if not np.all(np.isfinite(information)) or not np.any(np.diag(information) > _MIMICKED * before):
                continue
            # The gradient of the cost of representing the effect's regressor, as for the residual.
            scored = _score(candidate, information, -products[columns, 0], before, 1.0)
            loss = max(size - scored.gain, 0.0)
            known = found.get(candidate.label)
            if scored.gain > 0.0 and (known is None or loss < known.loss):
                found[candidate.label] = Resemblance(candidate.applied(scored.amounts), loss)
        return sorted(found.values(), key=lambda resemblance: resemblance.loss)

    def _ranked(
        self, equations: NormalEquations, free: Sequence[FreeParameter]
    ) -> tuple[list[ScoredCandidate], float]:
        """Return the ranked candidates, and the cost without any, where only some parameters are free."""
        equations = equations.of_some(self._kept(free), self._of_candidates())
        # The ridge keeps the elimination possible where parameters have the same influence on the measurements.
        precision = prior_precision(free) + np.diag(_RIDGE * np.diag(equations.information))
        reduced = equations.eliminate_parameters(precision)
        scored = []
        for candidate, columns in self._with_columns(0):
            # Square of each response before and after the free parameters took what they can reproduce of it.
            before = equations.response_information[columns, columns]
            information = reduced.response_information[np.ix_(columns, columns)]
            gradient = reduced.response_gradient[columns]
            scored.append(_score(candidate, information, gradient, before, self.fit.chi2))
        return sorted(scored, key=lambda s: -s.gain), equations.least_cost(precision)

    def _free_without(self, label: str) -> tuple[FreeParameter, ...]:
        """Return the free parameters without those of an effect."""
        return tuple(f for f in self.fit.free if not f.name.startswith(f"{label}."))

    def _kept(self, free: Sequence[FreeParameter]) -> NDArray[np.bool_]:
        """Return which of the fit's parameters are free, shape (k,)."""
        names = {f.name for f in free}
        return np.array([f.name in names for f in self.fit.free], bool)

    def _of_candidates(self) -> NDArray[np.intp]:
        """Return the indices of the candidates' basis functions among the perturbations."""
        return np.arange(len(self.removed) + len(self.compared), len(self.equations.response_gradient))

    def _with_columns(self, first: int) -> Iterator[tuple[Candidate, NDArray[np.intp]]]:
        """Yield each candidate with the indices of its basis functions, which begin at the first."""
        for candidate in self.candidates:
            yield candidate, np.arange(first, first + len(candidate.columns))
            first += len(candidate.columns)


def _needs(candidate: Candidate, label: str) -> bool:
    """Return whether a candidate requires the effect so labeled."""
    return f"{candidate.effect.requires}@{candidate.site}" == label


def screen(fit: Fit, candidates: Sequence[Candidate], data: Dataset) -> list[ScoredCandidate]:
    """Rank candidate effects by the reduction of chi-squared that a linearized model predicts, without fitting any.

    Args:
        fit: Fit of the machine without the candidates.
        candidates: Effects, sites (components) and starting values to compare.
        data: Runs that were fitted.

    Returns:
        The candidates in the order of `Screening.ranked`.
    """
    return Screening.of(fit, candidates, data).ranked() if candidates else []


class PerturbedMachine(NamedTuple):
    """Machine with one effect at one site, in as many variants as its candidates have basis functions.

    Attributes:
        effect: Definition of the effect.
        columns: Number of variants.
        fraction: Size of the variants as a fraction of that of the basis functions, dimensionless.
        equations: Equations of the machine with the effect; each parameter of it has the shape (columns, 1).
        step: Fraction of the basis functions by which predictions are changed to get derivatives, dimensionless.
    """

    effect: Effect
    columns: int
    fraction: float
    equations: Equations
    step: float = DIFFERENCE_STEP


def _difference_step(own: Candidate) -> float:
    """Return the fraction of an effect with which derivatives change predictions as much as with its typical size.

    Friction that sticks and slips limits how accurately small changes are known: an error of an encoder, 4 % of the
    typical one, had 3.5 times the response that it has.
    """
    ratios = [
        abs(amplitude.scale * own.scales.get(amplitude.unit, 1.0) / value)
        for amplitude in own.effect.parameters
        if amplitude.amplitude and (value := own.columns[0][amplitude.name])
    ]
    return DIFFERENCE_STEP * min(ratios, default=1.0)


def perturbed_machines(machine: Machine, candidates: Sequence[Candidate]) -> list[PerturbedMachine]:
    """Return the machine with each of some effects, for `candidate_perturbations` along several motions.

    Args:
        candidates: Candidate effects. Successive ones with the same effect and site are variants of one machine.
    """
    bare, perturbed = _without_effects(machine), []
    for _, group in itertools.groupby(candidates, key=lambda c: c.label):
        members = list(group)
        effect, columns = members[0].effect, [column for c in members for column in c.columns]
        # A small amplitude keeps the response linear: a Coulomb level cannot become negative, and the force of an
        # eccentric pulley contains the product of belt travel and lever arm.
        fraction = _SMALL_FRACTION if effect.coulomb or effect.belt_travel else 1.0
        scales = {name: fraction if name in effect.amplitudes else 1.0 for name in columns[0]}
        # Shape (columns, 1) each, so that all basis functions are evaluated at all samples at once.
        parameters = {
            name: np.array([[scale * column[name]] for column in columns]) for name, scale in scales.items()
        }
        applied = AppliedEffect(effect, members[0].site, parameters)
        equations = Equations(dataclasses.replace(bare, effects=(applied,)))
        perturbed.append(PerturbedMachine(effect, len(columns), fraction, equations))
    return perturbed


def _without_effects(machine: Machine) -> Machine:
    """Return a machine without effects; coordinates that they added stay."""
    return dataclasses.replace(machine, effects=())


class Unperturbed:
    """Motion of a machine along a run, with its forces and readings, which candidate effects change.

    Args:
        machine: The machine; effects that it has are left out, because candidates do not interact with them.
        run: Run with the sample times and voltages of the motion.
        motion: Motion of the machine with positions and velocities, a batch of one, n samples.

    Attributes:
        motion: The motion.
        known: The same, for the forces of machines with one more effect.
        forces: Net force on each coordinate, N or Nm, shape (n,).
        time_s: Sample times, s, shape (n,).
        readings: Ideal reading of each sensor, in its unit, shape (n,) each.
    """

    def __init__(self, machine: Machine, run: PreparedRecording, motion: Motion) -> None:
        bare = _without_effects(machine)
        equations, q, v = Equations(bare), motion.positions[0], motion.velocities[0]
        self.motion, self.time_s = motion, run.time_s
        self.known = KnownMotion(equations, run.time_s, q, v, run.inputs)
        self.forces = self.known.by_coordinate(equations)
        accelerations, currents = np.gradient(v, run.time_s, axis=0), ohmic_currents(bare, v, run.inputs)
        self._columns = [list(values.T) for values in (q, v, accelerations, currents)]
        self.readings = self.readings_of(equations)

    def readings_of(self, equations: Equations) -> list[Array]:
        """Return the ideal reading of each sensor along the motion.

        Args:
            equations: Equations of the machine, with effects or without.

        Returns:
            Readings in the sensors' units, shape (n,) each, or (columns, n) for several variants of an effect.
        """
        return equations.sensor_readings(*self._columns)


def candidate_perturbations(unperturbed: Unperturbed, perturbed: Sequence[PerturbedMachine]) -> Perturbation:
    """Compute the forces and measurement changes that candidate effects of typical size cause along a motion.

    `screen` linearizes the residual with them. They are approximate in three respects: the motion is computed for the
    machine without the candidate, the candidate does not interact with other effects, and forces are constant from each
    sample to the next.

    Args:
        unperturbed: Motion of the machine, n samples.
        perturbed: The machine with each of the candidate effects, from `perturbed_machines`.

    Returns:
        Forces, N or Nm, shape (columns, n, coordinates), and changes of measurements, m or rad, shape
        (columns, n, sensors). A column is one basis function of one candidate, in the order of `Candidate.columns`.
    """
    count, first, motion = sum(each.columns for each in perturbed), 0, unperturbed.motion
    force = np.zeros((count, *motion.positions.shape[1:]))
    measurement = np.zeros((count, *motion.readings.shape[1:]))
    for each in perturbed:
        rows = slice(first, first + each.columns)
        first += each.columns
        if _acts_on_sensors(each.effect):
            measurement[rows] = _measurement_change(each.equations, unperturbed)
        else:
            changed = unperturbed.known.by_coordinate(each.equations)
            for i, (with_effect, without) in enumerate(zip(changed, unperturbed.forces, strict=True)):
                if with_effect.ndim > 1 or not np.array_equal(with_effect, without):
                    force[rows, :, i] = (with_effect - without) / each.fraction
    return Perturbation(force, measurement)


def _acts_on_sensors(effect: Effect) -> bool:
    """Return whether an effect changes measurements instead of forces."""
    return bool(effect.measurement or effect.measurement_delay)


def _measurement_change(equations: Equations, unperturbed: Unperturbed) -> Array:
    """Return the change of ideal measurements by effects on sensors, shape (columns or 1, n, sensors).

    A measurement delay d is approximated to first order: the measurement changes by -d times its rate.
    """
    changes = []
    for measured, without, delay, values in zip(
        unperturbed.readings_of(equations),
        unperturbed.readings,
        equations.measurement_delays(),
        unperturbed.motion.readings[0].T,
        strict=True,
    ):
        change = measured - without
        if np.any(delay):
            change = change - delay * np.gradient(values, unperturbed.time_s)
        changes.append(np.atleast_2d(change))
    return np.stack(np.broadcast_arrays(*changes), axis=-1)


def _screening_model(fit: Fit, data: Dataset) -> ResidualModel:
    """Return the residual of a fit with rows combined to blocks that are short for mechanical effects."""
    return ResidualModel(
        fit.machine, fit.free, data, fit.bandwidth, rows_per_block=mechanical_rows_per_block(data)
    )


def _prediction_residual(model: ResidualModel, machine: Machine, run: PreparedRecording) -> Array:
    """Return the residual of a run that another machine predicts, shape (1, rows)."""
    predicted = predict(
        machine, run, model.bandwidth, period=model.data.period, longest_step=model.longest_step
    )
    return model.residuals(run, predicted.readings)


def _responses(
    model: ResidualModel, perturbed: Sequence[PerturbedMachine], run: PreparedRecording, motion: Motion
) -> Array:
    """Return the derivatives of a run's residual by the columns of candidates, shape (columns, rows)."""
    start = run.initial_state(model.machine)

    def residual(force: Array, measurement: Array | None) -> Array:
        moved = predict(
            model.machine,
            run,
            model.bandwidth,
            period=model.data.period,
            initial_state=start,
            extra_force=force,
            extra_measurement=measurement,
            longest_step=model.longest_step,
        )
        return model.residuals(run, moved.readings)

    # The unperturbed residual comes from the same kernel, the one that takes extra forces.
    unperturbed = residual(np.zeros((1, *motion.positions.shape[1:])), None)
    columns, along = [], Unperturbed(model.machine, run, motion)
    for part in _parts(perturbed):
        force, measurement = candidate_perturbations(along, part)
        of_sensors = any(_acts_on_sensors(each.effect) for each in part)
        step = np.repeat([each.step for each in part], [each.columns for each in part])
        by_column = step[:, None, None]
        force *= by_column
        changed = residual(force, by_column * measurement if of_sensors else None)
        changed -= unperturbed
        columns.append(changed / step[:, None])
    return np.vstack(columns)


def _parts(perturbed: Sequence[PerturbedMachine]) -> Iterator[list[PerturbedMachine]]:
    """Divide perturbed machines, in their order, into parts of few columns."""
    part: list[PerturbedMachine] = []
    for each in perturbed:
        if part and sum(other.columns for other in (*part, each)) > _COLUMNS_AT_ONCE:
            yield part
            part = []
        part.append(each)
    yield part


def _score(
    candidate: Candidate, information: Array, gradient: Array, before: Array, chi2: float
) -> ScoredCandidate:
    """Return the cost that a candidate would save with its best admissible amounts.

    information and gradient are of its columns after elimination of the free parameters, `before` of those before it.
    The cost per value of the present fit, chi2, scales the smoothness prior of tables.
    """
    nothing = ScoredCandidate(candidate, 0.0, (0.0,) * len(gradient))
    if not np.all(np.isfinite(information)) or not np.any(np.diag(information) > _MIMICKED * before):
        return nothing
    ridge = _RIDGE * np.diag(np.maximum(np.diag(information), 1e-300))
    if candidate.effect.family == TABLE_FAMILY:
        ridge += chi2 * second_difference_penalty(len(gradient))
    if candidate.has_no_amplitude:
        amounts: Array = np.ones_like(gradient)
    else:
        amounts = np.array(-np.linalg.solve(information + ridge, gradient), float)
        if len(amounts) == 1:
            amplitude = candidate.effect.parameter(candidate.effect.amplitudes[0])
            unit = candidate.columns[0][amplitude.name]
            amounts = np.array(np.clip(amounts, amplitude.lower / unit, amplitude.upper / unit), float)
    gain = float(-2 * amounts @ gradient - amounts @ information @ amounts)
    if not gain > 0.0:
        return nothing
    return ScoredCandidate(candidate, gain, tuple(amounts.tolist()))


def _is_simulated(effect: Effect) -> bool:
    """Return whether starting values of an effect are simulated to rank them.

    Effects that replace a part of the model are, and those whose amplitude has starting values: a large one acts in
    another way than a small one. Play that exceeds the extension of a belt leaves no tension at all.
    """
    return effect.replaces_model_part or any(p.amplitude and any(p.grid) for p in effect.parameters)


def screen_structures(
    current: Fit, data: Dataset, scale: TypicalScales, minimum_gain: float
) -> list[Machine]:
    """Build machines with the most promising effects that replace a part of the nominal model, one effect each.

    These effects add coordinates (structural effects) or replace dry friction. The linearization underestimates their
    benefit and is no reliable ranking; therefore the three best effects are returned, structural ones with their two
    best sets of starting values.

    Args:
        current: Fit of the machine without such an effect; the effects are evaluated at its observer bandwidth.
        data: Runs that were fitted.
        scale: Typical sizes on this machine, by which relative starting values are multiplied.
        minimum_gain: Smallest linearized reduction of chi-squared per sample, dimensionless, of a promising effect.

    Returns:
        Copies of the fitted machine, each with one more effect (the last in its list, with starting values); most
        promising first.
    """
    present = {e.label for e in current.machine.effects}
    simulated = {
        (effect, site): _variants(effect, site, current.machine, scale)
        for effect in filter(_is_simulated, EFFECTS.values())
        for site in effect_sites(effect, current.machine)
        if f"{effect.name}@{site}" not in present
    }
    promising: list[tuple[float, list[Machine]]] = []
    for (effect, site), gains in _structure_gains(simulated, current, data).items():
        if gains.max() > minimum_gain * data.count:
            best = np.argsort(-gains)[: 2 if effect.structure else 1]
            promising.append((float(gains.max()), [simulated[effect, site][int(k)] for k in best]))
    promising.sort(key=lambda p: -p[0])
    return [variant for _, variants in promising[:_FITTED_STRUCTURES] for variant in variants]


def _variants(effect: Effect, site: str, machine: Machine, scale: TypicalScales) -> list[Machine]:
    """Return copies of a machine with an effect at a site, one for each combination of starting values."""
    starting_values = _starting_values(effect, scale.of(machine.coordinate_of_site(site, effect.site) or ""))
    return [machine.with_effects(effect.at(site, **values)) for values in starting_values]


def _starting_values(effect: Effect, typical: Mapping[str, float]) -> list[dict[str, float]]:
    """Return the grid of an effect's starting values, within bounds.

    They are multiples of typical values, but absolute, SI, for structural effects where the unit is not of the site.
    """
    grids = []
    for p in effect.parameters:
        absolute = effect.structure is not None and p.unit not in UNITS["linear"]
        scale = 1.0 if absolute else typical.get(p.unit, 1.0)
        grids.append(sorted({min(max(g * scale, p.lower), p.upper) for g in p.grid}))
    names = [p.name for p in effect.parameters]
    return [dict(zip(names, values, strict=True)) for values in itertools.product(*grids)]


def _structure_gains(
    simulated: Mapping[tuple[Effect, str], Sequence[Machine]], current: Fit, data: Dataset
) -> dict[tuple[Effect, str], Array]:
    """Return the linearized reduction of the cost towards each variant, shape (variants,) for each effect and site.

    The difference of the two predictions, without the part that the free parameters can reproduce, is multiplied by its
    best positive weight.
    """
    if not simulated:
        return {}
    model, batches = _screening_model(current, data), _batches(simulated, current.machine)
    may_go_on = spender()

    def responses(run: PreparedRecording, motion: Motion) -> Array:
        predicted = []
        for machine, parameters in batches:
            may_go_on()  # new code may have to be compiled for each
            predicted.append(
                predict(machine, run, model.bandwidth, period=data.period, parameters=parameters)
            )
        expected = model.residuals(run, motion.readings)
        changes = np.vstack([model.residuals(run, moved.readings) for moved in predicted]) - expected
        # a variant may diverge
        return np.where(np.isfinite(changes).all(axis=1, keepdims=True), changes, 0.0)

    equations = model.linearize(current.theta, responses).normal_equations
    reduced = equations.eliminate_parameters(prior_precision(current.free))
    squares, gradient = np.diag(reduced.response_information), reduced.response_gradient
    gains = np.where(gradient < 0.0, gradient**2 / np.maximum(squares, 1e-300), 0.0)
    ends = np.cumsum([len(variants) for variants in simulated.values()])
    return dict(zip(simulated, np.split(np.where(np.isfinite(gains), gains, 0.0), ends[:-1]), strict=True))


def _batches(
    simulated: Mapping[tuple[Effect, str], Sequence[Machine]], machine: Machine
) -> list[tuple[Machine, Array]]:
    """Return machines and parameters (variants, P) that simulate all variants, in their order.

    Each machine needs newly compiled code. An effect that disappears at zero amplitude is therefore added at all its
    sites to one machine; its amplitude is zero at all sites but one.
    """
    batches = []
    for effect, members in itertools.groupby(simulated.items(), key=lambda item: item[0][0]):
        groups = [variants for _, variants in members]
        if effect.replaces_model_part:
            batches += [
                (variants[0], np.vstack([parameter_batch(v) for v in variants])) for variants in groups
            ]
        else:
            everywhere = machine.with_effects(*(variants[0].effects[-1] for variants in groups))
            none = {
                f"{e.label}.{name}": 0.0
                for e in everywhere.effects[-len(groups) :]
                for name in effect.amplitudes
            }
            everywhere = everywhere.replace(none)
            rows = [parameter_batch(everywhere.replace(v.parameters)) for v in itertools.chain(*groups)]
            batches.append((everywhere, np.vstack(rows)))
    return batches
