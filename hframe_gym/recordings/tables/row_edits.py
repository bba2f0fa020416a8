"""Parts of a text's rows that do not belong to a table: brackets, arrows, letters, names before numbers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from .cells import (
    CONSECUTIVE,
    MISSING_WORDS,
    NUMBER,
    SEPARATORS,
    WHITESPACE,
    detect_separator,
    is_comment,
    is_missing,
    is_number_or_stamp,
    split_row,
)

_ROW_ENDS = ";,|\t"  # separators that may end each row although other separators are between its cells
_MOST = 0.5  # fraction of the rows of numbers that have such an end; their last one may be incomplete
# Beginning of a row of numbers.
_ROW_START = re.compile(rf"[ \t]*\"?(?:[+-]?[.,]?\d|(?:nan|{MISSING_WORDS})\b)", re.IGNORECASE)
# Name before a number, as for Arduino's serial plotter: "speed:1.5", "speed=1.5". The "e" of "1e-3" begins
# none.
_LABEL = re.compile(r"(?<![\w.])(?!(?:nan|inf)\b)[^\W\d][^:=;,|\t\n]{0,40}[:=][ \t]*")
# Between time stamp and text in Arduino's serial monitor.
_ARROW = re.compile(r"(?m)^(\d\d:\d\d:\d\d\.\d+) -> ")
# Brackets around a matrix, as ECP's programs write it, or around each row, perhaps after one name for all of
# its numbers ("log=[1.0, 2.0]") and after the arrow of the serial monitor.
_OPENING = r"(?:^|(?<=\d -> ))[ \t]*(?:[^\W\d]\w{0,40}[ \t]*[:=][ \t]*)?\[(?=[ \t]*[-+.\d])"
_OPENS = re.compile(_OPENING)
_BRACKET = re.compile(rf"(?m){_OPENING}|(?<=\d)[ \t]*\](?=[ \t]*[;,]?[ \t]*$)")
_TAB = "\t"
# What may be between the cells of a row with different separators: commas before blanks only, then any.
_GAPS = (re.compile(r" *[;|\t] *|,? +"), re.compile(r" *[;|,\t] *| +"))
# Row between two equal letters, as SimpleFOC's monitor writes it.
_ENCLOSED = re.compile(r"(?P<letter>[A-Za-z])[-+.\d][-+.\d\t]*\d(?P=letter)[ \t]*")


def find_edits(lines: Sequence[str]) -> tuple[list[tuple[re.Pattern[str], str]], list[str], list[str]]:
    """Find the parts of lines to remove before they are split into cells, such as brackets and arrows.

    Args:
        lines: First lines of the file, data and what stands above.

    Returns:
        Patterns with their replacements, to be applied to complete lines in this order; names of the columns
        where they stand before the numbers in each row, else none; and how the file deviates from a
        recording, in words.
    """
    rows = [line.rstrip(" ") for line in lines if not is_comment(line) and any(map(str.isdigit, line))]
    edits: list[tuple[re.Pattern[str], str]] = []
    remarks = []
    if any(map(_OPENS.search, rows)):
        edits.append((_BRACKET, ""))
        remarks.append("brackets enclose the rows")
        rows = [_BRACKET.sub("", row) for row in rows]
    starting = [row for row in rows if _ROW_START.match(row)]
    without_arrow = [_ARROW.sub("", row) for row in rows]
    has_arrow = sum(_ARROW.match(row) is not None for row in starting) > _MOST * len(starting)
    label, labels = _labels(without_arrow, [line for line in lines if not is_comment(line)])
    plain = [label.sub("", row) for row in without_arrow] if labels else without_arrow
    mixed = _mixed_separators([row.rstrip(_ROW_ENDS + " ") for row in plain if _ROW_START.match(row)])
    if has_arrow:
        separator = _TAB if mixed else detect_separator(plain)
        edits.append((_ARROW, rf"\1{separator}"))
        remarks.append("an arrow follows the time stamps")
    if letter := _enclosing_letter(without_arrow):
        edits.append((re.compile(rf"(?m)(?:^|(?<=\t)){letter}(?=[-+.\d])|(?<=\d){letter}[ \t]*$"), ""))
        remarks.append(f"the letter {letter} encloses each row")
    if labels:
        edits.append((label, ""))
        labels = ["", *labels] if has_arrow else labels
        remarks.append("each cell begins with the name of its column")
    for row_end in _ROW_ENDS:
        if sum(row.endswith(row_end) for row in starting) > _MOST * len(starting):
            pattern = re.compile(rf"(?m){re.escape(row_end)} *$")
            if detect_separator([pattern.sub("", row) for row in starting]) != row_end:
                edits.append((pattern, ""))
                remarks.append(f"rows end with {SEPARATORS[row_end]}")
    if mixed:
        edits.append((mixed, _TAB))
        remarks.append("different separators are between the cells")
    return edits, labels, remarks


def _mixed_separators(rows: Sequence[str]) -> re.Pattern[str] | None:
    """Return the pattern of several separators in each row, such as commas and tabs; None for one."""
    separator = detect_separator(rows)
    if sum(all(map(_is_value, split_row(row, separator))) for row in rows) > (1.0 - _MOST) * len(rows):
        return None
    for gap in _GAPS:
        kinds = Counter(
            tuple(_separator_in(between) for between in gap.findall(row))
            for row in rows
            if all(map(_is_value, gap.split(row)))
        )
        usual, count = kinds.most_common(1)[0] if kinds else ((), 0)
        if count >= CONSECUTIVE and count > _MOST * len(rows) and len(set(usual)) > 1:
            between = [mark for mark in SEPARATORS if mark in usual]
            marks = "".join(re.escape(mark) for mark in between if mark != WHITESPACE)
            blanks = "| +" if WHITESPACE in between else ""
            return re.compile(rf" *(?:[{marks}] *)+{blanks}")
    return None


def _separator_in(between: str) -> str:
    """Return the separator among the blanks between two cells."""
    return next((mark for mark in SEPARATORS if mark != WHITESPACE and mark in between), WHITESPACE)


def _is_value(cell: str) -> bool:
    """Return whether a cell is a number, a time stamp or a missing value."""
    return is_number_or_stamp(cell) or is_missing(cell)


def _enclosing_letter(rows: Sequence[str]) -> str:
    """Return the letter that begins and ends most rows; "" if there is none."""
    enclosed = [match for match in map(_ENCLOSED.fullmatch, rows) if match]
    letters = {match["letter"] for match in enclosed}
    enough = len(enclosed) > max(_MOST * len(rows), CONSECUTIVE - 1)
    return letters.pop() if enough and len(letters) == 1 else ""


def _labels(rows: Sequence[str], lines: Sequence[str]) -> tuple[re.Pattern[str], list[str]]:
    """Return the pattern and the names of texts before the numbers of all last rows; none if a row differs.

    A colon or an equals sign follows a name ("speed:1.5"), or, if no line is a header, the separator of the
    cells ("speed,1.5,x,0.2").
    """
    for last in (rows[-CONSECUTIVE:], rows[-CONSECUTIVE - 1 : -1]):  # the last row may be incomplete
        if names := _labels_with_colon(last):
            return _LABEL, names
        for separator in SEPARATORS:
            names = _labels_in_cells(last, separator)
            cells = [split_row(line, separator) for line in lines] if names else []
            if names and all(row[::2] == names for row in cells if len(row) == 2 * len(names)):
                words = "|".join(map(re.escape, sorted(names, key=len, reverse=True)))
                mark = "[ \t]+" if separator == WHITESPACE else rf"[ \t]*{re.escape(separator)}"
                return re.compile(rf"(?m)(?:^|(?<={re.escape(separator)}))[ \t]*(?:{words}){mark}"), names
    return _LABEL, []


def _labels_in_cells(rows: Sequence[str], separator: str) -> list[str]:
    """Return the names in the first, third, ... cell of all rows, before numbers; none if a row differs."""
    cells = [split_row(row, separator) for row in rows]
    names = cells[0][::2] if cells and len(cells[0]) > 2 else []
    alike = all(row[::2] == names and len(row) == 2 * len(names) for row in cells)
    texts = not any(is_number_or_stamp(name) or is_missing(name) for name in names)
    numbers = all(NUMBER.fullmatch(cell) or is_missing(cell) for row in cells for cell in row[1::2])
    return names if alike and texts and numbers else []


def _labels_with_colon(rows: Sequence[str]) -> list[str]:
    """Return the names with a colon that stand before the numbers of all rows; none if a row has others."""
    names = [[match[0].rstrip(":= \t") for match in _LABEL.finditer(row)] for row in rows]
    alike = all(of_row == names[0] for of_row in names)
    found = alike and all(
        _is_number_per_label(row, len(of_row)) for row, of_row in zip(rows, names, strict=True)
    )
    return names[0] if names and found else []


def _is_number_per_label(row: str, count: int) -> bool:
    """Return whether a row has one number for each of its labels."""
    cells = [cell for cell in re.split(r"[;,|\t ]+", _LABEL.sub(" ", row)) if cell]
    return len(cells) == count and all(NUMBER.fullmatch(cell) or is_missing(cell) for cell in cells)
