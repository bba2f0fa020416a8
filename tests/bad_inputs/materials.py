"""Small valid files of every kind that the commands read; tests and the fuzzer damage them."""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hframe_gym.agents import shipped_agent_folder
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS, get_effect
from hframe_gym.effects.smooth_table import KNOTS
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import machine_to_dict

ROWS = 60
HEADER = ("time_s", "v1_V", "v2_V", "phi1_rad", "phi2_rad", "x_m", "y_m")


@cache
def run_table() -> np.ndarray:
    """Return a run of the H-frame at 1 kHz, rest and then a move, columns as in `HEADER`, shape (ROWS, 7)."""
    machine = BUILTIN_MACHINES["hframe"]()
    time_s = 1e-3 * np.arange(ROWS)
    inputs = np.zeros((ROWS, 2))
    inputs[ROWS // 3 :] = (-4.0, 3.0)
    return np.column_stack([time_s, inputs, simulate(machine, time_s, inputs).outputs])


def run_text() -> str:
    """Return the run as a CSV file."""
    lines = [",".join(f"{value:.9g}" for value in row) for row in run_table()]
    return "\n".join([",".join(HEADER), *lines]) + "\n"


def write_run(path: Path) -> None:
    """Write the run as .csv, .csv.gz, .parquet or .mat, as the name of the file ends."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(run_text().encode(), mtime=0))
    elif path.suffix == ".parquet":
        import pyarrow
        from pyarrow import parquet

        parquet.write_table(pyarrow.table(dict(zip(HEADER, run_table().T, strict=True))), path)
    elif path.suffix == ".mat":
        from scipy import io

        io.savemat(path, dict(zip(HEADER, run_table().T, strict=True)), do_compression=True)
    else:
        path.write_text(run_text())


def log_text() -> str:
    """Return a log with semicolons, decimal commas, units, a comment and a time stamp."""
    lines = ["# logger 7", "t [ms];U1;U2;phi1 [deg];phi2 [deg];x [mm];y [mm]"]
    for time_s, u1, u2, phi1, phi2, x, y in run_table():
        values = (1e3 * time_s, u1, u2, np.degrees(phi1), np.degrees(phi2), 1e3 * x, 1e3 * y)
        lines.append(";".join(f"{value:.6f}".replace(".", ",") for value in values))
    return "\n".join(lines) + "\n"


def dialect_texts() -> dict[str, str]:
    """Return logs with names and units in comments, other row ends, names before numbers, and of LabVIEW."""
    rows = [[f"{value:.6f}" for value in row] for row in run_table()]
    comments = [
        "%logger 7",
        f"%{','.join(HEADER)}",
        "%[s],[V],[V],[rad],[rad],[m],[m]",
        "nan" + 6 * ",nan" + ";",
    ]
    comments += [f"{','.join(row)};" for row in rows]
    labels = [",".join(f"{name}:{value}" for name, value in zip(HEADER, row, strict=True)) for row in rows]
    labview = [
        "LabVIEW Measurement\t",
        "Separator\tTab",
        "***End_of_Header***\t",
        "Channels\t6\t",
        "Delta_X\t0.001\t0.001",
    ]
    labview += ["***End_of_Header***\t\t", "\t".join([*HEADER, "Comment"]), *("\t".join(row) for row in rows)]
    texts = {"comments": comments, "labels": labels, "labview": labview}
    return {name: "\n".join(lines) + "\n" for name, lines in texts.items()}


def sysid_content() -> dict[str, Any]:
    """Return the content of a JSON file of SysId with two tests."""
    rows = [[float(row[0]), float(row[1]), float(row[5]), 0.0] for row in run_table()]
    content: dict[str, Any] = {"sysid": True, "test": "Simple", "units": "Meters", "unitsPerRotation": 0.5}
    return content | {"slow-forward": rows[:40], "fast-backward": rows[:20]}


def mapping_text(suffix: str = ".toml") -> str:
    """Return a mapping file for the log."""
    tables = {"map": {"v1_V": "U1", "v2_V": "U2"}, "unit": {"x_m": "mm"}, "scale": {"v1_V": 1.0}}
    if suffix == ".json":
        return json.dumps(tables)
    return '[map]\nv1_V = "U1"\nv2_V = "U2"\n[unit]\nx_m = "mm"\n[scale]\nv1_V = 1.0\n'


def machine_content(name: str = "hframe") -> dict[str, Any]:
    """Return the content of a machine.json with an example of every field."""
    content = machine_to_dict(BUILTIN_MACHINES[name]())
    content |= {"comment": ["a machine"], "$schema": "machine.schema.json"}
    content["effects"] = [
        {
            "name": "stribeck_friction",
            "site": "x",
            "parameters": {"dF": {"value": 0.8, "unit": "N"}, "vs": {"value": 0.02, "unit": "m/s"}},
        }
    ]
    first = content["coordinates"][0]["name"]
    content["uncertainty"] = {"names": [f"{first}.mass"], "covariance": [[1e-6]]}
    content["ties"] = {f"{first}.viscous": [f"{first}.coulomb", 1.0]}
    content["drives"][0] |= {
        "current_limit": {"value": 10.0, "unit": "A"},
        "delay": {"value": 1e-3, "unit": "s"},
    }
    content["sensors"][-1] |= {"range": [-1.0, 1.0]}
    return content


def path_text() -> str:
    """Return a path with times for the task `track`."""
    angle = np.linspace(0.0, 2.0 * np.pi, 25)
    rows = zip(np.linspace(0.0, 1.0, 25), 0.05 * np.cos(angle), 0.05 * np.sin(angle), strict=True)
    return "time_s,x_m,y_m\n" + "".join(f"{t:.6g},{x:.6g},{y:.6g}\n" for t, x, y in rows)


def curve_parameters() -> dict[str, float]:
    """Return the parameters of a table over the position of an axis."""
    knots = {f"k{i:02d}": 0.01 * i - 0.12 for i in range(KNOTS)}
    return knots | {f"f{i:02d}": 0.1 * float(np.sin(i)) for i in range(KNOTS)}


def answer_curves() -> dict[str, np.ndarray]:
    """Return the arrays of an answer's evidence.npz."""
    ramp = np.linspace(0.0, 1.0, 50)
    by_name = {f"run_2/{name}": 1e-5 * ramp[:, None] for name in ("measured", "declared", "before", "after")}
    return by_name | {
        "run_2/time_s": ramp,
        **{f"force/{name}": ramp for name in ("variable", "before", "after")},
        "coverage/position of x": ramp,
        "coverage/velocity of x": ramp - 0.5,
        "coverage/v_V": ramp,
    }


def answer_report() -> dict[str, Any]:
    """Return the content of an answer's report.json with an example of every field."""
    errors = {"held_out": {"x_m": {"rmse": 3e-5, "noise_ratio": 1.5}, "force_error": 0.05}}
    parameters = {key: {"value": 0.1, "std": 0.01, "unit": "1"} for key in ("A", "n", "p")}
    table = "smooth_force[position of x]@x"
    formula = {
        "table": table,
        "terms": ["constant"],
        "formula": "c",
        "parameters": {"c": 0.1},
        "complexity": 1,
        "curve_error": 0.5,
        "fitted": 1.1,
        "held_out": {"x_m": 1.2},
        "recommended": True,
    }
    return {
        "schema": 1,
        "verdict": "effect_found",
        "runs": {"fitted": ["run_1"], "held_out": ["run_2"]},
        **dict.fromkeys(("declared", "before", "after"), errors),
        "effects": [
            {
                "name": "cogging",
                "site": "motor",
                "parameters": parameters,
                "size": 0.1,
                "held_out_gain": 0.9,
                "rivals": ["presliding@x"],
            }
        ],
        "residual": {
            "depends_on": [{"variable": "velocity of x", "coordinate": "x", "share": 0.5}],
            "white": False,
        },
        "explained": 0.9,
        "left": 1.5,
        "considered": [
            {"name": "presliding", "site": "x", "size": 0.1, "held_out_gain": 0.01, "reason": "small"}
        ],
        "not_separable": [
            {
                "parameters": ["x.viscous", "motor.Ke"],
                "determined": [{"weights": {"x.viscous": 1.0, "motor.Ke": 2.0}, "value": 3.0, "std": 0.1}],
            }
        ],
        "next_experiment": {
            "separates": ["a", "b"],
            "why": "It separates them.",
            "file": "next_experiment.csv",
        },
        "seconds": 1.0,
        "warnings": ["advice: odd"],
        "proposed_formulas": [
            {
                "table": table,
                "complexity": KNOTS,
                "fitted": 1.0,
                "held_out": {"x_m": 1.1},
                "formulas": [formula],
            }
        ],
    }


def answer_machine() -> dict[str, Any]:
    """Return the content of an answer's machine.json."""
    axis = BUILTIN_MACHINES["axis"]()
    table = get_effect("smooth_force[position of x]").at("x", **curve_parameters())
    content = machine_to_dict(axis.with_effects(EFFECTS["cogging"].at("motor", A=0.1, n=50.0, p=0.0), table))
    content["uncertainty"] = {"names": ["x.mass", "x.viscous"], "covariance": [[1e-6, 0.0], [0.0, 1e-4]]}
    return content


def write_answer(folder: Path) -> None:
    """Write a folder as `hframe identify` does."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "report.json").write_text(json.dumps(answer_report()))
    (folder / "machine.json").write_text(json.dumps(answer_machine()))
    (folder / "declared.json").write_text(json.dumps(machine_to_dict(BUILTIN_MACHINES["axis"]())))
    np.savez_compressed(folder / "evidence.npz", **answer_curves())


def write_agent(folder: Path) -> None:
    """Copy the shipped agent `ppo` of the task `reach`."""
    shutil.copytree(shipped_agent_folder("ppo", "reach"), folder)


WRITERS: dict[str, Callable[[Path], None]] = {
    "run": write_run,
    "log": lambda path: path.write_text(log_text()) and None,
    "mapping": lambda path: path.write_text(mapping_text(path.suffix)) and None,
    "machine": lambda path: path.write_text(json.dumps(machine_content())) and None,
    "path": lambda path: path.write_text(path_text()) and None,
    "answer": write_answer,
    "agent": write_agent,
}


def write_material(kind: str, path: Path) -> None:
    """Write a valid file or folder of a kind.

    Args:
        kind: Key of `WRITERS`.
        path: File or folder to write; its parent is created.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    WRITERS[kind](path)
