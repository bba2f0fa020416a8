"""JSON files of SysId become one run per test; other files that are no tables are refused by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import Machine
from hframe_gym.recordings import ImportSettings, MappingOptions, import_logs, load_recordings, save_machine

TESTS = ("slow-forward", "slow-backward", "fast-forward", "fast-backward")
TIME = 100.0 + np.arange(50) * 5e-3
VOLTAGE = np.linspace(0.0, 2.0, 50)
ROTATIONS = 0.1 * (TIME - 100.0) ** 2


def sysid_file(columns: int, **entries: Any) -> dict[str, Any]:
    """Return the content of a SysId file with rows of 4 or 9 numbers."""
    speed = np.gradient(ROTATIONS, TIME)
    four = [TIME, VOLTAGE, ROTATIONS, speed]
    nine = [TIME, VOLTAGE, -VOLTAGE, ROTATIONS, -ROTATIONS, speed, -speed, 0 * TIME, 0 * TIME]
    content: dict[str, Any] = {"sysid": True, "test": "Elevator", "units": "Meters", "unitsPerRotation": 0.3}
    content |= {
        test: np.column_stack([TIME + k, *(four if columns == 4 else nine)[1:]]).tolist()
        for k, test in enumerate(TESTS)
    }
    return content | entries


def settings(**columns: str) -> ImportSettings:
    """Return settings that assign columns to channels."""
    return ImportSettings(MappingOptions(columns))


@pytest.mark.parametrize(
    ("columns", "names", "units", "per_rotation"),
    [
        (4, ("voltage", "position"), {}, 0.3),
        (9, ("l voltage", "l position"), {}, 0.3),
        (9, ("r voltage", "r position"), {}, -0.3),
        (4, ("voltage", "position"), {"units": "Feet", "unitsPerRotation": 2.0}, 0.6096),
        (4, ("voltage", "position"), {"units": "Inches"}, 0.00762),
    ],
)
def test_the_tests_of_a_file_become_runs(
    columns: int,
    names: tuple[str, str],
    units: dict[str, Any],
    per_rotation: float,
    axis: Machine,
    tmp_path: Path,
) -> None:
    (tmp_path / "drive.json").write_text(json.dumps(sysid_file(columns, **units), indent=2))
    lines: list[str] = []
    mapping = settings(v_V=names[0], x_m=names[1])
    files = import_logs(tmp_path / "drive.json", tmp_path / "runs", axis, mapping, lines.append)
    assert [file.name for file in files] == [f"drive_{test}.csv.gz" for test in TESTS]
    runs = {run.name: run for run in load_recordings(tmp_path / "runs", axis)}
    sign = np.sign(per_rotation)
    for k, test in enumerate(TESTS):
        run = runs[f"drive_{test}"]
        np.testing.assert_allclose(run.time_s, TIME + k)
        np.testing.assert_allclose(run.inputs[:, 0], sign * VOLTAGE)
        np.testing.assert_allclose(run.outputs[:, 0], per_rotation * ROTATIONS, atol=1e-15)
    assert "drive.json, slow-forward:" in lines
    assert "drive.json, fast-backward: same format and columns as the log before" in lines


@pytest.mark.parametrize(
    ("before", "side", "after"),
    [
        (("battery", "autospeed"), "", ()),
        (("battery", "autospeed"), "l ", ()),
        (("battery", "autospeed"), "l ", ("angle",)),
    ],
)
def test_files_of_the_predecessor_of_sysid_are_read(
    before: tuple[str, ...], side: str, after: tuple[str, ...], axis: Machine, tmp_path: Path
) -> None:
    """frc-characterization writes the same tests without "sysid" and units, with further columns."""
    speed = np.gradient(ROTATIONS, TIME)
    motion = (
        [VOLTAGE, ROTATIONS, speed] if not side else [VOLTAGE, VOLTAGE, ROTATIONS, -ROTATIONS, speed, -speed]
    )
    rows = np.column_stack([TIME, *(12.0 + 0 * TIME for _ in before), *motion, *(0 * TIME for _ in after)])
    content = {"fast-forward": rows.tolist(), "slow-forward": rows.tolist(), "track-width": rows.tolist()}
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "drive.json").write_text(json.dumps(content))
    lines: list[str] = []
    mapping = settings(v_V=f"{side}voltage", x_m=f"{side}position")
    files = import_logs(tmp_path / "logs", tmp_path / "runs", axis, mapping, lines.append)
    assert [file.name for file in files] == [
        f"drive_{test}.csv.gz" for test in ("slow-forward", "fast-forward")
    ]
    run = load_recordings(tmp_path / "runs", axis)[0]
    np.testing.assert_allclose(run.inputs[:, 0], VOLTAGE)
    np.testing.assert_allclose(run.outputs[:, 0], ROTATIONS, atol=1e-15)
    assert any("file of frc-characterization, which does not state the unit" in line for line in lines)


def test_a_later_file_of_the_predecessor_states_its_unit(axis: Machine, tmp_path: Path) -> None:
    rows = np.column_stack([TIME, TIME, TIME, VOLTAGE, ROTATIONS, np.gradient(ROTATIONS, TIME)]).tolist()
    content = {"slow-forward": rows, "test": "Simple", "units": "Feet", "unitsPerRotation": 2.0}
    (tmp_path / "drive.json").write_text(json.dumps(content))
    import_logs(tmp_path / "drive.json", tmp_path / "runs", axis, settings(v_V="voltage", x_m="position"))
    run = load_recordings(tmp_path / "runs", axis)[0]
    np.testing.assert_allclose(run.outputs[:, 0], 0.6096 * ROTATIONS, atol=1e-15)


def test_a_folder_of_sysid_files_may_hold_the_machine(axis: Machine, tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "drive.json").write_text(json.dumps(sysid_file(4, **{"fast-backward": []})))
    save_machine(axis, tmp_path / "logs" / "machine.json")
    lines: list[str] = []
    mapping = settings(v_V="voltage", x_m="position")
    files = import_logs(tmp_path / "logs", tmp_path / "runs", axis, mapping, lines.append)
    assert len(files) == 3
    assert lines[0] == "skipped (by their names or content, no logs): machine.json"


def test_the_columns_of_a_sysid_file_are_proposed(axis: Machine, tmp_path: Path) -> None:
    (tmp_path / "drive.json").write_text(json.dumps(sysid_file(4)))
    with pytest.raises(InputError, match=r"--map 'v_V=voltage \[V\]' --map 'x_m=position \[m\]'"):
        import_logs(tmp_path / "drive.json", tmp_path / "runs", axis)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            '{"schema": 1}',
            "is a JSON file without tests of SysId; of JSON files only those of WPILib's SysId are read",
        ),
        ("[1, 2]", "is a JSON file without tests of SysId"),
        ('{"t": 1}\n{"t": 2}\n', "is not valid JSON: .*of JSON files only"),
        ('{"sysid": true}', "is a JSON file without tests of SysId"),
        (sysid_file(4, units="Cubits"), "units: 'Cubits' is none of Meters, Feet, Inches"),
        (sysid_file(4, unitsPerRotation=0), "unitsPerRotation: 0 is not a number of units"),
        (sysid_file(4, unitsPerRotation=10**400), "is not a number of units"),
        (sysid_file(4, unitsPerRotation=True), "unitsPerRotation: True is not a number of units"),
        (
            sysid_file(4, **{"slow-forward": [[1, 2, 3]]}),
            "slow-forward, row 1: must be a list of 4 or 9 numbers",
        ),
        (sysid_file(4, **{"slow-forward": [7]}), "slow-forward, row 1: must be a list of 4 or 9 numbers"),
        (
            sysid_file(4, **{"slow-forward": [[0, 0, 0, 0], [0, None, 0, 0]]}),
            "slow-forward, row 2: must be a list of 4 numbers",
        ),
        (
            sysid_file(4, **{"slow-forward": [[0, 0, 0, 10**400]]}),
            "slow-forward: has an integer beyond the range",
        ),
    ],
)
def test_other_json_is_refused(
    content: str | dict[str, Any], message: str, axis: Machine, tmp_path: Path
) -> None:
    path = tmp_path / "log.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(InputError, match=message) as error:
        import_logs(path, tmp_path / "runs", axis, settings(v_V="voltage", x_m="position"))
    assert "\n" not in str(error.value)


def test_an_error_names_the_test(axis: Machine, tmp_path: Path) -> None:
    rows = [[0.0, 0, 0, 0], [0.1, 0, 0, 0], [0.1, 1, 0, 0]]
    (tmp_path / "drive.json").write_text(json.dumps(sysid_file(4, **{"fast-forward": rows})))
    with pytest.raises(
        InputError, match=r"drive.json, fast-forward, row 3, column time_s: 0.1 repeats row 2"
    ):
        import_logs(tmp_path / "drive.json", tmp_path / "runs", axis, settings(v_V="voltage", x_m="position"))
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("name", "start", "message"),
    [
        ("a.xlsx", b"PK\x03\x04", "is a spreadsheet or an archive.*save the sheet as CSV"),
        ("a.ods", b"PK\x03\x04", "save the sheet as CSV"),
        ("a.ulg", b"ULog\x01\x12\x35", "ulog2csv"),
        ("a.tdms", b"TDSm", "is a TDMS file"),
        ("a.mf4", b"MDF     4.10", "asammdf"),
        ("a.json", b'{"a": 1}', "is a JSON file without tests of SysId"),
    ],
)
def test_a_file_of_another_program_is_refused_by_name_alone_and_in_a_folder(
    name: str, start: bytes, message: str, axis: Machine, tmp_path: Path
) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / name).write_bytes(start + bytes(300) if name != "a.json" else start)
    for path in (tmp_path / "logs" / name, tmp_path / "logs"):
        with pytest.raises(InputError, match=rf"{name}: {message}|{name}: .*{message}"):
            import_logs(path, tmp_path / "runs", axis)


@pytest.mark.parametrize("sparse", [False, True])
def test_each_test_that_a_column_of_a_table_marks_becomes_a_run(
    tmp_path: Path, axis: Machine, sparse: bool
) -> None:
    """The states of the tests stand in each row, or only where they change."""
    states = ["none"] * 5 + ["quasistatic-forward"] * 30 + ["none"] * 2 + ["dynamic-reverse"] * 25
    states += ["none"] + ["quasistatic-forward"] * 22
    rows = [
        f"{0.02 * k:.2f},{0.1 * k:.1f},{0.01 * k if k % 7 else '':},"
        f"{'' if sparse and k and state == states[k - 1] else state}"
        for k, state in enumerate(states)
    ]
    header = "timestamp [s],voltage [V],position [m],/drive/sysid-test-state"
    (tmp_path / "log.csv").write_text("\n".join([header, *rows]) + "\n")
    columns = dict.fromkeys(axis.output_channels, "none")
    columns |= {axis.input_channels[0]: "voltage", axis.output_channels[0]: "position"}
    progress: list[tuple[int, int]] = []
    files = import_logs(
        tmp_path / "log.csv",
        tmp_path / "runs",
        axis,
        settings(**columns),
        print,
        lambda done, total: progress.append((done, total)),
    )
    names = ["quasistatic-forward_1", "dynamic-reverse", "quasistatic-forward_2"]
    assert [file.name for file in files] == [f"log_{name}.csv.gz" for name in names]
    runs = {run.name: run for run in load_recordings(tmp_path / "runs", axis)}
    np.testing.assert_allclose(runs["log_dynamic-reverse"].inputs[:, 0], 0.1 * np.arange(37, 62))
    # Each test reads the whole file, which counts once for reading and once for writing, less what rounds.
    (total,) = {of_all for _, of_all in progress}
    assert total == 2 * (tmp_path / "log.csv").stat().st_size
    assert max(done for done, _ in progress) == pytest.approx(total, abs=len(names))


def test_a_column_of_other_texts_marks_no_tests(tmp_path: Path, axis: Machine) -> None:
    rows = [f"{0.02 * k:.2f},{0.1 * k:.1f},{0.01 * k:.2f},{'auto' if k > 20 else 'none'}" for k in range(40)]
    (tmp_path / "log.csv").write_text("\n".join(["time,voltage,position,mode", *rows]) + "\n")
    columns = dict.fromkeys(axis.output_channels, "none")
    columns |= {axis.input_channels[0]: "voltage", axis.output_channels[0]: "position"}
    files = import_logs(tmp_path / "log.csv", tmp_path / "runs", axis, settings(**columns), print)
    assert [file.name for file in files] == ["log.csv.gz"]
