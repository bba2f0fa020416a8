"""Test that the documentation's links, paths and examples are valid."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")])
# Paths of this repository in backticks; placeholders such as NAME and patterns are not paths.
_PATH = re.compile(r"`((?:hframe_gym|agents|benchmarks|tests|tools|docs|examples)/[\w./-]*?)(?:::\w+)?`")
_LINK = re.compile(r"\]\((?!https?:|#)([^)#]+)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_paths_exist(page: Path) -> None:
    text = page.read_text("utf-8")
    missing = [link for link in _LINK.findall(text) if not (page.parent / link).exists()]
    if page.name != "CHANGELOG.md" and "decisions" not in page.parts:  # these record what was
        missing += [path for path in _PATH.findall(text) if "NAME" not in path and not (ROOT / path).exists()]
    assert missing == []


def test_examples_of_the_readme_run() -> None:
    examples = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    assert len(examples) == 2
    for example in examples:
        exec(example.replace("num_envs=1024", "num_envs=4"), {})


def test_modules_that_the_documentation_runs_exist() -> None:
    for page in PAGES:
        for module in re.findall(r"python -m ((?:benchmarks|tests|tools)[\w.]*)", page.read_text("utf-8")):
            path = ROOT / module.replace(".", "/")
            assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), f"{page.name}: {module}"
