"""What is odd about a recording without being wrong: said, not refused."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..machine import Machine
from .recording import Recording

_LONG = 0.1  # s, a channel that stands still for less is not stuck
_MOVES = 0.02  # of its whole span: another channel that changes by less has not moved


def suspicions(recording: Recording, machine: Machine) -> list[str]:
    """One line for each: dropped or irregular samples, an input that never moves, an output stuck at its end."""
    found = []
    steps = np.diff(recording.time_s)
    if len(steps):
        period = float(np.median(steps))
        gaps = int(np.sum(steps > 1.5 * period))
        if gaps:
            found.append(f"{gaps} gaps in time_s: samples were dropped")
        if np.std(steps[steps <= 1.5 * period]) > 0.02 * period:
            found.append(f"sampling is irregular around {1e3 * period:.4g} ms")
    for channel, values in zip(machine.input_channels, recording.inputs.T, strict=True):
        if np.ptp(values) == 0.0:
            found.append(f"{channel} never moves")
    for j, channel in enumerate(machine.output_channels):
        span = _stuck(recording, j)
        if span:
            found.append(f"{channel} stays at the end of its range for {span:.3g} s while others move: clipped?")
    return [f"{recording.name}: {line}" for line in found]


def _stuck(recording: Recording, j: int) -> float:
    """Longest time, s, that output j keeps its largest or smallest value while another output moves; 0 if short."""
    values = recording.outputs[:, j]
    if not np.isfinite(values).any() or np.nanmax(values) == np.nanmin(values):
        return 0.0
    others = np.delete(recording.outputs, j, axis=1)
    others = others[:, np.isfinite(others).any(axis=0)]
    size = np.nanmax(others, axis=0) - np.nanmin(others, axis=0) if others.shape[1] else np.zeros(0)
    longest = 0.0
    for end in (np.nanmax(values), np.nanmin(values)):
        for first, last in _runs(values == end):
            seconds = float(recording.time_s[last] - recording.time_s[first])
            if seconds <= max(_LONG, longest):
                continue
            part = others[first : last + 1]
            seen = np.isfinite(part).any(axis=0) & (size > 0)
            moved = np.nanmax(part[:, seen], axis=0) - np.nanmin(part[:, seen], axis=0)
            if np.any(moved > _MOVES * size[seen]):
                longest = seconds
    return longest


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of each stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
