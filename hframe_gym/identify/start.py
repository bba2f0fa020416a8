"""Where a run starts: its resting rows, the state they mean, and what each sensor's zero is.

A run starts at rest; the rows before its first input change are its resting position.  Belts are taken as unstretched
there.  Encoders count from wherever they were switched on and lasers from where they were mounted, so what the resting
readings differ from the state's is a constant offset of the run.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from ..files import Recording
from ..machine import Machine

Array = NDArray[np.float64]


class Start(NamedTuple):
    """state (2 coordinates,), at rest; offset (sensors,): reading minus what the state would read; rows at rest."""

    state: Array
    offset: Array
    rows: int


def resting_rows(recording: Recording) -> int:
    """Number of rows until the first input change takes effect: the row of the change itself still shows rest."""
    changed = np.flatnonzero(np.any(recording.inputs != recording.inputs[0], axis=1))
    idle = not np.any(recording.inputs[0])
    if not idle:
        # The machine is driven from its first row on; only that row is surely at rest.
        return 1
    return int(changed[0]) + 1 if len(changed) else len(recording.time_s)


def settled(rows: int) -> slice:
    """The later half of the resting rows: what still swung when the recording began has come to rest."""
    return slice(rows // 2, rows)


def start_of(recording: Recording, machine: Machine) -> Start:
    """The resting state of a run and the sensors' offsets.

    Sensors on linear coordinates place the machine where they can; encoders only where nothing else does.
    """
    rows = resting_rows(recording)
    resting = recording.outputs[settled(rows)]
    known = np.asarray(np.isfinite(resting).any(axis=0))
    reading = np.array([np.nanmean(resting[:, j]) if known[j] else np.nan for j in range(resting.shape[1])])
    count = len(machine.coordinates)
    rigid = np.eye(count)
    if machine.belts:
        rows_held = [machine.row(b.extension) for b in machine.belts]
        rows_held += [machine.row({name: 1.0}) for name in machine.sprung]
        rigid = null_space(np.array(rows_held)) / machine.radii[:, None]
    position = np.zeros(count)
    if known.any():
        linear = np.array([machine.coordinate(s.coordinate).kind == "linear" for s in machine.sensors])
        weight = np.where(linear[known], 1.0, 1e-6)
        rows_of = machine.sensor_matrix[known] @ rigid
        amount = np.linalg.lstsq(weight[:, None] * rows_of, weight * reading[known], rcond=1e-12)[0]
        position = rigid @ amount
    offset = np.where(known, reading - machine.sensor_matrix @ position, 0.0)
    return Start(np.concatenate([position, np.zeros(count)]), offset, rows)
