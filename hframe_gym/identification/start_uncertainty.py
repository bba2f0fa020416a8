"""The uncertainty that the measurements at rest leave about the initial state of a run, and its estimate from the run.

Static friction holds an unknown stretch of the belts when a run begins: encoders behind belts do not resolve it, and an
encoder that was switched on anew does not measure it at all. Where no laser measures at rest, the position is uncertain
as well. A bristle or a cable with hysteresis remembers motion that was not recorded. The motion that follows depends on
all of these unknowns. A fit removes the response to them from its residual (variable projection); a simulation over a
recording starts from the most probable state.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from ..dynamics import Equations
from ..machine import Machine
from .dataset import Dataset, PreparedRecording
from .encoder_zeros import stretch_angles, vibration_speeds
from .initial_state import refine_encoder_zeros
from .lost_voltages import estimate_lost_voltages
from .prediction import POLISH_STEP, SEARCH_STEP, SIMULATION, map_runs, predict, residuals
from .rest_measurement import InitialState, rigid_basis

Array = NDArray[np.float64]
_UNMEASURED_POSITION = 2e-4  # m; error of a position that follows from later measurements
# Iterations of `most_probable_start`, fractions of a step that it tries, and its differences in standard deviations.
_ITERATIONS, _FRACTIONS, _DIFFERENCE = 4, np.array([1.0, 0.5, 0.25, 0.1]), 0.3
_SMALLEST_DECREASE = 0.01  # of the cost per iteration, below which `most_probable_start` ends


@dataclass(frozen=True)
class InitialStateProjection:
    """Projection that removes from residuals what an uncertain initial state, such as a belt stretch, explains.

    Attributes:
        directions: Orthonormal responses of the residual to s independent displacements of the initial state, shape
            (rows, s).
        weights: Fraction of the residual along each direction that is removed, 0 (the prior determines the
            displacement) to 1 (the data determine it), shape (s,).
    """

    directions: Array
    weights: Array

    def __call__(self, residual: Array) -> Array:
        """Remove the part of residuals that the optimal displacement of the initial state explains, given its prior.

        Args:
            residual: Residuals of a batch of predictions, in units of the noise, shape (batch, rows).

        Returns:
            Projected residuals, same shape; their sum of squares is the cost at the optimal displacement.
        """
        return residual - (residual @ self.directions) * self.weights @ self.directions.T


def initial_state_projection(
    machine: Machine,
    run: PreparedRecording,
    data: Dataset,
    bandwidth: float,
    *,
    initial_state: Array | None = None,
    longest_step: float = SEARCH_STEP,
    rows_per_block: int = 1,
) -> InitialStateProjection | None:
    """Return the projection that removes from residuals what an uncertain initial state explains.

    The initial state is uncertain mainly because static friction holds an unknown stretch of the belts at rest.
    `start_displacements` lists all uncertain displacements and their standard deviations (Gaussian prior). The run is
    simulated once for each of them, which linearizes the residual. The sum of squares of a projected residual equals
    the cost, prior included, at the best displacements (variable projection). A fit therefore need not estimate them.

    Args:
        machine: Machine that predicts.
        run: Run to predict.
        data: Data set of the run.
        bandwidth: Bandwidth of the observer that corrects the prediction by the measurements, rad/s; 0 for none.
        initial_state: Positions (m, rad), velocities (m/s, rad/s), effect states (SI), shape (2 * coordinates + effect
            states,). Default: `run.initial_state(machine)`.
        longest_step: Maximum integration step, s.
        rows_per_block: Number of consecutive rows that are combined into one (sum / square root of the number).

    Returns:
        Projection for residuals and for columns of a Jacobian, shape (batch, rows). None if nothing is uncertain or the
        simulation diverges.

    References:
        Golub and Pereyra (1973), variable projection.
    """
    displacements = start_displacements(machine, run.initial)
    if not len(displacements):
        return None
    state = run.initial_state(machine) if initial_state is None else initial_state
    initial_states = np.tile(state, (len(displacements) + 1, 1))
    initial_states[1:] += displacements
    motion = predict(
        machine,
        run,
        bandwidth,
        period=data.period,
        initial_state=initial_states,
        extra_measurement=_displaced_zeros(machine, run, initial_states) if bandwidth else None,
        longest_step=longest_step,
    )
    residual = residuals(run, data, motion.readings, rows_per_block)
    columns = (residual[1:] - residual[0]).T  # (rows, displacements), in units of the prior's standard deviation
    if not np.all(np.isfinite(columns)):
        return None
    # The squared norm of the projected residual is the minimum over w of |residual - columns w|^2 + |w|^2.
    directions, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return InitialStateProjection(directions, 1.0 - 1.0 / np.hypot(1.0, sizes))  # no overflow close to divergence


def _displaced_zeros(machine: Machine, run: PreparedRecording, initial_states: Array) -> Array:
    """Return the changes of the encoders' zeros that displaced initial states imply, shape (batch, n, sensors).

    An encoder without a known zero counts from the state at the start. If that state is displaced, all of its
    measurements are, which an observer feeds back throughout the run.
    """
    unknown = np.array([sensor.incremental for sensor in machine.sensors]) & ~run.initial.resolves_stretch
    positions = initial_states[:, : len(machine.coordinates)]
    changes = np.where(unknown, (positions - positions[0]) @ machine.sensor_matrix.T, 0.0)  # (batch, sensors)
    return np.repeat(-changes[:, None], len(run.time_s), axis=1)


def prediction_residuals(
    machine: Machine, run: PreparedRecording, data: Dataset, bandwidth: float, *, longest_step: float = SEARCH_STEP
) -> Array:
    """Return a machine's prediction errors over a run, each divided by the standard deviation of the sensor's noise.

    The part of the errors that an unknown initial stretch of the belts (or another unknown part of the initial state)
    can explain is removed, as in a fit.

    Args:
        machine: Machine that predicts.
        run: Run to predict (times, voltages, measurements, SI), n samples.
        data: Data set of the run.
        bandwidth: Bandwidth of the observer that corrects predictions by the measurements, rad/s; 0 for a simulation.
        longest_step: Maximum integration step, s.

    Returns:
        Residuals, dimensionless, shape (n * sensors,), 0 where not measured; not finite if the prediction diverges.
    """
    motion = predict(machine, run, bandwidth, period=data.period, longest_step=longest_step)
    residual = residuals(run, data, motion.readings)
    projection = initial_state_projection(machine, run, data, bandwidth, longest_step=longest_step)
    return np.ravel(residual if projection is None else projection(residual))


def start_displacements(machine: Machine, initial: InitialState) -> Array:
    """Return the independent displacements by which the state at the start of a run may differ from the measured one.

    They have four causes:

    - Static friction holds an unknown stretch of the belts: one displacement per pulley with an encoder.
    - In a machine with belts, lasers (sensors with a fixed zero) do not measure the complete position before the motion
      begins: one displacement per motion that stretches no belt and that no laser measures at rest.
    - The run begins in motion, and its first measurements show the velocity inaccurately: one per motion that stretches
      no belt, and one per pulley with an encoder, because the belts vibrate.
    - An effect such as hysteresis remembers motion before the recording: one per state of an effect that defines an
      `initial_spread`.

    Args:
        machine: Machine whose simulation starts from this state.
        initial: Measured initial state of the run.

    Returns:
        Displacements, one per row, each of the size of one standard deviation: positions (m, rad), velocities (m/s,
        rad/s), states of the effects (SI), shape (displacements, 2 * coordinates + effect states).
    """
    held_angles = stretch_angles(machine, moving=len(initial.velocity_deviations) > 0)
    velocities = _velocity_displacements(machine, initial)
    displacements = np.zeros((len(held_angles), len(machine.coordinates)))
    for k, (name, angle) in enumerate(held_angles.items()):
        displacements[k, machine.coordinate_names.index(name)] = angle
    if held_angles and not initial.lasers_measured:
        displacements = np.vstack([displacements, _rigid_displacements(machine, initial, held_angles)])
    spreads = _effect_state_spreads(machine)
    of_effects = np.diag(spreads)[spreads > 0.0]
    count = len(machine.coordinates)
    blocks = (
        np.pad(displacements, ((0, 0), (0, count + len(spreads)))),
        np.pad(velocities, ((0, 0), (count, len(spreads)))),
        np.pad(of_effects, ((0, 0), (2 * count, 0))),
    )
    return np.vstack(blocks)


def _velocity_displacements(machine: Machine, initial: InitialState) -> Array:
    """Return the uncertain velocities of a run that begins in motion, each of the size of its error (k, coordinates).

    Beside the motions that stretch no belt, every pulley vibrates against the belts.
    """
    rigid, count = initial.velocity_deviations, len(machine.coordinates)
    if not len(rigid):
        return np.zeros((0, count))
    speeds = vibration_speeds(machine)
    vibrations = [machine.coefficients({name: 1.0}) * speed for name, speed in speeds.items()]
    # `rigid` lacks the coordinates of structural effects, which are the last ones.
    return np.vstack([np.pad(rigid, ((0, 0), (0, count - rigid.shape[1]))), *vibrations])


def _effect_state_spreads(machine: Machine) -> Array:
    """Return the standard deviation of each effect's state at the start, in its unit, shape (effect states,)."""
    equations = Equations(machine)
    spreads = []
    for k in equations.states:
        effect, i = equations.instances[k].effect, equations.instances[k].coordinate
        level = machine.coordinates[i].coulomb if i >= 0 else 0.0
        known = effect.definition.initial_spread is None
        spreads.append(0.0 if known else float(equations.evaluate(effect, "initial_spread", {"level": level})))
    return np.array(spreads)


def _rigid_displacements(machine: Machine, initial: InitialState, held_angles: dict[str, float]) -> Array:
    """Return the rigid motions that no laser measured at rest, of the size of their uncertainty, (k, coordinates)."""
    travel = [angle * machine.coordinate(name).travel_per_unit for name, angle in held_angles.items()]
    size = max(travel) if initial.position_measured else _UNMEASURED_POSITION
    rigid = rigid_basis(machine)
    lasers = np.array([not sensor.incremental for sensor in machine.sensors]) & initial.measured_at_rest
    unseen = rigid @ null_space((machine.sensor_matrix @ rigid)[lasers])  # (coordinates, k)
    linear = [c.kind == "linear" for c in machine.coordinates]
    return np.asarray(size * (unseen / np.linalg.norm(unseen[linear], axis=0)).T)


def most_probable_initial_state(machine: Machine, run: PreparedRecording, data: Dataset) -> Array:
    """Return the state from which a run most probably began, given all of its measurements.

    It is the state of maximum posterior density: it fits the measurements and is near the state measured at rest.
    An effect is a deviation from the nominal model. Some effects, such as hysteresis and bristle friction, have states
    of their own, which remember motion before the run.

    Args:
        machine: Machine to simulate, with its effects.
        run: Run as `prepare` returns it: times, voltages, measurements minus the sensors' zeros, initial state.
        data: Data set of the run, for the sampling period and the sensors' quantization steps.

    Returns:
        Positions (m, rad), velocities (m/s, rad/s) and states of the effects (SI), shape (2 * coordinates + effect
        states,).
    """

    def errors(states: Array) -> Array:
        motion = predict(machine, run, SIMULATION, period=data.period, initial_state=states, longest_step=POLISH_STEP)
        return residuals(run, data, motion.readings, fitted=False)  # as `recording_simulation` does for a single run

    # Only positions and velocities are passed: the effects' states are estimated anew, starting from 0.
    state = run.initial_state(machine)[: 2 * len(machine.coordinates)]
    return most_probable_start(machine, run.initial, state, errors)


def refine_dataset(data: Dataset, machine: Machine, reference: Dataset | None = None) -> Dataset:
    """Copy a data set, with the values corrected that were estimated from the recordings without a fitted machine.

    - Zeros of encoders (measurements at position 0): forces that stretch the belts at rest falsify their estimate.
    - Voltages in rows that the logger dropped, which were interpolated: see `estimate_lost_voltages`.
    - Initial states of effects that remember motion before the recording, such as hysteresis. They must be close to the
      true ones, because a fit linearizes the influence of their uncertainty.

    Args:
        data: Data set to correct (times, voltages, measurements, SI).
        machine: Fitted machine with its effects (deviations from the nominal model).
        reference: Data set to which the machine was fitted; the errors of the zeros are estimated from it.
            Default: `data`.

    Returns:
        Copy with corrected initial states, voltages, V, shape (n, drives), and measurements minus the corrected zeros,
        m or rad, shape (n, sensors), of each run; `data` itself if there is nothing to correct.
    """
    data = estimate_lost_voltages(refine_encoder_zeros(data, machine, reference), machine)
    if not np.any(_effect_state_spreads(machine) > 0.0):
        return data

    def refined(run: PreparedRecording) -> PreparedRecording:
        start = most_probable_initial_state(machine, run, data)
        states = run.initial.with_start(machine, start).effect_states
        return dataclasses.replace(run, initial=dataclasses.replace(run.initial, effect_states=states))

    return dataclasses.replace(data, runs=tuple(map_runs(refined, data)))


def most_probable_start(
    machine: Machine, initial: InitialState, state: Array, errors: Callable[[Array], Array]
) -> Array:
    """Return the state from which a run most probably began, given all of its measurements.

    It is the state of maximum posterior density. It minimizes the sum of squared simulation errors in units of the
    noise plus the sum of squared displacements from the measured state in units of their standard deviations. The
    squared errors of an inaccurate model are first divided by their mean if it exceeds 1.

    Args:
        machine: Machine to simulate. Its effects (deviations from the nominal model) may have states that remember
            earlier motion, such as hysteresis.
        initial: Measured initial state of the run.
        state: Positions (m, rad), then velocities (m/s, rad/s), by the measurements at rest, shape (2 * coordinates,).
        errors: Function that simulates from states, shape (B, 2 * coordinates + effect states), and returns measured
            minus simulated values in units of the noise, shape (B, values), not finite where the simulation diverges.

    Returns:
        Positions (m, rad), velocities (m/s, rad/s) and effect states (SI), shape (2 * coordinates + effect
        states,). If nothing is uncertain or the simulation diverges: `state` itself, with effect states of zero.

    References:
        Nocedal and Wright (2006), "Numerical optimization", chapter 10 (Gauss-Newton method with a line search).
    """
    displacements = start_displacements(machine, initial)
    count = len(displacements)
    state = np.pad(state, (0, displacements.shape[1] - len(state)))
    best = np.zeros(count)  # displacements in units of their standard deviations
    differences = _DIFFERENCE * np.vstack([np.zeros((1, count)), np.eye(count), -np.eye(count)])
    for _ in range(_ITERATIONS if count else 0):
        error = errors(state + (best + differences) @ displacements)
        if not np.isfinite(error).all():
            break
        now = error[0]
        response = (error[1 : count + 1] - error[count + 1 :]) / (2.0 * _DIFFERENCE)  # (displacements, values)
        excess = max(1.0, float(np.mean(now**2)))  # mean square error in units of the noise
        weight = 1.0 / np.sqrt(excess)
        # Of full rank by the identity, however large the response is; the normal equations would lose it.
        step = np.linalg.lstsq(
            np.vstack([weight * response.T, np.eye(count)]), np.concatenate([weight * now, best]), rcond=None
        )[0]
        trials = best - _FRACTIONS[:, None] * step
        with np.errstate(invalid="ignore", over="ignore"):
            costs = np.sum(errors(state + trials @ displacements) ** 2, axis=1) / excess + np.sum(trials**2, axis=1)
        cost = float(now @ now) / excess + float(best @ best)
        lowest = int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))
        if not costs[lowest] < cost:
            break
        best = trials[lowest]
        if cost - costs[lowest] < _SMALLEST_DECREASE * cost:
            break
    return np.asarray(state + best @ displacements)
