"""The kernel with each effect against an event-driven simulator without common code or method."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import Machine, rest_state
from tests import reference_simulator as reference
from tests.effects.one_of_each import CASES, ELSEWHERE, START, Case, history

TRAVEL = np.array([0.0194, 0.0194, 1.0, 1.0])  # m per rad of an encoder, m per m of a laser
pytestmark = pytest.mark.oracle

STEP = 0.125e-3  # s
TOLERANCE = 1.5e-6  # m of travel
# m; these switch a force within a step, or change the damping, which is integrated with that of Ohm's law
SWITCHING_TOLERANCE = {
    "coasting_bridge": 3e-6,
    "input_delay": 8e-6,
    "current_limit": 3e-6,
    "gear_backlash": 3e-6,
}


def difference(machine: Machine, time_s: np.ndarray, inputs: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest difference of the machine's readings, relative to the first sample, m of travel."""
    readings = simulate(machine, time_s, inputs, rest_state(machine, START), longest_step=STEP).outputs
    return float(np.abs((readings - readings[0] - (expected - expected[0])) * TRAVEL).max())


def test_every_effect_has_a_case() -> None:
    """A new effect of the library needs a case in one_of_each.py."""
    assert {*CASES, *ELSEWHERE} == set(EFFECTS)


@pytest.mark.parametrize("seed", [3, 11])
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_readings_agree(case: Case, seed: int, hframe: Machine) -> None:
    """The difference is far smaller than the effect."""
    time_s, inputs = history(seed)
    _, _, expected = case.run(time_s, inputs)
    tolerance = SWITCHING_TOLERANCE.get(case.name, TOLERANCE)
    assert difference(hframe.with_effects(case.effect), time_s, inputs, expected) < tolerance
    assert difference(hframe, time_s, inputs, expected) > 20 * tolerance


def test_dead_band_without_drop_is_a_switch(hframe: Machine) -> None:
    """With drop = 0 the effect equals voltages of which the small ones are zero."""
    time_s, inputs = history(5)
    inputs *= 0.2
    switched = inputs.copy()
    switched[np.abs(inputs[:, 0]) < 0.8, 0] = 0.0
    positions, _ = reference.simulate(reference.Rig(), time_s, switched, START)
    machine = hframe.with_effects(EFFECTS["dead_band"].at("motor1", Vd=0.8, drop=0.0))
    expected = positions[:, [2, 3, 0, 1]]
    assert difference(machine, time_s, inputs, expected) < TOLERANCE
    assert difference(hframe, time_s, inputs, expected) > 20 * TOLERANCE


SHARED_BY_BOTH_DRIVES = {
    "electrical_lag": ({"tau": 1.5e-3}, {"electrical_lag_s": (1.5e-3, 1.5e-3)}),
    "dead_band": ({"Vd": 0.4, "drop": 1.0}, {"dead_band_V": (0.4, 0.4)}),
    "voltage_limit": ({"U": 4.0}, {"voltage_limit_V": (4.0, 4.0)}),
    "coasting_bridge": ({"U": 12.0}, {"coasting_V": (12.0, 12.0)}),
    "current_limit": ({"I": 4.5}, {"current_limit_A": (4.5, 4.5)}),
    "inverter_dead_time": (
        {"Vd": 0.4, "i0": 0.1},
        {"dead_time_V": (0.4, 0.4), "dead_time_A": (0.1, 0.1)},
    ),
}


@pytest.mark.parametrize("name", SHARED_BY_BOTH_DRIVES)
def test_effect_on_both_drives(name: str, hframe: Machine) -> None:
    """One effect at "drives" acts on both drives, each with its own current."""
    time_s, inputs = history(13)
    parameters, fields = SHARED_BY_BOTH_DRIVES[name]
    positions, _ = reference.simulate(reference.Rig(**fields), time_s, inputs, START)
    machine = hframe.with_effects(EFFECTS[name].at("drives", **parameters))
    tolerance = SWITCHING_TOLERANCE.get(name, TOLERANCE)
    assert difference(machine, time_s, inputs, positions[:, [2, 3, 0, 1]]) < tolerance


def test_damping_of_one_belt(hframe: Machine) -> None:
    """The other two belts remain without damping."""
    time_s, inputs = history(13)
    rig = reference.Rig(belt_damping_s=1e-3, belt_damping_factor=(0.0, 1.0, 0.0))
    positions, _ = reference.simulate(rig, time_s, inputs, START)
    machine = hframe.with_effects(EFFECTS["belt_damping"].at("right", c=1e-3))
    assert difference(machine, time_s, inputs, positions[:, [2, 3, 0, 1]]) < TOLERANCE


@pytest.mark.parametrize("name", ["belt_damping", "belt_play", "belt_slack", "belt_hardening"])
def test_effect_on_each_belt_equals_the_effect_on_all(name: str, hframe: Machine) -> None:
    """Three effects at single belts, against the one at "belts", which the simulator confirms."""
    time_s, inputs = history(17, seconds=0.3)
    case = CASES[name]
    each = [EFFECTS[name].at(belt.name, **case.parameters) for belt in hframe.belts]
    expected = simulate(hframe.with_effects(case.effect), time_s, inputs, rest_state(hframe, START)).outputs
    outputs = simulate(hframe.with_effects(*each), time_s, inputs, rest_state(hframe, START)).outputs
    np.testing.assert_allclose(outputs, expected, atol=1e-9)


def test_damped_belt_around_an_eccentric_pulley(hframe: Machine) -> None:
    """Belt damping acts on the rate at which the eccentric pulley draws its belts."""
    time_s, inputs = history(7)
    rig = reference.Rig(belt_damping_s=1e-3, eccentricity_m=(0.0, 1e-3), eccentricity_phase=(0.0, 0.7))
    positions, _ = reference.simulate(rig, time_s, inputs, START)
    damping = EFFECTS["belt_damping"].at("belts", c=1e-3)
    pulley = EFFECTS["eccentric_pulley"].at("motor2", e=1e-3, p=0.7)
    expected = positions[:, [2, 3, 0, 1]]
    assert difference(hframe.with_effects(damping, pulley), time_s, inputs, expected) < 2 * TOLERANCE
