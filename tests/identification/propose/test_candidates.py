"""Tests of the candidates: periods of the missing force, ends of ranges, effects at their sites."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS, register_effect, unregister_effect
from hframe_gym.identification.evidence.effect_parameters import parameter_values
from hframe_gym.identification.judge.criteria import SelectionCriteria
from hframe_gym.identification.judge.effect import parameter_at_limit
from hframe_gym.identification.propose.candidates import Candidate, SearchState, candidates, effect_parameters
from hframe_gym.identification.propose.periodogram import periodogram_peaks, slow_rates
from hframe_gym.identification.propose.typical_scales import LONGEST_RUN, TypicalScales
from hframe_gym.identification.search.tables import table_candidates
from hframe_gym.machine import Machine
from tests.identification.scripted_fits import fit_with
from tests.identification.single_axis import AXIS, axis_runs


def motion(rate: float, kind: str = "force") -> tuple[np.ndarray, np.ndarray | None]:
    """Return position, velocity and force of a sine of position, beside viscous and dry friction."""
    time_s = np.arange(6000) * 1e-3
    position = 0.2 * np.sin(2 * np.pi * 0.37 * time_s) + 0.05 * np.sin(2 * np.pi * 1.7 * time_s)
    velocity = np.gradient(position, time_s)
    current = np.sin(2 * np.pi * 2.9 * time_s) + np.cos(2 * np.pi * 0.6 * time_s)
    factor = {"force": None, "friction": np.sign(velocity), "torque": current}[kind]
    wave = 0.3 * np.sin(rate * position + 0.4) * (1.0 if factor is None else factor)
    noise = np.random.default_rng(0).normal(0.0, 0.2, len(time_s))
    force = wave + 2.0 * velocity + 1.5 * np.sign(velocity) + noise
    return np.column_stack([position, velocity, force]), factor


@pytest.mark.parametrize("kind", ["force", "friction", "torque"])
@pytest.mark.parametrize("rate", [100.0, 583.0])
def test_the_rate_of_a_sine_is_the_first_peak(rate: float, kind: str) -> None:
    data, factor = motion(rate, kind)
    resolution = 2 * np.pi / np.ptp(data[:, 0])
    peaks = periodogram_peaks(data, 1e-3, factor=factor)
    assert abs(peaks[0] - rate) < 0.5 * resolution


def test_a_coordinate_that_rests_has_no_periods() -> None:
    assert len(periodogram_peaks(np.zeros((100, 3)), 1e-3)) == 0
    assert len(slow_rates(np.zeros(100))) == 0


def test_a_candidate_combines_sine_and_cosine_to_amplitude_and_phase() -> None:
    cogging = EFFECTS["cogging"]
    columns = tuple({"A": 0.5, "n": 50.0, "p": phase} for phase in (0.0, np.pi / 2))
    effect = Candidate(cogging, "motor1", columns, {}).applied((3.0, 4.0))
    assert effect.parameters["A"] == pytest.approx(2.5)
    assert effect.parameters["p"] == pytest.approx(np.arctan2(4.0, 3.0))


def test_free_parameters_start_at_the_effects_values(hframe: Machine) -> None:
    effect = EFFECTS["stribeck_friction"].at("x", dF=0.8, vs=0.02)
    scales = TypicalScales({"x": {"force": 10.0, "speed": 0.5}}, {})
    free = {f.name: f for f in effect_parameters(effect, hframe, scales)}
    assert set(free) == {"stribeck_friction@x.dF", "stribeck_friction@x.vs"}
    for name, value in (("dF", 0.8), ("vs", 0.02)):
        parameter = free[f"stribeck_friction@x.{name}"]
        assert parameter.value(np.zeros(1)) == pytest.approx([value])
    assert free["stribeck_friction@x.dF"].scale is not None  # may change its sign


def test_the_recorded_motion_limits_what_a_fit_may_reach(hframe: Machine) -> None:
    """Less than a period of cogging, and a hysteresis over most of the travel, seem like a spring."""
    scales = TypicalScales({"x": {"position": 0.2}, "phi1": {"position": 8.0}}, {})
    hysteresis = effect_parameters(EFFECTS["dahl_hysteresis"].at("x", F=1.0, L=0.01), hframe, scales)
    assert {f.name: f.upper for f in hysteresis}["dahl_hysteresis@x.L"] == pytest.approx(0.05)
    cogging = effect_parameters(EFFECTS["cogging"].at("motor1", A=0.1, n=6.0, p=0.0), hframe, scales)
    assert {f.name: f.lower for f in cogging}["cogging@motor1.n"] == pytest.approx(2 * np.pi / 8.0)
    beyond = effect_parameters(EFFECTS["dahl_hysteresis"].at("x", F=1.0, L=0.08), hframe, scales)
    # a declared effect stays
    assert {f.name: f.upper for f in beyond}["dahl_hysteresis@x.L"] == pytest.approx(0.08)


def test_a_load_swings_once_at_least_within_a_run(hframe: Machine) -> None:
    """A slower one is a spring with friction; it was named beside a friction of another form."""
    scales = TypicalScales({"y": {"mass": 1.0}}, {LONGEST_RUN: 2.0})
    for natural, least in ((1.6, 0.5), (0.3, 0.3)):  # a declared one stays
        swing = EFFECTS["payload_swing"].at("y", f0=natural, zeta=0.1, r=0.1)
        machine = hframe.with_effects(swing)
        free = effect_parameters(swing, machine, scales)
        assert {f.name: f.lower for f in free}["payload_swing@y.f0"] == pytest.approx(least)
    slow = swing.definition.at("y", f0=0.5, zeta=0.1, r=0.1)
    limited = dataclasses.replace(fit_with(chi2=1.0), machine=hframe.with_effects(slow))
    limited = dataclasses.replace(limited, free=effect_parameters(slow, limited.machine, scales))
    values = parameter_values(slow.label, limited)
    assert parameter_at_limit(values).startswith("fits only with f0 at the limit of what the runs cover")
    unlimited = tuple(dataclasses.replace(v, covered=(0.2, 500.0)) for v in values if v.name == "f0")
    assert parameter_at_limit(unlimited) == ""


def test_a_force_has_at_least_one_period(hframe: Machine) -> None:
    data, _ = motion(0.6 * 2 * np.pi / 0.5)
    span = np.ptp(data[:, 0])
    assert periodogram_peaks(data, 1e-3).min() >= 2 * np.pi / span * 0.999
    assert periodogram_peaks(data, 1e-3, factor=np.sign(data[:, 1])).min() < 2 * np.pi / span


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (-1.0, 1.0, []),
        (-0.5, 1.0, [(True, False)]),
        (-0.5, 0.6, [(True, False), (False, True), (True, True)]),
    ],
)
def test_a_range_starts_from_ends_at_which_many_measurements_lie(
    low: float, high: float, expected: list[tuple[bool, bool]]
) -> None:
    """An end that was not reached lies far outside the measurements."""
    starts = EFFECTS["sensor_range"].starting_values
    assert starts is not None
    measured = np.clip(np.linspace(-1.0, 1.0, 5001), low, high)
    found = [(values["low"], values["high"]) for values in starts([measured], 1e-5)]
    assert [(abs(a) < 1.0, abs(b) < 1.0) for a, b in found] == expected
    for a, b in found:
        assert a in (pytest.approx(low), pytest.approx(-10.0 * abs(measured).max()))
        assert b in (pytest.approx(high), pytest.approx(10.0 * abs(measured).max()))
    assert starts([np.zeros(0)], 1e-5) == []


@pytest.mark.parametrize("others", [0, 6])
def test_runs_that_do_not_reach_an_end_do_not_hide_it(others: int) -> None:
    """One of seven runs reaches it, in 2 % of its rows, which are 0.3 % of all."""
    starts = EFFECTS["sensor_range"].starting_values
    assert starts is not None
    position = np.sin(np.linspace(0.0, 20.0, 2001))
    reaching = np.minimum(position, np.percentile(position, 98.0))
    found = starts([*[0.5 * position] * others, reaching], 1e-5)
    assert [values["high"] for values in found] == [pytest.approx(reaching.max())]


def test_an_effect_may_bring_starting_values_of_its_own() -> None:
    """Here from the largest measurement; the noise is that of the sensor."""
    data = axis_runs(AXIS, rows=1000, volts=6.0)
    noises: list[float] = []

    def from_largest(measured: Sequence[np.ndarray], noise: float) -> list[dict[str, float]]:
        noises.append(noise)
        return [{"low": -1.0, "high": max(float(run.max()) for run in measured)}]

    effect = dataclasses.replace(EFFECTS["sensor_range"], name="own_range", starting_values=from_largest)
    register_effect(effect)
    try:
        proposed = candidates(
            SearchState(AXIS, data, TypicalScales({"x": {}}, {}), {"x": motion(100.0)[0][:3000]})
        )
    finally:
        unregister_effect("own_range")
    [own] = [c for c in proposed if c.effect is effect]
    assert own.columns[0] == {"low": -1.0, "high": max(run.max() for run in data.measured_values(0))}
    assert noises == [data.noise[0]]


def test_a_table_that_the_machine_has_is_not_proposed_again() -> None:
    data = axis_runs(AXIS.with_effects(EFFECTS["quadratic_drag"].at("x", c=5.0)), rows=1000, volts=6.0)
    scales = TypicalScales({"x": {"force": 2.0, "speed": 0.5}}, {})
    first, *others = table_candidates(AXIS, data, scales, SelectionCriteria())
    tabled = AXIS.with_effects(first.applied(np.ones(len(first.columns))))
    labels = [candidate.label for candidate in table_candidates(tabled, data, scales, SelectionCriteria())]
    assert others
    assert first.label not in labels


def test_the_rate_of_many_short_periods_is_the_first_peak() -> None:
    """300 periods over the range of the motion, of which slow motion has enough rows."""
    rate = 300 * 2 * np.pi / np.ptp(motion(1.0)[0][:, 0])
    data, _ = motion(rate)
    assert abs(periodogram_peaks(data, 1e-3)[0] - rate) < 0.5 * rate / 300


def test_second_cogging_is_a_candidate_only_beside_cogging() -> None:
    data = axis_runs(AXIS, rows=1000, volts=6.0)
    scales = TypicalScales({"x": {"force": 2.0, "speed": 0.5, "position": 0.2}}, {})
    missing = {"x": motion(100.0)[0][: sum(len(run.time_s) for run in data.runs)]}

    def labels(machine: Machine) -> set[str]:
        return {candidate.label for candidate in candidates(SearchState(machine, data, scales, missing))}

    assert "cogging@motor" in labels(AXIS)
    assert "second_cogging@motor" not in labels(AXIS)
    assert "second_cogging@motor" in labels(
        AXIS.with_effects(EFFECTS["cogging"].at("motor", A=0.5, n=100.0, p=0.0))
    )


def test_periodic_errors_of_a_sensor_start_from_its_errors() -> None:
    """Not from the missing force of the coordinate, which may have other periods."""
    data = axis_runs(AXIS, rows=1000, volts=6.0)
    scales = TypicalScales({"x": {"force": 2.0, "speed": 0.5, "position": 0.2}}, {})
    [channel] = AXIS.output_channels
    missing = {"x": motion(100.0)[0][: sum(len(run.time_s) for run in data.runs)]}
    state = SearchState(AXIS, data, scales, missing, sensor_errors={channel: motion(583.0)[0]})
    first = next(c for c in candidates(state) if c.effect.name == "interpolation_error")
    assert first.columns[0]["n"] == pytest.approx(583.0, rel=0.01)
    unknown = SearchState(AXIS, data, scales, missing)
    assert "interpolation_error" not in {c.effect.name for c in candidates(unknown)}


@pytest.mark.parametrize("currents", [(4.2, 4.7), (4.7, 4.2)])
def test_a_common_limit_is_searched_for_up_to_the_largest_current(
    hframe: Machine, currents: tuple[float, float]
) -> None:
    """A limit of 4.5 A in both amplifiers binds in one only; it was named there, and tried nowhere else."""
    sizes = {f"phi{i + 1}": {"A": current} for i, current in enumerate(currents)}
    data: Any = None  # is not needed
    state = SearchState(hframe, data, TypicalScales(sizes, {}), {})
    limit = EFFECTS["current_limit"]
    assert state.sizes(limit, "drives")["A"] == 4.7
    assert [state.sizes(limit, f"motor{i}")["A"] for i in (1, 2)] == [*currents]
