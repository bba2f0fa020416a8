"""Sums and differences of columns: a CoreXY printer logs its tool, and its motors follow what is added."""

from pathlib import Path

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import ImportSettings, MappingOptions, import_logs, load_recordings
from hframe_gym.recordings.logs.log_files import open_logs

PRINTER = BUILTIN_MACHINES["printer"]()
RADIUS = PRINTER.coordinate("phi1").radius
TIME = np.arange(60) * 1e-3
HEADERS = "time [s],x-ref [mm],y-ref [mm],x_m,y_m,load [A]"
TOOL = np.column_stack([20.0 * np.sin(20.0 * TIME), 10.0 * np.sin(35.0 * TIME)])  # mm


def write_log(path: Path) -> Path:
    table = np.column_stack([TIME, TOOL, 1e-3 * TOOL, TIME])
    np.savetxt(path, table, fmt="%.17g", delimiter=",", header=HEADERS, comments="")
    return path


def options(first: str, second: str) -> MappingOptions:
    columns = {"command1_rad": first, "command2_rad": second}
    return MappingOptions(columns, scales=dict.fromkeys(columns, 1e-3 / RADIUS))


@pytest.mark.parametrize(
    ("first", "second"),
    [("x-ref + y-ref", "x-ref - y-ref"), ("#2+#3", "-#3+x-ref"), ("y-ref [mm]+X-REF", "x-ref-y-ref")],
)
def test_commands_of_motors_are_sums_of_columns(first: str, second: str, tmp_path: Path) -> None:
    lines: list[str] = []
    settings = ImportSettings(options(first, second))
    import_logs(write_log(tmp_path / "log.csv"), tmp_path / "runs", PRINTER, settings, lines.append)
    (run,) = load_recordings(tmp_path / "runs", PRINTER)
    expected = np.column_stack([TOOL.sum(axis=1), TOOL @ [1.0, -1.0]]) * 1e-3 / RADIUS
    np.testing.assert_allclose(run.inputs, expected, atol=1e-9)
    unused = [line for line in lines if "not used" in line]
    assert len(unused) == 1
    assert "load" in unused[0]


@pytest.mark.parametrize(
    ("reference", "problem"),
    [
        ("x-ref + z", "there is no such column"),
        ("x-ref + load", "x-ref [mm] is in mm and load [A] in A"),
        ("x-ref + x_m", "x-ref [mm] is in mm and x_m in m"),
    ],
)
def test_what_cannot_be_added_is_refused(reference: str, problem: str, tmp_path: Path) -> None:
    path, settings = write_log(tmp_path / "log.csv"), ImportSettings(options(reference, "x-ref - y-ref"))
    with pytest.raises(InputError) as refused:
        import_logs(path, tmp_path / "runs", PRINTER, settings, lambda line: None)
    assert problem in str(refused.value)


def test_a_printer_without_angles_is_told_how_the_tool_commands_them(tmp_path: Path) -> None:
    """By its columns if they say so, else in general."""
    path = write_log(tmp_path / "log.csv")
    with pytest.raises(InputError) as refused:
        import_logs(path, tmp_path / "runs", PRINTER, ImportSettings(MappingOptions()), lambda line: None)
    assert "--map 'command1_rad=x-ref [mm] + y-ref [mm]' --scale command1_rad=0.15708 " in str(refused.value)
    assert "--map 'command2_rad=x-ref [mm] - y-ref [mm]' --scale command2_rad=0.15708" in str(refused.value)
    path.write_text(path.read_text().replace("x-ref", "first").replace("y-ref", "second"))
    with pytest.raises(InputError) as refused:
        import_logs(path, tmp_path / "runs", PRINTER, ImportSettings(MappingOptions()), lambda line: None)
    assert "--map 'command1_rad=X + Y' --scale command1_rad=0.15708 " in str(refused.value)
    assert "--map 'command2_rad=X - Y' --scale command2_rad=0.15708 " in str(refused.value)


def test_the_longest_name_of_a_column_counts(tmp_path: Path) -> None:
    (log,) = open_logs(write_log(tmp_path / "log.csv"))
    (sign, column), *others = log.terms_called("-x-ref-y-ref")
    assert (sign, column.name, [(s, c.name) for s, c in others]) == (-1.0, "x-ref", [(-1.0, "y-ref")])


@pytest.mark.parametrize(
    ("reference", "first"), [("pulse - 1500", 0.0), ("pulse+0.5", 1500.5), ("pulse - 7", 7.0)]
)
def test_a_number_is_added_in_the_unit_of_the_column(reference: str, first: float, tmp_path: Path) -> None:
    """The pulses of a servo rest at 1.5 ms. A column whose header is the reference comes first."""
    rows = "\n".join(f"{k * 1e-3:g},{1500 + k},{7 + k},{k}" for k in range(40))
    (tmp_path / "log.csv").write_text(f"time,pulse,pulse - 7,x\n{rows}\n")
    axis = BUILTIN_MACHINES["axis"]()
    mapping = MappingOptions({"v_V": reference, "x_m": "x"}, scales={"v_V": 0.001, "x_m": 1e-3})
    lines: list[str] = []
    import_logs(tmp_path / "log.csv", tmp_path / "runs", axis, ImportSettings(mapping), lines.append)
    (run,) = load_recordings(tmp_path / "runs", axis)
    np.testing.assert_allclose(run.inputs[:, 0], 0.001 * (first + np.arange(40.0)))
    assert any(line.split("  ")[1].startswith(reference[:5]) for line in lines if "v_V" in line)
