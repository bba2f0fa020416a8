"""Mutations of valid files for fuzzing, as Hypothesis strategies."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from typing import Any

from hypothesis import strategies as st

# In every text that would do something if it were executed; no page may contain it unescaped.
MARK = "hostile_mark"
PAYLOAD = f"__import__('pathlib').Path('{MARK}').touch()"
TEXTS = (
    *(
        "",
        " ",
        "nan",
        "inf",
        "-inf",
        "1e308",
        "-1e308",
        "1e-320",
        "1e400",
        "9" * 400,
        "0x10",
        "1_0",
        "12:30:00",
    ),
    *(
        "\u0661\u0662",
        "--",
        "#n/a",
        '"',
        "'",
        ";",
        ",",
        "\t",
        "\r",
        "\x00",
        "\x1b[2J",
        "\u202e",
        "\ud7ff",
        "%s",
        "{0}",
    ),
    *(
        f"<script>{MARK}()</script>",
        f'" onload="{MARK}()',
        f"{{{{ {MARK} }}}}",
        "$\\frac_$",
        "[/bold]",
        "[link=x]",
    ),
    *(
        PAYLOAD,
        f"x\n{PAYLOAD}",
        f'"""\n{PAYLOAD}\n"""',
        "../../etc/passwd",
        "/dev/zero",
        "os:system",
        "class",
        "a" * 5000,
    ),
)
NUMBERS = (
    *(
        0,
        1,
        -1,
        2,
        1e-300,
        -1e-300,
        1e-9,
        1e9,
        1e30,
        1e300,
        -1e300,
        10**30,
        -(10**30),
        2**63,
        10**400,
        0.1,
        -0.1,
        1e-3,
    ),
    *(float("nan"), float("inf"), float("-inf"), True, False),
)
_JSON_KINDS = (
    *("value", "value", "value", "scale", "scale", "scale", "remove", "add", "rename", "exchange", "repeat"),
)
VALUES = (None, [], {}, [[]], {"": {}}, [1.0, "x"], {"value": 1.0, "unit": "kg"}, ["x"] * 3, [[[[[]]]]])


def hostile_value() -> st.SearchStrategy[Any]:
    """Return a strategy for JSON values that a reader may not expect."""
    return st.one_of(
        st.sampled_from(NUMBERS), st.sampled_from(TEXTS), st.sampled_from(VALUES), st.floats(), st.text()
    )


@st.composite
def damaged_bytes(draw: st.DrawFn, content: bytes) -> bytes:
    """Return a strategy for the content of a file with flipped, lost, repeated or replaced bytes."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, max(len(data) - 1, 0)))
        length = draw(st.sampled_from((1, 1, 2, 4, 16, 64)))
        kind = draw(st.sampled_from(("flip", "cut", "lose", "repeat", "zero", "replace", "insert")))
        if kind == "flip" and data:
            data[place] ^= 1 << draw(st.integers(0, 7))
        elif kind == "cut":
            del data[place:]
        elif kind == "lose":
            del data[place : place + length]
        elif kind == "repeat":
            data[place:place] = data[place : place + length]
        elif kind == "zero":
            data[place : place + length] = bytes(len(data[place : place + length]))
        elif kind == "replace":
            data[place : place + length] = draw(st.binary(min_size=length, max_size=length))
        else:
            data[place:place] = draw(st.sampled_from(TEXTS)).encode("utf-8", "surrogatepass")
    return bytes(data)


@st.composite
def damaged_table(draw: st.DrawFn, text: str, separator: str = ",") -> str:
    """Return a strategy for a table with replaced, swapped, lost and repeated cells, rows and columns."""
    rows = [line.split(separator) for line in text.rstrip("\n").split("\n")]
    for _ in range(draw(st.integers(1, 4))):
        i = draw(st.one_of(st.just(0), st.integers(0, len(rows) - 1)))
        k = draw(st.integers(0, len(rows) - 1))
        j = draw(st.integers(0, max(len(rows[i]) - 1, 0)))
        kind = draw(
            st.sampled_from(("cell", "cell", "number", "column", "lose", "repeat", "swap", "cells", "cut"))
        )
        if kind == "cell" and rows[i]:
            rows[i][j] = draw(st.one_of(st.sampled_from(TEXTS), st.text(max_size=4)))
        elif kind == "number" and rows[i]:
            rows[i][j] = repr(draw(st.one_of(st.floats(), st.sampled_from(NUMBERS))))
        elif kind == "column":
            value = draw(st.sampled_from((*TEXTS, "0", "5")))
            for row in rows[1:]:
                row[j : j + 1] = [value]
        elif kind == "lose" and len(rows) > 1:
            del rows[i]
        elif kind == "repeat":
            rows.insert(k, list(rows[i]))
        elif kind == "swap":
            rows[i], rows[k] = rows[k], rows[i]
        elif kind == "cells":
            rows[i] = rows[i][:j] + rows[i][j + 1 :]
        elif kind == "cut":
            del rows[max(k, 1) :]
    return draw(st.sampled_from(("\n", "\n", "\n", "\r\n", "\r"))).join(separator.join(row) for row in rows)


def paths_of(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Yield the path of every value inside a JSON value, without the root."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, member in items:
        yield (*path, key)
        yield from paths_of(member, (*path, key))


def replaced(content: Any, path: tuple[str | int, ...], value: Any) -> Any:
    """Return a copy of a JSON value with the value at a path replaced."""
    result = copy.deepcopy(content)
    value_at(result, path[:-1])[path[-1]] = value
    return result


def value_at(content: Any, path: tuple[str | int, ...]) -> Any:
    """Return the value at a path in a JSON value."""
    for key in path:
        content = content[key]
    return content


@st.composite
def damaged_json(draw: st.DrawFn, content: Any) -> str:
    """Return a strategy for a JSON text with replaced, removed, added and exchanged values."""
    for _ in range(draw(st.sampled_from((1, 1, 1, 2)))):
        paths = list(paths_of(content))
        if not paths:
            break
        values = [value_at(content, path) for path in paths]
        numbers = [path for path, value in zip(paths, values, strict=True) if isinstance(value, int | float)]
        path = draw(st.sampled_from(numbers if numbers and draw(st.booleans()) else paths))
        content = copy.deepcopy(content)
        parent = value_at(content, path[:-1])
        kind = draw(st.sampled_from(_JSON_KINDS))
        value = parent[path[-1]]
        if kind == "scale" and isinstance(value, int | float) and abs(value) < 1e200:
            parent[path[-1]] = value * draw(st.sampled_from((-1, 0, 1e-3, 1e3, 1e9, 1e-9, 1e30, 1e-30)))
        elif kind == "remove":
            del parent[path[-1]]
        elif kind == "add" and isinstance(parent, dict):
            parent[draw(st.sampled_from(TEXTS))] = draw(hostile_value())
        elif kind == "rename" and isinstance(parent, dict):
            parent[draw(st.sampled_from(TEXTS))] = parent.pop(path[-1])
        elif kind == "exchange":
            parent[path[-1]] = copy.deepcopy(draw(st.sampled_from(values)))
        elif kind == "repeat" and isinstance(parent, list):
            parent.append(copy.deepcopy(value))
        else:
            parent[path[-1]] = draw(hostile_value())
    text = json.dumps(content)
    if draw(st.integers(0, 30)) == 0:
        text = draw(
            st.sampled_from(
                (text[: len(text) // 2], "[" * 100_000, '{"a":' * 100_000, "9" * 100_000, f"[{text}]")
            )
        )
    return text
