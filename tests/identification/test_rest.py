"""Where a run rests: beside the independent simulator left alone, and what sensors and zeros are made to say of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.effects import EFFECTS
from hframe_gym.identification import prepare
from hframe_gym.identification.dataset import Dataset, PreparedRecording
from hframe_gym.identification.encoder_offsets import with_zeros, zero_errors
from hframe_gym.identification.estimation import cost_of
from hframe_gym.identification.prediction import initial_state_of_run
from hframe_gym.identification.static_equilibrium import static_equilibrium
from hframe_gym.machine import Machine, rest_state
from hframe_gym.recordings import Recording
from tests import reference_simulator as reference

RADIUS = 0.0194
QUANTUM = 5.2e-4  # rad
PLACES = np.random.default_rng(8).uniform(-0.1, 0.1, (7, 2)) * [1.0, 0.5]


def left_alone(rig: reference.Rig, place: np.ndarray) -> np.ndarray:
    """Where the simulator's stage, put down with unstretched belts and no voltage, comes to rest (4,)."""
    time_s = np.linspace(0.0, 1.0, 1001)
    positions, velocities = reference.simulate(rig, time_s, np.zeros((1001, 2)), place)
    assert np.abs(velocities[-1]).max() < 1e-6
    return positions[-1]


def stretched(position: np.ndarray) -> np.ndarray:
    """How far the pulleys stand from where belts are unstretched, m of travel, by phi1 and phi2."""
    x, y = position[:2]
    return RADIUS * position[2:4] - np.array([-(x + y), x - y])


@pytest.mark.parametrize("force", [0.3, 0.6, 0.8])  # N on y, whose friction holds 0.4 N; motors hold 1 N
def test_belts_hold_what_friction_does_not(hframe: Machine, force: float) -> None:
    rig = reference.Rig(constant_force=(0.0, force, 0.0, 0.0))
    true = left_alone(rig, PLACES[0])
    machine = hframe.with_effects(EFFECTS["constant_force"].at("y", size=force))
    at_rest = static_equilibrium(machine, true)
    off = stretched(at_rest) - stretched(true)
    # Friction can hold 0.4 N more or less, 17 um of the two belts' 24 kN/m: half of that may be left.
    assert np.abs(off).max() < 8e-6
    np.testing.assert_allclose(at_rest[:2], true[:2], atol=1e-12)


def run_at(place: np.ndarray, encoders: np.ndarray, told: bool, name: str = "run") -> PreparedRecording:
    start = np.concatenate([place, encoders, np.zeros(4)])
    outputs = np.tile([*encoders, *place], (50, 1))
    return PreparedRecording(
        name,
        np.arange(50) * 1e-3,
        np.zeros((50, 2)),
        outputs,
        start,
        50,
        np.zeros(4),
        np.array([told] * 2 + [False] * 2),
    )


def rigid(place: np.ndarray) -> np.ndarray:
    x, y = place
    return np.array([-(x + y), x - y]) / RADIUS


def test_a_skewed_laser_is_read_back(hframe: Machine) -> None:
    x, y, a = 0.1, -0.05, 5e-3
    shown = np.array([x, y + a * x])
    run = run_at(shown, rigid(shown), told=False)
    skewed = hframe.with_effects(EFFECTS["sensor_skew"].at("y_m", a=a))
    np.testing.assert_allclose(initial_state_of_run(skewed, run), rest_state(hframe, [x, y]), atol=1e-9)
    np.testing.assert_allclose(initial_state_of_run(hframe, run), rest_state(hframe, shown), atol=1e-9)


def test_a_place_beyond_the_range_is_not_read_back(hframe: Machine) -> None:
    """The laser did not place this run: its encoders did."""
    place = np.array([0.14, 0.02])
    stuck = hframe.with_effects(EFFECTS["sensor_range"].at("x_m", low=-0.1, high=0.1))
    np.testing.assert_allclose(
        initial_state_of_run(stuck, run_at(place, rigid(place), told=False))[:2], place, atol=1e-12
    )


def test_an_eccentric_pulley_stands_where_the_simulator_has_it(hframe: Machine) -> None:
    e, p, place = 0.5e-3, 0.7, np.array([0.06, -0.03])
    stage = reference.Stage(reference.Rig(eccentricity_m=(0.0, e), eccentricity_phase=(0.0, p)), place)
    shown = stage.position[2:4]
    machine = hframe.with_effects(EFFECTS["eccentric_pulley"].at("motor2", e=e, p=p))
    run = dataclasses.replace(run_at(place, shown, told=True), zeroed=True)
    # The state is that of a round pulley: its belts are unstretched.  Second order in e / r is left.
    assert abs(initial_state_of_run(machine, run)[3] - rigid(place)[1]) < 2 * (e / RADIUS) ** 2
    assert abs(shown[1] - rigid(place)[1]) > 20 * (e / RADIUS) ** 2


def test_zeros_are_put_right_under_a_cable(hframe: Machine) -> None:
    """Encoders whose common zero was taken as if a cable did not stretch the belts on the whole."""
    k, q0, wrong = 4.0, 0.2, np.array([2.4e-3, -1.1e-3])
    rig = reference.Rig(spring_stiffness=(0.0, k, 0.0, 0.0), spring_rest=(0.0, q0, 0.0, 0.0))
    machine = hframe.with_effects(EFFECTS["cable_spring"].at("y", k=k, q0=q0))
    rests = [left_alone(rig, place) for place in PLACES]
    runs = tuple(run_at(q[:2], q[2:4] + wrong, told=True, name=f"run_{i}") for i, q in enumerate(rests))
    data = Dataset(runs, np.full(4, 2e-5), np.zeros(4), np.array([True, True, False, False]))
    errors = zero_errors(machine, data)
    np.testing.assert_allclose(errors[:2], wrong, atol=0.3e-3)  # 6 um: what friction may hold
    right = with_zeros(data, machine, errors)
    for before, after in zip(runs, right.runs, strict=True):
        np.testing.assert_allclose(after.start[2:4], before.start[2:4] - errors[:2])
        np.testing.assert_allclose(after.outputs[:, :2], before.outputs[:, :2] - errors[:2])
    # A machine without effects says nothing of zeros.
    assert with_zeros(data, hframe, zero_errors(hframe, data)) is data


def test_only_rows_that_count_are_judged(hframe: Machine) -> None:
    time_s = np.arange(300) * 1e-3
    outputs = np.tile([0.0, 0.0, 0.01, 0.02], (300, 1))
    outputs[200:, 2] += 1e-3
    recordings = [Recording(f"r{i}", time_s, np.zeros((300, 2)), outputs) for i in range(2)]
    data = prepare(recordings, hframe)
    whole = cost_of(hframe, data, "free")
    early = data.judged([time_s < 0.2] * 2)
    late = data.judged([time_s >= 0.2] * 2)
    assert early.count + late.count == data.count
    assert cost_of(hframe, early, "free") + cost_of(hframe, late, "free") == pytest.approx(whole)
