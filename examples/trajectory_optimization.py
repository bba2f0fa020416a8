"""Find the voltages that move the tool to a point and leave it at rest there, by gradient descent.

    python examples/trajectory_optimization.py

Every voltage of the motion is a free number. The derivatives of the final error with respect to all of them
come from one pass back through the simulated motion.
"""

from __future__ import annotations

import torch

from hframe_gym import load_machine
from hframe_gym.differentiable import DifferentiableStage

GOAL = (0.10, 0.05)  # m
PERIODS = 30  # of 10 ms
SPEED_S = 0.02  # s, time by which the final speed is multiplied to compare it with the final distance


def optimize(updates: int = 400) -> tuple[torch.Tensor, float, float]:
    """Optimize the voltages of one motion from the origin.

    Args:
        updates: Number of gradient steps.

    Returns:
        voltages: V, shape (PERIODS, drives).
        distance: Distance of the tool from the goal at the end, m.
        speed: Speed of the tool at the end, m/s.
    """
    # Static friction would hide at the start that a higher voltage moves the tool; "sliding" derivatives tell
    # it.
    stage = DifferentiableStage(load_machine("hframe"), end_stops=True, friction="sliding")
    rated, goal = torch.from_numpy(stage.rated), torch.tensor(GOAL, dtype=torch.float64)
    free = torch.zeros(PERIODS, len(rated), dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.Adam([free], lr=0.05)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates)
    for _ in range(updates):
        voltages = torch.tanh(free) * rated  # within the rated voltages
        states = stage.rollout(stage.rest(), voltages[None])
        tool = stage.tool_positions(states)[0]
        distance = torch.linalg.vector_norm(tool[-1] - goal)
        speed = torch.linalg.vector_norm(tool[-1] - tool[-2]) / stage.period
        optimizer.zero_grad()
        (distance + SPEED_S * speed).backward()
        optimizer.step()
        schedule.step()
    return voltages.detach(), distance.item(), speed.item()


if __name__ == "__main__":
    torch.set_num_threads(1)  # the tensors are small: a second thread would only be waited for
    voltages, distance, speed = optimize()
    print(
        f"after {PERIODS * 10} ms the tool is {1e3 * distance:.3f} mm from "
        f"the goal, at {1e3 * speed:.2f} mm/s"
    )
    print(f"largest voltage: {voltages.abs().max():.1f} V")
