"""EMPS: a ball-screw axis under a known controller, evaluated by the force of its inverse dynamics."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.real_machines.study import (
    MACHINES,
    data_folder,
    errors_by_machine,
    picture,
    print_effects,
    print_errors,
    write_recording,
)
from benchmarks.results_file import write_results
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import identify
from hframe_gym.identification.forces.inverse_dynamics import force_error
from hframe_gym.identification.forces.missing_force import smooth_force_residual
from hframe_gym.machine import Machine
from hframe_gym.recordings import load_machine, load_recordings

# Janot et al. (2019): viscous and Coulomb friction and an offset, least squares on the first record.
PUBLISHED = {"train": 0.04083, "test": 0.05982}
# N, in their equation on the side of the inertia, so it is a force of the opposite sign.
PUBLISHED_OFFSET = -3.165
RECORDS = ("emps_train", "emps_test_pulses")


def convert(source: Path, target: Path) -> None:
    """Convert both records to recordings: time_s, v_V, x_m."""
    for name in RECORDS:
        table = np.genfromtxt(source / f"{name}.csv", delimiter=",", names=True)
        columns = {"time_s": table["t_s"], "v_V": table["vir_V"], "x_m": table["qm_meas_m"]}
        write_recording(target / f"{name}.csv", columns)


def run(console: Console) -> None:
    """Identify EMPS and report the relative force error of both records, with the published values."""
    source = data_folder("emps", console)
    if source is None:
        return
    machine = load_machine(MACHINES / "emps.json")
    with tempfile.TemporaryDirectory() as folder:
        convert(source, Path(folder))
        recordings = load_recordings(folder, machine)
    answer = identify(recordings, machine, held_out=("emps_test_pulses",), log=console.print, budget=math.inf)

    def measure(m: Machine) -> dict[str, float]:
        return {
            "train": float(force_error(m, answer.fitted) or np.nan),
            "test": float(force_error(m, answer.held_out) or np.nan),
        }

    textbook = machine.with_effects(EFFECTS["constant_force"].at("x", size=-PUBLISHED_OFFSET))
    stages = errors_by_machine(answer, measure)
    errors = {"published": PUBLISHED, "declared (textbook friction, no offset)": stages.pop("declared")}
    errors |= {"declared with the published offset": measure(textbook)} | stages
    print_errors(
        "EMPS, relative force error",
        "%",
        {k: {n: 100 * v for n, v in e.items()} for k, e in errors.items()},
        console,
    )
    print_effects(answer, console)
    test = answer.held_out.runs[0]
    machines = {"refitted": answer.before.machine, "identified": answer.after.machine}
    panels = [
        (
            "unexplained force, N",
            test.time_s,
            {k: smooth_force_residual(m, test, answer.held_out)[:, 0] for k, m in machines.items()},
        )
    ]
    picture("emps", "EMPS, held-out record: force that the model does not explain", panels, console)
    write_results("real_machines_emps", {"force_error": errors, "answer": answer.as_json()}, seed=None)
