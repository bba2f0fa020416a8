"""Tests of a machine's initial state: equilibrium, effects on measurements, zeros, simulated recordings."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_gym.dynamics import simulate
from hframe_gym.effects import EFFECTS
from hframe_gym.identification import (
    Dataset,
    InitialState,
    PreparedRecording,
    prepare,
    simulate_recording,
)
from hframe_gym.identification.fit.channel_errors import channel_errors
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect, Belt, Machine, rest_state
from hframe_gym.preparation.session_zeros import refine_encoder_zeros
from hframe_gym.preparation.start.belt_stretch import static_equilibrium
from hframe_gym.preparation.start.modeled_state import encoder_zero_errors, model_initial_states
from hframe_gym.recordings import Recording, load_machine
from tests import reference_simulator as reference

pytestmark = pytest.mark.oracle
RADIUS = 0.0194
REPOSITORY = Path(__file__).resolve().parents[3]
QUANTUM = 5.2e-4  # rad
POSITIONS = np.random.default_rng(8).uniform(-0.1, 0.1, (7, 2)) * [1.0, 0.5]


def settled(rig: reference.Rig, position: np.ndarray) -> np.ndarray:
    """Return where the simulator's stage, put down with unstretched belts at 0 V, comes to rest (4,)."""
    time_s = np.linspace(0.0, 1.0, 1001)
    positions, velocities = reference.simulate(rig, time_s, np.zeros((1001, 2)), position)
    assert np.abs(velocities[-1]).max() < 1e-6
    return positions[-1]


def belt_stretch(position: np.ndarray) -> np.ndarray:
    """Return the travel of the pulleys beyond that of unstretched belts, m, by phi1 and phi2."""
    x, y = position[:2]
    return RADIUS * position[2:4] - np.array([-(x + y), x - y])


@pytest.mark.parametrize("force", [0.3, 0.6, 0.8])
def test_belts_carry_what_static_friction_does_not(hframe: Machine, force: float) -> None:
    """The force acts on y, whose friction holds 0.4 N; the motors hold 1 N."""
    rig = reference.Rig(constant_force=(0.0, force, 0.0, 0.0))
    true = settled(rig, POSITIONS[0])
    machine = hframe.with_effects(EFFECTS["constant_force"].at("y", size=force))
    equilibrium = static_equilibrium(machine, true)
    error = belt_stretch(equilibrium) - belt_stretch(true)
    # Friction can hold 0.4 N more or less, 17 um of the two belts' 24 kN/m; half of that may remain.
    assert np.abs(error).max() < 8e-6
    np.testing.assert_allclose(equilibrium[:2], true[:2], atol=1e-12)


def test_equilibrium_of_a_machine_without_carriages() -> None:
    """Two coupled motors: a belt, but no linear coordinate."""
    machine = load_machine(REPOSITORY / "benchmarks" / "machines" / "ced.json")
    np.testing.assert_array_equal(static_equilibrium(machine, np.zeros((3, 2)))[:, 0], 0.0)
    assert static_equilibrium(machine, np.zeros(2)).shape == (2,)


def test_a_carriage_that_an_effect_adds_rests_beside_its_own() -> None:
    """The teeth behind a gap split the driven one of two carriages on a spring."""
    axis = BUILTIN_MACHINES["axis"]()
    second = dataclasses.replace(axis.coordinate("x"), name="y")
    pair = axis.with_components(second, Belt("spring", 150.0, 1.0, {"x": -1.0, "y": 1.0}))
    gap = EFFECTS["gear_backlash"].at("motor", d=1e-4, J=0.1, F=0.1, B=0.1, K=2e4, Z=1.0)
    machine = pair.with_effects(gap)
    equilibrium = static_equilibrium(machine, np.array([[0.1, 0.1], [-0.2, -0.2]]))
    np.testing.assert_allclose(equilibrium, [[0.1] * 3, [-0.2] * 3], atol=1e-12)
    assert max(abs(machine.belt_matrix @ equilibrium[0])) < 1e-12


def initial_at(position: np.ndarray, encoders: np.ndarray, known: bool) -> InitialState:
    """Return the initial state that sensors without noise measure."""
    state = np.concatenate([position, encoders, np.zeros(4)])
    return InitialState(state, np.zeros(4), 50, zero_spread=1e-4 * np.array([known, known, False, False]))


def prepared(initial: InitialState, name: str) -> PreparedRecording:
    """Return a run at rest in an initial state."""
    outputs = np.tile([*initial.state[2:4], *initial.state[:2]], (50, 1))
    return PreparedRecording(
        name,
        np.arange(50) * 1e-3,
        np.zeros((50, 2)),
        outputs,
        initial,
        *[np.ones_like(outputs)] * 2,
        dropped=np.zeros(50, dtype=bool),
    )


def rigid(position: np.ndarray) -> np.ndarray:
    """Return the pulley angles of unstretched belts, rad."""
    x, y = position
    return np.array([-(x + y), x - y]) / RADIUS


def test_a_skewed_laser_is_inverted(hframe: Machine) -> None:
    x, y, a = 0.1, -0.05, 5e-3
    measured = np.array([x, y + a * x])
    initial = initial_at(measured, rigid(measured), known=False)
    skewed = hframe.with_effects(EFFECTS["sensor_skew"].at("y_m", a=a))
    np.testing.assert_allclose(
        model_initial_states(skewed, [initial])[0], rest_state(hframe, [x, y]), atol=1e-9
    )
    np.testing.assert_allclose(
        model_initial_states(hframe, [initial])[0], rest_state(hframe, measured), atol=1e-9
    )


def test_a_position_beyond_the_range_of_a_laser_is_kept(hframe: Machine) -> None:
    """The laser did not determine this position, the encoders did."""
    position = np.array([0.14, 0.02])
    limited = hframe.with_effects(EFFECTS["sensor_range"].at("x_m", low=-0.1, high=0.1))
    initial = initial_at(position, rigid(position), known=False)
    np.testing.assert_allclose(model_initial_states(limited, [initial])[0][:2], position, atol=1e-12)


def test_an_eccentric_pulley_rests_where_the_simulator_has_it(hframe: Machine) -> None:
    e, p, position = 0.5e-3, 0.7, np.array([0.06, -0.03])
    stage = reference.Stage(reference.Rig(eccentricity_m=(0.0, e), eccentricity_phase=(0.0, p)), position)
    measured = stage.position[2:4]
    machine = hframe.with_effects(EFFECTS["eccentric_pulley"].at("motor2", e=e, p=p))
    initial = dataclasses.replace(initial_at(position, measured, known=True), zeros_refined=True)
    # The state is that of a round pulley, whose belts are unstretched, up to second order in e / r.
    assert abs(model_initial_states(machine, [initial])[0][3] - rigid(position)[1]) < 2 * (e / RADIUS) ** 2
    assert abs(measured[1] - rigid(position)[1]) > 20 * (e / RADIUS) ** 2


ENCODER_ERRORS = [
    EFFECTS["eccentric_encoder"].at("phi2_rad", A=0.02, p=0.7),
    EFFECTS["interpolation_error"].at("phi2_rad", A=0.005, n=12.0, p=0.7),
    EFFECTS["sensor_scale"].at("phi2_rad", g=0.01),
]


@pytest.mark.parametrize("effect", ENCODER_ERRORS, ids=lambda effect: effect.name)
def test_what_an_encoder_adds_is_no_stretch_of_the_belts(hframe: Machine, effect: AppliedEffect) -> None:
    """Not even before the zeros are refined, which a wrong machine has estimated."""
    position, machine = np.array([0.06, -0.03]), hframe.with_effects(effect)
    angles = rigid(position) + np.array([0.0, 1e-3])
    measured = angles.copy()
    measured[1] = effect("measurement", r=angles[1], q=angles[1], across=0.0)
    initial = dataclasses.replace(initial_at(position, measured, known=True), zeros_refined=True)
    np.testing.assert_allclose(model_initial_states(machine, [initial])[0][2:4], angles, atol=1e-6)
    unrefined = initial_at(position, measured, known=True)
    np.testing.assert_allclose(
        model_initial_states(machine, [unrefined])[0][2:4], rigid(position), atol=1e-12
    )


@pytest.mark.parametrize("effect", ENCODER_ERRORS, ids=lambda effect: effect.name)
def test_zeros_are_refined_for_what_an_encoder_adds(hframe: Machine, effect: AppliedEffect) -> None:
    """The zeros had been the mean over all runs, which contains the mean of this error."""
    wrong = np.array([0.0, -6e-3])
    machine = hframe.with_effects(effect)
    initial = []
    for position in POSITIONS:
        measured = rigid(position)
        measured[1] = effect("measurement", r=measured[1], q=measured[1], across=0.0)
        initial.append(initial_at(position, measured + wrong, known=True))
    errors = encoder_zero_errors(machine, initial)
    np.testing.assert_allclose(errors[:2], wrong, atol=0.07 * abs(wrong[1]))  # it is found to first order


@pytest.mark.parametrize(("stretch", "left"), [(5e-3, 3e-3), (-5e-3, -3e-3), (1e-3, 0.0)])
def test_behind_a_gap_the_belts_bear_what_exceeds_it(hframe: Machine, stretch: float, left: float) -> None:
    """The encoder measures the motor, which friction holds; half the gap is 2 mrad."""
    position, angles = np.array([0.06, -0.03]), rigid(np.array([0.06, -0.03]))
    gap = EFFECTS["gear_backlash"].at("motor1", d=2e-3, J=4e-5, F=0.02, B=0.0, K=100.0, Z=0.5)
    machine = hframe.with_effects(gap)
    initial = initial_at(position, angles + np.array([stretch, 0.0]), known=True)
    state = model_initial_states(machine, [dataclasses.replace(initial, zeros_refined=True)])[0]
    assert state[2] == pytest.approx(angles[0] + stretch)
    assert state[machine.coordinate_names.index("phi1_load")] == pytest.approx(angles[0] + left, abs=1e-9)


def test_zeros_are_refined_under_the_force_of_a_cable(hframe: Machine) -> None:
    """The common zero of the encoders was estimated as if the cable did not stretch the belts on average."""
    k, q0, wrong = 4.0, 0.2, np.array([2.4e-3, -1.1e-3])
    rig = reference.Rig(spring_stiffness=(0.0, k, 0.0, 0.0), spring_rest=(0.0, q0, 0.0, 0.0))
    machine = hframe.with_effects(EFFECTS["cable_spring"].at("y", k=k, q0=q0))
    rests = [settled(rig, position) for position in POSITIONS]
    initial = [initial_at(q[:2], q[2:4] + wrong, known=True) for q in rests]
    runs = tuple(prepared(state, f"run_{i}") for i, state in enumerate(initial))
    data = Dataset(runs, np.full(4, 2e-5), np.zeros(4), np.array([True, True, False, False]))
    errors = encoder_zero_errors(machine, initial)
    np.testing.assert_allclose(errors[:2], wrong, atol=0.3e-3)  # 6 um, which friction may hold
    refined = refine_encoder_zeros(data, machine)
    for before, after in zip(runs, refined.runs, strict=True):
        np.testing.assert_allclose(after.initial.state[2:4], before.initial.state[2:4] - errors[:2])
        np.testing.assert_allclose(after.outputs[:, :2], before.outputs[:, :2] - errors[:2])
    # A machine without effects predicts nothing about the zeros.
    assert refine_encoder_zeros(data, hframe) is data
    # In logs with interpolated voltages, neither does one whose effects act in motion only.
    unknown: Any = object()
    slow = dataclasses.replace(
        data, runs=tuple(dataclasses.replace(run, voltage_errors=unknown) for run in runs)
    )
    friction = EFFECTS["stribeck_friction"].at("x", dF=1.0, vs=0.05)
    assert refine_encoder_zeros(slow, hframe.with_effects(friction)) is slow
    assert refine_encoder_zeros(slow, machine) is not slow


# Starts and voltages of runs that leave and enter the range of a laser, +-0.1 m.
RUNS = {
    "inside": ((0.02, -0.05), (1.0, -3.0)),
    "to_the_left": ((0.06, 0.03), (4.0, -2.0)),
    "beyond": ((0.14, 0.02), (5.0, -4.0)),
    "to_the_right": ((-0.05, -0.02), (-3.0, 4.0)),
}


def measured_runs(machine: Machine, zeros: tuple[float, float]) -> list[Recording]:
    """Return noisy runs of a machine that starts at rest, with encoders switched on at given angles."""
    rng = np.random.default_rng(5)
    time_s = np.arange(900) * 1e-3
    recordings = []
    for name, (start, voltage) in RUNS.items():
        inputs = np.where((time_s[:, None] > 0.1) & (time_s[:, None] < 0.6), voltage, 0.0)
        ideal = simulate(machine, time_s, inputs, rest_state(machine, start)).outputs
        encoders = np.round((ideal[:, :2] + zeros) / QUANTUM) * QUANTUM
        outputs = np.hstack([encoders, ideal[:, 2:] + rng.normal(0.0, 20e-6, (len(time_s), 2))])
        recordings.append(Recording(name, time_s, inputs, outputs))
    return recordings


def simulated_rmse(machine: Machine, recording: Recording) -> np.ndarray:
    """Return simulation errors (sensors,) from the recording's initial state, as in `hframe simulate`."""
    initial = simulate_recording(machine, recording).initial
    trajectory = simulate(machine, recording.time_s, recording.inputs, initial.state, offset=initial.zeros)
    return np.asarray(np.sqrt(np.mean((recording.outputs - trajectory.outputs) ** 2, axis=0)))


@pytest.mark.parametrize("effect", ["sensor_skew", "sensor_range"])
@pytest.mark.parametrize("zeros", [(0.0, 0.0), (1.3, -2.1)])
def test_simulation_of_a_recording_has_the_errors_that_identification_reports(
    hframe: Machine, effect: str, zeros: tuple[float, float]
) -> None:
    """With an identified skew a measurement is not the position; with a range, runs may begin beyond."""
    applied = {
        "sensor_skew": EFFECTS["sensor_skew"].at("y_m", a=0.08),
        "sensor_range": EFFECTS["sensor_range"].at("x_m", low=-0.1, high=0.1),
    }[effect]
    machine = hframe.with_effects(applied)
    recordings = measured_runs(machine, zeros)
    usable = []
    for run in recordings:  # identification does not use saturated measurements
        outputs = run.outputs.copy()
        if effect == "sensor_range":
            outputs[np.abs(outputs[:, 2]) > 0.1 - 80e-6, 2] = np.nan
        usable.append(dataclasses.replace(run, outputs=outputs))
    data = prepare(usable, hframe)
    for name, run in zip(RUNS, recordings, strict=True):
        complete = dataclasses.replace(
            data.with_runs([name]).runs[0], outputs=run.outputs - data.with_runs([name]).runs[0].initial.zeros
        )
        reported = channel_errors(machine, dataclasses.replace(data, runs=(complete,)))
        expected = [reported[channel].rmse for channel in machine.output_channels]
        np.testing.assert_allclose(simulated_rmse(machine, run), expected, rtol=0.05)
        assert simulated_rmse(machine, run)[2] < 22e-6


def test_a_start_beyond_the_range_is_determined_from_later_measurements_and_reported(hframe: Machine) -> None:
    machine = hframe.with_effects(EFFECTS["sensor_range"].at("x_m", low=-0.1, high=0.1))
    run = measured_runs(machine, (1.3, -2.1))[2]
    initial = simulate_recording(machine, run).initial
    np.testing.assert_allclose(initial.state[:2], RUNS["beyond"][0], atol=20e-6)
    assert "x_m measures nothing at rest" in initial.warnings[0]


def test_a_recording_without_outputs_starts_at_the_origin_with_a_warning(hframe: Machine) -> None:
    run = Recording("voltages", np.arange(50) * 1e-3, np.zeros((50, 2)), np.full((50, 4), np.nan))
    initial = simulate_recording(hframe, run).initial
    np.testing.assert_array_equal(initial.state, 0.0)
    np.testing.assert_array_equal(initial.zeros, 0.0)
    assert "cannot be determined" in initial.warnings[0]
