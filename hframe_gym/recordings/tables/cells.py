"""Cells of a table in text: how rows are split into them, and if they are numbers, time stamps or empty."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence

WHITESPACE = " "  # as a separator: one or more blanks
# In the order of preference; a table with semicolons or tabs may have decimal commas.
SEPARATORS = {"\t": "tabs", ";": "semicolons", "|": "vertical bars", ",": "commas", WHITESPACE: "blanks"}
CONSECUTIVE = 3  # rows of numbers that mark the beginning of the data
MISSING_WORDS = r"#?n/?a|null|none|nil|missing|#(?:num|value|ref)!|#div/0!|--+"
_COMMENT_SIGNS = ("#", "%", "//")
_MISSING = re.compile(rf"(?:{MISSING_WORDS}|[+-]?nan|)", re.IGNORECASE)
# Also a number whose thousands are separated, which is refused later with advice; "1.0,0.5,0.2" is a row of
# numbers.
NUMBER = re.compile(
    r"[+-]?"
    r"(?:\d+(?:[.,]\d*)?|\d{1,3}(?:\.\d{3})+(?:,\d*)?|\d{1,3}(?:,\d{3})+(?:\.\d*)?|[.,]\d+)"
    r"(?:e[+-]?\d+)?"
    r"|[+-]?inf(?:inity)?",
    re.IGNORECASE,
)
_DATE = r"(?:\d{4}-\d\d-\d\d|\d\d\.\d\d\.\d{4})"
_TIME_STAMP = re.compile(rf"(?:{_DATE}[T ]+)?\d{{1,2}}:\d\d:\d\d(?:[.,]\d+)?(?:Z|[+-]\d\d:?\d\d)?|{_DATE}")


def split_row(line: str, separator: str) -> list[str]:
    """Split a line into cells, without blanks and quotation marks around them.

    Several blanks count as one separator. A separator between quotation marks does not split a cell, unless
    the separator is a blank: then quotation marks have no effect and are kept.
    """
    if separator == WHITESPACE:
        return line.split()
    # Nearly all lines; the reader below returns the same, but takes longer.
    if '"' not in line and line.strip():
        return [cell.strip() for cell in line.split(separator)]
    try:
        cells = next(csv.reader([line], delimiter=separator), [])
    except csv.Error:  # such as a cell of more than 131072 characters
        cells = line.split(separator)
    return [cell.strip() for cell in cells]


def is_missing(cell: str) -> bool:
    """Return whether a cell has no value: it is empty, or a word such as NA, NaN, null or #N/A."""
    return _MISSING.fullmatch(cell) is not None


def is_stamp(cell: str) -> bool:
    """Return whether a cell is a time stamp: a time of day, a date (2024-05-31 or 31.05.2024), or both."""
    return _TIME_STAMP.fullmatch(cell) is not None


def is_comment(line: str) -> bool:
    """Return whether a line begins with #, % or //, and not with a missing value such as #N/A."""
    return line.lstrip().startswith(_COMMENT_SIGNS) and not is_missing(re.split(r"[,;\t ]", line.lstrip())[0])


def detect_separator(lines: Sequence[str]) -> str:
    """Find the separator of a table's cells: one of `SEPARATORS`, a blank for one or more blanks.

    Args:
        lines: First lines of the file.

    Returns:
        The separator that makes most lines rows of numbers (`is_data`) with one number of cells. If none
        makes any, the most frequent one in the last line, other than blanks.
    """
    scores = {}
    written = [line for line in lines if line.strip() and not is_comment(line)]
    for separator in SEPARATORS:
        # Whitespace of any kind separates cells where blanks do.
        divisible = written if separator == WHITESPACE else [line for line in written if separator in line]
        rows = [split_row(line, separator) for line in divisible]
        # Texts have blanks as well, so more than half of the cells between blanks must be numbers.
        least = 0.6 if separator == WHITESPACE else 0.5
        widths = Counter(len(row) for row in rows if len(row) > 1 and is_data(row, least))
        scores[separator] = max(widths.values(), default=0)
    best = max(scores, key=lambda separator: scores[separator])
    if scores[best]:
        return best
    last = next((line for line in reversed(lines) if line.strip()), "")
    return max((s for s in SEPARATORS if s != WHITESPACE), key=lambda s: (last.count(s), s == ","))


def is_data(row: Sequence[str], least: float = 0.5) -> bool:
    """Return whether enough cells of a row are numbers or time stamps, and at least one.

    Args:
        row: Cells of the row, see `split_row`.
        least: Smallest fraction of numbers and time stamps, 0 to 1, among the cells that are not missing
            (`is_missing`).
    """
    numbers = texts = 0
    for cell in row:
        if is_number_or_stamp(cell):
            numbers += 1
        elif not is_missing(cell):
            texts += 1
    return numbers > 0 and numbers >= least * (numbers + texts)


def is_row(row: Sequence[str]) -> bool:
    """Return whether a row belongs to the data.

    It does if at least half of its cells that are not missing are numbers or time stamps (`is_data`), or if
    all its cells are missing and not all are empty.
    """
    return is_data(row) or (any(row) and all(map(is_missing, row)))


def is_number_or_stamp(cell: str) -> bool:
    """Return whether a cell is a number or a time stamp."""
    return NUMBER.fullmatch(cell) is not None or is_stamp(cell)
