"""Propose every effect of the library at every site, with several starting values.

The library gives starting values relative to typical sizes (0.3 of the typical force, a tenth of the top
speed). Those of periods are the peaks of a periodogram of the missing force, the force that the model lacks,
or of the errors of a sensor.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from ....arrays import Array
from ....effects import EFFECTS
from ....machine import Effect, argument_names
from ..candidates import STRATEGIES, Candidate, SearchState
from ..periodogram import block_means, periodogram_peaks, slow_rates

_MAX_SHAPES = 64  # Sets of starting values per effect and site.
# s; means over it keep what a periodogram shows: periods of at least 25 ms (`HIGHEST_FREQUENCY`), of which it
# needs four rows, and noise, of which they leave no more than all rows do.
_BLOCK_S = 4e-3


@STRATEGIES.register("library")
def library(state: SearchState) -> Iterator[Candidate]:
    """Propose the effects of the library at all their sites (`SearchState.sites`).

    Starting values of widths, speeds and times are the effect's multiples of typical sizes; those of periods
    are peaks of a periodogram. Values that the runs cannot determine are left out.

    Args:
        state: State of the search.

    Yields:
        One candidate per effect, site and combination of starting values, at most 64 per effect and site.
    """
    for effect in EFFECTS.values():
        for site in state.sites(effect):
            for values in _starting_values(effect, site, state):
                yield state.candidate(effect, site, values)


def _starting_values(effect: Effect, site: str, state: SearchState) -> list[Mapping[str, float]]:
    """Return the starting values of everything but amplitudes and phases."""
    if effect.starting_values is not None:
        j = state.machine.output_channels.index(site)
        return list(effect.starting_values(state.data.measured_values(j), float(state.data.noise[j])))
    sizes, grids = state.sizes(effect, site), dict[str, list[float]]()
    for p in effect.parameters:
        if p.role in ("shape", "switch"):
            grids[p.name] = [g * sizes.get(p.unit, 1.0) for g in p.grid]
        elif p.role in ("rate", "period"):
            rates = _rates(effect, site, state)
            grids[p.name] = [float(rate) if p.role == "rate" else float(2 * np.pi / rate) for rate in rates]
    for name, values in grids.items():
        grids[name] = [v for v in values if state.covers(effect, site, {name: v})]
    sets = [dict(zip(grids, values, strict=True)) for values in itertools.product(*grids.values())]
    return list(sets[:_MAX_SHAPES])


def _rates(effect: Effect, site: str, state: SearchState) -> Array:
    """Return the main spatial rates of missing force or sensor error, (rates,), rad per unit of the position.

    Friction that varies slowly over the position may hide in its noise, and starts from a grid as well.
    """
    unexplained = state.unexplained(effect, site)
    if not len(unexplained):
        return np.zeros(0)
    factor, rows = _factor(effect, site, state), max(1, round(_BLOCK_S / state.data.period))
    rates = periodogram_peaks(
        block_means(unexplained, rows),
        rows * state.data.period,
        factor=None if factor is None else block_means(factor, rows),
    )
    if state.slow and effect.coulomb:
        rates = np.concatenate([rates, slow_rates(unexplained[:, 0])])
    return rates


def _factor(effect: Effect, site: str, state: SearchState) -> Array | None:
    """Return what multiplies a periodic quantity of an effect in each row, see `periodogram_peaks`."""
    velocity = state.unexplained(effect, site)[:, 1]
    if effect.coulomb:
        return np.sign(velocity)
    loaded = effect.force is not None and "load" in argument_names(effect.force)
    if not effect.torque and not loaded:
        return None
    j = [drive.name for drive in state.machine.drives].index(site)
    drive, command = state.machine.drives[j], np.concatenate([run.inputs[:, j] for run in state.data.runs])
    current: Array = (command - drive.emf_constant * velocity) / drive.resistance
    factor = current / max(float(np.abs(current).max()), np.finfo(float).tiny)
    return np.abs(factor) if loaded else factor  # what the drive pulls, its belts carry on
