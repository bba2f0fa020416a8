"""Stages that torch differentiates: gradients, shapes, end stops, parameters by name, and refusals."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hframe_gym.controllers import MotionModel
from hframe_gym.differentiable import DifferentiableStage
from hframe_gym.dynamics import NotFiniteError
from hframe_gym.effects import EFFECTS
from hframe_gym.envs import HFrameVectorEnv
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES

MACHINE = BUILTIN_MACHINES["hframe"]()
UNITS = torch.tensor([1e-3, 1e-3, 0.1, 0.1, 0.05, 0.05, 5.0, 5.0], dtype=torch.float64)


@pytest.fixture(scope="module")
def stage():
    return DifferentiableStage(MACHINE)


def moving(stage, batch=2):
    """States in motion along x and y, not equally fast, so that no pulley is at rest."""
    state = stage.rest(batch=batch)
    model = MotionModel(MACHINE)
    speeds = np.array([0.3, -0.2]) @ model.rigid.T / MACHINE.travel_per_unit
    state[:, 4:] = torch.from_numpy(speeds)
    return state


def test_torch_confirms_all_gradients(stage):
    start = moving(stage).requires_grad_()
    voltages = torch.tensor([[[3.0, -1.0]] * 3, [[5.0, 2.0]] * 3], dtype=torch.float64, requires_grad=True)
    mass = torch.tensor([4.0, 4.3], dtype=torch.float64, requires_grad=True)
    stretch = torch.tensor(1.02, dtype=torch.float64, requires_grad=True)

    def function(start, voltages, mass, stretch):
        parameters = stage.parameters({"x.mass": mass, "left.EA": 2e5 * stretch}, batch=2)
        states = stage.rollout(start * UNITS, voltages, parameters)
        return states / UNITS, 1e3 * stage.readings(states, parameters)

    scaled = (start / UNITS).detach().requires_grad_()
    assert torch.autograd.gradcheck(
        function, (scaled, voltages, mass, stretch), eps=1e-6, atol=1e-4, rtol=1e-5
    )


def test_steps_are_a_rollout(stage):
    voltages = torch.tensor(np.random.default_rng(0).uniform(-6.0, 6.0, (2, 4, 2)), requires_grad=True)
    together = stage.rollout(moving(stage), voltages)
    state = moving(stage)
    for k in range(4):
        state = stage.step(state, voltages[:, k])
        torch.testing.assert_close(state, together[:, k + 1], rtol=0.0, atol=1e-12)
    (by_steps,) = torch.autograd.grad(stage.tool_positions(state).sum(), voltages)
    (by_rollout,) = torch.autograd.grad(stage.tool_positions(together[:, -1]).sum(), voltages)
    torch.testing.assert_close(by_steps, by_rollout, rtol=1e-9, atol=0.0)


def test_steps_with_a_dead_time_take_earlier_voltages():
    stage = DifferentiableStage(MACHINE.with_effects(EFFECTS["input_delay"].at("drives", d=0.0137)))
    voltages = torch.tensor(np.random.default_rng(0).uniform(2.0, 6.0, (1, 6, 2)))
    together = stage.rollout(stage.rest(), voltages)
    state = stage.rest()
    for k in range(6):
        state = stage.step(state, voltages[:, k], earlier=voltages[:, max(0, k - 2) : k] if k else None)
    torch.testing.assert_close(state, together[:, -1], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("preset", ["hframe", "printer"])  # drives of the printer need steps below 0.5 ms
def test_an_episode_of_the_environment_is_a_rollout(preset):
    machine = BUILTIN_MACHINES[preset]()
    environment = HFrameVectorEnv(3, machine=machine, randomize="default", reward="dense")
    environment.reset(seed=1)
    stage = DifferentiableStage(machine, end_stops=True)
    simulator = environment.batch.simulator
    assert stage.motion.step == simulator.h
    start = stage.rest(simulator.tool_positions())
    parameters = torch.from_numpy(np.array(environment.parameters))
    generator = np.random.default_rng(0)
    actions = generator.uniform(-1.0, 1.0, (3, 40, 2)).astype(np.float32)
    states = stage.rollout(start, torch.from_numpy(actions) * torch.from_numpy(stage.rated), parameters)
    for k in range(40):
        environment.step(actions[:, k])
        tool = stage.tool_positions(states[:, k + 1])
        np.testing.assert_allclose(tool, simulator.tool_positions(), atol=1e-9)


def test_end_stops_keep_the_tool_in_the_workspace():
    voltages = torch.full((1, 150, 2), 12.0)
    ends = {}
    for stops in (False, True):
        stage = DifferentiableStage(MACHINE, end_stops=stops)
        states = stage.rollout(stage.rest(), voltages)
        ends[stops] = stage.tool_positions(states).abs().max().item()
    widest = max(abs(end) for axis in MACHINE.tool_axes for end in MACHINE.coordinate(axis).range)
    assert ends[False] > 1.2 * widest
    assert ends[True] < 1.02 * widest


def test_gradients_have_the_type_of_their_tensors(stage):
    voltages = torch.full((2, 3, 2), 4.0, dtype=torch.float32, requires_grad=True)
    stage.rollout(moving(stage), voltages, torch.from_numpy(stage.nominal)).sum().backward()
    assert voltages.grad.dtype == torch.float32
    assert voltages.grad.abs().min() > 0.0


def test_second_derivatives_are_refused(stage):
    voltages = torch.full((2, 3, 2), 4.0, requires_grad=True)
    result = (stage.rollout(moving(stage), voltages) ** 2).sum()
    (gradient,) = torch.autograd.grad(result, voltages, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start": torch.zeros(2, 7)}, r"start has shape \(2, 7\), machine '.*' needs \(B, 8\)"),
        ({"start": torch.zeros(8)}, r"start has shape \(8,\)"),
        ({"voltages": torch.zeros(2, 2)}, r"voltages has shape \(2, 2\)"),
        ({"voltages": torch.zeros(3, 5, 2)}, r"voltages has shape \(3, 5, 2\)"),
        ({"parameters": torch.zeros(2, 3)}, r"parameters has shape \(2, 3\)"),
        ({"earlier": torch.zeros(2, 5, 3)}, r"earlier has shape \(2, 5, 3\)"),
        ({"voltages": np.zeros((2, 5, 2))}, r"voltages is of type ndarray; give a tensor, such as torch\."),
        ({"parameters": [1.0, 2.0]}, r"parameters is of type list; give a tensor"),
    ],
)
def test_wrong_shapes_and_types_are_refused(stage, changes, message):
    arguments = {"start": stage.rest(batch=2), "voltages": torch.zeros(2, 5, 2), **changes}
    with pytest.raises(InputError, match=message):
        stage.rollout(**arguments)


def test_a_diverging_motion_is_reported(stage):
    parameters = stage.parameters({"left.EA": 1e12}, batch=2)
    with pytest.raises(NotFiniteError, match=r"motion 0: .* diverges at t = "):
        stage.rollout(moving(stage), torch.zeros(2, 20, 2), parameters)


def test_unknown_and_tied_parameters_are_refused(stage):
    with pytest.raises(InputError, match=r"'x\.weight' is none of its parameters; names are, "):
        stage.parameters({"x.weight": 1.0})


def test_without_torch_the_message_names_the_extra(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "hframe_gym.differentiable.torch_stage", raising=False)
    with pytest.raises(ImportError, match=r"pip install 'hframe_gym\[agents\]'"):
        import hframe_gym.differentiable.torch_stage  # noqa: F401
