"""States of effects that are stepped along a motion, against their formulas evaluated step by step."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.dynamics.codegen.state_steps import follow_state
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import argument_names

WITH_STATE = [name for name, effect in EFFECTS.items() if effect.next_state]


@pytest.mark.parametrize("name", WITH_STATE)
@pytest.mark.parametrize("variants", [None, 3])
def test_states_are_those_of_the_formula(name: str, variants: int | None) -> None:
    formula = EFFECTS[name].next_state
    assert formula is not None
    rng, shape = np.random.default_rng(0), (20,) if variants is None else (variants, 20)
    steps = {n: rng.uniform(0.1, 1.0, shape) for n in argument_names(formula) if n != "z"}
    if len(steps) > 1:  # the same for all variants
        steps |= {n: rng.normal(size=20) for n in steps if n in ("dq", "i")}
    expected, state = [], np.zeros(shape[:-1])
    for row in range(20):
        expected.append(state)
        state = formula(z=state, **{n: values[..., row] for n, values in steps.items()})
    np.testing.assert_allclose(
        follow_state(formula, steps), np.stack(expected, axis=-1), rtol=1e-12, atol=1e-14
    )
