"""Samples that a logger dropped: their rows put back, with what was lost left blank.

An input is held from its row until the next, so a lost row holds the input of the row before it for too long.  The lost
voltages are unknown; halfway between their neighbours they are wrong by far less, and a blank output is not compared.
"""

from __future__ import annotations

import numpy as np

from .recording import Recording

_GAP = 1.5  # median periods; a longer step lost a sample


def fill_gaps(recording: Recording) -> Recording:
    """The run with a row for every lost sample: inputs interpolated, outputs NaN; the run itself if none was lost."""
    time_s = recording.time_s
    steps = np.diff(time_s)
    period = float(np.median(steps)) if len(steps) else 1.0
    lost = np.where(steps > _GAP * period, np.rint(steps / period) - 1, 0).astype(int)
    if not lost.any():
        return recording
    missing = np.concatenate(
        [np.linspace(a, b, k + 2)[1:-1] for a, b, k in zip(time_s[:-1], time_s[1:], lost, strict=True) if k]
    )
    grid = np.concatenate([time_s, missing])
    order = np.argsort(grid, kind="stable")
    inputs = np.column_stack([np.interp(grid, time_s, values) for values in recording.inputs.T])
    blank = np.full((len(missing), recording.outputs.shape[1]), np.nan)
    outputs = np.concatenate([recording.outputs, blank])
    return Recording(recording.name, grid[order], inputs[order], outputs[order])
