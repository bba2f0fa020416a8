"""Files that hold one motion together, such as the commands in one file and the measurements in another."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, Sensor
from hframe_gym.recordings import ImportSettings, MappingOptions, Recording, import_logs, load_recordings

MOTOR = BUILTIN_MACHINES["motor"]().replace(sensors=(Sensor("shaft_rad_s", {"shaft": 1.0}, kind="speed"),))
ROWS = 200
TIME = np.arange(ROWS) * 5e-3
VOLTS = np.where(np.arange(ROWS) // 40 % 2, 3.0, -3.0)
SPEED = 40.0 * np.sin(7.0 * TIME)
BY_ROW = {"time_s": "200Hz", "v_V": "#2", "shaft_rad_s": "#1"}


def write(path: Path, *columns: np.ndarray, header: str = "") -> Path:
    np.savetxt(path, np.column_stack(columns), fmt="%.17g", delimiter=",", header=header, comments="")
    return path


def join(log: Path, *others: Path, columns: dict[str, str]) -> Recording:
    settings = ImportSettings(MappingOptions(columns), join=others)
    import_logs(log, log.parent / "runs", MOTOR, settings, lambda line: None)
    (run,) = load_recordings(log.parent / "runs", MOTOR)
    return run


def test_columns_without_names_are_counted_through_the_files(tmp_path: Path) -> None:
    run = join(write(tmp_path / "speed.txt", SPEED), write(tmp_path / "volts.txt", VOLTS), columns=BY_ROW)
    np.testing.assert_allclose(run.inputs[:, 0], VOLTS)
    np.testing.assert_allclose(run.outputs[:, 0], SPEED)


def test_rows_without_a_time_belong_to_those_with_one(tmp_path: Path) -> None:
    log = write(tmp_path / "speed.csv", TIME, SPEED, header="time,speed")
    volts = tmp_path / "volts.mat"
    scipy.io.savemat(volts, {"u": VOLTS})
    run = join(log, volts, columns={"v_V": "u", "shaft_rad_s": "speed"})
    np.testing.assert_allclose(run.time_s, TIME)
    np.testing.assert_allclose(run.inputs[:, 0], VOLTS)


def test_files_with_times_are_merged_by_them(tmp_path: Path) -> None:
    log = write(tmp_path / "speed.csv", TIME[1::2], SPEED[1::2], header="time_s,speed")
    volts = tmp_path / "volts.mat"
    scipy.io.savemat(volts, {"time": TIME, "u": VOLTS})
    run = join(log, volts, columns={"v_V": "u", "shaft_rad_s": "speed"})
    np.testing.assert_allclose(run.time_s, TIME)
    np.testing.assert_allclose(run.inputs[:, 0], VOLTS)
    np.testing.assert_allclose(run.outputs[1::2, 0], SPEED[1::2])
    assert np.isnan(run.outputs[::2]).all()


def test_the_same_names_in_both_files_get_numbers(tmp_path: Path) -> None:
    log = write(tmp_path / "a.csv", TIME, SPEED, header="time_s,value")
    other = write(tmp_path / "b.csv", TIME[:-20], VOLTS[:-20], header="time_s,value")
    run = join(log, other, columns={"v_V": "value.2", "shaft_rad_s": "value"})
    np.testing.assert_allclose(run.inputs[: ROWS - 20, 0], VOLTS[:-20])
    np.testing.assert_allclose(run.outputs[:, 0], SPEED)


def test_a_message_tells_which_file_has_a_column(tmp_path: Path) -> None:
    """MATLAB exports often call their variable `data` in each file."""
    files = [tmp_path / "speed.mat", tmp_path / "voltage.mat"]
    for path, values in zip(files, (SPEED, VOLTS), strict=True):
        scipy.io.savemat(path, {"data": {"Time": TIME, "Data": values}})
    with pytest.raises(InputError, match="no column is named like") as error:
        join(*files, columns={})
    assert "data.Data, data.Time.2 (of voltage.mat), data.Data.2 (of voltage.mat)" in str(error.value)


def test_a_joined_file_in_the_folder_is_no_log_of_its_own(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    write(folder / "speed.txt", SPEED)
    volts = write(folder / "volts.txt", VOLTS)
    settings = ImportSettings(MappingOptions(BY_ROW), join=(volts,))
    (file,) = import_logs(folder, tmp_path / "runs", MOTOR, settings, lambda line: None)
    assert file.name == "speed.csv.gz"


def test_files_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    log = write(tmp_path / "speed.csv", TIME, SPEED, header="time,speed")
    names = {"v_V": "u", "shaft_rad_s": "speed"}
    shorter = write(tmp_path / "short.csv", VOLTS[:-1], header="u")
    with pytest.raises(InputError, match=r"u has 199 rows, but time has 200; .* row by row"):
        join(log, shorter, columns=names)
    later = write(tmp_path / "later.csv", TIME + 1.7e9, VOLTS, header="time,u")
    with pytest.raises(InputError, match=r"no moment in common: time is from 0 to 0\.995 s, time\.2 is from"):
        join(log, later, columns=names)


def test_a_log_without_commands_is_told_of_join(tmp_path: Path) -> None:
    log = write(tmp_path / "speed.csv", TIME, SPEED, header="time,speed")
    with pytest.raises(InputError, match="add those of another file by --join FILE"):
        join(log, columns={"shaft_rad_s": "speed"})
    log = write(tmp_path / "more.csv", TIME, SPEED, SPEED, header="time,speed,temp")
    with pytest.raises(InputError, match="--join FILE adds the columns of another file"):
        join(log, columns={"shaft_rad_s": "speed"})
