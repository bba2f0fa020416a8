"""Step the state of one effect along a known motion, as machine code that is generated from its formula."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from ...arrays import Array
from ...machine import argument_names
from ..symbolic.source_text import function_source
from ..symbolic.tracing import Trace
from .blocks import in_blocks
from .lane_program import LaneProgram

_FUNCTION = "follow"
_Follow = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)


def follow_state(next_state: Callable[..., Any], steps: Mapping[str, Array]) -> Array:
    """Compute the internal state of an effect along a known motion: before each of n steps, from zero.

    Args:
        next_state: Formula of the effect for its state after a step (`Effect.next_state`).
        steps: Arguments of the formula other than the state, SI, by name: arrays of shape (n,), or (variants,
            n) with one row for each of several variants of the effect.

    Returns:
        States, SI, shape (n,), or (variants, n) if an argument has variants.
    """
    names = _step_names(next_state)
    shape = np.broadcast_shapes(*(steps[name].shape for name in names))
    arguments = np.empty((*np.atleast_2d(np.empty(shape)).shape, len(names)))
    for column, name in enumerate(names):
        arguments[..., column] = steps[name]
    variants, count, _ = arguments.shape
    blocks = in_blocks(arguments.reshape(variants, -1))
    states = np.zeros((len(blocks), count, blocks.shape[2]))
    follow = _compiled(next_state)
    for block, followed in zip(blocks, states, strict=True):
        follow(block.ctypes.data, followed.ctypes.data, count)
    by_variant = states.transpose(0, 2, 1).reshape(-1, count)[:variants]
    return np.ascontiguousarray(by_variant.reshape(shape))


def _step_names(next_state: Callable[..., Any]) -> list[str]:
    """Return the names of the arguments of a formula but the state."""
    return [name for name in argument_names(next_state) if name != "z"]


@cache
def _compiled(next_state: Callable[..., Any]) -> Callable[..., None]:
    """Return the function that steps a block of variants; it expects their initial states in row 0."""
    names = _step_names(next_state)
    trace = Trace(f"{_FUNCTION}(arguments, states, steps: int)")
    state = trace.variable("state", None, trace.load("states", 0, ""))
    with trace.block("for step in range(steps):", loop=True):
        rows = {
            name: trace.load("arguments", f"step * {len(names)} + {column}", f"a{column}", invariant=False)
            for column, name in enumerate(names)
        }
        trace.store("states", "step", state)
        trace.assign(state, trace.expression(next_state(z=state, **rows)))
    program = LaneProgram(function_source(trace), (_FUNCTION,))
    return _Follow(program.addresses[_FUNCTION])
