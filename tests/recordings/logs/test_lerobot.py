"""Data sets of LeRobot are read by episode, with motors' names; lists in other Parquet files by number."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import ImportSettings, MappingOptions, import_logs, load_recordings
from hframe_gym.recordings.logs.log_files import find_logs, open_logs

ROWS = 30  # of an episode
STATE = np.column_stack([np.arange(3 * ROWS) * 1e-4, -1.0 * np.arange(3 * ROWS)]).astype(np.float32)
ACTION = np.arange(3 * ROWS) % 5 * 1.0


def episodes(*numbers: int, state: Any = None) -> pyarrow.Table:
    """Return the table of some episodes, as LeRobot writes it."""
    rows = np.concatenate([np.arange(ROWS) + ROWS * number for number in numbers])
    states = pyarrow.array(list(STATE[rows]), pyarrow.list_(pyarrow.float32(), 2))
    columns = {
        "observation.state": states if state is None else state,
        "action": pyarrow.array([[value] for value in ACTION[rows]], pyarrow.list_(pyarrow.float32())),
        "timestamp": pyarrow.array((rows % ROWS / 30).astype(np.float32)),
        "frame_index": rows % ROWS,
        "episode_index": rows // ROWS,
        "index": rows,
        "task_index": np.zeros(len(rows), np.int64),
    }
    return pyarrow.table(columns)


def write_data_set(folder: Path, names: Any) -> None:
    """Write a data set of three episodes in two files."""
    (folder / "meta").mkdir(parents=True)
    feature = {"dtype": "float32", "shape": [2], "names": names}
    info = {"codebase_version": "v3.0", "fps": 30, "features": {"observation.state": feature}}
    (folder / "meta/info.json").write_text(json.dumps(info))
    for chunk, numbers in enumerate([(0, 1), (2,)]):
        data = folder / f"data/chunk-{chunk:03d}"
        data.mkdir(parents=True)
        pyarrow.parquet.write_table(episodes(*numbers), data / "file-000.parquet")


def test_each_episode_becomes_a_run(tmp_path: Path) -> None:
    axis = BUILTIN_MACHINES["axis"]()
    write_data_set(tmp_path / "set", ["slide.pos", "gripper.pos"])
    columns = dict.fromkeys(axis.output_channels, "none")
    columns |= {axis.input_channels[0]: "action[0]", axis.output_channels[0]: "observation.state.slide.pos"}
    lines: list[str] = []
    settings = ImportSettings(MappingOptions(columns))
    import_logs(tmp_path / "set", tmp_path / "runs", axis, settings, lines.append)
    runs = load_recordings(tmp_path / "runs", axis)
    assert [run.name for run in runs] == ["episode_000000", "episode_000001", "episode_000002"]
    for number, run in enumerate(runs):
        rows = slice(number * ROWS, (number + 1) * ROWS)
        np.testing.assert_allclose(run.outputs[:, 0], STATE[rows, 0], rtol=1e-7)
        np.testing.assert_array_equal(run.inputs[:, 0], ACTION[rows])
        np.testing.assert_allclose(run.time_s, np.arange(ROWS) / 30, atol=1e-6)
    assert any("it is a data set of LeRobot" in line for line in lines)


@pytest.mark.parametrize(
    ("names", "headers"),
    [
        ({"motors": ["slide", "gripper"]}, ["observation.state.slide", "observation.state.gripper"]),
        (["state"], ["observation.state[0]", "observation.state[1]"]),  # of another number than the items
        (None, ["observation.state[0]", "observation.state[1]"]),
    ],
)
def test_items_have_the_names_of_the_motors(tmp_path: Path, names: Any, headers: list[str]) -> None:
    write_data_set(tmp_path / "set", names)
    logs, _ = find_logs(tmp_path / "set")
    assert [path.parent.name for path in logs] == ["chunk-000", "chunk-001"]
    log = open_logs(logs[0])[1]
    assert log.title == "file-000.parquet, episode 1"
    assert [column.header for column in log.columns[:3]] == [*headers, "action[0]"]
    np.testing.assert_array_equal(log.read(log.columns[1:2])[0][0], STATE[ROWS : 2 * ROWS, 1])


def test_lists_of_different_lengths_are_refused(tmp_path: Path) -> None:
    lists = pyarrow.array([[1.0, 2.0]] * (ROWS - 1) + [[1.0]])
    pyarrow.parquet.write_table(episodes(0, state=lists), tmp_path / "log.parquet")
    (log,) = open_logs(tmp_path / "log.parquet")
    with pytest.raises(
        InputError, match=r"log.parquet, row 30, column observation.state: has a list of 1 items, .* 2"
    ):
        log.read(log.columns[:1])


def test_episodes_whose_rows_are_mixed_are_refused(tmp_path: Path) -> None:
    table = episodes(0, 1)
    pyarrow.parquet.write_table(
        table.take(np.arange(2 * ROWS).reshape(2, ROWS).T.ravel()), tmp_path / "log.parquet"
    )
    with pytest.raises(InputError, match=r"column episode_index: the rows of an episode are not together"):
        open_logs(tmp_path / "log.parquet")


def test_lists_in_another_parquet_file_have_numbers(tmp_path: Path) -> None:
    table = pyarrow.table({"t": np.arange(4) * 0.1, "q_deg": pyarrow.array([[1, 2], [3, 4], [5, 6], None])})
    pyarrow.parquet.write_table(table.slice(0, 3), tmp_path / "log.parquet")
    (log,) = open_logs(tmp_path / "log.parquet")
    assert [column.header for column in log.columns] == ["t", "q_deg[0]", "q_deg[1]"]
    np.testing.assert_array_equal(log.read(log.columns)[0][2], [2, 4, 6])
    pyarrow.parquet.write_table(table, tmp_path / "log.parquet")
    with pytest.raises(InputError, match="row 4, column q_deg: has a list of 0 items"):
        open_logs(tmp_path / "log.parquet")[0].read(log.columns[1:2])
