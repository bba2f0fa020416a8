"""Curves of the plots in report.html, computed once and kept in evidence.npz: errors, missing force and coverage."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from ..fit.channel_errors import simulation_error
from ..fit.missing_force import smooth_force_residual
from ..fit.motion_variables import dependence_variables
from .result import IdentificationResult

# Points of a thinned curve that are kept at least, if it has as many: every k-th point of the curve is kept, so that
# fewer than twice as many remain.
_LEAST_POINTS = 4000


def plot_data(result: IdentificationResult) -> dict[str, Array]:
    """Compute the curves that the plots show.

    Missing force is the force that would have to act in addition for a machine to follow the measurements. Thinned
    curves keep every k-th point, fewer than 8000 in all.

    Args:
        result: Result of an identification: machines, selected effects, fitted and held-out runs.

    Returns:
        Arrays by name. Of each held-out run RUN, which was not fitted, with n samples:

        - ``RUN/time_s``: sample times, s, shape (n,).
        - ``RUN/inputs``: inputs, in the drives' units, shape (n, drives).
        - ``RUN/measured``: measurements minus the sensors' zeros, in the sensors' units, shape (n, sensors).
        - ``RUN/declared``, ``RUN/before``, ``RUN/after``, ``RUN/plain``: measured minus simulated values of the
          declared machine, of the refitted and corrected ones, and of the plain fit, if there is one; in the sensors'
          units, shape (n, sensors).

        Of all fitted runs, one after the other, thinned to m points:

        - ``force/variable``: variable on which the missing force depends most, such as a position, SI, shape (m,).
        - ``force/before``, ``force/after``: force that the refitted and the corrected machine lack at these points, on
          the coordinate that shows this dependence, N or Nm, shape (m,). All three are absent if the force depends on
          no variable.
        - ``coverage/NAME``: where the runs have been, SI, shape (m,). NAME is an input channel, or "position of C" or
          "velocity of C" for each linear coordinate C; on a machine without linear coordinates, for each coordinate.
    """
    return _held_out_errors(result) | _missing_force(result) | _coverage(result)


def _held_out_errors(result: IdentificationResult) -> dict[str, Array]:
    """Return the held-out runs with the errors of all machines."""
    compared = result.evaluations | ({"plain": result.plain.evaluation} if result.plain else {})
    curves: dict[str, Array] = {}
    for run in result.held_out.runs:
        curves |= {
            f"{run.name}/time_s": run.time_s,
            f"{run.name}/measured": run.outputs,
            f"{run.name}/inputs": run.inputs,
        }
        for name, evaluation in compared.items():
            error = evaluation.errors.get(run.name)  # known if the run was simulated to evaluate the machine
            if error is None:
                error = simulation_error(evaluation.machine, run, result.held_out)
            curves[f"{run.name}/{name}"] = error
    return curves


def _missing_force(result: IdentificationResult) -> dict[str, Array]:
    """Return the missing force of the fitted runs against the variable on which it depends most."""
    if not result.dependence:
        return {}
    strongest, data = result.dependence[0], result.fitted
    coordinate = result.declared.machine.coordinate_names.index(strongest.coordinate)
    variable = [
        dependence_variables(result.before.machine, run, data)[strongest.variable] for run in data.runs
    ]
    curves = {"force/variable": _thinned(variable)}
    for name in ("before", "after"):
        machine = result.evaluations[name].machine
        force = [smooth_force_residual(machine, run, data)[:, coordinate] for run in data.runs]
        curves[f"force/{name}"] = _thinned(force)
    return curves


def _coverage(result: IdentificationResult) -> dict[str, Array]:
    """Return positions, velocities and inputs of the fitted runs."""
    machine, data = result.before.machine, result.fitted
    linear = [c.name for c in machine.coordinates if c.kind == "linear"]
    names = [
        f"{what} of {c}" for what in ("position", "velocity") for c in linear or machine.coordinate_names
    ]
    by_run = [dependence_variables(machine, run, data) for run in data.runs]
    return {
        f"coverage/{name}": _thinned([values[name] for values in by_run])
        for name in (*names, *machine.input_channels)
    }


def _thinned(by_run: list[Array]) -> Array:
    """Return every k-th value of a curve that is given run by run; k depends on the number of values alone."""
    return np.concatenate(by_run)[:: max(1, sum(map(len, by_run)) // _LEAST_POINTS)]
