"""Save and restore the complete state of environments.

The state is everything that changes: positions, velocities and the internal states of effects, sampled
parameters, histories of voltages and readings (dead times, delays), measurements, goals, counters of the
random numbers. It is collected from the objects themselves, so that a new part of the simulation is saved
without a line here.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..errors import InputError
from ..machine import Machine

FORMAT = 1
_PACKAGE = __name__.rpartition(".")[0]
_NUMBERS = (bool, int, float, str, bytes, type(None), np.generic)


def batch_state(batch: Any) -> dict[str, Any]:
    """Copy the state of an `EnvironmentBatch` for `restore_batch`.

    Returns:
        Arrays and numbers, by the path of their attribute from the batch, such as "simulator.state".
    """
    return {path: _copied(vars(owner)[name]) for path, owner, name in _attributes(batch)}


def restore_batch(batch: Any, state: dict[str, Any]) -> None:
    """Write a state of `batch_state` back into an `EnvironmentBatch`.

    Raises:
        InputError: If the state has other attributes than the batch, which then is not changed.
    """
    attributes = {path: (owner, name) for path, owner, name in _attributes(batch)}
    different = sorted(set(attributes) ^ set(state))
    if different:
        raise InputError(
            f"set_state: the state is of an environment with other options ({', '.join(different[:3])})"
        )
    for path, (owner, name) in attributes.items():
        present, value = vars(owner)[name], state[path]
        if isinstance(present, np.ndarray) and isinstance(value, np.ndarray) and _alike(present, value):
            if present.flags.writeable:
                present[...] = value  # in place: others hold the same array
        else:
            # Not through __setattr__, which a frozen class forbids.
            vars(owner)[name] = _copied(value)


def generator_state(generator: np.random.Generator | None) -> dict[str, Any] | None:
    """Copy the state of a random generator, the dict of its bit generator; None for no generator."""
    return None if generator is None else copy.deepcopy(dict(generator.bit_generator.state))


def check_state(state: Any, kind: str, batch: Any) -> None:
    """Raise an InputError unless the argument of `set_state` fits these environments.

    Args:
        state: The argument, such as a result of `get_state`.
        kind: Kind of these environments, "single" or "vector".
        batch: Their `EnvironmentBatch`, whose machine, number and options the state must have.
    """
    if not isinstance(state, dict) or state.get("format") != FORMAT:
        raise InputError("set_state: the argument is no state that get_state of this version returned")
    if state["kind"] != kind:
        raise InputError(
            f"set_state: the state is of a {state['kind']} environment, and this is a {kind} one"
        )
    if state["fingerprint"] != batch.fingerprint:
        raise InputError("set_state: the state is of an environment with another machine, number or options")


def _attributes(root: Any) -> Iterator[tuple[str, Any, str]]:
    """Yield path, owner and name of each attribute with plain data in this package's objects below a root."""
    pending, seen = [("", root)], {id(root)}
    while pending:
        prefix, owner = pending.pop()
        for name, value in vars(owner).items():
            path = f"{prefix}{name}"
            if _is_plain(value):
                yield path, owner, name
            elif _is_part(value) and id(value) not in seen:
                seen.add(id(value))
                pending.append((f"{path}.", value))


def _copied(value: Any) -> Any:
    """Return a copy of plain data."""
    if isinstance(value, np.ndarray):
        return value.copy()
    return value if isinstance(value, _NUMBERS) else copy.deepcopy(value)


def _is_plain(value: Any) -> bool:
    """Return whether a value consists of arrays and numbers only."""
    if isinstance(value, np.ndarray):
        return value.dtype != object
    if isinstance(value, _NUMBERS):
        return True
    if isinstance(value, dict):
        return all(map(_is_plain, value.values()))
    if isinstance(value, list | tuple | deque | set):
        return all(map(_is_plain, value))
    return False


def _is_part(value: Any) -> bool:
    """Return whether a value is an object of this package that can change; settings and machines cannot."""
    if isinstance(value, type | Machine) or not hasattr(value, "__dict__"):
        return False
    parameters = getattr(type(value), "__dataclass_params__", None)
    frozen = parameters is not None and parameters.frozen
    return type(value).__module__.startswith(f"{_PACKAGE}.") and not frozen


def _alike(first: np.ndarray[Any, Any], second: np.ndarray[Any, Any]) -> bool:
    """Return whether two arrays have the same shape and type."""
    return first.shape == second.shape and first.dtype == second.dtype
