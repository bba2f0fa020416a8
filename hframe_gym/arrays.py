"""Array types that occur in many signatures, with shape and unit stated once.

The names are annotations for readers; a type checker only sees arrays of floats. Letters in shapes: B
machines that are simulated side by side, n coordinates of a machine, P parameters, N samples; "axes" are
those of the tool. Belt travel and other terms are defined in docs/glossary.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""Floats; the docstring of the function states shape and unit."""

Mask: TypeAlias = NDArray[np.bool_]
"""True for the selected machines, shape (B,)."""

Index: TypeAlias = NDArray[np.intp]
"""Indices of machines or environments, ascending, shape (k,)."""

Times: TypeAlias = NDArray[np.float64]
"""Sample times, s, strictly increasing, shape (N,)."""

Inputs: TypeAlias = NDArray[np.float64]
"""Command of each drive, V, A, Nm or its set point's unit, held until the next sample, shape (N, drives)."""

Measurements: TypeAlias = NDArray[np.float64]
"""Measurement of each sensor, in its unit, NaN where it was not measured, shape (N, sensors)."""

SensorNoise: TypeAlias = NDArray[np.float64]
"""Standard deviation of the noise of each sensor, in its unit, shape (sensors,)."""

Quanta: TypeAlias = NDArray[np.float64]
"""Quantization step of each sensor, in its unit, 0 where there is none, shape (sensors,)."""

ElapsedTimes: TypeAlias = NDArray[np.float64]
"""Time since the start of the episode of each machine, s, shape (B,)."""

Volts: TypeAlias = NDArray[np.float64]
"""Voltage of each drive, V, shape (B, drives)."""

Actions: TypeAlias = NDArray[np.float64]
"""Voltages divided by the rated voltages, in [-1, 1], shape (B, drives)."""

ToolPositions: TypeAlias = NDArray[np.float64]
"""Positions of the tool, m of belt travel (radius * angle along a rotary axis), shape (B, axes)."""

PreviewedGoals: TypeAlias = NDArray[np.float64]
"""Goals of the tool, as `ToolPositions`, m, shape (B, 1 + H, axes).

The first is the present goal, the others are those at the ends of the next H periods; H = 0: a fixed goal.
"""

TravelStates: TypeAlias = NDArray[np.float64]
"""Belt travel of the coordinates, m, then its velocity, m/s, shape (B, 2 n)."""

CoordinateForces: TypeAlias = NDArray[np.float64]
"""Force on each coordinate, N, positive in the direction of increasing belt travel, shape (B, n)."""

ParameterRows: TypeAlias = NDArray[np.float64]
"""Parameters of each machine in the order of `Machine.parameters`, SI, shape (B, P)."""

Workspace: TypeAlias = NDArray[np.float64]
"""Workspace of the tool: one row per axis, columns low and high, m or rad, shape (axes, 2)."""

EnvironmentParameters: TypeAlias = NDArray[np.float64]
"""Parameters of k environments, ordered as `ParameterSpace.names` of `hframe_gym.envs`, SI, shape (k, N)."""

EnvironmentCounts: TypeAlias = NDArray[np.int64]
"""A count for each environment, such as its control periods since the reset, shape (environments,)."""

EpisodeKeys: TypeAlias = NDArray[np.uint64]
"""Key (seed) of each episode, from which all its random numbers follow, shape (k,)."""

GoalPlans: TypeAlias = NDArray[np.float64]
"""Plan of each episode: numbers, in the task's format, for its goal at all times, shape (k, plan_size)."""

LaneReadings: TypeAlias = NDArray[np.float64]
"""Readings of all sensors without noise and rounding, in their units, in lanes: (blocks, sensors, LANES).

Machine b is lane b % LANES (8 or 16, `hframe_gym.dynamics.LANES`) of block b // LANES.
"""

KeyedObservation: TypeAlias = Mapping[str, NDArray[Any]]
"""Observation of B machines by key.

- `observation`: positions of the tool's axes and the driven coordinates, m and rad, then their velocities,
  m/s and rad/s, if the full state is observed, shape (B, 2 n); otherwise one measurement per sensor,
  shape (B, channels);
- `achieved_goal`: position of the tool as observed, and `desired_goal`: its present goal, m or rad,
  shape (B, axes) each;
- `preview`, only for a moving goal: goals at the ends of the next H periods, m or rad, shape (B, axes * H):
  all axes of the first, then of the second, ...
"""
