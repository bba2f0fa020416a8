"""XL330: a servo with a pendulum (logs of Rhoban's BAM); one rotary coordinate under its position loop.

    python -m benchmarks.real_machines.xl330       # writes examples/xl330 from the logs

The position loop needs no model, because its output is logged. `load` is proportional to goal minus position
(254 per rad at kp 100) and saturates at 885, the default limit of the servo's duty cycle. Therefore it is the
duty cycle, and the voltage is load / 885 * supply. The servo updates it about every millisecond, the log
every 4 to 5 ms; between two rows the mean of both is held. Rows after the torque is switched off
(lift_and_drop) are omitted, because a released motor has an open circuit and not 0 V.
"""

from __future__ import annotations

import math
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
from hframe_gym.identification import identify
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording, load_machine, load_recordings
from tools.repository import ROOT

FULL_DUTY = 885.0
EXAMPLE = ROOT / "examples" / "xl330"
# One trajectory of each kind, at gains that the fitted records contain as well.
HELD_OUT = ("sin_sin_kp400", "sin_time_square_kp200", "up_and_down_kp100", "up_and_down_kp800")


def convert(source: Path, target: Path) -> None:
    """Convert every log to a recording: time_s, v_V, arm_rad (0: pendulum down)."""
    for path in sorted(source.glob("*_kp*.csv")):
        log = np.genfromtxt(path, delimiter=",", names=True)
        released = np.flatnonzero(log["torque_enable"] == 0)
        log = log[: released[0]] if len(released) else log
        voltage = log["load_raw_signed"] / FULL_DUTY * log["input_V"]
        held = np.append((voltage[:-1] + voltage[1:]) / 2, voltage[-1])
        write_recording(
            target / path.name, {"time_s": log["t_s"], "v_V": held, "arm_rad": log["position_rad"]}
        )


def simulate_angle(machine: Machine, run: Recording) -> Array:
    """Simulate the angle, rad, shape (n,), under the logged voltages, from the first measurement at rest."""
    angle = machine.simulate(run.time_s, run.inputs, [run.outputs[0, 0], 0.0]).outputs[:, 0]
    return angle - angle[0] + run.outputs[0, 0]


def run(console: Console) -> None:
    """Identify the servo and report the angle error of open-loop simulations.

    The machine file does not declare the pendulum's weight, so a force proportional to the sine of the angle
    must be identified.
    """
    if not EXAMPLE.is_dir():
        console.print(f"xl330: skipped, no folder {EXAMPLE.relative_to(ROOT)}")
        return
    machine = load_machine(MACHINES / "xl330.json")
    recordings = load_recordings(EXAMPLE, machine)
    groups = {
        "fitted": [r for r in recordings if r.name not in HELD_OUT],
        "held out": [r for r in recordings if r.name in HELD_OUT],
    }

    def measure(m: Machine) -> dict[str, float]:
        return {k: _rms([simulate_angle(m, r) - r.outputs[:, 0] for r in runs]) for k, runs in groups.items()}

    answer = identify(recordings, machine, held_out=HELD_OUT, log=console.print, budget=math.inf)
    errors = errors_by_machine(answer, measure)
    in_mrad = {stage: {k: 1e3 * v for k, v in e.items()} for stage, e in errors.items()}
    print_errors("XL330, rms angle error in open-loop simulation", "mrad", in_mrad, console)
    print_effects(answer, console)
    stages = {"refitted": answer.before.machine, "identified": answer.after.machine}
    panels = [
        (
            f"{r.name}, rad",
            r.time_s,
            {"measured": r.outputs[:, 0]} | {k: simulate_angle(m, r) for k, m in stages.items()},
        )
        for r in groups["held out"]
    ]
    picture("xl330", "XL330 with a pendulum, held-out logs in open-loop simulation", panels, console)
    write_results("real_machines_xl330", {"rms_rad": errors, "answer": answer.as_json()}, seed=None)


def _rms(errors: list[Array]) -> float:
    """Return the root mean square of all errors together."""
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


if __name__ == "__main__":
    logs = data_folder("bam_xl330", Console())
    if logs is not None:
        convert(logs, EXAMPLE)
