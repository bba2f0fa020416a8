"""Estimation of a machine's parameters in an episode: measured states against one-period simulations.

Unlike `MomentumFilter`, which balances mean forces, these estimators compare the measured state with the
simulated one, so that belt modes and friction that reverses within a period do not disturb them. They
estimate every belt separately. Undeclared forces can be estimated as *missing voltages*: voltages at the
drives that the simulation lacks.

ParameterEstimator Base class: the estimated parameters, and the simulations that give the derivatives of a
                   period's final state with respect to the estimates.
ParameterFilter    Extended Kalman filter: each period is linearized once, at the estimates of its time. Its
                   errors stay at a few percent even where states are measured exactly, because an early
                   period is never revised.
ParameterWindow    Moving-horizon estimation: the last periods are linearized anew in every update, so that
                   estimates converge to the actual parameters where the model's structure is right and the
                   states are exact. The noise is estimated too: where states or model are inexact, the
                   estimates change slowly.

References:
    Ljung (1979), Asymptotic behavior of the extended Kalman filter as a parameter estimator for linear
    systems. Rao, Rawlings and Mayne (2003), Constrained state estimation for nonlinear discrete-time systems.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ...arrays import Array, Mask, ParameterRows, TravelStates
from ..base import SIMULATION_STEP_S
from ..models.motion_model import MotionModel
from ..models.simulated_motion import SimulatedMotion
from .estimation_model import ParameterRatios, prior_deviation
from .recursive_least_squares import RecursiveLeastSquares

LARGEST = 1.2  # limit of the logarithms: a ratio of 3.3, or the inverse
# Of `ParameterWindow`:
WINDOW = 6  # periods
REPEATED_PERIODS = 4  # periods at the beginning in which the estimates change much; they take two iterations
LARGEST_CHANGE = 0.5  # of a logarithm in an iteration
# Missing voltages, as fractions of the rated voltage: their change per period for each multiple of the
# smallest noise beyond 1 (standard deviation) with its limit, and the limit of the voltages.
OFFSET_WALK, LARGEST_WALK, LARGEST_OFFSET = 2e-3, 2e-2, 0.3
LIMIT_STD = 4.0  # limit of a logarithm in prior standard deviations: a belt must not become shorter than zero
LARGEST_DIFFERENCE = 1e6  # in multiples of the smallest noise; a simulation with bad parameters may diverge


class ParameterEstimator(ABC):
    """Estimator of parameters of B machines from states, voltages, and simulations of single control periods.

    A subclass defines in class attributes which parameters are estimated and how large the assumed errors
    are, and implements the correction of the estimates.

    Args:
        model: Model of the machine with its declared parameters, n coordinates and b belts, without a dead
            time of the drives: `update` receives the voltages that have arrived at the drives (see
            `DeadTime`).
        period: Control period, s.
        switch_s: Time from the start of a period at which the voltages change, because the drives have a dead
            time, s; 0 if they change at the start.

    Attributes:
        prior_std: Prior standard deviations of ln(actual / declared value) by kind of parameter: "coulomb"
            and "mass" of every coordinate, "EA" and "rest_length" of every belt (class attribute). Those of
            an identified machine are smaller (`prior_deviation`).
        prior_offset_std: Prior standard deviation of the missing voltage (voltage at a drive that the
            simulation lacks) as a fraction of the rated voltage; None: no missing voltages are estimated
            (class attribute).
        state_std: Standard deviations of measured minus simulated belt travel, m, and its rate, m/s (class
            attribute).
        difference: Change of an estimate for the finite differences, dimensionless (class attribute).
        integration_step: Largest step of the simulations, s (class attribute).
        parameter_names: Full names of the estimated parameters, such as "x.mass", in the order of the
            estimates.
        size: Number of estimates.
        estimates: Logarithms of the ratios of actual to declared values (0.1: about 10 % above), limited, in
            the order of `prior_std`, then the missing voltages, shape (B, size). Zero at the start of an
            episode.
        memory: Memories of the machines at the last state (`SimulatedMotion`), shape (B, M): what effects and
            swinging loads remember of the episode.
    """

    prior_std: ClassVar[Mapping[str, float]]
    prior_offset_std: ClassVar[float | None] = None
    state_std: ClassVar[tuple[float, float]]
    difference: ClassVar[float]
    integration_step: ClassVar[float]

    def __init__(self, model: MotionModel, period: float, switch_s: float = 0.0) -> None:
        machine = model.machine
        coordinates, belts = machine.coordinate_names, tuple(belt.name for belt in machine.belts)
        components = {"coulomb": coordinates, "mass": coordinates, "EA": belts, "rest_length": belts}
        std = {
            f"{component}.{kind}": value
            for kind, value in self.prior_std.items()
            for component in components[kind]
        }
        std = {
            name: prior_deviation(machine, name, value)
            for name, value in std.items()
            if name in machine.parameters
        }
        self._model, self._ratios = model, ParameterRatios(machine, std)
        self._motion = SimulatedMotion(model)
        self.parameter_names = self._ratios.names
        offsets = [] if self.prior_offset_std is None else [self.prior_offset_std] * len(model.rated)
        self.size, self._offsets = len(std) + len(offsets), slice(len(std), len(std) + len(offsets))
        self._std = np.array([*std.values(), *offsets])
        self._state_unit = np.repeat(self.state_std, len(model.mass))
        self._time_s = np.array([0.0, switch_s, period] if switch_s > 0.0 else [0.0, period])
        self._levels = len(self._time_s) - 1  # voltages that follow each other in a period
        self.estimates, self.memory = np.zeros((0, self.size)), np.zeros((0, self._motion.memory_size))

    def update(self, before: TravelStates, after: TravelStates, actions: Array, starts: Mask) -> None:
        """Update the attribute `estimates` with the measured states of the control period that has ended.

        Args:
            before: States at the start of the period.
            after: States at its end.
            actions: Voltages at the drives in the period, divided by the rated voltages, shape (B, drives).
                With a dead time (`switch_s` > 0): the voltages before, then after, `switch_s` in the period,
                shape (B, 2, drives).
            starts: Machines whose episode starts with `after`. Their estimates become zero: all parameters
                have their declared values, because ln(1) = 0, and no voltage is missing.
        """
        if len(self.estimates) != len(starts):
            self._resize(len(starts))
            self.memory = np.zeros((len(starts), self._motion.memory_size))
        if not starts.all():
            self._correct(before, after, actions, starts)
            self._remember(before, after, actions)
        self._restart(starts)
        self.memory[starts] = 0.0

    def parameters(self, estimates: Array) -> ParameterRows:
        """Convert estimates to values of all parameters of the machine.

        Parameters that are not estimated have their declared values.

        Args:
            estimates: As the attribute `estimates`, shape (B, size). The missing voltages among them are no
                parameters and are ignored.
        """
        return self._ratios.parameters(estimates[:, : self._offsets.start])

    @abstractmethod
    def _resize(self, batch: int) -> None:
        """Allocate the arrays of B machines."""

    @abstractmethod
    def _correct(self, before: Array, after: Array, actions: Array, starts: Mask) -> None:
        """Correct the estimates by the difference between measured and simulated states; see `update`."""

    @abstractmethod
    def _restart(self, starts: Mask) -> None:
        """Forget the episodes of the machines (B,) that start a new one."""

    def _simulate(self, estimates: Array, before: Array, memory: Array, actions: Array) -> Array:
        """Simulate R control periods with given estimates, and with each changed by `difference`."""
        variants = 1 + self.size
        varied = np.tile(estimates, (variants, 1, 1))
        varied[1:] += self.difference * np.eye(self.size)[:, None]
        before, memory, actions = (
            np.tile(rows, (variants, *(1,) * (rows.ndim - 1))) for rows in (before, memory, actions)
        )
        end, _ = self._simulated_end(varied.reshape(-1, self.size), before, memory, actions)
        return (end / self._state_unit).reshape(variants, *estimates.shape[:1], -1)

    def _remember(self, before: Array, after: Array, actions: Array) -> None:
        """Move the memories on over the period that ends with the state `after`."""
        if self._motion.memory_size:
            end, memory = self._simulated_end(self.estimates, before, self.memory, actions)
            self.memory = self._motion.corrected(memory, end, after)

    def _simulated_end(
        self, estimates: Array, before: Array, memory: Array, actions: Array
    ) -> tuple[Array, Array]:
        """Return the states and memories with which R simulated control periods end."""
        actions = actions.reshape(len(actions), self._levels, -1)
        if self.prior_offset_std is not None:
            actions = actions + estimates[:, None, self._offsets]
        volts = actions * self._model.rated
        states, memories = self._motion.simulate(
            before,
            memory,
            self._time_s,
            np.concatenate([volts, volts[:, -1:]], axis=1),
            self.parameters(estimates),
            longest_step=self.integration_step,
            parallel=False,
        )
        return states[:, -1], memories[:, -1]


class ParameterFilter(ParameterEstimator):
    """Extended Kalman filter of Coulomb friction, masses and belt stiffnesses.

    Attributes:
        size: Number of estimates, 2 n + b.
        estimates: n Coulomb friction forces, n masses, b axial stiffnesses EA, as `ParameterEstimator` states
            them.
    """

    # About the standard deviations of the randomization "default"; the belts' lengths enter by EA.
    prior_std: ClassVar[Mapping[str, float]] = {"coulomb": 0.4, "mass": 0.1, "EA": 0.22}
    # Errors that remain from the linearization, parameters that are not estimated, and the step of the
    # simulation.
    state_std: ClassVar[tuple[float, float]] = (2e-5, 8e-3)
    difference: ClassVar[float] = 0.03
    integration_step: ClassVar[float] = 1e-3

    def __init__(self, model: MotionModel, period: float, switch_s: float = 0.0) -> None:
        super().__init__(model, period, switch_s)
        self._least_squares = RecursiveLeastSquares(self._std)

    @override
    def _resize(self, batch: int) -> None:
        self._least_squares.resize(batch)
        self.estimates = self._least_squares.estimates

    @override
    def _correct(self, before: Array, after: Array, actions: Array, starts: Mask) -> None:
        simulated = self._simulate(self.estimates, before, self.memory, actions)
        innovation = after / self._state_unit - simulated[0]  # in units of `state_std`
        H = ((simulated[1:] - simulated[0]) / self.difference).transpose(1, 2, 0)  # (B, 2 n, size)
        self._least_squares.correct(innovation, H, np.ones(H.shape[1]))
        self._least_squares.estimates = np.clip(self._least_squares.estimates, -LARGEST, LARGEST)

    @override
    def _restart(self, starts: Mask) -> None:
        self._least_squares.restart(starts)
        self.estimates = self._least_squares.estimates


class ParameterWindow(ParameterEstimator):
    """Moving-horizon estimator of Coulomb friction, masses and belts.

    The estimates minimize the squares of the differences between measured and simulated states over the last
    periods (Gauss-Newton) and of the deviations from what earlier periods and the prior say (arrival cost).

    Attributes:
        size: Number of estimates, 2 n + 2 b + drives.
        estimates: n Coulomb friction forces, n masses, b axial stiffnesses EA, b lengths, and for each drive
            the missing voltage, as `ParameterEstimator` states them. Only the ratio of EA to length, the
            stiffness of a belt, can be determined.
        noise_ratio: Estimated noise of the states in multiples of the smallest assumed one, at least 1,
            shape (B,).
    """

    # About the standard deviations of the randomization "default".
    prior_std: ClassVar[Mapping[str, float]] = {"coulomb": 0.4, "mass": 0.1, "EA": 0.18, "rest_length": 0.1}
    prior_offset_std: ClassVar[float | None] = 1e-5  # where the simulation is exact, no voltage is missing
    state_std: ClassVar[tuple[float, float]] = (2e-6, 1e-3)  # the smallest noise; the actual one is estimated
    difference: ClassVar[float] = 0.01
    integration_step: ClassVar[float] = SIMULATION_STEP_S

    def __init__(self, model: MotionModel, period: float, switch_s: float = 0.0) -> None:
        super().__init__(model, period, switch_s)
        self._prior_information = np.diag(self._std**-2.0)
        self._limits = np.minimum(LARGEST, LIMIT_STD * self._std)
        self._limits[self._offsets] = LARGEST_OFFSET
        self._resize(0)

    @override
    def _resize(self, batch: int) -> None:
        states, volts = len(self._state_unit), self._levels * len(self._model.rated)
        self.estimates, self.noise_ratio = np.zeros((batch, self.size)), np.ones(batch)
        # Arrival cost: information matrix, and that matrix times the expected values (information vector).
        self._information_matrix = np.tile(self._prior_information, (batch, 1, 1))
        self._information_vector = np.zeros((batch, self.size))
        # The last periods, the latest last: states before and after, actions, and whether they belong to the
        # episode.
        self._before, self._after = np.zeros((2, WINDOW, batch, states))
        self._memories = np.zeros((WINDOW, batch, self._motion.memory_size))  # before
        self._actions, self._valid = np.zeros((WINDOW, batch, volts)), np.zeros((WINDOW, batch))
        self._elapsed = np.zeros(batch, np.intp)

    @override
    def _correct(self, before: Array, after: Array, actions: Array, starts: Mask) -> None:
        self._update_arrival_cost()
        for rows, new in (
            (self._before, before),
            (self._memories, self.memory),
            (self._after, after),
            (self._actions, actions),
        ):
            rows[:-1] = rows[1:]
            rows[-1] = new.reshape(rows[-1].shape)
        self._valid[:-1] = self._valid[1:]
        self._valid[-1] = ~starts
        self._iterate(np.ones(len(starts), np.bool_))
        early = self._elapsed < REPEATED_PERIODS
        if early.any():
            self._iterate(early)

    @override
    def _restart(self, starts: Mask) -> None:
        self._elapsed = np.where(starts, 0, self._elapsed + 1)
        self.estimates[starts], self.noise_ratio[starts] = 0.0, 1.0
        self._information_matrix[starts], self._information_vector[starts] = self._prior_information, 0.0
        self._valid[:, starts] = 0.0

    def _iterate(self, chosen: Mask) -> None:
        """Improve the estimates of the chosen machines (B,) by one Gauss-Newton iteration over the window."""
        difference, H = self._linearized(slice(None))
        weight = self._valid.T[:, :, None] / self.noise_ratio[:, None, None] ** 2  # (B, W, 1)
        weighted = H * weight[..., None]
        information = self._information_matrix + np.einsum("bkai,bkaj->bij", weighted, H, optimize=True)
        gradient = np.einsum("bkai,bka->bi", weighted, difference) + self._information_vector
        gradient -= np.einsum("bij,bj->bi", self._information_matrix, self.estimates)
        change = np.linalg.solve(information, gradient[..., None])[..., 0]
        remaining = (difference - np.einsum("bkai,bi->bka", H, change)) ** 2 * self._valid.T[:, :, None]
        entries = np.maximum(self._valid.sum(axis=0) * difference.shape[2], 1.0)
        ratio = np.maximum(1.0, np.sqrt(remaining.sum(axis=(1, 2)) / entries))
        self.noise_ratio = np.where(chosen, ratio, self.noise_ratio)
        change = np.clip(change, -LARGEST_CHANGE, LARGEST_CHANGE) * chosen[:, None]
        self.estimates = np.clip(self.estimates + change, -self._limits, self._limits)

    def _update_arrival_cost(self) -> None:
        """Add the oldest period of the window to the arrival cost, before it is dropped from the window."""
        if not self._valid[0].any():
            return
        difference, H = self._linearized(slice(0, 1))
        H, difference = H[:, 0], difference[:, 0]
        weighted = H * (self._valid[0] / self.noise_ratio**2)[:, None, None]
        self._information_matrix = self._information_matrix + np.einsum("bai,baj->bij", weighted, H)
        measured = difference + np.einsum("bai,bi->ba", H, self.estimates)  # = H estimates, but for noise
        self._information_vector = self._information_vector + np.einsum("bai,ba->bi", weighted, measured)
        inexact = np.flatnonzero((self.noise_ratio > 1.0) & (self._valid[0] > 0.0))
        if len(inexact):
            self._let_offsets_walk(inexact)

    def _let_offsets_walk(self, inexact: NDArray[np.intp]) -> None:
        """Add a period's process noise to the missing voltages of machines whose simulation is inexact."""
        covariance = np.linalg.inv(self._information_matrix[inexact])
        expected = np.einsum("bij,bj->bi", covariance, self._information_vector[inexact])
        walk = np.minimum(OFFSET_WALK * (self.noise_ratio[inexact] - 1.0), LARGEST_WALK)
        for column in range(self._offsets.start, self.size):
            covariance[:, column, column] += walk**2
        self._information_matrix[inexact] = np.linalg.inv(covariance)
        self._information_vector[inexact] = np.einsum(
            "bij,bj->bi", self._information_matrix[inexact], expected
        )

    def _linearized(self, chosen: slice) -> tuple[Array, Array]:
        """Return measured minus simulated states of periods (B, W, 2 n) and the latter's derivatives.

        Both are in multiples of the smallest noise; the derivatives have the shape (B, W, 2 n, size).
        """
        before, after, actions = self._before[chosen], self._after[chosen], self._actions[chosen]
        periods, batch, states = before.shape
        simulated = self._simulate(
            np.tile(self.estimates, (periods, 1)),
            before.reshape(-1, states),
            self._memories[chosen].reshape(periods * batch, -1),
            actions.reshape(periods * batch, -1),
        )
        error = simulated.reshape(-1, periods, batch, states) - after / self._state_unit
        error = np.clip(np.nan_to_num(error), -LARGEST_DIFFERENCE, LARGEST_DIFFERENCE)
        derivatives = (error[1:] - error[0]) / self.difference
        return -error[0].transpose(1, 0, 2), derivatives.transpose(2, 1, 3, 0)

    @property
    def offset(self) -> Array:
        """Estimated missing voltages at the drives, which the simulation lacks, V, shape (B, drives)."""
        return self.estimates[:, self._offsets] * self._model.rated
