"""Which periods along the way are worth a try: peaks of a periodogram of the missing force against position."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FEWEST, _MOST = 0.5, 150.0  # periods over the way gone
_FINENESS = 4  # grid points a resolvable period
_TRIED = 4
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
    grid = 2 * np.pi / span * np.arange(_FEWEST, _MOST, 1.0 / _FINENESS)
    sign = np.sign(velocity) if friction else np.ones_like(velocity)
    power = np.concatenate([_powers(n, position, sign, force, basis) for n in np.array_split(grid, _PARTS)])
    found: list[float] = []
    for k in np.argsort(-power):
        if all(abs(grid[k] - other) > 1.5 * np.pi / span for other in found):
            found.append(float(grid[k]))
        if len(found) == _TRIED:
            break
    return np.array(found)


def _powers(rates: Array, position: Array, sign: Array, force: Array, basis: Array) -> Array:
    """What a sine and a cosine at each rate explain of the force, both beyond the basis (n, k)."""
    angle = np.outer(rates, position)
    waves = np.stack([np.cos(angle) * sign, np.sin(angle) * sign])
    waves -= (waves @ basis) @ basis.T
    onto = waves @ force
    cc, ss = np.einsum("krn,krn->kr", waves, waves)
    cs = np.einsum("rn,rn->r", *waves)
    determinant = np.maximum(cc * ss - cs**2, 1e-9 * cc * ss + 1e-300)
    explained: Array = (ss * onto[0] ** 2 + cc * onto[1] ** 2 - 2 * cs * onto[0] * onto[1]) / determinant
    return explained
