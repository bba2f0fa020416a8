"""Small logs in the formats of other programs, for the tests of their readers."""

from __future__ import annotations

import json
import shutil
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
from mcap.writer import Writer as McapWriter
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

BEGIN = 1_700_000_000_000_000_000  # ns, of bags and MCAP files
PERIOD = 10_000_000
COUNT = 40
POSITION = 0.001 * np.arange(COUNT) ** 1.5
VOLTAGE = 5.0 * (np.arange(COUNT) >= 10)
WPILOG_PERIOD_US = 20_000
# A motion of x: 0.1 s at 1000 mm/s^2, then 0.1 s at 100 mm/s, a pause of 0.1 s, and 0.05 s backward at 20
# mm/s.
KLIPPER_PIECES = [
    [10.0, 0.1, 0.0, 1000.0, [5.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
    [10.1, 0.1, 100.0, 0.0, [10.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
    [10.3, 0.05, 20.0, 0.0, [20.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
]
KLIPPER_STEPS = {
    "data": [[1000, 3, 10], [2000, -2, 0]],
    "first_clock": 5000,
    "last_clock": 5000 + 1010 + 1020 + 4000,
    "first_step_time": 10.0,
    "last_step_time": 10.0 + 6030e-6,
    "start_position": 7.0,
    "step_distance": 0.01,
}
KLIPPER_INFO = {"id": "info", "result": {"state": "ready"}}


def wpilog_record(number: int, time_us: int, payload: bytes) -> bytes:
    """Return a record with the fewest bytes for each of its numbers."""
    fields = []
    for value, most in ((number, 4), (len(payload), 4), (time_us, 8)):
        fields.append(value.to_bytes(next(n for n in range(1, most + 1) if value < 1 << 8 * n), "little"))
    lengths = len(fields[0]) - 1 | len(fields[1]) - 1 << 2 | len(fields[2]) - 1 << 4
    return bytes([lengths]) + b"".join(fields) + payload


def wpilog_start(number: int, name: str, kind: str, description: str = "") -> bytes:
    """Return the control record that starts an entry."""
    texts = b"".join(struct.pack("<I", len(text)) + text.encode() for text in (name, kind, description))
    return wpilog_record(0, 0, b"\0" + struct.pack("<I", number) + texts)


def wpilog(*records: bytes) -> bytes:
    """Return a file of some records."""
    extra = b"made for a test"
    return b"WPILOG\0\1" + struct.pack("<I", len(extra)) + extra + b"".join(records)


def wpilog_of_a_drive() -> bytes:
    """Return a log of a drive: a voltage every period, a position 3 ms later, an array and texts besides."""
    rows = [
        wpilog_start(1, "/drive/voltage", "double"),
        wpilog_start(300, "/drive/position", "float"),
        wpilog_start(2, "/mode", "string"),
    ]
    rows += [
        wpilog_start(3, "/all", "double[]"),
        wpilog_start(4, "/raw", "raw"),
        wpilog_record(2, 5, b"auto"),
        wpilog_record(4, 5, b"x"),
    ]
    for k in range(COUNT):
        rows.append(wpilog_record(1, k * WPILOG_PERIOD_US, struct.pack("<d", 6.0 * (k >= 10))))
        rows.append(wpilog_record(300, k * WPILOG_PERIOD_US + 3000, struct.pack("<f", 0.01 * max(k - 10, 0))))
        rows.append(
            wpilog_record(3, k * WPILOG_PERIOD_US, struct.pack(f"<{1 + k % 2}d", *[0.5 * k] * (1 + k % 2)))
        )
    return wpilog(*rows)


def write_klipper(path: Path, *messages: dict[str, Any], tail: bytes = b"", end: bool = True) -> None:
    """Write messages as data_logger.py does; without `end` the file ends as after a loss of power."""
    stream = zlib.compressobj(-1, zlib.DEFLATED, 31)
    text = b"".join(json.dumps(message).encode() + b"\x03" for message in messages) + tail
    content = stream.compress(text) + stream.flush(zlib.Z_FINISH if end else zlib.Z_FULL_FLUSH)
    path.write_bytes(content)


def klipper_block(name: str, **params: Any) -> dict[str, Any]:
    """Return a message of a subscription."""
    return {"q": name, "params": params}


def _add(group: h5py.Group, name: str, value: Any, references: h5py.Group) -> None:
    """Store a value as MATLAB does: the axes of arrays reversed, cells and structure arrays as references."""
    if isinstance(value, dict):
        member = group.create_group(name)
        member.attrs["MATLAB_class"] = np.bytes_("struct")
        for key, content in value.items():
            _add(member, key, content, references)
    elif isinstance(value, list) and isinstance(value[0], dict):
        member = group.create_group(name)
        member.attrs["MATLAB_class"] = np.bytes_("struct")
        for key in value[0]:
            pointers = [_stored(element[key], references) for element in value]
            member.create_dataset(key, data=np.array([pointers], dtype=h5py.ref_dtype))
    elif isinstance(value, list):
        pointers = [_stored(element, references) for element in value]
        member = group.create_dataset(name, data=np.array([pointers], dtype=h5py.ref_dtype))
        member.attrs["MATLAB_class"] = np.bytes_("cell")
    elif isinstance(value, str):
        member = group.create_dataset(name, data=np.array([[ord(c)] for c in value], dtype=np.uint16))
        member.attrs["MATLAB_class"] = np.bytes_("char")
    else:
        member = group.create_dataset(name, data=np.atleast_2d(np.asarray(value).T), compression="gzip")
        member.attrs["MATLAB_class"] = np.bytes_("double")


def _stored(value: Any, references: h5py.Group) -> h5py.Reference:
    """Store a value among the references of the file and return the reference."""
    name = f"r{len(references)}"
    _add(references, name, value, references)
    return references[name].ref


def write_matlab(path: Path, **variables: Any) -> None:
    """Write a file of MATLAB version 7.3, with the block of text that MATLAB writes before the HDF5 file."""
    with h5py.File(path, "w", userblock_size=512) as file:
        references = file.create_group("#refs#")
        for name, value in variables.items():
            _add(file, name, value, references)
        table = file.create_dataset("results", data=np.arange(12, dtype=np.uint32).reshape(1, 12))
        table.attrs["MATLAB_class"] = np.bytes_("table")
        table.attrs["MATLAB_object_decode"] = 3
    with open(path, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def write_matlab_objects(path: Path, version: str, seconds: Any, values: Any) -> None:
    """Write a timetable, timeseries of equal steps and of a model, and an array; versions: "v7", "v7.3"."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # mat-io warns of its own use of pandas
        from matio import save_to_mat
        from matio.utils.matclass import MatlabOpaque

        timetable = pd.DataFrame({"x": values}, index=pd.to_timedelta(seconds, unit="s"))
        step = np.diff(seconds[:2]).item()
        times = {"Time_": np.zeros((0, 0)), "Start_": seconds[0], "Increment_": step, "Length": len(seconds)}
        info = MatlabOpaque(times, classname="tsdata.timemetadata")
        series = MatlabOpaque({"Data_": values[:, None], "TimeInfo": info}, classname="timeseries")
        info = MatlabOpaque({"Time_": seconds[:, None]}, classname="tsdata.timemetadata")
        storage = MatlabOpaque({"Data": values[None]}, classname="tsdata.StreamingStorage")
        streamed = {"Data_": np.zeros((0, 0)), "TimeInfo": info, "Storage_": storage}
        content = {"speed": series, "current": MatlabOpaque(streamed, classname="timeseries")}
        save_to_mat(path, {**content, "bench": timetable, "t": seconds}, version=version)


def write_simulink_signals(path: Path, seconds: Any, values: Any) -> None:
    """Write a data set of Simulink as a running model does: signals without name, with times, in a bus."""
    step = float(np.diff(seconds[:2])[0])
    with h5py.File(path, "w") as file:

        def text(group: Any, name: str, value: str) -> Any:
            codes = np.array([[ord(letter)] for letter in value] or [[0], [0]], np.uint16)
            group[name] = codes
            if not value:
                group[name].attrs["MATLAB_empty"] = 1
            return group[name]

        def stream(number: int, data: Any) -> None:
            group = file.create_group(f"#sigstream#/{number}")
            group["#data#"] = np.frombuffer(data.tobytes(), np.uint8)
            group["#length#"], group["#sampleSize#"] = [len(data)], [data.dtype.itemsize]

        def leaf(group: Any, name: str, kind: str, number: int, times: int | None = None) -> None:
            text(group, "Name", name)
            text(group, "SignalAttributes/ClassName", kind)
            group["DataR2"] = [[float(number)]]
            group["TimeR2"] = [[float(times or 0)]]
            group["CompressedTime"] = [[seconds[0]], [step], [len(seconds)]]
            if times is None:
                group["TimeR2"].attrs["MATLAB_empty"] = 1

        def element(key: str, name: str, block: str) -> Any:
            group = file.create_group(f"#refs#/{key}")
            text(group, "Name", name)
            path_of_block = text(file["#refs#"], f"{key}_block", f"model/{block}")
            group.create_dataset("BlockPath", data=[[path_of_block.ref]], dtype=h5py.ref_dtype)
            return group.create_group("Values")

        stream(0, np.asarray(values, "f8"))
        stream(1, np.asarray(values, "f4"))
        stream(2, np.arange(len(seconds), dtype="i4"))
        stream(3, np.asarray(seconds, "f8"))
        leaf(element("a", "", "Chirp"), "", "double", 0)
        leaf(element("b", "angle", "Encoder"), "angle", "single", 1, times=3)
        leaf(element("c", "motor", "Bus").create_group("current"), "", "int32", 2)
        file["#subsystem#/MCOS"] = [0]


def _joint_states(store: Any, k: int, delay: int) -> Any:
    """Return the message of two joints; the order of the joints changes from message to message."""
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(BEGIN + k * PERIOD - delay, 1_000_000_000))
    extra = {"seq": k} if "seq" in types["std_msgs/msg/Header"].__dataclass_fields__ else {}
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **extra)
    names, positions = ["slide", "arm"], np.array([POSITION[k], -1.0])
    order = 1 if k % 2 == 0 else -1
    empty = np.empty(0)
    return types["sensor_msgs/msg/JointState"](
        header, names[::order], positions[::order].copy(), empty, empty
    )


def _topics(store: Any, delay: int) -> list[tuple[str, str, list[Any]]]:
    """Return topics with their types and messages."""
    types = store.types
    image = types["std_msgs/msg/String"]("no number")
    return [
        (
            "/joint_states",
            "sensor_msgs/msg/JointState",
            [_joint_states(store, k, delay) for k in range(COUNT)],
        ),
        (
            "/motor/command",
            "std_msgs/msg/Float64",
            [types["std_msgs/msg/Float64"](float(v)) for v in VOLTAGE],
        ),
        ("/status", "std_msgs/msg/String", [image]),
    ]


def write_ros2(path: Path, storage: rosbag2.StoragePlugin, delay: int = 2_000_000) -> None:
    """Write a bag of ROS 2."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with rosbag2.Writer(path, version=9, storage_plugin=storage) as writer:
        for topic, kind, messages in _topics(store, delay):
            connection = writer.add_connection(topic, kind, typestore=store)
            for k, message in enumerate(messages):
                writer.write(connection, BEGIN + k * PERIOD, store.serialize_cdr(message, kind))


def write_ros1(path: Path, delay: int = 2_000_000) -> None:
    """Write a bag of ROS 1."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with rosbag1.Writer(path) as writer:
        for topic, kind, messages in _topics(store, delay):
            connection = writer.add_connection(topic, kind, typestore=store)
            for k, message in enumerate(messages):
                writer.write(connection, BEGIN + k * PERIOD, store.serialize_ros1(message, kind))


def write_mcap_json(path: Path, rows: int = COUNT, finish: bool = True, **chunks: Any) -> None:
    """Write an MCAP file of JSON."""
    with open(path, "wb") as stream:
        writer = McapWriter(stream, **chunks)
        writer.start()
        schema = writer.register_schema("Motor", "jsonschema", b"{}")
        channel = writer.register_channel("/motor", "json", schema)
        other = writer.register_channel("/other", "cbor", 0)
        writer.add_message(other, BEGIN, b"\x01", BEGIN)
        for k in range(rows):
            content = {"angle_deg": k, "on": True, "name": "m", "big": 10**400, "v": [1, {"x": 2.5}]}
            writer.add_message(channel, BEGIN + k, json.dumps(content).encode(), BEGIN + k)
        if finish:
            writer.finish()


def write_all(folder: Path) -> dict[str, tuple[str, ...]]:
    """Write one log of each format.

    Args:
        folder: New folder.

    Returns:
        Options of `hframe import` by the name of the file, for the machine `axis`.
    """
    folder.mkdir(parents=True)
    (folder / "log.wpilog").write_bytes(wpilog_of_a_drive())
    rows = [[10.0 + 0.003 * k, 1.0 * k, 0.0, 9810.0] for k in range(60)]
    blocks = (
        ("trapq:toolhead", {"data": KLIPPER_PIECES}),
        ("adxl345:a", {"data": rows}),
        ("stepq:x", KLIPPER_STEPS),
    )
    write_klipper(
        folder / "log.json.gz", KLIPPER_INFO, *(klipper_block(name, **params) for name, params in blocks)
    )
    write_matlab(
        folder / "log.mat", t=np.arange(COUNT) * 0.01, log={"U": VOLTAGE, "pos": [POSITION, POSITION]}
    )
    write_ros1(folder / "log.bag")
    write_mcap_json(folder / "log.mcap", use_chunking=False)
    for storage in (rosbag2.StoragePlugin.SQLITE3, rosbag2.StoragePlugin.MCAP):
        write_ros2(folder / "bag", storage)
        (file,) = (path for path in (folder / "bag").iterdir() if path.suffix in (".db3", ".mcap"))
        file.rename(folder / f"ros2{file.suffix}")
        shutil.rmtree(folder / "bag")
    ros = ("v_V=/motor/command/data", "x_m=/joint_states/slide/position")
    return {
        "log.wpilog": ("v_V=/drive/voltage", "x_m=/drive/position"),
        "log.json.gz": ("v_V=trapq:toolhead/x_velocity", "x_m=stepq:x/position"),
        "log.mat": ("v_V=log.U", "x_m=log.pos.1"),
        "log.bag": ros,
        "ros2.db3": ros,
        "ros2.mcap": ros,
        "log.mcap": ("v_V=/motor/on", "x_m=/motor/angle_deg"),
    }
