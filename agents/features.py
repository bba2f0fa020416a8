"""Inputs of a policy network (features): errors, speeds, belt stretch and voltages on logarithmic scales.

An error of 0.1 mm, in meters, is too small an input for a network to learn from. Each quantity v therefore enters as

    sign(v) * log(1 + |v| / scale)

for one or several scales: linear well below a scale, logarithmic above it. Errors enter for the tool (x, y) and for
each motor (as belt travel), now and after 10 ms at the present speeds with an unchanged goal. Every v is linear in the
observation z, so all features are one matrix product and one logarithm: factor * sign(z M) * log(1 + |z M|).

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

from hframe_gym.arrays import Array

from ..controllers import (
    MotionModel,
    OperatingPointGrid,
    ParameterFilter,
    ParameterRatios,
    PreviewGains,
    SimulatedTransfers,
    TransferDesign,
    scaled_machine,
)
from ..controllers.planning.finite_horizon_control import VOLTAGE_CHANGE_WEIGHT
from ..errors import InputError
from ..machine import RADIANS, Machine, observed_coordinates, rest_positions_per_axis

ERROR_SCALES = (1e-1, 1e-2, 1e-3, 1e-4)  # m
SPEED_SCALES = (0.3, 0.02)  # m/s
INTEGRAL_SCALES = (1e-5, 1e-6)  # m s; an error of 0.1 mm in ten control periods of 10 ms, and in one
STRETCH_SCALES = (1e-3, 1e-4)  # m
# Fractions of the rated voltage: full voltage, and about the voltage that overcomes Coulomb friction.
ACTION_SCALES = (1.0, 0.03)
# Fractions of the rated voltage. At rest at the goal, 0.01 moves the tool by about 0.1 mm in one control period.
ACTION_CHANGE_SCALES, ACTION_ERROR_SCALES = (0.3, 0.01), (0.05, 0.005)
FRICTION_VOLTAGE_SCALES = (0.03, 0.003)  # fractions of the rated voltage
# Fractions of the rated voltage; far from the goal, short transfers ask for up to 30 times the rated voltage.
TRANSFER_SCALES, LARGEST_TRANSFER = (1.0, 0.05), 30.0
ESTIMATE_SCALE, LARGEST_ESTIMATE = 0.2, 1.0  # relative deviations from the nominal parameters
POSITION_SCALE = 0.2  # m
EXTRAPOLATION_S = 0.01  # s; the default control period, also used with others
# Values at which a feature reaches 1: about the largest that occur.
LARGEST_ERROR = 0.5  # m
LARGEST_SPEED = 1.5  # m/s
LARGEST_STRETCH = 0.01  # m
LARGEST_INTEGRAL = 1e-4  # m s

# Variants of the machine for which transfers are also designed: factors on its belt stiffness and on its masses.
VARIANTS = ((0.7, 0.95), (0.7, 1.15), (1.3, 0.95), (1.3, 1.15))
# For variants, only so many transfers, the shortest: the parameters matter most near the goal.
VARIANT_TRANSFERS = 5
LARGEST_WEIGHTED = 1.2  # Fraction of the rated voltage; limit of the voltages before their mean is formed.

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
    "error_integral",
    "action",  # of this period, which only critics observe
)


def feature_parameters(
    machine: Machine, period: float = 0.01, transfers: Sequence[int] = (), preview: int = 0
) -> dict[str, Any]:
    """Compute the arguments of `feature_matrix` that depend on the machine: its kinematics and gains of controllers.

    The features of a policy can include voltages of model-based controllers, which are linear in the observation.

    Args:
        period: Control period, s.
        transfers: For a fixed goal: durations of the minimum-energy transfers (motions to rest at the goal) whose first
            voltages are features, in control periods beyond the shortest transfer (0). Default: none.
        preview: For a moving goal: number of future goals that a preview control uses, whose voltages are features.
            Ignored if `transfers` are given. Default: no preview control.

    Returns:
        `radii`: belt travel (radius * angle) per radian of each motor coordinate, m/rad, list of one per motor; a drive
            that acts on an axis of the tool itself has no motor coordinate.
        `rest`: belt travel of each motor coordinate per meter of each axis with unstretched belts, m/m, nested list of
            shape (motors, axes).
        `meters`: only for rotary axes: length that a rad of the tool position counts as, m.
        `gains`: only with `transfers` or `preview`; by key of the observation, the matrix from its entries to these
            voltages as fractions of the rated ones, transfer by transfer, nested list of shape (voltages, entries).

    Raises:
        InputError: If the machine has no transfer of one of these durations.
    """
    # The tool's axes come first, then the motors.
    motor_names = observed_coordinates(machine)[len(machine.tool_axes) :]
    motors = [machine.coordinate_names.index(name) for name in motor_names]
    radii = machine.travel_per_unit[motors]
    rest = rest_positions_per_axis(machine)[motors] * radii[:, None] * machine.axis_unit.per_meter
    geometry = {"radii": radii.tolist(), "rest": rest.tolist()}
    if machine.axis_unit is RADIANS:
        geometry["meters"] = 1.0 / machine.axis_unit.per_meter
    if transfers:
        return {**geometry, "gains": _transfer_gains(MotionModel(machine), period, transfers)}
    if preview:
        return {**geometry, "gains": _preview_gains(MotionModel(machine), period, preview)}
    return geometry


def _transfer_gains(model: MotionModel, period: float, transfers: Sequence[int]) -> dict[str, Any]:
    """Return the gains for the first voltages of transfers to rest, designed at the center of the workspace."""
    designed = TransferDesign(model, period)
    _check_transfers(designed, transfers)
    by_duration = designed.first_gains(transfers, [_center(designed.grid)])[0]  # (durations, drives, 2 n)
    on_state = np.concatenate(by_duration / model.rated[:, None])
    return _as_lists(
        observation=on_state @ _state_of_observation(model),
        desired_goal=-on_state @ model.goal_state(np.diag(model.axis_radii)).T,
    )


def _check_transfers(designed: TransferDesign, transfers: Sequence[int]) -> None:
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
        preview=designed.goal[center] / rated * np.tile(model.axis_radii, preview),
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
    sizes: Mapping[str, int],
    radii: Array,
    rest: Array,
    gains: Mapping[str, Array] | None = None,
    meters: float = 1.0,
) -> tuple[Array, Array]:
    """Build the matrix M and the factors g of the inputs of a policy network, g * sign(z M) * log(1 + |z M|).

    z is an observation, all its arrays joined. The machine has as many drives as axes.

    Args:
        sizes: Number of entries of each array of the observation, by key, in the order in which z joins them.
            `observation` and `desired_goal` are required; the other keys of `OBSERVATION_KEYS` add features.
        radii: Belt travel (radius * angle) per radian of each motor coordinate, m/rad, shape (motors,).
        rest: Belt travel of each motor coordinate per meter of each axis with unstretched belts, m/m, shape
            (motors, axes).
        gains: By key, matrices from entries of the observation to voltages of model-based controllers, which are summed
            over the keys, shape (voltages, entries of the key); see `feature_parameters`. Default: no such features.
        meters: Length that a unit of the tool position counts as, m: 1 for meters.

    Returns:
        M: Matrix from z to the quantities divided by their scales (z M: dimensionless), shape (entries, features).
        g: Factors, dimensionless, shape (features,). A feature is 1 at a large value of its quantity, such as 0.5 m.
    """
    # Each quantity is a matrix of columns (entries of z, components): the quantity is z times these columns.
    selectors = _selectors(sizes)
    goal = meters * selectors["desired_goal"]
    axes = drives = goal.shape[1]
    rest = np.reshape(rest, (len(radii), axes))
    tool, motors, tool_speed, motor_speed = _split_state(selectors["observation"], radii, axes, meters)
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
        goal_changes = meters * selectors["preview"] - np.tile(goal, sizes["preview"] // axes)
        blocks.append(_scaled_columns(goal_changes, ERROR_SCALES[1:3], LARGEST_ERROR))
    if "last_observation" in selectors:
        last_speeds = np.hstack(_split_state(selectors["last_observation"], radii, axes, meters)[2:])
        blocks.append(_scaled_columns(speeds - last_speeds, SPEED_SCALES, LARGEST_SPEED))
    for key in ("last_action", "base_action"):
        if key in selectors:
            blocks.append(_scaled_columns(selectors[key], ACTION_SCALES, 1.0))
    if "expected_friction" in selectors:
        upcoming, recent = (
            selectors["expected_friction"][:, :-drives],
            selectors["expected_friction"][:, -drives:],
        )
        # An integral action knows the recent (last) friction voltages, but does not anticipate their changes.
        change = upcoming - np.tile(recent, upcoming.shape[1] // drives)
        columns = np.hstack([upcoming[:, :drives], change])
        blocks.append(_scaled_columns(columns, FRICTION_VOLTAGE_SCALES, FRICTION_VOLTAGE_SCALES[0]))
    if "estimates" in selectors:
        blocks.append(_scaled_columns(selectors["estimates"], (ESTIMATE_SCALE,), LARGEST_ESTIMATE))
    if "error_integral" in selectors:
        integral = selectors["error_integral"]
        blocks.append(
            _scaled_columns(np.hstack([integral, integral @ rest.T]), INTEGRAL_SCALES, LARGEST_INTEGRAL)
        )
    if gains:
        volts = np.sum([selectors[key] @ np.transpose(values) for key, values in gains.items()], axis=0)
        blocks.append(_scaled_columns(volts, TRANSFER_SCALES, LARGEST_TRANSFER))
        if "action" in selectors:  # its error as the first action of each transfer
            repeated = np.tile(selectors["action"], volts.shape[1] // drives)
            blocks.append(_scaled_columns(repeated - volts, ACTION_ERROR_SCALES, 1.0))
    if "action" in selectors:
        blocks.append(_scaled_columns(selectors["action"], ACTION_SCALES, 1.0))
        change = selectors["action"] - selectors["last_action"]
        blocks.append(_scaled_columns(change, ACTION_CHANGE_SCALES, 1.0))
    return np.hstack([matrix for matrix, _ in blocks]), np.concatenate([factors for _, factors in blocks])


def _selectors(sizes: Mapping[str, int]) -> dict[str, Array]:
    """Return, for each key, the columns that pick its entries out of z, shape (entries, entries of the key)."""
    edges = np.cumsum([0, *sizes.values()]).tolist()
    identity = np.eye(edges[-1])
    return {
        key: identity[:, first:last] for key, first, last in zip(sizes, edges[:-1], edges[1:], strict=True)
    }


def _split_state(state: Array, radii: Array, axes: int, meters: float) -> tuple[Array, Array, Array, Array]:
    """Split a state's columns into tool, motors, tool speed and motor speed, in m and motors in belt travel."""
    tool, motors, tool_speed, motor_speed = np.split(state, np.cumsum([axes, len(radii), axes]), axis=1)
    return meters * tool, motors * radii, meters * tool_speed, motor_speed * radii


def _scaled_columns(columns: Array, scales: Sequence[float], largest: float) -> tuple[Array, Array]:
    """Return the columns divided by each scale, and the factors by which the value `largest` gives a feature of 1."""
    factors = [np.full(columns.shape[1], 1.0 / np.log1p(largest / scale)) for scale in scales]
    return np.hstack([columns / scale for scale in scales]), np.concatenate(factors)


class FeedbackLaws(NamedTuple):
    """Voltages that K feedback laws give in the present state, and the derivatives of these voltages.

    Attributes:
        volts: Voltages divided by the rated voltages, not limited, shape (batch, K, drives).
        gains: Derivatives of `volts` with respect to the entries of the full-state observation, per m, rad, m/s or
            rad/s, shape (batch, K, drives, entries).
    """

    volts: Array
    gains: Array


class TransferBank:
    """First voltages of K minimum-energy transfers (motions to rest at the goal) of several durations and designs.

    Every transfer is designed for `machine`; the first five (`VARIANT_TRANSFERS`) are also designed for each of four
    variants with other belt stiffness and masses (`VARIANTS`). The durations of a variant count from its shortest
    transfer and are limited to its longest one.

    Args:
        period: Control period, s.
        transfers: Durations in control periods beyond the shortest possible transfer, ascending; 0: the shortest.

    Attributes:
        size: Number K of transfers.

    Raises:
        InputError: If the machine has no transfer of one of the durations, or they are not ascending.
    """

    def __init__(self, machine: Machine, period: float, transfers: Sequence[int]) -> None:
        self._model = MotionModel(machine)
        self._grid = OperatingPointGrid(machine)
        designed = TransferDesign(self._model, period)
        _check_transfers(designed, transfers)
        if any(second <= first for first, second in pairwise(transfers)):
            raise InputError(f"transfers are {list(transfers)}; list durations in ascending order, each once")
        gains = [designed.first_gains(transfers)]
        for stiffness, mass in VARIANTS:
            variant = TransferDesign(MotionModel(scaled_machine(machine, stiffness, mass)), period)
            extra_periods = np.minimum(transfers[:VARIANT_TRANSFERS], variant.longest - variant.shortest)
            gains.append(variant.first_gains(extra_periods.tolist()))
        self._gains = np.concatenate(gains, axis=1) / self._model.rated[:, None]  # (points, K, drives, 2 n)
        self._of_observation = _state_of_observation(self._model)
        self.size = self._gains.shape[1]

    def laws(self, observation: NDArray[Any], goal: NDArray[Any]) -> FeedbackLaws:
        """Compute the first voltages of each transfer from the present state, by the design nearest to the goal.

        The transfers of the declared machine, in the order of the durations, precede those of each variant.

        Args:
            observation: Present full-state observations, m, rad, m/s and rad/s, shape (batch, entries).
            goal: Tool positions of the goals, m, shape (batch, axes).

        Returns:
            K laws per observation, in units of the rated voltages.
        """
        travel = self._model.axis_travel(goal)
        gains = self._gains[self._grid.nearest(travel)] @ self._of_observation
        at_rest = self._model.observation(self._model.goal_state(travel))
        return FeedbackLaws(np.einsum("bkij,bj->bki", gains, observation - at_rest), gains)


class PlanBank:
    """First voltages of K transfers, planned in every period for the machine as estimated (`SimulatedTransfers`).

    Args:
        period: Control period, s.
        estimator: Estimator of the parameters; `laws` plans with its present estimates.
        durations: Durations of the transfers in periods, ascending.

    Attributes:
        size: Number K of transfers.

    Raises:
        InputError: If the durations are not positive and ascending.
    """

    def __init__(
        self, machine: Machine, period: float, estimator: ParameterFilter, durations: Sequence[int]
    ) -> None:
        self._model, self._estimator, self.size = MotionModel(machine), estimator, len(durations)
        # not its machine, which has no dead time
        self._ratios = ParameterRatios(machine, estimator.parameter_names)
        self._transfers = SimulatedTransfers(self._model, period, durations)
        self._of_observation = _state_of_observation(self._model)

    def laws(self, observation: NDArray[Any], goal: NDArray[Any], last_action: NDArray[Any]) -> FeedbackLaws:
        """Plan each transfer for the estimated machine, in the order of the durations.

        Args:
            observation: Present full-state observations, m, rad, m/s and rad/s, shape (batch, entries).
            goal: Tool positions of the goals, m, shape (batch, axes).
            last_action: Voltages of the period before, divided by the rated voltages, shape (batch, drives).

        Returns:
            K laws per observation, in units of the rated voltages.
        """
        rated = self._model.rated
        planned = self._transfers.plan(
            self._model.state({"observation": observation}),
            self._model.axis_travel(goal),
            self._ratios.parameters(self._estimator.estimates),
            last_action * rated,
        )
        return FeedbackLaws(planned.volts / rated, planned.gains / rated[:, None] @ self._of_observation)
