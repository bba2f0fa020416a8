"""Run a function in a new process, where nothing that an identification left behind can affect the result."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

Result = TypeVar("Result")


def in_fresh_process(function: Callable[..., Result], *arguments: object) -> Result:
    """Call a function in a new process, as a user does who runs the next command.

    A search compiles simulation code that several candidates share; a test in its process would not see an
    error in it.

    Args:
        function: Function of a module, which the process can import.
        *arguments: Its arguments; they must be picklable.

    Returns:
        What the function returns.
    """
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as fresh:
        return fresh.submit(function, *arguments).result()
