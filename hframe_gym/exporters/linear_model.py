"""Linear model of a machine with those of its effects that are linear near rest, its modes, and modes with held motors.

`dynamics.linearize` gives the derivatives of the nominal equations, exact to rounding. What effects add (stiffness of a
frame, damping of belts, another gain of an amplifier) is the difference of the accelerations with and without them,
differentiated by central differences. Dry friction has no derivative at rest and is left out with all effects on it.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..dynamics import Equations, linearize
from ..machine import AppliedEffect, Machine

Complex = NDArray[np.complex128]
# Steps of the central differences: m of belt travel, m/s, V. Forces are linear to 1e-9 over them, and rounding errors
# are of the same size.
_STEPS = (1e-6, 1e-5, 1e-4)
_RIGID = 1e-6  # rad/s; slower eigenvalues are those of motions without a restoring force
_NEGLIGIBLE = 1e-9  # relative displacements below are rounding errors
# Hooks of effects that act on the linear model. Delays are stated beside it.
_LINEAR_HOOKS = ("force", "active_region", "viscous", "tension", "energy_slope", "voltage", "measurement")
_IGNORED_HOOKS = ("delay", "measurement_delay", "initial_spread")


class LinearModel(NamedTuple):
    """Linear model x' = A x + B u + b, y = C x + D u of deviations from rest at an operating point.

    Attributes:
        A: System matrix, shape (states, states): positions of all coordinates (m, rad), then velocities.
        B: Input matrix, shape (states, drives), per V.
        C: Output matrix, shape (sensors, states).
        D: Feedthrough matrix, zero unless a sensor measures a current or an acceleration, shape (sensors, drives).
        bias: Constant part b of the derivative: accelerations by constant forces of effects, shape (states,).
        states: Names of the states.
        state_units: Their units.
        inputs: Names of the input channels, in V.
        outputs: Names of the output channels.
        output_units: Their units.
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
        damping: Damping ratio, dimensionless; 1 or -1 for a real eigenvalue, 0 for a motion without restoring force.
        shape: Complex displacement of each coordinate in belt travel, relative to the largest, shape (coordinates,).
    """

    eigenvalue: complex
    frequency: float
    damping: float
    shape: Complex


def linear_model(machine: Machine, position: Array) -> LinearModel:
    """Linearize a machine, with its effects, about rest.

    Args:
        position: Position of every coordinate with unstretched belts, m or rad, shape (coordinates,).

    Returns:
        The model, in SI, with names and units; A has the shape (states, states).
    """
    n, drives = len(machine.coordinates), len(machine.drives)
    nominal = linearize(machine, position)
    kept = tuple(e for e in machine.effects if _linear(e))
    equations = Equations(_without_dry_friction(machine, kept))
    # A structural effect ties parameters of the coordinates that it adds to its parameters, so ties go with effects.
    base = Equations(dataclasses.replace(_without_dry_friction(machine, ()), ties={}))
    steps = np.concatenate(
        [np.repeat(_STEPS[:2], n) / np.tile(machine.travel_per_unit, 2), np.full(drives, _STEPS[2])]
    )
    points = np.concatenate([np.diag(steps), -np.diag(steps), np.zeros((1, len(steps)))])
    added, readings = (
        _evaluated(equations, position, points, n)[k] - _evaluated(base, position, points, n)[k]
        for k in (0, 1)
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
    delays = Equations(machine)
    return LinearModel(
        A,
        B,
        C,
        D,
        np.concatenate([np.zeros(n), added[-1]]),
        (*machine.coordinate_names, *(f"{name}_rate" for name in machine.coordinate_names)),
        (*units, *rates),
        machine.input_channels,
        machine.output_channels,
        tuple(map(machine.sensor_unit, machine.sensors)),
        np.array([float(d) for d in delays.voltage_delays()]),
        np.array([float(d) for d in delays.measurement_delays()]),
        tuple(e.label for e in machine.effects if not _linear(e)),
    )


def modes(A: Array, travel_per_unit: Array, rigid: Array | None = None) -> list[Mode]:
    """Compute the modes of a system matrix whose states are positions, then velocities.

    Args:
        A: System matrix, SI, shape (2 n, 2 n).
        travel_per_unit: Belt travel per unit of each position, m/m or m/rad, shape (n,).
        rigid: Positions of all coordinates in motions without a restoring force, m or rad, shape (n, motions). They are
            the shapes of the eigenvalue zero, for which eigenvectors are not unique. None: no such motions are known.

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
    """Return the first mode of each tool axis while the motors are held, as position-controlled motors do.

    Of the oscillations with held motors, an axis has the slowest one in which it moves more than the other axes.

    Args:
        machine: Machine with belts or other springs between motors and tool.
        position: Position of every coordinate with unstretched belts, m or rad, shape (coordinates,).

    Returns:
        Mode by axis; shapes are over the coordinates that are not held. Axes without such a mode are missing.
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


def _evaluated(equations: Equations, position: Array, points: Array, n: int) -> tuple[Array, Array]:
    """Return accelerations (points, n), m/s^2 or rad/s^2, and readings (points, sensors) at steps from rest."""
    point = equations.point(position + points[:, :n], points[:, n : 2 * n])
    accelerations = equations.accelerations(point, list(points[:, 2 * n :].T), np.zeros_like)
    in_units = [a * equations.per_radius(i) for i, a in enumerate(accelerations)]
    voltages = equations.motor_voltages(list(points[:, 2 * n :].T))
    currents = [equations.current(j, point, voltages) for j in range(len(voltages))]
    positions, velocities = (position + points[:, :n]).T, points[:, n : 2 * n].T
    readings = equations.sensor_readings(list(positions), list(velocities), in_units, currents)
    return tuple(  # type: ignore[return-value]
        np.array([np.broadcast_to(value, len(points)) for value in values]).reshape(-1, len(points)).T
        for values in (in_units, readings)
    )


def _without_dry_friction(machine: Machine, effects: tuple[AppliedEffect, ...]) -> Machine:
    """Return the machine without Coulomb friction and with only some of its effects."""
    coordinates = tuple(dataclasses.replace(c, coulomb=0.0) for c in machine.coordinates)
    return dataclasses.replace(machine, coordinates=coordinates, effects=effects)


def _linear(effect: AppliedEffect) -> bool:
    """Return whether an effect acts on the linear model: without memory, threshold and part in dry friction."""
    definition = effect.definition
    if definition.impacts or any(p.role == "switch" for p in definition.parameters):
        return False
    hooks = [h for h in ("coulomb", "friction", "next_state", "current") if getattr(definition, h)]
    acts = [h for h in _LINEAR_HOOKS if getattr(definition, h)]
    delays = [h for h in _IGNORED_HOOKS if getattr(definition, h)]
    return not hooks and bool(acts or delays or definition.structure)
