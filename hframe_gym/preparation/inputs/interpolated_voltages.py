"""Interpolated voltages: what acts between the rows of a log that is slower than the controller.

A log at 250 Hz has every fourth voltage of a controller at 1 kHz. Held from row to row, these voltages act
1.5 ms late, and a fit makes up for that by wrong masses and frictions. Between the rows, they are
interpolated instead: by Akima's piecewise cubic, because straight lines reduce fast changes (2 % at 20 Hz
between rows of 4 ms, which a fit takes for a smaller mass), and splines overshoot where a voltage jumps.
"""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np
from scipy.interpolate import Akima1DInterpolator, CubicSpline, make_interp_spline

from ...arrays import Array, Times

# "straight" reduces what is fast, "spline" overshoots where voltages jump; the truth lies between them.
Interpolation = Literal["akima", "straight", "spline"]
_INTERPOLATORS = {
    "akima": Akima1DInterpolator,
    "straight": partial(make_interp_spline, k=1),
    "spline": CubicSpline,
}


def update_times(time_s: Times, updates: int) -> Array:
    """Return the times at which a controller changes the voltages.

    Args:
        updates: How often the voltages change from one row to the next, at least once.

    Returns:
        The times of the rows and, between two of them, `updates` - 1 times in equal steps, s,
        shape ((n - 1) * `updates` + 1,).
    """
    fractions = np.arange(updates) / updates
    between = time_s[:-1, None] + np.diff(time_s)[:, None] * fractions
    return np.append(between.ravel(), time_s[-1])


def updated_inputs(
    time_s: Times, inputs: Array, updates: int, interpolation: Interpolation = "akima"
) -> Array:
    """Interpolate inputs to the times at which a controller changes them.

    Args:
        inputs: Inputs in the rows, V, shape (..., n, drives).
        updates: How often the inputs change from one row to the next, at least once.
        interpolation: "akima" (piecewise cubic), "straight" (lines) or "spline" (cubic).

    Returns:
        Inputs at `update_times`, V, shape (..., (n - 1) * `updates` + 1, drives).
    """
    axis = np.ndim(inputs) - 2
    return np.asarray(_INTERPOLATORS[interpolation](time_s, inputs, axis=axis)(update_times(time_s, updates)))


def mean_inputs(inputs: Array, updates: int, parts: int) -> Array:
    """Return the means of inputs over the equal parts into which each row's interval is divided.

    Args:
        inputs: Inputs at `update_times`, each held until the next, V, shape (..., (n - 1) * `updates` + 1,
            drives).
        updates: How often the inputs change from one row to the next, at least once.
        parts: Number of parts from one row to the next.

    Returns:
        Means, V, shape (..., (n - 1) * `parts` + 1, drives); the last one is the input of the last row.
    """
    # Time integral of each change up to the end of each part, in parts.
    ends = np.arange(parts + 1)[:, None] / parts * updates
    until = np.clip(ends - np.arange(updates), 0.0, 1.0) * (parts / updates)
    means = np.diff(until, axis=0) @ inputs[..., :-1, :].reshape(
        *inputs.shape[:-2], -1, updates, inputs.shape[-1]
    )
    return np.concatenate(
        [means.reshape(*inputs.shape[:-2], -1, inputs.shape[-1]), inputs[..., -1:, :]], axis=-2
    )
