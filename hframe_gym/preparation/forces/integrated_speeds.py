"""Integrate measured speeds, so that a balance of forces can take them for positions."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.integrate import cumulative_trapezoid

from ...machine import Machine
from ..dataset import PreparedRecording


def with_integrated_speeds(
    runs: Sequence[PreparedRecording], machine: Machine
) -> tuple[list[PreparedRecording], Machine]:
    """Replace the sensors of speeds by sensors of positions, and their measurements by the integrals.

    Returns:
        Runs with positions only, m or rad, which begin with 0 at the first measured speed; and the machine
        with encoders in place of its sensors, without effects.
    """
    of_speed = np.array([sensor.of_velocity for sensor in machine.sensors], np.bool_)
    sensors = tuple(dataclasses.replace(s, kind="encoder") for s in machine.sensors if s.of_velocity)
    positions = []
    for run in runs:
        outputs = run.outputs[:, of_speed].copy()
        for values in outputs.T:
            measured = np.flatnonzero(np.isfinite(values))
            if len(measured):
                rows = slice(measured[0], measured[-1] + 1)
                time_s = run.time_s[rows]
                speeds = np.interp(time_s, run.time_s[measured], values[measured])
                values[rows] = cumulative_trapezoid(speeds, time_s, initial=0.0)
        positions.append(dataclasses.replace(run, outputs=outputs))
    return positions, machine.replace(sensors=sensors, effects=())
