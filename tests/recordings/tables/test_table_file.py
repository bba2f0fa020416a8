"""Tables: CSV, gzip and Parquet files, and paths for the task `track`."""

from __future__ import annotations

import datetime
import gzip
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import Machine
from hframe_gym.recordings import load_recording, read_path
from hframe_gym.recordings.tables import text_reader
from hframe_gym.recordings.tables.table_file import read_table
from hframe_gym.recordings.tables.text_format import detect_format

WriteRun = Callable[..., Path]


def test_a_run_reads_the_same_from_csv_gzip_and_parquet(
    write_run: WriteRun, hframe: Machine, tmp_path: Path
) -> None:
    path = write_run(cells={(3, "x_m"): ""})
    plain = load_recording(path, hframe)
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(path.read_bytes()))
    names = path.read_text().splitlines()[0].split(",")
    columns = [plain.time_s, *plain.inputs.T, *plain.outputs.T]
    table = pyarrow.table(
        {n: pyarrow.array(c, from_pandas=True) for n, c in zip(names, columns, strict=True)}
    )
    pyarrow.parquet.write_table(table, tmp_path / "run.parquet")
    for other in ("run.csv.gz", "run.parquet"):
        run = load_recording(tmp_path / other, hframe)
        assert run.name == "run"
        np.testing.assert_array_equal(run.time_s, plain.time_s)
        np.testing.assert_array_equal(run.outputs, plain.outputs)


def test_a_short_row_and_a_broken_gzip_are_refused(
    write_run: WriteRun, tmp_path: Path, hframe: Machine
) -> None:
    path = write_run()
    path.write_text(path.read_text() + "5.1,1,1\n")
    with pytest.raises(InputError, match="row 21: 3 cells under 7 columns"):
        load_recording(path, hframe)
    path.write_text(path.read_text().replace("5.1,1,1", "Fault 17 of the drive"))
    with pytest.raises(
        InputError, match=r"row 21: 1 cell under 7 columns, 'Fault 17 of the drive'; delete the"
    ):
        load_recording(path, hframe)
    complete = gzip.compress(b"time_s,v1_V\n" + b"0.001,1\n" * 1000)
    damaged = complete[:20] + b"\xff\xff\xff" + complete[23:]
    for content in (complete[: len(complete) // 2], damaged):
        (tmp_path / "broken.csv.gz").write_bytes(content)
        with pytest.raises(InputError, match=r"broken\.csv\.gz: cannot be read"):
            load_recording(tmp_path / "broken.csv.gz", hframe)
    (tmp_path / "latin.csv").write_bytes("time_s,größe\n".encode("latin-1"))
    with pytest.raises(InputError, match=r"latin\.csv: cannot be read"):
        load_recording(tmp_path / "latin.csv", hframe)


def test_byte_order_mark_windows_line_ends_and_blank_lines_are_read(
    write_run: WriteRun, hframe: Machine
) -> None:
    path = write_run()
    plain = load_recording(path, hframe)
    text = path.read_text()
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode() + b"\r\n\r\n")
    np.testing.assert_array_equal(load_recording(path, hframe).outputs, plain.outputs)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (["0", "oops"], "column x_m: has values of the type string instead of numbers"),
        (["0", "1"], "column x_m: has values of the type string instead of numbers"),
        ([datetime.datetime(2020, 1, 1)] * 2, "column x_m: has dates or times (timestamp"),
        ([2**53 + 1, 0], "column x_m: int64 cannot be converted to numbers"),
    ],
)
def test_an_error_names_the_column_of_a_parquet_file_that_is_not_numbers(
    values: list[object], message: str, tmp_path: Path, hframe: Machine
) -> None:
    columns: dict[str, list[object]] = {"time_s": [0.0, 1.0], "v1_V": [0, 1], "v2_V": [0, 1]}
    columns |= {"phi1_rad": [0.0, None], "phi2_rad": [0.0, 0.0], "x_m": values, "y_m": [0.0, 0.0]}
    pyarrow.parquet.write_table(pyarrow.table(columns), tmp_path / "run.parquet")
    with pytest.raises(InputError) as error:
        load_recording(tmp_path / "run.parquet", hframe)
    assert message in str(error.value)
    columns["x_m"] = [0.0, 0.1]
    pyarrow.parquet.write_table(pyarrow.table(columns), tmp_path / "run.parquet")
    run = load_recording(tmp_path / "run.parquet", hframe)
    np.testing.assert_array_equal(run.inputs, [[0, 0], [1, 1]])
    np.testing.assert_array_equal(run.outputs[:, 0], [0.0, np.nan])


def test_without_pyarrow_the_error_names_the_extra_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, hframe: Machine
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    (tmp_path / "run.parquet").write_bytes(b"")
    with pytest.raises(InputError, match=r"hframe_gym\[parquet\]"):
        load_recording(tmp_path / "run.parquet", hframe)


def test_a_path_has_points_and_optional_times_from_zero(tmp_path: Path) -> None:
    path = tmp_path / "path.csv"
    path.write_text("x_m,y_m\n0,0\n0.1,0.05\n")
    points, time_s = read_path(path)
    np.testing.assert_array_equal(points, [[0.0, 0.0], [0.1, 0.05]])
    assert time_s is None
    path.write_text("time_s,x_m,y_m\n2,0,0\n3.5,0.1,0.05\n")
    np.testing.assert_array_equal(read_path(path)[1], [0.0, 1.5])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x_m,z_m\n0,0\n", "column z_m: a path has the columns"),
        ("x_m\n0\n", "column y_m: missing"),
        ("x_m,y_m\n0,0\n", "needs at least two rows, it has 1"),
        ("x_m,y_m\n0,0\n0,\n", "row 2, column y_m: value is not a finite number"),
        ("time_s,x_m,y_m\n1,0,0\n0.5,0,0\n", "row 2, column time_s: 0.5 goes back, row 1 is 1"),
    ],
)
def test_a_faulty_path_is_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "path.csv"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_path(path)
    assert str(path) in str(error.value)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x_m;y_m\n0,1;0,2\n", "columns are separated by semicolons, numbers have decimal commas"),
        ("x_m\ty_m\n0\t1\n", "columns are separated by tabs"),
        ("x_m y_m\n0 1\n", "columns are separated by blanks"),
        ("# bench 3\nx_m,y_m\n0,0\n", "1 comment line is above the data"),
        ("# x_m,y_m\n0,0\n", "the header is in a comment line"),
        ("sep=,\nx_m,y_m\n0,0\n", "its first line is sep="),
        ("bench 3\nx_m,y_m\n0,0\n1,2\n", "1 other line is above the data"),
        ("x_m,y_m\nm,m\n0,0\n", "a row of units is below the header"),
        ("x_m,y_m\n0,0,\n1,2,\n", "rows end with a separator"),
        ("0,1\n2,3\n", "it has no header"),
        ("x_m,y_m\n12:00:01.5,0\n", "column x_m: has dates or times of day instead of numbers"),
    ],
)
def test_foreign_table_formats_are_refused_with_advice(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_table(path)
    assert message in str(error.value)


def test_a_table_in_utf_16_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    for content in ("x_m,y_m\n0,1\n".encode("utf-16"), "x_m,y_m\n0,1\n".encode("utf-16-le")):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"table\.csv: cannot be read: it is UTF-16 text"):
            read_table(path)
    path.write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match="is not a text file"):
        read_table(path)


@pytest.mark.parametrize("missing", ["", " ", "NA", "n/a", "NaN", "nan", "#N/A", "#NUM!", "null", "--"])
def test_missing_values_are_read_as_nan(missing: str, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(f"x_m,y_m\n{missing},1\n2,{missing}\n3,4\n")
    np.testing.assert_array_equal(read_table(path)[1]["x_m"], [np.nan, 2, 3])
    np.testing.assert_array_equal(read_table(path)[1]["y_m"], [1, np.nan, 4])


def test_a_table_of_several_blocks_reads_as_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text_reader, "_BLOCK", 1000)
    table = np.random.default_rng(0).normal(size=(500, 3))
    table[77, 2] = np.nan
    path = tmp_path / "table.csv"
    np.savetxt(path, table, fmt="%.17g", delimiter=",", header="a,b,c", comments="")
    read_bytes: list[int] = []
    header, columns = read_table(path, read_bytes.append)
    np.testing.assert_array_equal(np.column_stack([columns[name] for name in header]), table)
    assert sum(read_bytes) == path.stat().st_size
    lines = path.read_text().splitlines()
    lines[400] = "1,2"
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match="row 400: 2 cells under 3 columns"):
        read_table(path)
    lines[400] = "1,bad,2"
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match="row 400, column b: 'bad' is not a number"):
        read_table(path)


def test_line_ends_of_old_spreadsheets_are_read(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(b"x_m,y_m\r0,1\r2,3\r")
    assert {name: list(column) for name, column in read_table(path)[1].items()} == {
        "x_m": [0, 2],
        "y_m": [1, 3],
    }


def test_numbers_and_time_stamps_end_at_the_same_row(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("clock,x_m\n" + "".join(f"12:00:0{second},{second}\n" for second in range(5)))
    (clock, x_m), _ = text_reader.read_columns(path, detect_format(path), [0, 1], max_rows=3)
    assert len(clock) == len(x_m) == 3
