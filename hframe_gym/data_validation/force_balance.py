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

from ..machine import Machine
from ..preparation.motion_windows import MotionWindows, determined_motion, leading_motions

Array = NDArray[np.float64]

# Fraction of the squared force of the drives, or of the squared motion, below which a motion is explained. On 33
# recorded and simulated sets of right wiring, at most 0.05 is unexplained; with one wrong sign, 0.1 to 1.
EXPLAINED = 0.2
_RESTING = 0.02  # fraction of the largest speed; below, static friction may have any value
_ROWS_PER_COEFFICIENT = 5  # rows that a regression needs


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
    R = leading_motions(machine)
    if not len(R) or not windows:
        return None
    motion = determined_motion(windows, machine, R, output_correction)
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


def _damping(machine: Machine) -> Array:
    """Return the declared viscous friction of each coordinate with the back-EMF of its drives, SI."""
    back_emf = [machine.coefficients({d.coordinate: d.back_emf}) for d in machine.drives]
    return np.array([c.viscous for c in machine.coordinates]) + np.sum(back_emf, axis=0)
