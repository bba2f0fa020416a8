"""What held-out runs, which no fit uses, say about effects: by how much these reduce their error."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ...machine import Machine
from ...preparation.dataset import Dataset, PreparedRecording
from ..fit.estimation import Fit, prediction_cost
from ..fit.model_error import bandwidths_for
from ..forces.inverse_dynamics import force_error
from ..judge import held_out as judge
from ..judge.error import FitError
from ..judge.run import HeldOutRun, contradicts, shows_effects
from ..predict.prediction import POLISH_STEP, SEARCH_BANDWIDTH, SIMULATION, map_runs
from ..predict.start_uncertainty import prediction_residuals
from .tried_effects import SelectedEffect


def held_out_gain(selected: SelectedEffect, machine: Machine, held_out: Dataset, bandwidth: float) -> float:
    """Return the fraction of the held-out runs' squared error that one of the machine's effects removes.

    The machine with all effects is compared with a copy without this effect, whose other parameters are
    equal. If the effect added coordinates, the comparison is with the machine that was fitted with all other
    effects.

    An observer hides slow errors, and with them the effect of a small constant force. If it shows no gain,
    the error of a simulation decides, provided that the effect removes more than half of it.

    Args:
        selected: The effect, with the machine that was fitted without it.
        machine: Machine with all effects.
        held_out: Held-out runs, prepared.
        bandwidth: Bandwidth of the observer, rad/s; 0 for a simulation.

    Returns:
        Fraction, dimensionless, at most 1; negative if the effect increases the error, as `error_reduction`
        defines it.
    """
    without = _machine_without(selected, machine)
    gain = error_reduction(without, machine, held_out, bandwidth)
    simulated = None
    if bandwidth != SIMULATION:
        simulated = partial(error_reduction, without, machine, held_out, SIMULATION)
    return judge.gain_of_effect(gain, simulated)


def _machine_without(selected: SelectedEffect, machine: Machine) -> Machine:
    """Return a machine without one of its effects; if it added coordinates, as fitted without it."""
    if selected.effect.definition.structure:  # the effect added coordinates
        return selected.machine_without
    return machine.replace(effects=tuple(e for e in machine.effects if e.label != selected.effect.label))


def error_reduction(without: Machine, machine: Machine, held_out: Dataset, bandwidth: float) -> float:
    """Return by which fraction a machine reduces the squared error of another: 1 - error^2 / error_without^2.

    The error is the root mean square prediction error in units of the sensors' noise. With the widest
    observer (60 rad/s), for machines without belts and with a drive and a sensor for each coordinate, it is
    the error of the drives' force instead: force by the voltages minus force that the measured motion
    requires (`inverse_dynamics.force_error`). Effects on sensors do not change this force. If the machines
    differ in such effects, the prediction errors are therefore compared.

    Args:
        without: Machine to compare with, for example without an effect.
        machine: The other machine, for example with the effect.
        held_out: Runs on which they are compared.
        bandwidth: Bandwidth of the observer, rad/s; 0 for a simulation.

    Returns:
        Fraction, dimensionless, at most 1; negative if the error is larger. If predictions diverge: minus
        infinity for `machine` alone, 1 for `without` alone, NaN for both.
    """
    on_sensors = [
        {
            e.label
            for e in m.effects
            if e.definition.measurement or e.definition.measurement_delay or e.definition.clock
        }
        for m in (without, machine)
    ]
    comparable = bandwidth == SEARCH_BANDWIDTH and on_sensors[0] == on_sensors[1]
    forces = [force_error(m, held_out) if comparable else None for m in (without, machine)]
    if forces[0] is not None and forces[1] is not None:
        return 1.0 - (forces[1] / forces[0]) ** 2
    costs = [prediction_cost(m, held_out, bandwidth, longest_step=POLISH_STEP) for m in (without, machine)]
    return 1.0 - costs[1] / costs[0]


def worsens_simulation(without: Machine, machine: Machine, held_out: Dataset) -> bool:
    """Check whether a machine with effects simulates held-out runs worse than the refitted one without.

    An observer hides slow errors, so that wrong effects may reduce the error of predictions and add up in a
    simulation. Errors of interpolated voltages also add up in a simulation. Runs with such errors are
    therefore predicted with the observer of the smallest suitable bandwidth (`bandwidths_for`).

    Args:
        without: Refitted machine without the effects.
        machine: Machine with all effects.

    Returns:
        True if the ratio of the squared simulation errors, with effects / without effects, has a geometric
        mean over the runs above 1. In this mean, a single run with a large error of another cause has little
        weight. A run on which both simulations diverge does not count.
    """
    bandwidth, changes = bandwidths_for(held_out)[-1], []
    for run in held_out.single_runs():
        costs = [prediction_cost(m, run, bandwidth, longest_step=POLISH_STEP) for m in (without, machine)]
        changes.append(np.log(costs[1]) - np.log(costs[0]) if np.isfinite(costs).any() else 0.0)
    return judge.worsens_simulation(changes)


def is_excited(selected: SelectedEffect, machine: Machine, held_out: Dataset, bandwidth: float) -> bool:
    """Check whether an effect changes the predictions of the held-out runs at all.

    Examples of effects that do not: a current limit that the held-out voltages never reach, or a constant
    force on a carriage that friction holds.

    Args:
        selected: The effect, with the machine that was fitted without it.
        machine: Machine with all effects.
        held_out: Held-out runs, prepared.
        bandwidth: Bandwidth of the observer, rad/s; 0 for a simulation.

    Returns:
        True if the root mean square change of the predictions by the effect is at least 1/20 of their root
        mean square error, or if a prediction diverges.
    """
    without = _machine_without(selected, machine)

    def of_run(run: PreparedRecording) -> tuple[float, float]:
        errors = [
            prediction_residuals(m, run, held_out, bandwidth, longest_step=POLISH_STEP)
            for m in (machine, without)
        ]
        return float(np.sum((errors[1] - errors[0]) ** 2)), float(np.sum(errors[0] ** 2))

    change, error = np.sum(list(map_runs(of_run, held_out)), axis=0)
    return judge.is_excited(float(change), float(error))


def held_out_evidence(
    selected: Sequence[SelectedEffect], machine: Machine, held_out: Dataset, bandwidth: float
) -> dict[str, judge.HeldOutEffect]:
    """Return what the held-out runs say about several effects: gains, and whether they depend on them.

    Args:
        selected: The effects, each with the machine that was fitted without it.
        machine: Machine with all effects.
        held_out: Held-out runs, prepared.
        bandwidth: Bandwidth of the observer, rad/s; 0 for a simulation.

    Returns:
        Results of `held_out_gain` and `is_excited`, by the effect's label (name@site).
    """
    return {
        s.effect.label: judge.HeldOutEffect(
            held_out_gain(s, machine, held_out, bandwidth), is_excited(s, machine, held_out, bandwidth)
        )
        for s in selected
    }


def contradicting_held_out_runs(
    after: Fit, before: Machine, selected: Sequence[SelectedEffect], held_out: Dataset
) -> tuple[str, ...]:
    """Find the held-out runs that a fitted machine explains far worse than the runs that it was fitted to.

    Either something was wrong with such a run (a loose connector, a slipped belt, another amplifier setting),
    or it excites an effect that the fitted runs do not excite. A run is not listed if the selected effects
    cause its error: it is evidence against them.

    Args:
        after: Fit of the machine with the selected effects.
        before: Refitted machine without effects.
        selected: The selected effects.
        held_out: Held-out runs, prepared.

    Returns:
        Names of the runs that contradict the machine by `judge.run.contradicts`, at the observer bandwidth of
        the fit.
    """

    def shown_by(run: Dataset) -> HeldOutRun:
        cost = prediction_cost(after.machine, run, after.bandwidth, longest_step=POLISH_STEP)

        def gains() -> tuple[float, ...]:
            together = error_reduction(before, after.machine, run, after.bandwidth)
            return (together, *(held_out_gain(s, after.machine, run, after.bandwidth) for s in selected))

        return HeldOutRun(FitError(cost, run.count), after.chi2, gains if selected else None)

    return tuple(run.runs[0].name for run in held_out.single_runs() if contradicts(shown_by(run)))


def runs_with_effects(after: Fit, before: Machine, held_out: Dataset) -> tuple[str, ...]:
    """Find the held-out runs of whose squared error the selected effects together remove more than 90 %.

    Args:
        after: Fit of the machine with the selected effects.
        before: Refitted machine without effects.
        held_out: Held-out runs, prepared.

    Returns:
        Names of the runs (`judge.run.shows_effects`); errors are those at the observer bandwidth of the fit.
    """

    def gain(run: Dataset) -> float:
        return error_reduction(before, after.machine, run, after.bandwidth)

    return tuple(run.runs[0].name for run in held_out.single_runs() if shows_effects(gain(run)))
