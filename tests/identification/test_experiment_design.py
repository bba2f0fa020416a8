"""The next experiment: it separates what can be separated, keeps inside the travel, and promises nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hframe_gym.cli import app
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, FreeParameter, default_free_parameters, fit, prepare
from hframe_gym.identification.covariance import with_uncertainty
from hframe_gym.identification.experiment_design import (
    LEAST_SIGMA,
    ExperimentDesign,
    design_discriminating_experiment,
    next_experiment,
)
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Uncertainty
from hframe_gym.recordings import Recording, load_recording

AXIS = BUILTIN_MACHINES["axis"]()
PULLED = AXIS.with_effects(EFFECTS["constant_force"].at("x", size=0.15))
RUBBED = AXIS.with_effects(EFFECTS["asymmetric_viscous"].at("x", a=-0.15))
LABELS = ("constant_force@x", "asymmetric_viscous@x")


@pytest.fixture(scope="module")
def data() -> Dataset:
    """A recording of the axis that spans 100 mm."""
    time_s = np.arange(1000) * 2e-3
    noise = np.random.default_rng(0).normal(0.0, 20e-6, 1000)
    position = np.interp(time_s, [0.0, 0.2, 0.8, 1.6, 2.0], [0.0, 0.0, 0.06, -0.04, 0.0])
    inputs = np.where(time_s > 0.2, 1.0, 0.0)[:, None]
    return prepare([Recording("run", time_s, inputs, (position + noise)[:, None])], AXIS)


@pytest.fixture(scope="module")
def proposed(data: Dataset) -> ExperimentDesign:
    found = next_experiment(PULLED, RUBBED, LABELS, data)
    assert found is not None
    return found


def shown(machine: Machine, experiment: ExperimentDesign) -> np.ndarray:
    return simulate(machine, experiment.time_s, experiment.inputs, longest_step=0.125e-3).outputs[:, 0]


def test_it_separates_the_two_as_promised(proposed: ExperimentDesign, data: Dataset) -> None:
    difference = (shown(PULLED, proposed) - shown(RUBBED, proposed)) / data.noise[0]
    assert proposed.sigma == pytest.approx(np.linalg.norm(difference), rel=1e-3)
    assert proposed.sigma > 100 * LEAST_SIGMA
    assert proposed.channel == "x_m"


def test_it_stays_within_voltage_and_travel(proposed: ExperimentDesign) -> None:
    assert np.abs(proposed.inputs).max() <= AXIS.drives[0].rated_voltage
    assert not proposed.inputs[0].any()
    for machine in (PULLED, RUBBED):
        position = shown(machine, proposed)
        assert np.abs(position).max() < 0.05


def test_it_beats_a_plain_step(proposed: ExperimentDesign, data: Dataset) -> None:
    step = np.where((proposed.time_s > 0.15) & (proposed.time_s < 0.4), 1.0, 0.0)[:, None]
    one, other = (simulate(m, proposed.time_s, step).outputs[:, 0] for m in (PULLED, RUBBED))
    assert proposed.sigma > 2 * np.linalg.norm((one - other) / data.noise[0])


def test_what_the_parameters_may_follow_does_not_count(proposed: ExperimentDesign, data: Dataset) -> None:
    """A rival whose friction is hardly known takes up part of the difference."""
    names = ("x.coulomb", "x.viscous", "asymmetric_viscous@x.a")
    vague = RUBBED.replace(uncertainty=Uncertainty(names, np.diag([0.3, 3.0, 0.1]) ** 2))
    found = next_experiment(PULLED, vague, LABELS, data)
    assert found is not None
    assert LEAST_SIGMA < found.sigma < 0.8 * proposed.sigma


def test_nothing_is_promised_for_the_same_machine_in_other_words(data: Dataset) -> None:
    gain = AXIS.drives[0].gain
    offset = AXIS.with_effects(EFFECTS["voltage_offset"].at("motor", V0=0.15 / gain))
    assert next_experiment(PULLED, offset, ("constant_force@x", "voltage_offset@motor"), data) is None


def test_the_rival_of_a_fit_is_fitted_and_told_apart() -> None:
    """Runs that only ever go one way at one speed: a pull is as good as friction that differs by direction."""
    time_s = np.arange(400) * 2e-3
    inputs = np.where((time_s > 0.2) & (time_s < 0.6), 1.0, 0.0)[:, None]
    noise = np.random.default_rng(1).normal(0.0, 20e-6, (400, 1))
    outputs = simulate(PULLED, time_s, inputs, longest_step=0.125e-3).outputs + noise
    data = prepare([Recording("run", time_s, inputs, outputs)], AXIS)
    own = (
        *default_free_parameters(AXIS),
        FreeParameter("constant_force@x.size", 0.15, prior=10.0, scale=0.1, lower=-9.0),
    )
    after = fit(PULLED, own, data, "free")
    corrected = with_uncertainty(after, data)
    found = design_discriminating_experiment(after, corrected, LABELS[0], RUBBED.effects, data)
    assert found is not None
    assert found.separates == LABELS
    assert design_discriminating_experiment(after, corrected, LABELS[0], (), data) is None


def test_the_file_is_one_that_simulate_takes(proposed: ExperimentDesign, tmp_path: Path) -> None:
    path, out = tmp_path / "next_experiment.csv", tmp_path / "predicted.csv"
    proposed.write(path, AXIS)
    again = load_recording(path, AXIS, outputs_needed=False)
    np.testing.assert_allclose(again.inputs, proposed.inputs, rtol=1e-8)
    result = CliRunner().invoke(
        app, ["simulate", "--machine", "axis", "--inputs", str(path), "--out", str(out)], catch_exceptions=False
    )
    assert result.exit_code == 0
    assert len(load_recording(out, AXIS).time_s) == len(proposed.time_s)


def test_two_drives_work_together() -> None:
    """On the H-frame, along every combination of the motors, within the declared workspace."""
    hframe = BUILTIN_MACHINES["hframe"]()
    first = hframe.with_effects(EFFECTS["stribeck_friction"].at("x", dF=0.5, vs=0.02))
    second = hframe.with_effects(EFFECTS["friction_slope"].at("x", s=3.0))
    data = prepare([Recording("run", np.arange(500) * 2e-3, np.zeros((500, 2)), np.zeros((500, 4)))], hframe)
    found = next_experiment(first, second, ("stribeck_friction@x", "friction_slope@x"), data)
    assert found is not None
    moved = simulate(first, found.time_s, found.inputs).positions
    for i, c in enumerate(hframe.coordinates[:2]):
        assert c.range is not None
        assert c.range[0] < moved[:, i].min()
        assert moved[:, i].max() < c.range[1]
