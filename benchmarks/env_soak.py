"""Whether the environment stays sane for long: wide randomisation, random actions, 1e8 steps.

    python -m benchmarks.env_soak [--steps 100000000]

After every control period: all numbers finite, nobody further out than a buffer gives way, and mechanical energy below
what the drives can have given.  Partial results are written as it goes.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from benchmarks.results_file import write_results
from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.envs.end_stops import rated_belt_force

SEED, ENVS, CHUNK = 5, 4096, 250  # CHUNK: control periods between two reports
LOOK = 10  # control periods between two checks of the energy
OPTIONS: dict[str, dict[str, Any]] = {
    "random actions": {"randomize": "wide"},
    "sensors and drives of the rig": {"randomize": "wide", "sensors": "rig", "drives": "rig"},
    "20th order": {"randomize": "wide", "machine": "hframe-order20"},
}
SHARES = {"random actions": 0.9, "sensors and drives of the rig": 0.05, "20th order": 0.05}  # of the steps


class Energy:
    """Kinetic energy and that of the belts, (B,) J, from the numbers of each stage."""

    def __init__(self, envs: HFrameVectorEnv) -> None:
        self.stages = envs.batch.stages
        machine = self.stages.machine
        names = list(machine.parameters)
        self.mass = [names.index(f"{c.name}.mass") for c in machine.coordinates]
        self.radius = [names.index(f"{c.name}.radius") if c.kind == "rotary" else None for c in machine.coordinates]
        self.belts = [
            (
                names.index(f"{b.name}.EA"),
                names.index(f"{b.name}.rest_length"),
                machine.row(b.extension),
                machine.row(b.length),
            )
            for b in machine.belts
        ]

    def __call__(self) -> NDArray[np.float64]:
        P, n = self.stages.parameters, len(self.mass)
        q, v = self.stages.state[:, :n], self.stages.state[:, n : 2 * n]
        total = np.zeros(P.shape[::2])
        for i, (mass, radius) in enumerate(zip(self.mass, self.radius, strict=True)):
            own = P[:, mass] if radius is None else P[:, mass] / P[:, radius] ** 2
            total += 0.5 * own * v[:, i] ** 2
        for EA, rest, extension, length in self.belts:
            s, long = (np.einsum("j,bjl->bl", row, q) for row in (extension, length))
            total += 0.5 * P[:, EA] / (P[:, rest] + long) * s**2
        return total


def bound(envs: HFrameVectorEnv) -> float:
    """More energy than any drawn stage can hold, J: all masses at no-load speed, and belts at twice the stall force."""
    machine, batch = envs.batch.machine, envs.batch
    most = dict(zip(machine.parameters, batch.population.high.tolist(), strict=True))
    least = dict(zip(machine.parameters, batch.population.low.tolist(), strict=True))
    speed = 0.0
    for d in machine.drives:
        w = d.rated_voltage / (least[f"{d.name}.Ke"] * d.gear_ratio)
        speed = max(speed, w * machine.coordinate(d.coordinate).radius)
    kinetic = sum(
        0.5 * most[f"{c.name}.mass"] / (c.radius if c.kind == "rotary" else 1.0) ** 2 * speed**2
        for c in machine.coordinates
    )
    force = rated_belt_force(machine) * most["motor1.Kt"] / machine.drives[0].Kt / 0.9
    belts = sum(
        0.5 * (2.0 * force) ** 2 * (most[f"{b.name}.rest_length"] + 0.6) / least[f"{b.name}.EA"] for b in machine.belts
    )
    return kinetic + belts


def soak(name: str, steps: int, console: Console, content: dict[str, Any]) -> None:
    """Run `steps` steps of environments with the options of that name and leave what was seen in content."""
    envs = HFrameVectorEnv(ENVS, max_episode_steps=150, **OPTIONS[name])
    envs.reset(seed=SEED)
    energy, most = Energy(envs), bound(envs)
    workspace = envs.batch.workspace
    rng = np.random.default_rng(SEED)
    periods = -(-steps // ENVS)
    seen = {"steps": 0, "furthest_beyond_m": -1.0, "largest_energy_J": 0.0, "not_finite": 0}
    begin = time.perf_counter()
    for period in range(periods):
        if period % 5 == 0:  # held for 50 ms: long enough to run into the ends
            actions = rng.uniform(-1.0, 1.0, (ENVS, 2)).astype(np.float32)
            actions[::2] = np.sign(actions[::2])  # every other one at full voltage
        _, reward, *_ = envs.step(actions)
        tool = envs.batch.stages.tools()
        seen["not_finite"] += int((~np.isfinite(reward)).sum() + (~np.isfinite(tool)).sum())
        out = np.maximum(workspace[:, 0] - tool, tool - workspace[:, 1]).max()
        seen["furthest_beyond_m"] = max(seen["furthest_beyond_m"], float(out))
        if period % LOOK == 0:
            seen["largest_energy_J"] = max(seen["largest_energy_J"], float(energy().max()))
        seen["steps"] += ENVS
        if (period + 1) % CHUNK == 0 or period + 1 == periods:
            content[name] = {**seen, "energy_bound_J": most, "seconds": time.perf_counter() - begin}
            write_results("env_soak", content, seed=SEED)
            console.print(
                f"{name}: {seen['steps']:.3g} steps, "
                f"furthest beyond the workspace {1e3 * seen['furthest_beyond_m']:.2f} mm, "
                f"energy up to {seen['largest_energy_J']:.2f} J of {most:.1f} J"
            )
    assert seen["not_finite"] == 0
    assert seen["furthest_beyond_m"] < 0.02
    assert seen["largest_energy_J"] < most


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=float, default=1e8, help="of all environments together, 10 ms each")
    arguments = parser.parse_args()
    content: dict[str, Any] = {"environments": ENVS}
    for name, share in SHARES.items():
        soak(name, int(arguments.steps * share), Console(width=150), content)


if __name__ == "__main__":
    main()
