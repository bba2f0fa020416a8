"""Estimation of a machine's parameters during an episode: measured states against simulations of a control period.

Unlike `MomentumFilter`, which balances mean forces, these estimators compare the measured state with the simulated one,
so that belt modes and friction that reverses within a period do not disturb them. They estimate every belt separately.

ParameterFilter    Extended Kalman filter: each period is linearized once, at the estimates of its time. Its errors stay
                   at a few percent even where states are measured exactly, because an early period is never revised.
ParameterWindow    Moving-horizon estimation: the last periods are linearized anew in every update, so that estimates
                   converge to the actual parameters where the model's structure is right and the states are exact. The
                   noise is estimated too: where states or model are inexact, the estimates change slowly.

References:
    Ljung (1979), Asymptotic behavior of the extended Kalman filter as a parameter estimator for linear systems.
    Rao, Rawlings and Mayne (2003), Constrained state estimation for nonlinear discrete-time systems.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..dynamics import simulate_batch
from .motion_model import MotionModel

Array = NDArray[np.float64]
# Prior standard deviations of the logarithms of Coulomb friction, masses and belt stiffnesses, about those of the
# randomization "default".
FRICTION_STD, MASS_STD, BELT_STD = 0.4, 0.1, 0.22
# Standard deviations of the difference between measured and simulated belt travel, m, and its rate, m/s: what the
# linearization, other parameters and the step of the simulation leave.
TRAVEL_NOISE, RATE_NOISE = 2e-5, 8e-3
DIFFERENCE = 0.03  # step of the finite differences by the logarithms of the parameters
LARGEST = 1.2  # limit of the logarithms
INTEGRATION_STEP = 1e-3  # s
# Of `ParameterWindow`: prior standard deviations of the logarithms of axial stiffness and length of a belt, smallest
# noise (see TRAVEL_NOISE), step of the differences, and step of the integrator, which is that of the environments.
STIFFNESS_STD, LENGTH_STD = 0.18, 0.1
LEAST_TRAVEL_NOISE, LEAST_RATE_NOISE = 2e-6, 1e-3
FINE_DIFFERENCE, FINE_STEP = 0.01, 5e-4
WINDOW = 6  # periods
REPEATED_PERIODS = 4  # periods at the beginning in which the estimates change much; they take two iterations
LARGEST_CHANGE = 0.5  # of a logarithm in an iteration
# Fractions of the rated voltage: what the simulation lacks at first, and its change per period for each multiple of the
# smallest noise beyond 1 (standard deviations). Where the simulation is exact, nothing is lacking.
OFFSET_STD, OFFSET_WALK, LARGEST_WALK, LARGEST_OFFSET = 1e-5, 2e-3, 2e-2, 0.3
LIMIT_STD = 4.0  # limit of a logarithm in prior standard deviations: a belt must not become shorter than zero
LARGEST_DIFFERENCE = 1e6  # in multiples of the smallest noise; a simulation with bad parameters may diverge


class ParameterFilter:
    """Estimator of Coulomb friction, masses and belt stiffnesses of B machines from their states and voltages.

    Args:
        model: Model of the machine with its declared parameters, n coordinates and b belts.
        period: Control period, s.

    Attributes:
        size: Number of estimates, 2 n + b.
        estimates: Logarithms of the ratios of actual to declared values (0.1: about 10 % above), limited, shape
            (B, size): n Coulomb friction forces, n masses, b axial stiffnesses EA. Zero at the start of an episode.
    """

    def __init__(self, model: MotionModel, period: float) -> None:
        machine = model.machine
        self._model = model
        self._time_s = np.array([0.0, period])
        names = list(machine.parameters)
        coordinates = machine.coordinate_names
        groups = [
            ([f"{name}.coulomb" for name in coordinates], FRICTION_STD),
            ([f"{name}.mass" for name in coordinates], MASS_STD),
            ([f"{belt.name}.EA" for belt in machine.belts], BELT_STD),
        ]
        chosen = [(names.index(name), std) for group, std in groups for name in group if name in names]
        self._columns = np.array([column for column, _ in chosen])
        self._prior_std = np.array([std for _, std in chosen])
        self._nominal = np.array(list(machine.parameters.values()))
        self._units = np.tile(machine.travel_per_unit, 2)
        self._noise = np.repeat([TRAVEL_NOISE, RATE_NOISE], len(model.mass))
        self.size = len(chosen)
        self.estimates, self._covariance = np.zeros((0, self.size)), np.zeros((0, self.size, self.size))

    def update(self, before: Array, after: Array, actions: Array, starts: NDArray[np.bool_]) -> None:
        """Update the estimates by the control period that has ended.

        Args:
            before: States at its start: belt travel (radius * angle of a rotary coordinate) of the n coordinates of B
                machines and its velocity, m and m/s, shape (B, 2 n).
            after: States at its end, m and m/s, shape (B, 2 n).
            actions: Voltages applied in it, divided by the rated voltages, shape (B, drives).
            starts: True for machines whose episode starts with `after`, shape (B,); their estimates are set to zero.
        """
        if len(self.estimates) != len(starts):
            self.estimates = np.zeros((len(starts), self.size))
            self._covariance = np.zeros((len(starts), self.size, self.size))
        if not starts.all():
            self._correct(before, after, actions)
        self.estimates[starts], self._covariance[starts] = 0.0, np.diag(self._prior_std**2)

    def _correct(self, before: Array, after: Array, actions: Array) -> None:
        """Correct the estimates by the difference between measured and simulated states."""
        batch = len(before)
        changed = np.tile(self.estimates, (1 + self.size, 1, 1))
        changed[1:] += DIFFERENCE * np.eye(self.size)[:, None]
        parameters = np.tile(self._nominal, ((1 + self.size) * batch, 1))
        parameters[:, self._columns] *= np.exp(changed.reshape(-1, self.size))
        motion = simulate_batch(
            self._model.machine,
            self._time_s,
            np.repeat(np.tile(actions * self._model.rated, (1 + self.size, 1))[:, None], 2, axis=1),
            parameters=parameters,
            start=np.tile(before / self._units, (1 + self.size, 1)),
            longest_step=INTEGRATION_STEP,
            readings=False,
            parallel=False,
        )
        end = np.concatenate([motion.positions[:, -1], motion.velocities[:, -1]], axis=1) * self._units
        simulated = end.reshape(1 + self.size, batch, -1) / self._noise
        innovation = after / self._noise - simulated[0]
        H = ((simulated[1:] - simulated[0]) / DIFFERENCE).transpose(1, 2, 0)  # (B, 2 n, size), in units of the noise
        PH = self._covariance @ H.transpose(0, 2, 1)
        S = H @ PH + np.eye(H.shape[1])
        K = np.linalg.solve(S, PH.transpose(0, 2, 1)).transpose(0, 2, 1)
        self.estimates = np.clip(self.estimates + np.einsum("bpa,ba->bp", K, innovation), -LARGEST, LARGEST)
        self._covariance = self._covariance - K @ PH.transpose(0, 2, 1)


class ParameterWindow:
    """Moving-horizon estimator of Coulomb friction, masses and belts of B machines from their states and voltages.

    The estimates minimize the squares of the differences between measured and simulated states over the last periods
    (Gauss-Newton), and of the deviation from what earlier periods and the prior say.

    Args:
        model: Model of the machine with its declared parameters, n coordinates and b belts.
        period: Control period, s.
        switch_s: Time from the start of a period at which the voltages change, because the drives have a dead time, s;
            0 if they change at the start.

    Attributes:
        columns: Columns of the estimated parameters in `Machine.parameters`, shape (2 n + 2 b,).
        size: Number of estimates, 2 n + 2 b + drives.
        estimates: Logarithms of the ratios of actual to declared values (0.1: about 10 % above), limited, shape
            (B, size): n Coulomb friction forces, n masses, b axial stiffnesses EA, b lengths; then for each drive the
            voltage that the simulation lacks, as a fraction of the rated voltage. Zero at the start of an episode. EA
            and length are known only together, as the stiffness of each belt.
        noise_ratio: Estimated noise of the states in multiples of the smallest assumed one, at least 1, shape (B,).
    """

    def __init__(self, model: MotionModel, period: float, switch_s: float = 0.0) -> None:
        machine = model.machine
        self._model = model
        self._time_s = np.array([0.0, switch_s, period] if switch_s > 0.0 else [0.0, period])
        names = list(machine.parameters)
        coordinates, belts = machine.coordinate_names, [belt.name for belt in machine.belts]
        groups = [
            ([f"{name}.coulomb" for name in coordinates], FRICTION_STD),
            ([f"{name}.mass" for name in coordinates], MASS_STD),
            ([f"{name}.EA" for name in belts], STIFFNESS_STD),
            ([f"{name}.rest_length" for name in belts], LENGTH_STD),
        ]
        chosen = [(names.index(name), std) for group, std in groups for name in group if name in names]
        self.columns = np.array([column for column, _ in chosen])
        self.size = len(chosen) + len(model.rated)
        self._offsets = slice(len(chosen), self.size)
        deviations = np.array([std for _, std in chosen] + [OFFSET_STD] * len(model.rated))
        self._prior_information = np.diag(deviations**-2.0)
        self._limits = np.minimum(LARGEST, LIMIT_STD * deviations)
        self._limits[self._offsets] = LARGEST_OFFSET
        self._nominal = np.array(list(machine.parameters.values()))
        self._units = np.tile(machine.travel_per_unit, 2)
        self._noise = np.repeat([LEAST_TRAVEL_NOISE, LEAST_RATE_NOISE], len(model.mass))
        self._resize(0)

    def _resize(self, batch: int) -> None:
        """Allocate the arrays of B machines."""
        states, volts = len(self._units), (len(self._time_s) - 1) * len(self._model.rated)
        self.estimates, self.noise_ratio = np.zeros((batch, self.size)), np.ones(batch)
        # What earlier periods and the prior say: information matrix, and that matrix times the expected values.
        self._information = np.tile(self._prior_information, (batch, 1, 1))
        self._informed = np.zeros((batch, self.size))
        # The last periods, the latest last: states before and after, actions, and whether they belong to the episode.
        self._before, self._after = np.zeros((2, WINDOW, batch, states))
        self._actions, self._valid = np.zeros((WINDOW, batch, volts)), np.zeros((WINDOW, batch))
        self._elapsed = np.zeros(batch, np.intp)

    def update(self, before: Array, after: Array, actions: Array, starts: NDArray[np.bool_]) -> None:
        """Update the estimates by the control period that has ended.

        Args:
            before: States at its start: belt travel (radius * angle of a rotary coordinate) of the n coordinates of B
                machines and its velocity, m and m/s, shape (B, 2 n).
            after: States at its end, m and m/s, shape (B, 2 n).
            actions: Voltages applied in it, divided by the rated voltages, shape (B, drives); if they change within a
                period, those before and after, shape (B, 2, drives).
            starts: True for machines whose episode starts with `after`, shape (B,); their estimates are set to zero.
        """
        if len(self.estimates) != len(starts):
            self._resize(len(starts))
        if not starts.all():
            self._absorb_oldest()
            for rows, new in ((self._before, before), (self._after, after), (self._actions, actions)):
                rows[:-1] = rows[1:]
                rows[-1] = new.reshape(rows[-1].shape)
            self._valid[:-1] = self._valid[1:]
            self._valid[-1] = ~starts
            self._iterate(np.ones(len(starts), np.bool_))
            early = self._elapsed < REPEATED_PERIODS
            if early.any():
                self._iterate(early)
        self._elapsed = np.where(starts, 0, self._elapsed + 1)
        self.estimates[starts], self.noise_ratio[starts] = 0.0, 1.0
        self._information[starts], self._informed[starts] = self._prior_information, 0.0
        self._valid[:, starts] = 0.0

    def _iterate(self, chosen: NDArray[np.bool_]) -> None:
        """Improve the estimates of the chosen machines (B,) by one Gauss-Newton iteration over the window."""
        difference, H = self._linearized(slice(None))
        weight = self._valid.T[:, :, None] / self.noise_ratio[:, None, None] ** 2  # (B, W, 1)
        weighted = H * weight[..., None]
        information = self._information + np.einsum("bkai,bkaj->bij", weighted, H, optimize=True)
        gradient = np.einsum("bkai,bka->bi", weighted, difference) + self._informed
        gradient -= np.einsum("bij,bj->bi", self._information, self.estimates)
        change = np.linalg.solve(information, gradient[..., None])[..., 0]
        remaining = (difference - np.einsum("bkai,bi->bka", H, change)) ** 2 * self._valid.T[:, :, None]
        entries = np.maximum(self._valid.sum(axis=0) * difference.shape[2], 1.0)
        ratio = np.maximum(1.0, np.sqrt(remaining.sum(axis=(1, 2)) / entries))
        self.noise_ratio = np.where(chosen, ratio, self.noise_ratio)
        change = np.clip(change, -LARGEST_CHANGE, LARGEST_CHANGE) * chosen[:, None]
        self.estimates = np.clip(self.estimates + change, -self._limits, self._limits)

    def _absorb_oldest(self) -> None:
        """Add what the oldest period of the window says to the earlier information, before it is dropped."""
        if not self._valid[0].any():
            return
        difference, H = self._linearized(slice(0, 1))
        H, difference = H[:, 0], difference[:, 0]
        weighted = H * (self._valid[0] / self.noise_ratio**2)[:, None, None]
        self._information = self._information + np.einsum("bai,baj->bij", weighted, H)
        explained = difference + np.einsum("bai,bi->ba", H, self.estimates)
        self._informed = self._informed + np.einsum("bai,ba->bi", weighted, explained)
        inexact = np.flatnonzero((self.noise_ratio > 1.0) & (self._valid[0] > 0.0))
        if len(inexact):
            covariance = np.linalg.inv(self._information[inexact])
            expected = np.einsum("bij,bj->bi", covariance, self._informed[inexact])
            walk = np.minimum(OFFSET_WALK * (self.noise_ratio[inexact] - 1.0), LARGEST_WALK)
            for column in range(self._offsets.start, self.size):
                covariance[:, column, column] += walk**2
            self._information[inexact] = np.linalg.inv(covariance)
            self._informed[inexact] = np.einsum("bij,bj->bi", self._information[inexact], expected)

    def _linearized(self, chosen: slice) -> tuple[Array, Array]:
        """Return measured minus simulated states of periods (B, W, 2 n) and the derivatives of the simulated ones.

        Both are in multiples of the smallest noise; the derivatives have the shape (B, W, 2 n, size).
        """
        before, after, actions = self._before[chosen], self._after[chosen], self._actions[chosen]
        periods, batch, states = before.shape
        variants = 1 + self.size
        changed = np.tile(self.estimates, (variants, 1, 1))
        changed[1:] += FINE_DIFFERENCE * np.eye(self.size)[:, None]

        def repeated(rows: Array) -> Array:
            return np.broadcast_to(rows, (variants, *rows.shape)).reshape(-1, rows.shape[-1])

        every = np.broadcast_to(changed[:, None], (variants, periods, batch, self.size)).reshape(-1, self.size)
        applied = repeated(actions).reshape(len(every), -1, len(self._model.rated))
        volts = (applied + every[:, None, self._offsets]) * self._model.rated
        motion = simulate_batch(
            self._model.machine,
            self._time_s,
            np.concatenate([volts, volts[:, -1:]], axis=1),
            parameters=self.parameters(every),
            start=repeated(before / self._units),
            longest_step=FINE_STEP,
            readings=False,
            parallel=False,
        )
        end = np.concatenate([motion.positions[:, -1], motion.velocities[:, -1]], axis=1) * self._units
        simulated = (end / self._noise).reshape(variants, periods, batch, states) - after / self._noise
        simulated = np.clip(np.nan_to_num(simulated), -LARGEST_DIFFERENCE, LARGEST_DIFFERENCE)
        difference = -simulated[0].transpose(1, 0, 2)
        return difference, ((simulated[1:] - simulated[0]) / FINE_DIFFERENCE).transpose(2, 1, 3, 0)

    def parameters(self, estimates: Array) -> Array:
        """Return the parameters of machines with given estimates.

        Args:
            estimates: Logarithms of the ratios of actual to declared values, as `estimates`, shape (B, size).

        Returns:
            Parameters in the order of `Machine.parameters`, SI, shape (B, P).
        """
        parameters = np.tile(self._nominal, (len(estimates), 1))
        parameters[:, self.columns] *= np.exp(estimates[:, : len(self.columns)])
        return parameters

    @property
    def offset(self) -> Array:
        """Voltages that the simulation lacks, V, shape (B, drives): what undeclared forces amount to at the drives."""
        return self.estimates[:, self._offsets] * self._model.rated
