"""Runs that differ in one parameter, recorded on a simulator that shares no code with the identification."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, SelectionCriteria, identify, prepare
from hframe_gym.identification.fit.estimation import Fit, fit
from hframe_gym.identification.fit.run_differences import (
    Quantity,
    RunDifferences,
    describe_run_differences,
    find_run_differences,
)
from hframe_gym.identification.predict.free_parameters import default_free_parameters
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.machine import BUILTIN_MACHINES, Machine
from hframe_gym.recordings import Recording
from tests.euler_simulator.stage import EulerStage
from tests.reference_simulator.rig import Rig
from tests.reference_simulator.sensors import ENCODER_STEP_RAD, LASER_NOISE_M
from tests.rigs.euler_rig import euler_parameters
from tests.rigs.random_excitation import play

pytestmark = pytest.mark.integration  # complete fits and an identification; seconds each
HFRAME, AXIS = BUILTIN_MACHINES["hframe"](), BUILTIN_MACHINES["axis"]()
KINDS = ("steps", "moves", "triangle", "telegraph", "steps")


def scaled(values: tuple[float, ...], factor: float) -> tuple[float, ...]:
    """Return values times a factor."""
    return tuple(factor * value for value in values)


def with_payload(rig: Rig, kg: float) -> Rig:
    """Return a rig with a payload on the tool."""
    x, y, phi1, phi2 = rig.mass
    return dataclasses.replace(rig, mass=(x + kg, y + kg, phi1, phi2))


def with_supply(rig: Rig, factor: float) -> Rig:
    """Return a rig with another supply voltage."""
    return dataclasses.replace(rig, drive_gain=scaled(rig.drive_gain, factor))


def with_friction(rig: Rig, factor: float) -> Rig:
    """Return a rig with other dry friction."""
    return dataclasses.replace(rig, coulomb=scaled(rig.coulomb, factor))


def with_cogging(rig: Rig, _: float) -> Rig:
    """Return a rig with cogging of motor 1, the same in all runs."""
    return dataclasses.replace(rig, wave_force=(0.0, 0.0, 0.05, 0.0))


def record(change: Callable[[Rig, float], Rig], amounts: list[float]) -> list[Recording]:
    """Record a run of 1.6 s at 500 Hz for each amount by which a rig is changed."""
    rng, recordings = np.random.default_rng(4), []
    for i, amount in enumerate(amounts):
        parameters = euler_parameters(change(Rig(), amount))
        run = play(
            lambda start_s, parameters=parameters: EulerStage(parameters, (0.0, 0.0), (0.0, 0.0), start_s),
            KINDS[i % len(KINDS)],
            "center",
            10.0 * i + np.arange(800) / 500.0,
            rng,
        )
        outputs = run.positions[:, [2, 3, 0, 1]].copy()
        outputs[:, :2] = np.round(outputs[:, :2] / ENCODER_STEP_RAD) * ENCODER_STEP_RAD
        outputs[:, 2:] += rng.normal(0.0, LASER_NOISE_M, (len(outputs), 2))
        recordings.append(Recording(f"run_{i}", run.time_s, run.inputs, outputs))
    return recordings


def refitted(recordings: list[Recording]) -> tuple[Fit, Dataset]:
    """Return the declared machine, refitted to all runs, and the runs."""
    data = prepare(recordings, HFRAME)
    return fit(HFRAME, default_free_parameters(HFRAME), data, SEARCH_BANDWIDTH), data


def differences(recordings: list[Recording]) -> RunDifferences | None:
    """Return what differs between runs."""
    return find_run_differences(*refitted(recordings), SelectionCriteria())


@pytest.mark.parametrize(
    ("change", "amounts", "name", "values"),
    [
        (with_payload, [0.0, 0.3, 0.0, 0.6], "the payload", ["+0 kg", "+0.3 kg", "+0 kg", "+0.6 kg"]),
        (with_supply, [1.0, 0.9, 1.0, 0.95], "the voltage of all drives", ["1.11", "1", "1.11", "1.06"]),
        (with_friction, [1.0, 1.3, 0.8, 1.0], "the dry friction", ["1.25", "1.62", "1", "1.25"]),
    ],
)
def test_a_quantity_that_differs_between_runs_is_named_with_its_values(change, amounts, name, values):
    found = differences(record(change, amounts))
    assert found is not None
    assert found.quantity.name == name
    assert found.chi2 < 2.0 < 10.0 < found.chi2_before
    relative = np.array(list(found.amounts.values()))
    quantities = np.array(amounts) if found.quantity.additions else np.log(amounts)
    np.testing.assert_allclose(relative, quantities - quantities.min(), atol=0.02)
    assert all(f"run_{i} " in str(found) for i in range(len(amounts)))
    assert values[1] in str(found)


@pytest.mark.parametrize(
    ("amounts", "drifts"),
    [([0.3, 0.2, 0.1, 0.0], True), ([0.0, 0.2, 0.2, 0.4], True), ([0.0, 0.3, 0.1, 0.2], False)],
)
def test_amounts_that_only_rise_or_fall_drift(amounts, drifts):
    by_run = {f"run_{i}": amount for i, amount in enumerate(amounts)}
    assert RunDifferences(Quantity("x.coulomb", {"x.coulomb": 1.0}), by_run, 10.0, 1.0).drifts == drifts


@pytest.mark.parametrize(
    ("amounts", "different"),
    [([0.2, 0.2, 0.0, 0.2], "run_2"), ([0.0, 0.0, 0.3, 0.0], "run_2"), ([0.0, 0.1, 0.3, 0.0], None)],
)
def test_a_single_run_that_differs_is_named(amounts, different):
    by_run = {f"run_{i}": amount for i, amount in enumerate(amounts)}
    found = RunDifferences(Quantity("the voltage of motor1", {"motor1.Kt": 1.0}), by_run, 10.0, 1.0)
    assert found.different_run == different
    if different:
        assert f"{np.exp(amounts[2] - amounts[0]):.3g} times that of the others" in str(found)


@pytest.mark.parametrize(
    ("amounts", "shared", "differs"),
    [([0.0, 0.0, 0.0], 0.9, False), ([0.01, 0.0, 0.02], -1.1, False), ([0.0, 0.2, 0.1], 0.0, True)],
)
def test_equal_amounts_are_a_common_factor_and_no_difference(amounts, shared, differs):
    by_run = {f"run_{i}": amount for i, amount in enumerate(amounts)}
    quantity = Quantity("the conductance of motor1", {"motor1.Kt": 1.0})
    found = RunDifferences(quantity, by_run, 10.0, 1.0, shared)
    assert found.differs == differs
    assert ("The runs differ" in str(found)) == differs
    if not differs:
        factor = f"{np.exp(shared + np.mean(amounts)):.3g} times the fitted value"
        assert f"the same in every run: {factor}" in str(found)
        assert "no difference between runs but a common factor, such as a wrong unit" in str(found)


def test_a_unit_that_all_runs_share_is_described_as_a_common_factor():
    """Positions in a unit 4 times too large: no free parameter may change that much, and all runs agree."""
    motor = BUILTIN_MACHINES["axis"]()
    rng, runs = np.random.default_rng(2), []
    for k in range(4):
        time = np.arange(1500) * 1e-3
        volts = np.repeat(rng.uniform(-6.0, 6.0, 15), 100)[:, None] * (time > 0.1)[:, None]
        runs.append(Recording(f"run_{k}", 5.0 * k + time, volts, motor.simulate(time, volts).outputs / 4.0))
    data = prepare(runs, motor)
    fitted = fit(motor, default_free_parameters(motor), data, SEARCH_BANDWIDTH)
    assert find_run_differences(fitted, data, SelectionCriteria()) is None
    described = describe_run_differences(fitted, data, SelectionCriteria())
    assert not any("The runs differ" in line for line in described.sentences)
    assert described.explain


def test_an_effect_that_all_runs_have_is_no_difference():
    assert differences(record(with_cogging, [0.0] * 4)) is None


def test_runs_without_a_difference_need_none():
    assert differences(record(with_payload, [0.2] * 3)) is None


def test_two_runs_are_not_compared():
    assert differences(record(with_payload, [0.0, 0.5])) is None


def of_different_gain(motor: Machine, different: int) -> list[Recording]:
    """Return three runs of an axis, one of which has 0.73 times the gain."""
    runs = []
    for k in range(3):
        rng, time = np.random.default_rng(k), np.arange(1500) * 1e-3
        volts = (
            3.0 * np.sin((5 + k) * time) + 2.0 * np.sin(17.0 * time + k) + 1.5 * np.sign(np.sin(2.0 * time))
        )
        volts = (volts * (time > 0.1))[:, None]
        outputs = motor.simulate(time, volts * (0.73 if k == different else 1.0)).outputs
        runs.append(
            Recording(f"run_{k}", 20.0 * k + time, volts, outputs + rng.normal(0.0, 20e-6, (1500, 1)))
        )
    return runs


@pytest.mark.parametrize("different", [1, 2])
def test_of_three_runs_the_one_with_another_gain_is_left_out_and_its_gain_is_told(different):
    """Run 2 is the held-out one; two runs that agree say which of the three is different."""
    result = identify(of_different_gain(AXIS, different), AXIS)
    assert result.verdict == "no_effect"
    assert result.left < 1.2
    assert any(
        f"run_{different} differs from the other runs in the voltage of motor: 0.73" in warning
        for warning in result.run_warnings
    )


@pytest.mark.parametrize(("gain", "told"), [(1, 1), (9, 0)])
def test_a_run_that_differs_is_told_although_an_effect_is_missing_too(gain, told):
    """A difference explains nearly all of the error, though not all; without one, nothing is told."""
    cogged = AXIS.with_effects(EFFECTS["cogging"].at("motor", A=0.2, n=40.0, p=0.0))
    data = prepare(of_different_gain(cogged, gain), AXIS)
    fitted = fit(AXIS, default_free_parameters(AXIS), data, SEARCH_BANDWIDTH)
    assert find_run_differences(fitted, data, SelectionCriteria()) is None
    lines, explain = describe_run_differences(fitted, data, SelectionCriteria())
    assert len(lines) == told
    assert not explain
    assert all("the voltage of motor: 0.7" in line and "though not only noise" in line for line in lines)


@pytest.mark.slow
def test_identify_names_the_payload_and_no_effect():
    lines: list[str] = []
    result = identify(record(with_payload, [0.0, 0.3, 0.0, 0.6, 0.3]), HFRAME, log=lines.append)
    assert result.verdict == "unexplained"
    assert not result.effects
    assert result.hint is None
    assert any(
        "if the payload has a value of its own in each run" in warning for warning in result.run_warnings
    )
