"""CED, two motors, a flexible belt and a pulley whose speed is counted without its sign: PRBS records.

The tables have sensors of positions.  The conversion therefore gives the speed its sign back, piece by piece between
its dips to zero, and integrates it.  Judged on the raw reading: |simulated speed| against the counter.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy import signal

from benchmarks.real_machines.study import (
    MACHINES,
    Array,
    by_stage,
    data_folder,
    picture,
    show,
    show_effects,
    write_recording,
)
from benchmarks.results_file import write_results
from hframe_gym.dynamics import rollout
from hframe_gym.identification import identify
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording, load_machine, load_recordings

HELD_OUT = "prbs_1"  # fitted: records of amplitude 1.5 and 0.5; the one between them is judged
PUBLISHED_MODEL = ([5163.0], [1.0, 19.93, 509.8, 2835.0])  # speed per volt, as tabulated in public code
_DIP = 0.25  # of the largest reading: a minimum below may be a change of sign


def with_sign(speed: Array, drive: Array, period: float) -> Array:
    """A speed (n,) from its absolute value: between two dips to zero, the sign of the published model's speed."""
    A, B, C, D, _ = signal.cont2discrete(signal.tf2ss(*PUBLISHED_MODEL), period)
    guide = signal.dlsim((A, B, C, D, period), drive)[1][:, 0]
    dips, _ = signal.find_peaks(-speed, height=-_DIP * speed.max())
    pieces = np.split(np.arange(len(speed)), dips)
    return np.concatenate([speed[k] * np.sign(speed[k] @ guide[k] or 1.0) for k in pieces])


def convert(source: Path, target: Path) -> None:
    """The three PRBS records in the recordings' format: time_s, u_V, pulley_rad (integrated speed)."""
    table = np.genfromtxt(source / "ced_prbs.csv", delimiter=",", names=True)
    for k in (1, 2, 3):
        period = float(np.median(np.diff(table["t_s"])))
        speed = with_sign(table[f"z{k}"], table[f"u{k}_V"], period)
        angle = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * period)])
        write_recording(
            target / f"prbs_{k}.csv", {"time_s": table["t_s"], "u_V": table[f"u{k}_V"], "pulley_rad": angle}
        )


def speed_of(machine: Machine, run: Recording) -> Array:
    """Simulated pulley speed (n,), sensor units, free run from rest."""
    count = len(machine.coordinates)
    states = rollout(machine, run.time_s, run.inputs, velocities=True)[0]
    return states[:, count + machine.coordinate_names.index("pulley")]


def run(console: Console) -> None:
    """Error of |speed| on the held-out record over its standard deviation: published model, declared, before, after."""
    source = data_folder("ced", console)
    if source is None:
        return
    machine = load_machine(MACHINES / "ced.json")
    with tempfile.TemporaryDirectory() as folder:
        convert(source, Path(folder))
        recordings = load_recordings(folder, machine)
    table = np.genfromtxt(source / "ced_prbs.csv", delimiter=",", names=True)
    counted = {f"prbs_{k}": table[f"z{k}"] for k in (1, 2, 3)}

    def judge(m: Machine) -> dict[str, float]:
        return {
            r.name + (" (held out)" if r.name == HELD_OUT else ""): float(
                np.sqrt(np.mean((np.abs(speed_of(m, r)) - counted[r.name]) ** 2)) / np.std(counted[r.name])
            )
            for r in recordings
        }

    answer = identify(recordings, machine, held_out=(HELD_OUT,), say=console.print)
    errors = by_stage(answer, judge)
    show("CED, rms of |speed| over its std", "", errors, console)
    show_effects(answer, console)
    panels = [
        (
            r.name,
            r.time_s,
            {
                "counted": counted[r.name],
                "before": np.abs(speed_of(answer.before.machine, r)),
                "after": np.abs(speed_of(answer.after.machine, r)),
            },
        )
        for r in recordings
    ]
    picture("ced", "CED, absolute pulley speed in free run (prbs_1 held out)", panels, console)
    write_results("real_machines_ced", {"nrmse": errors, "answer": answer.as_json()}, seed=None)
