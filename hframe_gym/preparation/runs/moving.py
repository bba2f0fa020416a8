"""Find the runs in which the machine moves, and those in which it should."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import Array
from ...machine import Machine
from ...recordings import Recording
from ..dataset import Dataset, PreparedRecording
from ..sensors.noise import scatter_noise, sensor_quantum

_NORMAL_SPAN = 4.65  # standard deviations of noise between its 1st and 99th percentile
_MOVES = 0.01  # fraction of a sensor's largest span in all runs; with less, the error of a run says nothing
_NO_NOISE = 0.5  # fraction of a span that noise does not explain
# Times the noise of a sensor of speeds, which is at least its rounding error, so that it is three steps here;
# an offset at standstill is smaller.
_STEADY_SPEED = 10.0


def moving_runs(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Find the runs in which at least one sensor moves by more than 1 % of its largest span in all runs.

    The span of a run is the difference between the 99th and the 1st percentile of its measurements, so that
    single wrong samples and the first steps of a motor that hardly turns do not count. The part that noise
    explains is subtracted (of the squares); what is left must be more than half of the span.

    Args:
        recordings: At least one run.

    Returns:
        Names of these runs.
    """
    spans, moves = np.zeros((2, len(recordings), recordings[0].outputs.shape[1]))
    for i, recording in enumerate(recordings):
        for j, values in enumerate(recording.outputs.T):
            measured = values[np.isfinite(values)]
            if len(measured):
                spans[i, j] = np.ptp(np.percentile(measured, [1, 99]))
                noise = scatter_noise(measured, sensor_quantum([measured], 0.0))
                moves[i, j] = max(spans[i, j] ** 2 - (_NORMAL_SPAN * noise) ** 2, 0.0) ** 0.5
    moving = (moves > _MOVES * spans.max(axis=0)) & (moves > _NO_NOISE * spans)
    return tuple(r.name for r, moves in zip(recordings, moving.any(axis=1), strict=True) if moves)


def runs_that_should_move(data: Dataset, machine: Machine, moving: Sequence[str]) -> dict[str, str]:
    """Find runs in which the machine rests although such inputs move it in another run.

    Their sensor was not read, their drive was off, or something was blocked. In a fit, they would be evidence
    of dry friction that the other runs refute.

    Args:
        data: Prepared runs, with inputs in the drives' units, shape (n, drives).
        moving: Names of the runs in which the machine moves.

    Returns:
        By name of each such run, the name of another run that starts from rest although none of its inputs is
        larger (root mean square and peak). Empty for drives that follow a set point, which rest at any
        constant position. A run at a constant measured speed counts as moving.
    """

    def sizes(run: PreparedRecording) -> Array:
        return np.concatenate([np.sqrt(np.mean(run.inputs**2, axis=0)), np.abs(run.inputs).max(axis=0)])

    if machine.drive_laws:
        return {}
    started = {
        run.name: sizes(run)
        for run in data.runs
        if run.name in moving and run.inputs.any() and not run.initial.velocity.any()
    }
    found = {}
    for run in data.runs:
        weaker = [name for name, size in started.items() if np.all(size <= sizes(run))]
        if weaker and run.name not in moving and not turns_steadily(run.outputs, data.noise, machine):
            found[run.name] = weaker[0]
    return found


def turns_steadily(outputs: Array, noise: Array, machine: Machine) -> bool:
    """Return whether a speed sensor measures a nonzero speed in a run, even if it is constant.

    It does if the median of its measurements exceeds `_STEADY_SPEED` standard deviations of its noise.

    Args:
        outputs: Measurements of the run, in the channels' units, NaN where not measured, shape (n, sensors).
        noise: Noise of the sensors, in the same units, shape (sensors,).
    """
    typical = np.array(
        [np.median(values[np.isfinite(values)]) if np.isfinite(values).any() else 0.0 for values in outputs.T]
    )
    of_speed = np.array([sensor.quantity == "speed" for sensor in machine.sensors])
    return bool(np.any(of_speed & (np.abs(typical) > _STEADY_SPEED * noise)))
