"""Stages that JAX differentiates: the same motions and gradients as with torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hframe_gym.differentiable import DifferentiableStage
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES

jax = pytest.importorskip("jax")

MACHINE = BUILTIN_MACHINES["hframe"]()


@pytest.fixture
def float64():
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


@pytest.mark.usefixtures("float64")
def test_jax_and_torch_compute_the_same():
    from hframe_gym.differentiable import JaxStage

    ours, theirs = JaxStage(MACHINE, end_stops=True), DifferentiableStage(MACHINE, end_stops=True)
    voltages = np.random.default_rng(0).uniform(-6.0, 6.0, (3, 10, 2))
    parameters = np.tile(ours.nominal, (3, 1))

    @jax.jit
    def cost(voltages, parameters):
        return (ours.rollout(ours.rest(batch=3), voltages, parameters)[:, -1, :2] ** 2).sum()

    by_voltages, by_parameters = jax.grad(cost, argnums=(0, 1))(voltages, parameters)
    tensors = [torch.from_numpy(values).requires_grad_() for values in (voltages, parameters)]
    expected = (theirs.rollout(theirs.rest(batch=3), *tensors)[:, -1, :2] ** 2).sum()
    expected.backward()
    assert float(cost(voltages, parameters)) == pytest.approx(expected.item(), rel=1e-12)
    np.testing.assert_allclose(by_voltages, tensors[0].grad, rtol=1e-12)
    np.testing.assert_allclose(by_parameters, tensors[1].grad, rtol=1e-12)


@pytest.mark.usefixtures("float64")
def test_shapes_are_checked_before_tracing():
    from hframe_gym.differentiable import JaxStage

    stage = JaxStage(MACHINE)
    with pytest.raises(InputError, match="voltages has shape"):
        stage.rollout(stage.rest(batch=2), np.zeros((2, 5, 3)))


def test_single_precision_is_refused():
    from hframe_gym.differentiable import JaxStage

    with pytest.raises(InputError, match="jax_enable_x64"):
        JaxStage(MACHINE)
