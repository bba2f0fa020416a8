"""Fit masses, friction and belts of a machine to recordings of a rig, by the gradient of its error.

    python examples/parameter_fit.py [FOLDER]

All runs of the folder are simulated at once from rest, under the recorded voltages. `hframe identify` does
this and much more; the example shows how little is needed for a fit of your choice: another cost, other
parameters, a network.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch

from hframe_gym import load_machine, load_recordings
from hframe_gym.differentiable import DifferentiableStage

RESTING = 80  # samples at the beginning of a run in which nothing moves
FITTED = ("mass", "viscous", "coulomb", "EA", "Kt")  # endings of the names of the fitted parameters
UNITS = {"rad": 2e-3, "m": 50e-6}  # errors that count as 1, by the unit of the sensor


def fit(folder: Path, updates: int = 60) -> tuple[dict[str, float], float, float]:
    """Fit the parameters by L-BFGS on their logarithms.

    Args:
        folder: Folder with recordings of equal length and sampling period.
        updates: Number of iterations.

    Returns:
        parameters: Fitted values by name, SI.
        before: Root mean square error of the declared machine, in the units of UNITS.
        after: The same of the fitted machine.
    """
    machine = load_machine("hframe")
    runs = load_recordings(folder, machine)
    rows = min(len(run.time_s) for run in runs)
    period = float(np.median(np.diff(runs[0].time_s)))
    stage = DifferentiableStage(machine, period, longest_step=0.5e-3)
    inputs = torch.from_numpy(np.stack([run.inputs[: rows - 1] for run in runs]))
    outputs = torch.from_numpy(np.stack([run.outputs[:rows] for run in runs]))
    units = torch.tensor([UNITS[channel.rpartition("_")[2]] for channel in machine.output_channels])
    resting = outputs[:, :RESTING].mean(1)  # encoders count from where they were switched on: compare changes
    tool = [machine.output_channels.index(f"{axis}_m") for axis in machine.tool_axes]
    start = stage.rest(resting[:, tool].numpy())
    names = [name for name in stage.parameter_names if name.endswith(FITTED)]
    logarithms = torch.zeros(len(names), dtype=torch.float64, requires_grad=True)
    declared = torch.tensor([machine.parameters[name] for name in names], dtype=torch.float64)

    def cost() -> torch.Tensor:
        values = declared * torch.exp(logarithms)
        parameters = stage.parameters(dict(zip(names, values, strict=True)), batch=len(runs))
        readings = stage.readings(stage.rollout(start, inputs, parameters), parameters)
        errors = (readings - readings[:, :1]) - (outputs - resting[:, None])
        return (errors / units).square().mean()

    def closure() -> torch.Tensor:
        optimizer.zero_grad()
        value = cost()
        value.backward()
        return value

    before = cost().item()
    optimizer = torch.optim.LBFGS(
        [logarithms], max_iter=updates, history_size=20, line_search_fn="strong_wolfe"
    )
    optimizer.step(closure)
    values = (declared * torch.exp(logarithms)).tolist()
    return dict(zip(names, values, strict=True)), before**0.5, cost().item() ** 0.5


if __name__ == "__main__":
    torch.set_num_threads(1)  # the tensors are small: a second thread would only be waited for
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "rig_b"
    parameters, before, after = fit(folder)
    print(f"root mean square error, in units of the sensors' noise: {before:.1f} before, {after:.2f} after")
    for name, value in parameters.items():
        print(f"{name:14} {value:.6g}")
