"""Tables of ODrive's properties get their units; the output of SimpleFOC's monitor gets names and units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import ImportSettings, MappingOptions, import_logs, load_recordings
from hframe_gym.recordings.logs.log_files import open_logs

TIME = np.arange(40) * 0.01
ANGLE = 0.5 * TIME**2
VOLTAGE = np.where(TIME < 0.1, 0.0, 2.0)


def units(path: Path) -> dict[str, str]:
    """Return the unit of each column of a log by its header."""
    (log,) = open_logs(path)
    return {column.header: column.unit for column in log.columns}


def write(
    path: Path, header: str, *columns: np.ndarray, separator: str = ",", begin: str = "", end: str = ""
) -> Path:
    """Write a table."""
    rows = (separator.join(f"{value:.4f}" for value in row) for row in zip(*columns, strict=True))
    path.write_text(header + "".join(f"{begin}{row}{end}\n" for row in rows))
    return path


def test_properties_of_odrive_have_their_units(tmp_path: Path) -> None:
    header = "# time,odrv0.axis0.pos_estimate,vel_estimate,Iq_measured,input_torque,vbus_voltage,error\n"
    path = write(tmp_path / "odrive.csv", header, TIME, ANGLE, ANGLE, ANGLE, ANGLE, ANGLE, 0 * TIME)
    assert units(path) == {
        "time": "",
        "odrv0.axis0.pos_estimate": "rev",
        "vel_estimate": "rev/s",
        "Iq_measured": "A",
        "input_torque": "Nm",
        "vbus_voltage": "V",
        "error": "",
    }
    (log,) = open_logs(path)
    assert any(
        "units of ODrive since its firmware 0.5.1 for odrv0.axis0.pos_estimate, vel" in r for r in log.remarks
    )


def test_units_in_the_header_win(tmp_path: Path) -> None:
    header = "Time (s),Pos_estimate,Vel_estimate (counts/s),Torque_estimate (Nm)\n"
    path = write(tmp_path / "odrive.csv", header, TIME, ANGLE, ANGLE, ANGLE)
    assert list(units(path).values()) == ["s", "rev", "counts/s", "Nm"]


def test_a_log_of_odrive_becomes_a_recording(tmp_path: Path) -> None:
    motor = BUILTIN_MACHINES["axis"]()
    path = write(tmp_path / "odrive.csv", "time,Vq_setpoint,pos_estimate\n", TIME, VOLTAGE, ANGLE)
    columns = dict.fromkeys(motor.output_channels, "none")
    columns |= {motor.input_channels[0]: "Vq_setpoint", motor.output_channels[0]: "pos_estimate"}
    settings = ImportSettings(MappingOptions(columns, scales={motor.output_channels[0]: 0.04}))
    import_logs(path, tmp_path / "runs", motor, settings, lambda line: None)
    (run,) = load_recordings(tmp_path / "runs", motor)
    np.testing.assert_allclose(run.outputs[:, 0], 0.04 * ANGLE, atol=1e-5)


MESSAGES = "MOT: Monitor enabled!\nMOT: Init\nMOT: Enable driver.\nMOT: Ready.\n"


@pytest.mark.parametrize(
    ("header", "around"), [(MESSAGES, ""), ("", "M"), (MESSAGES, "M"), (MESSAGES.replace("\n", "\r\n"), "b")]
)
def test_the_output_of_the_monitor_gets_names(tmp_path: Path, header: str, around: str) -> None:
    columns = [0 * TIME, VOLTAGE, -ANGLE, ANGLE]
    path = write(tmp_path / "monitor.txt", header, *columns, separator="\t", begin=around, end=around)
    (log,) = open_logs(path)
    assert units(path) == {"target": "", "voltage.q": "V", "velocity": "rad/s", "angle": "rad"}
    for values, expected in zip(log.read(log.columns)[0], columns, strict=True):
        np.testing.assert_allclose(values, expected, atol=1e-4)
    assert any("4 columns, taken for the usual monitor_variables" in remark for remark in log.remarks)


def test_all_variables_and_a_serial_monitor_with_times(tmp_path: Path) -> None:
    columns = [ANGLE] * 7
    path = write(tmp_path / "monitor.txt", MESSAGES, *columns, separator="\t")
    assert list(units(path).values()) == ["", "V", "V", "mA", "mA", "rad/s", "rad"]
    rows = zip(TIME, VOLTAGE, ANGLE, strict=True)
    path.write_text("".join(f"12:00:{t:06.3f} -> M0.0000\t{v:.4f}\t{a:.4f}\t{a:.4f}M\n" for t, v, a in rows))
    (log,) = open_logs(path)
    assert [column.kind for column in log.columns] == ["stamp", "number", "number", "number", "number"]
    assert log.columns[2].header == "voltage.q"
    np.testing.assert_allclose(log.read(log.columns[2:3])[0][0], VOLTAGE)


def test_other_numbers_of_columns_keep_their_numbers(tmp_path: Path) -> None:
    path = write(tmp_path / "monitor.txt", MESSAGES, ANGLE, VOLTAGE, ANGLE, separator="\t")
    assert list(units(path)) == ["#1", "#2", "#3"]


def test_the_monitor_has_no_time(tmp_path: Path) -> None:
    axis = BUILTIN_MACHINES["axis"]()
    path = write(tmp_path / "monitor.txt", MESSAGES, 0 * TIME, VOLTAGE, ANGLE, ANGLE, separator="\t")
    columns = dict.fromkeys(axis.output_channels, "none")
    columns |= {axis.input_channels[0]: "voltage.q", axis.output_channels[0]: "angle"}
    scales = {axis.output_channels[0]: 0.01}
    settings = ImportSettings(MappingOptions(columns, scales=scales))
    with pytest.raises(InputError, match=r"monitor.txt: .*state the rate, e.g. time_s=200Hz"):
        import_logs(path, tmp_path / "runs", axis, settings, lambda line: None)
    settings = ImportSettings(MappingOptions({**columns, "time_s": "100Hz"}, scales=scales))
    import_logs(path, tmp_path / "runs", axis, settings, lambda line: None)
    (run,) = load_recordings(tmp_path / "runs", axis)
    np.testing.assert_allclose(run.time_s, TIME, atol=1e-12)
    np.testing.assert_allclose(run.inputs[:, 0], VOLTAGE)


def test_json_with_properties_of_odrive_is_refused_as_json(tmp_path: Path) -> None:
    (tmp_path / "log.json").write_text('{"pos_estimate": [1, 2, 3]}')
    with pytest.raises(InputError, match=r"log.json: is a JSON file without tests of SysId"):
        open_logs(tmp_path / "log.json")
