"""Exported files: whole or not at all, where --out says, equal for equal machines; exporters' commands."""

from __future__ import annotations

import dataclasses
import io
import re
import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest

from hframe_gym import cli
from hframe_gym.errors import InputError
from hframe_gym.exporters import EXPORTERS, Exporter, MachineExporter, option
from hframe_gym.exporters.base import operating_point, plain
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import save_machine

KINDS = [name for name in EXPORTERS if issubclass(EXPORTERS.get(name), MachineExporter)]


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Run the command `hframe export` with these words; return exit code, output and errors."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["hframe", "export", *words])
        with pytest.raises(SystemExit) as stop:
            cli.main()
    printed = capsys.readouterr()
    return int(stop.value.code or 0), printed.out, printed.err


@pytest.mark.filterwarnings("ignore:textbook-pid is unstable")
@pytest.mark.parametrize("kind", KINDS)
def test_every_file_names_machine_version_and_units_and_has_no_date(kind: str) -> None:
    exporter = EXPORTERS.get(kind)(machine="corexy")  # type: ignore[call-arg]
    assert isinstance(exporter, MachineExporter)
    files = exporter.files(exporter.loaded())
    assert files == exporter.files(exporter.loaded())
    for name, content in files.items():
        if name.endswith(".fmu"):
            with zipfile.ZipFile(io.BytesIO(bytes(content))) as archive:
                content = archive.read("modelDescription.xml").decode()
        text = content if isinstance(content, str) else content.decode("latin-1")
        if name.endswith(".mat"):
            text = text.encode("latin-1").decode("utf-16-le", "ignore") + text
        assert "corexy" in text or isinstance(content, bytes), name
        assert "hframe_gym" in text, name


def test_a_file_or_a_folder_is_written(tmp_path: Path) -> None:
    exporter = EXPORTERS.get("state-space")()  # type: ignore[call-arg]
    exporter.write(tmp_path / "folder")
    names = {p.name for p in (tmp_path / "folder").iterdir()}
    assert names == {"state_space.json", "state_space.mat", "state_space.csv", "modes.csv"}
    exporter.write(tmp_path / "alone" / "model.mat")
    assert (tmp_path / "alone" / "model.mat").read_bytes() == (
        tmp_path / "folder" / "state_space.mat"
    ).read_bytes()
    assert len(list((tmp_path / "alone").iterdir())) == 1
    with pytest.raises(InputError, match=r"model.csv: the export state-space has the files .*modes.csv"):
        exporter.write(tmp_path / "model.csv")  # two files have this suffix
    with pytest.raises(InputError, match=r"stage.c: the export c has the files .* name a folder"):
        EXPORTERS.get("c")().write(tmp_path / "stage.c")  # type: ignore[call-arg]
    (tmp_path / "taken").write_text("old")
    with pytest.raises(InputError, match="taken: is a file, but must be a folder"):
        exporter.write(tmp_path / "taken")
    assert (tmp_path / "taken").read_text() == "old"


def test_nothing_is_written_if_an_export_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, errors = run(capsys, "klipper", "--machine", "axis", "--out", str(tmp_path / "out"))
    assert (code, list(tmp_path.iterdir())) == (2, [])
    assert "machine 'axis': along x the carriage has no vibration against held motors" in errors


def test_the_command_writes_what_the_library_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, output, _ = run(
        capsys, "klipper", "--machine", "corexy", "--shaper", "ei", "--at", "x=0.1", "--out", str(tmp_path)
    )
    exporter = EXPORTERS.get("klipper")(machine="corexy", shaper="ei", at=["x=0.1"])  # type: ignore[call-arg]
    assert isinstance(exporter, MachineExporter)
    assert code == 0
    for name, content in exporter.files(exporter.loaded()).items():
        assert f"wrote {tmp_path / name}" in output.replace("\n", "")
        assert (tmp_path / name).read_text() == content


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["state-spce", "--out", "x"],
            "kind of export 'state-spce' is unknown; choose one of .* did you mean 'state-space'",
        ),
        (["nobody", "--out", "x"], "kind of export 'nobody' is unknown"),
        (["klipper", "--shaper", "best", "--out", "x"], "'--shaper': 'best' is not one of 'zv', 'mzv', 'ei'"),
        (
            ["state-space", "--at", "z=1", "--out", "x"],
            "--at z=1: write AXIS=POSITION with one of the axes x, y",
        ),
        (["state-space", "--at", "x=left", "--out", "x"], "'left' is not a number in m"),
        (["state-space", "--at", "x=9", "--out", "x"], "--at x=9: must be from .* m, the range of x"),
        (["c", "--prefix", "1st", "--out", "x"], "--prefix 1st: must be a letter"),
        (["c", "--period", "1e-9", "--out", "x"], "period"),
        (["mjcf", "--step", "0", "--out", "x"], "--step 0: must be from"),
    ],
)
def test_wrong_words_give_one_line(
    words: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, errors = run(capsys, *words)
    assert code == 2
    [line] = errors.splitlines()
    assert re.search(message, line), line
    assert list(tmp_path.iterdir()) == []


def test_an_exporter_of_a_plugin_is_a_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    @EXPORTERS.register("masses")
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Masses(MachineExporter):
        """Write the masses.

        Example:  hframe export masses --out masses.txt
        """

        unit: str = option("kg", "Unit of the masses.")

        def files(self, machine: Machine) -> dict[str, str]:
            """Return the masses."""
            return {"masses.txt": "".join(f"{c.name} {c.mass} {self.unit}\n" for c in machine.coordinates)}

    try:
        assert (
            run(
                capsys, "masses", "--machine", "axis", "--unit", "kilograms", "--out", str(tmp_path / "m.txt")
            )[0]
            == 0
        )
        assert (tmp_path / "m.txt").read_text().split()[2] == "kilograms"
        assert issubclass(EXPORTERS.get("masses"), Exporter)
    finally:
        EXPORTERS.unregister("masses")


def test_names_of_a_machine_file_end_no_comment(tmp_path: Path, hframe: Machine) -> None:
    machine = hframe.replace(
        name="*/ int evil; /* *) evil; (* --> <evil/> <!-- ü \n#define X", description="\\\n"
    )
    for kind in KINDS:
        exporter = EXPORTERS.get(kind)(machine=machine)  # type: ignore[call-arg]
        for name, text in exporter.files(machine).items():  # type: ignore[attr-defined]
            if isinstance(text, str) and name.endswith(
                (".c", ".h", ".st", ".xml", ".urdf", ".cfg", ".gcode", ".csv")
            ):
                head = text[: text.index("SHA-256")]
                assert "\n#define X" not in head
                assert not any(sign in head for sign in ("*/", "*)")), name
            if name.endswith((".xml", ".urdf")):
                ElementTree.fromstring(text)  # a comment that ends early is no XML
    assert plain("a\tb\x1b\n*/c") == "a b? * /c"
    save_machine(machine, tmp_path / "m.json")


def test_operating_points(hframe: Machine) -> None:
    assert operating_point(hframe, None).tolist() == pytest.approx([0.0] * 4)
    point = operating_point(hframe, ["x=0.1", "y=-0.05"])
    assert point[:2].tolist() == [0.1, -0.05]
    assert (hframe.belt_matrix @ point).tolist() == pytest.approx([0.0] * 3)
    assert operating_point(BUILTIN_MACHINES["pendulum"](), ["arm=3"]).tolist() == [3.0]


@pytest.mark.parametrize("kind", ["c", "st", "gains", "fmu", "mjcf", "urdf"])
def test_files_with_positions_in_m_refuse_a_rotary_axis(kind: str, tmp_path: Path) -> None:
    machine = BUILTIN_MACHINES["axis"]()
    turning = dataclasses.replace(machine.coordinates[0], kind="rotary", radius=0.1)
    save_machine(machine.replace(coordinates=(turning,)), tmp_path / "motor.json")
    exporter = EXPORTERS.get(kind)(machine=str(tmp_path / "motor.json"))
    with pytest.raises(InputError, match="has the tool position in m, and x turns; export state-space"):
        exporter.files(exporter.loaded())
