"""Compute the curves that the report plots, which a result's folder keeps as evidence.npz."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from ..fit.channel_errors import simulation_error
from ..fit.missing_force import smooth_force_residual
from ..fit.motion_variables import dependence_variables
from .result import IdentificationResult

_MAX_POINTS = 4000  # Points of a thinned curve in evidence.npz.


def plot_data(result: IdentificationResult) -> dict[str, Array]:
    """Compute the curves that the report plots.

    The residual force is the force that would have to be added for a machine to follow the measurements. Thinned curves
    have fewer than 8000 points.

    Args:
        result: Result of an identification: machines, selected effects and fitted runs.

    Returns:
        Arrays by name, where RUN is the name of a held-out run (not fitted) with n samples.

        - ``RUN/time_s``: sample times of each held-out run, s, shape (n,).
        - ``RUN/measured``: its measurements minus the sensors' zeros, m or rad, shape (n, sensors).
        - ``RUN/declared``, ``RUN/before``, ``RUN/after``: simulation errors of the declared, refitted and corrected
          machine, m or rad, shape (n, sensors).
        - ``RUN/inputs``: its inputs, in the drives' units, shape (n, drives).
        - ``RUN/plain``: the same of the plain fit; absent if there is none.
        - ``force/variable``: variable that the residual force of the fitted runs depends on most, thinned to m points,
          SI, shape (m,); absent if there is none.
        - ``force/before``, ``force/after``: residual force of the refitted and of the corrected machine at these
          points, N or Nm, shape (m,).
        - ``coverage/NAME``: motion and inputs of the fitted runs, thinned, SI, shape (m,). NAME is an input channel, or
          "position of C" or "velocity of C" for each linear coordinate C (if there is none, for each coordinate).
    """
    curves: dict[str, Array] = {}
    for run in result.held_out.runs:
        curves |= {f"{run.name}/time_s": run.time_s, f"{run.name}/measured": run.outputs}
        curves[f"{run.name}/inputs"] = run.inputs
        plain = {"plain": result.plain.evaluation} if result.plain else {}
        for name, evaluation in (result.evaluations | plain).items():
            evaluated = evaluation.errors.get(run.name)
            error = (
                simulation_error(evaluation.machine, run, result.held_out) if evaluated is None else evaluated
            )
            curves[f"{run.name}/{name}"] = error
    if result.dependence:
        data, strongest = result.fitted, result.dependence[0]
        i = result.declared.machine.coordinate_names.index(strongest.coordinate)
        by_run = [
            dependence_variables(result.before.machine, run, data)[strongest.variable] for run in data.runs
        ]
        thin = max(1, sum(map(len, by_run)) // _MAX_POINTS)
        curves["force/variable"] = np.concatenate(by_run)[::thin]
        for name in ("before", "after"):
            machine = result.evaluations[name].machine
            forces = [smooth_force_residual(machine, run, data)[:, i] for run in data.runs]
            curves[f"force/{name}"] = np.concatenate(forces)[::thin]
    return curves | {f"coverage/{name}": values for name, values in _coverage(result).items()}


def _coverage(result: IdentificationResult) -> dict[str, Array]:
    """Return positions, velocities and inputs of the fitted runs, thinned."""
    machine, data = result.before.machine, result.fitted
    linear = [c.name for c in machine.coordinates if c.kind == "linear"]
    names = [
        f"{what} of {c}" for what in ("position", "velocity") for c in linear or machine.coordinate_names
    ]
    by_run = [dependence_variables(machine, run, data) for run in data.runs]
    thin = max(1, sum(len(run.time_s) for run in data.runs) // _MAX_POINTS)
    return {
        name: np.concatenate([values[name] for values in by_run])[::thin]
        for name in (*names, *machine.input_channels)
    }
