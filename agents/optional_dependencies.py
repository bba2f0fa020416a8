"""The extra `agents`: its modules, named where they are missing, and how torch is to run."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


def load(module: str) -> Any:
    """Import a module of the extra `agents`.

    Raises ImportError naming the extra when it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        name = module.partition(".")[0]
        raise ImportError(f"learned controllers need {name}: pip install 'hframe-gym[agents]'") from error


@contextmanager
def one_thread() -> Iterator[None]:
    """torch on one thread: networks as small as these wait for a second one far longer than it helps."""
    torch = load("torch")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
