"""Clocks of logs: continue counters that overflow, cut where a clock restarts, and give advice on others."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ..recording import LONGEST_GAP
from .measurement_units import TIME

_DAY = 86_400.0  # s
# Values at which counters of clocks start anew, in the unit of the column, with the counter in words. They
# are tried in this order. A counter of microseconds may be logged in ms or s, one of milliseconds in s.
_COUNTERS = {
    2.0**32: "a counter of 32 bits",
    2.0**31: "a counter of 31 bits",
    2.0**24: "a counter of 24 bits",
    2.0**16: "a counter of 16 bits",
    2.0**32 / 1e3: "a counter of 32 bits in thousandths",
    2.0**32 / 1e6: "a counter of 32 bits in millionths",
    2.0**16 / 1e3: "a counter of 16 bits in thousandths",
}
# The step across the start, plus the modulus, is at most this many sampling periods. A clock that was set
# back to any other value passes by chance in so many periods of all that the counter has: one in a million
# for 32 bits in microseconds at 1 kHz.
_PERIODS_ACROSS = 3.0
# Fraction of rows; fewer repeated times are those of messages that were delayed, more are those of a coarse
# clock.
_RARE = 0.1
# A clock restarts if it goes back by more than this fraction of the time since its last start. Rows that were
# written in a wrong order go back by a few periods.
_RESTART = 0.5
# Rows after a restart whose times are all earlier than the last one before it; after one wrong time they are
# not.
_ROWS_EARLIER = 3
# Fewer times between two starts are what a buffer still held of the session before, or its rows that were not
# filled, which all have the same time.
_FEWEST_TIMES = 10


def continued_counter(times: Array) -> tuple[Array, str]:
    """Make times continuous across overflows of a counter, such as 32 bits of microseconds after 71.6 min.

    Args:
        times: Times in the unit of the log, NaN where there is none, shape (n,).

    Returns:
        times: Continuous times in the unit of the log, shape (n,). The given times are returned unless each
        step back is that of one counter in `_COUNTERS`, within three sampling periods.
        remark: Note for the user on the change; "" if nothing was changed.
    """
    for modulus, words in _COUNTERS.items():
        continued, starts = _continued(times, modulus, None)
        if starts:
            return continued, f"{TIME} goes on where {words} started anew ({_times(starts)})"
    return times, ""


def continued_over_midnight(times: Array) -> tuple[Array, str]:
    """Make times of day continuous across midnight.

    Args:
        times: Times of day, s, NaN where there is none, shape (n,).

    Returns:
        times: Times, s, shape (n,), with a day (86,400 s) added after each midnight. The given times are
        returned unless each step back is a day, less at most 600 s (`LONGEST_GAP`).
        remark: What was done, for the user; "" for nothing.
    """
    # A day less than the longest gap of a recording: a longer one would be refused.
    continued, midnights = _continued(times, _DAY, LONGEST_GAP)
    return continued, f"{TIME} goes on after midnight ({_times(midnights)})" if midnights else ""


def _times(count: int) -> str:
    """Return a number of events in words."""
    return "once" if count == 1 else f"{count} times"


def _continued(times: Array, modulus: float, longest: float | None) -> tuple[Array, int]:
    """Return times that go on where the clock began anew, and how often it did; unchanged if it never did."""
    present = np.isfinite(times)
    steps = np.diff(times[present])
    back = steps < 0.0
    if not back.any() or not (steps > 0.0).any():
        return times, 0
    if longest is None:
        longest = _PERIODS_ACROSS * float(np.median(steps[steps > 0.0]))
    across = steps[back] + modulus
    if np.any(across < 0.0) or np.any(across > longest) or np.ptp(times[present]) >= modulus:
        return times, 0
    result = times.copy()
    result[present] += modulus * np.concatenate([[0.0], np.cumsum(back)])
    return result, int(back.sum())


def clock_sections(time_s: Array) -> list[slice]:
    """Cut a log where its clock restarts, as when a controller is reset while the logger runs.

    A clock restarts where the time goes back by more than half of the time since its last start, and stays
    earlier than before for at least three rows.

    Args:
        time_s: Times, s, NaN where there is none, shape (n,).

    Returns:
        Rows between two starts of the clock, in the order of the log. Those with fewer than ten different
        times are left out, unless they have a tenth of all rows: these are no restarts, and all rows are
        returned as one slice.
    """
    rows = np.flatnonzero(np.isfinite(time_s))
    times, starts = time_s[rows], [0]
    for row in np.flatnonzero(np.diff(times) < 0.0) + 1:
        before, since = times[row - 1], times[row - 1] - times[starts[-1]]
        if before - times[row] > _RESTART * since and np.all(times[row : row + _ROWS_EARLIER] < before):
            starts.append(int(row))
    edges = [0, *rows[starts[1:]].tolist(), len(time_s)]
    sections = [slice(first, end) for first, end in pairwise(edges)]
    long = [section for section in sections if len(np.unique(_present(time_s[section]))) >= _FEWEST_TIMES]
    kept = sum(section.stop - section.start for section in long)
    return long if kept > (1.0 - _RARE) * len(time_s) else [slice(0, len(time_s))]


def _present(times: Array) -> Array:
    """Return the times that are given."""
    return times[np.isfinite(times)]


def replaced_rows(time_s: Array) -> tuple[NDArray[np.bool_], str]:
    """Find rows whose time the next row repeats, as when a logger writes a sample twice.

    Args:
        time_s: Times, s, NaN where there is none, shape (n,).

    Returns:
        rows: True for each row that the next one replaces, shape (n,). None if these are a tenth of all rows
        or more, which shows a coarse clock, or if times go back.
        remark: What was done, for the user; "" for nothing.
    """
    replaced = np.zeros(len(time_s), np.bool_)
    rows = np.flatnonzero(np.diff(time_s) == 0.0)
    present = time_s[np.isfinite(time_s)]
    if not 0 < len(rows) < _RARE * len(time_s) or np.any(np.diff(present) < 0.0):
        return replaced, ""
    replaced[rows] = True
    left_out = f"{len(rows)} row{'s' if len(rows) > 1 else ''} left out whose time the next row repeats"
    return replaced, f"{left_out}; if all rows are equally spaced, state their rate: {_rate_option(present)}"


def repair_of_times(time_s: Array) -> str:
    """Return advice, as the end of a message, on how to repair times that do not increase.

    Args:
        time_s: Times, s, of which some repeat or go back, shape (n,).

    Returns:
        Text from "; " on. If times go back, it advises to sort or delete rows; otherwise to state the rate of
        the rows by the option --map time_s=RATE.
    """
    steps = np.diff(time_s)
    if np.any(steps < 0.0):
        return "; are rows in a wrong order? Sort them, or delete those whose time is wrong"
    span = float(time_s[-1] - time_s[0])
    if span <= 0.0:
        return f"; if the rows are equally spaced, state their rate, e.g. --map {TIME}=1000Hz"
    resolution = float(np.min(steps[steps > 0.0]))
    clock = f"; the clock has steps of {resolution:.3g} s"
    return f"{clock}: if the rows are equally spaced, state their rate: {_rate_option(time_s)}"


def _rate_option(time_s: Array) -> str:
    """Return the option that states the rate of rows with these times, s, of which some repeat."""
    steps = np.diff(time_s)
    rate = _rate(len(time_s), float(time_s[-1] - time_s[0]), float(np.min(steps[steps > 0.0])))
    return f"--map {TIME}={rate:g}Hz"


def _rate(count: int, span: float, resolution: float) -> float:
    """Return the roundest rate, Hz, of a number of rows whose times have a span and a resolution, s."""
    # The times are rounded down, so that those of the last step extend beyond it.
    rate = count / (span + resolution)
    tolerance = rate * resolution / span
    digits = next((d for d in range(1, 6) if abs(float(f"{rate:.{d - 1}e}") - rate) <= tolerance), 6)
    return float(f"{rate:.{digits - 1}e}")
