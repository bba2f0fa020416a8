"""Recognize measured currents that were read after the voltage of their own row had been applied.

A row of a recording holds the measurements just before its voltage acts. The current of a motor jumps with
the voltage, unlike position and speed, so that a current that is read later belongs to another voltage.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import special

from ..arrays import Array
from ..identification import MIN_ROWS
from ..machine import Machine
from ..recordings import GAP_PERIODS, Recording
from .findings import Finding

_PAST_ROWS = 4  # whose voltages act on a current; an inductance spreads the response over several
_CHANCE = 1e-6  # probability below which the current certainly depends on the voltage of its own row


def check_currents(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report currents that respond to the voltage of their own row, which acts only afterwards.

    Changes of the current are regressed on the changes of its drive's voltage in the same row and in the four
    rows before. Reported is a response to the own row that is larger than each of the others, and that chance
    would give with a probability of less than 1e-6. Changes of the speed, and thus of the back-EMF, are small
    from row to row. A controller that computes the voltage from the current of the same row makes them depend
    on each other with the opposite sign, which is not reported.

    Returns:
        Advice, one for each sensor: a controller that is faster than the log has the same consequence, so
        that the mistake is not certain.
    """
    findings = []
    for channel, (command, own, earlier) in currents_after_their_voltage(recordings, machine).items():
        message = (
            f"responds more to {command} of its own row ({own:.3g} A/V) than to that of earlier rows "
            f"({max(earlier, 0.0):.2g} A/V), although a voltage acts only from its row's time on: the "
            "current was read after the voltage had been applied, or the controller is faster than the "
            "log. Shift the current down by one row, or leave it out by hframe import "
            f"--map {channel}=none; if the controller is faster, log each of its rows"
        )
        findings.append(Finding("advice", "", channel, message))
    return findings


def currents_after_their_voltage(
    recordings: Sequence[Recording], machine: Machine
) -> dict[str, tuple[str, float, float]]:
    """Return the currents that respond to the voltage of their own row, see `check_currents`.

    Returns:
        By the current's channel: the channel of the voltage, and the responses, A/V, to the voltage of the
        own row and the largest to that of an earlier one.
    """
    found: dict[str, tuple[str, float, float]] = {}
    for j, sensor in enumerate(machine.sensors):
        names = [drive.name for drive in machine.drives]
        if sensor.quantity != "current" or len(sensor.row) != 1 or next(iter(sensor.row)) not in names:
            continue
        [(name, coefficient)] = sensor.row.items()
        i = names.index(name)
        if not machine.drives[i].resistance or coefficient == 0.0:
            continue
        runs = [(r.time_s, r.inputs[:, i], r.outputs[:, j] / coefficient) for r in recordings]
        own, earlier = _responses(runs)
        if own > earlier:
            found[sensor.channel] = machine.input_channels[i], own, earlier
    return found


def _responses(runs: Sequence[tuple[Array, Array, Array]]) -> tuple[float, float]:
    """Return the responses of a current, A/V: to its own row's voltage, and the largest to earlier ones.

    Both are 0 if the response to the own row may be by chance, or has the sign of a controller's.

    Args:
        runs: Times, s, voltages, V, and currents, A, of each run, each of shape (n,).
    """
    rows = [_changes(*run) for run in runs]
    changes = np.concatenate([r for r in rows if len(r)] or [np.zeros((0, _PAST_ROWS + 2))])
    freedom = len(changes) - _PAST_ROWS - 1
    voltages, current = changes[:, :-1], changes[:, -1]  # of the own row first
    if freedom < MIN_ROWS or np.linalg.matrix_rank(voltages) < _PAST_ROWS + 1:
        return 0.0, 0.0
    response, *_ = np.linalg.lstsq(voltages, current)
    left = current - voltages @ response
    past = current - voltages[:, 1:] @ np.linalg.lstsq(voltages[:, 1:], current)[0]
    ratio = (float(past @ past) / max(float(left @ left), np.finfo(float).tiny) - 1.0) * freedom
    if response[0] <= 0.0 or special.fdtrc(1, freedom, ratio) > _CHANCE:
        return 0.0, 0.0
    return float(response[0]), float(response[1:].max())


def _changes(time_s: Array, voltage: Array, current: Array) -> Array:
    """Return changes of the voltage, of the own row first, and of the current, (rows, _PAST_ROWS + 2).

    Rows beside a gap or without a measurement are left out.
    """
    steps = np.diff(time_s)
    if len(steps) <= _PAST_ROWS:
        return np.zeros((0, _PAST_ROWS + 2))
    gap = steps > GAP_PERIODS * np.median(steps)
    windows = np.lib.stride_tricks.sliding_window_view
    whole = ~windows(gap, _PAST_ROWS + 1).any(axis=1)
    inputs = windows(np.diff(voltage), _PAST_ROWS + 1)[:, ::-1]
    outputs = np.diff(current)[_PAST_ROWS:, None]
    table = np.hstack([inputs, outputs])
    return np.asarray(table[whole & np.isfinite(table).all(axis=1)])
