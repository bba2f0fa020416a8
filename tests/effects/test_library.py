"""Each effect of the library is complete, and does what its formula says (tests/machine holds it to an oracle)."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.effects import LIBRARY, sites
from hframe_gym.machine import Effect, Machine
from hframe_gym.machine.effect import CONTRIBUTIONS
from hframe_gym.machine.tables import UNITS

EVERY = pytest.mark.parametrize("effect", LIBRARY.values(), ids=LIBRARY.keys())


@EVERY
def test_a_definition_is_complete(effect: Effect, hframe: Machine) -> None:
    assert any(getattr(effect, name) for name in CONTRIBUTIONS)
    assert sum(p.amplitude for p in effect.parameters) == 1
    assert effect.formula
    assert effect.source
    assert sites(effect, hframe)
    for p in effect.parameters:
        assert p.lower < p.upper
        assert p.unit in {*UNITS["linear"], "1", "s", "V", "A", "m", "rad"}


@EVERY
def test_a_zero_amplitude_changes_nothing(effect: Effect, hframe: Machine) -> None:
    rng = np.random.default_rng(0)
    time = np.arange(300) * 1e-3
    inputs = np.repeat(rng.uniform(-8, 8, (10, 2)), 30, axis=0)
    values = {p.name: 0.0 if p.amplitude else 0.1 for p in effect.parameters}
    with_effect = hframe.with_effects(effect.at(sites(effect, hframe)[0], **values))
    difference = with_effect.simulate(time, inputs).positions - hframe.simulate(time, inputs).positions
    assert np.abs(difference).max() < 1e-12


@EVERY
def test_parameters_are_checked(effect: Effect, hframe: Machine) -> None:
    site = sites(effect, hframe)[0]
    with pytest.raises(ValueError, match=f"effect {effect.name} at {site} takes"):
        effect.at(site, nonsense=1.0)
    first = effect.parameters[0]
    values = {p.name: max(p.lower, 0.0) for p in effect.parameters} | {first.name: first.upper * 2 + 1}
    with pytest.raises(ValueError, match=f"{first.name} = .* is outside"):
        effect.at(site, **values)
