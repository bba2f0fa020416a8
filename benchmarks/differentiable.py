"""How many differentiated steps a second? Episodes forward and back against simulation alone, on one core.

    python -m benchmarks.differentiable

A step is a control period of 10 ms, 20 steps of the integrator, of one stage; a differentiated step is
simulated and then differentiated with respect to state and voltages, or also to all parameters of the
machine. Both run in turn, in one thread, on a batch of stages under random voltages. Seconds are processor
time, which other programs affect little; a ratio is the median over the repetitions, and the spread gives
their extremes. The errors are relative differences from central differences of the simulation, along random
directions. Results are in results/differentiable.json.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from benchmarks.kernel_batch import VOLTS, interleaved
from benchmarks.results_file import write_results
from hframe_gym.differentiable import DifferentiableStage
from hframe_gym.machine import BUILTIN_MACHINES, Machine

SEED, STAGES, PERIODS = 11, 256, 150
MACHINES = ("hframe", "hframe-order20", "axis")
FRICTIONS = ("exact", "sliding")
STEPS = (1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7)  # of the differences, relative
DIRECTIONS, CHECKED = 20, 64  # directions; stages whose derivatives are compared


class Episodes:
    """Episodes of a batch of stages with random voltages, and their derivatives with torch.

    Args:
        machine: Machine of all stages.
        friction: Treatment of the corner of friction.
        by_parameters: Whether to differentiate with respect to the parameters, too.
    """

    def __init__(self, machine: Machine, friction: str, *, by_parameters: bool) -> None:
        generator = np.random.default_rng(SEED)
        self.stage = DifferentiableStage(machine, friction=friction, parallel=False)  # type: ignore[arg-type]
        voltages = generator.uniform(-VOLTS, VOLTS, (STAGES, PERIODS, len(machine.drives)))
        self.voltages = torch.from_numpy(voltages).requires_grad_()
        self.start = self.stage.rest(batch=STAGES).requires_grad_()
        self.parameters = torch.from_numpy(np.tile(self.stage.nominal, (STAGES, 1)))
        self.parameters.requires_grad_(by_parameters)
        self.forward()
        self.differentiate()  # compiles before the first clock starts

    def forward(self) -> None:
        """Simulate all episodes."""
        with torch.no_grad():
            self.stage.rollout(self.start, self.voltages, self.parameters)

    def differentiate(self) -> None:
        """Simulate all episodes and differentiate the sum of all states."""
        states = self.stage.rollout(self.start, self.voltages, self.parameters)
        states.sum().backward()  # type: ignore[no-untyped-call]


def rate(run: Callable[[], None], least_s: float = 0.2) -> float:
    """Return the control periods per second of processor time of a function that runs all episodes."""
    runs, begin = 0, time.process_time()
    while (spent := time.process_time() - begin) < least_s or runs == 0:
        run()
        runs += 1
    return runs * STAGES * PERIODS / spent


def errors(machine: Machine) -> dict[str, Any]:
    """Compare derivatives of episodes of five periods in motion with central differences.

    Returns:
        Median and largest relative error, and the fraction of comparisons with an error below 1e-6.
    """
    generator = np.random.default_rng(SEED)
    stage = DifferentiableStage(machine, parallel=False)
    motion, count = stage.motion, len(machine.coordinates)
    arrays = {
        "start": stage.rest(batch=CHECKED).numpy(),
        "inputs": generator.uniform(-VOLTS, VOLTS, (CHECKED, 5, len(machine.drives))),
        "parameters": np.tile(stage.nominal, (CHECKED, 1))
        * generator.uniform(0.9, 1.1, (CHECKED, len(stage.nominal))),
    }
    rates = generator.choice((-1.0, 1.0), (CHECKED, count)) * generator.uniform(0.2, 0.4, (CHECKED, count))
    arrays["start"][:, count : 2 * count] = rates / machine.travel_per_unit
    units = {
        "start": np.concatenate([np.full(count, 1e-3), np.full(count, 0.3)])
        / np.tile(machine.travel_per_unit, 2),
        "inputs": np.array(1.0),
        "parameters": np.abs(arrays["parameters"]),
    }
    weights = generator.normal(size=(CHECKED, 6, motion.state_size))
    motions = motion.simulate(arrays["start"], arrays["inputs"], arrays["parameters"])
    found = motion.gradients(motions, weights)
    relative = []
    for name, values in arrays.items():
        gradient = getattr(found, name)
        size = np.sqrt(((gradient * units[name]) ** 2).reshape(CHECKED, -1).sum(1))
        for _ in range(DIRECTIONS):
            direction = generator.normal(size=values.shape) * units[name]
            quotients = []
            for step in STEPS:
                ends = [
                    (
                        motion.simulate(*({**arrays, name: values + sign * step * direction}).values()).states
                        * weights
                    )
                    for sign in (1.0, -1.0)
                ]
                quotients.append((ends[0] - ends[1]).sum((1, 2)) / (2.0 * step))
            expected = np.array(quotients)
            best = np.abs(np.diff(expected, axis=0)).argmin(axis=0)
            expected = np.take_along_axis(expected, best[None] + 1, axis=0)[0]
            relative.append(np.abs(expected - (gradient * direction).reshape(CHECKED, -1).sum(1)) / size)
    every = np.concatenate(relative)
    return {
        "median": float(np.median(every)),
        "largest": float(every.max()),
        "fraction_below_1e-6": float((every < 1e-6).mean()),
    }


def main() -> None:
    """Measure all machines, print a table and write the results."""
    torch.set_num_threads(1)
    table = Table(
        "machine", "friction", "with respect to", "differentiated, 1/s", "simulated, 1/s", "ratio", "spread"
    )
    rows = []
    for name in MACHINES:
        machine = BUILTIN_MACHINES[name]()
        for friction in FRICTIONS:
            for by_parameters in (False, True):
                episodes = Episodes(machine, friction, by_parameters=by_parameters)
                ratio = interleaved(
                    lambda e=episodes: rate(e.differentiate), lambda e=episodes: rate(e.forward)
                )
                row = {
                    "machine": name,
                    "friction": friction,
                    "by_parameters": by_parameters,
                    **ratio.report(),
                }
                rows.append(row)
                target = "state, voltages" + (", parameters" if by_parameters else "")
                spread = f"{row['spread'][0]:.3f} to {row['spread'][1]:.3f}"
                speeds = (f"{row['ours_steps_per_s']:,.0f}", f"{row['theirs_steps_per_s']:,.0f}")
                table.add_row(name, friction, target, *speeds, f"{row['ratio']:.3f}", spread)
    console = Console()
    console.print(table)
    compared = {name: errors(BUILTIN_MACHINES[name]()) for name in MACHINES}
    for name, values in compared.items():
        console.print(
            f"{name}: relative errors, median {values['median']:.1e}, largest {values['largest']:.1e}"
        )
    settings = {"stages": STAGES, "periods": PERIODS, "period_s": 0.01, "integrator_step_s": 0.5e-3}
    write_results("differentiable", {"settings": settings, "rates": rows, "errors": compared}, seed=SEED)


if __name__ == "__main__":
    main()
