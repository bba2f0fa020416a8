"""Rank effects that replace a part of the model, and those with simulated start values, by their promise.

An effect that replaces a part of the model cannot have a small size: structural effects add coordinates (a
yawing bridge, idlers with inertia), others replace dry friction (presliding). Each of their starting values
is simulated, and the difference from the present machine's prediction takes the place of the response that
`screening` linearizes.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from ...arrays import Array
from ...dynamics.simulation import Motion, parameter_batch
from ...effects import EFFECTS, effect_sites
from ...machine import UNITS, Effect, Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ..budget import spender
from ..fit.estimation import Fit
from ..predict.free_parameters import prior_precision
from ..predict.prediction import predict
from .screening import LimitedResidual, screening_model
from .typical_scales import TypicalScales

_FITTED_STRUCTURES = 3  # effects that replace a part of the model and are fitted


def _is_simulated(effect: Effect) -> bool:
    """Return whether starting values of an effect are simulated to rank them.

    Effects that replace a part of the model are, and those whose amplitude has starting values: a large one
    acts in another way than a small one. Play that exceeds the extension of a belt leaves no tension at all.
    """
    return effect.replaces_model_part or any(p.amplitude and any(p.grid) for p in effect.parameters)


def screen_structures(
    current: Fit, data: Dataset, scale: TypicalScales, minimum_gain: float
) -> list[Machine]:
    """Build machines with the most promising effects that replace a part of the model, one effect each.

    These effects add coordinates (structural effects) or replace dry friction. The linearization
    underestimates their benefit and is no reliable ranking; therefore the three best effects are returned,
    structural ones with their two best sets of starting values.

    Args:
        current: Fit of the machine without such an effect; the effects are evaluated at its observer
            bandwidth.
        scale: Typical sizes on this machine, by which relative starting values are multiplied.
        minimum_gain: Smallest linearized reduction of chi-squared per sample, dimensionless, of a promising
            effect.

    Returns:
        Copies of the fitted machine, each with one more effect (the last in its list, with starting values);
        most promising first.
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

    They are multiples of typical values, but absolute, SI, for structural effects where the unit is not of
    the site.
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
    """Return the linearized reduction of cost to each variant, shape (variants,) for each effect and site.

    The difference of the two predictions, without the part that the free parameters can reproduce within
    their limits, is multiplied by its best positive weight.
    """
    if not simulated:
        return {}
    model, batches = screening_model(current, data), _batches(simulated, current.machine)
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
    precision = prior_precision(current.free)
    limited = LimitedResidual.where_limits_bind(equations, precision, current.free, current.theta)
    if limited is not None:
        gains = np.array([limited.gain_of_positive(k) for k in range(len(equations.response_gradient))])
    else:
        reduced = equations.eliminate_parameters(precision)
        squares, gradient = np.diag(reduced.response_information), reduced.response_gradient
        gains = np.where(gradient < 0.0, gradient**2 / np.maximum(squares, 1e-300), 0.0)
    ends = np.cumsum([len(variants) for variants in simulated.values()])
    return dict(zip(simulated, np.split(np.where(np.isfinite(gains), gains, 0.0), ends[:-1]), strict=True))


def _batches(
    simulated: Mapping[tuple[Effect, str], Sequence[Machine]], machine: Machine
) -> list[tuple[Machine, Array]]:
    """Return machines and parameters (variants, P) that simulate all variants, in their order.

    Each machine needs newly compiled code. An effect that disappears at zero amplitude is therefore added at
    all its sites to one machine; its amplitude is zero at all sites but one.
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
