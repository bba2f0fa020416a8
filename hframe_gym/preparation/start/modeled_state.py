"""The initial state of a run for a given machine.

`measured_state` estimates the position from the measurements alone. With the effects of a machine
(deviations from the nominal model, such as cables and tilt) the estimate is better: effects on measurements
are inverted, and pulleys are in static equilibrium with the forces that act at rest. This also corrects the
zeros of the encoders.

Fits take their initial states from here; `recording_simulation` determines that of a single run for every
command.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, Quanta
from ...machine import AppliedEffect, Machine, Sensor, rest_state, rigid_basis
from ...recordings import Recording
from .belt_stretch import linear_coordinates, static_equilibrium
from .encoder_zeros import EncoderZeros, zero_tolerance
from .measured_state import InitialState, estimate_initial_state

_INVERSION_STEPS = 4  # Each leaves a few hundredths of the error.
_INVERSION_TOLERANCE = 1e-6  # m or rad
_ENCODER_WEIGHT = 1e-3  # of encoders beside lasers, which determine the position where they can
_STRETCH_STEPS = 2  # The force at rest changes little with the stretch of the belts.


def measured_initial_state(
    recording: Recording,
    machine: Machine,
    zeros: EncoderZeros,
    quanta: Quanta,
    alone: InitialState | None = None,
) -> InitialState:
    """Estimate the initial state of a run from its measurements at rest and the encoder zeros of all runs.

    An encoder that stays on counts from the same zero in all runs of a session. Positions follow from
    measurement minus zero:

    - Lasers have a fixed zero and give the positions of the carriages, if they measured at rest.
    - Encoders with a zero of the session give the angles of their pulleys and, without lasers, the positions.
    - An encoder may have been switched on anew before this run. Its zero of the session is not used if it
      puts the pulley further away from static equilibrium than `zero_tolerance` permits (mainly what friction
      can hold). Instead, the pulley is assumed to be in equilibrium at rest, which gives a zero for this run.
    - If only the zeros of the session would give positions (without lasers), and the sensors then disagree
      about the position by more than that tolerance, no zero of the session is used; the result is `alone`.

    Args:
        recording: The run; saturated measurements are NaN.
        machine: Machine with the rig's coordinates, belts and sensors, and its effects.
        zeros: Zeros of the encoders in the session.
        alone: Initial state without zeros of the session. Default: that of `estimate_initial_state`.

    Returns:
        Initial state: positions at rest, m or rad, shape (coordinates,), and zeros of the sensors, m or rad,
        shape (sensors,). Its `warnings` name the encoders whose zero of the session was not used.
    """
    alone = alone or estimate_initial_state(recording, machine)
    if not zeros.known.any() or not machine.belts:
        return alone
    moved = _switched_on_anew(machine, alone, zeros, quanta)
    initial = estimate_initial_state(recording, machine, zeros.without(moved))
    if not moved.any():
        return initial
    channels = ", ".join(np.array(machine.output_channels)[moved])
    warning = (
        f"{channels} does not count from its zero in the other runs, so the encoder was switched on "
        "anew; the belts are assumed to be in static equilibrium at rest."
    )
    return dataclasses.replace(initial, warnings=(*initial.warnings, warning))


def _switched_on_anew(
    machine: Machine, alone: InitialState, zeros: EncoderZeros, quanta: Array
) -> NDArray[np.bool_]:
    """Mark the encoders (sensors,) whose measurements at rest contradict their zero in the session."""
    moved = np.zeros(len(machine.sensors), np.bool_)
    fixed = np.array([s.fixed for s in machine.sensors])
    tolerance = zero_tolerance(machine, zeros, quanta)
    if not alone.position_known:
        # One laser cannot show which of several encoders it contradicts.
        rigid = rigid_basis(machine)
        checked = (zeros.known | fixed) & np.isfinite(alone.zeroed_measurement)
        zeroed = (alone.zeroed_measurement - np.where(zeros.known, zeros.values, 0.0))[checked]
        seen = (machine.sensor_matrix @ rigid)[checked]
        weight = np.where(fixed[checked], 1.0, _ENCODER_WEIGHT)
        position = np.linalg.lstsq(weight[:, None] * seen, weight * zeroed, rcond=None)[0]
        contradicted = np.any(
            np.abs(zeroed - seen @ position)[~fixed[checked]] > tolerance[checked][~fixed[checked]]
        )
        return zeros.known & contradicted
    equilibrium = static_equilibrium(
        machine, _without_measurement_effects(machine, alone, alone.position.copy())
    )
    for j in np.flatnonzero(zeros.known & np.isfinite(alone.zeroed_measurement)):
        i = machine.coordinate_names.index(machine.sensors[j].coordinate)
        row = machine.sensors[j].row[machine.sensors[j].coordinate]
        angle = _angle_of_encoder(machine, int(j), alone.zeroed_measurement[j] - zeros.values[j])
        moved[j] = abs(row) * abs(angle - equilibrium[i]) > tolerance[j]
    return moved


def model_initial_states(machine: Machine, initial: Sequence[InitialState]) -> list[Array]:
    """Return the states from which simulations of runs start, given the measurements at rest of each run.

    The state depends on the machine's effects, which may change measurements and exert forces at rest. If the
    zero of an encoder is known, the encoder gives the angle of its pulley. All other angles are those in
    static equilibrium.

    Zeros that were estimated without an effect may be wrong and would indicate a belt stretch that does not
    exist. Therefore, until `refine_encoder_zeros` has corrected them, the static equilibrium gives the angles
    of eccentric pulleys and of those whose encoder an effect falsifies as well, and the angles of all pulleys
    if an effect changes what a laser measures at rest.

    Args:
        machine: Machine with its effects; structural ones may have added coordinates.
        initial: Measured initial state of each run (positions at rest, zeros of the sensors).

    Returns:
        For each run positions (m, rad), velocities (m/s, rad/s) and states of the effects (SI; zero unless
        estimated), shape (2 * coordinates + effect states,). Velocities are those in `initial`: zero unless
        the run begins in motion. Without belts, added coordinates start at 0.
    """
    if not initial:
        return []
    # Coordinates of structural effects, at rest at 0.
    added = len(machine.coordinates) - len(initial[0].position)
    if machine.belts:
        measured = np.array([_position_from_measurements(machine, state) for state in initial])
        positions = static_equilibrium(machine, measured)
        for i, state in enumerate(initial):
            _set_encoder_angles(machine, state, measured[i], positions[i])
    else:
        positions = np.array([np.pad(state.position, (0, added)) for state in initial])
    states = []
    for position, state in zip(positions, initial, strict=True):
        start = np.concatenate([position, np.pad(state.velocity, (0, added))])
        if len(state.start_offset):
            start += np.concatenate([np.pad(half, (0, added)) for half in np.split(state.start_offset, 2)])
        states.append(dataclasses.replace(state, state=start).start(machine))
    return states


def _set_encoder_angles(machine: Machine, initial: InitialState, measured: Array, positions: Array) -> None:
    """Replace pulley angles in equilibrium by those that encoders with a known zero measure, in place."""
    # Encoders are not used if an effect changes the position that lasers measure and their zeros are not
    # corrected yet.
    if not initial.zeros_refined and not np.array_equal(measured, initial.position):
        return
    falsified = [
        machine.coordinate_of_site(e.site, e.definition.site)
        for e in machine.effects
        if e.definition.rest_angle_offset or e.definition.measurement
    ]
    for i, angle in _encoder_angles(machine, initial).items():
        if initial.zeros_refined or machine.coordinate_names[i] not in falsified:
            positions[i] = angle
    # Friction holds one side; belts pull the other as far as the gap permits.
    for contact in machine.contacts:
        near, far = (machine.coordinate_names.index(name) for name in (contact.near, contact.far))
        stretch = positions[near] - positions[far]
        positions[far] = positions[near] - np.clip(stretch, -contact.half_gap, contact.half_gap)


def _encoder_angles(machine: Machine, initial: InitialState) -> dict[int, float]:
    """Return the angles at rest, rad, by index of each pulley whose encoder has a zero and resolves stretch.

    What effects add to the measurements of the encoder is removed. The angle of an eccentric pulley is that
    of a concentric pulley with the same belt travel.
    """
    angles: dict[int, float] = {}
    for j in np.flatnonzero(initial.resolves_stretch):
        sensor = machine.sensors[j]
        i = machine.coordinate_names.index(sensor.coordinate)
        measured = sensor.row[sensor.coordinate] * float(initial.state[i])
        angles[i] = _angle_of_encoder(machine, int(j), measured)
    return angles


def _angle_of_encoder(machine: Machine, j: int, measured: float) -> float:
    """Convert what encoder j measures at rest, minus its zero, to the angle of a concentric pulley, rad."""
    sensor = machine.sensors[j]
    angle = _without_errors_of_sensor(machine, j, measured) / sensor.row[sensor.coordinate]
    return _concentric_angle(machine, machine.coordinate_names.index(sensor.coordinate), angle)


def _concentric_angle(machine: Machine, index: int, angle: float) -> float:
    """Convert an eccentric pulley's angle at rest to that of a concentric one with the same belt travel, rad.

    A simulation starts from the angles of concentric pulleys, whose belt travel is radius * angle. The
    conversion is accurate to first order in the eccentricity.
    """
    converted = angle
    # The formula of eccentricity gives the difference of the two angles, rad.
    for e in machine.effects:
        moved = machine.coordinate_of_site(e.site, e.definition.site)
        if e.definition.rest_angle_offset and moved == machine.coordinate_names[index]:
            converted += float(
                e("rest_angle_offset", q=angle, per_radius=1.0 / machine.travel_per_unit[index])
            )
    return converted


def _position_from_measurements(machine: Machine, initial: InitialState) -> Array:
    """Return the true positions (coordinates,) from measurements at rest that the machine's effects falsify.

    Effects on lasers (skew, scale) are inverted iteratively. For a laser that measured nothing at rest, the
    encoders give the position, corrected for eccentric pulleys and for the belt stretch that forces cause at
    rest.
    """
    if initial.lasers_measured or not machine.effects:
        return _without_measurement_effects(machine, initial, initial.position.copy())
    measured = np.flatnonzero(np.isfinite(initial.zeroed_measurement))
    encoders = [j for j in measured if machine.sensors[j].incremental]
    # The stretch depends on the position and the position on the stretch: a few alternating steps solve both.
    stretch = np.zeros(len(machine.sensors))  # rad
    position = initial.position
    for _ in range(_STRETCH_STEPS):
        zeroed = np.nan_to_num(initial.zeroed_measurement)
        for j in encoders:
            row = machine.sensors[j].row[machine.sensors[j].coordinate]
            zeroed[j] = row * _angle_of_encoder(machine, int(j), zeroed[j]) - stretch[j]
        unstretched = initial.position_matrix @ zeroed
        position = _without_measurement_effects(machine, initial, unstretched)
        at_rest = rest_state(machine, position[linear_coordinates(machine)[: len(position)]])
        held = static_equilibrium(machine, position) - at_rest[: len(machine.coordinates)]
        stretch = machine.sensor_matrix @ held
    return position


def _without_measurement_effects(machine: Machine, initial: InitialState, position: Array) -> Array:
    """Invert the effects on the measurements of lasers in positions (coordinates,), in place."""
    names = machine.coordinate_names
    for j, sensor in enumerate(machine.sensors):
        if not sensor.fixed or not sensor.of_position:
            continue
        if len(initial.zeroed_measurement) and not np.isfinite(initial.zeroed_measurement[j]):
            continue  # Encoders determined this position.
        i, other = names.index(sensor.coordinate), machine.other_axis(sensor.coordinate)
        across = float(position[names.index(other)]) if other else 0.0
        position[i] = _without_errors_of_sensor(machine, j, float(position[i]), across)
    return position


def _without_errors_of_sensor(machine: Machine, j: int, measured: float, across: float = 0.0) -> float:
    """Invert the effects on the measurement of sensor j, m or rad; effects that have no inverse stay.

    Args:
        across: Position of the other linear coordinate, m.
    """
    channel, sensor = machine.output_channels[j], machine.sensors[j]
    effects = [e for e in machine.effects if e.site == channel and e.definition.measurement]
    for e in sorted(effects, key=lambda e: e.definition.signal_order, reverse=True):
        inverse = measured
        for _ in range(_INVERSION_STEPS):
            inverse -= _measured(e, sensor, inverse, across) - measured
        if abs(_measured(e, sensor, inverse, across) - measured) < _INVERSION_TOLERANCE:
            measured = inverse
    return measured


def _measured(effect: AppliedEffect, sensor: Sensor, value: float, across: float) -> float:
    """Return what a sensor with an effect measures, m or rad, where its measurement should be `value`."""
    q = value / sensor.row[sensor.coordinate]
    return float(effect("measurement", r=value, q=q, across=across))


def encoder_zero_errors(machine: Machine, initial: Sequence[InitialState]) -> Array:
    """Estimate errors of the encoders' zeros from the equilibrium of a fitted machine.

    `common_encoder_zeros` assumes that the belts are unstretched on average over the runs. This is wrong if a
    force at rest, from a cable or a tilt, always stretches them in the same direction.

    A machine with that force predicts the angle of each pulley in static equilibrium. The measured minus the
    predicted angle is an estimate of the error. The median over the runs is used, because friction acts in
    both directions.

    The prediction needs the positions of the carriages. In runs with a laser measurement at rest, they do not
    depend on the encoders. In other runs they come from the encoders themselves. Such runs show only those
    errors by which the encoders contradict each other, and are used only if there are no others.

    Args:
        machine: Fitted machine with its effects.
        initial: Measured initial states, one per run.

    Returns:
        Values to add to the assumed zeros, in the unit of each sensor (encoder on a pulley: rad; others: m),
        shape (sensors,); 0 where the zero is not known.
    """
    errors = np.zeros(len(machine.sensors))
    if not machine.belts:
        return errors
    located = [state for state in initial if state.lasers_measured] or initial
    runs = [
        (
            _encoder_angles(machine, state),
            static_equilibrium(machine, _position_from_measurements(machine, state)),
        )
        for state in located
    ]
    for j, sensor in enumerate(machine.sensors):
        if not sensor.of_position:
            continue
        i = machine.coordinate_names.index(sensor.coordinate)
        # Measured minus predicted angle of the pulley in each run, rad.
        excess = [angles[i] - equilibrium[i] for angles, equilibrium in runs if i in angles]
        if excess:
            errors[j] = sensor.row[sensor.coordinate] * float(np.median(excess))
    return errors
