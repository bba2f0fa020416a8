"""Estimate from the first measurements the initial position of a run and the zero of every sensor.

A recording should begin at rest; the rows before the first input change measure the position there. A run
that was cut out of a longer log begins in motion: its first measurements show the velocity of its first row.
The zero of a sensor is its measurement at position 0. Sensors with a fixed zero (called lasers here)
determine the position of the tool. The angles of the pulleys follow from unstretched belts or from encoders
whose zero is known.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...dynamics.physics.effect_instances import instances_with_state
from ...machine import Machine, Sensor, commanded_state, rigid_basis
from ...recordings import Recording
from .encoder_zeros import EncoderZeros
from .initial_velocity import InitialVelocity, initial_velocity
from .rest import count_resting_rows

# Weights of encoders that matter only where no laser measures: behind stretched belts, and with an unknown
# zero.
_STRETCHED_WEIGHT, _FALLBACK_WEIGHT = 1e-3, 1e-6
_STRETCH_RESIDUAL = 1.0 / 3.0  # of the belts' stretch under the drives' force, which a linear model leaves


@dataclass(frozen=True)
class InitialState:
    """The measured initial state of one run.

    Attributes:
        state: Positions (m, rad), then velocities (m/s, rad/s), at the first row, shape (2 * coordinates,).
            The velocities are zero unless the run begins in motion.
        zeros: Zeros of the sensors, in the sensors' units, shape (sensors,); the argument `offset` of
            `simulate`.
        resting_rows: Number of rows at rest at the beginning of the run.
        zero_spread: Standard deviation of each encoder's zero from run to run, in the sensors' units,
            shape (sensors,); 0 for an encoder without a known zero, and for one that does not resolve the
            stretch of the belts.
        zeros_refined: Whether a fitted machine has corrected the encoders' zeros.
        position_measured: Whether sensors with a known zero measure the position at rest.
        lasers_measured: Whether sensors with a fixed zero alone measure the position at rest.
        position_known: Whether sensors with a known zero determine the position at rest, by measurements at
            rest or later ones.
        zeroed_measurement: Measurements at rest minus the known zeros, m or rad, NaN where there is none,
            shape (sensors,).
        measured_at_rest: Whether each sensor measured something at rest, shape (sensors,).
        position_matrix: Matrix that computes the positions with unstretched belts from `zeroed_measurement`
            (with 0 instead of NaN), shape (coordinates, sensors).
        velocity_deviations: Independent errors of the velocities, one per row, each of the size of one
            standard deviation, m/s or rad/s, shape (errors, coordinates); no rows if the run begins at rest.
        start_offset: Correction of the positions (m, rad) and velocities (m/s, rad/s) by a fitted machine,
            shape (2 * coordinates,): a stretch of the belts that the measurements at rest do not show.
        effect_states: States of the machine's effects (hysteresis, bristles) at the start, in their units, by
            label and component of the effect; an effect without an entry starts at zero.
        warnings: Sentences on quantities that were not measured, and the assumptions instead.
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
        """Return the complete initial state, as for `simulate`: positions, velocities, states of effects.

        Returns:
            Positions (m, rad), velocities (m/s, rad/s), effect states (SI),
            shape (2 * coordinates + effect states,).
        """
        states = [
            self.effect_states.get((i.effect.label, i.component), 0.0) for i in instances_with_state(machine)
        ]
        return np.concatenate([self.state, states])

    def with_start(self, machine: Machine, start: Array) -> InitialState:
        """Return a copy with another complete initial state, as the method `start` returns it.

        Args:
            start: Positions (m, rad), velocities (m/s, rad/s), effect states (SI),
                shape (2 * coordinates + effect states,).
        """
        names = [(i.effect.label, i.component) for i in instances_with_state(machine)]
        state, states = np.split(start, [len(start) - len(names)])
        return dataclasses.replace(
            self, state=state, effect_states=dict(zip(names, states.tolist(), strict=True))
        )

    @property
    def resolves_stretch(self) -> NDArray[np.bool_]:
        """Whether each encoder kept its zero in all runs and measures belt stretch, shape (sensors,)."""
        return self.zero_spread > 0.0

    @property
    def position(self) -> Array:
        """Positions at rest, or in the first row of a moving run, m or rad, shape (coordinates,)."""
        return self.state[: len(self.state) // 2]

    @property
    def velocity(self) -> Array:
        """Velocities at the run's first row, m/s or rad/s, shape (coordinates,); zero if at rest."""
        return self.state[len(self.state) // 2 :]


def settled_rows(resting_rows: int) -> slice:
    """Select the later half of the rows at rest (at least 1), where an earlier vibration has decayed."""
    return slice(resting_rows // 2, resting_rows)


def estimate_initial_state(
    recording: Recording, machine: Machine, zeros: EncoderZeros | None = None
) -> InitialState:
    """Estimate the state at rest and the sensors' zeros from one run.

    Sensors with a known zero determine the position: lasers, whose zero is fixed, and encoders whose zero is
    given. Other encoders are used only where nothing else measures. If a drive commands the position of a
    coordinate, its encoder counts from the commanded position, at which the coordinate is assumed without any
    sensor. Only encoders with a known zero measure a stretch of the belts. A laser that is saturated at rest
    is replaced by its later measurements minus the encoders' displacement.

    Args:
        recording: The run; saturated measurements are NaN.
        machine: Machine with the rig's coordinates, belts and sensors.
        zeros: Zeros of the encoders, from all runs together. Default: unknown.

    Returns:
        Positions at rest, m or rad, zeros of the sensors, shape (sensors,), and warnings. A run that begins
        in motion has the velocity and the positions of its first row.
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

    # (sensors,)
    zeroed = measurement - np.where(known, zeros.values, _zeros_by_command(recording, machine, rows))
    warnings: tuple[str, ...] = ()
    if not position_measured:
        later = _later_measurements(recording, measurement, machine, rigid)
        replaced = fixed & ~measured & np.isfinite(later)
        zeroed = np.where(replaced, later, zeroed)
        warnings = (_position_warning(machine, fixed & ~measured, replaced),)
    usable = np.isfinite(zeroed)
    velocity = InitialVelocity.at_rest(machine)
    if rows == 1:  # The run may begin in motion, from the position from which it is simulated.
        position = _located(recording, machine, _position_matrix(machine, zeros, usable, moving=True), zeroed)
        velocity = initial_velocity(recording, machine, rigid, position)
    position_matrix = _position_matrix(machine, zeros, usable, moving=len(velocity.deviations) > 0)
    position = _located(recording, machine, position_matrix, zeroed)
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

    It is the mean of the later half of the rows at rest or, if the sensor measured nothing there, of all of
    them. An encoder counts from an unknown zero, so that its first measurement after the rest is much better
    than none.
    """
    for rows in (settled_rows(resting_rows), slice(resting_rows)):
        if np.isfinite(values[rows]).any():
            return float(np.nanmean(values[rows]))
    later = values[np.isfinite(values)] if sensor.incremental else np.zeros(0)
    return float(later[0]) if len(later) else np.nan


def _zeros_by_command(recording: Recording, machine: Machine, resting_rows: int) -> Array:
    """Return the zeros of the encoders on coordinates whose position is commanded, shape (sensors,); else 0.

    At rest the coordinate is where its command holds it. A run that begins in motion follows its command with
    a lag, so that its zero is known only where encoder and command are further apart than they move against
    each other.
    """
    found = np.zeros(len(machine.sensors))
    for j, sensor in enumerate(machine.sensors):
        column = machine.position_commands.get(sensor.coordinate)
        if column is None or not sensor.incremental:
            continue
        command = recording.inputs[:, column] * sensor.row[sensor.coordinate]
        apart = recording.outputs[:, j] - command
        if resting_rows > 1 and np.isfinite(apart[:resting_rows]).any():
            found[j] = np.nanmean(apart[:resting_rows])
        elif np.isfinite(apart).any():
            middle = float(np.nanmedian(apart))
            found[j] = middle if abs(middle) > np.nanmax(np.abs(apart - middle)) else 0.0
    return found


def _position_matrix(
    machine: Machine, zeros: EncoderZeros, usable: NDArray[np.bool_], *, moving: bool
) -> Array:
    """Return the matrix (coordinates, sensors) to positions from usable measurements, by least squares.

    In a run that begins in motion, the drives stretch the belts.
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


def _located(recording: Recording, machine: Machine, position_matrix: Array, zeroed: Array) -> Array:
    """Return the positions at the first row, m or rad, shape (coordinates,), from measurements minus zeros.

    In directions that no sensor of a position measures, the machine is where its commands hold it, or else at
    0.
    """
    seen = machine.sensor_matrix[np.isfinite(zeroed)] @ rigid_basis(machine)
    if not machine.position_commands or _rank(seen) == seen.shape[1]:
        return np.asarray(position_matrix @ np.nan_to_num(zeroed))
    held = commanded_state(machine, recording.inputs[0])[: len(machine.coordinates)]
    return np.asarray(held + position_matrix @ np.nan_to_num(zeroed - machine.sensor_matrix @ held))


def _rank(rows: Array) -> int:
    """Return the rank of a matrix; 0 for one without rows."""
    return int(np.linalg.matrix_rank(rows)) if len(rows) else 0


def _later_measurements(recording: Recording, at_rest: Array, machine: Machine, rigid: Array) -> Array:
    """Return what each sensor would have measured at rest, (sensors,), from its later rows, or NaN.

    The displacement that the encoders measure since the rest is subtracted. While the drives pull, the
    stretch of the belts makes it wrong; a linear regression on voltages, speeds and directions of the motors
    removes this error.
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
        "The initial position cannot be determined, because no sensor with a known zero measures it; "
        "the encoders are assumed to count from the machine's zero, "
        "and positions without any measurement are assumed to be 0."
    )
