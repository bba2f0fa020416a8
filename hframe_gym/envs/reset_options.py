"""The argument `options` of `reset`, which sets positions, goals, parameters or the state of an episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..arrays import Array
from ..errors import InputError, example_names
from .environment_batch import EnvironmentBatch
from .tasks import check_point


def reset_keywords(
    options: Any, batch: EnvironmentBatch, count: int, others: Sequence[str] = ()
) -> dict[str, Any]:
    """Convert the options of a reset to keywords of `EnvironmentBatch.reset`.

    Args:
        options: Dict with the optional keys `start`, `target`, `parameters` and `state`, see
            `HFrameEnv.reset`; each has values for all environments, or a row for each. None: no options.
        batch: The environments.
        count: Number of environments that are reset.
        others: Further keys, which the caller handles.

    Returns:
        The keywords `start`, `plan`, `parameters` and `motion`, as far as the options determine them.

    Raises:
        InputError: If the options are not a dict, a key or parameter is unknown, or a value has another
            shape, is not finite, or is outside its limits or the workspace. Also if both `start` and `state`
            are given.
    """
    accepted = ("start", "target", "parameters", "state", *others)
    listed = f"{', '.join(map(repr, accepted[:-1]))} or {accepted[-1]!r}"
    if options is not None and not isinstance(options, Mapping):
        raise InputError(f"reset: options is {options!r}, it must be a dict; its keys may be {listed}")
    if unknown := [name for name in options or () if name not in accepted]:
        raise InputError(f"reset: unknown option {', '.join(map(repr, unknown))}; choose {listed}")
    given = {name: value for name, value in (options or {}).items() if value is not None}
    keywords: dict[str, Any] = {}
    if "start" in given:
        keywords["start"] = _points("start", given["start"], batch, count)
    if "target" in given:
        keywords["plan"] = batch.task.aim(_points("target", given["target"], batch, count))
    if "parameters" in given:
        keywords["parameters"] = _parameters(given["parameters"], batch, count)
    if "state" in given:
        if "start" in given:
            raise InputError("reset: give options['start'] or options['state'], not both")
        keywords["motion"] = _states(given["state"], batch, count)
    return keywords


def _points(name: str, given: Any, batch: EnvironmentBatch, count: int) -> Array:
    """Return positions of the tool or of the goal, m or rad, shape (count, axes)."""
    label, axes = f"options[{name!r}]", len(batch.workspace)
    try:
        values = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{label} is {given!r}, it must be a position, numbers in m") from None
    check_point(label, values, batch.workspace)
    if values.ndim > 1 and values.shape not in ((1, axes), (count, axes)):
        raise InputError(f"{label} has shape {values.shape}, it must be ({axes},) or ({count}, {axes})")
    return np.array(np.broadcast_to(values, (count, axes)))


def _parameters(given: Any, batch: EnvironmentBatch, count: int) -> dict[str, Array]:
    """Return values of parameters by full name, SI, shape (count,) each."""
    label, space = "reset: options['parameters']", batch.sampler.space
    names = list(space.names)
    if not isinstance(given, Mapping):
        raise InputError(
            f"{label} is {given!r}, it must be a dict of values by name, such as {{'{names[0]}': 1.0}}"
        )
    parameters = {}
    for name, value in given.items():
        if name not in names:
            raise InputError(f"{label}: unknown parameter {name!r}; {example_names(name, names)}")
        values = _numbers(f"{label}[{name!r}]", value, ((), (1,), (count,)), f"a number or {count} numbers")
        column = np.array(np.broadcast_to(values, (count,)))
        lower, upper = space.lower[names.index(name)], space.upper[names.index(name)]
        for outside in column[(column < lower) | (column > upper)][:1]:
            raise InputError(f"{label}[{name!r}] is {outside:g}, it must be from {lower:g} to {upper:g}")
        if name.endswith(".converter_bits") and (column != np.rint(column)).any():
            raise InputError(f"{label}[{name!r}] is {value!r}, it must be an integer")
        parameters[name] = column
    return parameters


def _states(given: Any, batch: EnvironmentBatch, count: int) -> Array:
    """Return positions of the n coordinates, then their velocities, in their units, shape (count, 2 n)."""
    machine, label = batch.machine, "reset: options['state']"
    size = 2 * len(machine.coordinates)
    order = ", ".join(machine.coordinate_names)
    needed = f"positions of {order} and then their velocities, shape ({size},) or ({count}, {size})"
    values = _numbers(label, given, ((size,), (1, size), (count, size)), needed)
    tool = [machine.coordinate_names.index(axis) for axis in machine.tool_axes]
    check_point(f"{label}: the tool", values[..., tool], batch.workspace)
    return np.array(np.broadcast_to(values, (count, size)))


def _numbers(label: str, given: Any, shapes: Sequence[tuple[int, ...]], needed: str) -> Array:
    """Return a finite array of one of some shapes; raise InputError with the label for another."""
    try:
        values = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{label} is {given!r}, it must be {needed}") from None
    if values.shape not in shapes:
        raise InputError(f"{label} has shape {values.shape}, it must be {needed}")
    if not np.isfinite(values).all():
        raise InputError(
            f"{label} has the value {values[~np.isfinite(values)].ravel()[0]}, it must be finite"
        )
    return values
