"""Tests of what runs cannot distinguish: rivals over the recorded motion, and parameters beyond it."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import Dataset, SelectionCriteria, fit, prepare
from hframe_gym.identification.evidence.effect_parameters import parameter_values
from hframe_gym.identification.judge.chance import LongRunVariance
from hframe_gym.identification.judge.effect import parameter_at_limit
from hframe_gym.identification.judge.rival import largest_resembling_loss
from hframe_gym.identification.predict.free_parameters import default_free_parameters
from hframe_gym.identification.propose.candidates import (
    Candidate,
    SearchState,
    candidates,
    coverage,
    effect_parameters,
)
from hframe_gym.identification.propose.screening import Screening
from hframe_gym.identification.propose.trial_fits import indistinguishable, screened_fit
from hframe_gym.identification.propose.typical_scales import typical_scales
from hframe_gym.machine import Machine
from hframe_gym.recordings import Recording
from tests.identification.single_axis import AXIS

RIG = AXIS.with_effects(EFFECTS["stribeck_friction"].at("x", dF=0.3, vs=0.1))


def sines(frequencies: list[list[float]]) -> Dataset:
    """Return runs of the rig in which the voltage is a sum of sines, Hz, of 3 V in total."""
    rng, runs = np.random.default_rng(1), []
    for k, of_run in enumerate(frequencies):
        time_s = np.arange(3000) * 1e-3
        wave = sum(np.sin(2 * np.pi * f * (time_s - 0.1)) for f in of_run) / len(of_run)
        inputs = np.where(time_s > 0.1, 3.0 * wave, 0.0)[:, None]
        outputs = simulate(RIG, time_s, inputs).outputs + rng.normal(0.0, 2e-5, (3000, 1))
        runs.append(Recording(f"run_{k}", time_s, inputs, outputs))
    return prepare(runs, AXIS)


def test_one_sine_cannot_tell_friction_over_speed_from_other_friction() -> None:
    """In a single sine, position and speed are one variable; several sines separate them."""

    def rivals(data: Dataset) -> list[str]:
        free = [*default_free_parameters(RIG, effects=False)]
        fitted = fit(RIG, free, data, 60.0)
        free += effect_parameters(RIG.effects[0], RIG, typical_scales(fitted, data))
        complete = fit(RIG, tuple(free), data, 60.0)
        loss = largest_resembling_loss(LongRunVariance(1.0), SelectionCriteria())
        screened = screened_fit(complete, data)
        return [effect.name for effect in indistinguishable(screened, RIG.effects[0].label, loss)]

    single, several = rivals(sines([[1.0]] * 2)), rivals(sines([[1.0], [0.4, 2.3], [0.7, 5.0], [0.3]]))
    assert "tustin_friction" in single
    assert several == []


@pytest.mark.parametrize("part", [1.0, 1e-9])
def test_a_small_effect_is_compared_as_accurately_as_one_of_typical_size(part: float) -> None:
    """Derivatives change the motion by a part of the typical size; a tiny effect's would be rounding."""
    data = sines([[1.0]])
    fitted = fit(AXIS, default_free_parameters(AXIS), data, 60.0)
    typical = SearchState.of(fitted, data).candidate(EFFECTS["sensor_delay"], "x_m", {})
    delay = typical.columns[0]["d"]
    own = Candidate(typical.effect, "x_m", ({"d": part * delay},), typical.scales)
    (same,) = Screening.of(fitted, [typical], data, compared=[own]).resembling(own.label)
    assert same.effect.parameters["d"] == pytest.approx(part * delay, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "parameter", "low", "high"),
    [
        ("position_friction", "L", -np.inf, 0.2),  # a period of at most the travel
        ("stribeck_friction", "vs", -np.inf, 0.5),  # a speed that the runs reach
        ("tustin_friction", "vs", -np.inf, 0.5),
        ("friction_warm_up", "tau", -np.inf, 40.0),  # a time that the session lasts
        ("cogging", "n", 2 * np.pi / 0.2, np.inf),
        ("electrical_lag", "tau", -np.inf, np.inf),
        ("quadratic_drag", "c", -np.inf, np.inf),
    ],
)
def test_runs_show_shapes_only_within_their_motion(
    name: str, parameter: str, low: float, high: float
) -> None:
    scales = {"position": 0.2, "speed": 0.5, "session": 40.0}
    assert coverage(EFFECTS[name].parameter(parameter), scales) == pytest.approx((low, high))


def rows_of(data: Dataset) -> int:
    """Return the number of rows of all runs."""
    return sum(len(run.time_s) for run in data.runs)


def test_a_period_longer_than_the_travel_is_no_candidate() -> None:
    data = sines([[1.0], [0.4]])
    fitted = fit(AXIS, default_free_parameters(AXIS), data, 60.0)
    scales = typical_scales(fitted, data)
    travel = scales.of("x")["position"]
    position = travel * np.sin(np.linspace(0.0, 6.0, rows_of(data))) / 2.0
    missing = {"x": np.column_stack([position, np.gradient(position), np.cos(4.0 * position / travel)])}
    periods = [
        candidate.columns[0]["L"]
        for candidate in candidates(SearchState(AXIS, data, scales, missing, slow=True))
        if candidate.effect.name == "position_friction"
    ]
    assert periods
    assert max(periods) <= 1.01 * travel


@pytest.mark.parametrize(("part", "doubted"), [(0.995, True), (0.9, False)])
def test_a_shape_at_the_limit_of_what_the_runs_cover_is_doubted(part: float, doubted: bool) -> None:
    data = sines([[1.0], [0.4]])
    fitted = fit(AXIS, default_free_parameters(AXIS), data, 60.0)
    scales = typical_scales(fitted, data)
    effect = EFFECTS["stribeck_friction"].at("x", dF=1.0, vs=part * scales.of("x")["speed"])
    machine: Machine = AXIS.with_effects(effect)
    complete = fit(machine, effect_parameters(effect, machine, scales), data, 60.0, iterations=0)
    reason = parameter_at_limit(parameter_values(effect.label, complete))
    assert ("at the limit of what the runs cover" in reason) == doubted


@pytest.mark.parametrize(("name", "site"), [("friction_warm_up", "machine"), ("winding_heat", "motor")])
def test_a_change_slower_than_the_session_keeps_its_name(name: str, site: str) -> None:
    """A long time constant is no simpler effect: it starts within the session, and a fit may pass its end."""
    data = sines([[1.0], [0.4]])
    fitted = fit(AXIS, default_free_parameters(AXIS), data, 60.0)
    scales = typical_scales(fitted, data)
    session = scales.general["session"]
    effect = EFFECTS[name].at(site, a=0.1, tau=session)
    machine: Machine = AXIS.with_effects(effect)
    free = effect_parameters(effect, machine, scales)
    assert free[1].upper == effect.definition.parameter("tau").upper > session
    complete = fit(machine, free, data, 60.0, iterations=0)
    assert parameter_at_limit(parameter_values(effect.label, complete)) == ""
    missing = {"x": np.zeros((rows_of(data), 3))}
    starts = [
        c.columns[0]["tau"]
        for c in candidates(SearchState(AXIS, data, scales, missing, slow=True))
        if c.effect.name == name
    ]
    assert starts
    assert max(starts) <= 1.01 * session


@pytest.mark.parametrize(
    ("name", "site", "parameter"), [("cable_spring", "x", "q0"), ("voltage_offset", "motor", "V0")]
)
def test_what_the_runs_do_not_limit_may_be_negative(name: str, site: str, parameter: str) -> None:
    data = sines([[1.0], [0.4]])
    scales = typical_scales(fit(AXIS, default_free_parameters(AXIS), data, 60.0, iterations=1), data)
    definition = EFFECTS[name]
    effect = definition.at(site, **{p.name: 0.0 for p in definition.parameters})
    free = {f.name: f for f in effect_parameters(effect, AXIS.with_effects(effect), scales)}
    assert free[f"{effect.label}.{parameter}"].lower < 0.0
    missing = {"x": np.zeros((rows_of(data), 3))}
    proposed = [
        c for c in candidates(SearchState(AXIS, data, scales, missing)) if c.effect.name == "cable_spring"
    ]
    assert len(proposed) == 3  # the spring is relaxed at the middle or at one of two ends
