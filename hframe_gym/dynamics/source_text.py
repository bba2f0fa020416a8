"""Small pieces of source text."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping


def identifier(name: str) -> str:
    """A name as it may stand in source."""
    return re.sub(r"\W", "_", name)


def combination(row: Mapping[str, float], term: Callable[[str], str]) -> str:
    """sum(coefficient * term(name)) as an expression without zeros or ones."""
    text = ""
    # A positive term first: a leading minus would cost an instruction.
    for name, factor in sorted(row.items(), key=lambda item: item[1] < 0):
        if factor == 0.0:
            continue
        size = term(name) if abs(factor) == 1.0 else f"{abs(factor)!r} * {term(name)}"
        text += f" - {size}" if factor < 0 else f" + {size}" if text else size
    return text.lstrip() or "0.0"


def plus(expression: str) -> str:
    """The expression as something to append to a sum."""
    return expression if expression.startswith("- ") else f"+ {expression}"
