"""Tests of experiment design: it separates what it can, stays inside the travel and promises no more."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hframe_gym.cli import app
from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, FreeParameter, default_free_parameters, fit, prepare
from hframe_gym.identification.fit.covariance import with_uncertainty
from hframe_gym.identification.predict.prediction import SIMULATION
from hframe_gym.identification.report.diagnostics.experiment_design import (
    MINIMUM_SIGMA,
    ExperimentDesign,
    after_adaptation,
    design_discriminating_experiment,
    separate_machines,
)
from hframe_gym.machine import BUILTIN_MACHINES, Machine, Uncertainty
from hframe_gym.recordings import Recording, load_recording
from tests.identification.report.axis_results import PLAN

PRESET = BUILTIN_MACHINES["axis"]()
AXIS = PRESET.replace(coordinates=(dataclasses.replace(PRESET.coordinates[0], range=None),))
CONSTANT_FORCE = AXIS.with_effects(EFFECTS["constant_force"].at("x", size=0.15))
ASYMMETRIC = AXIS.with_effects(EFFECTS["asymmetric_viscous"].at("x", a=-0.15))
LABELS = ("constant_force@x", "asymmetric_viscous@x")


@pytest.fixture
def data() -> Dataset:
    """Return a recording of the axis that spans 100 mm."""
    time_s = np.arange(1000) * 2e-3
    noise = np.random.default_rng(0).normal(0.0, 20e-6, 1000)
    position = np.interp(time_s, [0.0, 0.2, 0.8, 1.6, 2.0], [0.0, 0.0, 0.06, -0.04, 0.0])
    inputs = np.where(time_s > 0.2, 1.0, 0.0)[:, None]
    return prepare([Recording("run", time_s, inputs, (position + noise)[:, None])], AXIS)


@pytest.fixture
def experiment(data: Dataset) -> ExperimentDesign:
    """Return the run that separates a constant force from direction-dependent friction."""
    design = separate_machines(CONSTANT_FORCE, ASYMMETRIC, LABELS, data)
    assert design is not None
    return design


def simulated_output(machine: Machine, experiment: ExperimentDesign) -> np.ndarray:
    """Return the noise-free position (n,) that a machine predicts for an experiment."""
    return simulate(machine, experiment.time_s, experiment.inputs, longest_step=0.125e-3).outputs[:, 0]


def test_design_separates_the_machines_as_predicted(experiment: ExperimentDesign, data: Dataset) -> None:
    difference = (
        simulated_output(CONSTANT_FORCE, experiment) - simulated_output(ASYMMETRIC, experiment)
    ) / data.noise[0]
    assert experiment.sigma == pytest.approx(np.linalg.norm(difference), rel=1e-3)
    assert experiment.sigma > 100 * MINIMUM_SIGMA
    assert experiment.channel == "x_m"


def test_design_respects_voltage_and_travel(experiment: ExperimentDesign) -> None:
    assert np.abs(experiment.inputs).max() <= AXIS.drives[0].rated_voltage
    assert not experiment.inputs[0].any()
    for machine in (CONSTANT_FORCE, ASYMMETRIC):
        position = simulated_output(machine, experiment)
        assert np.abs(position).max() < 0.05


def test_design_separates_better_than_a_single_step(experiment: ExperimentDesign, data: Dataset) -> None:
    step = np.where((experiment.time_s > 0.15) & (experiment.time_s < 0.4), 1.0, 0.0)[:, None]
    first, second = (simulate(m, experiment.time_s, step).outputs[:, 0] for m in (CONSTANT_FORCE, ASYMMETRIC))
    assert experiment.sigma > 2 * np.linalg.norm((first - second) / data.noise[0])


def test_difference_that_uncertain_parameters_absorb_does_not_count(
    experiment: ExperimentDesign, data: Dataset
) -> None:
    """A rival with uncertain friction absorbs part of the difference."""
    names = ("x.coulomb", "x.viscous", "asymmetric_viscous@x.a")
    uncertain = ASYMMETRIC.replace(uncertainty=Uncertainty(names, np.diag([0.3, 3.0, 0.1]) ** 2))
    design = separate_machines(CONSTANT_FORCE, uncertain, LABELS, data)
    assert design is not None
    assert MINIMUM_SIGMA < design.sigma < 0.8 * experiment.sigma


def test_no_design_for_two_equivalent_machines(data: Dataset) -> None:
    gain = AXIS.drives[0].gain
    offset = AXIS.with_effects(EFFECTS["voltage_offset"].at("motor", V0=0.15 / gain))
    assert (
        separate_machines(CONSTANT_FORCE, offset, ("constant_force@x", "voltage_offset@motor"), data) is None
    )


def test_rival_of_a_fit_is_fitted_and_separated() -> None:
    """Runs in one direction at one speed: a constant force is as good as direction-dependent friction."""
    time_s = np.arange(400) * 2e-3
    inputs = np.where((time_s > 0.2) & (time_s < 0.6), 1.0, 0.0)[:, None]
    noise = np.random.default_rng(1).normal(0.0, 20e-6, (400, 1))
    outputs = simulate(CONSTANT_FORCE, time_s, inputs, longest_step=0.125e-3).outputs + noise
    data = prepare([Recording("run", time_s, inputs, outputs)], AXIS)
    free = (
        *default_free_parameters(AXIS),
        FreeParameter("constant_force@x.size", 0.15, prior=10.0, scale=0.1, lower=-9.0),
    )
    fitted = fit(CONSTANT_FORCE, free, data, SIMULATION)
    corrected = with_uncertainty(fitted, data)
    design = design_discriminating_experiment(fitted, corrected, LABELS[0], ASYMMETRIC.effects, data)
    assert design is not None
    assert design.separates == LABELS
    assert design_discriminating_experiment(fitted, corrected, LABELS[0], (), data) is None
    # The range of a saturated sensor follows from the measurements and is no effect of the fit.
    assert design_discriminating_experiment(fitted, corrected, "sensor_range@x_m", (), data) is None


def with_sensors(machine: Machine, *channels: str) -> Machine:
    """Return a machine with more sensors of the position of its first coordinate."""
    first = machine.sensors[0]
    more = [dataclasses.replace(first, channel=channel) for channel in channels]
    return machine.replace(sensors=(*machine.sensors, *more))


@pytest.mark.parametrize(
    ("machine", "equivalent"),
    [
        (with_sensors(AXIS, "tape_m"), True),
        (with_sensors(AXIS, "tape_m", "ruler_m"), False),  # two of three agree
        (with_sensors(BUILTIN_MACHINES["belt-axis"](), "tape_m"), False),  # the motor has an encoder
    ],
)
def test_the_scales_of_two_sensors_of_one_axis_are_the_same_in_every_recording(
    machine: Machine, equivalent: bool
) -> None:
    """A run that decides between them had been promised."""
    scale = EFFECTS["sensor_scale"]
    assert scale.is_equivalent(machine, "x_m", "sensor_scale@tape_m") == equivalent
    assert scale.is_equivalent(
        machine, "x_m", "a wrong travel per turn (radius of a pulley, lead of a screw)"
    )
    assert not scale.is_equivalent(machine, "x_m", "sensor_delay@tape_m")


@pytest.mark.parametrize(("channels", "designed"), [(("tape_m",), False), (("tape_m", "ruler_m"), True)])
def test_no_experiment_is_designed_where_no_recording_can_decide(
    channels: tuple[str, ...], designed: bool
) -> None:
    """A fit of the rival that lacks what makes up for it predicts a difference all the same."""
    machine = with_sensors(AXIS, *channels).with_effects(EFFECTS["sensor_scale"].at("x_m", g=0.02))
    rival = EFFECTS["sensor_scale"].at("tape_m", g=-0.02)
    time_s = np.arange(400) * 2e-3
    inputs = np.where(time_s > 0.2, 1.0, 0.0)[:, None]
    data = prepare([Recording("run", time_s, inputs, simulate(machine, time_s, inputs).outputs)], machine)
    scales = [parameter for parameter in default_free_parameters(machine) if parameter.of_effect]
    fitted = fit(machine, scales, data, SIMULATION, iterations=1)
    design = design_discriminating_experiment(fitted, machine, "sensor_scale@x_m", (rival,), data)
    assert (design is not None) == designed
    assert design is None or design.separates == ("sensor_scale@x_m", "sensor_scale@tape_m")


def test_written_file_is_an_input_of_simulate(experiment: ExperimentDesign, tmp_path: Path) -> None:
    path, out = tmp_path / "next_experiment.csv", tmp_path / "predicted.csv"
    experiment.write(path, AXIS)
    reloaded = load_recording(path, AXIS, outputs_needed=False)
    np.testing.assert_allclose(reloaded.inputs, experiment.inputs, rtol=1e-8)
    result = CliRunner().invoke(
        app,
        ["simulate", "--machine", "axis", "--inputs", str(path), "--out", str(out)],
        catch_exceptions=False,
    )
    assert result.exit_code == 0
    assert len(load_recording(out, AXIS).time_s) == len(experiment.time_s)


def test_design_for_two_drives_stays_inside_the_workspace() -> None:
    """Excite the H-frame along every combination of its motors."""
    hframe = BUILTIN_MACHINES["hframe"]()
    first = hframe.with_effects(EFFECTS["stribeck_friction"].at("x", dF=0.5, vs=0.02))
    second = hframe.with_effects(EFFECTS["friction_slope"].at("x", s=3.0))
    data = prepare([Recording("run", np.arange(500) * 2e-3, np.zeros((500, 2)), np.zeros((500, 4)))], hframe)
    design = separate_machines(first, second, ("stribeck_friction@x", "friction_slope@x"), data)
    assert design is not None
    moved = simulate(first, design.time_s, design.inputs).positions
    for i, c in enumerate(hframe.coordinates[:2]):
        assert c.range is not None
        assert c.range[0] < moved[:, i].min()
        assert moved[:, i].max() < c.range[1]


def test_a_machine_that_may_be_unstable_raises_no_error() -> None:
    """Two combinations of parameters with the same, enormous influence make the normal equations singular."""
    random = np.random.default_rng(0)
    enormous, difference = 1e12 * random.normal(size=50), random.normal(size=50)
    remaining = after_adaptation(np.vstack([enormous, enormous]), difference)
    along = enormous / np.linalg.norm(enormous)
    np.testing.assert_allclose(remaining, difference - (along @ difference) * along, atol=1e-6)


@pytest.mark.parametrize(
    ("sigma", "promise"), [(40.0, "by 40 standard"), (2.35e8, "clearly (by more than 100 standard")]
)
def test_the_proposed_experiment_promises_no_more_than_is_known(sigma: float, promise: str) -> None:
    why = dataclasses.replace(PLAN, sigma=sigma).why
    assert f"their predictions should differ {promise} deviations of the sensors' noise" in why
    assert "e+" not in why
