"""The kernel with each effect against an event-driven simulator with which it shares neither code nor method."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.machine import Machine, rest_state
from tests import reference_simulator as reference
from tests.effects.one_of_each import CASES, START, Case, history

TRAVEL = np.array([0.0194, 0.0194, 1.0, 1.0])  # m per rad of an encoder, m per m of a laser
STEP = 0.125e-3  # s
AGREE = 1.5e-6  # m of travel
WITHIN_A_STEP = {"input_delay": 8e-6, "current_limit": 3e-6}  # these switch a force inside a step, which costs more


def difference(machine: Machine, time_s: np.ndarray, inputs: np.ndarray, shown: np.ndarray) -> float:
    """Largest difference of the machine's readings from those shown, counted from the first row, m of travel."""
    readings = simulate(machine, time_s, inputs, rest_state(machine, START), longest_step=STEP).outputs
    return float(np.abs((readings - readings[0] - (shown - shown[0])) * TRAVEL).max())


def test_every_effect_has_a_case() -> None:
    assert set(CASES) == set(EFFECTS)


@pytest.mark.parametrize("seed", [3, 11])
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_the_readings_agree(case: Case, seed: int, hframe: Machine) -> None:
    time_s, inputs = history(seed)
    _, _, shown = case.run(time_s, inputs)
    agree = WITHIN_A_STEP.get(case.name, AGREE)
    assert difference(hframe.with_effects(case.effect), time_s, inputs, shown) < agree
    # The effect itself is far larger than what the test allows.
    assert difference(hframe, time_s, inputs, shown) > 20 * agree


def test_a_switch_drives_all_or_nothing(hframe: Machine) -> None:
    """drop = 0 is a switch: the same as voltages of which the small ones are zero."""
    time_s, inputs = history(5)
    inputs *= 0.2
    switched = inputs.copy()
    switched[np.abs(inputs[:, 0]) < 0.8, 0] = 0.0
    positions, _ = reference.simulate(reference.Rig(), time_s, switched, START)
    machine = hframe.with_effects(EFFECTS["dead_band"].at("motor1", Vd=0.8, drop=0.0))
    shown = positions[:, [2, 3, 0, 1]]
    assert difference(machine, time_s, inputs, shown) < AGREE
    assert difference(hframe, time_s, inputs, shown) > 20 * AGREE


def test_a_late_belt_around_an_eccentric_pulley(hframe: Machine) -> None:
    """Two effects that meet: the damping acts on the rate at which the eccentric pulley really draws its belts."""
    time_s, inputs = history(7)
    rig = reference.Rig(belt_damping_s=1e-3, eccentricity_m=(0.0, 1e-3), eccentricity_phase=(0.0, 0.7))
    positions, _ = reference.simulate(rig, time_s, inputs, START)
    late, untrue = EFFECTS["belt_damping"].at("belts", c=1e-3), EFFECTS["eccentric_pulley"].at("motor2", e=1e-3, p=0.7)
    shown = positions[:, [2, 3, 0, 1]]
    assert difference(hframe.with_effects(late, untrue), time_s, inputs, shown) < 2 * AGREE
