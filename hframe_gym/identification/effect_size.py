"""Size of an effect: the force that it adds to a machine during the recordings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..dynamics import net_forces
from ..machine import HOOKS, AppliedEffect, Machine, argument_names
from .dataset import Dataset, PreparedRecording
from .prediction import SEARCH_BANDWIDTH, map_runs, predict

Array = NDArray[np.float64]

# Variable of a coordinate, drive or belt by the name of an argument of an effect's formulas (`Effect`).
_VARIABLES = {
    "q": "position",
    "dq": "position",
    "v": "speed",
    "direction": "speed",
    "t": "time",
    "V": "voltage",
    "i": "current",
    "s": "extension",
    "rate": "extension",
}


def effect_force(machine: Machine, effect: AppliedEffect, data: Dataset) -> float:
    """Return the size of the force that an effect adds to a machine during the recordings.

    Args:
        machine: Machine with or without the effect; the motion is predicted without it.
        effect: Effect (deviation from the nominal model) whose force is evaluated.
        data: Runs (times, voltages, measurements) over which the machine is predicted.

    Returns:
        Root mean square over all rows of the root sum of squares over the coordinates, as a force at the belt (torque /
        pulley radius), N; infinite for an effect that changes the structure of the machine or a measurement, which no
        force describes.
    """
    if effect.definition.structure or effect.definition.measurement or effect.definition.measurement_delay:
        return np.inf
    without = machine.replace(effects=tuple(e for e in machine.effects if e.label != effect.label))
    return force_difference(without, without.with_effects(effect), data)


def force_difference(first: Machine, second: Machine, data: Dataset) -> float:
    """Return the size of the difference between the forces of two machines during the recordings.

    Args:
        first: Machine whose predicted motion is used.
        second: Machine with the same coordinates, for example with an effect (deviation from the nominal model), fitted
            to the same data. What parameters of the first machine can represent of that effect is then not a part of
            the difference.
        data: Runs over which the motion is predicted (times, voltages, measurements, SI).

    Returns:
        Root mean square over all rows of the root sum of squares over the coordinates, as a force at the belt (torque /
        pulley radius), N.
    """

    def of_run(run: PreparedRecording) -> Array:
        motion = predict(first, run, SEARCH_BANDWIDTH, period=data.period, states=True)
        record = (run.time_s, motion.positions[0], motion.velocities[0], run.inputs)
        change: Array = net_forces(second, *record) - net_forces(first, *record)
        return change.reshape(-1, len(first.coordinates)) / first.travel_per_unit

    return force_size(np.concatenate(list(map_runs(of_run, data))))


def depend_on_same_variable(first: AppliedEffect, second: AppliedEffect, machine: Machine) -> bool:
    """Check whether two effects act on the same component and depend on the same variable of it.

    If so, a small effect may only correct the formula of a large one: where a formula describes friction as a function
    of the speed to within 10 %, the remaining force is a function of the speed as well.

    Args:
        first: One effect (deviation from the nominal model) at its component.
        second: Another effect.
        machine: Machine on which both act.

    Returns:
        True for example for Stribeck friction and quadratic drag of one coordinate, two functions of its speed.
    """
    sites = [machine.coordinate_of_site(e.site) or e.site for e in (first, second)]
    return sites[0] == sites[1] and bool(_variables(first) & _variables(second))


def _variables(effect: AppliedEffect) -> set[tuple[str, bool]]:
    """Return the variables on which the formulas of an effect depend, and whether it is periodic in them."""
    periodic = any(p.role in ("period", "rate") for p in effect.definition.parameters)
    hooks = [getattr(effect.definition, hook) for hook in HOOKS if getattr(effect.definition, hook)]
    arguments = {name for hook in hooks for name in argument_names(hook)}
    return {(_VARIABLES[name], periodic) for name in arguments & set(_VARIABLES)}


def drive_force(machine: Machine, data: Dataset) -> float:
    """Return the size of the force that the drives apply during the recordings, without back-EMF.

    Args:
        machine: Machine with its drives.
        data: Runs with the voltages.

    Returns:
        Root mean square over all rows of the root sum of squares over the drives, as a force at the belt (torque /
        pulley radius), N.
    """
    gains = [drive.gain / machine.coordinate(drive.coordinate).travel_per_unit for drive in machine.drives]
    return force_size(np.concatenate([run.inputs for run in data.runs]) * gains)


def force_size(force: Array) -> float:
    """Return the root mean square of a force over time.

    Args:
        force: Forces at n samples, N, shape (n, coordinates).

    Returns:
        Root mean square over the samples of the root sum of squares over the coordinates, N.
    """
    return float(np.sqrt(np.mean(np.sum(force**2, axis=1))))
