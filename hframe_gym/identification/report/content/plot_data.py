"""Curves of the plots in report.html, computed once and kept in evidence.npz: errors, force, coverage."""

from __future__ import annotations

import numpy as np

from ....arrays import Array
from ...fit.channel_errors import simulation_error
from ...forces.missing_force import smooth_force_residual
from ...forces.motion_variables import dependence_variables
from .result import IdentificationResult
from .result_curves import MissingForce, ResultCurves, RunCurves

# Points of a thinned curve that are kept at least, if it has as many: every k-th point of the curve is kept,
# so that fewer than twice as many remain.
_LEAST_POINTS = 4000


def plot_data(result: IdentificationResult) -> ResultCurves:
    """Compute the curves of the report's plots.

    They are the errors of all machines on the held-out runs, the missing force over the variable on which it
    depends most, and the positions, velocities and inputs that the fitted runs cover. Of curves of the fitted
    runs, every k-th row is kept, so that fewer than 8000 remain.

    Args:
        result: Result of an identification: machines, selected effects, fitted and held-out runs.
    """
    return ResultCurves(_held_out_errors(result), _missing_force(result), _coverage(result))


def _held_out_errors(result: IdentificationResult) -> dict[str, RunCurves]:
    """Return the held-out runs with the errors of all machines."""
    compared = result.evaluations | ({"plain": result.plain.evaluation} if result.plain else {})
    curves = {}
    for run in result.held_out.runs:
        errors = {}
        for name, evaluation in compared.items():
            error = evaluation.errors.get(run.name)  # known if the run was simulated to evaluate the machine
            if error is None:
                error = simulation_error(evaluation.machine, run, result.held_out)
            errors[name] = error
        curves[run.name] = RunCurves(run.time_s, run.outputs, errors, run.inputs)
    return curves


def _missing_force(result: IdentificationResult) -> MissingForce | None:
    """Return the missing force of the fitted runs against the variable on which it depends most."""
    if not result.dependence:
        return None
    strongest, data = result.dependence[0], result.fitted
    coordinate = result.declared.machine.coordinate_names.index(strongest.coordinate)
    variable = [
        dependence_variables(result.before.machine, run, data)[strongest.variable] for run in data.runs
    ]
    forces = {}
    for name in ("before", "after"):
        machine = result.evaluations[name].machine
        force = [smooth_force_residual(machine, run, data)[:, coordinate] for run in data.runs]
        forces[name] = _thinned(force)
    return MissingForce(_thinned(variable), forces)


def _coverage(result: IdentificationResult) -> dict[str, Array]:
    """Return positions, velocities and inputs of the fitted runs."""
    machine, data = result.before.machine, result.fitted
    linear = [c.name for c in machine.coordinates if c.kind == "linear"]
    names = [
        f"{what} of {c}" for what in ("position", "velocity") for c in linear or machine.coordinate_names
    ]
    by_run = [dependence_variables(machine, run, data) for run in data.runs]
    return {name: _thinned([values[name] for values in by_run]) for name in (*names, *machine.input_channels)}


def _thinned(by_run: list[Array]) -> Array:
    """Return every k-th value of a curve that is given run by run; k depends on its length alone."""
    return np.concatenate(by_run)[:: max(1, sum(map(len, by_run)) // _LEAST_POINTS)]
