"""Imports of the extra `agents`, with a message that names the extra where a package is missing."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ..errors import naming_extra

EXTRA_MODULES = ("torch", "stable_baselines3", "safetensors.torch", "tensorboard")
CONTRIB_ALGORITHMS = ("tqc", "crossq")  # of sb3-contrib, which the other algorithms do not need


def import_optional(module: str) -> Any:
    """Import a module such as "stable_baselines3.ppo"; if it is missing, an ImportError names the extra."""
    with naming_extra("agents", f"learned controllers need {module.partition('.')[0]}"):
        return importlib.import_module(module)


def require_training_packages(kind: str) -> None:
    """Import every package that an algorithm needs, so that a missing one is reported before work starts.

    Args:
        kind: Algorithm, one of `ALGORITHMS` of recipe.py, such as "ppo".

    Raises:
        ImportError: If a package is missing; the message names the extra that has it.
    """
    for module in (*EXTRA_MODULES, *(("sb3_contrib",) if kind in CONTRIB_ALGORITHMS else ())):
        import_optional(module)


@contextmanager
def single_threaded_torch() -> Iterator[None]:
    """Limit torch to one thread inside a `with` block; afterwards, restore the number of threads.

    The policies are small: waiting for a second thread costs more time than the thread saves.
    """
    torch = import_optional("torch")
    threads_before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads_before)
