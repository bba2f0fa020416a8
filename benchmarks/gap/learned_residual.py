"""Entries NAME-learned: NAME on the declared machine, and voltages that were learned from recordings.

    python -m benchmarks.gap run pid-learned ppo_mix-learned

Nothing is identified: no parameter is fitted and no effect is sought. Recordings show which forces the
declared machine lacks along its axes (`missing_forces`), and a regression learns them as a function of
position, speeds and voltages (`VoltageResidual`). In control, the entry subtracts the voltages of these
forces, so that the controller and its state estimator see a plant that is closer to the declared machine
(`Compensated`). Forces of belts sum to zero along the axes, so that their stiffness is not learned; what has
a memory, as heat, delays and hysteresis, is no function of these inputs.

Reference:
    Messenger and Bortz (2021), Weak SINDy: Galerkin-based data-driven model selection, Multiscale Modeling &
    Simulation 19(3).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import savgol_filter
from typing_extensions import override

from benchmarks.gap.control_loop import OBSERVED, PERIOD_S
from benchmarks.gap.entries import DesignedEntry, Trackname
from benchmarks.gap.recorder import RATE_HZ, Recorder, standard_session
from hframe_gym.arrays import Actions, KeyedObservation, Mask, TravelStates
from hframe_gym.controllers import Controller, MotionModel, OutputFeedbackController, StateEstimator
from hframe_gym.envs import Task, observed_machine
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording
from tests.reference_simulator import Array

# Half a window over which forces are averaged, and distance of the windows, samples of 1 ms: long against the
# belts' vibrations and the lasers' noise of 20 um, short against the runs' changes of speed.
HALF_WINDOW, STRIDE = 30, 10
SMOOTHED = 31  # samples over which positions are smoothed by a parabola, for speeds
MOVING_M_S = 0.01  # m/s; slower coordinates may be held by friction, whose force is then not known
# Scales of the inputs: m for positions, m/s for speeds (linear, and where friction changes its sign), V.
POSITION_M, SPEED_M_S, SLOW_M_S, VOLTAGE_V = 0.1, 0.5, 0.03, 6.0
WAVES, WAVES_SEED = 100, 0  # random cosines of position, speed and voltage: the smooth part
# Variances of the coefficients, over that of the noise, among which predictions of runs that are left out
# decide: of the linear and of the smooth part.
LINEAR, SMOOTH = (10.0, 1000.0), (1e-6, 0.1, 1.0, 10.0)


class Samples(NamedTuple):
    """Mean forces along an axis that the machine lacks, in windows of recordings.

    Attributes:
        inputs: Means of the inputs of the regression, dimensionless, shape (n, inputs).
        force_N: Missing forces, N, shape (n,).
        run: Number of the recording of each window, shape (n,).
    """

    inputs: Array
    force_N: Array
    run: Array


def regression_inputs(travel: Array, speed: Array, volts: Array) -> Array:
    """Compute the inputs of the regression: a constant, linear ones, blurred signs of speeds, and cosines.

    Args:
        travel: Travel of x, y and both motors, m, shape (n, 4).
        speed: Their speeds, m/s, shape (n, 4).
        volts: Voltages of the motors, V, shape (n, 2).

    Returns:
        The inputs, dimensionless, shape (n, 9 + `WAVES`).
    """
    moving = np.hstack([speed[:, :2] / SPEED_M_S, volts / VOLTAGE_V])
    rng = np.random.default_rng(WAVES_SEED)
    phases = np.hstack([travel[:, :2] / POSITION_M, moving]) @ rng.standard_normal((6, WAVES))
    waves = np.cos(phases + rng.uniform(0.0, 2.0 * np.pi, WAVES)) / np.sqrt(WAVES)
    return np.hstack([np.ones((len(travel), 1)), moving, np.tanh(speed / SLOW_M_S), waves])


def missing_forces(model: MotionModel, recordings: Sequence[Recording]) -> list[Samples]:
    """Compute the forces along the axes that a plant has in addition to a model.

    The equation of motion is averaged with a weight that vanishes smoothly at both ends of a window, so that
    the second derivative is that of the weight and not that of the noisy positions. Belts have no force along
    the axes in sum, however much they stretch.

    Args:
        model: Model of the machine.
        recordings: Runs of the plant, at 1 kHz.

    Returns:
        Samples of each axis, of the windows in which it and both motors move.
    """
    tau = np.arange(-HALF_WINDOW, HALF_WINDOW + 1) / HALF_WINDOW
    weight = (1.0 - tau**2) ** 4
    curvature = (56.0 * tau**2 - 8.0) * (1.0 - tau**2) ** 2 * (RATE_HZ / HALF_WINDOW) ** 2
    inputs, force, still = [], [], []
    for recording in recordings:
        travel = recording.outputs[:, OBSERVED] * model.machine.travel_per_unit  # x, y, phi1, phi2
        smooth, speed = (
            savgol_filter(travel, SMOOTHED, 2, deriv=order, delta=1.0 / RATE_HZ, axis=0) for order in (0, 1)
        )
        known = recording.inputs @ model.drive.T - model.viscous * speed - model.coulomb * np.sign(speed)
        momentum = _means(travel * model.mass @ model.rigid, curvature)
        inputs.append(_means(regression_inputs(smooth, speed, recording.inputs), weight))
        force.append((momentum - _means(known @ model.rigid, weight)) / weight.sum())
        still.append(_means((np.abs(speed) < MOVING_M_S).astype(np.float64), weight))
    every = np.concatenate(inputs) / weight.sum(), np.concatenate(force), np.concatenate(still)
    run = np.repeat(np.arange(len(inputs)), [len(rows) for rows in inputs])
    samples = []
    for axis in range(len(model.axes)):
        moving = (every[2][:, [axis, 2, 3]] == 0.0).all(axis=1)
        samples.append(Samples(every[0][moving], every[1][moving, axis], run[moving]))
    return samples


def _means(values: Array, weight: Array) -> Array:
    """Return the weighted sums of values (n, k) over windows, shape (windows, k)."""
    windows = sliding_window_view(values, len(weight), axis=0)[::STRIDE]
    return np.asarray(windows @ weight)


class VoltageResidual:
    """Voltages of the forces that a machine lacks, learned by a ridge regression for each axis.

    Args:
        model: Model of the machine.
        recordings: Runs of the plant.

    Attributes:
        left: Of each axis, the mean squared error of predicted runs that were left out, over that of
            predicting zero.
    """

    def __init__(self, model: MotionModel, recordings: Sequence[Recording]) -> None:
        learned = [_learned(samples) for samples in missing_forces(model, recordings)]
        self.left = [left for left, _, _ in learned]
        self._coefficients = np.stack([coefficients for _, coefficients, _ in learned], axis=1)
        self._largest_N = np.array([largest for _, _, largest in learned])
        self._volts_per_newton = np.linalg.inv(model.force_per_volt).T

    def __call__(self, state: TravelStates, volts: Array) -> Array:
        """Predict the missing voltages, V, shape (B, 2), of states (B, 8) and voltages, V, (B, 2)."""
        force = regression_inputs(state[:, :4], state[:, 4:], volts) @ self._coefficients
        return np.asarray(force.clip(-self._largest_N, self._largest_N) @ self._volts_per_newton)


def _learned(samples: Samples) -> tuple[float, Array, float]:
    """Return the error left, the coefficients and the largest force of the samples of an axis."""
    scored = {(linear, smooth): _left(samples, linear, smooth) for linear in LINEAR for smooth in SMOOTH}
    best = min(scored, key=lambda variances: scored[variances])
    coefficients = _ridge(samples.inputs, samples.force_N, *best)
    return scored[best], coefficients, float(np.abs(samples.force_N).max())


def _ridge(inputs: Array, force_N: Array, linear: float, smooth: float) -> Array:
    """Return the coefficients of a ridge regression."""
    variance = np.repeat([linear, smooth], [inputs.shape[1] - WAVES, WAVES])
    return np.asarray(np.linalg.solve(inputs.T @ inputs + np.diag(1.0 / variance), inputs.T @ force_N))


def _left(samples: Samples, linear: float, smooth: float) -> float:
    """Return the squared error of predicted runs that were left out, over that of predicting zero."""
    squared = 0.0
    for number in np.unique(samples.run):
        out = samples.run == number
        coefficients = _ridge(samples.inputs[~out], samples.force_N[~out], linear, smooth)
        squared += float(((samples.force_N[out] - samples.inputs[out] @ coefficients) ** 2).sum())
    return squared / float((samples.force_N**2).sum())


class _Remembering(StateEstimator):
    """State estimator that keeps its last estimate."""

    estimate: TravelStates

    @override
    def update(self, measurements: Array, arrived: tuple[Array, Array] | None = None) -> TravelStates:
        self.estimate = super().update(measurements, arrived)
        return self.estimate


class Compensated(Controller):
    """A controller from measurements whose commands are corrected by learned voltages.

    The controller and its estimator are told the voltages that act on the declared machine: those of the
    command, limited, and the learned ones.

    Args:
        controller: Controller of the declared machine.
        estimator: Its state estimator.
        residual: Learned voltages.
    """

    feedback = "observation"

    def __init__(self, controller: Controller, estimator: _Remembering, residual: VoltageResidual) -> None:
        super().__init__(controller.machine, controller.period)
        self._controller = OutputFeedbackController(controller, estimator)
        self._estimator, self._residual = estimator, residual

    @override
    def reset(self, mask: Mask | None = None) -> None:
        self._controller.reset(mask)

    @override
    def act(self, observation: KeyedObservation) -> Actions:
        rated = self._estimator.model.rated
        wanted = self._controller.act(observation).clip(-1.0, 1.0)
        learned = self._residual(self._estimator.estimate, wanted * rated) / rated
        command = (wanted - learned).clip(-1.0, 1.0)
        self._controller.replace_last_action(command + learned)
        return np.asarray(command)


class LearnedResidual(DesignedEntry):
    """The machine is the declared one; a regression learned from the standard session what it lacks."""

    track: Trackname = "identified"
    knowledge = "declared machine, residual learned from recordings"
    learned = True

    @override
    def prepare(self, declared: Machine, recorder: Recorder, folder: Path) -> None:
        self.machine = declared
        self.residual = VoltageResidual(MotionModel(declared), standard_session(recorder))

    @override
    def controller(self, task: Task) -> Controller:
        observed = observed_machine(self.machine, "machine")
        assert observed is not None
        return Compensated(self.design(task), _Remembering(observed, PERIOD_S), self.residual)

    @override
    def about(self) -> dict[str, object]:
        return {"residual_left": [round(left, 4) for left in self.residual.left]}
