"""Inputs of a policy network (features): errors, speeds, belt stretch and voltages on logarithmic scales.

An error of 0.1 mm, in meters, is too small an input for a network to learn from. Each quantity v therefore
enters as

    sign(v) * log(1 + |v| / scale)

for one or several scales: linear well below a scale, logarithmic above it. Errors enter for the tool (x, y)
and for each motor (as belt travel), now and after 10 ms at the present speeds with an unchanged goal. Every v
is linear in the observation z, so all features are one matrix product and one logarithm: factor * sign(z M) *
log(1 + |z M|).

This module needs NumPy only; sb3_adapters.py evaluates the features in torch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..arrays import Array
from ..controllers import MotionModel, OperatingPointGrid, PreviewGains, TransferDesign
from ..controllers.planning.finite_horizon_control import VOLTAGE_CHANGE_WEIGHT
from ..machine import RADIANS, Machine, observed_coordinates, rest_positions_per_axis
from .feedback_laws import check_transfers, state_of_observation

ERROR_SCALES = (1e-1, 1e-2, 1e-3, 1e-4)  # m
SPEED_SCALES = (0.3, 0.02)  # m/s
INTEGRAL_SCALES = (1e-5, 1e-6)  # m s; an error of 0.1 mm in ten control periods of 10 ms, and in one
STRETCH_SCALES = (1e-3, 1e-4)  # m
# Fractions of the rated voltage: full voltage, and about the voltage that overcomes Coulomb friction.
ACTION_SCALES = (1.0, 0.03)
# Fractions of the rated voltage. At rest at the goal, 0.01 moves the tool by about 0.1 mm in one control
# period.
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

# Observation keys in the order in which they are concatenated; absent keys are skipped. The weights of a
# trained agent depend on this order.
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
    """Compute the arguments of `feature_matrix` that depend on the machine: kinematics and gains.

    The features of a policy can include voltages of model-based controllers, which are linear in the
    observation.

    Args:
        period: Control period, s.
        transfers: For a fixed goal: durations of the minimum-energy transfers (motions to rest at the goal)
            whose first voltages are features, in control periods beyond the shortest transfer (0). Default:
            none.
        preview: For a moving goal: number of future goals that a preview control uses, whose voltages are
            features. Ignored if `transfers` are given. Default: no preview control.

    Returns:
        `radii`: belt travel (radius * angle) per radian of each motor coordinate, m/rad, list of one per
            motor; a drive that acts on an axis of the tool itself has no motor coordinate.
        `rest`: belt travel of each motor coordinate per meter of each axis with unstretched belts, m/m,
            nested list of shape (motors, axes).
        `meters`: only for rotary axes: length, m, that one rad of the tool position corresponds to.
        `gains`: only with `transfers` or `preview`; by key of the observation, the matrix from its entries to
            these voltages as fractions of the rated ones, transfer by transfer, nested list of shape
            (voltages, entries).

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
    """Return the gains for the first voltages of transfers to rest, from the center of the workspace."""
    designed = TransferDesign(model, period)
    check_transfers(designed, transfers)
    by_duration = designed.first_gains(transfers, [_center(designed.grid)])[0]  # (durations, drives, 2 n)
    on_state = np.concatenate(by_duration / model.rated[:, None])
    return _as_lists(
        observation=on_state @ state_of_observation(model),
        desired_goal=-on_state @ model.goal_state(np.diag(model.axis_radii)).T,
    )


def _preview_gains(model: MotionModel, period: float, preview: int) -> dict[str, Any]:
    """Return the gains for the voltages of a preview control, designed at the center of the workspace."""
    grid = OperatingPointGrid(model.machine)
    designed = PreviewGains(model, grid, period, preview, VOLTAGE_CHANGE_WEIGHT)
    center, rated = _center(grid), model.rated[:, None]
    return _as_lists(
        observation=designed.state[center] / rated @ state_of_observation(model),
        preview=designed.goal[center] / rated * np.tile(model.axis_radii, preview),
        last_action=designed.last[center] / rated * model.rated,
    )


def _center(grid: OperatingPointGrid) -> int:
    """Return the index of the operating point at the center of the workspace."""
    return int(grid.nearest(grid.points.mean(axis=0, keepdims=True))[0])


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
        gains: By key, matrices from entries of the observation, SI, to voltages of model-based controllers as
            fractions of the rated ones, which are summed over the keys, shape (voltages, entries of the key);
            see `feature_parameters`. Default: no such features.
        meters: Length, m, that one unit of the tool position corresponds to: 1 for meters.

    Returns:
        M: Matrix from z to the quantities divided by their scales (z M: dimensionless),
        shape (entries, features). g: Factors, dimensionless, shape (features,). A feature is 1 at a large
        value of its quantity, such as 0.5 m.
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
        upcoming = selectors["expected_friction"][:, :-drives]
        recent = selectors["expected_friction"][:, -drives:]
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
    """Return, for each key, the columns that pick its entries of z, shape (entries, entries of the key)."""
    edges = np.cumsum([0, *sizes.values()]).tolist()
    identity = np.eye(edges[-1])
    return {
        key: identity[:, first:last] for key, first, last in zip(sizes, edges[:-1], edges[1:], strict=True)
    }


def _split_state(state: Array, radii: Array, axes: int, meters: float) -> tuple[Array, Array, Array, Array]:
    """Split a state's columns into tool, motors, tool speed and motor speed, in m, motors in belt travel."""
    tool, motors, tool_speed, motor_speed = np.split(state, np.cumsum([axes, len(radii), axes]), axis=1)
    return meters * tool, motors * radii, meters * tool_speed, motor_speed * radii


def _scaled_columns(columns: Array, scales: Sequence[float], largest: float) -> tuple[Array, Array]:
    """Return the columns divided by each scale, and factors that make a feature 1 at the value `largest`."""
    factors = [np.full(columns.shape[1], 1.0 / np.log1p(largest / scale)) for scale in scales]
    return np.hstack([columns / scale for scale in scales]), np.concatenate(factors)
