"""Hide from the project's code what only POSIX systems have, in this process and in those that it starts.

What the standard library and other packages import is not changed: on Windows they have their own
implementations.
"""

from __future__ import annotations

import builtins
import multiprocessing
import multiprocessing.context
import os
import select
import signal
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from absent_names import MODULES, NAMES

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]


class _Partial(ModuleType):
    """A module without some of its names; what is set on it is set on the module."""

    def __init__(self, module: ModuleType, absent: frozenset[str]) -> None:
        super().__init__(module.__name__)
        object.__setattr__(self, "_hidden", (module, absent))

    def __getattribute__(self, name: str) -> Any:
        module, absent = object.__getattribute__(self, "_hidden")
        if name in absent:
            raise AttributeError(f"module {module.__name__!r} has no attribute {name!r} (without POSIX)")
        return getattr(module, name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(object.__getattribute__(self, "_hidden")[0], name, value)

    def __delattr__(self, name: str) -> None:
        delattr(object.__getattribute__(self, "_hidden")[0], name)


PARTIAL = {module.__name__: _Partial(module, NAMES[module.__name__]) for module in (os, select, signal, time)}
_import = builtins.__import__


def _is_ours(scope: Mapping[str, Any] | None) -> bool:
    """Return whether the code that imports something is the project's."""
    file = (scope or {}).get("__file__")
    if not file:  # a command line with -c
        return (scope or {}).get("__name__") == "__main__"
    path = os.path.realpath(file)
    return (
        path.startswith(f"{ROOT}{os.sep}")
        and f"{os.sep}.venv{os.sep}" not in path
        and "site-packages" not in path
    )


def _import_without_posix(
    name: str,
    globals: Mapping[str, Any] | None = None,
    locals: Mapping[str, Any] | None = None,
    fromlist: Sequence[str] | None = (),
    level: int = 0,
) -> ModuleType:
    """Import a module as `__import__` does, for the project's code without what only POSIX systems have."""
    top = name.partition(".")[0]
    if level == 0 and (top in MODULES or top in PARTIAL) and _is_ours(globals):
        if top in MODULES:
            raise ModuleNotFoundError(f"No module named {name!r} (without POSIX)", name=name)
        if name == top or not fromlist:
            return PARTIAL[top]
    return _import(name, globals, locals, fromlist or (), level)


def install() -> None:
    """Hide the names here and, by PYTHONPATH, in processes started here; leave only the method spawn."""
    builtins.__import__ = _import_without_posix  # type: ignore[assignment]
    contexts: dict[str, Any] = multiprocessing.context._concrete_contexts  # type: ignore[attr-defined]
    for method in ("fork", "forkserver"):
        contexts.pop(method, None)
    multiprocessing.set_start_method("spawn", force=True)
    if str(FOLDER) not in os.environ.get("PYTHONPATH", "").split(os.pathsep):
        paths = [str(FOLDER), *filter(None, [os.environ.get("PYTHONPATH")])]
        os.environ["PYTHONPATH"] = os.pathsep.join(paths)
