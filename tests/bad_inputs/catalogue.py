"""The catalogue of bad inputs: read catalogue.toml and write the files of a case.

A case has a command line, the files that it reads and the message that it must end with. A file is a text, or
a table:

- `like`: valid material of this kind (`materials.WRITERS`); without it, the file that an entry above has
  written,
- `rows`: number of rows of a CSV file with the columns of the run, `period`: its sampling period, s,
  `columns`: values in the first and in the second half of the rows by column (default: zero),
- `replace`: texts and what takes their places, in pairs,
- `set`: new values of fields of a JSON file by dotted path, `remove`: paths of fields that are deleted,
- `cut`: number of bytes that are kept, `append`: text behind the content, `head`: text in front of
  everything,
- `delete`: the file is removed,
- `hex`: content as hexadecimal digits, `repeat`: how often the content is repeated, `gzip`: whether it is
  compressed,
- `parquet`: columns of a Parquet file that differ from the run's, as lists with a type of pyarrow in front,
- `npz`, `mat`: arrays that differ, as expressions of `ARRAYS`, `pickle`: a pickle that executes code.
"""

from __future__ import annotations

import gzip
import json
import pickle
import shlex
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .materials import HEADER, ROWS, answer_curves, run_table, write_material
from .mutations import value_at
from .readers import Payload

FILE = Path(__file__).with_name("catalogue.toml")
ARRAYS: dict[str, Any] = {
    "objects": np.array([None, 1], object),
    "pickle": np.array([Payload()], object),
    "texts": np.array(["a", "b"]),
    "short": np.zeros(7),
    "empty": np.zeros(0),
    "nan": np.full(50, np.nan),
    "wide": np.zeros((50, 3)),
    "complex": np.zeros(ROWS, complex),
    "cube": np.zeros((3, 4, 5)),
    "bomb": np.zeros(20_000_000),
    "text": "a text",
    "absent": None,  # of a .npz file: it is left out
}


@dataclass(frozen=True)
class BadInput:
    """One case of the catalogue.

    Attributes:
        name: What is wrong, in words.
        command: Command line without `hframe`.
        files: Content of each file by name, see the module.
        error: The line on standard error without "hframe: ".
    """

    name: str
    command: str
    files: dict[str, Any]
    error: str

    @property
    def words(self) -> list[str]:
        """Words of the command line."""
        return shlex.split(self.command)

    def write(self, folder: Path) -> None:
        """Write the files into a folder."""
        for name, content in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, str):
                path.write_text(content, encoding="utf-8")
            else:
                _write(path, content)


def load() -> list[BadInput]:
    """Return the cases of catalogue.toml."""
    return [BadInput(**case) for case in tomllib.loads(FILE.read_text("utf-8"))["case"]]


def _write(path: Path, content: dict[str, Any]) -> None:
    """Write or edit one file."""
    if "like" in content:
        write_material(content["like"], path)
    if "rows" in content:
        _write_steps(path, content)
    if "parquet" in content:
        _write_parquet(path, content["parquet"])
    if "npz" in content:
        arrays = answer_curves() | {name: ARRAYS[key] for name, key in content["npz"].items()}
        np.savez_compressed(path, **{name: values for name, values in arrays.items() if values is not None})
    if "mat" in content:
        from scipy import io

        columns: dict[str, Any] = dict(zip(HEADER, run_table().T, strict=True))
        io.savemat(path, columns | {n: ARRAYS[key] for n, key in content["mat"].items()}, do_compression=True)
    if content.get("delete"):
        path.unlink()
    if path.is_dir() or not {
        "replace",
        "set",
        "remove",
        "cut",
        "append",
        "hex",
        "repeat",
        "gzip",
        "pickle",
    } & set(content):
        return
    data = path.read_bytes() if path.exists() else b""
    data = pickle.dumps(Payload()) if "pickle" in content else data
    data = bytes.fromhex(content["hex"]) if "hex" in content else data
    for old, new in content.get("replace", ()):
        assert old.encode() in data, f"{path.name} does not contain {old!r}"
        data = data.replace(old.encode(), new.encode())
    if "set" in content or "remove" in content:
        data = _edited_json(data, content.get("set", {}), content.get("remove", ()))
    data = data[: content.get("cut", len(data))] + content.get("append", "").encode()
    data = content.get("head", "").encode() + data * content.get("repeat", 1)
    path.write_bytes(gzip.compress(data, 9) if content.get("gzip") else data)


def _edited_json(data: bytes, new: dict[str, Any], removed: Any) -> bytes:
    """Return a JSON text with other and fewer fields."""
    value = json.loads(data)
    for text, replacement in new.items():
        path = _path(text)
        value_at(value, path[:-1])[path[-1]] = replacement
    for text in removed:
        path = _path(text)
        del value_at(value, path[:-1])[path[-1]]
    return json.dumps(value).encode()


def _path(text: str) -> tuple[str | int, ...]:
    """Return a dotted path as keys and indices."""
    return tuple(int(key) if key.isdecimal() else key for key in text.split("."))


def _write_steps(path: Path, content: dict[str, Any]) -> None:
    """Write a CSV file whose columns have one value in the first and one in the second half."""
    rows = content["rows"]
    columns = {
        name: np.repeat(content.get("columns", {}).get(name, [0.0, 0.0]), [rows - rows // 2, rows // 2])
        for name in HEADER
    }
    columns["time_s"] = content["period"] * np.arange(rows)
    lines = [",".join(f"{value:.9g}" for value in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join([",".join(HEADER), *lines]) + "\n")


def _write_parquet(path: Path, changed: dict[str, Any]) -> None:
    """Write the run as a Parquet file with other columns: [type, value] or [type, value, rows]."""
    import pyarrow
    from pyarrow import parquet

    columns: dict[str, Any] = dict(zip(HEADER, run_table().T, strict=True))
    rows = next((entry[2] for entry in changed.values() if len(entry) > 2), ROWS)
    if rows != ROWS:
        columns = {}
    for name, (kind, value, *_) in changed.items():
        target = pyarrow.timestamp("ns") if kind == "timestamp" else pyarrow.type_for_alias(kind)
        columns[name] = (
            pyarrow.array([value] * ROWS).cast(target)
            if rows == ROWS
            else pyarrow.array(np.full(rows, value))
        )
    parquet.write_table(pyarrow.table(columns), path)
