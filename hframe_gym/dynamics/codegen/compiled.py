"""Compile loops over arrays with Numba, and keep the machine code on disk."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core import event

from ...files import cache_folder

Function = TypeVar("Function", bound=Callable[..., Any])
_njit: Any = numba.njit
_PATIENCE_S = 1.0  # of compilation, after which the user is told why nothing happens


def compiled_only(function: Function, *, inlined: bool = False) -> Function:
    """Compile a function for calls from compiled functions only; it needs no wrapper and compiles faster.

    Args:
        inlined: Whether callers contain its code: for a short function, whose call takes as long as its work.
    """
    options = {"nogil": True, "error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return cast("Function", _njit(**options, forceinline=inlined)(function))


def compiled(function: Function) -> Function:
    """Compile a function with Numba and cache it on disk; its calls release Python's interpreter lock."""
    config: Any = numba.config
    compile_cached = _njit(nogil=True, cache=True, error_model="numpy")
    try:
        return cast("Function", compile_cached(function))
    except RuntimeError:  # neither the package's folder nor Numba's folder in HOME can be written
        configured, config.CACHE_DIR = config.CACHE_DIR, str(cache_folder())
        try:
            return cast("Function", compile_cached(function))
        finally:
            config.CACHE_DIR = configured


class _Notice(event.Listener):
    """Logs one line when this package has been compiling for more than a second in this process."""

    def __init__(self) -> None:
        self._depth, self._since, self._total, self._given = 0, 0.0, 0.0, False

    def on_start(self, happened: Any) -> None:
        """Start the clock at the outermost compilation."""
        if self._depth == 0:
            self._since = time.perf_counter()
        self._depth += 1

    def on_end(self, happened: Any) -> None:
        """Give the notice once enough time has passed; nested compilations count once."""
        self._depth -= 1
        passed = self._total + time.perf_counter() - self._since
        if self._depth == 0:
            self._total = passed
        module = str(happened.data["dispatcher"].py_func.__module__)
        if passed > _PATIENCE_S and not self._given and module.startswith("hframe_gym."):
            self._given = True
            text = (
                "compiling for this processor, once per installation; "
                "the code is kept in %s and beside the package"
            )
            logging.getLogger("hframe_gym").warning(text, cache_folder())


event.register("numba:compile", _Notice())
