"""The curves behind an answer, small enough to keep beside it: what the report and a notebook plot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..atomic_files import whole_file
from .residual import free_run_error, smooth_force_residual, variables
from .result import IdentificationResult

Array = NDArray[np.float64]
_POINTS = 4000


def evidence(answer: IdentificationResult) -> dict[str, Array]:
    """Arrays by name.

    `RUN/time_s` (n,), `RUN/measured`, `RUN/declared`, `RUN/before`, `RUN/after` (n, sensors): held-out runs,
    measured outputs and the three machines' errors.  `force/variable`, `force/before`, `force/after` (m,): the
    residual force on the coordinate, against the variable, that leads the answer's dependence (fitted runs, thinned).
    `coverage/NAME` (m,): where the fitted runs went, by position, velocity and input (thinned).
    """
    found: dict[str, Array] = {}
    stages = {"declared": answer.declared, "before": answer.before, "after": answer.after}
    for run in answer.held_out.runs:
        found[f"{run.name}/time_s"] = run.time_s
        found[f"{run.name}/measured"] = run.outputs
        for name, stage in stages.items():
            found[f"{run.name}/{name}"] = free_run_error(stage.machine, run, answer.held_out)
    if answer.dependence:
        lead = answer.dependence[0]
        i = answer.declared.machine.coordinate_names.index(lead.coordinate)
        data = answer.fitted
        runs = [variables(answer.before.machine, run, data)[lead.variable] for run in data.runs]
        thin = max(1, sum(map(len, runs)) // _POINTS)
        found["force/variable"] = np.concatenate(runs)[::thin]
        for name in ("before", "after"):
            machine = stages[name].machine
            forces = [smooth_force_residual(machine, run, data)[:, i] for run in data.runs]
            found[f"force/{name}"] = np.concatenate(forces)[::thin]
    found |= {f"coverage/{name}": values for name, values in _coverage(answer).items()}
    return found


def _coverage(answer: IdentificationResult) -> dict[str, Array]:
    machine, data = answer.before.machine, answer.fitted
    linear = [c.name for c in machine.coordinates if c.kind == "linear"]
    shown = [f"{what} of {c}" for what in ("position", "velocity") for c in linear or machine.coordinate_names]
    by_run = [variables(machine, run, data) for run in data.runs]
    thin = max(1, sum(len(run.time_s) for run in data.runs) // _POINTS)
    names = (*shown, *machine.input_channels)
    return {name: np.concatenate([known[name] for known in by_run])[::thin] for name in names}


def save_evidence(answer: IdentificationResult, path: Path) -> None:
    """Write the curves as a compressed .npz, whole."""
    with whole_file(path) as temporary:
        arrays: dict[str, Any] = {k: v.astype(np.float32) for k, v in evidence(answer).items()}
        np.savez_compressed(temporary, **arrays)
