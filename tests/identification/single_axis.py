"""A single axis: simulated runs, and results that are put together by hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, IdentificationResult, SelectedEffect, prepare
from hframe_gym.identification.fit.channel_errors import channel_errors
from hframe_gym.identification.forces.inverse_dynamics import force_error
from hframe_gym.identification.validate.machine_errors import ModelEvaluation, PredictionErrors
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect, Machine
from hframe_gym.recordings import Recording

AXIS = BUILTIN_MACHINES["axis"]()
NOISE = 20e-6  # m
PRESLIDING = EFFECTS["presliding"].at("x", s0=3e3, s1=1.0)


def axis_recordings(truth: Machine, *, rows: int, volts: float) -> list[Recording]:
    """Return three runs of an axis at 1 kHz with ten random voltage steps each, the first at 0 V (50 ms)."""
    rng = np.random.default_rng(3)
    recordings = []
    for k in range(3):
        time_s = np.arange(rows) * 1e-3
        inputs = np.repeat(rng.uniform(-volts, volts, (10, 1)), rows // 10, axis=0)
        inputs[:50] = 0.0
        outputs = simulate(truth, time_s, inputs).outputs + rng.normal(0.0, NOISE, (rows, 1))
        recordings.append(Recording(f"run_{k}", time_s, inputs, outputs))
    return recordings


def axis_runs(truth: Machine, *, rows: int, volts: float) -> Dataset:
    """Return `axis_recordings`, prepared for a fit."""
    return prepare(axis_recordings(truth, rows=rows, volts=volts), AXIS)


def limited_runs(volts: Sequence[float], peak: int | None = None) -> list[Recording]:
    """Return runs of an axis with a current limit of 5 A and random voltage steps of the given sizes.

    The run of index `peak` has 9 V for 40 ms.
    """
    truth = AXIS.with_effects(EFFECTS["current_limit"].at("motor", I=5.0))
    rng = np.random.default_rng(4)
    recordings = []
    for k, size in enumerate(volts):
        time_s = np.arange(1500) * 1e-3
        inputs = np.repeat(rng.uniform(-size, size, (15, 1)), 100, axis=0)
        inputs[:100] = 0.0
        if k == peak:
            inputs[700:740] = 9.0
        outputs = simulate(truth, time_s, inputs).outputs + rng.normal(0.0, 2e-5, (1500, 1))
        recordings.append(Recording(f"run_{k}", time_s, inputs, outputs))
    return recordings


def axis_result(
    data: Dataset, after: Machine, *, gain: float = 0.9, rivals: tuple[AppliedEffect, ...] = (), **fields: Any
) -> IdentificationResult:
    """Return a result with a corrected machine, evaluated on the last run; `fields` replace defaults."""
    held_out = data.with_runs(["run_2"])
    before, last = (
        ModelEvaluation(m, PredictionErrors(channel_errors(m, held_out), force_error(m, held_out)))
        for m in (AXIS, after)
    )
    defaults: dict[str, Any] = {"verdict": "effect_found", "dependence": ()}
    return IdentificationResult(
        declared=before,
        before=before,
        after=last,
        effects=tuple(SelectedEffect(e, 1.0, AXIS, rivals) for e in after.effects),
        gains={e.label: gain for e in after.effects},
        sizes={e.label: 0.1 for e in after.effects},
        considered=(),
        white=True,
        fitted=data.with_runs(["run_0", "run_1"]),
        held_out=held_out,
        seconds=3.0,
        **(defaults | fields),
    )
