"""How far is an exported MuJoCo model (`hframe export mjcf`) from the simulator of this package?

The H-frame and the CoreXY stage follow random voltages for one second from rest, in MuJoCo and in the
simulator. The first comparison leaves out the change of belt stiffness with the position, which MJCF cannot
describe, and dry friction; the second one has dry friction, and the last one is against the complete machine.

    python -m benchmarks.mjcf_deviation
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

import hframe_gym
from benchmarks.mujoco_stage import constant_at_center
from hframe_gym.arrays import Array
from hframe_gym.dynamics import simulate
from hframe_gym.exporters import EXPORTERS
from hframe_gym.machine import Machine

SECONDS, SAMPLE, HOLD = 1.0, 1e-3, 0.05  # s
RUNS, SEED = 8, 0
SETTINGS = (("Euler", 5e-4), ("RK4", 5e-4), ("RK4", 5e-5))


def voltages(machine: Machine, run: int) -> tuple[Array, Array]:
    """Return times, s, shape (n,), and random voltages, V, to a quarter of rated, shape (n, drives)."""
    count, rows = round(SECONDS / SAMPLE) + 1, round(HOLD / SAMPLE)
    rated = np.array([d.rated_voltage for d in machine.drives])
    levels = np.random.default_rng([SEED, run]).uniform(-0.25, 0.25, (count // rows + 1, len(rated))) * rated
    return SAMPLE * np.arange(count), np.repeat(levels, rows, axis=0)[:count]


def tool_in_mujoco(machine: Machine, inputs: Array, integrator: str, step: float) -> Array:
    """Return the tool's positions in MuJoCo, m, shape (n, axes)."""
    files = EXPORTERS.get("mjcf")(machine=machine, integrator=integrator, step=step).files(machine)  # type: ignore[call-arg, attr-defined]
    model = mujoco.MjModel.from_xml_string(files["stage.xml"])
    data = mujoco.MjData(model)
    columns = [model.joint(axis).qposadr[0] for axis in machine.tool_axes]
    positions = np.zeros((len(inputs), len(columns)))
    for row in range(1, len(inputs)):
        data.ctrl[:] = inputs[row - 1]
        mujoco.mj_step(model, data, round(SAMPLE / step))
        positions[row] = data.qpos[columns]
    return positions


def deviation(machine: Machine, truth: Machine, integrator: str, step: float) -> tuple[float, float]:
    """Return the root mean square and the largest distance of the tools of all runs, mm."""
    distances = []
    for run in range(RUNS):
        time_s, inputs = voltages(machine, run)
        trajectory = simulate(truth, time_s, inputs)
        tool = trajectory.positions[:, [truth.coordinate_names.index(a) for a in truth.tool_axes]]
        distances.append(np.linalg.norm(tool_in_mujoco(machine, inputs, integrator, step) - tool, axis=1))
    return 1e3 * float(np.sqrt(np.mean(np.square(distances)))), 1e3 * float(np.max(distances))


def main() -> None:
    """Print the table of docs/export.md."""
    print("| machine | against the simulator with | integrator, step | rms, mm | largest, mm |")
    print("|---|---|---|---:|---:|")
    for name in ("hframe", "corexy"):
        machine = hframe_gym.load_machine(name)
        constant = constant_at_center(machine)
        frictionless = dataclasses.replace(
            constant, coordinates=tuple(dataclasses.replace(c, coulomb=0.0) for c in machine.coordinates)
        )
        for text, exported, truth in (
            ("constant stiffness, no dry friction", frictionless, frictionless),
            ("constant stiffness", machine, constant),
            ("everything", machine, machine),
        ):
            for integrator, step in SETTINGS:
                rms, largest = deviation(exported, truth, integrator, step)
                print(
                    f"| {name} | {text} | {integrator}, {step * 1e3:g} ms | {rms:.3g} | {largest:.3g} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
