"""What a controller did in a batch of episodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Episodes:
    """B episodes of one controller, n samples and m control periods each.

    time_s (n,); position and goal (B, n, 2), m, the stage's own state and not what a sensor says; contour (B, n), m,
    distance to the path, or None for a task without one; volts (B, m, drives) as applied; rated (drives,), V; energy_J
    (B,), drawn from the supply less what comes back; peak_belt_force_N (B,), beyond pretension.
    """

    time_s: Array
    position: Array
    goal: Array
    contour: Array | None
    volts: Array
    rated: Array
    energy_J: Array
    peak_belt_force_N: Array
