"""Test the tool that checks pins and licenses, the hints on extras, and the list of packages to install."""

from __future__ import annotations

import re
import tomllib
from email.message import Message
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

from tools import dependencies, house
from tools.repository import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


class FakeDistribution(metadata.Distribution):
    """Installed package with given metadata fields."""

    def __init__(self, *fields: tuple[str, str]) -> None:
        self._message = Message()
        for name, value in fields:
            self._message[name] = value

    @property
    def metadata(self) -> Any:
        return self._message

    def read_text(self, filename: str) -> str | None:
        return None

    def locate_file(self, path: Any) -> Any:
        raise NotImplementedError


def package(version: str, *requires: str) -> FakeDistribution:
    return FakeDistribution(("Version", version), *(("Requires-Dist", line) for line in requires))


def test_requirements_are_followed_with_extras_and_markers(monkeypatch: pytest.MonkeyPatch) -> None:
    installed = {
        "first": package(
            "1.0", "Second_Package[fast]>=1", "nowhere; sys_platform == 'never'", "nvidia-library==1"
        ),
        "second-package": package("2.0", "speed; extra == 'fast'", "style; extra == 'pretty'", "first"),
        "speed": package("3.0"),
    }
    monkeypatch.setattr(dependencies, "_distribution", installed.get)
    found = dependencies.installed_dependencies([Requirement("First>=1"), Requirement("absent")])
    assert found == {**installed, "absent": None}


def test_an_extra_does_not_repeat_the_extras_that_it_includes() -> None:
    direct, installed = dependencies.requirements_by_extra(PROJECT)
    assert "numpy" in {requirement.name for requirement in direct["core"]}
    assert not {"hframe_gym", "torch"} & {requirement.name for requirement in direct["dev"]}
    assert {"core", "dev", "agents", "report"} <= installed
    assert not {"bench", "release"} & installed


def test_problems_are_reported_per_package() -> None:
    pins = dependencies.read_pins("# comment\nTorch==2.13.0  # pinned\nold_pin==1.0\n")
    assert pins == {"torch": "2.13.0", "old-pin": "1.0"}
    installed = {
        "torch": package("2.13.0+cpu"),
        "old-pin": package("1.1"),
        "new": package("5"),
        "a": None,
        "b": None,
    }
    pins |= {"a": "1", "b": "1"}
    installed |= {"c": None}
    assert list(dependencies.find_problems(installed, {"a", "torch"}, pins)) == [
        "a: is not installed; run: pip install -c constraints.txt -e '.[dev]'",
        "c: constraints.txt has no version",
        "new: constraints.txt has no version",
        "old-pin: constraints.txt has 1.0, installed is 1.1",
    ]


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ([("License-Expression", "MIT OR Apache-2.0"), ("License", "ignored")], "MIT OR Apache-2.0"),
        ([("Classifier", "License :: OSI Approved :: MIT License"), ("License", "ignored")], "MIT"),
        (
            [("Classifier", "License :: OSI Approved"), ("License", "Apache 2.0\nThe whole text")],
            "Apache-2.0",
        ),
        ([("Classifier", "Programming Language :: Python")], "unknown"),
    ],
)
def test_the_license_is_read_from_each_field_that_packages_use(
    fields: list[tuple[str, str]], expected: str
) -> None:
    assert dependencies.license_of(FakeDistribution(*fields)) == expected


def test_a_missing_pin_is_reported_and_then_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    constraints, page = tmp_path / "constraints.txt", tmp_path / "dependencies.md"
    pins = (ROOT / "constraints.txt").read_text("utf-8")
    constraints.write_text(re.sub(r"^numpy==.*\n", "", pins, flags=re.MULTILINE))
    page.write_text("# Title\n\n<!-- dependencies -->\n<!-- end -->\n\nMore text.\n")
    monkeypatch.setattr(dependencies, "CONSTRAINTS", constraints)
    monkeypatch.setattr(dependencies, "PAGE", page)
    assert dependencies.main(["--check"]) == 1
    problems = capsys.readouterr().err
    assert "numpy: constraints.txt has no version" in problems
    assert "numpy: docs/dependencies.md has no such row" in problems
    dependencies.main([])
    assert f"\nnumpy=={metadata.version('numpy')}\n" in constraints.read_text()
    assert f"\n| numpy | {metadata.version('numpy')} | BSD-3-Clause" in page.read_text()
    assert page.read_text().endswith("<!-- end -->\n\nMore text.\n")


def test_resolved_versions_are_compared_with_the_pins(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """GPU libraries depend on the platform and are not pinned."""
    version = dependencies.read_pins(dependencies.CONSTRAINTS.read_text("utf-8"))["numpy"]
    resolved = tmp_path / "resolved.txt"
    resolved.write_text(f"numpy=={version}\nnvidia-something==1.0\n")
    assert dependencies.main(["--resolved", str(resolved)]) == 0
    assert "1 packages" in capsys.readouterr().out
    resolved.write_text("numpy==0.1\nunheard-of==2.0\n")
    assert dependencies.main(["--resolved", str(resolved)]) == 1
    assert capsys.readouterr().err.splitlines() == [
        "numpy==0.1: constraints.txt does not have this line",
        "unheard-of==2.0: constraints.txt does not have this line",
    ]


def test_hints_name_extras_that_exist_and_are_spelled_alike() -> None:
    folders = ("hframe_gym", "agents", "docs", "tests", "tools", "benchmarks", "examples")
    files = [
        file
        for folder in folders
        for file in (ROOT / folder).rglob("*")
        if file.suffix in (".py", ".md", ".j2")
    ]
    hints = [hint for file in [*ROOT.glob("*.md"), *files] for hint in _hints(file)]
    assert len(hints) > 5
    assert [hint for hint in hints if not hint[1].startswith("hframe_gym[")] == []
    named = {extra for _, hint in hints for extra in hint.partition("[")[2].rstrip("]").split(",")}
    assert named <= set(PROJECT["optional-dependencies"])


def _hints(file: Path) -> list[tuple[Path, str]]:
    """Return the names with an extra, such as hframe_gym[agents], in a file or by `naming_extra`."""
    text = file.read_text("utf-8")
    named = [f"hframe_gym[{extra}]" for extra in re.findall(r"naming_extra\(\"([a-z]+)\"", text)]
    return [(file, hint) for hint in [*named, *re.findall(r"hframe[_-]gym\[[a-z,]+\]", text)]]


def test_setup_lists_every_package(monkeypatch: pytest.MonkeyPatch) -> None:
    setuptools = pytest.importorskip("setuptools")
    listed: list[str] = []
    monkeypatch.setattr(setuptools, "setup", lambda packages: listed.extend(packages))
    monkeypatch.chdir(ROOT)
    exec((ROOT / "setup.py").read_text("utf-8"), {})
    folders = [path.parent for path in house.source_files(ROOT) if path.stem == "__init__"]
    names = {".".join(folder.relative_to(ROOT).parts) for folder in folders}
    packages = [name if name.startswith("hframe_gym") else f"hframe_gym.{name}" for name in names]
    assert sorted(listed) == sorted([*packages, "hframe_gym.examples"])  # recordings and notebooks, no code
