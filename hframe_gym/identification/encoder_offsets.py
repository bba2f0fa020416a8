"""What a fitted machine says of the zeros of encoders behind belts.

`start.common_zeros` has an encoder's zero from its runs together, as if belts rested unstretched on the whole.  A force
that acts at rest, a cable or a tilt, stretches them all one way; a machine that has this force knows how far.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .prediction import encoder_angles, position_from_readings
from .static_equilibrium import static_equilibrium

Array = NDArray[np.float64]


def zero_errors(machine: Machine, data: Dataset) -> Array:
    """By how much the kept zeros (sensors,) are off, own units; nought where encoders do not tell of a stretch.

    Each is the median over runs of what the encoder shows at rest beyond the angle at which the belts hold what acts
    on the carriage; friction, which holds a little more or less than that, has no side.
    """
    errors = np.zeros(len(machine.sensors))
    if not machine.belts:
        return errors
    runs = [
        (encoder_angles(machine, run), static_equilibrium(machine, position_from_readings(machine, run)))
        for run in data.runs
    ]
    for j, sensor in enumerate(machine.sensors):
        i = machine.coordinate_names.index(sensor.coordinate)
        beyond = [told[i] - at_rest[i] for told, at_rest in runs if i in told]
        if beyond:
            errors[j] = sensor.row[sensor.coordinate] * float(np.median(beyond))
    return errors


def with_zeros(data: Dataset, machine: Machine, errors: Array) -> Dataset:
    """The same runs with the encoders' zeros put right: readings (own units) and starts less `errors` (sensors,)."""

    def right(run: PreparedRecording) -> PreparedRecording:
        start = run.start.copy()
        for j in np.flatnonzero(errors):
            sensor = machine.sensors[j]
            start[machine.coordinate_names.index(sensor.coordinate)] -= errors[j] / sensor.row[sensor.coordinate]
        return dataclasses.replace(
            run, start=start, outputs=run.outputs - errors, offset=run.offset + errors, zeroed=True
        )

    told = any(np.any(run.told) for run in data.runs)
    return dataclasses.replace(data, runs=tuple(map(right, data.runs))) if told and machine.effects else data
