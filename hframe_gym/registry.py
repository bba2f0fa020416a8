"""Registries of named parts, such as controllers, tasks, rewards and sensor kinds.

A name of the form `package.module:name` imports the module first. A part that is defined outside the package is
therefore available to every command and to `gym.make` without any change inside the package.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from .errors import InputError

T = TypeVar("T")
P = TypeVar("P")


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
        if key not in self._parts:
            raise InputError(f"{self.kind} {name!r} is unknown; choose one of {', '.join(self._parts)}")
        return self._parts[key]

    @property
    def names(self) -> tuple[str, ...]:
        """Registered names in the order of registration."""
        return tuple(self._parts)

    def __contains__(self, name: object) -> bool:
        """Return whether a name is registered."""
        return name in self._parts

    def __iter__(self) -> Iterator[str]:
        """Iterate over the registered names."""
        return iter(self._parts)
