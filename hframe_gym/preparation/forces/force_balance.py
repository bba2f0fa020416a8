"""Compare the drives' forces with what the measured motion requires, whatever forces the machine file lacks.

A simulation with the declared machine cannot tell a wrong sign from a spring or a weight that the file does
not declare: below resonance, a spring turns the phase of the motion by half a turn, as a wrong sign does. The
balance of forces can. Along each rigid motion z, the force F of the drives is

    F = a (M z'') + b z' + c sign(z') + k z + (s sin z + r cos z for an angle) + o

with unknown coefficients. Inertia, viscous and dry friction are positive on any machine (a, b, c >= 0); a
spring, a weight and an offset have either sign. Linear least squares with these bounds gives the fraction of
F that no machine explains. With a wrong sign, the drives would brake what they accelerate, and friction would
drive: most of F remains. A load that the drives hold throughout, as on a vertical axis, tells no direction,
because an offset explains it with either sign. Over a session, directions are therefore compared by the
changes of F about its mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from ...arrays import Array
from ...machine import Machine
from .force_equations import force_equations, leading_motions
from .motion_windows import MotionWindows

# Fraction of the squared force of the drives, or of the squared motion, below which a motion is explained. On
# 33 recorded and simulated sets of right wiring, at most 0.05 is unexplained; with one wrong sign, 0.1 to 1.
# Of the changes of the force, at most 0.11 on 26 sets, and 0.28 on one whose voltage is limited; with one
# wrong sign, 0.23 to 1, and 0.12 on a joint that sticks.
EXPLAINED = 0.2
# Another wiring takes the place of the declared one if it leaves this much less, as a fraction of the squared
# force, and at most this fraction of what the declared one leaves.
IMPROVEMENT, CLEARLY_LESS = 0.1, 1 / 3
_ROUNDING = 1e-12  # squared changes of a constant force, as a fraction of its square
SPANS = (0.02, 0.05, 0.1, 0.2)  # s, windows of the balance of forces


class Balance(NamedTuple):
    """Least-squares balance of the drives' forces over the rigid motions that the sensors determine.

    Attributes:
        unexplained: Fraction of the sum of squared forces that no machine explains, from 0 to 1.
        of_changes: Sum of squared unexplained forces as a fraction of that of the forces' changes about their
            mean.
        inertia: Fitted inertia / declared inertia, by motion, shape (motions,); NaN if the rows do not
            suffice.
        viscous: Fitted / declared viscous friction, back-EMF included, by motion, shape (motions,); NaN also
            if none is declared.
    """

    unexplained: float
    of_changes: float
    inertia: Array
    viscous: Array


def explains_instead(unexplained: float, declared: float) -> bool:
    """Decide whether another assignment of drives, sensors or signs explains the motion better than declared.

    It must leave less than `CLEARLY_LESS` of what the declared one leaves unexplained, and explain at least
    the fraction `IMPROVEMENT` of the motion more.

    Args:
        unexplained: Fraction that the other assignment leaves unexplained, from 0 to 1.
        declared: Fraction that the declared assignment leaves unexplained.
    """
    return unexplained < declared - IMPROVEMENT and unexplained < CLEARLY_LESS * declared


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
        Fractions of the squared force, and of its changes, that stay unexplained, 0 to 1, and the ratios of
        fitted to declared inertia and viscous friction of each motion. None if the sensors determine no
        motion, nothing moves, or too few rows are measured.
    """
    R = leading_motions(machine)
    if not len(R) or not windows:
        return None
    damping = _damping(machine)
    residual, total, changes = 0.0, 0.0, 0.0
    inertia, viscous = [], []
    for equations in force_equations(windows, machine, output_correction, input_correction, spring=True):
        if not equations.determined:
            inertia.append(np.nan)
            viscous.append(np.nan)
            continue
        force, columns = equations.force, equations.columns
        scale = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
        coefficients, left = nnls(columns / scale, force)
        residual, total = residual + left**2, total + float(force @ force)
        changes += float(np.sum((force - force.mean()) ** 2))
        inertia.append(coefficients[0] / scale[0])
        declared = float(R[equations.motion] ** 2 @ damping)
        viscous.append(coefficients[1] / scale[1] / declared if declared else np.nan)
    if not total:
        return None
    of_changes = residual / changes if changes > _ROUNDING * total else 0.0
    return Balance(residual / total, of_changes, np.array(inertia), np.array(viscous))


def _damping(machine: Machine) -> Array:
    """Return the declared viscous friction of each coordinate with the back-EMF of its drives, SI."""
    back_emf = [machine.coefficients({d.coordinate: d.back_emf}) for d in machine.drives]
    return np.array([c.viscous for c in machine.coordinates]) + np.sum(back_emf, axis=0)
