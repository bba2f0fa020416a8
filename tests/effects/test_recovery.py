"""Each effect's numbers, found again in short recordings of the independent simulator with real sensors' noise.

The rest of the machine is known here; benchmarks/identification.py searches rigs of which nothing is.
"""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.identification import fit, prepare
from hframe_gym.identification.candidates import effect_parameters
from hframe_gym.identification.prediction import POLISH_STEP
from hframe_gym.identification.dataset import scales_of_motion as references
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording
from tests.effects.one_of_each import CASES, Case, history
from tests.reference_simulator.sensors import noisy

SEEDS = (21, 22, 23)


def near(case: Case) -> dict[str, float]:
    """The parameters by full name, as far off as a screening may leave them."""
    factors = {"rate": 1.01, "period": 1.01, "amplitude": 0.75, "shape": 0.99 if case.name == "sensor_range" else 0.75}
    found = {}
    for p in case.effect.definition.parameters:
        value = case.parameters[p.name]
        found[f"{case.effect.label}.{p.name}"] = value + 0.3 if p.role == "phase" else factors[p.role] * value
    return found


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_its_parameters_are_recovered(case: Case, hframe: Machine) -> None:
    rng = np.random.default_rng(7)
    recordings, moved = [], []
    for seed in SEEDS:
        time_s, inputs = history(seed, seconds=0.7, hold_s=0.02)
        *motion, readings = case.run(time_s, inputs)
        recordings.append(Recording(f"run_{seed}", time_s, inputs, noisy(readings, rng)))
        moved.append(motion)
    data = prepare(recordings, hframe)
    positions, velocities = (np.concatenate(part) for part in zip(*moved, strict=True))
    scale = references(hframe, positions, velocities, [r.inputs for r in recordings])
    # With the right numbers first: an effect that changes the tables takes its inertia out of what is declared.
    machine = hframe.with_effects(case.effect).replace(near(case))
    free = effect_parameters(machine.effects[0], machine, scale)
    found = fit(machine, free, data, "free", longest_step=POLISH_STEP)
    assert found.chi2 < 1.3
    for p in case.effect.definition.parameters:
        off = found.machine.effects[0].parameters[p.name] - case.parameters[p.name]
        assert abs(off) < (0.02 if p.role == "phase" else 0.02 * abs(case.parameters[p.name])), (p.name, off)
