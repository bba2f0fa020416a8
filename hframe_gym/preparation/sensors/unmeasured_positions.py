"""Drop the position sensors of a machine if the recordings contain only speeds.

Templates declare an encoder beside a tachometer, and a log may have the speed alone. With a position sensor
that measured nothing, an observer would correct nothing: it corrects speeds only where no sensor measures the
position. Nor would there be a balance of forces.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ...machine import Machine
from ...recordings import Recording

_LEFT_OUT = (
    "No run measures a position. {} is left out, also of the machines here, so forces that depend "
    "on the position are not identified. Add it again to a machine file for a controller that reads it."
)


def without_unmeasured_positions(
    recordings: Sequence[Recording], machine: Machine
) -> tuple[list[Recording], Machine, tuple[str, ...]]:
    """Leave out all position sensors if no run has a position, but some run has a speed.

    Args:
        recordings: Runs of a session.
        machine: Machine as declared.

    Returns:
        Runs and machine without these sensors and the effects on them, and a sentence about them. Otherwise
        the same runs and machine, and no sentence.
    """
    measured = np.any([np.isfinite(r.outputs).any(axis=0) for r in recordings], axis=0)  # (sensors,)
    speeds = np.array([s.of_velocity for s in machine.sensors], np.bool_)
    positions = machine.position_sensors
    if not positions.any() or measured[positions].any() or not measured[speeds].any():
        return list(recordings), machine, ()
    channels = [s.channel for s in machine.sensors if s.of_position]
    reduced = machine.replace(
        sensors=tuple(s for s in machine.sensors if not s.of_position),
        effects=tuple(e for e in machine.effects if e.site not in channels),
    )
    runs = [dataclasses.replace(r, outputs=r.outputs[:, ~positions]) for r in recordings]
    return runs, reduced, (_LEFT_OUT.format(", ".join(channels)),)
