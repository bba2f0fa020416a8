"""Detect the format of a table in a text file: encoding, separator, decimal mark, header and units."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, TextIO, cast

from ...errors import InputError
from ...files import MAX_LINE, refuse_long_line
from ..quantities import is_unit

_SAMPLE = MAX_LINE  # bytes that determine the format
_WHITESPACE = " "  # as a separator: one or more blanks
# In the order of preference; a table with semicolons or tabs may have decimal commas.
_SEPARATORS = {"\t": "tabs", ";": "semicolons", "|": "vertical bars", ",": "commas", _WHITESPACE: "blanks"}
_CONSECUTIVE = 3  # rows of numbers that mark the beginning of the data
# The same where a row begins with a text, as lines above the data do in some logs ("Delta_X 0.001 0.001").
_CONSECUTIVE_TEXTS = 10
MISSING_WORDS = r"#?n/?a|null|none|nil|missing|#(?:num|value|ref)!|#div/0!|--+"
_COMMENT_SIGNS = ("#", "%", "//")
_COMMENT_SIGN = re.compile(r"\s*(?:#+|%+|//+)\s*")
_ROW_ENDS = ";,|\t"  # separators that may end each row although other separators are between its cells
_MOST = 0.5  # fraction of the rows of numbers that have such an end; their last one may be incomplete
# Beginning of a row of numbers.
_ROW_START = re.compile(rf"[ \t]*\"?(?:[+-]?[.,]?\d|(?:nan|{MISSING_WORDS})\b)", re.IGNORECASE)
_COMMENTS_WITH_NAMES = 3  # last comments above the data in which the names of the columns are looked for
# Name before a number, as for Arduino's serial plotter: "speed:1.5". The "e" of "1e-3" begins none.
_LABEL = re.compile(r"(?<![\w.])(?!(?:nan|inf)\b)[^\W\d][^:;,|\t\n]{0,40}:[ \t]*")
# Between time stamp and text in Arduino's serial monitor.
_ARROW = re.compile(r"(?m)^(\d\d:\d\d:\d\d\.\d+) -> ")
# Brackets around a matrix, as ECP's programs write it.
_BRACKET = re.compile(r"(?m)^[ \t]*\[(?=[ \t]*[-+.\d])|(?<=\d)[ \t]*\](?=[ \t]*[;,]?[ \t]*$)")
# Between the names of columns whose values blanks separate, where the names have blanks themselves.
_GAP_OF_NAMES = re.compile(r" *\t[ \t]*| {2,}[ \t]*")
# Row between two equal letters, as SimpleFOC's monitor writes it.
_ENCLOSED = re.compile(r"(?P<letter>[A-Za-z])[-+.\d][-+.\d\t]*\d(?P=letter)[ \t]*")
# Last cells of a header that are no columns: LabVIEW's comments, start and increment of the time of an oscilloscope.
_NOT_A_COLUMN = re.compile(r"comment|start|increment|(?:t0|tinc)\s*=.*", re.IGNORECASE)

_NO_HEADER = "it has no header"
_MISSING = re.compile(rf"(?:{MISSING_WORDS}|[+-]?nan|)", re.IGNORECASE)
# Also a number whose thousands are separated, which is refused later with advice; "1.0,0.5,0.2" is a row of numbers.
_NUMBER = re.compile(
    r"[+-]?(?:\d+(?:[.,]\d*)?|\d{1,3}(?:\.\d{3})+(?:,\d*)?|\d{1,3}(?:,\d{3})+(?:\.\d*)?|[.,]\d+)(?:e[+-]?\d+)?"
    r"|[+-]?inf(?:inity)?",
    re.IGNORECASE,
)
_DATE = r"(?:\d{4}-\d\d-\d\d|\d\d\.\d\d\.\d{4})"
_TIME_STAMP = re.compile(rf"(?:{_DATE}[T ]+)?\d{{1,2}}:\d\d:\d\d(?:[.,]\d+)?(?:Z|[+-]\d\d:?\d\d)?|{_DATE}")


@dataclass(frozen=True)
class TextFormat:
    """Format of a table in a text file.

    Attributes:
        encoding: Name of the encoding for Python's codecs.
        separator: Character between the cells of a row; a blank means one or more blanks.
        decimal: Decimal mark, "." or ","; "" if the first rows have none.
        skipped_lines: Number of lines above the first row of numbers.
        names: Names of the columns as written; "#1", "#2", ... if the file has no header.
        units: Units in the row below the header, "" where there is none, in the order of the names.
        kinds: What each column contains: "number", "stamp" (time, with or without a date) or "text".
        edits: Patterns that are replaced in the text before it is split into cells, with their replacements: separators
            at the end of rows, names before numbers.
        deviations: What distinguishes the file from a recording (UTF-8, commas, points, a header in the first line), in
            words; empty for a plain file.
    """

    encoding: str
    separator: str
    decimal: str
    skipped_lines: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    kinds: tuple[str, ...]
    deviations: tuple[str, ...]
    edits: tuple[tuple[re.Pattern[str], str], ...] = ()

    def edited(self, text: str) -> str:
        """Remove from complete lines below the header the parts that do not belong to a table, see `edits`."""
        for pattern, replacement in self.edits:
            text = pattern.sub(replacement, text)
        return text


def detect_format(path: Path) -> TextFormat:
    """Detect the format of a text file, possibly compressed by gzip, from its beginning.

    Raises:
        InputError: If the file cannot be read, is empty or is not text, its first line is too long, or commas are both
            separators and decimal marks.
    """
    encoding, deviations = _detect_encoding(path)
    lines = _first_lines(path, encoding)
    declared = lines[0].strip()[4:] if lines[0].lower().startswith("sep=") else ""
    edits, labels, remarks = _edits(lines)
    deviations += remarks
    for pattern, replacement in edits:
        lines = [line if _is_comment(line) else pattern.sub(replacement, line) for line in lines]
    separator = declared[:1] or _detect_separator(lines)
    cells = [[] if _is_comment(line) else split_row(line, separator) for line in lines]
    if declared:
        cells[0] = []
    first, width = _first_row(cells)
    rows = [row for row in cells[first:] if any(row)]
    if separator == ",":
        _refuse_decimal_commas(path, cells[:first], width)
    without_last = _are_empty_from(width - 1, rows)  # the rows end with a separator
    widths = (width, width - 1) if without_last else (width,)
    header, units, layout = _detect_header(lines, cells, first, widths, separator)
    if _NO_HEADER in layout and not without_last and width > 2:
        # A name may be missing, which the reader refuses with the numbers of names and cells.
        other = _detect_header(lines, cells, first, (width, width - 1), separator)
        header, units, layout = other if len(other[0]) < width else (header, units, layout)
    if labels:
        header, units = [label or f"#{k}" for k, label in enumerate(labels, start=1)], [""] * len(labels)
        layout = [remark for remark in layout if remark != _NO_HEADER]
    while len(header) > 1 and _NOT_A_COLUMN.fullmatch(header[-1]) and _are_empty_from(len(header) - 1, rows):
        header.pop()
        units.pop()
    if rows and min(map(len, rows)) > len(header) and _are_empty_from(len(header), rows):
        layout.append("rows end with a separator")
    deviations += layout
    if separator != ",":
        deviations.append(f"columns are separated by {_SEPARATORS.get(separator, repr(separator))}")
    decimal, kinds = _decimal_and_kinds(rows, len(header))
    if decimal == ",":
        deviations.append("numbers have decimal commas")
    return TextFormat(
        encoding,
        separator,
        decimal,
        first,
        tuple(header),
        tuple(units),
        tuple(kinds),
        tuple(deviations),
        tuple(edits),
    )


def _first_lines(path: Path, encoding: str) -> list[str]:
    """Return the complete lines at the beginning of a file; an empty file and a long first line are refused."""
    with open_text(path, encoding) as (file, _):
        sample = file.read(_SAMPLE)
    if not sample.strip():
        raise InputError(f"{path}: empty")
    lines = sample.split("\n")
    if len(lines) == 1:
        refuse_long_line(path, len(sample))
    return lines[:-1] if len(sample) == _SAMPLE else lines  # the last one may be incomplete


def _refuse_decimal_commas(path: Path, above: Sequence[Sequence[str]], width: int) -> None:
    """Refuse rows of so many more cells than names that commas must be both separators and decimal marks."""
    names = max(map(len, above), default=0)
    if names > 1 and names + 1 < width <= 2 * names:
        raise InputError(
            f"{path}: the rows have {width} cells under {names} names; if commas are also decimal marks, export it "
            "with semicolons between the columns"
        )


def _are_empty_from(index: int, rows: Sequence[Sequence[str]]) -> bool:
    """Return whether no row has a filled cell from a column on."""
    return not any(any(row[index:]) for row in rows)


@contextmanager
def open_text(path: Path, encoding: str) -> Iterator[tuple[TextIO, BinaryIO]]:
    """Open a text file, possibly compressed by gzip; errors while it is read are raised as InputError.

    Yields:
        Two streams: the text, with line feeds as line ends, and the underlying file, whose position shows how many
        bytes have been read.

    Raises:
        InputError: If the file cannot be opened, decompressed or decoded.
    """
    try:
        with open(path, "rb") as file:
            compressed = file.read(2) == b"\x1f\x8b" or path.suffix == ".gz"
            file.seek(0)
            stream = cast(BinaryIO, gzip.GzipFile(fileobj=file)) if compressed else file
            with io.TextIOWrapper(stream, encoding, newline=None) as text:
                yield text, file
    except UnicodeDecodeError as error:
        name = encoding.removesuffix("-sig").upper()
        raise InputError(f"{path}: cannot be read: not {name} text ({error.reason})") from None
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None


def split_row(line: str, separator: str) -> list[str]:
    """Split a line into cells, without the blanks and quotation marks around them; a blank separates as several do.

    A separator between quotation marks does not split a cell. If the separator is a blank, however, quotation marks
    have no effect and are kept.
    """
    if separator == _WHITESPACE:
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
    """Return whether a cell has no value: whether it is empty or a word such as NA, NaN, null or #N/A."""
    return _MISSING.fullmatch(cell) is not None


def is_stamp(cell: str) -> bool:
    """Return whether a cell is a time stamp: a time of day, a date (2024-05-31 or 31.05.2024), or both."""
    return _TIME_STAMP.fullmatch(cell) is not None


def _detect_encoding(path: Path) -> tuple[str, list[str]]:
    """Return the encoding of a file and what is unusual about it."""
    with open_text(path, "latin-1") as (text, _):
        sample = text.read(_SAMPLE)
    # Latin-1 maps each byte to the character of the same number.
    raw = sample.encode("latin-1")
    for mark, encoding in ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16")):
        if raw.startswith(mark):
            return encoding, ["it is UTF-16 text"]
    if "\0" in sample[1::2] and "\0" not in sample[::2]:
        return "utf-16-le", ["it is UTF-16 text"]
    if "\0" in sample:
        raise InputError(f"{path}: is not a text file")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(raw)
    except UnicodeDecodeError:
        return "cp1252", ["it is not UTF-8 text (probably Windows-1252)"]
    return "utf-8-sig", []


def _is_comment(line: str) -> bool:
    """Return whether a line is a comment, which a missing value such as #N/A is not."""
    return line.lstrip().startswith(_COMMENT_SIGNS) and not is_missing(re.split(r"[,;\t ]", line.lstrip())[0])


def _edits(lines: Sequence[str]) -> tuple[list[tuple[re.Pattern[str], str]], list[str], list[str]]:
    """Find the parts of lines that do not belong to a table.

    Return patterns with their replacements, names of columns that stand before the numbers, and deviations from a
    recording.
    """
    rows = [line.rstrip(" ") for line in lines if not _is_comment(line) and any(map(str.isdigit, line))]
    edits: list[tuple[re.Pattern[str], str]] = []
    remarks = []
    if any(map(_BRACKET.match, rows)):
        edits.append((_BRACKET, ""))
        remarks.append("brackets enclose the rows")
        rows = [_BRACKET.sub("", row) for row in rows]
    starting = [row for row in rows if _ROW_START.match(row)]
    without_arrow = [_ARROW.sub("", row) for row in rows]
    has_arrow = sum(_ARROW.match(row) is not None for row in starting) > _MOST * len(starting)
    if has_arrow:
        edits.append((_ARROW, rf"\1{_detect_separator(without_arrow)}"))
        remarks.append("an arrow follows the time stamps")
    if letter := _enclosing_letter(without_arrow):
        edits.append((re.compile(rf"(?m)(?:^|(?<=\t)){letter}(?=[-+.\d])|(?<=\d){letter}[ \t]*$"), ""))
        remarks.append(f"the letter {letter} encloses each row")
    label, labels = _labels(without_arrow, [line for line in lines if not _is_comment(line)])
    if labels:
        edits.append((label, ""))
        labels = ["", *labels] if has_arrow else labels
        remarks.append("each cell begins with the name of its column")
    for row_end in _ROW_ENDS:
        if sum(row.endswith(row_end) for row in starting) > _MOST * len(starting):
            pattern = re.compile(rf"(?m){re.escape(row_end)} *$")
            if _detect_separator([pattern.sub("", row) for row in starting]) != row_end:
                edits.append((pattern, ""))
                remarks.append(f"rows end with {_SEPARATORS[row_end]}")
    return edits, labels, remarks


def _enclosing_letter(rows: Sequence[str]) -> str:
    """Return the letter that begins and ends most rows; "" if there is none."""
    enclosed = [match for match in map(_ENCLOSED.fullmatch, rows) if match]
    letters = {match["letter"] for match in enclosed}
    enough = len(enclosed) > max(_MOST * len(rows), _CONSECUTIVE - 1)
    return letters.pop() if enough and len(letters) == 1 else ""


def _labels(rows: Sequence[str], lines: Sequence[str]) -> tuple[re.Pattern[str], list[str]]:
    """Return the pattern and the names of texts before the numbers of all last rows; no names if a row differs.

    A colon follows a name ("speed:1.5"), or, if no line is a header, the separator of the cells ("speed,1.5,x,0.2").
    """
    for last in (rows[-_CONSECUTIVE:], rows[-_CONSECUTIVE - 1 : -1]):  # the last row may be incomplete
        if names := _labels_with_colon(last):
            return _LABEL, names
        for separator in _SEPARATORS:
            names = _labels_in_cells(last, separator)
            cells = [split_row(line, separator) for line in lines] if names else []
            if names and all(row[::2] == names for row in cells if len(row) == 2 * len(names)):
                words = "|".join(map(re.escape, sorted(names, key=len, reverse=True)))
                mark = "[ \t]+" if separator == _WHITESPACE else rf"[ \t]*{re.escape(separator)}"
                return re.compile(rf"(?m)(?:^|(?<={re.escape(separator)}))[ \t]*(?:{words}){mark}"), names
    return _LABEL, []


def _labels_in_cells(rows: Sequence[str], separator: str) -> list[str]:
    """Return the names in the first, third, ... cell of all rows, before numbers; none if a row differs."""
    cells = [split_row(row, separator) for row in rows]
    names = cells[0][::2] if cells and len(cells[0]) > 2 else []
    alike = all(row[::2] == names and len(row) == 2 * len(names) for row in cells)
    texts = not any(is_number_or_stamp(name) or is_missing(name) for name in names)
    numbers = all(_NUMBER.fullmatch(cell) or is_missing(cell) for row in cells for cell in row[1::2])
    return names if alike and texts and numbers else []


def _labels_with_colon(rows: Sequence[str]) -> list[str]:
    """Return the names with a colon that stand before the numbers of all rows; none if a row has others."""
    names = [[match[0].rstrip(": \t").strip() for match in _LABEL.finditer(row)] for row in rows]
    alike = all(of_row == names[0] for of_row in names)
    found = alike and all(
        _is_number_per_label(row, len(of_row)) for row, of_row in zip(rows, names, strict=True)
    )
    return names[0] if names and found else []


def _is_number_per_label(row: str, count: int) -> bool:
    """Return whether a row has one number for each of its labels."""
    cells = [cell for cell in re.split(r"[;,|\t ]+", _LABEL.sub(" ", row)) if cell]
    return len(cells) == count and all(_NUMBER.fullmatch(cell) or is_missing(cell) for cell in cells)


def _detect_separator(lines: Sequence[str]) -> str:
    """Return the separator under which most lines are rows of numbers, else that of the last line."""
    scores = {}
    written = [line for line in lines if line.strip() and not _is_comment(line)]
    for separator in _SEPARATORS:
        # Whitespace of any kind separates cells where blanks do.
        divisible = written if separator == _WHITESPACE else [line for line in written if separator in line]
        rows = [split_row(line, separator) for line in divisible]
        # Texts have blanks as well, so more than half of the cells between blanks must be numbers.
        least = 0.6 if separator == _WHITESPACE else 0.5
        widths = Counter(len(row) for row in rows if len(row) > 1 and _is_data(row, least))
        scores[separator] = max(widths.values(), default=0)
    best = max(scores, key=lambda separator: scores[separator])
    if scores[best]:
        return best
    last = next((line for line in reversed(lines) if line.strip()), "")
    return max((s for s in _SEPARATORS if s != _WHITESPACE), key=lambda s: (last.count(s), s == ","))


def _is_data(row: Sequence[str], least: float = 0.5) -> bool:
    """Return whether at least a fraction of the cells of a row that have a value are numbers or time stamps."""
    numbers = texts = 0
    for cell in row:
        if is_number_or_stamp(cell):
            numbers += 1
        elif not is_missing(cell):
            texts += 1
    return numbers > 0 and numbers >= least * (numbers + texts)


def _is_row(row: Sequence[str]) -> bool:
    """Return whether a row belongs to the data: whether it has numbers, or states that it has no values."""
    return _is_data(row) or (any(row) and all(map(is_missing, row)))


def is_number_or_stamp(cell: str) -> bool:
    """Return whether a cell is a number or a time stamp."""
    return _NUMBER.fullmatch(cell) is not None or is_stamp(cell)


def _first_row(cells: Sequence[Sequence[str]]) -> tuple[int, int]:
    """Return the line of the first row of numbers (the number of lines if there is none), and the cells of a row.

    Above the data there may be lines with a name and a number, which rows of three and more cells differ from.
    """
    filled = [i for i, row in enumerate(cells) if any(row)]
    widths = Counter(len(cells[i]) for i in filled if _is_data(cells[i]))
    if not widths:
        return len(cells), len(cells[filled[-1]]) if filled else 0
    width = widths.most_common(1)[0][0]
    for k, i in enumerate(filled):
        begins_with_value = is_number_or_stamp(cells[i][0]) or is_missing(cells[i][0])
        following = filled[k : k + (_CONSECUTIVE if begins_with_value else _CONSECUTIVE_TEXTS)]
        is_first = len(cells[i]) == width and (width > 2 or begins_with_value)
        if is_first and _is_data(cells[i]) and all(_is_row(cells[j]) for j in following):
            while k and len(cells[filled[k - 1]]) == width and all(map(is_missing, cells[filled[k - 1]])):
                k -= 1
            return filled[k], width
    return len(cells), width


@dataclass(frozen=True)
class _LineAbove:
    """Line above the data that may have the names or units of the columns: its number, and its cells if they fit."""

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


def _detect_header(
    lines: Sequence[str], cells: Sequence[Sequence[str]], first: int, widths: Sequence[int], separator: str
) -> tuple[list[str], list[str], list[str]]:
    """Find names ("#1", ... without a header) and units of the columns above the first row of numbers, and deviations.

    They are in the last line above the data and in the line before it, in either order; if the last line that is no
    comment does not fit, they are in comments. `widths` are the numbers of cells of the rows, and of names that fit.
    """
    deviations = ["its first line is sep="] if lines[0].lower().startswith("sep=") else []
    above = []
    for i in range(first):
        if _is_comment(lines[i]):
            above.append(_LineAbove(i, _cells_of_comment(lines[i], widths, separator), True))
        elif any(cells[i]):
            fitting = _fitting(cells[i], widths)
            if not fitting and separator == _WHITESPACE:
                fitting = _fitting(_GAP_OF_NAMES.split(lines[i].strip()), widths)
            above.append(_LineAbove(i, fitting, False))
    names, units = _names_and_units(above)
    used = [line.number for line in (names, units) if line is not None]
    if names is None:
        deviations.append(_NO_HEADER)
    elif names.is_comment:
        deviations.append("the header is in a comment line")
    if units is not None:
        place = (
            "below the header" if names is not None and units.number > names.number else "above the header"
        )
        in_comment = " in a comment line" if units.is_comment else ""
        deviations.append(f"a row of units is {place if names is not None else 'above the data'}{in_comment}")
    for is_comment, what in ((True, "comment"), (False, "other")):
        skipped = sum(line.is_comment == is_comment and line.number not in used for line in above)
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
        _NOT_A_COLUMN.fullmatch(trimmed[-1]) or _NUMBER.fullmatch(trimmed[-1])
    ):
        trimmed.pop()
    return trimmed if len(trimmed) in widths else []


def _cells_of_comment(line: str, widths: Sequence[int], separator: str) -> list[str]:
    """Return the cells of a comment, which may have another separator than the data, if their number fits."""
    text = _COMMENT_SIGN.sub("", line, count=1)
    splits = (_fitting(split_row(text, candidate), widths) for candidate in (separator, *_SEPARATORS))
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
    """Return the last line that may have names; lines of numbers below it, such as sampling periods, have none."""
    for line in reversed(above):
        if not line.cells or not all(map(is_number_or_stamp, filter(None, line.cells))):
            return line if line.cells else None
    return None


def _decimal_and_kinds(rows: Sequence[Sequence[str]], width: int) -> tuple[str, list[str]]:
    """Return the decimal mark, "" if none occurs, and the kind of each column, from sample rows."""
    kinds, marks = [], Counter[str]()
    for k in range(width):
        values = [row[k] for row in rows if k < len(row) and not is_missing(row[k])]
        stamps, numbers = sum(map(is_stamp, values)), [v for v in values if _NUMBER.fullmatch(v)]
        kinds.append(
            "stamp" if stamps > len(values) / 2 else "number" if 2 * len(numbers) >= len(values) else "text"
        )
        marks.update(mark for value in numbers for mark in ".," if mark in value)
    return (max(marks, key=lambda mark: marks[mark]) if marks else ""), kinds
