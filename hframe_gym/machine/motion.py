"""Motion of a machine: observed coordinates, states at rest, motions that stretch no belt."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from .effect import AppliedEffect
from .machine import Machine
from .uncertainty import Uncertainty

# m per unit of the leading coordinate; a motion that extends a belt by more is not rigid.
_RIGID_EXTENSION = 1e-9
# Hz, natural frequency below which a load is slow. Designed for the cart alone, with a load of 0.3 of its
# mass, `pid` settles an H-frame within 0.2 mm in 0.41 instead of 0.76 s at 1.8 Hz, in 0.67 instead of 0.70 s
# at 4 Hz, and in 0.72 instead of 0.69 s at 5 Hz.
FASTEST_SLOW_LOAD_HZ = 4.0


def observed_coordinates(machine: Machine) -> tuple[str, ...]:
    """List the coordinates of a full-state observation: the tool's axes, then the other driven coordinates.

    The observation holds the positions of these coordinates, then their velocities.
    """
    return tuple(dict.fromkeys((*machine.tool_axes, *(drive.coordinate for drive in machine.drives))))


def pulley_names(machine: Machine) -> tuple[str, ...]:
    """List a machine's pulleys: rotary coordinates, except those that a spring holds, such as bridge yaw."""
    return tuple(
        c.name for c in machine.coordinates if c.kind == "rotary" and c.name not in machine.spring_loaded
    )


def rigid_counterpart(machine: Machine, *, with_slow_loads: bool = False) -> Machine:
    """Return the simplified machine for which controllers are designed: without coordinates that effects add.

    A bridge does not yaw, a payload does not swing, the frame that carries a sensor rests, idlers have no
    inertia of their own, a gear has no gap: no sensor measures these coordinates, and a controller does not
    act against the vibration that they cause. The effects that add them are left out with their parameters; a
    machine without such effects is returned as it is. A load that is left out moves with its carriage, unless
    it is slow (`slow_loads`): then the carriage moves alone. A load behind a gap that is itself the axis of
    the tool remains: the controller moves it through the teeth.

    Args:
        with_slow_loads: Whether slow loads remain in the machine; a state estimator needs them.
    """
    slow = slow_loads(machine)
    left_out = tuple(e for e in effects_left_out(machine) if not (with_slow_loads and e in slow))
    if not left_out:
        return machine
    names = {e.coordinate for e in left_out if e.coordinate}
    labels = {e.label for e in left_out}

    def kept(row: Mapping[str, float]) -> dict[str, float]:
        return {key: factor for key, factor in row.items() if names.isdisjoint(key.split("*"))}

    rigid = dataclasses.replace(
        machine,
        coordinates=tuple(c for c in machine.coordinates if c.name not in names),
        belts=tuple(
            dataclasses.replace(b, extension=kept(b.extension), length=kept(b.length)) for b in machine.belts
        ),
        sensors=tuple(dataclasses.replace(s, row=kept(s.row)) for s in machine.sensors),
        effects=tuple(e for e in machine.effects if e not in left_out),
        ties={key: tie for key, tie in machine.ties.items() if key.partition(".")[0] not in names},
        uncertainty=_without(machine.uncertainty, labels),
    )
    for effect in reversed(left_out):  # the last one has changed the structure last
        if effect.definition.rigid and effect not in slow:
            rigid = effect.definition.rigid(rigid, effect)
    return rigid


def effects_left_out(machine: Machine) -> tuple[AppliedEffect, ...]:
    """Return the effects that `rigid_counterpart` leaves out, slow loads included.

    They add coordinates or a rigidly carried load. A load behind a gap that is itself an axis of the tool is
    not one of them.
    """
    added = (e for e in machine.effects if e.coordinate or e.definition.rigid)
    return tuple(e for e in added if not _moves_tool(machine, e))


def _moves_tool(machine: Machine, effect: AppliedEffect) -> bool:
    """Return whether the coordinate behind an effect's contact is an axis of the tool."""
    contact = next((b for b in machine.belts if b.name == effect.added_belt), None)
    return contact is not None and not set(machine.tool_axes).isdisjoint(contact.extension)


def slow_loads(machine: Machine) -> tuple[AppliedEffect, ...]:
    """Return the effects that add a load to a carriage whose natural frequency is below 4 Hz.

    The carriage reaches a goal before such a load follows. The frequency, `FASTEST_SLOW_LOAD_HZ`, is that
    with a held carriage.
    """
    return tuple(
        e for e in machine.effects if e.definition.reaction and _natural_frequency(e) < FASTEST_SLOW_LOAD_HZ
    )


def _natural_frequency(load: AppliedEffect) -> float:
    """Return the natural frequency of a load whose carriage is held, Hz."""
    return math.sqrt(-load("force", q=1.0, v=0.0, m=1.0, net=0.0)) / (2.0 * math.pi)


def _without(uncertainty: Uncertainty | None, labels: Collection[str]) -> Uncertainty | None:
    """Return the covariance of the parameters that do not belong to the effects with these labels."""
    if uncertainty is None:
        return None
    names = uncertainty.names
    remaining = [i for i, name in enumerate(names) if name.rpartition(".")[0] not in labels]
    return Uncertainty(
        tuple(names[i] for i in remaining), uncertainty.covariance[np.ix_(remaining, remaining)]
    )


def rest_state(machine: Machine, position: ArrayLike | None = None, *, leading: int | None = None) -> Array:
    """Return the state of a machine at rest, with unstretched belts, for given positions of the carriages.

    The pulley angles follow from the condition that no belt is stretched. If it cannot be met, the sum of the
    squared extensions is minimal. Coordinates that a spring holds, such as the yaw of a bridge, are zero.

    Args:
        position: Positions of the linear coordinates in the machine's order, m, shape (linear coordinates,);
            a single value applies to all of them. Default: zeros. Ignored for a machine without linear
            coordinates, which rests at zero.
        leading: Number of linear coordinates, the first ones, to which `position` refers; the others, which
            effects added, follow like pulleys. Default: all.

    Returns:
        Positions of all coordinates, m or rad, then velocities, which are zero, shape (2 * coordinates,).

    Raises:
        ValueError: If there are several positions, but not one per leading linear coordinate.
    """
    linear = [i for i, c in enumerate(machine.coordinates) if c.kind == "linear"]
    q = _unstretched(machine, linear[:leading], 0.0 if position is None else position)
    return np.concatenate([q, np.zeros(len(q))])


def commanded_state(machine: Machine, commands: ArrayLike) -> Array:
    """Return the state at rest in which drives with position commands hold their coordinates as commanded.

    Belts are stretched as little as possible.

    Args:
        commands: Inputs, in the drives' units, shape (drives,); only commanded positions matter.

    Returns:
        Positions of all coordinates, m or rad, then velocities, which are zero, shape (2 * coordinates,).
        Without position commands, it is the result of `rest_state`.
    """
    held = [machine.coordinate_names.index(name) for name in machine.position_commands]
    if not held:
        return rest_state(machine)
    q = np.zeros(len(machine.coordinates))
    q[held] = np.asarray(commands, float)[list(machine.position_commands.values())]
    free = [i for i in range(len(q)) if i not in held]
    if free and machine.belts:
        G = machine.belt_matrix
        q[free] = np.linalg.lstsq(G[:, free], -G[:, held] @ q[held], rcond=None)[0]
    return np.concatenate([q, np.zeros(len(q))])


def _unstretched(machine: Machine, leaders: Sequence[int], position: ArrayLike) -> Array:
    """Return the positions (coordinates,) where others follow the leading coordinates without stretch."""
    q = np.zeros(len(machine.coordinates))
    q[leaders] = np.asarray(position, float)
    held = machine.spring_loaded
    followers = [
        i for i, name in enumerate(machine.coordinate_names) if i not in leaders and name not in held
    ]
    if followers and machine.belts:
        # Zero extension of every belt: G[:, followers] @ angles = -G[:, leaders] @ positions.
        G = machine.belt_matrix
        q[followers] = np.linalg.lstsq(G[:, followers], -G[:, leaders] @ q[leaders], rcond=None)[0]
    return q


def rest_positions_per_axis(machine: Machine) -> Array:
    """Return all coordinates' motion per tool motion with unstretched belts, SI, shape (coordinates, axes).

    With the tool at p, the positions in `rest_state` are this matrix times p.
    """
    tool = [machine.coordinate_names.index(axis) for axis in machine.tool_axes]
    others = [i for i, c in enumerate(machine.coordinates) if c.kind == "linear" and i not in tool]
    positions = np.zeros((len(machine.coordinates), len(tool)))
    for column, row in enumerate(np.eye(len(tool))):
        positions[:, column] = _unstretched(machine, [*tool, *others], [*row, *(0.0 for _ in others)])
    return positions


def rigid_basis(machine: Machine) -> Array:
    """Return a basis of the rigid motions: displacements that stretch neither belts nor springs.

    Returns:
        Displacements of the coordinates, m or rad, one rigid motion per column,
        shape (coordinates, rigid motions).
    """
    if not machine.belts:
        held = np.isin(machine.coordinate_names, machine.spring_loaded)
        return np.eye(len(machine.coordinates))[:, ~held]
    constraints = [machine.coefficients(b.extension) for b in machine.belts]
    constraints += [machine.coefficients({name: 1.0}) for name in machine.spring_loaded]
    unstretched = _unstretched_travel(tuple(map(tuple, np.array(constraints).tolist())))
    return np.asarray(unstretched / machine.travel_per_unit[:, None])


@lru_cache(maxsize=64)  # of few machines, but asked for before every prediction
def _unstretched_travel(constraints: tuple[tuple[float, ...], ...]) -> Array:
    """Return a basis of the belt travels of the coordinates, m, that are 0 in all constraints."""
    from scipy.linalg import null_space

    return np.asarray(null_space(np.array(constraints)))


def rigid_motions(machine: Machine) -> dict[str, Array]:
    """Return the rigid-body motions of a machine: independent motions in which no belt is stretched.

    In each motion one linear coordinate leads, and others follow so that all belts keep their length: the
    pulleys, or in a machine without pulleys the other carriages. In a machine without belts each coordinate
    moves alone. Coordinates that a spring holds, such as the yaw of a bridge, do not move.

    Returns:
        Motions by name of the leading coordinate: motion of every coordinate per unit of the leading one (m
        or rad per m or rad), shape (coordinates,). A linear coordinate does not lead a motion if it follows
        another one or cannot move without stretching a belt.
    """
    count = len(machine.coordinates)
    movable = [i for i, name in enumerate(machine.coordinate_names) if name not in machine.spring_loaded]
    if not machine.belts:
        return {machine.coordinate_names[i]: np.eye(count)[i] for i in movable}
    G = machine.belt_matrix  # extension of each belt per unit of each coordinate, (belts, coordinates)
    pulleys = [machine.coordinate_names.index(name) for name in pulley_names(machine)]
    motions: dict[str, Array] = {}
    for index in movable:
        coordinate = machine.coordinates[index]
        if coordinate.kind == "linear":
            motion = np.eye(count)[index]  # 1 for the leading coordinate, 0 for carriages that do not follow
            followers = pulleys or [i for i in movable if i != index]
            motion[followers] = np.linalg.lstsq(G[:, followers], -G[:, index], rcond=None)[0]
            led = any(abs(earlier[index]) > _RIGID_EXTENSION for earlier in motions.values())
            if np.max(np.abs(G @ motion)) < _RIGID_EXTENSION and not led:
                motions[coordinate.name] = motion
    return motions


def carried_through_contacts(machine: Machine, displacements: Array) -> Array:
    """Return displacements in which the coordinates behind stiff contacts move along with those before them.

    A displacement of one side alone would cause a blow. The result has the shape (n, coordinates).

    Args:
        displacements: Displacements of the coordinates, m or rad, or their rates, shape (n, coordinates).
    """
    carried = np.array(displacements, float)
    for contact in machine.contacts:
        near, far = (machine.coordinate_names.index(name) for name in (contact.near, contact.far))
        carried[:, far] = carried[:, near]
    return carried


@dataclass(frozen=True)
class MotionLimits:
    """Inertia, largest force and speed along one rigid motion, to check whether a machine file is plausible.

    Attributes:
        inertia: Inertia that moves, referred to the leading coordinate, kg or kg m^2.
        force: Force of all drives at standstill, minus Coulomb friction, N or Nm.
        speed: Steady speed at rated voltage, m/s or rad/s, within the limits of drives with set points;
            infinite if neither friction, back-EMF nor a limit holds it back.
    """

    inertia: float
    force: float
    speed: float


def motion_limits(machine: Machine) -> dict[str, MotionLimits]:
    """Compute inertia, maximum force and steady speed along each rigid motion, all drives at rated voltage.

    A rigid motion stretches no belt; on an H-frame, these are the motions along x and along y. The values
    show whether a description of a machine is plausible, for example whether its units are right. Effects are
    ignored.

    Returns:
        Inertia (kg or kg m^2), force (N or Nm) and speed (m/s or rad/s) by name of the leading coordinate
        (`rigid_motions`).
    """
    limits = {}
    for name, motion in rigid_motions(machine).items():
        rates = dict(zip(machine.coordinate_names, np.abs(motion).tolist(), strict=True))
        force = sum(d.gain * d.rated_voltage * rates[d.coordinate] for d in machine.drives)
        force -= sum(c.coulomb * rates[c.name] for c in machine.coordinates)
        damping = sum(c.viscous * rates[c.name] ** 2 for c in machine.coordinates)
        damping += sum(d.back_emf * rates[d.coordinate] ** 2 for d in machine.drives)
        inertia = sum(c.mass * rates[c.name] ** 2 for c in machine.coordinates)
        force = max(force, 0.0)
        speeds = [d.largest_speed / rates[d.coordinate] for d in machine.drives if rates[d.coordinate]]
        steady = force / damping if damping else float("inf")
        limits[name] = MotionLimits(inertia, force, min([steady, *speeds]))
    return limits
