"""Balance of forces along the rigid motions of a machine, from measured motion without a simulation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...machine import Machine, rigid_basis, rigid_motions
from .motion_windows import MotionWindows

_RESTING = 0.02  # fraction of the largest speed; below, static friction may have any value
_ROWS_PER_COEFFICIENT = 5  # rows that a regression needs


def leading_motions(machine: Machine) -> Array:
    """Return the rigid motions of a machine, scaled so that the leading coordinate moves by 1.

    They are those of `rigid_motions`. A machine of pulleys only has none of these; there, the coordinate that
    moves most leads each motion of `rigid_basis`.

    Returns:
        Motions, shape (motions, coordinates); no rows if there is none.
    """
    named = rigid_motions(machine)
    if named:
        return np.array(list(named.values()))
    basis = rigid_basis(machine).T  # a machine of pulleys only has no leading carriage
    return np.array([motion / motion[int(np.argmax(np.abs(motion)))] for motion in basis])


def determined_motion(
    windows: Sequence[MotionWindows], machine: Machine, R: Array, correction: Array
) -> tuple[NDArray[np.int_], Array, Array, Array] | None:
    """Compute the rigid motions, with derivatives, from corrected sensors, and which ones these determine.

    Args:
        windows: Motion of each run.
        machine: Declared machine.
        R: Rigid motions, see `leading_motions`, shape (motions, coordinates).
        correction: Matrix that multiplies the measurements, shape (sensors, sensors).

    Returns:
        Indices of the motions that the sensors determine; positions, velocities and accelerations of all
        motions, shape (rows, motions) each. None if the sensors determine no motion.
    """
    measured = np.isfinite(np.concatenate([w.position for w in windows])).any(axis=0)
    usable = np.abs(correction) @ (~measured).astype(float) == 0.0
    of_motion = (machine.sensor_matrix @ R.T)[usable]  # (usable sensors, motions)
    size = np.linalg.norm(of_motion, axis=1)
    size[size == 0.0] = 1.0
    scaled = of_motion / size[:, None]  # lengths and angles become comparable
    inverse = np.linalg.pinv(scaled)
    determined = np.flatnonzero(np.isclose(np.diag(inverse @ scaled), 1.0))
    if not len(determined):
        return None

    def motion(measurements: Array) -> Array:
        missing = np.isnan(measurements).astype(float) @ np.abs(correction).T > 0.0
        corrected = np.where(missing, np.nan, np.nan_to_num(measurements) @ correction.T)
        return np.asarray((corrected[:, usable] / size) @ inverse.T)

    position, velocity, acceleration = (motion(np.concatenate([w[i] for w in windows])) for i in range(3))
    return determined, position, velocity, acceleration


class ForceEquations(NamedTuple):
    """Equations for the balance of forces along one rigid motion z, one for each row in which it moves.

    The force F of the drives is columns @ coefficients with coefficients >= 0: inertia relative to the
    declared one, viscous friction, dry friction, then two for each term of either sign, which are its
    positive and its negative part.

    Attributes:
        motion: Index of the motion, see `leading_motions`.
        force: Force F, N or Nm, shape (rows,).
        columns: Declared inertial force, z', sign(z'), then both signs of each further term: z minus its mean
            where a spring is asked for, 1, and for an angle sin(z) and cos(z); shape (rows, coefficients).
        runs: Index of the run of each row, shape (rows,).
    """

    motion: int
    force: Array
    columns: Array
    runs: NDArray[np.int_]

    @property
    def determined(self) -> bool:
        """Whether the drives exert a force and there are five rows per coefficient of the regression."""
        return len(self.force) >= _ROWS_PER_COEFFICIENT * self.columns.shape[1] and bool(self.force.any())


def force_equations(
    windows: Sequence[MotionWindows],
    machine: Machine,
    output_correction: Array,
    input_correction: Array,
    *,
    spring: bool,
) -> Iterator[ForceEquations]:
    """Yield the balance of forces along each rigid motion that the sensors determine.

    Nothing is yielded if they determine none, or for a machine with drives whose force is not in proportion
    to their command.

    Args:
        windows: Motion of each run, at least one.
        machine: Declared machine: directions of drives and sensors, inertia of its rigid motions.
        output_correction: Matrix that multiplies the measurements, shape (sensors, sensors).
        input_correction: Matrix that multiplies the inputs, shape (drives, drives).
        spring: Whether a force in proportion to the position is a term.

    Yields:
        Equations, N or Nm, shape (rows,); of some motions too few for a regression
        (`ForceEquations.determined`).
    """
    if machine.drive_laws:
        return
    R = leading_motions(machine)
    motion = determined_motion(windows, machine, R, output_correction)
    if motion is None:
        return
    determined, position, velocity, acceleration = motion
    gains = np.column_stack([R @ machine.coefficients({d.coordinate: d.gain}) for d in machine.drives])
    force = np.concatenate([w.inputs for w in windows]) @ input_correction.T @ gains.T
    mass = np.array([c.mass for c in machine.coordinates])
    runs = np.repeat(np.arange(len(windows)), [len(w.velocity) for w in windows])
    inertial = np.nan_to_num(acceleration) @ (R @ (mass[:, None] * R.T))
    for k in determined:
        rows = np.isfinite(acceleration).all(axis=1)
        fastest = float(np.abs(velocity[rows, k]).max(initial=0.0))
        rows &= np.abs(np.nan_to_num(velocity[:, k])) > _RESTING * fastest
        F, z, dz = force[rows, k], position[rows, k], velocity[rows, k]
        free = [z - z.sum() / max(len(z), 1)] if spring else []
        free.append(np.ones(len(z)))
        if machine.coordinates[int(np.argmax(np.abs(R[k]) > 0.0))].kind == "rotary":
            free += [np.sin(z), np.cos(z)]
        signed = [sign * column for column in free for sign in (1.0, -1.0)]
        columns = np.column_stack([inertial[rows, k], dz, np.sign(dz), *signed])
        yield ForceEquations(int(k), F, columns, runs[rows])
