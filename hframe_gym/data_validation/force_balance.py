"""Compare the drives' forces with what the measured motion requires, whatever forces the machine file lacks.

A simulation with the declared machine cannot tell a wrong sign from a spring or a weight that the file does not
declare: below resonance, a spring turns the phase of the motion by half a turn, as a wrong sign does. The balance of
forces can. Along each rigid motion z, the force F of the drives is

    F = a (M z'') + b z' + c sign(z') + k z + (s sin z + r cos z for an angle) + o

with unknown coefficients. Inertia, viscous and dry friction are positive on any machine (a, b, c >= 0); a spring, a
weight and an offset have either sign. Linear least squares with these bounds gives the fraction of F that no machine
explains. With a wrong sign, the drives would brake what they accelerate, and friction would drive: most of F remains.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from ..identification import PreparedRecording
from ..machine import Machine, rigid_motions
from ..preparation.belt_stretch import rigid_basis
from ..recordings import bridge_blanks

Array = NDArray[np.float64]

# Fraction of the squared force of the drives, or of the squared motion, below which a motion is explained. On 33
# recorded and simulated sets of right wiring, at most 0.05 is unexplained; with one wrong sign, 0.1 to 1.
EXPLAINED = 0.2
_OVERLAP = 2  # grid points of the balance per window
_RESTING = 0.02  # fraction of the largest speed; below, static friction may have any value
_ROWS_PER_COEFFICIENT = 5  # rows that a regression needs


class MotionWindows(NamedTuple):
    """Measured motion and inputs of one run, averaged over windows.

    Attributes:
        position: Mean measurements, m or rad, NaN where not measured, shape (rows, sensors).
        velocity: Their velocities, m/s or rad/s, shape (rows, sensors).
        acceleration: Their accelerations, m/s^2 or rad/s^2, shape (rows, sensors).
        inputs: Means of the inputs with the weights that an acceleration has, V, shape (rows, drives).
    """

    position: Array
    velocity: Array
    acceleration: Array
    inputs: Array


class Balance(NamedTuple):
    """Least-squares balance of the drives' forces over the rigid motions that the sensors determine.

    Attributes:
        unexplained: Fraction of the sum of squared forces that no machine explains, from 0 to 1.
        inertia: Fitted inertia / declared inertia, by motion, shape (motions,).
        viscous: Fitted viscous friction / declared one with the back-EMF, by motion, shape (motions,); NaN if none is
            declared.
    """

    unexplained: float
    inertia: Array
    viscous: Array


def motion_windows(run: PreparedRecording, span: float) -> MotionWindows:
    """Average a run over windows and differentiate it.

    A second difference of positions is the mean acceleration with triangular weights. The inputs are averaged with the
    same weights, so that both sides of the balance agree exactly, however fast the inputs change.

    Args:
        run: Prepared run.
        span: Length of a window, s.

    Returns:
        Means and derivatives, m or rad, shape (rows, sensors), with two rows per window; no rows for a run that is
        shorter than three windows.
    """
    time_s = run.time_s - run.time_s[0]
    grid = np.arange(span / 2, time_s[-1] - span / 2, span / _OVERLAP)
    if len(grid) <= 2 * _OVERLAP:
        empty = np.zeros((0, run.outputs.shape[1]))
        return MotionWindows(empty, empty, empty, np.zeros((0, run.inputs.shape[1])))
    bridged = bridge_blanks(run.outputs, time_s, 1.01 * span)
    steps = np.diff(time_s)[:, None]
    first = _cumulated(run.inputs[:-1] * steps)  # integral of the inputs, which are held from row to row
    second = _cumulated((first[:-1] + first[1:]) / 2 * steps)

    def mean(values: Array) -> Array:
        """Return the mean over a window around each grid point."""
        integral = _cumulated((values[:-1] + values[1:]) / 2 * steps)
        before, after = (_at(grid + side * span / 2, time_s, integral) for side in (-1.0, 1.0))
        return (after - before) / span

    outputs = mean(np.where(np.isfinite(bridged), bridged, 0.0))
    outputs[mean(np.isnan(bridged).astype(float)) > 0.0] = np.nan
    twice = mean(second)

    def shifted(rows: int) -> Array:
        """Return the mean outputs that many grid points later, from the third grid point to the third last one."""
        return outputs[_OVERLAP + rows : len(outputs) - _OVERLAP + rows]

    # Weights that spread as far in time as those of the accelerations, so that fast motion falsifies no coefficient.
    position = (shifted(-1) + shifted(0) + shifted(1)) / 3
    velocity = (shifted(2) - shifted(-2)) / (6 * span) + (shifted(1) - shifted(-1)) * 2 / (3 * span)
    acceleration = (shifted(2) - 2 * shifted(0) + shifted(-2)) / span**2
    inputs = (twice[2 * _OVERLAP :] - 2 * twice[_OVERLAP:-_OVERLAP] + twice[: -2 * _OVERLAP]) / span**2
    return MotionWindows(position, velocity, acceleration, inputs)


def _cumulated(increments: Array) -> Array:
    """Return the sums of increments up to each row, beginning with 0."""
    return np.vstack([np.zeros(increments.shape[1]), np.cumsum(increments, axis=0)])


def _at(times: Array, time_s: Array, values: Array) -> Array:
    """Return columns of values interpolated at other times."""
    return np.column_stack([np.interp(times, time_s, column) for column in values.T])


def force_balance(
    windows: Sequence[MotionWindows], machine: Machine, output_correction: Array, input_correction: Array
) -> Balance | None:
    """Fit the balance of forces to measured motions, after a correction of outputs or inputs.

    Args:
        windows: Motion of each run.
        machine: Declared machine: directions of drives and sensors, inertia of its rigid motions.
        output_correction: Matrix that multiplies the measurements, shape (sensors, sensors).
        input_correction: Matrix that multiplies the inputs, shape (drives, drives).

    Returns:
        The balance, with ratios of shape (motions,). None if the sensors determine no motion, nothing moves, or too
        few rows are measured.
    """
    R = _motions(machine)
    if not len(R) or not windows:
        return None
    motion = _determined_motion(windows, machine, R, output_correction)
    if motion is None:
        return None
    determined, position, velocity, acceleration = motion
    gains = np.column_stack([R @ machine.coefficients({d.coordinate: d.gain}) for d in machine.drives])
    force = np.concatenate([w.inputs for w in windows]) @ input_correction.T @ gains.T
    mass = np.array([c.mass for c in machine.coordinates])
    inertial = np.nan_to_num(acceleration) @ (R @ (mass[:, None] * R.T))
    residual, total = 0.0, 0.0
    inertia, viscous = np.full((2, len(determined)), np.nan)
    for i, k in enumerate(determined):
        rows = np.isfinite(acceleration).all(axis=1)
        fastest = float(np.abs(velocity[rows, k]).max(initial=0.0))
        rows &= np.abs(np.nan_to_num(velocity[:, k])) > _RESTING * fastest
        F, z, dz = force[rows, k], position[rows, k], velocity[rows, k]
        leading = machine.coordinates[int(np.argmax(np.abs(R[k]) > 0.0))]
        free = [z - z.sum() / max(len(z), 1), np.ones(len(z))]
        free += [np.sin(z), np.cos(z)] if leading.kind == "rotary" else []
        # A coefficient of either sign is the difference of two positive ones.
        signed = [sign * column for column in free for sign in (1.0, -1.0)]
        columns = np.column_stack([inertial[rows, k], dz, np.sign(dz), *signed])
        if len(z) < _ROWS_PER_COEFFICIENT * columns.shape[1] or not F.any():
            continue
        scale = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
        coefficients, left = nnls(columns / scale, F)
        residual, total = residual + left**2, total + float(F @ F)
        inertia[i] = coefficients[0] / scale[0]
        declared = float(R[k] ** 2 @ _damping(machine))
        viscous[i] = coefficients[1] / scale[1] / declared if declared else np.nan
    return Balance(residual / total, inertia, viscous) if total else None


def _motions(machine: Machine) -> Array:
    """Return the rigid motions, shape (motions, coordinates); 1 at the coordinate that leads each of them."""
    named = rigid_motions(machine)
    if named:
        return np.array(list(named.values()))
    basis = rigid_basis(machine).T  # a machine of pulleys only has no leading carriage
    return np.array([motion / motion[int(np.argmax(np.abs(motion)))] for motion in basis])


def _determined_motion(
    windows: Sequence[MotionWindows], machine: Machine, R: Array, correction: Array
) -> tuple[NDArray[np.int_], Array, Array, Array] | None:
    """Return which rigid motions corrected sensors determine, and all motions with their derivatives, (rows, motions).

    None if they determine no motion.
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


def _damping(machine: Machine) -> Array:
    """Return the declared viscous friction of each coordinate with the back-EMF of its drives, SI."""
    back_emf = [machine.coefficients({d.coordinate: d.back_emf}) for d in machine.drives]
    return np.array([c.viscous for c in machine.coordinates]) + np.sum(back_emf, axis=0)
