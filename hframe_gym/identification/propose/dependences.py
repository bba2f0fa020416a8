"""Rank possible causes of a missing force, or of a disagreement of sensors, as a hint for the user."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...machine import HOOKS, AppliedEffect, Machine, argument_names
from ...machine.motion import rigid_motions
from ...preparation.dataset import Dataset
from ..fit.channel_errors import white_sensors
from ..forces.missing_force import (
    correction_filters,
    missing_motions,
    motion_directions,
    sensor_combinations,
)
from ..forces.motion_variables import smooth_sign
from ..judge import cause as judge
from ..predict.free_parameters import typical_force
from .cause_comparison import Cause, CauseComparison, Signals, Unexplained
from .causes import CONSTANT, causes_of_disagreement, causes_of_force

# Fraction of the typical force; a smaller missing force is a rounding error, as on an axis at rest.
_ROUNDING_FORCE = 1e-9
_FORCE_HZ = 150.0  # rate at which forces below 30 Hz are compared
_DISAGREEMENT_HZ = 500.0  # rate at which the sensors are compared, whose noise needs no filter
# Variables that come before others which explain about as much.
_PLAIN = ("position", "velocity", "current", "torque")


class Dependence(NamedTuple):
    """Dependence of the force residual on a variable.

    Attributes:
        variable: Name of the variable, e.g. "velocity of x"; `CONSTANT` for a force that depends on nothing.
        coordinate: Coordinate on which the force acts.
        explained: Fraction of the variance beyond noise, of the residual force or of the disagreement of the
            sensors, that the variable explains in runs to which the curve was not fitted, in [0, 1].
        component: Where the cause lies: a coordinate, drive or output channel, "drives", "belts" or "clock".
    """

    variable: str
    coordinate: str
    explained: float
    component: str = ""


def rank_dependences(machine: Machine, data: Dataset) -> list[Dependence]:
    """Rank possible causes of the missing force and of the sensors' disagreement, as a hint for the user.

    Args:
        machine: Machine that predicts, with its parameters fitted.

    Returns:
        Variables with their components that explain more than 5 % of the force, or of the disagreement,
        beyond noise. Sorted by the fraction, noise included, that they explain for certain (one standard
        error) in runs to which they were not fitted, largest first. A coordinate has none if its sensors show
        only white noise in a simulation, or if it never moves.
    """
    white = white_sensors(machine, data)
    deviating = _deviating(machine, white)
    if not deviating.any():
        return []
    motions = missing_motions(machine, data)
    if not all(np.isfinite(array).all() for motion in motions for array in motion):
        return []  # the prediction diverges
    signals = Signals(machine, data, motions, _FORCE_HZ, filtered=True)
    if not signals.count:
        return []
    force = np.concatenate([motion.force for motion in motions])
    if np.abs(force).max() <= _ROUNDING_FORCE * typical_force(machine):
        return []
    absorbed, directions = _absorbed(machine, signals), motion_directions(machine, data)
    missing = Unexplained(
        signals.thinned([motion.correction for motion in motions]),
        signals.thinned([motion.correction_noise for motion in motions]),
        signals.compared(force),
        directions,
        correction_filters(machine, data),
    )
    comparison = CauseComparison(signals, missing, absorbed)
    ranked = _ranked(comparison, causes_of_force(machine, comparison, directions, deviating))
    if motions[0].disagreement.shape[1]:
        signals = Signals(machine, data, motions, _DISAGREEMENT_HZ, filtered=False)
        disagreement = signals.thinned([motion.disagreement for motion in motions])
        noise = signals.thinned([motion.disagreement_noise for motion in motions])
        unexplained = Unexplained(
            disagreement, noise, prompt=disagreement, directions=sensor_combinations(machine, data).T
        )
        absorbed = np.hstack([absorbed, force])  # a missing force stretches belts as well
        comparison = CauseComparison(signals, unexplained, absorbed, free_constants=True)
        ranked += _ranked(comparison, causes_of_disagreement(machine, comparison, ~white))
    best: dict[tuple[str, str], Dependence] = {}
    for _, dependence in sorted(ranked, key=lambda entry: -entry[0]):
        best.setdefault((dependence.component, dependence.variable), dependence)
    return list(best.values())


def _ranked(comparison: CauseComparison, causes: Iterable[Cause]) -> list[tuple[float, Dependence]]:
    """Return causes that explain enough of what is missing, each with the number by which they are sorted."""
    ranked = []
    for cause in causes:
        plain = cause.variable.startswith(_PLAIN)
        constant = cause.variable == CONSTANT
        found = judge.CauseEvidence(*comparison.explained(cause), comparison.beyond_noise, plain, constant)
        if judge.is_cause(found):
            dependence = Dependence(cause.variable, cause.coordinate, found.fraction, cause.component)
            ranked.append((judge.rank_of_cause(found, comparison.total), dependence))
    return ranked


def _deviating(machine: Machine, white: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark the coordinates whose sensors show more than white noise in a simulation, shape (coordinates,).

    For a coordinate without a sensor, the sensors of the coordinates that move with it count.
    """
    names = machine.coordinate_names
    sites = [machine.coordinate_of_sensor(sensor) for sensor in machine.sensors]
    measured = np.array([[site == name for site in sites] for name in names])
    related = measured.copy()
    for motion in rigid_motions(machine).values():
        related |= np.outer(motion != 0.0, measured[motion != 0.0].any(axis=0))
    related[measured.any(axis=1)] = measured[measured.any(axis=1)]
    return np.asarray((related & ~white).any(axis=1))


def _absorbed(machine: Machine, signals: Signals) -> Array:
    """Return the signals in proportion to which refitted parameters change the force, shape (rows, k)."""
    names = machine.coordinate_names
    columns = [signals[f"acceleration of {name}"] for name in names]
    columns += [signals[f"velocity of {name}"] for name in names]
    columns += [smooth_sign(signals[f"velocity of {name}"]) for name in names]
    columns += [signals[channel] for channel in machine.input_channels]
    return np.stack(columns, axis=1)


# Variables of a force by the arguments of its formula. Other formulas (of a voltage, a tension) may depend on
# any variable of their component.
_VARIABLES = {"q": "position", "v": "velocity", "direction": "velocity", "t": "time", "drive": "load"}
_FRICTION_HOOKS = ("coulomb", "friction", "viscous")  # it changes its sign with the velocity
_SENSOR_HOOKS = {"measurement", "measurement_delay"}


def agree_with_causes(
    effects: Sequence[AppliedEffect], ranked: Sequence[Dependence], machine: Machine
) -> bool:
    """Return whether selected effects agree with the causes of the missing force (`rank_dependences`).

    The causes are found without the effects' formulas. An effect agrees with a cause if it acts on the same
    component, and its formula depends on the same kind of variable, or on none if the cause is a constant
    force. An effect of a sensor agrees with no cause, not even with that of a disagreement of this sensor:
    belts that slip imitate a wrong scale, and an eccentric pulley an eccentric encoder. The position of the
    pulley explains 94 and 98 % of what its encoder says differently.

    Args:
        effects: Effects that the search selected.
        ranked: Causes of the force that is missing without the effects, the strongest first.
        machine: Machine without the effects.

    Returns:
        True if an effect agrees with the strongest cause, and each effect with one of them.
    """
    return judge.names_causes(
        [[_is_cause(effect, cause, effects, machine) for cause in ranked] for effect in effects]
    )


def _is_cause(
    effect: AppliedEffect, cause: Dependence, effects: Sequence[AppliedEffect], machine: Machine
) -> bool:
    """Return whether an effect acts on a cause's component, and its formula depends on the cause's variable.

    An effect that each drive has acts on the drives together.
    """
    definition = effect.definition
    components = [effect.site, machine.coordinate_of_site(effect.site, definition.site)]
    alike = {e.site for e in effects if e.definition.name == definition.name}
    if alike >= {drive.name for drive in machine.drives}:
        components.append("drives")
    if cause.component not in components:
        return False
    hooks = {hook: getattr(definition, hook) for hook in HOOKS if getattr(definition, hook)}
    if hooks.keys() & _SENSOR_HOOKS:
        return False
    if not hooks.keys() & {"force", *_FRICTION_HOOKS}:
        return True
    arguments = {name for f in hooks.values() for name in argument_names(f)}
    if arguments <= {p.name for p in definition.parameters}:
        return cause.variable == CONSTANT
    kinds = {_VARIABLES[name] for name in arguments if name in _VARIABLES}
    if hooks.keys() & set(_FRICTION_HOOKS):
        kinds.add("velocity")
    return cause.variable.partition(" of ")[0] in kinds
