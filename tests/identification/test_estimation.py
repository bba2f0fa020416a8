"""The fit finds parameters of recordings that another simulator made (examples/, tools.make_examples)."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.identification import Dataset, default_free_parameters, fit, prepare
from hframe_gym.identification.estimation import FreeParameter
from hframe_gym.machine import BUILTIN_MACHINES
from hframe_gym.recordings import load_recordings
from tools.make_examples import TRUTH


@pytest.fixture(scope="module")
def twin() -> Dataset:
    machine = BUILTIN_MACHINES["hframe"]()
    return prepare(load_recordings("examples/rig_b", machine), machine)


def test_parameters_of_the_twin_without_effects(twin: Dataset) -> None:
    machine = BUILTIN_MACHINES["hframe"]()
    rough = fit(machine, default_free_parameters(machine), twin, "innovations")
    found = fit(machine, default_free_parameters(machine), twin, "free", theta=rough.theta)
    assert found.chi2 < 1.1
    # Voltages tell forces only in units of the first motor's gain.
    gains = [k * g for k, g in zip(TRUTH.torque_constant, TRUTH.drive_gain, strict=True)]
    unit = gains[0] / machine.drives[0].Kt
    values = found.machine.parameters
    for i, name in enumerate(("x", "y", "phi1", "phi2")):
        assert values[f"{name}.mass"] * unit == pytest.approx(TRUTH.mass[i], rel=0.01)
        assert values[f"{name}.coulomb"] * unit == pytest.approx(TRUTH.coulomb[i], rel=0.01)
    assert values["motor2.Kt"] * unit == pytest.approx(gains[1], rel=0.01)


def test_a_free_parameter_moves_as_it_says() -> None:
    positive = FreeParameter("m", 2.0, prior=0.3)
    assert positive.value(np.array([0.0, np.log(2)])) == pytest.approx([2.0, 4.0])
    linear = FreeParameter("c", 0.0, prior=1.0, scale=0.5)
    assert linear.value(np.array([-1.0, 3.0])) == pytest.approx([0.0, 1.5])
