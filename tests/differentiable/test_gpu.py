"""A learner on a GPU, stages on the processor: run where torch finds a GPU."""

from __future__ import annotations

import pytest
import torch

from hframe_gym.differentiable import DifferentiableStage
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES

MACHINE = BUILTIN_MACHINES["hframe"]()


def test_tensors_of_another_device_are_refused():
    stage = DifferentiableStage(MACHINE)
    with pytest.raises(InputError, match="is on the device meta"):
        stage.rollout(stage.rest(), torch.zeros(1, 5, 2, device="meta"))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no GPU")
@pytest.mark.filterwarnings("ignore:Attempting to run cuBLAS")  # from torch's own thread of backward()
def test_gradients_reach_a_policy_on_the_gpu():
    stage = DifferentiableStage(MACHINE, friction="sliding")
    weights = torch.full((stage.rest().shape[1], 2), 0.1, dtype=torch.float64)

    def gradient(device: str) -> torch.Tensor:
        policy, state = weights.to(device).requires_grad_(), stage.rest([[0.02, 0.01]])
        for _ in range(5):
            state = stage.step(state, (state.to(device) @ policy + 1.0).cpu())
        stage.tool_positions(state).sum().backward()
        return policy.grad.cpu()

    torch.testing.assert_close(gradient("cuda"), gradient("cpu"), rtol=1e-9, atol=0.0)
