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
from hframe_gym.recordings import load_recording, load_recordings, write_trajectory

WriteRun = Callable[..., Path]


def test_reads_columns_in_any_order_and_blank_outputs(write_run: WriteRun, hframe: Machine) -> None:
    path = write_run(cells={(3, "x_m"): "", (4, "y_m"): "nan", (5, "x_m"): "0.25"})
    run = load_recording(path, hframe)
    assert run.name == "run"
    assert run.inputs.shape == (20, 2)
    assert np.isnan(run.outputs[2, 2])
    assert np.isnan(run.outputs[3, 3])
    assert run.outputs[4, 2] == 0.25
    assert run.time_s[0] == 5.0
    lines = path.read_text().splitlines()
    order = [0, 6, 1, 5, 2, 3, 4]
    mixed = path.with_name("mixed.csv")
    mixed.write_text("\n".join(",".join(line.split(",")[i] for i in order) for line in lines))
    again = load_recording(mixed, hframe)
    np.testing.assert_array_equal(again.outputs, run.outputs)


def test_gzip_and_parquet_hold_the_same_run(write_run: WriteRun, hframe: Machine, tmp_path: Path) -> None:
    path = write_run(cells={(3, "x_m"): ""})
    plain = load_recording(path, hframe)
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(path.read_bytes()))
    names = path.read_text().splitlines()[0].split(",")
    columns = [plain.time_s, *plain.inputs.T, *plain.outputs.T]
    table = pyarrow.table({n: pyarrow.array(c, from_pandas=True) for n, c in zip(names, columns, strict=True)})
    pyarrow.parquet.write_table(table, tmp_path / "run.parquet")
    for other in ("run.csv.gz", "run.parquet"):
        run = load_recording(tmp_path / other, hframe)
        assert run.name == "run"
        np.testing.assert_array_equal(run.time_s, plain.time_s)
        np.testing.assert_array_equal(run.outputs, plain.outputs)


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ({(7, "v1_V"): "abc"}, "row 7, column v1_V: 'abc' is not a number"),
        ({(7, "x_m"): "abc"}, "row 7, column x_m: 'abc' is not a number"),
        ({(7, "v1_V"): ""}, "row 7, column v1_V: nan is blank"),
        ({(7, "y_m"): "inf"}, "row 7, column y_m: inf is infinite"),
        ({(7, "time_s"): "5.001"}, "row 7, column time_s: 5.001 goes back"),
        ({(7, "time_s"): "5.005"}, "row 7, column time_s: 5.005 repeats"),
        ({(7, "time_s"): ""}, "row 7, column time_s"),
        ({(7, "x_m"): "125.0"}, "row 7, column x_m: 125 cannot be m: millimetres?"),
        ({(7, "x_m"): "15.0"}, "column x_m: moves by 15, x can move by 0.56: millimetres?"),
        ({(7, "x_m"): "2.0"}, "column x_m: moves by 2, x can move by 0.56: millimetres?"),
        ({(r, c): "" for r in range(1, 21) for c in ("phi1_rad", "phi2_rad", "x_m", "y_m")}, "all outputs are blank"),
    ],
)
def test_a_wrong_cell_is_refused_by_place(
    cells: dict[tuple[int, str], str], message: str, write_run: WriteRun, hframe: Machine
) -> None:
    path = write_run(cells=cells)
    with pytest.raises(InputError) as error:
        load_recording(path, hframe)
    assert str(path) in str(error.value)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_mm,y_m", "column x_mm: is in millimetres; recordings have x_m"),
        ("time_s,v1_V,v2_V,phi1_deg,phi2_rad,x_m,y_m", "column phi1_deg: is in degrees; recordings have phi1_rad"),
        ("time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,z_m", "column z_m: unknown"),
        ("v1_V,time_s,v2_V,phi1_rad,phi2_rad,x_m,y_m", "the first column must be time_s"),
        ("time_s,v1_V,v1_V,phi1_rad,phi2_rad,x_m,y_m", "column v1_V: appears twice"),
    ],
)
def test_a_wrong_header_is_refused(header: str, message: str, write_run: WriteRun, hframe: Machine) -> None:
    with pytest.raises(InputError, match=message):
        load_recording(write_run(header=header), hframe)


def test_a_missing_column_is_refused_but_voltages_alone_can_be_simulated(tmp_path: Path, hframe: Machine) -> None:
    path = tmp_path / "v.csv"
    path.write_text("time_s,v1_V,v2_V\n0,0,0\n0.001,1,1\n")
    with pytest.raises(InputError, match="column phi1_rad: missing"):
        load_recording(path, hframe)
    run = load_recording(path, hframe, outputs_needed=False)
    assert np.isnan(run.outputs).all()
    path.write_text("time_s,v1_V,v2_V,x_m\n0,0,0,0\n")
    with pytest.raises(InputError, match="column phi1_rad: missing"):
        load_recording(path, hframe, outputs_needed=False)


def test_angles_in_degrees_under_a_rad_name_are_refused(tmp_path: Path, hframe: Machine) -> None:
    time = np.arange(200) * 1e-3
    y = 0.1 * time
    phi = np.degrees(-y / 0.0194)
    table = np.column_stack([time, 0 * time, 0 * time, phi, phi, 0 * time, y])
    path = tmp_path / "deg.csv"
    np.savetxt(path, table, delimiter=",", header="time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,y_m", comments="")
    with pytest.raises(InputError, match="columns phi1_rad, phi2_rad: 57 times what the belts allow: degrees"):
        load_recording(path, hframe)


def test_a_small_move_in_millimetres_is_refused_by_the_belts(tmp_path: Path, hframe: Machine) -> None:
    time = np.arange(200) * 1e-3
    y = 0.005 * time
    phi = -y / 0.0194
    table = np.column_stack([time, 0 * time, 0 * time, phi, phi, 0 * time, 1000 * y])
    path = tmp_path / "mm.csv"
    np.savetxt(path, table, delimiter=",", header="time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,y_m", comments="")
    with pytest.raises(InputError, match="columns x_m, y_m: 1000 times what the belts allow: millimetres"):
        load_recording(path, hframe)


@pytest.mark.parametrize("content", ["", "time_s,v1_V,v2_V,phi1_rad,phi2_rad,x_m,y_m\n"])
def test_nothing_in_a_file_is_refused(content: str, tmp_path: Path, hframe: Machine) -> None:
    (tmp_path / "empty.csv").write_text(content)
    with pytest.raises(InputError, match=r"empty\.csv: (empty|no rows)"):
        load_recording(tmp_path / "empty.csv", hframe)


def test_a_short_row_and_a_broken_gzip_are_refused(write_run: WriteRun, tmp_path: Path, hframe: Machine) -> None:
    path = write_run()
    path.write_text(path.read_text() + "5.1,1,1\n")
    with pytest.raises(InputError, match="row 21: 3 cells under 7 columns"):
        load_recording(path, hframe)
    whole = gzip.compress(b"time_s,v1_V\n" + b"0.001,1\n" * 1000)
    damaged = whole[:20] + b"\xff\xff\xff" + whole[23:]
    for content in (b"not gzip", whole[: len(whole) // 2], damaged):
        (tmp_path / "broken.csv.gz").write_bytes(content)
        with pytest.raises(InputError, match=r"broken\.csv\.gz: cannot be read"):
            load_recording(tmp_path / "broken.csv.gz", hframe)
    (tmp_path / "latin.csv").write_bytes("time_s,größe\n".encode("latin-1"))
    with pytest.raises(InputError, match=r"latin\.csv: cannot be read"):
        load_recording(tmp_path / "latin.csv", hframe)


def test_byte_order_mark_windows_line_ends_and_blank_lines_are_read(write_run: WriteRun, hframe: Machine) -> None:
    path = write_run()
    plain = load_recording(path, hframe)
    text = path.read_text()
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode() + b"\r\n\r\n")
    np.testing.assert_array_equal(load_recording(path, hframe).outputs, plain.outputs)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (["0", "oops"], "row 2, column x_m: 'oops' is not a number"),
        ([datetime.datetime(2020, 1, 1)] * 2, "row 1, column x_m: datetime.datetime"),
    ],
)
def test_a_wrong_column_of_parquet_is_refused_by_place(
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


def test_parquet_without_its_library_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, hframe: Machine
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    (tmp_path / "run.parquet").write_bytes(b"")
    with pytest.raises(InputError, match=r"hframe_gym\[parquet\]"):
        load_recording(tmp_path / "run.parquet", hframe)


def test_a_folder_is_read_in_order(write_run: WriteRun, tmp_path: Path, hframe: Machine) -> None:
    write_run("b.csv")
    write_run("a.csv")
    (tmp_path / "notes.txt").write_text("not a run")
    assert [r.name for r in load_recordings(tmp_path, hframe)] == ["a", "b"]
    with pytest.raises(InputError, match="no such folder"):
        load_recordings(tmp_path / "none", hframe)
    with pytest.raises(InputError, match="is a file, give the folder"):
        load_recordings(tmp_path / "a.csv", hframe)
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress((tmp_path / "a.csv").read_bytes()))
    with pytest.raises(InputError, match=r"the run 'a' is there twice"):
        load_recordings(tmp_path, hframe)


def test_written_predictions_read_back(tmp_path: Path, hframe: Machine) -> None:
    time = np.arange(50) * 1e-3
    inputs = np.full((50, 2), -4.0)
    trajectory = hframe.simulate(time, inputs)
    for name in ("out.csv", "out.csv.gz"):
        write_trajectory(tmp_path / name, trajectory, inputs, hframe)
        run = load_recording(tmp_path / name, hframe)
        np.testing.assert_allclose(run.outputs, trajectory.outputs, rtol=1e-8, atol=1e-12)
    assert {p.name for p in tmp_path.iterdir()} == {"out.csv", "out.csv.gz"}
