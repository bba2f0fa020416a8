"""CED: two motors, a flexible belt, and a pulley whose counter measures the absolute value of the speed."""

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
from hframe_gym.arrays import Array
from hframe_gym.dynamics import rollout
from hframe_gym.identification import identify
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording, load_machine, load_recordings

HELD_OUT = "prbs_1"  # the amplitudes 1.5 and 0.5 are fitted; the one between them is held out


def convert(source: Path, target: Path) -> None:
    """Convert the three PRBS records to recordings: time_s, u_V, pulley_rad_s."""
    table = np.genfromtxt(source / "ced_prbs.csv", delimiter=",", names=True)
    for k in (1, 2, 3):
        columns = {"time_s": table["t_s"], "u_V": table[f"u{k}_V"], "pulley_rad_s": table[f"z{k}"]}
        write_recording(target / f"prbs_{k}.csv", columns)


def counted_by(machine: Machine, run: Recording) -> Array:
    """Return what the counter reads in an open-loop simulation from rest, rad/s, shape (n,)."""
    count = len(machine.coordinates)
    states = rollout(machine, run.time_s, run.inputs, velocities=True)[0]
    return np.abs(states[:, count + machine.coordinate_names.index("pulley")])


def run(console: Console) -> None:
    """Identify CED and report the error of |speed| over the standard deviation of the measured speed."""
    source = data_folder("ced", console)
    if source is None:
        return
    machine = load_machine(MACHINES / "ced.json")
    with tempfile.TemporaryDirectory() as folder:
        convert(source, Path(folder))
        recordings = load_recordings(folder, machine)
    counted = {r.name: r.outputs[:, 0] for r in recordings}

    def measure(m: Machine) -> dict[str, float]:
        return {
            r.name + (" (held out)" if r.name == HELD_OUT else ""): float(
                np.sqrt(np.mean((counted_by(m, r) - counted[r.name]) ** 2)) / np.std(counted[r.name])
            )
            for r in recordings
        }

    answer = identify(recordings, machine, held_out=(HELD_OUT,), log=console.print, budget=math.inf)
    errors = errors_by_machine(answer, measure)
    print_errors("CED, rms of |speed| over its std", "", errors, console)
    print_effects(answer, console)
    panels = [
        (
            f"{r.name}, speed",
            r.time_s,
            {
                "counted": counted[r.name],
                "refitted": counted_by(answer.before.machine, r),
                "delivered": counted_by(answer.after.machine, r),
            },
        )
        for r in recordings
    ]
    picture("ced", "CED, absolute pulley speed in open-loop simulation (prbs_1 held out)", panels, console)
    write_results("real_machines_ced", {"nrmse": errors, "answer": answer.as_json()}, seed=None)
