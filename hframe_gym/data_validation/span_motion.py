"""Measured and simulated motion over short spans of time, whose ratio shows wrong units."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..dynamics import resolved_step, rollout
from ..identification import Dataset, PreparedRecording
from ..machine import Machine, commanded_state
from ..recordings import bridge_blanks, comparison_window

_WINDOW = 0.02  # s, least time over which motion is compared; long enough to average out noise
_MAX_ROWS = 20_000  # rows of a run that are simulated; enough to determine a factor
_STEP = 1e-3  # s, longest integration step; the comparison needs no accuracy
MIN_ROWS = 10  # rows that a correlation or slope needs


@dataclasses.dataclass(frozen=True)
class SpanMotion:
    """Measured and simulated changes over short time spans of equal length, of all runs together.

    A change over a span is the mean speed times the length of the span, so that ratios of changes are ratios
    of speeds.

    Attributes:
        measured: Changes of the measurements over each span, in the sensors' units, shape (rows, sensors).
        simulated: Changes of the simulated measurements, in the sensors' units, shape (rows, sensors).
        values: Measurements at the middle of each span, in the sensors' units, shape (rows, sensors).
        run: Index of the run of each row, shape (rows,).
    """

    measured: Array
    simulated: Array
    values: Array
    run: NDArray[np.int_]

    def speed_ratio(self, sensor: int) -> float:
        """Return the ratio of measured to simulated speed of a sensor, dimensionless.

        It is the ratio of the standard deviations of the changes over the spans; 0 if there are too few, or
        if the simulated changes are all equal, as without motion.

        Args:
            sensor: Index of the sensor.
        """
        return self._ratio(np.isfinite(self.measured[:, sensor]), sensor)

    def speed_ratios_by_run(self, sensor: int) -> list[float]:
        """Return `speed_ratio` of a sensor for each run in which it is not 0.

        Args:
            sensor: Index of the sensor.
        """
        finite = np.isfinite(self.measured[:, sensor])
        ratios = (self._ratio(finite & (self.run == run), sensor) for run in np.unique(self.run))
        return [ratio for ratio in ratios if ratio]

    def _ratio(self, rows: NDArray[np.bool_], sensor: int) -> float:
        if np.count_nonzero(rows) < MIN_ROWS:
            return 0.0
        size = float(np.std(self.simulated[rows, sensor]))
        return float(np.std(self.measured[rows, sensor])) / size if size else 0.0


def span_motion(data: Dataset, machine: Machine) -> SpanMotion:
    """Simulate the runs, and compare changes of measurements and simulation over short time spans.

    A simulation begins at the workspace's center or a commanded position, with the recorded inputs.

    Returns:
        Changes over each span, measured and simulated, and the measurement at its middle, in the sensors'
        units, shape (rows, sensors) each, and the index of the run of each row.
    """
    parts = []
    for i, run in enumerate(map(_first_rows, data.runs)):
        span = comparison_window(run.outputs, run.time_s, _WINDOW)
        bridged = bridge_blanks(run.outputs, run.time_s, span)
        measured = _changes(bridged, run.time_s, span)
        simulated = _changes(_simulate_outputs(machine, run), run.time_s, span)
        values = _middles(bridged, run.time_s, span)
        parts.append((measured, simulated, values, np.full(len(measured), i)))
    return SpanMotion(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _window_rows(time_s: Array, span: float) -> int:
    """Return the number of rows of a span in s."""
    return max(1, min(len(time_s) - 1, round(span / float(np.median(np.diff(time_s))))))


def _changes(outputs: Array, time_s: Array, span: float) -> Array:
    """Return the change of each channel over each span (in s), in its unit, shape (rows, channels)."""
    window = _window_rows(time_s, span)
    return (outputs[window:] - outputs[:-window])[:: max(1, window // 4)]


def _middles(outputs: Array, time_s: Array, span: float) -> Array:
    """Return the measurements at the middle of each span of `_changes`, shape (rows, channels)."""
    window = _window_rows(time_s, span)
    return outputs[window // 2 : len(outputs) - window + window // 2][:: max(1, window // 4)]


def _first_rows(run: PreparedRecording) -> PreparedRecording:
    """Return a run with at most `_MAX_ROWS` rows, which begin where the first input changes."""
    if len(run.time_s) <= _MAX_ROWS:
        return run
    changed = np.any(run.inputs != run.inputs[0], axis=1)
    first = min(int(np.argmax(changed)), len(run.time_s) - _MAX_ROWS)
    return run.rows(slice(first, first + _MAX_ROWS))


def _simulate_outputs(machine: Machine, run: PreparedRecording) -> Array:
    """Simulate outputs, shape (n, sensors), from the workspace's center or a commanded position.

    A measured position in a wrong unit would be far outside.
    """
    step, start = resolved_step(machine, _STEP), commanded_state(machine, run.inputs[0])
    positions = rollout(machine, run.time_s, run.inputs, start=start, longest_step=step)[0]
    return np.asarray(positions @ machine.sensor_matrix.T)


def correlation(a: Array, b: Array) -> float:
    """Return the correlation of two motions about zero instead of their means.

    A constant speed counts too.

    Args:
        a: Motion, in any unit, shape (n,).
        b: Motion at the same times, in any unit, shape (n,).

    Returns:
        Correlation, dimensionless, -1 to 1; NaN if a motion is zero throughout.
    """
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))
