"""Tests of what candidate effects do along a motion: the forces, and the simulation that they predict."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import prepare
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH, SIMULATION, predict
from hframe_gym.identification.propose.perturbations import (
    Unperturbed,
    candidate_perturbations,
    perturbed_machines,
)
from hframe_gym.machine import Machine
from tests.identification.propose.recorded_axis import CANDIDATES, candidate, recorded


@pytest.mark.parametrize(
    ("name", "site", "column", "amplitude"),
    [
        ("cogging", "motor", {"A": 0.2, "n": 90.0, "p": 0.4}, "A"),
        ("position_friction", "x", {"A": 5.0, "L": 0.02, "p": 0.4}, "A"),  # five times the Coulomb friction
        ("sensor_delay", "x_m", {"d": 1e-3}, "d"),
    ],
)
def test_response_predicts_the_simulation_with_a_small_effect(
    axis: Machine, name: str, site: str, column: dict[str, float], amplitude: str
) -> None:
    data = prepare([recorded(axis)], axis)
    run, fraction = data.runs[0], 1e-3
    motion = predict(axis, run, SIMULATION, period=data.period, states=True)
    candidates = [candidate(name, site, **column)]
    perturbation = candidate_perturbations(
        Unperturbed(axis, run, motion), perturbed_machines(axis, candidates)
    )
    of_sensors = perturbation.measurement  # None where only forces act
    assert (of_sensors is not None) == (site == "x_m")
    perturbed = predict(
        axis,
        run,
        SIMULATION,
        period=data.period,
        extra_force=fraction * perturbation.force,
        extra_measurement=None if of_sensors is None else fraction * of_sensors,
    )
    machine = axis.with_effects(EFFECTS[name].at(site, **{**column, amplitude: fraction * column[amplitude]}))
    exact = predict(machine, run, SIMULATION, period=data.period)
    change = exact.readings - motion.readings
    error = perturbed.readings - exact.readings
    assert np.abs(change).max() > 1e-7
    assert np.abs(error).max() < 0.03 * np.abs(change).max()


def test_columns_of_several_candidates_keep_their_order(axis: Machine) -> None:
    data = prepare([recorded(axis)], axis)
    motion = predict(axis, data.runs[0], SEARCH_BANDWIDTH, period=data.period, states=True)
    perturbed = perturbed_machines(axis, CANDIDATES)
    perturbation = candidate_perturbations(Unperturbed(axis, data.runs[0], motion), perturbed)
    np.testing.assert_allclose(perturbation.force[0], 0.1)
    viscous = axis.coordinates[0].viscous
    np.testing.assert_allclose(
        perturbation.force[1], -0.1 * viscous * np.abs(motion.velocities[0]), atol=1e-12
    )
    np.testing.assert_allclose(perturbation.force[2], -10.0 * motion.positions[0], atol=1e-12)
    assert perturbation.measurement is None
