"""The uncertain start of a run: what may be wrong with it, and how residuals are freed from its influence.

Static friction holds an unknown stretch of the belts when a run begins: encoders behind belts do not resolve
it, and an encoder that was switched on anew does not measure it at all. Where no laser measures at rest, the
position is uncertain as well. A bristle or a cable with hysteresis remembers motion that was not recorded. A
fit removes the response to all of these from its residual (variable projection); `start_estimation` estimates
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space

from ...arrays import Array
from ...dynamics import Equations
from ...dynamics.simulation import Motion, parameter_batch
from ...machine import Machine, carried_through_contacts, rigid_basis
from ...preparation.dataset import Dataset, PreparedRecording
from ...preparation.start.belt_stretch import linear_coordinates, stretch_angles, vibration_speeds
from ...preparation.start.measured_state import InitialState
from ...preparation.start.modeled_state import model_initial_states
from .prediction import SEARCH_STEP, predict, residuals, whitened

# Fraction of a standard deviation over which the influence of an effect's state is computed. The friction of
# a contact that rested for an unknown time is known to five e-folds only. Over all of them, its influence is
# far from linear: a fit that took it as linear walked along a valley to twenty times the right force; with
# fractions of 0.01 to 0.3, it ends at the right one.
_STATE_DIFFERENCE = 0.1
_UNMEASURED_POSITION = 2e-4  # m; standard deviation of a start that is estimated from later measurements


class UncertainStart(NamedTuple):
    """Initial state for the prediction of a run, with its uncertainty.

    Attributes:
        state: Positions (m, rad), velocities (m/s, rad/s), effect states (SI),
            shape (2 * coordinates + states,).
        displacements: Independent displacements of this state, one per row, each of the size of one standard
            deviation, shape (displacements, 2 * coordinates + states); no rows if nothing is uncertain.
        differences: Fraction of each displacement over which its influence is computed,
            shape (displacements,).
    """

    state: Array
    displacements: Array
    differences: Array

    @property
    def displaced_states(self) -> Array:
        """State plus the fraction `differences` of each displacement, SI, shape (displacements, state)."""
        return self.state + self.differences[:, None] * self.displacements


def uncertain_starts(machine: Machine, runs: Sequence[PreparedRecording]) -> dict[str, UncertainStart]:
    """Return the initial state of each run for predictions by a machine, with its uncertainty.

    Args:
        machine: Machine that predicts; its effects also determine the state.
        runs: Runs to predict. What depends on the machine alone is computed once for all of them.

    Returns:
        State, shape (2 * coordinates + effect states,), and displacements (`start_displacements`), by name of
        the run.
    """
    states = model_initial_states(machine, [run.initial for run in runs])
    displacements = start_displacements(machine, [run.initial for run in runs])
    coordinates = len(machine.coordinates)
    starts = [
        UncertainStart(state, rows, np.where(rows[:, 2 * coordinates :].any(axis=1), _STATE_DIFFERENCE, 1.0))
        for state, rows in zip(states, displacements, strict=True)
    ]
    return dict(zip((run.name for run in runs), starts, strict=True))


def start_displacements(machine: Machine, initial: Sequence[InitialState]) -> list[Array]:
    """Return the independent displacements by which states at the start may differ from the measured ones.

    They have four causes:

    - Static friction holds an unknown stretch of the belts: one displacement per pulley with an encoder.
    - In a machine with belts, lasers (sensors with a fixed zero) do not measure the complete position before
      the motion begins: one displacement per motion that stretches no belt and that no laser measures at
      rest.
    - The run begins in motion, and its first measurements show the velocity inaccurately: one per motion that
      stretches no belt, and one per pulley with an encoder, because the belts vibrate.
    - An effect such as hysteresis remembers motion before the recording: one per state of an effect that
      defines an `initial_spread`, and two per coordinate that such an effect adds, because it may swing.

    Args:
        machine: Machine whose simulation starts from these states.
        initial: Measured initial state of each run.

    Returns:
        For each run its displacements, one per row, each of the size of one standard deviation: positions (m,
        rad), velocities (m/s, rad/s), states of the effects (SI), shape (displacements, 2 * coordinates +
        effect states).
    """
    count, spreads = len(machine.coordinates), effect_state_spreads(machine)
    of_effects, swinging = np.diag(spreads)[spreads > 0.0], _added_displacements(machine)
    # The typical stretch depends on the machine, and on whether the run begins in motion.
    angles = {
        moving: stretch_angles(machine, moving=moving)
        for moving in {len(state.velocity_deviations) > 0 for state in initial}
    }
    displacements = []
    for state in initial:
        positions = _position_displacements(machine, state, angles[len(state.velocity_deviations) > 0])
        velocities = _velocity_displacements(machine, state)
        # Columns: positions, velocities, states of effects.
        blocks = ((positions, 0), (velocities, count), (of_effects, 2 * count), (swinging, 0))
        table = np.zeros((sum(len(block) for block, _ in blocks), 2 * count + len(spreads)))
        row = 0
        for block, column in blocks:
            table[row : row + len(block), column : column + block.shape[1]] = block
            row += len(block)
        displacements.append(table)
    return displacements


def _position_displacements(machine: Machine, initial: InitialState, held_angles: dict[str, float]) -> Array:
    """Return the uncertain positions of a run, each of the size of its error, shape (k, coordinates).

    Zeros that scatter from run to run show the stretch that friction holds on this rig; a zero is then
    uncertain, too.
    """
    spreads = {
        sensor.coordinate: spread / abs(sensor.row[sensor.coordinate])
        for sensor, spread in zip(machine.sensors, initial.zero_spread, strict=True)
        if sensor.of_position
    }
    stretches = np.zeros((len(held_angles), len(machine.coordinates)))
    for k, (name, angle) in enumerate(held_angles.items()):
        stretches[k, machine.coordinate_names.index(name)] = max(angle, spreads.get(name, 0.0))
    stretches = carried_through_contacts(machine, stretches)
    if not held_angles or initial.lasers_measured:
        return stretches
    return np.vstack([stretches, _rigid_displacements(machine, initial, held_angles)])


def _velocity_displacements(machine: Machine, initial: InitialState) -> Array:
    """Return uncertain velocities of a run that begins in motion, as large as their error (k, coordinates).

    Beside the motions that stretch no belt, every pulley vibrates against the belts.
    """
    rigid, count = initial.velocity_deviations, len(machine.coordinates)
    if not len(rigid):
        return np.zeros((0, count))
    speeds = vibration_speeds(machine)
    vibrations = np.array([machine.coefficients({name: 1.0}) * speed for name, speed in speeds.items()])
    vibrations = carried_through_contacts(machine, vibrations.reshape(-1, count))
    # `rigid` lacks the coordinates of structural effects, which are the last ones.
    return np.vstack([np.pad(rigid, ((0, 0), (0, count - rigid.shape[1]))), vibrations])


def _added_displacements(machine: Machine) -> Array:
    """Return uncertain positions and speeds of coordinates that effects add, each of the size of its error.

    The shape is (k, 2 * coordinates). Effects without `initial_spread` add coordinates that rest at zero.
    """
    equations, rows = Equations(machine), []
    for effect in machine.effects:
        if effect.coordinate and effect.definition.initial_spread:
            quantities = {
                "m": machine.coordinate(effect.coordinate).mass,
                "level": machine.coordinate(effect.site).coulomb,
            }
            position, speed = equations.evaluate(effect, "initial_spread", quantities)
            there = machine.coefficients({effect.coordinate: 1.0})
            rows += [np.append(position * there, 0.0 * there), np.append(0.0 * there, speed * there)]
    return np.array(rows).reshape(len(rows), 2 * len(machine.coordinates))


def effect_state_spreads(machine: Machine) -> Array:
    """Return the standard deviations of the effects' internal states at the start of a run.

    Returns:
        Standard deviations, SI, in the order of the effects' states, shape (effect states,); 0 for a state
        that is zero at rest, such as the current of a motor.
    """
    equations = Equations(machine)
    spreads = []
    for k in equations.states:
        instance = equations.instances[k]
        effect, i = instance.effect, instance.coordinate
        quantities = {"level": machine.coordinates[i].coulomb if i >= 0 else 0.0}
        if effect.definition.site in ("drive", "drives"):
            drive = machine.drive(instance.component)
            quantities |= {"N": drive.gear_ratio, "i": drive.rated_voltage / drive.resistance}
        known = effect.definition.initial_spread is None
        spreads.append(0.0 if known else float(equations.evaluate(effect, "initial_spread", quantities)))
    return np.array(spreads)


def _rigid_displacements(machine: Machine, initial: InitialState, held_angles: dict[str, float]) -> Array:
    """Return the rigid motions that no laser measured at rest, as large as uncertain, (k, coordinates)."""
    travel = [angle * machine.coordinate(name).travel_per_unit for name, angle in held_angles.items()]
    size = max(travel) if initial.position_measured else _UNMEASURED_POSITION
    rigid = rigid_basis(machine)
    lasers = np.array([sensor.fixed for sensor in machine.sensors]) & initial.measured_at_rest
    unseen = rigid @ null_space((machine.sensor_matrix @ rigid)[lasers])  # (coordinates, k)
    return np.asarray(size * (unseen / np.linalg.norm(unseen[linear_coordinates(machine)], axis=0)).T)


@dataclass(frozen=True)
class InitialStateProjection:
    """Projection that removes from residuals what an uncertain initial state (a belt stretch) explains.

    The squared norm of a projected residual r is the minimum over w of |r - C w|^2 + |w|^2, where the columns
    of C are the changes of r by displacements of the initial state, each of the size of one standard
    deviation (variable projection). A fit therefore need not estimate the displacements w.

    Attributes:
        directions: Orthonormal basis of the s columns of C, shape (rows, s).
        weights: Fraction of the residual along each direction that is removed, 0 (the prior determines the
            displacement) to 1 (the data determine it), shape (s,).

    References:
        Golub and Pereyra (1973), variable projection.
    """

    directions: Array
    weights: Array

    @classmethod
    def from_displaced(
        cls, residual: Array, displaced: Array, differences: Array
    ) -> InitialStateProjection | None:
        """Build the projection from the residuals of predictions that start from displaced states.

        Args:
            residual: Residual of the prediction from the undisplaced state, in units of the noise, shape
                (rows,).
            displaced: Residuals of predictions from `UncertainStart.displaced_states`,
                shape (displacements, rows).
            differences: The fractions of the displacements that these states have, shape (displacements,).

        Returns:
            Projection for residuals of shape (batch, rows); None without displacements, or if a prediction
            diverges.
        """
        columns = (displaced - residual).T / differences
        if not columns.shape[1] or not np.all(np.isfinite(columns)):
            return None
        directions, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        return cls(directions, 1.0 - 1.0 / np.hypot(1.0, sizes))  # no overflow close to divergence

    def __call__(self, residual: Array) -> Array:
        """Remove what the optimal displacement of the initial state explains of residuals, given its prior.

        Args:
            residual: Residuals of a batch of predictions, in units of the noise, shape (batch, rows).

        Returns:
            Projected residuals, same shape; their sum of squares is the cost at the optimal displacement.
        """
        explained = (residual @ self.directions) * self.weights
        projected_rows = explained @ self.directions.T
        return np.subtract(residual, projected_rows, out=projected_rows)

    def costs(self, residual: Array) -> Array:
        """Return the sum of squares of each residual after the projection, shape (batch,).

        Args:
            residual: Residuals of a batch of predictions, in units of the noise, shape (batch, rows).

        Returns:
            Sums of squares, shape (batch,); infinite where a square is, close to divergence.
        """
        along = residual @ self.directions
        removed = self.weights * (2.0 - self.weights)  # 1 - (1 - weights)^2, of each square of along
        with np.errstate(over="ignore", invalid="ignore"):  # a square of a divergent prediction is infinite
            costs = np.einsum("bi,bi->b", residual, residual) - along**2 @ removed
        return np.where(np.isfinite(costs), costs, np.inf)


def probable_amounts(residual: Array, displaced: Array, differences: Array) -> Array:
    """Estimate the most probable displacement of a run's start from the measured initial state.

    Args:
        residual: Residual of the prediction from the undisplaced state, in units of the noise, shape (rows,).
        displaced: Residuals of predictions from `UncertainStart.displaced_states`,
            shape (displacements, rows).
        differences: The fractions of the displacements that these states have, shape (displacements,).

    Returns:
        Amounts w that minimize |r + C w|^2 + |w|^2 (`InitialStateProjection`), in standard deviations, shape
        (displacements,); zero if a prediction diverges.
    """
    columns = (displaced - residual).T / differences
    if not np.all(np.isfinite(columns)):
        return np.zeros(len(displaced))
    return np.asarray(
        np.linalg.solve(columns.T @ columns + np.eye(len(displaced)), -columns.T @ residual), np.float64
    )


def projected(
    residuals_of_predictions: Array, differences: Array
) -> tuple[Array, InitialStateProjection | None]:
    """Remove from residuals what an uncertain initial state explains.

    Args:
        residuals_of_predictions: Residuals in units of the noise, shape (batch + displacements, rows). The
            first one is that of the prediction around which the initial state is displaced; the last ones are
            those of the displaced states, from `predict_with_displaced_starts`.
        differences: The fractions of the displacements that the displaced states have,
            shape (displacements,).

    Returns:
        residuals: Projected residuals, without those of the displaced states, shape (batch, rows).
        projection: Projection for further residuals, shape (batch, rows). None if nothing is uncertain or a
            prediction diverges.
    """
    batch, displaced = np.split(residuals_of_predictions, [len(residuals_of_predictions) - len(differences)])
    projection = InitialStateProjection.from_displaced(batch[0], displaced, differences)
    return (batch if projection is None else projection(batch)), projection


def predict_with_displaced_starts(
    machine: Machine,
    run: PreparedRecording,
    bandwidth: float,
    start: UncertainStart,
    *,
    period: float,
    parameters: Array | None = None,
    longest_step: float = SEARCH_STEP,
    states: bool = False,
) -> Motion:
    """Predict a run for several sets of parameters, and from displaced initial states, as one batch.

    Args:
        run: Run to predict, n samples.
        bandwidth: Bandwidth of the observer, rad/s; 0 for none.
        start: State from which the run is predicted, with s displacements.
        period: Sampling period, s.
        parameters: Parameters, SI, as in `Machine.parameters`, shape (batch, parameters); the first set is
            also that for the displaced states. Default: those of the machine, a batch of one.
        longest_step: Maximum integration step, s.
        states: Whether to return positions and velocities too.

    Returns:
        Motion as from `predict`, shape (batch + s, n, ...): first the sets of parameters, then the displaced
        states.
    """
    table = parameter_batch(machine) if parameters is None else parameters
    displaced = start.displaced_states
    rows = np.vstack([table, np.repeat(table[:1], len(displaced), axis=0)])
    initial_states = np.vstack([np.tile(start.state, (len(table), 1)), displaced])
    return predict(
        machine,
        run,
        bandwidth,
        period=period,
        parameters=rows,
        initial_state=initial_states,
        extra_measurement=_displaced_zeros(machine, run, initial_states)
        if run.bandwidth(bandwidth)
        else None,
        longest_step=longest_step,
        states=states,
    )


def _displaced_zeros(machine: Machine, run: PreparedRecording, initial_states: Array) -> Array | None:
    """Return the changes of the encoders' zeros that displaced initial states imply, shape (batch, sensors).

    An encoder without a known zero counts from the state at the start. If that state is displaced, all
    measurements of the encoder are shifted as well, and an observer must know it. None if there is no such
    encoder.
    """
    unknown = np.array([sensor.incremental for sensor in machine.sensors]) & ~run.initial.resolves_stretch
    positions = initial_states[:, : len(machine.coordinates)]
    changes = np.where(unknown, (positions - positions[0]) @ machine.sensor_matrix.T, 0.0)  # (batch, sensors)
    return -changes if np.any(changes) else None


def prediction_residuals(
    machine: Machine,
    run: PreparedRecording,
    data: Dataset,
    bandwidth: float,
    *,
    start: UncertainStart | None = None,
    longest_step: float = SEARCH_STEP,
) -> Array:
    """Return a machine's prediction errors, divided by the standard deviation of the sensor's noise.

    The part of the errors that an unknown initial stretch of the belts (or another unknown part of the
    initial state) can explain is removed, as in a fit.

    Args:
        run: Run to predict, n samples.
        bandwidth: Bandwidth of the observer, rad/s; 0 for a simulation.
        start: State from which the run is predicted. Default: that of `uncertain_starts`.
        longest_step: Maximum integration step, s.

    Returns:
        Residuals, dimensionless, shape (n * sensors,), 0 where not measured; not finite if the prediction
        diverges.
    """
    start = start or uncertain_starts(machine, [run])[run.name]
    motion = predict_with_displaced_starts(
        machine, run, bandwidth, start, period=data.period, longest_step=longest_step
    )
    predicted = whitened(residuals(run, data, motion.readings), run, bandwidth)
    residual, _ = projected(predicted, start.differences)
    return residual[0]
