"""Registries of named parts: classes or functions, such as controllers, tasks, rewards and sensor kinds.

A part that is defined outside the package is available to every command and to `gym.make` without any change inside the
package: a name of the form `package.module:name` imports the module first, and modules that installed packages declare
as entry points of the group `hframe_gym.plugins`, or that the environment variable `HFRAME_PLUGINS` lists, are imported
when a name is not registered yet.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Generic, TypeVar

from .errors import InputError

T = TypeVar("T")
P = TypeVar("P")
PLUGIN_GROUP = "hframe_gym.plugins"
PLUGIN_VARIABLE = "HFRAME_PLUGINS"


@cache
def load_plugins() -> None:
    """Import the plugins of installed packages and those that the environment names; later calls do nothing.

    A plugin is a module that registers effects, controllers, tasks or other parts when it is imported. A package
    declares it as an entry point of the group `hframe_gym.plugins`; the environment variable `HFRAME_PLUGINS` lists
    names of modules or Python files, separated like the folders of PATH.

    Raises:
        InputError: If a plugin of `HFRAME_PLUGINS` cannot be imported.

    Warns:
        UserWarning: If a plugin of a package cannot be imported; the other plugins are still imported.
    """
    for name in filter(None, os.environ.get(PLUGIN_VARIABLE, "").split(os.pathsep)):
        import_plugin(name)
    for plugin in entry_points(group=PLUGIN_GROUP):
        try:
            plugin.load()
        except Exception as error:  # a broken third-party package must not disable the commands
            warnings.warn(f"plugin {plugin.name} ({plugin.value}) was not loaded: {error}", stacklevel=2)


def import_plugin(name: str) -> None:
    """Import a plugin by the name of its module or the path of its file.

    Args:
        name: Name of a module, or path of a Python file. The file's folder is added to `sys.path`, so that other
            processes can import the module as well.

    Raises:
        InputError: If the module cannot be imported.
    """
    module = name
    if name.endswith(".py"):
        path = Path(name).resolve()
        module = path.stem
        if str(path.parent) not in sys.path:
            sys.path.append(str(path.parent))
    try:
        importlib.import_module(module)
    except Exception as error:
        raise InputError(f"{PLUGIN_VARIABLE}: plugin {name!r} cannot be imported: {error}") from error


def import_modules(package: str, path: Iterable[str], *, skip: tuple[str, ...] = ()) -> None:
    """Import every module of a package, so that the parts in them register themselves.

    Args:
        package: Full name of the package, its `__name__`.
        path: Folders of the package, its `__path__`.
        skip: Names of modules, without the package, that are not imported because they need optional dependencies.

    Raises:
        ImportError: If a module cannot be imported.
    """
    for module in pkgutil.iter_modules(path):
        if module.name not in skip:
            importlib.import_module(f"{package}.{module.name}")


class Registry(Generic[T]):
    """Collection of parts (classes or functions) of one kind, which options and commands select by name.

    Args:
        kind: Kind of the parts for error messages, for example "controller".
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._parts: dict[str, T] = {}

    def register(self, name: str) -> Callable[[P], P]:
        """Return a decorator that adds a class or function to the registry.

        Args:
            name: Name by which options and commands select the part.

        Returns:
            A decorator that returns its argument unchanged.

        Raises:
            ValueError: By the decorator, if the name belongs to another part.
        """

        def add(part: P) -> P:
            present = self._parts.get(name)
            if present is not None and getattr(present, "__qualname__", present) != getattr(part, "__qualname__", part):
                raise ValueError(f"{self.kind} {name!r} is registered already")
            self._parts[name] = part  # type: ignore[assignment]
            return part

        return add

    def unregister(self, name: str) -> None:
        """Remove a part from the registry, for example after a test.

        Args:
            name: Name under which the part was registered.

        Raises:
            KeyError: If no part has this name.
        """
        del self._parts[name]

    def get(self, name: str) -> T:
        """Look up a part (class or function) by name; import plugins, or the given module, if necessary.

        Args:
            name: Registered name, or `package.module:name` for a part that this module registers when it is imported.

        Returns:
            Class or function that was registered under the name.

        Raises:
            InputError: If the module cannot be imported or no part has this name; the message lists all names.
        """
        module, colon, key = name.rpartition(":")
        if colon:
            try:
                importlib.import_module(module)
            except ImportError as error:
                raise InputError(f"{self.kind} {name!r}: cannot import {module!r}: {error}") from error
        if key not in self:
            raise InputError(f"{self.kind} {name!r} is unknown; choose one of {', '.join(self._parts)}")
        return self._parts[key]

    @property
    def names(self) -> tuple[str, ...]:
        """Registered names in the order of registration, without plugins that are not imported yet."""
        return tuple(self._parts)

    def __contains__(self, name: object) -> bool:
        """Return whether a part of this name is registered; plugins are imported before the answer is False.

        Args:
            name: Name under which the part may be registered.

        Returns:
            True if it is registered.
        """
        if name not in self._parts:
            load_plugins()
        return name in self._parts

    def __iter__(self) -> Iterator[str]:
        """Return an iterator over the registered names in the order of registration; plugins are not imported."""
        return iter(self._parts)
