"""Which periods along the way are worth a try: peaks of a periodogram of the missing force against position."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FEWEST, _MOST = 0.5, 150.0  # periods over the way gone
_FINENESS = 4  # grid points a resolvable period
_TRIED = 4
_ROWS = 4000


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
    sign = np.sign(velocity) if friction else 1.0
    power = np.empty(len(grid))
    for k, n in enumerate(grid):
        wave = np.exp(1j * n * position) * sign
        pair = np.stack([wave.real, wave.imag], axis=1)
        pair -= basis @ (basis.T @ pair)
        power[k] = force @ pair @ np.linalg.lstsq(pair.T @ pair, pair.T @ force, rcond=1e-9)[0]
    found: list[float] = []
    for k in np.argsort(-power):
        if all(abs(grid[k] - other) > 1.5 * np.pi / span for other in found):
            found.append(float(grid[k]))
        if len(found) == _TRIED:
            break
    return np.array(found)
