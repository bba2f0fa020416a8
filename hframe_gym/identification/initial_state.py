"""Where a run starts: its resting rows, the state they mean, and what each sensor's zero is.

A run starts at rest; the rows before its first input change are its resting position.  Belts are taken as unstretched
there.  Encoders count from wherever they were switched on and lasers from where they were mounted, so what the resting
readings differ from the state's is a constant offset of the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from ..machine import Machine
from ..recordings import Recording

Array = NDArray[np.float64]
_RUNS_FOR_A_ZERO = 3
# Weight of a sensor that is used only where nothing else tells.
_LAST = 1e-6


class InitialState(NamedTuple):
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


def estimate_initial_state(recording: Recording, machine: Machine, zeros: Zeros | None = None) -> InitialState:
    """The resting state of a run and the sensors' offsets.

    Sensors on linear coordinates place the machine where they can; encoders only where nothing else does, or where
    their zero is known.  Belts are unstretched unless such encoders tell of a stretch.
    """
    rows = resting_rows(recording)
    resting = recording.outputs[settled(rows)]
    known = np.asarray(np.isfinite(resting).any(axis=0))
    reading = np.array([np.nanmean(resting[:, j]) if known[j] else np.nan for j in range(resting.shape[1])])
    zeros = zeros or Zeros.unknown(machine)
    count = len(machine.coordinates)
    rigid = np.eye(count)
    if machine.belts:
        rows_held = [machine.row(b.extension) for b in machine.belts]
        rows_held += [machine.row({name: 1.0}) for name in machine.sprung]
        rigid = null_space(np.array(rows_held)) / machine.radii[:, None]
    place = [machine.coordinate_names.index(s.coordinate) for s in machine.sensors]
    linear = np.array([machine.coordinates[i].kind == "linear" for i in place])
    told = np.isfinite(zeros.offset)
    # An encoder's angle is as sure as a laser's place when it is turned into travel.
    weight = np.where(linear, 1.0, np.where(told & ~zeros.stretched, machine.radii[place], _LAST))
    angle = reading - np.where(told, zeros.offset, 0.0)
    position = np.zeros(count)
    if known.any():
        rows_of = machine.sensor_matrix[known] @ rigid
        amount = np.linalg.lstsq(weight[known, None] * rows_of, weight[known] * angle[known], rcond=1e-12)[0]
        position = rigid @ amount
    for j in np.flatnonzero(told & known & zeros.stretched):
        position[place[j]] = angle[j] / machine.sensors[j].row[machine.sensors[j].coordinate]
    offset = np.where(told, zeros.offset, np.where(known, reading - machine.sensor_matrix @ position, 0.0))
    return InitialState(np.concatenate([position, np.zeros(count)]), offset, rows)


class Zeros(NamedTuple):
    """offset (sensors,): zeros of the encoders that have kept theirs from run to run, NaN for all others; stretched
    (sensors,): whether those encoders tell of belts that rest stretched."""

    offset: Array
    stretched: NDArray[np.bool_]

    @classmethod
    def unknown(cls, machine: Machine) -> Zeros:
        return cls(np.full(len(machine.sensors), np.nan), np.zeros(len(machine.sensors), np.bool_))


def common_zeros(starts: Sequence[InitialState], machine: Machine, quanta: Array) -> Zeros:
    """What a session's encoders tell beyond their single runs.

    An encoder behind belts whose zero differs from run to run by no more than friction can hold as stretch has kept it;
    one that was switched on anew for every run differs by turns.  quanta (sensors,): of the sensors.
    """
    zeros = Zeros.unknown(machine)
    if not machine.belts or len(starts) < _RUNS_FOR_A_ZERO:
        return zeros
    offsets = np.array([s.offset for s in starts])
    middle = np.median(offsets, axis=0)
    spread = 1.4826 * np.median(np.abs(offsets - middle), axis=0)
    stiffness = float(np.mean([b.EA / b.rest_length for b in machine.belts]))
    friction = sum(c.coulomb / (c.radius if c.kind == "rotary" else 1.0) for c in machine.coordinates)
    for j, sensor in enumerate(machine.sensors):
        c = machine.coordinate(sensor.coordinate)
        if c.kind == "rotary" and spread[j] < max(2 * friction / stiffness / c.radius, 2 * quanta[j]):
            zeros.offset[j] = middle[j]
            zeros.stretched[j] = spread[j] > max(quanta[j], 0.1e-3)
    return zeros
