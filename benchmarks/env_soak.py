"""Does the environment stay physically plausible for 1e9 steps with random machines and random actions?

    python -m benchmarks.env_soak [--steps 1e9]

After every control period all values must be finite and no tool may be further outside the workspace than its
buffers allow; every ten periods the mechanical energy must be below what the drives can have supplied. The
resident memory must not grow after the first report of each part. Besides the built-in machines with wide
randomization, rigs drawn at random (`tests.rigs.random_rigs`) with their hidden effects take part. Partial
results are written to results/env_soak.json while it runs.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from benchmarks.results_file import write_results
from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.machine import Machine
from tests.rigs.random_rigs import describe_effects, draw_rig
from tests.rigs.true_machine import true_machine
from tools.command_line import command_line
from tools.posix import require_posix

SEED, ENVS = 5, 4096
RIG_SEED, RIGS = 20260718, 12  # of the rigs drawn at random
MEMORY_GROWTH_MB = 64.0  # largest growth after the first report of a part
REPORT_PERIODS = 1000  # control periods between two reports
ENERGY_PERIODS = 10  # control periods between two checks of the energy
OPTIONS: dict[str, dict[str, Any]] = {
    "random actions": {"randomize": "wide"},
    "sensors and drives of the rig": {"randomize": "wide", "sensors": "rig", "drives": "rig"},
    "20th order": {"randomize": "wide", "machine": "hframe-order20"},
}
# Of the steps; the rigs drawn at random share the rest.
FRACTIONS = {"random actions": 0.75, "sensors and drives of the rig": 0.1, "20th order": 0.05}


def resident_megabytes() -> float:
    """Return the resident memory of this process, MB; Linux only."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def random_machines() -> dict[str, Machine]:
    """Return the machines of the first rigs drawn at random that hide effects of the library, by name."""
    machines: dict[str, Machine] = {}
    index = 0
    while len(machines) < RIGS:
        rig = draw_rig(RIG_SEED, index)
        machine = true_machine(rig) if rig.hidden_effects else None
        if machine is not None:
            machines[f"rig {index}: {describe_effects(rig.hidden_effects)}"] = machine
        index += 1
    return machines


class Energy:
    """Kinetic energy plus that of the belts, from the parameters and states of each stage.

    Args:
        envs: Environments to observe.
    """

    def __init__(self, envs: HFrameVectorEnv) -> None:
        self.simulator = envs.batch.simulator
        machine = self.simulator.machine
        names = list(machine.parameters)
        # A structural effect adds coordinates and belts whose masses and lengths follow from its parameters:
        # left out.
        bodies = [(i, c) for i, c in enumerate(machine.coordinates) if f"{c.name}.mass" in names]
        self.coordinates = len(machine.coordinates)
        self.bodies = [
            (
                i,
                names.index(f"{c.name}.mass"),
                names.index(f"{c.name}.radius") if c.kind == "rotary" else None,
            )
            for i, c in bodies
        ]
        self.belts = [
            (
                names.index(f"{b.name}.EA"),
                names.index(f"{b.name}.rest_length"),
                machine.coefficients(b.extension),
                machine.coefficients(b.length),
            )
            for b in machine.belts
            if f"{b.name}.EA" in names
        ]

    def __call__(self) -> NDArray[np.float64]:
        """Return the energies, J, shape (blocks, lanes)."""
        P, n = self.simulator.parameters, self.coordinates
        q, v = self.simulator.state[:, :n], self.simulator.state[:, n : 2 * n]
        total = np.zeros(P.shape[::2])
        for i, mass, radius in self.bodies:
            linear_mass = P[:, mass] if radius is None else P[:, mass] / P[:, radius] ** 2
            total += 0.5 * linear_mass * v[:, i] ** 2
        for EA, rest, extension, length in self.belts:
            stretch, elongation = (np.einsum("j,bjl->bl", row, q) for row in (extension, length))
            total += 0.5 * P[:, EA] / (P[:, rest] + elongation) * stretch**2
        return total


def bound(envs: HFrameVectorEnv) -> float:
    """Return an upper bound of a stage's energy, J: masses at no-load speed, belts at double stall force."""
    machine, sampler = envs.batch.machine, envs.batch.sampler
    upper = dict(zip(sampler.space.names, sampler.high.tolist(), strict=True))
    lower = dict(zip(sampler.space.names, sampler.low.tolist(), strict=True))
    speed = 0.0
    for d in machine.drives:
        w = d.rated_voltage / (lower[f"{d.name}.Ke"] * d.gear_ratio)
        speed = max(speed, w * machine.coordinate(d.coordinate).radius)
    kinetic = sum(
        0.5 * upper[f"{c.name}.mass"] / (c.radius if c.kind == "rotary" else 1.0) ** 2 * speed**2
        for c in machine.coordinates
        if f"{c.name}.mass" in upper
    )
    stall_force = sum(
        d.gain * d.rated_voltage / machine.coordinate(d.coordinate).travel_per_unit for d in machine.drives
    )
    force = stall_force * upper["motor1.Kt"] / machine.drives[0].Kt / 0.9
    belts = sum(
        0.5 * (2.0 * force) ** 2 * (upper[f"{b.name}.rest_length"] + 0.6) / lower[f"{b.name}.EA"]
        for b in machine.belts
        if f"{b.name}.EA" in upper
    )
    return kinetic + belts


def soak(name: str, options: dict[str, Any], steps: int, console: Console, content: dict[str, Any]) -> None:
    """Run environments with options, check them, and write extremes and counts to the content, by name."""
    envs = HFrameVectorEnv(ENVS, max_episode_steps=150, **options)
    envs.reset(seed=SEED)
    energy, energy_bound = Energy(envs), bound(envs)
    workspace = envs.batch.workspace
    rng = np.random.default_rng(SEED)
    periods = -(-steps // ENVS)
    extremes = {"steps": 0, "furthest_beyond_m": -1.0, "largest_energy_J": 0.0, "not_finite": 0}
    memory_MB: list[float] = []
    begin = time.perf_counter()
    for period in range(periods):
        if period % 5 == 0:  # held for 50 ms, long enough to reach the end stops
            actions = rng.uniform(-1.0, 1.0, (ENVS, 2)).astype(np.float32)
            actions[::2] = np.sign(actions[::2])  # every second one at full voltage
        _, reward, *_ = envs.step(actions)
        tool = envs.batch.simulator.tool_positions()
        extremes["not_finite"] += int((~np.isfinite(reward)).sum() + (~np.isfinite(tool)).sum())
        outside = np.maximum(workspace[:, 0] - tool, tool - workspace[:, 1]).max()
        extremes["furthest_beyond_m"] = max(extremes["furthest_beyond_m"], float(outside))
        if period % ENERGY_PERIODS == 0:
            extremes["largest_energy_J"] = max(extremes["largest_energy_J"], float(energy().max()))
        extremes["steps"] += ENVS
        if (period + 1) % REPORT_PERIODS == 0 or period + 1 == periods:
            memory_MB.append(resident_megabytes())
            memory = {"first_MB": memory_MB[0], "last_MB": memory_MB[-1], "largest_MB": max(memory_MB)}
            seconds = time.perf_counter() - begin
            content[name] = {**extremes, "energy_bound_J": energy_bound, "memory": memory, "seconds": seconds}
            write_results("env_soak", content, seed=SEED)
            console.print(
                f"{name}: {extremes['steps']:.3g} steps, "
                f"furthest beyond the workspace {1e3 * extremes['furthest_beyond_m']:.2f} mm, "
                f"energy up to {extremes['largest_energy_J']:.2f} J of at most {energy_bound:.1f} J, "
                f"{memory_MB[-1]:.0f} MB"
            )
    assert extremes["not_finite"] == 0
    assert extremes["furthest_beyond_m"] < 0.02
    assert extremes["largest_energy_J"] < energy_bound
    assert max(memory_MB) < memory_MB[0] + MEMORY_GROWTH_MB


def main() -> None:
    """Run all environments and write the results."""
    require_posix("benchmarks.env_soak")
    parser = command_line(__doc__)
    parser.add_argument("--steps", type=float, default=1e9, help="of all environments together, 10 ms each")
    arguments = parser.parse_args()
    content: dict[str, Any] = {"environments": ENVS}
    console = Console(width=180)
    for name, fraction in FRACTIONS.items():
        soak(name, OPTIONS[name], int(arguments.steps * fraction), console, content)
    machines = random_machines()
    share = (1.0 - sum(FRACTIONS.values())) / len(machines)
    for name, machine in machines.items():
        soak(name, {"randomize": "wide", "machine": machine}, int(arguments.steps * share), console, content)


if __name__ == "__main__":
    main()
