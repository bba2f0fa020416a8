"""Detect the format of a table in a text file: encoding, separator, decimal mark, header and units."""

from __future__ import annotations

import codecs
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
from .cells import (
    CONSECUTIVE,
    NUMBER,
    SEPARATORS,
    detect_separator,
    is_comment,
    is_data,
    is_missing,
    is_number_or_stamp,
    is_row,
    is_stamp,
    split_row,
)
from .header_lines import NO_HEADER, NOT_A_COLUMN, detect_header
from .row_edits import find_edits

_SAMPLE = MAX_LINE  # bytes that determine the format
# As `CONSECUTIVE`, where a row begins with a text, as lines above the data do in some logs ("Delta_X 0.001
# 0.001").
_CONSECUTIVE_TEXTS = 10


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
        edits: Patterns that are replaced in the text before it is split into cells, with their replacements:
            separators at the end of rows, names before numbers.
        deviations: What distinguishes the file from a recording (UTF-8, commas, points, a header in the first
            line), in words; empty for a plain file.
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
        """Apply `edits` to complete lines below the header: remove what does not belong to a table."""
        for pattern, replacement in self.edits:
            text = pattern.sub(replacement, text)
        return text


def detect_format(path: Path) -> TextFormat:
    """Detect the format of a text file, possibly compressed by gzip, from its beginning.

    Raises:
        InputError: If the file cannot be read, is empty or is not text, its first line is too long, the
            header has a name too few, or commas are both separators and decimal marks.
    """
    encoding, deviations = _detect_encoding(path)
    lines = _first_lines(path, encoding)
    declared = lines[0].strip()[4:] if lines[0].lower().startswith("sep=") else ""
    edits, labels, remarks = find_edits(lines)
    deviations += remarks
    for pattern, replacement in edits:
        lines = [line if is_comment(line) else pattern.sub(replacement, line) for line in lines]
    separator = declared[:1] or detect_separator(lines)
    cells = [[] if is_comment(line) else split_row(line, separator) for line in lines]
    if declared:
        cells[0] = []
    first, width = _first_row(cells)
    rows = [row for row in cells[first:] if any(row)]
    if separator == ",":
        _refuse_decimal_commas(path, cells[:first], width)
    without_last = _are_empty_from(width - 1, rows)  # the rows end with a separator
    widths = (width, width - 1) if without_last else (width,)
    header, units, layout = detect_header(lines, cells, first, widths, separator)
    if NO_HEADER in layout and not without_last and width > 2:
        fewer, _, _ = detect_header(lines, cells, first, (width, width - 1), separator)
        if len(fewer) < width and not labels:
            raise InputError(
                f"{path}: the rows have {width} cells under {len(fewer)} names ({', '.join(fewer)}); "
                "complete the header, or delete this line if it is none"
            )
    if labels:
        header, units = [label or f"#{k}" for k, label in enumerate(labels, start=1)], [""] * len(labels)
        layout = [remark for remark in layout if remark != NO_HEADER]
    while len(header) > 1 and NOT_A_COLUMN.fullmatch(header[-1]) and _are_empty_from(len(header) - 1, rows):
        header.pop()
        units.pop()
    if rows and min(map(len, rows)) > len(header) and _are_empty_from(len(header), rows):
        layout.append("rows end with a separator")
    deviations += layout
    if separator != ",":
        deviations.append(f"columns are separated by {SEPARATORS.get(separator, repr(separator))}")
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
    """Return the complete lines at the beginning of a file; empty files and long first lines are refused."""
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
    names = max((len(row) for row in above if not is_data(row)), default=0)
    if names > 1 and names + 1 < width <= 2 * names:
        raise InputError(
            f"{path}: the rows have {width} cells under {names} names; "
            "if commas are also decimal marks, export it with semicolons between the columns"
        )


def _are_empty_from(index: int, rows: Sequence[Sequence[str]]) -> bool:
    """Return whether no row has a filled cell from a column on."""
    return not any(any(row[index:]) for row in rows)


@contextmanager
def open_text(path: Path, encoding: str) -> Iterator[tuple[TextIO, BinaryIO]]:
    """Open a text file, possibly compressed by gzip; errors while it is read are raised as InputError.

    Bytes that are no text, such as a serial line garbles them, are read as U+FFFD, which no number has.

    Args:
        encoding: Name of the encoding for Python's codecs, see `TextFormat`.

    Yields:
        Two streams: the text, with line feeds as line ends, and the underlying file, whose position shows how
        many bytes have been read.

    Raises:
        InputError: If the file cannot be opened or decompressed.
    """
    try:
        with open(path, "rb") as file:
            compressed = file.read(2) == b"\x1f\x8b"
            file.seek(0)
            stream = cast(BinaryIO, gzip.GzipFile(fileobj=file)) if compressed else file
            with io.TextIOWrapper(stream, encoding, "replace", newline=None) as text:
                yield text, file
    except EOFError:
        raise InputError(
            f"{path}: cannot be read: it ends in the middle of the compressed data. Copy it again, or unpack "
            "what there is by gzip -dc"
        ) from None
    except (OSError, zlib.error) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None


def _detect_encoding(path: Path) -> tuple[str, list[str]]:
    """Return the encoding of a file and what is unusual about it."""
    with open_text(path, "latin-1") as (text, _):
        sample = text.read(_SAMPLE)
    # Latin-1 maps each byte to the character of the same number.
    raw = sample.encode("latin-1")
    for mark, encoding in ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16")):
        if raw.startswith(mark):
            return encoding, ["it is UTF-16 text"]
    # Without a mark: in text of mostly Latin letters, every other byte is zero.
    for start, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        zeros, others = sample[start::2], sample[1 - start :: 2]
        if zeros.count("\0") > len(zeros) / 2 and "\0" not in others:
            return encoding, ["it is UTF-16 text"]
    if "\0" in sample:
        raise InputError(f"{path}: is not a text file")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(raw)
    except UnicodeDecodeError:
        return "cp1252", ["it is not UTF-8 text (probably Windows-1252)"]
    return "utf-8-sig", []


def _first_row(cells: Sequence[Sequence[str]]) -> tuple[int, int]:
    """Return the line of the first row of numbers (or the number of lines), and the cells of a row.

    Above the data there may be lines with a name and a number, which rows of three and more cells differ
    from.
    """
    filled = [i for i, row in enumerate(cells) if any(row)]
    widths = Counter(len(cells[i]) for i in filled if is_data(cells[i]))
    if not widths:
        return len(cells), len(cells[filled[-1]]) if filled else 0
    width = widths.most_common(1)[0][0]
    for k, i in enumerate(filled):
        begins_with_value = is_number_or_stamp(cells[i][0]) or is_missing(cells[i][0])
        following = filled[k : k + (CONSECUTIVE if begins_with_value else _CONSECUTIVE_TEXTS)]
        is_first = len(cells[i]) == width and (width > 2 or begins_with_value)
        if is_first and is_data(cells[i]) and all(is_row(cells[j]) for j in following):
            while k and len(cells[filled[k - 1]]) == width and all(map(is_missing, cells[filled[k - 1]])):
                k -= 1
            return filled[k], width
    return len(cells), width


def _decimal_and_kinds(rows: Sequence[Sequence[str]], width: int) -> tuple[str, list[str]]:
    """Return the decimal mark, "" if none occurs, and the kind of each column, from sample rows."""
    kinds, marks = [], Counter[str]()
    for k in range(width):
        values = [row[k] for row in rows if k < len(row) and not is_missing(row[k])]
        stamps, numbers = sum(map(is_stamp, values)), [v for v in values if NUMBER.fullmatch(v)]
        kinds.append(
            "stamp" if stamps > len(values) / 2 else "number" if 2 * len(numbers) >= len(values) else "text"
        )
        marks.update(mark for value in numbers for mark in ".," if mark in value)
    return (max(marks, key=lambda mark: marks[mark]) if marks else ""), kinds
