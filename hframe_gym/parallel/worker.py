"""A task in its worker process, on any backend: one thread, and the caller's version and settings."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import TypeVar

from ..errors import InputError
from ..version import __version__

ATTEMPTS = 3  # of a task whose worker dies
# One thread per worker, so that workers do not compete for cores. The results do not depend on the number of
# threads.
_ONE_THREAD = dict.fromkeys(
    ("HFRAME_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)

Item = TypeVar("Item")
Result = TypeVar("Result")


def run_task(
    function: Callable[[Item], Result], item: Item, version: str, settings: Mapping[str, str]
) -> Result:
    """Run a task in a worker process, with one thread for the linear algebra.

    Args:
        version: Version of this package in the calling process.
        settings: Environment variables to set in the worker, see `task_settings`.

    Returns:
        Result of function(item).

    Raises:
        InputError: If this process has another version of the package.
    """
    from threadpoolctl import threadpool_limits

    if version != __version__:
        raise InputError(
            f"a worker has hframe_gym {__version__}, this program {version}: "
            "install the same version on all machines"
        )
    os.environ.update(settings)
    with threadpool_limits(1):  # libraries that are loaded later read the variables
        return function(item)


def task_settings() -> dict[str, str]:
    """Return environment variables for workers: those that begin with HFRAME_, and limits to one thread."""
    return {k: v for k, v in os.environ.items() if k.startswith("HFRAME_")} | _ONE_THREAD
