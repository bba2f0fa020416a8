"""Forces along a motion that is given by its samples: those of the belts, and those that effects add.

Parameters may be arrays of shape (variants, 1), so that many variants of an effect are evaluated at once.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, Inputs, Times
from ..machine import AppliedEffect, Effect, Machine, argument_names
from .codegen.state_steps import follow_state
from .physics.belts import BeltState
from .physics.equations import Equations
from .physics.parameterized_machine import MotionPoint

# The flow of a bristle state over a distance without turning point is exact, so few steps suffice.
_BRISTLE_STATE_STRIDE = 5


def belt_states(
    machine: Machine, positions: ArrayLike, velocities: ArrayLike | None = None
) -> list[BeltState]:
    """Return extension, stiffness and tension of each belt along a motion, in the machine's order.

    Args:
        positions: Positions, m or rad, shape (..., coordinates).
        velocities: Velocities, m/s or rad/s, of the same shape. Default: at rest.

    Returns:
        One `BeltState` of arrays of shape (...) per belt; `stiffness` and `stiffness_force` are floats for a
        belt of constant stiffness.
    """
    equations = Equations(machine)
    return equations.belt_states(equations.point(positions, velocities))


def belt_forces(machine: Machine, positions: ArrayLike, velocities: ArrayLike | None = None) -> Array:
    """Return the force of the belts on each coordinate along a motion, N or Nm, shape (..., coordinates).

    Args:
        positions: Positions, m or rad, shape (..., coordinates).
        velocities: Velocities, m/s or rad/s, of the same shape. Default: at rest.
    """
    equations = Equations(machine)
    point = equations.point(positions, velocities)
    return np.asarray(equations.in_units(equations.belt_forces(point, equations.belt_states(point))))


def net_forces(
    machine: Machine,
    time_s: Times,
    positions: Array,
    velocities: Array,
    inputs: Inputs,
    values: Mapping[str, Array] | None = None,
) -> Array:
    """Return the sum of all forces on each coordinate along a motion of N samples, with friction and effects.

    Coulomb friction is F sign(v), thus zero at zero speed, where static friction is unknown.

    Args:
        positions: Positions, m or rad, shape (N, coordinates).
        velocities: Velocities, m/s or rad/s, shape (N, coordinates).
        values: Parameter values by full name ("x.mass"), SI, that replace the machine's. An array of shape
            (variants, 1) gives one value for each of several variants of the machine; otherwise a float.

    Returns:
        Net forces, N or Nm, shape (N, coordinates), or (variants, N, coordinates) if a value is an array.
    """
    equations = Equations(machine, values)
    return KnownMotion(equations, time_s, positions, velocities, inputs).forces(equations)


class KnownMotion:
    """A given motion, along which the forces of a machine with different additional effects are evaluated.

    What does not depend on these effects, such as the forces of linear belts, is computed once.

    Args:
        equations: Equations of the machine without the additional effects.
        time_s: Sample times, s, shape (N,).
        positions: Positions, m or rad, shape (N, coordinates).
        velocities: Velocities, m/s or rad/s, shape (N, coordinates).
        inputs: Commanded voltages, V, held from each sample until the next, shape (N, drives).
    """

    def __init__(
        self, equations: Equations, time_s: Times, positions: Array, velocities: Array, inputs: Inputs
    ) -> None:
        self._equations, self._record = equations, (time_s, positions, velocities)
        self._inputs = inputs
        self._point = equations.point(positions, velocities, time_s)

    @cached_property
    def _voltages(self) -> list[Array]:
        """Voltage that reaches each drive, V."""
        return _delayed_voltages(self._equations, self._record[0], self._inputs)

    @cached_property
    def _belt_forces(self) -> list[Any]:
        """Force of linear belts on each coordinate, N."""
        return self._equations.belt_forces(self._point, self._equations.belt_states(self._point))

    def forces(self, equations: Equations) -> Array:
        """Return the net forces (`net_forces`) along the motion of the machine with further effects.

        Args:
            equations: Equations of the machine with further effects, which add no coordinates. Parameters of
                these effects may have one value for each of several variants; all other parameters are
                unchanged.

        Returns:
            Net forces, N or Nm, shape (N, coordinates), or (variants, N, coordinates) for several variants.
        """
        return np.stack(np.broadcast_arrays(*self.by_coordinate(equations)), axis=-1)

    def by_coordinate(self, equations: Equations) -> list[Array]:
        """Return what `forces` does as a list by coordinate, with an axis of variants only where they differ.

        Args:
            equations: As in `forces`.

        Returns:
            Net force on each coordinate, N or Nm, shape (N,) or (variants, N).
        """
        delayed = any(instance.effect.definition.delay for instance in equations.instances)
        voltages = _delayed_voltages(equations, self._record[0], self._inputs) if delayed else self._voltages
        states = effect_states(equations, *self._record, voltages)
        point = dataclasses.replace(self._point, effect_states=states)
        belt_forces = (
            equations.belt_forces(point, equations.belt_states(point))
            if equations.nonlinear_belts
            else self._belt_forces
        )
        forces = equations.net_forces(point, voltages, belt_forces=belt_forces)
        return [np.asarray(force * equations.radius(i)) for i, force in enumerate(forces)]


def effect_forces(
    machine: Machine,
    time_s: Times,
    positions: Array,
    velocities: Array,
    inputs: Inputs,
    effects: Sequence[AppliedEffect] | None = None,
) -> Array:
    """Return the forces that effects add along a motion.

    The result is the difference of two net forces: of the machine with these effects, and of the machine
    without them. Therefore it contains everything that an effect changes: a force, friction, a voltage, a
    current or a belt tension.

    Args:
        machine: Machine. If `effects` is given, it must not have these effects; any other effect that it has
            acts in both cases. If `effects` is not given, all effects of the machine are evaluated.
        positions: Positions, m or rad, shape (N, coordinates).
        velocities: Velocities, m/s or rad/s, shape (N, coordinates).
        effects: Effects to evaluate together. A parameter is a float, or an array of shape (variants, 1) with
            one value for each of several variants. Default: the effects of the machine, which is compared
            with no effect.

    Returns:
        Added forces, N or Nm, shape (N, coordinates), or (variants, N, coordinates) if a parameter is an
        array.
    """
    motion = (time_s, positions, velocities, inputs)
    if effects is None:
        effects, machine = machine.effects, dataclasses.replace(machine, effects=())
    # An effect can change any term of the equations, so the difference of two evaluations is its force.
    complete = dataclasses.replace(machine, effects=(*machine.effects, *effects))
    return net_forces(complete, *motion) - net_forces(machine, *motion)


def sensor_readings(
    machine: Machine,
    positions: ArrayLike,
    velocities: ArrayLike | None = None,
    accelerations: ArrayLike | None = None,
    currents: ArrayLike | None = None,
) -> Array:
    """Return the readings of all sensors along a motion, without delay, noise and rounding.

    Args:
        positions: Positions, m or rad, shape (..., coordinates).
        velocities: Velocities, m/s or rad/s, shape (..., coordinates). Default: at rest.
        accelerations: Accelerations, m/s^2 or rad/s^2, shape (..., coordinates); needed if a sensor measures
            one.
        currents: Currents of the drives, A, shape (..., drives); needed if a sensor measures one.

    Returns:
        Readings in the units of the channels, shape (..., sensors).

    Raises:
        ValueError: If a sensor needs accelerations or currents that are not given.
    """

    def columns(values: ArrayLike | None) -> list[Array] | None:
        return None if values is None else list(np.moveaxis(np.asarray(values, float), -1, 0))

    q = np.asarray(positions, float)
    v = np.zeros_like(q) if velocities is None else velocities
    readings = Equations(machine).sensor_readings(
        list(np.moveaxis(q, -1, 0)), columns(v), columns(accelerations), columns(currents)
    )
    return np.stack(np.broadcast_arrays(*readings), axis=-1)


def ohmic_currents(machine: Machine, velocities: Array, inputs: Array) -> Array:
    """Return the drives' currents by Ohm's law just before each sample, without inductance and delays.

    Args:
        machine: Machine; its effects on the voltage are included.
        velocities: Velocities, m/s or rad/s, shape (N, coordinates).
        inputs: Commanded voltages, V, held from each sample until the next, shape (N, drives).

    Returns:
        Currents, A, shape (N, drives); at the first sample those with the first voltage.
    """
    equations = Equations(machine)
    point = equations.point(np.zeros_like(velocities), velocities)
    held = np.vstack([inputs[:1], inputs[:-1]])
    voltages = equations.motor_voltages(list(held.T))
    return np.column_stack([equations.ohmic_current(j, point, voltage) for j, voltage in enumerate(voltages)])


def law_torques(
    machine: Machine, time_s: Times, positions: Array, velocities: Array, inputs: Inputs
) -> Array:
    """Return the torques that drives with a law, such as servos, exert along a motion, without effects, Nm.

    Args:
        positions: Positions, m or rad, shape (N, coordinates).
        velocities: Velocities, m/s or rad/s, shape (N, coordinates).

    Returns:
        Torques, Nm, shape (N, drives); 0 for drives without a law.
    """
    torques = np.zeros((len(time_s), len(machine.drives)))
    if not machine.drive_laws:
        return torques
    equations = Equations(dataclasses.replace(machine, effects=()))
    voltages = list(inputs.T)
    states = effect_states(equations, time_s, positions, velocities, voltages)
    point = equations.point(positions, velocities, time_s, states)
    for j, drive in enumerate(machine.drives):
        if drive.law:
            torques[:, j] = equations.current(j, point, voltages)
    return torques


def _delayed_voltages(equations: Equations, time_s: Times, inputs: Inputs) -> list[Array]:
    """Return the voltage that reaches each drive, as its mean from each sample to the next.

    The delay of a drive shifts the steps of the commanded voltage to times between the samples; hence the
    mean. The last mean is over an interval as long as the one before. Until the delay has passed, the voltage
    of the first sample acts. Shape (N,), or (variants, N) for delays of several variants.
    """
    # Length of the interval after each sample, s; the last one is as long as the one before it.
    steps = np.diff(time_s, append=2.0 * time_s[-1] - time_s[-2] if len(time_s) > 1 else time_s[-1] + 1.0)
    ends = np.append(time_s, time_s[-1] + steps[-1])
    voltages = []
    for j, delay in enumerate(equations.voltage_delays()):
        if np.all(np.asarray(delay) == 0.0):
            voltages.append(inputs[:, j])
            continue
        # The mean of a held voltage is the difference of its integral over time, Vs, divided by the interval.
        integral = np.concatenate([[0.0], np.cumsum(inputs[:, j] * steps)])
        sent_at = ends - np.asarray(delay)  # s, when the voltage was commanded that acts at `ends`
        # Before the first sample, the voltage of the first sample acts.
        delayed = np.interp(sent_at, ends, integral) + inputs[0, j] * np.minimum(sent_at - ends[0], 0.0)
        voltages.append(np.diff(delayed, axis=-1) / steps)
    return voltages


def effect_states(
    equations: Equations, time_s: Times, positions: Array, velocities: Array, voltages: Sequence[Array]
) -> dict[int, Array]:
    """Integrate the internal states of effects (bristle deflection, motor current, ...) along a motion.

    The states start at zero.

    Args:
        positions: Positions, m or rad, shape (N, coordinates).
        velocities: Velocities, m/s or rad/s, shape (N, coordinates).
        voltages: Voltage of each drive after its delay, V, arrays of shape (N,), or (variants, N) for several
            variants of the parameters.

    Returns:
        State of every effect that has one, SI, shape (N,) or (variants, N), by index in
        `equations.instances`. States are those at the samples; a motor current is the mean from a sample to
        the next, because it varies while the voltage is held.
    """
    states: dict[int, Array] = {}
    for k in equations.states:
        effect = equations.instances[k].effect
        point = equations.point(positions, velocities, time_s, states)
        motor_voltages = equations.motor_voltages(voltages)
        arguments = equations.force_balance(point, motor_voltages, [0.0] * len(point.travel)).arguments.get(
            k, {}
        )
        rows = np.arange(len(time_s))
        if argument_names(effect.definition.next_state) != ("z", "dq") and not effect.definition.current:
            # A bristle; `_BRISTLE_STATE_STRIDE` gives the reason.
            rows = np.unique(np.append(rows[::_BRISTLE_STATE_STRIDE], rows[-1]))
        steps = _step_arguments(equations, k, point, arguments, time_s, rows)
        states[k] = _integrated(effect.definition, steps, rows, len(time_s))
    return states


def _integrated(
    definition: Effect, steps: Mapping[str, Array], rows: NDArray[np.intp], samples: int
) -> Array:
    """Return an effect's state at every sample, stepped from row to row of `rows` with `_step_arguments`."""
    function: Any = definition.next_state
    states = follow_state(function, steps)  # (rows,) or (variants, rows)
    if definition.current:  # the mean over each step by Simpson's rule
        half_steps = {
            name: 0.5 * values if name in ("dt", "dq") else values for name, values in steps.items()
        }
        states = (states + 4.0 * function(z=states, **half_steps) + function(z=states, **steps)) / 6.0
    if len(rows) == samples:
        return states
    variants = [np.interp(np.arange(samples), rows, variant) for variant in np.atleast_2d(states)]
    return np.array(variants) if states.ndim > 1 else variants[0]


def _step_arguments(
    equations: Equations,
    k: int,
    point: MotionPoint,
    arguments: Mapping[str, Array],
    time_s: Array,
    rows: NDArray[np.intp],
) -> dict[str, Array]:
    """Return the arguments of effect k's `next_state` but the state: arrays (rows,) or (variants, rows)."""
    effect, i = equations.instances[k].effect, equations.instances[k].state_coordinate
    durations = np.diff(time_s[rows])
    series: dict[str, Any] = {"dt": np.append(durations, durations[-1] if len(durations) else 0.0)}
    for name, values in arguments.items():
        values = np.asarray(values, float)
        series[name] = values[..., rows] if values.ndim and values.shape[-1] == len(time_s) else values
    if i >= 0:
        position = (point.travel[i] * equations.per_radius(i))[..., rows]
        series["dq"] = np.diff(position, append=position[..., -1:], axis=-1)
        series["dv"] = np.zeros(len(rows))
        series["v"] = (point.speed[i] * equations.per_radius(i))[..., rows]
    for name in effect.parameters:
        series[name] = equations.parameter(f"{effect.label}.{name}")
    names = [name for name in argument_names(effect.definition.next_state) if name != "z"]
    shapes = {name: np.broadcast_shapes(np.shape(series[name]), (len(rows),)) for name in names}
    return {name: np.broadcast_to(series[name], shapes[name]) for name in names}
