"""Tests of the significance of an effect: its force, the unexplained force, and the doubts about it."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, Fit, prepare
from hframe_gym.identification.evidence import significance
from hframe_gym.identification.evidence.significance import (
    TestedFit,
    curves_of_one_variable,
    depend_on_same_variable,
    doubt_about_candidate,
    doubt_beside_others,
    sizes,
    variance_along,
)
from hframe_gym.identification.fit import force_sizes
from hframe_gym.identification.fit.force_sizes import force_size
from hframe_gym.identification.fit.model_error import search_step
from hframe_gym.identification.predict.linearization import RunLinearization
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH, predict, prediction_error
from hframe_gym.machine import AppliedEffect, Uncertainty
from hframe_gym.recordings import Recording
from tests.identification.scripted_fits import (
    AXIS,
    COUNT,
    CRITERIA,
    DATA,
    DRAG,
    FRAME,
    HFRAME,
    PUSH,
    SPRING,
    STRIBECK,
    Scripted,
    fit_with,
)
from tests.identification.single_axis import axis_runs

CLOCK = EFFECTS["clock_drift"].at("machine", a=-5e-4)


@pytest.fixture
def axis_data() -> Dataset:
    """Return runs of the built-in axis."""
    return axis_runs(AXIS, rows=1500, volts=3.0)


def test_the_size_of_a_force_is_its_root_mean_square() -> None:
    assert force_size(np.array([[3.0, 4.0], [0.0, 0.0]])) == pytest.approx(np.sqrt(12.5))


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        (STRIBECK, DRAG, True),
        (STRIBECK, SPRING, False),
        (FRAME, SPRING, False),  # the frame's own position and speed
        (FRAME, STRIBECK, False),
        (STRIBECK, EFFECTS["quadratic_drag"].at("y", c=4.0), False),
        (
            EFFECTS["cogging"].at("motor1", A=0.03, n=23.6, p=0.5),
            EFFECTS["cable_spring"].at("phi1", k=6.0, q0=0.0),
            False,
        ),
        (EFFECTS["friction_slope"].at("x", s=1.0), SPRING, True),
        (
            EFFECTS["friction_slope"].at("phi1", s=0.1),
            EFFECTS["cable_spring"].at("phi1", k=6.0, q0=0.0),
            True,
        ),
        (
            CLOCK,
            EFFECTS["winding_heat"].at("motor1", a=0.03, tau=10.0),
            True,
        ),  # memories that drift, of all parts
        (CLOCK, EFFECTS["winding_heat"].at("motor1", a=0.03, tau=0.1), False),
        (CLOCK, EFFECTS["friction_warm_up"].at("x", a=0.3, tau=30.0), True),
        (CLOCK, EFFECTS["electrical_lag"].at("motor1", tau=1e-3), False),
        (CLOCK, STRIBECK, False),
    ],
)
def test_which_effects_depend_on_the_same_variable(
    first: AppliedEffect, second: AppliedEffect, same: bool
) -> None:
    """Periodic ones only on that of other periodic ones."""
    assert depend_on_same_variable(first, second, HFRAME) == same
    assert depend_on_same_variable(second, first, HFRAME) == same


@pytest.mark.parametrize(
    ("residue", "heat_force", "reason"),
    [
        (0.3, 20.0, "adds 2 % to the force of winding_heat@motor, which depends on the same variable"),
        (0.3, 1.0, ""),
        (0.4, 1.0, "explains a force of 0.3 N, where 0.4 N remain unexplained"),
    ],
)
def test_a_clock_has_the_size_of_the_force_that_it_explains(
    scripted: Scripted, residue: float, heat_force: float, reason: str
) -> None:
    """A winding that warms up otherwise than by the formula leaves what a drifting clock partly explains."""
    heat = EFFECTS["winding_heat"].at("motor", a=0.03, tau=10.0)
    scripted.residue, scripted.force = {1.3: 0.5, 1.1: residue}, {heat.label: heat_force}
    both = fit_with(heat, CLOCK, chi2=1.1)
    doubt = doubt_about_candidate(fit_with(heat, chi2=1.3), both, DATA, CRITERIA)
    assert doubt.startswith(reason) if reason else doubt == ""


def test_no_effect_corrects_a_clock(scripted: Scripted) -> None:
    """It has no force, of which another effect could be a small part."""
    heat = EFFECTS["winding_heat"].at("motor", a=0.03, tau=10.0)
    scripted.force = {CLOCK.label: np.inf}
    both = fit_with(heat, CLOCK, chi2=1.1)
    assert doubt_beside_others(fit_with(CLOCK, chi2=1.3), TestedFit(both, DATA), heat, CRITERIA) == ""


def test_curves_of_one_variable_are_functions_of_it_alone_at_one_coordinate() -> None:
    """A motor turns with its coordinate; what remembers, or depends on a voltage, is no curve that a table has."""
    cogging = EFFECTS["cogging"].at("motor1", A=0.03, n=23.6, p=0.5)
    spring = EFFECTS["cable_spring"].at("phi1", k=6.0, q0=0.0)
    others = [
        SPRING,
        STRIBECK,
        EFFECTS["dahl_hysteresis"].at("phi1", F=0.1, L=0.02),
        EFFECTS["dead_band"].at("drives", Vd=0.1, drop=0.0),
        EFFECTS["gain_mismatch"].at("motor1", g=0.1),
    ]
    assert curves_of_one_variable([spring, *others, cogging], HFRAME) == [spring, cogging]
    assert curves_of_one_variable([spring, *others], HFRAME) == []


def test_the_difference_of_forces_is_that_at_the_belt() -> None:
    """Torques are divided by the radius of the pulley."""
    inputs = np.zeros((100, 2))
    inputs[50:] = 2.0
    time_s = np.arange(100) * 1e-3
    data = prepare([Recording("run", time_s, inputs, HFRAME.simulate(time_s, inputs).outputs)], HFRAME)
    force = EFFECTS["constant_force"]
    other = HFRAME.with_effects(
        force.at("x", size=3.0), force.at("y", size=-4.0), force.at("phi2", size=12.0 * 0.0194)
    )
    assert force_sizes.force_difference(HFRAME, other, data) == pytest.approx(13.0)


def test_forces_are_compared_along_the_motion_of_the_first_machine(axis_data: Dataset) -> None:
    x = AXIS.coordinates[0]
    damped = AXIS.replace(coordinates=(dataclasses.replace(x, viscous=x.viscous + 2.0),))
    for first, second in ((AXIS, damped), (damped, AXIS)):
        speeds = [
            predict(first, run, SEARCH_BANDWIDTH, period=axis_data.period, states=True).velocities[0]
            for run in axis_data.runs
        ]
        expected = 2.0 * force_size(np.concatenate(speeds))
        assert force_sizes.force_difference(first, second, axis_data) == pytest.approx(expected)


def test_the_force_of_the_drives_is_at_the_belt() -> None:
    inputs = np.array([[3.0, -4.0], [0.0, 0.0]])
    data: Any = SimpleNamespace(runs=[SimpleNamespace(inputs=inputs)])
    drive = HFRAME.drives[0]
    assert force_sizes.drive_force(HFRAME, data) == pytest.approx(np.sqrt(12.5) * drive.gain / 0.0194)


@pytest.mark.parametrize("effect", [FRAME, EFFECTS["sensor_scale"].at("x_m", g=1.01)])
def test_no_force_describes_structures_and_measurements(effect: AppliedEffect) -> None:
    assert force_sizes.effect_force(AXIS, effect, DATA) == np.inf


def test_the_size_of_an_effect_is_its_force(axis_data: Dataset) -> None:
    data = axis_data
    assert force_sizes.effect_force(
        AXIS, EFFECTS["constant_force"].at("x", size=-0.3), data
    ) == pytest.approx(0.3)
    assert force_sizes.effect_force(AXIS, EFFECTS["sensor_scale"].at("x_m", g=1.01), data) == np.inf
    (drive,) = AXIS.drives
    rms = np.sqrt(np.mean(np.concatenate([run.inputs for run in data.runs]) ** 2))
    expected = rms * drive.gain / AXIS.coordinates[0].travel_per_unit
    assert force_sizes.drive_force(AXIS, data) == pytest.approx(expected)


@pytest.mark.parametrize("bandwidth", [0.0, 30.0])
def test_the_residue_is_the_correction_beyond_that_of_noise(axis_data: Dataset, bandwidth: float) -> None:
    """The observer corrects the velocity by bandwidth^2 times the innovation; without one, by that of 3 rad/s."""
    [run] = axis_data.with_runs(["run_0"]).runs
    run.outputs[700:800] = np.nan  # a missing measurement has neither error nor noise
    pushed = fit_with(PUSH, chi2=1.0, bandwidth=bandwidth)
    data = dataclasses.replace(axis_data, runs=(run,))
    used = max(bandwidth, 3.0)
    motion = predict(pushed.machine, run, used, period=data.period, longest_step=search_step(used))
    innovation = prediction_error(run, data, motion.readings)[0]  # without the error of the sensor's zero
    measured = np.isfinite(run.outputs)
    power = np.sum((innovation**2 - run.noise**2)[measured]) / len(innovation)
    expected = used**2 * AXIS.coordinates[0].mass * np.sqrt(power)
    assert force_sizes.residue_force(pushed, data) == pytest.approx(expected, rel=1e-4)
    noisy = dataclasses.replace(run, noise=1e3 * run.noise)
    assert force_sizes.residue_force(pushed, dataclasses.replace(data, runs=(noisy,))) == 0.0


def correlated(seed: int, rows: int) -> RunLinearization:
    """Return a residual of 4 s at 1 kHz that is constant over sequences of rows, and the influence of two parameters.

    The first parameter, of the machine, has the influence of a sine; the second one, of the effect, is constant.
    """
    residual = np.repeat(np.random.default_rng(seed).normal(size=4000 // rows), rows)
    sine = np.sin(np.arange(4000) * 2e-3 * np.pi)
    return RunLinearization(np.array([sine, np.ones(4000)]), None, residual, None)


OF_EFFECT, PRECISION = np.array([False, True]), np.diag([1.0 / 0.3**2, 1e-12])


@pytest.mark.parametrize("rows", [1, 20, 200, 4000])
def test_a_residual_that_is_constant_over_some_rows_has_that_many_times_the_variance(rows: int) -> None:
    """800 blocks of 0.5 s; the largest of three estimates, the last one of 100 runs."""
    runs = [correlated(seed, rows) for seed in range(100)]
    assert variance_along(runs, OF_EFFECT, PRECISION, 50, 500).ratio == pytest.approx(rows, rel=0.35)


def test_the_parameters_of_the_effect_and_the_long_blocks_are_counted() -> None:
    found = variance_along([correlated(0, 200)] * 3, OF_EFFECT, PRECISION, 50, 500)
    assert (found.parameters, found.blocks) == (1, 24)


def test_a_machine_that_diverges_reaches_any_gain_by_chance() -> None:
    run = correlated(0, 200)
    run.residual[-1] = np.inf
    assert variance_along([run], OF_EFFECT, PRECISION, 50, 500).ratio == np.inf


def test_the_size_of_an_effect_is_as_certain_as_its_form_permits() -> None:
    """Runs that are slower than the speed scale tell the product of both only; the product may still be certain."""
    friction = EFFECTS["stribeck_friction"].at("x", dF=2.0, vs=0.03)
    names = ("x.mass", "stribeck_friction@x.vs", "stribeck_friction@x.dF")
    correlation = np.array([[1.0, 0.0, 0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 1.0]])
    correlation[1, 2] = correlation[2, 1] = 0.79
    stds = np.array([0.1, 0.05, 5.0])
    machine = HFRAME.with_effects(friction).replace(
        uncertainty=Uncertainty(names, correlation * np.outer(stds, stds))
    )
    (size,) = sizes(friction, machine)
    assert (size.name, size.unit, size.value) == ("dF", "N", 2.0)
    assert size.std == pytest.approx(5.0 * np.sqrt(1.0 - 0.79**2))
    assert sizes(friction, machine.replace(uncertainty=None)) == ()
    assert sizes(EFFECTS["current_limit"].at("motor1", I=1.0), machine) == ()


@pytest.mark.parametrize(("std_of_speed", "std_of_size", "expected"), [(0.0, 5.0, 5.0), (0.05, 0.0, 0.0)])
def test_parameters_without_a_variance_were_held(
    std_of_speed: float, std_of_size: float, expected: float
) -> None:
    friction = EFFECTS["stribeck_friction"].at("x", dF=2.0, vs=0.03)
    names = ("stribeck_friction@x.vs", "stribeck_friction@x.dF")
    uncertainty = Uncertainty(names, np.diag([std_of_speed**2, std_of_size**2]))
    (size,) = sizes(friction, HFRAME.with_effects(friction).replace(uncertainty=uncertainty))
    assert size.std == expected


def test_an_effect_in_proportion_to_an_uncertain_coefficient_may_be_certain() -> None:
    """Viscous friction and back-EMF act alike; how much friction differs between the directions is known anyway."""
    drag = EFFECTS["asymmetric_viscous"].at("phi1", a=0.3)
    names = ("phi1.viscous", "asymmetric_viscous@phi1.a")
    covariance = np.array([[1.0, -0.99], [-0.99, 1.0]]) * np.outer([1e-5, 0.4], [1e-5, 0.4])
    (size,) = sizes(drag, HFRAME.with_effects(drag).replace(uncertainty=Uncertainty(names, covariance)))
    assert size.std == pytest.approx(0.4 * np.sqrt(1.0 - 0.99**2))


def test_what_an_effect_remembers_is_no_missing_force() -> None:
    """A winding that is hot when a run begins reduces all forces of the run; a fit takes this into account too."""
    heated = AXIS.with_effects(EFFECTS["winding_heat"].at("motor", a=0.01, tau=20.0))
    generator = np.random.default_rng(5)
    time_s = np.arange(1500) * 1e-3
    inputs = np.repeat(generator.uniform(-3.0, 3.0, (15, 1)), 100, axis=0)
    inputs[:50] = 0.0
    noise = generator.normal(0.0, 2e-5, (1500, 1))
    cold, hot = (
        prepare(
            [Recording("run", time_s, inputs, simulate(heated, time_s, inputs, start).outputs + noise)], AXIS
        )
        for start in ([0.0, 0.0, 0.0], [0.0, 0.0, 40.0])  # heat, A^2
    )
    fitted = fit_with(*heated.effects, chi2=1.0, bandwidth=60.0)
    without = fit_with(chi2=1.0, bandwidth=60.0)
    lost = force_sizes.residue_force(without, hot)
    assert force_sizes.residue_force(fitted, cold) < 0.1 * lost
    assert force_sizes.residue_force(fitted, hot) < 0.1 * lost


def test_the_tests_of_all_effects_of_a_machine_share_its_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Voltages that change twice a row may change once more, on straight lines or on splines."""
    costs = iter([105.0, 90.0, 103.0])
    refits: list[object] = []

    def refit(fitted: Fit, data: Any, bandwidth: float) -> Fit:
        refits.append(data)
        return fit_with(chi2=next(costs) / COUNT)

    monkeypatch.setattr(significance, "continue_fit", refit)
    data: Any = SimpleNamespace(
        updates=2, with_updates=lambda n: n, with_interpolation=lambda between: between
    )
    tested = TestedFit(fit_with(chi2=100.0 / COUNT), data)
    assert [tested.interpolation_change, tested.interpolation_change] == pytest.approx([10.0, 10.0])
    assert refits == [3, "straight", "spline"]
