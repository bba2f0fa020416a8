"""Estimate from the first measurements the initial position of a run and the zero of every sensor.

A recording should begin at rest; the rows before the first input change measure the position there. If it begins in
motion, its first row has a position and a velocity (`initial_rest`). The zero of a sensor is its measurement at
position 0. Sensors with a fixed zero (called lasers here) determine the position of the tool. The angles of the pulleys
follow from unstretched belts or from encoders whose zero is known.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..dynamics.physics.effect_instances import instances_with_state
from ..machine import SENSOR_KINDS, Machine, Sensor
from ..recordings import Recording
from .belt_stretch import rigid_basis, stretch_angles
from .encoder_zeros import EncoderZeros, zero_tolerance
from .initial_rest import InitialVelocity, count_resting_rows, initial_velocity

Array = NDArray[np.float64]
# Weights of encoders that matter only where no laser measures: behind stretched belts, and with an unknown zero.
_STRETCHED_WEIGHT, _FALLBACK_WEIGHT = 1e-3, 1e-6
_FIRST_ROWS = 5  # rows from which the zero of a noisy sensor is estimated if only one row is at rest
_MOVING_STRETCH = 4.0  # times the typical stretch of the belts at the start of a run that begins in motion
_STRETCH_RESIDUAL = 1.0 / 3.0  # of the belts' stretch under the drives' force, which a linear model leaves


@dataclass(frozen=True)
class InitialState:
    """The measured initial state of one run.

    Attributes:
        state: Positions (m, rad), then velocities (m/s, rad/s), at the first row, shape (2 * coordinates,). The
            velocities are zero unless the run begins in motion.
        zeros: Zeros of the sensors (measurements at position 0), in the sensors' units, shape (sensors,); the argument
            `offset` of `simulate`.
        resting_rows: Number of rows at rest at the beginning of the run.
        zero_spread: Standard deviation of each encoder's zero from run to run, m or rad, shape (sensors,); 0 for an
            encoder without a known zero, and for one that does not resolve the stretch of the belts.
        zeros_refined: Whether a fitted machine has corrected the encoders' zeros.
        position_measured: Whether sensors with a known zero measure the position at rest.
        lasers_measured: Whether sensors with a fixed zero alone measure the position at rest.
        position_known: Whether sensors with a known zero determine the position at rest, by measurements at rest or
            later ones.
        zeroed_measurement: Measurements at rest minus the known zeros, m or rad, NaN where there is none, shape
            (sensors,).
        measured_at_rest: Whether each sensor measured something at rest, shape (sensors,).
        position_matrix: Matrix that computes the positions with unstretched belts from `zeroed_measurement` (with 0
            instead of NaN), shape (coordinates, sensors).
        velocity_deviations: Independent errors of the velocities, one per row, each of the size of one standard
            deviation, m/s or rad/s, shape (errors, coordinates); no rows if the run begins at rest.
        start_offset: What a fitted machine added to the positions (m, rad) and velocities (m/s, rad/s) from which it is
            simulated, shape (2 * coordinates,): a stretch of the belts that the measurements at rest do not show.
        effect_states: States of the machine's effects (hysteresis, bristles) at the start, in their units, by label and
            component of the effect; an effect without an entry starts at zero.
        warnings: What could not be measured and what is assumed instead, one sentence each.
    """

    state: Array
    zeros: Array
    resting_rows: int
    zero_spread: Array
    zeros_refined: bool = False
    position_measured: bool = True
    lasers_measured: bool = True
    position_known: bool = True
    zeroed_measurement: Array = field(default_factory=lambda: np.zeros(0))
    measured_at_rest: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))
    position_matrix: Array = field(default_factory=lambda: np.zeros((0, 0)))
    velocity_deviations: Array = field(default_factory=lambda: np.zeros((0, 0)))
    start_offset: Array = field(default_factory=lambda: np.zeros(0))
    effect_states: Mapping[tuple[str, str], float] = field(default_factory=dict)
    warnings: tuple[str, ...] = field(default=())

    def start(self, machine: Machine) -> Array:
        """Return the complete initial state, as `simulate` takes it: positions, velocities and states of the effects.

        Args:
            machine: Machine with its effects (deviations from the nominal model).

        Returns:
            Positions (m, rad), velocities (m/s, rad/s), effect states (SI), shape (2 * coordinates + effect states,).
        """
        states = [
            self.effect_states.get((i.effect.label, i.component), 0.0) for i in instances_with_state(machine)
        ]
        return np.concatenate([self.state, states])

    def with_start(self, machine: Machine, start: Array) -> InitialState:
        """Return a copy with another complete initial state, in the format that the method `start` returns.

        Args:
            machine: Machine with its effects (deviations from the nominal model), which name the last entries of
                `start`.
            start: Positions (m, rad), velocities (m/s, rad/s), effect states (SI), shape (2 * coordinates + effect
                states,).

        Returns:
            Copy whose `state`, shape (2 * coordinates,), and `effect_states` hold the values of the argument `start`.
        """
        names = [(i.effect.label, i.component) for i in instances_with_state(machine)]
        state, states = np.split(start, [len(start) - len(names)])
        return dataclasses.replace(
            self, state=state, effect_states=dict(zip(names, states.tolist(), strict=True))
        )

    @property
    def resolves_stretch(self) -> NDArray[np.bool_]:
        """Whether each encoder kept its zero in all runs and measures the stretch of the belts, shape (sensors,)."""
        return self.zero_spread > 0.0

    @property
    def position(self) -> Array:
        """Positions at rest, or at the first row of a run that begins in motion, m or rad, shape (coordinates,)."""
        return self.state[: len(self.state) // 2]

    @property
    def velocity(self) -> Array:
        """Velocities at the run's first row, m/s or rad/s, shape (coordinates,); zero if the run begins at rest."""
        return self.state[len(self.state) // 2 :]


def settled_rows(resting_rows: int) -> slice:
    """Select the later half of the rows at rest, where a vibration from before the run has decayed.

    Args:
        resting_rows: Number of rows at rest at the beginning of a run, at least 1.

    Returns:
        Slice of row indices; its rows are the later half of the rows at rest.
    """
    return slice(resting_rows // 2, resting_rows)


def estimate_initial_state(
    recording: Recording, machine: Machine, zeros: EncoderZeros | None = None
) -> InitialState:
    """Estimate the state at rest and the sensors' zeros (measurements at position 0) from one run.

    Sensors with a known zero determine the position: lasers, whose zero is fixed, and encoders whose zero is given.
    Other encoders are used only where nothing else measures. Only encoders with a known zero measure a stretch of the
    belts. A laser that is saturated at rest is replaced by its later measurements minus the encoders' displacement.

    Args:
        recording: The run (times, voltages, measurements); saturated measurements are NaN.
        machine: Machine with the rig's coordinates, belts and sensors.
        zeros: Zeros of the encoders, from all runs together. Default: unknown.

    Returns:
        Positions at rest, m or rad, zeros of the sensors, shape (sensors,), and warnings. A run that begins in motion
        has the velocity and the positions of its first row.
    """
    rows = count_resting_rows(recording, machine)
    zeros = zeros or EncoderZeros.of_machine(machine).without(np.ones(len(machine.sensors), np.bool_))
    measurement = np.array(
        [_measurement_at_rest(c, rows, s) for c, s in zip(recording.outputs.T, machine.sensors, strict=True)]
    )
    measured = np.isfinite(measurement)
    site = [machine.coordinate_names.index(machine.coordinate_of_sensor(s)) for s in machine.sensors]
    fixed, known = np.array([s.fixed for s in machine.sensors]), zeros.known  # lasers; encoders with a zero
    rigid = rigid_basis(machine)  # (coordinates, motions that stretch no belt)
    seen = machine.sensor_matrix @ rigid  # measurement per unit of each such motion, (sensors, motions)
    lasers_measured = _rank(seen[fixed & measured]) == _rank(seen) or not fixed.any()
    position_measured = lasers_measured or _rank(seen[(fixed | known) & measured]) == _rank(seen)

    zeroed = measurement - np.where(known, zeros.values, 0.0)  # (sensors,)
    warnings: tuple[str, ...] = ()
    if not position_measured:
        later = _later_measurements(recording, measurement, machine, rigid)
        replaced = fixed & ~measured & np.isfinite(later)
        zeroed = np.where(replaced, later, zeroed)
        warnings = (_position_warning(machine, fixed & ~measured, replaced),)
    usable = np.isfinite(zeroed)
    velocity = InitialVelocity.at_rest(machine)
    if rows == 1:  # The run may begin in motion, from the position from which it is simulated.
        position = _position_matrix(machine, zeros, usable, moving=True) @ np.nan_to_num(zeroed)
        velocity = initial_velocity(recording, machine, rigid, position)
    position_matrix = _position_matrix(machine, zeros, usable, moving=len(velocity.deviations) > 0)
    position = position_matrix @ np.nan_to_num(zeroed)
    for j in np.flatnonzero(known & measured & zeros.resolves_stretch):
        position[site[j]] = zeroed[j] / machine.sensors[j].row[machine.sensors[j].coordinate]
    estimated = np.where(
        measured & machine.position_sensors, measurement - machine.sensor_matrix @ position, 0.0
    )
    return InitialState(
        np.concatenate([position, velocity.mean]),
        np.where(known, zeros.values, estimated),
        rows,
        zeros.spread,
        position_measured=position_measured,
        lasers_measured=lasers_measured,
        position_known=position_measured or _rank(seen[(fixed | known) & usable]) == _rank(seen),
        zeroed_measurement=zeroed,
        measured_at_rest=measured,
        position_matrix=position_matrix,
        velocity_deviations=velocity.deviations,
        warnings=warnings,
    )


def _measurement_at_rest(values: Array, resting_rows: int, sensor: Sensor) -> float:
    """Return what a sensor measures at rest, in its unit; NaN if that is not known.

    It is the mean of the later half of the rows at rest or, if the sensor measured nothing there, of all of them. An
    encoder counts from an unknown zero, so that its first measurement after the rest is much better than none.
    """
    for rows in (settled_rows(resting_rows), slice(resting_rows)):
        if np.isfinite(values[rows]).any():
            return float(np.nanmean(values[rows]))
    later = values[np.isfinite(values)] if sensor.incremental else np.zeros(0)
    return float(later[0]) if len(later) else np.nan


def _position_matrix(
    machine: Machine, zeros: EncoderZeros, usable: NDArray[np.bool_], *, moving: bool
) -> Array:
    """Return the matrix (coordinates, sensors) that gives positions from measurements minus zeros by least squares.

    Args:
        machine: Machine with the sensors.
        zeros: Zeros of the encoders.
        usable: Mask of the sensors that measure the position, shape (sensors,).
        moving: Whether the run begins in motion, so that the drives stretch the belts.
    """
    stretched = zeros.resolves_stretch | moving
    encoders = np.where(zeros.known, np.where(stretched, _STRETCHED_WEIGHT, 1.0), _FALLBACK_WEIGHT)
    weight = np.where([s.fixed for s in machine.sensors], 1.0, encoders)
    # An angle is as accurate as a length once it is multiplied by the radius.
    coordinates = [machine.coordinate(machine.coordinate_of_sensor(s)) for s in machine.sensors]
    weight = np.where(
        usable & machine.position_sensors, weight * [c.travel_per_unit for c in coordinates], 0.0
    )
    rigid = rigid_basis(machine)
    return np.asarray(
        rigid @ np.linalg.pinv(weight[:, None] * (machine.sensor_matrix @ rigid), rcond=1e-12) * weight
    )


def _rank(rows: Array) -> int:
    """Return the rank of a matrix; 0 for one without rows."""
    return int(np.linalg.matrix_rank(rows)) if len(rows) else 0


def _later_measurements(recording: Recording, at_rest: Array, machine: Machine, rigid: Array) -> Array:
    """Return what each sensor would have measured at rest, shape (sensors,), from its later rows; NaN if impossible.

    The displacement that the encoders measure since the rest is subtracted. While the drives pull, the stretch of the
    belts makes it wrong; a linear regression on voltages, speeds and directions of the motors removes this error.
    """
    unknown = np.full(len(machine.sensors), np.nan)
    encoders = np.array([s.incremental for s in machine.sensors]) & np.isfinite(at_rest)
    seen = machine.sensor_matrix @ rigid
    if _rank(seen[encoders]) < rigid.shape[1]:
        return unknown
    turned = recording.outputs[:, encoders] - at_rest[encoders]  # (n, encoders)
    displacement = turned @ np.linalg.pinv(seen[encoders]).T @ seen.T  # (n, sensors)
    start = recording.outputs - displacement
    speed = np.gradient(np.nan_to_num(turned), axis=0)
    pull = np.hstack([recording.inputs, speed, np.sign(speed)])  # (n, regressors), 0 at rest
    pull /= np.maximum(np.abs(pull).max(axis=0), 1e-12)
    regressors = np.hstack([np.ones((len(pull), 1)), pull])
    # Ridge: if the motion does not separate stretch and position, the stretch is assumed to be small.
    prior = _STRETCH_RESIDUAL * np.eye(regressors.shape[1])[1:]
    for j in range(len(machine.sensors)):
        rows = np.isfinite(start[:, j])
        if rows.any():
            middle = np.median(start[rows, j])
            target = np.concatenate([start[rows, j] - middle, np.zeros(len(prior))])
            unknown[j] = (
                middle + np.linalg.lstsq(np.vstack([regressors[rows], prior]), target, rcond=None)[0][0]
            )
    return unknown


def _position_warning(machine: Machine, silent: NDArray[np.bool_], replaced: NDArray[np.bool_]) -> str:
    """Return a sentence about how an unmeasured position was determined."""
    channels = np.array(machine.output_channels)
    if silent.any() and np.array_equal(silent, replaced):
        return (
            f"{', '.join(channels[silent])} measures nothing at rest; its initial position follows "
            "from later measurements and the encoders."
        )
    return (
        "The initial position cannot be determined, because no sensor with a known zero measures it; the encoders are "
        "assumed to count from the machine's zero, and positions without any measurement are assumed to be 0."
    )


def sensor_zero_error(
    error: Array, weights: Array, resting_rows: int, max_mean: Array, quanta: Array
) -> Array:
    """Estimate the errors of the sensors' zeros (measurements at position 0) from prediction errors over a run.

    The estimate is the mean error over the complete run, limited to the range +-`max_mean` around the mean error over
    the later half of the rows at rest. The limit is needed because a constant force may also cause a mean error. For a
    sensor without quantization, the first five rows of the run replace a single row at rest, which has the noise of one
    measurement.

    Args:
        error: Measured minus predicted values over n samples, m or rad, 0 if not measured, shape (batch, n, sensors).
        weights: Weights of the measurements in the means, dimensionless, 0 where not measured, shape (n, sensors).
        resting_rows: Number of rows at rest at the beginning of the run, at least 1.
        max_mean: Largest difference between estimate and mean error at rest, m or rad, shape (sensors,); infinite for
            no limit.
        quanta: Quantization steps of the sensors, m or rad, 0 where there is none, shape (sensors,).

    Returns:
        Errors of the zeros, m or rad, shape (batch, 1, sensors), to be subtracted from `error`.
    """

    def mean(rows: slice) -> Array:  # (batch, sensors)
        sums = np.einsum(
            "bns,ns->bs", error[:, rows], weights[rows]
        )  # a quarter of the time of a product and a sum
        return np.asarray(sums / np.maximum(weights[rows].sum(axis=0), 1e-12))

    at_rest, of_run = mean(settled_rows(resting_rows)), mean(slice(None))
    if resting_rows == 1:
        at_rest = np.where(quanta > 0.0, at_rest, mean(slice(_FIRST_ROWS)))
    return np.asarray((at_rest + np.clip(of_run - at_rest, -max_mean, max_mean))[:, None, :])


def max_zero_means(behind: NDArray[np.bool_], quanta: Array) -> Array:
    """Return how far the zero of each sensor may differ from its estimate by the rows at rest.

    The zero is the measurement at position 0. The rows at rest determine it only to within the quantization; for an
    encoder behind belts not at all, because friction holds an unknown stretch of the belts at rest. Up to these limits,
    `sensor_zero_error` counts the mean prediction error over a run as an error of the zero.

    Args:
        behind: True for encoders on pulleys, which elastic belts separate from the tool, shape (sensors,).
        quanta: Quantization steps of the sensors, m or rad, 0 where there is none, shape (sensors,).

    Returns:
        Limits, m or rad, shape (sensors,): infinite behind belts, otherwise half a quantization step.
    """
    return np.where(behind, np.inf, quanta / 2)


def max_reported_zero_means(machine: Machine, initial: InitialState, quanta: Array) -> Array:
    """Return how far, in a reported error, the zero of each sensor may differ from its estimate by the rows at rest.

    A search compares machines without a limit for encoders behind belts, see `max_zero_means`. In a reported error,
    the zero accounts only for what the stretch of the belts at the start can cause. The rest of a mean error over the
    run is an error of the model.

    Args:
        machine: Machine whose error is reported.
        initial: Initial state of the run.
        quanta: Quantization steps of the sensors, m or rad, 0 where there is none, shape (sensors,).

    Returns:
        Limits, m or rad, shape (sensors,): half a quantization step; behind belts, what `zero_tolerance` permits, and
        for a run that begins in motion four times the stretch that the drives typically cause.
    """
    behind = behind_belts(machine)
    limits = max_zero_means(free_zeros(machine) & ~behind, quanta)
    if not behind.any():
        return limits
    stretched = zero_tolerance(machine, EncoderZeros.of_machine(machine), quanta)
    if initial.velocity.any():
        angles = stretch_angles(machine, moving=True)
        stretched = stretched + _MOVING_STRETCH * np.array(
            [angles.get(s.coordinate, 0.0) for s in machine.sensors]
        )
    return np.where(behind, stretched, limits)


def max_fitted_zero_means(behind: NDArray[np.bool_], quanta: Array, at_rest: NDArray[np.bool_]) -> Array:
    """Return how far, in a fit, the zero of each sensor may differ from its estimate by the rows at rest.

    The zero is the measurement at position 0. The limits differ from those of `max_zero_means` for a sensor without
    quantization. It gives the initial position, and the noise of its few measurements at rest makes this position wrong
    by a constant over the complete run. The mean error over the run is the best estimate of this constant. If it
    remained in the residual, parameters would adapt to it.

    Args:
        behind: True for encoders on pulleys, which elastic belts separate from the tool, shape (sensors,).
        quanta: Quantization steps of the sensors, m or rad, 0 where there is none, shape (sensors,).
        at_rest: True for sensors that measured at rest, shape (sensors,). The limits of all other sensors are those of
            `max_zero_means`, because later measurements of these sensors determine the initial position.

    Returns:
        Limits, m or rad, shape (sensors,): infinite behind belts and for sensors without quantization that
        measured at rest, otherwise half a quantization step.
    """
    return np.where((quanta == 0.0) & at_rest, np.inf, max_zero_means(behind, quanta))


def behind_belts(machine: Machine) -> NDArray[np.bool_]:
    """Return which sensors are encoders on pulleys, which elastic belts separate from the tool.

    Args:
        machine: Machine with the sensors.

    Returns:
        True for such an encoder, shape (sensors,).
    """
    pulleys = [s.incremental and machine.coordinate(s.coordinate).kind == "rotary" for s in machine.sensors]
    return np.array(pulleys) & bool(machine.belts)


def free_zeros(machine: Machine) -> NDArray[np.bool_]:
    """Return which sensors have a zero that the rows at rest do not determine, shape (sensors,).

    They are encoders on pulleys behind belts, and sensors with an offset, such as accelerometers.
    """
    return behind_belts(machine) | np.array([SENSOR_KINDS.get(s.kind).has_offset for s in machine.sensors])


def has_zero(machine: Machine) -> NDArray[np.bool_]:
    """Return which sensors have a zero to estimate: those of positions, and those with an offset, shape (sensors,)."""
    return machine.position_sensors | free_zeros(machine)
