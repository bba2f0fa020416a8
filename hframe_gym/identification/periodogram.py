"""Which periods along the way are worth a try: peaks of a periodogram of the missing force against position."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FEWEST, _MOST = 0.5, 150.0  # periods over the way gone
_FINENESS = 4  # grid points a resolvable period
_BANDS = (3.0, 12.0, 40.0)  # periods over the way gone
_SLOW = np.concatenate([np.arange(0.5, 3.0, 0.25), np.arange(3.0, 6.1, 0.5)])
_TRIED = 6
_ROWS = 3000
_PARTS = 8


def rates(residual: Array, *, friction: bool) -> Array:
    """The likeliest rates n, rad per position, of a sine of position in the missing force, best first.

    residual (n, 3): position, velocity, missing force.  friction: the sine is one of the friction level, whose force
    changes sign with the motion.  Least squares at each rate (Lomb 1976) beside a constant, viscous and dry friction.
    """
    position, velocity, force = residual.T
    span = float(np.ptp(position))
    if span <= 0.0:
        return np.zeros(0)
    moving = np.abs(velocity) > 0.02 * np.percentile(np.abs(velocity), 99)
    thin = max(1, int(moving.sum()) // _ROWS)
    position, velocity, force = (column[moving][::thin] for column in (position, velocity, force))
    known = np.stack([np.ones_like(position), velocity, np.sign(velocity)], axis=1)
    basis, _ = np.linalg.qr(known)
    force = force - basis @ (basis.T @ force)
    count = int((_MOST - _FEWEST) * _FINENESS)
    first, step = 2 * np.pi / span * np.array([_FEWEST, 1.0 / _FINENESS])
    grid = first + step * np.arange(count)
    sign = np.sign(velocity) if friction else np.ones_like(velocity)
    power = np.concatenate(
        [_powers(len(n), position, n[0], step, sign, force, basis) for n in np.array_split(grid, _PARTS)]
    )
    # The best of each band, for the observer's noise grows with the rate; then the best of all.
    band = np.searchsorted(_BANDS, grid * span / (2 * np.pi))
    firsts = [np.flatnonzero(band == k)[np.argmax(power[band == k])] for k in np.unique(band)]
    found: list[float] = []
    for k in (*sorted(firsts, key=lambda k: -power[k]), *np.argsort(-power)):
        if all(abs(grid[k] - other) > 1.5 * np.pi / span for other in found):
            found.append(float(grid[k]))
        if len(found) == _TRIED:
            break
    return np.array(found)


def slow_rates(position: Array) -> Array:
    """Rates of a few periods over the way gone, all that can be told apart: a free run shows what they do, though the
    missing force may hide it in the observer's noise."""
    found: Array = 2 * np.pi / float(np.ptp(position)) * _SLOW if np.ptp(position) > 0.0 else np.zeros(0)
    return found


def _powers(count: int, position: Array, first: float, step: float, sign: Array, force: Array, basis: Array) -> Array:
    """What a sine and a cosine at each rate first + k step explain of the force, both beyond the basis (count,).

    The waves of a rate are those of the rate before, turned by the step; their squares are waves of twice the rate.
    """
    turns = np.empty((count, len(position)), np.complex128)
    turns[0] = np.exp(1j * first * position)
    turns[1:] = np.exp(1j * step * position)
    waves = np.multiply.accumulate(turns, axis=0)
    onto = waves @ (sign * force)
    beside = waves @ (sign[:, None] * basis)
    twice = np.einsum("kn,kn->k", waves, waves)
    cc = 0.5 * (len(position) + twice.real) - np.sum(beside.real**2, axis=1)
    ss = 0.5 * (len(position) - twice.real) - np.sum(beside.imag**2, axis=1)
    cs = 0.5 * twice.imag - np.sum(beside.real * beside.imag, axis=1)
    determinant = np.maximum(cc * ss - cs**2, 1e-9 * cc * ss + 1e-300)
    explained: Array = (ss * onto.real**2 + cc * onto.imag**2 - 2 * cs * onto.real * onto.imag) / determinant
    return explained
