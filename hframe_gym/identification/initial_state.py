"""The initial state of a run for a given machine.

`rest_measurement` estimates the position from the measurements alone. A machine with effects knows more: an effect on a
reading is inverted, and pulleys are in static equilibrium with the forces that act at rest.

Every command takes its initial states from here: identification from `model_initial_state`, ``hframe simulate`` from
`initial_state_of_recording`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..dynamics import effect_forces, simulate_batch, stiffness_matrix
from ..machine import Machine, rest_state
from ..recordings import Recording
from .criteria import SelectionCriteria
from .rest_measurement import (
    InitialState,
    count_resting_rows,
    estimate_initial_state,
    max_zero_means,
    rigid_basis,
    sensor_zero_error,
)
from .sensor_properties import blank_saturated, sensor_noise, sensor_quantum

Array = NDArray[np.float64]
_POSITION_CORRECTIONS = 3  # Simulations that refine a position which no sensor measures at rest.
_INVERSION_STEPS = 4  # Each leaves a few hundredths of the error.
_INVERSION_TOLERANCE = 1e-6  # m


def static_equilibrium(machine: Machine, position: Array) -> Array:
    """Return the positions of all coordinates at rest, stretched belts included, for a given position of the tool.

    The belts stretch where effects exert forces at rest (cables, tilt).

    Static friction carries the load up to the Coulomb level. Any excess force displaced the carriage; it came to rest
    at the far end of its first swing, at twice the displacement of the excess, or where the belts carry the entire
    force.

    Args:
        machine: Machine with its effects.
        position: Positions of the first coordinates, in their units, shape (at most coordinates,); only those of the
            linear coordinates are used.

    Returns:
        Positions in the coordinates' units, shape (coordinates,).
    """
    names = machine.coordinate_names
    linear = np.array([c.kind == "linear" for c in machine.coordinates])
    given = position[: len(names)]
    at_rest = rest_state(machine, given[linear[: len(given)]])[: len(names)]
    if not any(e.definition.force for e in machine.effects):
        return at_rest
    force = _force_at_rest(machine, at_rest)[linear]
    friction = np.array([c.coulomb for c in machine.coordinates])[linear]
    rotary = ~linear & ~np.isin(names, machine.spring_loaded)
    stiffness = stiffness_matrix(machine, at_rest)[np.ix_(linear, rotary)]
    carried = np.sign(force) * np.clip(2.0 * (np.abs(force) - friction), 0.0, np.abs(force))
    at_rest[rotary] += np.linalg.lstsq(stiffness, carried, rcond=None)[0]
    return at_rest


def _force_at_rest(machine: Machine, position: Array) -> Array:
    """Return the force of the effects on each coordinate of a machine at rest (coordinates,), N or Nm."""
    positions = np.tile(position, (2, 1))
    inputs = np.zeros((2, len(machine.drives)))
    return np.asarray(effect_forces(machine, np.array([0.0, 1e-3]), positions, np.zeros_like(positions), inputs)[0])


def model_initial_state(machine: Machine, initial: InitialState) -> Array:
    """Return the state from which a machine is simulated, given the measurements at rest.

    Effects of the machine may change its static equilibrium or the sensors' readings, so the state depends on them.

    Encoders with a known zero determine the angles of their pulleys; all other pulleys are in static equilibrium.
    Until `refine_offsets` has corrected the zeros with a machine that has the effect, static equilibrium is also used
    for an eccentric pulley, and for all pulleys if an effect changes a laser's measurement at rest: the uncorrected
    zeros would attribute the effect to a stretch of the belts.

    Args:
        machine: Machine with its effects; structural effects may have added coordinates.
        initial: Measured initial state.

    Returns:
        Positions, then velocities (zero), in the coordinates' units, shape (2 * coordinates,).
    """
    if not machine.belts:
        return initial.state
    measured = position_from_measurements(machine, initial)
    position = static_equilibrium(machine, measured)
    if initial.offsets_refined or np.array_equal(measured, initial.position):
        eccentric = [machine.coordinate_of_site(e.site) for e in machine.effects if e.definition.rest_angle_offset]
        for i, angle in encoder_angles(machine, initial).items():
            if initial.offsets_refined or machine.coordinate_names[i] not in eccentric:
                position[i] = angle
    return np.concatenate([position, np.zeros_like(position)])


def encoder_angles(machine: Machine, initial: InitialState) -> dict[int, float]:
    """Return the angles at rest of the pulleys whose encoders kept a known zero.

    For a pulley with the effect of eccentricity, the angle is converted to that of a concentric pulley with the same
    belt travel (radius * angle).

    Args:
        machine: Machine with its effects.
        initial: Measured initial state.

    Returns:
        Angle, rad, by index of the coordinate in `Machine.coordinates`; empty if no zero is known.
    """
    angles: dict[int, float] = {}
    for j in np.flatnonzero(initial.offset_known):
        i = machine.coordinate_names.index(machine.sensors[j].coordinate)
        angles[i] = measured = float(initial.state[i])
        for e in machine.effects:
            if e.definition.rest_angle_offset and machine.coordinate_of_site(e.site) == machine.coordinate_names[i]:
                angles[i] += float(e("rest_angle_offset", q=measured, per_radius=1.0 / machine.travel_per_unit[i]))
    return angles


def position_from_measurements(machine: Machine, initial: InitialState) -> Array:
    """Return the positions at rest for which the machine's lasers would give the measured values.

    Effects on the measurements (skew, scale) are inverted iteratively. A measurement beyond the end of a sensor's range
    has no inverse; that position, which other sensors determined, is kept.

    Args:
        machine: Machine with its effects.
        initial: Measured initial state.

    Returns:
        Positions in the coordinates' units, shape (coordinates,).
    """
    position = initial.position.copy()
    names = machine.coordinate_names
    for e in machine.effects:
        if not e.definition.measurement or machine.sensor(e.site).incremental:
            continue
        sensor = machine.sensor(e.site)
        i, other = names.index(sensor.coordinate), machine.other_axis(sensor.coordinate)
        measured, across = float(position[i]), position[names.index(other)] if other else 0.0
        inverse = measured
        for _ in range(_INVERSION_STEPS):
            inverse -= float(e("measurement", r=inverse, across=across)) - measured
        if abs(float(e("measurement", r=inverse, across=across)) - measured) < _INVERSION_TOLERANCE:
            position[i] = inverse
    return position


def encoder_zero_errors(machine: Machine, initial: Sequence[InitialState]) -> Array:
    """Estimate the errors of the encoders' zeros from the static equilibrium of a fitted machine.

    `common_encoder_zeros` assumes that the belts are unstretched on average. A force that acts at rest, from a cable or
    a tilt, stretches them in one direction, and a machine with that force predicts by how much. The error is the median
    over the runs of the measured angle minus the angle in static equilibrium; friction adds to it in either direction.

    Args:
        machine: Fitted machine.
        initial: Measured initial states, one per run.

    Returns:
        Values to add to the assumed zeros, in the sensors' units, shape (sensors,); 0 where the zero is not known.
    """
    errors = np.zeros(len(machine.sensors))
    if not machine.belts:
        return errors
    runs = [
        (encoder_angles(machine, state), static_equilibrium(machine, position_from_measurements(machine, state)))
        for state in initial
    ]
    for j, sensor in enumerate(machine.sensors):
        i = machine.coordinate_names.index(sensor.coordinate)
        excess = [angles[i] - equilibrium[i] for angles, equilibrium in runs if i in angles]
        if excess:
            errors[j] = sensor.row[sensor.coordinate] * float(np.median(excess))
    return errors


def refine_offsets(initial: InitialState, machine: Machine, errors: Array) -> InitialState:
    """Correct the encoder zeros of an initial state, and the pulley angles that follow from them.

    Args:
        initial: Measured initial state.
        machine: Machine with the sensors and coordinates of that state.
        errors: Values to add to the zeros, in the sensors' units, shape (sensors,), see `encoder_zero_errors`.

    Returns:
        Corrected copy, marked by `offsets_refined=True`.
    """
    state = initial.state.copy()
    for j in np.flatnonzero(errors):
        sensor = machine.sensors[j]
        state[machine.coordinate_names.index(sensor.coordinate)] -= errors[j] / sensor.row[sensor.coordinate]
    return dataclasses.replace(initial, state=state, offset=initial.offset + errors, offsets_refined=True)


def initial_state_of_recording(machine: Machine, recording: Recording) -> InitialState:
    """Determine the initial state from which a machine is simulated over a recording.

    This is the initial state that identification uses, for a single run: measurements beyond a sensor's range do not
    count, effects on readings are inverted, pulleys are in static equilibrium. The offsets are those of the simulation
    from that state, so that `simulate(..., offset=initial.offset)` minus the recording is the error that identification
    reports.

    Args:
        machine: Machine, declared or identified.
        recording: The run; outputs may be missing.

    Returns:
        Initial state of the machine and the sensors' offsets; `warnings` lists what could not be determined. If the
            simulation diverges, the offsets are those of the measurements at rest.
    """
    criteria = SelectionCriteria()
    rows = count_resting_rows(recording)
    channels = [[recording.outputs[:, j]] for j in range(len(machine.sensors))]
    quanta = np.array([sensor_quantum(c, s.resolution) for c, s in zip(channels, machine.sensors, strict=True)])
    noise = [sensor_noise(c, [rows], q, s.noise) for c, q, s in zip(channels, quanta, machine.sensors, strict=True)]
    ends = {e.site: (e.parameters["low"], e.parameters["high"]) for e in machine.effects if e.name == "sensor_range"}
    usable = blank_saturated(recording, ends, machine, np.array(noise), criteria)
    initial = estimate_initial_state(usable, machine)
    state = model_initial_state(machine, initial)
    measured = np.isfinite(recording.outputs)

    def readings(state: Array) -> Array:
        return simulate_batch(machine, recording.time_s, recording.inputs, start=state, states=False).readings

    if not initial.position_measured:
        for _ in range(_POSITION_CORRECTIONS):
            state = _corrected_position(machine, state, usable.outputs - readings(state)[0])
    error = np.where(measured, recording.outputs - readings(state), 0.0)
    if not np.isfinite(error).all():
        return dataclasses.replace(initial, state=state)
    offset = sensor_zero_error(error, measured, rows, max_zero_means(machine, quanta))[0, 0]
    return dataclasses.replace(initial, state=state, offset=offset)


def _corrected_position(machine: Machine, state: Array, error: Array) -> Array:
    """Return the state moved rigidly by the median error (n, sensors) of the sensors with a fixed zero."""
    fixed = np.array([not s.incremental for s in machine.sensors]) & np.isfinite(error).any(axis=0)
    if not fixed.any():
        return state
    rigid = rigid_basis(machine)
    mean = np.array([np.nanmedian(error[:, j]) for j in np.flatnonzero(fixed)])
    moved = state.copy()
    moved[: len(rigid)] += rigid @ np.linalg.lstsq(machine.sensor_matrix[fixed] @ rigid, mean, rcond=1e-9)[0]
    return moved
