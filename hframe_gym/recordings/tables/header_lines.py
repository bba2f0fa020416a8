"""Lines above the data of a table in text: the names and units of its columns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ..quantities import is_unit
from .cells import NUMBER, SEPARATORS, WHITESPACE, is_comment, is_number_or_stamp, split_row

_COMMENT_SIGN = re.compile(r"\s*(?:#+|%+|//+)\s*")
_COMMENTS_WITH_NAMES = 3  # last comments above the data in which the names of the columns are looked for
# Between the names of columns whose values blanks separate, where the names have blanks themselves.
_GAP_OF_NAMES = re.compile(r" *\t[ \t]*| {2,}[ \t]*")
# Last cells of a header that are no columns: LabVIEW's comments, start and increment of the time of an
# oscilloscope.
NOT_A_COLUMN = re.compile(r"comment|start|increment|(?:t0|tinc)\s*=.*", re.IGNORECASE)
NO_HEADER = "it has no header"


@dataclass(frozen=True)
class _LineAbove:
    """Line above the data that may have names or units of columns: its number, and its cells if they fit."""

    number: int
    cells: list[str]
    is_comment: bool

    @property
    def has_units(self) -> bool:
        """Whether at least half of the filled cells are units."""
        filled = [cell for cell in self.cells if cell]
        return bool(filled) and 2 * sum(map(is_unit, filled)) >= len(filled)

    @property
    def has_only_bracketed_units(self) -> bool:
        """Whether all cells are units in brackets, which are no names."""
        return self.has_units and all(cell[:1] in "([{<" for cell in self.cells if cell)


def detect_header(
    lines: Sequence[str], cells: Sequence[Sequence[str]], first: int, widths: Sequence[int], separator: str
) -> tuple[list[str], list[str], list[str]]:
    """Find the names and units of columns above the data of a table, and deviations from a plain header.

    A line may hold names or units if its number of cells is one of `widths`. The last line above the data
    that is no comment is one of the two if it fits; otherwise, the nearest of the last three comments that
    fits. The other one is beside it, in either order.

    Args:
        lines: First lines of the file.
        cells: Cells of each of these lines; none for a comment.
        first: Index of the first line of data.
        widths: Possible numbers of cells in a row, and thus of names, the usual one first.
        separator: Character between cells; a blank means one or more blanks.

    Returns:
        Names, or "#1", "#2", ... if there are none; units in the order of the names, "" where none is stated;
        and how the lines deviate from a single header in the first line of the file, in words.
    """
    deviations = ["its first line is sep="] if lines[0].lower().startswith("sep=") else []
    above = []
    for i in range(first):
        if is_comment(lines[i]):
            above.append(_LineAbove(i, _cells_of_comment(lines[i], widths, separator), True))
        elif any(cells[i]):
            fitting = _fitting(cells[i], widths)
            if not fitting and separator == WHITESPACE:
                fitting = _fitting(_GAP_OF_NAMES.split(lines[i].strip()), widths)
            above.append(_LineAbove(i, fitting, False))
    names, units = _names_and_units(above)
    used = [line.number for line in (names, units) if line is not None]
    if names is None:
        deviations.append(NO_HEADER)
    elif names.is_comment:
        deviations.append("the header is in a comment line")
    if units is not None:
        place = (
            "below the header" if names is not None and units.number > names.number else "above the header"
        )
        in_comment = " in a comment line" if units.is_comment else ""
        deviations.append(f"a row of units is {place if names is not None else 'above the data'}{in_comment}")
    for in_comments, what in ((True, "comment"), (False, "other")):
        skipped = sum(line.is_comment == in_comments and line.number not in used for line in above)
        if skipped:
            plural = "lines are" if skipped > 1 else "line is"
            deviations.append(f"{skipped} {what} {plural} above the data")
    header = names.cells if names is not None else [f"#{k + 1}" for k in range(widths[0])]
    texts = units.cells if units is not None else []
    return header, [*texts, *[""] * len(header)][: len(header)], deviations


def _fitting(row: Sequence[str], widths: Sequence[int]) -> list[str]:
    """Return the cells of a line above the data if their number fits that of the columns, else none."""
    width = widths[0]
    trimmed = list(row[: max((k + 1 for k, cell in enumerate(row) if cell), default=0)])
    while len(trimmed) > max(width, 1) and (
        NOT_A_COLUMN.fullmatch(trimmed[-1]) or NUMBER.fullmatch(trimmed[-1])
    ):
        trimmed.pop()
    return trimmed if len(trimmed) in widths else []


def _cells_of_comment(line: str, widths: Sequence[int], separator: str) -> list[str]:
    """Return the cells of a comment, which may have another separator than the data, if their number fits."""
    text = _COMMENT_SIGN.sub("", line, count=1)
    splits = (_fitting(split_row(text, candidate), widths) for candidate in (separator, *SEPARATORS))
    return next(filter(None, splits), [])


def _names_and_units(above: Sequence[_LineAbove]) -> tuple[_LineAbove | None, _LineAbove | None]:
    """Return the lines above the data that have the names and the units; None where there is none."""
    plain = [line for line in above if not line.is_comment][-1:]
    comments = [line for line in above if line.is_comment][: -_COMMENTS_WITH_NAMES - 1 : -1]
    start = next((line for line in (*plain, *comments) if line.cells), None)
    if start is None:
        return None, None
    place = above.index(start)
    before = _nearest_names(above[:place])
    after = above[place + 1] if place + 1 < len(above) and above[place + 1].cells else None
    if start.has_units and before is not None and not before.has_only_bracketed_units:
        return before, start
    if start.has_only_bracketed_units:
        return None, start
    return start, next((line for line in (after, before) if line is not None and line.has_units), None)


def _nearest_names(above: Sequence[_LineAbove]) -> _LineAbove | None:
    """Return the last line that may have names; lines of numbers below it are passed over."""
    for line in reversed(above):
        if not line.cells or not all(map(is_number_or_stamp, filter(None, line.cells))):
            return line if line.cells else None
    return None
