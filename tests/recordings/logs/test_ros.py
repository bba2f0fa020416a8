"""Bags of ROS 1 and 2 and MCAP files are read: topics, joints by name, header times, and damaged files."""

from __future__ import annotations

import importlib.util
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.writer import Writer as ProtobufWriter
from rosbags import rosbag2

from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import ImportSettings, MappingOptions, import_logs, load_recordings
from hframe_gym.recordings.logs.formats.messages import UnreadableError, numbers_of
from hframe_gym.recordings.logs.formats.ros_messages import RosDecoder
from hframe_gym.recordings.logs.log import Log
from hframe_gym.recordings.logs.log_files import find_logs, open_logs
from tests.log_samples import BEGIN, COUNT, PERIOD, POSITION, write_mcap_json, write_ros1, write_ros2


def bag(kind: str, folder: Path) -> Path:
    """Write a bag of a kind and return the path that a user names."""
    if kind == "ros1":
        write_ros1(folder / "bench.bag")
        return folder / "bench.bag"
    storage = rosbag2.StoragePlugin.SQLITE3 if "sqlite" in kind else rosbag2.StoragePlugin.MCAP
    write_ros2(folder / "bench", storage)
    if kind.endswith("folder"):
        return folder / "bench"
    (file,) = (path for path in (folder / "bench").iterdir() if path.suffix in (".db3", ".mcap"))
    return file.rename(folder / f"bench{file.suffix}")


@pytest.mark.parametrize("kind", ["ros1", "sqlite folder", "mcap folder", "sqlite file", "mcap file"])
def test_a_bag_becomes_a_recording(kind: str, tmp_path: Path) -> None:
    axis = BUILTIN_MACHINES["axis"]()
    columns = dict.fromkeys(axis.output_channels, "none")
    columns |= {
        axis.input_channels[0]: "/motor/command/data",
        axis.output_channels[0]: "/joint_states/slide/position",
    }
    lines: list[str] = []
    settings = ImportSettings(MappingOptions(columns))
    import_logs(bag(kind, tmp_path), tmp_path / "runs", axis, settings, lines.append)
    (run,) = load_recordings(tmp_path / "runs", axis)
    assert run.name == "bench"
    measured = np.isfinite(run.outputs[:, 0])
    np.testing.assert_allclose(run.outputs[measured, 0], POSITION[-measured.sum() :])
    steps = np.diff(run.time_s[measured])
    np.testing.assert_allclose(steps, 1e-9 * PERIOD, atol=1e-9)
    # The command has no header; its recorder's time is 2 ms after that in the header of the position.
    changed = run.time_s[np.flatnonzero(np.diff(run.inputs[:, 0])) + 1]
    measured_then = run.time_s[measured][np.isclose(run.outputs[measured, 0], POSITION[10])]
    np.testing.assert_allclose(changed - measured_then, 2e-3, atol=1e-9)
    text = "\n".join(lines)
    assert "/joint_states: the times are those of its headers" in text
    assert "topics that are left out: /status (std_msgs/msg/String)" in text


def test_a_folder_of_bags_gives_a_run_each(tmp_path: Path) -> None:
    for name in ("b", "a"):
        write_ros2(tmp_path / "logs" / name, rosbag2.StoragePlugin.MCAP)
    assert [path.name for path in find_logs(tmp_path / "logs")[0]] == ["a", "b"]


def test_a_folder_with_another_description_is_no_bag(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("author: someone\n")
    (tmp_path / "run.csv").write_text("t,u\n0,1\n1,2\n2,3\n")
    assert [path.name for path in find_logs(tmp_path)[0]] == ["run.csv"]


def test_headers_of_another_clock_are_not_used(tmp_path: Path) -> None:
    write_ros2(tmp_path / "bag", rosbag2.StoragePlugin.MCAP, delay=BEGIN - 7)  # a simulation that begins at 0
    (log,) = open_logs(tmp_path / "bag")
    (column,) = (c for c in log.columns if c.header == "/joint_states/arm/position")
    assert column.time is not None
    (times, values), remarks = log.read([column.time, column])
    assert times[0] == np.datetime64(BEGIN, "ns")
    np.testing.assert_array_equal(values, -1.0)
    assert remarks == [
        "/joint_states: the times of its headers are 1.7e+09 s before those of the recorder, which are used"
    ]


def read_all(log: Log) -> dict[str, Any]:
    """Return the values of all columns by header."""
    return dict(zip([column.header for column in log.columns], log.read(log.columns)[0], strict=True))


@pytest.mark.parametrize("chunks", [{}, {"use_chunking": False}])
def test_json_in_an_mcap_file(tmp_path: Path, chunks: dict[str, Any]) -> None:
    write_mcap_json(tmp_path / "a.mcap", **chunks)
    (log,) = open_logs(tmp_path / "a.mcap")
    values = read_all(log)
    assert list(values) == ["/motor/angle_deg", "/motor/on", "/motor/big", "/motor/v[0]", "/motor/v[1]/x"]
    np.testing.assert_array_equal(values["/motor/angle_deg"], np.arange(COUNT))
    np.testing.assert_array_equal(values["/motor/v[1]/x"], 2.5)
    assert np.isnan(values["/motor/big"]).all()
    assert log.columns[0].unit == "deg"
    assert log.remarks == (
        "it is an MCAP file",
        "topics that are left out: /other (cbor: messages in cbor are not read)",
    )


def test_protobuf_in_an_mcap_file(tmp_path: Path) -> None:
    with open(tmp_path / "a.mcap", "wb") as stream, ProtobufWriter(stream) as writer:
        for k in range(5):
            message = Timestamp(seconds=k, nanos=500_000_000)
            writer.write_message("/clock", message, BEGIN + k, BEGIN + k)
    (log,) = open_logs(tmp_path / "a.mcap")
    np.testing.assert_allclose(read_all(log)["/clock"], np.arange(5) + 0.5)


def test_an_mcap_file_that_ends_early_is_read_up_to_there(tmp_path: Path) -> None:
    write_mcap_json(tmp_path / "a.mcap", use_chunking=False)
    content = (tmp_path / "a.mcap").read_bytes()
    cut = content.index(b'{"angle_deg": 30')
    (tmp_path / "a.mcap").write_bytes(content[:cut])
    (log,) = open_logs(tmp_path / "a.mcap")
    assert "it ends early; the messages up to there are read" in log.remarks
    np.testing.assert_array_equal(read_all(log)["/motor/angle_deg"], np.arange(30))


@pytest.mark.parametrize(
    ("kind", "problem"),
    [("ros1", "rosbag reindex"), ("sqlite file", "ros2 bag reindex"), ("mcap file", "mcap recover")],
)
def test_damaged_files_are_refused(kind: str, problem: str, tmp_path: Path) -> None:
    path = bag(kind, tmp_path)
    content = bytearray(path.read_bytes())
    content[20:] = bytes(len(content) - 20)
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"{path.name}: .*{problem}"):
        open_logs(path)


def test_a_damaged_message_is_named(tmp_path: Path) -> None:
    write_mcap_json(tmp_path / "a.mcap", use_chunking=False)
    content = (tmp_path / "a.mcap").read_bytes().replace(b'{"angle_deg": 20', b'["angle_deg": 20')
    (tmp_path / "a.mcap").write_bytes(content)
    (log,) = open_logs(tmp_path / "a.mcap")
    with pytest.raises(InputError, match=r"a.mcap, /motor, message 21: is damaged"):
        log.read(log.columns[:1])


def test_a_bag_without_its_file_is_refused(tmp_path: Path) -> None:
    write_ros2(tmp_path / "bag", rosbag2.StoragePlugin.SQLITE3)
    for file in (tmp_path / "bag").glob("*.db3"):
        file.unlink()
    with pytest.raises(InputError, match=r"bag: cannot be read as a bag of ROS: .*missing"):
        open_logs(tmp_path / "bag")


def test_an_old_bag_without_definitions_has_the_usual_types(tmp_path: Path) -> None:
    path = bag("sqlite file", tmp_path)
    with sqlite3.connect(path) as database:
        database.execute("DELETE FROM message_definitions")
        database.execute("UPDATE topics SET type = 'own_msgs/msg/Status' WHERE name = '/status'")
    database.close()
    (log,) = open_logs(path)
    values = read_all(log)
    np.testing.assert_allclose(values["/joint_states/slide/position"], POSITION)
    assert (
        "topics that are left out: /status (own_msgs/msg/Status: its definition is not in the file)"
        in log.remarks
    )


def test_a_database_without_messages_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.db3").write_bytes(b"SQLite format 3\0" + bytes(200))
    with pytest.raises(InputError, match=r"a.db3: cannot be read as a bag of ROS"):
        open_logs(tmp_path / "a.db3")


@pytest.mark.parametrize("module", ["rosbags", "mcap"])
def test_a_missing_extra_is_named(module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = bag("ros1" if module == "rosbags" else "mcap file", tmp_path)
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == module else found(name))
    with pytest.raises(
        InputError, match=r"needs pip install 'hframe_gym\[ros\]'; or export its signals as CSV"
    ):
        open_logs(path)


@pytest.mark.parametrize("definition", ["float64 3x", "float64 class", "float64 x\nother/Type y("])
def test_faulty_definitions_are_refused(definition: str) -> None:
    with pytest.raises(UnreadableError, match="faulty definition"):
        RosDecoder().add_definition("a/msg/B", definition, idl=False)


def test_names_label_lists_of_their_length_only() -> None:
    message = {"names": ["a", "b"], "q": [1, 2], "mode": [3], "twice": {"name": ["c", "c"], "v": [4, 5]}}
    assert numbers_of(message, "/t") == {
        "/t/a/q": 1.0,
        "/t/b/q": 2.0,
        "/t/mode[0]": 3.0,
        "/t/twice/v[0]": 4.0,
        "/t/twice/v[1]": 5.0,
    }
    assert numbers_of({"image": list(range(1000)), "raw": b"123"}, "/t") == {}
