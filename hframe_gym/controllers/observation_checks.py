"""Checks that observations are what controllers read: arrays by key with a batch axis, in SI units."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..arrays import KeyedObservation
from ..errors import InputError
from ..machine import Machine
from .models.motion_model import MotionModel

# m. In motion the belts of the stages here stretch by some mm, and end stops yield by less than this.
LARGEST_STRETCH = 0.05
# rad. With `normalize=True` an angle is at most 1.5, its bound over its scale; such an angle moves a belt by
# 1 or 2 cm.
LARGEST_NORMALIZED = 1.5
_ADVICE = (
    "controllers and agents need SI units by key; "
    "make them for the environment, make_controller(name, env), which undoes normalize and flat, "
    "or make the environment without normalize, flat and wrappers that scale observations"
)


def check_keys(observation: Any) -> None:
    """Raise an InputError if an observation is a flat array, not arrays by key, or has no batch axis."""
    if not isinstance(observation, Mapping):
        raise InputError(f"observation is one array of shape {np.shape(observation)}, not a dict: {_ADVICE}")
    if observation["observation"].ndim == 1:
        raise InputError(
            "observation is that of one machine, without batch axis; make the controller "
            "for the environment, make_controller(name, env), or give arrays of shape (1, entries)"
        )


def check_state_units(observation: KeyedObservation, model: MotionModel) -> None:
    """Check that a full-state observation is in SI units: its angles must fit the tool position.

    A tool more than `LARGEST_STRETCH` of belt travel from where all angles are zero has turned some pulley by
    more than `LARGEST_NORMALIZED`. Otherwise the observation is normalized to fractions of the ranges.

    Only observations of environments, which have `achieved_goal`, are checked.

    Raises:
        InputError: If angles and position do not fit; the message names the values.
    """
    if "achieved_goal" not in observation:
        return
    count = len(model.observed)
    values = np.asarray(observation["observation"], np.float64)
    achieved = np.asarray(observation["achieved_goal"], np.float64)
    rotary = [i for i, name in enumerate(model.observed) if model.machine.coordinate(name).kind == "rotary"]
    rotary = [i for i in rotary if model.observed[i] not in model.axes]
    # no angle shows the scale: the size of the workspace has to
    if not rotary or values.shape[1] != 2 * count:
        check_goal_units(observation, model.machine)
        return
    radii = np.array([model.machine.coordinate(model.observed[i]).travel_per_unit for i in rotary])
    rows = [model.machine.coordinate_names.index(model.observed[i]) for i in rotary]
    expected = model.axis_travel(achieved) @ model.rigid[rows].T
    angles = values[:, rotary]
    far = np.abs(angles * radii - expected).max(axis=1) > LARGEST_STRETCH
    scaled = far & (np.abs(angles).max(axis=1) <= LARGEST_NORMALIZED)
    if scaled.any():
        b = int(np.flatnonzero(scaled)[0])
        position = ", ".join(f"{value:.3g}" for value in achieved[b])
        turned = ", ".join(f"{value:.3g}" for value in angles[b])
        raise InputError(
            f"observation is not in SI units: at the position ({position}) "
            f"m the pulleys cannot be at ({turned}) rad, as if the environment had normalize=True; {_ADVICE}"
        )


def check_goal_units(observation: KeyedObservation, machine: Machine) -> None:
    """Check that goals and positions are in m or rad, not normalized: they must lie in the workspace.

    A real axis may overshoot: a position may lie outside by up to half the workspace's length. Positions too
    far away to be normalized ones are not checked. Only observations of environments, which have
    `achieved_goal`, are checked.

    Raises:
        InputError: If a goal is outside the workspace, or a position looks normalized.
    """
    for key in ("achieved_goal", "desired_goal") if "achieved_goal" in observation else ():
        columns = np.asarray(observation[key]).T
        for axis, limits, values in zip(machine.tool_axes, machine.axis_ranges, columns, strict=False):
            low, high = limits or (-np.inf, np.inf)
            margin = LARGEST_STRETCH * machine.axis_unit.per_meter + 1e-6
            normalized = np.abs(values) <= LARGEST_NORMALIZED
            if key == "achieved_goal":
                margin = max(margin, (high - low) / 2.0)
            outside = (values < low - margin) | (values > high + margin)
            wrong = outside & normalized if key == "achieved_goal" else outside
            if wrong.any():
                reason = (
                    "as if the environment had normalize=True"
                    if normalized[wrong].all()
                    else "as if in mm or deg"
                )
                raise InputError(
                    f"observation is not in SI units: {key} has {axis} = {values[wrong][0]:.3g}, "
                    f"and the workspace is {low:g} to {high:g} {machine.axis_unit.name}, {reason}; {_ADVICE}"
                )


class UnitCheck:
    """Check that observations are arrays by key in SI units, for controllers that use them as they are.

    Args:
        full_state: Whether the full state is observed instead of sensors.
    """

    def __init__(self, machine: Machine, full_state: bool) -> None:
        self._machine = machine
        self._model: MotionModel | None = None
        if full_state:
            # A machine with coordinates that nobody observes has no such model; its goals are checked.
            with contextlib.suppress(InputError):
                self._model = MotionModel(machine)

    def __call__(self, observation: KeyedObservation) -> None:
        """Raise an InputError if an observation is one array, lacks the batch axis or is normalized."""
        check_keys(observation)
        if self._model is None:
            check_goal_units(observation, self._machine)
        else:
            check_state_units(observation, self._model)
