"""Counters that start anew are continued, logs are cut where a clock restarts, other times are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import Machine
from hframe_gym.recordings import ImportSettings, MappingOptions, Recording, import_logs, load_recordings


def imported(
    folder: Path, machine: Machine, header: str, times: list[str], **options: dict[str, str]
) -> tuple[Recording, list[str]]:
    """Import a log with the given texts of its times; return its run and what was printed."""
    rows = [f"{time};{0.01 * k:.2f};{1e-4 * k:.4f}" for k, time in enumerate(times)]
    (folder / "log.csv").write_text("\n".join([f"{header};v_V;x_m", *rows]))
    lines: list[str] = []
    settings = ImportSettings(MappingOptions(**options))  # type: ignore[arg-type]
    import_logs(folder / "log.csv", folder / "runs", machine, settings, log=lines.append)
    return load_recordings(folder / "runs", machine)[0], lines


def time_of_day(seconds: float) -> str:
    """Return a time of day, 0 to 24 h, from seconds since some midnight."""
    milliseconds = round(seconds * 1000) % 86_400_000
    minutes, rest = divmod(milliseconds, 60_000)
    return f"{minutes // 60:02d}:{minutes % 60:02d}:{rest / 1000:06.3f}"


def test_a_time_of_day_goes_on_after_midnight(axis: Machine, tmp_path: Path) -> None:
    seconds = 86_398.5 + 0.01 * np.arange(300)
    run, lines = imported(tmp_path, axis, "Time", [time_of_day(s) for s in seconds])
    np.testing.assert_allclose(run.time_s, seconds, atol=1e-9)
    assert "  time_s goes on after midnight (once)" in lines


def test_seconds_of_the_day_go_on_after_midnight(axis: Machine, tmp_path: Path) -> None:
    seconds = 86_399.0 + 0.01 * np.arange(300)
    run, _ = imported(tmp_path, axis, "time_s", [f"{s % 86_400:.2f}" for s in seconds])
    np.testing.assert_allclose(run.time_s, seconds, atol=1e-9)


def test_a_time_of_day_that_goes_back_by_hours_is_a_restart(axis: Machine, tmp_path: Path) -> None:
    seconds = [*(50_000 + 0.01 * np.arange(20)), *(0.01 * np.arange(20))]
    run, lines = imported(tmp_path, axis, "Time", [time_of_day(s) for s in seconds])
    np.testing.assert_allclose(run.time_s, seconds[:20])
    assert any("the clock restarts: cut into 2 runs" in line for line in lines)


@pytest.mark.parametrize(
    ("header", "modulus", "period", "per_second", "form"),
    [
        ("t_us", 2**32, 1000, 1e6, "{:.0f}"),  # micros() of a microcontroller after 71.6 minutes
        ("t_us", 2**32, 517, 1e6, "{:.0f}"),
        ("t_ms", 2**16, 5, 1e3, "{:.0f}"),
        ("t_s", 2**32 / 1e6, 0.002, 1.0, "{:.6f}"),
        ("t_ms", 2**32 / 1e3, 0.5, 1e3, "{:.4f}"),
    ],
)
def test_a_counter_that_starts_anew_is_continued(
    header: str, modulus: float, period: float, per_second: float, form: str, axis: Machine, tmp_path: Path
) -> None:
    ticks = modulus - 100.4 * period + period * np.arange(300)
    if form == "{:.0f}":
        ticks = np.rint(ticks)
    run, lines = imported(tmp_path, axis, header, [form.format(t % modulus) for t in ticks])
    np.testing.assert_allclose(run.time_s, ticks / per_second, rtol=1e-8)
    assert any(
        "time_s goes on where a counter of" in line and "started anew (once)" in line for line in lines
    )


def test_a_counter_that_starts_anew_several_times_is_continued(axis: Machine, tmp_path: Path) -> None:
    ticks = 5000 + 400 * np.arange(1000)
    run, lines = imported(tmp_path, axis, "t_us", [str(t % 2**16) for t in ticks])
    np.testing.assert_allclose(run.time_s, ticks / 1e6)
    assert any("a counter of 16 bits started anew (6 times)" in line for line in lines)


def sessions(
    folder: Path, machine: Machine, times: list[float], **options: object
) -> tuple[list[Recording], str]:
    """Import a log with some times, s; return its runs and what was printed."""
    rows = [f"{time:.3f},{0.01 * k:.2f},{1e-4 * k:.4f}" for k, time in enumerate(times)]
    (folder / "log.csv").write_text("\n".join(["time_s,v_V,x_m", *rows]))
    lines: list[str] = []
    import_logs(folder / "log.csv", folder / "runs", machine, ImportSettings(**options), log=lines.append)  # type: ignore[arg-type]
    return load_recordings(folder / "runs", machine), "\n".join(lines)


def test_a_log_is_cut_where_its_clock_restarts(axis: Machine, tmp_path: Path) -> None:
    first, second, third = 5.0 + 0.01 * np.arange(40), 0.01 * np.arange(60), 0.2 + 0.01 * np.arange(30)
    runs, text = sessions(tmp_path, axis, [*first, *second, *third])
    assert [run.name for run in runs] == ["log_01", "log_02", "log_03"]
    for run, times, rows in zip(
        runs, (first, second, third), (range(40), range(40, 100), range(100, 130)), strict=True
    ):
        np.testing.assert_allclose(run.time_s, times, atol=1e-9)
        np.testing.assert_allclose(run.outputs[:, 0], 1e-4 * np.array(rows), atol=1e-9)
    assert "the clock restarts: cut into 3 runs (new runs begin in row 41, 101)" in text


def test_rows_of_the_session_before_are_left_out(axis: Machine, tmp_path: Path) -> None:
    (run,), text = sessions(tmp_path, axis, [1.074, *(0.008 + 0.01 * np.arange(100))])
    assert (run.name, len(run.time_s)) == ("log", 100)
    assert "1 row left out beside a restart of the clock, with fewer than ten times" in text


def test_rows_of_a_buffer_that_were_not_filled_are_left_out(axis: Machine, tmp_path: Path) -> None:
    (run,), text = sessions(tmp_path, axis, [*(0.1 + 0.01 * np.arange(200)), *(0.0,) * 12])
    assert (run.name, len(run.time_s)) == ("log", 200)
    assert "12 rows left out beside a restart of the clock, with fewer than ten times" in text


def test_a_speed_is_integrated_and_a_log_cut_within_each_session(axis: Machine, tmp_path: Path) -> None:
    times = [*(0.01 * np.arange(300)), *(0.01 * np.arange(300))]
    rows = [f"{time:.2f},1,{0.5 if k < 300 else -0.5}" for k, time in enumerate(times)]
    (tmp_path / "log.csv").write_text("\n".join(["time_s,v_V,speed", *rows]))
    settings = ImportSettings(MappingOptions({"x_m": "speed"}, {"x_m": "m/s"}), every=1.5)
    import_logs(tmp_path / "log.csv", tmp_path / "runs", axis, settings, log=str)
    runs = load_recordings(tmp_path / "runs", axis)
    assert [run.name for run in runs] == ["log_01_01", "log_01_02", "log_02_01", "log_02_02"]
    np.testing.assert_allclose([run.outputs[-1, 0] for run in runs[1::2]], [1.495, -1.495])


@pytest.mark.parametrize(
    "wrong",
    [
        [0.41, 0.40],  # two rows in a wrong order
        [0.005],  # one wrong time
    ],
)
def test_times_in_a_wrong_order_are_no_restart(wrong: list[float], axis: Machine, tmp_path: Path) -> None:
    times = [*(0.01 * np.arange(40)), *wrong, *(0.42 + 0.01 * np.arange(40))]
    with pytest.raises(InputError, match=r"column time_s: .* goes back.*are rows in a wrong order"):
        sessions(tmp_path, axis, times)


def test_a_fault_after_a_restart_names_where_its_rows_are_counted_from(axis: Machine, tmp_path: Path) -> None:
    times = [*(1.0 + 0.01 * np.arange(40)), *(0.01 * np.arange(40)), 0.38, *(0.41 + 0.01 * np.arange(9))]
    with pytest.raises(InputError, match=r"row 41, .* rows count from row 41, where the clock restarts"):
        sessions(tmp_path, axis, times)


def test_stamps_that_repeat_name_the_rate_that_repairs_them(axis: Machine, tmp_path: Path) -> None:
    times = [str(k // 2) for k in range(2000)]
    with pytest.raises(InputError) as error:
        imported(tmp_path, axis, "t_ms", times)
    assert str(error.value).endswith(
        "row 2, column time_s: 0 repeats row 1; times must increase; the clock has steps of 0.001 s: if "
        "the rows are equally spaced, state their rate: --map time_s=2000Hz; time_s is the column 't_ms'"
    )
    run, _ = imported(tmp_path, axis, "t_ms", times, columns={"time_s": "2000Hz"})
    np.testing.assert_allclose(run.time_s, np.arange(2000) / 2000)


def test_rows_that_repeat_completely_are_left_out(axis: Machine, tmp_path: Path) -> None:
    rows = [f"{0.001 * k:.3f};{0.01 * k:.2f};{1e-4 * k:.4f};" for k in range(50)]
    doubled = [rows[0], *(row for row in rows for _ in range(2)), rows[-1]]
    (tmp_path / "log.csv").write_text(
        "\n".join(["t_s;v_V;x_m;note", *(f"{row}{k}" for k, row in enumerate(doubled))])
    )
    lines: list[str] = []
    import_logs(tmp_path / "log.csv", tmp_path / "runs", axis, log=lines.append)
    (run,) = load_recordings(tmp_path / "runs", axis)
    np.testing.assert_allclose(run.outputs[:, 0], 1e-4 * np.arange(50), atol=1e-12)
    assert "  52 rows left out that repeat the row before and its time" in lines


def test_of_two_rows_with_a_time_that_rarely_repeats_the_later_one_is_used(
    axis: Machine, tmp_path: Path
) -> None:
    rows = [f"{(k if k < 50 else k - 1)};{0.01 * k:.2f};{1e-4 * k:.4f}" for k in range(201)]
    (tmp_path / "log.csv").write_text("\n".join(["t_ms;v_V;x_m", *rows]))
    lines: list[str] = []
    import_logs(tmp_path / "log.csv", tmp_path / "runs", axis, log=lines.append)
    (run,) = load_recordings(tmp_path / "runs", axis)
    np.testing.assert_allclose(run.outputs[:, 0], 1e-4 * np.delete(np.arange(201), 49), atol=1e-12)
    assert any(
        "  1 row left out whose time the next row repeats; if all rows are equally" in line for line in lines
    )


@pytest.mark.parametrize(("step", "unit"), [(1, "ms"), (20, "ms"), (250, "us"), (100_000, "ns")])
def test_a_time_without_a_unit_is_refused_with_its_likely_unit(
    step: int, unit: str, axis: Machine, tmp_path: Path
) -> None:
    with pytest.raises(
        InputError, match=rf"has no unit and steps of {step:g}, .* by --unit time_s={unit} \(rows at"
    ):
        imported(tmp_path, axis, "t", [str(k * step) for k in range(100)])


def test_two_clocks_of_one_rate_leave_no_gaps(axis: Machine, tmp_path: Path) -> None:
    kept = np.array([k for k in range(50) if k not in (30, 31)])
    rows = [f"{0.02 * k:.3f};{0.01 * k:.2f};{0.02 * k + 0.006:.3f};{1e-4 * k:.4f}" for k in kept]
    (tmp_path / "log.csv").write_text("\n".join(["t_s;v_V;time_s.2;x_m", *rows]))
    lines: list[str] = []
    settings = ImportSettings(MappingOptions({"time_s": "t_s,time_s.2"}))
    import_logs(tmp_path / "log.csv", tmp_path / "runs", axis, settings, lines.append)
    (run,) = load_recordings(tmp_path / "runs", axis)
    measured = np.isfinite(run.outputs[:, 0])
    np.testing.assert_allclose(run.time_s[measured], 0.02 * kept + 0.006, atol=1e-9)
    np.testing.assert_allclose(run.inputs[measured, 0], 0.01 * kept)
    assert any(line.startswith("  1 gap in time") for line in lines)  # that of the rows that are missing


def test_a_gap_in_epoch_seconds_is_told_to_the_millisecond(axis: Machine, tmp_path: Path) -> None:
    times = [f"{1748600000.25 + 0.01 * k:.2f}" for k in range(100) if not 30 < k < 40]
    _, lines = imported(tmp_path, axis, "time_s", times)
    assert any("the longest 0.1 s at time_s = 1748600000.55" in line for line in lines)
