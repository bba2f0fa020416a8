"""Traces of CODESYS are read: variables with their own times, in blocks below each other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import ImportSettings, MappingOptions, import_logs, load_recordings

VOLTAGE = [0.0, 0.0, 0.0, 5.0, 5.0]
POSITION = [0.0, 0.0, 0.0, 0.5, 2.0]  # mm


def block(number: int, name: str, values: list[str]) -> str:
    rows = "".join(f"; {4 * k}; {value}\n" for k, value in enumerate(values))
    return f"{number}.Variable; {name}\n{number}.Class; 14\n{number}.YAxis; 0\n{number}.Data; \n{rows};\n"


def write(path: Path, *blocks: str) -> None:
    path.write_text("[key]; [value]\nName; Application.Trace\nEveryNCycles; 1\n" + "".join(blocks))


def test_a_trace_becomes_a_recording(tmp_path: Path) -> None:
    axis = BUILTIN_MACHINES["axis"]()
    voltages, positions = [str(v) for v in VOLTAGE], [f"{p:e}" for p in POSITION]
    enabled = block(2, "PLC.bEnable", ["FALSE", "TRUE", "TRUE", "TRUE", "TRUE"])
    write(tmp_path / "a.trace.csv", block(0, "PLC.fOut", voltages), block(1, "PLC.fPos", positions), enabled)
    columns = dict.fromkeys(axis.output_channels, "none")
    columns |= {axis.input_channels[0]: "PLC.fOut", axis.output_channels[0]: "PLC.fPos"}
    settings = ImportSettings(MappingOptions(columns, units={axis.output_channels[0]: "mm"}))
    lines: list[str] = []
    import_logs(tmp_path / "a.trace.csv", tmp_path / "runs", axis, settings, lines.append)
    (run,) = load_recordings(tmp_path / "runs", axis)
    np.testing.assert_allclose(run.time_s, 0.004 * np.arange(5))
    np.testing.assert_array_equal(run.inputs[:, 0], VOLTAGE)
    np.testing.assert_allclose(run.outputs[:, 0], 1e-3 * np.array(POSITION))
    assert any("trace of CODESYS" in line for line in lines)
    assert any("PLC.bEnable" in line and "not used" in line for line in lines)


@pytest.mark.parametrize(
    ("blocks", "message"),
    [
        (block(0, "PLC.fOut", []), "trace of CODESYS without samples"),
        (block(0, "PLC.sState", ["RUN", "RUN"]), "variable PLC.sState: could not convert string to float"),
    ],
)
def test_a_trace_without_numbers_is_refused(tmp_path: Path, blocks: str, message: str) -> None:
    axis = BUILTIN_MACHINES["axis"]()
    write(tmp_path / "a.trace.csv", blocks)
    with pytest.raises(InputError, match=message):
        import_logs(tmp_path / "a.trace.csv", tmp_path / "runs", axis, ImportSettings(), lambda line: None)
