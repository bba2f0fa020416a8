"""Versions of the packages on which results depend, as result files state them."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib import metadata

from ..version import __version__

# What simulates, and what trains and runs learned agents.
PACKAGES = ("hframe_gym", "numpy", "scipy", "numba", "torch", "stable-baselines3")


def result_versions(further: Iterable[str] = ()) -> dict[str, str]:
    """Return the versions of Python and of the packages on which results depend, by name, for result files.

    `further` packages are added. Packages that are not installed are omitted.
    """
    return {"python": platform.python_version(), **installed_versions((*PACKAGES, *further))}


def installed_versions(packages: Iterable[str]) -> dict[str, str]:
    """Return the versions of installed packages by name; others are omitted.

    For this package, it is the version of the running code, because the metadata of an editable installation
    may be outdated.
    """
    versions = {}
    for package in packages:
        try:
            versions[package] = __version__ if package == "hframe_gym" else metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return versions
