"""Linear state-space model of a machine at rest, with its effects if linear there, and its modes.

The model is that of the machine without effects (`dynamics.linearize`, exact to rounding) plus what the
effects add, such as the stiffness of a frame or the damping of belts. That part is the difference between the
accelerations with and without effects; it is differentiated by central differences. Dry friction has no
derivative at rest: it is set to zero, and the effects that change it are left out and listed
(`LinearModel.left_out`).
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...dynamics import Equations, linearize
from ...dynamics.physics.linearization import evaluate_beside_rest
from ...machine import AppliedEffect, Machine

Complex = NDArray[np.complex128]
# Steps of the central differences: belt travel in m, its rate in m/s, voltage in V. Over them, forces deviate
# from a straight line by 1e-9, which is also the size of the rounding errors.
_STEPS = (1e-6, 1e-5, 1e-4)
_RIGID = 1e-6  # rad/s; smaller eigenvalues count as zero: motions without a restoring force
_NEGLIGIBLE = 1e-9  # relative displacements below are rounding errors
# Functions of an effect (hooks of `machine.Effect`) that change the matrices, and others that do not: delays
# stand beside the matrices, and the state in which a recording begins is no part of the model.
_LINEAR_HOOKS = ("force", "active_region", "viscous", "tension", "energy_slope", "voltage", "measurement")
_IGNORED_HOOKS = ("delay", "measurement_delay", "clock", "initial_spread")


class LinearModel(NamedTuple):
    """State-space model x' = A x + B u + b, y = C x + D u; x, u and y are deviations from an operating point.

    Attributes:
        A: System matrix, shape (states, states): positions of all coordinates (m, rad), then velocities.
        B: Input matrix, shape (states, drives), per V.
        C: Output matrix, shape (sensors, states).
        D: Feedthrough matrix, zero unless a sensor measures a current or an acceleration,
            shape (sensors, drives).
        bias: The constant b: accelerations that constant forces of effects cause, m/s^2 or rad/s^2,
            shape (states,).
        states: Names of the states.
        state_units: Unit of each state.
        inputs: Names of the input channels, in V.
        outputs: Names of the output channels.
        output_units: Unit of each output.
        input_delays: Delay of each drive, s, shape (drives,); it is not part of the matrices.
        output_delays: Delay of each sensor, s, shape (sensors,); it is not part of the matrices.
        left_out: Labels of effects that have no linear model at rest.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    bias: Array
    states: tuple[str, ...]
    state_units: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    output_units: tuple[str, ...]
    input_delays: Array
    output_delays: Array
    left_out: tuple[str, ...]


class Mode(NamedTuple):
    """One mode: an oscillation (a pair of eigenvalues) or a real eigenvalue.

    Attributes:
        eigenvalue: Eigenvalue with imaginary part >= 0, rad/s.
        frequency: Natural frequency |eigenvalue| / (2 pi), Hz.
        damping: Damping ratio, dimensionless; 1 or -1 for a real eigenvalue, 0 for a motion without restoring
            force.
        shape: Complex amplitude of each coordinate relative to the largest one, all as belt travel (for a
            pulley its radius times its angle), shape (coordinates,).
    """

    eigenvalue: complex
    frequency: float
    damping: float
    shape: Complex


def linear_model(machine: Machine, position: Array) -> LinearModel:
    """Linearize a machine at rest, with those of its effects that have a linear model; the model is in SI.

    Coulomb friction is left out. Delays are listed beside the matrices, as are the effects that are left out.

    Args:
        position: Operating point: position of every coordinate at which no belt is stretched, m or rad, shape
            (coordinates,).
    """
    n, drives = len(machine.coordinates), len(machine.drives)
    nominal = linearize(machine, position)
    kept = tuple(e for e in machine.effects if _linear(e))
    with_effects = Equations(_without_dry_friction(machine, kept))
    without = Equations(_without_dry_friction(machine, ()))
    steps = np.concatenate(
        [np.repeat(_STEPS[:2], n) / np.tile(machine.travel_per_unit, 2), np.full(drives, _STEPS[2])]
    )
    points = np.concatenate([np.diag(steps), -np.diag(steps), np.zeros((1, len(steps)))])
    added, readings = (
        of_effects - plain
        for of_effects, plain in zip(
            evaluate_beside_rest(with_effects, position, points),
            evaluate_beside_rest(without, position, points),
            strict=True,
        )
    )
    m = len(steps)
    by_step = (added[:m] - added[m : 2 * m]).T / (2.0 * steps)  # (coordinates, 2 n + drives)
    of_readings = (readings[:m] - readings[m : 2 * m]).T / (2.0 * steps)
    A, B, C = nominal.A.copy(), nominal.B.copy(), nominal.C.copy()
    A[n:] += by_step[:, : 2 * n]
    B[n:] += by_step[:, 2 * n :]
    C += of_readings[:, : 2 * n]
    D = nominal.D + of_readings[:, 2 * n :]
    units = [c.unit("position") for c in machine.coordinates]
    rates = [c.unit("speed") for c in machine.coordinates]
    complete = Equations(machine)
    return LinearModel(
        A=A,
        B=B,
        C=C,
        D=D,
        bias=np.concatenate([np.zeros(n), added[-1]]),
        states=(*machine.coordinate_names, *(f"{name}_rate" for name in machine.coordinate_names)),
        state_units=(*units, *rates),
        inputs=machine.input_channels,
        outputs=machine.output_channels,
        output_units=tuple(map(machine.sensor_unit, machine.sensors)),
        input_delays=np.array([float(d) for d in complete.voltage_delays()]),
        output_delays=np.array([float(d) for d in complete.measurement_delays()]),
        left_out=tuple(e.label for e in machine.effects if not _linear(e)),
    )


def modes(A: Array, travel_per_unit: Array, rigid: Array | None = None) -> list[Mode]:
    """Compute the modes of a system matrix whose states are positions, then velocities.

    Args:
        A: System matrix, SI, shape (2 n, 2 n).
        travel_per_unit: Belt travel per unit of each position, m/m or m/rad, shape (n,).
        rigid: Known motions without a restoring force, one column each with the positions of all coordinates,
            m or rad, shape (n, motions). They replace the eigenvectors of the eigenvalue zero, which are not
            unique. Default: the eigenvectors are used.

    Returns:
        Modes by ascending frequency; of a pair of complex eigenvalues only one.
    """
    eigenvalues, vectors = np.linalg.eig(A)
    found = []
    free = [] if rigid is None else list((rigid * travel_per_unit[:, None]).T)
    for value, vector in zip(eigenvalues, vectors.T, strict=True):
        if value.imag < 0.0 and abs(value) > _RIGID:
            continue
        size = abs(value)
        travel = vector[: len(travel_per_unit)] * travel_per_unit
        if size <= _RIGID:
            value, size, travel = 0.0, 0.0, free.pop(0) if free else travel
        largest = travel[np.argmax(np.abs(travel))]
        shape = travel / largest if largest else travel
        shape = np.where(np.abs(shape) < _NEGLIGIBLE, 0.0, shape)
        damping = -value.real / size if size else 0.0
        found.append(Mode(complex(value), float(size / (2.0 * np.pi)), float(damping), shape))
    return sorted(found, key=lambda mode: (mode.frequency, -mode.damping))


def axis_modes(machine: Machine, position: Array) -> dict[str, Mode]:
    """Return the slowest oscillation along each tool axis while stiff control holds the motors.

    An oscillation belongs to the axis that moves most in it.

    Args:
        position: Operating point as of `linear_model`, m or rad, shape (coordinates,).

    Returns:
        Mode by axis; `shape` has the coordinates without a motor only. An axis in which nothing oscillates is
        missing.
    """
    model, n = linear_model(machine, position), len(machine.coordinates)
    driven = {drive.coordinate for drive in machine.drives}
    free = [i for i, name in enumerate(machine.coordinate_names) if name not in driven]
    rows = [*free, *(n + i for i in free)]
    found: dict[str, Mode] = {}
    if not free:
        return found
    held = modes(model.A[np.ix_(rows, rows)], machine.travel_per_unit[free])
    names = [machine.coordinate_names[i] for i in free]
    axes = [name for name in machine.tool_axes if name in names]
    for mode in held:
        if abs(mode.eigenvalue.imag) <= _RIGID:
            continue
        leading = max(axes, key=lambda axis: abs(mode.shape[names.index(axis)]), default=None)
        if leading is not None and leading not in found:
            found[leading] = mode
    return found


def _without_dry_friction(machine: Machine, effects: tuple[AppliedEffect, ...]) -> Machine:
    """Return the machine without Coulomb friction and with only some of its effects."""
    coordinates = tuple(dataclasses.replace(c, coulomb=0.0) for c in machine.coordinates)
    return dataclasses.replace(machine, coordinates=coordinates, effects=effects)


def _linear(effect: AppliedEffect) -> bool:
    """Return whether an effect is linear at rest: it has no memory, threshold or part in dry friction."""
    definition = effect.definition
    if definition.impacts or any(p.role == "switch" for p in definition.parameters):
        return False
    hooks = [h for h in ("coulomb", "friction", "next_state", "current") if getattr(definition, h)]
    acts = [h for h in _LINEAR_HOOKS if getattr(definition, h)]
    delays = [h for h in _IGNORED_HOOKS if getattr(definition, h)]
    return not hooks and bool(acts or delays or definition.structure)
