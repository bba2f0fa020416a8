"""Leave out the wrong one of a speed and a position that contradict each other in a part of a run.

The drives' forces tell which it is: the motion that one of them measures follows from the commands, that of
the other one only in part.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from ...errors import name_runs
from ...machine import Machine
from ...recordings import Recording, comparison_window
from ..dataset import PreparedRecording
from ..sensors.contradicted_speeds import ContradictedSpeed, contradicted_speeds
from .force_balance import SPANS, force_balance
from .integrated_speeds import with_integrated_speeds
from .motion_windows import motion_windows


def without_contradictions(
    recordings: Sequence[Recording], runs: Sequence[PreparedRecording], machine: Machine
) -> tuple[list[Recording], tuple[str, ...]]:
    """Leave out the sensor that is wrong where a speed contradicts a position.

    Of a speed, the rows of the part are left out. Of a position, all rows of the run: those after the part
    have another zero.

    Args:
        recordings: Runs without unusable measurements.
        runs: The same runs, prepared for a fit.
        machine: Machine as declared.

    Returns:
        Runs without these measurements, and a sentence about each sensor; the same runs and no sentence if
        nothing is contradicted.
    """
    parts = contradicted_speeds(recordings, machine)
    if not parts:
        return list(recordings), ()
    of_position = _position_is_wrong(runs, machine)
    cleaned = []
    for recording in recordings:
        outputs = recording.outputs.copy()
        for part in parts:
            if part.run == recording.name:
                rows = slice(None) if of_position else slice(part.first, part.last + 1)
                outputs[rows, machine.output_channels.index(part.position if of_position else part.speed)] = (
                    np.nan
                )
        cleaned.append(dataclasses.replace(recording, outputs=outputs))
    return cleaned, tuple(_statements(parts, of_position))


def forces_decide(machine: Machine) -> bool:
    """Return whether the drives' forces decide which sensor is left out; otherwise it is the speed.

    They do not decide for drives that follow a set point, whose force is not known, and for machines with
    belts, where the speed of one coordinate does not show the motion of all.
    """
    return not (machine.drive_laws or machine.belts)


def _statements(parts: Sequence[ContradictedSpeed], of_position: bool) -> Iterator[str]:
    """Yield a sentence about each sensor that is left out."""
    for speed, position in dict.fromkeys((part.speed, part.position) for part in parts):
        own = [part for part in parts if (part.speed, part.position) == (speed, position)]
        runs = name_runs(list(dict.fromkeys(part.run for part in own)))
        ratio = float(np.median([part.ratio for part in own]))
        what = (
            f"In parts of {runs}, {speed} is about {ratio:.3g} times the rate at which {position} changes, "
            "in other parts it is not."
        )
        if of_position:
            left_out = f"{position} is left out in these runs, since the motion that {speed} shows"
            yield f"{what} {left_out} follows better from the commands."
        else:
            yield f"{what} {speed} is left out there."


def _position_is_wrong(runs: Sequence[PreparedRecording], machine: Machine) -> bool:
    """Decide whether the measured speeds follow from the drives' forces better than the positions do."""
    if not forces_decide(machine):
        return False
    of_position = machine.position_sensors
    sensors = tuple(sensor for sensor in machine.sensors if sensor.of_position)
    positions = [dataclasses.replace(run, outputs=run.outputs[:, of_position]) for run in runs]
    by_position = _unexplained(positions, machine.replace(sensors=sensors, effects=()))
    return _unexplained(*with_integrated_speeds(runs, machine)) < by_position


def _unexplained(runs: Sequence[PreparedRecording], machine: Machine) -> float:
    """Return the fraction of the drives' squared force that no machine explains, in the best window."""
    unchanged = np.eye(len(machine.sensors)), np.eye(len(machine.drives))
    left = 1.0
    for span in SPANS:
        windows = [motion_windows(run, comparison_window(run.outputs, run.time_s, span)) for run in runs]
        balance = force_balance(windows, machine, *unchanged)
        left = min(left, balance.unexplained if balance else 1.0)
    return left
