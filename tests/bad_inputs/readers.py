"""One strategy per reader of files: a folder with a damaged file, and the command that reads it."""

from __future__ import annotations

import gzip
import io
import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st

from ..log_samples import write_all
from .materials import (
    HEADER,
    answer_curves,
    answer_machine,
    answer_report,
    dialect_texts,
    log_text,
    machine_content,
    mapping_text,
    path_text,
    run_table,
    run_text,
    sysid_content,
    write_material,
)
from .mutations import PAYLOAD, TEXTS, damaged_bytes, damaged_json, damaged_table


@dataclass(frozen=True)
class Case:
    """Files and a command line.

    Attributes:
        files: Content of each file by its name relative to the working folder.
        words: Words of the command line without `hframe`.
    """

    files: dict[str, bytes]
    words: tuple[str, ...]

    def __repr__(self) -> str:
        sizes = ", ".join(f"{name} ({len(content)} bytes)" for name, content in self.files.items())
        return f"{' '.join(self.words)[:500]!r} on {sizes[:500]}"

    def write(self, folder: Path) -> None:
        """Write the files into a folder."""
        for name, content in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)


FOLDERS = ("agent", "answer")  # materials of which a stored case has only the files that differ


def save_case(case: Case, folder: Path) -> None:
    """Store a case: the command line in the file `command`, and the files that differ from valid material.

    Args:
        case: Case to store.
        folder: New folder.
    """
    valid = {name: content for kind in FOLDERS for name, content in contents_of(kind, kind).items()}
    changed = {name: content for name, content in case.files.items() if valid.get(name) != content}
    Case(changed | {"command": " ".join(case.words).encode()}, ()).write(folder)


def load_case(folder: Path) -> Case:
    """Load a case that `save_case` stored.

    Args:
        folder: Its folder.

    Returns:
        The case with all its files.
    """
    files = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    words = tuple(files.pop("command").decode().split())
    for kind in FOLDERS:
        if kind in words:
            files = contents_of(kind, kind) | files
    return Case(files, words)


class Payload:
    """Object whose pickle executes code when it is loaded."""

    def __reduce__(self) -> tuple[Any, ...]:
        return exec, (PAYLOAD,)


@cache
def contents_of(kind: str, name: str) -> dict[str, bytes]:
    """Return the files of a valid material by their names."""
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        write_material(kind, root / name)
        return {str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


def _encoded(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")


@st.composite
def csv_run(draw: st.DrawFn) -> Case:
    """Return a strategy for a damaged CSV recording."""
    valid = run_text()
    damaged = damaged_table(valid).map(_encoded) if draw(st.booleans()) else damaged_bytes(valid.encode())
    simulate = ("simulate", "--inputs", "runs/a.csv", "--out", "out.csv")
    words = draw(st.sampled_from((*([simulate] * 5), ("check", "runs"))))  # a check takes a second
    return Case({"runs/a.csv": draw(damaged)}, words)


@st.composite
def gzip_run(draw: st.DrawFn) -> Case:
    """Return a strategy for a damaged compressed recording."""
    valid = run_text()
    content = gzip.compress(_encoded(draw(damaged_table(valid))), 1)
    if draw(st.booleans()):
        content = draw(damaged_bytes(gzip.compress(valid.encode(), 1)))
    return Case({"a.csv.gz": content}, ("simulate", "--inputs", "a.csv.gz", "--out", "out.csv"))


@st.composite
def parquet_run(draw: st.DrawFn) -> Case:
    """Return a strategy for a Parquet recording with damaged bytes, or columns of other types and values."""
    import pyarrow
    from pyarrow import parquet

    words = draw(
        st.sampled_from(
            (("simulate", "--inputs", "a.parquet", "--out", "out.csv"), ("import", "a.parquet", "--out", "r"))
        )
    )
    if draw(st.booleans()):
        return Case({"a.parquet": draw(damaged_bytes(contents_of("run", "a.parquet")["a.parquet"]))}, words)
    columns: dict[str, Any] = {
        name: pyarrow.array(column) for name, column in zip(HEADER, run_table().T, strict=True)
    }
    for _ in range(draw(st.integers(1, 2))):
        name = draw(st.sampled_from(HEADER))
        values = run_table()[:, HEADER.index(name)]
        types = (
            "int64",
            "uint64",
            "bool",
            "text",
            "number text",
            "null",
            "time",
            "decimal",
            "list",
            "half",
            "binary",
        )
        kind = draw(st.sampled_from((*types, "dictionary", "struct", "duration", "number", "rename")))
        integers = [draw(st.sampled_from((0, 1, 2**53 + 1, 2**62)))] * len(values)
        new: Any = {
            "int64": lambda v=integers: pyarrow.array(v, pyarrow.int64()),
            "uint64": lambda v=integers: pyarrow.array(v, pyarrow.uint64()),
            "bool": lambda v=values: pyarrow.array(v > 0),
            "text": lambda v=values: pyarrow.array([draw(st.sampled_from(TEXTS[:20]))] * len(v)),
            "number text": lambda v=values: pyarrow.array([str(x) for x in v]),
            "null": lambda v=values: pyarrow.nulls(len(v)),
            "time": lambda v=integers: pyarrow.array(
                v, pyarrow.timestamp(draw(st.sampled_from(("s", "ns"))))
            ),
            "decimal": lambda v=values: pyarrow.array([round(x) for x in v]).cast(pyarrow.decimal128(38, 3)),
            "list": lambda v=values: pyarrow.array([[x] for x in v]),
            "half": lambda v=values: pyarrow.array(v.astype(np.float16)),
            "binary": lambda v=values: pyarrow.array([b"\x00"] * len(v)),
            "dictionary": lambda v=values: pyarrow.array([str(x) for x in v]).dictionary_encode(),
            "struct": lambda v=values: pyarrow.array([{"a": x} for x in v]),
            "duration": lambda v=integers: pyarrow.array(v, pyarrow.duration("ns")),
            "number": lambda v=values: pyarrow.array([draw(st.floats())] * len(v)),
            "rename": lambda v=values: pyarrow.array(v),
        }[kind]()
        if kind == "rename":
            columns.pop(name, None)
            name = draw(st.sampled_from(TEXTS))
        columns[name] = new
    buffer = io.BytesIO()
    try:
        parquet.write_table(pyarrow.table(columns), buffer)
    except pyarrow.ArrowException:  # such as times that a file cannot hold
        reject()
    return Case({"a.parquet": buffer.getvalue()}, words)


@st.composite
def text_log(draw: st.DrawFn) -> Case:
    """Return a strategy for a damaged log in text with its mapping."""
    valid = log_text()
    damaged = (
        damaged_table(valid, ";").map(_encoded) if draw(st.booleans()) else damaged_bytes(valid.encode())
    )
    split = ("--split-at-rests",) if draw(st.booleans()) else ()
    files = {"log.txt": draw(damaged), "map.toml": mapping_text().encode()}
    return Case(files, ("import", "log.txt", "--mapping", "map.toml", "--out", "runs", *split))


@st.composite
def dialect_log(draw: st.DrawFn) -> Case:
    """Return a strategy for a damaged log as another program writes it."""
    name = draw(st.sampled_from(sorted(dialect_texts())))
    valid = dialect_texts()[name]
    separator = "\t" if name == "labview" else ","
    damaged = (
        damaged_table(valid, separator).map(_encoded)
        if draw(st.booleans())
        else damaged_bytes(valid.encode())
    )
    return Case({"log.txt": draw(damaged)}, ("import", "log.txt", "--out", "runs"))


@st.composite
def sysid_log(draw: st.DrawFn) -> Case:
    """Return a strategy for a damaged JSON file of SysId."""
    content = sysid_content()
    if draw(st.integers(0, 3)) == 0:
        damaged = draw(damaged_bytes(json.dumps(content).encode()))
    else:
        damaged = _encoded(draw(damaged_json(content)))
    words = ("import", "drive.json", "--machine", "axis", "--map", "v_V=voltage", "--map", "x_m=position")
    return Case({"drive.json": damaged}, (*words, "--out", "runs"))


@st.composite
def mat_log(draw: st.DrawFn) -> Case:
    """Return a strategy for a MATLAB file with damaged bytes, or other variables."""
    from scipy import io as scipy_io

    words = ("import", "log.mat", "--out", "runs")
    if draw(st.booleans()):
        compressed = contents_of("run", "log.mat")["log.mat"]
        return Case({"log.mat": draw(damaged_bytes(compressed))}, words)
    columns: dict[str, Any] = dict(zip(HEADER, run_table().T, strict=True))
    name = draw(st.sampled_from(HEADER))
    with np.errstate(invalid="ignore", over="ignore"):  # 0 times infinity: NaN in a log is one of the cases
        scaled = columns[name] * draw(st.floats())
    others = (
        *(
            columns[name][:-1],
            columns[name].astype(complex),
            np.zeros((3, 4, 5)),
            np.array("text"),
            np.zeros((0, 2)),
        ),
        *(
            {"a": columns[name]},
            np.array([{"a": 1}, "x"], object),
            columns[name].astype(np.int8),
            columns[name] * np.nan,
        ),
        *(scaled, columns[name][::-1], np.full(len(columns[name]), 2**60), True),
    )
    columns[name] = others[draw(st.integers(0, len(others) - 1))]
    buffer = io.BytesIO()
    scipy_io.savemat(buffer, columns)
    content = buffer.getvalue()
    return Case({"log.mat": draw(damaged_bytes(content)) if draw(st.booleans()) else content}, words)


@cache
def _foreign_logs() -> dict[str, tuple[bytes, tuple[str, ...]]]:
    """Return the content of a valid log of each format, and the options that map its columns."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary, "logs")
        maps = write_all(folder)
        return {name: ((folder / name).read_bytes(), options) for name, options in maps.items()}


def import_case(name: str, content: bytes | None = None) -> Case:
    """Return the import of a log in the format of another program, the valid one if no content is given."""
    valid, maps = _foreign_logs()[name]
    options = [word for pair in maps for word in ("--map", pair)]
    scales = ("--scale", "v_V=0.1", "--scale", "x_m=0.001")
    words = ("import", name, "--machine", "axis", *options, *scales, "--out", "runs")
    return Case({name: valid if content is None else content}, words)


def foreign_log(name: str) -> Callable[[], st.SearchStrategy[Case]]:
    """Return a strategy for a damaged log in the format of another program."""

    @st.composite
    def damaged(draw: st.DrawFn) -> Case:
        content = _foreign_logs()[name][0]
        if name.endswith(".json.gz") and draw(st.booleans()):  # the text inside
            changed = gzip.compress(draw(damaged_bytes(gzip.decompress(content))), 1)
        else:
            changed = draw(damaged_bytes(content))
        return import_case(name, changed)

    return damaged


FOREIGN_LOGS = ("log.wpilog", "log.json.gz", "log.mat", "log.bag", "ros2.db3", "ros2.mcap", "log.mcap")


@st.composite
def mapping_file(draw: st.DrawFn) -> Case:
    """Return a strategy for a damaged mapping file."""
    if draw(st.booleans()):
        name, content = "map.json", _encoded(draw(damaged_json(json.loads(mapping_text(".json")))))
    else:
        name, content = "map.toml", draw(damaged_bytes(mapping_text().encode()))
    return Case(
        {"log.txt": log_text().encode(), name: content},
        ("import", "log.txt", "--mapping", name, "--out", "r"),
    )


@st.composite
def machine_file(draw: st.DrawFn) -> Case:
    """Return a strategy for a damaged machine.json."""
    content = machine_content(draw(st.sampled_from(("hframe", "axis"))))
    if draw(st.integers(0, 5)) == 0:
        damaged = draw(damaged_bytes(json.dumps(content).encode()))
    else:
        damaged = _encoded(draw(damaged_json(content)))
    words = draw(
        st.sampled_from(
            (("machines", "show", "m.json"), ("machines", "show", "m.json"), ("kernel", "m.json"))
        )
    )
    return Case({"m.json": damaged}, words)


@st.composite
def machine_values(draw: st.DrawFn) -> Case:
    """Return a strategy for a machine.json with other numbers, which a recording is simulated with."""
    content = machine_content()
    numbers = [value for table in ("coordinates", "belts", "drives", "sensors") for value in content[table]]
    entry = draw(st.sampled_from(numbers))
    quantities = [key for key, value in entry.items() if isinstance(value, dict) and "value" in value]
    key = draw(st.sampled_from(quantities))
    entry[key]["value"] *= draw(
        st.sampled_from((1e-300, 1e-30, 1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9, 1e30, 1e300))
    )
    files = {"m.json": _encoded(json.dumps(content)), "a.csv": run_text().encode()}
    return Case(files, ("simulate", "--machine", "m.json", "--inputs", "a.csv", "--out", "out.csv"))


@st.composite
def path_file(draw: st.DrawFn) -> Case:
    """Return a strategy for a damaged path of the task `track`."""
    valid = path_text()
    damaged = damaged_table(valid).map(_encoded) if draw(st.integers(0, 3)) else damaged_bytes(valid.encode())
    options = ("--task", "track", "--path", "path.csv", "--episodes", "1", "--out", "out")
    return Case({"path.csv": draw(damaged)}, ("evaluate", "textbook-pid", *options))


def _npz(arrays: dict[str, Any]) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


@st.composite
def answer_folder(draw: st.DrawFn) -> Case:
    """Return a strategy for an answer of `hframe identify` with one damaged file."""
    files = dict(contents_of("answer", "answer"))
    name = draw(
        st.sampled_from(("report.json", "report.json", "machine.json", "declared.json", "evidence.npz"))
    )
    if draw(st.integers(0, 5)) == 0:
        files[f"answer/{name}"] = draw(damaged_bytes(files[f"answer/{name}"]))
    elif name == "report.json":
        files[f"answer/{name}"] = _encoded(draw(damaged_json(answer_report())))
    elif name == "evidence.npz":
        files[f"answer/{name}"] = draw(damaged_curves())
    else:
        files[f"answer/{name}"] = _encoded(draw(damaged_json(answer_machine())))
    if draw(st.integers(0, 20)) == 0:
        del files[f"answer/{name}"]
    words = draw(
        st.sampled_from(
            (("report", "answer"), ("effects", "new", "found", "--from", "answer", "--out", "f.py"))
        )
    )
    return Case(files, words)


@st.composite
def damaged_curves(draw: st.DrawFn) -> bytes:
    """Return a strategy for the content of an evidence.npz with another array."""
    curves: dict[str, Any] = dict(answer_curves())
    name = draw(st.sampled_from(sorted(curves)))
    values = curves[name]
    others = (
        *(
            values[:-1],
            values[:0],
            values[:, None],
            values.astype(np.float32),
            values.astype(int),
            values * np.nan,
        ),
        *(
            values * 1e300,
            values * 1e-300,
            np.full_like(values, np.inf),
            values.astype(str),
            values + 1j,
            np.float64(1.0),
        ),
        *(
            np.array([Payload()], object),
            np.zeros(50_000),
            np.zeros(0),
            values[::-1],
            np.zeros((50, 0)),
            values > 0,
        ),
        *(
            values.astype(np.longdouble),
            values.astype(np.float16),
            values.astype(">f8"),
            np.asfortranarray(values),
        ),
    )
    curves[name] = others[draw(st.integers(0, len(others) - 1))]
    if draw(st.integers(0, 4)) == 0:
        curves[draw(st.sampled_from([t for t in TEXTS if "\x00" not in t]))] = curves.pop(name)
    return _npz(curves)


@st.composite
def agent_folder(draw: st.DrawFn) -> Case:
    """Return a strategy for the folder of an agent with one damaged file."""
    import torch

    files = dict(contents_of("agent", "agent"))
    name = draw(st.sampled_from(("agent.json", "agent.json", "machine.json", "policy.safetensors")))
    content = files[f"agent/{name}"]
    if name == "policy.safetensors" or draw(st.integers(0, 5)) == 0:
        files[f"agent/{name}"] = draw(damaged_bytes(content))
        if draw(st.integers(0, 10)) == 0:
            buffer = io.BytesIO()
            torch.save(Payload(), buffer)
            files[f"agent/{name}"] = buffer.getvalue()
    else:
        files[f"agent/{name}"] = _encoded(draw(damaged_json(json.loads(content))))
    return Case(files, ("evaluate", "agent", "--episodes", "1", "--out", "out"))


@st.composite
def checkpoint(draw: st.DrawFn) -> Case:
    """Return a strategy for a checkpoint that this installation did not write."""
    import pickle

    files = {f"agent/{Path(name).name}": content for name, content in contents_of("agent", "agent").items()}
    card = json.loads(files["agent/card.json"])
    card["kept"] = card["curve"][-1]["steps"]
    files["agent/card.json"] = (
        _encoded(draw(damaged_json(card))) if draw(st.booleans()) else json.dumps(card).encode()
    )
    files["agent/checkpoint.zip"] = draw(st.one_of(st.just(pickle.dumps(Payload())), st.binary(max_size=200)))
    files["agent/replay.pkl"] = pickle.dumps(Payload())
    return Case(files, ("train", "ppo", "--steps", "1", "--resume", "--out", "agent"))


READERS: dict[str, Callable[[], st.SearchStrategy[Case]]] = {
    "recording.csv": csv_run,
    "recording.csv.gz": gzip_run,
    "recording.parquet": parquet_run,
    "log.txt": text_log,
    "log of a dialect": dialect_log,
    "log.json": sysid_log,
    "log.mat": mat_log,
    **{f"foreign {name}": foreign_log(name) for name in FOREIGN_LOGS},
    "mapping": mapping_file,
    "machine.json": machine_file,
    "machine values": machine_values,
    "path": path_file,
    "answer folder": answer_folder,
    "agent folder": agent_folder,
    "checkpoint": checkpoint,
}
# Relative number of examples; drawing a page or building a network takes longer than reading a table.
WEIGHTS = {
    "machine.json": 2.0,
    "mapping": 1.5,
    "log.txt": 1.5,
    "log.mat": 1.5,
    "recording.parquet": 1.5,
    "answer folder": 0.6,
    "agent folder": 0.4,
    "path": 0.4,
    "checkpoint": 0.3,
}
