"""Versions of the packages on which results depend, as result files state them."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib import metadata

from ..version import __version__

# What simulates, and what trains and runs learned agents.
PACKAGES = ("hframe_gym", "numpy", "scipy", "numba", "torch", "stable-baselines3")


def result_versions(further: Iterable[str] = ()) -> dict[str, str]:
    """List the versions of Python, of packages on which all results depend and of `further` ones, by name.

    Packages that are not installed are omitted.
    """
    return {"python": platform.python_version(), **installed_versions((*PACKAGES, *further))}


def installed_versions(packages: Iterable[str]) -> dict[str, str]:
    """List the versions of packages by name; those that are not installed are omitted.

    Of this package it is that of the code that runs: an editable installation keeps the number of the day it
    was made.
    """
    versions = {}
    for package in packages:
        try:
            versions[package] = __version__ if package == "hframe_gym" else metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return versions
