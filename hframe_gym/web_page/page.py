"""Fill the template of a page, with its plots as graphics inside it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import naming_extra
from ..files import write_text
from .colors import COLORS
from .panels import NEED, Panel, panel_svg


class NextStep(NamedTuple):
    """What the reader of a page should do next: a sentence, and the command that does it, or ""."""

    text: str
    command: str = ""


def write_page(path: Path, package: str, template: str, values: Mapping[str, Any]) -> None:
    """Fill a Jinja template and write the result as an HTML page.

    Args:
        path: File to write. If writing fails, an existing file is unchanged.
        package: Python package with a folder templates/, for example "hframe_gym.evaluation".
        template: File name in this folder. The template extends `page.html.j2` of
            hframe_gym/web_page/templates.
        values: Variables of the template. A plot (`Panel`) is drawn by the macro `figure` of
            `macros.html.j2`.

    Raises:
        ImportError: If Jinja or matplotlib is missing; the message says how to install them.
        OSError: If the file cannot be written.
    """
    with naming_extra("report", NEED):
        from markupsafe import Markup

        templates = _templates(package)
    count = 0

    def svg(panel: Panel) -> Markup:
        nonlocal count
        count += 1
        return Markup(panel_svg(panel, f"f{count}"))

    write_text(path, templates.get_template(template).render(values, svg=svg, colors=COLORS))


@lru_cache
def _templates(package: str) -> Any:
    """Return the Jinja environment with the templates of a package, which it compiles once."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader

    loader = ChoiceLoader([PackageLoader(package), PackageLoader(__package__)])
    return Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)


def number(value: float | None, absent: str = "") -> str:
    """Format a `value`, in any unit, to three significant digits, as "18.3" or "12413"; `absent` for None."""
    if value is None:
        return absent
    return f"{value:.0f}" if 999.5 <= abs(value) < 1e6 else f"{value:.3g}"
