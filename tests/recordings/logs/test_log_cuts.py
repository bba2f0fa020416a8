"""Tests of runs that are parts of logs (`hframe import --cut`)."""

from __future__ import annotations

from pathlib import Path

import pytest

from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import ImportSettings, import_logs, load_recording, parse_interval

AXIS = BUILTIN_MACHINES["axis"]()


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    folder = tmp_path / "logs"
    folder.mkdir()
    for name in ("a", "b"):
        rows = [f"{k * 0.01:.2f},{k % 7},{k * 1e-4}" for k in range(500)]
        (folder / f"{name}.csv").write_text("\n".join(["time_s,v_V,x_m", *rows]))
    return folder


def cut(logs: Path, out: Path, *texts: str, **others: object) -> list[Path]:
    settings = ImportSettings(intervals=tuple(map(parse_interval, texts)), run_format="csv", **others)  # type: ignore[arg-type]
    return import_logs(logs, out, AXIS, settings, log=lambda line: None)


def test_a_cut_of_one_log_leaves_the_others_as_they_are(logs: Path, tmp_path: Path) -> None:
    files = cut(logs, tmp_path / "runs", "b=1:2", "b=3:3.5")
    assert [path.name for path in files] == ["a.csv", "b_01.csv", "b_02.csv"]
    part = load_recording(files[1], AXIS)
    assert (part.time_s[0], part.time_s[-1], len(part.time_s)) == (1.0, 2.0, 101)
    assert part.outputs[0, 0] == pytest.approx(100e-4)


def test_a_cut_without_name_applies_to_every_log_and_keeps_its_name(logs: Path, tmp_path: Path) -> None:
    assert [path.name for path in cut(logs, tmp_path / "runs", "0.5:4")] == ["a.csv", "b.csv"]


@pytest.mark.parametrize(
    ("texts", "others", "message"),
    [
        (("c=1:2",), {}, "there is no such log; the logs are a, b"),
        (("10:12",), {}, r"a: there are no rows from 10 to 12 s; it has 0 to 4\.99 s"),
        (("1:2",), {"split": True}, "exclude each other"),
        (("1:2",), {"every": 2.0}, "exclude each other"),
    ],
)
def test_a_cut_that_cannot_be_writes_nothing(
    logs: Path, tmp_path: Path, texts: tuple[str, ...], others: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        cut(logs, tmp_path / "runs", *texts, **others)
    assert not (tmp_path / "runs").exists() or not any((tmp_path / "runs").iterdir())


def test_only_a_single_long_log_needs_to_be_cut(tmp_path: Path) -> None:
    """Identification needs several runs; several long logs are several runs."""
    folder = tmp_path / "logs"
    folder.mkdir()
    told = []
    for name in ("a", "b"):
        rows = [f"{k * 0.1:.1f},{k % 7},{k * 1e-4}" for k in range(700)]
        (folder / f"{name}.csv").write_text("\n".join(["time_s,v_V,x_m", *rows]))
        lines: list[str] = []
        import_logs(folder, tmp_path / f"runs_{name}", AXIS, log=lines.append)
        told.append("identification needs several runs" in " ".join(lines))
    assert told == [True, False]
