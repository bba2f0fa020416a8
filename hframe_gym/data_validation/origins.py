"""Recognize counters that were reset before each run, so that the runs have no common position.

Where nothing but an encoder measures a coordinate, what it shows is the position. Forces that depend on the
position, such as those of a cable, then need a counter that goes on from run to run.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..machine import Machine
from ..recordings import Recording
from .findings import Finding, channel_unit

_MIN_RUNS = 3  # fewer may begin at 0 because the machine did
_APART = 0.05  # fraction of the travel by which a run must end elsewhere than it began


def check_origins(recordings: Sequence[Recording], machine: Machine) -> list[Finding]:
    """Report, as notes, encoders that begin at 0 in each run although the machine stopped elsewhere before.

    That is so if a run ends by more than 5 % of the encoder's largest travel away from 0. Fewer than three
    runs, encoders beside a sensor with a fixed zero, and those of machines with belts, whose zeros are found,
    are not checked.
    """
    if machine.belts or len(recordings) < _MIN_RUNS:
        return []
    fixed = {coordinate for sensor in machine.sensors if sensor.fixed for coordinate in sensor.row}
    findings = []
    for j, sensor in enumerate(machine.sensors):
        values = [column[np.isfinite(column)] for column in (r.outputs[:, j] for r in recordings)]
        if not sensor.incremental or fixed & set(sensor.row) or not all(len(column) for column in values):
            continue
        travel = max(float(np.ptp(column)) for column in values)
        ends = [abs(float(column[-1])) for column in values]
        if any(column[0] for column in values) or max(ends) <= _APART * travel:
            continue
        name = recordings[int(np.argmax(ends))].name
        message = (
            f"begins at 0 in each run, although {name} ends at {max(ends):.3g} "
            f"{channel_unit(sensor.channel, machine)}: was the counter reset? All runs then seem to begin at "
            "one position. If they did not, effects that depend on the position (a cable, cogging) are not "
            "found: let the counter go on through the session"
        )
        findings.append(Finding("note", "", sensor.channel, message))
    return findings
