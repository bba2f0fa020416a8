"""Fit a machine to logs that are slower than the controller, with voltages interpolated between rows.

A controller answers each rounding error of an encoder with a voltage that lasts until it reads the encoder
again. In a slow log, interpolation spreads this voltage over the intervals on both sides of the row. The
interpolated voltages then err by some 20 mV, and least squares fail in three ways:

- The voltage before a row already contains the answer to the measurement of the row. Least squares take the
  correlation of both for an effect of the voltage on the motion: pulleys seemed up to 13 % heavier. Therefore
  the residual must not be orthogonal to the derivatives themselves, but to *instruments*: derivatives
  computed from smoothed voltages and measurements, which follow the motion as well and hardly contain single
  rounding errors.
- The errors of the voltages push the machine about, so that the residual is correlated in time and between
  sensors. An autoregressive filter of residual and derivatives makes it white.
- Where a voltage jumps between two rows, interpolation fails. Rows that it affects are left out.

Both rows and autoregression follow from the residual, and are found anew after each step of the parameters.

Instruments also tell how late the voltages act: the derivative with respect to their delay is one more
regressor, and computed from smoothed voltages one more instrument (`excess_delay`).

A fit to residuals that the statistics of the interpolation make white (`voltage_errors`) uses the data
better, where these statistics are right; instruments need none. Both are fitted to half of the runs, and the
weighted mean of their parameters that simulates the other half best is taken (stacking). With a choice of one
of both, a difference of 1 % decided between 25 and 31 times the noise.

All of these fits are right if the voltages err as assumed. If they do not, each errs by another amount,
because it weighs fast and slow errors otherwise; their deviations from the delivered parameters are a part of
the covariance (`deviations_of_fits`), as a difference of two estimators shows a wrong specification.

References:
    Hausman (1978), "Specification tests in econometrics".
    Sawa (1973), "The mean square error of a combined estimator and numerical comparison with the TSLS
    estimator". Breiman (1996), "Stacked regressions". Söderström and Stoica (1983), "Instrumental Variable
    Methods for System Identification". Ljung (1999), "System Identification", sections 7.5 and 13.4.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.linalg import block_diag
from scipy.signal import savgol_filter

from ...arrays import Array
from ...machine import Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ..budget import goes_on, spend
from ..judge.observer import index_of_best_simulation
from ..predict.free_parameters import bounded_step, prior_precision, values_at
from ..predict.linearization import ResidualModel
from ..predict.prediction import (
    NARROWEST_WITH_VOLTAGE_ERRORS,
    POLISH_STEP,
    SEARCH_BANDWIDTH,
    SIMULATION,
    block_size,
    innovation_variance,
    map_runs,
)
from .covariance import BLOCK_S, DELAY_STD, principal_directions, student_widening
from .estimation import Fit, prediction_cost, prediction_costs
from .model_error import continue_fit, search_step

_ORDER = 12  # rows of the autoregression: errors of the voltages last as long as the belts vibrate
# Rows of the cubics by which voltages and measurements are smoothed for the instruments: a single row counts
# 16 %. Windows from 9 to 31 rows gave the same parameters.
_SMOOTHED_ROWS = 15
_CHANCE = 1e-6  # probability that Gaussian errors exceed those at which a row is left out
_ROWS_PER_COEFFICIENT = 10  # fewer rows do not determine an autoregression
_ROUNDS = 10  # steps of the parameters, at most
# Of theta, where the residual is not linear; a parameter that is no logarithm may also change by this part of
# itself. A damping of belts that does not exist is 1 ms by least squares; in steps of 0.05 ms, no fit by
# instruments ended.
_LONGEST_STEP = 0.5
# Weights of the fit by instruments that are compared; more would not change its simulations.
_WEIGHTS = (0.0, 0.25, 0.5, 0.75, 1.0)
_CONVERGED = 1.0  # decrease of the cost: that of one standard deviation
# Change of the voltages' delay between steps, standard deviations: less than its own error. It follows from a
# step of delay and parameters together, so that it is known before these converge.
_DELAY_CONVERGED = 0.5


class _Whitening(NamedTuple):
    """Autoregression that makes the residual of s sensors white, with unit variance.

    Attributes:
        coefficients: Prediction of a row from the `_ORDER` rows before it, the latest first,
            shape (_ORDER * s, s).
        root: Inverse Cholesky factor of the covariance of its errors, shape (s, s).
    """

    coefficients: Array
    root: Array

    def __call__(self, values: Array) -> Array:
        """Return whitened rows, shape (k, n - _ORDER, s), of k residuals or derivatives of n rows."""
        sensors = len(self.root)
        rows = values.reshape(len(values), -1, sensors)
        errors = rows[:, _ORDER:].copy()
        for lag, of_lag in enumerate(self.coefficients.reshape(_ORDER, sensors, sensors), 1):
            errors -= rows[:, _ORDER - lag : -lag] @ of_lag
        return np.asarray(errors @ self.root.T)


class _Linear(NamedTuple):
    """Linearized residual of a run.

    Attributes:
        residual: Residual, shape (1, n * s).
        jacobian: Its derivatives with respect to k parameters, shape (k, n * s).
        instruments: The derivatives with smoothed voltages and measurements, shape (k, n * s).
    """

    residual: Array
    jacobian: Array
    instruments: Array


class _Equations(NamedTuple):
    """Normal equations of that part of the white residual that instruments represent, for k parameters.

    Attributes:
        information: Shape (k, k).
        by_block: The information of each block of 0.5 s, in which the residual may be correlated,
            shape (blocks, k, k).
        scores: Gradient of each block, shape (blocks, k).
    """

    information: Array
    by_block: Array
    scores: Array

    @property
    def gradient(self) -> Array:
        """Sum of the scores, shape (k,)."""
        return np.asarray(self.scores.sum(axis=0))

    def without_delay(self) -> _Equations:
        """Return the equations without the last parameter, the voltages' delay."""
        return _Equations(self.information[:-1, :-1], self.by_block[:, :-1, :-1], self.scores[:, :-1])

    def delay(self, prior: Array, theta: Array) -> ExcessDelay:
        """Return the voltages' delay, the last parameter, from the prior and theta of the other ones."""
        prior = block_diag(prior, 1.0)  # of the delay: one sampling period
        covariance = np.linalg.inv(self.information + prior)
        step = -covariance @ (self.gradient + prior @ np.append(theta, 0.0))
        return ExcessDelay(float(step[-1]), math.sqrt(covariance[-1, -1]), theta)

    def covariance(self, prior: Array, theta: Array) -> tuple[Array, Array]:
        """Return the covariance of theta, and the change of theta by the delay that the residual indicates.

        Their shapes are (k - 1, k - 1) and (k - 1,), if the last parameter is the voltages' delay. The parts
        of the covariance are those of `covariance.with_uncertainty` without this change: residual, prior and
        times.
        """
        known = self.without_delay()
        white = np.asarray(np.linalg.inv(known.information + prior), np.float64)
        changes = known.scores @ white * student_widening(known.by_block, white)
        sandwich = changes.T @ changes + white @ prior @ white
        inflation = np.sqrt(np.maximum(np.diag(white) / np.diag(sandwich), 1.0))
        of_delay = np.asarray(white @ self.information[:-1, -1])
        of_times = DELAY_STD**2 * np.outer(of_delay, of_delay)
        covariance = np.asarray(sandwich * np.outer(inflation, inflation) + of_times)
        return covariance, self.delay(prior, theta).periods * of_delay


class _Estimate(NamedTuple):
    """Fit by instruments: k parameters theta, and the machine."""

    theta: Array
    machine: Machine


class ExcessDelay(NamedTuple):
    """Additional delay of the voltages beyond that of the assumed number of changes between two rows.

    Attributes:
        periods: Delay, sampling periods; negative if the voltages act earlier.
        deviation: Standard deviation of the delay, sampling periods.
        theta: Parameters of the machine, estimated together with the delay, shape (k,).
    """

    periods: float
    deviation: float
    theta: Array


class _Models(NamedTuple):
    """Residuals of a machine, with the voltages and measurements as they are, and smoothed.

    Attributes:
        measured: Residual as a function of the parameters.
        smooth: The same with smoothed voltages and measurements.
    """

    measured: ResidualModel
    smooth: ResidualModel

    @classmethod
    def of(cls, fitted: Fit, data: Dataset) -> _Models:
        """Return the models of a fitted machine."""
        smooth = dataclasses.replace(data, runs=tuple(map(_smoothed, data.runs)))
        return cls(
            *(
                ResidualModel(
                    fitted.machine, fitted.free, d, SEARCH_BANDWIDTH, search_step(SEARCH_BANDWIDTH, d)
                )
                for d in (data, smooth)
            )
        )

    @property
    def sensors(self) -> int:
        """Number of sensors."""
        return len(self.measured.machine.sensors)

    @property
    def rows_per_block(self) -> int:
        """Rows between which the residual may be correlated."""
        return block_size(BLOCK_S, self.measured.machine, self.measured.data) // self.sensors

    @property
    def all_rows(self) -> list[NDArray[np.bool_]]:
        """Mask of the rows that have enough rows before them, for each run."""
        return [np.ones(len(run.time_s) - _ORDER, np.bool_) for run in self.measured.data.runs]

    def directions(self, theta: Array) -> Array:
        """Return the principal axes of the information, like those of the covariance, shape (k, k)."""
        information = self.measured.linearize(theta).normal_equations.information
        if not np.isfinite(information).all():
            information = np.zeros_like(information)
        return principal_directions(information, prior_precision(self.measured.free))

    def linearize(self, theta: Array, directions: Array) -> list[_Linear]:
        """Return each run's linearized residual, and its instruments, by differences along directions."""
        measured = _differences(self.measured, theta, directions)
        smooth = _differences(self.smooth, theta, directions)
        return [
            _Linear(residual, jacobian, instruments)
            for (residual, jacobian), (_, instruments) in zip(measured, smooth, strict=True)
        ]


def _differences(model: ResidualModel, theta: Array, directions: Array) -> list[tuple[Array, Array]]:
    """Return residual, (1, n * s), and derivatives, (k, n * s), of runs by differences along directions."""
    point = model.at(theta)
    inverse = np.linalg.inv(directions)

    def of_run(run: PreparedRecording) -> tuple[Array, Array]:
        residual = point.residuals(run, directions.T)[0]
        return residual[:1], inverse.T @ (residual[1:] - residual[0])

    return list(map_runs(of_run, model.data))


def fit_slow_log(fitted: Fit, data: Dataset) -> Fit:
    """Refine a fit to a slow log, whose voltages are interpolated between rows, by instrumental variables.

    Least squares adapt to the controller's answers to rounding errors of the rows. Instruments are
    derivatives of the predictions, computed from smoothed signals, that do not contain these answers. The
    cost is the part of the residual that instruments can represent, plus the prior (two-stage least squares).
    The predictions have the observer of the search, and an autoregressive filter makes their residual white.
    Of the parameters of `fitted`, of this fit and between both, those are returned that simulate left-out
    runs best.

    Args:
        fitted: Final fit of a machine.
        data: Runs that were fitted (times, voltages, measurements, SI).

    Returns:
        Fit with the same observer. `fitted` itself if the voltages are held, the rows are too few, the steps
        do not converge, the time of a stage that must deliver is used up, or instruments do not simulate
        left-out runs better (`judge.observer.index_of_best_simulation`).
    """
    if not data.has_voltage_errors or not _are_enough(data) or not goes_on():
        return fitted
    weight = _weight_of_instruments(fitted, data)
    by_instruments = _by_instruments(fitted, data.without_voltage_errors()) if weight else None
    return fitted if by_instruments is None else _finished(fitted, by_instruments, weight, data)


def fit_by_instruments(fitted: Fit, data: Dataset) -> Fit | None:
    """Fit a machine by instrumental variables (see `fit_slow_log`), without a comparison with `fitted`.

    Instruments are computed from smoothed signals; the errors of interpolated voltages hardly change them.

    Args:
        fitted: Fit by least squares, from which the estimation starts.
        data: Runs that were fitted.

    Returns:
        Fit with the covariance of its parameters; None if the voltages are held, the rows are too few, or the
        steps do not converge.
    """
    if not data.has_voltage_errors or not _are_enough(data):
        return None
    found = _by_instruments(fitted, data.without_voltage_errors())
    return None if found is None else _finished(fitted, found, 1.0, data)


def _weight_of_instruments(fitted: Fit, data: Dataset) -> float:
    """Return the weight of the fit by instruments with which half of the runs simulates the other half best.

    Errors of the voltages add up in a simulation, and a fit adapts to those of its own runs.
    """
    halves = [data.with_runs([run.name for run in data.runs[first::2]]) for first in (0, 1)]
    costs = list[list[Array]]()
    for known, others in (halves, halves[::-1]):
        if not known.runs or not others.runs or not _are_enough(known):
            return 0.0
        by_squares = continue_fit(fitted, known, fitted.bandwidth)
        if not goes_on():  # then that fit did not converge
            return 0.0
        by_instruments = _by_instruments(by_squares, known.without_voltage_errors())
        if by_instruments is None:
            return 0.0
        machines = (_between(by_squares, by_instruments, weight)[1] for weight in _WEIGHTS)
        costs.append([prediction_costs(m, others, SIMULATION, longest_step=POLISH_STEP) for m in machines])
    return _WEIGHTS[index_of_best_simulation(np.concatenate(costs, axis=1))]


def _between(by_squares: Fit, by_instruments: _Estimate, weight: float) -> _Estimate:
    """Return the machine with weighted means of the parameters, from least squares (0) to instruments (1)."""
    theta = (1.0 - weight) * by_squares.theta + weight * by_instruments.theta
    return _Estimate(theta, by_squares.machine.replace(values_at(by_squares.free, theta)))


def deviations_of_fits(fitted: Fit, data: Dataset) -> Array:
    """Return how far other fits, which weigh fast errors differently, deviate from the delivered one.

    If the errors of the voltages between the rows are as assumed, the fits differ only by chance. They are
    least-squares fits with observer bandwidths of 60 and of 15 rad/s (the largest and the smallest for a log
    slower than its controller) and a fit by instrumental variables, if it converges in time and the runs have
    enough rows for it.

    Args:
        fitted: Delivered fit of k parameters.
        data: Runs that were fitted.

    Returns:
        `Fit.theta` of each other fit minus that of `fitted`, dimensionless, shape (m, k). m is 0 if the
        voltages are held, nothing was fitted (the declared machine is delivered), or the time of the stage
        ends before both least-squares fits have converged; otherwise it is 2 or, with instruments, 3.
    """
    deviations = list[Array]()
    if data.has_voltage_errors and fitted.free:
        for bandwidth in (SEARCH_BANDWIDTH, NARROWEST_WITH_VOLTAGE_ERRORS):
            deviations.append(continue_fit(fitted, data, bandwidth).theta - fitted.theta)
            if not goes_on():  # then that fit did not converge
                return np.zeros((0, len(fitted.theta)))
        if _are_enough(data) and (found := _by_instruments(fitted, data.without_voltage_errors())):
            deviations.append(found.theta - fitted.theta)
    return np.array(deviations).reshape(len(deviations), len(fitted.theta))


def excess_delay(fitted: Fit, data: Dataset, start: ExcessDelay | None = None) -> ExcessDelay | None:
    """Estimate the delay of the voltages beyond that of the assumed number of their changes per row.

    Voltages that change n times a row and are held between the changes act later than continuous ones by 1 /
    (2 n) sampling periods. The delay is estimated together with the parameters, by instrumental variables. A
    delay of zero confirms the assumed number.

    Args:
        fitted: Fit of a machine to these runs.
        data: Runs whose voltages change at least twice a row.
        start: Result for another number of changes, whose parameters are the starting values. Default: those
            fitted.

    Returns:
        Delay; None if the rows are too few, the delay does not converge, or a prediction diverges.
    """
    data = data.without_voltage_errors()
    if not _are_enough(data):
        return None
    models, prior = _Models.of(fitted, data), prior_precision(fitted.free)
    theta = fitted.theta if start is None else start.theta
    used, directions, found = models.all_rows, models.directions(theta), None
    for _ in range(_ROUNDS):
        spend()
        linear = _linear_with_delay(models, theta, directions)
        if not _are_finite(linear):
            return None
        whitening, used = _whitening([of_run.residual for of_run in linear], used, models.sensors)
        wide = block_diag(prior, 1.0)
        equations = _normal_equations(linear, whitening, used, wide, models.rows_per_block)
        before, found = found, equations.delay(prior, theta)
        if before is not None and abs(found.periods - before.periods) < _DELAY_CONVERGED * found.deviation:
            return found
        theta = theta + _step(fitted, theta, equations.without_delay())[0]
    return None


def _linear_with_delay(models: _Models, theta: Array, directions: Array) -> list[_Linear]:
    """Return the linearized residual of each run, with the voltages' delay as the last parameter."""
    return [
        _Linear(
            of_run.residual,
            np.vstack([of_run.jacobian, by_delay]),
            np.vstack([of_run.instruments, smooth_by_delay]),
        )
        for of_run, by_delay, smooth_by_delay in zip(
            models.linearize(theta, directions),
            *(_delay_derivatives(model, theta) for model in models),
            strict=True,
        )
    ]


def _equations_with_delay(fitted: Fit, theta: Array, data: Dataset) -> _Equations | None:
    """Return the equations for the parameters and the voltages' delay; None if a prediction diverges."""
    models = _Models.of(fitted, data)
    linear = _linear_with_delay(models, theta, models.directions(theta))
    if not _are_finite(linear):
        return None
    whitening, used = _whitening([of_run.residual for of_run in linear], models.all_rows, models.sensors)
    prior = block_diag(prior_precision(fitted.free), 1.0)
    return _normal_equations(linear, whitening, used, prior, models.rows_per_block)


def _delay_derivatives(model: ResidualModel, theta: Array) -> list[Array]:
    """Return the derivative of each run's residual by the voltages' delay, 1/period, shape (1, n * s)."""
    fewer, more = model.data.updates - 1, model.data.updates + 1

    def residuals_with(updates: int) -> list[Array]:
        data = model.data.with_updates(updates)
        point = dataclasses.replace(model, data=data).at(theta)
        return list(map_runs(lambda run: point.residuals(run, np.zeros((0, len(theta))))[0], data))

    delay = 0.5 / more - 0.5 / fewer  # periods
    return [
        (after - before) / delay
        for before, after in zip(residuals_with(fewer), residuals_with(more), strict=True)
    ]


def _by_instruments(fitted: Fit, data: Dataset) -> _Estimate | None:
    """Fit a machine by instruments; None if the steps do not converge, or their time ends."""
    models, theta, prior = _Models.of(fitted, data), fitted.theta, prior_precision(fitted.free)
    used, directions = models.all_rows, models.directions(theta)
    for _ in range(_ROUNDS):
        if not goes_on():
            return None
        linear = models.linearize(theta, directions)
        if not _are_finite(linear):
            return None
        whitening, used = _whitening([of_run.residual for of_run in linear], used, models.sensors)
        equations = _normal_equations(linear, whitening, used, prior, models.rows_per_block)
        step, slope = _step(fitted, theta, equations)
        theta = theta + step
        if -float(slope @ step) < _CONVERGED:
            return _Estimate(theta, models.measured.machine_at(theta))
    return None


def _step(fitted: Fit, theta: Array, equations: _Equations) -> tuple[Array, Array]:
    """Return a step of the parameters within their limits, and the gradient of the cost with the prior."""
    prior = prior_precision(fitted.free)
    slope = equations.gradient + prior @ theta
    step = bounded_step(fitted.free, theta, equations.information + prior, slope)
    values = zip(fitted.free, theta, strict=True)
    sizes = [0.0 if free.scale is None else float(abs(free.value(t) / free.scale)) for free, t in values]
    longest = _LONGEST_STEP * np.maximum(np.array(sizes), 1.0)
    return step / max(float(np.max(np.abs(step) / longest)), 1.0), slope


def _are_finite(linear: Sequence[_Linear]) -> bool:
    """Return whether no prediction diverges."""
    return all(np.isfinite(part).all() for of_run in linear for part in of_run)


def _are_enough(data: Dataset) -> bool:
    """Return whether the rows of the runs determine an autoregression."""
    sensors = data.runs[0].outputs.shape[1]
    rows = [len(run.time_s) for run in data.runs]
    return min(rows) > 2 * _ORDER and sum(rows) > _ROWS_PER_COEFFICIENT * _ORDER * sensors


def _finished(fitted: Fit, by_instruments: _Estimate, weight: float, data: Dataset) -> Fit:
    """Return the fit with weighted means of the parameters, and its cost with the observer that it had.

    The covariance is that of the instruments, the less accurate ones of both.
    """
    equations = _equations_with_delay(fitted, by_instruments.theta, data.without_voltage_errors())
    if equations is None:
        return fitted
    theta, machine = _between(fitted, by_instruments, weight)
    covariance, by_delay = equations.covariance(prior_precision(fitted.free), by_instruments.theta)
    data = data.with_observers(fitted.observers)
    cost = prediction_cost(machine, data, fitted.bandwidth, longest_step=fitted.longest_step)
    floor = innovation_variance(machine, data, fitted.bandwidth)[0]
    if not math.isfinite(cost):
        return fitted
    return dataclasses.replace(
        fitted,
        machine=machine,
        theta=theta,
        cost=cost,
        count=data.count,
        floor=floor,
        information=equations.without_delay().information,
        covariance=covariance,
        change_by_delay=by_delay,
    )


def _smoothed(run: PreparedRecording) -> PreparedRecording:
    """Return a run with smoothed voltages, measurements and times; missing measurements are interpolated.

    A controller differentiates the jitter of its clock, so that its voltages err with the time of each row.
    Measurements that were smooth at unsmoothed times would contain that time, and be no instrument. A sensor
    that measures nothing in the run, such as a laser beyond its range, has no smoothed measurements either.
    """
    outputs = run.known_outputs.copy()
    measured = np.isfinite(run.outputs)
    for j in np.flatnonzero(measured.any(axis=0)):
        rows = measured[:, j]
        outputs[:, j] = np.interp(run.time_s, run.time_s[rows], outputs[rows, j])
    time_s, inputs, outputs = (
        savgol_filter(values, _SMOOTHED_ROWS, 3, axis=0)
        for values in (run.time_s, run.without_clock_answers(), outputs)
    )
    outputs[:, ~measured.any(axis=0)] = np.nan
    clock = run.clock_voltages
    clock = None if clock is None else clock._replace(answers=np.zeros_like(inputs))  # they are removed
    return dataclasses.replace(run, time_s=time_s, inputs=inputs, outputs=outputs, clock_voltages=clock)


def _earlier(rows: Array) -> Array:
    """Return the `_ORDER` rows before each of n rows, the latest first, shape (n - _ORDER, _ORDER * s)."""
    return np.hstack([rows[_ORDER - lag : -lag] for lag in range(1, _ORDER + 1)])


def _whitening(
    residuals: Sequence[Array], used: Sequence[NDArray[np.bool_]], sensors: int
) -> tuple[_Whitening, list[NDArray[np.bool_]]]:
    """Fit the autoregression to the rows in use, and find these: rows with errors that chance explains."""
    limit = stats.chi2.isf(_CHANCE, sensors)
    rows = [residual.reshape(-1, sensors) for residual in residuals]
    regressors = np.concatenate([_earlier(of_run) for of_run in rows])
    values = np.concatenate([of_run[_ORDER:] for of_run in rows])
    kept, ends = np.concatenate(used), np.cumsum([len(of_run) for of_run in used])[:-1]
    for _ in range(_ROUNDS):
        coefficients = np.linalg.lstsq(regressors[kept], values[kept], rcond=None)[0]
        errors = values - regressors @ coefficients
        covariance = errors[kept].T @ errors[kept] / max(int(kept.sum()), 1)
        root = np.linalg.inv(np.linalg.cholesky(covariance + 1e-9 * np.eye(sensors)))
        before, kept = kept, np.sum((errors @ root.T) ** 2, axis=1) < limit
        if np.array_equal(before, kept):
            break
    return _Whitening(coefficients, root), np.split(kept, ends)


def _normal_equations(
    linear: Sequence[_Linear],
    whitening: _Whitening,
    used: Sequence[NDArray[np.bool_]],
    prior: Array,
    rows_per_block: int,
) -> _Equations:
    """Return the normal equations of the white residual's part in instruments, for k parameters."""
    k = len(prior)
    products, of_runs = np.zeros((k, 2 * k)), []
    for of_run, kept in zip(linear, used, strict=True):
        parts = np.vstack([of_run.instruments, of_run.jacobian, of_run.residual])
        white = whitening(parts) * kept[:, None]
        flat = white.reshape(len(white), -1)
        products += flat[:k] @ flat[:-1].T
        begins = range(0, white.shape[1], rows_per_block)
        of_runs += [white[:, begin : begin + rows_per_block].reshape(len(white), -1) for begin in begins]
    # A small part of the prior keeps combinations without instruments determined; it moves no parameter.
    own, of_jacobian = products[:, :k], products[:, k:]
    projected_rows = of_jacobian.T @ np.linalg.inv(own + 0.01 * prior)
    represented = [projected_rows @ block[:k] for block in of_runs]  # (k, values of a block)
    return _Equations(
        projected_rows @ of_jacobian,
        np.array([rows @ rows.T for rows in represented]),
        np.array([rows @ block[-1] for rows, block in zip(represented, of_runs, strict=True)]),
    )
