"""Functions of SIMD registers, from their source text to their addresses in memory."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

from ..physics import friction
from . import derivative_formulas, lane_compiler, lane_formulas
from .lane_compiler import compile_lanes
from .machine_code import LANES, native_functions

# Python functions that a source text can call, besides the vector instructions.
FORMULAS: Mapping[str, Callable[..., Any]] = {
    name: function
    for module in (friction, lane_formulas, derivative_formulas)
    for name, function in inspect.getmembers(module, inspect.isfunction)
    if function.__module__ == module.__name__
}


class LaneProgram:
    """Compiled functions of SIMD registers. Machine code is kept on disk, where other processes find it.

    Args:
        text: Source text; `lane_compiler` describes the language.
        names: Names of the functions in it.

    Attributes:
        addresses: Address of each function by name, for `call_at`.
    """

    def __init__(self, text: str, names: Sequence[str]) -> None:
        self.text, self.names = text, tuple(names)
        key = f"{_foundation()} {LANES}\n{text}"
        self.addresses = native_functions(key, names, lambda: compile_lanes(text, FORMULAS, LANES))

    def __reduce__(self) -> tuple[Any, ...]:
        return LaneProgram, (self.text, self.names)


@lru_cache(maxsize=1)
def _foundation() -> str:
    """Return a hash of the code with which source texts are compiled."""
    modules = (friction, lane_formulas, derivative_formulas, lane_compiler)
    return hashlib.sha256("".join(map(inspect.getsource, modules)).encode()).hexdigest()
