"""Tests of effects that are another one, with fewer parameters, by a value of a parameter."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.machine import HOOKS, Effect, argument_names

SIMPLER = [
    (definition, parameter.name, value, EFFECTS[name])
    for definition in EFFECTS.values()
    for parameter in definition.parameters
    for value, name in parameter.simpler.items()
]


@pytest.mark.parametrize(
    ("effect", "parameter", "value", "simpler"), SIMPLER, ids=[f"{e.name}.{p}" for e, p, *_ in SIMPLER]
)
def test_the_simpler_effect_has_the_same_formula(
    effect: Effect, parameter: str, value: float, simpler: Effect
) -> None:
    known = {p.name for p in simpler.parameters}
    assert {p.name for p in effect.parameters} == known | {parameter}
    rng = np.random.default_rng(1)
    for hook in HOOKS:
        formula, other = getattr(effect, hook), getattr(simpler, hook)
        assert (formula is None) == (other is None)
        if formula is None:
            continue
        values = {
            name: rng.uniform(0.5, 2.0, 9) for name in (*argument_names(formula), *argument_names(other))
        }
        values[parameter] = np.full(9, value)
        results = [f(**{name: values[name] for name in argument_names(f)}) for f in (formula, other)]
        np.testing.assert_allclose(results[0], results[1], rtol=1e-12)
