"""Read columns of numbers and time stamps from text files of any size, a block of rows at a time.

Rows are counted from 1, the first row of numbers. An empty cell is NaN.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...errors import InputError, first_of
from ...files import refuse_expansion, refuse_long_line, refuse_many_values
from .cells import MISSING_WORDS, NUMBER, is_missing, is_number_or_stamp, is_row, split_row
from .text_format import TextFormat, open_text

# Called with the number of bytes of the file that were read since the last call.
Progress = Callable[[int], None]

_BLOCK = 1 << 22  # characters that are converted at a time
# Possessive repetitions (*+, ++) and the look-behind keep the time linear in lines of blanks.
_MISSING_CELL = re.compile(rf"(?<![^,\n])[ \t]*+(?:{MISSING_WORDS})?[ \t]*+(?=[,\n]|\Z)", re.IGNORECASE)
_COMMENT = re.compile(r"(?mi)^[ \t]*(?:#(?!n/?a|num!|value!|ref!|div/)|%|//).*(?:\n|\Z)")
_SEPARATORS_ONLY = re.compile(r"(?m)^[,; \t]*\n")
_CELL_SEPARATOR = "\x1f"
_SHOWN = 40  # characters of a faulty row that a message repeats
# Lines below the data, such as settings of the controller: more than these are a damaged table.
_MOST_LINES_BELOW = 100
# Fraction of the rows of a log that may be damaged: a serial line loses some bytes, and a program prints some
# lines of text among its numbers. A table of another layout, or with a name too few, differs in all rows.
_MOST_DAMAGED = 0.1
_NAMED = 3  # damaged rows that a remark names
# A number of which something is lost or garbled, such as "1.2.5" or "0.1\ufffd3"; letters are a text, which
# may mean something.
_GARBLED = re.compile(r"(?:[-+.,\dEe]|[^\x20-\x7e])+")
# Decimal commas become points. Points, which then separate thousands, become a character that numbers do not
# have.
_FOREIGN_MARK = "'"
_FROM_DECIMAL_COMMA = str.maketrans(",.", "." + _FOREIGN_MARK)
_FROM_DECIMAL_POINT = str.maketrans(",", _FOREIGN_MARK)
_GERMAN_DATE = re.compile(r"^(\d\d)\.(\d\d)\.(\d{4})")
_TIME_ZONE = re.compile(r"(?:Z|[+-]\d\d:?\d\d)$")


def cumulative(progress: Callable[[int, int], None] | None, total: int) -> Progress:
    """Return a function to call with each further amount of work, which reports the sum of all.

    Args:
        progress: Called with the sum and `total`; None to report nothing.
        total: All the work, in the unit of the amounts, such as bytes.
    """
    done = 0

    def add(increment: int) -> None:
        nonlocal done
        done += increment
        if progress is not None:
            progress(done, total)

    return add


def read_columns(
    path: Path,
    layout: TextFormat,
    columns: Sequence[int],
    *,
    lenient: bool = False,
    progress: Progress | None = None,
    max_rows: int | None = None,
    texts: Sequence[int] = (),
) -> tuple[list[NDArray[Any]], list[str]]:
    """Read columns of numbers and time stamps from a text file.

    Args:
        layout: Format of the file, as `detect_format` returns it.
        columns: Indices of the columns, from 0.
        lenient: Whether to leave out comment lines, rows without any value, lines of text below the data and
            some among the rows, and the last row if it is incomplete, and to read a few damaged rows as
            empty, which have another number of cells than others. Otherwise, these are errors, and a row
            without values is read as NaN.
        progress: Called with the number of bytes read since the last call.
        max_rows: Number of rows after which reading stops. Default: all rows are read.
        texts: Those of the indices in `columns` whose cells are read as texts.

    Returns:
        values: One array per column, in the unit of the file, shape (rows,): float64, NaN where a cell is
            empty, or datetime64[ns] for a column of time stamps (NaT where empty; times of day have the date
            1970-01-01), or texts as they are written.
        remarks: Sentences for the user about lines and an incomplete last row that were left out, and about
            damaged rows.

    Raises:
        InputError: If the file cannot be read, rows differ in length, more than a tenth of them if `lenient`,
            or a cell is not a number. The message names file, row and column.
    """
    reader = _BlockReader(path, layout, columns, lenient, texts)
    for block, is_last in _blocks(path, layout, progress):
        reader.add(block, is_last)
        if max_rows is not None and sum(map(len, reader.tables)) >= max_rows:
            break
    reader.refuse_many_damaged_rows()
    table = np.concatenate([np.zeros((0, len(reader.numbers))), *reader.tables])[:max_rows]
    reader.tables.clear()
    values: dict[int, NDArray[Any]] = {
        c: np.ascontiguousarray(table[:, k]) for k, c in enumerate(reader.numbers)
    }
    for k, column in enumerate(reader.stamps):
        stamps = [np.zeros(0, "datetime64[ns]"), *(block[k] for block in reader.stamp_blocks)]
        values[column] = np.concatenate(stamps)[:max_rows]
    for k, column in enumerate(reader.texts):
        values[column] = np.concatenate([np.zeros(0, "U1"), *(block[k] for block in reader.text_blocks)])[
            :max_rows
        ]
    remarks = []
    if reader.comments:
        remarks.append(
            f"{reader.comments} comment line{'s' if reader.comments > 1 else ''} between the rows left out"
        )
    remarks += reader.damage_remarks()
    if reader.incomplete:
        remarks.append("the last row is incomplete and left out")
    if reader.lines_below:
        lines = "1 line" if reader.lines_below == 1 else f"{reader.lines_below} lines"
        remarks.append(f"{lines} below the data left out")
    return [values[c] for c in columns], remarks


def _parse_stamps(cells: Sequence[str]) -> NDArray[np.datetime64]:
    """Convert dates and times of day to datetime64[ns]; a time of day gets the date 1970-01-01."""
    texts = []
    for cell in cells:
        stamp = cell.strip().replace(",", ".").replace(_FOREIGN_MARK, ".")
        if is_missing(stamp):
            texts.append("NaT")
            continue
        stamp = _GERMAN_DATE.sub(r"\3-\2-\1", _TIME_ZONE.sub("", stamp))
        if "-" not in stamp:
            stamp = f"1970-01-01T{'0' if stamp[1:2] == ':' else ''}{stamp}"
        texts.append(stamp)
    return np.array(texts, "datetime64[ns]")


def _blocks(path: Path, layout: TextFormat, progress: Progress | None) -> Iterator[tuple[str, bool]]:
    """Yield blocks of complete lines below the header, and whether a block is the last one."""
    with open_text(path, layout.encoding) as (file, raw):
        rest, to_skip, position, size = "", layout.skipped_lines, 0, 0
        while True:
            text = file.read(_BLOCK)
            size += len(text)
            refuse_expansion(path, size)
            if progress is not None:
                progress(raw.tell() - position)
                position = raw.tell()
            if not text:
                break
            rest += text
            while to_skip and "\n" in rest:
                rest, to_skip = rest.partition("\n")[2], to_skip - 1
            complete, newline, rest = ("", "", rest) if to_skip else rest.rpartition("\n")
            refuse_long_line(path, len(rest))
            if newline:
                yield complete + newline, False
        yield "" if to_skip else rest, True


class _BlockReader:
    """Converts blocks of complete lines to arrays.

    Attributes:
        numbers: Indices of the columns of numbers that are read.
        stamps: Indices of the columns of time stamps that are read.
        texts: Indices of the columns of texts that are read.
        tables: Numbers of each block, shape (rows, number columns).
        stamp_blocks: Time stamps of each block, one array per stamp column.
        text_blocks: Texts of each block, one array per column of texts.
        comments: Number of comment lines left out.
        incomplete: Whether the last row was left out.
        lines_below: Number of lines below the data left out.
        damaged: Number and cells of each row that has too many or too few cells and is read as empty.
        garbled: Number of the row, column and cell of each number that is garbled and read as empty.
        texts_among: Number of the row above and cells of each line of text between the rows that is left out.
    """

    def __init__(
        self, path: Path, layout: TextFormat, columns: Sequence[int], lenient: bool, texts: Sequence[int]
    ) -> None:
        self._path, self._layout, self._lenient = path, layout, lenient
        self._decimal, self._rows, self._had_blanks, self._held = layout.decimal, 0, False, ""
        self.texts = list(texts)
        self.numbers = [c for c in columns if layout.kinds[c] != "stamp" and c not in texts]
        self.stamps = [c for c in columns if layout.kinds[c] == "stamp" and c not in texts]
        self.tables: list[Array] = []
        self.stamp_blocks: list[list[NDArray[np.datetime64]]] = []
        self.text_blocks: list[list[NDArray[np.str_]]] = []
        self.comments, self.incomplete, self.lines_below = 0, False, 0
        self.damaged: list[tuple[int, list[str]]] = []
        self.garbled: list[tuple[int, str, str]] = []
        self.texts_among: list[tuple[int, list[str]]] = []

    def add(self, block: str, is_last: bool) -> None:
        """Convert one block of lines; the first faulty cell is refused."""
        if self._lenient:
            if any(sign in block for sign in ("#", "%", "//")):
                block, count = _COMMENT.subn("", block)
                self.comments += count
            block = self._layout.edited(block)
            if self._layout.separator != " ":
                block = _SEPARATORS_ONLY.sub("", block)
        block = re.sub(r"\n\s*\n", "\n", self._held + block).strip("\n")
        self._held = ""
        block, below = self._split_end(block) if self._lenient else (block, [])
        if (
            not is_last
        ):  # the last row may be incomplete, and lines below it may be faulty rows: the next block decides
            block, _, last = block.rpartition("\n")
            self._held = "".join(f"{line}\n" for line in (last, *below))
        elif self._lenient:
            self.lines_below = len(below)
            body, _, last = block.rpartition("\n")
            if not below and len(split_row(last, self._layout.separator)) < len(self._layout.names):
                self.incomplete, block = True, body
        if not block.strip():
            return
        text = self._with_commas(block)
        if not (self._is_regular(text) and self._convert(text)):
            block = self._without_damage(block) if self._lenient else block
            if not block:
                return
            self._refuse_faulty_cell(block)
            text = self._with_commas(block)
            if not self._convert(text):
                last_row = self._rows + text.count("\n") + 1
                raise InputError(
                    f"{self._path}, rows {self._rows + 1} to {last_row}: cannot be read as numbers"
                )
        self._rows += text.count("\n") + 1
        columns = len(self.numbers) + len(self.stamps) + len(self.texts)
        refuse_many_values(self._path, self._rows, columns)

    def _is_regular(self, text: str) -> bool:
        """Return whether lines, now with commas, have a cell for each name; an empty one may follow."""
        width = len(self._layout.names)
        return all(
            (commas := line.count(",")) == width - 1 or (commas == width and line.endswith(","))
            for line in text.split("\n")
        )

    def _has_width(self, row: Sequence[str]) -> bool:
        """Return whether a row has one cell for each name; an empty one may follow."""
        width = len(self._layout.names)
        return len(row) in (width, width + 1) and not any(row[width:])

    def _without_damage(self, block: str) -> str:
        """Return lines with empty rows in place of damaged ones, which then keep their place in time.

        Lines of text between the rows are left out. A garbled number becomes an empty cell.
        """
        names, separator = self._layout.names, self._layout.separator
        lines: list[str] = []
        for line in block.split("\n"):
            row, number = split_row(line, separator), self._rows + len(lines) + 1
            kept = [cell for cell, kind in zip(row, self._layout.kinds, strict=False) if kind != "text"]
            if kept and not is_row(kept):
                self.texts_among.append((number - 1, row))
                continue
            if self._has_width(row):
                for column in self.numbers:
                    if _GARBLED.fullmatch(row[column]) and not NUMBER.fullmatch(row[column]):
                        self.garbled.append((number, names[column], row[column]))
                        row[column] = "nan"
                        line = separator.join(f'"{c}"' if separator in c else c for c in row)
            else:
                self.damaged.append((number, row))
                line = separator.join(["nan"] * len(names))
            lines.append(line)
        return "\n".join(lines)

    def refuse_many_damaged_rows(self) -> None:
        """Refuse the file if more than a tenth of its rows are damaged, or are lines of text."""
        count = len(self.damaged) + len(self.garbled) + len(self.texts_among)
        if count <= _MOST_DAMAGED * self._rows:
            return
        if self.damaged:
            number, row = self.damaged[0]
            self._refuse_width(number, row, len(self.damaged))
        if self.garbled:
            number, column, cell = self.garbled[0]
            others = f"; {len(self.garbled)} cells are garbled so" if len(self.garbled) > 1 else ""
            raise InputError(f"{self._path}, row {number}, column {column}: {cell!r} is not a number{others}")
        number, row = self.texts_among[0]
        self._refuse_width(number + 1, row, len(self.texts_among))

    def _refuse_width(self, number: int, row: Sequence[str], count: int) -> None:
        """Refuse a row that has another number of cells than the header has names, with how many do."""
        cells = f"{len(row)} cell{'' if len(row) == 1 else 's'}"
        more = f", and {count - 1} more such rows" if count > 1 else ""
        advice = _faulty_row_advice(row)
        if not self._lenient:
            advice += "; or convert the file by hframe import, which leaves out a few such rows"
        elif count > 1:
            advice += "; up to a tenth of the rows may be damaged: delete these rows, or record the log again"
        raise InputError(
            f"{self._path}, row {number}: {cells} under {len(self._layout.names)} columns{more}{advice}"
        )

    def damage_remarks(self) -> list[str]:
        """Return sentences for the user about damaged rows, garbled numbers and lines of text."""
        remarks = []
        width = len(self._layout.names)
        if self.damaged:
            rows = first_of([f"row {number} has {len(row)}" for number, row in self.damaged], _NAMED)
            remarks.append(f"damaged rows are left empty: {rows} instead of {width} cells")
        if self.garbled:
            cells = first_of(
                [f"row {number}, column {name}: {cell!r}" for number, name, cell in self.garbled], _NAMED
            )
            remarks.append(f"garbled numbers are left empty: {cells}")
        if self.texts_among:
            lines = first_of(
                [f"{_words(row)!r} after row {number}" for number, row in self.texts_among], _NAMED
            )
            remarks.append(f"lines of text between the rows are left out: {lines}")
        return remarks

    def _split_end(self, block: str) -> tuple[str, list[str]]:
        """Split lines into those up to the last row, and text below it, such as a controller's settings."""
        lines = block.rsplit("\n", _MOST_LINES_BELOW)
        end = len(lines)
        while end > 1 and not self._may_be_row(lines[end - 1]):
            end -= 1
        return "\n".join(lines[:end]), lines[end:]

    def _may_be_row(self, line: str) -> bool:
        """Return whether a line begins with a value, as incomplete rows do, or has one in each column."""
        cells = split_row(line, self._layout.separator) or [""]
        if is_number_or_stamp(cells[0]) or is_missing(cells[0]):
            return True
        kinds = self._layout.kinds
        values = [cell for cell, kind in zip(cells, kinds, strict=False) if kind == "number"]
        is_complete = len(cells) in (len(kinds), len(kinds) + 1)
        return is_complete and all(is_number_or_stamp(cell) or is_missing(cell) for cell in values)

    def _with_commas(self, block: str) -> str:
        """Return lines with commas between the cells and decimal points."""
        separator = self._layout.separator
        if '"' in block:  # there may be separators within quotation marks
            block = "\n".join(_CELL_SEPARATOR.join(split_row(line, separator)) for line in block.split("\n"))
            separator = _CELL_SEPARATOR
        if separator == ",":
            return block
        if not self._decimal:
            self._decimal = "." if "." in block else "," if "," in block else ""
        if self._decimal == ",":
            block = block.translate(_FROM_DECIMAL_COMMA)
        elif "," in block:
            block = block.translate(_FROM_DECIMAL_POINT)
        if separator == " ":
            return re.sub(r"[ \t]+", ",", re.sub(r"(?m)^[ \t]++|(?<![ \t])[ \t]++$", "", block))
        return block.replace(separator, ",")

    def _convert(self, text: str) -> bool:
        """Append the numbers and time stamps of a block; return False if a cell is of another type."""
        as_written = text
        for fill_blanks in (True,) if self._had_blanks else (False, True):
            if fill_blanks:
                text = _MISSING_CELL.sub("nan", text)
            try:
                table = self._load(text, self.numbers, float) if self.numbers else None
                stamps = [_parse_stamps(self._load(text, [c], str)[:, 0].tolist()) for c in self.stamps]
                texts = [self._load(as_written, [c], str)[:, 0] for c in self.texts]
            except ValueError:
                continue
            self._had_blanks = fill_blanks
            self.stamp_blocks.append(stamps)
            self.text_blocks.append(texts)
            self.tables.append(np.zeros((text.count("\n") + 1, 0)) if table is None else table)
            return True
        return False

    @staticmethod
    def _load(text: str, columns: Sequence[int], kind: type) -> NDArray[Any]:
        """Read columns of lines with commas by NumPy's fast reader."""
        return np.loadtxt(
            io.StringIO(text), dtype=kind, delimiter=",", comments=None, ndmin=2, usecols=columns
        )

    def _refuse_faulty_cell(self, block: str) -> None:
        """Refuse the first row of a wrong length or cell that is no number; return if there is none."""
        names, position = self._layout.names, f"{self._path}, row "
        for number, line in enumerate(block.split("\n"), start=self._rows + 1):
            row = split_row(line, self._layout.separator)
            if not self._has_width(row):
                self._refuse_width(number, row, 1)
            for column in (*self.numbers, *self.stamps):
                cell = row[column]
                if is_missing(cell):
                    continue
                try:
                    if column in self.stamps:
                        _parse_stamps([cell])
                    else:
                        marks = _FROM_DECIMAL_COMMA if self._decimal == "," else _FROM_DECIMAL_POINT
                        float(cell.translate(marks))
                except ValueError:
                    what = "a time stamp" if column in self.stamps else "a number"
                    advice = "; correct the cell, or leave it empty if nothing was measured"
                    if ":" in cell:
                        advice = "; dates and times are read as 2024-05-31T12:00:00.5"
                    if {".", ","} <= set(cell):  # such as 1.500,5
                        advice = "; export it without marks that separate thousands"
                    text = f"column {names[column]}: {cell!r} is not {what}{advice}"
                    raise InputError(f"{position}{number}, {text}") from None


def _faulty_row_advice(cells: Sequence[str]) -> str:
    """Say what to do about a row with another number of cells than its header."""
    words = _words(cells)
    if not words[:1].isalpha():
        return "; is the row cut off?"
    return f", {words!r}; delete the row, or begin it with # if it is a comment"


def _words(cells: Sequence[str]) -> str:
    """Return the beginning of the text in a row for a message."""
    words = " ".join(filter(None, map(str.strip, cells)))
    return words if len(words) <= _SHOWN else f"{words[:_SHOWN]}..."
