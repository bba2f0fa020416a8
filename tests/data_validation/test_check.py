"""Each mistake that a rig's owner makes, planted into a good recording, is named; a good recording has none."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from hframe_gym.data_validation import Finding, check_recordings, warnings_of
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import Recording, load_recordings

Array = NDArray[np.float64]
PHI1, PHI2, X, Y = range(4)


@pytest.fixture(scope="module")
def runs() -> list[Recording]:
    return load_recordings("examples/rig_b", BUILTIN_MACHINES["hframe"]())


def faults(found: list[Finding]) -> list[str]:
    return [str(f) for f in found if f.severity == "fault"]


def changed(runs: list[Recording], change: Callable[[Array, Array], tuple[Array, Array]]) -> list[Recording]:
    """The runs with inputs and outputs put through a function."""
    parts = [change(r.inputs.copy(), r.outputs.copy()) for r in runs]
    return [dataclasses.replace(r, inputs=u, outputs=y) for r, (u, y) in zip(runs, parts, strict=True)]


def with_column(runs: list[Recording], j: int, of: Callable[[Array], Array]) -> list[Recording]:
    def change(u: Array, y: Array) -> tuple[Array, Array]:
        y[:, j] = of(y[:, j])
        return u, y

    return changed(runs, change)


def test_good_runs_have_no_fault(runs: list[Recording], hframe: Machine) -> None:
    found = check_recordings(runs, hframe)
    assert faults(found) == []
    assert any("8 runs, 19.99 s in all, sampled at 1000 Hz" in f.message for f in found)
    assert all(warnings_of(r, hframe) == [] for r in runs)


@pytest.mark.parametrize("j", [PHI1, PHI2, X, Y])
def test_a_channel_that_counts_backwards(j: int, runs: list[Recording], hframe: Machine) -> None:
    found = faults(check_recordings(with_column(runs, j, lambda y: -y), hframe))
    assert found == [f"fault: {hframe.output_channels[j]} has its sign the wrong way round"]


@pytest.mark.parametrize(("pair", "names"), [((PHI1, PHI2), "phi1_rad and phi2_rad"), ((X, Y), "x_m and y_m")])
def test_swapped_channels(pair: tuple[int, int], names: str, runs: list[Recording], hframe: Machine) -> None:
    def swap(u: Array, y: Array) -> tuple[Array, Array]:
        y[:, list(pair)] = y[:, list(reversed(pair))]
        return u, y

    assert f"fault: {names} are swapped" in faults(check_recordings(changed(runs, swap), hframe))


def test_a_motor_wired_backwards_and_swapped_motors(runs: list[Recording], hframe: Machine) -> None:
    negated = changed(runs, lambda u, y: (u * [1.0, -1.0], y))
    assert faults(check_recordings(negated, hframe)) == ["fault: v2_V has its sign the wrong way round"]
    swapped = changed(runs, lambda u, y: (u[:, ::-1], y))
    assert faults(check_recordings(swapped, hframe)) == ["fault: v1_V and v2_V are swapped"]


@pytest.mark.parametrize(("j", "factor", "unit"), [(Y, 1000.0, "millimetres"), (PHI1, 57.2958, "degrees")])
def test_a_wrong_unit(j: int, factor: float, unit: str, runs: list[Recording], hframe: Machine) -> None:
    found = faults(check_recordings(with_column(runs, j, lambda y: factor * y), hframe))
    assert any(hframe.output_channels[j] in line and unit in line for line in found)


def test_a_pulley_of_another_radius_is_measured(runs: list[Recording], hframe: Machine) -> None:
    bigger = changed(runs, lambda u, y: (u, y / [1.05, 1.05, 1.0, 1.0]))
    found = [f for f in check_recordings(bigger, hframe) if f.severity == "fault"]
    assert [f.channel for f in found] == ["phi1_rad", "phi2_rad"]
    radii = [float(f.message.split("a radius of ")[1].split(" m")[0]) for f in found]
    np.testing.assert_allclose(radii, 1.05 * 0.0194, rtol=3e-3)


def test_a_laser_that_sticks(runs: list[Recording], hframe: Machine) -> None:
    def stick(y: Array) -> Array:
        y[900:1800] = y[900]
        return y

    one = [with_column(runs[1:2], X, stick)[0], *runs[2:]]
    [line] = faults(check_recordings(one, hframe))
    assert "run_02, x_m: for 0.899 s, while others move, it does not move: stuck?" in line
    assert "stuck" in str(warnings_of(one[0], hframe)[0])


def test_a_laser_at_the_end_of_its_range(runs: list[Recording], hframe: Machine) -> None:
    clipped = with_column(runs[1:2], X, lambda y: np.minimum(y, np.quantile(y, 0.7)))
    assert "clipped?" in str(warnings_of(clipped[0], hframe)[0])


def test_dropped_samples_and_jitter(runs: list[Recording], hframe: Machine) -> None:
    run = runs[0]
    keep = np.ones(len(run.time_s), bool)
    keep[[500, 900, 901]] = False
    dropped = Recording("r", run.time_s[keep], run.inputs[keep], run.outputs[keep])
    [warning] = warnings_of(dropped, hframe)
    assert warning.channel == "time_s"
    assert "2 gaps (3 ms in all" in warning.message
    jitter = np.random.default_rng(0).uniform(-1e-4, 1e-4, len(run.time_s))
    [warning] = warnings_of(dataclasses.replace(run, time_s=run.time_s + jitter), hframe)
    assert warning.message == "sampling is irregular, 0.9964 ms with a jitter of 0.085 ms"


def test_an_idle_input_and_one_that_never_breaks_away(runs: list[Recording], hframe: Machine) -> None:
    idle = changed(runs[:1], lambda u, y: (u * [1.0, 0.0], y))
    assert [f.channel for f in warnings_of(idle[0], hframe)] == ["v2_V"]
    weak = check_recordings(changed(runs, lambda u, y: (0.01 * u, y)), hframe)
    assert {f.channel for f in weak if "never breaks away" in f.message} == {"x", "y"}


def test_a_missing_output_and_a_run_that_never_moves(runs: list[Recording], hframe: Machine) -> None:
    without = with_column(runs, Y, lambda y: np.full_like(y, np.nan))
    found = check_recordings(without, hframe)
    assert faults(found) == []
    assert sum(f.channel == "y_m" and "was not measured" in f.message for f in found) == len(runs)
    resting = dataclasses.replace(runs[0], name="still", inputs=0 * runs[0].inputs, outputs=0 * runs[0].outputs)
    [line] = [f for f in check_recordings([*runs, resting], hframe) if "nothing moves" in f.message]
    assert line.run == "still"


def test_one_direction_and_no_rest(hframe: Machine) -> None:
    time = np.arange(1000) * 1e-3
    inputs = np.full((1000, 2), -3.0)
    outputs = hframe.simulate(time, inputs).outputs
    found = check_recordings([Recording("push", time, inputs, outputs)], hframe)
    assert any(f.channel == "y" and "one direction only" in f.message for f in found)
    assert any(f.channel == "y" and "forwards 100 %" in f.message for f in found)
    assert any(f.run == "push" and "at rest before the first input" in f.message for f in found)


def test_runs_whose_clock_restarts(runs: list[Recording], hframe: Machine) -> None:
    restarted = [dataclasses.replace(r, time_s=r.time_s - r.time_s[0]) for r in runs]
    assert any("the clock restarts" in f.message for f in check_recordings(restarted, hframe))


def test_an_axis_wired_backwards() -> None:
    axis = BUILTIN_MACHINES["axis"]()
    time = np.arange(2000) * 1e-3
    inputs = np.where(time > 0.1, 4 * np.sign(np.sin(9 * time)), 0.0)[:, None]
    outputs = axis.simulate(time, inputs).outputs
    assert faults(check_recordings([Recording("r", time, inputs, outputs)], axis)) == []
    found = faults(check_recordings([Recording("r", time, inputs, -outputs)], axis))
    assert found == ["fault: x_m has its sign the wrong way round or v_V has its sign the wrong way round"]
