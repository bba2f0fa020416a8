"""Forces and changes of measurements that candidate effects cause along the motion of a fitted machine.

They are computed for the motion as it is, without a simulation of the machine with the effect.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ...dynamics import Equations
from ...dynamics.motion_forces import KnownMotion, ohmic_currents
from ...dynamics.simulation import Motion
from ...machine import AppliedEffect, Effect, Machine
from ...preparation.dataset import PreparedRecording
from ..predict.linearization import DIFFERENCE_STEP
from .candidates import Candidate

_SMALL_FRACTION = 1e-4  # fraction of the typical amplitude at which a nonlinear effect is linearized


class Perturbation(NamedTuple):
    """Forces and changes of measurements that the basis functions of candidate effects cause along a motion.

    One column is one basis function of an effect (for example a sine or a cosine) at its typical size; n is
    the number of samples.

    Attributes:
        force: Force on every coordinate, N or Nm, shape (columns, n, coordinates).
        measurement: Change of the sensors' output, in the sensors' units, shape (columns, n, sensors); None
            if no column changes it.
    """

    force: Array
    measurement: Array | None


class PerturbedMachine(NamedTuple):
    """Machine with one effect at one site, in as many variants as its candidates have basis functions.

    Attributes:
        effect: Definition of the effect.
        columns: Number of variants.
        fraction: Size of the variants as a fraction of that of the basis functions, dimensionless.
        equations: Equations of the machine with the effect; each parameter of it has the shape (columns, 1).
        step: Fraction of the basis functions by which predictions are changed to get derivatives,
            dimensionless.
    """

    effect: Effect
    columns: int
    fraction: float
    equations: Equations
    step: float = DIFFERENCE_STEP


def perturbed_machines(machine: Machine, candidates: Sequence[Candidate]) -> list[PerturbedMachine]:
    """Create machines with candidate effects, for `candidate_perturbations` along several motions.

    Args:
        candidates: Candidate effects. Successive ones with the same effect and site are variants of one
            machine.

    Returns:
        One machine for each group of such candidates, in their order, with the effect of this group alone.
    """
    bare, perturbed = _without_effects(machine), []
    for _, group in itertools.groupby(candidates, key=lambda c: c.label):
        members = list(group)
        effect, columns = members[0].effect, [column for c in members for column in c.columns]
        # A small amplitude keeps the response linear: a Coulomb level cannot become negative, and the force
        # of an eccentric pulley contains the product of belt travel and lever arm.
        fraction = _SMALL_FRACTION if effect.coulomb or effect.belt_travel else 1.0
        scales = {name: fraction if name in effect.amplitudes else 1.0 for name in columns[0]}
        # Shape (columns, 1) each, so that all basis functions are evaluated at all samples at once.
        parameters = {
            name: np.array([[scale * column[name]] for column in columns]) for name, scale in scales.items()
        }
        applied = AppliedEffect(effect, members[0].site, parameters)
        equations = Equations(dataclasses.replace(bare, effects=(applied,)))
        perturbed.append(PerturbedMachine(effect, len(columns), fraction, equations))
    return perturbed


def _without_effects(machine: Machine) -> Machine:
    """Return a machine without effects; coordinates that they added stay."""
    return dataclasses.replace(machine, effects=())


class Unperturbed:
    """Motion of a machine along a run, with its forces and readings, which candidate effects change.

    Args:
        machine: The machine; effects that it has are left out, because candidates do not interact with them.
        run: Run with the sample times and voltages of the motion.
        motion: Motion of the machine with positions and velocities, a batch of one, n samples.

    Attributes:
        motion: The motion.
        known: The motion, prepared to compute forces of machines with one more effect.
        forces: Net force on each coordinate, N or Nm, shape (n,).
        time_s: Sample times, s, shape (n,).
        readings: Ideal reading of each sensor, in its unit, shape (n,) each.
    """

    def __init__(self, machine: Machine, run: PreparedRecording, motion: Motion) -> None:
        bare = _without_effects(machine)
        equations, q, v = Equations(bare), motion.positions[0], motion.velocities[0]
        self.motion, self.time_s = motion, run.time_s
        self.known = KnownMotion(equations, run.time_s, q, v, run.inputs)
        self.forces = self.known.by_coordinate(equations)
        accelerations, currents = np.gradient(v, run.time_s, axis=0), ohmic_currents(bare, v, run.inputs)
        self._columns = [list(values.T) for values in (q, v, accelerations, currents)]
        self.readings = self.readings_of(equations)

    def readings_of(self, equations: Equations) -> list[Array]:
        """Return the ideal reading of each sensor along the motion.

        Args:
            equations: Equations of the machine, with effects or without.

        Returns:
            Readings in the sensors' units, shape (n,) each, or (columns, n) for several variants of an
            effect.
        """
        return equations.sensor_readings(*self._columns)


def candidate_perturbations(unperturbed: Unperturbed, perturbed: Sequence[PerturbedMachine]) -> Perturbation:
    """Compute the forces and measurement changes that candidate effects of typical size cause along a motion.

    `screen` linearizes the residual with them. They are approximate in three respects: the motion is computed
    for the machine without the candidate, the candidate does not interact with other effects, and forces are
    constant from each sample to the next.

    Args:
        unperturbed: Motion of the machine, n samples.
        perturbed: The machine with each of the candidate effects, from `perturbed_machines`.

    Returns:
        Forces, N or Nm, shape (columns, n, coordinates), and changes of measurements, in the sensors' units,
        shape (columns, n, sensors), None if no candidate acts on sensors. A column is one basis function of
        one candidate, in the order of `Candidate.columns`.
    """
    count, first, motion = sum(each.columns for each in perturbed), 0, unperturbed.motion
    force = np.zeros((count, *motion.positions.shape[1:]))
    of_sensors = any(acts_on_sensors(each.effect) for each in perturbed)
    measurement = np.zeros((count, *motion.readings.shape[1:])) if of_sensors else None
    for each in perturbed:
        rows = slice(first, first + each.columns)
        first += each.columns
        if measurement is not None and acts_on_sensors(each.effect):
            measurement[rows] = _measurement_change(each.equations, unperturbed)
        else:
            changed = unperturbed.known.by_coordinate(each.equations)
            for i, (with_effect, without) in enumerate(zip(changed, unperturbed.forces, strict=True)):
                if with_effect.ndim > 1 or not np.array_equal(with_effect, without):
                    force[rows, :, i] = (with_effect - without) / each.fraction
    return Perturbation(force, measurement)


def acts_on_sensors(effect: Effect) -> bool:
    """Return whether an effect changes or delays a sensor's measurements instead of adding forces."""
    return bool(effect.measurement or effect.measurement_delay)


def _measurement_change(equations: Equations, unperturbed: Unperturbed) -> Array:
    """Return the change of ideal measurements by effects on sensors, shape (columns or 1, n, sensors).

    A measurement delay d is approximated to first order: the measurement changes by -d times its rate.
    """
    changes = []
    for measured, without, delay, values in zip(
        unperturbed.readings_of(equations),
        unperturbed.readings,
        equations.measurement_delays(),
        unperturbed.motion.readings[0].T,
        strict=True,
    ):
        change = measured - without
        if np.any(delay):
            change = change - delay * np.gradient(values, unperturbed.time_s)
        changes.append(np.atleast_2d(change))
    return np.stack(np.broadcast_arrays(*changes), axis=-1)
