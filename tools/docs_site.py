"""Hooks of the documentation site (mkdocs.yml): pages from outside docs/, the command line page, formulas.

    make docs    # or: python -m mkdocs build --strict

Links in docs/ are relative to the repository, so that the pages also work where they are read as files. On
the site, links to files outside docs/ become links to their page, if they have one, or the plain path of the
file.
"""

from __future__ import annotations

import html
import posixpath
import re
from typing import Any

import typer
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from hframe_gym.cli import app
from hframe_gym.help_texts import registered_choices
from tools.repository import ROOT

# Pages of the site that are files of the repository's root folder.
ROOT_PAGES = {
    "RESULTS.md": "results.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
}
TABLES_AND_HISTORY = ("identification_results.md", "results.md", "changelog.md")
_LINK = re.compile(r"(!?)\[([^\]]+)\]\((?!https?:|#|mailto:)([^)#\s]+)(#[^)\s]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not files of docs/ (MkDocs event).

    Returns:
        The same files and the added ones.
    """
    for source, page in ROOT_PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text("utf-8")))
    files.append(File.generated(config, "commands.md", content=commands_page()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Resolve links that leave docs/ (MkDocs event)."""
    uri = page.file.src_uri
    if uri in TABLES_AND_HISTORY:
        page.meta["search"] = {"boost": 0.2}  # below the pages that explain
    source = next((name for name, target in ROOT_PAGES.items() if target == uri), f"docs/{uri}")
    return resolve_links(markdown, source, uri)


def resolve_links(markdown: str, source: str, uri: str) -> str:
    """Replace links to files outside docs/ by links to their page on the site, or by their path.

    Args:
        markdown: Text of a page.
        source: Path of the page's file, relative to the repository.
        uri: Path of the page on the site, relative to docs/.

    Returns:
        The text with replaced links; links to missing files stay, so that MkDocs reports them.
    """

    def resolve(match: re.Match[str]) -> str:
        image, label, link, anchor = match[1], match[2], match[3], match[4] or ""
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link))
        if target.startswith("docs/"):
            inside = target.removeprefix("docs/")
        elif target in ROOT_PAGES:
            inside = ROOT_PAGES[target]
        else:
            return _repository_path(label, target) if (ROOT / target).exists() else match[0]
        if (ROOT / "docs" / inside / "README.md").is_file():
            inside += "/README.md"
        elif (ROOT / "docs" / inside).is_dir():
            return _repository_path(label, target)
        return f"{image}[{label}]({posixpath.relpath(inside, posixpath.dirname(uri) or '.')}{anchor})"

    return _LINK.sub(resolve, markdown)


def _repository_path(label: str, path: str) -> str:
    """Return the text of a link to a file that is not on the site."""
    return f"`{path}`" if label.strip("`") == path else f"{label} (`{path}` in the repository)"


def format_math(source: str, *_: Any, **__: Any) -> str:
    """Convert a fenced block of LaTeX to MathML, which browsers display without scripts."""
    return f'<div class="math">{convert(source.strip(), display="block")}</div>'


def commands_page() -> str:
    """Return the page of the command line: help text, arguments and options of every command.

    Returns:
        The page in Markdown.
    """
    sections = [
        "# Command line\n\nGenerated from the help texts of `hframe COMMAND --help`.",
        "`hframe` and `python -m hframe_gym` are the same. "
        "Exit codes: 0 done, 1 internal error or a fault found by `hframe check`, 2 the input is at fault.",
    ]
    _add_commands(sections, typer.main.get_command(app), "hframe")
    return "\n\n".join(sections) + "\n"


def _add_commands(sections: list[str], command: Any, name: str) -> None:
    """Append the section of a command, or those of all commands of a group."""
    if name != "hframe":
        sections.append(_command_section(command, name))
    if not hasattr(command, "commands"):
        return
    context = typer.Context(command)
    # `hframe export` makes its commands when listed
    for subcommand in sorted(command.list_commands(context)):
        _add_commands(sections, command.get_command(context, subcommand), f"{name} {subcommand}")


def _command_section(command: Any, name: str) -> str:
    """Return the section of one command."""
    text = re.sub(r"^(Example:)\s+(.*)$", r"\1\n\n```text\n\2\n```", command.help or "", flags=re.MULTILINE)
    rows = [_parameter_row(parameter) for parameter in command.params if parameter.name != "help"]
    table = "\n".join(["| argument or option | default | meaning |", "|---|---|---|", *rows]) if rows else ""
    return f"## {name}\n\n{text.strip()}\n\n{table}".strip()


def _parameter_row(parameter: Any) -> str:
    """Return the row of an argument or option."""
    names = ", ".join(parameter.opts) if parameter.param_type_name == "option" else parameter.name.upper()
    default = (
        "" if parameter.default is None or getattr(parameter, "is_flag", False) else str(parameter.default)
    )
    shown = "required" if parameter.required else f"`{default}`" if default else ""
    text = re.sub(
        r"\{(\w+)\}", lambda match: registered_choices().get(match[1], match[0]), parameter.help or ""
    )
    return f"| `{names}` | {shown} | {html.escape(text, quote=False).replace('|', '&#124;')} |"
