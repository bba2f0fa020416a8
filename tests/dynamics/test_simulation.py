"""Simulation against an event-driven simulator (tests/reference_simulator), and its general properties."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hframe_gym.dynamics import NotFiniteError, rollout, simulate, simulate_batch
from hframe_gym.dynamics.codegen import time_loops
from hframe_gym.effects import EFFECTS
from hframe_gym.errors import InputError
from hframe_gym.machine import BUILTIN_MACHINES, AppliedEffect, Machine, rest_state
from tests import reference_simulator as reference
from tests.reference_simulator import Rig

ORACLE = pytest.mark.oracle
TIME = np.arange(401) * 1e-3
START = (0.08, -0.05)
RADII = np.array([1.0, 1.0, 0.0194, 0.0194])


def history(seed: int) -> np.ndarray:
    """Return random voltages (401, 2), held for 10 ms, after 20 ms of rest."""
    rng = np.random.default_rng(seed)
    levels = rng.uniform(-8, 8, (41, 2))
    levels[:2] = 0.0
    return np.repeat(levels, 10, axis=0)[:401]


def difference(machine: Machine, rig: Rig, seed: int) -> float:
    """Return the largest difference of travel over 0.4 s of random voltages, m.

    A delayed voltage changes within a step, which uses its mean over the step; therefore the step is shorter
    then.
    """
    inputs = history(seed)
    exact, _ = reference.simulate(rig, TIME, inputs, START)
    step = 0.1e-3 if any(rig.input_delay_s) else 0.25e-3
    positions = simulate(machine, TIME, inputs, rest_state(machine, START), longest_step=step).positions
    return float(np.abs((positions - exact) * RADII).max())


@ORACLE
@pytest.mark.parametrize("seed", range(4))
def test_machine_without_effects(seed: int, hframe: Machine) -> None:
    """The paper's rig under random voltages."""
    assert difference(hframe, Rig(), seed) < 2e-6


@ORACLE
@pytest.mark.parametrize(
    ("effect", "change"),
    [
        (
            EFFECTS["stribeck_friction"].at("x", dF=3.0, vs=0.04),
            {"stribeck_force": (3.0, 0, 0, 0), "stribeck_velocity": (0.04, 1, 1, 1)},
        ),
        (
            EFFECTS["stribeck_friction"].at("phi2", dF=0.03, vs=2.0),
            {"stribeck_force": (0, 0, 0, 0.03), "stribeck_velocity": (1, 1, 1, 2.0)},
        ),
        (EFFECTS["constant_force"].at("y", size=-1.5), {"constant_force": (0, -1.5, 0, 0)}),
        (EFFECTS["constant_force"].at("phi1", size=0.03), {"constant_force": (0, 0, 0.03, 0)}),
        (EFFECTS["asymmetric_viscous"].at("x", a=0.3), {"viscous_asymmetry": (0.3, 0, 0, 0)}),
        (EFFECTS["asymmetric_viscous"].at("phi1", a=-0.4), {"viscous_asymmetry": (0, 0, -0.4, 0)}),
        (EFFECTS["input_delay"].at("drives", d=0.0023), {"input_delay_s": (0.0023, 0.0023)}),
    ],
    ids=lambda value: value.label if isinstance(value, AppliedEffect) else "",
)
def test_effects_at_carriage_and_motor(
    effect: AppliedEffect, change: dict[str, tuple[float, ...]], hframe: Machine
) -> None:
    """The difference is far smaller than the effect."""
    rig = dataclasses.replace(Rig(), **change)
    machine = hframe.with_effects(effect)
    assert difference(machine, rig, 11) < 5e-6
    assert difference(hframe, rig, 11) > 5e-5


def test_static_friction_does_not_creep(hframe: Machine) -> None:
    """Below breakaway the belts stretch, then nothing moves for 10 s."""
    time = np.arange(1001) * 1e-2
    trajectory = simulate(hframe, time, np.full((1001, 2), 0.2))
    assert np.abs(trajectory.positions[-1] - trajectory.positions[100]).max() < 1e-12
    np.testing.assert_array_equal(trajectory.velocities[-1], 0.0)


def test_machine_at_rest_stays_at_rest(hframe: Machine) -> None:
    """Without voltage nothing moves."""
    trajectory = simulate(hframe, TIME, np.zeros((401, 2)))
    np.testing.assert_array_equal(trajectory.positions, 0.0)


@pytest.mark.parametrize("batch", [1, 7, 4096])
def test_bits_do_not_depend_on_batch_or_threads(
    batch: int, hframe: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last machine of a batch moves exactly as it does alone."""
    time, inputs = TIME[:51], history(5)[:51]
    alone = rollout(hframe, time, inputs, velocities=True)[0]
    many = np.tile(inputs, (batch, 1, 1))
    many[:-1] *= 0.5
    for threads in ("1", "2"):
        monkeypatch.setenv("HFRAME_THREADS", threads)
        np.testing.assert_array_equal(rollout(hframe, time, many, velocities=True)[-1], alone)


@pytest.mark.parametrize("voltages", [1, 5])
def test_machines_of_a_batch_have_their_own_delays(voltages: int, hframe: Machine) -> None:
    """Each moves exactly as alone, whether it shares voltages and delay with the first machine or not."""
    machine = hframe.with_effects(EFFECTS["input_delay"].at("motor1", d=0.7e-3))
    parameters = np.tile(list(machine.parameters.values()), (5, 1))
    delays = [0.7e-3, 0.7e-3, 2.3e-3, 0.0, 0.7e-3]
    parameters[:, list(machine.parameters).index("input_delay@motor1.d")] = delays
    inputs = history(5)[:51] * np.linspace(1.0, 0.5, voltages)[:, None, None]
    batch = rollout(machine, TIME[:51], inputs, parameters=parameters)
    for b in range(5):
        own = inputs[min(b, voltages - 1)]
        alone = rollout(machine, TIME[:51], own, parameters=parameters[b : b + 1])[0]
        np.testing.assert_array_equal(batch[b], alone)


def test_a_number_of_threads_that_is_none_is_named(hframe: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HFRAME_THREADS", "all")
    with pytest.raises(InputError, match="HFRAME_THREADS is 'all'"):
        rollout(hframe, TIME[:3], history(5)[:3])


@ORACLE
def test_integrator_is_of_second_order(hframe: Machine) -> None:
    """A quarter of the step reduces the error at least eightfold."""
    inputs = history(7)
    exact, _ = reference.simulate(Rig(), TIME, inputs, START)
    start = rest_state(hframe, START)
    errors = [
        np.sqrt(
            np.mean((simulate(hframe, TIME, inputs, start, longest_step=h).positions - exact)[:, :2] ** 2)
        )
        for h in (1e-3, 0.25e-3)
    ]
    assert errors[0] / errors[1] > 8


def test_energy_is_conserved_without_friction_and_drives(hframe: Machine) -> None:
    """Stretched belts oscillate; the force 1/2 s^2 dk/dq closes the balance."""
    coordinates = tuple(dataclasses.replace(c, viscous=0.0, coulomb=0.0) for c in hframe.coordinates)
    drives = tuple(dataclasses.replace(d, Ke=0.0) for d in hframe.drives)
    machine = hframe.replace(coordinates=coordinates, drives=drives)
    start = rest_state(machine, START)
    start[2] += 0.3
    trajectory = simulate(machine, TIME, np.zeros((401, 2)), start, longest_step=0.05e-3)
    travel = trajectory.positions * RADII
    potential = np.zeros(len(TIME))
    for b in machine.belts:
        length = b.rest_length + travel @ machine.coefficients(b.length)
        potential += 0.5 * b.EA / length * (travel @ machine.coefficients(b.extension)) ** 2
    kinetic = trajectory.velocities**2 @ np.array([0.5 * c.mass for c in machine.coordinates])
    total = potential + kinetic
    assert np.ptp(total) / total[0] < 2e-4
    assert total[-1] == pytest.approx(total[0], rel=1e-4)


@pytest.mark.parametrize(
    ("time", "inputs", "message"),
    [
        ([0.0, 0.0], np.zeros((2, 2)), "strictly increasing"),
        ([], np.zeros((0, 2)), "strictly increasing"),
        ([0.0, 1e6], np.zeros((2, 2)), r"more than 1e\+09 steps"),
        ([0.0, 1e-3], np.zeros((2, 3)), r"inputs have shape \(2, 3\)"),
        ([0.0, 1e-3], np.array([[0, 0], [0, np.nan]]), "row 1, v2_V is nan"),
    ],
)
def test_invalid_input_is_refused(
    time: list[float], inputs: np.ndarray, message: str, hframe: Machine
) -> None:
    """The message names the fault."""
    with pytest.raises(ValueError, match=message):
        simulate(hframe, time, inputs)


@pytest.mark.parametrize("step", [-1e-3, 0.0, float("nan"), float("inf")])
def test_a_longest_step_that_is_no_time_is_refused(step: float, hframe: Machine) -> None:
    with pytest.raises(ValueError, match=r"longest_step is .*, it must be a positive number of seconds"):
        simulate(hframe, [0.0, 1e-3], np.zeros((2, 2)), longest_step=step)


def test_measurements_without_gains_correct_nothing() -> None:
    """Without observer gains, measurements leave the simulation unchanged."""
    machine = BUILTIN_MACHINES["axis"]()
    inputs, measured = np.full((len(TIME), 1), 6.0), np.full((len(TIME), 1), 0.1)
    free, observed = (simulate_batch(machine, TIME, inputs, measured=m).positions for m in (None, measured))
    assert np.array_equal(free, observed)


def test_divergence_is_reported(hframe: Machine) -> None:
    """In one line, with time and coordinate."""
    stiff = hframe.replace({"left.EA": 1e15})
    start = rest_state(stiff)
    start[0] = 0.1
    with pytest.raises(NotFiniteError, match=r"diverges at t = \S+ s \((velocity of )?\w+\)\. Check"):
        simulate(stiff, TIME, np.zeros((401, 2)), start)


def test_axis_reaches_its_steady_speed() -> None:
    """The closed form is (gain V - F) / (b + back-EMF)."""
    machine = BUILTIN_MACHINES["axis"]()
    time = np.arange(3001) * 1e-3
    drive, c = machine.drives[0], machine.coordinates[0]
    speed = simulate(machine, time, np.full((3001, 1), 2.0)).velocities[-1, 0]
    assert speed == pytest.approx((drive.gain * 2.0 - c.coulomb) / (c.viscous + drive.back_emf), rel=1e-9)


@pytest.mark.parametrize("delay", [0.4e-3, 3.3e-3])
def test_a_sensor_delay_is_exact_at_uneven_sampling(delay: float, hframe: Machine) -> None:
    """Delayed readings are those of the motion at the delayed times, also at the second sample."""
    time = np.concatenate(
        [[0.0, 1e-3], 1e-3 + np.cumsum(np.random.default_rng(0).uniform(0.1e-3, 1.5e-3, 200))]
    )
    delayed_times = np.maximum(time - delay, 0.0)
    every_time = np.unique(np.concatenate([time, delayed_times]))
    volts, start = [3.0, 2.0], rest_state(hframe, START)
    start[4:] = 0.05, 0.0, 3.0, 3.0  # m/s and rad/s
    undelayed = simulate(hframe, every_time, np.tile(volts, (len(every_time), 1)), start, longest_step=2e-5)
    machine = hframe.with_effects(*(EFFECTS["sensor_delay"].at(s.channel, d=delay) for s in hframe.sensors))
    delayed = simulate(machine, time, np.tile(volts, (len(time), 1)), start, longest_step=2e-5)
    expected = undelayed.outputs[np.searchsorted(every_time, delayed_times)]
    np.testing.assert_allclose(delayed.outputs[1], expected[1], atol=5e-4)  # linear interpolation
    np.testing.assert_allclose(delayed.outputs[2:], expected[2:], atol=1e-4)


def test_read_only_recordings_are_simulated_by_the_same_compiled_code(axis: Machine) -> None:
    """To Numba, a read-only array is of another type: each combination would take seconds of compilation."""
    series = (TIME, np.ones((401, 1)), np.zeros((401, 1)))
    gains = np.zeros((2, 1))
    simulate_batch(axis, series[0], series[1], measured=series[2], gains=gains)
    compiled = len(time_loops.rollout.signatures)
    for k in range(3):
        time_s, inputs, measured = (values.copy() for values in series)
        (time_s, inputs, measured)[k].setflags(write=False)
        simulate_batch(axis, time_s, inputs, measured=measured, gains=gains)
    assert len(time_loops.rollout.signatures) == compiled


def test_samples_between_the_rows_change_voltages_only(axis: Machine) -> None:
    """With two samples a row, the simulation is that of all samples, of which only the rows are measured."""
    rng = np.random.default_rng(0)
    inputs, gains = rng.uniform(-2.0, 2.0, (401, 1)), np.array([[0.1], [2.0]])
    measured = np.full((401, 1), np.nan)
    measured[::2] = rng.normal(0.0, 1e-3, (201, 1))
    complete = simulate_batch(axis, TIME, inputs, measured=measured, gains=gains)
    in_rows = simulate_batch(axis, TIME, inputs, measured=measured[::2], gains=gains, every=2)
    for every_sample, rows in zip(complete, in_rows, strict=True):
        assert np.array_equal(every_sample[:, ::2], rows)


def test_offsets_are_added_to_readings_and_reach_the_observer(axis: Machine) -> None:
    offsets, gains = np.array([[0.0], [2e-3]]), np.array([[0.1], [2.0]])
    inputs, measured = np.ones((401, 1)), np.zeros((401, 1))
    both = simulate_batch(axis, TIME, inputs, measured=measured, gains=gains, offsets=offsets)
    moved = simulate_batch(axis, TIME, inputs, measured=measured - 2e-3, gains=gains)
    np.testing.assert_allclose(both.positions[1], moved.positions[0], atol=1e-15)
    np.testing.assert_allclose(both.readings[1], moved.readings[0] + 2e-3, atol=1e-15)
    assert not np.allclose(both.positions[0], both.positions[1], atol=1e-4)
