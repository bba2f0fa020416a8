"""Texts in files are data: no string of a machine.json reaches code, and no page contains one unescaped."""

from __future__ import annotations

import ast
import json
import typing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.agents import train
from hframe_gym.agents.checkpoint_signature import key_file, refuse_unsigned, sign_checkpoint
from hframe_gym.errors import InputError
from hframe_gym.recordings import TABLES

from .commands import hostile_parts, run_command
from .materials import answer_curves, answer_machine, answer_report, machine_content, run_text, write_material
from .mutations import MARK, PAYLOAD, paths_of, replaced, value_at

pytestmark = pytest.mark.integration

INJECTIONS = (
    PAYLOAD,
    f"x\n{PAYLOAD}\n",
    f'"""\n{PAYLOAD}\n"""',
    f"x); {PAYLOAD} #",
    f"{{{PAYLOAD}}}",
    "os:system",
    "\x1b[2J",
)
SCRIPT = f'--><script>{MARK}()</script>$\\frac_$[/b]" onload="{MARK}()'
CONTENT = machine_content()
CONTENT["drives"][0] |= {"kind": "duty-cycle", "supply": "supply_V"}
STRING_FIELDS = [path for path in paths_of(CONTENT) if isinstance(value_at(CONTENT, path), str)]
KEYED_FIELDS = [path for path in paths_of(CONTENT) if isinstance(path[-1], str) and path[-2:-1] != ()]
FREE_KEYS = [p for p in KEYED_FIELDS if p[-2] in ("extension", "length", "row", "parameters", "ties")]


def _string_fields(annotation: Any) -> bool:
    """Return whether an annotation of the schema accepts strings."""
    return annotation is str or any(map(_string_fields, typing.get_args(annotation)))


def test_the_example_has_every_string_field_of_the_schema() -> None:
    wanted = {
        (table.__name__, info.alias or name)
        for table in TABLES
        for name, info in table.model_fields.items()
        if _string_fields(info.annotation) and name != "comment"
    }
    present = {name for path in STRING_FIELDS + FREE_KEYS for name in path if isinstance(name, str)}
    assert [field for field in wanted if field[1] not in present] == []
    assert "comment" in present


@pytest.mark.parametrize("path", STRING_FIELDS, ids=lambda path: ".".join(map(str, path)))
def test_code_in_a_string_of_a_machine_is_refused_or_harmless(
    path: tuple[str | int, ...], tmp_path: Path
) -> None:
    for text in INJECTIONS:
        _assert_harmless(json.dumps(replaced(CONTENT, path, text)), tmp_path)


@pytest.mark.parametrize("path", FREE_KEYS, ids=lambda path: ".".join(map(str, path)))
def test_code_in_a_key_of_a_machine_is_refused_or_harmless(
    path: tuple[str | int, ...], tmp_path: Path
) -> None:
    for text in INJECTIONS:
        parent = value_at(CONTENT, path[:-1])
        renamed = {text if key == path[-1] else key: value for key, value in parent.items()}
        _assert_harmless(json.dumps(replaced(CONTENT, path[:-1], renamed)), tmp_path)


def _assert_harmless(text: str, folder: Path) -> None:
    """Assert that a machine.json is refused, or that neither its kernel nor the output has its strings."""
    (folder / "m.json").write_text(text)
    shown = run_command(("machines", "show", "m.json"), folder)
    assert shown.problem == ""
    assert "\x1b" not in shown.out
    kernel = run_command(("kernel", "m.json"), folder)
    assert kernel.problem == ""
    if kernel.code == 0:
        ast.parse(kernel.out)
        assert MARK not in kernel.out
        (folder / "run.csv").write_text(run_text())
        simulated = run_command(
            ("simulate", "--machine", "m.json", "--inputs", "run.csv", "--out", "o.csv"), folder
        )
        assert simulated.problem == ""
    assert not (folder / MARK).exists()


def _assert_escaped(page: Path) -> None:
    """Assert that a page contains the hostile text, but neither as an element nor as an attribute."""
    assert MARK in page.read_text()
    assert hostile_parts(page) == []


def test_the_report_escapes_every_text_of_its_folder(tmp_path: Path) -> None:
    folder = tmp_path / "answer"
    write_material("answer", folder)
    report, run = answer_report(), f"run {SCRIPT}"
    report["runs"]["held_out"] = [run]
    report["warnings"] = [SCRIPT]
    report["next_experiment"] |= {"why": SCRIPT, "file": SCRIPT}
    report["considered"][0] |= {"name": SCRIPT, "site": SCRIPT, "reason": SCRIPT}
    report["effects"][0]["rivals"] = [SCRIPT]
    report["proposed_formulas"][0]["formulas"][0]["formula"] = SCRIPT
    curves = {
        name.replace("run_2", run).replace("v_V", SCRIPT): values for name, values in answer_curves().items()
    }
    np.savez(folder / "evidence.npz", **curves)
    (folder / "report.json").write_text(json.dumps(report))
    for name in ("machine.json", "declared.json"):
        (folder / name).write_text(json.dumps(answer_machine() | {"name": SCRIPT, "description": SCRIPT}))
    for name in ("machine.json", "declared.json", "report.json"):
        channel = f"<script>{MARK}()</script>[/b]$_m"  # quotation marks are refused
        (folder / name).write_text((folder / name).read_text().replace("x_m", channel))
    outcome = run_command(("report", "answer"), tmp_path)
    assert (outcome.code, outcome.problem, outcome.errors) == (0, "", ())
    _assert_escaped(folder / "report.html")


def test_the_scorecard_escapes_the_names_of_machines_and_controllers(tmp_path: Path) -> None:
    name = f"<script>{MARK}()<|script>[b].json"
    (tmp_path / name).write_text(json.dumps(machine_content() | {"name": SCRIPT}))
    write_material("agent", tmp_path / f"<script>{MARK}()[b]")
    words = (
        "evaluate",
        f"<script>{MARK}()[b]",
        "--machine",
        name,
        "--episodes",
        "2",
        "--html",
        "--out",
        "out",
    )
    outcome = run_command(words, tmp_path)
    assert (outcome.code, outcome.problem) == (0, "")
    _assert_escaped(tmp_path / "out" / "scorecard.html")


@pytest.mark.train
@pytest.mark.usefixtures("brief_evaluations")
def test_a_checkpoint_is_resumed_only_where_it_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "first"))
    folder = tmp_path / "agent"
    train("ppo", steps=1, out=folder, log=lambda line: None)
    assert key_file().stat().st_mode & 0o077 == 0
    steps = json.loads((folder / "card.json").read_text())["curve"][-1]["steps"] + 1
    train("ppo", steps=steps, out=folder, resume=True, log=lambda line: None)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "second"))
    with pytest.raises(InputError, match=r"was not written by this installation.*--trust"):
        train("ppo", steps=steps + 1, out=folder, resume=True, log=lambda line: None)
    train("ppo", steps=steps + 1, out=folder, resume=True, log=lambda line: None, trust=True)


@pytest.mark.parametrize("change", ["first byte", "last byte", "appended", "cut"])
def test_a_changed_checkpoint_has_no_valid_signature(
    change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    file = tmp_path / "checkpoint.zip"
    file.write_bytes(b"content")
    sign_checkpoint(file)
    refuse_unsigned(file)
    data = file.read_bytes()
    changed = {
        "first byte": b"C" + data[1:],
        "last byte": data[:-1] + b"g",
        "appended": data + b"x",
        "cut": data[:3],
    }
    file.write_bytes(changed[change])
    with pytest.raises(InputError, match="was not written by this installation"):
        refuse_unsigned(file)


def test_without_a_place_for_the_key_training_continues_unsigned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("in the way of the folder")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "file"))
    file = tmp_path / "checkpoint.zip"
    file.write_bytes(b"content")
    sign_checkpoint(file)
    assert file.read_bytes() == b"content"
    with pytest.raises(InputError, match="add --trust"):
        refuse_unsigned(file)
