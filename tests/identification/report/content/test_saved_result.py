"""Tests of saved results: a damaged folder is refused with the name of the file."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.identification.report.content.saved_result import load_result
from hframe_gym.identification.report.page import build_report
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import load_machine, save_machine

Damage = Callable[[Path], object]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return the folder of a small result of the built-in axis."""
    axis = BUILTIN_MACHINES["axis"]()
    save_machine(axis, tmp_path / "declared.json")
    save_machine(
        axis.with_effects(EFFECTS["cogging"].at("motor", A=0.1, n=50.0, p=0.0)), tmp_path / "machine.json"
    )
    errors = {"held_out": {"x_m": {"rmse": 3e-5, "noise_ratio": 1.5}, "force_error": 0.05}}
    parameters = {key: {"value": 0.1, "std": None, "unit": "1"} for key in ("A", "n", "p")}
    cogging = {
        "name": "cogging",
        "site": "motor",
        "parameters": parameters,
        "held_out_gain": 0.9,
        "rivals": [],
    }
    report = {
        "schema": 1,
        "verdict": "effect_found",
        "runs": {"fitted": ["run_1"], "held_out": ["run_2"]},
        **dict.fromkeys(("declared", "before", "after"), errors),
        "effects": [cogging],
        "residual": {
            "depends_on": [{"variable": "velocity of x", "coordinate": "x", "share": 0.5}],
            "white": True,
        },
        "next_experiment": None,
        "seconds": 1.0,
    }
    (tmp_path / "report.json").write_text(json.dumps(report))
    np.savez_compressed(tmp_path / "evidence.npz", **curves())
    return tmp_path


def curves() -> dict[str, Any]:
    """Return curves that fit the report."""
    ramp = np.linspace(0.0, 1.0, 50)
    by_name = {f"run_2/{name}": ramp[:, None] for name in ("measured", "declared", "before", "after")}
    return by_name | {
        "run_2/time_s": ramp,
        **{f"force/{name}": ramp for name in ("variable", "before", "after")},
        "coverage/position of x": ramp,
        "coverage/velocity of x": ramp - 0.5,
        "coverage/v_V": ramp,
    }


def with_curves(**changed: np.ndarray | None) -> Damage:
    """Return a damage that replaces curves (None: removes them); "__" in a name is "/"."""

    def damage(folder: Path) -> None:
        values = curves() | {name.replace("__", "/"): v for name, v in changed.items()}
        np.savez_compressed(folder / "evidence.npz", **{k: v for k, v in values.items() if v is not None})

    return damage


def with_report(*path: str | int, value: Any = None, remove: bool = False) -> Damage:
    """Return a damage that replaces or removes a field of report.json."""

    def damage(folder: Path) -> None:
        report = json.loads((folder / "report.json").read_text())
        entry = report
        for key in path[:-1]:
            entry = entry[key]
        if remove:
            del entry[path[-1]]
        else:
            entry[path[-1]] = value
        (folder / "report.json").write_text(json.dumps(report))

    return damage


def with_text(name: str, text: str) -> Damage:
    """Return a damage that replaces a file by a text."""
    return lambda folder: (folder / name).write_text(text)


def cut(name: str) -> Damage:
    """Return a damage that cuts a file in half, as a full disk does."""
    return lambda folder: (folder / name).write_bytes(
        (folder / name).read_bytes()[: (folder / name).stat().st_size // 2]
    )


def without(name: str) -> Damage:
    """Return a damage that removes a file."""
    return lambda folder: (folder / name).unlink()


def other_array(folder: Path) -> None:
    """Replace the archive of curves by a single array."""
    with (folder / "evidence.npz").open("wb") as file:
        np.save(file, np.zeros(3))


DAMAGES: dict[str, tuple[Damage, str]] = {
    "no report": (without("report.json"), "no report.json here"),
    "empty report": (with_text("report.json", ""), "report.json: is not valid: "),
    "half a report": (cut("report.json"), "report.json: is not valid: "),
    "a list": (with_text("report.json", "[]"), "report.json: is not valid: "),
    "not a text": (
        lambda f: (f / "report.json").write_bytes(b"\xff\xfe\x00"),
        "report.json: is not a text file",
    ),
    "another channel": (
        with_report("declared", "held_out", "y_m", value={"rmse": 1e-5, "noise_ratio": 1.0}),
        "report.json: declared.held_out has other channels",
    ),
    "other schema": (with_report("schema", value=2), "report.json: schema: "),
    "unknown verdict": (with_report("verdict", value="perhaps"), "report.json: verdict: "),
    "no verdict": (with_report("verdict", remove=True), "report.json: verdict: "),
    "no held-out runs": (with_report("runs", "held_out", value=[]), "report.json: runs.held_out: "),
    "error as a text": (
        with_report("after", "held_out", "x_m", "rmse", value="3e-5"),
        "report.json: after.held_out",
    ),
    "channel missing": (
        with_report("after", "held_out", "x_m", remove=True),
        "report.json: after.held_out has no errors",
    ),
    "channel is a number": (
        with_report("before", "held_out", "x_m", value=1.0),
        "report.json: before.held_out has no",
    ),
    "force error in one": (
        with_report("before", "held_out", "force_error", remove=True),
        "report.json: force_error",
    ),
    "effect unknown": (
        with_report("effects", 0, "site", value="motor7"),
        "report.json: effect cogging at motor7",
    ),
    "gain missing": (
        with_report("effects", 0, "held_out_gain", remove=True),
        "report.json: effects.0.held_out_gain",
    ),
    "parameter is null": (
        with_report("effects", 0, "parameters", "A", value=None),
        "report.json: effects.0.parameters.A",
    ),
    "coordinate unknown": (
        with_report("residual", "depends_on", 0, "coordinate", value="z"),
        "report.json: residual.depends_on",
    ),
    "warnings as a text": (with_report("warnings", value="all is well"), "report.json: warnings: "),
    "no machine": (without("machine.json"), "machine.json: is missing"),
    "half a machine": (cut("machine.json"), "machine.json: "),
    "machine as a list": (with_text("declared.json", "[]"), "declared.json: "),
    "no curves": (without("evidence.npz"), "evidence.npz: is missing"),
    "half the curves": (cut("evidence.npz"), "evidence.npz: is not a readable .npz file"),
    "curves as a text": (
        with_text("evidence.npz", "no archive"),
        "evidence.npz: is not a readable .npz file",
    ),
    "curves as one array": (other_array, "evidence.npz: is not a readable .npz file"),
    "curves of objects": (
        with_curves(force__before=np.array([None, 1])),
        "evidence.npz: is not a readable .npz file",
    ),
    "curves of texts": (with_curves(force__before=np.array(["a"])), "evidence.npz: force/before holds"),
    "run missing": (with_curves(run_2__time_s=None), "evidence.npz: has no array run_2/time_s"),
    "another length": (
        with_curves(run_2__after=np.zeros((7, 1))),
        "evidence.npz: array run_2/after has the shape",
    ),
    "another width": (
        with_curves(run_2__after=np.zeros((50, 3))),
        "evidence.npz: array run_2/after has the shape",
    ),
    "empty run": (with_curves(run_2__time_s=np.zeros(0)), "evidence.npz: array run_2/time_s has the shape"),
    "inputs of another length": (
        with_curves(
            run_2__inputs=np.zeros((7, 1)), force__variable=None, force__before=None, force__after=None
        ),
        "evidence.npz: array run_2/inputs has the shape (7, 1)",
    ),
    "forces differ": (
        with_curves(force__after=np.zeros(7)),
        "evidence.npz: array force/after has another length",
    ),
    "coverage of nothing": (
        with_curves(**{"coverage/position of z": np.zeros(3)}),
        "evidence.npz: array coverage/",
    ),
    "coverage not finite": (
        with_curves(**{"coverage/v_V": np.full(3, np.nan)}),
        "evidence.npz: array coverage/v_V has",
    ),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_folder_is_refused_with_the_name_of_the_file(name: str, folder: Path) -> None:
    damage, message = DAMAGES[name]
    damage(folder)
    with pytest.raises(InputError) as error:
        build_report(folder)
    assert message in str(error.value)
    assert str(folder) in str(error.value)
    assert not (folder / "report.html").exists()


def test_an_undamaged_folder_is_accepted(folder: Path) -> None:
    assert load_result(folder).report.verdict == "effect_found"
    assert "cogging at motor" in build_report(folder).read_text()


def test_a_page_that_cannot_be_written_is_reported(folder: Path) -> None:
    (folder / "plots").write_text("a file in the way")
    with pytest.raises(InputError, match="plots"):
        build_report(folder)


def test_doubts_about_the_machine_are_not_repeated(folder: Path) -> None:
    """They are said when the declaration is read; warnings are errors here."""
    axis = BUILTIN_MACHINES["axis"]()
    far = dataclasses.replace(axis.coordinates[0], range=(-500.0, 500.0))
    machine = axis.replace(coordinates=(far, *axis.coordinates[1:]))
    save_machine(machine, folder / "declared.json")
    with pytest.warns(UserWarning, match="is it in millimeters"):
        load_machine(folder / "declared.json")
    assert load_result(folder).declared.coordinates[0].range == (-500.0, 500.0)
