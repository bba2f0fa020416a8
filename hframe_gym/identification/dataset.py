"""Recordings made ready for a machine: starts known, offsets removed, the sensors' noise estimated."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from ..recordings import Recording, fill_gaps
from .initial_state import common_zeros, estimate_initial_state

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PreparedRecording:
    """One recording of a machine.

    time_s (n,); inputs (n, drives) V; outputs (n, sensors) with the resting offset removed, NaN where not measured;
    start (2 coordinates,), with the stretch of the belts that encoders told of; told (sensors,): which did; offset
    (sensors,), the one removed; zeroed: whether a fitted machine has put the encoders' zeros right; rows (n,): those
    that count, where not all do.
    """

    name: str
    time_s: Array
    inputs: Array
    outputs: Array
    start: Array
    rest: int
    offset: Array
    told: NDArray[np.bool_]
    zeroed: bool = False
    rows: NDArray[np.bool_] | None = None

    @property
    def count(self) -> int:
        """How many numbers were measured."""
        counted = self.outputs if self.rows is None else self.outputs[self.rows]
        return int(np.isfinite(counted).sum())


@dataclass(frozen=True)
class Dataset:
    """Runs of one rig; for each sensor (sensors,) the standard deviation of its noise, its quantum (0: none), and
    whether belts are between it and the carriage."""

    runs: tuple[PreparedRecording, ...]
    noise: Array
    quantum: Array
    behind_belts: NDArray[np.bool_]

    @property
    def count(self) -> int:
        return sum(run.count for run in self.runs)

    @property
    def period(self) -> float:
        """Median sampling period, s."""
        return float(np.median(np.concatenate([np.diff(run.time_s) for run in self.runs])))

    def only(self, names: Sequence[str]) -> Dataset:
        """The runs of these names, with the same noise."""
        return dataclasses.replace(self, runs=tuple(run for run in self.runs if run.name in names))

    def judged(self, rows: Sequence[NDArray[np.bool_]]) -> Dataset:
        """The same runs, of which only these rows (n,) count."""
        return dataclasses.replace(
            self, runs=tuple(dataclasses.replace(run, rows=own) for run, own in zip(self.runs, rows, strict=True))
        )


def shown(data: Dataset, recordings: Sequence[Recording]) -> Dataset:
    """The same runs with all that their recordings show, also what was kept out of a fit."""
    outputs = {r.name: fill_gaps(r).outputs for r in recordings}
    runs = tuple(dataclasses.replace(run, outputs=outputs[run.name] - run.offset) for run in data.runs)
    return dataclasses.replace(data, runs=runs)


def prepare(recordings: Sequence[Recording], machine: Machine) -> Dataset:
    """Runs ready for fitting a machine of this shape."""
    recordings = [fill_gaps(recording) for recording in recordings]
    quanta = np.array([_quantum(recordings, j, machine) for j in range(len(machine.sensors))])
    zeros = common_zeros([estimate_initial_state(recording, machine) for recording in recordings], machine, quanta)
    starts = [estimate_initial_state(recording, machine, zeros) for recording in recordings]
    runs = []
    for recording, start in zip(recordings, starts, strict=True):
        outputs = recording.outputs - start.offset
        runs.append(
            PreparedRecording(
                recording.name,
                recording.time_s,
                recording.inputs,
                outputs,
                start.state,
                start.rows,
                start.offset,
                zeros.stretched,
            )
        )
    noise = np.array([_noise(recordings, runs, j, machine, quanta[j]) for j in range(len(machine.sensors))])
    belted = [bool(machine.belts) and machine.coordinate(s.coordinate).kind == "rotary" for s in machine.sensors]
    return Dataset(tuple(runs), noise, quanta, np.array(belted))


def quantum_of(values: Array) -> float:
    """The step of a quantised channel: the smallest change that nearly all changes are multiples of; 0 if none."""
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    steps = steps[steps > 0]
    if len(steps) < 10:
        return 0.0
    smallest = float(np.percentile(steps, 2))
    fraction = np.abs(steps / smallest - np.rint(steps / smallest))
    return smallest if np.mean(fraction < 0.1) > 0.95 else 0.0


def _quantum(recordings: Sequence[Recording], j: int, machine: Machine) -> float:
    step = float(np.median([quantum_of(recording.outputs[:, j]) for recording in recordings]))
    return step or machine.sensors[j].resolution


def _noise(
    recordings: Sequence[Recording], runs: Sequence[PreparedRecording], j: int, machine: Machine, quantum: float
) -> float:
    """Standard deviation of sensor j from the resting rows if there are any, at least its quantum's."""
    channel = [recording.outputs[:, j] for recording in recordings]
    deviations, rows = 0.0, 0
    for values, run in zip(channel, runs, strict=True):
        first = values[: run.rest]
        resting = first[np.isfinite(first)]
        if len(resting) >= 10:
            # Around a parabola: a stage that still creeps to rest is no noise.
            rows_of = np.linspace(-1.0, 1.0, len(resting))
            left = resting - np.polynomial.polynomial.polyval(
                rows_of, np.polynomial.polynomial.polyfit(rows_of, resting, 2)
            )
            deviations += float(np.sum(left**2))
            rows += len(resting) - 3
    least, declared = quantum / np.sqrt(12), machine.sensors[j].noise
    if rows >= 30:
        return max(float(np.sqrt(deviations / rows)), least) or declared or _difference_noise(channel)
    return max(least, declared or _difference_noise(channel))


def _difference_noise(channel: Sequence[Array]) -> float:
    """Noise from third differences, which smooth motion hardly has (von Neumann 1941)."""
    parts = [np.diff(values, n=3) for values in channel]
    spread = np.concatenate([p[np.isfinite(p)] for p in parts])
    if len(spread) == 0:
        return 1.0
    return max(1.4826 * float(np.median(np.abs(spread))) / np.sqrt(20.0), 1e-12)
