"""Test the conversions on synthetic logs with the format of the originals, so that no data are needed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.public_axes import SETS
from benchmarks.real_machines import printers, xl330
from benchmarks.real_machines.study import MACHINES
from hframe_gym.recordings import load_machine, load_recordings


def test_servo_log_is_converted_to_motor_voltage(tmp_path: Path) -> None:
    log = tmp_path / "logs"
    log.mkdir()
    header = "t_s,goal_position_rad,position_rad,speed_rad_s,load_raw_signed,input_V,temp_C,torque_enable"
    rows = [
        "0.000,0,0,0,0,7.0,29,1",
        "0.005,1,0.1,0,885,7.0,29,1",
        "0.010,1,0.2,0,442.5,8.0,29,1",
        "0.015,1,0.3,0,0,8.0,29,0",
    ]
    (log / "drop_kp100.csv").write_text("\n".join([header, *rows]) + "\n")
    xl330.convert(log, tmp_path / "runs")
    [run] = load_recordings(tmp_path / "runs", load_machine(MACHINES / "xl330.json"))
    np.testing.assert_allclose(run.inputs[:, 0], [3.5, 5.5, 4.0])  # without the released row
    np.testing.assert_allclose(run.outputs[:, 0], [0.0, 0.1, 0.2])


def test_shipped_servo_logs_match_their_machine() -> None:
    runs = load_recordings(xl330.EXAMPLE, load_machine(MACHINES / "xl330.json"))
    assert len(runs) == 16
    assert set(xl330.HELD_OUT) < {r.name for r in runs}


def test_peaks_of_a_damped_oscillator() -> None:
    """The spectrum has two modes with damping ratios 0.05 and 0.03."""
    f = np.arange(10.0, 140.0, 0.5)

    def mode(center: float, zeta: float) -> np.ndarray:
        return np.abs(1 / (1 - (f / center) ** 2 + 2j * zeta * f / center)) ** 2

    peaks = printers.peaks(f, mode(40.0, 0.05) + 0.3 * mode(90.0, 0.03))
    assert [p[0] for p in peaks] == pytest.approx([40.0, 90.0], abs=0.5)
    assert [p[1] for p in peaks] == pytest.approx([0.05, 0.03], rel=0.15)


@pytest.mark.parametrize("name", [name for name, public in SETS.items() if public.file])
def test_public_sets_say_how_their_logs_are_imported(name: str) -> None:
    """The recipe maps each channel of the machine file, so that it can be pasted."""
    public = SETS[name]
    recipe = public.recipe(Path("runs"))
    machine = load_machine(MACHINES / f"{public.file}.json")
    assert f"--machine benchmarks/machines/{public.file}.json --out runs" in recipe
    for channel in (*machine.input_channels, *machine.output_channels):
        assert f"{channel}=" in recipe
