"""Tests of fits whose residual has no useful derivative: thresholds that act at once, parts that collide."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, Fit, default_free_parameters, fit, prepare
from hframe_gym.identification.fit.covariance import with_uncertainty
from hframe_gym.identification.fit.estimation import prediction_cost
from hframe_gym.identification.judge.criteria import SelectionCriteria
from hframe_gym.identification.predict.prediction import SEARCH_BANDWIDTH
from hframe_gym.identification.propose.candidates import Candidate, effect_parameters
from hframe_gym.identification.propose.structures import screen_structures
from hframe_gym.identification.propose.trial_fits import _other_threshold, trial_fits
from hframe_gym.identification.propose.typical_scales import typical_scales
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect, Belt, Coordinate, Machine
from hframe_gym.recordings import Recording

NOISE = 20e-6  # m
THRESHOLD = 0.8  # V


def runs(truth: Machine, machine: Machine, volts: float) -> Dataset:
    """Return two runs of 2 s at 1 kHz, of random voltage steps and of a swept sine."""
    rng, time_s = np.random.default_rng(0), np.arange(2000) * 1e-3
    steps = np.repeat(rng.uniform(-volts, volts, 40), 50)
    sweep = volts * np.sin(2 * np.pi * (0.5 + 2.0 * time_s) * time_s)
    recordings = []
    for name, voltage in (("steps", steps), ("sweep", sweep)):
        inputs = np.where(time_s < 0.1, 0.0, voltage)[:, None]
        readings = simulate(truth, time_s, inputs).outputs
        noise = rng.normal(0.0, 1.0, readings.shape) * [s.noise for s in machine.sensors]
        recordings.append(Recording(name, time_s, inputs, readings + noise))
    return prepare(recordings, machine)


@pytest.fixture(scope="module")
def switching() -> tuple[Machine, Dataset]:
    """Return an axis, and runs of one whose amplifier is off below a voltage."""
    axis = BUILTIN_MACHINES["axis"]()
    return axis, runs(axis.with_effects(EFFECTS["dead_band"].at("motor", Vd=THRESHOLD, drop=0.0)), axis, 3.0)


def fit_threshold(axis: Machine, data: Dataset, start: float) -> Fit:
    """Fit the axis with the effect, from a threshold that is wrong."""
    machine = axis.with_effects(EFFECTS["dead_band"].at("motor", Vd=start, drop=0.0))
    fitted = fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH)
    added = effect_parameters(machine.effects[0], machine, typical_scales(fitted, data))
    return fit(machine, (*default_free_parameters(axis), *added), data, SEARCH_BANDWIDTH)


@pytest.mark.parametrize("start", [0.6, 0.7, 1.0, 1.3])
def test_a_fit_finds_a_threshold(switching: tuple[Machine, Dataset], start: float) -> None:
    fitted = fit_threshold(*switching, start)
    assert fitted.chi2 < 1.1
    assert fitted.values["dead_band@motor.Vd"] == pytest.approx(THRESHOLD, rel=0.01)


@pytest.mark.parametrize(
    ("there", "promising"), [(THRESHOLD, ""), (2.0 * THRESHOLD, "smaller"), (0.5 * THRESHOLD, "larger")]
)
def test_another_threshold_is_fitted_only_where_it_promises_less_error(
    switching: tuple[Machine, Dataset], there: float, promising: str
) -> None:
    fitted = fit_threshold(*switching, 0.7)
    names = [f.name for f in fitted.free]
    j = names.index("dead_band@motor.Vd")
    theta = fitted.theta.copy()
    theta[j] = fitted.free[j].theta(there)
    machine = fitted.machine.replace({names[j]: there})
    cost = prediction_cost(machine, switching[1], SEARCH_BANDWIDTH)
    moved = _other_threshold(
        dataclasses.replace(fitted, machine=machine, theta=theta, cost=cost), j, switching[1]
    )
    assert (moved is None) == (promising == "")
    if moved is not None:
        assert (moved[j] < theta[j]) == (promising == "smaller")
        assert np.delete(moved, j) == pytest.approx(np.delete(theta, j))


def test_a_fit_finds_a_limit_that_the_declared_machine_does_not_reach() -> None:
    axis = BUILTIN_MACHINES["axis"]()
    drive = axis.drives[0]
    reached = 3.0 / drive.resistance  # A, at standstill with 3 V
    limited = [
        axis.with_effects(EFFECTS["current_limit"].at("motor", I=ratio * reached)) for ratio in (0.6, 1.8)
    ]
    data = runs(limited[0], limited[1], 3.0)
    fitted = fit(limited[1], default_free_parameters(limited[1]), data, SEARCH_BANDWIDTH)
    assert fitted.values["current_limit@motor.I"] == pytest.approx(0.6 * reached, rel=0.01)
    assert fitted.chi2 < 1.1


def test_the_standard_deviation_of_a_threshold_is_the_distance_of_the_voltages(
    switching: tuple[Machine, Dataset],
) -> None:
    axis, data = switching
    fitted = fit_threshold(axis, data, 0.7)
    uncertainty = with_uncertainty(fitted, data).uncertainty
    assert uncertainty is not None
    std = uncertainty.std("dead_band@motor.Vd")
    voltages = np.unique(np.abs(np.concatenate([run.inputs[:, 0] for run in data.runs])))
    above = np.searchsorted(voltages, THRESHOLD)
    assert voltages[above] - voltages[above - 1] < 2.0 * std < 0.05
    assert abs(fitted.values["dead_band@motor.Vd"] - THRESHOLD) < 3.0 * std


def test_candidates_with_and_without_a_drop_are_both_fitted(switching: tuple[Machine, Dataset]) -> None:
    """Of one switch with two forms, the linearization may rank the wrong form first."""
    axis, data = switching
    current = fit(axis, default_free_parameters(axis), data, SEARCH_BANDWIDTH)
    trials = trial_fits(current, data, 0.1, SelectionCriteria())
    best = min(trials, key=lambda trial: trial.cost)
    assert best.machine.effects[0].label == "dead_band@motor"
    assert best.values["dead_band@motor.drop"] == pytest.approx(0.0, abs=0.02)


def test_candidates_that_differ_in_a_threshold_only() -> None:
    band = EFFECTS["dead_band"]
    first, second, third = (
        Candidate(band, "motor", ({"Vd": threshold, "drop": drop},), {})
        for threshold, drop in ((0.5, 0.0), (1.0, 0.0), (0.5, 1.0))
    )
    assert first.differs_in_thresholds(second)
    assert not first.differs_in_thresholds(third)


def screw(effects: tuple[AppliedEffect, ...] = ()) -> Machine:
    """Return a carriage with a stiff nut on a screw of 10 mm lead; its extension under load is about 5 um."""
    axis = BUILTIN_MACHINES["axis"]()
    lead = 0.01 / (2 * np.pi)  # m/rad
    carriage = Coordinate("x", mass=7.0, viscous=40.0, coulomb=18.0)
    rotor = Coordinate("screw", mass=3.5e-5, viscous=1e-4, coulomb=0.025, kind="rotary", radius=lead)
    drive = type(axis.drives[0])(
        "motor", "v_V", "screw", Kt=0.06, Ke=0.06, resistance=0.8, gear_ratio=1.0, rated_voltage=24.0
    )
    sensor = type(axis.sensors[0])
    return Machine(
        "screw",
        coordinates=(carriage, rotor),
        belts=(Belt("nut", EA=1e7, rest_length=1.0, extension={"x": 1.0, "screw": -1.0}),),
        drives=(drive,),
        sensors=(sensor("x_m", {"x": 1.0}, noise=1e-6), sensor("screw_rad", {"screw": 1.0}, noise=1e-4)),
        effects=effects,
    )


def test_play_of_several_times_the_extension_is_screened_and_fitted() -> None:
    play = 30e-6  # m
    declared = screw()
    data = runs(screw((EFFECTS["belt_play"].at("belts", d=play),)), declared, 6.0)
    current = fit(declared, default_free_parameters(declared), data, SEARCH_BANDWIDTH)
    scales = typical_scales(current, data)
    # Two backlashes of the motor's gear, which move the carriage in the same way, come first.
    screened = [machine.effects[-1] for machine in screen_structures(current, data, scales, 0.1)[:3]]
    best = next(effect for effect in screened if effect.label == "belt_play@belts")
    assert 0.3 * play < best.parameters["d"] < 3.0 * play
    machine = declared.with_effects(best)
    free = (*default_free_parameters(declared), *effect_parameters(best, machine, scales))
    fitted = fit(machine, free, data, SEARCH_BANDWIDTH, iterations=8)
    assert fitted.chi2 < 0.1 * current.chi2
    assert fitted.values["belt_play@belts.d"] == pytest.approx(play, rel=0.2)


def test_the_uncertainty_of_a_threshold_beside_play() -> None:
    """One has no derivative, the other one that holds over a wide difference only."""
    effects = (
        EFFECTS["dead_band"].at("motor", Vd=THRESHOLD, drop=0.0),
        EFFECTS["belt_play"].at("belts", d=30e-6),
    )
    machine = screw(effects)
    data, declared = runs(machine, screw(), 6.0), screw()
    scales = typical_scales(fit(declared, default_free_parameters(declared), data, SEARCH_BANDWIDTH), data)
    free = list(default_free_parameters(declared))
    for effect in effects:
        free += effect_parameters(effect, machine, scales)
    uncertainty = with_uncertainty(fit(machine, free, data, SEARCH_BANDWIDTH, iterations=2), data).uncertainty
    assert uncertainty is not None
    stds = [uncertainty.std(name) for name in ("dead_band@motor.Vd", "belt_play@belts.d", "x.mass")]
    assert all(std is not None and 0.0 < std < np.inf for std in stds)
