"""Logs of controllers and data loggers, as they come, become recordings with the same values."""

from __future__ import annotations

import dataclasses
import gzip
import json
import pickle
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from scipy.io import savemat

from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Sensor
from hframe_gym.recordings import (
    ImportSettings,
    MachineOptions,
    MappingOptions,
    Recording,
    import_logs,
    load_recordings,
    new_machine,
    read_mapping_file,
    write_recording,
)
from hframe_gym.recordings.logs.log_files import log_name
from hframe_gym.recordings.logs.log_rests import split_at_rests
from hframe_gym.recordings.logs.measurement_units import accepted_units
from hframe_gym.recordings.wrong_units import WrongUnitError

Table = dict[str, np.ndarray]
PLAIN = ["time_s", "v1_V", "v2_V", "phi1_rad", "phi2_rad", "x_m", "y_m"]


@pytest.fixture
def table(hframe: Machine) -> Table:
    """Return a run of 300 rows at 1 kHz by channel, rounded as a logger does."""
    time_s = np.round(np.arange(300) * 1e-3, 3)
    inputs = np.where(time_s[:, None] < 0.1, 0.0, np.round(6 * np.sin(30 * time_s)[:, None] * [1.0, 0.4], 3))
    columns = np.column_stack([time_s, inputs, np.round(hframe.simulate(time_s, inputs).outputs, 6)])
    return dict(zip(PLAIN, columns.T, strict=True))


def text_of(table: Table, separator: str = ",", decimal: str = ".", header: str | None = None) -> str:
    """Return a table as text."""
    rows = (
        separator.join(map(repr, row)).replace(".", decimal)
        for row in zip(*(c.tolist() for c in table.values()), strict=True)
    )
    first = separator.join(table) if header is None else header
    return "\n".join([first, *(row.replace(".", decimal) for row in rows)]) + "\n"


def convert(
    path: Path, machine: Machine, *, lines: list[str] | None = None, **options: dict[str, object]
) -> Recording:
    """Import a log into a new folder and load the only run."""
    out = path.parent / "runs"
    settings = ImportSettings(MappingOptions(**options))  # type: ignore[arg-type]
    import_logs(path, out, machine, settings, log=(lines if lines is not None else []).append)
    (run,) = load_recordings(out, machine)
    return run


def squeezed(lines: list[str]) -> str:
    """Return lines as one text with single blanks between the words."""
    return " ".join("\n".join(lines).split())


def assert_equal(run: Recording, table: Table) -> None:
    """Compare a run with the table of its source."""
    np.testing.assert_array_equal(run.time_s, table["time_s"])
    np.testing.assert_array_equal(run.inputs.T, [table["v1_V"], table["v2_V"]])
    np.testing.assert_array_equal(run.outputs.T, [table[c] for c in ("phi1_rad", "phi2_rad", "x_m", "y_m")])


def in_text(edit: Callable[[Table], str | bytes]) -> Callable[[Path, Table], Path]:
    """Return a function that writes an edited text of a table to a folder."""

    def write(folder: Path, table: Table) -> Path:
        content = edit(table)
        path = folder / "log.txt"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def with_line(table: Table, number: int, line: str) -> str:
    """Return a table as text with one more line."""
    lines = text_of(table).split("\n")
    return "\n".join([*lines[:number], line, *lines[number:]])


FORMATS: dict[str, tuple[Callable[[Table], str | bytes], str]] = {
    "plain": (text_of, "300 rows, 0.299 s at 1000 Hz"),
    "semicolons": (lambda t: text_of(t, ";"), "separated by semicolons"),
    "semicolons and decimal commas": (lambda t: text_of(t, ";", ","), "numbers have decimal commas"),
    "tabs": (lambda t: text_of(t, "\t"), "separated by tabs"),
    "tabs and decimal commas": (lambda t: text_of(t, "\t", ","), "numbers have decimal commas"),
    "blanks": (lambda t: "  " + text_of(t, "   ").replace("\n", "\n  "), "separated by blanks"),
    "vertical bars": (lambda t: text_of(t, " | "), "separated by vertical bars"),
    "quoted decimal commas": (
        lambda t: text_of(t, ";", ",").replace(";", '","').replace("\n", '"\n"').join('""')[:-2],
        "numbers have decimal commas",
    ),
    "byte order mark": (lambda t: b"\xef\xbb\xbf" + text_of(t).encode(), "300 rows"),
    "UTF-16": (lambda t: text_of(t, "\t").encode("utf-16"), "UTF-16"),
    "UTF-16 without mark": (lambda t: text_of(t).encode("utf-16-le"), "UTF-16"),
    "Windows-1252": (lambda t: ("# Größe µ\n" + text_of(t)).encode("cp1252"), "Windows-1252"),
    "carriage returns": (lambda t: text_of(t).replace("\n", "\r").encode(), "300 rows"),
    "Windows line ends": (lambda t: text_of(t).replace("\n", "\r\n").encode(), "300 rows"),
    "sep= line": (lambda t: "sep=;\n" + text_of(t, ";"), "first line is sep="),
    "comment lines": (lambda t: "# bench 3\n# 2024\n" + text_of(t), "2 comment lines are above the data"),
    "comment line between rows": (
        lambda t: with_line(t, 40, "# pause"),
        "1 comment line between the rows left out",
    ),
    "header in a comment": (lambda t: "# " + text_of(t), "the header is in a comment line"),
    "lines of the logger": (
        lambda t: "Bench;3\nOperator;A. B.\n\n" + text_of(t, ";"),
        "2 other lines are above",
    ),
    "units row": (lambda t: with_line(t, 1, "s,V,V,rad,rad,m,m"), "a row of units is below the header"),
    "units row in brackets": (lambda t: with_line(t, 1, "[s],[V],[V],[rad],[rad],[m],[m]"), "a row of units"),
    "trailing separators": (lambda t: text_of(t).replace("\n", ",\n"), "rows end with a separator"),
    "trailing separators of rows": (
        lambda t: text_of(t).replace("\n", ",\n").replace(",\n", "\n", 1),
        "rows end with a separator",
    ),
    "empty lines of a spreadsheet": (lambda t: text_of(t) + ",,,,,,\n,,,,,,\n", "300 rows"),
    "incomplete last row": (lambda t: text_of(t) + "0.3,1.0", "the last row is incomplete and left out"),
    "gzip": (lambda t: gzip.compress(text_of(t).encode()), "300 rows"),
}


@pytest.mark.parametrize("case", FORMATS)
def test_a_text_of_any_format_is_imported(case: str, table: Table, hframe: Machine, tmp_path: Path) -> None:
    edit, said = FORMATS[case]
    lines: list[str] = []
    assert_equal(convert(in_text(edit)(tmp_path, table), hframe, lines=lines), table)
    assert said in "\n".join(lines)
    assert all("no unit" not in line for line in lines)


def renamed(**names: str) -> Callable[[Table], Table]:
    """Return a function that renames channels of a table."""
    return lambda table: {names.get(channel, channel): values for channel, values in table.items()}


COLUMNS: dict[str, tuple[Callable[[Table], str], dict[str, dict[str, object]], str]] = {
    "other names": (
        lambda t: text_of(renamed(time_s="Zeit", v1_V="U1", v2_V="U2", x_m="Laser X")(t)),
        {"columns": {"v1_V": "U1", "v2_V": "u2", "x_m": "Laser X"}},
        "Zeit time - time_s (no unit, taken as s)",
    ),
    "other case": (
        lambda t: text_of(t, header="TIME_S,V1_v,V2_V,Phi1_RAD,PHI2_rad,X_M,Y_m"),
        {},
        "X_M length m x_m",
    ),
    "units in brackets": (
        lambda t: text_of(t | {"x_m": t["x_m"] * 1000, "time_s": t["time_s"] * 1000}).replace(
            text_of(t).split("\n")[0], "Time [ms],V1 [V],V2 [V],Phi1 (rad),Phi2 (rad),X [mm],Y [m]"
        ),
        {},
        "X [mm] length mm x_m (mm to m)",
    ),
    "units as endings": (
        lambda t: text_of(
            {
                ("y_um" if c == "y_m" else "time_ms" if c == "time_s" else c): v
                * {"y_m": 1e6, "time_s": 1e3}.get(c, 1)
                for c, v in t.items()
            }
        ),
        {},
        "y_um length um y_m (um to m)",
    ),
    "extra columns": (
        lambda t: text_of({"i1_A": t["v1_V"] / 3, **t, "state": t["x_m"]}),
        {},
        "i1_A current A not used state state - not used",
    ),
    "a text column": (
        lambda t: text_of(t).replace("\n", ",RUN\n").replace("RUN", "State", 1),
        {},
        "State state - not used",
    ),
    "repeated names": (
        lambda t: text_of(t, header="time_s,U,U,phi1_rad,phi2_rad,x_m,y_m"),
        {"columns": {"v1_V": "U", "v2_V": "U.2"}},
        "U.2 voltage - v2_V (no unit, taken as V)",
    ),
    "no header": (
        lambda t: "\n".join(text_of(t).split("\n")[1:]),
        {"columns": {c: f"#{i}" for i, c in enumerate(PLAIN, start=1)}},
        "it has no header",
    ),
    "duty cycle in percent": (
        lambda t: text_of(
            {("duty1 [%]" if c == "v1_V" else c): v / (0.12 if c == "v1_V" else 1) for c, v in t.items()}
        ),
        {"columns": {"v1_V": "duty1"}},
        "duty cycle, 100 % is 12 V, the rated voltage of motor1",
    ),
    "a factor": (
        lambda t: text_of({c: (-v * 1000 if c == "x_m" else v) for c, v in t.items()}),
        {"scales": {"x_m": -0.001}},
        "x_m length m x_m (times -0.001)",
    ),
}


@pytest.mark.parametrize("case", COLUMNS)
def test_columns_of_any_name_and_unit_are_imported(
    case: str, table: Table, hframe: Machine, tmp_path: Path
) -> None:
    edit, options, said = COLUMNS[case]
    lines: list[str] = []
    run = convert(in_text(edit)(tmp_path, table), hframe, lines=lines, **options)
    for array, channels in ((run.inputs, PLAIN[1:3]), (run.outputs, PLAIN[3:])):
        np.testing.assert_allclose(array.T, [table[c] for c in channels], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(run.time_s, table["time_s"])
    assert said in squeezed(lines)


def test_numbered_columns_must_be_the_same_in_all_logs(tmp_path: Path) -> None:
    """The names of two logs say that a number stands for another column in the second."""
    motor = BUILTIN_MACHINES["motor"]()
    (tmp_path / "logs").mkdir()
    rows = "\n".join(f"{k * 1e-3:g},{k % 7},{0.01 * k:g}" for k in range(40))
    columns = {"v_V": "#2", "shaft_rad": "#3"}
    for second in ("time,uL,angle", "time,angle,u"):
        for name, header in (("a", "time,u,angle"), ("b", second)):
            (tmp_path / "logs" / f"{name}.csv").write_text(f"{header}\n{rows}\n")
        settings = ImportSettings(MappingOptions(columns))
        if second == "time,uL,angle":
            import_logs(tmp_path / "logs", tmp_path / "runs", motor, settings, lambda line: None)
            continue
        with pytest.raises(
            InputError, match=r"column 2 is 'angle', and in a.csv it is 'u', which is column 3"
        ):
            import_logs(tmp_path / "logs", tmp_path / "others", motor, settings, lambda line: None)


def test_angles_in_degrees_are_converted(table: Table, hframe: Machine, tmp_path: Path) -> None:
    degrees = {c: (np.degrees(v) if c.startswith("phi") else v) for c, v in table.items()}
    path = in_text(text_of)(tmp_path, degrees)
    with pytest.raises(InputError, match="are they in degrees"):
        convert(path, hframe)
    assert not (tmp_path / "runs").exists()
    run = convert(path, hframe, units={"phi1_rad": "deg", "phi2_rad": "°"})
    np.testing.assert_allclose(run.outputs[:, 0], table["phi1_rad"], rtol=1e-14)


@pytest.mark.parametrize("missing", ["", "NA", "NaN", "#N/A", "null", " "])
def test_missing_outputs_stay_empty_and_missing_inputs_are_held(
    missing: str, table: Table, hframe: Machine, tmp_path: Path
) -> None:
    rows = [line.split(",") for line in text_of(table).split("\n")[:-1]]
    rows[150][5] = rows[151][2] = missing
    path = tmp_path / "log.csv"
    path.write_text("\n".join(map(",".join, rows)))
    lines: list[str] = []
    run = convert(path, hframe, lines=lines)
    assert np.isnan(run.outputs[149, 2])
    assert run.inputs[150, 1] == table["v2_V"][149]
    assert "v2_V: 1 of 300 cells is empty; the value before each is held" in "\n".join(lines)


def test_several_rates_in_one_table_hold_inputs_and_leave_outputs_empty(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    slow = {
        c: np.where(np.arange(300) % 5 == 2, v, np.nan) if c in ("v1_V", "x_m") else v
        for c, v in table.items()
    }
    path = in_text(lambda t: text_of(t).replace("nan", ""))(tmp_path, slow)
    lines: list[str] = []
    run = convert(path, hframe, lines=lines)
    assert "the first 2 rows are left out, an input has no value there yet" in "\n".join(lines)
    np.testing.assert_array_equal(run.time_s, table["time_s"][2:])
    np.testing.assert_array_equal(run.inputs[:, 0], np.repeat(table["v1_V"][2::5], 5)[:298])
    np.testing.assert_array_equal(run.outputs[::5, 2], table["x_m"][2::5])
    assert np.isnan(run.outputs[1:5, 2]).all()


def test_several_columns_of_time_are_merged(table: Table, hframe: Machine, tmp_path: Path) -> None:
    fast = [[repr(float(v)) for v in row] for row in zip(*(table[c] for c in PLAIN[:5]), strict=True)]
    slow = [
        [repr(float(v)) for v in row]
        for row in zip(*(table[c][::5] for c in ("time_s", "x_m", "y_m")), strict=True)
    ]
    slow += [["", "", ""]] * (len(fast) - len(slow))
    rows = [",".join([*a, *b]) for a, b in zip(fast, slow, strict=True)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["Time [s],v1_V,v2_V,phi1_rad,phi2_rad,Time [s],x_m,y_m", *rows]))
    lines: list[str] = []
    run = convert(path, hframe, lines=lines)
    assert "several columns of time, merged to 300 rows (300 of Time [s], 60 of Time [s].2)" in "\n".join(
        lines
    )
    np.testing.assert_array_equal(run.time_s, table["time_s"])
    np.testing.assert_array_equal(run.inputs[:, 0], table["v1_V"])
    np.testing.assert_array_equal(run.outputs[::5, 2], table["x_m"][::5])
    assert np.isnan(run.outputs[1::5, 2:]).all()


@pytest.mark.parametrize(
    ("stamp", "first"),
    [
        ("2024-05-01T12:00:{:06.3f}", 43200.0),
        ("2024-05-01 12:00:{:06.3f}", 43200.0),
        ("2024-05-01T12:00:{:06.3f}Z", 43200.0),
        ("2024-05-01T12:00:{:06.3f}+02:00", 43200.0),
        ("01.05.2024 12:00:{:06.3f}", 43200.0),
        ("9:30:{:06.3f}", 34200.0),
    ],
)
def test_time_stamps_become_seconds_since_midnight(
    stamp: str, first: float, table: Table, hframe: Machine, tmp_path: Path
) -> None:
    header, *rows = text_of(table).split("\n")[:-1]
    path = tmp_path / "log.csv"
    stamped = [f"{stamp.format(float(row.split(',')[0]))},{row.partition(',')[2]}" for row in rows]
    path.write_text("\n".join([header.replace("time_s", "Timestamp"), *stamped]))
    run = convert(path, hframe)
    np.testing.assert_array_equal(run.time_s, np.round(first + table["time_s"], 3))
    np.testing.assert_array_equal(run.outputs[:, 2], table["x_m"])


def test_logs_with_time_stamps_share_a_clock(table: Table, hframe: Machine, tmp_path: Path) -> None:
    header, *rows = text_of(table).split("\n")[:-1]
    (tmp_path / "logs").mkdir()
    for name, day in (("a.csv", 1), ("b.csv", 2)):
        stamps = [
            f"2024-05-0{day}T00:00:{float(row.split(',')[0]):06.3f},{row.partition(',')[2]}" for row in rows
        ]
        (tmp_path / "logs" / name).write_text("\n".join([header, *stamps]))
    for name in ("notes.md", "README.txt"):
        (tmp_path / "logs" / name).write_text("Both logs were recorded in May.")
    (tmp_path / "logs" / "c.csv").touch()
    (tmp_path / "logs" / "more.zip").write_bytes(b"PK\x03\x04")
    (tmp_path / "logs" / "tuesday").mkdir()
    (tmp_path / "logs" / "tuesday" / "d.csv").write_text(header)
    lines: list[str] = []
    import_logs(tmp_path / "logs", tmp_path / "runs", hframe, log=lines.append)
    a, b = load_recordings(tmp_path / "runs", hframe)
    np.testing.assert_array_equal(b.time_s, np.round(a.time_s + 86400.0, 3))
    assert "skipped (by their names or content, no logs): README.txt, notes.md, tuesday/" in lines
    assert f"skipped: {tmp_path / 'logs' / 'more.zip'}: is an archive; unpack it" in "\n".join(lines)
    assert lines[lines.index("c.csv:") + 1] == "  left out: the file is empty"
    assert "b.csv: same format and columns as the log before" in lines


def test_matlab_arrays_structs_and_matrices_are_imported(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    named = {"t": table["time_s"], **{c: table[c] for c in PLAIN[1:]}}
    matrix = np.column_stack(list(table.values()))
    short = {"t_slow": table["time_s"][::5], "x_m": table["x_m"][::5]}
    numbered = {c: f"data.{i}" for i, c in enumerate(PLAIN, start=1)}
    for content, options in (
        (named, {}),
        ({"log": named}, {"columns": {c: f"log.{c}" for c in PLAIN[1:]}}),
        ({"data": matrix}, {"columns": numbered}),
    ):
        folder = tmp_path / str(len(options.get("columns", {}))) / str(len(content))
        folder.mkdir(parents=True)
        savemat(folder / "run.mat", content)
        assert_equal(convert(folder / "run.mat", hframe, **options), table)
    # The structure that dSPACE ControlDesk writes.
    signals = np.array([(c, table[c]) for c in PLAIN[1:]], dtype=[("Name", "O"), ("Data", "O")])
    (tmp_path / "desk").mkdir()
    savemat(tmp_path / "desk/desk.mat", {"desk": {"X": {"Name": "", "Data": table["time_s"]}, "Y": signals}})
    assert_equal(convert(tmp_path / "desk/desk.mat", hframe), table)
    savemat(tmp_path / "rates.mat", {**named, **short})
    with pytest.raises(
        InputError,
        match=r"x_m: has 60 values, .* rename its time to t or time in the log, or .* --map time_s=t,t_slow",
    ):
        convert(tmp_path / "rates.mat", hframe)
    run = convert(tmp_path / "rates.mat", hframe, columns={"time_s": "t,t_slow"})
    np.testing.assert_array_equal(run.outputs[::5, 2], table["x_m"][::5])
    assert np.isnan(run.outputs[1::5, 2]).all()


def test_each_timeseries_of_a_matlab_file_has_its_own_time(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    """Signals of one model have equal times, and a signal that is no channel has others."""
    series = {f"ws_{c}": {"Time": table["time_s"], "Data": table[c]} for c in PLAIN[1:]}
    series["ws_angle"] = {"Time": table["time_s"][::5], "Data": table["x_m"][::5]}
    savemat(tmp_path / "run.mat", series)
    columns = {c: f"ws_{c}.Data" for c in PLAIN[1:]}
    assert_equal(convert(tmp_path / "run.mat", hframe, columns=columns), table)
    savemat(
        tmp_path / "run.mat",
        {**series, "log": {"t": table["time_s"], "time": table["time_s"], "x": table["x_m"]}},
    )
    with pytest.raises(InputError, match=r"several times have the length of log.x: add --map"):
        convert(tmp_path / "run.mat", hframe, columns=columns | {"x_m": "log.x"})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x89HDF\r\n\x1a\n" + bytes(200), "cannot be read as an HDF5 file"),
        (b"MATLAB 5.0 MAT-file" + bytes(20), "cannot be read as a MATLAB file"),
        (b"PK\x03\x04" + bytes(200), "is a spreadsheet or an archive.*save the sheet as CSV"),
        (b"", "empty"),
        (b"only text\nand more\n", "no column is named like time_s, v1_V"),
    ],
)
def test_files_that_cannot_be_read_are_refused_with_advice(
    content: bytes, message: str, hframe: Machine, tmp_path: Path
) -> None:
    (tmp_path / "log.mat").write_bytes(content)
    path = (tmp_path / "log.mat").rename(tmp_path / ("log.txt" if b"MATLAB 5" not in content else "log.mat"))
    with pytest.raises(InputError, match=message):
        convert(path, hframe)


def test_parquet_with_time_stamps_and_other_types_is_imported(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    start = np.datetime64("2024-05-01T06:00:00", "ns")
    stamps = start + np.round(table["time_s"] * 1e9).astype("timedelta64[ns]")
    columns = {"timestamp": pyarrow.array(stamps), **{c: pyarrow.array(table[c]) for c in PLAIN[1:]}}
    columns["note"] = pyarrow.array(["run"] * 300)
    pyarrow.parquet.write_table(pyarrow.table(columns), tmp_path / "log.parquet")
    assert_equal(
        convert(tmp_path / "log.parquet", hframe), table | {"time_s": np.round(21600 + table["time_s"], 3)}
    )


@pytest.mark.parametrize("run_format", ["csv", "csv.gz", "parquet"])
def test_recordings_are_written_without_loss(
    run_format: str, table: Table, hframe: Machine, tmp_path: Path
) -> None:
    exact = {c: v + np.where(c == "x_m", 1e-17 + v / 3, 0.0) for c, v in table.items()}
    path = in_text(text_of)(tmp_path, exact)
    settings = ImportSettings(run_format=run_format)  # type: ignore[arg-type]
    (file,) = import_logs(path, tmp_path / "runs", hframe, settings, log=lambda line: None)
    assert file.name == f"log.{run_format}"
    (run,) = load_recordings(tmp_path / "runs", hframe)
    assert_equal(run, exact)


def test_a_log_with_unknown_names_is_refused_with_a_line_to_paste(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    names = renamed(time_s="Zeit [s]", v1_V="U1 [V]", v2_V="U2 [V]", x_m="Pos 1 [m]", y_m="Pos 2 [m]")(table)
    path = in_text(text_of)(tmp_path, names | {"I1 [A]": table["v1_V"]})
    with pytest.raises(InputError) as error:
        convert(path, hframe)
    text = str(error.value)
    assert "\n" not in text
    assert text.startswith(
        f"{path}: no column is named like v1_V, v2_V, x_m, y_m. Columns of the log: Zeit [s], U1 [V]"
    )
    assert "Machine 'hframe' has time_s, inputs v1_V, v2_V and outputs phi1_rad, phi2_rad, x_m, y_m" in text
    suggested = "--map 'v1_V=U1 [V]' --map 'v2_V=U2 [V]' --map 'x_m=Pos 1 [m]' --map 'y_m=Pos 2 [m]'"
    assert suggested in text
    options = [part.strip("'") for part in suggested.split("--map ")[1:]]
    columns = dict(option.strip().strip("'").split("=") for option in options)
    assert_equal(convert(path, hframe, columns=columns), table)


@pytest.mark.parametrize(
    ("units", "scales", "remark"),
    [
        ({"x_m": "in"}, {}, "in to m"),
        ({}, {"x_m": 2.5}, "times 2.5"),
        ({"x_m": "mm"}, {"x_m": 2e3}, "mm to m, times 2000"),
    ],
)
def test_a_wrong_unit_that_the_user_states_is_named(
    units: dict[str, str],
    scales: dict[str, float],
    remark: str,
    table: Table,
    hframe: Machine,
    tmp_path: Path,
) -> None:
    columns = {c: v for c, v in table.items() if c != "x_m"} | {"X": table["x_m"] * 1e5}
    path = in_text(text_of)(tmp_path, columns)
    with pytest.raises(InputError) as error:
        convert(path, hframe, units=units, scales=scales)
    assert f". Correct --unit x_m=UNIT or --scale x_m=FACTOR: x_m is the column 'X' ({remark})" in str(
        error.value
    )
    assert "millimeters" not in str(error.value)


def test_the_angle_of_a_motor_on_an_axis_becomes_travel_by_the_gear_ratio(tmp_path: Path) -> None:
    machine = new_machine("axis", "stage", MachineOptions(encoder_lines=500))
    (drive,) = machine.drives
    log, travel = axis_log(machine)
    log = {"time_s": log["time_s"], "v_V": log["v_V"], "Winkel [deg]": np.degrees(drive.gear_ratio * travel)}
    log["Wegsensor [mm]"] = 1e3 * travel
    lines: list[str] = []
    path = in_text(text_of)(tmp_path, log)
    with pytest.raises(InputError) as error:
        convert(path, machine)
    assert "--map 'x_encoder_m=Winkel [deg]' --map 'x_m=Wegsensor [mm]'" in str(error.value)
    run = convert(path, machine, lines=lines, columns={"x_encoder_m": "Winkel", "x_m": "Wegsensor"})
    np.testing.assert_allclose(run.outputs, np.column_stack([travel, travel]), atol=1e-12)
    assert any(
        f"angle of {drive.name} in deg, converted by its gear ratio, {drive.gear_ratio:.6g} rad/m" in line
        for line in lines
    )
    path.write_text(path.read_text().replace("Winkel [deg]", "Winkel [N]"))
    # One length for two channels.
    with pytest.raises(InputError, match=r"--map x_encoder_m=COLUMN --map x_m=COLUMN"):
        convert(path, machine)


def axis_log(machine: Machine) -> tuple[Table, np.ndarray]:
    """Return time and voltage of a log of an axis, and the travel of its carriage, m."""
    time_s = np.arange(300) * 1e-3
    inputs = np.where(time_s < 0.1, 0.0, 6.0)[:, None]
    travel = machine.simulate(time_s, inputs).outputs[:, machine.output_channels.index("x_m")]
    return {"time_s": time_s, "v_V": inputs[:, 0], "x_m": travel}, travel


def test_the_speed_of_a_motor_on_an_axis_is_integrated_to_travel(tmp_path: Path) -> None:
    machine = new_machine("axis", "stage", MachineOptions(encoder_lines=500))
    (drive,) = machine.drives
    log, travel = axis_log(machine)
    log["n [rpm]"] = np.gradient(drive.gear_ratio * travel, log["time_s"]) * 30 / np.pi
    path = in_text(text_of)(tmp_path, log)
    lines: list[str] = []
    run = convert(path, machine, lines=lines, columns={"x_encoder_m": "n"})
    expected = travel - travel[0]
    np.testing.assert_allclose(run.outputs[:, 0], expected, atol=2e-3 * np.ptp(expected))
    assert any(f"speed of {drive.name} in rpm, converted by its gear ratio" in line for line in lines)
    scales = {"x_encoder_m": 0.01}
    with pytest.raises(
        InputError, match=r"rpm is a speed, not a length. Add --unit x_encoder_m=rpm to integrate it"
    ):
        convert(path, machine, columns={"x_encoder_m": "n"}, scales=scales)


def test_a_carriage_may_be_commanded_and_measured_in_the_speed_of_its_motor(tmp_path: Path) -> None:
    """Drives of screws are commanded in rpm, which the gear ratio of the machine file converts."""
    machine = new_machine(
        "axis", "stage", MachineOptions(drive="speed", sensor=("speed@x",), travel_per_turn=0.01)
    )
    time_s = 1e-3 * np.arange(1000)
    log = {
        "time_s": time_s,
        "n_set [rpm]": 600.0 * np.sin(9.0 * time_s),
        "n [rpm]": 500.0 * np.sin(9.0 * time_s),
    }
    columns = {"command_m_s": "n_set", "x_m_s": "n", "x_m": "none", "x_encoder_m": "none"}
    columns = {
        name: columns[name] for name in columns if name in machine.input_channels + machine.output_channels
    }
    run = convert(in_text(text_of)(tmp_path, log), machine, columns=columns)
    np.testing.assert_allclose(run.inputs[:, 0], 0.1 * np.sin(9.0 * time_s), atol=1e-6)
    speed = run.outputs[:, machine.output_channels.index("x_m_s")]
    np.testing.assert_allclose(speed, 500.0 / 6000.0 * np.sin(9.0 * time_s), atol=1e-6)


def test_the_angle_of_two_motors_of_different_gear_ratios_is_no_travel() -> None:
    machine = new_machine("axis", "stage", MachineOptions(encoder_lines=500))
    (drive,) = machine.drives
    for ratio, accepted in ((1.0, True), (2.0, False)):
        second = dataclasses.replace(
            drive, name="second", channel="v2_V", gear_ratio=ratio * drive.gear_ratio
        )
        both = dataclasses.replace(machine, drives=(drive, second))
        assert ("deg" in accepted_units(both, "x_encoder_m")) == accepted
        assert ("rpm" in accepted_units(both, "x_encoder_m")) == accepted


def test_a_speed_of_another_quantity_is_not_taken_as_a_position_by_a_factor(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    speed = {"enc [rpm]": np.gradient(table["x_m"], table["time_s"]) * 100}
    path = in_text(text_of)(tmp_path, {c: v for c, v in table.items() if c != "x_m"} | speed)
    message = (
        r"rpm is a speed, not a length. If the factor converts it to m/s, add --unit x_m=m/s to integrate it"
    )
    with pytest.raises(InputError, match=message):
        convert(path, hframe, columns={"x_m": "enc"}, scales={"x_m": 0.01})
    run = convert(path, hframe, columns={"x_m": "enc"}, scales={"x_m": 0.01}, units={"x_m": "m/s"})
    expected = table["x_m"] - table["x_m"][0]
    np.testing.assert_allclose(run.outputs[:, 2], expected, atol=2e-3 * np.ptp(expected))


def test_a_factor_of_a_speed_may_be_a_voltage(table: Table, hframe: Machine, tmp_path: Path) -> None:
    command = {("n [rpm]" if c == "v1_V" else c): (v * 100 if c == "v1_V" else v) for c, v in table.items()}
    run = convert(in_text(text_of)(tmp_path, command), hframe, columns={"v1_V": "n"}, scales={"v1_V": 0.01})
    np.testing.assert_allclose(run.inputs[:, 0], table["v1_V"], atol=1e-12)


@pytest.mark.parametrize(
    ("header", "factor", "remark"),
    [("x [mm]", 1e8, "mm to m"), ("x [m/s]", 1e6, "speed in m/s, integrated from 0; an offset")],
)
def test_values_that_do_not_fit_the_unit_in_the_log_are_suspect(
    header: str, factor: float, remark: str, table: Table, hframe: Machine, tmp_path: Path
) -> None:
    values = {(header if c == "x_m" else c): (v * factor if c == "x_m" else v) for c, v in table.items()}
    with pytest.raises(InputError) as error:
        convert(in_text(text_of)(tmp_path, values), hframe, columns={"x_m": "x"})
    text = str(error.value)
    assert (
        "cannot be m. The values in the log are suspect; check them, or correct their unit by --unit x_m="
        in text
    )
    assert f"--scale x_m=FACTOR: x_m is the column '{header}' ({remark}" in text
    assert "millimeters" not in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"columns": {"x_m": "Pos Y"}},
            "--map 'x_m=Pos Y': there is no such column; .*If x_m was not measured, add --map x_m=none",
        ),
        (
            {"columns": {"x_m": "Pos X", "y_m": "Pos X"}},
            "--map 'x_m=Pos X' --map 'y_m=Pos X': one column .*If y_m was not measured, add --map y_m=none",
        ),
        (
            {"columns": {"x_m": "At"}},
            "column At: contains dates or times of day; x_m needs numbers. Map another .*add --map x_m=none",
        ),
        ({"columns": {"v1_V": "Pos Y"}}, r"--map 'v1_V=Pos Y': there is no such column; [^.]*$"),
        ({}, "no column is named like x_m.*--map 'x_m=Pos X'"),
        ({"columns": {"time_s": "time_s,x a"}}, "--map 'time_s=x a': there is no such column"),
    ],
)
def test_options_in_messages_can_be_pasted_into_a_shell(
    options: dict[str, dict[str, object]], message: str, table: Table, hframe: Machine, tmp_path: Path
) -> None:
    lines = text_of(renamed(x_m="Pos X")(table)).split("\n")[:-1]
    rows = [f"{line},2024-05-01T12:00:00" for line in lines[1:]]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([f"{lines[0]},At", *rows]))
    with pytest.raises(InputError) as error:
        convert(path, hframe, **options)
    assert re.search(message, str(error.value).removeprefix(str(path)))


def test_the_time_of_a_column_is_the_nearest_one_to_its_left_in_any_order_of_the_option(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    slow = np.round(np.linspace(0, table["time_s"][-1], 300), 9) * 0.5
    columns = {
        "time_s": table["time_s"],
        **{c: table[c] for c in PLAIN[1:6]},
        "t2": slow,
        "y_m": table["y_m"],
    }
    path = in_text(text_of)(tmp_path, columns)
    lines: list[str] = []
    run = convert(path, hframe, lines=lines, columns={"time_s": "t2,time_s"})
    assert any("several columns of time, merged" in line for line in lines)
    at = np.searchsorted(run.time_s, slow[1::2])
    np.testing.assert_array_equal(run.outputs[at, 3], table["y_m"][1::2])


def test_a_wrong_unit_error_can_be_pickled() -> None:
    error = WrongUnitError("a.csv: too large", ("x_m", "y_m"), "mm")
    copy = pickle.loads(pickle.dumps(error))
    assert str(copy) == str(error) == "a.csv: too large; are they in millimeters?"
    assert (copy.problem, copy.channels, copy.unit) == (error.problem, error.channels, error.unit)


def test_a_log_without_a_voltage_says_that_it_must_be_recorded(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    path = in_text(text_of)(tmp_path, {c: v for c, v in table.items() if c != "v2_V"})
    with pytest.raises(InputError, match=r"Not assigned: none.*No column is unassigned, but v2_V has none"):
        convert(path, hframe)


def test_a_log_without_times_is_imported_at_a_stated_rate(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    values = {channel: column for channel, column in table.items() if channel != "time_s"}
    path = in_text(text_of)(tmp_path, values)
    with pytest.raises(
        InputError, match=r"Check and add: --map time_s=200Hz; no column is a time, so state the rate"
    ):
        convert(path, hframe)
    lines: list[str] = []
    assert_equal(convert(path, hframe, lines=lines, columns={"time_s": "1 kHz"}), table)
    assert "row number at 1 kHz row number - time_s (to s)" in squeezed(lines)
    savemat(tmp_path / "rates.mat", values | {"y_m": table["y_m"][::5]})
    with pytest.raises(
        InputError, match=r"rates.mat: the columns have different numbers of rows .*y_m has 60"
    ):
        convert(tmp_path / "rates.mat", hframe, columns={"time_s": "1000Hz"})


def test_a_counter_of_rows_is_proposed_only_with_a_rate(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    values = {"M1_sequence_number": np.arange(len(table["time_s"]))}
    values |= {channel: column for channel, column in table.items() if channel != "time_s"}
    path = in_text(text_of)(tmp_path, values)
    advice = r"Check and add: --map time_s=200Hz; .* --map time_s=M1_sequence_number --unit time_s=200Hz"
    with pytest.raises(InputError, match=advice):
        convert(path, hframe)
    run = convert(path, hframe, columns={"time_s": "M1_sequence_number"}, units={"time_s": "1kHz"})
    assert_equal(run, table)


def test_a_speed_is_integrated_to_a_position_only_where_its_unit_is_stated(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    speed = np.gradient(table["phi1_rad"], table["time_s"])  # rad/s
    logged = {c: v for c, v in table.items() if c != "phi1_rad"} | {"phi1 [rpm]": speed * 30 / np.pi}
    logged["phi1 [rpm]"][7] = np.nan
    path = in_text(text_of)(tmp_path, logged)
    with pytest.raises(InputError, match=r"no column is named like phi1_rad.*--map 'phi1_rad=phi1 \[rpm\]'"):
        convert(path, hframe)
    with pytest.raises(
        InputError, match=r"rpm is a speed, not an angle. Add --unit phi1_rad=rpm to integrate it"
    ):
        convert(path, hframe, columns={"phi1_rad": "phi1"}, scales={"phi1_rad": 0.1})
    lines: list[str] = []
    run = convert(path, hframe, columns={"phi1_rad": "phi1"}, lines=lines)
    taken = "phi1 [rpm] angular speed rpm phi1_rad (speed in rpm, integrated from 0; an offset of the speed"
    assert taken in squeezed(lines)
    expected = table["phi1_rad"] - table["phi1_rad"][0]
    assert np.isnan(run.outputs[7, 0])
    np.testing.assert_allclose(
        np.delete(run.outputs[:, 0], 7), np.delete(expected, 7), atol=2e-3 * np.ptp(expected)
    )


def test_an_output_without_a_column_must_be_declared_unless_no_column_is_left(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    del table["y_m"]
    lines: list[str] = []
    run = convert(in_text(text_of)(tmp_path, table), hframe, lines=lines)
    assert np.isnan(run.outputs[:, 3]).all()
    assert "none - - y_m (not measured: the cells stay empty)" in squeezed(lines)
    (tmp_path / "again").mkdir()
    path = in_text(text_of)(tmp_path / "again", table | {"force": table["x_m"]})
    with pytest.raises(InputError, match=r"no column is named like y_m.*y_m=none, if it was not measured"):
        convert(path, hframe)
    run = convert(path, hframe, columns={"y_m": "none"})
    assert np.isnan(run.outputs[:, 3]).all()


@pytest.mark.parametrize(
    ("header", "options", "message"),
    [
        (
            "Time,T,v1,v2,phi1,phi2,x,y",
            {},
            "several columns may be the time .Time, T.: add --map time_s=Time or",
        ),
        ("time_s,v1,v2,phi1,phi2,x [m],x [mm],y", {}, r"x_m may be x \[m\], x \[mm\]"),
        (
            "time_s,v1,v2,phi1,phi2,x [inc],z,y",
            {},
            "column x .inc.: 'inc' is not a unit of x_m; state it by --unit x_m=",
        ),
        (
            "time_s,v1,v2,phi1 [counts],phi2,x,z,y",
            {},
            r"--scale phi1_rad=FACTOR \(FACTOR is 0.000519993 if a count is the declared resolution\)",
        ),
        (
            "time_s,v1,v2,phi1 [Inkremente],phi2,x,z,y",
            {},
            r"'Inkremente' is not a unit of phi1_rad; .* \(FACTOR is 0.000519993 if a count is",
        ),
        (
            "time_s,v1,v2,phi1 [ticks],phi2,x,z,y",
            {},
            r"'ticks' is not a unit of phi1_rad; .* \(FACTOR is 0.000519993 if a count is",
        ),
        ("time_s,v1,v2,n1 (steps),phi2,x,z,y", {}, r"Check and add: --map 'phi1_rad=n1 \(steps\)'"),
        (  # counts are nearer to an angle than a speed, which would be integrated
            "time_s,v1,v2,n [rpm],phi2,x,Encoder 1 [Inkremente],y",
            {},
            r"Check and add: --map 'phi1_rad=Encoder 1 \[Inkremente\]'",
        ),
        (
            "time_s,v1,v2,phi1,phi2,x,z,y",
            {"columns": {"x_m": "z", "y_m": "z"}},
            "--map x_m=z --map y_m=z: one column cannot be two measurements",
        ),
        ("time_s,v1,v2,phi1 [mm],phi2,x,z,y", {}, "'mm' is not a unit of phi1_rad"),
        (
            "time_s,v1,v2,phi1,phi2,x,z,y",
            {"columns": {"x_m": "w"}},
            "--map x_m=w: there is no such column; the col",
        ),
        (
            "time_s,v1,v2,phi1,phi2,x,z,y",
            {"columns": {"u_V": "z"}},
            "--map u_V=...: no such channel. Machine 'hframe'",
        ),
        (
            "time_s,v1,v2,phi1,phi2,x,z,y",
            {"columns": {"v1_V": "none"}},
            "--map v1_V=none: only outputs may be left out",
        ),
        ("time_s,v1,v2,phi1,phi2,x,z,y", {"units": {"x_m": "inc"}}, "'inc' is not a unit of x_m"),
    ],
)
def test_an_ambiguous_or_impossible_mapping_is_refused(
    header: str, options: dict[str, dict[str, object]], message: str, hframe: Machine, tmp_path: Path
) -> None:
    rows = [f"{0.001 * i:.3f}," + ",".join(["0.0"] * 7) for i in range(20)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([header, *rows]))
    with pytest.raises(InputError, match=message):
        convert(path, hframe, **options)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (
            lambda t: "\n".join(
                line[:30] if k % 5 == 4 else line for k, line in enumerate(text_of(t).split("\n"))
            ),
            r"row \d+: \d cells under 7 columns, and \d+ more such rows; is the row cut off\?; up to a tenth",
        ),
        (
            lambda t: text_of(t).replace("time_s,", "", 1),
            r"the rows have 7 cells under 6 names \(v1_V, .*, y_m\); complete the header",
        ),
        (lambda t: with_line(t, 40, "0.0385,1,2,a,1,1,1"), "row 40, column phi1_rad: 'a' is not a number"),
        (
            lambda t: with_line(t, 40, "0.0005,1,2,1,1,1,1"),
            "row 40, column time_s: 0.0005 goes back.*wrong order",
        ),
        (
            lambda t: text_of(t, ";", ",").replace("0,04;", "1.000,04;"),
            "row 41, column time_s: '1.000,04' is not a number; "
            "export it without marks that separate thousands",
        ),
        (
            lambda t: text_of(t).replace("\n0.0", "\nMay 1 0:00:0"),
            "column time_s: 'May 1 0:00:0' is not .*dates and times",
        ),
        (
            lambda t: text_of(t, ",", ","),
            "rows have 14 cells under 7 names; if commas are also decimal marks",
        ),
        (
            lambda t: text_of({("t" if c == "time_s" else c): v * 1000 for c, v in t.items()}),
            "has no unit and steps of 1",
        ),
        (
            lambda t: text_of(t | {"x_m": t["x_m"] * 1e5}),
            "column x_m: .* cannot be m; is the column in millimeters. "
            "If so, add --unit x_m=mm: x_m is the col",
        ),
    ],
)
def test_an_invalid_log_is_refused_and_nothing_is_written(
    edit: Callable[[Table], str], message: str, table: Table, hframe: Machine, tmp_path: Path
) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "a.csv").write_text(text_of(table))
    (tmp_path / "logs" / "b.csv").write_text(edit(table))
    with pytest.raises(InputError, match=message):
        import_logs(tmp_path / "logs", tmp_path / "runs", hframe, log=lambda line: None)
    assert {path.name for path in tmp_path.iterdir()} == {"logs"}


def test_existing_runs_are_not_replaced(table: Table, hframe: Machine, tmp_path: Path) -> None:
    path = in_text(text_of)(tmp_path, table)
    convert(path, hframe)
    before = (tmp_path / "runs" / "log.csv.gz").read_bytes()
    with pytest.raises(InputError, match="the run 'log' exists; choose another --out or delete it"):
        import_logs(path, tmp_path / "runs", hframe, ImportSettings(run_format="csv"), log=lambda line: None)
    assert [p.name for p in (tmp_path / "runs").iterdir()] == ["log.csv.gz"]
    assert (tmp_path / "runs" / "log.csv.gz").read_bytes() == before
    path.rename(tmp_path / "other.txt")
    import_logs(tmp_path / "other.txt", tmp_path / "runs", hframe, log=lambda line: None)
    assert sorted(p.name for p in (tmp_path / "runs").iterdir()) == ["log.csv.gz", "other.csv.gz"]


def test_runs_of_an_earlier_import_of_the_same_log_are_told(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    path = in_text(text_of)(tmp_path, table)
    convert(path, hframe)
    (tmp_path / "runs" / "logbook.csv.gz").write_bytes((tmp_path / "runs" / "log.csv.gz").read_bytes())
    lines: list[str] = []
    import_logs(path, tmp_path / "runs", hframe, ImportSettings(every=0.5), log=lines.append)
    assert lines[-1].endswith(
        "has runs of these logs from before (log): delete them unless they are other recordings"
    )


@pytest.mark.parametrize(
    ("header", "per_rad", "modulus", "options", "what"),
    [
        ("phi1 [deg]", 180 / np.pi, 360.0, {}, "one turn in degrees"),
        ("phi1 [turns]", 0.5 / np.pi, 1.0, {}, "one turn in turns"),
        ("phi1_rad", 1.0, 2 * np.pi, {}, "one turn"),
        ("phi1", 5000.0, 65536, {"scales": {"phi1_rad": 1 / 5000.0}}, "a counter of 16 bits"),
        ("phi1", 4096 / 2 / np.pi, 4096, {"scales": {"phi1_rad": 2 * np.pi / 4096}}, "a counter of 12 bits"),
    ],
)
def test_an_angle_or_counter_that_starts_anew_is_made_continuous(
    header: str,
    per_rad: float,
    modulus: float,
    options: dict[str, dict[str, object]],
    what: str,
    tmp_path: Path,
) -> None:
    machine = BUILTIN_MACHINES["hframe"]()
    time_s = np.arange(2000) * 1e-3
    angle = 12.0 * np.sin(2 * np.pi * time_s) + 3.0
    raw = angle * per_rad
    raw = (np.rint(raw) if modulus > 360 else raw) % modulus
    columns = {"time_s": time_s, "v1_V": np.sin(time_s), "v2_V": np.cos(time_s), header: raw}
    columns |= {"phi2_rad": 0.0 * time_s, "x_m": 0.0 * time_s, "y_m": 0.0 * time_s}
    lines: list[str] = []
    run = convert(in_text(text_of)(tmp_path, columns), machine, lines=lines, **options)
    moved = run.outputs[:, 0] - run.outputs[0, 0]
    np.testing.assert_allclose(moved, angle - angle[0], atol=1.0 / per_rad if modulus > 360 else 1e-9)
    assert re.search(rf"phi1_rad: starts anew after {what}, made continuous \(\d+ jumps\)", "\n".join(lines))


def test_a_percentage_that_never_exceeds_one_is_doubted(
    table: Table, hframe: Machine, tmp_path: Path
) -> None:
    logged = {("v1 [%]" if c == "v1_V" else c): (v / 12 if c == "v1_V" else v) for c, v in table.items()}
    lines: list[str] = []
    convert(in_text(text_of)(tmp_path, logged), hframe, lines=lines)
    assert "  v1_V: never exceeds 1 %; if 1 is full, add --unit v1_V=pu" in lines
    (tmp_path / "again").mkdir()
    run = convert(in_text(text_of)(tmp_path / "again", logged), hframe, lines=lines, units={"v1_V": "pu"})
    np.testing.assert_allclose(run.inputs[:, 0], table["v1_V"], atol=1e-12)


def test_a_log_of_many_columns_gets_a_short_table(table: Table, hframe: Machine, tmp_path: Path) -> None:
    lines: list[str] = []
    path = in_text(text_of)(tmp_path, table | {f"extra{k}": table["x_m"] for k in range(30)})
    convert(path, hframe, lines=lines)
    assert sum(line.endswith("not used") for line in lines) == 20
    assert any(line.startswith("  and 10 more that are not used: extra20, extra21") for line in lines)


@pytest.fixture
def session(axis: Machine) -> tuple[Recording, np.ndarray]:
    """Return a log of four moves with rests of 1, 2, 0.2, 1 and 0.7 s, and the times of their edges."""
    edges = np.cumsum([1.0, 1.5, 2.0, 1.5, 0.2, 1.5, 1.0, 1.5, 0.7])
    time_s = np.arange(round(edges[-1] * 1000)) * 1e-3
    interval = np.searchsorted(edges, time_s, "right")
    phase = time_s - np.concatenate([[0.0], edges])[interval]
    voltage = np.where(interval % 2 == 1, 6 * np.sin(2 * np.pi * phase / 0.5), 0.0)
    outputs = axis.simulate(time_s, voltage[:, None]).outputs
    outputs += np.random.default_rng(0).normal(0, axis.sensors[0].noise, outputs.shape)
    return Recording("log", time_s, voltage[:, None], outputs), edges


def test_a_long_log_is_cut_where_the_machine_rests(
    session: tuple[Recording, np.ndarray], axis: Machine, tmp_path: Path
) -> None:
    recording, edges = session
    write_recording(tmp_path / "log.csv", recording, axis)
    lines: list[str] = []
    settings = ImportSettings(split=True, min_rest=0.5)
    import_logs(tmp_path / "log.csv", tmp_path / "runs", axis, settings, lines.append)
    runs = load_recordings(tmp_path / "runs", axis)
    assert [run.name for run in runs] == ["log_01", "log_02", "log_03"]
    assert any("cut at rests of 0.5 s and more: 3 runs of" in line for line in lines)
    # The rest of 0.2 s is too short.
    moves = [(edges[0], edges[1]), (edges[2], edges[5]), (edges[6], edges[7])]
    for run, (start, stop) in zip(runs, moves, strict=True):
        assert start - 0.52 < run.time_s[0] < start - 0.4
        assert stop + 0.45 < run.time_s[-1] < stop + 0.75  # the carriage coasts for 0.2 s
        rows = np.isin(recording.time_s, run.time_s)
        np.testing.assert_array_equal(run.outputs, recording.outputs[rows])
        np.testing.assert_array_equal(run.inputs, recording.inputs[rows])
    import_logs(
        tmp_path / "log.csv", tmp_path / "fine", axis, ImportSettings(split=True, min_rest=0.02), lines.append
    )
    assert len(list((tmp_path / "fine").iterdir())) == 4


def test_a_long_log_without_rests_is_cut_into_runs_of_equal_duration(
    session: tuple[Recording, np.ndarray], axis: Machine, tmp_path: Path
) -> None:
    recording, _ = session
    write_recording(tmp_path / "log.csv", recording, axis)
    lines: list[str] = []
    import_logs(tmp_path / "log.csv", tmp_path / "runs", axis, ImportSettings(every=2.0), lines.append)
    runs = load_recordings(tmp_path / "runs", axis)
    assert len(runs) == round(recording.time_s[-1] / 2.0)
    assert runs[1].name == "log_02"
    np.testing.assert_array_equal(np.concatenate([run.outputs for run in runs]), recording.outputs)
    assert any("which may begin in motion" in line for line in lines)
    with pytest.raises(InputError, match="exclude each other"):
        import_logs(tmp_path / "log.csv", tmp_path / "both", axis, ImportSettings(split=True, every=2.0))


def test_a_log_that_begins_in_motion_loses_its_beginning(
    session: tuple[Recording, np.ndarray], axis: Machine, tmp_path: Path
) -> None:
    recording, edges = session
    rows = slice(1500, 6500)  # from the first move into the third
    cut = dataclasses.replace(
        recording,
        time_s=recording.time_s[rows],
        inputs=recording.inputs[rows],
        outputs=recording.outputs[rows],
    )
    runs, remarks = split_at_rests(cut, axis, 0.5)
    assert [run.name for run in runs] == ["log_01"]
    assert runs[0].time_s[0] > edges[1]
    assert any("left out, they do not begin at rest" in remark for remark in remarks)
    assert any("does not end at rest" in remark for remark in remarks)


def test_a_long_rest_at_either_end_is_left_out(session: tuple[Recording, np.ndarray], axis: Machine) -> None:
    recording, edges = session
    rest = np.zeros(5000, np.int64)
    rows = np.concatenate([rest, np.arange(len(recording.time_s)), rest + len(recording.time_s) - 1])
    longer = Recording("log", np.arange(len(rows)) * 1e-3, recording.inputs[rows], recording.outputs[rows])
    runs, _ = split_at_rests(longer, axis, 0.5)
    assert len(runs) == 3
    assert 5.0 + edges[0] - 0.52 < runs[0].time_s[0] < 5.0 + edges[0] - 0.4
    assert 5.0 + edges[7] + 0.45 < runs[-1].time_s[-1] < 5.0 + edges[7] + 0.75


def test_a_log_that_rests_only_at_its_end_has_no_run(
    session: tuple[Recording, np.ndarray], axis: Machine
) -> None:
    recording, _ = session
    rows = slice(1500, 4000)  # from the first move into the rest after it
    part = Recording("log", recording.time_s[rows], recording.inputs[rows], recording.outputs[rows])
    with pytest.raises(InputError, match="rests only at its end, so no run begins at rest"):
        split_at_rests(part, axis, 0.5)


def test_a_log_without_rests_or_without_motion_cannot_be_cut(
    session: tuple[Recording, np.ndarray], axis: Machine
) -> None:
    recording, _ = session
    for rows, message in ((slice(1100, 2400), "nothing rests for 0.5 s"), (slice(0, 900), "nothing moves")):
        part = Recording("log", recording.time_s[rows], recording.inputs[rows], recording.outputs[rows])
        with pytest.raises(InputError, match=message):
            split_at_rests(part, axis, 0.5)


@pytest.mark.parametrize("ending", ["toml", "json"])
def test_a_mapping_file_states_columns_units_and_factors(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"map.{ending}"
    toml = '[map]\nv1_V = "U1"\n[unit]\nphi1_rad = "deg"\n[scale]\nx_m = 0.001\n'
    path.write_text(toml if ending == "toml" else json.dumps(tomllib.loads(toml)))
    assert read_mapping_file(path) == MappingOptions({"v1_V": "U1"}, {"phi1_rad": "deg"}, {"x_m": 0.001})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[map\n", "is not a valid TOML file"),
        (
            "[columns]\nv1_V = 'U1'\n",
            "columns: unknown table; a mapping file may have map, unit and scale, each with",
        ),
        ("map = 'U1'\n", "map: not a table; a mapping file may have map, unit and scale"),
        ("[scale]\nx_m = 'mm'\n", "scale.x_m: 'mm' is not a factor"),
        ("[scale]\nx_m = 0\n", "scale.x_m: 0 is not a factor"),
        ("[scale]\nx_m = true\n", "scale.x_m: True is not a factor"),
    ],
)
def test_an_invalid_mapping_file_is_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_mapping_file(path)
    with pytest.raises(InputError, match="No such file"):
        read_mapping_file(tmp_path / "none.toml")


def test_a_mapping_file_that_is_a_list_is_refused(tmp_path: Path) -> None:
    (tmp_path / "map.json").write_text("[]")
    with pytest.raises(
        InputError, match=r"map.json: has no tables; a mapping file may have map, unit and scale"
    ):
        read_mapping_file(tmp_path / "map.json")


def test_logs_of_the_same_name_and_missing_logs_are_refused(hframe: Machine, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file or folder"):
        import_logs(tmp_path / "none", tmp_path / "runs", hframe)
    with pytest.raises(InputError, match="no logs"):
        import_logs(tmp_path, tmp_path / "runs", hframe)
    for name in ("a.csv", "a.txt"):
        (tmp_path / name).write_text("x")
    with pytest.raises(InputError, match=r"a\.txt: would be the same run 'a' as a\.csv"):
        import_logs(tmp_path, tmp_path / "runs", hframe)


@pytest.mark.parametrize("file", ["test_3.csv", "test_3.csv.gz", "TEST_3.CSV.GZ", "test_3.TXT"])
def test_a_run_has_the_name_of_its_log_without_endings(file: str) -> None:
    assert log_name(Path("logs", file)).lower() == "test_3"


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"duty": "U"}, "describe its drive with the kind voltage and a channel such as u_V"),
        ({"duty": "pwm"}, r"FACTOR is 1 / radius of what rolls, in mm"),
    ],
)
def test_messages_name_the_way_for_a_voltage_at_a_bridge_and_for_a_distance_of_a_wheel(
    tmp_path: Path, columns: dict[str, str], message: str
) -> None:
    (tmp_path / "log.csv").write_text("t [s],U [V],pwm [%],x [mm]\n0,0,0,0\n0.1,1,20,1\n0.2,1,20,3\n")
    settings = ImportSettings(MappingOptions({**columns, "wheel_rad": "x"}))
    with pytest.raises(InputError, match=message):
        import_logs(tmp_path / "log.csv", tmp_path / "runs", BUILTIN_MACHINES["wheel"](), settings)


def test_a_speed_is_proposed_for_the_speed_and_not_for_the_position_beside_it(tmp_path: Path) -> None:
    """A position may be an integrated speed, but not where the machine has a sensor of the speed as well."""
    axis = BUILTIN_MACHINES["axis"]()
    both = axis.replace(sensors=(*axis.sensors, Sensor("x_m_s", {"x": 1.0}, noise=0.0, kind="speed")))
    path = tmp_path / "log.csv"
    path.write_text("time_s,Input,Velo\n" + "".join(f"{k / 100},1,{k}\n" for k in range(30)))
    with pytest.raises(InputError, match=r"--map x_m=COLUMN --map x_m_s=Velo "):
        import_logs(path, tmp_path / "runs", both)


def test_a_log_without_rows_is_left_out_of_a_folder(table: Table, hframe: Machine, tmp_path: Path) -> None:
    folder, lines = tmp_path / "logs", list[str]()
    folder.mkdir()
    (folder / "a.csv").write_text(text_of(table))
    (folder / "b.csv").write_text(",".join(table) + "\n")
    files = import_logs(folder, tmp_path / "runs", hframe, log=lines.append)
    assert [file.name for file in files] == ["a.csv.gz"]
    assert "  left out: no rows below the header" in lines
    with pytest.raises(InputError, match=r"b\.csv: no rows below the header"):
        import_logs(folder / "b.csv", tmp_path / "other", hframe, log=lines.append)
    (folder / "a.csv").write_text(",".join(table) + "\n")
    with pytest.raises(InputError, match=r"none of its 2 logs has rows"):
        import_logs(folder, tmp_path / "other", hframe, log=lines.append)


def test_several_logs_are_imported_together(table: Table, hframe: Machine, tmp_path: Path) -> None:
    """As a shell writes them for *.csv; two that would give one run are refused, and nothing is written."""
    logs = [tmp_path / "a.csv", tmp_path / "more" / "b.csv"]
    for log in logs:
        log.parent.mkdir(exist_ok=True)
        log.write_text(text_of(table))
    files = import_logs([logs[0], tmp_path / "more"], tmp_path / "runs", hframe, log=lambda line: None)
    assert [file.name for file in files] == ["a.csv.gz", "b.csv.gz"]
    (tmp_path / "more" / "a.csv").write_text(text_of(table))
    with pytest.raises(InputError, match=r"another log has given the run 'a'"):
        import_logs([logs[0], tmp_path / "more"], tmp_path / "other", hframe, log=lambda line: None)
    assert not (tmp_path / "other").exists() or not list((tmp_path / "other").iterdir())


@pytest.mark.parametrize("option", ["units", "scales"])
def test_current_may_also_mean_the_present_value(option: str, tmp_path: Path) -> None:
    speed = Sensor("shaft_rad_s", {"shaft": 1.0}, kind="speed")
    motor = BUILTIN_MACHINES["motor"]().replace(sensors=(speed,))
    rows = "\n".join(f"{k * 1e-3:g},{k % 7},{k}" for k in range(40))
    (tmp_path / "log.csv").write_text(f"time,volts,CURRENT_M1\n{rows}\n")
    columns: dict[str, object] = {"v_V": "volts", "shaft_rad_s": "CURRENT_M1"}
    with pytest.raises(InputError, match=r"or state the unit by --unit shaft_rad_s=UNIT"):
        convert(tmp_path / "log.csv", motor, columns=columns)
    stated: dict[str, object] = {"shaft_rad_s": "rad/s" if option == "units" else 1.0}
    run = convert(tmp_path / "log.csv", motor, columns=columns, **{option: stated})
    np.testing.assert_array_equal(run.outputs[:, 0], np.arange(40.0))
