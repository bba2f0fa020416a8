"""Records of runs prepared for a fit: measurements minus zeros, initial states, noise of the sensors.

The zero of a sensor is its measurement at position 0. A laser has a fixed zero; that of an encoder is
wherever the encoder was switched on, and common to all runs in which it stayed on.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..machine import Machine
from .inputs.clock_voltages import ClockVoltages, updated_inputs_of_clock
from .inputs.interpolated_voltages import Interpolation, mean_inputs, update_times
from .start.encoder_zeros import EncoderZeros
from .start.measured_state import InitialState
from .start.modeled_state import model_initial_states
from .start.sensor_zeros import max_zero_means

MIN_ROWS = 20  # rows of a run that the filters of the residual need
# Part of the intervals between rows that integration steps divide as intended; where rows were lost, they are
# longer.
_REGULAR = 0.95
_SAME_STEP = 1e-6  # of a step, by which rounding may lengthen an interval; the integrator allows the same


class VoltageErrors(Protocol):
    """Errors of the voltages of a run that are interpolated between its rows."""

    def whiten(self, residual: Array, bandwidth: float) -> Array:
        """Filter a residual so that its values are independent with unit variance despite the voltage errors.

        Args:
            residual: Residuals of a batch of predictions, in units of the noise, shape (batch, n * sensors).
            bandwidth: Bandwidth of the observer, rad/s.

        Returns:
            White residuals of an exact machine, dimensionless, same shape.
        """

    def log_variance(self, bandwidth: float) -> Array:
        """Return the logarithm of the variance of each value before it was whitened, shape (n, sensors).

        Args:
            bandwidth: Bandwidth of the observer, rad/s.
        """


class RunObserver(NamedTuple):
    """Observer that corrects the predictions of one run by its measurements.

    Attributes:
        bandwidth: Bandwidth, rad/s; 0 for a simulation.
        inflation: Variance of the run's innovations / their variance for an exact machine, at least 1.
    """

    bandwidth: float
    inflation: float = 1.0


class HeldVoltages(NamedTuple):
    """Voltages of n rows that are held from one time to the next, with m = (n - 1) * `per_row` + 1 times.

    Attributes:
        time_s: Times, s, shape (m,).
        inputs: Voltages from then on, V, shape (..., m, drives).
        per_row: Times from one row to the next.
    """

    time_s: Array
    inputs: Array
    per_row: int


@dataclass(frozen=True)
class PreparedRecording:
    """One recording of a machine, with its initial state.

    Attributes:
        name: Name of the run.
        time_s: Sample times, s, shape (n,).
        inputs: Drive voltages, V, shape (n, drives).
        outputs: Measurements minus zeros, in the sensors' units, shape (n, sensors), NaN where missing.
        initial: Measured initial state.
        noise: Standard deviation of each measurement, in the sensors' units, shape (n, sensors):
            sqrt(noise^2 + (jitter * speed)^2) with the sensor's noise at rest and the jitter of the clock, s.
        weights: Weight of each measurement in a fit, shape (n, sensors), from 0 (not measured) to 1
            (independent of the measurements beside it), see `independent_values`.
        dropped: True for rows that the logger dropped; their voltages are interpolated or estimated,
            shape (n,).
        observer_bandwidth: Bandwidth of the observer for this run, rad/s; None: that of the prediction or
            fit.
        updates: How many times the voltages change from one row to the next: more than once if the controller
            is faster than the log. They are then interpolated between the rows (`interpolated_voltages`).
        interpolation: How they are interpolated, see `updated_inputs`.
        voltage_errors: Statistics of the errors of interpolated voltages; None if the voltages are held.
        clock_voltages: Changes of voltages between the rows by the jitter of the controller's clock; None
            without jitter.
    """

    name: str
    time_s: Array
    inputs: Array
    outputs: Array
    initial: InitialState
    noise: Array
    weights: Array
    dropped: NDArray[np.bool_]
    observer_bandwidth: float | None = None
    updates: int = 1
    interpolation: Interpolation = "akima"
    voltage_errors: VoltageErrors | None = field(default=None, repr=False, compare=False)
    clock_voltages: ClockVoltages | None = field(default=None, repr=False)

    def bandwidth(self, of_prediction: float) -> float:
        """Return the observer's bandwidth for this run, rad/s: its own one, or else `of_prediction`."""
        return of_prediction if self.observer_bandwidth is None else self.observer_bandwidth

    @property
    def count(self) -> float:
        """Effective number of measured values in the fit, dimensionless; repeats of a value count as one."""
        return float(self.weights.sum())

    @cached_property
    def known_outputs(self) -> Array:
        """Measurements minus zeros, in the sensors' units, 0 where missing, shape (n, sensors)."""
        return np.where(np.isfinite(self.outputs), self.outputs, 0.0)

    @cached_property
    def fit_scales(self) -> Array:
        """Factors sqrt(weight) / noise from measurement errors to residuals, shape (n, sensors)."""
        return np.asarray(np.sqrt(self.weights) / self.noise)

    def first_rows(self, count: int) -> PreparedRecording:
        """Return a copy with only the first `count` rows of the run, or all if it has fewer."""
        return self.rows(slice(count))

    def rows(self, chosen: slice) -> PreparedRecording:
        """Return a copy with only some rows of the run; the initial state stays that of the complete run."""
        series = ("time_s", "inputs", "outputs", "noise", "weights", "dropped")
        clock = None if self.clock_voltages is None else self.clock_voltages.rows(chosen)
        return dataclasses.replace(
            self, clock_voltages=clock, **{name: getattr(self, name)[chosen] for name in series}
        )

    def without_clock_answers(self) -> Array:
        """Return the rows' voltages without what the clock's jitter adds to them, V, shape (n, drives).

        A controller that reads a sensor late or early answers the difference of position with a voltage.
        """
        return self.inputs if self.clock_voltages is None else self.inputs - self.clock_voltages.answers

    def held(self, step_s: float, inputs: Array | None = None) -> HeldVoltages:
        """Return the voltages as a step function of time, which an integrator needs.

        Voltages that change between the rows get additional times. Those that change within an integration
        step are replaced by their mean over it.

        Args:
            step_s: Longest integration step, s.
            inputs: Voltages in the rows, V, shape (..., n, drives). Default: those of the run.

        Returns:
            Times, s, shape (m,), the voltages from then on, V, shape (..., m, drives), and the number of
            times from one row to the next.
        """
        if self.updates == 1:
            return HeldVoltages(self.time_s, self.inputs if inputs is None else inputs, 1)
        per_row = min(max(1, math.ceil(self._longest_regular_interval / step_s - _SAME_STEP)), self.updates)
        if inputs is not None:
            return self._held(per_row, inputs)
        if per_row not in self._held_by_number:
            self._held_by_number[per_row] = self._held(per_row, self.inputs)
        return self._held_by_number[per_row]

    @cached_property
    def _longest_regular_interval(self) -> float:
        """Time, s, that at least `_REGULAR` of the intervals between rows do not exceed."""
        return float(np.quantile(np.diff(self.time_s), _REGULAR))

    @cached_property
    def _held_by_number(self) -> dict[int, HeldVoltages]:
        """Voltages of the run, by the number of their changes from row to row."""
        return {}

    def _held(self, per_row: int, inputs: Array) -> HeldVoltages:
        """Return interpolated voltages with up to `updates` changes from row to row."""
        changing = updated_inputs_of_clock(
            self.time_s, inputs, self.clock_voltages, self.updates, self.interpolation
        )
        if per_row < self.updates:
            changing = mean_inputs(changing, self.updates, per_row)
        return HeldVoltages(update_times(self.time_s, per_row), changing, per_row)

    def initial_state(self, machine: Machine) -> Array:
        """Return the state from which a machine is simulated over this run.

        It follows from the measurements at rest and from the machine, because effects may change what sensors
        measure, and forces at rest stretch the belts.

        Returns:
            Positions (m, rad), velocities (m/s, rad/s) and states of the effects (SI; 0 unless estimated),
            shape (2 * coordinates + effect states,).
        """
        return model_initial_states(machine, [self.initial])[0]


@dataclass(frozen=True, eq=False)
class Dataset:
    """Prepared recordings of one rig; two data sets are equal only if they are the same object.

    Attributes:
        runs: The recordings.
        noise: Standard deviations of the sensors' noise, in the sensors' units, shape (sensors,).
        quantum: Quantization steps of the sensors, in the sensors' units, 0 where there is none,
            shape (sensors,).
        behind_belts: True for sensors whose zero the rows at rest do not determine: encoders on pulleys,
            which elastic belts separate from the tool, and sensors with an offset, shape (sensors,).
        zeros: Zeros of the encoders that have the same one in all runs, because they stayed on. None:
            unknown.
        jitter: Standard deviation of the sampling times, s, which the noise of the runs includes; 0 if none
            is found.
        has_zero: False for sensors without a zero that a comparison may adapt, such as those of speeds and
            currents, shape (sensors,). None: all have one.
        updates_rejected: Numbers of voltage changes per row that earlier searches found wrong, each with the
            number of effects known at that time.
        means_are_zeros: Whether a fit attributes the mean error of a sensor over a run to its initial
            position, if the sensor has no quantization and measured at rest. False for simulations of
            complete runs, in which an error of the machine has a mean as well.
    """

    runs: tuple[PreparedRecording, ...]
    noise: Array
    quantum: Array
    behind_belts: NDArray[np.bool_]
    zeros: EncoderZeros | None = None
    jitter: float = 0.0
    has_zero: NDArray[np.bool_] | None = None
    updates_rejected: Mapping[int, int] = field(default_factory=dict)
    means_are_zeros: bool = True

    @property
    def count(self) -> float:
        """Effective number of measured values of all runs in the fit, dimensionless (sum of `count`)."""
        return sum(run.count for run in self.runs)

    @cached_property
    def period(self) -> float:
        """Median sampling period over all runs, s."""
        return float(np.median(np.concatenate([np.diff(run.time_s) for run in self.runs])))

    def fitted_zero_limits(self, run: PreparedRecording) -> Array:
        """Return by how much a fit may change each sensor's zero from its estimate at rest, for one run.

        The limits differ from those of `max_zero_means` for a sensor without quantization. It gives the
        initial position, and the noise of its few measurements at rest makes this position wrong by a
        constant over the complete run. The mean error over the run is the best estimate of this constant. If
        it remained in the residual, parameters would adapt to it. Where a sensor did not measure at rest,
        later measurements of it determine the initial position.

        Returns:
            Limits, in the sensors' units, shape (sensors,): infinite behind belts and, if `means_are_zeros`,
            for sensors without quantization that measured at rest; otherwise half a quantization step.
        """
        by_mean = self.means_are_zeros & run.initial.measured_at_rest & (self.quantum == 0.0)
        return np.where(by_mean, np.inf, max_zero_means(self.behind_belts, self.quantum))

    def with_runs(self, names: Sequence[str]) -> Dataset:
        """Return a copy with the named runs only, in their present order; other properties stay.

        Args:
            names: Names of runs; those that the data set does not have are ignored.
        """
        return dataclasses.replace(self, runs=tuple(run for run in self.runs if run.name in names))

    def leaving_out(self, piece: int, pieces: int) -> tuple[Dataset, Dataset]:
        """Split off one piece of a run, for cross-validation.

        The other measurements of this run stay in the piece with weight 0, so that an observer follows the
        complete run.

        Args:
            piece: Index of the piece among those of all runs, in the order of the runs, from 0.
            pieces: Number of pieces into which each run is divided; 1 for complete runs.

        Returns:
            The data set without the piece, and the piece.
        """
        index, part = divmod(piece, pieces)
        run, before, after = self.runs[index], self.runs[:index], self.runs[index + 1 :]
        if pieces == 1:
            return dataclasses.replace(self, runs=before + after), dataclasses.replace(self, runs=(run,))
        rows = np.array_split(np.arange(len(run.weights)), pieces)[part]
        inside = np.zeros_like(run.weights)
        inside[rows] = run.weights[rows]
        rest = dataclasses.replace(run, weights=run.weights - inside)
        left_out = dataclasses.replace(run, weights=inside)
        return (
            dataclasses.replace(self, runs=(*before, rest, *after)),
            dataclasses.replace(self, runs=(left_out,)),
        )

    def with_inputs(self, inputs: Mapping[str, Array]) -> Dataset:
        """Return a copy with other voltages.

        Args:
            inputs: Voltages, V, shape (n, drives), by the name of the run; every run needs an entry.
        """
        runs = (dataclasses.replace(run, inputs=inputs[run.name]) for run in self.runs)
        return dataclasses.replace(self, runs=tuple(runs))

    @property
    def has_voltage_errors(self) -> bool:
        """Whether residuals of a run are whitened, because they contain errors of interpolated voltages."""
        return any(run.voltage_errors is not None for run in self.runs)

    @property
    def updates(self) -> int:
        """Largest number of changes of the voltages from one row to the next; 1 if they are held."""
        return max(run.updates for run in self.runs)

    def with_all_runs(self, **changes: Any) -> Dataset:
        """Return a copy in which attributes of the runs have new values, the same in all runs.

        Args:
            **changes: New values by name of the attribute of `PreparedRecording`.
        """
        runs = (dataclasses.replace(run, **changes) for run in self.runs)
        return dataclasses.replace(self, runs=tuple(runs))

    def with_updates(self, updates: int) -> Dataset:
        """Return a copy in which the voltages of all runs change `updates` times per row."""
        return self.with_all_runs(updates=updates)

    def without_voltage_errors(self) -> Dataset:
        """Return a copy whose residuals are not whitened for errors of interpolated voltages.

        The voltages themselves stay interpolated.
        """
        return self.with_all_runs(voltage_errors=None)

    def with_held_voltages(self) -> Dataset:
        """Return a copy whose voltages are held from row to row, and have no errors of interpolation."""
        return self.with_all_runs(updates=1, voltage_errors=None)

    def with_observers(self, observers: Mapping[str, RunObserver]) -> Dataset:
        """Return a copy in which some runs are predicted with another observer.

        Args:
            observers: By name of the run: bandwidth of the observer, rad/s, and factor by which the variance
                of the run's noise is inflated.

        Returns:
            Copy; runs that are not named are unchanged.
        """

        def with_observer(run: PreparedRecording, observer: RunObserver) -> PreparedRecording:
            noise = run.noise * np.sqrt(observer.inflation)
            return dataclasses.replace(run, observer_bandwidth=observer.bandwidth, noise=noise)

        runs = (
            with_observer(run, observers[run.name]) if run.name in observers else run for run in self.runs
        )
        return dataclasses.replace(self, runs=tuple(runs))

    def describe_jitter(self) -> str:
        """Describe the jitter of the clock.

        Returns:
            Clause that follows "the clock", such as "jitters by 0.1 ms ..."; empty if there is no jitter.
        """
        if not self.jitter:
            return ""
        return (
            f"jitters by {1e3 * self.jitter:.2g} ms (standard deviation, from fast motion; the period is "
            f"{1e3 * self.period:.3g} ms): measurements in motion count as less accurate"
        )

    def single_runs(self) -> tuple[Dataset, ...]:
        """Divide the data set into data sets of one run each."""
        return tuple(dataclasses.replace(self, runs=(run,)) for run in self.runs)

    def measured_values(self, sensor: int) -> tuple[Array, ...]:
        """Return each run's measurements of a sensor (its index) minus its zero, in its unit, shapes (m,).

        Rows in which the sensor did not measure are left out.
        """
        values = (run.outputs[:, sensor] for run in self.runs)
        return tuple(of_run[np.isfinite(of_run)] for of_run in values)
