"""Test that the documentation's links, paths and code blocks are valid, and that the site builds silently."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tools.code_blocks import EXECUTED, SHOWN, Block, BlockError, Interpreters, read_blocks
from tools.repository import ROOT
from tools.tables.pages import pages

PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")])
SITE = [page for page in PAGES if page.parent == ROOT or "docs" in page.parts]
# Paths of this repository in backticks; placeholders such as NAME and patterns are not paths.
_PATH = re.compile(r"`((?:hframe_gym|agents|benchmarks|tests|tools|docs|examples)/[\w./-]*?)(?:::\w+)?`")
_LINK = re.compile(r"\]\((?!https?:|#)([^)#]+)")
# a page whose blocks another test executes names that test
_TESTED_BY = re.compile(r"run by `(tests/[\w/]+\.py)`")


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


@cache
def blocks_of(page: Path) -> tuple[Block, ...]:
    return tuple(read_blocks(page.read_text("utf-8")))


def has_blocks(page: Path, slow: bool) -> bool:
    tested = _TESTED_BY.search(page.read_text("utf-8"))
    if tested and (ROOT / tested[1]).is_file():
        return False
    blocks = [block for block in blocks_of(page) if block.executed]
    return any(block.slow for block in blocks) if slow else any(not block.slow for block in blocks)


@pytest.fixture(scope="module")
def interpreters() -> Iterator[Interpreters]:
    """Return the interpreters of the blocks of all pages."""
    with Interpreters() as started:
        yield started


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_and_paths_exist(page: Path) -> None:
    text = page.read_text("utf-8")
    missing = [link for link in _LINK.findall(text) if not (page.parent / link).exists()]
    if page.name != "CHANGELOG.md" and "decisions" not in page.parts:  # these record what was
        missing += [path for path in _PATH.findall(text) if "NAME" not in path and not (ROOT / path).exists()]
    assert missing == []


def test_the_start_page_leads_to_the_same_pages_as_the_readme() -> None:
    readme, start = (
        [
            line
            for line in (ROOT / name).read_text("utf-8").splitlines()
            if line.startswith("| ") and "](" in line
        ]
        for name in ("README.md", "docs/index.md")
    )
    assert [line.replace("](docs/", "](") for line in readme] == [
        line.replace("](../", "](") for line in start
    ]


@pytest.mark.parametrize("page", SITE, ids=name_of)
def test_every_block_has_a_language(page: Path) -> None:
    """A block without a language would not be executed; one not executed says why in its first line."""
    assert [
        f"line {b.line}: {b.language!r}" for b in blocks_of(page) if b.language not in (*EXECUTED, *SHOWN)
    ] == []


@pytest.mark.integration
@pytest.mark.parametrize("page", [page for page in SITE if has_blocks(page, slow=False)], ids=name_of)
def test_blocks_run(page: Path, interpreters: Interpreters) -> None:
    assert interpreters.run_page(page, slow=False) > 0


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in SITE if has_blocks(page, slow=True)], ids=name_of)
def test_slow_blocks_run(page: Path, interpreters: Interpreters) -> None:
    assert interpreters.run_page(page, slow=True) > 0


def test_reader_of_blocks_finds_all_kinds(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "```python\nvalue = 2\n```\n\n"
        "- in a list:\n\n  ```sh\n  echo first\n  pip install nothing-of-this-name\n  ```\n\n"
        "<!-- slow -->\n```python\nprint(value + 40)\n```\n\n"
        "```sh\n# Not executed in the tests: it would fail.\nfalse\n```\n\n"
        "    indented\n"
    )
    blocks = read_blocks(page.read_text())
    assert [(b.language, b.slow, b.executed) for b in blocks] == [
        ("python", False, True),
        ("sh", False, True),
        ("python", True, True),
        ("sh", False, False),
        ("", False, False),
    ]
    assert page.read_text().splitlines()[blocks[2].line - 1] == "print(value + 40)"
    run = [sys.executable, "-m", "tools.code_blocks", str(page)]
    quick = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "first" in quick
    assert "42" not in quick
    assert (
        "42" in subprocess.run([*run, "--slow"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    )


@pytest.mark.integration
def test_a_block_that_fails_is_named_by_its_line(tmp_path: Path, interpreters: Interpreters) -> None:
    page = tmp_path / "page.md"
    page.write_text("text\n\n```python\nx = 1\nx / 0\n```\n")
    with pytest.raises(BlockError, match=r'page\.md", line 5'):
        interpreters.run_page(page, slow=False)
    page.write_text("text\n\n```sh\nhframe machines show nothing\n```\n")
    with pytest.raises(BlockError, match=r"page\.md, line 4: hframe machines show nothing: exit code 2"):
        interpreters.run_page(page, slow=False)
    page.write_text("```python\nvalue = 1\n```\n")
    assert interpreters.run_page(page, slow=False) == 1
    page.write_text("```python\nprint(value)\n```\n")  # of another page
    with pytest.raises(BlockError, match="name 'value' is not defined"):
        interpreters.run_page(page, slow=False)
    page.write_text("```sh\nfalse | true\n```\n")
    with pytest.raises(BlockError, match="non-zero exit status"):
        interpreters.run_page(page, slow=False)


@pytest.mark.integration
def test_generated_pages_are_up_to_date() -> None:
    assert [name_of(path) for path, text in pages().items() if path.read_text("utf-8") != text] == []


def test_modules_that_the_documentation_runs_exist() -> None:
    for page in PAGES:
        for module in re.findall(r"python -m ((?:benchmarks|tests|tools)[\w.]*)", page.read_text("utf-8")):
            path = ROOT / module.replace(".", "/")
            assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), (
                f"{page.name}: {module}"
            )


def test_links_of_the_site_stay_inside_it() -> None:
    site = pytest.importorskip("tools.docs_site", reason="the site needs the extra docs")
    text = (
        "[a](../RESULTS.md#x), [b](agents.md), [c](../agents/shipped), "
        "![d](figures/e.png), [f](https://example.org)"
    )
    assert site.resolve_links(text, "docs/page.md", "page.md") == (
        "[a](results.md#x), [b](agents.md), c (`agents/shipped` in the repository), "
        "![d](figures/e.png), [f](https://example.org)"
    )
    assert site.resolve_links("[a](docs/errata.md)", "RESULTS.md", "results.md") == "[a](errata.md)"
    assert (
        site.resolve_links("[a](../agents.md)", "docs/decisions/0001.md", "decisions/0001.md")
        == "[a](../agents.md)"
    )
    assert "<mfrac>" in site.format_math(r"\frac{a}{b}")


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_loads_nothing_from_the_network(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="the site needs the extra docs")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NO_MKDOCS_2_WARNING": "1"}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment)
    assert result.returncode == 0, result.stderr[-5000:]
    html = "".join(page.read_text("utf-8") for page in tmp_path.rglob("*.html"))
    loaded = re.findall(r'<(?:script|link|img|iframe)[^>]*(?:src|href)="(?:https?:)?//[^"]*"', html)
    assert loaded == []
    index = json.loads((tmp_path / "search" / "search_index.json").read_text("utf-8"))
    locations = {entry["location"] for entry in index["docs"]}
    assert {
        "commands.html#hframe-identify",
        "reference/machine.html#hframe_gym.machine.Machine.parameters",
    } <= locations
