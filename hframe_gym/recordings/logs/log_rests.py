"""Cut a long recording into runs where the machine rests."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...errors import InputError
from ...machine import Machine
from ...robust_statistics import white_noise
from ..recording import Recording

# A channel is at rest while its peak-to-peak variation is below a tolerance, the largest of:
_REST_NOISE = 10.0  # standard deviations of its noise,
_REST_STEPS = 2.5  # quantization steps,
_INPUT_TOLERANCE = 1e-3  # for an input, a fraction of the rated voltage.
# All but the declared noise and resolution are limited to this fraction of the channel's span in the log.
# More is a motion, however noisy the channel seems.
_MAX_REST_SPAN = 0.01


def split_at_rests(
    recording: Recording, machine: Machine, min_rest: float
) -> tuple[list[Recording], list[str]]:
    """Cut a recording into runs that begin at rest and, except perhaps the last one, end at rest.

    The machine rests where no voltage and no measurement changes by more than noise and resolution for
    `min_rest` or longer. A rest between two motions is cut in the middle; each of the two runs keeps at most
    `min_rest` of it. Rows before the first rest are left out.

    Args:
        min_rest: Shortest rest at which the recording is cut, s.

    Returns:
        runs: One recording per motion (measurements of shape (n, sensors)), named NAME_01, NAME_02, ...;
            their times are unchanged, so they need not begin at 0.
        remarks: Sentences for the user about what was left out.

    Raises:
        InputError: If the machine never rests for `min_rest`, never moves, or rests only at the end.
    """
    time_s = recording.time_s
    resting = _resting_rows(recording, machine, min_rest)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], resting.astype(np.int8), [0]])))
    first, last = edges[::2], edges[1::2] - 1  # first and last row of each rest
    if len(first) == 0:
        raise InputError(
            f"{recording.name}: nothing rests for {min_rest:g} s: reduce --min-rest, or --split-every 10"
        )
    if resting.all():
        raise InputError(f"{recording.name}: nothing moves, so there are no runs to cut")
    begins_at_rest, ends_at_rest = first[0] == 0, last[-1] == len(time_s) - 1
    # Where the run before each rest ends, and where the run after it begins. No run precedes the first row or
    # follows the last, so that rests there are not cut in the middle.
    middle = (time_s[first] + time_s[last]) / 2
    latest_end, earliest_begin = middle.copy(), middle.copy()
    if begins_at_rest:
        earliest_begin[0] = time_s[0]
    if ends_at_rest:
        latest_end[-1] = time_s[-1]
    ends = np.searchsorted(time_s, np.minimum(latest_end, time_s[first] + min_rest), side="right")
    begins = np.searchsorted(time_s, np.maximum(earliest_begin, time_s[last] - min_rest))
    pieces = list(zip(begins[:-1], ends[1:], strict=True))
    remarks = []
    if not begins_at_rest:
        remarks.append(f"the first {time_s[first[0]] - time_s[0]:.4g} s left out, they do not begin at rest")
    if not ends_at_rest:
        pieces.append((begins[-1], len(time_s)))
        remarks.append("the last run does not end at rest")
    if not pieces:
        raise InputError(
            f"{recording.name}: rests only at its end, so no run begins at rest; reduce --min-rest"
        )
    digits = max(2, len(str(len(pieces))))
    runs = []
    for number, (begin, end) in enumerate(pieces, start=1):
        part = recording.rows(slice(int(begin), int(end)))
        runs.append(dataclasses.replace(part, name=f"{recording.name}_{number:0{digits}d}"))
    seconds = [float(run.time_s[-1] - run.time_s[0]) for run in runs]
    left_out = time_s[-1] - time_s[0] - sum(seconds)
    count = "1 run of" if len(runs) == 1 else f"{len(runs)} runs of {min(seconds):.3g} to"
    remarks.append(
        f"cut at rests of {min_rest:g} s and more: {count} {max(seconds):.3g} s, {left_out:.4g} s left out"
    )
    return runs, remarks


def _resting_rows(recording: Recording, machine: Machine, min_rest: float) -> NDArray[np.bool_]:
    """Return the rows that belong to an interval of the given length, s, in which nothing moves."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    count = len(recording.time_s)
    period = float(np.median(np.diff(recording.time_s))) if count > 1 else min_rest
    window = max(2, round(min_rest / period) + 1)
    if window > count:
        return np.zeros(count, np.bool_)
    still = np.ones(count - window + 1, np.bool_)  # whether nothing moves in a window, by its first row
    for values, tolerance in _channels_with_tolerance(recording, machine):
        center = window // 2
        high = maximum_filter1d(values, window, mode="nearest")[center : center + len(still)]
        low = minimum_filter1d(values, window, mode="nearest")[center : center + len(still)]
        still &= high - low <= tolerance
    # A row rests if any window that contains it is still: if the number of still windows grows over their
    # first rows.
    still_before = np.concatenate([[0], np.cumsum(still)])
    first_window = np.maximum(np.arange(count) - window + 1, 0)
    last_window = np.minimum(np.arange(count), len(still) - 1)
    return still_before[last_window + 1] > still_before[first_window]


def _channels_with_tolerance(recording: Recording, machine: Machine) -> list[tuple[Array, float]]:
    """Return for each channel its values, with empty cells as the last value, and its tolerance at rest."""
    channels = []
    for values, drive in zip(recording.inputs.T, machine.drives, strict=True):
        tolerance = max(_INPUT_TOLERANCE * drive.rated_voltage, _variation_at_rest(values))
        channels.append((values, min(tolerance, _MAX_REST_SPAN * float(np.ptp(values)))))
    for values, sensor in zip(recording.outputs.T, machine.sensors, strict=True):
        measured = np.flatnonzero(np.isfinite(values))
        if len(measured) == 0:
            continue
        declared = max(_REST_NOISE * sensor.noise, _REST_STEPS * sensor.resolution)
        estimated = min(
            _variation_at_rest(values[measured]), _MAX_REST_SPAN * float(np.ptp(values[measured]))
        )
        held = values[
            measured[np.clip(np.searchsorted(measured, np.arange(len(values)), "right") - 1, 0, None)]
        ]
        channels.append((held, max(declared, estimated)))
    return channels


def _variation_at_rest(values: Array) -> float:
    """Estimate the peak-to-peak variation of a channel at rest from its noise and its smallest step."""
    changes = np.abs(np.diff(values))
    step = float(np.min(changes, where=changes > 0.0, initial=np.inf))
    return max(_REST_STEPS * step if np.isfinite(step) else 0.0, _REST_NOISE * white_noise([values], 2))
