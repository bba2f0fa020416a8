"""Train a policy by backpropagation through simulated episodes, without a reinforcement-learning library.

    python examples/policy_gradient.py

The policy sees the distance to the goal and the velocity of the tool. Each update simulates 0.5 s of 64
episodes with random starts and goals, and differentiates the mean distance with respect to the weights.
`hframe train apg` is a complete recipe of this kind.
"""

from __future__ import annotations

import itertools

import torch

from hframe_gym import load_machine
from hframe_gym.differentiable import DifferentiableStage

EPISODES, PERIODS = 64, 50
REACH = 0.08  # m, largest coordinate of starts and goals
SCALES = (0.02, 0.002, 0.0002)  # m, distances that the policy must tell apart


class Policy(torch.nn.Module):
    """Network from the error of the tool's position, m, and its velocity, m/s, to actions in [-1, 1]."""

    def __init__(self) -> None:
        super().__init__()
        sizes = 2 * len(SCALES) + 2, 64, 64, 2
        layers = [torch.nn.Linear(a, b) for a, b in itertools.pairwise(sizes)]
        self.layers = torch.nn.Sequential(layers[0], torch.nn.Tanh(), layers[1], torch.nn.Tanh(), layers[2])
        self.double()

    def forward(self, error: torch.Tensor, velocity: torch.Tensor) -> torch.Tensor:
        """Return the actions of a batch, shape (B, 2)."""
        features = [torch.tanh(error / scale) for scale in SCALES]
        return torch.tanh(self.layers(torch.cat([*features, velocity / 0.5], dim=1)))


def distances(stage: DifferentiableStage, policy: Policy, generator: torch.Generator) -> torch.Tensor:
    """Simulate episodes under a policy.

    Args:
        stage: Stage to control.
        policy: The policy.
        generator: Random numbers for starts and goals.

    Returns:
        Distance of the tool from the goal at the end of each period, m, shape (EPISODES, PERIODS).
    """
    start, goal = (
        REACH * (2.0 * torch.rand(EPISODES, 2, generator=generator).double() - 1.0) for _ in range(2)
    )
    state, found = stage.rest(start.numpy()), []
    tool, velocity = stage.tool_positions(state), torch.zeros(EPISODES, 2, dtype=torch.float64)
    for _ in range(PERIODS):
        state = stage.step(state, policy(goal - tool, velocity) * torch.from_numpy(stage.rated))
        last, tool = tool, stage.tool_positions(state)
        velocity = (tool - last) / stage.period
        found.append(torch.sqrt((tool - goal).square().sum(1) + 1e-10))
    return torch.stack(found, dim=1)


def train(updates: int = 300, seed: int = 0) -> tuple[Policy, list[float]]:
    """Train a policy.

    Args:
        updates: Number of updates.
        seed: Seed of weights, starts and goals.

    Returns:
        policy: The trained policy.
        medians: Median distance at the end of the episodes, m, after each update.
    """
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    stage = DifferentiableStage(load_machine("hframe"), end_stops=True, friction="smoothed")
    policy, medians = Policy(), []
    optimizer = torch.optim.Adam(policy.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates)
    for _ in range(updates):
        found = distances(stage, policy, generator)
        optimizer.zero_grad()
        sum(found / (found + scale) for scale in (0.1, *SCALES)).mean().backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        medians.append(found[:, -1].median().item())
    return policy, medians


if __name__ == "__main__":
    torch.set_num_threads(1)  # the tensors are small: a second thread would only be waited for
    _, medians = train()
    for update in range(0, len(medians), 50):
        print(f"update {update:3}: median distance at the end {1e3 * medians[update]:.2f} mm")
    print(f"last update: {1e3 * medians[-1]:.3f} mm")
