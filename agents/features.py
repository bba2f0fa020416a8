"""Policy features: position errors and speeds on logarithmic scales from meters to micrometers.

A network that receives meters cannot resolve 0.1 mm. Each quantity v therefore enters as

    sign(v) * log(1 + |v| / scale)

for several scales: linear well below a scale, logarithmic above it. Errors enter for the tool (x, y) and for each motor
(as belt travel), now and extrapolated one control period ahead. Every v is linear in the observation z, so all
features are one matrix product followed by one logarithm: gain * sign(z M) * log(1 + |z M|).

A *transfer* is a motion of given duration that brings the machine to rest at its goal with the least sum of squared
voltages. `TransferBank` and `PlanBank` compute the first voltages of several transfers; a policy can form a weighted
mean of them (residual_action.py).

This module needs NumPy only; sb3_adapters.py evaluates the features in torch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..controllers import (
    MinimumEnergyTransfers,
    MotionModel,
    OperatingPointGrid,
    ParameterFilter,
    ParameterRatios,
    PreviewGains,
    SimulatedTransfers,
    scaled_machine,
)
from ..controllers.finite_horizon_control import VOLTAGE_CHANGE_WEIGHT
from ..errors import InputError
from ..machine import Machine, observed_coordinates, rest_state

Array = NDArray[np.float64]
ERROR_SCALES = (1e-1, 1e-2, 1e-3, 1e-4)  # m
SPEED_SCALES = (0.3, 0.02)  # m/s
STRETCH_SCALES = (1e-3, 1e-4)  # m
# Fractions of the rated voltage: full voltage, and about the voltage that overcomes Coulomb friction.
ACTION_SCALES = (1.0, 0.03)
FRICTION_VOLTAGE_SCALES = (0.03, 0.003)  # fractions of the rated voltage
# Fractions of the rated voltage; far from the goal a short transfer would need far more than the rated voltage.
TRANSFER_SCALES, LARGEST_TRANSFER = (1.0, 0.05), 30.0
ESTIMATE_SCALE, LARGEST_ESTIMATE = 0.2, 1.0  # relative deviations from the nominal parameters
POSITION_SCALE = 0.2  # m
EXTRAPOLATION_S = 0.01  # s, one control period
# Values at which a feature reaches 1: about the largest that occur.
LARGEST_ERROR = 0.5  # m
LARGEST_SPEED = 1.5  # m/s
LARGEST_STRETCH = 0.01  # m

# Factors (belt stiffness, masses) on the declared values for which transfers are designed, beside (1, 1).
BANK = ((0.7, 0.95), (0.7, 1.15), (1.3, 0.95), (1.3, 1.15))
BANK_TRANSFERS = 5  # number of the durations, the shortest ones, for which they are designed; they matter at the goal
LARGEST_WEIGHTED = 1.2  # limit of a transfer's voltages, as a fraction of the rated voltage

# Observation keys in the order in which they are concatenated; absent keys are skipped. The weights of a trained agent
# depend on this order.
OBSERVATION_KEYS = (
    "observation",
    "desired_goal",
    "preview",
    "last_observation",
    "last_action",
    "base_action",
    "expected_friction",
    "estimates",
)


def feature_parameters(
    machine: Machine, period: float = 0.01, transfers: Sequence[int] = (), preview: int = 0
) -> dict[str, Any]:
    """Compute the arguments of `feature_matrix` that depend on the machine: its kinematics and gains of controllers.

    The features of a policy can include voltages of model-based controllers, which are linear in the observation.

    Args:
        machine: Machine with a workspace.
        period: Control period, s.
        transfers: For a fixed goal: durations of the minimum-energy transfers (motions to rest at the goal) whose first
            voltages are features, in control periods beyond the shortest transfer (0). Default: none.
        preview: For a moving goal, if `transfers` is empty: number of future goals of a preview control. Its voltages
            are features. Default: no preview control.

    Returns:
        `radii`: belt travel (radius * angle) per radian of each motor coordinate, m/rad, list of one per motor; a drive
            that acts on an axis of the tool itself has no motor coordinate.
        `rest`: belt travel of each motor coordinate per meter of each axis with unstretched belts, m/m, nested list of
            shape (motors, axes).
        `gains`: only with `transfers` or `preview`; by key of the observation, the matrix from its entries to these
            voltages as fractions of the rated ones, transfer by transfer, nested list of shape (voltages, entries).

    Raises:
        InputError: If the machine has no transfer of a duration.
    """
    axes = machine.tool_axes
    linear_names = [c.name for c in machine.coordinates if c.kind == "linear"]
    # The tool's axes come first, then the motors.
    driven = [machine.coordinate_names.index(name) for name in observed_coordinates(machine)[len(axes) :]]
    # Rest states for a displacement of 1 m along each axis.
    unit_states = [rest_state(machine, [float(name == axis) for name in linear_names]) for axis in axes]
    geometry = {
        "radii": [float(machine.travel_per_unit[i]) for i in driven],
        "rest": [[float(state[i] * machine.travel_per_unit[i]) for state in unit_states] for i in driven],
    }
    if transfers:
        return {**geometry, "gains": _transfer_gains(MotionModel(machine), period, transfers)}
    if preview:
        return {**geometry, "gains": _preview_gains(MotionModel(machine), period, preview)}
    return geometry


def _transfer_gains(model: MotionModel, period: float, transfers: Sequence[int]) -> dict[str, Any]:
    """Return the gains for the first voltages of transfers to rest, designed at the center of the workspace."""
    designed = MinimumEnergyTransfers(model, period)
    _check_transfers(designed, transfers)
    by_duration = designed.gains[_center(designed.grid), :, 0]  # (durations, drives, 2 n)
    on_state = np.concatenate([by_duration[extra] / model.rated[:, None] for extra in transfers])
    return _as_lists(
        observation=on_state @ _state_of_observation(model),
        desired_goal=-on_state @ model.goal_state(np.eye(len(model.axes))).T,
    )


def _check_transfers(designed: MinimumEnergyTransfers, transfers: Sequence[int]) -> None:
    """Raise an error if a machine lacks transfers of given durations, in periods beyond the shortest."""
    longest = designed.longest - designed.shortest
    if not 0 <= min(transfers) <= max(transfers) <= longest:
        name = designed.model.machine.name
        raise InputError(
            f"transfers are {list(transfers)}; machine {name!r} has those of 0 to {longest} periods beyond the shortest"
        )


def _preview_gains(model: MotionModel, period: float, preview: int) -> dict[str, Any]:
    """Return the gains for the voltages of a preview control, designed at the center of the workspace."""
    grid = OperatingPointGrid(model.machine)
    designed = PreviewGains(model, grid, period, preview, VOLTAGE_CHANGE_WEIGHT)
    center, rated = _center(grid), model.rated[:, None]
    return _as_lists(
        observation=designed.state[center] / rated @ _state_of_observation(model),
        preview=designed.goal[center] / rated,
        last_action=designed.last[center] / rated * model.rated,
    )


def _center(grid: OperatingPointGrid) -> int:
    """Return the index of the operating point at the center of the workspace."""
    return int(grid.nearest(grid.points.mean(axis=0, keepdims=True))[0])


def _state_of_observation(model: MotionModel) -> Array:
    """Return the matrix that converts a full-state observation to a state in belt travel, (2 n, entries)."""
    return model.state({"observation": np.eye(2 * len(model.mass))}).T


def _as_lists(**gains: Array) -> dict[str, Any]:
    """Return arrays as nested lists, for agent.json."""
    return {key: values.tolist() for key, values in gains.items()}


def feature_matrix(
    sizes: Mapping[str, int], radii: Array, rest: Array, gains: Mapping[str, Array] | None = None
) -> tuple[Array, Array]:
    """Build the matrix M and the factors g of the inputs of a policy network, g * sign(z M) * log(1 + |z M|).

    z is an observation, all its arrays joined. These inputs (features) resolve meters as well as micrometers.

    Args:
        sizes: Number of entries of each array of the observation, by key, in the order in which z joins them.
            `observation` and `desired_goal` are required; `preview`, `last_action` and others add features.
        radii: Belt travel (radius * angle) per radian of each motor coordinate, m/rad, shape (motors,).
        rest: Belt travel of each motor coordinate per meter of each axis with unstretched belts, m/m, shape
            (motors, axes).
        gains: By key, matrices from entries of the observation to voltages of model-based controllers, which are summed
            over the keys, shape (voltages, entries of the key); see `feature_parameters`. Default: no such features.

    Returns:
        M: Matrix from entries of z (m, rad, m/s, rad/s) to errors, speeds and voltages divided by their scales, so that
            z M is dimensionless, shape (entries, features).
        g: Factors, dimensionless, shape (features,). Features are 1 at the largest values in use (0.5 m, 1.5 m/s, ...).
    """
    # Each quantity is a matrix of columns (entries of z, components): the quantity is z times these columns.
    selectors = _selectors(sizes)
    goal = selectors["desired_goal"]
    axes = drives = goal.shape[1]
    rest = np.reshape(rest, (len(radii), axes))
    tool, motors, tool_speed, motor_speed = _split_state(selectors["observation"], radii, axes)
    speeds = np.hstack([tool_speed, motor_speed])
    errors = np.hstack([goal - tool, goal @ rest.T - motors])
    blocks = [
        _scaled_columns(tool, (POSITION_SCALE,), POSITION_SCALE),
        _scaled_columns(np.hstack([errors, errors - EXTRAPOLATION_S * speeds]), ERROR_SCALES, LARGEST_ERROR),
        _scaled_columns(speeds, SPEED_SCALES, LARGEST_SPEED),
        _scaled_columns(motors - tool @ rest.T, STRETCH_SCALES, LARGEST_STRETCH),
        _scaled_columns(motor_speed - tool_speed @ rest.T, SPEED_SCALES[1:], LARGEST_SPEED),
    ]
    if "preview" in selectors:
        future_goals = [selectors["preview"][:, i : i + axes] - goal for i in range(0, sizes["preview"], axes)]
        blocks.append(_scaled_columns(np.hstack(future_goals), ERROR_SCALES[1:3], LARGEST_ERROR))
    if "last_observation" in selectors:
        last_speeds = np.hstack(_split_state(selectors["last_observation"], radii, axes)[2:])
        blocks.append(_scaled_columns(speeds - last_speeds, SPEED_SCALES, LARGEST_SPEED))
    for key in ("last_action", "base_action"):
        if key in selectors:
            blocks.append(_scaled_columns(selectors[key], ACTION_SCALES, 1.0))
    if "expected_friction" in selectors:
        upcoming, recent = selectors["expected_friction"][:, :-drives], selectors["expected_friction"][:, -drives:]
        # The change of the friction voltage along the path is what a controller that only integrates cannot anticipate.
        change = upcoming - np.tile(recent, upcoming.shape[1] // drives)
        columns = np.hstack([upcoming[:, :drives], change])
        blocks.append(_scaled_columns(columns, FRICTION_VOLTAGE_SCALES, FRICTION_VOLTAGE_SCALES[0]))
    if "estimates" in selectors:
        blocks.append(_scaled_columns(selectors["estimates"], (ESTIMATE_SCALE,), LARGEST_ESTIMATE))
    if gains:
        volts = np.sum([selectors[key] @ np.transpose(values) for key, values in gains.items()], axis=0)
        blocks.append(_scaled_columns(volts, TRANSFER_SCALES, LARGEST_TRANSFER))
    return np.hstack([matrix for matrix, _ in blocks]), np.concatenate([gain for _, gain in blocks])


def _selectors(sizes: Mapping[str, int]) -> dict[str, Array]:
    """Return, for each key, the columns that pick its entries out of z, shape (entries, entries of the key)."""
    edges = np.cumsum([0, *sizes.values()]).tolist()
    identity = np.eye(edges[-1])
    return {key: identity[:, first:last] for key, first, last in zip(sizes, edges[:-1], edges[1:], strict=True)}


def _split_state(state: Array, radii: Array, axes: int) -> tuple[Array, Array, Array, Array]:
    """Split a state's columns into tool, motors, tool speed and motor speed, motors in belt travel."""
    tool, motors, tool_speed, motor_speed = np.split(state, np.cumsum([axes, len(radii), axes]), axis=1)
    return tool, motors * radii, tool_speed, motor_speed * radii


def _scaled_columns(columns: Array, scales: Sequence[float], largest: float) -> tuple[Array, Array]:
    """Return the columns divided by each scale, and the gains at which the value `largest` gives a feature of 1."""
    gains = [np.full(columns.shape[1], 1.0 / np.log1p(largest / scale)) for scale in scales]
    return np.hstack([columns / scale for scale in scales]), np.concatenate(gains)


class FeedbackLaws(NamedTuple):
    """Voltages of K feedback laws in the present state, and their derivatives.

    Attributes:
        volts: Voltages divided by the rated voltages, not limited, shape (batch, K, drives).
        gains: Derivatives of the voltages with respect to the entries of the full-state observation, per m, rad, m/s or
            rad/s, shape (batch, K, drives, entries).
    """

    volts: Array
    gains: Array


class TransferBank:
    """First voltages of K minimum-energy transfers (motions to rest at the goal) of several durations and designs.

    The transfers are designed for the declared machine, and the five shortest ones also for 0.7 and 1.3 times its belt
    stiffness with 0.95 and 1.15 times its masses (`BANK`).

    Args:
        machine: Machine for which the transfers are designed.
        period: Control period, s.
        transfers: Durations in periods beyond the shortest possible transfer, ascending.

    Attributes:
        size: Number K of transfers.

    Raises:
        InputError: If the machine has no transfer of a duration, or the durations are not ascending.
    """

    def __init__(self, machine: Machine, period: float, transfers: Sequence[int]) -> None:
        self._model = MotionModel(machine)
        self._grid = OperatingPointGrid(machine)
        designed = MinimumEnergyTransfers(self._model, period)
        _check_transfers(designed, transfers)
        if any(second <= first for first, second in pairwise(transfers)):
            raise InputError(f"transfers are {list(transfers)}; list durations in ascending order, each once")
        gains = [designed.gains[:, list(transfers), 0]]
        for stiffness, mass in BANK:
            variant = MinimumEnergyTransfers(MotionModel(scaled_machine(machine, stiffness, mass)), period)
            last = np.minimum(transfers[:BANK_TRANSFERS], variant.longest - variant.shortest)
            gains.append(variant.gains[:, last, 0])
        self._gains = np.concatenate(gains, axis=1) / self._model.rated[:, None]  # (points, K, drives, 2 n)
        self._of_observation = _state_of_observation(self._model)
        self.size = self._gains.shape[1]

    def laws(self, observation: NDArray[Any], goal: NDArray[Any]) -> FeedbackLaws:
        """Compute the first voltages of each transfer (motion to rest at the goal) from the present state.

        Args:
            observation: Present full-state observations, m, rad, m/s and rad/s, shape (batch, entries).
            goal: Tool positions of the goals, m, shape (batch, axes).

        Returns:
            `FeedbackLaws`: voltages / rated ones, shape (batch, K, drives), by duration, of the declared machine,
            then of variants of it; their derivatives by the observation, shape (batch, K, drives, entries).
        """
        gains = self._gains[self._grid.nearest(np.asarray(goal, np.float64))] @ self._of_observation
        at_rest = self._model.observation(self._model.goal_state(goal))
        return FeedbackLaws(np.einsum("bkij,bj->bki", gains, observation - at_rest), gains)


class PlanBank:
    """First voltages of K transfers, planned in every period for the machine as estimated (`SimulatedTransfers`).

    Args:
        machine: Machine with its declared parameters.
        period: Control period, s.
        estimator: Estimator of the parameters; `laws` plans with its present estimates.
        durations: Durations of the transfers in periods, ascending.

    Attributes:
        size: Number K of transfers.

    Raises:
        InputError: If the durations are not positive and ascending.
    """

    def __init__(self, machine: Machine, period: float, estimator: ParameterFilter, durations: Sequence[int]) -> None:
        self._model, self._estimator, self.size = MotionModel(machine), estimator, len(durations)
        self._ratios = ParameterRatios(machine, estimator.parameter_names)  # the estimator's machine has no dead time
        self._transfers = SimulatedTransfers(self._model, period, durations)
        self._of_observation = _state_of_observation(self._model)

    def laws(self, observation: NDArray[Any], goal: NDArray[Any], last_action: NDArray[Any]) -> FeedbackLaws:
        """Plan each transfer (motion to rest at the goal) for the estimated machine; return voltages and derivatives.

        Args:
            observation: Present full-state observations, m, rad, m/s and rad/s, shape (batch, entries).
            goal: Tool positions of the goals, m, shape (batch, axes).
            last_action: Voltages of the period before, divided by the rated voltages, shape (batch, drives).

        Returns:
            Voltages / rated ones by duration, shape (batch, K, drives), and `gains`, shape (batch, K, drives, entries).
        """
        rated = self._model.rated
        planned = self._transfers.plan(
            self._model.state({"observation": observation}),
            np.asarray(goal, np.float64),
            self._ratios.parameters(self._estimator.estimates),
            last_action * rated,
        )
        return FeedbackLaws(planned.volts / rated, planned.gains / rated[:, None] @ self._of_observation)
