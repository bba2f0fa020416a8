"""Registries: collections of classes or functions, such as controllers and tasks, that are selected by name.

Code outside the package can register more of them, which every command and `gym.make` then accept. There are
three ways: a name of the form `package.module:name` imports that module first; an installed package declares
a module as an entry point of the group `hframe_gym.plugins`; the environment variable `HFRAME_PLUGINS` lists
modules. The latter two are imported when a name is not registered yet. Modules are also found in the current
folder.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib.machinery import PathFinder
from importlib.metadata import entry_points
from pathlib import Path
from typing import Generic, TypeVar

from .errors import InputError, suggestion

T = TypeVar("T")
P = TypeVar("P")
PLUGIN_GROUP = "hframe_gym.plugins"
PLUGIN_VARIABLE = "HFRAME_PLUGINS"


@cache
def load_plugins() -> None:
    """Import all plugins; calls after the first one do nothing.

    A plugin is a module that registers effects, controllers, tasks and so on when it is imported. The
    environment variable `HFRAME_PLUGINS` lists names of modules or paths of Python files, with the separator
    of PATH between them. An installed package declares a plugin as an entry point of the group
    `hframe_gym.plugins`.

    Raises:
        InputError: If a plugin of `HFRAME_PLUGINS` cannot be imported.

    Warns:
        UserWarning: If a plugin of an installed package cannot be imported; all other plugins are still
        imported.
    """
    for name in filter(None, os.environ.get(PLUGIN_VARIABLE, "").split(os.pathsep)):
        import_plugin(name)
    for plugin in entry_points(group=PLUGIN_GROUP):
        try:
            plugin.load()
        except Exception as error:  # a broken third-party package must not disable the commands
            warnings.warn(f"plugin {plugin.name} ({plugin.value}) was not loaded: {error}", stacklevel=2)


def import_plugin(name: str) -> None:
    """Import a plugin, a module that registers effects, controllers, ..., by its name or its file's path.

    Args:
        name: Name of a module, which is installed, on PYTHONPATH or in the current folder, or path of a
            Python file. The folder of the file or module is added to `sys.path`, so that other processes can
            import the module.

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
        _import_from_user(module)
    except Exception as error:
        raise InputError(f"{PLUGIN_VARIABLE}: plugin {name!r} cannot be imported: {error}") from error


def _import_from_user(module: str) -> None:
    """Import a module that a user named: where Python finds it, else in the current folder.

    The folder is then appended to `sys.path`, so that the module and worker processes find modules beside it;
    it comes last, so that files in it replace no installed module.
    """
    top_level = module.partition(".")[0]
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        folder = str(Path.cwd())
        if error.name != top_level or folder in sys.path or PathFinder.find_spec(top_level, [folder]) is None:
            raise
        sys.path.append(folder)
        importlib.import_module(module)


def names_module(name: str) -> bool:
    """Return whether a name has the form `package.module:name`; a Windows path such as C:/x has not."""
    return re.fullmatch(r"[^\W\d][\w.]*:[^\\/:]+", name) is not None


def import_modules(package: str, path: Iterable[str], *, skip: tuple[str, ...] = ()) -> None:
    """Import all modules of a package, except some, so that their parts are registered.

    Args:
        package: Full name of the package, such as "hframe_gym.controllers".
        path: Its folders, the attribute `__path__` of the package.
        skip: Names of modules in the package that are not imported.
    """
    for module in pkgutil.iter_modules(path):
        if module.name not in skip:
            importlib.import_module(f"{package}.{module.name}")


class Registry(Generic[T]):
    """Collection of classes or functions of one kind, such as controllers, selected by name.

    Args:
        kind: What the collection holds, for error messages, for example "controller".
        package: Full name of a package whose modules register further parts. It is imported when an unknown
            name is looked up or all names are listed.
        base: Class from which all parts must inherit; None if there is none.
    """

    def __init__(self, kind: str, package: str = "", base: type | None = None) -> None:
        self.kind = kind
        self._package, self._base = package, base
        self._parts: dict[str, T] = {}

    def register(self, name: str) -> Callable[[P], P]:
        """Return a decorator that adds a class or function to the registry, under a name for options.

        Raises:
            TypeError: When the decorator is applied, if the class does not inherit from the registry's base.
            ValueError: When the decorator is applied, if another class or function has the name. A class or
                function with the same file and `__qualname__` as the registered one, for example of a
                reloaded module, is not another one and replaces it.
        """

        def add(part: P) -> P:
            base = self._base
            if base is not None and not (isinstance(part, type) and issubclass(part, base)):
                raise TypeError(f"{self.kind} {name!r}: {part!r} must be a subclass of {base.__name__}")
            present = self._parts.get(name)
            if present is not None and _origin(present) != _origin(part):
                raise ValueError(f"{self.kind} {name!r} is registered already")
            self._parts[name] = part  # type: ignore[assignment]
            return part

        return add

    def unregister(self, name: str) -> None:
        """Remove what is registered under a name, for example after a test; KeyError if nothing is."""
        del self._parts[name]

    def get(self, name: str) -> T:
        """Return the class or function that is registered under a name.

        If the name is not registered yet, all plugins are imported before the name is looked up.

        Args:
            name: Registered name. `package.module:name` first imports that module, which registers the name;
                it is installed, on PYTHONPATH or in the current folder.

        Raises:
            InputError: If the module cannot be imported or the name is not registered; the message lists all
                names.
        """
        if name in self._parts:
            return self._parts[name]
        module, _, key = name.rpartition(":") if names_module(name) else ("", "", name)
        if module:
            try:
                _import_from_user(module)
            except Exception as error:
                problem = str(error) if isinstance(error, ImportError) else f"{type(error).__name__}: {error}"
                missing = isinstance(error, ModuleNotFoundError)
                advice = (
                    "; install it, add its folder to PYTHONPATH, or change to that folder" if missing else ""
                )
                raise InputError(
                    f"{self.kind} {name!r}: cannot import {module!r}: {problem}{advice}"
                ) from error
        if key not in self:
            file = getattr(sys.modules.get(module), "__file__", None)
            place = f" in {file}" if file else ""  # another module than the user means may have the same name
            raise InputError(
                f"{self.kind} {name!r} is unknown{place}; choose one of {', '.join(self._parts)}"
                f"{suggestion(name, self._parts)}"
            )
        return self._parts[key]

    @property
    def names(self) -> tuple[str, ...]:
        """Registered names in the order of registration. Those of plugins not imported yet are missing."""
        self._import_package()
        return tuple(self._parts)

    def __contains__(self, name: object) -> bool:
        """Return whether a name is registered; plugins are imported before the answer is False."""
        if name not in self._parts:
            self._import_package()
        if name not in self._parts:
            load_plugins()
        return name in self._parts

    def __iter__(self) -> Iterator[str]:
        """Return an iterator over registered names in the order of registration; plugins are not imported."""
        return iter(self.names)

    def _import_package(self) -> None:
        """Import the package whose modules register further parts."""
        if self._package:
            importlib.import_module(self._package)


def _origin(part: object) -> object:
    """Return file and name that define a class or function; a module may be imported under two names."""
    if not hasattr(part, "__qualname__"):
        return part
    return getattr(sys.modules.get(part.__module__), "__file__", part.__module__), part.__qualname__
