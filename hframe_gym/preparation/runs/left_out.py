"""Find runs that are left out: too short, copies of others, or without a known position."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import name_runs
from ...recordings import Recording, peak_to_peak
from ..dataset import MIN_ROWS, Dataset

_COVERED = 0.5  # fraction of a run's rows in its parts; with more, the parts are used and not the run


def short_runs(recordings: Sequence[Recording]) -> dict[str, str]:
    """Find runs with fewer than 20 rows, such as pieces of a log with gaps; filters need these rows.

    If all runs are too short, the result is empty, because none can be left out.

    Returns:
        Reason, as the predicate of a sentence, by name of the run.
    """
    short = {
        recording.name: f"has {len(recording.time_s)} rows, identification needs at least {MIN_ROWS}"
        for recording in recordings
        if len(recording.time_s) < MIN_ROWS
    }
    return short if len(short) < len(recordings) else {}


def copied_runs(recordings: Sequence[Recording], kept: Sequence[str] = ()) -> dict[str, str]:
    """Find runs whose times, commands and measurements are a copy of another run or of a part of it.

    A copy of a held-out run among the fitted ones makes the held-out error meaningless. The usual cause is a
    log that was imported as one run and again in parts; the parts are used then. No machine repeats a motion
    to the last digit, unless nothing moves.

    Args:
        recordings: All runs, in the order in which the first one of equal runs is kept.
        kept: Names of runs to keep in preference to their copies, for example the held-out ones.

    Returns:
        Reason, as the predicate of a sentence, by name of the copy.
    """
    first_of: dict[bytes, str] = {}
    reasons: dict[str, str] = {}
    moving = [recording for recording in recordings if peak_to_peak(recording.outputs).any()]
    for recording in sorted(moving, key=lambda recording: recording.name not in kept):
        content = recording.inputs.tobytes() + recording.outputs.tobytes()
        original = first_of.setdefault(content, recording.name)
        if original != recording.name:
            reasons[recording.name] = f"is a copy of {original}, the same in every row"
    different = [recording for recording in moving if recording.name not in reasons]
    for whole in different:
        parts = [run for run in different if run.name not in reasons and _is_part(run, whole)]
        if not parts:
            continue
        names = [run.name for run in parts]
        covered = sum(len(run.time_s) for run in parts) / len(whole.time_s)
        if whole.name not in kept and (covered >= _COVERED or not set(kept).isdisjoint(names)):
            reasons[whole.name] = f"contains {name_runs(names)}, used in its place"
        else:
            reasons |= dict.fromkeys(names, f"is a part of {whole.name}, the same in every row")
    return reasons


def _is_part(run: Recording, whole: Recording) -> bool:
    """Return whether another, longer run has all rows of a run, one after the other."""
    first = int(np.searchsorted(whole.time_s, run.time_s[0]))
    rows = slice(first, first + len(run.time_s))
    return len(run.time_s) < len(whole.time_s) and all(
        np.array_equal(getattr(run, name), getattr(whole, name)[rows], equal_nan=True)
        for name in ("time_s", "inputs", "outputs")
    )


def with_known_positions(data: Dataset) -> tuple[Dataset, tuple[str, ...]]:
    """Copy a data set without the runs whose initial position no sensor determines.

    Returns:
        data: Copy without these runs. If no run would remain, all are kept.
        warnings: One sentence that names the runs that were left out; empty if none was.
    """
    located = [run.name for run in data.runs if run.initial.position_known]
    if not located or len(located) == len(data.runs):
        return data, ()
    lost = ", ".join(run.name for run in data.runs if run.name not in located)
    return data.with_runs(located), (
        f"Not used, because no sensor with a known zero measures the start: {lost}.",
    )
