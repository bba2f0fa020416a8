"""Logs of controllers, loggers and oscilloscopes are read with names, units and values."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.recordings.logs.log import Log
from hframe_gym.recordings.logs.log_files import open_logs
from hframe_gym.recordings.tables.text_format import detect_format

TIME = np.arange(30) * 1e-3
VOLTAGE = np.where(TIME < 5e-3, 0.0, 3.0)
POSITION = np.round(1e-4 * np.cumsum(VOLTAGE), 7)


def rows(separator: str, form: str = "{:.7g}", end: str = "", first: np.ndarray = TIME) -> str:
    """Return three columns as text."""
    columns = zip(first, VOLTAGE, POSITION, strict=True)
    return "".join(separator.join(map(form.format, row)) + end + "\n" for row in columns)


def plotted(separator: str, colon: str) -> str:
    """Return rows as Arduino's serial plotter reads them, with a name before each number."""
    return "".join(
        separator.join(f"{name}{colon}{value:.7g}" for name, value in zip(("t", "u", "x"), row, strict=True))
        + "\n"
        for row in zip(TIME, VOLTAGE, POSITION, strict=True)
    )


ODRIVE = "%Motor data\r\n%Timestep increments at 8kHz\r\n\r\n%Operator:\r\n%Date:,29/04/2021\r\n\r\n"
ODRIVE_NAMES = "%timestep (8Hz),voltage,position\r\n%[#],[V],[turns]\r\n"
LABVIEW = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t.
X_Columns\tOne
Date\t2024/05/01
Time\t12:00:00.1234
***End_of_Header***\t
\t
Channels\t2\t\t
Samples\t30\t30\t
Date\t2024/05/01\t2024/05/01\t
Time\t12:00:00.12\t12:00:00.12\t
Y_Unit_Label\tVolts\tmm\t
X_Dimension\tTime\tTime\t
X0\t0.0000000000000000E+0\t0.0000000000000000E+0\t
Delta_X\t0.001000\t0.001000\t
***End_of_Header***\t\t\t
X_Value\tVoltage\tPosition\tComment
"""
TEKTRONIX = """Model,MDO3024
Firmware Version,1.26

Waveform Type,ANALOG,
Point Format,Y,
Horizontal Units,s,
Sample Interval,4e-08,
Record Length,30,
Probe Attenuation,10,10
Vertical Units,V,V
Label,,
TIME,CH1,CH2
"""
RIGOL_OLD = "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-1.200000e-02,1.000000e-03\n"


@dataclass(frozen=True)
class Dialect:
    """Text of a log, and the names and units of its columns as understood; values are those above."""

    text: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    remark: str = ""


DIALECTS = {
    "ODrive, rows end with ;": Dialect(
        ODRIVE + ODRIVE_NAMES + rows(",", end=";").replace("\n", "\r\n"),
        ("timestep", "voltage", "position"),
        ("#", "V", "rev"),
        "rows end with semicolons",
    ),
    "ODrive, first rows nan": Dialect(
        ODRIVE + ODRIVE_NAMES + "nan,nan,nan;\r\n" * 5 + rows(",", end=";").replace("\n", "\r\n"),
        ("timestep", "voltage", "position"),
        ("#", "V", "rev"),
        "a row of units is below the header in a comment line",
    ),
    "Klipper": Dialect(
        "#time,u,x\n" + rows(","), ("time", "u", "x"), ("", "", ""), "the header is in a comment line"
    ),
    "SimpleFOC": Dialect(
        "Target\tVoltage q\tAngle\n" + rows("\t"), ("Target", "Voltage q", "Angle"), ("", "", "")
    ),
    "serial plotter, commas": Dialect(plotted(",", ":"), ("t", "u", "x"), ("", "", ""), "name of its column"),
    "serial plotter, tabs": Dialect(plotted("\t", ":"), ("t", "u", "x"), ("", "", ""), "name of its column"),
    "serial plotter, blanks": Dialect(
        plotted(" ", ": "), ("t", "u", "x"), ("", "", ""), "name of its column"
    ),
    "names with equals signs": Dialect(
        plotted(" ", "="), ("t", "u", "x"), ("", "", ""), "name of its column"
    ),
    "names with blanks around equals signs": Dialect(
        plotted(", ", " = "), ("t", "u", "x"), ("", "", ""), "name of its column"
    ),
    "commas and tabs": Dialect(
        "Zeit in s, U in V\tx in mm\n"
        + "".join("{}, {} \t{}\n".format(*row.split(",")) for row in rows(",").splitlines()),
        ("Zeit", "U", "x"),
        ("s", "V", "mm"),
        "different separators",
    ),
    "semicolons and blanks": Dialect(
        "".join("{}; {} {}\n".format(*row.split(",")) for row in rows(",").splitlines()),
        ("#1", "#2", "#3"),
        ("", "", ""),
        "different separators",
    ),
    "lists": Dialect(
        "".join(f"[{row}]\n" for row in rows(" ").splitlines()),
        ("#1", "#2", "#3"),
        ("", "", ""),
        "brackets enclose the rows",
    ),
    "lists after a name": Dialect(
        "Ready\n" + "".join(f"log=[{row}]\n" for row in rows(", ").splitlines()),
        ("#1", "#2", "#3"),
        ("", "", ""),
        "brackets enclose the rows",
    ),
    "MATLAB": Dialect("% time u x\n" + rows("   ", "{: .7e}"), ("time", "u", "x"), ("", "", "")),
    "NumPy": Dialect("# t [s], u [V], x [mm]\n" + rows(" ", "{:.9e}"), ("t", "u", "x"), ("s", "V", "mm")),
    "LabVIEW": Dialect(LABVIEW + rows("\t"), ("X_Value", "Voltage", "Position"), ("", "", "")),
    "LabVIEW, German": Dialect(
        LABVIEW + rows("\t").replace(".", ","),
        ("X_Value", "Voltage", "Position"),
        ("", "", ""),
        "decimal commas",
    ),
    "LabVIEW, column of comments": Dialect(
        LABVIEW + rows("\t", end="\t"), ("X_Value", "Voltage", "Position"), ("", "", "")
    ),
    "PicoScope": Dialect(
        "Time,Channel A,Channel B\r\n(µs),(V),(mV)\r\n\r\n" + rows(",").replace("\n", "\r\n"),
        ("Time", "Channel A", "Channel B"),
        ("us", "V", "mV"),
        "a row of units is below the header",
    ),
    "Saleae": Dialect(
        "Time [s],Channel 0,Channel 1\n" + rows(","), ("Time", "Channel 0", "Channel 1"), ("s", "", "")
    ),
    "Tektronix": Dialect(
        TEKTRONIX + rows(","), ("TIME", "CH1", "CH2"), ("", "", ""), "other lines are above"
    ),
    "Rigol": Dialect(
        "Time(s),CH1(V),CH2(V),t0 =-1.2e-02, tInc = 1e-05,\n" + rows(",", end=","),
        ("Time", "CH1", "CH2"),
        ("s", "V", "V"),
    ),
    "Rigol, old": Dialect(RIGOL_OLD + rows(",", end=","), ("X", "CH1", "CH2"), ("Sequence", "V", "V")),
    "Siglent": Dialect(
        "Source,CH1,CH2\nSecond,Volt,Volt\n" + rows(","), ("Source", "CH1", "CH2"), ("s", "V", "V")
    ),
    "units above the names": Dialect(
        "s,V,mm\ntime,u,x\n" + rows(","),
        ("time", "u", "x"),
        ("s", "V", "mm"),
        "a row of units is above the header",
    ),
    "units in a comment below the names": Dialect(
        "time,u,x\n# s,V,mm\n" + rows(","),
        ("time", "u", "x"),
        ("s", "V", "mm"),
        "below the header in a comment line",
    ),
    "units without names": Dialect(
        "[s],[V],[mm]\n" + rows(","), ("#1", "#2", "#3"), ("s", "V", "mm"), "a row of units is above the data"
    ),
    "German": Dialect(
        "Zeit in s;Motorspannung in V;Sollweg in mm\n" + rows(";").replace(".", ","),
        ("Zeit", "Motorspannung", "Sollweg"),
        ("s", "V", "mm"),
    ),
    "names before the numbers, commas": Dialect(
        "PuTTY log 2018.05.08\n" + plotted(",", ",") + "t,0.0",
        ("t", "u", "x"),
        ("", "", ""),
        "name of its column",
    ),
    "names before the numbers, blanks": Dialect(plotted(" ", " "), ("t", "u", "x"), ("", "", "")),
    "ECP": Dialect(
        " Sample   Time     Control Effort\n\n[" + rows("  ", end=";")[:-2] + "]\n",
        ("Sample", "Time", "Control Effort"),
        ("", "", ""),
        "brackets enclose the rows",
    ),
    "a sampling period for each column": Dialect(
        "Temps;Tension;Position\nT1.CRB;U1.CRB;P1.CRB\n3,978;3,978;3,978\ns;V;deg.\n"
        + rows(";").replace(".", ","),
        ("T1.CRB", "U1.CRB", "P1.CRB"),
        ("s", "V", "deg"),
        "a row of units is below the header",
    ),
    "settings below the data": Dialect(
        "Temps;Courant;Vitesse\nms;mA;tr/min\n"
        + rows(";").replace(".", ",")
        + "\nParamètre AXE :;1\nVitesse :;3000;0\nSécurité\nPosition :;2420;8340\n",
        ("Temps", "Courant", "Vitesse"),
        ("ms", "mA", "rpm"),
    ),
    "forty rows of nan": Dialect("t,u,x\n" + "nan,nan,nan\n" * 40 + rows(","), ("t", "u", "x"), ("", "", "")),
}


def opened(folder: Path, text: str) -> Log:
    """Write a text to a file and open it."""
    (folder / "log.txt").write_bytes(text.encode())
    (log,) = open_logs(folder / "log.txt")
    return log


@pytest.mark.parametrize("name", DIALECTS)
def test_a_log_of_a_dialect_has_its_names_units_and_values(name: str, tmp_path: Path) -> None:
    dialect = DIALECTS[name]
    log = opened(tmp_path, dialect.text)
    assert tuple(column.name for column in log.columns) == dialect.names
    assert tuple(column.unit for column in log.columns) == dialect.units
    assert dialect.remark in "; ".join(log.remarks)
    values, _ = log.read(log.columns)
    for read, written in zip(values, (TIME, VOLTAGE, POSITION), strict=True):
        np.testing.assert_allclose(read[np.isfinite(read)], written, rtol=1e-6, atol=1e-12)


def test_columns_of_equal_texts_under_a_header_are_no_names(tmp_path: Path) -> None:
    log = opened(tmp_path, "mode,t,status,x\n" + "auto,0.1,ok,1.5\n" * 5)
    assert [column.name for column in log.columns] == ["mode", "t", "status", "x"]


@pytest.mark.parametrize(
    ("below", "said"),
    [
        ("Gains\nposition,2420,8340\n", "2 lines below the data left out"),
        ("\nend\n", "1 line below the data left out"),
        ("x,y\n" * 100, "100 lines below the data left out"),
        ("", ""),
    ],
)
@pytest.mark.parametrize("count", [30, 400_000])
def test_lines_of_text_below_the_data_are_left_out_and_counted(
    below: str, said: str, count: int, tmp_path: Path
) -> None:
    log = opened(tmp_path, "t,u,x\n" + "".join(f"{k},0.25,1.5\n" for k in range(count)) + below)
    values, remarks = log.read(log.columns)
    assert len(values[0]) == count
    assert values[2][-1] == 1.5
    assert "; ".join(remarks) == said


def test_many_lines_of_text_below_few_rows_are_refused(tmp_path: Path) -> None:
    text = "t,u,x\n" + "".join(f"{k},0,1\n" for k in range(30)) + "x,y\n" * 150
    with pytest.raises(InputError, match=r"row 31: 2 cells under 3 columns, and \d\d more such rows, 'x y'"):
        opened(tmp_path, text).read([])


DAMAGE = {
    "cut": ("0.2,1", "row 21 has 2 instead of 3 cells", [0, 1, 2]),
    "two rows in one": ("0.2,1,20.21,2,10.5", "row 21 has 5 instead of 3 cells", [0, 1, 2]),
    "a garbled number": ("0.2,1.2.5,10", "row 21, column u: '1.2.5'", [1]),
    "a byte that is no text": ("0.2,1,1\x815", "row 21, column x: '1\ufffd5'", [2]),
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("separator", [",", " ", ";"])
def test_a_damaged_row_is_read_as_empty_and_named(damage: str, separator: str, tmp_path: Path) -> None:
    line, said, empty = DAMAGE[damage]
    lines = [f"{0.01 * k:.2f},{k % 3},{0.5 * k}" for k in range(50)]
    lines[20] = line
    text = "t,u,x\n" + "\n".join(lines)
    (tmp_path / "log.txt").write_bytes(text.replace(",", separator).encode("latin-1"))
    (log,) = open_logs(tmp_path / "log.txt")
    values, remarks = log.read(log.columns)
    assert said in "; ".join(remarks)
    table = np.array(values)
    assert table.shape == (3, 50)
    rows, columns = np.nonzero(np.isnan(table.T))
    assert set(rows) == {20}
    assert list(columns) == empty
    np.testing.assert_allclose(table[2, 21:], 0.5 * np.arange(21, 50))


@pytest.mark.parametrize("separator", [",", " "])
def test_lines_of_text_among_rows_are_left_out_and_named(separator: str, tmp_path: Path) -> None:
    lines = [f"{0.01 * k:.2f},{k % 3},{0.5 * k}" for k in range(50)]
    lines[40:40] = ["t,u,x"]
    lines[20:20] = ["Motor,is,on"]
    log = opened(tmp_path, "t,u,x\n" + "\n".join(lines).replace(",", separator))
    values, remarks = log.read(log.columns)
    np.testing.assert_allclose(values[2], 0.5 * np.arange(50))
    assert "left out: 'Motor is on' after row 20, 't u x' after row 40" in "; ".join(remarks)


def test_two_damaged_rows_whose_cells_make_up_for_each_other_shift_no_value(tmp_path: Path) -> None:
    lines = [f"{0.01 * k:.2f},{k % 3},{0.5 * k}" for k in range(50)]
    lines[10], lines[20] = "9,0.1,1,5", "0.2,1"
    log = opened(tmp_path, "t,u,x\n" + "\n".join(lines))
    times, _ = log.read(log.columns[:1])
    assert np.flatnonzero(np.isnan(times[0])).tolist() == [10, 20]


@pytest.mark.parametrize("count", [1, 2, 3, 20])
def test_a_short_log_whose_rows_end_with_another_separator_is_read(count: int, tmp_path: Path) -> None:
    text = "".join(rows(",", end=";").splitlines(keepends=True)[:count])
    log = opened(tmp_path, "t,u,x\n" + text)
    values, _ = log.read(log.columns)
    np.testing.assert_allclose(values[0], TIME[:count])
    assert [column.name for column in log.columns] == ["t", "u", "x"]


NAMES = ("time", "voltage", "position", "speed_rpm", "I1", "status word", "x", "Zeit", "Winkel 1", "u_cmd")
UNITS = ("s", "V", "mm", "rpm", "A", "-", "rad", "ms", "deg", "V")
# Lines above the data, from the names, the units and the sign of a comment.
HEADERS = {
    "names": (("{names}",), False),
    "names in quotation marks": (("{quoted}",), False),
    "names in a comment": (("{sign}{names}",), False),
    "names and units in comments": (("{sign}{names}", "{sign}{units}"), True),
    "units and names in comments": (("{sign}{units}", "{sign}{names}"), True),
    "names, then units": (("{names}", "{units}"), True),
    "units, then names": (("{units}", "{names}"), True),
    "names, then units in a comment": (("{names}", "{sign}{units}"), True),
}


@pytest.mark.parametrize("header", HEADERS)
@pytest.mark.parametrize("number", range(40))
def test_tables_of_random_dialects_are_read_as_they_were_written(
    header: str, number: int, tmp_path: Path
) -> None:
    random = np.random.default_rng([number, len(header)])

    def choose(*texts: str) -> str:
        return str(random.choice(texts))

    width, count = int(random.integers(2, 7)), int(random.choice([1, 2, 3, 5, 30, 200]))
    separator, form = choose(",", ";", "\t", " ", "|"), choose("{:.6g}", "{:.4f}", "{:.6e}")
    decimal = choose(".", ",") if separator in ";\t|" else "."
    columns = random.permutation(10)[:width]
    values = random.normal(0.0, random.choice([1e-3, 1.0, 100.0]), (count, width))
    values[:, 0] = np.arange(count) * random.choice([1e-3, 0.1, 1.0, 5.0])
    texts = [[form.format(value) for value in row] for row in values]
    blanks = random.choice([0, 0, 1, 4]) if count > 2 else 0
    lines = [separator.join(["nan"] * width)] * blanks
    lines += [separator.join(row).replace(".", decimal) for row in texts]
    end = choose("", "", "" if separator == " " else separator, "" if separator == ";" else ";")
    sign, bracket = choose("#", "# ", "%", "% ", "//", "##"), choose("{}", "[{}]", "({})")
    names = [NAMES[k].replace(" ", "_" if separator == " " else " ") for k in columns]
    parts = {
        "sign": sign,
        "names": separator.join(names),
        "quoted": separator.join(name if separator == " " else f'"{name}"' for name in names),
        "units": separator.join(bracket.format(UNITS[k]) for k in columns),
    }
    above, has_units = HEADERS[header]
    title = choose(
        "", "Bench 3\n" if separator != " " else "", f"{sign}logger 7, run 3\n", f"{sign}date: 2024\n\n"
    )
    text = title + "\n".join([*(line.format(**parts) for line in above), *(line + end for line in lines)])
    text = (text + choose("", "\n", "\n\n")).replace("\n", choose("\n", "\r\n"))
    (tmp_path / "log.txt").write_bytes(text.encode(choose("utf-8", "utf-8-sig", "utf-16")))
    (log,) = open_logs(tmp_path / "log.txt")
    assert [column.header for column in log.columns] == names
    if has_units:
        assert [column.unit for column in log.columns] == [UNITS[k] for k in columns]
    read = np.column_stack(log.read(log.columns)[0])
    assert np.isnan(read[:blanks]).all()
    np.testing.assert_allclose(read[blanks:], np.array(texts, float), rtol=1e-12)


def assert_read_with_stamps(log: Log) -> None:
    """Check that a log is read as time stamps, voltages and positions."""
    stamps, voltage, position = log.read(log.columns)[0]
    np.testing.assert_allclose((stamps - stamps[0]) / np.timedelta64(1, "s"), TIME)
    np.testing.assert_array_equal(voltage, VOLTAGE)
    np.testing.assert_allclose(position, POSITION)


def test_the_serial_monitor_puts_an_arrow_after_its_time_stamps(tmp_path: Path) -> None:
    text = "".join(
        f"12:00:{t:06.3f} -> {u:.2f},{x:.7f}\n" for t, u, x in zip(TIME, VOLTAGE, POSITION, strict=True)
    )
    log = opened(tmp_path, text)
    assert [column.kind for column in log.columns] == ["stamp", "number", "number"]
    assert_read_with_stamps(log)


@pytest.mark.parametrize("between", [" ", ",", "; "])
def test_names_before_the_numbers_may_follow_an_arrow(between: str, tmp_path: Path) -> None:
    text = "12:00:00.000 -> Ready\n" + "".join(
        f"12:00:{t:06.3f} -> u={u:.2f}{between}x={x:.7f}\n"
        for t, u, x in zip(TIME, VOLTAGE, POSITION, strict=True)
    )
    log = opened(tmp_path, text)
    assert [column.name for column in log.columns] == ["#1", "u", "x"]
    assert_read_with_stamps(log)


def test_lists_after_a_name_and_an_arrow_keep_their_time_stamps(tmp_path: Path) -> None:
    text = "".join(
        f"12:00:{t:06.3f} -> log=[{u:.2f},{x:.7f}]\n" for t, u, x in zip(TIME, VOLTAGE, POSITION, strict=True)
    )
    log = opened(tmp_path, text)
    assert_read_with_stamps(log)


def test_a_row_of_numbers_with_commas_is_not_one_number(tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text("t;u\n1.000,04;2\n1.000,05;3\n1.000,06;4\n")
    assert detect_format(tmp_path / "log.txt").separator == ";"
    (tmp_path / "log.txt").write_text("11.0,0.0,113.9;\n68.0,0.0,113.9;\n")
    assert detect_format(tmp_path / "log.txt").separator == ","


@pytest.mark.parametrize(
    "line", ["a " * 15_000, "_" * 30_000, "a: " * 10_000, " " * 30_000 + "a", "/" * 30_000]
)
def test_long_lines_above_a_table_take_no_time(line: str, tmp_path: Path) -> None:
    begin = time.process_time()
    log = opened(tmp_path, f"{line}\n{line}\n" + "1,2,3\n2,3,4\n" * 500)
    assert len(log.columns) == 3
    assert time.process_time() - begin < 2.0  # 0.02 s; a pattern of quadratic effort takes minutes


def test_a_speed_in_a_comment_header_without_a_unit_is_no_position(tmp_path: Path) -> None:
    log = opened(tmp_path, "# time velocity x\n" + rows(" "))
    assert [column.meaning.quantity for column in log.columns] == ["time", "speed", ""]


@pytest.mark.parametrize("count", [19, 20, 2000])
def test_quantities_in_rows_are_read_as_columns(count: int, tmp_path: Path) -> None:
    """As `numpy.savetxt` writes a list of signals; a table with 19 columns and 3 rows is taken as it is."""
    values = np.random.default_rng(1).normal(size=(3, count))
    np.savetxt(tmp_path / "log.csv", values, delimiter=",")
    (log,) = open_logs(tmp_path / "log.csv")
    in_rows = count >= 20
    assert [column.header for column in log.columns] == [
        f"#{k}" for k in range(1, (3 if in_rows else 19) + 1)
    ]
    read = np.array(log.read([log.columns[0], log.columns[2]])[0])
    assert np.allclose(read, values[[0, 2]] if in_rows else values[:, [0, 2]].T)
