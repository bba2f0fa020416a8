"""Each effect of the library is complete, is nothing at amplitude zero, and checks its numbers."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS, effect_sites, get_effect
from hframe_gym.effects.smooth_table import KNOTS
from hframe_gym.machine import BUILTIN_MACHINES, Effect, Machine
from hframe_gym.machine.effect import CONTRIBUTIONS
from hframe_gym.machine.machine import UNITS
from tests.effects.one_of_each import CASES, Case, history

EVERY = pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
WITH_AMPLITUDE = {name: case for name, case in CASES.items() if EFFECTS[name].amplitudes}
PLAIN_UNITS = {"1", "s", "V", "A", "m", "rad", "N", "1/m^2", "kg m^2", "Nm/rad", "Nms"}


@EVERY
def test_a_definition_is_complete(effect: Effect, hframe: Machine) -> None:
    assert effect.structure or any(getattr(effect, name) for name in CONTRIBUTIONS)
    assert effect.formula
    assert effect.source
    assert effect_sites(effect, hframe)
    roles = [p.role for p in effect.parameters]
    # The screening takes sine and cosine of one amplitude, or a grid of starting values.
    assert roles.count("amplitude") <= 1
    assert roles.count("phase") <= roles.count("amplitude")
    for p in effect.parameters:
        assert p.lower < p.upper
        assert p.unit in {*UNITS["linear"], *PLAIN_UNITS}
        assert p.role != "shape" or p.grid or effect.name == "sensor_range"


@EVERY
def test_parameters_are_checked(effect: Effect, hframe: Machine) -> None:
    case = CASES[effect.name]
    with pytest.raises(ValueError, match=f"effect {effect.name} at {case.site} takes"):
        effect.at(case.site, nonsense=1.0)
    first = effect.parameters[0]
    wrong = case.parameters | {first.name: first.upper * 2 + 1}
    with pytest.raises(ValueError, match=f"{first.name} = .* is outside"):
        effect.at(case.site, **wrong)


@pytest.mark.parametrize("case", WITH_AMPLITUDE.values(), ids=WITH_AMPLITUDE)
def test_a_zero_amplitude_changes_nothing(case: Case, hframe: Machine) -> None:
    time_s, inputs = history(0, seconds=0.3)
    [amplitude] = EFFECTS[case.name].amplitudes
    effect = case.effect.with_parameters(case.parameters | {amplitude: 0.0})
    difference = hframe.with_effects(effect).simulate(time_s, inputs).outputs - hframe.simulate(time_s, inputs).outputs
    # Bent belts are evaluated in full at both points of a step, which changes its error.
    assert np.abs(difference).max() < (1e-6 if case.site == "belts" or case.name == "eccentric_pulley" else 1e-12)


def test_effects_without_room_have_no_site() -> None:
    axis = BUILTIN_MACHINES["axis"]()
    for name in ("belt_play", "eccentric_pulley", "bridge_yaw", "idler_inertia", "sensor_skew", "sensor_scale"):
        assert effect_sites(EFFECTS[name], axis) == ()


def table(name: str, site: str, knots: np.ndarray, values: np.ndarray) -> dict[str, float]:
    return {f"k{i:02d}": k for i, k in enumerate(knots)} | {f"f{i:02d}": f for i, f in enumerate(values)}


@pytest.mark.parametrize(("kind", "contribution"), [("smooth_force", "force"), ("smooth_friction", "coulomb")])
def test_a_table_is_straight_between_its_knots(kind: str, contribution: str) -> None:
    rng = np.random.default_rng(4)
    knots, values = np.sort(rng.normal(size=KNOTS)), rng.normal(size=KNOTS)
    name = f"{kind}[position of y]"
    effect = get_effect(name).at("x", **table(name, "x", knots, values))
    u = np.linspace(knots[0] - 1.0, knots[-1] + 1.0, 500)
    np.testing.assert_allclose(effect(contribution, u=u), np.interp(u, knots, values), atol=1e-12)


@pytest.mark.parametrize(
    "name", ["smooth_force[weight of x]", "smooth_force[position]", "smooth_nothing[time]", "rust"]
)
def test_an_unknown_name_is_refused(name: str) -> None:
    with pytest.raises(KeyError):
        get_effect(name)
