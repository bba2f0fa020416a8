"""Logs of Klipper are read: accelerometer files, and motions, steps and more of its data_logger."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import ImportSettings, MappingOptions, import_logs, load_recordings
from hframe_gym.recordings.logs.log_files import find_logs, open_logs
from tests.log_samples import KLIPPER_INFO, KLIPPER_PIECES, KLIPPER_STEPS, write_klipper
from tests.log_samples import klipper_block as block


def test_the_data_logger_gives_a_recording(tmp_path: Path) -> None:
    axis = BUILTIN_MACHINES["axis"]()
    accelerations = [[10.0 + 0.003 * k, 100.0 * k, 0.0, 9810.0] for k in range(115)]
    write_klipper(
        tmp_path / "bench.json.gz",
        KLIPPER_INFO,
        block("trapq:toolhead", data=KLIPPER_PIECES[:1]),
        block("status", eventtime=3.0, status={}),
        block("adxl345:adxl345", data=accelerations[:40], errors=0),
        block("trapq:toolhead", data=KLIPPER_PIECES[1:]),
        block("adxl345:adxl345", data=accelerations[40:], errors=0),
    )
    write_klipper(tmp_path / "bench.index.gz", KLIPPER_INFO)
    assert [path.name for path in find_logs(tmp_path)[0]] == ["bench.json.gz"]
    columns = dict.fromkeys(axis.output_channels, "none")
    columns |= {
        axis.input_channels[0]: "trapq:toolhead/x_velocity",
        axis.output_channels[0]: "trapq:toolhead/x",
    }
    settings = ImportSettings(MappingOptions(columns, scales={axis.input_channels[0]: 1.0}))
    lines: list[str] = []
    import_logs(tmp_path, tmp_path / "runs", axis, settings, lines.append)
    (run,) = load_recordings(tmp_path / "runs", axis)
    assert run.name == "bench"
    times = [row[0] for row in accelerations]
    np.testing.assert_allclose(run.time_s, times)
    at = np.searchsorted(run.time_s, [10.0509, 10.1499, 10.2489, 10.3239])
    np.testing.assert_allclose(run.outputs[at, 0], [0.0063005, 0.015, 0.02, 0.01952], atol=1e-9)
    np.testing.assert_allclose(run.inputs[at, 0], [51.0, 100.0, 0.0, -20.0], atol=1e-9)
    text = "\n".join(lines)
    assert "commanded motion, given at the times of the sensors" in text
    assert "subscriptions that are not read: status" in text


def test_without_sensors_the_motion_is_given_every_millisecond(tmp_path: Path) -> None:
    write_klipper(tmp_path / "a.json.gz", block("trapq:toolhead", data=KLIPPER_PIECES))
    (log,) = open_logs(tmp_path / "a.json.gz")
    (position, time_s), remarks = log.read([log.columns[0], *log.times])
    np.testing.assert_allclose(time_s, 10.0 + 1e-3 * np.arange(351))
    assert position[0] == 5.0
    assert "given every 1 ms" in remarks[0]


def test_steps_and_angles_have_their_times(tmp_path: Path) -> None:
    angles = [[1.0, 0], [1.1, 16384], [1.2, -65536]]
    write_klipper(
        tmp_path / "a.json.gz", block("stepq:stepper_x", **KLIPPER_STEPS), block("angle:hall", data=angles)
    )
    (log,) = open_logs(tmp_path / "a.json.gz")
    assert [(c.header, c.unit) for c in log.columns] == [
        ("angle:hall/angle [rev]", "rev"),
        ("stepq:stepper_x/position [mm]", "mm"),
    ]
    (angle, position, angle_time, step_time), _ = log.read([*log.columns, *log.times])
    np.testing.assert_allclose(angle, [0.0, 0.25, -1.0])
    np.testing.assert_allclose(angle_time, [1.0, 1.1, 1.2])
    np.testing.assert_allclose(position, [7.01, 7.02, 7.03, 7.02, 7.01])
    np.testing.assert_allclose(step_time, 10.0 + 1e-6 * np.array([0.0, 1010.0, 2030.0, 4030.0, 6030.0]))


def test_an_accelerometer_has_millimeters_per_second_squared(tmp_path: Path) -> None:
    rows = "".join(f"{1.5 + 3e-4 * k:.6f},{100.0 * k:.6f},0.000000,9810.000000\n" for k in range(20))
    for head in ("", "##{'lost': 0}\n"):
        (tmp_path / "raw_data_x.csv").write_text(f"{head}#time,accel_x,accel_y,accel_z\n{rows}")
        (log,) = open_logs(tmp_path / "raw_data_x.csv")
        assert [(column.header, column.unit) for column in log.columns] == [
            ("time", "s"),
            *((f"accel_{axis}", "mm/s^2") for axis in "xyz"),
        ]
        assert log.columns[1].meaning.quantity == "linear acceleration"
        np.testing.assert_allclose(log.read(log.columns[1:2])[0][0], 100.0 * np.arange(20))


def test_a_spectrum_is_refused_with_advice(tmp_path: Path) -> None:
    (tmp_path / "calibration_data_x.csv").write_text(
        "freq, psd_x, psd_y, psd_z, psd_xyz, mzv\n1.0,2.0,2.0,2.0,2.0,2.0\n"
    )
    with pytest.raises(InputError, match=r"calibration_data_x.csv: is a spectrum .*OUTPUT=raw_data"):
        open_logs(tmp_path / "calibration_data_x.csv")


def test_an_incomplete_message_is_left_out(tmp_path: Path) -> None:
    write_klipper(tmp_path / "a.json.gz", block("angle:hall", data=[[1.0, 1]]), tail=b'{"q": "an', end=False)
    (log,) = open_logs(tmp_path / "a.json.gz")
    assert "its last message is incomplete and left out" in log.remarks


@pytest.mark.parametrize(
    ("messages", "problem"),
    [
        (
            [KLIPPER_INFO, block("status", status={})],
            r"no motions or measurements .* \(subscriptions: status\)",
        ),
        ([block("adxl345:a", data=[[1.0, 2.0]])], "adxl345:a: the rows of its data must be lists of 4"),
        (
            [block("adxl345:a", data=[[1.0, 2.0, "x", 1]])],
            "adxl345:a: the rows of its data must be lists of 4",
        ),
        ([block("trapq:t", data=[[1.0, 2.0]])], "trapq:t: its data are not pieces of a motion"),
        (
            [block("trapq:t", data=[KLIPPER_PIECES[0], [1e9, *KLIPPER_PIECES[0][1:]]])],
            "trapq:t: lasts 1e[+]09 s",
        ),
        (
            [block("stepq:s", **{**KLIPPER_STEPS, "data": [[1, 70_000, 0]]})],
            "stepq:s, block 1: has more than 65535 steps in a row",
        ),
        ([block("stepq:s", data=[[1, 2, 3]])], "stepq:s, block 1: is not the data of a stepper motor"),
    ],
)
def test_faulty_messages_are_refused(tmp_path: Path, messages: list[dict[str, Any]], problem: str) -> None:
    write_klipper(tmp_path / "a.json.gz", *messages)
    with pytest.raises(InputError, match=rf"a.json.gz.*{problem}"):
        open_logs(tmp_path / "a.json.gz")


def test_other_compressed_json_and_damaged_files_are_refused(tmp_path: Path) -> None:
    stream = zlib.compressobj(-1, zlib.DEFLATED, 31)
    (tmp_path / "b.json.gz").write_bytes(stream.compress(b'{"a": 1}') + stream.flush())
    with pytest.raises(InputError, match=r"b.json.gz: is no log of Klipper's data_logger"):
        open_logs(tmp_path / "b.json.gz")
    write_klipper(tmp_path / "c.json.gz", KLIPPER_INFO, tail=b"{no json\x03")
    with pytest.raises(InputError, match=r"c.json.gz, message 2: is not valid JSON"):
        open_logs(tmp_path / "c.json.gz")
