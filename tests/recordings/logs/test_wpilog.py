"""Data logs of WPILib are read: entries of every type with their own times, structures, and damaged files."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import Machine
from hframe_gym.recordings import ImportSettings, MappingOptions, import_logs, load_recordings
from hframe_gym.recordings.logs.log_files import open_logs
from tests.log_samples import COUNT, wpilog, wpilog_of_a_drive, wpilog_record, wpilog_start


def test_entries_become_a_recording(tmp_path: Path, axis: Machine) -> None:
    (tmp_path / "match.wpilog").write_bytes(wpilog_of_a_drive())
    lines: list[str] = []
    columns = dict(
        zip((*axis.input_channels, *axis.output_channels), ["/drive/voltage", *["none"] * 9], strict=False)
    )
    columns[axis.output_channels[0]] = "/drive/position"
    settings = ImportSettings(MappingOptions(columns))
    import_logs(tmp_path / "match.wpilog", tmp_path / "runs", axis, settings, lines.append)
    (run,) = load_recordings(tmp_path / "runs", axis)
    assert run.name == "match"
    measured = np.isfinite(run.outputs[:, 0])
    np.testing.assert_allclose(run.time_s[measured], 0.02 * np.arange(COUNT) + 0.003, atol=1e-12)
    np.testing.assert_allclose(
        run.outputs[measured, 0], 0.01 * np.maximum(np.arange(COUNT) - 10, 0), atol=1e-7
    )
    # Held between its records.
    np.testing.assert_array_equal(run.inputs[measured, 0], 6.0 * (np.arange(COUNT) >= 10))
    assert any("/mode (string), /raw (raw)" in line for line in lines)


def test_arrays_have_a_column_for_each_item(tmp_path: Path) -> None:
    (tmp_path / "match.wpilog").write_bytes(wpilog_of_a_drive())
    (log,) = open_logs(tmp_path / "match.wpilog")
    assert [column.header for column in log.columns] == [
        "/drive/voltage",
        "/drive/position",
        "/all[0]",
        "/all[1]",
    ]
    (first, second), _ = log.read(log.columns[2:])
    np.testing.assert_array_equal(first, 0.5 * np.arange(COUNT))
    np.testing.assert_array_equal(np.isnan(second), np.arange(COUNT) % 2 == 0)  # of the shorter arrays
    np.testing.assert_array_equal(second[1::2], 0.5 * np.arange(1, COUNT, 2))


def test_structures_are_read_by_their_description(tmp_path: Path) -> None:
    inner, outer = "double angle_rad;", "enum {a=1} int8 state; Rotation2d turn; float size[2]"
    records = [
        wpilog_start(1, "/.schema/struct:Rotation2d", "structschema"),
        wpilog_start(2, "/.schema/struct:Pose", "structschema"),
        wpilog_start(3, "/pose", "struct:Pose"),
        wpilog_start(4, "/bits", "struct:Bits"),
        wpilog_start(6, "/modules", "struct:Rotation2d[]"),
        wpilog_start(5, "/.schema/struct:Bits", "structschema"),
        wpilog_record(1, 0, inner.encode()),
        wpilog_record(2, 0, outer.encode()),
        wpilog_record(5, 0, b"int8 a:4; int8 b:4"),
        wpilog_record(4, 0, b"\x11"),
        wpilog_record(6, 0, struct.pack("<2d", 0.5, 0.75)),
        *(wpilog_record(3, k, struct.pack("<bdff", 1, 0.1 * k, 2.0, 3.0 + k)) for k in range(5)),
    ]
    (tmp_path / "pose.wpilog").write_bytes(wpilog(*records))
    (log,) = open_logs(tmp_path / "pose.wpilog")
    headers = [column.header for column in log.columns]
    modules = ["/modules[0]/angle_rad", "/modules[1]/angle_rad"]
    assert headers == ["/pose/state", "/pose/turn/angle_rad", "/pose/size[0]", "/pose/size[1]", *modules]
    assert log.columns[1].unit == "rad"
    values, _ = log.read(log.columns)
    np.testing.assert_allclose(values[1], 0.1 * np.arange(5))
    np.testing.assert_allclose(values[3], 3.0 + np.arange(5))
    assert values[5] == [0.75]
    assert any("/bits (struct:Bits)" in remark for remark in log.remarks)  # bit fields are not read


def test_each_test_of_sysid_becomes_a_run(tmp_path: Path, axis: Machine) -> None:
    records = [
        wpilog_start(1, "sysid-test-state-drive", "string"),
        wpilog_start(2, "voltage-left-drive", "double", "Volt"),
        wpilog_start(3, "position-left-drive", "double", "Meter"),
        wpilog_start(4, "velocity-left-drive", "double", '{"unit": "Rotation per Second"}'),
        wpilog_start(5, "odd", "double", "Furlong per Fortnight"),
    ]
    states = ["quasistatic-forward"] * 10 + ["none"] + ["dynamic-reverse"] * 10 + ["quasistatic-forward"] * 10
    for k, state in enumerate(states):
        records.append(wpilog_record(1, k * 20_000, state.encode()))
        for number in (2, 3, 4, 5):
            records.append(wpilog_record(number, k * 20_000 + 100, struct.pack("<d", 0.01 * k * number)))
    (tmp_path / "log.wpilog").write_bytes(wpilog(*records))
    logs = open_logs(tmp_path / "log.wpilog")
    assert [column.unit for column in logs[0].columns] == ["V", "m", "rev/s", ""]
    columns = dict.fromkeys(axis.output_channels, "none")
    columns |= {axis.input_channels[0]: "voltage-left-drive", axis.output_channels[0]: "position-left-drive"}
    settings = ImportSettings(MappingOptions(columns))
    files = import_logs(tmp_path / "log.wpilog", tmp_path / "runs", axis, settings, lambda line: None)
    names = ["quasistatic-forward_1", "dynamic-reverse", "quasistatic-forward_2"]
    assert [file.name for file in files] == [f"log_{name}.csv.gz" for name in names]
    first, rows = (load_recordings(tmp_path / "runs", axis)[k] for k in (1, 0))
    np.testing.assert_allclose(first.outputs[:, 0], 0.03 * np.arange(10))
    np.testing.assert_allclose(rows.outputs[:, 0], 0.03 * np.arange(11, 21))


def test_rows_are_sorted_and_repeated_times_left_out(tmp_path: Path) -> None:
    records = [
        wpilog_record(1, time, struct.pack("<q", value))
        for time, value in [(30, 3), (10, 1), (20, 2), (20, 4)]
    ]
    (tmp_path / "log.wpilog").write_bytes(wpilog(wpilog_start(1, "n", "int64"), *records))
    (log,) = open_logs(tmp_path / "log.wpilog")
    (times, values), remarks = log.read([log.times[0], log.columns[0]])
    np.testing.assert_allclose(times, [1e-5, 2e-5, 3e-5])
    np.testing.assert_array_equal(values, [1, 4, 3])
    assert remarks == [
        "n: rows sorted by time",
        "n: 1 of 4 rows have the time of the row after them and are left out",
    ]


def test_an_incomplete_record_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "log.wpilog").write_bytes(wpilog_of_a_drive()[:-5])
    (log,) = open_logs(tmp_path / "log.wpilog")
    assert "its last record is incomplete and left out" in log.remarks
    assert [len(values) for values in log.read(log.columns)[0]] == [COUNT, COUNT, COUNT - 1, COUNT - 1]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"WPILOG\0\1", "ends within its header"),
        (b"WPILOG\0\2\0\0\0\0", "version 2"),
        (wpilog(), "has no entries of numbers; entries: none"),
        (
            wpilog(wpilog_start(1, "text", "string"), wpilog_record(1, 5, b"hello")),
            r"entries: text \(string\)",
        ),
        (wpilog(wpilog_record(7, 5, b"hello")), "byte 27: has a record of the entry 7, which is not started"),
        (wpilog(wpilog_record(0, 5, b"\0\1")), "has a damaged control record"),
        (
            wpilog(wpilog_start(1, "x", "double"), wpilog_record(1, 5, b"1234")),
            "x, record 1: has 4 bytes, not 8",
        ),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, content: bytes, problem: str) -> None:
    (tmp_path / "log.wpilog").write_bytes(content)
    with pytest.raises(InputError, match=problem) as error:
        open_logs(tmp_path / "log.wpilog")
    assert "log.wpilog" in str(error.value)
