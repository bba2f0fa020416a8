"""Check that constraints.txt pins every dependency, and list their licenses in docs/dependencies.md.

    python -m tools.dependencies [--check] [--resolved FILE]

Without an option, missing pins are added to constraints.txt and the table of docs/dependencies.md is written.
With one, nothing is written: the exit code is 1, and one line per problem says what is wrong.

The dependencies are those of the installed packages, followed from the requirements in pyproject.toml. Of
extras that the extra `dev` does not include, such as `clients`, only the direct requirements are known unless
they are installed. `make audit` therefore resolves all extras on the package index, and `--resolved` compares
the result with the pins.
"""

from __future__ import annotations

import argparse
import re
import sys
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from hframe_gym.files import write_text
from tools.repository import ROOT

CONSTRAINTS, PAGE = ROOT / "constraints.txt", ROOT / "docs" / "dependencies.md"
# The build of torch with GPU libraries, which pip installs by default on Linux, names their exact versions
# itself.
_GPU_LIBRARIES = ("cuda-", "nvidia-", "triton")
_HEADER = ("| package | version | license | extra |", "| --- | --- | --- | --- |")
_TABLE = re.compile(r"<!-- dependencies -->\n.*?<!-- end -->", re.DOTALL)
# Licenses that older packages state as free text or as a classifier, as SPDX identifiers.
_SPDX = {
    "3-Clause BSD License": "BSD-3-Clause",
    "Apache 2.0": "Apache-2.0",
    "Apache License 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "BSD": "BSD-3-Clause",
    "BSD License": "BSD-3-Clause",
    "GNU Library or Lesser General Public License (LGPL)": "LGPL",
    "GNU Lesser General Public License v3 or later (LGPLv3+)": "LGPL-3.0-or-later",
    "ISC License (ISCL)": "ISC",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Python Software Foundation License": "PSF-2.0",
}


def requirements_by_extra(project: Mapping[str, Any]) -> tuple[dict[str, list[Requirement]], set[str]]:
    """Read the direct requirements of the package.

    Args:
        project: The table `project` of pyproject.toml.

    Returns:
        requirements: Requirements by extra, those without an extra under "core". An extra that includes other
            extras of the package itself, as `dev` does, does not repeat their requirements.
        installed: The extras that an installation with the extra `dev` includes, with "core" and "dev".
    """
    lines = {"core": project["dependencies"], **project["optional-dependencies"]}
    package = canonicalize_name(project["name"])
    requirements: dict[str, list[Requirement]] = {}
    included: dict[str, set[str]] = {}
    for extra, group in lines.items():
        parsed = [Requirement(line) for line in group]
        requirements[extra] = [r for r in parsed if canonicalize_name(r.name) != package]
        included[extra] = {name for r in parsed if canonicalize_name(r.name) == package for name in r.extras}
    installed, pending = {"core"}, {"dev"}
    while pending:
        extra = pending.pop()
        installed.add(extra)
        pending |= included[extra] - installed
    return requirements, installed


def installed_dependencies(requirements: Iterable[Requirement]) -> dict[str, metadata.Distribution | None]:
    """Follow requirements through the installed packages.

    Args:
        requirements: Requirements to start from; those whose marker excludes this platform are ignored.

    Returns:
        Installed distribution by canonical name, direct and indirect ones without GPU libraries; None where a
        package is not installed.
    """
    pending = [(requirement, "") for requirement in requirements]
    found: dict[str, metadata.Distribution | None] = {}
    visited: set[tuple[str, str]] = set()
    while pending:
        requirement, extra = pending.pop()
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        name = canonicalize_name(requirement.name)
        if name.startswith(_GPU_LIBRARIES):
            continue
        if name not in found:
            found[name] = _distribution(name)
        distribution = found[name]
        for wanted in ("", *requirement.extras):
            if distribution is None or (name, wanted) in visited:
                continue
            visited.add((name, wanted))
            pending += [(Requirement(line), wanted) for line in distribution.requires or ()]
    return found


def read_pins(text: str) -> dict[str, str]:
    """Read the pinned versions, by canonical name, from the text of a constraints file."""
    lines = (line.partition("#")[0].strip() for line in text.splitlines())
    return {
        canonicalize_name(name): version
        for name, _, version in (line.partition("==") for line in lines if line)
    }


def find_problems(
    packages: Mapping[str, metadata.Distribution | None], needed: Collection[str], pins: Mapping[str, str]
) -> Iterator[str]:
    """Compare the installed packages with the pins.

    Args:
        packages: Installed distribution by canonical name, None where a package is not installed.
        needed: Names of the packages that must be installed.
        pins: Pinned version by canonical name.

    Yields:
        One line of text per package that is not installed, not pinned, or installed in another version.
    """
    for name, distribution in sorted(packages.items()):
        if distribution is None:
            if name not in pins:
                yield f"{name}: constraints.txt has no version"
            elif name in needed:
                yield f"{name}: is not installed; run: pip install -c constraints.txt -e '.[dev]'"
        elif name not in pins:
            yield f"{name}: constraints.txt has no version"
        elif Version(pins[name]).public != Version(distribution.version).public:
            yield f"{name}: constraints.txt has {pins[name]}, installed is {distribution.version}"


def license_of(distribution: metadata.Distribution) -> str:
    """Return the license that a package declares.

    Returns:
        SPDX expression, where the package states one or its text is known; else the declared text, "unknown"
        if none.
    """
    fields = distribution.metadata
    if "License-Expression" in fields:
        return fields["License-Expression"]
    classifiers = [
        c.rpartition(" :: ")[2] for c in fields.get_all("Classifier") or () if c.startswith("License :: ")
    ]
    declared = [text for text in classifiers if text != "OSI Approved"]
    if not declared and "License" in fields:
        declared = fields["License"].splitlines()[:1]  # some packages put the whole text of the license there
    return " AND ".join(_SPDX.get(text, text) for text in declared) or "unknown"


def license_rows(groups: Mapping[str, Mapping[str, metadata.Distribution | None]]) -> dict[str, str]:
    """Format the rows of the table in docs/dependencies.md.

    Args:
        groups: Packages that each extra needs, directly or indirectly: distribution by canonical name, by
            extra.

    Returns:
        Row in Markdown by canonical name. A package is listed once, with the first extra that needs it.
    """
    rows: dict[str, str] = {}
    for extra, packages in groups.items():
        for name, found in sorted(packages.items()):
            if found is not None and name not in rows:
                rows[name] = f"| {name} | {Version(found.version).public} | {license_of(found)} | {extra} |"
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Check or write constraints.txt and docs/dependencies.md.

    Args:
        arguments: Command line without the program's name. Default: that of the process.

    Returns:
        Exit code: 1 if there is a problem, else 0.
    """
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--check", action="store_true", help="write nothing; exit with 1 if something is missing"
    )
    parser.add_argument(
        "--resolved", type=Path, metavar="FILE", help="check only that every name==version of it is pinned"
    )
    options = parser.parse_args(arguments)
    if options.resolved:
        return _check_resolved(options.resolved)
    check = options.check
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    requirements, installed = requirements_by_extra(project)
    groups = {extra: installed_dependencies(direct) for extra, direct in requirements.items()}
    every = {name: found for packages in groups.values() for name, found in packages.items()}
    needed = {name for extra in installed for name in groups[extra]}
    rows = license_rows({extra: packages for extra, packages in groups.items() if extra in installed})
    if not check:
        _write_pins(every)
        table = "\n".join(["<!-- dependencies -->", *_HEADER, *rows.values(), "<!-- end -->"])
        write_text(PAGE, _TABLE.sub(lambda _: table, PAGE.read_text("utf-8")))
    pins, page = read_pins(CONSTRAINTS.read_text("utf-8")), PAGE.read_text("utf-8").splitlines()
    problems = [
        *find_problems(every, needed, pins),
        *(
            f"{name}: docs/dependencies.md has no such row: {row}"
            for name, row in rows.items()
            if row not in page
        ),
    ]
    for problem in problems:
        print(problem, file=sys.stderr)
    if problems:
        print("To add what is missing, run: python -m tools.dependencies", file=sys.stderr)
    else:
        print(f"{len(needed)} dependencies are pinned and listed with their licenses")
    return 1 if problems else 0


def _check_resolved(path: Path) -> int:
    """Compare resolved versions with the pins and report differences; return the exit code."""
    pins, resolved = (read_pins(file.read_text("utf-8")) for file in (CONSTRAINTS, path))
    resolved = {name: version for name, version in resolved.items() if not name.startswith(_GPU_LIBRARIES)}
    wrong = [f"{name}=={version}" for name, version in resolved.items() if pins.get(name) != version]
    for line in wrong:
        print(f"{line}: constraints.txt does not have this line", file=sys.stderr)
    if not wrong:
        print(f"{len(resolved)} packages that the extras need are pinned")
    return 1 if wrong else 0


def _write_pins(packages: Mapping[str, metadata.Distribution | None]) -> None:
    """Add the versions of installed packages that constraints.txt lacks; pins that it has stay."""
    text = CONSTRAINTS.read_text("utf-8")
    comments = [line for line in text.splitlines() if line.startswith("#")]
    found = {
        name: Version(package.version).public for name, package in packages.items() if package is not None
    }
    pins = {**found, **read_pins(text)}
    write_text(
        CONSTRAINTS, "\n".join([*comments, *(f"{name}=={pins[name]}" for name in sorted(pins))]) + "\n"
    )


def _distribution(name: str) -> metadata.Distribution | None:
    """Return an installed distribution, None if there is none of this name."""
    try:
        return metadata.distribution(name)
    except metadata.PackageNotFoundError:
        return None


if __name__ == "__main__":
    raise SystemExit(main())
