"""MATLAB files and other HDF5 files are read: arrays, structures, cells, tables, timeseries and iddata."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import io

from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import ImportSettings, MappingOptions, import_logs, load_recordings
from hframe_gym.recordings.logs.log_files import open_logs
from tests.log_samples import write_matlab, write_matlab_objects, write_simulink_signals

COUNT = 50
TIME = np.arange(COUNT) * 1e-3
POSITION = 0.01 * TIME


def test_arrays_structures_and_cells_are_columns(tmp_path: Path) -> None:
    matrix = np.column_stack([TIME, POSITION])
    signals = [{"values": TIME, "label": "u"}, {"values": POSITION, "label": "x"}]
    content = {"t": TIME, "log": {"x": POSITION, "n": 3.0}, "data": matrix, "sim": {"signals": signals}}
    write_matlab(tmp_path / "log.mat", **content, cell=[TIME, POSITION], name="motor 1")
    (log,) = open_logs(tmp_path / "log.mat")
    headers = [column.header for column in log.columns]
    assert headers == ["cell.1", "cell.2", "data.1", "data.2", "log.x", "u", "x", "t"]
    values = dict(zip(headers, log.read(log.columns)[0], strict=True))
    for header in ("cell.1", "data.1", "u", "t"):
        np.testing.assert_array_equal(values[header], TIME)
    for header in ("cell.2", "data.2", "log.x", "x"):
        np.testing.assert_array_equal(values[header], POSITION)


def test_arrays_of_numpy_are_columns_like_those_of_matlab(tmp_path: Path) -> None:
    joints = np.column_stack([POSITION, TIME])
    np.savez(tmp_path / "log.npz", time=TIME, q=joints, name=np.array("joint"), image=np.zeros((2, 3, 4)))
    (log,) = open_logs(tmp_path / "log.npz")
    assert [column.header for column in log.columns] == ["time", "q.1", "q.2"]
    np.testing.assert_array_equal(log.read(log.columns[1:2])[0][0], POSITION)
    np.savez(tmp_path / "texts.npz", name=np.array("joint"))
    with pytest.raises(InputError, match=r"texts.npz: has no arrays of numbers"):
        open_logs(tmp_path / "texts.npz")


def test_a_file_becomes_a_recording(tmp_path: Path) -> None:
    axis = BUILTIN_MACHINES["axis"]()
    voltage = np.where(TIME < 0.01, 0.0, 5.0)
    write_matlab(tmp_path / "bench.mat", t=TIME, U=voltage, pos=POSITION)
    columns = dict.fromkeys(axis.output_channels, "none")
    columns |= {axis.input_channels[0]: "U", axis.output_channels[0]: "pos"}
    settings = ImportSettings(MappingOptions(columns))
    import_logs(tmp_path / "bench.mat", tmp_path / "runs", axis, settings, lambda line: None)
    (run,) = load_recordings(tmp_path / "runs", axis)
    np.testing.assert_array_equal(run.time_s, TIME)
    np.testing.assert_array_equal(run.inputs[:, 0], voltage)
    np.testing.assert_array_equal(run.outputs[:, 0], POSITION)


def test_another_hdf5_file_keeps_its_axes(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["motor/state"] = np.column_stack([TIME, POSITION])
        file["motor/name"] = "left"
    (log,) = open_logs(tmp_path / "run.h5")
    assert [column.header for column in log.columns] == ["motor.state.1", "motor.state.2"]
    np.testing.assert_array_equal(log.read(log.columns)[0][1], POSITION)


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_tables_and_timeseries_are_columns(tmp_path: Path, version: str) -> None:
    write_matlab_objects(tmp_path / "log.mat", version, 0.5 + TIME, POSITION)
    (log,) = open_logs(tmp_path / "log.mat")
    columns = dict(zip([c.header for c in log.columns], log.read(log.columns)[0], strict=True))
    assert {name.removesuffix(".1") for name in columns} == {
        "speed.Time",
        "speed.Data",
        "current.Time",
        "current.Data",
        "bench.Time",
        "bench.x",
        "t",
    }
    np.testing.assert_allclose(columns["speed.Time"], 0.5 + TIME)
    np.testing.assert_allclose(columns["bench.Time"], TIME, atol=1e-9)
    np.testing.assert_array_equal(columns["bench.x"], POSITION)
    np.testing.assert_array_equal(columns["speed.Data"], POSITION)
    np.testing.assert_allclose(columns["current.Time"], 0.5 + TIME)
    np.testing.assert_array_equal(columns["current.Data"], POSITION)


def test_signals_of_a_simulink_data_set_are_columns(tmp_path: Path) -> None:
    """A running model writes them in streams, with times if steps are not equal; a bus contains several."""
    write_simulink_signals(tmp_path / "log.mat", TIME, POSITION)
    (log,) = open_logs(tmp_path / "log.mat")
    columns = dict(zip([c.header for c in log.columns], log.read(log.columns)[0], strict=True))
    expected = {"Chirp", "angle", "motor.current"}
    assert set(columns) == {f"{name}.{part}" for name in expected for part in ("Time", "Data")}
    for name in expected:
        np.testing.assert_allclose(columns[f"{name}.Time"], TIME)
    np.testing.assert_array_equal(columns["Chirp.Data"], POSITION)
    np.testing.assert_array_equal(columns["angle.Data"], POSITION.astype(np.float32))
    np.testing.assert_array_equal(columns["motor.current.Data"], np.arange(COUNT))


def test_each_experiment_of_iddata_is_a_log(tmp_path: Path) -> None:
    """The System Identification Toolbox keeps names, units and periods of each experiment in an object."""
    data = _iddata([POSITION, POSITION[:30]], periods=[1e-3, 2e-3], names=["Exp1", "slow"])
    io.savemat(tmp_path / "course.mat", {"data": data, "step": _iddata([POSITION], [5e-3], ["Exp1"])})
    first, slow, step = open_logs(tmp_path / "course.mat")
    assert [log.part for log in (first, slow, step)] == ["data_Exp1", "data_slow", "step"]
    assert [column.header for column in slow.columns] == ["time [s]", "Voltage [V]", "Angle [deg]"]
    for log, count, period in ((first, COUNT, 1e-3), (slow, 30, 2e-3), (step, COUNT, 5e-3)):
        time, voltage, angle = log.read(log.columns)[0]
        np.testing.assert_allclose(time, period * np.arange(count))
        np.testing.assert_array_equal(voltage, 2.0 * POSITION[:count])
        np.testing.assert_array_equal(angle, POSITION[:count])


def test_iddata_beside_other_vectors_is_a_part_of_their_log(tmp_path: Path) -> None:
    """Objects of older versions of the toolbox may have an empty unit of time."""
    times = {"SamplingInstants": _cell([TIME**1.1]), "TimeUnit": np.zeros((0, 0))}
    stored = _iddata([POSITION], [[]], ["Exp1"]) | times
    io.savemat(tmp_path / "log.mat", {"U": TIME, "data": stored})
    (log,) = open_logs(tmp_path / "log.mat")
    headers = [column.header for column in log.columns]
    assert headers == ["U", "data.time [s]", "data.Voltage [V]", "data.Angle [deg]"]
    np.testing.assert_array_equal(log.read(log.columns)[0][1], TIME**1.1)


def _cell(values: Sequence[Any]) -> NDArray[np.object_]:
    """Return a cell array of MATLAB; arrays become columns."""
    cell = np.empty((1, len(values)), dtype=object)
    for k, value in enumerate(values):
        cell[0, k] = value[:, None] if isinstance(value, np.ndarray) else value
    return cell


def _iddata(angles: Sequence[Any], periods: Sequence[Any], names: Sequence[str]) -> dict[str, Any]:
    """Return the fields of an iddata object with a voltage of twice the angle in each experiment."""
    return {
        "Domain": "Time",
        "OutputData": _cell(angles),
        "OutputName": _cell(["Angle"]),
        "OutputUnit": _cell(["deg"]),
        "InputData": _cell([2.0 * angle for angle in angles]),
        "InputName": _cell(["Voltage"]),
        "InputUnit": _cell(["V"]),
        "Ts": _cell(periods),
        "Tstart": _cell([[] for _ in angles]),
        "SamplingInstants": _cell([[] for _ in angles]),
        "TimeUnit": "seconds",
        "ExperimentName": _cell(names),
        "Utility": {"last": np.arange(6.0)},
    }


def test_objects_need_an_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_matlab(tmp_path / "log.mat")
    with pytest.raises(
        InputError, match=r"log.mat: has no arrays of numbers, tables or timeseries; save plain"
    ):
        open_logs(tmp_path / "log.mat")
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "matio" else find_spec(name)
    )
    with pytest.raises(InputError, match=r"log.mat: .*timeseries needs pip install 'hframe_gym\[matlab\]'"):
        open_logs(tmp_path / "log.mat")


def test_arrays_that_would_fill_the_memory_are_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.create_dataset("x", shape=(10**9,), dtype="f8", chunks=(10**6,))
    with pytest.raises(InputError, match=r"run.h5: .*its arrays have more than 67108864 bytes"):
        open_logs(tmp_path / "run.h5")


def test_a_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_matlab(tmp_path / "log.mat", t=TIME)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        InputError, match=r"log.mat: .*needs pip install 'hframe_gym\[hdf5\]'; or save it as version 7"
    ):
        open_logs(tmp_path / "log.mat")
