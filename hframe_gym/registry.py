"""Registries of named parts, such as controllers, tasks, rewards and sensor kinds.

A part that is defined outside the package is available to every command and to `gym.make` without any change inside the
package: a name of the form `package.module:name` imports the module first, and modules that installed packages declare
as entry points of the group `hframe_gym.plugins` are imported when a name is not registered yet.
"""

from __future__ import annotations

import importlib
import pkgutil
import warnings
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib.metadata import entry_points
from typing import Generic, TypeVar

from .errors import InputError

T = TypeVar("T")
P = TypeVar("P")
PLUGIN_GROUP = "hframe_gym.plugins"


@cache
def load_plugins() -> None:
    """Import the plugins of installed packages, once.

    A plugin is a module that registers effects, controllers, tasks or other parts when it is imported; a package
    declares it as an entry point of the group `hframe_gym.plugins`.

    Warns:
        UserWarning: If a plugin cannot be imported.
    """
    for plugin in entry_points(group=PLUGIN_GROUP):
        try:
            plugin.load()
        except Exception as error:  # a broken third-party package must not disable the commands
            warnings.warn(f"plugin {plugin.name} ({plugin.value}) was not loaded: {error}", stacklevel=2)


def import_modules(package: str, path: Iterable[str], *, skip: tuple[str, ...] = ()) -> None:
    """Import every module of a package, so that the parts in them register themselves.

    Args:
        package: Name of the package, its `__name__`.
        path: Its folders, its `__path__`.
        skip: Modules that are not imported, because they need an extra.
    """
    for module in pkgutil.iter_modules(path):
        if module.name not in skip:
            importlib.import_module(f"{package}.{module.name}")


class Registry(Generic[T]):
    """Parts of one kind by name.

    Args:
        kind: What the parts are, for messages, for example "controller".
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._parts: dict[str, T] = {}

    def register(self, name: str) -> Callable[[P], P]:
        """Return a decorator that adds a part under a name.

        Args:
            name: Name by which options and commands select the part.

        Returns:
            A decorator that returns its argument unchanged.

        Raises:
            ValueError: If the name is taken by another part.
        """

        def add(part: P) -> P:
            present = self._parts.get(name)
            if present is not None and getattr(present, "__qualname__", present) != getattr(part, "__qualname__", part):
                raise ValueError(f"{self.kind} {name!r} is registered already")
            self._parts[name] = part  # type: ignore[assignment]
            return part

        return add

    def unregister(self, name: str) -> None:
        """Remove a part, for example after a test.

        Args:
            name: Name of the part.

        Raises:
            KeyError: If no part has this name.
        """
        del self._parts[name]

    def get(self, name: str) -> T:
        """Return the part of a name.

        Args:
            name: A registered name, or `package.module:name` for a part that the module registers when imported.

        Returns:
            The registered part.

        Raises:
            InputError: If no part has this name; the message lists the names there are.
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
        """Registered names in the order of registration."""
        return tuple(self._parts)

    def __contains__(self, name: object) -> bool:
        """Return whether a name is registered, by a plugin if by nothing else."""
        if name not in self._parts:
            load_plugins()
        return name in self._parts

    def __iter__(self) -> Iterator[str]:
        """Iterate over the registered names."""
        return iter(self._parts)
