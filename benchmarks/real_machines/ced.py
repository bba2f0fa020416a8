"""CED: two motors, a flexible belt and a pulley whose counter measures the absolute value of the speed; PRBS records.

Machines have position sensors. The conversion therefore restores the sign of the speed, piece by piece between its dips
to zero, and integrates it. The evaluation uses the raw measurement: |simulated speed| against the counter.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy import signal

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
PUBLISHED_MODEL = ([5163.0], [1.0, 19.93, 509.8, 2835.0])  # speed per volt, as tabulated in public code
_DIP = 0.25  # of the maximum; a minimum below this may be a change of sign


def with_sign(speed: Array, drive: Array, period: float) -> Array:
    """Restore the sign of a speed: between two dips to zero it is that of the published model's speed.

    Args:
        speed: Absolute value of the speed, shape (n,).
        drive: Voltage, V, shape (n,).
        period: Sampling period, s.

    Returns:
        Signed speed, shape (n,).
    """
    A, B, C, D, _ = signal.cont2discrete(signal.tf2ss(*PUBLISHED_MODEL), period)
    guide = signal.dlsim((A, B, C, D, period), drive)[1][:, 0]
    dips, _ = signal.find_peaks(-speed, height=-_DIP * speed.max())
    pieces = np.split(np.arange(len(speed)), dips)
    return np.concatenate([speed[k] * np.sign(speed[k] @ guide[k] or 1.0) for k in pieces])


def convert(source: Path, target: Path) -> None:
    """Convert the three PRBS records to recordings: time_s, u_V, pulley_rad (the integrated speed)."""
    table = np.genfromtxt(source / "ced_prbs.csv", delimiter=",", names=True)
    for k in (1, 2, 3):
        period = float(np.median(np.diff(table["t_s"])))
        speed = with_sign(table[f"z{k}"], table[f"u{k}_V"], period)
        angle = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * period)])
        write_recording(
            target / f"prbs_{k}.csv", {"time_s": table["t_s"], "u_V": table[f"u{k}_V"], "pulley_rad": angle}
        )


def speed_of(machine: Machine, run: Recording) -> Array:
    """Return the pulley speed (n,) of an open-loop simulation from rest, in the sensor's units."""
    count = len(machine.coordinates)
    states = rollout(machine, run.time_s, run.inputs, velocities=True)[0]
    return states[:, count + machine.coordinate_names.index("pulley")]


def run(console: Console) -> None:
    """Identify CED and report the error of |speed| divided by the standard deviation of the measured speed."""
    source = data_folder("ced", console)
    if source is None:
        return
    machine = load_machine(MACHINES / "ced.json")
    with tempfile.TemporaryDirectory() as folder:
        convert(source, Path(folder))
        recordings = load_recordings(folder, machine)
    table = np.genfromtxt(source / "ced_prbs.csv", delimiter=",", names=True)
    counted = {f"prbs_{k}": table[f"z{k}"] for k in (1, 2, 3)}

    def measure(m: Machine) -> dict[str, float]:
        return {
            r.name + (" (held out)" if r.name == HELD_OUT else ""): float(
                np.sqrt(np.mean((np.abs(speed_of(m, r)) - counted[r.name]) ** 2)) / np.std(counted[r.name])
            )
            for r in recordings
        }

    answer = identify(recordings, machine, held_out=(HELD_OUT,), log=console.print, budget=math.inf)
    errors = errors_by_machine(answer, measure)
    print_errors("CED, rms of |speed| over its std", "", errors, console)
    print_effects(answer, console)
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
    picture("ced", "CED, absolute pulley speed in open-loop simulation (prbs_1 held out)", panels, console)
    write_results("real_machines_ced", {"nrmse": errors, "answer": answer.as_json()}, seed=None)
