"""State estimation from sensors: a Kalman filter around the simulator that also estimates parameters.

The estimated vector holds travel and velocity of all coordinates, the logarithms of the ratios of masses,
friction, belt stiffness and motor constants to their declared values (`AugmentedParameters`), and, if they
may drift, the errors of the encoders. A belt mode covers a good part of its cycle between two measurements:
velocities are observable only together with the belts' stiffness.

Prediction    Second-order divided differences: the simulator maps points spread over the covariance, so that
              friction that sticks at some points and slips at others enters the predicted covariance. Effects
              with a memory, as heat or a hysteresis, go on from their states at the mean.
Loads         A load that swings slowly is simulated with its carriage (`slow_loads`), although no sensor sees
              it.
Correction    By the measurements within their sensors' ranges. A laser at the end of its range carries no
              information; encoders, and the belts' stretch under the estimated friction, then locate the
              tool.
Encoders      What lies between an encoder and its belt (an eccentric pulley, a belt that creeps or climbs its
              teeth) moves one against the other. Taken for stretch of the belt, 0.1 mm is a force of tens of
              newtons. With `drifting_encoders`, the filter therefore estimates an error of each encoder,
              which wanders slowly.
Robustness    Innovations larger than their covariance explains inflate it (fading memory), because a machine
              file is never complete.

References:
    Norgaard, Poulsen and Ravn (2000), New developments in state estimation for nonlinear systems, Automatica
    36(11). Fagin (1964), Recursive linear regression theory, optimal filter theory, and error analysis of
    optimal systems.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, Mask, TravelStates, Volts
from ...dynamics import simulate_batch
from ...errors import InputError
from ...machine import Machine, rigid_counterpart
from ..base import SIMULATION_STEP_S, EpisodeStarts
from ..control_period import check_period
from ..models.input_compensation import DeadTime
from ..models.motion_model import MotionModel
from .estimation_model import AugmentedParameters, MeasurementModel
from .recursive_least_squares import kalman_gain

# Squared distance of the points in standard deviations: the kurtosis of a normal distribution.
SIGMA_SQUARED = 3.0
ROUNDING = 1e-9  # relative growth of variances that keeps a covariance positive definite in double precision

# Each reduces the error by the slope of the deviation, which is below a third for the errors of real sensors.
DEVIATION_ITERATIONS = 4
INITIAL_STRETCH_STD = 1e-4  # m, of the travel at the start of an episode
# Process noise: an unmodeled force on each coordinate, constant over a period, as a fraction of its Coulomb
# level (at least a tenth of the largest level); and m/s per square root of a second for machines without
# friction.
FORCE_NOISE, VELOCITY_NOISE = 0.1, 1e-2
PARAMETER_MEMORY_S = 8.0  # s, time constant of forgetting: motors warm up, and friction varies along the path
INNOVATION_LIMIT = 4.0  # squared innovation over its expectation, above which the covariance is inflated
LARGEST_INFLATION = 1e4  # of variances, per period
# Standard deviations beyond which travel (m) and velocity (m/s) are not inflated; for parameters the prior
# ones.
LARGEST_STD = (0.1, 1.0)
# Errors of encoders that may drift: standard deviation at the start of an episode, at rest, m;
# their growth, m per square root of a second; and the limit of inflation, m: the eccentricity of a bad
# pulley.
ENCODER_START, ENCODER_WALK, ENCODER_LARGEST = 5e-6, 2e-5, 2e-4
# Smallest distance of the points (m, m/s, logarithm) at which differences of doubles still give a slope.
SMALLEST_STD = (1e-8, 1e-6, 1e-5)


class StateEstimator:
    """Kalman filter that estimates states and parameters from the declared sensors; see `Estimator`.

    Args:
        period: Control period, s.
        parameter_covariance: Covariance of the logarithms of the ratios of the k parameters `augmented.names`
            to their values in the machine, at the start of an episode, shape (k, k). Default: that of
            declared values.
        drifting_encoders: Whether the sensors of coordinates other than the tool's axes have errors that
            wander slowly; they are estimated as well. Useful where the machine file may lack effects between
            encoder and belt.

    Attributes:
        augmented: Names and prior covariance of the k estimated parameters (masses, friction, belts, motors).

    Raises:
        InputError: If the machine does not have one drive per axis of its tool, its sensors do not determine
            the position of the tool, the period is invalid, or the covariance has the wrong shape.
    """

    def __init__(
        self,
        machine: Machine,
        period: float,
        parameter_covariance: Array | None = None,
        drifting_encoders: bool = False,
    ) -> None:
        machine = rigid_counterpart(machine, with_slow_loads=True)
        self.model = model = MotionModel(machine)
        self.period = check_period(period)
        self.measurements = MeasurementModel(model)
        self.channels = self.measurements.channels
        self._dead_time = DeadTime(machine, period)
        # The delay line applies the dead time, and the measurement equation the effects of the sensors.
        machine_without_delay = self._dead_time.machine_without_delay
        remaining_effects = tuple(e for e in machine_without_delay.effects if e.definition.site != "sensor")
        self._simulated = dataclasses.replace(machine_without_delay, effects=remaining_effects)
        self.augmented = AugmentedParameters(self._simulated)
        n, count = len(machine.coordinates), len(self.augmented.names)
        if parameter_covariance is not None:
            self.augmented.covariance = _checked_covariance(parameter_covariance, count)
        self._scale = np.tile(machine.travel_per_unit, 2)
        # Travel and velocity of the coordinates of the controllers' model; slow loads are estimated beside
        # them.
        modeled = [machine.coordinate_names.index(name) for name in model.machine.coordinate_names]
        self._modeled = np.concatenate([modeled, n + np.array(modeled)])
        # Parts of the estimated vector: state, logarithms of parameter ratios, errors of encoders.
        encoders = np.eye(self.channels)[:, self._of_encoders() if drifting_encoders else []]
        drifting = encoders.shape[1]
        self._state, self._logarithms = slice(0, 2 * n), slice(2 * n, 2 * n + count)
        self._errors = slice(2 * n + count, 2 * n + count + drifting)
        # The linear part of the measurement equation, and the entries of the vector that it concerns.
        self._matrix = np.hstack([self.measurements.matrix, encoders])
        self._measured = np.r_[self._modeled, self._errors]
        self._smallest_std = np.repeat([*SMALLEST_STD, SMALLEST_STD[0]], [n, n, count, drifting])
        self._initial_covariance = np.zeros((self._errors.stop,) * 2)
        self._initial_covariance[:n, :n] = INITIAL_STRETCH_STD**2 * np.eye(n)
        self._initial_covariance[self._logarithms, self._logarithms] = self.augmented.covariance
        self._initial_covariance[self._errors, self._errors] = ENCODER_START**2 * np.eye(drifting)
        self._largest_variance = np.concatenate(
            [
                np.repeat(LARGEST_STD, n) ** 2,
                np.diag(self.augmented.covariance),
                np.full(drifting, ENCODER_LARGEST**2),
            ]
        )
        self._keep = np.exp(-period / PARAMETER_MEMORY_S)
        self._process_noise = (1.0 - self._keep**2) * self._initial_covariance
        velocity_std = np.zeros(n)
        largest_force = FORCE_NOISE * np.maximum(model.coulomb, 0.1 * model.coulomb.max())
        velocity_std[modeled] = largest_force / model.mass * period
        std = np.concatenate(
            [0.5 * period * velocity_std, np.hypot(velocity_std, VELOCITY_NOISE * np.sqrt(period))]
        )
        self._process_noise[self._state, self._state] = np.diag(std**2)
        self._process_noise[self._errors, self._errors] = ENCODER_WALK**2 * period * np.eye(drifting)
        self._starts = EpisodeStarts()
        self._mean = np.zeros((0, len(self._initial_covariance)))
        self._covariance = np.zeros((0, *self._initial_covariance.shape))
        self._effects = np.zeros((0, 0))  # states of the effects at the mean, SI
        # Of the last measurements: squared innovation over its covariance, this covariance, and what is
        # valid.
        self._predicted = np.zeros(0), np.zeros((0, 0, 0)), np.zeros((0, 0), np.bool_)

    @property
    def log_likelihood(self) -> Array:
        """Log-likelihood of the last valid measurements, given all earlier ones, shape (B,).

        Measurements count in m of belt travel. To compare two estimators with the same sensors, sum it over
        recordings: the larger sum belongs to the better model.
        """
        squared, covariance, valid = self._predicted
        # Invalid measurements are predicted with the variance of their noise alone.
        invalid = np.where(valid, 0.0, np.log(self.measurements.variance)).sum(axis=1)
        log_determinant = np.linalg.slogdet(covariance)[1] - invalid
        return -0.5 * (squared + log_determinant + np.log(2.0 * np.pi) * valid.sum(axis=1))

    @property
    def parameter_ratios(self) -> Array:
        """Estimates of the k parameters `augmented.names` divided by the declared values, shape (B, k)."""
        return self.augmented.ratios(self._mean[:, self._logarithms])

    @property
    def parameter_covariance(self) -> Array:
        """Covariance of the logarithms of the k parameter ratios, shape (B, k, k)."""
        return self._covariance[:, self._logarithms, self._logarithms].copy()

    def _of_encoders(self) -> NDArray[np.intp]:
        """Return the indices of the channels that measure a coordinate other than the tool's axes."""
        beside = [i for i in range(len(self.model.mass)) if i not in self.model.tool]
        return np.flatnonzero(np.any(self.measurements.matrix[:, beside] != 0.0, axis=1))

    def reset(self, mask: Mask | None = None) -> None:
        """Discard the estimates of the machines in `mask`, which start an episode next.

        The new estimates start from a machine at rest with the declared parameters. If `mask` is None, all
        estimates are discarded; the number of machines may then change.
        """
        self._starts.reset(mask)

    def send(self, volts: Volts) -> None:
        """Store the voltages commanded for the period that starts now; `update` predicts with them."""
        self._dead_time.send(volts)

    def replace_last(self, volts: Volts) -> None:
        """Replace the voltages that `send` stored last with the voltages that were actually applied."""
        self._dead_time.replace_last(volts)

    @property
    def delay_s(self) -> float:
        """Dead time of the slowest drive, s."""
        return self._dead_time.delay_s

    def update(self, measurements: Array, arrived: tuple[Array, Array] | None = None) -> TravelStates:
        """Predict the state over the last control period and correct it with new measurements.

        Args:
            measurements: One measurement per sensor, m or rad, shape (B, channels).
            arrived: Times within the last period, from 0 to the period, s, shape (k,), and the voltages that
                reached the drives from each time on, V, shape (B, k, drives), the last entry repeated. It is
                for recordings whose voltages also change within a control period. Default: the voltages of
                `send`.

        Raises:
            InputError: If a measurement is not finite.
        """
        values = np.asarray(measurements, np.float64)
        if not np.all(np.isfinite(values)):
            row, column = map(int, np.argwhere(~np.isfinite(values))[0])
            raise InputError(f"measurements: channel {column} of machine {row} is {values[row, column]}")
        if self._starts.resize(len(values)):
            self._mean = np.zeros((len(values), len(self._initial_covariance)))
            self._covariance = np.tile(self._initial_covariance, (len(values), 1, 1))
            self._effects = np.zeros((len(values), 0))  # none: all begin with 0
        starts = self._starts.mask
        self._dead_time.reset(starts)
        travel, valid = self.measurements.to_travel(values), self.measurements.in_range(values)
        self._predict(*(arrived or self._dead_time.arrived_history()))
        if starts.any():  # new episodes start at rest, with the declared parameters
            self._mean[starts] = 0.0
            self._mean[np.ix_(starts, self._modeled)] = self._state_at_rest(travel, valid)[starts]
            self._covariance[starts] = self._initial_covariance
            self._effects[starts] = 0.0
            self._starts.clear()
        self._correct(travel, valid)
        return self._mean[:, self._modeled]

    def _state_at_rest(self, travel: Array, valid: Mask) -> Array:
        """Return states (B, 2 n) at rest with unstretched belts, by weighted least squares of measurements.

        Deviations of the sensors from a linear measurement are those at the state of the iteration before.
        """
        rigid = self.measurements.matrix[:, : len(self.model.mass)] @ self.model.rigid  # (channels, axes)
        weight = valid / self.measurements.variance
        normal = np.einsum("ki,bk,kj->bij", rigid, weight, rigid)
        states = np.zeros((len(travel), len(self._modeled)))
        for _ in range(1 if self.measurements.is_linear else 1 + DEVIATION_ITERATIONS):
            linear = travel - self.measurements.deviation(states)
            tool = np.linalg.solve(normal, ((weight * linear) @ rigid)[..., None])[..., 0]
            states = self.model.goal_state(tool)
        return states

    def _predict(self, times: Array, volts: Array) -> None:
        """Propagate mean and covariance over the last period with voltages of `DeadTime.arrived_history`."""
        points = sigma_points(self._mean, self._covariance, self._smallest_std)
        batch, count, _ = points.shape
        flat = points.reshape(batch * count, -1)
        motion = simulate_batch(
            self._simulated,
            times,
            np.repeat(volts, count, axis=0),
            parameters=self.augmented.parameters(flat[:, self._logarithms]),
            start=np.hstack([flat[:, self._state] / self._scale, np.repeat(self._effects, count, axis=0)]),
            longest_step=SIMULATION_STEP_S,
            readings=False,
            effects=True,
        )
        states = np.hstack([motion.positions[:, -1], motion.velocities[:, -1]])
        points[:, :, self._state] = (states * self._scale).reshape(batch, count, -1)
        self._effects = motion.effects[::count, -1].copy()
        points[:, :, self._logarithms] *= self._keep
        self._mean, covariance = transformed_moments(points)
        self._covariance = covariance + self._process_noise

    def _correct(self, travel: Array, valid: Mask) -> None:
        """Correct mean and covariance by the valid measurements (B, channels), m."""
        linear = travel - self.measurements.deviation(self._mean[:, self._modeled])
        innovation = np.where(valid, linear - self._mean[:, self._measured] @ self._matrix.T, 0.0)
        _, S = self._innovation_covariance(valid)
        size = np.einsum("bi,bi->b", innovation, np.linalg.solve(S, innovation[..., None])[..., 0])
        self._predicted = size, S, valid
        self._inflate(size / np.maximum(valid.sum(axis=1), 1))
        PH, S = self._innovation_covariance(valid)
        K = kalman_gain(PH, S)
        self._mean = self._mean + np.einsum("bij,bj->bi", K, innovation)
        self._mean[:, self._logarithms] = self.augmented.clip(self._mean[:, self._logarithms])
        # Joseph's form keeps the covariance positive after corrections by almost exact measurements.
        reduction = np.tile(np.eye(K.shape[1]), (len(K), 1, 1))
        reduction[:, :, self._measured] -= (K * valid[:, None, :]) @ self._matrix
        noise = (K * self.measurements.variance) @ K.transpose(0, 2, 1)
        self._covariance = reduction @ self._covariance @ reduction.transpose(0, 2, 1) + noise

    def _innovation_covariance(self, valid: Mask) -> tuple[Array, Array]:
        """Return P H' (B, N, channels) and the innovation covariance (B, channels, channels)."""
        # An invalid measurement gets no gain: its covariance with the state is set to zero.
        PH = self._covariance[:, :, self._measured] @ self._matrix.T * valid[:, None, :]
        HPH = self._matrix @ PH[:, self._measured] * valid[:, :, None]
        return PH, HPH + np.diag(self.measurements.variance)

    def _inflate(self, innovation_ratio: Array) -> None:
        """Inflate the covariance where squared innovations are `innovation_ratio` (B,) times the expected."""
        inflation = np.clip(innovation_ratio / INNOVATION_LIMIT, 1.0, LARGEST_INFLATION)[:, None]
        variance = np.diagonal(self._covariance, axis1=1, axis2=2)
        room = self._largest_variance / np.maximum(variance, self._smallest_std**2)
        factor = np.sqrt(np.minimum(inflation, np.maximum(room, 1.0)))
        self._covariance = factor[:, :, None] * self._covariance * factor[:, None, :]


def _checked_covariance(covariance: Array, count: int) -> Array:
    """Return the covariance as array; raise InputError unless it is finite, (count, count) and symmetric."""
    values = np.asarray(covariance, np.float64)
    if values.shape != (count, count) or not np.isfinite(values).all() or not np.allclose(values, values.T):
        raise InputError(
            f"parameter_covariance has shape {values.shape}; it must be symmetric and finite, with shape "
            f"({count}, {count}), for the parameters `augmented.names`"
        )
    return values


def sigma_points(mean: Array, covariance: Array, smallest_std: Array) -> Array:
    """Compute the sigma points of B normal distributions of N variables for the DD2 filter.

    These are the mean and, for each column c of the covariance's Cholesky factor, mean + sqrt(3) c and mean -
    sqrt(3) c (`SIGMA_SQUARED` = 3). DD2 is the filter with second-order divided differences of Norgaard,
    Poulsen and Ravn (2000).

    Args:
        mean: Means, each in its variable's unit, shape (B, N).
        covariance: Covariances, in products of these units, shape (B, N, N).
        smallest_std: Standard deviations, in the variables' units, whose squares are added to the variances,
            so that the points of a variable with zero variance differ as well, shape (N,).

    Returns:
        Points, in the variables' units: the mean, the N points with +, the N points with -,
        shape (B, 2 N + 1, N).
    """
    diagonal = np.arange(mean.shape[1])
    widened = covariance.copy()
    widened[:, diagonal, diagonal] = (1.0 + ROUNDING) * widened[:, diagonal, diagonal] + smallest_std**2
    # Rows: columns of the Cholesky factor times sqrt(3), shape (B, N, N).
    steps = np.sqrt(SIGMA_SQUARED) * np.linalg.cholesky(widened).transpose(0, 2, 1)
    center = mean[:, None]
    return np.concatenate([center, center + steps, center - steps], axis=1)


def transformed_moments(mapped: Array) -> tuple[Array, Array]:
    """Estimate mean and covariance of y = f(x) for normally distributed x by second divided differences.

    Divided differences need no derivatives, which do not exist where friction reverses. The covariance is a
    sum of squares and therefore positive semidefinite.

    Args:
        mapped: Values of f, with M components in any units, at the `sigma_points` of B distributions of N
            variables x, shape (B, 2 N + 1, M).

    Returns:
        mean: Means of y, in the units of f, shape (B, M).
        covariance: Covariances of y, in products of these units, shape (B, M, M).

    References:
        Norgaard, Poulsen and Ravn (2000), New developments in state estimation for nonlinear systems,
        Automatica 36(11): the DD2 filter.
    """
    count = mapped.shape[1] // 2
    center, above, below = mapped[:, :1], mapped[:, 1 : count + 1], mapped[:, count + 1 :]
    # Each of shape (B, N, M); the covariance is the sum of the squares of `first` and `second` over the N
    # variables.
    curvature = above + below - 2.0 * center
    mean = center[:, 0] + curvature.sum(axis=1) / (2.0 * SIGMA_SQUARED)
    first = (above - below) / (2.0 * np.sqrt(SIGMA_SQUARED))
    second = curvature * np.sqrt(SIGMA_SQUARED - 1.0) / (2.0 * SIGMA_SQUARED)
    roots = np.concatenate([first, second], axis=1)
    return mean, roots.transpose(0, 2, 1) @ roots
