"""The generated kernel against the integrator in plain Python, step by step."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.dynamics import LANES, Equations, in_blocks, kernel_for
from hframe_gym.dynamics.physics.parameterized_machine import MotionPoint
from hframe_gym.dynamics.physics.reference_step import reference_step
from hframe_gym.dynamics.simulation import parameter_batch
from hframe_gym.machine import BUILTIN_MACHINES, Machine, rest_state
from tests.effects.one_of_each import CASES, START, Case

STEP = 0.25e-3  # s
STEPS = 48
HOLD = 6  # steps for which a voltage is held; short, so that coordinates stop and reverse


def largest_difference(machine: Machine) -> float:
    """Return the largest relative difference of a state after one step from the same state."""
    kernel, equations, count = kernel_for(machine), Equations(machine), len(machine.coordinates)
    parameters = in_blocks(parameter_batch(machine))
    derived = np.zeros((1, len(kernel.layout.derived), LANES))
    kernel.prepare_blocks(parameters, STEP, 0, 1, derived)
    state = np.zeros(kernel.states)
    linear = sum(c.kind == "linear" for c in machine.coordinates)
    state[:count] = rest_state(machine, START[:linear])[:count] * machine.travel_per_unit
    rng = np.random.default_rng(0)
    before, after = [], []
    for step in range(STEPS):
        if step % HOLD == 0:
            voltages = rng.uniform(-9.0, 9.0, len(machine.drives))
        effect_states = dict(zip(equations.states, state[2 * count + 1 :], strict=True))
        start = MotionPoint(state[:count], state[count : 2 * count], state[2 * count], effect_states)
        end = reference_step(equations, start, voltages, STEP)
        before.append([*end.travel, *end.speed, end.time, *end.effect_states.values()])
        block = in_blocks(state[None])
        kernel.advance_blocks(block, parameters, derived, in_blocks(voltages[None]), STEP, 1, 0, 1)
        state = block[0, :, 0].copy()
        after.append(state)
    expected, actual = np.array(before), np.array(after)
    scale = np.maximum(np.abs(actual).max(axis=0), 1e-9)
    assert np.abs(actual[:, :count]).max() > 1e-5
    return float((np.abs(actual - expected) / scale).max())


@pytest.mark.parametrize("name", BUILTIN_MACHINES)
def test_machine(name: str) -> None:
    """Machines without effects."""
    assert largest_difference(BUILTIN_MACHINES[name]()) < 1e-12


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_machine_with_effect(case: Case, hframe: Machine) -> None:
    """Each effect of the library."""
    # A bristle moves by a small difference of large exponents; the age of a contact adds to a logarithm.
    limits = {"presliding": 1e-10, "dwell_friction": 3e-12}
    assert largest_difference(hframe.with_effects(case.effect)) < limits.get(case.name, 1e-12)
