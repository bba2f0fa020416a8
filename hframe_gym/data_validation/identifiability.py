"""Which parameters these runs can tell: the standard deviations of a linearised fit around the declared machine.

The Cramer-Rao bound of the free run, sensitivities by central differences, residual white and of the sensors' noise.  A
real fit does worse by whatever the model lacks; what is badly told here is not told at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..dynamics import rollout
from ..identification import Dataset, default_free_parameters
from ..machine import Machine
from .findings import Finding

_STEP = 1e-3  # relative
_ROWS = 20_000  # of a run
_BADLY = 0.1  # relative standard deviation beyond which a parameter is not told
_TOGETHER = 0.98  # correlation beyond which two parameters are not told apart

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Told:
    """A parameter's relative standard deviation (inf: no trace of it), and the one it is most confused with."""

    name: str
    relative_std: float
    partner: str
    correlation: float


def told(data: Dataset, machine: Machine, names: Sequence[str] = ()) -> list[Told]:
    """How well the runs tell each of the named parameters (default: those that identification refits), jointly."""
    names = [n for n in (names or [f.name for f in default_free_parameters(machine)]) if machine.parameters[n] != 0.0]
    values = machine.parameters
    table = np.tile(np.array(list(values.values())), (2 * len(names), 1))
    for k, name in enumerate(names):
        column = list(values).index(name)
        table[2 * k, column] *= 1 + _STEP
        table[2 * k + 1, column] *= 1 - _STEP
    information = np.zeros((len(names), len(names)))
    for run in data.runs:
        rows = slice(0, _ROWS)
        reading = rollout(machine, run.time_s[rows], run.inputs[rows], parameters=table, start=run.start)
        outputs = (reading @ machine.sensor_matrix.T)[:, :, :] / data.noise
        measured = np.isfinite(run.outputs[rows])
        slope = (outputs[0::2] - outputs[1::2]) / (2 * _STEP)
        flat = np.where(measured, np.nan_to_num(slope), 0.0).reshape(len(names), -1)
        information += flat @ flat.T
    return _joint(names, information)


def _joint(names: Sequence[str], information: Array) -> list[Told]:
    """Invert an information matrix (k, k) over relative changes, parameters without a trace set aside."""
    scale = np.sqrt(np.diag(information))
    seen = scale > 1e-12 * max(float(scale.max(initial=0.0)), 1e-300)
    kept = [n for n, s in zip(names, seen, strict=True) if s]
    normal = information[np.ix_(seen, seen)] / np.outer(scale[seen], scale[seen])
    covariance = np.linalg.pinv(normal + 1e-14 * np.eye(len(kept)), hermitian=True, rcond=1e-14) if kept else normal
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    found = {}
    for i, name in enumerate(kept):
        correlations = covariance[i] / np.maximum(spread[i] * spread, 1e-300)
        correlations[i] = 0.0
        j = int(np.argmax(np.abs(correlations)))
        partner = kept[j] if len(kept) > 1 else ""
        found[name] = Told(name, float(spread[i] / scale[seen][i]), partner, float(correlations[j]))
    return [found.get(name, Told(name, float("inf"), "", 0.0)) for name in names]


def parameters(data: Dataset, machine: Machine) -> list[Finding]:
    """Advice for each parameter that these runs cannot tell, a note for each that they can."""
    found = []
    for t in told(data, machine):
        if not np.isfinite(t.relative_std):
            found.append(Finding("advice", "", t.name, "leaves no trace in these runs"))
            continue
        message = f"told to {100 * t.relative_std:.2g} % at best"
        confused = abs(t.correlation) > _TOGETHER
        if confused:
            message += f", hardly apart from {t.partner} (correlation {t.correlation:+.3f})"
        found.append(Finding("advice" if t.relative_std > _BADLY else "note", "", t.name, message))
    return found
