"""Where the predictions of a run start, and by how much the state at the start may differ from the measured one.

Static friction holds an unknown stretch of the belts when a run begins: encoders behind belts do not resolve it, and an
encoder that was switched on anew does not measure it at all. Where no laser measures at rest, the position is uncertain
as well. A bristle or a cable with hysteresis remembers motion that was not recorded.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from ..dynamics import Equations
from ..machine import Machine
from .belt_stretch import linear_coordinates, rigid_basis, stretch_angles, vibration_speeds
from .initial_state import model_initial_states
from .rest_measurement import InitialState

if TYPE_CHECKING:
    from .dataset import PreparedRecording

Array = NDArray[np.float64]
_UNMEASURED_POSITION = 2e-4  # m; error of a position that follows from later measurements


class UncertainStart(NamedTuple):
    """State from which a run is predicted, and by how much it may be wrong.

    Attributes:
        state: Positions (m, rad), velocities (m/s, rad/s), effect states (SI), shape (2 * coordinates + states,).
        displacements: Independent displacements of this state, one per row, each of the size of one standard deviation,
            shape (displacements, 2 * coordinates + states); no rows if nothing is uncertain.
    """

    state: Array
    displacements: Array

    @property
    def displaced_states(self) -> Array:
        """The state with each of the displacements added in turn, SI, shape (displacements, state)."""
        return self.state + self.displacements


def uncertain_starts(machine: Machine, runs: Sequence[PreparedRecording]) -> dict[str, UncertainStart]:
    """Return where predictions of runs by a machine start, and by how much these states may be wrong.

    Args:
        machine: Machine that predicts; its effects (deviations from the nominal model) also determine the state.
        runs: Runs to predict. What depends on the machine alone is computed once for all of them.

    Returns:
        State, shape (2 * coordinates + effect states,), and displacements (`start_displacements`), by name of the run.
    """
    states = model_initial_states(machine, [run.initial for run in runs])
    displacements = start_displacements(machine, [run.initial for run in runs])
    starts = map(UncertainStart, states, displacements)
    return dict(zip((run.name for run in runs), starts, strict=True))


def start_displacements(machine: Machine, initial: Sequence[InitialState]) -> list[Array]:
    """Return the independent displacements by which the states at the start of runs may differ from the measured ones.

    They have four causes:

    - Static friction holds an unknown stretch of the belts: one displacement per pulley with an encoder.
    - In a machine with belts, lasers (sensors with a fixed zero) do not measure the complete position before the motion
      begins: one displacement per motion that stretches no belt and that no laser measures at rest.
    - The run begins in motion, and its first measurements show the velocity inaccurately: one per motion that stretches
      no belt, and one per pulley with an encoder, because the belts vibrate.
    - An effect such as hysteresis remembers motion before the recording: one per state of an effect that defines an
      `initial_spread`.

    Args:
        machine: Machine whose simulation starts from these states.
        initial: Measured initial state of each run.

    Returns:
        For each run its displacements, one per row, each of the size of one standard deviation: positions (m, rad),
        velocities (m/s, rad/s), states of the effects (SI), shape (displacements, 2 * coordinates + effect states).
    """
    count, spreads = len(machine.coordinates), effect_state_spreads(machine)
    of_effects = np.pad(np.diag(spreads)[spreads > 0.0], ((0, 0), (2 * count, 0)))
    # The typical stretch depends on the machine, and on whether the run begins in motion.
    angles = {
        moving: stretch_angles(machine, moving=moving)
        for moving in {len(state.velocity_deviations) > 0 for state in initial}
    }
    displacements = []
    for state in initial:
        positions = _position_displacements(machine, state, angles[len(state.velocity_deviations) > 0])
        velocities = _velocity_displacements(machine, state)
        blocks = (
            np.pad(positions, ((0, 0), (0, count + len(spreads)))),
            np.pad(velocities, ((0, 0), (count, len(spreads)))),
            of_effects,
        )
        displacements.append(np.vstack(blocks))
    return displacements


def _position_displacements(machine: Machine, initial: InitialState, held_angles: dict[str, float]) -> Array:
    """Return the uncertain positions of a run, each of the size of its error, shape (k, coordinates).

    Zeros that scatter from run to run show the stretch that friction holds on this rig; a zero is then uncertain, too.
    """
    spreads = {
        sensor.coordinate: spread / abs(sensor.row[sensor.coordinate])
        for sensor, spread in zip(machine.sensors, initial.zero_spread, strict=True)
    }
    stretches = np.zeros((len(held_angles), len(machine.coordinates)))
    for k, (name, angle) in enumerate(held_angles.items()):
        stretches[k, machine.coordinate_names.index(name)] = max(angle, spreads.get(name, 0.0))
    if not held_angles or initial.lasers_measured:
        return stretches
    return np.vstack([stretches, _rigid_displacements(machine, initial, held_angles)])


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


def effect_state_spreads(machine: Machine) -> Array:
    """Return the standard deviation of the state that each effect has at the start of a run.

    Args:
        machine: Machine with its effects (deviations from the nominal model).

    Returns:
        Standard deviations, SI, in the order of the effects' states, shape (effect states,); 0 for a state that is zero
        at rest, such as the current of a motor.
    """
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
    return np.asarray(size * (unseen / np.linalg.norm(unseen[linear_coordinates(machine)], axis=0)).T)
