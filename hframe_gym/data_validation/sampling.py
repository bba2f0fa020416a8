"""The clock: rate, jitter, dropped samples, resting rows, and whether runs share one clock."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ..identification import estimate_initial_state
from ..machine import Machine
from ..recordings import Recording
from .findings import Finding

_GAP = 1.5  # periods; a longer step lost a sample
_JITTER = 0.02  # of the period, standard deviation
_REST = 0.05  # s at rest that place a run well


def sampling(recording: Recording) -> list[Finding]:
    """Dropped and irregular samples of one run."""
    found = []
    steps = np.diff(recording.time_s)
    if len(steps) == 0:
        return [Finding("fault", recording.name, "time_s", "a single row tells no motion")]
    period = float(np.median(steps))
    gaps = steps > _GAP * period
    if gaps.any():
        lost = float(np.sum(steps[gaps]) - np.sum(gaps) * period)
        found.append(
            Finding(
                "advice",
                recording.name,
                "time_s",
                f"{int(gaps.sum())} gaps ({1e3 * lost:.3g} ms in all, {100 * lost / np.sum(steps):.2g} %): samples "
                "were dropped, and the inputs inside the gaps with them",
            )
        )
    jitter = float(np.std(steps[~gaps]))
    if jitter > _JITTER * period:
        message = f"sampling is irregular, {1e3 * period:.4g} ms with a jitter of {1e3 * jitter:.2g} ms"
        found.append(Finding("advice", recording.name, "time_s", message))
    return found


def rate(recordings: Sequence[Recording]) -> Finding:
    """The sampling rate of all runs together."""
    periods = [float(np.median(np.diff(r.time_s))) for r in recordings if len(r.time_s) > 1]
    seconds = sum(float(r.time_s[-1] - r.time_s[0]) for r in recordings)
    low, high = min(periods, default=np.nan), max(periods, default=np.nan)
    shown = f"{1 / low:.4g} Hz" if high <= 1.02 * low else f"{1 / high:.4g} to {1 / low:.4g} Hz"
    return Finding("note", "", "time_s", f"{len(recordings)} runs, {seconds:.4g} s in all, sampled at {shown}")


def shared_clock(recordings: Sequence[Recording]) -> list[Finding]:
    """Runs that overlap in time: their clocks were restarted, so nothing that warms up can be followed."""
    ordered = sorted(recordings, key=lambda r: r.time_s[0])
    overlapping = [b.name for a, b in pairwise(ordered) if b.time_s[0] < a.time_s[-1]]
    if not overlapping:
        return []
    message = f"{len(overlapping)} runs overlap in time: the clock restarts, so a drift over the session cannot be told"
    return [Finding("note", "", "time_s", message)]


def rest(recording: Recording, machine: Machine) -> list[Finding]:
    """Whether the run begins with rows at rest, which give its start and the sensors' zeros."""
    rows = estimate_initial_state(recording, machine).rows
    seconds = float(recording.time_s[min(rows, len(recording.time_s)) - 1] - recording.time_s[0])
    if seconds >= _REST:
        return []
    message = f"{rows} rows ({1e3 * seconds:.3g} ms) at rest before the first input: its start and zeros are uncertain"
    return [Finding("advice", recording.name, "", message)]
