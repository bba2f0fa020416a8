"""JAX on a GPU, stages on the processor: run where JAX finds a GPU."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.machine import BUILTIN_MACHINES

MACHINE = BUILTIN_MACHINES["hframe"]()


def test_jax_calls_stages_from_a_program_on_the_gpu():
    jax = pytest.importorskip("jax")
    if jax.default_backend() != "gpu":
        pytest.skip("JAX finds no GPU")
    from hframe_gym.differentiable import JaxStage

    with jax.enable_x64(True):
        stage = JaxStage(MACHINE)
        voltages = np.random.default_rng(0).uniform(-6.0, 6.0, (8, 10, 2))

        def cost(voltages):
            return (stage.rollout(stage.rest(batch=8), voltages)[:, -1, :2] ** 2).sum()

        on_gpu = jax.jit(jax.grad(cost))(jax.device_put(voltages, jax.devices("gpu")[0]))
        on_cpu = jax.jit(jax.grad(cost))(jax.device_put(voltages, jax.devices("cpu")[0]))
    np.testing.assert_array_equal(on_gpu, on_cpu)
